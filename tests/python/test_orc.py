"""The orc's meshes are what a medium needs: closed, manifold, wound outward, without slivers of no area."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade

SCENES = Path(__file__).parents[2] / "usd_scenes"
STAGE = Usd.Stage.Open(str(SCENES / "orc.usda"))
SIDES = ["Left", "Right"]
MESHES = ["Skin", "Earring", *(part + side for part in ("Eye", "Cornea", "Tear", "Tusk") for side in SIDES)]


def read(name: str) -> tuple[np.ndarray, np.ndarray]:
    mesh = UsdGeom.Mesh(STAGE.GetPrimAtPath(f"/World/Bust/{name}"))
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get())
    assert (counts == 3).all()
    points = np.asarray(mesh.GetPointsAttr().Get(), np.float64)
    return points, np.asarray(mesh.GetFaceVertexIndicesAttr().Get(), np.int64).reshape(-1, 3)


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
    assert len(files) == 4 and all(file.is_file() for file in files)
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


# The eyes.

CENTERS = {"Left": np.array([3.25, -0.15, 6.1]), "Right": np.array([-3.25, -0.15, 6.1])}
"""Of the balls, in the space of the meshes."""


@pytest.mark.parametrize("side", SIDES)
def test_cornea_is_clear_and_stands_before_the_iris(side: str) -> None:
    prim = STAGE.GetPrimAtPath(f"/World/Bust/Cornea{side}")
    surface = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0].ComputeSurfaceSource()[0]
    inputs = {i.GetBaseName(): i.Get() for i in surface.GetInputs()}
    assert inputs["ior"] == pytest.approx(1.376) and inputs["opacity"] == 0.0 and inputs["roughness"] < 0.2
    assert "subsurface" not in inputs and tuple(inputs["diffuseColor"]) == (0, 0, 0)
    (ball, _), (cornea, _) = read(f"Eye{side}"), read(f"Cornea{side}")
    ball, cornea = ball - CENTERS[side], cornea - CENTERS[side]
    # The gaze is where the cornea is furthest from the middle.
    gaze = cornea[np.linalg.norm(cornea, axis=1).argmax()]
    gaze /= np.linalg.norm(gaze)
    height, radius = ball @ gaze, np.linalg.norm(ball - np.outer(ball @ gaze, gaze), axis=1)
    dome = cornea @ gaze
    across = np.linalg.norm(cornea - np.outer(dome, gaze), axis=1)
    order = np.argsort(across[dome > 0])
    above = np.interp(radius, across[dome > 0][order], dome[dome > 0][order])
    gap = (above - height)[(height > 0) & (radius < 1.2)]
    iris = (height > 0.9) & (radius > 0.25) & (radius < 0.55)
    assert gap.min() > 0.005, "the ball comes through its cornea"
    assert iris.sum() > 1000 and (above - height)[iris].mean() > 0.15, "no chamber before the iris"


@pytest.mark.parametrize("side", SIDES)
def test_tears_lie_where_lid_and_ball_meet(side: str) -> None:
    tear, _ = read(f"Tear{side}")
    skin, _ = read("Skin")
    from_ball = np.linalg.norm(tear - CENTERS[side], axis=1) - 1.3
    assert np.abs(from_ball).max() < 0.06
    for point in tear[::97]:
        assert np.linalg.norm(skin - point, axis=1).min() < 0.2


def eye(*without: str) -> np.ndarray:
    """The eye that is nearer to the camera, its surroundings matte, (60, 80, 3)."""
    dermis = pytest.importorskip("dermis")
    stage = Usd.Stage.Open(str(SCENES / "orc.usda"))
    stage.SetEditTarget(stage.GetSessionLayer())
    for name in ("Lashes", "Brows", "TuskLeft", "TuskRight", "Earring", *without):
        stage.GetPrimAtPath(f"/World/Bust/{name}").SetActive(False)
    UsdShade.Shader(stage.GetPrimAtPath("/World/Looks/Skin/Surface")).GetInput("subsurface").Set(0.0)
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/Main"))
    # The film of the eye alone: its middle, in apertures from the middle of the picture.
    for attribute, share, whole in (
        (camera.GetHorizontalApertureOffsetAttr(), EYE_AT[0], 24.0),
        (camera.GetVerticalApertureOffsetAttr(), EYE_AT[1], 27.0),
    ):
        attribute.Set(share * whole)
    camera.GetHorizontalApertureAttr().Set(24 * 0.08)
    camera.GetVerticalApertureAttr().Set(24 * 0.06)
    image = dermis.render(stage, resolution=[80, 60], samples=48, maxDepth=1, aovs=[])
    assert image.stats["warnings"] == []
    return image.color[..., :3].astype(float)


EYE_AT = (-0.033, 0.057)


def test_iris_is_seen_through_the_cornea_and_lights_in_it() -> None:
    clear, bare = eye(), eye("CorneaLeft", "TearLeft")
    amber = (bare[..., 0] > 2.5 * bare[..., 2]) & (bare.sum(-1) > 0.1)
    assert amber.sum() > 500, "the iris is not where it is looked for"
    # Straight through, in sight and from the lights: Fresnel's 0.975 at small angles, times 0.93 to 0.975.
    ratio = np.median(clear[amber] / bare[amber], axis=0)
    assert (ratio > 0.9).all() and (ratio < 0.976).all(), ratio
    row, column = np.argwhere(amber).mean(0).round().astype(int)
    pupil = slice(row - 3, row + 4), slice(column - 3, column + 4)
    assert bare[pupil].max() < 0.1
    # The eye spot in the pupil, and a key beside it.
    more = (clear - bare).min(-1)
    assert more[row - 5 : row + 6, column - 5 : column + 6].max() > 0.3
    assert (more > 0.15).sum() > 10
