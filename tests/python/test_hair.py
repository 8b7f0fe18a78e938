"""Curves in a hair material: the model written down a second time in numpy, and pictures of it."""

import numpy as np
import pytest
from pxr import Usd, UsdLux, UsdShade

pytest.importorskip("dermis._core", reason="the Rust core is not built")

import dermis
from dermis.emit import HAIR

LIGHTS = """
    def DomeLight "Dome"
    {
        float inputs:intensity = 1
    }
"""
NODES = """
    def Shader "Rough"
    {{
        uniform token info:id = "ND_chiang_hair_roughness"
        float inputs:longitudinal = 0.3
        float inputs:azimuthal = 0.4
        float2 outputs:roughness_R
        float2 outputs:roughness_TT
        float2 outputs:roughness_TRT
    }}
    def Shader "Hair"
    {{
        uniform token info:id = "ND_chiang_hair_bsdf"
        float2 inputs:roughness_R.connect = </World/Look/Rough.outputs:roughness_R>
        float2 inputs:roughness_TT.connect = </World/Look/Rough.outputs:roughness_TT>
        float2 inputs:roughness_TRT.connect = </World/Look/Rough.outputs:roughness_TRT>
        {inputs}
        token outputs:out
    }}
    def Shader "Surface"
    {{
        uniform token info:id = "ND_surface"
        token inputs:bsdf.connect = </World/Look/Hair.outputs:out>
        {surface}
        token outputs:out
    }}
"""


def look(inputs: str = "", surface: str = "", more: str = "") -> str:
    nodes = NODES.format(inputs=inputs, surface=surface)
    return f"""
def Material "Look"
{{
    token outputs:mtlx:surface.connect = </World/Look/Surface.outputs:out>
    {nodes}
    {more}
}}
"""


def fibre(more: str = "", turn: float = 0.0) -> str:
    """A strand along x, two units wide."""
    return f"""
def BasisCurves "Fibre" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    uniform token type = "linear"
    int[] curveVertexCounts = [2]
    point3f[] points = [(-60, 0, 0), (60, 0, 0)]
    float[] widths = [2] (
        interpolation = "constant"
    )
    rel material:binding = </World/Look>
    float3 xformOp:rotateXYZ = (0, {turn}, 0)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    {more}
}}
"""


CAMERA = """
def Camera "main_cam"
{
    token projection = "orthographic"
    float horizontalAperture = 25
    float verticalAperture = 25
    double3 xformOp:translate = (0, 0, 30)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
"""Two and a half units high: there is an eighth of a strand above and below it."""


def world(*prims: str) -> str:
    return 'def Xform "World"\n{' + "\n".join(prims) + "}"


# The model, after the paper.

V = np.array([1.0, 0.25, 4.0, 4.0]) * (0.726 * 0.3 + 0.812 * 0.3**2 + 3.7 * 0.3**20) ** 2
S = np.sqrt(np.pi / 8) * (0.265 * 0.4 + 1.194 * 0.4**2 + 5.372 * 0.4**22)


def shares(h, theta, absorption, ior=1.55):
    """A_p of the four lobes, and gamma_o, gamma_t."""
    gamma_o = np.arcsin(h)
    across = np.sqrt(ior**2 - np.sin(theta) ** 2) / np.cos(theta)
    gamma_t = np.arcsin(h / across)
    cos_t = np.sqrt(1 - (np.sin(theta) / ior) ** 2)
    passed = np.exp(-absorption * 2 * np.cos(gamma_t) / cos_t)
    cos = np.cos(theta) * np.cos(gamma_o)
    root = np.sqrt(1 - (1 - cos**2) / ior**2)
    f = 0.5 * (
        ((cos - ior * root) / (cos + ior * root)) ** 2 + ((ior * cos - root) / (ior * cos + root)) ** 2
    )
    f, one = f + 0 * passed, (1 - f) ** 2 * passed
    return np.array([f, one, one * passed * f, one * (passed * f) ** 2 / (1 - passed * f)]), gamma_o, gamma_t


def scattered(h, theta_o, theta_i, phi, absorption, alpha=0.0):
    """f * cos of the whole strand towards azimuth `phi` from that of sight."""
    a, gamma_o, gamma_t = shares(h, theta_o, absorption)
    total = 0.0
    for p in range(4):
        tilted = theta_o + (0.0 if p == 3 else (2.0, -1.0, -4.0)[p] * alpha)
        x = np.cos(theta_i) * np.cos(tilted) / V[p]
        m = np.i0(x) * np.exp(-np.sin(theta_i) * np.sin(tilted) / V[p]) / (2 * V[p] * np.sinh(1 / V[p]))
        d = phi - (2 * p * gamma_t - 2 * gamma_o + p * np.pi)
        d = d - 2 * np.pi * np.round(d / (2 * np.pi))
        n = np.exp(-np.abs(d) / S) / (S * (1 + np.exp(-np.abs(d) / S)) ** 2) / np.tanh(np.pi / (2 * S))
        total = total + a[p] * m * (1 / (2 * np.pi) if p == 3 else n)
    return total


OFFSETS = (np.arange(4000) + 0.5) / 2000 - 1


def render(make_stage, *prims: str, samples: int = 64, rows: int = 80, **settings):
    camera = CAMERA.replace("25", str(100 / rows), 1)
    image = dermis.render(
        make_stage(world(*prims, camera)), resolution=[4, rows], samples=samples, seed=3, **settings
    )
    assert image.stats["warnings"] == []
    return image


def test_a_clear_strand_is_white(make_stage):
    """The furnace: light that goes through has left, and meets the strand no second time."""
    image = render(make_stage, fibre(), look(), LIGHTS, rows=40)
    inner = image.color[6:-6, :, :3]
    assert inner.mean() == pytest.approx(1.0, abs=4 * inner.std() / np.sqrt(inner.size))
    assert inner.std() < 0.05
    samples = 4 * 40 * 64
    assert image.stats["rays"]["path"] <= 2 * samples


@pytest.mark.parametrize("turn", [0.0, 35.0])
def test_an_absorbing_strand_is_as_bright_as_the_model(make_stage, turn):
    absorption = np.array([0.1, 0.5, 2.0])
    inputs = f"float3 inputs:absorption_coefficient = {tuple(absorption.tolist())}"
    image = render(make_stage, fibre(turn=turn), look(inputs), LIGHTS, samples=512, maxDepth=1)
    a, _, _ = shares(OFFSETS[:, None], np.radians(turn), absorption[None])
    expected = a.sum(0).mean(0)
    # 24 sides are within a third of a percent of their circle.
    assert image.color[..., :3].mean((0, 1)) * 1.25 == pytest.approx(expected, rel=8e-3)


@pytest.mark.parametrize(
    ("behind", "turn", "cuticle"), [(False, 0.0, 0.5), (True, 0.0, 0.5), (True, 20.0, 0.53)]
)
def test_a_distant_light_is_seen_as_the_model_says(make_stage, behind, turn, cuticle):
    """Next-event estimation alone: towards the light through the strand, too."""
    elevation = np.radians(25.0)
    absorption = np.array([0.1, 0.5, 2.0])
    inputs = f"float3 inputs:absorption_coefficient = {tuple(absorption.tolist())}"
    inputs += f"\n float inputs:cuticle_angle = {cuticle}"
    # Shines along -z, turned about x: from above, behind or in front.
    degrees = -155.0 if behind else -25.0
    sun = f"""
def DistantLight "Sun"
{{
    float inputs:angle = 0
    float inputs:intensity = 1
    float3 xformOp:rotateXYZ = ({degrees}, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
}}
"""
    image = render(make_stage, fibre(turn=turn), look(inputs), sun, samples=128)
    # Towards the light, and the strand's own axes: x is the tip.
    light = np.array([0.0, np.sin(elevation), -np.cos(elevation) if behind else np.cos(elevation)])
    angle = np.radians(turn)
    x = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    z = np.array([np.sin(angle), 0.0, np.cos(angle)])
    y = np.array([0.0, 1.0, 0.0])
    # Azimuth counterclockwise about x, from y to z; sight is along z.
    phi = np.arctan2(light @ z, light @ y) - np.pi / 2
    # The normal at height q has azimuth -asin(q) from sight: h = q.
    h = OFFSETS[:, None]
    theta_o, theta_i = np.arcsin(x @ np.array([0.0, 0.0, 1.0])), np.arcsin(light @ x)
    expected = scattered(h, theta_o, theta_i, phi, absorption[None], (cuticle - 0.5) * np.pi)
    assert image.color[..., :3].mean((0, 1)) * 1.25 == pytest.approx(expected.mean(0), rel=1e-2)
    # And where across: thirds from the top, where y is above the axis.
    thirds = image.color[10:70, :, :3].reshape(3, 20, 4, 3).mean((1, 2))
    across = expected[::-1][125:-125].reshape(3, -1, 3).mean(1)
    assert thirds == pytest.approx(across, rel=3e-2, abs=1e-3)


def test_opacity_lets_light_straight_through(make_stage):
    image = render(make_stage, fibre(), look(surface="float inputs:opacity = 0.25"), LIGHTS, samples=256)
    assert image.color[12:-12, :, 3].mean() == pytest.approx(0.25, abs=0.02)


def test_nodes_are_the_formulas_of_their_papers(flat):
    more = """
    def Shader "Melanin"
    {
        uniform token info:id = "ND_deon_hair_absorption_from_melanin"
        float inputs:melanin_concentration = 0.6
        float inputs:melanin_redness = 0.25
        float3 outputs:absorption
    }
"""
    inputs = "float3 inputs:absorption_coefficient.connect = </World/Look/Melanin.outputs:absorption>"
    material = flat(world(look(inputs, more=more), fibre())).prims["/World/Look"]
    assert material["shader"] == HAIR.name
    eumelanin, pheomelanin = np.array([0.419, 0.697, 1.37]), np.array([0.187, 0.4, 1.05])
    expected = -np.log(0.4) * (0.75 * eumelanin + 0.25 * pheomelanin)
    assert material["absorption_coefficient"] == pytest.approx(expected, rel=1e-5)
    for name, factor in (("R", 1.0), ("TT", 0.25), ("TRT", 4.0)):
        expected = [V[0] * factor, S / np.sqrt(np.pi / 8)]
        assert material[f"roughness_{name}"] == pytest.approx(expected, rel=1e-5)
    more = """
    def Shader "Color"
    {
        uniform token info:id = "ND_chiang_hair_absorption_from_color"
        color3f inputs:color = (0.8, 0.4, 0.1)
        float inputs:azimuthal_roughness = 0.4
        float3 outputs:absorption
    }
"""
    inputs = "float3 inputs:absorption_coefficient.connect = </World/Look/Color.outputs:absorption>"
    material = flat(world(look(inputs, more=more), fibre())).prims["/World/Look"]
    fit = np.polyval([0.245, 5.574, -10.73, 2.532, -0.215, 5.969], 0.4)
    expected = (np.log([0.8, 0.4, 0.1]) / fit) ** 2
    assert material["absorption_coefficient"] == pytest.approx(expected, rel=1e-5)


def test_a_mass_of_strands_has_the_colour_asked_for(make_stage):
    """Chiang's eq. 9 is a fit to such renders: a deep mass of strands in even light looks about like the colour."""
    chance = np.random.default_rng(1)
    number = 6000
    roots = chance.uniform([-4, -4, -6], [4, 4, 0], (number, 3))
    ways = chance.normal(0.0, 1.0, (number, 3)) * (1.0, 1.0, 0.15)
    ways *= 4.0 / np.linalg.norm(ways, axis=1, keepdims=True)
    points = np.stack([roots - ways, roots + ways], axis=1).reshape(-1, 3)
    places = ", ".join(f"({x:.3f}, {y:.3f}, {z:.3f})" for x, y, z in points)
    mass = f"""
def BasisCurves "Mass" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    uniform token type = "linear"
    int[] curveVertexCounts = {[2] * number}
    point3f[] points = [{places}]
    float[] widths = [0.12] (
        interpolation = "constant"
    )
    rel material:binding = </World/Look>
}}
"""
    color = np.array([0.7, 0.4, 0.15])
    fit = np.polyval([0.245, 5.574, -10.73, 2.532, -0.215, 5.969], 0.4)
    absorption = (np.log(color) / fit) ** 2
    inputs = f"float3 inputs:absorption_coefficient = {tuple(float(x) for x in absorption)}"
    image = dermis.render(
        make_stage(world(mass, look(inputs), LIGHTS, CAMERA)), resolution=[8, 8], samples=12, maxDepth=200
    )
    # Of the albedo of a mass this is a fit, not a law: no closer than a tenth.
    assert image.color[..., :3].mean((0, 1)) == pytest.approx(color, rel=0.12, abs=0.03)
    assert image["albedo"].mean((0, 1)) == pytest.approx(color, abs=0.02)


def test_hair_is_for_curves(make_stage):
    ball = """
def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    rel material:binding = </World/Look>
    color3f[] primvars:displayColor = [(0.3, 0.2, 0.1)]
}
"""
    image = dermis.render(make_stage(world(ball, look(), LIGHTS, CAMERA)), resolution=[16, 16], samples=16)
    warning = {
        "prim": "/World/Ball",
        "message": "material:binding: /World/Look is for curves; displayColor is used",
    }
    assert warning in image.stats["warnings"]
    assert image.color[6:10, 6:10, 0].mean() > 1.4 * image.color[6:10, 6:10, 1].mean()


def test_what_is_left_out_is_said(flat):
    surface = "token inputs:edf.connect = </World/Look/Rough.outputs:roughness_R>"
    warnings = flat(world(look(surface=surface), fibre())).warnings
    assert ("/World/Look/Surface", "inputs:edf: not supported yet; ignored") in warnings


def test_ribbons_scatter_as_strands(make_stage):
    """A ribbon that faces the camera is the same strand."""
    normals = 'normal3f[] normals = [(0, 0, 1)] (\n interpolation = "constant"\n )'
    absorption = (0.1, 0.5, 2.0)
    inputs = f"float3 inputs:absorption_coefficient = {absorption}"
    image = render(make_stage, fibre(normals), look(inputs), LIGHTS, samples=512, maxDepth=1)
    a, _, _ = shares(OFFSETS[:, None], 0.0, np.array(absorption)[None])
    assert image.color[..., :3].mean((0, 1)) * 1.25 == pytest.approx(a.sum(0).mean(0), rel=1e-2)


def test_a_colour_along_the_strand(make_stage):
    """Absorption driven by a primvar of the curve."""
    more = """
    def Shader "Along"
    {
        uniform token info:id = "ND_geompropvalue_vector3"
        string inputs:geomprop = "dye"
        float3 outputs:out
    }
"""
    inputs = "float3 inputs:absorption_coefficient.connect = </World/Look/Along.outputs:out>"
    primvar = 'float3[] primvars:dye = [(2, 0, 0), (0, 0, 2)] (\n interpolation = "vertex"\n )'
    image = dermis.render(
        make_stage(world(fibre(primvar), look(inputs, more=more), LIGHTS, CAMERA.replace("25", "600", 1))),
        resolution=[60, 2],
        samples=512,
        maxDepth=1,
    )
    assert image.stats["warnings"] == []
    left, right = image.color[0, 4, :3], image.color[0, -5, :3]
    assert left[0] < 0.8 * left[2] and right[2] < 0.8 * right[0]


def test_our_stage_is_white_in_a_furnace(usd_scenes):
    """usd_scenes/hair.usda without melanin in even light: as bright as it is there."""
    stage = Usd.Stage.Open(str(usd_scenes / "hair.usda"))
    stage.SetEditTarget(stage.GetSessionLayer())
    for name in ("Key", "Back", "Floor"):
        stage.GetPrimAtPath(f"/World/{name}").SetActive(False)
    UsdLux.DomeLight(stage.GetPrimAtPath("/World/Dome")).GetIntensityAttr().Set(1.0)
    for name in ("Fair", "Red", "Dark"):
        pigment = UsdShade.Shader(stage.GetPrimAtPath(f"/World/{name}Look/Melanin"))
        pigment.GetInput("melanin_concentration").Set(0.0)
    image = dermis.render(
        stage, resolution=[64, 36], samples=16, maxDepth=200, camera="/World/main_cam", aovs=["variance"]
    )
    assert image.stats["warnings"] == []
    color, there = image.color[..., :3].astype(float), image.color[..., 3].astype(float)
    assert there.mean() > 0.15
    error = np.sqrt(image["variance"].astype(float).sum((0, 1))) / there.size
    assert (np.abs(color.mean((0, 1)) - there.mean()) < 4 * error + 1e-3).all() and error.max() < 0.01
