"""Defects that were found once, each with the smallest input that showed it."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

import dermis
from dermis.cli import main

CARD = """
def Mesh "Card"
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    uniform token subdivisionScheme = "none"
}
"""

LIGHT = """
def RectLight "Key"
{
    float inputs:intensity = 10
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""

CAMERA_IN_WAX = """
def Camera "main_cam"
{
    float focalLength = 20
    float2 clippingRange = (0.01, 100)
}
def Sphere "Wax" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    double radius = 1
    rel material:binding = </Look>
}
def Material "Look"
{
    token outputs:surface.connect = </Look/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        color3f inputs:subsurfaceRadius = (0.1, 0.1, 0.1)
        token outputs:surface
    }
}
"""

SMALL = {"resolution": (8, 8), "samples": 1, "threads": 1}


def test_a_prim_that_is_no_camera_is_refused_as_camera(make_stage):
    """It was a KeyError: 'horizontalAperture'."""
    image = dermis.render(make_stage(CARD + LIGHT), camera="/Key", **SMALL)
    said = [(entry["prim"], entry["message"]) for entry in image.stats["warnings"]]
    assert ("/Key", "camera: there is no such camera; it is ignored") in said
    assert np.isfinite(image.color).all() and image.color[..., 3].max() > 0.0


def test_a_settings_prim_that_names_no_camera_is_refused(make_stage):
    settings = 'def RenderSettings "Settings"\n{\n    rel camera = </Key>\n}\n'
    stage = make_stage(CARD + LIGHT + settings, 'renderSettingsPrimPath = "/Settings"')
    image = dermis.render(stage, **SMALL)
    assert "/Key" in [entry["prim"] for entry in image.stats["warnings"]]


def test_a_camera_inside_of_a_medium_is_said(tmp_path: Path, capsys):
    """Most walks leaked, and nothing was said beside the statistics."""
    file = tmp_path / "inside.usda"
    file.write_text("#usda 1.0\n" + CAMERA_IN_WAX + LIGHT)
    assert main(["record", str(file), str(tmp_path / "a.exr"), "-w", "8", "--samples", "4"]) == 0
    assert "subsurface walks leaked and ended black" in capsys.readouterr().err


@pytest.mark.parametrize("flag", ["--stats", "--displayImage"])
def test_two_outputs_of_one_name_are_a_usage_error(make_stage, tmp_path: Path, flag, capsys):
    """The statistics replaced the image, with exit code 0."""
    file, image = str(tmp_path / "card.usda"), str(tmp_path / "a.png")
    make_stage(CARD).Export(file)
    with pytest.raises(SystemExit) as left:
        main(["record", file, image, "-w", "8", "--samples", "1", flag, image])
    assert left.value.code == 2 and "must be different files" in capsys.readouterr().err
    assert not Path(image).exists()
