"""Lights: every type and attribute, textures, and what is said about the rest."""

import numpy as np
import pytest
from pxr import UsdLux, UsdUtils

from dermis.stage import flatten, open_stage

oiio = pytest.importorskip("OpenImageIO")


def light(kind: str, body: str = "", apis: str = "") -> str:
    metadata = f" (\n    prepend apiSchemas = [{apis}]\n)" if apis else ""
    return f'def {kind} "L"{metadata}\n{{\n{body}\n}}\n'


def write_image(path, pixels, kind) -> None:
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind))
    output.write_image(pixels)
    output.close()


DEFAULTS = {
    "RectLight": {"kind": "rect", "width": 1.0, "height": 1.0, "texture": ""},
    "DiskLight": {"kind": "disk", "radius": 0.5},
    "SphereLight": {"kind": "sphere", "radius": 0.5},
    "CylinderLight": {"kind": "cylinder", "length": 1.0, "radius": 0.5},
    "DistantLight": {"kind": "distant", "angle": pytest.approx(0.53)},
    "DomeLight": {"kind": "dome", "texture": "", "poleAxis": "Y"},
    "DomeLight_1": {"kind": "dome", "texture": "", "poleAxis": "Y"},
}


@pytest.mark.parametrize("kind", DEFAULTS)
def test_defaults(flat, kind):
    result = flat(light(kind))
    found = result.prims["/L"]
    assert result.warnings == []
    assert found["shape"] == DEFAULTS[kind]
    assert found["intensity"] == (50000.0 if kind == "DistantLight" else 1.0)
    assert found["exposure"] == 0.0 and found["color"] == [1.0, 1.0, 1.0]
    assert found["normalize"] is False and found["enableColorTemperature"] is False
    assert found["visible"] is True and found["cameraVisible"] is False
    assert found["shaping"] is None


def test_authored_attributes(flat):
    body = """
    float inputs:intensity = 3
    float inputs:exposure = -1
    color3f inputs:color = (1, 0.5, 0.25)
    bool inputs:normalize = 1
    bool inputs:enableColorTemperature = 1
    float inputs:colorTemperature = 3200
    float inputs:width = 2
    float inputs:height = 4
    bool inputs:visibility:camera = 1
    token visibility = "invisible"
"""
    found = flat(light("RectLight", body)).prims["/L"]
    assert (found["intensity"], found["exposure"], found["color"]) == (3.0, -1.0, [1.0, 0.5, 0.25])
    assert found["normalize"] is True and found["enableColorTemperature"] is True
    assert found["blackbody"] == pytest.approx(list(UsdLux.BlackbodyTemperatureAsRgb(3200)))
    assert (found["shape"]["width"], found["shape"]["height"]) == (2.0, 4.0)
    assert found["cameraVisible"] is True and found["visible"] is False


def test_shaping_only_where_applied_or_authored(flat):
    applied = flat(light("SphereLight", apis='"ShapingAPI"')).prims["/L"]["shaping"]
    assert applied == {"focus": 0.0, "focusTint": [0.0, 0.0, 0.0], "coneAngle": 90.0, "coneSoftness": 0.0}
    authored = flat(light("SphereLight", "    float inputs:shaping:cone:angle = 20")).prims["/L"]["shaping"]
    assert authored["coneAngle"] == 20.0


@pytest.mark.parametrize(
    ("axis", "up", "pole"), [("scene", "Y", "Y"), ("scene", "Z", "Z"), ("Y", "Z", "Y"), ("Z", "Y", "Z")]
)
def test_pole_axis(flat, axis, up, pole):
    metadata = f'    upAxis = "{up}"'
    assert (
        flat(light("DomeLight_1", f'    token poleAxis = "{axis}"'), metadata=metadata).prims["/L"]["shape"][
            "poleAxis"
        ]
        == pole
    )
    assert flat(light("DomeLight"), metadata=metadata).prims["/L"]["shape"]["poleAxis"] == "Y"


def test_dome_visibility_option(flat):
    assert flat(light("DomeLight"), enable_dome_light_visibility=True).prims["/L"]["cameraVisible"] is True
    assert flat(light("RectLight"), enable_dome_light_visibility=True).prims["/L"]["cameraVisible"] is False
    hidden = light("DomeLight", "    bool inputs:visibility:camera = 0")
    assert flat(hidden, enable_dome_light_visibility=True).prims["/L"]["cameraVisible"] is False


def test_damaged_values_become_defaults(flat):
    result = flat(
        light(
            "DiskLight",
            "    float inputs:intensity = nan\n    float inputs:radius = inf\n"
            "    string inputs:exposure = 'x'",
        )
    )
    found = result.prims["/L"]
    assert (found["intensity"], found["exposure"], found["shape"]["radius"]) == (1.0, 0.0, 0.5)
    assert sorted(message.split(":")[1] for _, message in result.warnings) == [
        "exposure",
        "intensity",
        "radius",
    ]


@pytest.mark.parametrize(
    ("kind", "body", "apis", "word"),
    [
        ("RectLight", "    rel light:filters = </F>", "", "light:filters"),
        ("DomeLight", "    rel portals = </F>", "", "portals"),
        ("DomeLight", '    token inputs:texture:format = "folded"', "", "plain colour"),
        ("GeometryLight", "", "", "GeometryLight is not supported"),
        ("PluginLight", "", "", "PluginLight is not supported"),
        ("LightFilter", "", "", "LightFilter is not supported"),
    ],
)
def test_what_is_not_rendered_is_said_once(flat, kind, body, apis, word):
    warnings = flat(light(kind, body, apis)).warnings
    assert len(warnings) == 1
    assert warnings[0][0] == "/L" and word in warnings[0][1]


def test_factors_of_lobes(flat):
    found = flat(light("DomeLight", "    float inputs:diffuse = 0.5\n    float inputs:specular = 1"))
    assert found.prims["/L"]["diffuse"] == 0.5 and "specular" not in found.prims["/L"] and not found.warnings


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (light("Xform", "", '"LightAPI"'), "LightAPI: a Xform does not shine; the API is for meshes"),
        (
            light("Points", "point3f[] points = [(0, 0, 0)]\nfloat[] widths = [1]", '"MeshLightAPI"'),
            "LightAPI: a Points",
        ),
        (light("Volume", "", '"VolumeLightAPI"'), "Volume is not rendered yet"),
        (light("PxrAovLight"), "'PxrAovLight', a type that USD does not know, is not rendered yet"),
        (light("Scope"), ""),
        (light("PortalLight"), ""),
        (light(""), ""),
    ],
)
def test_what_cannot_shine_is_said(flat, text, said):
    messages = [message for _, message in flat(text).warnings]
    assert any(message.startswith(said) for message in messages) if said else messages == []


def test_inputs_that_are_driven_are_said(flat):
    text = light("RectLight", "float inputs:exposure = 1\nfloat inputs:exposure.connect = </M.inputs:e>")
    found = flat(text + 'def Material "M"\n{\n    float inputs:e = 2\n}\n')
    assert found.prims["/L"]["exposure"] == 1.0
    [(path, message)] = found.warnings
    assert path == "/L" and message.startswith(
        "inputs:exposure: driven by /M.inputs:e, which is not supported"
    )


def test_defaults_of_unsupported_attributes_say_nothing(flat):
    body = (
        "    bool inputs:shadow:enable = 1\n    float inputs:diffuse = 1\n"
        "    bool collection:lightLink:includeRoot = 1"
    )
    assert flat(light("RectLight", body, '"ShadowAPI"')).warnings == []


def test_mesh_light_is_a_mesh_too(flat):
    prims = flat(light("Sphere", "    float inputs:intensity = 4", '"MeshLightAPI"')).prims
    assert prims["/L"]["type"] == "Mesh"
    assert prims["/L.light"]["shape"] == {"kind": "mesh", "mesh": "/L"}
    assert prims["/L.light"]["intensity"] == 4.0


def test_float_texture_is_linear_and_upright(flat, tmp_path):
    pixels = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    for suffix in ("exr", "hdr", "tif"):
        write_image(tmp_path / f"sky.{suffix}", pixels, oiio.FLOAT)
        result = flat(light("DomeLight", f"    asset inputs:texture:file = @{tmp_path}/sky.{suffix}@"))
        texture = result.prims[result.prims["/L"]["shape"]["texture"]]
        assert (texture["type"], texture["width"], texture["height"]) == ("Texture", 4, 2)
        # Radiance files share an exponent of 8 bits of mantissa.
        assert texture["pixels"] == pytest.approx(pixels.reshape(-1, 3), abs=0.1 if suffix == "hdr" else 0)
        assert texture["pixels"].dtype == np.float32 and result.warnings == []


@pytest.mark.parametrize(
    ("suffix", "space", "expected"), [("png", "", 0.2140), ("png", "raw", 0.4980), ("jpg", "", 0.2140)]
)
def test_eight_bits_are_srgb_unless_raw(flat, tmp_path, suffix, space, expected):
    write_image(tmp_path / f"card.{suffix}", np.full((8, 8, 3), 127, np.uint8), oiio.UINT8)
    metadata = f' (\n        colorSpace = "{space}"\n    )' if space else ""
    result = flat(light("RectLight", f"    asset inputs:texture:file = @{tmp_path}/card.{suffix}@{metadata}"))
    pixels = result.prims[result.prims["/L"]["shape"]["texture"]]["pixels"]
    assert pixels == pytest.approx(np.full((64, 3), expected), abs=4e-3)


def test_eight_bits_that_are_said_to_be_linear(flat, tmp_path):
    spec = oiio.ImageSpec(8, 8, 3, oiio.UINT8)
    spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
    output = oiio.ImageOutput.create(str(tmp_path / "card.png"))
    output.open(str(tmp_path / "card.png"), spec)
    output.write_image(np.full((8, 8, 3), 127, np.uint8))
    output.close()
    result = flat(light("RectLight", f"    asset inputs:texture:file = @{tmp_path}/card.png@"))
    pixels = result.prims[result.prims["/L"]["shape"]["texture"]]["pixels"]
    assert pixels == pytest.approx(np.full((64, 3), 127 / 255), abs=1e-4)


def test_other_primaries_become_rec709(flat, tmp_path):
    output = oiio.ImageOutput.create(str(tmp_path / "ap0.exr"))
    spec = oiio.ImageSpec(1, 1, 3, oiio.FLOAT)
    ap0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
    spec.attribute("chromaticities", "float[8]", ap0)
    output.open(str(tmp_path / "ap0.exr"), spec)
    output.write_image(np.array([[[0.5, 0.5, 0.5]]], np.float32))
    output.close()
    result = flat(light("DomeLight", f"    asset inputs:texture:file = @{tmp_path}/ap0.exr@"))
    (pixel,) = result.prims[result.prims["/L"]["shape"]["texture"]]["pixels"]
    # Equal luminance; the white point of ACES is a little warmer than D65 (no adaptation).
    assert pixel @ [0.2126, 0.7152, 0.0722] == pytest.approx(0.5, abs=1e-3)
    assert pixel[0] > pixel[2]


def test_unusable_pixels_are_replaced(flat, tmp_path):
    write_image(tmp_path / "bad.exr", np.array([[[np.nan, np.inf, -1.0]]], np.float32), oiio.FLOAT)
    result = flat(light("DomeLight", f"    asset inputs:texture:file = @{tmp_path}/bad.exr@"))
    assert result.prims[result.prims["/L"]["shape"]["texture"]]["pixels"].tolist() == [[0.0, 65504.0, 0.0]]
    assert "3 negative or not finite" in result.warnings[0][1]


@pytest.mark.parametrize("content", [None, b"no image"])
def test_missing_and_damaged_textures_leave_the_plain_light(flat, tmp_path, content):
    if content is not None:
        (tmp_path / "gone.exr").write_bytes(content)
    result = flat(light("DomeLight", f"    asset inputs:texture:file = @{tmp_path}/gone.exr@"))
    assert list(result.prims) == ["/L"] and result.prims["/L"]["shape"]["texture"] == ""
    ((prim, message),) = result.warnings
    assert prim == "/L"
    assert all(word in message for word in ("inputs:texture:file", "gone.exr", "plain colour"))


def test_one_image_for_two_lights(flat, tmp_path):
    write_image(tmp_path / "sky.exr", np.ones((1, 2, 3), np.float32), oiio.FLOAT)
    body = light("DomeLight", f"    asset inputs:texture:file = @{tmp_path}/sky.exr@")
    first, second = flat(body + body.replace('"L"', '"K"')), flat(body)
    assert sum(prim["type"] == "Texture" for prim in first.prims.values()) == 1
    key = first.prims["/L"]["shape"]["texture"]
    # The next frame gets the same memory.
    assert first.prims[key]["pixels"] is second.prims[key]["pixels"]


def test_our_stage(usd_scenes):
    flat_stage = flatten(open_stage(usd_scenes / "lights.usda"))
    assert flat_stage.warnings == []
    kinds = {prim["shape"]["kind"] for prim in flat_stage.prims.values() if prim["type"] == "Light"}
    assert kinds == {"rect", "disk", "sphere", "cylinder", "mesh", "distant", "dome"}


def test_texture_inside_a_package(tmp_path):
    write_image(tmp_path / "sky.exr", np.full((1, 2, 3), 3.0, np.float32), oiio.FLOAT)
    body = light("DomeLight", "    asset inputs:texture:file = @sky.exr@")
    (tmp_path / "sky.usda").write_text("#usda 1.0\n" + body)
    package = tmp_path / "sky.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "sky.usda"), str(package))
    result = flatten(open_stage(package))
    assert result.warnings == []
    texture = result.prims[result.prims["/L"]["shape"]["texture"]]
    assert "sky.usdz" in texture["file"] and texture["pixels"].tolist() == [[3.0, 3.0, 3.0]] * 2
