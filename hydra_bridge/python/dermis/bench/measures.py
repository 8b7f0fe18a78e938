"""Error of an image against a reference: relative squared error, trimmed, freed of the reference's own noise; bias.

Arrays are linear RGB, (height, width, 3), over one region.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Of the squared scale, beside R^2: dark pixels are judged by a tenth of the region's mean, not by their own nothing.
EPSILON = 0.01

#: Worst pixels that the trimmed error leaves out: a firefly there can outweigh all others.
TRIMMED_SHARE = 1e-3

#: Chance that a table of unbiased methods flags any of its numbers.
BIAS_LEVEL = 0.01

DEFINITION = (
    "relMSE = mean of (I - R)^2 / (R^2 + 0.01 s^2) over channels and pixels of the region, s the mean of R over "
    "them, so that exposure does not matter; trimmed: without the worst 0.1 % of the pixels (at least one); both "
    "less the reference's own. efficiency = 1 / (relMSE x CPU seconds)"
)


class MeasureError(Exception):
    """A region that cannot be measured; the text says why."""


def weights(reference: Array) -> Array:
    """1 / (R^2 + EPSILON s^2) per pixel and channel, s the mean of the reference. Raises MeasureError."""
    scale = float(reference.mean())
    if not scale > 0.0:  # also for NaN
        raise MeasureError("the reference is black there: nothing can be relative to it")
    return 1.0 / (reference**2 + EPSILON * scale**2)


def error_map(image: Array, reference: Array) -> Array:
    """Relative squared error per pixel (height, width): the mean over its channels."""
    return ((image - reference) ** 2 * weights(reference)).mean(axis=-1)


def noise_map(variance: Array, reference: Array) -> Array:
    """Relative squared error per pixel that the reference brings along; `variance` is that of its pixels."""
    return (variance * weights(reference)).mean(axis=-1)


def kept(errors: Array) -> NDArray[np.bool_]:
    """Pixels that the trimmed error keeps: all but the worst `TRIMMED_SHARE`, rounded up."""
    worst = math.ceil(TRIMMED_SHARE * errors.size)
    mask = np.ones(errors.size, dtype=bool)
    mask[np.argsort(errors, axis=None, kind="stable")[errors.size - worst :]] = False
    return mask.reshape(errors.shape)


@dataclass(frozen=True)
class Errors:
    """Relative squared errors of one image in one region, as measured against the reference."""

    plain: float
    trimmed: float
    #: Of which the reference's own noise, over the same pixels; 0 where it is not known.
    noise: float
    noise_trimmed: float

    @property
    def corrected(self) -> float:
        # E (I - R)^2 = E (I - truth)^2 + E (R - truth)^2, as image and reference are independent.
        return self.plain - self.noise

    @property
    def corrected_trimmed(self) -> float:
        return self.trimmed - self.noise_trimmed


def measure(image: Array, reference: Array, variance: Array | None) -> Errors:
    """The errors of `image`; `variance` per pixel and channel of the reference, if known."""
    errors = error_map(image, reference)
    keep = kept(errors)
    if not keep.any():
        raise MeasureError("a region of one pixel has nothing left after trimming")
    noise = np.zeros_like(errors) if variance is None else noise_map(variance, reference)
    return Errors(
        float(errors.mean()), float(errors[keep].mean()), float(noise.mean()), float(noise[keep].mean())
    )


def bias(image: Array, reference: Array) -> list[float]:
    """z per channel: the region's mean of I - R over its standard error; `image` the mean of the repeats.

    Pixels are independent, so the differences themselves tell the error of their sum. It contains the reference's
    noise and needs no variance; a tail that is not yet sampled makes it err towards 0.
    """
    difference = (image - reference).reshape(-1, image.shape[-1])
    spread = np.sqrt((difference**2).sum(axis=0))
    return [float(s / e) if e > 0.0 else 0.0 for s, e in zip(difference.sum(axis=0), spread, strict=True)]


def bias_threshold(tests: int) -> float:
    """|z| that unbiased methods exceed with chance `BIAS_LEVEL` in any of `tests` numbers (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - BIAS_LEVEL / (2.0 * max(tests, 1)))


@dataclass(frozen=True)
class Number:
    """A mean over repeats with its standard error; None for a single one."""

    mean: float
    error: float | None

    @property
    def relative(self) -> float:
        """Standard error over mean; 0 where it is not known."""
        return abs(self.error / self.mean) if self.error and self.mean else 0.0


def number(values: Sequence[float] | NDArray[np.floating]) -> Number:
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else None
    return Number(float(np.mean(values)), error)


def efficiency_ratio(
    errors: Sequence[float],
    seconds: Sequence[float],
    base_errors: Sequence[float],
    base_seconds: Sequence[float],
) -> Number | None:
    """How many times more efficient than the baseline, from the means of values per repeat.

    None where a mean is not positive: a corrected error can be, where the reference is too noisy for it. Repeats are
    paired, for they share seeds and the hour: the standard error is that of their contributions to the logarithm, to
    first order.
    """
    pairs = min(len(errors), len(base_errors))  # an interrupted run may lack the last one of either
    parts = [np.asarray(part[:pairs], dtype=float) for part in (base_errors, base_seconds, errors, seconds)]
    means = [float(part.mean()) if pairs else 0.0 for part in parts]
    if not all(mean > 0.0 for mean in means):
        return None
    ratio = means[0] * means[1] / (means[2] * means[3])
    shares = [part / mean for part, mean in zip(parts, means, strict=True)]
    spread = number(shares[0] + shares[1] - shares[2] - shares[3]).error
    return Number(ratio, None if spread is None else ratio * spread)


def geometric_mean(ratios: Sequence[Number]) -> Number | None:
    """Of independent ratios; None without any."""
    if not ratios:
        return None
    mean = math.exp(sum(math.log(ratio.mean) for ratio in ratios) / len(ratios))
    known = any(ratio.error is not None for ratio in ratios)
    return Number(mean, mean * math.hypot(*(r.relative for r in ratios)) / len(ratios) if known else None)
