"""Motion while the shutter is open: pictures against integrals over time that share no code with the renderer, keys
against usd-core's own results.

The camera is orthographic and looks along -Z; 4 pixels are one stage unit. The pixel filter is a tent of radius one
pixel.
"""

from pathlib import Path

import numpy as np
import pytest
from lux_quadrature import Light, irradiance
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom

import dermis
from dermis import hydra
from dermis._core import Delegate
from dermis.stage import FlatStage, Options, flatten

WIDTH, HEIGHT, UNIT = 32, 16, 4
TIMES = 400
"""Of the quadratures: midpoints."""

CAMERA = """#usda 1.0
(
    startTimeCode = 1
    endTimeCode = 2
    timeCodesPerSecond = 24
    metersPerUnit = 1
    upAxis = "Y"
)
def Camera "main_cam"
{
    token projection = "orthographic"
    float horizontalAperture = 80
    float verticalAperture = 40
    float2 clippingRange = (0.1, 100)
    double shutter:open = %s
    double shutter:close = %s
    double3 xformOp:translate%s
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""

SQUARE = """
def Mesh "%s" %s
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points%s
    uniform token subdivisionScheme = "none"
%s
}
"""

CORNERS = "[(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]"

STILL = " = " + CORNERS


def camera(opens: float = -0.5, closes: float = 0.5, translate: str = " = (0, 0, 10)") -> str:
    return CAMERA % (opens, closes, translate)


def square(xform: str = "", points: str = STILL, name: str = "Square", api: str = "") -> str:
    return SQUARE % (name, api, points, xform)


def translated(samples: str, more: str = "") -> str:
    return f"""    double3 xformOp:translate.timeSamples = {{ {samples} }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    {more}"""


def stage_of(text: str) -> Usd.Stage:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(text)
    return Usd.Stage.Open(layer)


def render(text: str, **settings: object) -> dermis.Image:
    settings = {"samples": 4096, "aovs": ["alpha"], "resolution": (WIDTH, HEIGHT), **settings}
    return dermis.render(stage_of(text), time=1.0, **settings)


def alpha(text: str, **settings: object) -> NDArray:
    return render(text, **settings)["alpha"][..., 0]


def flat(text: str, **options: object) -> FlatStage:
    return flatten(stage_of(text), 1.0, Options(**options))


def filtered(covered: object) -> NDArray:
    """Pixels of `covered(x, y)`, coverage of points in stage units, under the filter; 20 x 20 points per pixel."""
    n = 20
    grid = (np.arange(-n, (WIDTH + 1) * n) + 0.5) / n
    rows = (np.arange(-n, (HEIGHT + 1) * n) + 0.5) / n
    x, y = (grid - WIDTH / 2) / UNIT, (HEIGHT / 2 - rows) / UNIT
    fine = covered(x[None, :], y[:, None])
    tent = np.maximum(0.0, 1.0 - np.abs((np.arange(2 * n) + 0.5) / n - 1.0))
    tent /= tent.sum()
    along = np.stack([fine[:, i * n + n // 2 : i * n + n // 2 + 2 * n] @ tent for i in range(WIDTH)], axis=1)
    both = [tent @ along[i * n + n // 2 : i * n + n // 2 + 2 * n] for i in range(HEIGHT)]
    return np.stack(both)


def mean_over_time(covered: object) -> NDArray:
    """Of `covered(t, x, y)`, t from 0 to 1 over the shutter."""
    times = (np.arange(TIMES) + 0.5) / TIMES
    return filtered(lambda x, y: sum(covered(t, x, y) for t in times) / TIMES)


def within(x: NDArray, y: NDArray) -> NDArray:
    return ((np.abs(x) < 0.5) & (np.abs(y) < 0.5)).astype(float)


def assert_same(found: NDArray, expected: NDArray) -> None:
    assert expected.max() > 0.05, "the expected picture shows something"
    assert abs(found.mean() / expected.mean() - 1.0) < 3e-3
    np.testing.assert_allclose(found, expected, atol=0.008)


# Transforms


def test_a_square_that_crosses_the_picture() -> None:
    found = alpha(camera() + square(translated("0: (-3, 0.1, 0), 2: (3, 0.1, 0)")))
    assert_same(found, mean_over_time(lambda t, x, y: within(x - (3.0 * t - 1.5), y - 0.1)))


def test_keys_within_the_shutter_make_the_way_piecewise_linear() -> None:
    text = camera() + square(translated("0.5: (-2, 0, 0), 0.75: (2, 0, 0), 2: (2, 1, 0)"))

    def covered(t: float, x: NDArray, y: NDArray) -> NDArray:
        rest = (0.5 + t - 0.75) / 1.25
        at = (-2.0 + 16.0 * t, 0.0) if t < 0.25 else (2.0, rest)
        return within(x - at[0], y - at[1])

    assert_same(alpha(text), mean_over_time(covered))


def test_a_turn_is_a_turn() -> None:
    """Not the straight way between two matrices, on which a square that turns by 120 degrees shrinks to a half."""
    turn = """    double xformOp:rotateZ.timeSamples = {0: -120, 2: 120}
    double3 xformOp:translate = (1.5, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:rotateZ", "xformOp:translate"]"""

    def covered(t: float, x: NDArray, y: NDArray) -> NDArray:
        c, s = np.cos(np.radians(120.0 * t - 60.0)), np.sin(np.radians(120.0 * t - 60.0))
        return within(c * x + s * y - 1.5, c * y - s * x)

    assert_same(alpha(camera() + square(turn)), mean_over_time(covered))


def test_ancestors_and_resets() -> None:
    child = square(translated("0: (0, -1, 0), 2: (0, 1, 0)"))
    reset = child.replace('["xformOp:translate"]', '["!resetXformStack!", "xformOp:translate"]')
    parent = 'def Xform "P"\n{\n' + translated("0: (-2, 0, 0), 2: (2, 0, 0)") + "%s}\n"
    both = mean_over_time(lambda t, x, y: within(x - (2.0 * t - 1.0), y - (t - 0.5)))
    assert_same(alpha(camera() + parent % child), both)
    assert_same(alpha(camera() + parent % reset), mean_over_time(lambda t, x, y: within(x, y - (t - 0.5))))


def test_a_moving_camera_is_the_world_that_moves_the_other_way() -> None:
    moved = alpha(camera(translate=".timeSamples = {0: (1, 0, 10), 2: (-2, 1, 10)}") + square())
    world = alpha(camera() + square(translated("0: (-1, 0, 0), 2: (2, -1, 0)")))
    # The same random numbers: the same picture but for roundings at edges.
    np.testing.assert_allclose(moved, world, atol=0.004)
    assert_same(world, mean_over_time(lambda t, x, y: within(x - (-0.25 + 1.5 * t), y - (-0.25 - 0.5 * t))))


def test_blur_scale() -> None:
    moving = translated("0: (-2, 0, 0), 2: (2, 0, 0)", "float motion:blurScale = %s")
    half = mean_over_time(lambda t, x, y: within(x - (t - 0.5), y))
    api = '(prepend apiSchemas = ["MotionAPI"])'
    assert_same(alpha(camera() + square(moving % 0.5, api=api)), half)
    assert not moving_prims(flat(camera() + square(moving % 0, api=api)))


# Points


def test_points_that_move() -> None:
    """A square that grows to three times its width, its right half first."""
    grown = "(-0.5, -0.5, 0), (2.5, -0.5, 0), (2.5, 0.5, 0), (-0.5, 0.5, 0)"
    wide = "(-2.5, -0.5, 0), (2.5, -0.5, 0), (2.5, 0.5, 0), (-2.5, 0.5, 0)"
    text = camera() + square(points=f".timeSamples = {{ 0.5: {CORNERS}, 1: [{grown}], 1.5: [{wide}] }}")

    def covered(t: float, x: NDArray, y: NDArray) -> NDArray:
        left, right = -0.5 - 4.0 * max(t - 0.5, 0.0), 0.5 + 4.0 * min(t, 0.5)
        return ((x > left) & (x < right) & (np.abs(y) < 0.5)).astype(float)

    assert_same(alpha(text), mean_over_time(covered))


def test_velocities_beat_the_next_sample() -> None:
    """Another topology at each sample, as simulations write: only velocities say how points move."""
    fast = ", ".join(["(48, 0, 0)"] * 4)
    more = f"    vector3f[] velocities.timeSamples = {{1: [{fast}], 2: [(0, 0, 0)]}}"
    text = camera() + square(more, points=f".timeSamples = {{ 1: {CORNERS}, 2: [(0, 0, 0)] }}")
    assert_same(alpha(text), mean_over_time(lambda t, x, y: within(x - 2.0 * (t - 0.5), y)))


def test_accelerations_are_sampled_by_the_nonlinear_count() -> None:
    more = """    vector3f[] velocities.timeSamples = {1: [(0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0)]}
    vector3f[] accelerations.timeSamples = {1: [(1152, 0, 0), (1152, 0, 0), (1152, 0, 0), (1152, 0, 0)]}
    int motion:nonlinearSampleCount = 5"""
    api = '(prepend apiSchemas = ["MotionAPI"])'
    prim = flat(camera() + square(more, f".timeSamples = {{ 1: {CORNERS} }}", api=api)).prims["/Square"]
    keys = prim["pointKeys"]
    np.testing.assert_allclose(keys["times"], [0, 0.25, 0.5, 0.75, 1])
    at = [points[0, 0] + 0.5 for points in keys["points"]]
    np.testing.assert_allclose(at, [0.25, 0.0625, 0, 0.0625, 0.25], atol=1e-6)


def test_topology_that_changes_is_said() -> None:
    text = camera() + square(points=f".timeSamples = {{ 1: {CORNERS}, 1.25: [(0, 0, 0)] }}")
    found = flat(text)
    assert not moving_prims(found)
    assert [prim for prim, message in found.warnings if "keeps its shape" in message] == ["/Square"]


def test_what_is_not_sampled_is_said() -> None:
    text = camera().replace(
        "float horizontalAperture = 80",
        "float horizontalAperture = 80\n    float fStop.timeSamples = {0: 1, 2: 2}",
    )
    radius = "float inputs:radius.timeSamples = {0: 1, 2: 2}"
    text += f'def SphereLight "L"\n{{\n    {radius}\n    float inputs:intensity = 1\n}}\n'
    text += 'def Sphere "S"\n{\n    double radius.timeSamples = {0: 1, 2: 2}\n}\n'
    color = "color3f[] primvars:displayColor.timeSamples = {0: [(1, 0, 0)], 2: [(0, 1, 0)]}"
    said = dict(flat(text + square(color)).warnings)
    assert said.keys() == {"/main_cam", "/L", "/S", "/Square"}
    assert said["/S"].startswith("radius: not") and said["/Square"].startswith("primvars:displayColor: not")
    assert said["/main_cam"].startswith("fStop: not sampled") and said["/L"].startswith(
        "inputs:radius: not sampled"
    )


def test_surfaces_are_refined_at_each_key() -> None:
    box = """
def Mesh "Box"
{
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    point3f[] points%s
    %s
}
"""
    corners = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    moved = [(x + 1.5, y, z) for x, y, z in corners]
    by_points = box % (f".timeSamples = {{ 0.5: {corners}, 1.5: {moved} }}", "")
    by_matrix = box % (f" = {corners}", translated("0.5: (0, 0, 0), 1.5: (1.5, 0, 0)"))
    first, second = (render(camera() + text, refineLevel=2, samples=64) for text in (by_points, by_matrix))
    assert first["alpha"].max() > 0.9
    np.testing.assert_allclose(first["alpha"], second["alpha"], atol=0.04)
    np.testing.assert_allclose(first.color.mean(), second.color.mean(), rtol=2e-3)


# Instances

INSTANCER = """
def PointInstancer "Many"
{
    rel prototypes = </Many/Square>
    int[] protoIndices = [0, 0]
    point3f[] positions.timeSamples = { 1: [(-1, 0, 0), (1.5, 0, 0)] }
    vector3f[] velocities.timeSamples = { 1: [(24, 0, 0), (0, 12, 0)] }
    vector3f[] accelerations.timeSamples = { 1: [(0, 576, 0), (0, 0, 0)] }
    quath[] orientations.timeSamples = { 1: [(1, 0, 0, 0), (1, 0, 0, 0)] }
    vector3f[] angularVelocities.timeSamples = { 1: [(0, 0, 0), (0, 0, 1440)] }
%s
}
"""


def test_instancers_go_by_their_velocities() -> None:
    stage = stage_of(camera() + INSTANCER % square())
    keys = flatten(stage, 1.0).prims["/Many.prototypes[0].instances"]["transformKeys"]
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Many"))
    times = [Usd.TimeCode(0.5 + share) for share in keys["times"]]
    exclude, ignore = UsdGeom.PointInstancer.ExcludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
    expected = instancer.ComputeInstanceTransformsAtTimes(times, Usd.TimeCode(1.0), exclude, ignore)
    assert len(times) > 5, "the turn of the second"
    for found, matrices in zip(keys["transforms"], expected, strict=True):
        np.testing.assert_allclose(found, np.array(matrices), atol=1e-6)


@pytest.mark.parametrize(
    ("places", "speeds", "moves"),
    [
        (".timeSamples = {1: %s}", ".timeSamples = {1: %s}", True),
        (" = %s", " = %s", False),
        (".timeSamples = {0.75: %s}", ".timeSamples = {1: %s}", False),
        (" = %s", ".timeSamples = {1: %s}", False),
        (".timeSamples = {1: %s}", " = []", False),
    ],
)
def test_velocities_that_have_no_effect_are_said(places: str, speeds: str, moves: bool) -> None:
    fast = "[(24, 0, 0), (24, 0, 0), (24, 0, 0), (24, 0, 0)]"
    velocities = "    vector3f[] velocities" + (speeds.replace("%s", fast))
    still = square(velocities, points=places % CORNERS)
    many = f"""
def PointInstancer "Many"
{{
    rel prototypes = </Many/Square>
    int[] protoIndices = [0, 0, 0, 0]
    point3f[] positions{places % CORNERS}
{velocities}
{square()}
}}
"""
    found = flat(camera() + still + many)
    said = [prim for prim, message in found.warnings if "nothing moves by them" in message]
    assert sorted(said) == ([] if moves or "[]" in speeds else ["/Many", "/Square"])
    assert bool(moving_prims(found)) == moves


def test_the_picture_of_an_instancer() -> None:
    def covered(t: float, x: NDArray, y: NDArray) -> NDArray:
        s = t - 0.5
        c, d = np.cos(np.radians(60.0 * s)), np.sin(np.radians(60.0 * s))
        u, v = x - 1.5, y - 0.5 * s
        # Keys of the parabola are three, as nonlinearSampleCount says without another authored, and those of the turn.
        return within(x + 1.0 - s, y - 0.5 * s * s) + within(c * u + d * v, c * v - d * u)

    assert_same(alpha(camera() + INSTANCER % square()), mean_over_time(covered))


def test_native_instances_share_a_mesh_and_move_apart() -> None:
    place = """
def Xform "%s" (instanceable = true
    references = </Proto>)
{
    double3 xformOp:translate.timeSamples = { %s }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    text = camera() + 'class "Proto"\n{\n' + square() + "}\n"
    text += place % ("A", "0: (-3, 1, 0), 2: (-1, 1, 0)") + place % ("B", "0: (1, -1, 0), 2: (1, 0, 0)")
    image = render(text)
    assert image.stats["needs"]["meshes"] == 1 and image.stats["needs"]["moving_instances"] == 2
    expected = mean_over_time(
        lambda t, x, y: within(x - (-2.5 + t), y - 1.0) + within(x - 1.0, y - (-0.75 + 0.5 * t))
    )
    assert_same(image["alpha"][..., 0], expected)


def test_motion_and_instancing_together() -> None:
    """A prototype that deforms, in an instancer that moves."""
    grown = "(-0.5, -0.5, 0), (1.5, -0.5, 0), (1.5, 0.5, 0), (-0.5, 0.5, 0)"
    proto = square(points=f".timeSamples = {{ 0.5: {CORNERS}, 1.5: [{grown}] }}")
    text = """
def PointInstancer "Many"
{
    rel prototypes = </Many/Square>
    int[] protoIndices = [0, 0]
    point3f[] positions.timeSamples = { 0: [(-3, 1, 0), (0, -1, 0)], 2: [(-2, 1, 0), (0, -1.5, 0)] }
%s
}
"""

    def one(t: float, x: NDArray, y: NDArray) -> NDArray:
        return ((x > -0.5) & (x < 0.5 + t) & (np.abs(y) < 0.5)).astype(float)

    def covered(t: float, x: NDArray, y: NDArray) -> NDArray:
        s = 0.25 + 0.5 * t
        return one(t, x + 3.0 - s, y - 1.0) + one(t, x, y + 1.0 + 0.5 * s)

    assert_same(alpha(camera() + text % proto), mean_over_time(covered))


# Lights

FLOOR = """
def Mesh "Floor" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)]
    uniform token subdivisionScheme = "none"
    rel material:binding = </White>
}
def Material "White"
{
    token outputs:surface.connect = </White/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (1, 1, 1)
        float inputs:roughness = 1
        color3f inputs:specularColor = (0, 0, 0)
        int inputs:useSpecularWorkflow = 1
        token outputs:surface
    }
}
"""

LIGHTS = {
    "RectLight": ({"width": 1.0, "height": 0.5}, 1.0),
    "SphereLight": ({"radius": 0.4}, 1.0),
    "DiskLight": ({"radius": 0.5}, 1.0),
    "DistantLight": ({"intensity": 3.0, "angle": 2.0}, 1.0),
}


def light_text(kind: str, attributes: dict[str, float]) -> str:
    inputs = "\n".join(f"    float inputs:{name} = {value}" for name, value in attributes.items())
    return f"""
def {kind} "Light"
{{
{inputs}
    double3 xformOp:translate.timeSamples = {{0: (-4, 0.5, 1.5), 2: (4, -0.5, 1)}}
    double xformOp:rotateY.timeSamples = {{0: -120, 2: 120}}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]
}}
"""


@pytest.mark.parametrize("kind", LIGHTS)
def test_moving_lights(kind: str) -> None:
    """Irradiance over pi of a floor, against a quadrature over time: the light crosses it and turns by 120 degrees."""
    attributes, _ = LIGHTS[kind]
    text = camera() + FLOOR + light_text(kind, attributes)
    found = render(text, samples=512, maxDepth=0).color[..., 0]
    x = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / UNIT
    y = (HEIGHT / 2 - np.arange(HEIGHT) - 0.5) / UNIT
    # Light of two sides of a pixel's centre: the filter's width is a quarter of a unit, the light far wider.
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 0.0), axis=-1).reshape(-1, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    times, total = (np.arange(32) + 0.5) / 32, 0.0
    for t in times:
        share = 0.25 + 0.5 * t
        matrix = np.array(
            Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 1, 0), -120 + 240 * share))
            * Gf.Matrix4d().SetTranslate(Gf.Vec3d(-4 + 8 * share, 0.5 - share, 1.5 - 0.5 * share))
        )
        total = total + irradiance(Light(kind, attributes, matrix), points, normals, 12)
    expected = (np.asarray(total)[..., 0] / len(times) / np.pi).reshape(HEIGHT, WIDTH)
    assert abs(found.mean() / expected.mean() - 1.0) < 0.01
    bright = expected > 0.2 * expected.max()
    np.testing.assert_allclose(found[bright], expected[bright], rtol=0.08)


def test_a_dome_that_turns_about_its_pole_gives_the_mean() -> None:
    """A light of one colour all around is not changed by its turn."""
    dome = """
def DomeLight "Sky"
{
    float inputs:intensity = 1
    double xformOp:rotateY.timeSamples = {0: 0, 2: 200}
    uniform token[] xformOpOrder = ["xformOp:rotateY"]
}
"""
    found = render(camera() + FLOOR + dome, samples=64, maxDepth=0).color[..., 0]
    np.testing.assert_allclose(found.mean(), 1.0, rtol=5e-3)


def test_lights_seen_by_the_camera_are_blurred() -> None:
    light = """
def RectLight "Light"
{
    float inputs:width = 1
    float inputs:height = 1
    bool inputs:visibility:camera = 1
    matrix4d xformOp:transform.timeSamples = {
        0: ((-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 0), (-2, 0, 0, 1)),
        2: ((-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, 0), (2, 0, 0, 1)) }
    uniform token[] xformOpOrder = ["xformOp:transform"]
}
"""
    found = render(camera() + light).color[..., 0]
    assert_same(found, mean_over_time(lambda t, x, y: within(x - (2.0 * t - 1.0), y)))


# Media

BALL = """
def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    double radius = 1
    rel material:binding = </Wax>
    double3 xformOp:translate%s
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Material "Wax"
{
    token outputs:surface.connect = </Wax/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        color3f inputs:subsurfaceColor = (0.8, 0.5, 0.3)
        color3f inputs:subsurfaceRadius = (0.5, 0.3, 0.2)
        token inputs:subsurfaceBoundary = "%s"
        float inputs:roughness = %s
        token outputs:surface
    }
}
%s
"""

SUN = """
def DistantLight "Sun"
{
    float inputs:intensity = 3
    float inputs:angle = 10
    double xformOp:rotateY = 40
    uniform token[] xformOpOrder = ["xformOp:rotateY"]
}
"""

DOME = """
def DomeLight "Sky"
{
    float inputs:intensity = 1
}
"""

BODIES = {
    "diffuse": ("diffuse", 0.5, SUN, ("classical", "mixture"), 64),
    "matched": ("indexMatched", 0.5, SUN, ("classical", "mixture"), 64),
    "rough": ("dielectric", 0.4, DOME, ("classical", "mixture"), 64),
    "smooth": ("dielectric", 0.0, DOME, ("classical", "mixture"), 64),
    "refracted": ("dielectric", 0.0, SUN, ("classical",), 512),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_translucent_body_that_moves_gives_as_much_light(name: str) -> None:
    """All light of the picture is that of the body at rest, by classical walks and by guided ones; that of the sun,
    refracted, is searched for (`refractedLight`)."""
    boundary, roughness, light, walks, samples = BODIES[name]
    settings = {"refractedLight": "on"} if name == "refracted" else {}

    def lights(translate: str, walk: str) -> tuple[float, float]:
        text = camera() + BALL % (translate, boundary, roughness, light)
        images = [render(text, samples=samples, walk=walk, seed=seed, **settings) for seed in range(6)]
        sums = [image.color[..., :3].mean() for image in images]
        return float(np.mean(sums)), float(np.std(sums, ddof=1) / np.sqrt(len(sums)))

    still, error = lights(" = (0, 0, 0)", "classical")
    for walk in walks:
        moving, own = lights(".timeSamples = {0: (-2, 0.3, 0), 2: (2, -0.3, 0)}", walk)
        spread = np.hypot(error, own)
        assert spread < (0.03 if name == "refracted" else 0.012) * still
        assert abs(moving - still) < 4.5 * spread, f"{walk}: {moving / still} +- {spread / still}"


def test_a_translucent_body_that_deforms_gives_what_its_shapes_give() -> None:
    """The mean of two halves of the shutter, which is far from the mean of two shapes where one is twice as wide: eight
    shapes are quadrature enough."""
    ring = [(float(np.cos(a)), float(np.sin(a))) for a in np.arange(12) * np.pi / 6]

    def points(wide: float) -> str:
        return str([(wide * x, y, z) for z in (-0.5, 0.5) for x, y in ring])

    sides = [str([i, (i + 1) % 12, 12 + (i + 1) % 12, 12 + i]) for i in range(12)]
    faces = ", ".join(s.strip("[]") for s in [*sides, str(list(range(11, -1, -1))), str(list(range(12, 24)))])
    prism = f"""
def Mesh "Prism" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    int[] faceVertexCounts = {[4] * 12 + [12, 12]}
    int[] faceVertexIndices = [{faces}]
    point3f[] points%s
    uniform token subdivisionScheme = "none"
    rel material:binding = </Wax>
}}
"""
    wax = BALL[BALL.index("def Material") :] % ("diffuse", 0.5, SUN)

    def light(samples: str, seed: int, walk: str) -> float:
        text = camera() + prism % samples + wax
        return float(render(text, samples=64, seed=seed, walk=walk).color[..., :3].mean())

    still = [
        np.mean([light(f" = {points(1 + (i + 0.5) / 8)}", s, "classical") for i in range(8)])
        for s in range(4)
    ]
    for walk in ("classical", "mixture"):
        moving = [
            light(f".timeSamples = {{0.5: {points(1.0)}, 1.5: {points(2.0)}}}", seed, walk)
            for seed in range(6)
        ]
        error = np.hypot(np.std(still, ddof=1) / 2.0, np.std(moving, ddof=1) / np.sqrt(6.0))
        assert error < 0.01 * np.mean(still)
        assert abs(np.mean(moving) - np.mean(still)) < 4.5 * error, (
            f"{walk}: {np.mean(moving) / np.mean(still)}"
        )


# Switches, AOVs, edits

MOVING = square(translated("0: (-2, 0.5, 0), 2: (2, 1.5, 0)"))


def moving_prims(found: FlatStage) -> list[str]:
    return [key for key, prim in found.prims.items() if "transformKeys" in prim or "pointKeys" in prim]


def test_a_closed_shutter_is_no_blur() -> None:
    closed = render(camera(0.0, 0.0) + MOVING)
    assert not moving_prims(flat(camera(0.0, 0.0) + MOVING))
    switched_off = render(camera() + MOVING, disableMotionBlur=True)
    for name in ("color", "alpha"):
        np.testing.assert_array_equal(closed[name], switched_off[name])
    assert not np.array_equal(closed["alpha"], render(camera() + MOVING)["alpha"])


@pytest.mark.parametrize("name", ["disableMotionBlur", "instantaneousShutter"])
def test_settings_of_the_stage_switch_it_off(name: str) -> None:
    settings = f"""
def RenderSettings "S"
{{
    uniform bool {name} = 1
    rel camera = </main_cam>
}}
"""
    found = flatten(stage_of(camera() + MOVING + settings), 1.0, Options(render_settings="/S"))
    assert found.settings["disableMotionBlur"] is True and not moving_prims(found)


def test_threads_do_not_matter() -> None:
    one, two = (render(camera() + MOVING, samples=8, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.color, two.color)


def test_motion_vectors_are_pixels_over_the_shutter() -> None:
    for off in (False, True):
        image = render(camera() + MOVING, samples=16, aovs=["motionVector", "alpha"], disableMotionBlur=off)
        hit = image["alpha"][..., 0] > (0.999 if off else 0.3)
        # 2 units to the right and half a unit up are 8 and 2 pixels.
        np.testing.assert_allclose(image["motionVector"][hit], np.tile([8.0, 2.0], (hit.sum(), 1)), atol=1e-3)
    still = render(
        camera(translate=".timeSamples = {0: (-2, 0, 10), 2: (2, 0, 10)}") + square(), aovs=["motionVector"]
    )
    np.testing.assert_allclose(still["motionVector"][8, 16], [-8.0, 0.0], atol=1e-3)


ALL_THAT_MOVES = (
    square(
        """    float xformOp:rotateZ.timeSamples = { 0: 0, 2: 140 }
    double3 xformOp:translate.timeSamples = { 0: (-2, 0, 0), 1.2: (0.3, 0.4, 0), 2: (1, 1, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]""",
        f".timeSamples = {{ 0: {CORNERS}, 1: {CORNERS.replace('0.5, 0.5, 0', '0.7, 0.9, 0.2')}, 2: {CORNERS} }}",
    )
    + """
def SphereLight "Lamp"
{
    float inputs:intensity = 40
    double3 xformOp:translate.timeSamples = { 0: (-2, 1, 3), 2: (2, 2, 3) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
)


@pytest.mark.parametrize("shutter", [(-0.5, 0.5), (0.0, 0.6), (0.2, 0.7)])
def test_vectors_of_a_sharp_picture_leave_it_as_it_is(shutter: tuple[float, float]) -> None:
    """Bit for bit that of the frame, wherever it is in the shutter; the vectors are those of the blurred one."""
    text = camera(*shutter, translate=".timeSamples = {0: (-0.3, 0, 10), 2: (0.3, 0.2, 10)}") + ALL_THAT_MOVES
    settings = {"samples": 32, "disableMotionBlur": True}
    plain = render(text, **settings, aovs=["alpha", "normal", "depth"])
    vectors = render(text, **settings, aovs=["alpha", "normal", "depth", "motionVector"])
    frame = render(text.replace("shutter:", "off:"), samples=32, aovs=["alpha", "normal", "depth"])
    for name in ("color", "alpha", "normal", "depth"):
        np.testing.assert_array_equal(vectors[name], plain[name])
        np.testing.assert_array_equal(vectors[name], frame[name])
    blurred = render(text, samples=4096, aovs=["alpha", "motionVector"])
    middle = vectors["alpha"][..., 0] > 0.999
    assert middle.sum() > 4 and np.abs(vectors["motionVector"]).max() > 2.0
    # Both are of points of one square that turns: what the pixel shows differs, but not by the size of the square.
    span = np.ptp(vectors["motionVector"][middle], axis=0)
    off = vectors["motionVector"][middle].mean(axis=0) - blurred["motionVector"][
        blurred["alpha"][..., 0] > 0.4
    ].mean(axis=0)
    assert (np.abs(off) < 0.5 * span + 0.5).all()


HIDDEN = {
    "prim": """def Xform "Rig"
{
    token visibility = "invisible"
    double3 xformOp:translate.timeSamples = {0: (-2, 0, 10), 2: (2, 0, 10)}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    %s
}
""",
    "instance": """class Xform "Source"
{
    %s
}
def Xform "Rig" (
    instanceable = true
    references = </Source>
)
{
    token visibility = "invisible"
    double3 xformOp:translate.timeSamples = {0: (-2, 0, 10), 2: (2, 0, 10)}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
""",
}


@pytest.mark.parametrize("kind", HIDDEN)
def test_cameras_move_in_what_is_invisible(kind: str) -> None:
    eye = (
        camera().split(")\n", 1)[1].replace("xformOp:translate = (0, 0, 10)", "xformOp:translate = (0, 0, 0)")
    )
    head = camera().split("def Camera")[0]
    seen = alpha(camera(translate=".timeSamples = {0: (-2, 0, 10), 2: (2, 0, 10)}") + square())
    hidden = stage_of(head + HIDDEN[kind] % eye + square())
    assert "transformKeys" in flatten(hidden, 1.0, Options(camera="/Rig/main_cam")).prims["/Rig/main_cam"]
    for name in ("/Rig/main_cam", "main_cam", ""):
        chosen = {"camera": name} if name else {}
        found = dermis.render(
            hidden, time=1.0, samples=4096, aovs=["alpha"], resolution=(WIDTH, HEIGHT), **chosen
        )
        np.testing.assert_array_equal(found["alpha"][..., 0], seen)


def test_edits_give_the_image_of_a_fresh_load() -> None:
    grown = CORNERS.replace("0.5, 0)]", "0.9, 0)]")
    text = camera() + square(
        translated("0: (-2, 0, 0), 1: (0, 0, 0), 2: (1, 1, 0), 3: (2, 1, 0)"),
        f".timeSamples = {{ 1: {CORNERS}, 2: {grown}, 3: {CORNERS} }}",
    )
    stage = stage_of(text)
    frames = [flatten(stage, time) for time in (1.0, 2.0, 3.0)]
    for frame in frames:
        frame.settings |= {
            "camera": "/main_cam",
            "resolution": [WIDTH, HEIGHT],
            "samples": 4,
            "aovs": ["alpha"],
        }
    kept, previous = Delegate(), None
    for frame in frames:
        hydra.populate(kept, frame, previous)
        previous = frame
        fresh = Delegate()
        hydra.populate(fresh, frame)
        images = []
        for delegate in (kept, fresh):
            delegate.commit()
            delegate.start()
            delegate.wait(60.0)
            images.append(delegate.snapshot()["color"])
        np.testing.assert_array_equal(*images)


def test_a_dermis_file_keeps_the_motion(tmp_path: Path) -> None:
    frame = flat(camera() + MOVING)
    frame.settings |= {"camera": "/main_cam", "resolution": [WIDTH, HEIGHT]}
    delegate = Delegate()
    hydra.populate(delegate, frame)
    delegate.commit()
    delegate.save(str(tmp_path / "moving.dermis"))
    stored = dermis.render(tmp_path / "moving.dermis", samples=16, aovs=["alpha"])
    np.testing.assert_array_equal(stored["alpha"], render(camera() + MOVING, samples=16)["alpha"])


def test_a_mesh_light_whose_size_changes_does_not_shade_itself() -> None:
    """It shines, and stands, with the size of the frame: as one that stays."""

    def box(scale: str) -> str:
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        points = [(x, y, z) for z in (-0.3, 0.3) for y in (-0.3, 0.3) for x in (-0.3, 0.3)]
        return f"""
def Mesh "Lamp" (prepend apiSchemas = ["MeshLightAPI"])
{{
    int[] faceVertexCounts = {[4] * 6}
    int[] faceVertexIndices = {[i for side in sides for i in side[::-1]]}
    point3f[] points = {points}
    uniform token subdivisionScheme = "none"
    float inputs:intensity = 4
    double3 xformOp:translate.timeSamples = {{ 0: (-1, 0, 1.5), 2: (1, 0, 1.5) }}
    double3 xformOp:scale{scale}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}
"""

    grows, stays = (
        render(camera() + FLOOR + box(scale), samples=1024, maxDepth=0).color[..., 0]
        for scale in (".timeSamples = { 0: (0.2, 0.2, 0.2), 2: (1.8, 1.8, 1.8) }", " = (1, 1, 1)")
    )
    floor = np.abs((np.arange(WIDTH) + 0.5 - WIDTH / 2) / UNIT) > 1.6
    assert stays[:, floor].mean() > 0.01
    np.testing.assert_allclose(grows[:, floor].mean(), stays[:, floor].mean(), rtol=5e-3)
    np.testing.assert_allclose(grows, stays, rtol=0.1, atol=0.01)
