"""What `dermis bench` is asked to compare: methods, crops, flags and descriptions."""

from pathlib import Path

import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from bench_runs import SCALE, SECOND, SMALL, run, suite_of, write_spec

from dermis.bench import crops, methods, runner, suite
from dermis.cli import main
from dermis.cli.settings import default_settings

REPOSITORY = Path(__file__).resolve().parents[2]
RIGS = REPOSITORY / "usd_scenes" / "bench_rigs.json"


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


@pytest.mark.parametrize(("name", "scenes"), [("rigs", 14), ("order", 12), ("slopes", 3)])
def test_rigs_are_described_for_the_stages_that_exist(shared_scenes, name, scenes):
    read = suite_of("--spec", RIGS.with_name(f"bench_{name}.json"))
    assert len(read.scenes) == scenes
    from pxr import Usd

    for scene in read.scenes:
        assert (
            scene.stage.resolve().parent == (RIGS.parent if scene.name == "orc" else shared_scenes).resolve()
        )
        opened = Usd.Stage.Open(str(scene.stage))
        for path, value in scene.overrides.items():
            assert opened.GetAttributeAtPath(path).Get() != value
        for crop in scene.crops:
            resolution = tuple(scene.settings["resolution"])
            assert crops.window(crop.ndc, resolution).size == (40, 40), (scene.name, crop.name)
