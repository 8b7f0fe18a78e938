"""`--noiseThreshold`: what it decides, what it says, and that the mean stays what it is."""

import json

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, channels, run, stage_text

import dermis

#: A lamp that is found by chance: bright, and by indirect light alone; a plain card beside it is lit evenly.
NOISY = """
    def Mesh "Wall"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-2, -2, 4), (-2, -2, -1), (-2, 2, -1), (-2, 2, 4)]
        color3f[] primvars:displayColor = [(0.9, 0.9, 0.9)]
        uniform token subdivisionScheme = "none"
    }
    def SphereLight "Lamp"
    {
        float inputs:intensity = 4000
        float inputs:radius = 0.02
        double3 xformOp:translate = (-1.9, 0, -0.5)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "s.usda").write_text(stage_text(CARD, CAMERA, NOISY))
    return tmp_path / "s.usda"


def error_of(image: np.ndarray, reference: np.ndarray) -> float:
    """Relative RMS error of an image."""
    return float(np.sqrt(((image - reference) ** 2).mean() / (reference**2).mean()))


def color_of(file) -> np.ndarray:
    found = channels(file)
    return np.stack([found[c] for c in "RGB"], -1).astype(np.float64)


def test_samples_go_where_the_noise_is(stage, tmp_path, capsys):
    flags = ("-w", "80", "--aov", "sampleCount", "--stats", tmp_path / "s.json")
    wanted = 0.1
    assert (
        run("record", stage, tmp_path / "a.exr", *flags, "--samples", "1024", "--noiseThreshold", wanted) == 0
    )
    found = json.loads((tmp_path / "s.json").read_text())
    decided, counts = found["adaptive"], channels(tmp_path / "a.exr")["sampleCount.count"]
    said = capsys.readouterr().out
    assert f"noiseThreshold: 16 pilot samples, then {counts.min()} to {counts.max()} per pixel" in said
    assert (decided["leastSamples"], decided["mostSamples"]) == (counts.min(), counts.max())
    assert decided["meanSamples"] == pytest.approx(counts.mean()) == pytest.approx(found["samples_per_pixel"])
    # Empty corners get the least, the lit card many times that.
    assert counts[0, -1] == 16 and counts.max() > 4 * counts.min()
    assert decided["predictedError"] <= wanted * 1.001 and decided["tilesAtLimit"] == 0
    assert run("record", stage, tmp_path / "r.exr", "-w", "80", "--samples", "512", "--seed", "9") == 0
    # Sobol samples do better than the independent ones that the pilot takes them for; not worse.
    assert error_of(color_of(tmp_path / "a.exr"), color_of(tmp_path / "r.exr")) < 1.2 * wanted


def test_a_limit_that_is_too_low_is_said(stage, tmp_path, capsys):
    flags = ("-w", "32", "--samples", "20", "--noiseThreshold", "0.001")
    assert run("record", stage, tmp_path / "a.exr", *flags) == 0
    assert "tiles need more" in capsys.readouterr().out


def test_few_samples_need_no_pilot(stage, tmp_path):
    assert (
        run("record", stage, tmp_path / "a.exr", "-w", "8", "--samples", "16", "--noiseThreshold", "0.1") == 0
    )
    assert run("record", stage, tmp_path / "b.exr", "-w", "8", "--samples", "16") == 0
    np.testing.assert_array_equal(color_of(tmp_path / "a.exr"), color_of(tmp_path / "b.exr"))


def test_the_mean_over_seeds_is_that_of_plain_renders(stage):
    """Two-sample z of the image's mean; where tiles get from 16 to some hundred samples."""

    def means(first: int, count: int, **settings) -> np.ndarray:
        renders = (
            dermis.render(stage, seed=first + i, resolution=(16, 16), **settings) for i in range(count)
        )
        return np.array([image.color[..., :3].mean() for image in renders])

    aovs = ["sampleCount"]
    adaptive = means(0, 64, samples=128, noiseThreshold=0.3, aovs=aovs)
    plain = means(10_000, 16, samples=128, aovs=aovs)
    error = np.sqrt(adaptive.var(ddof=1) / len(adaptive) + plain.var(ddof=1) / len(plain))
    assert error < 0.02 * plain.mean()  # else the test could not see anything
    assert abs(adaptive.mean() - plain.mean()) < 4.0 * error
