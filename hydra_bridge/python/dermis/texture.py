"""Image files of lights, decoded by OpenImageIO to linear Rec.709 float32."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Ar, Usd

from .arrays import np
from .colorspace import REC709 as REC709_NAME
from .colorspace import transformed
from .reading import Reader

if TYPE_CHECKING:
    from numpy.typing import NDArray

RAW_SPACES = ("raw", "linear", "lin_rec709", "lin_rec709_scene", "Linear", "data")
SRGB_SPACES = ("sRGB", "srgb", "srgb_rec709_scene", "srgb_texture")

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


class TextureError(Exception):
    """An image that cannot be read; the text says why."""


def flatten_texture(prim: Usd.Prim, name: str, reader: Reader, textures: dict[str, dict[str, Any]]) -> str:
    """Key of the decoded image of an asset attribute, added to `textures`; empty where there is none.

    A missing or unreadable file gives one warning; the light then emits its plain colour.
    """
    asset = reader.asset(prim, name)
    if asset is None:
        return ""
    space = prim.GetAttribute(name).GetColorSpace() or "auto"
    if space not in ("auto", *RAW_SPACES, *SRGB_SPACES):
        reader.warn(prim, f"{name}: color space '{space}' is not supported; 'auto' is used")
        space = "auto"
    try:
        path = asset.resolvedPath
        if not path:
            raise TextureError("the file was not found")
        width, height, pixels, notes = decode(path, space, stamp(path))
    except TextureError as error:
        reader.warn(prim, f"{name}: {asset.path}: {error}; the light emits its plain colour")
        return ""
    for note in notes:
        reader.warn(prim, f"{name}: {asset.path}: {note}")
    rendering = reader.colors.rendering
    key = f"@{path}@" if space == "auto" else f"@{path}@{space}"
    if rendering != REC709_NAME:
        # Of a smaller gamut some are negative, which no light is.
        key = f"{key}{rendering}"
        pixels = np.maximum(transformed(pixels, REC709_NAME, rendering), 0.0)
    textures[key] = {"type": "Texture", "file": path, "width": width, "height": height, "pixels": pixels}
    return key


def stamp(path: str) -> tuple[int, int]:
    """What tells a rewritten file from the one decoded before."""
    package = Ar.SplitPackageRelativePathOuter(path)[0] if Ar.IsPackageRelativePath(path) else path
    try:
        status = os.stat(package)
    except OSError as error:
        raise TextureError(error.strerror or str(error)) from error
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=8)
def decode(path: str, space: str, _stamp: tuple[int, int]) -> tuple[int, int, NDArray, tuple[str, ...]]:
    """(width, height, pixels (h * w, 3) linear Rec.709 with row 0 at the top, notes for the user).

    The last few are kept, so that the frames of a sequence share their environment.
    """
    if not Ar.IsPackageRelativePath(path):
        return decode_file(path, space)
    import tempfile

    with tempfile.NamedTemporaryFile(suffix=Path(Ar.SplitPackageRelativePathInner(path)[1]).suffix) as file:
        asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
        if not asset:
            raise TextureError("the file was not found in its package")
        file.write(bytes(asset.GetBuffer()))
        file.flush()
        return decode_file(file.name, space)


def decode_file(path: str, space: str) -> tuple[int, int, NDArray, tuple[str, ...]]:
    try:
        import OpenImageIO as oiio
    except ImportError as error:
        raise TextureError(f"images need OpenImageIO ({error})") from error
    image = oiio.ImageInput.open(path)
    if image is None:
        raise TextureError(f"it cannot be read ({oiio.geterror().strip()})")
    spec = image.spec()
    values = image.read_image(oiio.FLOAT)
    if values is None:
        raise TextureError(f"it cannot be read ({image.geterror().strip()})")
    image.close()
    eight = spec.format.basetype == oiio.UINT8 and not says_linear(spec)
    if eight if space == "auto" else space in SRGB_SPACES:
        values = srgb_to_linear(values)
    pixels, notes = usable(to_rec709(rgb(values), spec.getattribute("chromaticities")))
    return spec.width, spec.height, pixels.reshape(-1, 3), notes


def says_linear(spec: Any) -> bool:
    """Whether a file says of itself that its colours are linear, as PNG does by a gAMA of 1."""
    return str(spec.getattribute("oiio:ColorSpace") or "").lower().startswith("lin")


def rgb(values: NDArray) -> NDArray:
    """(h, w, n) -> (h, w, 3); grey is repeated, alpha dropped."""
    values = values[..., None] if values.ndim == 2 else values
    return np.repeat(values[..., :1], 3, axis=2) if values.shape[2] < 3 else values[..., :3]


def srgb_to_linear(values: NDArray) -> NDArray:
    """IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_rec709(pixels: NDArray, chromaticities: Any) -> NDArray:
    """From the primaries that an EXR header names (xy of red, green, blue, white)."""
    if chromaticities is None or np.allclose(chromaticities, REC709, atol=1e-3):
        return pixels
    matrix = np.linalg.inv(rgb_to_xyz(REC709)) @ rgb_to_xyz(chromaticities)
    return (pixels @ matrix.T).astype(np.float32)


def rgb_to_xyz(chromaticities: Any) -> NDArray:
    """SMPTE RP 177: columns are the primaries, scaled so that (1, 1, 1) is the white."""
    xyz = np.array([[x, y, 1.0 - x - y] for x, y in np.reshape(chromaticities, (4, 2))])
    primaries, white = xyz[:3].T, xyz[3] / xyz[3, 1]
    return primaries * np.linalg.solve(primaries, white)


def usable(pixels: NDArray) -> tuple[NDArray, tuple[str, ...]]:
    """Radiance must be finite and not negative."""
    bad = ~np.isfinite(pixels) | (pixels < 0.0)
    if not bad.any():
        return np.ascontiguousarray(pixels, np.float32), ()
    # Infinity is what half floats make of a bright sun: their largest number stands in.
    pixels = np.maximum(np.nan_to_num(pixels, nan=0.0, posinf=65504.0, neginf=0.0), 0.0)
    return np.ascontiguousarray(pixels, np.float32), (
        f"{int(bad.sum())} negative or not finite values were replaced",
    )
