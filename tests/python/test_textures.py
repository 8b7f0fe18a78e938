"""Images and shading networks as they are rendered, against their texels and against arithmetic in Python."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from looked_up import (
    ST,
    camera,
    connect,
    glowing,
    looked_up,
    middles,
    primvar,
    quads,
    reader,
    render,
    shader,
    stage_of,
)

dermis = pytest.importorskip("dermis")
oiio = pytest.importorskip("OpenImageIO")

RNG = np.random.default_rng(7)

FORMATS = {
    "u8": (oiio.UINT8, np.uint8, 255),
    "u16": (oiio.UINT16, np.uint16, 65535),
    "half": (oiio.HALF, np.float16, 1.0),
    "float": (oiio.FLOAT, np.float32, 1.0),
}


def write(path: Path, texels: np.ndarray, bits: str = "u8", **attributes: object) -> Path:
    """Texels (rows from the top, columns, channels) in 0..1, rounded to `bits`; returns the path."""
    kind, dtype, scale = FORMATS[bits]
    values = (np.rint(texels * scale) if bits in ("u8", "u16") else texels).astype(dtype)
    spec = oiio.ImageSpec(texels.shape[1], texels.shape[0], texels.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("compression", "none")
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(values), out.geterror()
    out.close()
    return path


def rounded(texels: np.ndarray, bits: str) -> np.ndarray:
    """What the file holds."""
    _, dtype, scale = FORMATS[bits]
    return (
        np.rint(texels * scale) / scale if bits in ("u8", "u16") else texels.astype(dtype).astype(np.float64)
    )


def srgb(v: np.ndarray) -> np.ndarray:
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def texture(file: Path, *lines: str, output: str = "rgb", st: str = "R.outputs:result") -> str:
    kind = "float3" if output == "rgb" else "float"
    return reader() + shader(
        "T",
        "UsdUVTexture",
        f"asset inputs:file = @{file}@",
        f"float2 inputs:st.connect = </Look/{st}>",
        *lines,
        f"{kind} outputs:{output}",
    )


def centres(width: int, height: int) -> list[tuple[float, float]]:
    """st of the texels, rows from the top."""
    return [((x + 0.5) / width, 1 - (y + 0.5) / height) for y in range(height) for x in range(width)]


def glow_of(file: Path, *lines: str, output: str = "rgb", st: list | None = None) -> np.ndarray:
    return looked_up(
        glowing(texture(file, *lines, output=output), f"T.outputs:{output}"), st or centres(3, 2)
    )


RAW = 'token inputs:sourceColorSpace = "raw"'
SRGB = 'token inputs:sourceColorSpace = "sRGB"'


@pytest.mark.parametrize(
    ("extension", "bits"),
    [
        ("png", "u8"),
        ("png", "u16"),
        ("tif", "u8"),
        ("tif", "u16"),
        ("tif", "float"),
        ("exr", "half"),
        ("exr", "float"),
    ],
)
def test_every_format_shows_its_texels(tmp_path, extension, bits):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / f"a.{extension}", texels, bits)
    wanted = rounded(texels, bits).reshape(-1, 3)
    np.testing.assert_allclose(glow_of(file, RAW), wanted, rtol=2e-6, atol=1e-7)
    np.testing.assert_allclose(glow_of(file, SRGB), srgb(wanted), rtol=2e-5, atol=1e-6)
    auto = srgb(wanted) if bits == "u8" else wanted
    np.testing.assert_allclose(glow_of(file), auto, rtol=2e-5, atol=1e-6)


def test_jpeg_and_radiance(tmp_path):
    flat = np.full((16, 16, 3), 0.5)
    file = write(tmp_path / "a.jpg", flat)
    np.testing.assert_allclose(glow_of(file, st=[(0.5, 0.5)]), srgb(np.full((1, 3), 128 / 255)), rtol=1e-5)
    bright = np.full((16, 16, 3), 37.5)
    file = write(tmp_path / "a.hdr", bright, "float")
    np.testing.assert_allclose(glow_of(file, st=[(0.5, 0.5)]), np.full((1, 3), 37.5), rtol=1e-5)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("space", [RAW, SRGB])
def test_outputs_by_number_of_channels(tmp_path, channels, space):
    """Grey is repeated, alpha is 1 where there is none and never carries a transfer curve."""
    texels = RNG.random((2, 3, channels))
    file = write(tmp_path / "a.png", texels)
    values = rounded(texels, "u8").reshape(-1, channels)
    color = values[:, :3] if channels > 2 else np.repeat(values[:, :1], 3, axis=1)
    color = srgb(color) if space == SRGB else color
    alpha = values[:, -1] if channels % 2 == 0 else np.ones(6)
    for name, wanted in {"r": color[:, 0], "g": color[:, 1], "b": color[:, 2], "a": alpha}.items():
        got = glow_of(file, space, output=name)
        np.testing.assert_allclose(
            got, np.repeat(wanted[:, None], 3, axis=1), rtol=2e-5, atol=1e-6, err_msg=name
        )


def test_auto_takes_one_channel_of_eight_bits_as_data(tmp_path):
    texels = RNG.random((2, 3, 1))
    file = write(tmp_path / "a.png", texels)
    np.testing.assert_allclose(glow_of(file, output="r")[:, 0], rounded(texels, "u8").ravel(), rtol=2e-6)


def test_auto_believes_a_file_that_says_it_is_linear(tmp_path):
    """PNG's gAMA of 1; Storm's reader of PNG asks for it, too."""
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.png", texels, **{"oiio:ColorSpace": "lin_rec709_scene"})
    np.testing.assert_allclose(glow_of(file), rounded(texels, "u8").reshape(-1, 3), rtol=2e-6)


def test_bilinear_between_texels(tmp_path):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    got = glow_of(
        file, 'token inputs:wrapS = "clamp"', 'token inputs:wrapT = "clamp"', st=[(0.4, 0.6), (0.5, 0.5)]
    )
    x, y = 0.4 * 3 - 0.5, (1 - 0.6) * 2 - 0.5
    top = texels[0, 0] + (texels[0, 1] - texels[0, 0]) * x
    bottom = texels[1, 0] + (texels[1, 1] - texels[1, 0]) * x
    np.testing.assert_allclose(got[0], top + (bottom - top) * y, rtol=1e-5)
    np.testing.assert_allclose(got[1], texels[:, 1].mean(0), rtol=1e-5)


OUTSIDE = [-1.5, -0.5, 3.5, 4.5, 7.5]
"""In texels of an image 3 wide."""


@pytest.mark.parametrize(
    ("wrap", "columns"),
    [
        ("repeat", [1, 2, 0, 1, 1]),
        ("mirror", [1, 0, 2, 1, 1]),
        ("clamp", [0, 0, 2, 2, 2]),
        ("black", [None] * 5),
        ("useMetadata", [None] * 5),
    ],
)
def test_wrap_modes(tmp_path, wrap, columns):
    texels = RNG.random((1, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    st = [(s / 3, 0.5) for s in OUTSIDE]
    got = glow_of(file, f'token inputs:wrapS = "{wrap}"', 'token inputs:wrapT = "clamp"', st=st)
    wanted = [np.zeros(3) if column is None else texels[0, column] for column in columns]
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-7)
    # Down the other axis: the same image on its side, whose rows run from the top.
    file = write(tmp_path / "b.exr", texels.transpose(1, 0, 2)[::-1], "float")
    got = glow_of(
        file, f'token inputs:wrapT = "{wrap}"', 'token inputs:wrapS = "clamp"', st=[(t, s) for s, t in st]
    )
    np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-7)


def test_wrap_modes_of_the_file(tmp_path):
    texels = RNG.random((1, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float", wrapmodes="periodic,clamp")
    got = glow_of(file, st=[(-0.5 / 3, 0.5), (3.5 / 3, 0.5)])
    np.testing.assert_allclose(got, texels[0, [2, 0]], rtol=1e-5)


def test_scale_and_bias(tmp_path):
    texels = RNG.random((2, 3, 4))
    file = write(tmp_path / "a.tif", texels, "u8")
    values = rounded(texels, "u8").reshape(-1, 4)
    words = ("float4 inputs:scale = (2, 3, 0.5, 4)", "float4 inputs:bias = (0.25, 0, 1, 0.5)")
    got = glow_of(file, RAW, *words)
    np.testing.assert_allclose(got, values[:, :3] * [2, 3, 0.5] + [0.25, 0, 1], rtol=1e-5)
    np.testing.assert_allclose(
        glow_of(file, RAW, *words, output="a")[:, 0], values[:, 3] * 4 + 0.5, rtol=1e-5
    )


def test_udim_tiles(tmp_path):
    colors = {1001: (1, 0, 0), 1002: (0, 1, 0), 1011: (0, 0, 1), 1100: (1, 1, 0)}
    for number, color in colors.items():
        write(tmp_path / f"a.{number}.exr", np.full((2, 2, 3), color, float), "half")
    st = [(0.3, 0.3), (1.5, 0.2), (0.2, 1.9), (9.5, 9.5), (1.5, 1.5), (10.5, 0.5), (-0.5, 0.5)]
    got = glow_of(tmp_path / "a.<UDIM>.exr", "float4 inputs:fallback = (0.5, 0.25, 0.125, 1)", st=st)
    missing = (0.5, 0.25, 0.125)
    np.testing.assert_allclose(got, [*colors.values(), missing, missing, missing], atol=1e-6)


def test_opencolorio_space(tmp_path):
    """ACEScg red is outside of Rec.709: against OpenColorIO's own matrix."""
    ocio = pytest.importorskip("PyOpenColorIO")
    texels = RNG.random((2, 3, 3)) * 0.4 + 0.3
    file = write(tmp_path / "a.exr", texels, "float")
    config = ocio.Config.CreateFromFile("ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5")
    processor = config.getProcessor("ACEScg", "Linear Rec.709 (sRGB)").getDefaultCPUProcessor()
    wanted = texels.astype(np.float32).reshape(-1, 3).copy()
    processor.applyRGB(wanted)
    text = texture(file).replace(f"@{file}@", f'@{file}@ (\n            colorSpace = "ACEScg"\n        )')
    got = looked_up(glowing(text, "T.outputs:rgb"), centres(3, 2))
    assert (wanted > 0).all() and np.abs(wanted - texels.reshape(-1, 3)).max() > 0.01
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


def test_unreadable_files_give_one_message_and_the_fallback(tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    for file, word in ((broken, "cannot be read"), (tmp_path / "gone.png", "not found")):
        text = glowing(texture(file, "float4 inputs:fallback = (0.25, 0.5, 0.75, 1)"), "T.outputs:rgb")
        image = render(text + quads(1, primvar("st", "texCoord2f", [(0.5, 0.5)])), 1)
        np.testing.assert_allclose(middles(image, 1), [[0.25, 0.5, 0.75]])
        ((prim, message),) = [(w["prim"], w["message"]) for w in image.stats["warnings"]]
        assert prim == "/Look/T" and word in message and file.name in message


def test_truncated_file_is_said(tmp_path):
    file = write(tmp_path / "a.png", RNG.random((64, 64, 3)))
    file.write_bytes(file.read_bytes()[:2000])
    image = render(
        glowing(texture(file), "T.outputs:rgb") + quads(1, primvar("st", "texCoord2f", [(0.5, 0.5)])), 1
    )
    assert any("a.png" in w["message"] for w in image.stats["warnings"])
    np.testing.assert_allclose(middles(image, 1), [[0, 0, 0]])


# Transforms and primvars.


def test_transform2d(tmp_path):
    text = reader() + shader(
        "X",
        "UsdTransform2d",
        "float2 inputs:in.connect = </Look/R.outputs:result>",
        "float inputs:rotation = 30",
        "float2 inputs:scale = (2, 0.5)",
        "float2 inputs:translation = (0.25, 1)",
        "float2 outputs:result",
    )
    st = [(0.1, 0.2), (0.7, 0.3)]
    got = looked_up(glowing(text, "X.outputs:result"), st)
    angle = np.radians(30)
    scaled = np.array(st) * [2, 0.5]
    turned = np.stack(
        [
            scaled[:, 0] * np.cos(angle) - scaled[:, 1] * np.sin(angle),
            scaled[:, 0] * np.sin(angle) + scaled[:, 1] * np.cos(angle),
        ],
        axis=1,
    )
    np.testing.assert_allclose(got[:, :2], turned + np.array([0.25, 1]), rtol=1e-5)


KINDS = {
    "float": ("float", 1, "float"),
    "int": ("int", 1, "int"),
    "float2": ("float2", 2, "texCoord2f"),
    "float3": ("float3", 3, "color3f"),
    "float4": ("float4", 4, "color4f"),
    "normal": ("normal3f", 3, "normal3f"),
    "point": ("point3f", 3, "point3f"),
    "vector": ("vector3f", 3, "vector3f"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("interpolation", ["constant", "uniform", "vertex", "varying", "faceVarying"])
def test_primvar_readers(kind, interpolation):
    """Two quads; constant over each of them whatever carries the values."""
    _, width, value_type = KINDS[kind]
    values = RNG.integers(1, 9, (2, width)) / (1 if kind == "int" else 8)
    values = values[:1].repeat(2, 0) if interpolation == "constant" else values
    count = {"constant": 1, "uniform": 2}.get(interpolation, 8)
    spread = values[np.arange(count) * 2 // count] if count > 1 else values[:1]
    plain = [
        tuple(v.tolist()) if width > 1 else (int(v[0]) if kind == "int" else float(v[0])) for v in spread
    ]
    output = {"normal": "normal3f", "point": "point3f", "vector": "vector3f"}.get(kind, kind)
    text = shader(
        "R", f"UsdPrimvarReader_{kind}", 'string inputs:varname = "mine"', f"{output} outputs:result"
    )
    got = looked_up(
        glowing(text, "R.outputs:result"), [(0, 0), (0, 0)], primvar("mine", value_type, plain, interpolation)
    )
    wanted = np.repeat(values, 3, axis=1) if width == 1 else np.pad(values, ((0, 0), (0, 1)))[:, :3]
    np.testing.assert_allclose(got, wanted, rtol=1e-6)


def test_interpolated_and_indexed_primvar():
    """st over a quad: at its middle the mean of the corners."""
    values = primvar("mine", "float", [0.1, 0.2, 0.4, 0.8], "vertex")
    text = glowing(reader(varname="mine", kind="float"), "R.outputs:result")
    got = render(text + quads(1, values), 1, resolution=[63, 63], samples=64).color
    # The diagonal of the fan cuts the quad: the middle is the mean of its two ends. Beside it, of the others.
    np.testing.assert_allclose(got[31, 31, :3], 0.25, atol=0.004)
    u, v = 40.5 / 63, 1 - 50.5 / 63
    np.testing.assert_allclose(got[50, 40, :3], 0.1 + 0.1 * (u - v) + 0.3 * v, atol=0.004)
    indexed = (
        values.replace("[0.1, 0.2, 0.4, 0.8]", "[7.0, 0.5]")
        + "\n    int[] primvars:mine:indices = [1, 1, 1, 1]"
    )
    assert (middles(render(text + quads(1, indexed), 1), 1) == 0.5).all()


def test_constant_primvars_are_inherited():
    text = glowing(reader(varname="tone", kind="float3"), "R.outputs:result")
    row = quads(1, "").replace("def Mesh", "    def Mesh")
    tone = 'color3f primvars:tone = (0.25, 0.5, 1) (interpolation = "constant")'
    body = text + f'def Xform "Above"\n{{\n    {tone}\n{row}}}\n'
    np.testing.assert_allclose(middles(render(body, 1), 1), [[0.25, 0.5, 1]])


def test_missing_primvar_gives_the_fallback():
    text = glowing(reader(varname="none", kind="float3", fallback="(0.1, 0.2, 0.3)"), "R.outputs:result")
    image = render(text + quads(1, ""), 1)
    np.testing.assert_allclose(middles(image, 1), [[0.1, 0.2, 0.3]], rtol=1e-6)
    assert image.stats["warnings"] == []
    bare = glowing(reader(varname="none", kind="float3"), "R.outputs:result")
    ((prim, message),) = [(w["prim"], w["message"]) for w in render(bare + quads(1, ""), 1).stats["warnings"]]
    assert prim == "/Row" and "primvars:none" in message and "/Look" in message


@pytest.mark.parametrize("kind", ["string", "matrix"])
def test_readers_of_what_is_no_number_are_said(flat, kind):
    value_type = {"string": "string", "matrix": "matrix4d"}[kind]
    text = shader(
        "R", f"UsdPrimvarReader_{kind}", 'string inputs:varname = "mine"', f"{value_type} outputs:result"
    )
    ((prim, message),) = flat(glowing(text, "R.outputs:result") + quads(1, "")).warnings
    assert prim == "/Look/S" and f"UsdPrimvarReader_{kind}" in message and "the default is used" in message


def test_display_opacity_counts_once():
    """Read by name beside displayColor: a surface that is there by so much glows by so much."""
    nodes = reader("C", "displayColor", "float3") + reader("O", "displayOpacity", "float")
    text = (
        'def Material "Look"\n{\n    token outputs:surface.connect = </Look/S.outputs:surface>\n'
        + shader(
            "S",
            "UsdPreviewSurface",
            'token inputs:opacityMode = "presence"',
            "color3f inputs:emissiveColor = (1, 1, 1)",
            "color3f inputs:diffuseColor.connect = </Look/C.outputs:result>",
            "float inputs:opacity.connect = </Look/O.outputs:result>",
            "token outputs:surface",
        )
        + nodes
        + "}\n"
    )
    primvars = primvar("displayColor", "color3f", [(0.5, 0.25, 0.125)] * 2)
    primvars += "\n" + primvar("displayOpacity", "float", [0.25, 1.0])
    got = middles(render(text + quads(2, primvars), 2), 2)
    np.testing.assert_allclose(got, [[0.25] * 3, [1.0] * 3], rtol=1e-6)


def test_subsets_and_instances_read_their_own(tmp_path):
    """Two subsets with two images; an instance of a quad under another inherited primvar than its twin."""
    files = [write(tmp_path / f"{i}.exr", np.full((2, 2, 3), v), "float") for i, v in enumerate((0.25, 0.75))]
    looks = [
        glowing(texture(file), "T.outputs:rgb").replace("Look", f"Look{i}") for i, file in enumerate(files)
    ]
    subset = (
        '    def GeomSubset "P%d" (\n        prepend apiSchemas = ["MaterialBindingAPI"]\n    )\n    {\n'
        '        uniform token elementType = "face"\n        uniform token familyName = "materialBind"\n'
        "        int[] indices = [%d]\n        rel material:binding = </Look%d>\n    }\n"
    )
    row = quads(
        2, primvar("st", "texCoord2f", [(0.5, 0.5)] * 2) + "\n" + "".join(subset % (i, i, i) for i in (0, 1))
    )
    got = middles(render("".join(looks) + row.replace("    rel material:binding = </Look>\n", "", 1), 2), 2)
    np.testing.assert_allclose(got, [[0.25] * 3, [0.75] * 3])

    tone = 'color3f primvars:tone = {} (\n        interpolation = "constant"\n    )\n'
    one = 'class Xform "Proto"\n{\n' + quads(1, "") + "}\n"
    twins = "".join(
        f'def Xform "I{x}" (\n    instanceable = true\n    references = </Proto>\n)\n{{\n    {tone.format(color)}'
        f"    double3 xformOp:translate = ({x}, 0, 0)\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
        for x, color in enumerate([(0.25, 0.5, 1.0), (1.0, 0.5, 0.25)])
    )
    text = glowing(reader(varname="tone", kind="float3"), "R.outputs:result") + one + twins
    np.testing.assert_allclose(middles(render(text, 2), 2), [[0.25, 0.5, 1.0], [1.0, 0.5, 0.25]])


def test_images_inside_a_package(tmp_path):
    from pxr import UsdUtils

    write(tmp_path / "a.png", np.full((4, 4, 3), (1.0, 0.0, 1.0)))
    text = glowing(texture(Path("a.png")), "T.outputs:rgb")
    body = text + quads(1, primvar("st", "texCoord2f", [(0.5, 0.5)])) + camera(1)
    (tmp_path / "a.usda").write_text("#usda 1.0\n" + body)
    package = tmp_path / "a.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "a.usda"), str(package))
    (tmp_path / "a.png").unlink()
    image = dermis.render(str(package), camera="/Eye", resolution=[3, 3], samples=1)
    assert image.stats["warnings"] == []
    np.testing.assert_allclose(image.color[1, 1, :3], [1, 0, 1])


# Levels.


def test_what_is_far_away_is_the_mean(tmp_path):
    """A checkerboard of single texels across one pixel, one sample: its mean, not one of its texels."""
    board = np.indices((512, 512)).sum(0) % 2
    file = write(tmp_path / "a.png", np.repeat(board[..., None], 3, axis=2).astype(float))
    corners = primvar("st", "texCoord2f", [(0, 0), (8, 0), (8, 8), (0, 8)], "vertex")
    wrap = ('token inputs:wrapS = "repeat"', 'token inputs:wrapT = "repeat"')
    image = render(glowing(texture(file, RAW, *wrap), "T.outputs:rgb") + quads(1, corners), 1)
    np.testing.assert_allclose(middles(image, 1), 0.5, atol=0.003)


def test_coordinates_that_are_transformed_choose_their_level(tmp_path):
    board = np.indices((512, 512)).sum(0) % 2
    file = write(tmp_path / "a.png", np.repeat(board[..., None], 3, axis=2).astype(float))
    corners = primvar("st", "texCoord2f", [(0, 0), (1e-3, 0), (1e-3, 1e-3), (0, 1e-3)], "vertex")
    wrap = ('token inputs:wrapS = "repeat"', 'token inputs:wrapT = "repeat"')
    transform = shader(
        "X",
        "UsdTransform2d",
        "float2 inputs:in.connect = </Look/R.outputs:result>",
        "float2 inputs:scale = (9000, 9000)",
        "float inputs:rotation = 20",
        "float2 outputs:result",
    )
    nodes = texture(file, RAW, *wrap, st="X.outputs:result") + transform
    image = render(glowing(nodes, "T.outputs:rgb") + quads(1, corners), 1)
    np.testing.assert_allclose(middles(image, 1), 0.5, atol=0.003)


ATLAS = 100
"""Images of 384 x 384 texels, 0.59 MB with their levels."""


@pytest.fixture(scope="module")
def atlas(tmp_path_factory):
    """A stage of a square of 10 x 10 UDIM tiles that shows texels of the finest levels, all of them over a picture."""
    folder = tmp_path_factory.mktemp("atlas")
    rng = np.random.default_rng(11)
    for i in range(ATLAS):
        write(folder / f"a.{1001 + i}.tif", rng.random((384, 384, 3)))
        write(folder / f"small.{1001 + i}.tif", rng.random((2, 2, 3)))
    nodes = shader(
        "T",
        "ND_image_color3",
        f"asset inputs:file = @{folder}/a.<UDIM>.tif@",
        'string inputs:filtertype = "closest"',
        "color3f outputs:out",
    )
    square = quads(1, primvar("st", "texCoord2f", [(0, 0), (10, 0), (10, 10), (0, 10)], "faceVarying"))
    (folder / "atlas.usda").write_text("#usda 1.0\n" + glowing(nodes, "T.outputs:out") + square + camera(1))
    return folder / "atlas.usda"


def drawn(stage: Path, out: Path, **settings: object) -> tuple[np.ndarray, dict]:
    """Image and statistics of a render in a process of its own."""
    code = (
        "import sys, json, numpy as np, dermis\n"
        "image = dermis.render(sys.argv[1], camera='/Eye', **json.loads(sys.argv[3]))\n"
        "np.save(sys.argv[2], image.color); print(json.dumps(image.stats))"
    )
    settings = {"resolution": [320, 320], "samples": 4, "aovs": [], **settings}
    command = [sys.executable, "-c", code, str(stage), str(out), json.dumps(settings)]
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    return np.load(out), json.loads(said.stdout)


def test_texture_memory_bounds_memory_and_changes_no_picture(atlas, tmp_path):
    whole, free = drawn(atlas, tmp_path / "a.npy", threads=2)
    bounded, tight = drawn(atlas, tmp_path / "b.npy", threads=2, textureMemory=8)
    alone, _ = drawn(atlas, tmp_path / "c.npy", threads=1, textureMemory=8)
    np.testing.assert_array_equal(whole, bounded)
    np.testing.assert_array_equal(whole, alone)
    assert len(np.unique(whole[..., 0])) > 200
    assert free["needs"]["paged_images"] == 0 and tight["needs"]["paged_images"] == ATLAS
    assert free["needs"]["texture_bytes"] > 55e6 and tight["warnings"] == []
    # Beside the 8 MB: the image under way, decoded twice, and its levels in floats.
    (tmp_path / "small.usda").write_text(atlas.read_text().replace("a.<UDIM>.tif", "small.<UDIM>.tif"))
    _, small = drawn(tmp_path / "small.usda", tmp_path / "d.npy", threads=2)
    above = [stats["peak_rss_bytes"] - small["peak_rss_bytes"] for stats in (free, tight)]
    assert above[0] > 50e6 and above[1] < 8e6 + 12e6, above


# MaterialX.


def mtlx_image(file: Path, identifier: str, kind: str, *lines: str) -> str:
    return ST + shader(
        "T",
        identifier,
        f"asset inputs:file = @{file}@",
        connect("float2", "texcoord", "ST"),
        *lines,
        f"{kind} outputs:out",
    )


def test_materialx_images(tmp_path):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    flat = texels.reshape(-1, 3).astype(np.float32)
    got = looked_up(glowing(mtlx_image(file, "ND_image_color3", "color3f"), "T.outputs:out"), centres(3, 2))
    np.testing.assert_allclose(got, flat, rtol=1e-6)
    got = looked_up(glowing(mtlx_image(file, "ND_image_float", "float"), "T.outputs:out"), centres(3, 2))
    np.testing.assert_allclose(got, flat[:, :1].repeat(3, 1), rtol=1e-6)
    # Beyond the edge: its default.
    words = ('string inputs:uaddressmode = "constant"', "color3f inputs:default = (0.5, 0.25, 0.75)")
    got = looked_up(
        glowing(mtlx_image(file, "ND_image_color3", "color3f", *words), "T.outputs:out"), [(-0.5, 0.25)]
    )
    np.testing.assert_allclose(got, [[0.5, 0.25, 0.75]], rtol=1e-6)
    closest = 'string inputs:filtertype = "closest"'
    got = looked_up(
        glowing(mtlx_image(file, "ND_image_color3", "color3f", closest), "T.outputs:out"), [(0.4, 0.6)]
    )
    np.testing.assert_allclose(got, texels[:1, 1], rtol=1e-6)


ADDRESSED = {
    "clamp": lambda x: np.clip(x, 0.0, 1.0),
    "mirror": lambda x: 1.0 - np.abs(1.0 - np.mod(x, 2.0)),
    "periodic": lambda x: np.mod(x, 1.0),
}


@pytest.mark.parametrize("mode", ADDRESSED)
def test_materialx_address_modes(tmp_path, mode):
    """Of one axis; the other one repeats."""
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    points = [(-0.3, 0.25), (1.4, 0.75), (0.6, 1.25), (2.2, -0.25)]
    st = np.array(points)
    for axis, word in enumerate("uv"):
        words = (f'string inputs:{word}addressmode = "{mode}"', 'string inputs:filtertype = "closest"')
        got = looked_up(
            glowing(mtlx_image(file, "ND_image_color3", "color3f", *words), "T.outputs:out"), points
        )
        s, t = (ADDRESSED[mode if i == axis else "periodic"](st[:, i]) for i in (0, 1))
        columns, rows = (
            np.minimum(np.floor(s * 3), 2).astype(int),
            np.minimum(np.floor((1 - t) * 2), 1).astype(int),
        )
        np.testing.assert_allclose(got, texels[rows, columns], rtol=1e-6)


ONE_ST = primvar("st", "texCoord2f", [(0.5, 0.5)])

NOT_READ = {
    'string inputs:filtertype = "cubic"': (
        "inputs:filtertype: 'cubic' is none of closest, linear; 'linear' is used"
    ),
    'string inputs:layer = "skin"': "inputs:layer: 'skin' is not read; the first channels of the file are used",
    'string inputs:framerange = "1-9"': (
        "inputs:framerange: '1-9' is not read; the file that is named is used in every frame"
    ),
    "int inputs:frameoffset = 5": "inputs:frameoffset: '5' is not read; the file that is named is used in every frame",
    'string inputs:frameendaction = "clamp"': (
        "inputs:frameendaction: 'clamp' is not read; the file that is named is used in every frame"
    ),
    'string inputs:uaddressmode = "wrap"': (
        "inputs:uaddressmode: 'wrap' is none of constant, clamp, periodic, mirror; 'periodic' is used"
    ),
    'string inputs:vaddressmode = "tile"': (
        "inputs:vaddressmode: 'tile' is none of constant, clamp, periodic, mirror; 'periodic' is used"
    ),
}


@pytest.mark.parametrize("line", NOT_READ)
def test_what_materialx_images_do_not_read_is_said(tmp_path, flat, line):
    file = write(tmp_path / "a.exr", RNG.random((2, 3, 3)), "float")
    kinds = ("image",) if "addressmode" in line else ("image", "tiledimage")
    for kind in kinds:
        text = mtlx_image(file, f"ND_{kind}_color3", "color3f", line)
        assert flat(glowing(text, "T.outputs:out") + quads(1, ONE_ST)).warnings == [
            ("/Look/T", NOT_READ[line])
        ]
    plain = ('string inputs:layer = ""', 'string inputs:framerange = ""', "int inputs:frameoffset = 0")
    text = mtlx_image(file, "ND_image_color3", "color3f", *plain, 'string inputs:filtertype = "closest"')
    assert flat(glowing(text, "T.outputs:out") + quads(1, ONE_ST)).warnings == []


def test_wrap_modes_that_are_none_are_said(tmp_path, flat):
    file = write(tmp_path / "a.exr", RNG.random((2, 3, 3)), "float")
    text = texture(file, 'token inputs:wrapS = "periodic"', 'token inputs:wrapT = "repeat"')
    said = (
        "inputs:wrapS: 'periodic' is none of black, clamp, repeat, mirror, useMetadata; 'useMetadata' is used"
    )
    assert flat(glowing(text, "T.outputs:rgb") + quads(1, ONE_ST)).warnings == [("/Look/T", said)]


def test_the_materialx_twin_of_the_preview_texture_repeats(tmp_path, flat):
    """Its words and defaults are MaterialX's: `periodic`, the coordinates of the mesh."""
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    for words in ((), ('string inputs:wrapS = "periodic"',)):
        node = shader(
            "T", "ND_UsdUVTexture_23", f"asset inputs:file = @{file}@", *words, "color3f outputs:rgb"
        )
        assert flat(glowing(node, "T.outputs:rgb") + quads(1, ONE_ST)).warnings == []
        shifted = [(s + 1, t - 2) for s, t in centres(3, 2)]
        got = looked_up(glowing(node, "T.outputs:rgb"), shifted)
        np.testing.assert_allclose(got, texels.reshape(-1, 3), rtol=1e-4)


def test_materialx_colors_of_eight_bits_are_srgb_and_floats_are_data(tmp_path):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.png", texels)
    values = rounded(texels, "u8").reshape(-1, 3)
    got = looked_up(glowing(mtlx_image(file, "ND_image_color3", "color3f"), "T.outputs:out"), centres(3, 2))
    np.testing.assert_allclose(got, srgb(values), rtol=2e-5)
    got = looked_up(glowing(mtlx_image(file, "ND_image_vector3", "vector3f"), "T.outputs:out"), centres(3, 2))
    np.testing.assert_allclose(got, values, rtol=2e-6)
    text = mtlx_image(file, "ND_image_color3", "color3f")
    text = text.replace(f"@{file}@", f'@{file}@ (\n            colorSpace = "lin_rec709"\n        )')
    np.testing.assert_allclose(looked_up(glowing(text, "T.outputs:out"), centres(3, 2)), values, rtol=2e-6)


def test_materialx_tiled_image(tmp_path):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    words = ("float2 inputs:uvtiling = (2, 3)", "float2 inputs:uvoffset = (0.5, 0.25)")
    text = mtlx_image(file, "ND_tiledimage_color3", "color3f", *words)
    wanted = [((s + 0.5 + 4) / 2, (t + 0.25 + 6) / 3) for s, t in centres(3, 2)]
    np.testing.assert_allclose(
        looked_up(glowing(text, "T.outputs:out"), wanted), texels.reshape(-1, 3), rtol=1e-4
    )


def test_materialx_tiles_of_real_size(tmp_path):
    """A tile of (0.5, 2) showing an image of (0.25, 4): coordinates are scaled by size over size."""
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    words = ("float2 inputs:realworldimagesize = (0.25, 4)", "float2 inputs:realworldtilesize = (0.5, 2)")
    text = mtlx_image(file, "ND_tiledimage_color3", "color3f", *words)
    wanted = [(s * 0.25 / 0.5, t * 4 / 2) for s, t in centres(3, 2)]
    np.testing.assert_allclose(
        looked_up(glowing(text, "T.outputs:out"), wanted), texels.reshape(-1, 3), rtol=1e-4
    )


def test_files_that_nodes_drive_are_said(flat):
    name = shader(
        "P", "ND_geompropvalueuniform_filename", 'string inputs:geomprop = "map"', "asset outputs:out"
    )
    text = shader("T", "ND_image_color3", connect("asset", "file", "P"), "color3f outputs:out")
    warnings = flat(glowing(name + text, "T.outputs:out") + quads(1, ONE_ST)).warnings
    assert warnings == [("/Look/T", "inputs:file: a node drives it; the fallback is used")]


def test_node_graphs_with_interfaces(tmp_path):
    texels = RNG.random((2, 3, 3))
    file = write(tmp_path / "a.exr", texels, "float")
    graph = (
        '    def NodeGraph "G"\n    {\n        asset inputs:map.connect = </Look.inputs:map>\n'
        "        color3f inputs:tint = (0.5, 1, 2)\n        color3f outputs:out.connect = </Look/G/M.outputs:out>\n"
        + shader(
            "I",
            "ND_image_color3",
            "asset inputs:file.connect = </Look/G.inputs:map>",
            "float2 inputs:texcoord.connect = </Look/ST.outputs:out>",
            "color3f outputs:out",
        )
        + shader(
            "M",
            "ND_multiply_color3",
            "color3f inputs:in1.connect = </Look/G/I.outputs:out>",
            "color3f inputs:in2.connect = </Look/G.inputs:tint>",
            "color3f outputs:out",
        )
        + "    }\n"
    )
    text = glowing(ST + graph, "G.outputs:out").replace(
        'def Material "Look"\n{\n', f'def Material "Look"\n{{\n    asset inputs:map = @{file}@\n'
    )
    np.testing.assert_allclose(looked_up(text, centres(3, 2)), texels.reshape(-1, 3) * [0.5, 1, 2], rtol=1e-6)


def test_geompropvalue():
    text = shader("N", "ND_geompropvalue_color3", 'string inputs:geomprop = "mine"', "color3f outputs:out")
    got = looked_up(
        glowing(text, "N.outputs:out"), [(0, 0), (0, 0)], primvar("mine", "color3f", [(1, 2, 3), (4, 5, 6)])
    )
    np.testing.assert_allclose(got, [[1, 2, 3], [4, 5, 6]])


def test_constant_networks_leave_no_network(flat):
    nodes = shader(
        "C", "ND_constant_color3", "color3f inputs:value = (0.1, 0.2, 0.3)", "color3f outputs:out"
    ) + shader(
        "N",
        "ND_multiply_color3FA",
        connect("color3f", "in1", "C"),
        "float inputs:in2 = 2",
        "color3f outputs:out",
    )
    material = flat(glowing(nodes, "N.outputs:out") + quads(1, "")).prims["/Look"]
    assert "network" not in material
    assert material["emissiveColor"] == pytest.approx([0.2, 0.4, 0.6])


def test_what_cannot_be_rendered_is_said_once_with_its_node(flat):
    nodes = shader("C", "ND_noise2d_color3", "color3f outputs:out") + shader(
        "N", "ND_multiply_color3FA", connect("color3f", "in1", "C"), "color3f outputs:out"
    )
    result = flat(glowing(nodes, "N.outputs:out") + quads(1, ""))
    ((prim, message),) = result.warnings
    assert prim == "/Look/S"
    assert message == (
        "inputs:emissiveColor: node 'ND_noise2d_color3' at /Look/C: it is not supported; the default is used"
    )
    circle = shader("N", "ND_add_float", connect("float", "in1", "N"), "float outputs:out")
    ((_, message),) = flat(glowing(circle, "N.outputs:out") + quads(1, "")).warnings
    assert "go round in a circle" in message


def test_our_stage(usd_scenes):
    from dermis.stage import flatten, open_stage

    flat = flatten(open_stage(usd_scenes / "textures.usda"))
    assert flat.warnings == []
    driven = {path: list(prim["network"]["inputs"]) for path, prim in flat.prims.items() if "network" in prim}
    assert driven == {
        "/World/Looks/Preview": ["normal", "roughness", "subsurfaceColor"],
        "/World/Looks/OpenPBR": ["subsurface_color", "subsurface_radius"],
        "/World/Looks/Standard": ["metalness", "normal", "subsurface"],
    }
    image = dermis.render(str(usd_scenes / "textures.usda"), resolution=[48, 20], samples=2)
    assert image.stats["warnings"] == [] and image.stats["non_finite_samples"] == 0
    assert image.stats["walks_leaked"] == 0 and image.stats["walks"] > 0


def test_same_image_for_any_number_of_threads(tmp_path):
    file = write(tmp_path / "a.png", RNG.random((64, 64, 3)))
    corners = primvar("st", "texCoord2f", [(0, 0), (3, 0), (3, 3), (0, 3)] * 4, "faceVarying")
    text = glowing(texture(file), "T.outputs:rgb", "float inputs:roughness.connect = </Look/T.outputs:rgb>")
    light = 'def DomeLight "Sky"\n{\n}\n'
    bodies = [text + quads(4, corners) + light + camera(4)]
    images = [
        dermis.render(stage_of(body), camera="/Eye", resolution=[64, 32], samples=8, threads=threads)
        for body in bodies
        for threads in (1, 3)
    ]
    np.testing.assert_array_equal(images[0].color, images[1].color)
