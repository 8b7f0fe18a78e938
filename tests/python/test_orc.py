"""The orc's meshes are what a medium needs: closed, manifold, wound outward, without slivers of no area."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade

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


def test_skin_has_coordinates_without_a_jump() -> None:
    """No triangle spans the map; around the seam, s goes on beyond 1."""
    points, triangles = read("Skin")
    primvar = UsdGeom.PrimvarsAPI(STAGE.GetPrimAtPath("/World/Bust/Skin")).GetPrimvar("st")
    assert primvar.GetInterpolation() == UsdGeom.Tokens.faceVarying
    st = np.asarray(primvar.ComputeFlattened(), np.float64).reshape(-1, 3, 2)
    assert len(st) == len(triangles)
    spans = np.ptp(st, axis=1).max(1)
    # At the poles, on the crown and below the bust, a triangle sees much of the turn.
    axis = np.hypot(*points[triangles].mean(1)[:, [0, 2]].T)
    assert axis[spans > 0.2].max() < 0.3 and (spans > 0.2).sum() < 30
    assert st.min() >= 0.0 and st[..., 1].max() <= 1.0 and 1.0 < st[..., 0].max() < 1.5
    front = points[triangles][..., 2].min(1) > 4.0
    assert abs(np.median(st[front][..., 0]) - 0.5) < 0.02


def test_maps_are_found_and_light() -> None:
    files = [
        Path(shader.GetInput("file").Get().resolvedPath)
        for shader in map(UsdShade.Shader, STAGE.Traverse())
        if shader and shader.GetIdAttr().Get() == "UsdUVTexture"
    ]
    assert len(files) == 3 and all(file.is_file() for file in files)
    assert sum(file.stat().st_size for file in files) < 1.5e6


def test_normals_of_the_map_are_unit_and_level() -> None:
    oiio = pytest.importorskip("OpenImageIO")
    image = oiio.ImageBuf(str(SCENES / "textures" / "orc_normal.jpg"))
    n = 2.0 * image.get_pixels(oiio.FLOAT) - 1.0
    assert np.linalg.norm(n, axis=-1).mean() == pytest.approx(1.0, abs=0.03)
    assert np.abs(n[..., :2].mean((0, 1))).max() < 0.01 and n[..., 2].min() > 0.0
    # Pores, not noise: slopes of some degrees.
    assert 0.04 < n[..., :2].std() < 0.15


@pytest.mark.parametrize(("name", "least"), [("Lashes", 120), ("Brows", 300)])
def test_hairs_grow_out_of_the_skin(name: str, least: int) -> None:
    """Each root is under the nearest vertex of the skin, by less than a millimetre, and the tip above it."""
    curves = UsdGeom.BasisCurves(STAGE.GetPrimAtPath(f"/World/Bust/{name}"))
    hairs = np.asarray(curves.GetPointsAttr().Get(), np.float64).reshape(-1, 4, 3)
    assert len(hairs) >= least
    points, _ = read("Skin")
    mesh = UsdGeom.PrimvarsAPI(STAGE.GetPrimAtPath("/World/Bust/Skin"))
    normals = np.asarray(mesh.GetPrimvar("normals").Get(), np.float64)
    for points_of_hair in hairs[:: len(hairs) // 40]:
        root, tip = points_of_hair[0], points_of_hair[-1]
        i = np.linalg.norm(points - root, axis=1).argmin()
        depth = (points[i] - root) @ normals[i]
        assert 0.0 < depth < 0.1
        assert np.linalg.norm(points - tip, axis=1).min() > 0.05
    bound = UsdShade.MaterialBindingAPI(curves).ComputeBoundMaterial()[0]
    assert str(bound.GetPath()) == "/World/Looks/Hair"
