"""Cameras: attributes, exposure, usdrecord's search and its framing; render settings."""

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

import dermis
from dermis.stage import auto_camera, find_camera

DEFAULTS = {
    "projection": "perspective",
    "horizontalAperture": pytest.approx(20.955),
    "verticalAperture": pytest.approx(15.2908),
    "horizontalApertureOffset": 0.0,
    "verticalApertureOffset": 0.0,
    "focalLength": 50.0,
    "clippingRange": [1.0, 1_000_000.0],
    "fStop": 0.0,
    "focusDistance": 0.0,
    "exposureScale": 1.0,
}


def camera(body: str = "", name: str = "Cam") -> str:
    return f'def Camera "{name}"\n{{\n{body}\n}}\n'


def test_defaults(flat):
    found = flat(camera()).prims["/Cam"]
    assert {name: found[name] for name in DEFAULTS} == DEFAULTS


def test_authored(flat):
    found = flat(
        camera("""
    token projection = "orthographic"
    float horizontalAperture = 36
    float horizontalApertureOffset = 2
    float focalLength = 85
    float fStop = 2.8
    float focusDistance = 120
    float2 clippingRange = (0.1, 50)
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
""")
    ).prims["/Cam"]
    assert found["projection"] == "orthographic" and found["clippingRange"] == pytest.approx([0.1, 50])
    assert (found["horizontalAperture"], found["horizontalApertureOffset"], found["focalLength"]) == (
        36,
        2,
        85,
    )
    assert (found["fStop"], found["focusDistance"]) == (pytest.approx(2.8), 120)
    assert found["transform"][3] == [1, 2, 3, 1]


def test_exposure_scale_is_usds(flat, make_stage):
    body = camera(
        "    float exposure = 1.5\n    float exposure:time = 0.02\n    float exposure:iso = 400\n"
        "    float exposure:fStop = 2.8\n    float exposure:responsivity = 3"
    )
    stage = make_stage(body)
    expected = UsdGeom.Camera.Get(stage, "/Cam").ComputeLinearExposureScale(Usd.TimeCode.Default())
    assert flat(body).prims["/Cam"]["exposureScale"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    "body",
    [
        "    float exposure:fStop = 0",
        "    float exposure = 5000",
        "    float exposure = nan",
        "    string exposure = 'x'",
        '    token projection = "fisheye"',
        "    float fStop = inf",
    ],
)
def test_damage_becomes_defaults(flat, body):
    result = flat(camera(body))
    assert {name: result.prims["/Cam"][name] for name in DEFAULTS} == DEFAULTS
    assert [prim for prim, _ in result.warnings] == ["/Cam"]


def test_find_camera(make_stage):
    stage = make_stage(
        'def Xform "A"\n{\n'
        + camera(name="main_cam")
        + camera(name="other")
        + "}\n"
        + 'def Cube "box"\n{\n}\n'
    )
    assert find_camera(stage, "").GetPath() == "/A/main_cam"
    assert find_camera(stage, "other").GetPath() == "/A/other"
    assert find_camera(stage, "/A/other").GetPath() == "/A/other"
    for name in ("/A/gone", "gone", "box", "/box", "A/other", "/not a path"):
        assert find_camera(stage, name) is None


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("size", [4.0, 0.01])
def test_auto_camera_sees_every_corner(make_stage, up, size):
    body = (
        f'def Cube "C"\n{{\n    double size = {size}\n    double3 xformOp:translate = (5, 6, 7)\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )
    stage = make_stage(body, f'    upAxis = "{up}"')
    found = auto_camera(stage, Usd.TimeCode.Default(), ("default",))
    camera = Gf.Camera(
        Gf.Matrix4d(found["transform"]),
        horizontalAperture=found["horizontalAperture"],
        verticalAperture=found["verticalAperture"],
        focalLength=found["focalLength"],
    )
    to_camera = camera.frustum.ComputeViewMatrix()
    corners = [
        Gf.Vec3d(5, 6, 7) + Gf.Vec3d(x, y, z) * size / 2 for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    ]
    seen = np.array([to_camera.Transform(corner) for corner in corners])
    assert (-seen[:, 2] >= (1.0 if size < 1 else 0.0)).all()
    assert (
        np.abs(seen[:, 0] / seen[:, 2]) <= found["horizontalAperture"] / found["focalLength"] / 2 + 1e-9
    ).all()
    ups = np.array(found["transform"])[1, :3]
    assert ups == pytest.approx([0, 1, 0] if up == "Y" else [0, 0, 1], abs=1e-9)
    if size == 4.0:
        # (half diagonal) / tan(half field of view) + half depth
        distance = np.hypot(2, 2) / (found["horizontalAperture"] / 2 / found["focalLength"]) + 2
        expected = [5, 6, 7 + distance] if up == "Y" else [5, 6 - distance, 7]
        assert found["transform"][3][:3] == pytest.approx(expected)


def test_auto_camera_of_an_empty_stage_is_finite(make_stage):
    found = auto_camera(make_stage(""), Usd.TimeCode.Default(), (), aspect=2.0)
    assert np.isfinite(found["transform"]).all()
    assert found["verticalAperture"] == pytest.approx(found["horizontalAperture"] / 2)


def test_auto_camera_frames_what_is_sound(make_stage):
    damaged = (
        'def Cube "Bad"\n{\n    string xformOp:translate = "x"\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )
    sound = 'def Cube "Good"\n{\n}\n'
    expected = auto_camera(make_stage(sound), Usd.TimeCode.Default(), ())
    assert auto_camera(make_stage(damaged + sound), Usd.TimeCode.Default(), ()) == expected


SETTINGS = 'def RenderSettings "R"\n{\n%s\n}\n'
NAMED = '    renderSettingsPrimPath = "/R"'


def test_render_settings(flat):
    body = (
        camera()
        + SETTINGS
        % """
    rel camera = </Cam>
    uniform int2 resolution = (320, 200)
    uniform float pixelAspectRatio = 2
    uniform float4 dataWindowNDC = (0, 0, 0.5, 1)
    uniform bool disableDepthOfField = 1
    uniform token aspectRatioConformPolicy = "cropAperture"
    int dermis:samples = 16
    float dermis:timeLimit = 2.5
    token dermis:walk = "classical"
    bool dermis:lightsVisibleToCamera = 1
"""
    )
    result = flat(body, metadata=NAMED)
    assert result.warnings == []
    assert result.settings == {
        "camera": "/Cam",
        "resolution": [320, 200],
        "pixelAspectRatio": 2.0,
        "dataWindowNDC": [0.0, 0.0, 0.5, 1.0],
        "disableDepthOfField": True,
        "aspectRatioConformPolicy": "cropAperture",
        "samples": 16,
        "timeLimit": 2.5,
        "walk": "classical",
        "lightsVisibleToCamera": True,
    }
    assert flat(body).settings == {}
    assert flat(body, render_settings="/R").settings["samples"] == 16


def test_products_override_and_name_aovs(flat):
    body = (
        SETTINGS % "    rel products = </P>\n    uniform int2 resolution = (10, 10)"
        + """
def RenderProduct "P"
{
    uniform int2 resolution = (20, 20)
    rel orderedVars = [</color>, </z>, </weird>]
}
def RenderVar "color"
{
    uniform string sourceName = "Ci"
}
def RenderVar "z"
{
    uniform string sourceName = "z"
}
def RenderVar "weird"
{
    uniform string sourceName = "lpe:x"
}
"""
    )
    result = flat(body, metadata=NAMED)
    assert result.settings == {"resolution": [20, 20], "aovs": ["depth"]}
    assert [prim for prim, _ in result.warnings] == ["/weird"]


def test_damaged_settings(flat):
    body = (
        SETTINGS
        % """
    rel camera = </Gone>
    uniform int2 resolution = (0, -4)
    int dermis:samples = -3
    int dermis:nonsense = 3
    string dermis:seed = "x"
"""
    )
    result = flat(body, metadata=NAMED)
    assert result.settings == {"samples": 64, "seed": 0}
    assert [prim for prim, _ in result.warnings] == ["/R", "/R", "/R", "/R", "/Gone"]
    missing = flat("", metadata=NAMED)
    assert missing.settings == {} and missing.warnings[0][0] == "/R"


def test_our_stage_of_depth_of_field(usd_scenes):
    """The width of each lamp, by its second moment, is that of its disc convolved with the disc of confusion: in the
    lamp's plane, at distance z, (f / N) |z - s| / s."""
    stage = Usd.Stage.Open(str(usd_scenes / "depth_of_field.usda"))
    for name in ("Floor", "Tile", "Sky"):
        stage.OverridePrim(f"/World/{name}").SetActive(False)
    image = dermis.render(stage, resolution=[320, 160], samples=64, aovs=[])
    assert image.stats["warnings"] == []
    glow = image.color[..., 0].astype(float)
    column, row = np.meshgrid(np.arange(320) + 0.5, np.arange(160) + 0.5)
    for x, z in ((-13, 80), (-9, 100), (0, 120), (11, 160), (26, 220)):
        pixels = 80 / 36 * 320 / z
        middle = 160 + x * pixels
        near = (np.abs(column - middle) < 17) & (np.abs(row - 80) < 17)
        weight = np.where(near, glow, 0) / glow[near].sum()
        assert (weight * column).sum() == pytest.approx(middle, abs=0.3)
        confusion = 4.0 * abs(z - 120) / 120
        # A disc of diameter d has d^2 / 16, the tent of the film 1 / 6.
        expected = (confusion**2 + 1.0**2) * pixels**2 / 16 + 1 / 6
        assert (weight * (row - 80) ** 2).sum() == pytest.approx(expected, rel=0.06), z
