"""Frame specs and placeholders: usdrecord's rules and words."""

import argparse

import pytest
from pxr import Usd, UsdUtils

from dermis.cli import frames


@pytest.mark.parametrize(
    ("path", "mark"),
    [
        ("a.###.exr", "###"),
        ("a.##.##.exr", "##.##"),
        ("#", "#"),
        ("a.exr", None),
        ("", None),
        ("a.#.b#.exr", None),
        ("a.##.##.##.exr", None),
    ],
)
def test_placeholder(path, mark):
    assert frames.placeholder(path) == mark


@pytest.mark.parametrize(
    ("path", "time", "file"),
    [
        ("a.###.exr", 7.0, "a.007.exr"),
        ("a.###.exr", 1234.0, "a.1234.exr"),
        ("a.###.##.exr", 1.5, "a.001.50.exr"),
        ("a.#.exr", -3.0, "a.-3.exr"),
        ("{a}.##.exr", 5.0, "{a}.05.exr"),
        ("a.exr", 5.0, "a.exr"),
    ],
)
def test_frame_path(path, time, file):
    assert frames.frame_path(path, time) == file


@pytest.mark.parametrize(
    ("specs", "times", "decimals"),
    [
        ("123", [123], 0),
        ("101:105", [101, 102, 103, 104, 105], 0),
        ("105:103", [105, 104, 103], 0),
        ("101:109x2", [101, 103, 105, 107, 109], 0),
        ("101:110x2", [101, 103, 105, 107, 109], 0),
        ("101:102x0.5", [101, 101.5, 102], 1),
        ("1,5:6,2:3x0.25", [1, 5, 6, 2, 2.25, 2.5, 2.75, 3], 2),
    ],
)
def test_frame_specs(specs, times, decimals):
    found, needed = frames.parse_frame_specs(specs)
    assert ([code.GetValue() for code in found], needed, len(found)) == (times, decimals, len(times))
    assert [found[i] for i in range(len(found))] == list(found) and found[-1].GetValue() == times[-1]


@pytest.mark.parametrize("spec", ["1:2x0.1", "0:1x0.3", "5:1x-0.7", "1:100x7", "0:3x0.1", "-1:1x0.25"])
def test_frame_counts_are_those_of_usd(spec):
    codes = list(UsdUtils.TimeCodeRange.CreateFromFrameSpec(spec))
    found, _ = frames.parse_frame_specs(spec)
    assert [code.GetValue() for code in found] == pytest.approx([code.GetValue() for code in codes])


def test_a_long_range_costs_nothing():
    found, _ = frames.parse_frame_specs("1:1e9")
    assert (len(found), found[5].GetValue(), found[-1].GetValue()) == (10**9, 6.0, 1e9)
    assert next(iter(found)).GetValue() == 1.0
    with pytest.raises(IndexError):
        found[10**9]


@pytest.mark.parametrize("specs", ["x", "1:2:3", "1:5x", "1:5x-1", "1:2x0", "1,,2"])
def test_bad_frame_specs(specs):
    with pytest.raises(ValueError, match="Invalid FrameSpec"):
        frames.parse_frame_specs(specs)


def resolve(path, specs=None, default_time=False, start=None):
    stage = Usd.Stage.CreateInMemory()
    if start is not None:
        stage.SetStartTimeCode(start)
    args = argparse.Namespace(frames=specs, defaultTime=default_time, outputImagePath=path)
    return frames.resolve_times(argparse.ArgumentParser(prog="dermis"), args, stage, ("outputImagePath",))


def test_times_without_frames():
    assert [t.GetValue() for t in resolve("a.exr")] == [0.0]
    assert [t.GetValue() for t in resolve("a.exr", start=12.0)] == [12.0]
    assert resolve("a.exr", default_time=True)[0].IsDefault()


@pytest.mark.parametrize(
    ("path", "specs", "said"),
    [
        ("a.###.exr", None, "cannot contain a frame number placeholder when not operating on a frame range."),
        (
            "a.exr",
            "1:2",
            'must contain exactly one frame number placeholder of the form "###"" or "###.###".',
        ),
        (
            "a.##.exr",
            "1:2x0.5",
            "require a minimum floating point precision of 1, but the frame placeholder in",
        ),
        ("a.##.exr", "abc", 'Invalid FrameSpec: "abc"'),
    ],
)
def test_usage_errors(path, specs, said, capsys):
    with pytest.raises(SystemExit) as error:
        resolve(path, specs)
    assert error.value.code == 2
    assert said in capsys.readouterr().err
