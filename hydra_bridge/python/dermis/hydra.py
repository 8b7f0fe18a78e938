"""Hydra's vocabulary: dirty bits, the delegate, and the edits that lead from one flattened stage to the
next."""

from __future__ import annotations

import json
from dataclasses import replace
from enum import IntFlag
from typing import TYPE_CHECKING, Any

from pxr import Usd

from .arrays import np
from .stage import FlatStage, Options, encode, flatten_prim_for_core

if TYPE_CHECKING:
    from numpy.typing import NDArray

Prim = dict[str, Any]


class DirtyBits(IntFlag):
    """What an edit touches, named as in HdChangeTracker."""

    TOPOLOGY = 1
    POINTS = 2
    TRANSFORM = 4
    PRIMVAR = 8
    NORMALS = 16
    VISIBILITY = 32
    MATERIAL_ID = 64
    DOUBLE_SIDED = 128
    INSTANCER = 256
    PARAMS = 512
    CATEGORIES = 1024
    ALL = 2047


MESH_BITS = {
    "faceVertexCounts": DirtyBits.TOPOLOGY,
    "faceVertexIndices": DirtyBits.TOPOLOGY,
    "holeIndices": DirtyBits.TOPOLOGY,
    "orientation": DirtyBits.TOPOLOGY,
    "subdivisionScheme": DirtyBits.TOPOLOGY,
    "subdivTags": DirtyBits.TOPOLOGY,
    "refineLevel": DirtyBits.TOPOLOGY,
    "points": DirtyBits.POINTS,
    "pointKeys": DirtyBits.POINTS,
    "transform": DirtyBits.TRANSFORM,
    "transformKeys": DirtyBits.TRANSFORM,
    "primvars": DirtyBits.PRIMVAR,
    "displayColor": DirtyBits.PRIMVAR,
    "displayOpacity": DirtyBits.PRIMVAR,
    "normals": DirtyBits.NORMALS,
    "visible": DirtyBits.VISIBILITY,
    "material": DirtyBits.MATERIAL_ID,
    "mediumPriority": DirtyBits.MATERIAL_ID,
    "subsurfaceSet": DirtyBits.MATERIAL_ID,
    "doubleSided": DirtyBits.DOUBLE_SIDED,
    "instancer": DirtyBits.INSTANCER,
    "categories": DirtyBits.CATEGORIES,
}
"""Field of Mesh -> bit; `geomSubsets` is topology where faces move, material otherwise."""

INSTANCER_BITS = {
    "transforms": DirtyBits.INSTANCER,
    "transformKeys": DirtyBits.INSTANCER,
    "displayColor": DirtyBits.INSTANCER,
    "primvars": DirtyBits.INSTANCER,
    "visible": DirtyBits.VISIBILITY,
}

PARAMS_BITS = {
    "transform": DirtyBits.TRANSFORM,
    "transformKeys": DirtyBits.TRANSFORM,
    "visible": DirtyBits.VISIBILITY,
}
"""Of lights and cameras, beside PARAMS, which any change of theirs sets."""


def dirty_bits(old: Prim, new: Prim) -> DirtyBits:
    """Aspects in which two states of a prim of one type differ; arrays that are the same object are not
    compared."""
    changed = [name for name in {**old, **new} if not same(old.get(name), new.get(name))]
    bits = DirtyBits(0)
    for name in changed:
        match new["type"]:
            case "Mesh" if name == "geomSubsets":
                bits |= subset_bits(old.get(name, []), new.get(name, []))
            case "Mesh":
                bits |= MESH_BITS[name]
            case "Instancer":
                bits |= INSTANCER_BITS[name]
            case _:
                bits |= DirtyBits.PARAMS | PARAMS_BITS.get(name, DirtyBits.PARAMS)
    return bits


def subset_bits(old: list[Prim], new: list[Prim]) -> DirtyBits:
    faces = [[(subset["path"], subset["indices"]) for subset in subsets] for subsets in (old, new)]
    materials = [[subset["material"] for subset in subsets] for subsets in (old, new)]
    bits = DirtyBits(0) if same(*faces) else DirtyBits.TOPOLOGY
    return bits if same(*materials) else bits | DirtyBits.MATERIAL_ID


def same(a: Any, b: Any) -> bool:
    """Deep equality of fields: identity first, arrays by type and value."""
    if a is b:
        return True
    a, b = (np.asarray(x) if isinstance(x, memoryview) else x for x in (a, b))
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and (same_memory(a, b) or np.array_equal(a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def same_memory(a: NDArray, b: NDArray) -> bool:
    """Views of one buffer: USD hands out the same memory for an attribute that does not change."""
    return a.shape == b.shape and a.strides == b.strides and a.ctypes.data == b.ctypes.data


def populate(delegate: Any, flat: FlatStage, previous: FlatStage | None = None) -> dict[str, DirtyBits]:
    """Brings a `_core.Delegate` from `previous` (None: empty) to `flat`; returns the dirty bits sent, by
    path.

    `commit` is left to the caller.
    """
    old = previous or FlatStage()
    if previous is None or flat.stage != old.stage:
        delegate.set_stage(json.dumps(flat.stage, allow_nan=False))
    if flat.settings and flat.settings != old.settings:
        delegate.set_settings(json.dumps(flat.settings, allow_nan=False))
    for path, prim in old.prims.items():
        if path not in flat.prims or flat.prims[path]["type"] != prim["type"]:
            delegate.remove(path)
    sent = edits(flat, old)
    for path, bits in sent.items():
        delegate.sync(path, *encode(flat.prims[path]), int(bits))
    delegate.clear_warnings()
    for warning in flat.warnings:
        delegate.warn(*warning)
    return sent


def edits(flat: FlatStage, old: FlatStage) -> dict[str, DirtyBits]:
    """Dirty bits of the prims that are new or changed."""
    bits = {}
    for path, prim in flat.prims.items():
        before = old.prims.get(path)
        known = before is not None and before["type"] == prim["type"]
        bits[path] = dirty_bits(before, prim) if known else DirtyBits.ALL
    return {path: dirty for path, dirty in bits.items() if dirty}


class Delegate:
    """Hydra's render delegate. Prims come by `sync`, changes take effect at `commit`, then `start` renders.

    The calls of `dermis._core` raise `dermis.CoreError`.
    """

    def __init__(self, core: Any = None) -> None:
        if core is None:
            from ._core import Delegate as Core

            core = Core()
        self.core = core

    def sync(
        self,
        path: str,
        prim: Prim | Usd.Prim,
        dirty_bits: DirtyBits | int = DirtyBits.ALL,
        time: Usd.TimeCode | float | None = None,
        options: Options | None = None,
    ) -> None:
        """Inserts or edits a prim: a dict as in `FlatStage.prims`, or a prim of a stage with all that is
        below it.

        Of a prim of a stage, the materials and textures it uses come along where `dirty_bits` has
        MATERIAL_ID or PARAMS; of portals the domes that name them. `time` and `options` are for prims of a stage only.
        """
        if isinstance(prim, Usd.Prim):
            self._sync_stage_prim(path, prim, DirtyBits(dirty_bits), time, options)
        else:
            self.core.sync(path, *encode(prim), int(dirty_bits))

    def _sync_stage_prim(
        self, path: str, prim: Usd.Prim, bits: DirtyBits, time: Any, options: Options | None
    ) -> None:
        options = options or Options()
        # Their primvars are read of every prim.
        aovs = json.loads(self.core.settings()).get("aovs", ())
        flat = flatten_prim_for_core(prim, time, replace(options, aovs=(*options.aovs, *aovs)))
        root = str(prim.GetPath())
        for key, fields in flat.prims.items():
            if key == root or key.startswith((root + "/", root + "[", root + ".")):
                self.core.sync(path + key[len(root) :], *encode(fields), int(bits))
            elif fields["type"] == "Light" or bits & (DirtyBits.MATERIAL_ID | DirtyBits.PARAMS):
                self.core.sync(key, *encode(fields), int(DirtyBits.ALL))
        for warning in flat.warnings:
            self.core.warn(*warning)

    def remove(self, path: str) -> None:
        self.core.remove(path)

    def set_settings(self, **settings: Any) -> None:
        """Render settings by their names (`samples=64`, `resolution=(960, 540)`, ...); others keep their
        value."""
        self.core.set_settings(json.dumps(settings, allow_nan=False))

    def settings(self) -> dict[str, Any]:
        return json.loads(self.core.settings())

    def commit(self, last: bool = False) -> dict[str, Any]:
        """Compiles what is dirty; returns what was rebuilt. `last`: no edit follows, so that points and faces of
        meshes, which take a third of the room, are let go as soon as they are compiled; the next commit fails."""
        return json.loads(self.core.commit(last))

    def start(self) -> None:
        """Starts the render in the background; call after `commit`."""
        self.core.start()

    def poll(self) -> tuple[float, bool]:
        """(fraction done, finished)."""
        return self.core.poll()

    def wait(self, seconds: float) -> bool:
        """Waits for the end of the render, at most `seconds`; True when finished."""
        return self.core.wait(seconds)

    def snapshot(self) -> dict[str, NDArray[np.float32]]:
        """AOVs so far: name -> (height, width, channels), linear; `color` is the beauty (RGBA)."""
        return self.core.snapshot()

    def stats(self) -> dict[str, Any]:
        return json.loads(self.core.stats())

    def stop(self) -> None:
        self.core.stop()
