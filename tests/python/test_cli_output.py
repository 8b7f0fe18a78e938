"""Files that appear whole, warnings that appear once, progress that farms can read, signals that end well."""

import json
import os
import signal
import stat

import pytest

from dermis.cli import interrupt, output, progress, warnings


def test_replacing_writes_whole_files_only(tmp_path):
    file = tmp_path / "a.png"
    file.write_text("before")
    with pytest.raises(RuntimeError), output.replacing(file) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert file.read_text() == "before"
    with output.replacing(file) as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".png")
        temporary.write_text("after")
        assert file.read_text() == "before"
    assert file.read_text() == "after"
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_replacing_keeps_to_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        with output.replacing(tmp_path / "a.json") as temporary:
            temporary.write_text("{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o640


def test_missing_folder_is_made(tmp_path):
    output.prepare_folder(tmp_path / "deep" / "down" / "a.exr")
    assert list((tmp_path / "deep" / "down").iterdir()) == []


def test_impossible_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(output.OutputError, match="Cannot write to folder .*file"):
        output.prepare_folder(tmp_path / "file" / "a.exr")
    (tmp_path / "a.exr").mkdir()
    with pytest.raises(output.OutputError, match="it is a folder"):
        output.prepare_folder(tmp_path / "a.exr")


def test_json_has_no_nan(tmp_path):
    output.write_json(tmp_path / "s.json", {"a": [1.5, float("nan")], "b": {"c": float("inf")}})
    assert json.loads((tmp_path / "s.json").read_text()) == {"a": [1.5, None], "b": {"c": None}}


def test_alf_progress(capsys):
    with progress.Progress("alf", frames=2) as shown:
        for frame, fraction in [(0, 0.0), (0, 0.5), (0, 0.501), (0, 1.0), (1, 1.0)]:
            shown.update(frame, fraction)
    expected = ["ALF_PROGRESS 0%", "ALF_PROGRESS 25%", "ALF_PROGRESS 50%", "ALF_PROGRESS 100%"]
    assert capsys.readouterr().out.splitlines() == expected


def test_json_progress(capsys):
    with progress.Progress("json") as shown:
        shown.update(0, 0.25)
        shown.update(0, 0.25)
        shown.update(0, 1.0)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["progress"] for line in lines] == [0.25, 1.0]
    assert all(line["seconds"] >= 0 and line["frame"] == 0 for line in lines)


def test_bar_and_none_leave_stdout_alone(capsys):
    for kind in ("bar", "none"):
        with progress.Progress(kind) as shown:
            shown.update(0, 0.5)
    assert capsys.readouterr().out == ""


def test_each_warning_is_printed_once(capsys):
    printer = warnings.Printer()
    printer.print([("/A", "points: bad")])
    printer.print([("/A", "points: bad"), ("/B", "points: bad")])
    assert capsys.readouterr().err == "Warning: /A: points: bad\nWarning: /B: points: bad\n"


def test_merge_keeps_order_and_drops_repeats():
    assert warnings.merge([("/A", "x"), ("/B", "x")], [("/A", "x"), ("/C", "y")]) == [
        ("/A", "x"),
        ("/B", "x"),
        ("/C", "y"),
    ]


def test_self_check():
    assert warnings.self_check(True, True, {"non_finite_samples": 0}) == []
    assert warnings.self_check(True, False, {}) == [("image", "the image is all black")]
    assert "3 samples were not finite" in warnings.self_check(True, True, {"non_finite_samples": 3})[0][1]
    assert warnings.self_check(False, True, {}) == [("image", "the image has pixels that are not finite")]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_first_signal_is_a_request_second_one_interrupts(number):
    before = signal.getsignal(number)
    with interrupt.Interrupt() as requests:
        with requests.deferred():
            os.kill(os.getpid(), number)
            assert requests.requested
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), number)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before
