"""Sequences and signals: what is sent again from frame to frame, delegates shared by threads, Ctrl-C at any time."""

import json
import signal
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, DOME, names, run, stage_text, start

from dermis import stage as stages
from dermis._core import Delegate
from dermis.cli import build_parser
from dermis.cli.scene import open_scene
from dermis.cli.settings import default_settings
from dermis.hydra import DirtyBits

MOVING = """
    def DistantLight "Sun"
    {
        float inputs:intensity.timeSamples = {1: 1, 3: 3}
    }
    def Mesh "Waving"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points.timeSamples = {1: [(0, 0, 1), (1, 0, 1), (0, 1, 1)], 3: [(0, 0, 2), (1, 0, 2), (0, 1, 2)]}
        uniform token subdivisionScheme = "none"
    }
    def Mesh "Drifting"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 1), (-1, 0, 1), (0, -1, 1)]
        uniform token subdivisionScheme = "none"
        double3 xformOp:translate.timeSamples = {1: (0, 0, 0), 3: (0, 0, 1)}
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


@pytest.fixture
def moving(tmp_path):
    (tmp_path / "s.usda").write_text(stage_text(CARD, CAMERA, DOME, MOVING))
    return tmp_path / "s.usda"


def test_the_stage_is_opened_once_and_only_changes_are_sent(moving, monkeypatch):
    opened = []
    open_stage = stages.open_stage
    monkeypatch.setattr(stages, "open_stage", lambda *args: opened.append(args) or open_stage(*args))
    parser, parsers = build_parser()
    args = parser.parse_args(["record", str(moving), "f.#.exr", "-f", "1:4"])
    scene = open_scene(parsers["record"], args, default_settings(), ("outputImagePath",))
    sent, built = [], []
    for when in scene.times:
        loaded = scene.load(when)
        sent.append(scene.synced)
        built.append(json.loads(loaded.delegate.commit())["blas_built"])
    assert len(opened) == 1
    assert sent[0].keys() == {
        f"/World/{name}" for name in ("Card", "main_cam", "Dome", "Sun", "Waving", "Drifting")
    }
    changed = {
        "/World/Sun": DirtyBits.PARAMS,
        "/World/Waving": DirtyBits.POINTS,
        "/World/Drifting": DirtyBits.TRANSFORM,
    }
    # After the last sample nothing moves.
    assert sent[1:] == [changed, changed, {}]
    assert built == [3, 1, 1, 0]


def test_statistics_say_what_was_built(moving, tmp_path):
    flags = ("-w", "8", "--samples", "1", "--stats", tmp_path / "s.#.json")
    assert run("record", moving, tmp_path / "f.#.exr", "-f", "1:4", *flags) == 0
    built = [json.loads((tmp_path / f"s.{n}.json").read_text())["compile"]["blas_built"] for n in range(1, 5)]
    assert built == [3, 1, 1, 0]


def test_a_range_without_end_begins_at_once(moving, tmp_path):
    child = start("record", moving, tmp_path / "f.#.exr", "-f", "1:1e9", "-w", "8", "--samples", "1")
    end = time.monotonic() + 60
    while not (tmp_path / "f.2.exr").exists() and time.monotonic() < end:
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert child.returncode == 130 and (tmp_path / "f.2.exr").exists()


def test_several_threads_share_a_delegate(tmp_path):
    delegate = Delegate()
    delegate.sync("/Cam", json.dumps({"type": "Camera"}), [], 1023)
    delegate.set_settings(
        json.dumps({"camera": "/Cam", "resolution": [32, 32], "samples": 1 << 20, "threads": 1})
    )
    delegate.commit()
    delegate.start()
    errors, done = [], threading.Event()

    def ask(call) -> None:
        try:
            while not done.is_set():
                call()
        except Exception as error:  # whatever it is, it is what this test is about
            errors.append(error)

    calls = (
        lambda: delegate.wait(0.05),
        delegate.poll,
        delegate.stats,
        delegate.snapshot,
        delegate.settings,
        delegate.explain,
    )
    threads = [threading.Thread(target=ask, args=(call,)) for call in calls]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    delegate.stop()
    done.set()
    for thread in threads:
        thread.join(30)
    assert errors == [] and delegate.poll()[1]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs procfs to see what is being imported")
@pytest.mark.parametrize("library", ["_tf", "_sdf", "_usdGeom", "_core.abi3"])
def test_an_interrupt_during_imports_leaves_without_a_word(moving, tmp_path, library):
    child = start("record", moving, tmp_path / "a.exr", "-w", "8", "--samples", "100000000")
    maps, end = Path(f"/proc/{child.pid}/maps"), time.monotonic() + 60
    while library not in maps.read_text():
        assert child.poll() is None and time.monotonic() < end, "it is never imported"
        time.sleep(0.0005)
    child.send_signal(signal.SIGINT)
    out, said = child.communicate(timeout=60)
    assert child.returncode == 130
    assert said == "", out
    assert set(names(tmp_path)) <= {"s.usda", "a.exr"}
