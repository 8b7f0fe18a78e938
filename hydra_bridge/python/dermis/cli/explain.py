"""`dermis explain STAGE`: what the scene needs, what was switched on and why, what was dropped."""

import argparse
import json
import sys
from typing import Any

from .. import costs
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
    """The core's own account: what is on and why, the walks, what is off and why, what each costs, counts, warnings
    of both sides."""
    report = json.loads(loaded.delegate.explain())
    dropped = [(entry["prim"], entry["message"]) for entry in report.get("warnings", [])]
    capabilities = report["capabilities"]
    lines = [f"camera: {loaded.camera or 'framed automatically'}", "on:", *whys(capabilities, True)]
    if report["media"]:
        lines += ["walks:", *(f"  {medium_line(medium)}" for medium in report["media"])]
    if report["subdivision"]:
        lines += ["subdivision:", *(f"  {surface_line(surface)}" for surface in report["subdivision"])]
    lines += ["off:", *whys(capabilities, False), *cost_lines(capabilities), "needs:"]
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


def whys(capabilities: list[dict[str, Any]], on: bool) -> list[str]:
    return [f"  {entry['capability']}: {entry['why']}" for entry in capabilities if entry["on"] == on]


def cost_lines(capabilities: list[dict[str, Any]]) -> list[str]:
    """What each capability costs where a stage uses it, and where one only declares it: of minimal stages, not of
    this one."""
    known = costs.load()
    if known is None:
        return ["costs: not measured for this build; `make needs` does"]
    on = {entry["capability"]: entry["on"] for entry in capabilities}
    rows = [row for row in known.rows if row["capability"] in on]
    name, used = (max((len(text) for text in texts), default=0) for texts in columns(rows))
    lines = [f"costs on minimal stages, per sample ({known.made()}):"]
    for row in rows:
        here = "on " if on[row["capability"]] else "off"
        first, second = costs.in_use(row["used"]), costs.declared(row["unused"])
        lines.append(f"  {here} {row['capability']:{name}}  in use {first:{used}}  declared only {second}")
    missing = [capability for capability in on if known.row(capability) is None]
    return [*lines, *([f"  not measured: {', '.join(missing)}"] if missing else [])]


def columns(rows: list[dict[str, Any]]) -> tuple[list[str], list[str]]:
    return [row["capability"] for row in rows], [costs.in_use(row["used"]) for row in rows]


def medium_line(medium: dict[str, Any]) -> str:
    """Which walk a medium takes, and why."""
    guided = medium["walk"] != "classical"
    weight = {True: " (exact weights)", False: " (conditional weights)"}[medium["exact"]] if guided else ""
    return f"{medium['prim']}: {medium['walk']}{weight}: {medium['why']}"
