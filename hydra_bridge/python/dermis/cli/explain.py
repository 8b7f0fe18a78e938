"""`dermis explain STAGE`: what the scene needs, what was switched on and why, what was dropped."""

import argparse
import json
import sys
from typing import Any

from .arguments import add_sampling_arguments, add_stage_arguments, add_view_arguments
from .settings import SettingsError, default_settings, format_value
from .warnings import merge

NAME = "explain"
FILES = "STAGE"
HELP = "Says what a stage needs, what is switched on for it and why, and what is dropped"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_stage_arguments(parser)
    add_view_arguments(parser)
    add_sampling_arguments(parser)


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    from .scene import FRAME_ERRORS, open_scene

    try:
        scene = open_scene(parser, args, default_settings())
    except SettingsError as error:
        parser.error(str(error))
    code = 0
    for when in scene.times:
        try:
            loaded = scene.load(when)
            loaded.delegate.commit()
        except FRAME_ERRORS as error:
            code = 1
            print(error, file=sys.stderr)
            continue
        if len(scene.times) > 1:
            print(f"Time code: {when.GetValue():f}")
        print(explanation(loaded))
    return code


def explanation(loaded: Any) -> str:
    """The core's own account: what is on and why, the walks, what is off, counts, warnings of both sides."""
    report = json.loads(loaded.delegate.explain())
    dropped = [(entry["prim"], entry["message"]) for entry in report.get("warnings", [])]
    capabilities = report["capabilities"]
    lines = [f"camera: {loaded.camera or 'framed automatically'}", "on:"]
    lines += [f"  {entry['capability']}: {entry['why']}" for entry in capabilities if entry["on"]]
    if report["media"]:
        lines += ["walks:", *(f"  {medium_line(medium)}" for medium in report["media"])]
    if report["subdivision"]:
        lines += ["subdivision:", *(f"  {surface_line(surface)}" for surface in report["subdivision"])]
    lines += ["off: " + ", ".join(entry["capability"] for entry in capabilities if not entry["on"]), "needs:"]
    lines += [f"  {name}: {format_value(value)}" for name, value in report["needs"].items()]
    warnings = [f"  {prim}: {message}" for prim, message in merge(loaded.warnings, dropped)]
    return "\n".join(
        [*lines, *(["dropped or replaced:", *warnings] if warnings else ["dropped or replaced: nothing"])]
    )


def surface_line(surface: dict[str, Any]) -> str:
    """What became of a subdivision surface."""
    made = "its cage" if surface["level"] == 0 else f"level {surface['level']}"
    faces, triangles = surface["cageFaces"], surface["triangles"]
    return f"{surface['prim']}: {surface['scheme']}, {made}: {faces} faces to {triangles} triangles"


def medium_line(medium: dict[str, Any]) -> str:
    """Which walk a medium takes, and why."""
    guided = medium["walk"] != "classical"
    weight = {True: " (exact weights)", False: " (conditional weights)"}[medium["exact"]] if guided else ""
    return f"{medium['prim']}: {medium['walk']}{weight}: {medium['why']}"
