"""`dermis bench`: its numbers against hand-computed ones, and runs end to end on a tiny translucent card."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from dermis._core import CoreError
from dermis.bench import crops, measures, methods, reference, render, runner, spec, suite
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
    assert (errors.noise, errors.corrected) == (0.0, errors.plain)


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
    assert errors.corrected == pytest.approx(exact, rel=0.05)
    assert errors.corrected_trimmed == pytest.approx(exact, rel=0.05)
    assert errors.corrected_trimmed < errors.corrected


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
        (["a.usda", "--methods", "classical", "--samples", "4"], "a has no reference"),
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
        ({"methods": "classical", "reference": {}}, "block has no reference"),
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
    assert (read.crops, read.reference_samples) == (False, 8)


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
    out = tmp_path / "out"
    flags = ("--crops", "left=0.2,0.2,0.5,0.8", "--crops", "block/right=0.5,0.2,0.8,0.8")
    named = "classical,again=classical:seed=90,wrong=classical:subsurfaceBoundary=indexMatched"
    figure = tmp_path / "deep" / "figure.png"
    amounts = ("-w", "24", "--samples", "4,16", "--seeds", "3", "--referenceSamples", "128", "--quiet")
    assert run(stage, "--methods", named, "--out", out, "--figure", figure, *flags, *amounts) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out == (out / "table.md").read_text()

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
    assert len(list((out / "errors").iterdir())) == len(list((out / "images").iterdir())) == 6
    for picture in (figure, out / "relmse_over_time.png", out / "relmse_over_samples.png"):
        assert min(Image.open(picture).size) > 100


def test_crops_and_cuts_of_the_frame_are_the_same_pixels(stage, tmp_path):
    crop = ("--crops", "part=0.25,0.25,0.75,0.6", "--numbersOnly", *SMALL)
    rows = []
    for kind in ("--crops", "--wholeFrames"):
        assert run(stage, "--methods", "classical", "--out", tmp_path / kind, kind, *crop) == 0
        rows.append(results(tmp_path / kind)["rows"][0])
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
    assert "pip install matplotlib" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(*flags, "--numbersOnly") == 0


def test_a_method_that_fails_does_not_stop_the_others(stage, tmp_path, monkeypatch, capsys):
    def failing(scene, settings, window, file=None):
        if settings["walk"] == "poe":
            raise CoreError("the render failed: no such luck")
        return render.render(scene, settings, window, file)

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
    calls = []

    def interrupted(scene, settings, window, file=None):
        calls.append(settings)
        if len(calls) == 6:  # two warm-ups, three of four renders
            raise KeyboardInterrupt
        return render.render(scene, settings, window, file)

    monkeypatch.setattr(runner, "render", interrupted)
    out = tmp_path / "out"
    assert run(stage, "--methods", "classical,poe", "--out", out, *SMALL) == 130
    assert "interrupted: not all that was asked for is here" in capsys.readouterr().out
    found = results(out)
    assert found["interrupted"] is True and len(found["renders"]) == 3
    assert (out / "relmse_over_time.png").exists()


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
