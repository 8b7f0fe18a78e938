"""The command line end to end: stages in, images, messages and exit codes out. Renders are tiny."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import CAMERA, CARD, DOME, channels, read_exr, run, stage_text, write_stage
from PIL import Image

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from dermis import render

MOVING_LIGHT = """
    def DistantLight "Sun"
    {
        float inputs:angle = 0
        float inputs:intensity.timeSamples = {1: 1, 3: 3}
    }
"""

SETTINGS = """
def Scope "Render"
{
    def RenderSettings "Settings"
    {
        uniform int2 resolution = (24, 12)
        rel camera = </World/shot>
        int dermis:samples = 2
    }
}
"""

#: The flags of a small, quick render.
SMALL = ("--samples", "2", "-w", "16")


@pytest.fixture
def stage(tmp_path):
    """Writes a stage of the given prims below /World; returns its file name."""

    def write(*prims: str, metadata: str = "", outside: str = "", name: str = "stage.usda") -> str:
        body = "\n".join(prims)
        text = (
            f'#usda 1.0\n(\n    upAxis = "Y"\n    {metadata}\n)\ndef Xform "World"\n{{\n{body}\n}}\n{outside}'
        )
        return write_stage(tmp_path / name, text)

    return write


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_record_says_what_usdrecord_says(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, DOME, metadata="startTimeCode = 5\n endTimeCode = 9")
    assert run("record", file, tmp_path / "a.exr", *SMALL) == 0
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        "Camera: /World/main_cam",
        "Renderer plugin: dermis",
        "Recording time code: 5.000000",
    ]
    assert said.err == ""
    spec, pixels = read_exr(tmp_path / "a.exr")
    assert (spec.width, spec.height) == (16, 16)
    # A white card in a white dome of radiance 1 (furnace), filling the middle of the view.
    # Up to the highlight of the surface, which has a specular lobe.
    np.testing.assert_allclose(pixels[6:10, 6:10, :3].mean(), 1.0, rtol=0.2)


def test_png_is_the_display_transform_of_the_linear_image(stage, tmp_path):
    from dermis import color

    file = stage(CARD, CAMERA, DOME)
    assert run("record", file, tmp_path / "a.exr", "--displayImage", tmp_path / "a.png", *SMALL) == 0
    assert run("record", file, tmp_path / "b.png", *SMALL) == 0
    shown = np.array(Image.open(tmp_path / "a.png"))
    np.testing.assert_array_equal(shown, np.array(Image.open(tmp_path / "b.png")))
    spec, pixels = read_exr(tmp_path / "a.exr")
    rgba = pixels[..., [spec.channelnames.index(c) for c in "RGBA"]]
    expected = color.display_pixels(rgba, color.DisplayTransform(), alpha=True)
    # The EXR may hold half floats.
    assert np.abs(expected.astype(int) - shown).max() <= 1


def test_camera_by_name_by_path_and_missing(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, CAMERA.replace("main_cam", "shot"), DOME)
    for name in ("shot", "/World/shot"):
        assert run("record", file, tmp_path / "a.exr", "-cam", name, *SMALL) == 0
        assert "Camera: /World/shot\n" in capsys.readouterr().out
    assert run("record", file, tmp_path / "b.exr", "--camera", "/World/nobody", *SMALL) == 0
    said = capsys.readouterr()
    assert "Warning: /World/nobody: camera: there is no such camera on the stage" in said.err
    assert "Camera: /World/main_cam\n" in said.out
    assert (tmp_path / "b.exr").exists()


def test_stage_without_camera_is_framed(stage, tmp_path, capsys):
    assert run("record", stage(CARD, DOME), tmp_path / "a.png", *SMALL) == 0
    said = capsys.readouterr()
    assert "Camera: \n" in said.out
    assert "the stage is framed automatically" in said.err
    image = np.array(Image.open(tmp_path / "a.png"))
    # Height by GfCamera's default aspect; the card stands in the middle, the corners are empty.
    assert image.shape == (11, 16, 4)
    assert image[5, 8, 3] == 255 and image[5, 0, 3] == 0


def test_stage_without_lights_is_lit_from_the_camera(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA)
    assert run("record", file, tmp_path / "a.exr", *SMALL) == 0
    assert "it is lit from the camera" in capsys.readouterr().err
    _, pixels = read_exr(tmp_path / "a.exr")
    # Up to the highlight of the surface, which has a specular lobe.
    np.testing.assert_allclose(pixels[6:10, 6:10, :3].mean(), 1.0, rtol=0.2)
    assert run("record", file, tmp_path / "b.exr", "--disableCameraLight", *SMALL) == 0
    said = capsys.readouterr().err
    assert "camera light is disabled" in said
    assert f"Warning: {tmp_path}/b.exr: the image is all black" in said


def test_every_frame_that_is_black_is_named(stage, tmp_path, capsys):
    flags = ("--disableCameraLight", "--frames", "1:2", *SMALL)
    assert run("record", stage(CARD, CAMERA), tmp_path / "a.#.exr", *flags) == 0
    said = capsys.readouterr().err
    assert all(f"{tmp_path}/a.{frame}.exr: the image is all black" in said for frame in (1, 2))


def test_empty_stage_renders_black(stage, tmp_path, capsys):
    assert run("record", stage(), tmp_path / "a.png", *SMALL) == 0
    assert "all black" in capsys.readouterr().err
    assert not np.array(Image.open(tmp_path / "a.png"))[..., 3].any()


def test_render_settings_prim_decides_unless_flags_are_typed(stage, tmp_path, capsys):
    shot = CAMERA.replace("main_cam", "shot")
    metadata = 'renderSettingsPrimPath = "/Render/Settings"'
    file = stage(CARD, CAMERA, shot, DOME, metadata=metadata, outside=SETTINGS)
    assert run("record", file, tmp_path / "a.png", "--stats", tmp_path / "a.json") == 0
    assert "Camera: /World/shot\n" in capsys.readouterr().out
    assert Image.open(tmp_path / "a.png").size == (24, 12)
    assert json.loads((tmp_path / "a.json").read_text())["samples_per_pixel"] == 2
    flags = ("-w", "8", "-cam", "main_cam", "--samples", "1")
    assert run("record", file, tmp_path / "b.png", *flags) == 0
    said = capsys.readouterr().out
    assert "Camera: /World/main_cam\n" in said
    assert "Flag overrides samples of </Render/Settings>: 1 instead of 2" in said
    assert "Flag overrides resolution of </Render/Settings>: 8,8 instead of 24,12" in said
    assert Image.open(tmp_path / "b.png").size == (8, 8)


def test_render_pass_errors(stage, tmp_path, capsys):
    file = stage(CARD, outside='def RenderPass "Pass" {}')
    assert run("record", file, tmp_path / "a.png", "-rp", "/Pass", "-rs", "/S") == 1
    assert "Cannot specify both --renderSettingsPrimPath and --renderPassPrimPath" in capsys.readouterr().err
    assert run("record", file, tmp_path / "a.png", "-rp", "/Nothing") == 1
    assert "Unknown render pass </Nothing>" in capsys.readouterr().err
    assert run("record", file, tmp_path / "a.png", "-rp", "/Pass") == 1
    assert "Render source not authored on /Pass" in capsys.readouterr().err


def test_frames(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, MOVING_LIGHT)
    assert (
        run("record", file, tmp_path / "f.##.#.exr", "--frames", "1:3,2.5", "--progress", "alf", *SMALL) == 0
    )
    said = capsys.readouterr().out
    assert [f"Recording time code: {t:.6f}" in said for t in (1, 2, 3, 2.5)] == [True] * 4
    assert said.count("Camera:") == 1
    assert said.rstrip().endswith("ALF_PROGRESS 100%")
    files = [tmp_path / f"f.{frame}.exr" for frame in ("01.0", "02.0", "02.5", "03.0")]
    means = [read_exr(file)[1][6:10, 6:10, :3].mean() for file in files]
    # As the light's intensity, interpolated between its samples.
    np.testing.assert_allclose(means / means[0], [1.0, 2.0, 2.5, 3.0], rtol=1e-3)


def test_a_frame_after_others_is_the_frame_alone(stage, tmp_path):
    file = stage(CARD, CAMERA, MOVING_LIGHT)
    assert run("record", file, tmp_path / "f.#.exr", "--frames", "1:3", *SMALL) == 0
    assert run("record", file, tmp_path / "alone.#.exr", "--frames", "3", *SMALL) == 0
    np.testing.assert_array_equal(read_exr(tmp_path / "f.3.exr")[1], read_exr(tmp_path / "alone.3.exr")[1])


def test_one_failed_frame_does_not_stop_the_others(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, DOME)
    (tmp_path / "f.2.png").mkdir()
    assert run("record", file, tmp_path / "f.#.png", "-f", "1:3", *SMALL) == 1
    said = capsys.readouterr().err
    assert "Recording aborted due to the following failure at time code 2.0: Cannot write" in said
    assert (tmp_path / "f.1.png").is_file() and (tmp_path / "f.3.png").is_file()


@pytest.mark.parametrize(
    ("output", "flags", "said"),
    [
        ("a.exr", ["-f", "1:2"], "outputImagePath must contain exactly one frame number placeholder"),
        ("a.#.exr", [], "outputImagePath cannot contain a frame number placeholder"),
        ("a.#.exr", ["-f", "1:2x0.5"], "a minimum floating point precision of 1"),
        (
            "a.#.exr",
            ["-f", "1:2", "--stats", "s.json"],
            "stats must contain exactly one frame number placeholder",
        ),
        ("a.#.exr", ["-f", "one"], 'Invalid FrameSpec: "one"'),
        ("a.exr", ["--set", "sampels=1"], "there is no setting 'sampels'; did you mean samples?"),
        ("a.exr", ["--set", "resolution=4,4", "-w", "4"], "contradicts"),
        ("a.exr", ["-w", "1000000"], "too large"),
        ("a.png", ["--ocioView", "Pretty"], "Unknown OpenColorIO view 'Pretty'"),
        ("a.png", ["-color", "sRGB", "--ocioView", "Raw"], "does not go with"),
        ("a.exr", ["--walk", "vpg"], "walk 'vpg' is not available in this version"),
    ],
)
def test_usage_errors(stage, tmp_path, capsys, output, flags, said):
    assert run("record", stage(CARD, CAMERA, DOME), tmp_path / output, *flags) == 2
    assert said in capsys.readouterr().err
    assert names(tmp_path) == ["stage.usda"]


def test_missing_file(tmp_path, capsys):
    assert run("record", tmp_path / "nope.usda", tmp_path / "a.exr") == 1
    assert f"Could not open layer: {tmp_path / 'nope.usda'}" in capsys.readouterr().err
    assert run("record", tmp_path / "nope.dermis", tmp_path / "a.exr") == 1
    assert "nope.dermis" in capsys.readouterr().err
    assert names(tmp_path) == []


def test_missing_session_layer(stage, tmp_path, capsys):
    assert run("record", stage(CARD), tmp_path / "a.exr", "--sessionLayer", tmp_path / "nope.usda") == 1
    assert "Could not open layer" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["broken.usda", "broken.usdc", "broken.dermis"])
def test_damaged_file(tmp_path, capsys, name):
    (tmp_path / name).write_bytes(b"\x00\x01 this is no scene")
    assert run("record", tmp_path / name, tmp_path / "a.exr", *SMALL) == 1
    assert name in capsys.readouterr().err
    assert names(tmp_path) == [name]


def bad_material(authored: str) -> str:
    """A material with subsurface and the bad line, and a card that wears it."""
    return (
        'def Material "Bad"\n{\ntoken outputs:surface.connect = </World/Bad/Surface.outputs:surface>\n'
        'def Shader "Surface"\n{\nuniform token info:id = "UsdPreviewSurface"\nfloat inputs:subsurface = 1\n'
        + authored
        + "\ntoken outputs:surface\n}\n}\n"
        + CARD.replace("Card", "Worn").replace("{", "{\nrel material:binding = </World/Bad>", 1)
    )


BAD_PRIMS = {
    "negative radius": bad_material("color3f inputs:subsurfaceRadius = (-1, 0.1, 0.1)"),
    "nan radius": bad_material("color3f inputs:subsurfaceRadius = (nan, 0.1, 0.1)"),
    "albedo above 1": bad_material("color3f inputs:subsurfaceAlbedo = (1.5, 0.5, 0.5)"),
    "nan albedo": bad_material("color3f inputs:subsurfaceAlbedo = (0.5, nan, 0.5)"),
    "colour above 1": bad_material("color3f inputs:subsurfaceColor = (0.5, 3, 0.5)"),
    "zero scale": CARD.replace("Card", "Bad").replace(
        "uniform token sub",
        'double3 xformOp:scale = (0, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:scale"]\nuniform token sub',
    ),
    "reference": 'def "Gone" (references = @./gone.usda@) {}',
    "nan points": CARD.replace("(1, 1, 0)", "(nan, 1, 0)").replace("Card", "Bad"),
    "infinite points": CARD.replace("(1, 1, 0)", "(inf, 1, 0)").replace("Card", "Bad"),
    "index out of range": CARD.replace("[0, 1, 2, 3]", "[0, 1, 2, 9]").replace("Card", "Bad"),
    "negative index": CARD.replace("[0, 1, 2, 3]", "[0, 1, 2, -1]").replace("Card", "Bad"),
    "counts": CARD.replace("[4]", "[3]").replace("Card", "Bad"),
    "singular scale": CARD.replace("Card", "Bad").replace(
        "uniform token sub",
        'double3 xformOp:scale = (1, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:scale"]\nuniform token sub',
    ),
    "zero-area light": 'def RectLight "Bad"\n{\nfloat inputs:width = 0\nbool inputs:normalize = 1\n}',
    "missing texture": 'def DomeLight "Bad"\n{\nasset inputs:texture:file = @./gone.exr@\n}',
}


@pytest.mark.parametrize("bad", BAD_PRIMS.values(), ids=BAD_PRIMS.keys())
def test_bad_prim_warns_and_the_rest_renders(stage, tmp_path, capsys, bad):
    stats = tmp_path / "s.json"
    assert run("record", stage(CARD, CAMERA, DOME, bad), tmp_path / "a.exr", "--stats", stats, *SMALL) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("Warning: ")]
    assert [line for line in said if "/World/Bad" in line or "/World/Gone" in line]
    written = json.loads(stats.read_text())
    assert len(written["warnings"]) == len(said)
    assert written["non_finite_samples"] == 0
    _, pixels = read_exr(tmp_path / "a.exr")
    assert np.isfinite(pixels).all()
    assert pixels[8, 8, :3].min() > 0.5


def test_zero_area_faces_render(stage, tmp_path):
    flat = CARD.replace("(1, 1, 0), (-1, 1, 0)", "(1, -1, 0), (-1, -1, 0)").replace("Card", "Flat")
    assert run("record", stage(CARD, CAMERA, DOME, flat), tmp_path / "a.exr", *SMALL) == 0
    assert np.isfinite(read_exr(tmp_path / "a.exr")[1]).all()


def test_crop_is_the_data_window(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    assert run("record", file, tmp_path / "a.exr", "--crop", "0.25", "0.5", "0.75", "1", *SMALL) == 0
    assert run("record", file, tmp_path / "whole.exr", *SMALL) == 0
    spec, pixels = read_exr(tmp_path / "a.exr")
    assert (spec.full_width, spec.full_height) == (16, 16)
    # y of USD's data window points up: the upper half.
    assert (spec.x, spec.y, spec.width, spec.height) == (4, 0, 8, 8)
    np.testing.assert_array_equal(pixels, read_exr(tmp_path / "whole.exr")[1][0:8, 4:12])


def test_aovs_are_layers(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    assert run("record", file, tmp_path / "a.exr", "--aov", "depth", "--aov", "normal", *SMALL) == 0
    channels = " ".join(read_exr(tmp_path / "a.exr")[0].channelnames)
    assert "depth" in channels and "normal" in channels and "albedo" not in channels


def test_flattened_file_gives_the_same_image(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    assert run("flatten", file, tmp_path / "a.dermis", "-w", "16") == 0
    assert run("record", tmp_path / "a.dermis", tmp_path / "a.exr", "--samples", "2") == 0
    assert run("record", file, tmp_path / "b.exr", *SMALL) == 0
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")[1], read_exr(tmp_path / "b.exr")[1])


def test_flattened_file_refuses_flags_for_stages(stage, tmp_path, capsys):
    assert run("flatten", stage(CARD, CAMERA, DOME), tmp_path / "a.dermis") == 0
    assert run("record", tmp_path / "a.dermis", tmp_path / "a.exr", "--purposes", "render") == 2
    assert "purposes applies to a USD stage" in capsys.readouterr().err


def test_explain_lists_needs_and_warnings(stage, capsys):
    assert run("explain", stage(CARD, DOME)) == 0
    said = capsys.readouterr().out
    assert "camera: framed automatically" in said
    assert "needs" in said
    assert "/: camera: none found" in said


BALL = """
    def Mesh "Ball"
    {
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
        point3f[] points = [(-1, -1, -1), (1, -1, -1), (-1, 1, -1), (1, 1, -1),
            (-1, -1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, 1)]
    }
"""


def test_complexity_refines_subdivision_surfaces(stage, tmp_path, capsys):
    """usdrecord's default is the cage; then 24, 96 and 384 quads for its six."""
    file, covered = stage(BALL, CAMERA, DOME), []
    flags = ("--samples", "4", "-w", "64", "--stats", tmp_path / "s.json")
    for level, name in enumerate(("low", "medium", "high", "veryhigh")):
        typed = ("--complexity", name) if level else ()
        assert run("record", file, tmp_path / "a.exr", *flags, *typed) == 0
        said, triangles = capsys.readouterr().out, 12 * 4**level
        assert f"Subdivision surfaces at level {level}: 1, {triangles} triangles" in said
        needs = json.loads((tmp_path / "s.json").read_text())["needs"]
        assert needs["triangles"] == triangles and needs["refined_meshes"] == (level > 0)
        covered.append(read_exr(tmp_path / "a.exr")[1][..., 3].mean())
    # The cage is the square of 2 x 2 of its front at distance 9; the surface is well within. Chords of its silhouette
    # miss less of it from level to level, by 4 each.
    assert covered[0] == pytest.approx((2 / 9 * 50 / 20) ** 2, rel=0.02)
    assert covered[1] < 0.6 * covered[0]
    assert covered[1] < covered[2] < covered[3]
    assert covered[3] - covered[2] < 0.5 * (covered[2] - covered[1]) < 0.1 * covered[1]


def test_refine_levels_by_prim_by_settings_and_by_flag(stage, capsys):
    own = BALL.replace("    {\n", "    {\n        int primvars:dermis:refineLevel = 1\n", 1)
    settings = SETTINGS.replace("dermis:samples = 2", "dermis:refineLevel = 2")
    metadata = 'renderSettingsPrimPath = "/Render/Settings"'
    file = stage(own, BALL.replace("Ball", "Other"), CAMERA, DOME, outside=settings, metadata=metadata)
    assert run("explain", file) == 0
    said = capsys.readouterr().out
    assert "/World/Ball: catmullClark, level 1: 6 faces to 48 triangles" in said
    assert "/World/Other: catmullClark, level 2: 6 faces to 192 triangles" in said
    assert run("explain", file, "--complexity", "veryhigh") == 0
    said = capsys.readouterr().out
    assert "/World/Ball: catmullClark, level 1" in said and "/World/Other: catmullClark, level 3" in said
    assert run("explain", file, "--set", "refineLevel=0") == 0
    assert "/World/Other: catmullClark, its cage: 6 faces to 12 triangles" in capsys.readouterr().out


def test_a_flattened_file_is_refined_as_asked(stage, tmp_path, capsys):
    assert run("flatten", stage(BALL, CAMERA, DOME), tmp_path / "a.dermis", "-w", "16") == 0
    for flags, level in ((("-c", "high"), 2), ((), 0)):
        assert run("record", tmp_path / "a.dermis", tmp_path / "a.exr", "--samples", "2", *flags) == 0
        assert f"Subdivision surfaces at level {level}: 1," in capsys.readouterr().out


WAX = """
    def Material "Wax"
    {
        token outputs:surface.connect = </World/Wax/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            color3f inputs:subsurfaceRadius = (0.1, 0.05, 0.02)
            token outputs:surface
        }
    }
"""
ROPE = """
    def BasisCurves "Rope" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        uniform token type = "cubic"
        uniform token basis = "bspline"
        uniform token wrap = "%s"
        int[] curveVertexCounts = [4]
        point3f[] points = [(-1, 0, 0), (0, 1, 0.5), (1, 0, 0), (0, -1, -0.5)]
        float[] widths = [0.4] (
            interpolation = "constant"
        )
        rel material:binding = </World/Wax>
    }
"""


@pytest.mark.parametrize("body", ["surface", "periodic", "pinned"])
def test_walks_stay_within_what_was_tessellated(stage, tmp_path, body):
    """Refined surfaces and tubes are closed: no walk under them leaks, no edge is open."""
    worn = BALL.replace('"Ball"', '"Ball" (prepend apiSchemas = ["MaterialBindingAPI"])')
    worn = worn.replace("    }\n", "        rel material:binding = </World/Wax>\n    }\n")
    file = stage(worn if body == "surface" else ROPE % body, WAX, CAMERA, DOME)
    flags = ("-w", "48", "--samples", "8", "-c", "high", "--stats", tmp_path / "s.json")
    assert run("record", file, tmp_path / "a.exr", *flags) == 0
    stats = json.loads((tmp_path / "s.json").read_text())
    assert stats["walks"] > 1000 and stats["walks_leaked"] == 0 and stats["warnings"] == []


CREASES = """        int[] creaseIndices = [0, 7]
        int[] creaseLengths = [2]
        float[] creaseSharpnesses = [2]
    }
"""


def test_tags_that_fit_nothing_are_said(stage, tmp_path, capsys):
    file = stage(BALL.replace("    }\n", CREASES), CAMERA, DOME)
    assert run("record", file, tmp_path / "a.exr", "-c", "high", *SMALL) == 0
    assert "Warning: /World/Ball: creaseIndices: 1 of 1 edges are none of the mesh" in capsys.readouterr().err


POINTS = """
    def Points "Points"
    {
        point3f[] points = [(-1.2, 0, 0), (1.2, 0, 0)]
        float[] widths = [1.6, 0.8]
        color3f[] primvars:displayColor = [(0.8, 0, 0), (0, 0.4, 0)] (
            interpolation = "vertex"
        )
    }
"""


def test_points_are_spheres_of_their_width_and_colour(stage):
    file = stage(POINTS, CAMERA, DOME)
    image = render(file, resolution=(128, 128), samples=16)
    red, green, alpha = image["albedo"][..., 0], image["albedo"][..., 1], image.color[..., 3]
    assert red[:, 64:].sum() < 0.1 * red[:, :64].sum() and green[:, :64].sum() < 0.1 * red[:, :64].sum()
    assert green[:, 64:].max() == pytest.approx(0.4, abs=0.1)
    # Discs of radius 0.8 and 0.4 at distance 10, on a film of 128 pixels for 4 units there.
    left, right = alpha[:, :64].sum(), alpha[:, 64:].sum()
    assert left == pytest.approx(np.pi * (0.8 * 32) ** 2, rel=0.04)
    assert right == pytest.approx(np.pi * (0.4 * 32) ** 2, rel=0.04)


def test_set_alone_lists_the_settings(capsys):
    assert run("record", "a.usda", "a.exr", "--set") == 0
    listed = dict(line.split("=", 1) for line in capsys.readouterr().out.splitlines())
    assert listed["walk"] == "auto" and int(listed["samples"]) > 0


def test_stats_have_the_names_of_the_contract(stage, tmp_path):
    assert (
        run("record", stage(CARD, CAMERA, DOME), tmp_path / "a.exr", "--stats", tmp_path / "s.json", *SMALL)
        == 0
    )
    stats = json.loads((tmp_path / "s.json").read_text())
    for name in ("samples_per_pixel", "walks", "walk_steps", "peak_rss_bytes", "warnings", "needs"):
        assert name in stats
    assert {"total", "flatten", "compile", "train", "render"} <= stats["seconds"].keys()
    assert stats["seconds"]["total"] >= stats["seconds"]["flatten"] > 0.0
    assert stats["rays"]["total"] > 0
    assert stats["non_finite_samples"] == 0


def test_time_limit_ends_the_render_with_an_image(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    began = time.monotonic()
    assert (
        run("record", file, tmp_path / "a.exr", "-w", "32", "--samples", "1000000", "--timeLimit", "1") == 0
    )
    assert time.monotonic() - began < 10.0
    assert (tmp_path / "a.exr").exists()


def test_interrupt_writes_what_is_there(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    command = [
        sys.executable,
        "-m",
        "dermis",
        "record",
        file,
        str(tmp_path / "a.#.exr"),
        "-f",
        "1:2",
        "-w",
        "32",
    ]
    child = subprocess.Popen(
        [*command, "--samples", "100000000", "--progress", "json"], stdout=subprocess.PIPE, text=True
    )
    # The first line of progress says that the render runs.
    assert any('"progress"' in line for line in child.stdout)
    os.kill(child.pid, signal.SIGINT)
    child.communicate(timeout=60)
    assert child.returncode == 130
    assert names(tmp_path) == ["a.1.exr", "stage.usda"]
    assert np.isfinite(read_exr(tmp_path / "a.1.exr")[1]).all()


def test_bytes_of_one_and_two_threads_agree(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    for threads in ("1", "2"):
        assert run("record", file, tmp_path / f"{threads}.exr", "--threads", threads, *SMALL) == 0
    np.testing.assert_array_equal(read_exr(tmp_path / "1.exr")[1], read_exr(tmp_path / "2.exr")[1])


@pytest.mark.parametrize("listener", ["gone", "full", "closed"])
def test_nobody_has_to_listen(stage, tmp_path, listener):
    """A log that cannot be written costs no frame."""
    command = [sys.executable, "-m", "dermis", "record", stage(CARD, CAMERA, DOME), tmp_path / "a.###.exr"]
    if listener == "closed":
        command = ["sh", "-c", '"$@" >&- 2>&-', "sh", *command]
    reader, writer = os.pipe()
    os.close(reader)
    if listener == "full":
        os.close(writer)
        writer = os.open("/dev/full", os.O_WRONLY)
    child = subprocess.run([*command, "-f", "1:3", *SMALL], stdout=writer, stderr=writer, timeout=120)
    os.close(writer)
    assert child.returncode == 0
    assert [name for name in names(tmp_path) if name.startswith("a.")] == [f"a.00{i}.exr" for i in (1, 2, 3)]


def test_what_is_printed_for_nobody(stage):
    """A full disk is said in a line; a reader that has enough is no error."""
    command = [sys.executable, "-m", "dermis", "explain", stage(CARD, CAMERA, DOME)]
    with open("/dev/full", "w") as full:
        child = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert child.returncode == 1 and child.stderr.count("\n") == 1 and "No space left" in child.stderr


MAPPED = """
    def Material "Map"
    {
        token outputs:surface.connect = </World/Map/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Map/Reader.outputs:result>
            token outputs:surface
        }
        def Shader "Reader"
        {
            uniform token info:id = "UsdPrimvarReader_float3"
            string inputs:varname = "tint"
            float3 outputs:result
        }
    }
"""


@pytest.mark.parametrize("body", ["surface", "curve"])
def test_primvars_that_a_material_reads_follow_refinement(stage, body):
    """Red on the left, green on the right: by face of the cage, and along a tube."""
    binding = "        rel material:binding = </World/Map>\n    }\n"
    tint = 'float3[] primvars:tint = [%s] (\n            interpolation = "%s"\n        )\n'
    if body == "surface":
        red, green, blue = "(0.8, 0, 0)", "(0, 0.8, 0)", "(0, 0, 0.8)"
        faces = tint % (", ".join([blue, blue, blue, blue, red, green]), "uniform")
        prim = BALL.replace("    }\n", faces + binding).replace(
            '"Ball"', '"Ball" (prepend apiSchemas = ["MaterialBindingAPI"])'
        )
    else:
        ends = tint % ("(0.8, 0, 0), (0, 0.8, 0)", "vertex")
        prim = f"""
    def BasisCurves "Rope" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        uniform token type = "linear"
        int[] curveVertexCounts = [2]
        point3f[] points = [(-1, 0, 0), (1, 0, 0)]
        float[] widths = [0.8] (
            interpolation = "constant"
        )
        {ends}{binding}"""
    image = render(stage(prim, MAPPED, CAMERA, DOME), resolution=(64, 64), samples=8, refineLevel=2)
    left, right = image["albedo"][:, :32].mean((0, 1)), image["albedo"][:, 32:].mean((0, 1))
    assert left[0] > 2 * left[1] and right[1] > 2 * right[0] and left[0] == pytest.approx(right[1], rel=0.2)


ODD = """
def RenderSettings "R"
{
    rel products = [</R/P>]
    float4 dataWindowNDC = (1, 1, 0, 0)
    string dermis:walk = "jog"
    int dermis:seed = 7
    def RenderProduct "P"
    {
        rel orderedVars = [</R/V>]
    }
    def RenderVar "V"
    {
        string sourceName = "nonsense"
    }
}
def Sphere "Seen"
{
    token purpose = "odd"
    token visibility = "maybe"
}
"""


def test_what_is_odd_on_a_stage_costs_itself_alone(tmp_path, capsys):
    """One line each that names the prim; the image is that of a stage without."""
    files = [tmp_path / "odd.usda", tmp_path / "plain.usda"]
    plain = (
        ODD.replace('"jog"', '"auto"').replace("(1, 1, 0, 0)", "(0, 0, 1, 1)").replace('"odd"', '"default"')
    )
    for file, text in zip(files, (ODD, plain), strict=True):
        head = 'renderSettingsPrimPath = "/R"'
        file.write_text(stage_text(CARD, CAMERA, DOME, metadata=head, outside=text))
        assert run("record", file, file.with_suffix(".exr"), "-w", "8", "--samples", "1") == 0
        said = capsys.readouterr().err
        if file is files[0]:
            lines = [line for line in said.splitlines() if line.startswith("Warning: ")]
            for words in (
                "/R: dataWindowNDC: (1.0, 1.0, 0.0, 0.0) has no pixels",
                '/R: walk is "jog"; give auto, ',
                "/R/V: sourceName: 'nonsense' is not written",
                "/R/P: orderedVars: none of them can be written; the beauty is",
                "/Seen: purpose: 'odd' is not supported; 'default' is used",
                "/Seen: visibility: 'maybe' is not supported; 'inherited' is used",
            ):
                assert sum(words in line for line in lines) == 1, (words, said)
    odd, expected = (channels(file.with_suffix(".exr")) for file in files)
    assert odd.keys() == expected.keys() and odd["R"].max() > 0.1
    for name, values in odd.items():
        np.testing.assert_array_equal(values, expected[name])


def test_a_mask_that_holds_nothing_is_said(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, DOME)
    assert run("record", file, tmp_path / "o.exr", "--mask", "/Nope", "-w", "8", "--samples", "1") == 0
    assert "Warning: /Nope: mask: there is no such prim" in capsys.readouterr().err


def test_a_message_is_one_line(tmp_path, capsys):
    cycle = 'def "A" (\n    references = </B>\n)\n{\n}\ndef "B" (\n    references = </A>\n)\n{\n}\n'
    (tmp_path / "s.usda").write_text(stage_text(CARD, CAMERA, DOME, outside=cycle))
    assert run("record", tmp_path / "s.usda", tmp_path / "o.exr", "-w", "8", "--samples", "1") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "composition: Cycle detected" in line]
    assert len(said) == 2 and all("CANNOT reference" in line for line in said)


def test_a_plain_stage_needs_no_numpy(stage, tmp_path):
    """It takes longer to load than all of such a stage to read and to render."""
    lamp = 'def RectLight "Lamp"\n{\n    float inputs:intensity = 2\n    color3f inputs:color = (1, 0.9, 0.8)\n}\n'
    code = "import sys; from dermis.cli import main; code = main(); sys.exit(code or 7 * ('numpy' in sys.modules))"
    command = [
        sys.executable,
        "-c",
        code,
        "record",
        stage(CARD, CAMERA, DOME, lamp),
        tmp_path / "o.exr",
        *SMALL,
    ]
    assert subprocess.run(command).returncode == 0
    assert channels(tmp_path / "o.exr")["R"].max() > 0.1
