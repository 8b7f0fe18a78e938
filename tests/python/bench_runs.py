"""A tiny translucent block, and runs of `dermis bench` on it."""

import json
from pathlib import Path
from typing import Any

import pytest

from dermis.cli import build_parser, main
from dermis.cli.settings import default_settings

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


def suite_of(*flags: object) -> Any:
    from dermis.bench import spec

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


def count_renders(monkeypatch: pytest.MonkeyPatch, stop_at: int = 0) -> list[dict]:
    """Settings of the renders from now on, references not among them; the `stop_at`th is interrupted."""
    from dermis.bench import render, runner

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
