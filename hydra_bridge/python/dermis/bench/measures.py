"""Error of an image against a reference: squared, relative, trimmed, perceived, freed of the reference's noise; bias.

Arrays are linear RGB, (height, width, 3), over one crop; masks (height, width) say which pixels are measured, all
without one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_] | None

#: Of the squared scale, beside R^2: dark pixels are judged by a tenth of the crop's mean, not by their own nothing.
EPSILON = 0.01

#: Worst pixels that the trimmed error leaves out: a firefly there can outweigh all others.
TRIMMED_SHARE = 1e-3

#: Chance that a table of unbiased methods flags any of its numbers.
BIAS_LEVEL = 0.01

DEFINITION = (
    "relMSE = mean of (I - R)^2 / (R^2 + 0.01 s^2) over channels and measured pixels of the crop, s the mean of R over "
    "them, so that exposure does not matter; trimmed: without the worst 0.1 % of the pixels (at least one); MSE = mean "
    "of (I - R)^2; all three less the reference's own. efficiency = 1 / (relMSE x CPU seconds)"
)

#: Student's t, two-sided 95 %, by degrees of freedom from 1; beyond, an expansion in their inverse does.
T95 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)


class MeasureError(Exception):
    """A crop that cannot be measured; the text says why."""


def weights(reference: Array, mask: Mask = None) -> Array:
    """1 / (R^2 + EPSILON s^2) per pixel and channel, s the mean of the reference. Raises MeasureError."""
    measured = picked(reference, mask)
    if not measured.size:
        raise MeasureError("the reference has no subsurface light there: no pixel is measured")
    scale = float(measured.mean())
    if not scale > 0.0:  # also for NaN
        raise MeasureError("the reference is black there: nothing can be relative to it")
    return 1.0 / (reference**2 + EPSILON * scale**2)


def picked(values: Array, mask: Mask) -> Array:
    """Of the measured pixels, in a row."""
    return values.reshape(-1, *values.shape[2:]) if mask is None else values[mask]


def error_map(image: Array, reference: Array, mask: Mask = None) -> Array:
    """Relative squared error per pixel (height, width): the mean over its channels."""
    return ((image - reference) ** 2 * weights(reference, mask)).mean(axis=-1)


def noise_map(variance: Array, reference: Array, mask: Mask = None) -> Array:
    """Relative squared error per pixel that the reference brings along; `variance` is that of its pixels."""
    return (variance * weights(reference, mask)).mean(axis=-1)


def kept(errors: Array) -> NDArray[np.bool_]:
    """Pixels that the trimmed error keeps: all but the worst `TRIMMED_SHARE`, rounded up."""
    worst = math.ceil(TRIMMED_SHARE * errors.size)
    mask = np.ones(errors.size, dtype=bool)
    mask[np.argsort(errors, axis=None, kind="stable")[errors.size - worst :]] = False
    return mask.reshape(errors.shape)


@dataclass(frozen=True)
class Errors:
    """Relative squared errors of one image in one crop, as measured against the reference."""

    plain: float
    trimmed: float
    #: Of which the reference's own noise, over the same pixels; 0 where it is not known.
    noise: float
    noise_trimmed: float
    #: Squared error in scene units, and the reference's part of it.
    squared: float
    noise_squared: float

    @property
    def relmse(self) -> float:
        # E (I - R)^2 = E (I - truth)^2 + E (R - truth)^2, as image and reference are independent.
        return self.plain - self.noise

    @property
    def relmse_trimmed(self) -> float:
        return self.trimmed - self.noise_trimmed

    @property
    def mse(self) -> float:
        return self.squared - self.noise_squared


def measure(image: Array, reference: Array, variance: Array | None, mask: Mask = None) -> Errors:
    """The errors of `image`; `variance` per pixel and channel of the reference, if known."""
    variance = np.zeros_like(reference) if variance is None else variance
    errors = picked(error_map(image, reference, mask), mask)
    noise = picked(noise_map(variance, reference, mask), mask)
    keep = kept(errors)
    if not keep.any():
        raise MeasureError("a crop of one pixel has nothing left after trimming")
    parts = (errors, errors[keep], noise, noise[keep])
    squares = (picked((image - reference) ** 2, mask), picked(variance, mask))
    return Errors(*(float(part.mean()) for part in (*parts, *squares)))


def flip(shown: NDArray[np.float32], reference: NDArray[np.float32], mask: Mask = None) -> float:
    """Mean LDR-FLIP (Andersson et al. 2020) of two pictures in [0, 1], sRGB as displayed, at 67 pixels per degree."""
    from flip_evaluator import evaluate

    errors = evaluate(reference, shown, "LDR", applyMagma=False, computeMeanError=False)[0]
    return float(picked(errors[..., 0], mask).mean(dtype=np.float64))


#: Pixels along the side of the blocks that are taken to be independent where neighbours share paths.
BLOCK = 8


def bias(image: Array, reference: Array, mask: Mask = None, block: int = 1) -> list[float]:
    """z per channel: the crop's mean of I - R over its standard error; `image` the mean of the seeds.

    Blocks of so many pixels square are independent, so their differences themselves tell the error of the sum. It
    contains the reference's noise and needs no variance; a tail that is not yet sampled makes it err towards 0.
    """
    difference = image - reference if mask is None else np.where(mask[..., None], image - reference, 0.0)
    rows, columns = (np.arange(0, n, block) for n in difference.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(difference, rows, axis=0), columns, axis=1).reshape(
        -1, image.shape[-1]
    )
    spread = np.sqrt((sums**2).sum(axis=0))
    return [float(s / e) if e > 0.0 else 0.0 for s, e in zip(sums.sum(axis=0), spread, strict=True)]


def bias_threshold(tests: int) -> float:
    """|z| that unbiased methods exceed with chance `BIAS_LEVEL` in any of `tests` numbers (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - BIAS_LEVEL / (2.0 * max(tests, 1)))


@dataclass(frozen=True)
class Number:
    """A mean over seeds with its standard error; None for a single one."""

    mean: float
    error: float | None
    #: Values behind it.
    count: int = 1

    @property
    def relative(self) -> float:
        """Standard error over mean; 0 where it is not known."""
        return abs(self.error / self.mean) if self.error and self.mean else 0.0

    @property
    def band(self) -> tuple[float, float] | None:
        """Confidence interval of 95 %, for a positive mean: symmetric in the logarithm, as a logarithmic axis wants it;
        None where it is not known. The error is carried over to first order."""
        if self.error is None or not self.mean > 0.0:
            return None
        factor = math.exp(student(self.count - 1) * self.relative)
        return self.mean / factor, self.mean * factor


def number(values: Sequence[float] | NDArray[np.floating]) -> Number:
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else None
    return Number(float(np.mean(values)), error, len(values))


def student(freedom: int) -> float:
    """Student's t, two-sided 95 %."""
    if freedom <= len(T95):
        return T95[freedom - 1]
    z = NormalDist().inv_cdf(0.975)
    return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)


def slope(samples: Sequence[Sequence[float]], errors: Sequence[Sequence[float]]) -> Number | None:
    """Of log(error) against log(samples), per seed a least-squares line over the amounts of work: -1 where the error is
    that of independent samples. None with fewer than two amounts, or where an error is not positive."""
    fits = []
    for n, e in zip(samples, errors, strict=True):
        if len(set(n)) > 1 and min(*n, *e) > 0.0:
            fits.append(np.polyfit(np.log(n), np.log(e), 1)[0])
    return number(fits) if fits else None


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
