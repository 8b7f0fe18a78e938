"""Flags and settings before any stage is opened: what is accepted, what is refused, what wins."""

import argparse
import math

import pytest

from dermis.cli import build_parser, settings, view

DEFAULTS = {
    "camera": "",
    "resolution": [960, 540],
    "samples": 64,
    "timeLimit": 0.0,
    "walk": "auto",
    "lightsVisibleToCamera": False,
    "dataWindowNDC": [0.0, 0.0, 1.0, 1.0],
    "aovs": [],
}

CAMERA = {"horizontalAperture": 20.955, "verticalAperture": 15.2908, "transform": "the camera's"}


def record(*flags: str) -> argparse.Namespace:
    return build_parser()[0].parse_args(["record", "a.usda", "a.exr", *flags])


def test_nothing_typed_is_nothing_set():
    assert settings.typed_settings(record(), DEFAULTS) == {}


def test_usdrecord_flags_are_accepted():
    args = record(
        *("--mask", "/A,/B", "--purposes", "render,guide", "--sessionLayer", "s.usda", "--disableGpu"),
        *(
            "--disableCameraLight",
            "-cam",
            "shot",
            "-f",
            "1:2",
            "-c",
            "high",
            "-color",
            "sRGB",
            "-r",
            "dermis",
        ),
        *("-w", "320", "--enableDomeLightVisibility", "-rs", "/Render/S", "--disableDrawMode", "--memstats"),
        *("--resolver", "root", "--traceToFile", "t.json", "--traceFormat", "trace"),
    )
    assert args.purposes == ("default", "render", "guide")
    assert (args.camera, args.frames, args.imageWidth, args.rsPrimPath) == ("shot", "1:2", 320, "/Render/S")
    assert record("-rp", "/Render/P", "-d").rpPrimPath == "/Render/P"


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--walk", "vpg"], "walk 'vpg' is not available in this version"),
        (["--walk", "zigzag"], "invalid choice: 'zigzag'"),
        (["--walkPdf", "marginal"], "invalid choice: 'marginal'"),
        (["--classicalFraction", "1.5"], "1.5 is not between 0 and 1"),
        (["--classicalFraction", "nan"], "nan is not between 0 and 1"),
        (["--purposes", "rendr"], "Unrecognized purpose value 'rendr'."),
        (["--samples", "0"], "0 is below 1"),
        (["--samples", "99999999999"], "too large"),
        (["--timeLimit", "nan"], "nan is below 0"),
        (["--timeLimit", "inf"], "not finite"),
        (["--seed", "-1"], "-1 is below 0"),
        (["--crop", "0.5", "0", "0.5", "1"], "X0 < X1"),
        (["--crop", "0", "0", "1", "nan"], "Y0 < Y1"),
        (["--aov", "colour"], "invalid choice: 'colour'"),
        (["--displayImage", "a.exr"], "must end in one of .png, .jpg, .jpeg"),
        (["--set", "samples"], "expected NAME=VALUE, got 'samples'"),
        (["--renderer", "Storm"], "invalid choice: 'Storm'"),
        (["--resolver", "leaf"], "invalid choice: 'leaf'"),
        (["-d", "-f", "1"], "not allowed with argument"),
        (["--unknown"], "unrecognized arguments: --unknown"),
    ],
)
def test_usage_errors(flags, said, capsys):
    with pytest.raises(SystemExit) as error:
        record(*flags)
    assert error.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("walk", ["auto", "classical", "poe", "cp", "ii", "bono", "bill", "mixture"])
def test_walks_are_settings(walk):
    defaults = {"walkPdf": "auto", "classicalFraction": 0.0, "normals": 7, "learnShares": True}
    flags = ("--walk", walk, "--walkPdf", "exact", "--classicalFraction", "0.25")
    typed = settings.typed_settings(
        record(*flags, "--set", "normals=3", "--set", "learnShares=off"), DEFAULTS | defaults
    )
    assert typed == {
        "walk": walk,
        "walkPdf": "exact",
        "classicalFraction": 0.25,
        "normals": 3,
        "learnShares": False,
    }


@pytest.mark.parametrize(
    ("file", "accepted"), [("a.JPG", True), ("a.tif", False), ("exr", False), ("a.exr", True)]
)
def test_image_kinds(file, accepted, capsys):
    if accepted:
        assert build_parser()[0].parse_args(["record", "a.usda", file]).outputImagePath == file
        return
    with pytest.raises(SystemExit):
        build_parser()[0].parse_args(["record", "a.usda", file])
    assert "must end in one of .exr, .png" in capsys.readouterr().err


def test_typed_settings():
    flags = ("--samples", "4", "--crop", "0", "0.25", "0.5", "1", "--aov", "depth", "--aov", "normal")
    typed = settings.typed_settings(
        record(*flags, "--set", "lightsVisibleToCamera=1", "--set", "samples=4"), DEFAULTS
    )
    assert typed == {
        "samples": 4,
        "dataWindowNDC": [0.0, 0.25, 0.5, 1.0],
        "aovs": ["depth", "normal"],
        "lightsVisibleToCamera": True,
    }


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("sampels=3", "there is no setting 'sampels'; did you mean samples?"),
        ("q=3", "--set alone lists the settings"),
        ("samples=many", "'many' is no whole number"),
        ("samples=-1", "out of range"),
        ("timeLimit=nan", "not finite"),
        ("lightsVisibleToCamera=maybe", "neither true nor false"),
        ("resolution=64", "2 values were expected"),
        ("samples=8", "--set samples=8 contradicts samples=4"),
    ],
)
def test_bad_assignments(assignment, said):
    with pytest.raises(settings.SettingsError) as error:
        settings.typed_settings(record("--samples", "4", "--set", assignment), DEFAULTS)
    assert said in str(error.value)


def test_listing_can_be_typed_back():
    for line in settings.listing(DEFAULTS).splitlines():
        name, value = settings.parse_assignment(line, DEFAULTS)
        assert value == DEFAULTS[name]


def test_overrides_say_what_they_replace():
    lines = settings.overrides({"samples": 4, "walk": "auto"}, {"samples": 64}, "</Render/S>")
    assert lines == ["Flag overrides samples of </Render/S>: 4 instead of 64"]


@pytest.mark.parametrize(
    ("flags", "authored", "size"),
    [
        ([], {}, [960, 700]),
        (["-w", "32"], {}, [32, 23]),
        (["-w", "0"], {}, [1, 1]),
        (["--imageHeight", "10"], {}, [960, 10]),
        (["-w", "8", "--imageHeight", "4"], {"resolution": [64, 48]}, [8, 4]),
        ([], {"resolution": [64, 48]}, [64, 48]),
        (["-w", "32"], {"resolution": [64, 64]}, [32, 23]),
        (["--imageHeight", "10"], {"resolution": [64, 48]}, [64, 10]),
    ],
)
def test_image_size(flags, authored, size):
    assert view.image_size(record(*flags), {}, authored, view.aspect_ratio(CAMERA)) == size


def test_image_size_by_set():
    assert view.image_size(record(), {"resolution": [5, 6]}, {"resolution": [64, 48]}, 1.0) == [5, 6]
    with pytest.raises(settings.SettingsError, match="contradicts"):
        view.image_size(record("-w", "3"), {"resolution": [5, 6]}, {}, 1.0)
    with pytest.raises(settings.SettingsError, match="too large"):
        view.image_size(record("-w", "10000000"), {}, {}, 1.0)


@pytest.mark.parametrize("vertical", [0.0, -1.0, 1e9])
def test_aspect_of_a_broken_aperture_is_one(vertical):
    assert view.aspect_ratio({"horizontalAperture": 20.0, "verticalAperture": vertical}) == 1.0


def test_camera_light_makes_a_white_card_white():
    light = view.camera_light(CAMERA)
    # A distant light of angle 0 has irradiance = intensity; a white Lambertian card reflects E / pi.
    assert light["intensity"] / math.pi == 1.0
    assert light["shape"] == {"kind": "distant", "angle": 0.0}
    assert light["transform"] == CAMERA["transform"]


def test_find_named_camera():
    assert view.find_named(["/A/cam", "/B/cam"], "/B/cam") == "/B/cam"
    assert view.find_named(["/A/cam", "/B/shot"], "shot") == "/B/shot"
    assert view.find_named(["/A/cam"], "am") is None


@pytest.mark.parametrize("command", ["record", "explain", "flatten", "bench"])
def test_help(command, capsys):
    with pytest.raises(SystemExit) as error:
        build_parser()[0].parse_args([command, "--help"])
    assert error.value.code == 0
    assert "STAGE" in capsys.readouterr().out
