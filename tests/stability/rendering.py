"""Renders of flat prims, and what is measured of their pictures."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import hydra
from dermis._core import Delegate

from .row import RESOLUTION, Z_LIMIT, Row
from .scenes import Prim

THREADS = 0
"""Of every render; 0: all."""
BUDGET = 4e7
"""Rays, walk steps included, that a render may take for the sake of precision, about: some seconds. A count and no
time, so that a row is the same on every machine."""
WAIT = 600.0
"""Seconds after which a render is given up."""


@dataclass
class Picture:
    color: NDArray[np.float64]
    """Height, width, RGB."""
    stats: dict[str, Any]
    variance: NDArray[np.float64]
    """Of the mean of every pixel, as its samples tell."""
    non_finite: int
    """Samples, and values of any AOV."""
    seconds: float

    def mean(self, channel: int, alike: bool = True) -> tuple[float, float]:
        """Over the pixels, which are independent, and its standard error: by their spread where all are `alike`,
        else by their own variances."""
        mean, error = mean_and_error(self.color[..., channel])
        own = self.variance[..., channel]
        return mean, error if alike else float(np.sqrt(own.sum()) / own.size)

    def warnings(self) -> list[str]:
        return [warning["message"] for warning in self.stats["warnings"]]


def mean_and_error(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(values.size))


def load(prims: Mapping[str, Prim]) -> hydra.Delegate:
    delegate = hydra.Delegate(Delegate())
    for path, prim in prims.items():
        delegate.sync(path, prim)
    return delegate


def snapshots(
    prims: Mapping[str, Prim], seeds: Iterable[int], size: int, aovs: Iterable[str] = (), **settings: Any
) -> list[dict[str, NDArray[np.float32]]]:
    """All layers of a render for each seed."""
    delegate = load(prims)
    made = []
    for seed in seeds:
        delegate.set_settings(camera="/C", resolution=[size, size], seed=seed, aovs=list(aovs), **settings)
        delegate.commit()
        delegate.start()
        assert delegate.wait(120.0)
        made.append(delegate.snapshot())
    return made


def render(prims: Mapping[str, Prim], size: int = 24, samples: int = 64, **settings: Any) -> Picture:
    return run(load(prims), size, samples, **settings)


def resolving(
    prims: Mapping[str, Prim],
    expected: Mapping[int, float] | float,
    size: int = 24,
    samples: int = 64,
    alike: bool = True,
    budget: float = BUDGET,
    **settings: Any,
) -> Picture:
    """A render with the samples that it takes to see a deviation of `RESOLUTION` of `expected` (by channel, or of the
    second): those of a first one, if they do, else of others with other seeds, as long as `budget` allows."""
    wanted = expected if isinstance(expected, Mapping) else {1: expected}
    picture = render(prims, size, samples, **settings)
    # What one render says of the next is an estimate, and guides learn in between.
    for seed in (1, 2, 3):
        # Four fifths, since errors are estimates.
        errors = (
            picture.mean(channel)[1] / (0.8 * RESOLUTION / Z_LIMIT * value)
            for channel, value in wanted.items()
        )
        more = max(errors) ** 2
        # A render that met nothing at all has no error either.
        blind = any(value > 0.0 and picture.mean(channel)[0] == 0.0 for channel, value in wanted.items())
        affordable = budget / max(picture.stats["rays"]["total"], 1)
        if (more <= 1.0 and not blind) or (seed > 1 and affordable <= 1.0):
            return picture
        samples = min(1 << 20, math.ceil(samples * min(math.inf if blind else more, max(1.0, affordable))))
        picture = render(prims, size, samples, seed=seed, **settings)
    return picture


def run(delegate: hydra.Delegate, size: int = 24, samples: int = 64, **settings: Any) -> Picture:
    """Renders what the delegate holds, seen by /C, with all default AOVs."""
    start = time.monotonic()
    delegate.set_settings(camera="/C", resolution=[size, size], samples=samples, threads=THREADS, **settings)
    delegate.commit()
    delegate.start()
    if not delegate.wait(WAIT):
        delegate.stop()
        raise TimeoutError(f"a render takes longer than {WAIT:.0f} s")
    planes, stats = delegate.snapshot(), delegate.stats()
    bad = sum(int(np.count_nonzero(~np.isfinite(plane))) for plane in planes.values())
    color, variance = (planes[name][..., :3].astype(np.float64) for name in ("color", "variance"))
    return Picture(color, stats, variance, stats["non_finite_samples"] + bad, time.monotonic() - start)


def counts(picture: Picture) -> str:
    """What the safety nets caught."""
    named = {"walks_leaked": "leaked", "walks_too_long": "too long", "paths_trapped": "trapped"}
    caught = [f"{picture.stats[key]} {word}" for key, word in named.items() if picture.stats[key]]
    return ", ".join(caught) + (f" of {picture.stats['walks']} walks" if caught else "")


def walk_of(picture: Picture) -> str:
    """As decided, by medium."""
    media = picture.stats["guide"]["media"]
    return ", ".join(sorted({medium["walk"] for medium in media})) or "none"


def measured(
    picture: Picture,
    family: str,
    stressed: str,
    source: str,
    expected: float,
    channel: int = 1,
    alike: bool = True,
    **more: Any,
) -> Row:
    """A row of the mean of one channel."""
    mean, error = picture.mean(channel, alike)
    note = "; ".join(word for word in (more.pop("note", ""), counts(picture)) if word)
    return Row(
        family,
        stressed,
        source,
        expected,
        mean,
        error,
        non_finite=picture.non_finite,
        note=note,
        walk=walk_of(picture),
        seconds=picture.seconds,
        **more,
    )


def compared(
    picture: Picture, other: Picture, family: str, stressed: str, source: str, **more: Any
) -> Iterator[Row]:
    """Rows of the quarters of a picture against those of another one of the same thing, rendered with another seed."""
    half = picture.color.shape[0] // 2
    for name, *part in (
        ("upper left", slice(0, half), slice(0, half)),
        ("upper right", slice(0, half), slice(half, None)),
        ("lower left", slice(half, None), slice(0, half)),
        ("lower right", slice(half, None), slice(half, None)),
    ):
        yield difference(picture, other, family, f"{stressed}, {name}", source, tuple(part), **more)


def difference(
    picture: Picture,
    other: Picture,
    family: str,
    stressed: str,
    source: str,
    part: tuple[slice, slice] = (slice(None), slice(None)),
    **more: Any,
) -> Row:
    """A part of a picture, rows and columns, against that of another one."""
    a, b = (p.color[(*part, 1)] for p in (picture, other))
    _, error = mean_and_error(a - b)
    return Row(
        family,
        stressed,
        source,
        float(b.mean()),
        float(a.mean()),
        error,
        non_finite=picture.non_finite,
        note=counts(picture),
        walk=walk_of(picture),
        seconds=picture.seconds * a.size / picture.color[..., 1].size,
        **more,
    )
