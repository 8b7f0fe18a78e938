"""Writes the images of dome_layouts.usda: python usd_scenes/dome_scene.py

One sky in four layouts. They are small, and half floats: a sun is among them.
"""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent / "textures"
SUN = np.array([0.5, 0.62, 0.6])
"""Towards it, in the dome's space."""


def sky(direction):
    """Radiance from unit directions (..., 3) of the dome: blue, warm around the sun, red towards +X; ground below."""
    x, y, z = np.moveaxis(direction, -1, 0)
    up = np.clip(y, 0, 1)[..., None]
    color = np.array([0.75, 0.7, 0.62]) * (1 - up) + np.array([0.12, 0.28, 0.75]) * up
    color = color + np.clip(x, 0, 1)[..., None] ** 4 * np.array([0.6, 0.05, 0.0])
    near = np.clip(direction @ (SUN / np.linalg.norm(SUN)), 0, 1)[..., None]
    color = color + near**64 * np.array([12.0, 9.0, 5.0])
    ground = np.array([0.16, 0.12, 0.09]) * (1 + 0.5 * np.clip(z, -1, 1)[..., None])
    return color + (ground - color) * np.clip(0.5 - 8 * y, 0, 1)[..., None]


def latlong(size):
    """The middle is +Z; to the left is +X."""
    lat = np.pi / 2 - (np.arange(size) + 0.5) * np.pi / size
    lon = np.pi - (np.arange(2 * size) + 0.5) * np.pi / size
    lat, lon = np.meshgrid(lat, lon, indexing="ij")
    return sky(np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1))


def disc(size, mirrored):
    """Angular: the radius is the angle from +Z; mirrored ball: the sine of its half."""
    c = (np.arange(size) + 0.5) / size * 2 - 1
    right, down = np.meshgrid(c, c)
    radius = np.hypot(right, down)
    angle = 2 * np.arcsin(np.minimum(radius, 1)) if mirrored else np.pi * np.minimum(radius, 1)
    across = np.sin(angle) / np.maximum(radius, 1e-9)
    return sky(np.stack([-right * across, -down * across, np.cos(angle)], -1))


# Cell (column, row): what is ahead, to the right and up on the face.
FACES = {
    (1, 0): ((0, 1, 0), (-1, 0, 0), (0, 0, -1)),
    (0, 1): ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    (1, 1): ((0, 0, 1), (-1, 0, 0), (0, 1, 0)),
    (2, 1): ((-1, 0, 0), (0, 0, -1), (0, 1, 0)),
    (1, 2): ((0, -1, 0), (-1, 0, 0), (0, 0, 1)),
    (1, 3): ((0, 0, -1), (-1, 0, 0), (0, -1, 0)),
}


def cross(size):
    image = np.zeros((4 * size, 3 * size, 3))
    c = (np.arange(size) + 0.5) / size * 2 - 1
    s, t = np.meshgrid(c, -c)
    for (column, row), axes in FACES.items():
        ahead, right, up = np.array(axes, float)
        way = ahead + s[..., None] * right + t[..., None] * up
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        image[row * size : (row + 1) * size, column * size : (column + 1) * size] = sky(way)
    return image


def write(name, pixels):
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.HALF)
    spec.attribute("compression", "zip")
    image = oiio.ImageBuf(spec)
    pixels = np.ascontiguousarray(pixels, np.float32)
    if not (image.set_pixels(oiio.ROI(), pixels) and image.write(str(FOLDER / f"sky_{name}.exr"))):
        raise SystemExit(image.geterror())


if __name__ == "__main__":
    write("latlong", latlong(64))
    write("mirroredBall", disc(96, True))
    write("angular", disc(96, False))
    write("cubeMapVerticalCross", cross(32))
