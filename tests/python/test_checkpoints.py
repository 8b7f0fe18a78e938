"""Renders that end before they are done: killed and resumed, interrupted, skipped, looked at meanwhile."""

import json
import os
import re
import signal
import struct
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, DOME, WAX, channels, names, read_exr, run, stage_text, start

from dermis import color
from dermis._core import CoreError, Delegate
from dermis.cli import files

SMALL = ("--samples", "2", "-w", "16")


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "stage.usda").write_text(stage_text(CARD, CAMERA, DOME))
    return tmp_path / "stage.usda"


@pytest.fixture
def wax(tmp_path):
    (tmp_path / "wax.usda").write_text(stage_text(CARD, CAMERA, WAX))
    return tmp_path / "wax.usda"


def same_image(a: Path, b: Path) -> None:
    first, second = channels(a), channels(b)
    assert first.keys() == second.keys() and len(first) > 4
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], err_msg=name)


KEPT = ("depth", "variance", "subsurface", "cryptoObject", "primvars:displayColor")


def wait_for(file: Path, child, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not file.exists() and child.poll() is None and time.monotonic() < end:
        time.sleep(0.002)


@pytest.mark.parametrize(
    ("walk", "more"),
    [
        ("classical", ()),
        ("mixture", ()),
        ("bono", ()),
        ("mixture", ("--noiseThreshold", "0.02")),
        ("mixture", ("--set", "pixelFilterMode=weighted")),
    ],
    ids=["classical", "mixture", "bono", "adaptive", "weighted"],
)
def test_killed_and_resumed_is_the_uninterrupted_image(wax, tmp_path, walk, more):
    """kill -9 three times in a row, whatever tile or pass is under way."""
    flags = ("-w", "40", "--samples", "80", "--walk", walk, "--threads", "2", *more)
    aovs = [word for aov in KEPT for word in ("--aov", aov)]
    assert run("record", wax, tmp_path / "whole.exr", *flags, *aovs) == 0
    out, keep = tmp_path / "a.exr", tmp_path / "a.exr.checkpoint"
    # (pilot, samples done): after something was learned, in the middle of a pass.
    pilot = "--noiseThreshold" in more
    for least in [(True, 3), (False, 3), (False, 15)] if pilot else [(False, 3), (False, 7), (False, 31)]:
        child = start("record", wax, out, *flags, *aovs, "--checkpoint", "0.02", "--resume")
        while child.poll() is None and not is_past(keep, *least):
            time.sleep(0.001)
        assert child.poll() is None, "it was too fast to be killed"
        child.kill()
        child.communicate()
    child = start("record", wax, out, *flags, *aovs, "--resume", "--stats", tmp_path / "s.json")
    said = child.communicate(timeout=300)[0]
    assert child.returncode == 0 and f"Resuming from {keep}" in said
    assert json.loads((tmp_path / "s.json").read_text())["resumed_samples_per_pixel"] >= least[1]
    same_image(tmp_path / "whole.exr", out)
    assert names(tmp_path) == ["a.exr", "s.json", "wax.usda", "whole.exr"]


@pytest.mark.parametrize("fill", ["surface", "camera"])
def test_killed_while_training(wax, tmp_path, fill):
    """What was found of the light at the boundary is not looked for again, and the image is the same."""
    flags = ("-w", "40", "--samples", "8", "--threads", "1", "--set", f"cacheFill={fill}")
    assert run("record", wax, tmp_path / "whole.exr", *flags) == 0
    out, found = tmp_path / "a.exr", tmp_path / "a.exr.checkpoint.training"
    child = start("record", wax, out, *flags, "--checkpoint", "1000")
    while child.poll() is None and not has_finds(found):
        time.sleep(0.001)
    assert child.poll() is None, "it was too fast to be killed"
    child.kill()
    child.communicate()
    assert not (tmp_path / "a.exr.checkpoint").exists()
    child = start("record", wax, out, *flags, "--resume", "--stats", tmp_path / "s.json")
    said = child.communicate(timeout=300)[0]
    assert child.returncode == 0 and f"Resuming from {found}" in said
    stats = json.loads((tmp_path / "s.json").read_text())
    assert stats["resumed_samples_per_pixel"] is None
    assert 1000 < stats["guide"]["resumed_finds"] <= stats["guide"]["records"]
    same_image(tmp_path / "whole.exr", out)
    assert names(tmp_path) == ["a.exr", "s.json", "wax.usda", "whole.exr"]


def has_finds(journal: Path) -> bool:
    """Whether the first of its finds are there: after 20 bytes of header and the number of points that are looked at,
    each a digest, their length, and they."""
    data, at = journal.read_bytes() if journal.exists() else b"", 20
    for _ in range(2):
        if len(data) < at + 16:
            return False
        at += 16 + struct.unpack_from("<Q", data, at + 8)[0]
    return len(data) >= at


def test_interrupted_while_training(wax, tmp_path):
    """It ends at once, and goes on from what it had found."""
    flags = ("-w", "300", "--samples", "64", "--threads", "1")
    found = tmp_path / "a.exr.checkpoint.training"
    child = start("record", wax, tmp_path / "a.exr", *flags, "--checkpoint", "1000")
    while child.poll() is None and not has_finds(found):
        time.sleep(0.001)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert child.returncode == 130
    kept = found.stat().st_size
    assert run("record", wax, tmp_path / "a.exr", *flags, "--samples", "65", "--resume") == 1
    assert found.stat().st_size == kept and not (tmp_path / "a.exr.checkpoint").exists()
    # With less time than that training takes there is a picture, too.
    limited = ("--timeLimit", "2", "--resume", "--stats", tmp_path / "s.json")
    assert run("record", wax, tmp_path / "a.exr", *flags, *limited) == 0
    assert json.loads((tmp_path / "s.json").read_text())["samples_per_pixel"] > 0.0


def test_a_time_limit_is_not_for_training_alone(wax, tmp_path):
    """With checkpoints as without; a render that goes on from one has as many records as that."""
    flags = ("-w", "240", "--samples", "100000", "--threads", "1", "--timeLimit")

    def records(limit: str, *keep: str) -> int:
        assert (
            run("record", wax, tmp_path / "a.exr", *flags, limit, *keep, "--stats", tmp_path / "s.json") == 0
        )
        found = json.loads((tmp_path / "s.json").read_text())
        assert found["samples_per_pixel"] > 0.0
        return found["guide"]["records"]

    some = records("1")
    height, width = read_exr(tmp_path / "a.exr")[1].shape[:2]
    whole = width * height * 64 // 10
    assert 0 < some < whole // 2 and 0 < records("1", "--checkpoint", "1000") < whole // 2
    child = start(
        "record", wax, tmp_path / "a.exr", *flags, "1000", "--checkpoint", "0.05", "--progress", "json"
    )
    wait_for(tmp_path / "a.exr.checkpoint", child)
    child.kill()
    child.communicate()
    assert records("5", "--resume") == whole


def test_what_another_render_left_is_not_in_the_way(wax, tmp_path):
    """Both files: that of a render which was killed while it trained, and of one killed later."""
    flags = ("-w", "60", "--threads", "1", "--samples", "100000", "--checkpoint")
    for every, left in (("1000", "a.exr.checkpoint.training"), ("0.02", "a.exr.checkpoint")):
        child = start("record", wax, tmp_path / "a.exr", *flags, every)
        while child.poll() is None and not (tmp_path / left).exists():
            time.sleep(0.001)
        child.kill()
        child.communicate()
        child = start(
            "record", wax, tmp_path / "a.exr", *flags, "1000", "--walk", "classical", "--timeLimit", "100"
        )
        while child.poll() is None and any(tmp_path.glob("a.exr.checkpoint*")):
            time.sleep(0.001)
        assert child.poll() is None, "what the other render left is there until the end"
        child.kill()
        child.communicate()
        again = ("--walk", "classical", "--timeLimit", "1", "--resume")
        assert run("record", wax, tmp_path / "a.exr", *flags, "1000", *again) == 0


def is_past(keep: Path, pilot: bool, samples: int) -> bool:
    """Whether a checkpoint is of that phase or a later one, with that many samples done in it."""
    if not keep.exists():
        return False
    phase, tiles = struct.unpack_from("<IQ", keep.read_bytes(), 24)
    (done,) = struct.unpack_from("<I", keep.read_bytes(), 36 + 4 * tiles)
    return done >= samples if pilot == (phase == 1) else phase == 0


def test_interrupted_and_resumed(wax, tmp_path):
    flags = ("-w", "32", "--samples", "384", "--threads", "1")
    child = start("record", wax, tmp_path / "a.exr", *flags, "--checkpoint", "1000", "--progress", "json")
    assert any(re.search(r'"progress": 0\.0*[1-9]', line) for line in child.stdout)
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert child.returncode == 130
    # What was rendered is there, marked, and so is the way on.
    assert read_exr(tmp_path / "a.exr")[0].getattribute("dermis.complete") == "false"
    assert names(tmp_path) == ["a.exr", "a.exr.checkpoint", "a.exr.checkpoint.training", "wax.usda"]
    stats = ("--stats", tmp_path / "s.json")
    assert run("record", wax, tmp_path / "a.exr", *flags, "--resume", "--skipExisting", *stats) == 0
    found = json.loads((tmp_path / "s.json").read_text())
    assert 0.0 < found["resumed_samples_per_pixel"] < 384.0 and found["samples_per_pixel"] == 384.0
    assert run("record", wax, tmp_path / "whole.exr", *flags) == 0
    same_image(tmp_path / "a.exr", tmp_path / "whole.exr")


def checkpoint_of(stage: Path, out: Path, *flags: str) -> Path:
    """A checkpoint of a render that is not over."""
    child = start("record", stage, out, *flags, "--samples", "100000", "--checkpoint", "0.05")
    wait_for(Path(f"{out}.checkpoint"), child)
    child.kill()
    child.communicate()
    return Path(f"{out}.checkpoint")


def test_checkpoints_of_something_else_are_refused(stage, tmp_path, capsys):
    keep = checkpoint_of(stage, tmp_path / "a.exr", "-w", "16")
    for flags in (("-w", "16", "--samples", "99"), ("-w", "16", "--samples", "100000", "--seed", "3")):
        assert run("record", stage, tmp_path / "a.exr", *flags, "--resume") == 1
        assert (
            "a.exr.checkpoint: checkpoint: it is of another scene or other settings"
            in capsys.readouterr().err
        )
    stage.write_text(stage.read_text().replace("intensity = 1", "intensity = 2"))
    assert run("record", stage, tmp_path / "a.exr", "-w", "16", "--samples", "100000", "--resume") == 1
    assert "it is of another scene" in capsys.readouterr().err
    assert keep.exists() and not (tmp_path / "a.exr").exists()


def test_a_checkpoint_goes_on_where_its_images_lie_elsewhere(tmp_path, capsys):
    """The whole folder moves, and later the picture is another."""
    oiio = pytest.importorskip("OpenImageIO")
    sky = DOME.replace("float inputs", "asset inputs:texture:file = @./sky.exr@\n float inputs")

    def paint(file: Path, value: float) -> None:
        image = oiio.ImageBuf(oiio.ImageSpec(4, 2, 3, oiio.FLOAT))
        oiio.ImageBufAlgo.fill(image, (value, 0.5, 0.25))
        assert image.write(str(file))

    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    (here / "s.usda").write_text(stage_text(CARD, CAMERA, sky))
    paint(here / "sky.exr", 0.5)
    keep = checkpoint_of(here / "s.usda", here / "a.exr", "-w", "16")
    assert keep.exists()
    here.rename(there)
    flags = (
        "-w",
        "16",
        "--samples",
        "100000",
        "--timeLimit",
        "1",
        "--resume",
        "--stats",
        tmp_path / "s.json",
    )
    whole = (there / keep.name).read_bytes()
    assert run("record", there / "s.usda", there / "a.exr", *flags) == 0
    assert json.loads((tmp_path / "s.json").read_text())["resumed_samples_per_pixel"] > 0
    (there / keep.name).write_bytes(whole)
    paint(there / "sky.exr", 0.625)
    assert run("record", there / "s.usda", there / "a.exr", *flags) == 1
    assert "it is of another scene" in capsys.readouterr().err


def test_damaged_checkpoints_are_refused(stage, tmp_path):
    keep = checkpoint_of(stage, tmp_path / "a.exr", "-w", "16")
    whole = keep.read_bytes()
    flags = (
        "record",
        stage,
        tmp_path / "a.exr",
        "-w",
        "16",
        "--samples",
        "100000",
        "--timeLimit",
        "1",
        "--resume",
    )
    for damage in (b"", b"\0" * 100, whole[: len(whole) // 2], whole[:-1]):
        keep.write_bytes(damage)
        child = start(*flags)
        _, said = child.communicate(timeout=60)
        assert child.returncode == 1 and "a.exr.checkpoint: checkpoint:" in said, said
    keep.write_bytes(whole)
    assert run(*flags) == 0


def test_no_more_than_a_tile_is_between_two_checkpoints(stage, tmp_path):
    """Whenever they are due one is written after the tile under way: here after each of 9 tiles in 2 passes."""
    flags = ("-w", "48", "--imageHeight", "48", "--samples", "3", "--threads", "1", "--checkpoint", "1e-9")
    assert run("record", stage, tmp_path / "a.exr", *flags, "--stats", tmp_path / "s.json") == 0
    assert json.loads((tmp_path / "s.json").read_text())["checkpoints"] == 18


def test_resume_without_a_checkpoint_begins(stage, tmp_path):
    assert run("record", stage, tmp_path / "a.exr", *SMALL, "--resume") == 0
    assert run("record", stage, tmp_path / "b.exr", *SMALL) == 0
    same_image(tmp_path / "a.exr", tmp_path / "b.exr")
    assert names(tmp_path) == ["a.exr", "b.exr", "stage.usda"]


def test_a_checkpoint_that_cannot_be_written_costs_no_image(stage, tmp_path, capsys):
    (tmp_path / "a.exr.checkpoint.tmp").mkdir()
    flags = ("-w", "32", "--samples", "256", "--checkpoint", "0.01")
    assert run("record", stage, tmp_path / "a.exr", *flags) == 0
    assert "Warning: render settings: " in capsys.readouterr().err
    assert read_exr(tmp_path / "a.exr")[0].getattribute("dermis:samples") == 256


def test_skip_existing(stage, tmp_path, capsys):
    flags = (
        *SMALL,
        "--skipExisting",
        "--displayImage",
        tmp_path / "f.#.png",
        "--stats",
        tmp_path / "s.#.json",
    )
    assert run("record", stage, tmp_path / "f.#.exr", "-f", "1:3", *flags) == 0
    made = {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    capsys.readouterr()
    (tmp_path / "f.2.png").unlink()
    assert run("record", stage, tmp_path / "f.#.exr", "-f", "1:3", *flags) == 0
    said = capsys.readouterr().out
    assert [f"Skipping time code {n}.000000" in said for n in (1, 2, 3)] == [True, False, True]
    changed = [name for name, at in made.items() if (tmp_path / name).stat().st_mtime_ns != at]
    assert sorted(changed) == ["f.2.exr", "f.2.png", "s.2.json"]


@pytest.mark.parametrize("damage", ["empty", "cut", "interrupted"])
@pytest.mark.parametrize("kind", ["exr", "png", "jpg", "json"])
def test_only_complete_files_are_skipped(tmp_path, stage, kind, damage):
    file = tmp_path / f"a.{kind}"
    if kind == "json":
        file.write_text(json.dumps({"complete": damage != "interrupted"}))
    elif kind == "exr":
        # Larger than its header, and than what is read at once.
        assert run("record", stage, file, "--samples", "2", "-w", "100", "--aov", "normal") == 0
    else:
        comment = files.INCOMPLETE if damage == "interrupted" else ""
        color.write_display_image(
            file,
            np.random.default_rng(1).random((64, 64, 4), np.float32),
            color.DisplayTransform("disabled"),
            comment,
        )
    if kind == "exr" and damage == "interrupted":
        child = start("record", stage, file, "--samples", "1000000", "--progress", "json", "-w", "16")
        assert any('"progress"' in line for line in child.stdout)
        child.send_signal(signal.SIGINT)
        child.communicate(timeout=60)
    assert files.is_complete(file) == (damage != "interrupted")
    if damage == "empty":
        file.write_bytes(b"")
        assert not files.is_complete(file)
    if damage == "cut":
        whole = file.read_bytes()
        for length in (len(whole) // 3, len(whole) * 9 // 10):
            file.write_bytes(whole[:length])
            assert not files.is_complete(file), length


def test_tiled_files_are_complete(stage, tmp_path):
    """As other programs make them of ours."""
    oiio = pytest.importorskip("OpenImageIO")
    assert run("record", stage, tmp_path / "a.exr", "--samples", "2", "-w", "100") == 0
    image = oiio.ImageBuf(str(tmp_path / "a.exr"))
    image.set_write_tiles(32, 32)
    assert image.write(str(tmp_path / "tiled.exr"))
    assert files.is_complete(tmp_path / "tiled.exr")
    whole = (tmp_path / "tiled.exr").read_bytes()
    (tmp_path / "tiled.exr").write_bytes(whole[: len(whole) * 3 // 4])
    assert not files.is_complete(tmp_path / "tiled.exr")


def test_snapshots(wax, tmp_path):
    flags = ("-w", "32", "--samples", "1000000", "--progress", "json")
    child = start("record", wax, tmp_path / "a.exr", *flags, "--snapshot", "0.2", "--timeLimit", "6")
    seen = tmp_path / "a_snapshot.exr"
    wait_for(seen, child)
    spec, pixels = read_exr(seen)
    # The first ones may be of what is learned before the first pass.
    while pixels[16, 16, :3].max() == 0.0 and child.poll() is None:
        spec, pixels = read_exr(seen)
    assert spec.getattribute("dermis.complete") == "false" and pixels[16, 16, :3].max() > 0.0
    assert not (tmp_path / "a.exr").exists()
    child.communicate(timeout=60)
    assert child.returncode == 0
    assert names(tmp_path) == ["a.exr", "wax.usda"]


def test_a_signal_asks_for_a_snapshot(stage, tmp_path):
    child = start(
        "record", stage, tmp_path / "a.png", "-w", "32", "--samples", "100000000", "--progress", "json"
    )
    assert any('"progress"' in line for line in child.stdout)
    os.kill(child.pid, signal.SIGUSR1)
    wait_for(tmp_path / "a_snapshot.png", child)
    assert color.image_comment(tmp_path / "a_snapshot.png") == files.INCOMPLETE
    child.send_signal(signal.SIGINT)
    child.communicate(timeout=60)
    assert child.returncode == 130


def test_start_says_whether_it_resumes(tmp_path):
    delegate = Delegate()
    with pytest.raises(CoreError, match="commit the scene"):
        delegate.start(str(tmp_path / "c"), 1.0, True)
    delegate.set_settings(json.dumps({"resolution": [8, 8], "samples": 1}))
    delegate.sync("/Cam", json.dumps({"type": "Camera"}), [], 1023)
    delegate.set_settings(json.dumps({"camera": "/Cam"}))
    delegate.commit()
    assert delegate.start(str(tmp_path / "c"), 1.0, True) is None
    with pytest.raises(ValueError, match="every"):
        delegate.start(str(tmp_path / "c"), -1.0, True)
