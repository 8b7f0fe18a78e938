"""Images of materials: found and described when a stage is flattened, decoded when the core takes them.

They keep the numbers of their files; only spaces other than sRGB and raw are converted here, by OpenColorIO.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Ar, Usd, UsdShade

from .arrays import np
from .color import ColorError, linear_rec709, open_config
from .colorspace import REC709, transformed
from .reading import Reader
from .texture import RAW_SPACES, SRGB_SPACES, TextureError, says_linear, srgb_to_linear, stamp, to_rec709

if TYPE_CHECKING:
    from numpy.typing import NDArray

Fields = dict[str, Any]

RAW = (*RAW_SPACES, "Raw", "identity", "none", "lin_rec709_srgb", "scene_linear", "Utility - Raw")
SRGB = (*SRGB_SPACES, "sRGB - Texture", "Utility - sRGB - Texture", "srgb_tx", "sRGB Encoded Rec.709 (sRGB)")
"""What applications call the two spaces that need no configuration."""

WRAPS = {"black": "black", "clamp": "clamp", "periodic": "repeat", "mirror": "mirror"}
"""OpenImageIO's words for `wrapmodes`, and USD's."""


def find_images(
    attribute: Usd.Attribute, space: str, reader: Reader, images: dict[str, Fields]
) -> list[Fields]:
    """`tiles` of `flat::ImageNode` for an asset attribute, their images added to `images`; empty, with one warning,
    where nothing can be read."""
    asset = attribute.Get(reader.time)
    node, name = attribute.GetPrim(), attribute.GetName()
    if not getattr(asset, "path", ""):
        reader.warn(node, f"{name}: no file; the fallback is used")
        return []
    try:
        tiles = []
        for udim, path in located(attribute, asset):
            tiles.append({"udim": udim, "image": add_image(path, space, node, name, reader, images)})
    except TextureError as error:
        reader.warn(node, f"{name}: {asset.path}: {error}; the fallback is used")
        return []
    return tiles


def located(attribute: Usd.Attribute, asset: Any) -> list[tuple[int, str]]:
    """(UDIM or 0, path) of the files that an asset path names."""
    if not UsdShade.UdimUtils.IsUdimIdentifier(asset.path):
        if not asset.resolvedPath:
            raise TextureError("the file was not found")
        return [(0, asset.resolvedPath)]
    layer = attribute.GetPropertyStack(Usd.TimeCode.Default())[0].layer
    tiles = UsdShade.UdimUtils.ResolveUdimTilePaths(asset.path, layer)
    if not tiles:
        raise TextureError("no tile from 1001 to 1100 was found")
    return sorted((int(number), str(path)) for path, number in tiles)


def add_image(
    path: str, space: str, node: Usd.Prim, name: str, reader: Reader, images: dict[str, Fields]
) -> str:
    """Key of the image of a file in a colour space; its header is read, so that what cannot be opened is said."""
    modified = stamp(path)
    header = read_header(path, modified)
    if space == "auto":
        # The specification of UsdPreviewSurface: sRGB iff 8-bit with 3 or 4 channels, unless the file says otherwise.
        # That it is linear is believed. That it is sRGB is not, as in usdrecord: OpenImageIO writes so into every
        # PNG, data of 16 bits included.
        space = "sRGB" if header.bits == "u8" and header.channels > 2 and not header.is_linear else "raw"
    space = "sRGB" if space in SRGB else "raw" if space in RAW else space
    if space not in ("sRGB", "raw"):
        try:
            conversion(space)
        except ColorError as error:
            reader.warn(node, f"{name}: color space '{space}': {error}; 'raw' is used")
            space = "raw"
    key, rendering = f"@{path}@{space}", reader.colors.rendering
    fields = {"type": "Image", "file": path, "space": space, "stamp": list(modified)}
    if rendering != REC709:
        key, fields["rendering"] = f"{key}@{rendering}", rendering
    images[key] = fields
    return key


class Header:
    """What is asked of a file before its texels."""

    def __init__(self, spec: Any, bits: str) -> None:
        self.bits = bits
        self.channels = min(spec.nchannels, 4)
        self.is_linear = says_linear(spec)
        self.wraps = [WRAPS.get(wrap) for wrap in str(spec.getattribute("wrapmodes") or "").split(",")]


@lru_cache(maxsize=256)
def read_header(path: str, _stamp: tuple[int, int]) -> Header:
    """Raises TextureError."""
    with opened(path) as image:
        return Header(image.spec(), bits_of(image.spec()))


def wrap_modes(path: str) -> tuple[str | None, str | None]:
    """What the file's own metadata says of (s, t)."""
    wraps = read_header(path, stamp(path)).wraps
    return wraps[0], wraps[-1]


@contextmanager
def opened(path: str) -> Iterator[Any]:
    """The file as an OpenImageIO input, unpacked if it is inside a package."""
    try:
        import OpenImageIO as oiio
    except ImportError as error:
        raise TextureError(f"images need OpenImageIO ({error})") from error
    with unpacked(path) as file:
        # Colours are what the file says: a normal map with alpha must not be multiplied by it.
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)
        image = oiio.ImageInput.open(file, config)
        if image is None:
            raise TextureError(f"it cannot be read ({oiio.geterror().strip()})")
        try:
            yield image
        finally:
            image.close()


@contextmanager
def unpacked(path: str) -> Iterator[str]:
    if not Ar.IsPackageRelativePath(path):
        yield path
        return
    import tempfile

    with tempfile.NamedTemporaryFile(suffix=Path(Ar.SplitPackageRelativePathInner(path)[1]).suffix) as file:
        asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
        if not asset:
            raise TextureError("the file was not found in its package")
        file.write(bytes(asset.GetBuffer()))
        file.flush()
        yield file.name


def bits_of(spec: Any) -> str:
    """Name of `flat::Texels` that holds the file's numbers."""
    import OpenImageIO as oiio

    kinds = {oiio.UINT8: "u8", oiio.UINT16: "u16", oiio.HALF: "half"}
    return kinds.get(oiio.BASETYPE(spec.format.basetype), "float")


def load_image(fields: Fields) -> Fields:
    """The prim that the core takes, decoded; `fault` says why there are no texels."""
    path, space = fields["file"], fields["space"]
    rendering = fields.get("rendering", REC709)
    encoded = space == "sRGB" and rendering == REC709
    plain = {"type": "Image", "file": os.path.basename(path) or path, "srgb": encoded}
    try:
        values, bits, colorful = read_texels(path)
        if rendering != REC709 and (space != "raw" or colorful):
            values, bits = rendered(values, space, rendering), "float" if bits == "float" else "half"
        elif space not in ("sRGB", "raw"):
            values, bits = converted(values, space), "float" if bits == "float" else "half"
    except (TextureError, ColorError) as error:
        return {**plain, "fault": str(error)}
    height, width, channels = values.shape
    flat = np.ascontiguousarray(values).reshape(-1)
    if bits == "half":
        flat = flat.astype(np.float16).view(np.uint16)
    texels = {"format": bits, "values": flat}
    return {**plain, "width": width, "height": height, "channels": channels, "texels": texels}


def rendered(values: NDArray, space: str, rendering: str) -> NDArray:
    """Colours in a space (`raw`: linear Rec.709) as they are rendered; grey stays grey, and alpha alpha."""
    scale = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}.get(values.dtype, 1.0)
    values = values.astype(np.float32) / np.float32(scale)
    if space == "sRGB":
        colors = 1 if values.shape[2] < 3 else 3
        values[..., :colors] = srgb_to_linear(values[..., :colors])
    elif space != "raw":
        values = converted(values, space)
    return transformed(values, REC709, rendering) if values.shape[2] > 2 else values


def read_texels(path: str) -> tuple[NDArray, str, bool]:
    """(rows from the top, columns, channels 1 to 4) in the format of the file, its name, and whether it names its
    primaries, which are Rec.709's here."""
    import OpenImageIO as oiio

    formats = {"u8": oiio.UINT8, "u16": oiio.UINT16, "half": oiio.HALF, "float": oiio.FLOAT}
    with opened(path) as image:
        spec = image.spec()
        bits = bits_of(spec)
        values = image.read_image(0, 0, 0, min(spec.nchannels, 4), formats[bits])
        if values is None:
            raise TextureError(f"it cannot be read ({image.geterror().strip()})")
        chromaticities = spec.getattribute("chromaticities")
    values = np.asarray(values).reshape(spec.height, spec.width, -1)
    colorful = bits in ("half", "float") and chromaticities is not None and values.shape[2] > 2
    if colorful:
        values = values.astype(np.float32)
        values[..., :3] = to_rec709(values[..., :3], chromaticities)
    return values, bits, colorful


@lru_cache(maxsize=16)
def conversion(space: str) -> Any:
    """OpenColorIO's processor from a colour space to linear Rec.709. Raises ColorError."""
    config, name = open_config()
    if not config.getColorSpace(space):
        raise ColorError(f"the OpenColorIO config {name} does not know it")
    return config.getProcessor(space, linear_rec709(config)).getDefaultCPUProcessor()


def converted(values: NDArray, space: str) -> NDArray:
    scale = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}.get(values.dtype, 1.0)
    values = np.ascontiguousarray(values.astype(np.float32) / scale)
    grey = values.shape[2] < 3
    rgb = np.ascontiguousarray(np.repeat(values[..., :1], 3, axis=2) if grey else values[..., :3])
    conversion(space).applyRGB(rgb)
    # Grey with alpha becomes colour with alpha: a space may have a white of its own.
    return np.concatenate([rgb, values[..., 1:] if grey else values[..., 3:]], axis=2)
