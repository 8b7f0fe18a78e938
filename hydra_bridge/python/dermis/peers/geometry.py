"""Meshes as triangles in world space, with the normals that they are shaded by."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .appearance import Fields, matrix, require


@dataclass(frozen=True)
class Triangles:
    #: float32 (n, 3), world space.
    points: NDArray[np.float32]
    #: int32 (m, 3), counter-clockwise as seen from outside.
    corners: NDArray[np.int32]
    #: float32 (n, 3), unit; None: flat faces.
    normals: NDArray[np.float32] | None

    @property
    def smooth(self) -> bool:
        """Whether the normals are others than those of the faces."""
        if self.normals is None:
            return False
        a, b, c = (self.points[self.corners[:, i]].astype(float) for i in range(3))
        faces = unit(np.cross(b - a, c - a))
        cosines = np.einsum("ijk,ik->ij", self.normals[self.corners], faces)
        # 1e-4: 0.8 degrees; a face without area has no normal to differ from.
        return bool((cosines[np.any(faces != 0.0, axis=1)] < 1.0 - 1e-4).any())


def triangles_of(prim: Fields, path: str, refine_level: int = 0) -> Triangles:
    """Polygons become fans, which needs them convex. Subdivision surfaces are exported as cages, so `refine_level`,
    that of the settings, has to be 0 for them. Raises ExportError."""
    scheme, level = prim["subdivisionScheme"], prim.get("refineLevel", refine_level)
    require(scheme == "none" or level == 0, path, "refineLevel", level)
    require(not prim.get("instancer"), path, "instancer", prim.get("instancer"))
    for name in ("geomSubsets", "holeIndices"):
        values = prim.get(name)
        require(values is None or len(values) == 0, path, name, "")
    linear, shift = matrix(prim)[:3, :3], matrix(prim)[:3, 3]
    points = prim["points"] @ linear.T + shift
    slots = fan(prim["faceVertexCounts"])
    if (prim["orientation"] == "leftHanded") != (np.linalg.det(linear) < 0.0):
        slots = slots[:, ::-1]
    corners = prim["faceVertexIndices"][slots]
    normals = prim.get("normals") if scheme == "none" else None
    if normals is None:
        smooth = scheme in ("catmullClark", "loop")
        return Triangles(single(points), corners, cage_normals(points, corners) if smooth else None)
    # A normal is a plane's: the inverse transpose; its length does not matter.
    values = normals["values"] @ np.linalg.inv(linear)
    if "indices" in normals:
        values = values[normals["indices"]]
    if normals["interpolation"] in ("vertex", "varying"):
        return Triangles(single(points), corners, unit(values))
    require(
        normals["interpolation"] == "faceVarying", path, "normals:interpolation", normals["interpolation"]
    )
    apart = np.arange(slots.size, dtype=np.int32).reshape(-1, 3)
    return Triangles(single(points[corners].reshape(-1, 3)), apart, unit(values[slots].reshape(-1, 3)))


def fan(counts: NDArray[np.int32]) -> NDArray[np.int64]:
    """Corners of triangles as places in faceVertexIndices."""
    starts = np.cumsum(counts, dtype=np.int64) - counts
    face = np.repeat(np.arange(len(counts)), counts - 2)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    first = starts[face]
    return np.stack([first, first + within + 1, first + within + 2], axis=1)


def cage_normals(points: NDArray[Any], corners: NDArray[np.int32]) -> NDArray[np.float32]:
    """Area-weighted means of the faces around each point: how dermis shades a subdivision surface's cage."""
    a, b, c = (points[corners[:, i]] for i in range(3))
    faces = np.cross(b - a, c - a)
    sums = np.zeros_like(points, dtype=np.float64)
    for i in range(3):
        np.add.at(sums, corners[:, i], faces)
    return unit(sums)


def unit(vectors: NDArray[Any]) -> NDArray[np.float32]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return single(vectors / np.where(lengths > 0.0, lengths, 1.0))


def single(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)
