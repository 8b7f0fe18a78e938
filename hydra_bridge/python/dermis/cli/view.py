"""The view of a stage that is rendered: its camera and image size, and the light of a stage without lights."""

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..arrays import single
from .settings import Settings, SettingsError

DEFAULT_WIDTH = 960
#: Beyond it the film alone takes more memory than machines have.
LARGEST_SIDE = 65_536

#: Key, in the delegate, of the light that is added to a stage without.
CAMERA_LIGHT = "/dermis/CameraLight"


def aspect_ratio(camera: Mapping[str, Any]) -> float:
    """Width over height of a `flat::Camera`'s aperture; 1 where it has none, as in usdrecord."""
    width, height = float(camera["horizontalAperture"]), float(camera["verticalAperture"])
    ratio = width / height if height > 0.0 else 0.0
    return ratio if ratio > 1e-4 else 1.0


def image_size(
    args: argparse.Namespace, typed: Settings, authored: Mapping[str, Any], aspect: float
) -> list[int]:
    """Pixels (width, height): typed flags, else the stage's resolution, else 960 wide by the camera's aspect.

    Raises SettingsError for sizes that cannot be rendered.
    """
    width, height = args.imageWidth, args.imageHeight
    if "resolution" in typed:
        if width is not None or height is not None:
            raise SettingsError("--set resolution contradicts --imageWidth and --imageHeight")
        width, height = typed["resolution"]
    known = authored.get("resolution")
    if width is None and height is None and known:
        width, height = known
    if width is None:
        width = known[0] if known else DEFAULT_WIDTH
    width = max(int(width), 1)
    if height is None:
        # usdrecord divides as float32 and truncates; double precision would differ by a row now and then.
        height = int(single(single(width) / single(aspect)))
    height = max(int(height), 1)
    if max(width, height) > LARGEST_SIDE:
        raise SettingsError(f"An image of {width} x {height} pixels is too large; {LARGEST_SIDE} is the most")
    return [width, height]


def framing_aspect(args: argparse.Namespace, typed: Settings, authored: Mapping[str, Any]) -> float | None:
    """Aspect of the image where it does not follow from the camera; None where it does."""
    if "resolution" not in typed and args.imageHeight is None and "resolution" not in authored:
        return None
    if args.imageWidth is not None and args.imageHeight is None:
        return None
    width, height = image_size(args, typed, authored, 1.0)
    return width / height


def tile_window(args: argparse.Namespace, window: Sequence[float]) -> list[float]:
    """The part of a data window that `--tileCount` and `--tileIndex` ask for; rows from the top, as husk counts.

    Neighbours share an edge to the last bit, so that each pixel is in one of them.
    """
    if not getattr(args, "tileCount", None):
        return list(window)
    (x0, y0, x1, y1), (across, down) = window, args.tileCount
    column, row = args.tileIndex % across, args.tileIndex // across

    def edge(a: float, b: float, i: int, n: int) -> float:
        return a if i == 0 else b if i == n else a + (b - a) * i / n

    left, right = (edge(x0, x1, i, across) for i in (column, column + 1))
    bottom, top = (edge(y0, y1, down - i, down) for i in (row + 1, row))
    return [left, bottom, right, top]


def camera_light(camera: Mapping[str, Any]) -> dict[str, Any]:
    """A `flat::Light` from the camera for stages without any.

    A distant light of angle 0 has irradiance = intensity; pi makes a white diffuse card that faces the
    camera radiance albedo / pi * pi = 1.
    """
    light = {
        "type": "Light",
        "transform": camera["transform"],
        "intensity": math.pi,
        "shape": {"kind": "distant", "angle": 0.0},
    }
    return {**light, "transformKeys": camera["transformKeys"]} if "transformKeys" in camera else light


def find_named(cameras: list[str], name: str) -> str | None:
    """The camera whose path or last name is `name`."""
    if name in cameras:
        return name
    return next((path for path in cameras if path.rpartition("/")[2] == name), None)
