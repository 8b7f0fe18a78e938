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
    """The core's own account as an indented list, with the warnings of both sides."""
    report = json.loads(loaded.delegate.explain())
    dropped = [(entry["prim"], entry["message"]) for entry in report.pop("warnings", [])]
    report = {"camera": loaded.camera or "framed automatically", **report}
    warnings = [f"{prim}: {message}" for prim, message in merge(loaded.warnings, dropped)]
    return "\n".join(outline({**report, "warnings": warnings or "none"}))


def outline(value: Any, indent: int = 0) -> list[str]:
    """JSON as lines of an indented list."""
    pad = "  " * indent
    if isinstance(value, dict):
        lines = []
        for name, item in value.items():
            if _is_leaf(item):
                lines.append(f"{pad}{name}: {format_value(item)}")
            else:
                lines += [f"{pad}{name}:", *outline(item, indent + 1)]
        return lines
    if isinstance(value, list) and not _is_leaf(value):
        return [line for item in value for line in outline(item, indent)]
    return [f"{pad}{format_value(value)}"]


def _is_leaf(value: Any) -> bool:
    if isinstance(value, list):
        return all(isinstance(item, int | float) for item in value)
    return not isinstance(value, dict)
