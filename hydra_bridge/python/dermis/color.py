"""Display images: scene-linear Rec.709 to the colours of a screen, by OpenColorIO, as PNG or JPEG.

The EXR is the truth and is never transformed; what this module makes is for eyes.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

from .arrays import np
from .colorspace import REC709, transformed

# Libraries of display images are loaded where one is made: most renders write an EXR alone.
if TYPE_CHECKING:
    import PyOpenColorIO as ocio
    from numpy.typing import NDArray

#: The configuration without `$OCIO`: by its full name, for `ocio://default` changes with the library.
BUILTIN_CONFIG = "cg-config-v4.0.0_aces-v2.0_ocio-v2.5"

#: Names and aliases under which configurations carry linear Rec.709: ACES 2.x, ACES 1.x and Blender's.
LINEAR_REC709 = (
    "Linear Rec.709 (sRGB)",
    "lin_rec709_scene",
    "lin_rec709_srgb",
    "lin_rec709",
    "lin_srgb",
    "Utility - Linear - Rec.709",
    "Utility - Linear - sRGB",
    "Linear Rec.709",
    "Linear BT.709",
)

#: File name endings of display images.
EXTENSIONS = (".png", ".jpg", ".jpeg")


class ColorError(Exception):
    """A colour configuration, display, view or look that cannot be used; the text lists what exists."""


class DisplayTransform:
    """Scene-linear Rec.709 to display values in [0, 1].

    `mode` is `openColorIO`, `sRGB` (the IEC 61966-2-1 curve alone, no tone mapping) or `disabled`
    (linear values as they are). `config` (file name, `ocio://` name or built-in name), `display`,
    `view` and `look` are for `openColorIO`; empty ones take `$OCIO` or `BUILTIN_CONFIG`, and the
    configuration's own default display and view.

    Raises ColorError.
    """

    def __init__(
        self, mode: str = "openColorIO", config: str = "", display: str = "", view: str = "", look: str = ""
    ) -> None:
        self.mode = mode
        self.space = REC709
        self.config_name = self.display = self.view = ""
        if mode == "openColorIO":
            self._processor = self._build(config, display, view, look)

    def _build(self, name: str, display: str, view: str, look: str) -> ocio.CPUProcessor:
        import PyOpenColorIO as ocio

        config, self.config_name = open_config(name)
        source = linear_rec709(config)
        self.display = _known("display", display, config.getDisplays(), config.getDefaultDisplay())
        views = config.getViews(self.display)
        self.view = _known("view", view, views, config.getDefaultView(self.display, source))
        transform = ocio.DisplayViewTransform(src=source, display=self.display, view=self.view)
        pipeline = ocio.LegacyViewingPipeline()
        pipeline.setDisplayViewTransform(transform)
        if look:
            pipeline.setLooksOverrideEnabled(True)
            pipeline.setLooksOverride(_known("look", look, config.getLookNames(), ""))
        try:
            return pipeline.getProcessor(config).getDefaultCPUProcessor()
        except ocio.Exception as error:
            raise ColorError(
                f"OpenColorIO cannot show {self.display!r}, view {self.view!r}: {error}"
            ) from error

    def showing(self, space: str) -> DisplayTransform:
        """The same for colours in another linear space of usd-core."""
        other = copy(self)
        other.space = space
        return other

    def apply(self, rgb: NDArray[np.floating]) -> NDArray[np.float32]:
        """Display values of `rgb` (any shape ending in 3); a copy, in [0, 1]. What is not finite becomes black."""
        pixels = np.array(transformed(np.asarray(rgb, np.float32), self.space, REC709), np.float32, order="C")
        pixels[~np.isfinite(pixels).all(axis=-1)] = 0.0
        if self.mode == "openColorIO":
            self._processor.applyRGB(pixels)
        elif self.mode == "sRGB":
            pixels = srgb_encode(pixels)
        return np.clip(pixels, 0.0, 1.0)


def open_config(name: str = "") -> tuple[ocio.Config, str]:
    """The configuration called `name`, else `$OCIO`, else the pinned built-in one; with the name used."""
    import PyOpenColorIO as ocio

    name = name or os.environ.get("OCIO", "") or BUILTIN_CONFIG
    builtins = [entry[0] for entry in ocio.BuiltinConfigRegistry().getBuiltinConfigs()]
    try:
        config = ocio.Config.CreateFromFile(f"ocio://{name}" if name in builtins else name)
        config.validate()
    except (ocio.Exception, ocio.ExceptionMissingFile) as error:
        raise ColorError(
            f"Could not open OpenColorIO config {name!r}: {error} Built-in configs: {', '.join(builtins)}"
        ) from error
    return config, name


def linear_rec709(config: ocio.Config) -> str:
    """Name of the configuration's colour space for linear Rec.709, the renderer's own."""
    for name in LINEAR_REC709:
        if space := config.getColorSpace(name):
            return space.getName()
    spaces = ", ".join(config.getColorSpaceNames())
    raise ColorError(f"The OpenColorIO config has no linear Rec.709 colour space. Colour spaces: {spaces}")


def srgb_encode(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """The sRGB transfer curve, IEC 61966-2-1; negative values become 0."""
    linear = np.maximum(linear, 0.0)
    curve = 1.055 * np.power(linear, 1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve).astype(np.float32)


def quantize(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """[0, 1] to 8 bits, rounded to nearest."""
    return np.rint(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255.0).astype(np.uint8)


def display_pixels(
    color: NDArray[np.floating], transform: DisplayTransform, alpha: bool
) -> NDArray[np.uint8]:
    """8-bit display pixels of premultiplied linear RGBA or RGB (height, width, 4 or 3).

    With `alpha`, RGBA as PNG wants it: the transform works on unpremultiplied colour and alpha is kept
    beside it. A pixel that glows but covers nothing (alpha 0) keeps its colour under alpha 0. Without,
    RGB over black, which is what premultiplied values already are.
    """
    color = np.asarray(color, dtype=np.float32)
    if not alpha or color.shape[-1] < 4:
        return quantize(transform.apply(color[..., :3]))
    coverage = np.clip(np.nan_to_num(color[..., 3:4]), 0.0, 1.0)
    straight = color[..., :3] / np.where(coverage > 0.0, coverage, 1.0)
    return quantize(np.concatenate([transform.apply(straight), coverage], axis=-1))


def write_display_image(
    file: Path, color: NDArray[np.floating], transform: DisplayTransform, comment: str = ""
) -> None:
    """Writes a PNG (RGBA) or a JPEG (RGB over black); `color` is premultiplied linear RGBA or RGB."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    if Path(file).suffix.lower() == ".png":
        notes = PngInfo()
        if comment:
            notes.add_text("comment", comment)
        Image.fromarray(display_pixels(color, transform, alpha=True)).save(file, format="PNG", pnginfo=notes)
    else:
        pixels = display_pixels(color, transform, alpha=False)
        # No chroma subsampling: small saturated highlights are what these images are looked at for.
        Image.fromarray(pixels).save(file, format="JPEG", quality=95, subsampling=0, comment=comment)


def image_comment(file: Path) -> str:
    """The comment of a PNG or JPEG. Raises OSError for a file that is none, or is damaged."""
    from PIL import Image

    with Image.open(file) as image:
        image.load()
        comment = image.info.get("comment", "")
    return comment.decode("utf-8", "replace") if isinstance(comment, bytes) else comment


def _known(kind: str, name: str, known: Iterable[str], default: str) -> str:
    known = list(known)
    if not name:
        return default
    if name in known:
        return name
    raise ColorError(f"Unknown OpenColorIO {kind} {name!r}. The config has: {', '.join(known) or 'none'}")
