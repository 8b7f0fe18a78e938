"""Displacement against surfaces that are known: a larger sphere, a slope, a body that stays closed."""

from __future__ import annotations

import numpy as np
import pytest
from looked_up import images_of_edits, reader, shader, stage_of
from test_textures import write

dermis = pytest.importorskip("dermis")
from dermis.hydra import populate  # noqa: E402
from dermis.stage import flatten, open_stage  # noqa: E402

SAID = "displacement moves the"


def look(displacement: str, nodes: str = "", more: str = "") -> str:
    """A UsdPreviewSurface whose displacement is that of its material."""
    surface = shader(
        "S",
        "UsdPreviewSurface",
        f"float inputs:displacement{displacement}",
        "token outputs:surface",
        "token outputs:displacement",
        more,
    )
    outputs = "".join(
        f"    token outputs:{name}.connect = </Look/S.outputs:{name}>\n"
        for name in ("surface", "displacement")
    )
    return f'def Material "Look"\n{{\n{outputs}{surface}{nodes}}}\n'


def bound(prim: str, lines: str) -> str:
    return (
        f'def {prim} (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n{{\n'
        f"    rel material:binding = </Look>\n{lines}\n}}\n"
    )


CAMERA = """
def Camera "Eye"
{
    token projection = "orthographic"
    float2 clippingRange = (0.1, 100)
    float horizontalAperture = 40
    float verticalAperture = 40
    double3 xformOp:translate = (0, 0, 10)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def rendered(text: str, **settings: object) -> dermis.Image:
    settings = {"resolution": [64, 64], "samples": 1, "aovs": ["depth", "normal", "position"], **settings}
    return dermis.render(stage_of(text + CAMERA), camera="/Eye", **settings)


def said(image: dermis.Image) -> list[str]:
    return [warning["message"] for warning in image.stats["warnings"]]


def sphere(radius: float) -> str:
    return bound('Sphere "Ball"', f"    double radius = {radius}")


def test_a_displaced_sphere_is_a_larger_sphere():
    moved = rendered(sphere(1.25) + look(" = 0.5"))
    wanted = rendered(sphere(1.75) + look(" = 0"))
    hit = wanted["depth"] < 1e29
    assert hit.sum() > 1000 and np.array_equal(hit, moved["depth"] < 1e29)
    np.testing.assert_allclose(moved["depth"][hit], wanted["depth"][hit], atol=2e-6)
    np.testing.assert_allclose(moved["normal"], wanted["normal"], atol=2e-5)
    assert any(text.startswith(SAID) for text in said(moved)) and said(wanted) == []


def test_object_units_are_those_before_the_transform():
    """Twice as large, so that 0.25 is half a unit of the world."""
    scaled = '    double3 xformOp:scale = (2, 2, 2)\n    uniform token[] xformOpOrder = ["xformOp:scale"]\n'
    moved = rendered(bound('Sphere "Ball"', f"    double radius = 0.5\n{scaled}") + look(" = 0.25"))
    wanted = rendered(sphere(1.5) + look(" = 0"))
    hit = wanted["depth"] < 1e29
    np.testing.assert_allclose(moved["depth"][hit], wanted["depth"][hit], atol=2e-6)


def quad(scheme: str) -> str:
    lines = (
        "    int[] faceVertexCounts = [4]\n    int[] faceVertexIndices = [0, 1, 2, 3]\n"
        "    point3f[] points = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]\n"
        f'    uniform token subdivisionScheme = "{scheme}"\n'
        "    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (\n"
        '        interpolation = "faceVarying"\n    )\n'
    )
    return bound('Mesh "Quad"', lines)


def texture(file: object, *lines: str) -> str:
    return reader() + shader(
        "T",
        "UsdUVTexture",
        f"asset inputs:file = @{file}@",
        "float2 inputs:st.connect = </Look/R.outputs:result>",
        'token inputs:sourceColorSpace = "raw"',
        'token inputs:wrapS = "clamp"',
        'token inputs:wrapT = "clamp"',
        *lines,
        "float outputs:r",
    )


DRIVEN = ".connect = </Look/T.outputs:r>"


@pytest.mark.parametrize("scheme", ["bilinear", "catmullClark"])
def test_a_ramp_makes_a_slope(tmp_path, scheme):
    """z = 3 s - 1 over 4 units of s: the slope is 3/4, the normal (-3, 0, 4) / 5."""
    texels = ((np.arange(256) + 0.5) / 256)[None, :, None]
    file = write(tmp_path / "ramp.exr", texels, "float")
    nodes = texture(file, "float4 inputs:scale = (3, 3, 3, 1)", "float4 inputs:bias = (-1, -1, -1, 0)")
    moved = rendered(quad(scheme) + look(DRIVEN, nodes), refineLevel=6)
    # Samples at the rim may pass the quad, and a coarse level of the ramp ends before the ramp does.
    inner = np.s_[1:-1, 4:-4]
    x, _, z = np.moveaxis(moved["position"][inner].astype(np.float64), -1, 0)
    np.testing.assert_allclose(z, 0.75 * x + 0.5, atol=1e-4)
    wanted = np.broadcast_to([-0.6, 0.0, 0.8], (*z.shape, 3))
    np.testing.assert_allclose(moved["normal"][inner], wanted, atol=1e-3)
    assert said(moved) == []


def cube(more: str = "") -> str:
    """A cage with the same st on each of its faces."""
    faces = [0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4, 2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6]
    points = [tuple(2 * (i >> k & 1) - 1 for k in range(3)) for i in range(8)]
    st = ", ".join(["(0, 0), (1, 0), (1, 1), (0, 1)"] * 6)
    lines = (
        f"    int[] faceVertexCounts = {[4] * 6}\n    int[] faceVertexIndices = {faces}\n"
        f"    point3f[] points = {points}\n"
        f'    texCoord2f[] primvars:st = [{st}] (\n        interpolation = "faceVarying"\n    )\n{more}'
    )
    return bound('Mesh "Cube"', lines)


WAX = "float inputs:subsurface = 1\n        color3f inputs:subsurfaceRadius = (0.2, 0.2, 0.2)"
DOME = 'def DomeLight "Sky"\n{\n}\n'


def test_a_body_with_seams_stays_closed(tmp_path):
    rng = np.random.default_rng(3)
    file = write(tmp_path / "bumps.png", rng.random((16, 16, 1)))
    nodes = texture(file, "float4 inputs:scale = (0.3, 0.3, 0.3, 1)")
    image = rendered(cube() + DOME + look(DRIVEN, nodes, WAX), refineLevel=4, samples=16)
    assert image.stats["walks"] > 10_000 and image.stats["walks_leaked"] == 0
    assert said(image) == []


def test_edits_give_the_image_of_a_fresh_load():
    texts = [cube() + look(f" = {value}") + CAMERA for value in (0.0, 0.3, 0.1)]
    for built, edited, fresh in images_of_edits(
        texts, resolution=[32, 32], samples=1, refineLevel=2, aovs=["depth"]
    ):
        assert built == 1 and np.array_equal(edited["depth"], fresh["depth"])


def test_an_image_that_is_painted_over_displaces_anew(tmp_path):
    images = []
    for i in range(2):
        file = write(tmp_path / f"{i}.exr", np.full((4, 4, 1), 0.1 + 0.2 * i), "float")
        images.append(cube() + look(DRIVEN, texture(file)) + CAMERA)
    depths = []
    for built, edited, fresh in images_of_edits(
        images, resolution=[32, 32], samples=1, refineLevel=2, aovs=["depth"]
    ):
        assert built == 1 and np.array_equal(edited["depth"], fresh["depth"])
        depths.append(edited["depth"].min())
    assert depths[1] == pytest.approx(depths[0] - 0.2, abs=1e-3)


def test_what_displaces_is_in_the_file(tmp_path):
    text = tmp_path / "a.usda"
    text.write_text("#usda 1.0\n" + cube() + look(" = 0.3") + CAMERA)
    settings = {"resolution": [32, 32], "samples": 1, "camera": "/Eye", "refineLevel": 2, "aovs": ["depth"]}
    core = dermis._core.Delegate()
    populate(core, flatten(open_stage(text)))
    core.save(tmp_path / "a.dermis")
    images = [dermis.render(file, **settings)["depth"] for file in (text, tmp_path / "a.dermis")]
    assert np.array_equal(*images)


def test_materialx_scales_its_displacement():
    nodes = shader(
        "D",
        "ND_displacement_float",
        "float inputs:displacement = 0.25",
        "float inputs:scale = 2",
        "token outputs:out",
    )
    surface = shader("S", "UsdPreviewSurface", "float inputs:displacement = 9", "token outputs:surface")
    text = (
        'def Material "Look"\n{\n    token outputs:surface.connect = </Look/S.outputs:surface>\n'
        f"    token outputs:mtlx:displacement.connect = </Look/D.outputs:out>\n{surface}{nodes}}}\n"
    )
    moved = rendered(sphere(1.25) + text)
    wanted = rendered(sphere(1.75) + look(" = 0"))
    hit = wanted["depth"] < 1e29
    np.testing.assert_allclose(moved["depth"][hit], wanted["depth"][hit], atol=2e-6)


def test_what_does_not_displace_is_said():
    vector = shader(
        "D", "ND_displacement_vector3", "vector3f inputs:displacement = (0, 0, 1)", "token outputs:out"
    )
    text = f'def Material "Look"\n{{\n    token outputs:displacement.connect = </Look/D.outputs:out>\n{vector}}}\n'
    messages = said(rendered(sphere(1.0) + text))
    assert any("ND_displacement_vector3" in text and "nothing is displaced" in text for text in messages)
    unconnected = 'def Material "Look"\n{\n    token outputs:surface.connect = </Look/S.outputs:surface>\n'
    unconnected += (
        shader("S", "UsdPreviewSurface", "float inputs:displacement = 1", "token outputs:surface") + "}\n"
    )
    messages = said(rendered(sphere(1.0) + unconnected))
    assert any("inputs:displacement" in text and "is not connected" in text for text in messages)
