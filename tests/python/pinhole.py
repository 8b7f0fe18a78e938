"""Camera rays in numpy, for pictures that are computed a second time: what a pixel's filter means, ray by ray."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rays:
    """`o` (3,), unit `d` (k, height, width, 3), and the weights (k,) of the k rays of each pixel."""

    o: Array
    d: Array
    weight: Array

    def mean(self, values: Array) -> Array:
        """Pixels (height, width, ...) of values (k, height, width, ...)."""
        return np.tensordot(self.weight, values, 1)

    def plane(self, axis: int, at: float = 0.0) -> Array:
        """Where they meet the plane in which the coordinate `axis` is `at`; behind the camera as well."""
        t = (at - self.o[axis]) / self.d[..., axis]
        return self.o + t[..., None] * self.d

    def sphere(self, middle: Array, radius: float) -> Array:
        """The first points on a sphere; NaN where there is none."""
        to = self.o - middle
        b = self.d @ to
        with np.errstate(invalid="ignore"):
            t = -b - np.sqrt(b * b - to @ to + radius**2)
        return self.o + t[..., None] * self.d


def rays(
    resolution: tuple[int, int],
    focal: float,
    aperture: float,
    at: tuple[float, float, float],
    tilt: float = 0.0,
    per_axis: int = 4,
) -> Rays:
    """A camera that looks along -Z, turned by `tilt` degrees about X; the film's filter is a tent of one pixel's
    radius."""
    width, height = resolution
    offset = (np.arange(per_axis) + 0.5) / per_axis * 2 - 1
    dx, dy = (o.ravel()[:, None, None] for o in np.meshgrid(offset, offset))
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixel = aperture / width / focal
    x, y = (column + dx - width / 2) * pixel, (height / 2 - row - dy) * pixel
    cos, sin = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    d = np.stack([x, y * cos + sin, y * sin - cos], -1)
    weight = ((1 - np.abs(dx)) * (1 - np.abs(dy))).ravel()
    return Rays(np.array(at, float), d / np.linalg.norm(d, axis=-1, keepdims=True), weight / weight.sum())
