"""Images of a render as files: which are complete, what a snapshot is called, how each kind is written."""

import json
from pathlib import Path
from typing import Any

from dermis import color
from dermis.colorspace import REC709, chromaticities, linear_name

from . import output

#: Comment of a PNG or JPEG that an interrupt ended; EXRs have the attribute `dermis.complete`.
INCOMPLETE = "dermis: incomplete"

#: Of an image, read at once.
LINES = 64


class Writer:
    """Writes what a delegate has rendered; `transform` makes pictures for eyes."""

    def __init__(self, transform: color.DisplayTransform) -> None:
        self.transform = transform

    def write(self, delegate: Any, made: Any, file: str, attributes: dict[str, str]) -> None:
        """The layers of an output as `file`, by its ending."""
        if Path(file).suffix.lower() == ".exr":
            layers = None if made.layers is None else json.dumps(made.layers)
            delegate.write_exr(
                file, json.dumps({**attributes, **color_attributes(space_of(delegate))}), layers
            )
        else:
            self.write_display(delegate, file, attributes.get("dermis.complete") != "false")

    def write_display(self, delegate: Any, file: str, complete: bool) -> None:
        pixels = delegate.snapshot()["color"]
        with output.replacing(file) as temporary:
            transform = self.transform.showing(space_of(delegate))
            color.write_display_image(temporary, pixels, transform, "" if complete else INCOMPLETE)


def space_of(delegate: Any) -> str:
    """The linear space that colours were rendered in."""
    return linear_name(json.loads(delegate.settings())["renderingColorSpace"]) or REC709


def color_attributes(space: str) -> dict[str, Any]:
    """What the header of an EXR says of its colours; of Rec.709 it does without."""
    if space == REC709:
        return {}
    return {"chromaticities": chromaticities(space), "colorInteropID": space}


def snapshot_name(file: str) -> str:
    """`shot.0001.exr` -> `shot.0001_snapshot.exr`."""
    path = Path(file)
    return str(path.with_name(f"{path.stem}_snapshot{path.suffix}"))


def is_complete(file: Path) -> bool:
    """Whether a file is there, whole, and not what an interrupt left."""
    if not file.is_file() or file.stat().st_size == 0:
        return False
    if file.suffix.lower() == ".exr":
        return _exr_is_complete(file)
    if file.suffix.lower() in color.EXTENSIONS:
        try:
            return color.image_comment(file) != INCOMPLETE
        except OSError:
            return False
    try:
        # Statistics of a frame.
        return json.loads(file.read_text(encoding="utf-8")).get("complete", True)
    except (ValueError, AttributeError):
        return False


def _exr_is_complete(file: Path) -> bool:
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(file))
    if image is None:
        oiio.geterror()  # else it complains when the process ends
        return False
    complete = image.spec().getattribute("dermis.complete") != "false" and _has_all_lines(image)
    if not complete:
        oiio.geterror()
    image.close()
    return complete


def _has_all_lines(image: Any) -> bool:
    """Whether every line of every part can be read: a copy that was cut has its whole header."""
    part = 0
    while image.seek_subimage(part, 0):
        spec = image.spec()
        step = spec.tile_height or LINES
        for begin in range(spec.y, spec.y + spec.height, step):
            if _lines(image, part, spec, begin, min(begin + step, spec.y + spec.height)) is None:
                image.geterror()
                return False
        part += 1
    return part > 0


def _lines(image: Any, part: int, spec: Any, begin: int, end: int) -> Any:
    what = (0, spec.nchannels, spec.format)
    if spec.tile_width:
        return image.read_tiles(part, 0, spec.x, spec.x + spec.width, begin, end, spec.z, spec.z + 1, *what)
    return image.read_scanlines(part, 0, begin, end, spec.z, *what)
