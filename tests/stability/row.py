"""A row of the report, and the judge of all of them.

A row holds if what was measured is what was expected within the noise of the measurement, if no sample was not a
number, and if the measurement could have told: it must resolve a deviation of `RESOLUTION`. A known limit is a
deviation that the README names; its row holds if the deviation has the size named there, so that a limit that moves is
noticed too.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

Z_LIMIT = 4.5
"""Of 300 rows one exceeds it by chance in five hundred runs; seeds are fixed, so a row that holds goes on holding."""
ROUNDING = 1e-6
"""Relative; pixels are f32."""
RESOLUTION = 0.02
"""Largest relative deviation that a row may overlook: a pdf that is wrong by 2 % has to be seen."""


@dataclass(frozen=True)
class Limit:
    """A known limit: the relative deviation that is expected, `low` to `high`, and the words of the README."""

    low: float
    high: float
    words: str


def about(deviation: float, words: str) -> Limit:
    """A deviation of about so much: within a third, which is more than seeds move it."""
    low, high = sorted((0.67 * deviation, 1.33 * deviation))
    return Limit(max(-1.0, low), high, words)


@dataclass
class Row:
    """One number. `error` is the standard error of `measured`, `tolerance` what else it may deviate by, absolutely."""

    family: str
    stressed: str
    source: str
    expected: float
    measured: float
    error: float = 0.0
    tolerance: float = 0.0
    non_finite: int = 0
    note: str = ""
    walk: str = ""
    seconds: float = 0.0
    limit: Limit | None = None
    resolution: float = RESOLUTION

    @property
    def z(self) -> float:
        """Deviation beyond the tolerance in standard errors; infinite where an exact number is missed."""
        beyond = max(0.0, abs(self.measured - self.expected) - self.tolerance - ROUNDING * abs(self.expected))
        if beyond == 0.0:
            return 0.0
        return math.copysign(
            beyond / self.error if self.error > 0.0 else math.inf, self.measured - self.expected
        )

    @property
    def deviation(self) -> float:
        """Relative; absolute where nothing is expected."""
        return (self.measured - self.expected) / (abs(self.expected) or 1.0)

    @property
    def resolved(self) -> float:
        """Smallest relative deviation that this row would flag."""
        return (Z_LIMIT * self.error + self.tolerance) / (abs(self.expected) or 1.0)

    @property
    def verdict(self) -> str:
        """`holds`, `known limit`, or why it fails."""
        if self.non_finite:
            return f"fails: {self.non_finite} values are not finite"
        if not math.isfinite(self.measured):
            return "fails: not finite"
        if self.limit:
            within = self.limit.low <= self.deviation <= self.limit.high
            return "known limit" if within else f"fails: limit is {self.limit.low:g} to {self.limit.high:g}"
        if not abs(self.z) <= Z_LIMIT:
            return "fails: off"
        if self.resolved > self.resolution:
            return f"fails: would overlook {self.resolved:.1%}"
        return "holds"

    @property
    def holds(self) -> bool:
        return not self.verdict.startswith("fails")


@dataclass(frozen=True)
class Case:
    """What is stressed, and the measurement that gives its rows. `quick`: part of `make test`."""

    stressed: str
    rows: Callable[[], Iterable[Row]]
    quick: bool = False
    tags: tuple[str, ...] = field(default=())
