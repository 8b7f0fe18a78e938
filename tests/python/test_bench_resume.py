"""Runs of `dermis bench` that are interrupted and taken up, and what is said meanwhile."""

import signal
import subprocess
import sys

import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from bench_runs import SMALL, count_renders, results, run

from dermis.bench import store


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
