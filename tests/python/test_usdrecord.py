"""Parity with usdrecord: every one of its flags with what its documentation promises, its messages and exit codes.

The facts are those of pxr/usdImaging/bin/usdrecord and pxr/usdImaging/usdAppUtils of OpenUSD 24.11; placeholders, frame
specs and pictures have tests of their own (test_frames, test_cli_record).
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Ar

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, DOME, channels, names, read_exr, run, stage_text, start, write_stage

from dermis.cli import build_parser

#: Flags of usdrecord, short forms, and the destination that its scripts read.
FLAGS = {
    "--mask": "populationMask",
    "--purposes": "purposes",
    "--sessionLayer": "sessionLayerPath",
    "--disableGpu": "disableGpu",
    "--disableCameraLight": "disableCameraLight",
    "--camera -cam": "camera",
    "--defaultTime -d": "defaultTime",
    "--frames -f": "frames",
    "--complexity -c": "complexity",
    "--colorCorrectionMode -color": "colorCorrectionMode",
    "--renderer -r": "renderer",
    "--imageWidth -w": "imageWidth",
    "--enableDomeLightVisibility": "enableDomeLightVisibility",
    "--renderPassPrimPath -rp": "rpPrimPath",
    "--renderSettingsPrimPath -rs": "rsPrimPath",
    # Of later versions.
    "--disableDrawMode": "disableDrawMode",
    "--resolver": "resolver",
    "--traceToFile": "traceToFile",
    "--traceFormat": "traceFormat",
    "--memstats": "memstats",
}

RED = CARD.replace("Card", "Red").replace("(1, 1, 1)]", "(1, 0, 0)]").replace(", 0)", ", 1)")
SMALL = ("--samples", "2", "-w", "16", "--aov", "primId")


@pytest.fixture
def stage(tmp_path):
    def write(*prims: str, metadata: str = "", outside: str = "") -> str:
        return write_stage(tmp_path / "s.usda", stage_text(*prims, metadata=metadata, outside=outside))

    return write


def record(stage: str, tmp_path, *flags: str) -> np.ndarray:
    """The middle of the image of a run that must succeed."""
    assert run("record", stage, tmp_path / "a.exr", *SMALL, *flags) == 0
    return read_exr(tmp_path / "a.exr")[1][7:9, 7:9].mean(axis=(0, 1))


@pytest.mark.parametrize(("flags", "name"), FLAGS.items())
def test_every_flag_is_there(flags, name):
    actions = {action.dest: action for action in build_parser()[1]["record"]._actions}
    assert set(flags.split()) <= set(actions[name].option_strings)


@pytest.mark.parametrize(
    "mask", ["/World/Card,/World/main_cam,/World/Dome", "/World/Card /World/main_cam, /World/Dome"]
)
def test_mask_takes_commas_and_spaces(stage, tmp_path, mask):
    file = stage(CARD, RED, CAMERA, DOME)
    assert record(file, tmp_path)[1] < 0.2
    assert record(file, tmp_path, "--mask", mask)[1] > 0.5


def test_purposes(stage, tmp_path):
    """Proxy and default are the default; default is always included."""

    def of(purpose: str) -> str:
        return RED.replace("color3f[]", f'uniform token purpose = "{purpose}"\n        color3f[]')

    for purpose, flags, seen in [
        ("proxy", (), True),
        ("render", (), False),
        ("guide", (), False),
        ("render", ("--purposes", "render"), True),
        ("guide", ("--purposes", "render,guide"), True),
        ("guide", ("--purposes", "render guide"), True),
        ("proxy", ("--purposes", "render"), False),
    ]:
        color = record(stage(CARD, of(purpose), CAMERA, DOME), tmp_path, *flags)
        assert (color[1] < 0.2) == seen, (purpose, flags)
        assert color[0] > 0.5


def test_session_layer(stage, tmp_path):
    (tmp_path / "session.usda").write_text('#usda 1.0\nover "World"\n{\nover "Red" (active = false) {}\n}\n')
    file = stage(CARD, RED, CAMERA, DOME)
    assert record(file, tmp_path)[1] < 0.2
    assert record(file, tmp_path, "--sessionLayer", str(tmp_path / "session.usda"))[1] > 0.5


def test_resolver(stage, tmp_path):
    """Whose search paths count: those of the root layer's context, or those of the process."""
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "card.usda").write_text(
        f'#usda 1.0\n(defaultPrim = "Red")\n{RED.replace("    def Mesh", "def Mesh")}'
    )
    file = stage('    def "There" (references = @card.usda@) {}\n', CAMERA, DOME)
    search = Ar.ResolverContext(Ar.DefaultResolverContext([str(tmp_path / "assets")]))
    with Ar.ResolverContextBinder(search):
        assert record(file, tmp_path, "--resolver", "inherit")[0] > 0.5
        assert record(file, tmp_path, "--resolver", "root")[0] < 0.2


def test_trace_of_usd(stage, tmp_path):
    """In Chrome's format, or USD's."""
    file, trace = stage(CARD, CAMERA, DOME), tmp_path / "trace"
    record(file, tmp_path, "--traceToFile", str(trace))
    assert json.loads(trace.read_text())["traceEvents"]
    record(file, tmp_path, "--traceToFile", str(trace), "--traceFormat", "trace")
    assert "Tree view" in trace.read_text()


def test_memory_of_usd(stage, tmp_path):
    """Of a process that accounts it from its start: the sum, and a file with the tree of calls."""
    child = start("record", stage(CARD, CAMERA, DOME), tmp_path / "a.exr", *SMALL, "--memstats")
    said = child.communicate(timeout=60)[0]
    assert child.returncode == 0
    able = "from pxr import Tf; Tf.MallocTag.Initialize(); print(Tf.MallocTag.IsInitialized())"
    if subprocess.run([sys.executable, "-c", able], capture_output=True, text=True).stdout.strip() == "False":
        assert "Unable to accumulate memory usage since the Pxr MallocTag system was not initialized" in said
        return
    tree = re.search(r"Memory consumption of .* for s\.usda is \d+ Mb\nFor detailed analysis, see (.*)", said)
    assert tree, said
    assert "Tree view" in Path(tree[1]).read_text()
    Path(tree[1]).unlink()


def test_accepted_without_effect(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    plain = record(file, tmp_path)
    for flags in (
        ("--disableGpu",),
        ("--renderer", "dermis"),
        ("-r", "dermis"),
        ("--disableDrawMode",),
        ("-c", "low"),
    ):
        np.testing.assert_array_equal(record(file, tmp_path, *flags), plain)


def test_complexity_refines(stage, tmp_path, capsys):
    card = stage(
        CARD.replace('subdivisionScheme = "none"', 'subdivisionScheme = "catmullClark"'), CAMERA, DOME
    )
    assert run("record", card, tmp_path / "a.exr", *SMALL, "--complexity", "veryhigh") == 0
    assert "level 3: 1, 128 triangles" in capsys.readouterr().out
    assert run("record", "s.usda", "a.exr", "--complexity", "highest") == 2
    assert re.search("choose from '?low'?, '?medium'?, '?high'?, '?veryhigh'?", capsys.readouterr().err)


def test_camera_light(stage, tmp_path, capsys):
    """On where nothing else lights the stage, as usdrecord's; off with the flag."""
    file = stage(CARD, CAMERA)
    assert record(file, tmp_path)[0] > 0.5
    assert record(file, tmp_path, "--disableCameraLight")[0] == 0.0


def test_camera_by_name_anywhere(stage, tmp_path, capsys):
    nested = 'def Scope "Rig"\n{\n' + CAMERA.replace("main_cam", "shot") + "}\n"
    for name in ("shot", "/World/Rig/shot"):
        assert run("record", stage(CARD, CAMERA, nested, DOME), tmp_path / "a.exr", *SMALL, "-cam", name) == 0
        assert capsys.readouterr().out.startswith("Camera: /World/Rig/shot\n")


def test_times(stage, tmp_path, capsys):
    moving = DOME.replace(
        "inputs:intensity = 1",
        "inputs:intensity = 5\n        float inputs:intensity.timeSamples = {2: 1, 4: 3}",
    )
    file = stage(CARD, CAMERA, moving, metadata="startTimeCode = 2\n endTimeCode = 4")
    base = record(file, tmp_path)[0]
    assert "Recording time code: 2.000000\n" in capsys.readouterr().out
    assert record(file, tmp_path, "--defaultTime")[0] == pytest.approx(5.0 * base, rel=1e-3)
    assert "Recording time code: nan\n" in capsys.readouterr().out
    assert run("record", file, tmp_path / "f.###.##.exr", *SMALL, "--frames", "3:2x-0.5") == 0
    said = re.findall("Recording time code: (.*)", capsys.readouterr().out)
    assert said == ["3.000000", "2.500000", "2.000000"]
    made = [name for name in names(tmp_path) if name.startswith("f.")]
    assert made == ["f.002.00.exr", "f.002.50.exr", "f.003.00.exr"]
    assert read_exr(tmp_path / made[2])[1][8, 8, 0] == pytest.approx(2.0 * base, rel=0.05)


def test_width_and_the_height_that_follows(stage, tmp_path):
    wide = CAMERA.replace("verticalAperture = 20", "verticalAperture = 7")
    for width, size in [("101", (101, 35)), ("1", (1, 1)), ("0", (1, 1))]:
        assert run("record", stage(CARD, wide, DOME), tmp_path / "a.exr", "-w", width, "--samples", "1") == 0
        spec = read_exr(tmp_path / "a.exr")[0]
        # floor(width / aspect), 1 at least
        assert (spec.width, spec.height) == size
    assert (
        run(
            "record",
            stage(CARD, wide, DOME),
            tmp_path / "a.exr",
            "--samples",
            "1",
            "--crop",
            "0",
            "0",
            ".1",
            ".1",
        )
        == 0
    )
    spec = read_exr(tmp_path / "a.exr")[0]
    assert (spec.full_width, spec.full_height) == (960, 336)


def test_dome_light_visibility(stage, tmp_path):
    file = stage(CARD, CAMERA, DOME)
    assert record(file, tmp_path)[0] > 0.5
    corner = {}
    for flags in ((), ("--enableDomeLightVisibility",)):
        assert run("record", file, tmp_path / "a.exr", *SMALL, *flags) == 0
        corner[flags] = channels(tmp_path / "a.exr")["R"][0, 0]
    assert list(corner.values()) == [0.0, 1.0]


def test_color_correction_is_for_pictures(stage, tmp_path):
    from PIL import Image

    grey = DOME.replace("intensity = 1", "intensity = 0.25")
    file = stage(CARD, CAMERA, grey)
    linear = record(file, tmp_path)[0]
    shown = {}
    for mode in ("disabled", "sRGB", "openColorIO"):
        flags = (*SMALL, "--colorCorrectionMode", mode)
        assert run("record", file, tmp_path / "a.png", *flags) == 0
        shown[mode] = np.array(Image.open(tmp_path / "a.png"))[7:9, 7:9, 0].mean() / 255.0
    assert shown["disabled"] == pytest.approx(linear, abs=0.01)
    assert shown["sRGB"] == pytest.approx(1.055 * linear ** (1 / 2.4) - 0.055, abs=0.01)
    assert shown["openColorIO"] not in (
        pytest.approx(shown["sRGB"], abs=0.01),
        pytest.approx(linear, abs=0.01),
    )


SETTINGS = """
def RenderSettings "One"
{
    uniform int2 resolution = (20, 10)
}
def RenderSettings "Two"
{
    uniform int2 resolution = (8, 8)
}
def RenderPass "Pass"
{
    rel renderSource = [</Two>, </One>]
}
"""


def test_settings_and_passes(stage, tmp_path, capsys):
    file = stage(CARD, CAMERA, DOME, metadata='renderSettingsPrimPath = "/One"', outside=SETTINGS)
    flags = ("--samples", "1", "--aov", "primId")
    for more, size in [((), (20, 10)), (("-rs", "/Two"), (8, 8)), (("-rp", "/Pass"), (8, 8))]:
        assert run("record", file, tmp_path / "a.exr", *flags, *more) == 0
        spec = read_exr(tmp_path / "a.exr")[0]
        assert (spec.width, spec.height) == size
    assert "/Pass: renderSource: has multiple targets; using </Two>" in capsys.readouterr().err
    for more, said in [
        (
            ("-rs", "/One", "-rp", "/Pass"),
            "Cannot specify both --renderSettingsPrimPath and --renderPassPrimPath",
        ),
        (("-rp", "/None"), "Unknown render pass </None>"),
        (("-rp", "/One"), "Unknown render pass </One>"),
    ]:
        assert run("record", file, tmp_path / "b.exr", *flags, *more) == 1
        assert said in capsys.readouterr().err
    assert not (tmp_path / "b.exr").exists()


def test_wrong_settings_prim_warns_and_renders(stage, tmp_path, capsys):
    assert run("record", stage(CARD, CAMERA, DOME), tmp_path / "a.exr", *SMALL, "-rs", "/World/Card") == 0
    assert "there is no RenderSettings prim" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), 2, "the following arguments are required: STAGE"),
        (("none.usda", "a.exr"), 1, "Could not open layer: none.usda"),
        (("none.usda", "a.###.exr"), 1, "Could not open layer: none.usda"),
        (("s.usda", "a.exr", "-d", "-f", "1"), 2, "not allowed with argument"),
        (("s.usda", "a.exr", "--imageWidth", "wide"), 2, "invalid int value: 'wide'"),
        (("s.usda", "a.exr", "-color", "aces"), 2, "invalid choice: 'aces'"),
        (("s.usda", "a.exr", "-r", "GL"), 2, "invalid choice: 'GL'"),
        (("s.usda", "a.exr", "--purposes", "all"), 2, "Unrecognized purpose value 'all'."),
    ],
)
def test_errors(stage, tmp_path, capsys, monkeypatch, arguments, code, said):
    stage(CARD, CAMERA, DOME)
    monkeypatch.chdir(tmp_path)
    assert run("record", *arguments) == code
    assert said in capsys.readouterr().err
    assert names(tmp_path) == ["s.usda"]
