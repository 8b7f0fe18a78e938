"""Images of domes in layouts other than latlong, resampled to latlong.

UsdLux names the layouts and says nothing of their orientation: here the centre of each is that of a latlong image, the
dome's +Z with its +Y up, as converters between them have it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from .arrays import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

LAYOUTS = ("mirroredBall", "angular", "cubeMapVerticalCross")

Array: TypeAlias = "NDArray[np.float64]"

FINER = 2
"""Points per pixel and axis of the latlong image, averaged."""


def to_latlong(pixels: NDArray, layout: str) -> NDArray[np.float32]:
    """(h, w, 3) of one of LAYOUTS as latlong (n, 2 n, 3)."""
    height = pixels.shape[0] // 2 if layout == "cubeMapVerticalCross" else pixels.shape[0]
    height = max(2, height)
    rows, columns = height * FINER, 2 * height * FINER
    latitude = np.pi / 2.0 - (np.arange(rows) + 0.5) * np.pi / rows
    longitude = np.pi - (np.arange(columns) + 0.5) * 2.0 * np.pi / columns
    lat, lon = np.meshgrid(latitude, longitude, indexing="ij")
    forward, up, right = np.cos(lat) * np.cos(lon), np.sin(lat), -np.cos(lat) * np.sin(lon)
    if layout == "cubeMapVerticalCross":
        u, v, cell = cross(forward, up, right)
    else:
        u, v = disk(forward, up, right, layout)
        cell = (np.zeros_like(u), np.ones_like(u), np.zeros_like(u), np.ones_like(u))
    values = bilinear(pixels.astype(np.float64), u, v, cell)
    mean = values.reshape(height, FINER, 2 * height, FINER, 3).mean((1, 3))
    return np.ascontiguousarray(mean, np.float32)


def disk(forward: Array, up: Array, right: Array, layout: str) -> tuple[Array, Array]:
    """u to the right, v down, 0 to 1. Angular: the radius is the angle off the centre; mirrored ball: the sine of half
    of it, what a far camera sees of a ball."""
    angle = np.arctan2(np.hypot(up, right), forward)
    radius = angle / np.pi if layout == "angular" else np.sin(0.5 * angle)
    across = np.maximum(np.hypot(up, right), 1e-12)  # straight ahead or behind there is no direction across
    return 0.5 + 0.5 * radius * right / across, 0.5 - 0.5 * radius * up / across


def cross(forward: Array, up: Array, right: Array) -> tuple[Array, Array, tuple[Array, ...]]:
    """u, v, and the bounds of the face that they are on; from the top up, left front right, down, back upside down."""
    size = np.maximum(np.maximum(abs(forward), abs(up)), abs(right))
    f, y, x = forward / size, up / size, right / size
    on = [f >= 1.0, x >= 1.0, x <= -1.0, y >= 1.0, y <= -1.0]
    column = np.select(on, [1, 2, 0, 1, 1], 1)
    row = np.select(on, [1, 1, 1, 0, 2], 3)
    across = np.select(on, [x, -f, f, x, x], x)
    above = np.select(on, [y, y, y, -f, f], -y)
    u, v = (column + 0.5 + 0.5 * across) / 3.0, (row + 0.5 - 0.5 * above) / 4.0
    return u, v, (column / 3.0, (column + 1) / 3.0, row / 4.0, (row + 1) / 4.0)


def bilinear(pixels: Array, u: Array, v: Array, cell: tuple[Array, ...]) -> Array:
    """Of pixels within their cell alone."""
    rows, columns = pixels.shape[:2]
    left, right, top, bottom = cell
    x = np.clip(u * columns - 0.5, left * columns, right * columns - 1.0)
    y = np.clip(v * rows - 0.5, top * rows, bottom * rows - 1.0)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, columns - 1), np.minimum(y0 + 1, rows - 1)
    s, t = (x - x0)[..., None], (y - y0)[..., None]
    upper = pixels[y0, x0] * (1 - s) + pixels[y0, x1] * s
    return upper * (1 - t) + (pixels[y1, x0] * (1 - s) + pixels[y1, x1] * s) * t
