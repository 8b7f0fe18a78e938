"""Motion, subdivision and primvars of usd_scenes against sums that share no code with the renderer: rays through what
moves, OpenSubdiv's limit points, formulas of splines."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import channels, run
from numpy.typing import NDArray
from own_stages import SIZE, along, alpha, assert_covers, eye, only, opened
from pxr import Gf, Usd, UsdGeom

import dermis

REFERENCE = Path(__file__).parents[1] / "reference" / "subdivision.json"


# Motion: the shutter is open from 0.75 to 1.25

TIMES = 0.75 + 0.5 * (np.arange(32) + 0.5) / 32


def over_time(stage: Usd.Stage, covered: object) -> NDArray:
    """Pixels of the mean over the shutter of `covered(t, o, d)`, whether rays meet something."""
    sight = eye(stage)
    return sum(sight.mean(covered(t, sight.o, sight.d).astype(float)) for t in TIMES) / len(TIMES)


def through_box(o: NDArray, d: NDArray, half: NDArray) -> NDArray:
    """Whether rays meet a box about the origin."""
    a, b = (-half - o) / d, (half - o) / d
    return np.maximum.reduce(np.minimum(a, b), -1) < np.minimum.reduce(np.maximum(a, b), -1)


def near_sphere(o: NDArray, d: NDArray, radius: float) -> NDArray:
    """Whether rays meet a sphere about the origin; `d` has any length."""
    b, c = (d * o).sum(-1), o @ o - radius**2
    return b * b > (d * d).sum(-1) * c


def wax(t: float, o: NDArray, d: NDArray) -> NDArray:
    keys = np.array([(-1.8, 3.2), (-1.5, 1.6), (-1.45, 1.1), (-1.3, 0.7)])
    x, y = (np.interp(t, [0, 1, 1.2, 2], keys[:, i]) for i in (0, 1))
    wide, high = np.interp(t, [1, 1.25], [1, 1.15]), np.interp(t, [1, 1.25], [1, 0.8])
    scale = np.array([wide, high, wide])
    return near_sphere((o - [x, y, 0]) / scale, d / scale, 0.6)


def bar(t: float, o: NDArray, d: NDArray) -> NDArray:
    cos, sin = np.cos(np.radians(80 * (t - 1))), np.sin(np.radians(80 * (t - 1)))
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return through_box((o - [1, 1.7, -0.5]) @ turn, d @ turn, np.array([1.1, 0.09, 0.15]))


def lamp(t: float, o: NDArray, d: NDArray) -> NDArray:
    return near_sphere(o - [-4.5 + 3 * t, 3.4 - 0.3 * t, -1.5], d, 0.12)


def test_motion_is_the_mean_over_the_shutter(usd_scenes):
    """A ball that falls along three keys and is squashed, and a bar that turns."""
    for name, covered in (("Wax", wax), ("Bar", bar)):
        stage = opened(usd_scenes, "motion", name)
        assert_covers(alpha(stage, time=1.0), over_time(stage, covered), 0.012)


def test_confetti_flies_by_its_velocities(usd_scenes):
    stage = opened(usd_scenes, "motion", "Confetti")
    prim = UsdGeom.PointInstancer.Get(stage, "/World/Confetti")
    at, speed, turn = (
        np.array(attribute.Get(1.0), float)
        for attribute in (
            prim.GetPositionsAttr(),
            prim.GetVelocitiesAttr(),
            prim.GetAngularVelocitiesAttr(),
        )
    )

    def covered(t: float, o: NDArray, d: NDArray) -> NDArray:
        seconds, found = (t - 1) / 24, False
        for i in range(6):
            rotation = Gf.Rotation(Gf.Vec3d(*turn[i]), np.linalg.norm(turn[i]) * seconds)
            to_world = np.array(Gf.Matrix3d(rotation)) if turn[i].any() else np.eye(3)
            a, b = (o - at[i] - seconds * speed[i]) @ to_world.T, d @ to_world.T
            p = a - a[2] / b[..., 2:] * b
            found = found | ((np.abs(p[..., 0]) < 0.16) & (np.abs(p[..., 1]) < 0.1))
        return found

    assert_covers(alpha(stage, time=1.0), over_time(stage, covered), 0.02)


def test_the_lamp_that_passes_is_as_bright_as_it_is_long_there(usd_scenes):
    stage = opened(usd_scenes, "motion", "Lamp")
    image = dermis.render(stage, time=1.0, resolution=SIZE, samples=1024, aovs=[])
    expected = over_time(stage, lamp)[..., None] * 160 * np.array([1, 0.75, 0.45])
    found = image.color[..., :3].astype(float)
    np.testing.assert_allclose(found.sum((0, 1)), expected.sum((0, 1)), rtol=0.02)
    np.testing.assert_allclose(found, expected, atol=0.03 * 160)


# Subdivision: seen by a camera of its own in the space of each mesh


def seen(stage: Usd.Stage, name: str, half: float, **settings: object) -> tuple[NDArray, dict]:
    """Positions, in its own space, of what is seen of a mesh from above; and the image. `half` units to each side."""
    only(stage, name)
    path = f"/World/{name}/Above"
    camera = UsdGeom.Camera.Define(stage, path)
    camera.CreateProjectionAttr("orthographic")
    camera.CreateHorizontalApertureAttr(20 * half)
    camera.CreateVerticalApertureAttr(20 * half)
    UsdGeom.XformCommonAPI(camera).SetTranslate((0, 5, 0))
    UsdGeom.XformCommonAPI(camera).SetRotate((-90, 0, 0))
    settings = {"samples": 1, **settings}
    image = dermis.render(
        stage, camera=path, resolution=(48, 48), maxDepth=0, aovs=["alpha", "position"], **settings
    )
    to_mesh = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(f"/World/{name}"))
    hit = image["alpha"][..., 0] > 0.5
    world = np.concatenate([image["position"][hit].astype(float), np.ones((hit.sum(), 1))], 1)
    return (world @ np.linalg.inv(np.array(to_mesh)))[:, :3], image


def height_above(triangles: NDArray, p: NDArray) -> NDArray:
    """Highest y of triangles (n, 3, 3) above (x, z) of points; -inf where there is none."""
    a, b, c = (triangles[:, i][:, [0, 2]] for i in range(3))
    q = p[:, None, [0, 2]]

    def cross(u: NDArray, v: NDArray) -> NDArray:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    whole = cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        v, w = cross(q - a, c - a) / whole, cross(b - a, q - a) / whole
    y = triangles[:, 0, 1] * (1 - v - w) + triangles[:, 1, 1] * v + triangles[:, 2, 1] * w
    inside = (v >= -1e-4) & (w >= -1e-4) & (v + w <= 1 + 1e-4)
    return np.where(inside, y, -np.inf).max(1)


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("Cube0", "cube"),
        ("Cube1", "cube_crease_1"),
        ("Cube2", "cube_crease_2.3"),
        ("Cube3", "cube_crease_10"),
    ],
)
def test_creased_cubes_are_those_of_opensubdiv(usd_scenes, name, reference):
    """The stage's ring is the upper one, the reference's that of z = -1; at its level, the second, the facets are
    those between its limit points."""
    (entry,) = (e for e in json.loads(REFERENCE.read_text()) if e["name"] == reference)
    x, y, z = np.array(entry["limit"]).T
    limit, faces = np.stack([x, -z, y], 1), np.array(entry["faces"]).reshape(-1, 4)
    # Quads that are not flat have two diagonals: the surface is between.
    halves = [limit[faces[:, [i, i + 1, (i + 2) % 4]]] for i in (0, 1)]
    others = [limit[faces[:, [(i + 2) % 4, (i + 3) % 4, i]]] for i in (0, 1)]
    p, _ = seen(opened(usd_scenes, "subdivision"), name, 1.1, refineLevel=2)
    heights = [height_above(np.concatenate(pair), p) for pair in zip(halves, others, strict=True)]
    assert len(p) > 600
    assert np.abs(np.array(heights) - p[:, 1]).min(0).max() < 2e-3
    # Nothing is missing of its outline either.
    assert p.max(0) == pytest.approx(limit.max(0), abs=0.06)


@pytest.mark.parametrize("boundary", ["edgeAndCorner", "edgeOnly", "none"])
def test_sheets_are_bicubic_b_splines(usd_scenes, boundary):
    """With points reflected at the boundary its corners are kept, without them the surface ends a face early (the
    rules of creases are those of such a spline). `edgeOnly` differs near the corners, whose limit is a curve's."""
    stage = opened(usd_scenes, "subdivision")
    grid = np.array(UsdGeom.Mesh.Get(stage, f"/World/Sheet_{boundary}").GetPointsAttr().Get(), float)[:, 1]
    grid = grid.reshape(4, 4)
    reach = 0.3 if boundary == "none" else 0.9
    wrap = "nonperiodic" if boundary == "none" else "pinned"
    # Along z, then along x: parameters are even, and so are the points; joints are there twice.
    rows = along(along(grid, "bspline", wrap).T, "bspline", wrap).T
    at = np.concatenate([np.linspace(a, a + 0.6, 33) for a in np.arange(-reach, reach - 0.1, 0.6)])
    p, image = seen(stage, f"Sheet_{boundary}", 1.0, refineLevel=5)
    column, row = (np.searchsorted(at, p[:, i]).clip(1, len(at) - 1) for i in (0, 2))
    column, row = column - (at[column] - at[column - 1] == 0), row - (at[row] - at[row - 1] == 0)
    expected = bilinear(rows, at, p[:, 0], p[:, 2], column, row)
    near_corner = (np.abs(p[:, [0, 2]]).min(1) > 0.3) & (boundary == "edgeOnly")
    assert np.abs(expected - p[:, 1])[~near_corner].max() < 4e-3
    assert np.abs(p[:, [0, 2]]).max() == pytest.approx(reach, abs=0.05)
    # Of a rounded corner: (a + 4 b + c) / 6 of the boundary's points.
    hit = image["alpha"][..., 0] > 0.5
    diagonal = np.abs(p[:, 0] + p[:, 2]).max()
    assert diagonal == pytest.approx(2 * (0.8 if boundary == "edgeOnly" else reach), abs=0.06)
    assert hit.sum() > 150


def bilinear(values, at, x, z, column, row) -> NDArray:
    u = ((x - at[column - 1]) / (at[column] - at[column - 1])).clip(0, 1)
    v = ((z - at[row - 1]) / (at[row] - at[row - 1])).clip(0, 1)
    upper = values[row - 1, column - 1] * (1 - u) + values[row - 1, column] * u
    lower = values[row, column - 1] * (1 - u) + values[row, column] * u
    return upper * (1 - v) + lower * v


def test_loop_hole_and_cage(usd_scenes):
    """The apex of the octahedron by Loop's weights (1987) at the limit; through the hole the far side is seen, whose
    corners are kept; the cage stays a cube."""
    stage = opened(usd_scenes, "subdivision")
    p, _ = seen(stage, "Loop", 0.2, refineLevel=5)
    beta = (5 / 8 - (3 / 8) ** 2) / 4
    gamma = 1 / (4 + 3 / (8 * beta))
    assert p[:, 1].max() == pytest.approx(1.3 * (1 - 4 * gamma), abs=2e-3)
    # Its rim is the equator, a crease: no point is above it outside.
    p, _ = seen(stage, "Cage", 1.2)
    np.testing.assert_allclose(p[:, 1], 1.0, atol=1e-5)
    assert np.abs(p[:, [0, 2]]).max() == pytest.approx(1.0, abs=0.05)
    turned = UsdGeom.Mesh.Get(stage, "/World/Hole")
    # The face of the hole, z = 1, is turned up.
    UsdGeom.XformCommonAPI(turned).SetRotate((-90, 0, 0))
    points = turned.GetPointsAttr()
    rotated = [Gf.Vec3f(p[0], p[2], -p[1]) for p in points.Get()]
    points.Set(rotated)
    p, _ = seen(stage, "Hole", 1.1, refineLevel=5)
    middle = np.abs(p[:, [0, 2]]).max(1) < 0.3
    assert middle.sum() > 50 and p[middle, 1].max() < -0.5
    assert (np.abs(p[:, 0]) + np.abs(p[:, 2])).max() > 1.85
    points.Set(rotated)
    turned.GetCornerSharpnessesAttr().Set([0.0] * 4)
    turned.GetHoleIndicesAttr().Set([])
    p, _ = seen(stage, "Hole", 1.1, refineLevel=5)
    assert p[:, 1].max() > 0.5 and (np.abs(p[:, 0]) + np.abs(p[:, 2])).max() < 1.6


# Primvars of instances


def test_balls_have_the_tint_and_shine_of_their_place(usd_scenes, tmp_path):
    """The layers of its product, over the discs of the balls; colours in the space of the render, ACEScg."""
    stage = usd_scenes / "primvars.usda"
    assert run("record", stage, tmp_path / "p.exr", "-w", "64", "--samples", "64", "--maxDepth", "1") == 0
    found = channels(tmp_path / "p.exr")
    opened_stage = Usd.Stage.Open(str(stage))
    row = opened_stage.GetPrimAtPath("/World/Row")
    sight = eye(opened_stage)
    ap1 = np.array(
        [
            [0.61309732, 0.33952285, 0.04737928],
            [0.07019422, 0.91635557, 0.01345259],
            [0.02061560, 0.10956983, 0.86981512],
        ]
    )
    tints = np.array(row.GetAttribute("primvars:tint").Get(), float) @ ap1.T
    shines = np.array(row.GetAttribute("primvars:shine").Get(), float)
    tint, shine = np.zeros(sight.d.shape), np.zeros(sight.d.shape[:-1])
    for place, color, value in zip(row.GetAttribute("positions").Get(), tints, shines, strict=True):
        hit = ~np.isnan(sight.sphere(np.array(place, float), 0.55)[..., 0])
        tint[hit], shine[hit] = color, value
    got, expected = np.stack([found[f"tint.{channel}"] for channel in "RGB"], -1), sight.mean(tint)
    np.testing.assert_allclose(got.mean((0, 1)), expected.mean((0, 1)), rtol=0.01)
    np.testing.assert_allclose(got, expected, atol=0.15)
    (name,) = (name for name in found if name.startswith("shine"))
    np.testing.assert_allclose(found[name].mean(), sight.mean(shine).mean(), rtol=0.01)
    np.testing.assert_allclose(found[name], sight.mean(shine), atol=0.15)
