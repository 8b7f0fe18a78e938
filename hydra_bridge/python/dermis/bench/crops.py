"""Parts of the image that are measured on their own: NDC rectangles, snapped to pixels."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class CropError(Exception):
    """A crop that is none; the text names it."""


@dataclass(frozen=True)
class Crop:
    name: str
    #: x0 y0 x1 y1 in [0, 1], (0, 0) at the lower left as `--crop`.
    ndc: tuple[float, float, float, float]


#: What is measured where no crop is named.
FRAME = Crop("frame", (0.0, 0.0, 1.0, 1.0))


class Window(NamedTuple):
    """Pixels of the image: origin at the top left, half open."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def size(self) -> tuple[int, int]:
        return self.x1 - self.x0, self.y1 - self.y0

    def slices(self, outer: "Window") -> tuple[slice, slice]:
        """Rows and columns of this window in an image of the `outer` one."""
        return (
            slice(self.y0 - outer.y0, self.y1 - outer.y0),
            slice(self.x0 - outer.x0, self.x1 - outer.x0),
        )

    def within(self, outer: "Window") -> bool:
        return outer.x0 <= self.x0 and outer.y0 <= self.y0 and self.x1 <= outer.x1 and self.y1 <= outer.y1

    def ndc(self, resolution: tuple[int, int]) -> list[float]:
        """The NDC rectangle along the window's pixel edges, y up."""
        width, height = resolution
        return [self.x0 / width, 1.0 - self.y1 / height, self.x1 / width, 1.0 - self.y0 / height]


def make_crop(name: str, ndc: object) -> Crop:
    """A checked crop. Raises CropError."""
    try:
        x0, y0, x1, y1 = (float(edge) for edge in ndc)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise CropError(f"crop {name!r}: expected four numbers X0,Y0,X1,Y1, got {ndc!r}") from None
    if not (0.0 <= x0 < x1 <= 1.0 and 0.0 <= y0 < y1 <= 1.0):
        raise CropError(f"crop {name!r}: 0 <= X0 < X1 <= 1 and 0 <= Y0 < Y1 <= 1 must hold")
    return Crop(name, (x0, y0, x1, y1))


def parse_crop(text: str) -> tuple[str, Crop]:
    """(scene, crop) of `[SCENE/]NAME=X0,Y0,X1,Y1`; the scene is empty where none is named. Raises CropError."""
    name, equals, numbers = text.partition("=")
    scene, _, name = name.rpartition("/")
    if not (equals and name):
        raise CropError(f"--crops {text}: expected [SCENE/]NAME=X0,Y0,X1,Y1")
    return scene, make_crop(name, numbers.split(","))


def window(ndc: tuple[float, float, float, float], resolution: tuple[int, int]) -> Window:
    """Pixels whose centres lie in the rectangle, at least one: the core's rule, in its precision."""

    def pixel(x: np.float32, n: int) -> int:
        return int(np.clip(np.ceil(x * np.float32(n) - np.float32(0.5)), 0, n))

    (width, height), one = resolution, np.float32(1.0)
    left, bottom, right, top = (np.float32(edge) for edge in ndc)
    x0, x1 = min(pixel(left, width), width - 1), pixel(right, width)
    y0, y1 = min(pixel(one - top, height), height - 1), pixel(one - bottom, height)
    return Window(x0, y0, max(x1, x0 + 1), max(y1, y0 + 1))
