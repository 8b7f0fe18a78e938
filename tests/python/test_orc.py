"""The orc's meshes are what a medium needs: closed, manifold, wound outward, without slivers of no area."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

SCENES = Path(__file__).parents[2] / "usd_scenes"
STAGE = Usd.Stage.Open(str(SCENES / "orc.usda"))
MESHES = ["Skin", "EyeLeft", "EyeRight", "TuskLeft", "TuskRight", "Earring"]


def read(name: str) -> tuple[np.ndarray, np.ndarray]:
    mesh = UsdGeom.Mesh(STAGE.GetPrimAtPath(f"/World/Bust/{name}"))
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get())
    assert (counts == 3).all()
    points = np.asarray(mesh.GetPointsAttr().Get(), np.float64)
    return points, np.asarray(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)


@pytest.mark.parametrize("name", MESHES)
def test_mesh_encloses_a_volume(name: str) -> None:
    points, triangles = read(name)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = edges[:, 0] * len(points) + edges[:, 1]
    back = edges[:, 1] * len(points) + edges[:, 0]
    assert len(np.unique(there)) == len(there), "an edge runs the same way in two faces"
    assert np.array_equal(np.sort(there), np.sort(back)), "an edge has no face on its other side"
    a, b, c = (points[triangles[:, i]] for i in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0, "wound inward"
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-7


def test_skin_is_as_fine_as_the_issue_asks() -> None:
    _, triangles = read("Skin")
    assert 100_000 <= len(triangles) <= 300_000


def test_ears_are_thin() -> None:
    """Median thickness of the membrane between 3 and 7 mm: from each ear vertex to the sheet behind it."""
    points, triangles = read("Skin")
    normals = np.zeros_like(points)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], np.cross(b - a, c - a))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Beyond 10 cm from the middle, above the shoulders, there are only ears.
    ear = np.flatnonzero((np.abs(points[:, 0]) > 10) & (points[:, 1] > -4))
    assert len(ear) > 1000
    rng = np.random.default_rng(1)
    behind = []
    for i in rng.choice(ear, 300, replace=False):
        toward = points[ear] - points[i]
        depth = -toward @ normals[i]
        aside = np.linalg.norm(toward + depth[:, None] * normals[i], axis=1)
        facing = (normals[ear] @ normals[i] < -0.5) & (aside < 0.25) & (depth > 0)
        if facing.any():
            behind.append(depth[facing].min())
    assert len(behind) > 100
    assert 0.3 < np.median(behind) < 0.7, f"median thickness {np.median(behind):.2f} cm"
