"""`dermis bench`: its numbers against hand-computed ones, and runs end to end on a tiny translucent card."""

import csv
import json
import math
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from dermis._core import CoreError
from dermis.bench import crops, measures, methods, reference, render, runner, spec, store, suite
from dermis.cli import build_parser, main
from dermis.cli.settings import default_settings

REPOSITORY = Path(__file__).resolve().parents[2]
RIGS = REPOSITORY / "usd_scenes" / "bench_rigs.json"

STAGE = """#usda 1.0
(
    upAxis = "Y"
)
def Xform "World" (
    variants = { string color = "pale" }
    prepend variantSets = "color"
)
{
    def Cube "Block" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double size = 2
        rel material:binding = </World/Wax>
    }
    def Material "Wax"
    {
        token outputs:surface.connect = </World/Wax/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            color3f inputs:subsurfaceRadius = (0.3, 0.2, 0.1)
            float inputs:subsurfaceScale = 1
            float inputs:roughness.connect = </World/Wax.inputs:rough>
            token outputs:surface
        }
        float inputs:rough = 0.5
    }
    def RectLight "Key"
    {
        float inputs:intensity = 10
        float inputs:width = 2
        float inputs:height = 2
        double3 xformOp:translate = (0, 0, 5)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Camera "main_cam"
    {
        float horizontalAperture = 20
        float verticalAperture = 20
        float focalLength = 50
        double3 xformOp:translate = (0, 0, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    variantSet "color" = {
        "pale" {
            over "Wax"
            {
                over "Surface"
                {
                    color3f inputs:subsurfaceColor = (0.8, 0.6, 0.4)
                }
            }
        }
        "dark" {
            over "Wax"
            {
                over "Surface"
                {
                    color3f inputs:subsurfaceColor = (0.1, 0.1, 0.1)
                }
            }
        }
    }
}
"""

SCALE = "/World/Wax/Surface.inputs:subsurfaceScale"

#: What renders references where classical walks are under test.
SECOND = "poe:walkPdf=exact:classicalFraction=0.5"

#: Flags of a run of a second.
SMALL = ("-w", "16", "--samples", "2", "--seeds", "2", "--referenceSamples", "16", "--quiet")


@pytest.fixture
def stage(tmp_path):
    (tmp_path / "block.usda").write_text(STAGE)
    return tmp_path / "block.usda"


def run(*arguments: object) -> int:
    """Exit code of `dermis bench ARGUMENTS`."""
    try:
        return main(["bench", *map(str, arguments)])
    except SystemExit as leave:
        return leave.code


def suite_of(*flags: object) -> suite.Suite:
    args = build_parser()[0].parse_args(["bench", "--out", "o", *map(str, flags)])
    return spec.build_suite(args, default_settings())


def write_spec(folder: Path, **changes: object) -> Path:
    content = {
        "methods": ["classical"],
        "samples": 2,
        "seeds": 1,
        "settings": {"resolution": [16, 16]},
        "reference": {"samples": 16},
        "scenes": [{"stage": "block.usda"}],
        **changes,
    }
    (folder / "spec.json").write_text(json.dumps(content))
    return folder / "spec.json"


def results(out: Path) -> dict:
    return json.loads((out / "results.json").read_text())


# Numbers


def test_relative_error_by_hand():
    truth = np.array([[[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]])
    image = truth + np.array([[[0.5, 0.0, 0.0], [0.1, 0.0, 0.0]]])
    # s = 1, so that weights are 1 / (R^2 + 0.01).
    expected = np.array([[0.25 / 1.01 / 3.0, 0.01 / 0.01 / 3.0]])
    np.testing.assert_allclose(measures.error_map(image, truth), expected)
    errors = measures.measure(image, truth, None)
    assert errors.plain == pytest.approx(expected.mean())
    # Of two pixels the worse one is dropped.
    assert errors.trimmed == pytest.approx(expected[0, 0])
    assert (errors.noise, errors.relmse) == (0.0, errors.plain)
    assert errors.mse == pytest.approx((0.25 + 0.01) / 6.0)


def test_trimming_drops_a_thousandth_rounded_up():
    errors = np.ones((50, 42))
    errors[3, 4], errors[7, 8], errors[9, 9], errors[1, 1] = 1e6, 1e5, 1e4, 2.0
    keep = measures.kept(errors)
    assert keep.size - keep.sum() == 3
    assert errors[keep].mean() == pytest.approx((2100 - 3 - 1 + 2) / (2100 - 3))


def test_exposure_does_not_matter():
    rng = np.random.default_rng(1)
    truth, image = rng.random((2, 8, 8, 3))
    bright = measures.measure(image * 64.0, truth * 64.0, np.full(truth.shape, 0.1) * 64.0**2)
    plain = measures.measure(image, truth, np.full(truth.shape, 0.1))
    for name in ("plain", "trimmed", "noise", "noise_trimmed"):
        assert getattr(bright, name) == pytest.approx(getattr(plain, name))


def test_black_reference_is_refused():
    with pytest.raises(measures.MeasureError, match="black"):
        measures.measure(np.ones((2, 2, 3)), np.zeros((2, 2, 3)), None)


def test_noise_of_the_reference_is_subtracted():
    rng = np.random.default_rng(2)
    shape = (100, 100, 3)
    truth = 1.0 + rng.random(shape)
    # A reference that is as noisy as the image: half of what is measured is its own.
    halves = truth + 0.02 * math.sqrt(2.0) * rng.standard_normal((2, *shape))
    image = truth + 0.02 * rng.standard_normal(shape)
    mean, variance = reference.of_halves(*halves)
    errors = measures.measure(image, mean, variance)
    exact = float(measures.error_map(image, truth).mean())
    assert errors.plain == pytest.approx(2.0 * exact, rel=0.05)
    assert errors.relmse == pytest.approx(exact, rel=0.05)
    assert errors.relmse_trimmed == pytest.approx(exact, rel=0.05)
    assert errors.relmse_trimmed < errors.relmse
    assert errors.squared == pytest.approx(2.0 * 0.02**2, rel=0.05)
    assert errors.mse == pytest.approx(0.02**2, rel=0.05)


def test_halves_by_hand():
    mean, variance = reference.of_halves(np.full((1, 1, 3), 3.0), np.full((1, 1, 3), 1.0))
    assert mean[0, 0, 0] == 2.0 and variance[0, 0, 0] == 1.0


def test_bias_by_hand_and_its_threshold():
    truth = np.ones((1, 4, 3))
    image = truth + np.array([[[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]])
    # Sum over root of sum of squares: 4 / 2, 0 / 2, nothing.
    assert measures.bias(image, truth) == [2.0, 0.0, 0.0]
    # Two-sided 1 % of a normal distribution, and a hundredth of it.
    assert measures.bias_threshold(1) == pytest.approx(2.5758, abs=1e-4)
    assert measures.bias_threshold(100) == pytest.approx(3.8906, abs=1e-4)


def test_numbers_by_hand():
    three = measures.number([1.0, 2.0, 3.0])
    assert (three.mean, three.error) == (2.0, pytest.approx(1.0 / math.sqrt(3.0)))
    assert measures.number([5.0]).error is None


def test_ratio_by_hand():
    # Means 4 x 2 over 1 x 4.
    ratio = measures.efficiency_ratio([0.5, 1.5], [4.0, 4.0], [4.0, 4.0], [2.0, 2.0])
    assert ratio.mean == pytest.approx(2.0)
    # Shares -0.5 and -1.5: standard deviation sqrt(1/2), over sqrt(2) seeds.
    assert ratio.error == pytest.approx(2.0 * 0.5)
    # What goes up and down with the baseline is no uncertainty of the ratio.
    paired = measures.efficiency_ratio([1.0, 3.0], [1.0, 1.0], [2.0, 6.0], [1.0, 1.0])
    assert (paired.mean, paired.error) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-12))
    assert measures.efficiency_ratio([-1.0], [1.0], [1.0], [1.0]) is None


def test_masked_errors_are_those_of_the_masked_pixels_alone():
    rng = np.random.default_rng(3)
    truth, image, variance = rng.random((3, 8, 8, 3))
    mask = np.zeros((8, 8), dtype=bool)
    mask[2:6, 3:7] = True
    part = (slice(2, 6), slice(3, 7))
    masked = measures.measure(image, truth, variance, mask)
    assert masked == measures.measure(image[part], truth[part], variance[part])
    assert masked != measures.measure(image, truth, variance)
    with pytest.raises(measures.MeasureError, match="no pixel is measured"):
        measures.measure(image, truth, variance, np.zeros((8, 8), dtype=bool))


def test_flip_grows_with_the_error():
    pytest.importorskip("flip_evaluator")
    rng = np.random.default_rng(4)
    truth = rng.random((32, 32, 3), dtype=np.float32)
    noise = rng.standard_normal(truth.shape, dtype=np.float32)
    little, much = (np.clip(truth + size * noise, 0.0, 1.0) for size in (0.02, 0.2))
    assert measures.flip(truth, truth) == 0.0
    assert 0.0 < measures.flip(little, truth) < measures.flip(much, truth) < 1.0
    # Black against white is as far as it goes.
    assert measures.flip(np.zeros_like(truth), np.ones_like(truth)) > 0.9
    half = np.zeros((32, 32), dtype=bool)
    half[:, 16:] = True
    changed = truth.copy()
    changed[:, :8] = 0.0
    assert measures.flip(changed, truth, half) < 0.01 < measures.flip(changed, truth)


def test_bands_are_those_of_student():
    stats = pytest.importorskip("scipy.stats")
    for freedom in range(1, 100):
        assert measures.student(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-3)
    low, high = measures.number([1.0, 2.0, 3.0]).band
    # Mean 2, standard error 1 / sqrt(3), in the logarithm.
    factor = math.exp(stats.t.ppf(0.975, 2) / math.sqrt(3.0) / 2.0)
    assert (low, high) == (pytest.approx(2.0 / factor, rel=1e-3), pytest.approx(2.0 * factor, rel=1e-3))
    assert measures.number([1.0]).band is None and measures.number([-1.0, 0.5]).band is None


def test_slope_by_hand():
    # Halved error for twice the samples, and for four times.
    found = measures.slope([[1.0, 2.0, 4.0], [1.0, 4.0]], [[8.0, 4.0, 2.0], [2.0, 1.0]])
    assert found.mean == pytest.approx(-0.75) and found.error == pytest.approx(0.25)
    assert measures.slope([[4.0]], [[1.0]]) is None
    assert measures.slope([[1.0, 2.0]], [[1.0, -0.1]]) is None


def test_geometric_mean_by_hand():
    mean = measures.geometric_mean([measures.Number(2.0, 0.2), measures.Number(8.0, 0.8)])
    assert mean.mean == pytest.approx(4.0)
    assert mean.error == pytest.approx(4.0 * math.hypot(0.1, 0.1) / 2.0)
    assert measures.geometric_mean([]) is None


# Methods, crops, suites


def test_methods_are_parsed():
    defaults = default_settings()
    plain, detailed, labelled = methods.parse_methods(
        ["classical", "mixture:controlVariates=false:normals=4", "half=poe:classicalFraction=0.5"], defaults
    )
    assert (plain.label, plain.settings) == ("classical", {"walk": "classical"})
    assert detailed.label == "mixture:controlVariates=false:normals=4"
    assert detailed.settings == {"walk": "mixture", "controlVariates": False, "normals": 4}
    assert (labelled.label, labelled.settings) == ("half", {"walk": "poe", "classicalFraction": 0.5})
    assert methods.parse_method("classical:seed=7", defaults).seeded(2)["seed"] == 9
    assert plain.seeded(2)["seed"] == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("zigzag", "'zigzag': invalid choice"),
        ("vpg", "not available in this version"),
        ("mixture:normal=4", "there is no setting 'normal'; did you mean normals?"),
        ("mixture:normals=many", "'many' is no whole number"),
        ("mixture:normals=9", "normals is 9; give 0 to 7"),
        ("ii:walkPdf=exact", "walkPdf"),
        ("mixture:normals=1:normals=2", "normals is set twice"),
        ("=poe", "label before '=' is empty"),
        ("classical:samples=4", "samples is alike for all methods"),
        ("classical,classical", "is there twice"),
        ("classical,,mixture", "empty name"),
    ],
)
def test_wrong_methods_are_usage_errors(stage, tmp_path, capsys, text, said):
    assert run(stage, "--methods", text, "--out", tmp_path / "out", *SMALL) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_regions_are_the_pixels_of_crops(stage, tmp_path):
    oiio = pytest.importorskip("OpenImageIO")
    for number, ndc in enumerate([(0.1, 0.2, 0.37, 0.9), (0.0, 0.0, 1.0, 1.0), (0.5, 0.5, 0.51, 0.51)]):
        file = tmp_path / f"{number}.exr"
        flags = ["-w", "21", "--samples", "1", "--progress", "none", "--crop", *map(str, ndc)]
        assert main(["record", str(stage), str(file), *flags]) == 0
        s = oiio.ImageBuf(str(file)).spec()
        expected = (s.x, s.y, s.x + s.width, s.y + s.height)
        found = crops.window(ndc, (21, 21))
        assert found == expected
        # Fed back as edges of pixels, a window is itself.
        assert crops.window(tuple(found.ndc((21, 21))), (21, 21)) == found


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ([], "which stage?"),
        (["a.usda"], "name at least one method"),
        (["a.usda", "b/a.usda", "--methods", "classical"], "two stages are called a"),
        (["a.usda", "--methods", "classical"], "give one of --budget S"),
        (["a.usda", "--methods", "classical", "--budget", "1", "--samples", "1"], "give one of --budget S"),
        (["a.usda", "--methods", "classical", "--budget", "0"], "expected seconds above 0"),
        (["a.usda", "--methods", "classical", "--samples", "4,x"], "no list of numbers"),
        (["a.usda", "--methods", "classical", "--samples", "4", "--referenceSamples", "1"], "2 or more"),
        (["a.usda", "--crops", "ear"], "expected [SCENE/]NAME=X0,Y0,X1,Y1"),
        (["a.usda", "--crops", "ear=0,0,1"], "expected four numbers"),
        (["a.usda", "--crops", "ear=0.5,0,0.5,1"], "X0 < X1"),
        (["a.usda", "--crops", "b/ear=0,0,1,1"], "there is no stage 'b'; there are a"),
        (["a.usda", "--set", "samples=4"], "samples is for the comparison itself to decide"),
        (["a.usda", "--set", "sampels=4"], "did you mean samples?"),
        (["a.usda", "b.usda", "--reference", "r.exr"], "--reference is for one stage"),
        (["a.usda", "--only", "a"], "--only chooses among the scenes of --spec"),
        (["--spec", "nowhere.json"], "nowhere.json: No such file"),
    ],
)
def test_wrong_flags_are_usage_errors(tmp_path, capsys, flags, said):
    assert run(*flags, "--out", tmp_path / "out") == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_more_usage_errors(stage, tmp_path, capsys):
    named = (stage, "--methods", "classical", "--out", tmp_path / "out", *SMALL)
    for flags, said in [
        (["--baseline", "mixture"], "the methods are classical"),
        (["--crops", "a=0,0,1,1", "--crops", "a=0,0,.5,1"], "crop 'a' is there twice"),
        (["--figure", "f.png", "--figureRows", "block/ear"], "the crops are block/frame"),
        (["--figure", "f.png", "--numbersOnly"], "--figure does not go with --numbersOnly"),
        (["--figure", "f.gif"], "must end in one of .png"),
    ]:
        assert run(*named, *flags) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"method": ["classical"]}, "there is no 'method'"),
        ({"scenes": []}, "expected a list of at least one"),
        ({"scenes": [{"stage": "block.usda", "corps": {}}]}, "scenes[0]: there is no 'corps'"),
        ({"scenes": [{"name": "block"}]}, "scenes[0]: stage: expected a file name"),
        ({"scenes": [{"stage": "block.usda", "crops": {"ear": [0, 0, 1]}}]}, "expected four numbers"),
        ({"scenes": [{"stage": "block.usda"}] * 2}, "scene 'block' is there twice"),
        ({"settings": {"walk": "mixture"}}, "walk is for the comparison itself to decide"),
        ({"settings": {"resolution": [16]}}, "2 values were expected"),
        ({"samples": [0]}, "samples: expected a whole number of at least 1"),
        ({"seeds": "3"}, "seeds: expected a whole number"),
        ({"reference": {"sample": 3}}, "reference: there is no 'sample'"),
        ({"methods": "classical", "reference": {"samples": 1}}, "--referenceSamples 2 or more"),
        ({"wholeFrames": "no"}, "wholeFrames: expected true or false"),
    ],
)
def test_wrong_descriptions_are_usage_errors(stage, tmp_path, capsys, changes, said):
    assert run("--spec", write_spec(tmp_path, **changes), "--out", tmp_path / "out") == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ({"overrides": {"/World/Wax/Surface.inputs:subsurfaceScael": 1}}, "there is no attribute"),
        ({"overrides": {"/World/Wax": 1}}, "there is no attribute"),
        ({"overrides": {SCALE: "thin"}}, "is a float, which 'thin' is not"),
        ({"overrides": {"/World/Wax/Surface.inputs:roughness": 1.0}}, "is connected"),
        ({"variants": {"/World": {"color": "blue"}}}, "there are dark, pale"),
        ({"variants": {"/World": {"look": "blue"}}}, "there is no such variant set"),
        ({"stage": "gone.usda"}, "Could not open layer"),
    ],
)
def test_wrong_changes_of_a_stage_are_errors(stage, tmp_path, capsys, scene, said):
    file = write_spec(tmp_path, scenes=[{"stage": "block.usda", **scene}])
    assert run("--spec", file, "--out", tmp_path / "out", "--numbersOnly", "--quiet") == 1
    assert said in capsys.readouterr().err


def test_flags_win_over_the_description(tmp_path):
    file = write_spec(
        tmp_path, scenes=[{"stage": "a.usda", "settings": {"maxDepth": 3}}, {"stage": "b.usda"}]
    )
    read = suite_of(
        *("--spec", file, "--only", "a", "--methods", "mixture,classical", "--baseline", "classical"),
        *("--budget", "2", "--seeds", "5", "--set", "maxDepth=1", "--wholeFrames", "--referenceSamples", "8"),
    )
    assert [scene.name for scene in read.scenes] == ["a"]
    assert read.scenes[0].stage == tmp_path / "a.usda"
    assert read.scenes[0].settings == {"resolution": [16, 16], "maxDepth": 1}
    assert [method.label for method in read.methods] == ["mixture", "classical"]
    assert (read.baseline, read.works, read.seeds) == ("classical", (suite.Work("budget", 2.0),), 5)
    assert (read.whole_frames, read.reference_samples) == (True, 8)


@pytest.mark.parametrize(
    ("tested", "named", "made", "note"),
    [
        ("mixture,bono:walkPdf=conditional", None, "classical", ""),
        ("classical,mixture", None, SECOND, "classical is under test and cannot be its own reference"),
        ("plain=classical:seed=3", None, SECOND, "classical is under test, as plain"),
        ("mixture,auto", None, SECOND, "under test, as auto"),
        ("poe", None, "classical", ""),
        ("poe,classical", None, SECOND, "classical is under test and"),
        ("classical,mixture", "bono", "bono", ""),
        ("classical,mixture", "classical", "classical", "as was asked for, and is under test"),
    ],
)
def test_reference_is_not_rendered_by_what_is_under_test(tested, named, made, note):
    asked = ["--referenceMethod", named] if named else []
    read = suite_of("a.usda", "--methods", tested, "--samples", "2,8", *asked)
    assert read.reference_method.label == made and read.reference_samples == 8 * 64
    assert (note in read.reference_note) and bool(note) == bool(read.reference_note)


def test_reference_methods_may_run_out(capsys, tmp_path):
    flags = ("a.usda", "--methods", f"classical,half={SECOND}", "--samples", "2", "--out", tmp_path / "out")
    assert run(*flags) == 2
    assert "name another method by --referenceMethod, or give --reference FILE" in capsys.readouterr().err
    # With a reference at hand there is nothing to choose.
    read = suite_of(*flags[:5], "--reference", "r.exr")
    assert read.reference_method is None and read.reference_note == ""


def test_methods_are_interleaved_in_seeded_order(tmp_path):
    def order(seed: int) -> list[tuple[int, str, float]]:
        read = suite_of("a.usda", "--methods", "classical,mixture,poe", "--samples", "1,2", "--seed", seed,
                        "--referenceSamples", "2")  # fmt: skip

        class Scene:
            spec = read.scenes[0]

        targets = [runner.Target("frame", crops.Window(0, 0, 1, 1), ())]
        return [(j.repeat, j.method.label, j.work.amount) for j in runner.jobs_of(Scene, targets, read)]

    first = order(1)
    assert first == order(1) != order(2)
    assert [repeat for repeat, *_ in first] == [0] * 6 + [1] * 6 + [2] * 6
    assert len(set(first)) == 18
    assert first[:6] != [(0, *rest) for _, *rest in first[6:12]]


# Runs


def test_end_to_end(stage, tmp_path, capsys):
    pytest.importorskip("flip_evaluator")
    out = tmp_path / "out"
    flags = ("--crops", "left=0.2,0.2,0.5,0.8", "--crops", "block/right=0.5,0.2,0.8,0.8")
    named = "classical,again=classical:seed=90,wrong=classical:subsurfaceBoundary=indexMatched"
    figure = tmp_path / "deep" / "figure.png"
    amounts = ("-w", "24", "--samples", "4,16", "--seeds", "3", "--referenceSamples", "128", "--quiet")
    assert run(stage, "--methods", named, "--out", out, "--figure", figure, *flags, *amounts) == 0
    said = capsys.readouterr()
    assert said.err == ""

    found = results(out)
    assert len(found["renders"]) == 3 * 2 * 2 * 3 and len(found["rows"]) == 3 * 2 * 2
    by_key = {(r["crop"], r["method"], r["work"]["amount"]): r for r in found["rows"]}
    row = by_key["left", "classical", 16]
    mine = [
        r
        for r in found["renders"]
        if (r["crop"], r["method"], r["work"]["amount"]) == ("left", "classical", 16)
    ]
    assert {r["seed"] for r in mine} == {1, 2, 3}
    assert row["relmse"]["mean"] == pytest.approx(np.mean([r["plain"] - r["noise"] for r in mine]))
    assert row["flip"]["mean"] == pytest.approx(np.mean([r["flip"] for r in mine]))
    assert row["cpu"]["mean"] == pytest.approx(np.mean([r["cpu"] for r in mine])) and row["cpu"]["mean"] > 0.0
    assert row["efficiency"] == pytest.approx(1.0 / row["relmse"]["mean"] / row["cpu"]["mean"])
    assert row["samples"]["mean"] == 16 and row["steps"] > 1.0
    other = by_key["left", "again", 16]
    ratio = row["relmse"]["mean"] * row["cpu"]["mean"] / (other["relmse"]["mean"] * other["cpu"]["mean"])
    assert other["ratio"]["mean"] == pytest.approx(ratio)

    # Another boundary is another picture, and only that method says so.
    limit = measures.bias_threshold(3 * len(found["rows"]))
    largest = {key: max(map(abs, r["bias"])) for key, r in by_key.items()}
    assert all((value > limit) == (key[1] == "wrong") for key, value in largest.items()), largest
    lines = [
        line for line in said.out.splitlines() if line.startswith("| left ") or line.startswith("| right")
    ]
    assert all((" ! |" in line) == ("wrong" in line) for line in lines)

    assert found["machine"]["dermis"] and found["machine"]["cores"] >= 1
    assert found["scenes"][0]["method_settings"]["wrong"]["subsurfaceBoundary"] == "indexMatched"
    assert found["suite"]["works"] == [{"kind": "samples", "amount": 4}, {"kind": "samples", "amount": 16}]
    for picture in (figure, out / "curves.png"):
        assert min(Image.open(picture).size) > 100
    with (out / "results.csv").open() as lines:
        table = list(csv.DictReader(lines))
    assert len(table) == len(found["renders"])
    for line, render_ in zip(table, found["renders"], strict=True):
        assert (line["crop"], line["method"]) == (render_["crop"], render_["method"])
        assert float(line["relmse"]) == render_["relmse"] and 0.0 < float(line["flip"]) < 1.0
    slopes = {(s["crop"], s["method"]): s["slope"]["mean"] for s in found["slopes"]}
    assert -2.0 < slopes["left", "classical"] < -0.5


def test_a_method_two_percent_too_bright_is_flagged(stage, tmp_path, monkeypatch, capsys):
    def scaled(scene, settings, window, **more):
        rendered = render.render(scene, settings, window, **more)
        return replace(rendered, image=rendered.image * 1.02) if settings.get("maxDepth") == 11 else rendered

    monkeypatch.setattr(runner, "render", scaled)
    amounts = ("-w", "32", "--samples", "64", "--seeds", "3", "--referenceSamples", "512", "--quiet",
               "--crops", "front=.2,.2,.8,.8")  # fmt: skip
    named = "classical,bright=classical:maxDepth=11"
    flags = (stage, "--methods", named, "--out", tmp_path / "out", "--numbersOnly", *amounts)
    assert run(*flags) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "bright" in line or "classical" in line]
    assert [" ! |" in line for line in lines if "e-0" in line and "spp" in line] == [False, True]
    plain, bright = (row["bias"] for row in results(tmp_path / "out")["rows"])
    assert max(map(abs, plain)) < measures.bias_threshold(6) < max(bright)


def test_two_runs_agree_within_their_own_bands(stage, tmp_path):
    bands = []
    for seed in (1, 101):
        out = tmp_path / f"out{seed}"
        amounts = ("-w", "24", "--samples", "4,16", "--seeds", "4", "--referenceSamples", "512", "--quiet")
        flags = ("--methods", "classical,poe", "--seed", seed, "--out", out, "--numbersOnly")
        assert run(stage, *flags, *amounts) == 0
        rows = results(out)["rows"]
        bands.append({(row["method"], row["work"]["amount"]): row["relmse_band"] for row in rows})
    first, second = bands
    assert len(first) == 4 and first != second
    for key, (low, high) in first.items():
        assert low <= second[key][1] and second[key][0] <= high, (key, first[key], second[key])
    # They are narrow enough to tell 4 samples from 16, else they agreed with anything.
    for method in ("classical", "poe"):
        assert first[method, 16][1] < second[method, 4][0]


def test_subsurface_only_leaves_out_what_is_not(stage, tmp_path, capsys):
    # The frame is wider than the block: around it there is nothing below a surface.
    rows = {}
    for flags in ([], ["--subsurfaceOnly"]):
        out = tmp_path / f"out{len(rows)}"
        assert run(stage, "--methods", "classical", "--out", out, "--numbersOnly", *flags, *SMALL) == 0
        rows[len(flags)] = results(out)["rows"][0]
    assert "Measured pixels: those with subsurface light" in capsys.readouterr().out
    assert rows[1]["mse"]["mean"] > 1.05 * rows[0]["mse"]["mean"] > 0.0
    assert main(["record", str(stage), str(tmp_path / "r.exr"), "-w", "16", "--samples", "4", "--aov", "alpha",
                 "--seed", "99", "--progress", "none"]) == 0  # fmt: skip
    given = ("--subsurfaceOnly", "--reference", tmp_path / "r.exr")
    assert run(stage, "--methods", "classical", "--out", out, "--numbersOnly", *given, *SMALL) == 1
    assert "it has no subsurface AOV, which --subsurfaceOnly goes by" in capsys.readouterr().err


def test_progress_is_said_on_stderr_line_by_line(stage, tmp_path, capsys):
    flags = (stage, "--methods", "poe", "--out", tmp_path / "out", "--numbersOnly", *SMALL[:-1])
    for kept in ("", ", kept"):
        assert run(*flags) == 0
        said = capsys.readouterr().err.splitlines()
        assert [line.partition("] ")[0] for line in said] == ["[1/4", "[2/4", "[3/4", "[4/4"]
        assert said[0] == f"[1/4] block frame: reference, half 1 of 2{kept}"
        assert said[3] == f"[4/4] block frame: poe, 2 spp, seed 2 of 2{kept}"


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
def test_a_signal_ends_a_run_and_keeps_what_is_complete(stage, tmp_path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "dermis",
        "bench",
        str(stage),
        "--methods",
        "classical",
        "--budget",
        "0.2,3",
    ]
    command += ["--seeds", "20", "--referenceSamples", "16", "-w", "16", "--out", str(out), "--numbersOnly"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if line.startswith("[5/"):  # two halves and two renders are behind
                break
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    assert process.returncode == 130 and "interrupted: not all that was asked for" in said
    found = results(out)
    assert found["interrupted"] is True and len(found["renders"]) == len(list((out / "runs").iterdir())) >= 2


def test_crops_and_cuts_of_the_frame_are_the_same_pixels(stage, tmp_path):
    crop = ("--crops", "part=0.25,0.25,0.75,0.6", "--numbersOnly", *SMALL)
    rows = []
    for whole in ([], ["--wholeFrames"]):
        out = tmp_path / f"out{len(rows)}"
        assert run(stage, "--methods", "classical", "--out", out, *whole, *crop) == 0
        rows.append(results(out)["rows"][0])
    assert rows[0]["relmse"] == rows[1]["relmse"] and rows[0]["bias"] == rows[1]["bias"]


def test_reference_is_reused_until_the_scene_changes(stage, tmp_path, capsys):
    out = tmp_path / "out"
    kept = out / "reference"
    flags = ("--out", out, "--numbersOnly", *SMALL)

    def halves() -> dict[str, int]:
        return {file.name: file.stat().st_mtime_ns for file in kept.iterdir()}

    assert run(stage, "--methods", "classical", *flags) == 0
    first = halves()
    assert len(first) == 2
    # Other methods, seeds and threads, a comment in the stage: the same reference.
    stage.write_text(stage.read_text().replace("def Cube", "# of wax\n    def Cube"))
    assert run(stage, "--methods", "poe,classical", *flags, "--seed", 8, "--set", "threads=1") == 0
    assert halves() == first
    # Another scene, another size, more samples, another method: another one, and the old one stays.
    grown = len(first)
    stage.write_text(stage.read_text().replace("intensity = 10", "intensity = 11"))
    for more in (
        [],
        ["-w", "12"],
        ["--referenceSamples", "32"],
        ["--referenceMethod", "classical:maxDepth=1"],
    ):
        assert run(stage, "--methods", "classical", *flags, *more) == 0
        grown += 2
        assert len(halves()) == grown and first.items() <= halves().items()


def test_overrides_and_variants_change_the_picture_alone(stage, tmp_path):
    scenes = [
        {"name": "plain", "stage": "block.usda"},
        {"name": "dark", "stage": "block.usda", "variants": {"/World": {"color": "dark"}}},
        {
            "name": "thin",
            "stage": "block.usda",
            "overrides": {SCALE: 3, "/World/Key.inputs:color": [1, 1, 0.5]},
        },
    ]
    before = stage.read_text()
    session = tmp_path / "session.usda"
    session.write_text('#usda 1.0\nover "World"\n{\nover "Key"\n{\nfloat inputs:intensity = 20\n}\n}\n')
    file = write_spec(tmp_path, scenes=scenes, samples=16)
    flags = ("--spec", file, "--numbersOnly", "--quiet", "--sessionLayer", session)
    assert run(*flags, "--out", tmp_path / "out") == 0
    assert stage.read_text() == before and "subsurfaceScale" not in session.read_text()
    found = results(tmp_path / "out")
    assert [mean["scene"] for mean in found["means"]] == ["plain", "dark", "thin", ""]
    oiio = pytest.importorskip("OpenImageIO")
    means = {}
    for scene in found["scenes"]:
        image = oiio.ImageBuf(scene["crops"][0]["reference"][0])
        means[scene["name"]] = image.get_pixels(oiio.FLOAT)[4:12, 4:12, :3].mean(axis=(0, 1))
    assert (means["dark"] < 0.5 * means["plain"]).all()
    np.testing.assert_allclose(means["thin"][2] / means["plain"][2], 0.5, rtol=0.2)
    steps = {row["scene"]: row["steps"] for row in found["rows"]}
    assert steps["thin"] < steps["plain"]


def test_given_references(stage, tmp_path, capsys):
    files = {}
    for name, flags in {
        "a": ["--seed", "501"],
        "b": ["--seed", "502"],
        "bare": ["--seed", "503", "--aov", "alpha"],
        "other": ["--seed", "501", "-w", "8"],
        "corner": ["--seed", "501", "--crop", "0", "0", "0.5", "0.5"],
        "clash": ["--seed", "2"],
    }.items():
        files[name] = tmp_path / f"{name}.exr"
        base = ["-w", "16", "--samples", "32", "--progress", "none"]
        assert main(["record", str(stage), str(files[name]), *base, *flags]) == 0
    capsys.readouterr()
    base = (stage, "--methods", "classical", "--samples", "2", "-w", "16", "--numbersOnly", "--quiet")

    def bench(*names: str, crop: str = "r=0.25,0.25,0.75,0.75") -> int:
        given = [flag for name in names for flag in ("--reference", files[name])]
        return run(*base, "--crops", crop, *given, "--out", tmp_path / "out")

    assert bench("a", "b") == 0
    assert results(tmp_path / "out")["scenes"][0]["crops"][0]["noise_from"] == "difference of two halves"
    halves = results(tmp_path / "out")["reference_noise"][0]["noise"]
    assert "is not known" not in capsys.readouterr().out
    assert bench("a") == 0
    assert "variance AOV, an upper bound" in capsys.readouterr().out
    # One half has twice the variance of both.
    assert results(tmp_path / "out")["reference_noise"][0]["noise"] == pytest.approx(2.0 * halves, rel=0.5)
    assert bench("bare") == 0
    assert "noise is not known" in capsys.readouterr().out
    assert bench("corner", crop="r=0.1,0.1,0.4,0.4") == 0
    for names, said in [
        (["other"], "it is of 8 x 8 pixels, block of 16 x 16"),
        (["corner"], "does not cover"),
        (["clash"], "rendered with seed 2, as is repeat 1 of classical"),
        (["a", "b", "bare"], "not 3 files"),
    ]:
        capsys.readouterr()
        assert bench(*names) == 1
        assert said in capsys.readouterr().err
    files["gone"] = tmp_path / "gone.exr"
    assert bench("gone") == 1
    assert "gone.exr: it cannot be read" in capsys.readouterr().err


def test_noisy_reference_is_warned_about(stage, tmp_path, capsys):
    flags = ("-w", "16", "--samples", "16", "--referenceSamples", "16", "--numbersOnly", "--quiet")
    assert run(stage, "--methods", "classical", "--out", tmp_path / "out", *flags) == 0
    said = capsys.readouterr().out
    assert "more than 10% of the smallest error measured; give it more samples: block/frame" in said


def test_budget_is_a_time_limit(stage, tmp_path):
    flags = (
        "-w",
        "16",
        "--budget",
        "0.05,0.2",
        "--seeds",
        "1",
        "--referenceSamples",
        "16",
        "--numbersOnly",
        "--quiet",
    )
    assert run(stage, "--methods", "classical", "--out", tmp_path / "out", *flags) == 0
    short, long = results(tmp_path / "out")["rows"]
    assert 1 < short["samples"]["mean"] < long["samples"]["mean"]
    assert 0.05 <= short["wall"]["mean"] < long["wall"]["mean"] < 2.0


def test_missing_matplotlib_is_said_before_anything_renders(stage, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    flags = (stage, "--methods", "classical", "--out", tmp_path / "out", *SMALL)
    assert run(*flags) == 2
    assert "pip install matplotlib flip-evaluator" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(*flags, "--numbersOnly") == 0
    assert "FLIP: not measured" in capsys.readouterr().out
    assert not (tmp_path / "out" / "report.html").exists()


def test_a_method_that_fails_does_not_stop_the_others(stage, tmp_path, monkeypatch, capsys):
    def failing(scene, settings, window, **more):
        if settings["walk"] == "poe":
            raise CoreError("the render failed: no such luck")
        return render.render(scene, settings, window, **more)

    monkeypatch.setattr(runner, "render", failing)
    out = tmp_path / "out"
    assert run(stage, "--methods", "poe,classical", "--out", out, "--numbersOnly", *SMALL) == 1
    said = capsys.readouterr()
    assert "failed: block frame: poe, 2 spp: the render failed: no such luck" in said.err
    rows = results(out)["rows"]
    assert [row["method"] for row in rows] == ["classical"]
    # The baseline is the one that failed.
    assert rows[0]["ratio"] is None


def test_interrupted_runs_report_what_is_there(stage, tmp_path, monkeypatch, capsys):
    calls = count_renders(monkeypatch, stop_at=6)  # two warm-ups, three of four renders
    out = tmp_path / "out"
    flags = (stage, "--methods", "classical,poe", "--out", out, "--numbersOnly", *SMALL)
    assert run(*flags) == 130
    assert "interrupted: not all that was asked for is here" in capsys.readouterr().out
    found = results(out)
    assert found["interrupted"] is True and len(found["renders"]) == 3
    assert len((out / "results.csv").read_text().splitlines()) == 4

    # The second run takes up the three, as they were.
    calls.clear()
    assert run(*flags) == 0
    again = results(out)
    assert (again["interrupted"], again["kept"], len(again["renders"])) == (False, 3, 4)
    assert len(calls) == 2 and "3 of 4 renders are of an earlier run" in capsys.readouterr().out
    for render_before in found["renders"]:
        assert render_before in again["renders"]
    # A third has nothing to do, and the same to say.
    calls.clear()
    assert run(*flags) == 0
    assert calls == [] and results(out)["rows"] == again["rows"]


def test_what_is_kept_is_reused_for_the_same_alone(stage, tmp_path, monkeypatch):
    out = tmp_path / "out"
    calls = count_renders(monkeypatch)

    def rendered(*flags: object, methods: str = "classical") -> int:
        """Renders of a run, without the warm-ups (a sample each)."""
        calls.clear()
        assert run(stage, "--methods", methods, "--out", out, "--numbersOnly", *SMALL, *flags) == 0
        return sum(settings["samples"] > 1 for settings in calls)

    assert rendered() == 2
    assert rendered() == 0
    # One more of each: seed, amount of work, method; two labels of the same are measured apart.
    assert rendered("--seeds", "3") == 1
    assert rendered("--samples", "2,3") == 2
    assert rendered(methods="classical,poe") == 2
    assert rendered(methods="classical,same=classical") == 2
    # Another window, seed, setting of the method, number of threads.
    assert rendered("--crops", "part=.2,.2,.8,.8") == 2
    assert rendered("--seed", "7") == 2
    assert rendered(methods="classical:maxDepth=3") == 2
    assert rendered("--set", "threads=1") == 2
    # A comment changes nothing, light does; what is broken is rendered again.
    stage.write_text(stage.read_text().replace("def Cube", "# of wax\n    def Cube"))
    assert rendered() == 0
    stage.write_text(stage.read_text().replace("intensity = 10", "intensity = 11"))
    assert rendered() == 2
    for file in (out / "runs").iterdir():
        file.write_bytes(file.read_bytes()[: file.stat().st_size - 200])
    assert rendered() == 2
    # So does another build of the renderer, of which nothing else is known.
    monkeypatch.setattr(store, "renderer", lambda: ("0", "another"))
    assert rendered() == 2


def count_renders(monkeypatch: pytest.MonkeyPatch, stop_at: int = 0) -> list[dict]:
    """Settings of the renders from now on, references not among them; the `stop_at`th is interrupted."""
    calls: list[dict] = []
    state = {"left": stop_at}

    def counted(scene, settings, window, **more):
        calls.append(settings)
        state["left"] -= 1
        if state["left"] == 0:
            raise KeyboardInterrupt
        return render.render(scene, settings, window, **more)

    monkeypatch.setattr(runner, "render", counted)
    return calls


def test_renders_start_from_nothing_and_are_told_apart_by_seed(stage, tmp_path, capsys):
    named = "classical,same=classical,other=classical:seed=5"
    assert run(stage, "--methods", named, "--out", tmp_path / "out", "--numbersOnly", *SMALL) == 0
    said = capsys.readouterr().out
    assert "same renders the images of classical, bit for bit" in said and "other renders" not in said
    found = results(tmp_path / "out")["renders"]
    plain = {(r["method"], r["seed"]): r["plain"] for r in found}
    assert plain["classical", 1] == plain["same", 1] != plain["classical", 2] == plain["same", 2]


def test_rigs_are_described_for_the_stages_that_exist(shared_scenes):
    read = suite_of("--spec", RIGS)
    assert len(read.scenes) == 9
    from pxr import Usd

    for scene in read.scenes:
        assert scene.stage.resolve().parent == shared_scenes
        opened = Usd.Stage.Open(str(scene.stage))
        for path, value in scene.overrides.items():
            assert opened.GetAttributeAtPath(path).Get() != value
        for crop in scene.crops:
            resolution = tuple(scene.settings["resolution"])
            assert crops.window(crop.ndc, resolution).size == (40, 40), (scene.name, crop.name)
