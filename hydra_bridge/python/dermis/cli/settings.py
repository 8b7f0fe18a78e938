"""Render settings from three places: typed flags win over the RenderSettings prim, which wins over defaults."""

import argparse
import json
from collections.abc import Mapping
from typing import Any

#: Flags that are render settings, by the name of the argument.
FLAG_SETTINGS = {
    "samples": "samples",
    "timeLimit": "timeLimit",
    "noiseThreshold": "noiseThreshold",
    "seed": "seed",
    "sampleOffset": "sampleOffset",
    "threads": "threads",
    "crop": "dataWindowNDC",
    "maxDepth": "maxDepth",
    "textureMemory": "textureMemory",
    "walk": "walk",
    "walkPdf": "walkPdf",
    "classicalFraction": "classicalFraction",
    "aovs": "aovs",
}

#: usdrecord's words for `refineLevel`, in UsdImaging's order: 0 to 3.
COMPLEXITIES = ("low", "medium", "high", "veryhigh")

#: Settings with a rule of their own: `--camera`, `--imageWidth`, `--imageHeight`.
VIEW_SETTINGS = ("camera", "resolution")

Settings = dict[str, Any]


class SettingsError(Exception):
    """A setting that does not exist, or a value that it cannot take."""


def default_settings() -> Settings:
    """Every setting of the core with its default."""
    from dermis._core import Delegate

    return json.loads(Delegate().settings())


def listing(settings: Mapping[str, Any]) -> str:
    """One `NAME=VALUE` line per setting, as `--set` takes them."""
    return "\n".join(f"{name}={format_value(value)}" for name, value in sorted(settings.items()))


def format_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        # Settings are f32 in the core; its 0.01 arrives as 0.009999999776482582.
        return f"{value:.7g}"
    if isinstance(value, list | tuple):
        return ",".join(format_value(item) for item in value)
    return str(value)


def typed_settings(args: argparse.Namespace, defaults: Mapping[str, Any]) -> Settings:
    """What was typed: the flags that are settings, and `--set`. Raises SettingsError."""
    typed = {
        setting: getattr(args, flag)
        for flag, setting in FLAG_SETTINGS.items()
        if getattr(args, flag, None) is not None
    }
    if getattr(args, "complexity", None):
        typed["refineLevel"] = COMPLEXITIES.index(args.complexity)
    for assignment in getattr(args, "assignments", None) or []:
        name, value = parse_assignment(assignment, defaults)
        if typed.get(name, value) != value:
            raise SettingsError(f"--set {assignment} contradicts {name}={format_value(typed[name])}")
        typed[name] = value
    return typed


def parse_assignment(assignment: str, defaults: Mapping[str, Any]) -> tuple[str, Any]:
    """`NAME=VALUE` with the value as the type of the setting's default. Raises SettingsError."""
    name, _, text = assignment.partition("=")
    if name not in defaults:
        import difflib

        close = difflib.get_close_matches(name, defaults, n=1)
        hint = f"; did you mean {close[0]}?" if close else "; --set alone lists the settings"
        raise SettingsError(f"--set {assignment}: there is no setting {name!r}{hint}")
    try:
        return name, parse_value(text, defaults[name])
    except ValueError as error:
        raise SettingsError(f"--set {assignment}: {error}") from error


def parse_value(text: str, default: Any) -> Any:
    """`text` as the type of `default`; lists are separated by commas. Raises ValueError."""
    if isinstance(default, bool):
        return parse_bool(text)
    if isinstance(default, int):
        return whole_number(text)
    if isinstance(default, float):
        return number(text)
    if not isinstance(default, list):
        return text
    items = [item.strip() for item in text.split(",")] if text.strip() else []
    # Numbers have their places (resolution, window); names are as many as one likes.
    if default and not isinstance(default[0], str) and len(items) != len(default):
        raise ValueError(f"{len(default)} values were expected, separated by commas")
    return [parse_value(item, default[0] if default else "") for item in items]


def parse_bool(text: str) -> bool:
    truth = {"true": True, "1": True, "on": True, "false": False, "0": False, "off": False}.get(text.lower())
    if truth is None:
        raise ValueError(f"{text!r} is neither true nor false")
    return truth


def whole_number(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is no whole number") from None
    if not 0 <= value <= 0xFFFF_FFFF:  # u32 in the core
        raise ValueError(f"{text} is out of range")
    return value


def number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number") from None
    if not abs(value) <= 3.4e38:  # f32 in the core; also catches NaN
        raise ValueError(f"{text} is not finite")
    return value


def overrides(typed: Mapping[str, Any], authored: Mapping[str, Any], prim: str) -> list[str]:
    """A line of log for each setting of the stage that a flag overrides."""
    return [
        f"Flag overrides {name} of {prim}: {format_value(value)} instead of {format_value(authored[name])}"
        for name, value in typed.items()
        if name in authored and authored[name] != value
    ]
