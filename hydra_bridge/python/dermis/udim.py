"""UDIM: tiles that faces of a mesh are in, and that have no file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Usd

from .arrays import np
from .reading import Reader

if TYPE_CHECKING:
    from numpy.typing import NDArray

Fields = dict[str, Any]


def warn_missing_tiles(prim: Usd.Prim, mesh: Fields, materials: dict[str, Fields], reader: Reader) -> None:
    """Says which tiles are missing for a flat mesh, of images that are looked up by one of its primvars as it is."""
    for key, faces in worn(mesh):
        for varname, tiles in tiled(materials.get(key, {})):
            st = mesh.get("primvars", {}).get(varname)
            missing = sorted(tiles_of(mesh, st, faces) - tiles.keys()) if st else []
            if missing:
                file = Path(next(iter(tiles.values())).split("@")[1]).name
                numbers = ", ".join(map(str, missing[:8])) + (", ..." if len(missing) > 8 else "")
                message = f"of {key} there is {file}, but not {numbers}; these faces get the fallback"
                reader.warn(prim, f"primvars:{varname}: {message}")


def worn(mesh: Fields) -> Iterator[tuple[str, NDArray]]:
    """Materials with the faces that have them."""
    own = np.ones(len(mesh["faceVertexCounts"]), bool)
    for subset in mesh["geomSubsets"]:
        faces = subset["indices"]
        faces = faces[(faces >= 0) & (faces < len(own))]
        own[faces] = False
        yield subset["material"] or mesh["material"], faces
    yield mesh["material"], np.flatnonzero(own)


def tiled(material: Fields) -> Iterator[tuple[str, dict[int, str]]]:
    """Primvar and tiles, by number, of images that have such."""
    for network in (material.get(name, {}) for name in ("network", "displacement")):
        nodes = network.get("nodes", [])
        for node in nodes:
            if node["node"] == "image" and any(tile["udim"] for tile in node["tiles"]):
                source = nodes[node["st"]]
                if source["node"] == "primvar":
                    yield source["varname"], {tile["udim"]: tile["image"] for tile in node["tiles"]}


def tiles_of(mesh: Fields, st: Fields, faces: NDArray) -> set[int]:
    """Numbers of the tiles that the middles of faces are in: corners lie on the borders of tiles."""
    counts, corners = (np.asarray(mesh[name]) for name in ("faceVertexCounts", "faceVertexIndices"))
    values = np.asarray(st["values"])
    if st["type"] != "float2" or not len(faces) or counts.min() < 1 or counts.sum() != len(corners):
        return set()
    index = {
        "faceVarying": lambda: np.arange(len(corners)),
        "uniform": lambda: np.repeat(np.arange(len(counts)), counts),
        "constant": lambda: np.zeros(len(corners), int),
    }.get(st["interpolation"], lambda: corners)()
    if "indices" in st:
        index = np.asarray(st["indices"])[index]
    if index.min() < 0 or index.max() >= len(values):
        return set()
    sums = np.add.reduceat(values[index].astype(np.float64), np.cumsum(counts) - counts)
    middles = (sums / counts[:, None])[faces]
    u, v = np.floor(middles[np.isfinite(middles).all(axis=1)]).astype(int).T
    # Ten tiles to a row; what is beyond has no number.
    inside = (u >= 0) & (u < 10) & (v >= 0)
    return {int(number) for number in np.unique(1001 + u[inside] + 10 * v[inside])}
