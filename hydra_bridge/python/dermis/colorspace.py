"""The linear space that a stage is rendered in, and how authored colours get there: by usd-core's own colour spaces.

Whites are adapted (all of usd-core's spaces have D65 white): white light stays white.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pxr import Gf, Sdf, Usd

from .arrays import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

REC709 = "lin_rec709_scene"
"""What colours are in that say nothing, and what is rendered in without `renderingColorSpace`."""

#: Names of other programs for spaces of usd-core.
ALIASES = {
    "sRGB": "srgb_rec709_scene",
    "srgb": "srgb_rec709_scene",
    "srgb_texture": "srgb_rec709_scene",
    "lin_srgb": REC709,
    "acescg": "lin_ap1_scene",
    "ACEScg": "lin_ap1_scene",
}

#: Names for values that are no colours: other programs', and usd-core's (Gf.ColorSpace.IsData, which USD before 26.11
#: does not have).
DATA = ("raw", "Raw", "data", "none", "identity", "unknown")


def known(name: str) -> Gf.ColorSpace | None:
    """A space by usd-core's name or alias, with or without `_scene`; None for data and for what it does not know."""
    for spelled in (ALIASES.get(name, name), f"{name}_scene"):
        if Gf.ColorSpace.IsValid(spelled):
            return None if spelled in DATA else Gf.ColorSpace(spelled)
    return None


def is_data(name: str) -> bool:
    """Whether values in a space of that name are no colours."""
    return name in DATA


def linear_name(name: str) -> str | None:
    """usd-core's name of a space to render in; None where it is no linear one that it knows."""
    space = known(name)
    if space is None or space.GetGamma() != 1.0:
        return None
    names = [getattr(Gf.ColorSpaceNames, key) for key in dir(Gf.ColorSpaceNames) if not key.startswith("_")]
    alike = (n for n in names if Gf.ColorSpace.IsValid(n) and Gf.ColorSpace(n) == space)
    return next(alike, str(space.GetName()))


@lru_cache(maxsize=16)
def matrix(source: str, target: str) -> NDArray[np.float64] | None:
    """Linear RGB of `source` to that of `target`; None for the identity."""
    if source == target:
        return None
    to_xyz = [np.array(Gf.ColorSpace(name).GetRGBToXYZ(), np.float64) for name in (source, target)]
    product = np.linalg.inv(to_xyz[1]) @ to_xyz[0]
    return None if np.allclose(product, np.eye(3), atol=1e-6) else product


def transformed(rgb: NDArray, source: str, target: str) -> NDArray:
    """(..., 3) or (..., 4), whose fourth stays; linear `source` to `target`; the same array where these are one."""
    product = matrix(source, target)
    if product is None:
        return rgb
    colors = np.array(rgb, dtype=rgb.dtype if rgb.dtype.kind == "f" else np.float32)
    colors[..., :3] = rgb[..., :3] @ product.T
    return colors


def linear(rgb: NDArray, space: Gf.ColorSpace) -> NDArray:
    """Without the transfer curve of a space; by usd-core's parameters of it."""
    gamma, bias = space.GetGamma(), space.GetLinearBias()
    if gamma == 1.0:
        return rgb
    break_point, slope = space.GetTransferFunctionParams()
    colors = np.array(rgb, np.float64)
    straight = colors[..., :3]
    with np.errstate(invalid="ignore"):
        curved = ((straight + bias) / (1.0 + bias)) ** gamma
    colors[..., :3] = np.where(straight <= break_point, straight / (slope or 1.0), curved)
    return colors


def chromaticities(name: str) -> list[float]:
    """xy of red, green, blue, white."""
    primaries = (Gf.ColorSpace(linear_name(name) or REC709)).GetPrimariesAndWhitePoint()
    return [float(x) for point in primaries for x in point]


class Colors:
    """Brings authored colours to the space `rendering`."""

    def __init__(
        self, rendering: str = REC709, warn: Callable[[Usd.Prim, str], None] = lambda prim, message: None
    ) -> None:
        self.rendering = rendering
        self._warn = warn
        self._spaces = Usd.ColorSpaceHashCache()

    def from_rec709(self, rgb: Any) -> tuple[float, ...]:
        if self.rendering == REC709:
            return tuple(float(x) for x in rgb)
        color = np.asarray(rgb, np.float64)
        return tuple(float(x) for x in transformed(color, REC709, self.rendering))

    def source(self, attribute: Usd.Attribute) -> Gf.ColorSpace | None:
        """The space that an attribute's value is in, authored on it, its prim or above; None: it is no colour."""
        if attribute.GetTypeName().role != Sdf.ValueRoleNames.Color:
            return None
        name = str(Usd.ColorSpaceAPI.ComputeColorSpaceName(attribute, self._spaces))
        if name in ("", "auto"):
            return Gf.ColorSpace(REC709)
        space = known(name)
        if space is None and not is_data(name):
            self._warn(
                attribute.GetPrim(),
                f"{attribute.GetName()}: colorSpace '{name}' is not known to usd-core; linear Rec.709 is used",
            )
            return Gf.ColorSpace(REC709)
        return space

    def changes(self, attribute: Usd.Attribute) -> Gf.ColorSpace | None:
        """The space of a colour where that is not what is rendered in."""
        space = self.source(attribute)
        if space is None or space.GetGamma() != 1.0:
            return space
        return None if matrix(str(space.GetName()), self.rendering) is None else space

    def of(self, attribute: Usd.Attribute, values: NDArray) -> NDArray:
        """Values (..., 3 or 4) of an attribute in the rendering space; the same array where nothing changes."""
        space = self.changes(attribute)
        if space is None or values.ndim == 0 or values.shape[-1] not in (3, 4):
            return values
        values = np.asarray(values)
        changed = transformed(linear(values, space), str(space.GetName()), self.rendering)
        return changed.astype(values.dtype)
