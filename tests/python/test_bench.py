"""`dermis bench` end to end on a tiny translucent block."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from bench_runs import SCALE, SMALL, results, run, write_spec

from dermis._core import CoreError
from dermis.bench import measures, render, runner
from dermis.cli import main


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
    assert row["relmse"]["mean"] == pytest.approx(np.mean([r["raw_plain"] - r["raw_noise"] for r in mine]))
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


def test_crops_and_cuts_of_the_frame_are_the_same_pixels(stage, tmp_path):
    crop = ("--crops", "part=0.25,0.25,0.75,0.6", "--numbersOnly", *SMALL)
    rows = []
    for whole in ([], ["--wholeFrames"]):
        out = tmp_path / f"out{len(rows)}"
        assert run(stage, "--methods", "classical", "--out", out, *whole, *crop) == 0
        rows.append(results(out)["rows"][0])
    # Sums over a view round in another order.
    assert rows[0]["relmse"]["mean"] == pytest.approx(rows[1]["relmse"]["mean"], rel=1e-12)
    assert rows[0]["bias"] == pytest.approx(rows[1]["bias"], rel=1e-12)


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
    # One half has twice the variance of both, and the AOV takes Sobol samples for independent ones.
    assert 1.0 < results(tmp_path / "out")["reference_noise"][0]["noise"] / halves < 5.0
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


def test_renders_start_from_nothing_and_are_told_apart_by_seed(stage, tmp_path, capsys):
    named = "classical,same=classical,other=classical:seed=5"
    assert run(stage, "--methods", named, "--out", tmp_path / "out", "--numbersOnly", *SMALL) == 0
    said = capsys.readouterr().out
    assert "same renders the images of classical, bit for bit" in said and "other renders" not in said
    found = results(tmp_path / "out")["renders"]
    plain = {(r["method"], r["seed"]): r["raw_plain"] for r in found}
    assert plain["classical", 1] == plain["same", 1] != plain["classical", 2] == plain["same", 2]
