"""A shot as a pipeline sends it: usd_scenes/crowd_scene.py, all its frames by `dermis record`, and what it drops."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_line import channels, run
from pxr import Usd, UsdLux, UsdShade

SCENES = Path(__file__).parents[2] / "usd_scenes"
sys.path.insert(0, str(SCENES))
from crowd_scene import FRAMES, ODD, write_shot  # noqa: E402

#: What README states for this size of picture, bytes.
MEMORY_BOUND = 600 << 20


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    return write_shot(tmp_path_factory.mktemp("crowd"))


def test_the_shot_is_as_large_as_it_says(shot):
    stage = Usd.Stage.Open(str(shot))
    prims = list(stage.TraverseAll())
    assert len(prims) >= 500
    assert sum(prim.IsA(UsdShade.Material) for prim in prims) >= 200
    assert sum(prim.HasAPI(UsdLux.LightAPI) for prim in prims) >= 50
    assert sum(prim.IsInstance() for prim in prims) >= 100


def test_every_frame_within_the_memory_bound(shot):
    """In a process of its own, since memory is counted by process. The crowd hops and the camera moves: no two frames
    are alike, and only what moves is compiled again."""
    out, stats = shot.parent / "out.####.exr", shot.parent / "stats.####.json"
    command = [sys.executable, "-m", "dermis", "record", str(shot), str(out), "--frames"]
    command += [f"{FRAMES[0]}:{FRAMES[-1]}", "--samples", "2", "--imageWidth", "240", "--stats", str(stats)]
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=1200)
    images, counted = [], []
    for frame in FRAMES:
        color = channels(shot.parent / f"out.{frame}.exr")
        images.append(np.stack([color[c] for c in "RGB"], -1))
        counted.append(json.loads((shot.parent / f"stats.{frame}.json").read_text()))
    assert all(np.isfinite(image).all() and image.mean() > 0.01 for image in images)
    differences = [np.abs(a - b).mean() for a, b in pairwise(images)]
    assert min(differences) > 0.01
    assert counted[-1]["peak_rss_bytes"] < MEMORY_BOUND
    assert [c["non_finite_samples"] for c in counted] == [0] * len(FRAMES)
    # The flag's points move; nothing else needs a BVH again.
    assert [c["compile"]["blas_built"] for c in counted[1:]] == [1] * (len(FRAMES) - 1)


def test_explain_lists_what_is_not_rendered_and_why(shot, capsys):
    assert run("explain", shot) == 0
    printed = capsys.readouterr().out
    dropped = dict(
        line.strip().split(": ", 1)
        for line in printed.split("dropped or replaced:")[1].splitlines()
        if line.startswith("  /")
    )
    for prim, reason in ODD.items():
        assert reason in dropped[prim], prim
    assert all(prim.startswith("/World/Odd/") for prim in dropped), dropped
