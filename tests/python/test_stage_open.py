"""Opening stages: formats, missing files, damage, composition errors, stage metadata, time."""

import zipfile

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdUtils

from dermis.stage import StageError, encode, flatten, open_stage

BALL = 'def Sphere "Ball"\n{\n}\n'


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_opens_text_and_crate(tmp_path, suffix):
    layer = Sdf.Layer.CreateNew(str(tmp_path / f"ball{suffix}"))
    layer.ImportFromString("#usda 1.0\n" + BALL)
    layer.Save()
    assert list(flatten(open_stage(layer.realPath)).prims) == ["/Ball"]


def test_opens_a_package(tmp_path):
    (tmp_path / "ball.usda").write_text("#usda 1.0\n" + BALL)
    package = tmp_path / "ball.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "ball.usda"), str(package))
    assert zipfile.is_zipfile(package)
    assert list(flatten(open_stage(package)).prims) == ["/Ball"]


def test_missing_file_is_usdrecords_message(tmp_path):
    with pytest.raises(StageError, match="Could not open layer: .*nope.usda"):
        open_stage(tmp_path / "nope.usda")


@pytest.mark.parametrize("content", ["", "#usda 1.0\ndef Xform {", "PXR-USDC damaged", "no usd at all"])
def test_damaged_file_is_an_error(tmp_path, content):
    for suffix in (".usda", ".usdc", ".usdz"):
        file = tmp_path / f"damaged{suffix}"
        file.write_text(content)
        with pytest.raises(StageError, match="Could not open layer"):
            open_stage(file)


def test_session_layer_and_mask(tmp_path):
    (tmp_path / "two.usda").write_text("#usda 1.0\n" + BALL + BALL.replace("Ball", "Other"))
    (tmp_path / "session.usda").write_text('#usda 1.0\nover "Ball"\n{\n    double radius = 3\n}\n')
    masked = flatten(open_stage(tmp_path / "two.usda", tmp_path / "session.usda", ["/Ball"]))
    assert list(masked.prims) == ["/Ball"]
    assert masked.prims["/Ball"]["points"].max() == pytest.approx(3.0)
    with pytest.raises(StageError, match="session_gone"):
        open_stage(tmp_path / "two.usda", tmp_path / "session_gone.usda")


def test_unresolved_arcs_are_warnings_and_the_rest_renders(tmp_path):
    (tmp_path / "main.usda").write_text(
        "#usda 1.0\n(\n    subLayers = [@gone_sub.usda@]\n)\n"
        'def Xform "Ref" (\n    references = @gone_ref.usda@\n)\n{\n}\n'
        'def Xform "Pay" (\n    payload = @gone_pay.usda@\n)\n{\n}\n' + BALL
    )
    result = flatten(open_stage(tmp_path / "main.usda"))
    assert list(result.prims) == ["/Ball"]
    warnings = dict(result.warnings)
    assert "gone_ref.usda" in warnings["/Ref"]
    assert "gone_pay.usda" in warnings["/Pay"]
    assert any("gone_sub.usda" in message for message in warnings.values())


def test_stage_metadata(flat):
    info = flat(BALL, metadata='    upAxis = "Z"\n    metersPerUnit = 0.1').stage
    assert (info["upAxis"], info["metersPerUnit"]) == ("Z", 0.1)
    info = flat(BALL).stage
    assert (info["upAxis"], info["metersPerUnit"]) == ("Y", 0.01)


def test_empty_stage(flat):
    result = flat("")
    assert result.prims == {} and result.warnings == []


def test_inactive_prims_are_absent(flat):
    body = 'def Xform "A" (\n    active = false\n)\n{\n    def Sphere "S"\n    {\n    }\n}\n' + BALL
    assert list(flat(body).prims) == ["/Ball"]


def test_time_reads_points_transform_and_visibility(flat):
    body = """
def Mesh "M"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points.timeSamples = {
        1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        3: [(0, 0, 2), (1, 0, 2), (0, 1, 2)],
    }
    token visibility.timeSamples = {
        1: "inherited",
        3: "invisible",
    }
    double3 xformOp:translate.timeSamples = {
        1: (0, 0, 0),
        3: (4, 0, 0),
    }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    first, middle, last = (flat(body, time).prims["/M"] for time in (1, 2, 3))
    assert middle["points"][0, 2] == pytest.approx(1.0)
    assert [m["transform"][3][0] for m in (first, middle, last)] == [0.0, 2.0, 4.0]
    assert [m["visible"] for m in (first, middle, last)] == [True, True, False]
    # Without a time an animated stage shows its first sample, not the schema's fallback.
    assert flat(body).prims["/M"]["points"][0, 2] == 0.0


def test_encode_replaces_arrays_and_refuses_what_json_cannot_say():
    points = np.zeros((3, 3), np.float32)
    text, arrays = encode(
        {"type": "Mesh", "points": points, "geomSubsets": [{"indices": np.array([0], np.int32)}]}
    )
    assert text == '{"type": "Mesh", "points": {"array": 0}, "geomSubsets": [{"indices": {"array": 1}}]}'
    assert arrays[0] is points or np.shares_memory(arrays[0], points)
    with pytest.raises(ValueError, match="[Oo]ut of range"):
        encode({"type": "Light", "intensity": float("nan")})


def test_arrays_are_views_of_usd_memory(make_stage):
    stage = make_stage(
        'def Mesh "M"\n{\n    int[] faceVertexCounts = [3]\n    int[] faceVertexIndices = [0, 1, 2]\n'
        "    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n}\n"
    )
    held = np.asarray(stage.GetPrimAtPath("/M").GetAttribute("points").Get(Usd.TimeCode.Default()))
    assert np.shares_memory(flatten(stage).prims["/M"]["points"], held)


def test_materialx_files_say_what_reads_them(tmp_path):
    """usd-core has no reader; with usd-exchange the material is there."""
    (tmp_path / "red.mtlx").write_text(
        '<?xml version="1.0"?>\n<materialx version="1.38">\n'
        '  <standard_surface name="SR" type="surfaceshader">'
        '<input name="base_color" type="color3" value="0.75, 0.25, 0.125"/></standard_surface>\n'
        '  <surfacematerial name="Red" type="material">'
        '<input name="surfaceshader" type="surfaceshader" nodename="SR"/></surfacematerial>\n</materialx>\n'
    )
    text = (
        '#usda 1.0\ndef "Looks" (\n    references = @red.mtlx@</MaterialX/Materials>\n)\n{\n}\n'
        'def Sphere "B" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n{\n'
        "    rel material:binding = </Looks/Red>\n}\n"
    )
    (tmp_path / "a.usda").write_text(text)
    result = flatten(open_stage(tmp_path / "a.usda"))
    if "/Looks/Red" in result.prims:
        assert result.prims["/Looks/Red"]["base_color"] == [0.75, 0.25, 0.125]
        return
    prim, message = result.warnings[0]
    assert prim == "/Looks" and message.endswith("pip install usd-exchange MaterialX")
    with pytest.raises(StageError, match="pip install usd-exchange MaterialX"):
        open_stage(tmp_path / "red.mtlx")


@pytest.mark.parametrize("mode", ["cards", "bounds", "origin", "default", "inherited"])
def test_draw_modes_are_said(flat, mode):
    text = f'def Xform "X" (\n    kind = "component"\n)\n{{\n    uniform token model:drawMode = "{mode}"\n'
    text += '    def Sphere "S"\n    {\n    }\n}\n'
    found = flat(text)
    assert found.prims["/X/S"]["visible"]
    said = [f"model:drawMode: '{mode}' is not drawn; the model itself is rendered"]
    assert [message for _, message in found.warnings] == ([] if mode in ("default", "inherited") else said)


def test_procedurals_are_said(flat):
    [(path, message)] = flat('def GenerativeProcedural "P"\n{\n}\n').warnings
    assert path == "/P" and message.startswith("GenerativeProcedural is not rendered")
