"""A `.dermis` file as flat prims, read without the core; the layout is described in `src/flat/file.rs`."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..stage import FlatStage

VERSION = 3
HEADER = struct.Struct("<6sHQQQ")
TEXT_AT = 64
ENTRY = struct.Struct("<IIQQQ")
SCALARS = (np.dtype("<f4"), np.dtype("<f8"), np.dtype("<i4"), np.dtype("u1"), np.dtype("<u2"))

#: Maps of the file and the prim type of their entries.
MAPS = {
    "meshes": "Mesh",
    "instancers": "Instancer",
    "materials": "Material",
    "lights": "Light",
    "cameras": "Camera",
    "textures": "Texture",
    "images": "Image",
}


def read_flat(file: Path) -> FlatStage:
    """The scene of a file that the core wrote; checksums are the core's to check. Raises ValueError."""
    content = np.memmap(file, np.uint8, "r")
    magic, version, length, entries, size = HEADER.unpack_from(content)
    if (magic, version, size) != (b"DERMIS", VERSION, len(content)):
        raise ValueError(f"{file}: it is not a whole .dermis file of version {VERSION}")
    table = -(-(TEXT_AT + length) // 8) * 8
    arrays = [read_array(content, table + n * ENTRY.size) for n in range(entries)]

    def resolve(value: dict[str, Any]) -> Any:
        return arrays[value["array"]] if value.keys() == {"array"} else value

    scene = json.loads(bytes(content[TEXT_AT : TEXT_AT + length]), object_hook=resolve)
    prims = {
        path: {**fields, "type": kind} for name, kind in MAPS.items() for path, fields in scene[name].items()
    }
    return FlatStage(prims=prims, stage=scene["stage"], settings=scene["settings"])


def read_array(content: np.ndarray, entry: int) -> np.ndarray:
    scalar, components, offset, elements, _ = ENTRY.unpack_from(content, entry)
    kind = SCALARS[scalar]
    values = content[offset : offset + elements * components * kind.itemsize].view(kind)
    shape = {1: (elements,), 16: (elements, 4, 4)}.get(components, (elements, components))
    return values.reshape(shape)
