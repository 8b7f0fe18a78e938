"""renderingColorSpace: colours are brought to it once, are multiplied there, and the file says which it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from looked_up import camera, glowing, middles, primvar, quads, reader, render, shader, stage_of
from test_textures import srgb, write

dermis = pytest.importorskip("dermis")
oiio = pytest.importorskip("OpenImageIO")
from dermis.cli import main  # noqa: E402
from dermis.color import DisplayTransform  # noqa: E402
from dermis.colorspace import chromaticities, linear_name  # noqa: E402
from dermis.stage import flatten  # noqa: E402

# Linear Rec.709 to ACEScg and Rec.2020 (Bradford; ITU-R BT.2087), by other hands than usd-core's.
AP1 = np.array(
    [
        [0.61309732, 0.33952285, 0.04737928],
        [0.07019422, 0.91635557, 0.01345259],
        [0.02061560, 0.10956983, 0.86981512],
    ]
)
REC2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
SPACES = {"lin_ap1_scene": AP1, "ACEScg": AP1, "lin_rec2020_scene": REC2020}

RED = (0.7, 0.1, 0.05)


def lit(
    space: str, material: str = "", light: str = "", color: str = f"color3f[] primvars:displayColor = [{RED}]"
):
    """A white sheet of light over a diffuse square: beauty at its middle."""
    square = (
        'def Mesh "Row"\n{\n    int[] faceVertexCounts = [4]\n    int[] faceVertexIndices = [0, 1, 2, 3]\n'
        "    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]\n"
        f'    uniform token subdivisionScheme = "none"\n    {color}\n{material}\n}}\n'
    )
    sky = f'def DomeLight "Sky"\n{{\n{light}\n}}\n'
    settings = {"renderingColorSpace": space} if space else {}
    image = render(square + sky, 1, samples=64, maxDepth=1, **settings)
    return image["color"][1, 1, :3].astype(np.float64)


@pytest.mark.parametrize("space", SPACES)
def test_a_single_bounce_is_the_matrix_of_what_it_was(space):
    """Diffuse and specular are both linear in what the colours are for one bounce of white light."""
    np.testing.assert_allclose(lit(space), SPACES[space] @ lit(""), rtol=2e-3)


def test_white_stays_white():
    white = "color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]"
    np.testing.assert_allclose(lit("ACEScg", color=white), lit("", color=white), rtol=1e-5)


def test_products_of_colours_are_those_of_the_space():
    """A red light on a red surface is darker in another way in each space: the product of what both are there."""
    light = f"    color3f inputs:color = {RED}"
    got = lit("ACEScg", light=light)
    # The surface under light of each channel alone, in the space.
    white = lit("ACEScg")
    np.testing.assert_allclose(got, white * (AP1 @ RED), rtol=2e-3)


def test_authored_spaces_count_without_one_to_render_in():
    """On the attribute, on the prim, and above it; srgb with its curve."""
    plain, light = lit(""), '    color3f inputs:color = (0.3, 0.6, 0.2) (colorSpace = "lin_ap1_scene")'
    inverse = np.linalg.inv(AP1)
    np.testing.assert_allclose(lit("", light=light), plain * (inverse @ [0.3, 0.6, 0.2]), rtol=2e-3)
    encoded = f'color3f[] primvars:displayColor = [{RED}] (colorSpace = "srgb_rec709_scene")'
    decoded = f"color3f[] primvars:displayColor = [{tuple(float(x) for x in srgb(np.array(RED)))}]"
    np.testing.assert_allclose(lit("", color=encoded), lit("", color=decoded), rtol=1e-5)
    above = (
        'def Xform "X" (prepend apiSchemas = ["ColorSpaceAPI"])\n{\n'
        '    uniform token colorSpace:name = "lin_ap1_scene"\n'
        '    def SphereLight "L"\n    {\n        color3f inputs:color = (0.3, 0.6, 0.2)\n    }\n}\n'
    )
    color = flatten(stage_of(above)).prims["/X/L"]["color"]
    np.testing.assert_allclose(color, inverse @ [0.3, 0.6, 0.2], rtol=1e-5)


def glow(nodes: str, source: str, **settings: object) -> np.ndarray:
    corners = primvar("st", "texCoord2f", [(0.5, 0.5)]) + "\n" + primvar("tint", "color3f", [RED])
    return middles(render(glowing(nodes, source) + quads(1, corners), 1, **settings), 1)[0]


@pytest.mark.parametrize("kind", ["u8", "half"])
def test_images_networks_and_primvars(tmp_path, kind):
    space = {"renderingColorSpace": "ACEScg"}
    file = write(
        tmp_path / f"a.{'png' if kind == 'u8' else 'exr'}", np.full((4, 4, 3), 0.5) * [1.0, 0.5, 0.25], kind
    )

    def sampled(said: str) -> str:
        return reader() + shader(
            "T",
            "UsdUVTexture",
            f"asset inputs:file = @{file}@",
            "float2 inputs:st.connect = </Look/R.outputs:result>",
            f'token inputs:sourceColorSpace = "{said}"',
            "float3 outputs:rgb",
        )

    for said in ("sRGB", "raw"):
        plain = glow(sampled(said), "T.outputs:rgb")
        wanted = AP1 @ plain if said == "sRGB" else plain
        np.testing.assert_allclose(glow(sampled(said), "T.outputs:rgb", **space), wanted, rtol=1e-3)
    tint = reader(varname="tint", kind="float3")
    np.testing.assert_allclose(glow(tint, "R.outputs:result", **space), AP1 @ RED, rtol=1e-5)
    constant = shader("C", "ND_constant_color3", f"color3f inputs:value = {RED}", "color3f outputs:out")
    np.testing.assert_allclose(glow(constant, "C.outputs:out", **space), AP1 @ RED, rtol=1e-5)
    vector = shader("C", "ND_constant_vector3", f"vector3f inputs:value = {RED}", "vector3f outputs:out")
    np.testing.assert_allclose(glow(vector, "C.outputs:out", **space), RED, rtol=1e-5)


def test_temperatures_and_mean_free_paths():
    text = (
        'def SphereLight "L"\n{\n    bool inputs:enableColorTemperature = 1\n'
        "    float inputs:colorTemperature = 3000\n}\n"
        + glowing("", "S.outputs:surface").replace(
            "color3f inputs:emissiveColor.connect = </Look/S.outputs:surface>",
            "color3f inputs:subsurfaceRadius = (1, 0.5, 0.2)\n        color3f inputs:subsurfaceColor = (0.9, 0.5, 0.2)",
        )
        + quads(1, "")
        + 'def RenderSettings "R"\n{\n    token renderingColorSpace = "lin_ap1_scene"\n}\n'
    )
    stage = stage_of(text)
    stage.SetMetadata("renderSettingsPrimPath", "/R")
    plain = flatten(stage_of(text)).prims
    flat = flatten(stage)
    assert flat.settings["renderingColorSpace"] == "lin_ap1_scene" and flat.warnings == []
    np.testing.assert_allclose(flat.prims["/L"]["blackbody"], AP1 @ plain["/L"]["blackbody"], rtol=1e-5)
    assert flat.prims["/Look"]["subsurfaceRadius"] == [1.0, 0.5, pytest.approx(0.2)]
    np.testing.assert_allclose(flat.prims["/Look"]["subsurfaceColor"], AP1 @ [0.9, 0.5, 0.2], rtol=1e-5)


def recorded(tmp_path: Path, space: str, *flags: str) -> tuple[np.ndarray, dict, np.ndarray]:
    settings = (
        f'def RenderSettings "R"\n{{\n    rel camera = </Eye>\n    token renderingColorSpace = "{space}"\n'
        "    int2 resolution = (12, 12)\n}\n"
    )
    stage = tmp_path / f"{space}.usda"
    body = glowing(
        shader("C", "ND_constant_color3", f"color3f inputs:value = {RED}", "color3f outputs:out"),
        "C.outputs:out",
    )
    head = '#usda 1.0\n(\n    renderSettingsPrimPath = "/R"\n)\n'
    stage.write_text(head + body + quads(1, "") + camera(1) + settings)
    out, shown = tmp_path / f"{space}.exr", tmp_path / f"{space}.png"
    assert main(["record", str(stage), str(out), "--displayImage", str(shown), "--samples", "1", *flags]) == 0
    image = oiio.ImageBuf(str(out))
    attributes = {a.name: a.value for a in image.spec().extra_attribs}
    pixels = oiio.ImageBuf(str(shown)).get_pixels(oiio.FLOAT)[6, 6, :3]
    return image.get_pixels(oiio.FLOAT)[6, 6, :3], attributes, pixels


def test_the_file_says_its_primaries_and_the_picture_for_eyes_is_the_same(tmp_path):
    plain, says_plain, shown_plain = recorded(tmp_path, "lin_rec709")
    color, says, shown = recorded(tmp_path, "ACEScg")
    np.testing.assert_allclose(color, AP1 @ plain, rtol=1e-5)
    np.testing.assert_allclose(
        says_plain["chromaticities"], (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    )
    np.testing.assert_allclose(says["chromaticities"], chromaticities("ACEScg"), atol=1e-6)
    assert says["colorInteropID"] == "lin_ap1_scene" and "colorInteropID" not in says_plain
    np.testing.assert_allclose(shown, shown_plain, atol=1.01 / 255)


def test_an_exr_of_it_is_read_back_as_it_was(tmp_path):
    """As the texture of a dome, whose primaries are its header's."""
    recorded(tmp_path, "ACEScg")
    dome = f'def DomeLight "Sky"\n{{\n    asset inputs:texture:file = @{tmp_path}/ACEScg.exr@\n}}\n'
    flat = flatten(stage_of(dome))
    ((texture),) = [prim for prim in flat.prims.values() if prim["type"] == "Texture"]
    middle = texture["pixels"].reshape(texture["height"], texture["width"], 3)[6, 6]
    np.testing.assert_allclose(middle, RED, rtol=1e-4)


def test_merged_images_and_flattened_stages_keep_it(tmp_path, capsys):
    recorded(tmp_path, "ACEScg")
    stage, flat, out = tmp_path / "ACEScg.usda", tmp_path / "a.dermis", tmp_path / "flat.exr"
    assert main(["flatten", str(stage), str(flat)]) == 0
    flags = ["--samples", "1", "--set", "renderingColorSpace=lin_rec2020_scene"]
    assert main(["record", str(flat), str(out), *flags]) == 0
    assert "its colours are in lin_ap1_scene already" in capsys.readouterr().err
    parts = [tmp_path / f"part{i}.exr" for i in range(2)]
    for i, part in enumerate(parts):
        flags = ["--tileCount", "2", "1", "--tileIndex", str(i), "--samples", "1"]
        assert main(["record", str(stage), str(part), *flags]) == 0
    merged = tmp_path / "merged.exr"
    assert main(["merge", *map(str, parts), "--output", str(merged)]) == 0
    for file in (out, merged):
        spec = oiio.ImageBuf(str(file)).spec()
        np.testing.assert_allclose(spec.getattribute("chromaticities"), chromaticities("ACEScg"), atol=1e-6)


def test_display_images_start_from_the_space():
    rgb = np.array([[0.2, 0.5, 0.1]], np.float32)
    transform = DisplayTransform("sRGB")
    np.testing.assert_allclose(
        transform.showing("lin_ap1_scene").apply(rgb @ AP1.T.astype(np.float32)),
        transform.apply(rgb),
        atol=1e-5,
    )


def test_what_is_no_space_is_said():
    assert linear_name("lin_ap1") == "lin_ap1_scene" and linear_name("srgb_rec709_scene") is None
    for name in ("srgb_rec709_scene", "nonsense", "raw"):
        text = f'def RenderSettings "R"\n{{\n    token renderingColorSpace = "{name}"\n}}\n'
        stage = stage_of(text)
        stage.SetMetadata("renderSettingsPrimPath", "/R")
        ((prim, message),) = flatten(stage).warnings
        assert prim == "/R" and name in message and "linear Rec.709 is used" in message


def test_settings_list_it():
    assert json.loads(dermis._core.Delegate().settings())["renderingColorSpace"] == "lin_rec709_scene"


def test_our_stage(usd_scenes):
    """Colour of the card times colour of the sky, both in ACEScg."""
    image = dermis.render(usd_scenes / "rendering_space.usda", resolution=[48, 24], samples=64)
    assert image.stats["warnings"] == []
    light, card = 1.5 * AP1 @ [1, 0.8, 0.55], np.array([0.05, 0.6, 0.1])
    for column, to_ap1 in ((14, AP1), (34, AP1 @ np.linalg.inv(REC2020))):
        got = image.color[8:16, column - 4 : column + 4, :3].mean((0, 1))
        np.testing.assert_allclose(got, to_ap1 @ card * light, rtol=3e-3)
