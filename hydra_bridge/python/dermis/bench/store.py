"""Renders kept in DIR/runs: what is complete there is not rendered again, so that a long run can be taken up."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from .. import _core
from ..cli.output import OutputError, replacing
from .crops import Window
from .machine import processor
from .render import Render
from .scenes import Scene

#: Attribute of the EXR that holds times and statistics.
ATTRIBUTE = "dermis:bench"


@dataclass(frozen=True)
class Store:
    folder: Path

    def file(
        self, scene: Scene, target: str, label: str, settings: Mapping[str, Any], window: Window
    ) -> Path:
        """Where a render is kept: words for people, and a key of all that its image and times depend on.

        That is the flattened scene, settings (method, work and seed among them), window, renderer and processor; and
        the label, for two methods of the same settings are measured apart.
        """
        content = [scene.key, scene.threads, label, dict(settings), list(window), *renderer(), processor()]
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]
        words = f"{scene.spec.name}.{target}.{label}.{settings['seed']}"
        return self.folder / f"{safe(words)}.{key}.exr"

    def load(self, file: Path) -> Render | None:
        """What was kept; None where there is nothing, or nothing whole."""
        if not file.exists():
            return None
        image = oiio.ImageBuf(str(file))
        whole = image.read(0, 0, True, oiio.FLOAT)  # now, for what is cut off within its pixels
        text = image.spec().get_string_attribute(ATTRIBUTE)
        if image.geterror() or not (whole and text):
            return None
        return Render(image.get_pixels(oiio.FLOAT).astype(np.float64), **json.loads(text))

    def keep(self, file: Path, rendered: Render) -> None:
        """Raises OutputError."""
        height, width, channels = rendered.image.shape
        spec = oiio.ImageSpec(width, height, channels, oiio.FLOAT)
        facts = {name: getattr(rendered, name) for name in ("cpu", "wall", "peak", "stats")}
        spec.attribute(ATTRIBUTE, json.dumps(facts))
        image = oiio.ImageBuf(spec)
        image.set_pixels(oiio.ROI(), rendered.image.astype(np.float32))
        with replacing(file) as temporary:
            if not image.write(str(temporary)):
                raise OutputError(f"Cannot write {file}: {image.geterror()}")


@cache
def renderer() -> tuple[str, str]:
    """Version of dermis, and a hash of the compiled core: times of two builds must not be mixed."""
    return _core.__version__, hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest()


def safe(text: str) -> str:
    """`text` as a part of a file name."""
    return "".join(c if c.isalnum() or c in "-=." else "_" for c in text)
