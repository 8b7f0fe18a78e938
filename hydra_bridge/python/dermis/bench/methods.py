"""A method under test: a subsurface walk with settings, `[LABEL=]WALK[:NAME=VALUE...]`."""

import argparse
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..cli.arguments import walk_name
from ..cli.settings import Settings, SettingsError, parse_assignment

#: Settings that say what is rendered or how much of it: alike for all methods, so none may set them.
SHARED = (
    "camera",
    "resolution",
    "pixelAspectRatio",
    "aspectRatioConformPolicy",
    "dataWindowNDC",
    "samples",
    "sampleOffset",
    "timeLimit",
    "noiseThreshold",
    "aovs",
)

#: Seeds are 32 bits in the core.
SEEDS = 1 << 32


class MethodError(Exception):
    """A method that cannot be; the text quotes it."""


@dataclass(frozen=True)
class Method:
    label: str
    #: Render settings by name, `walk` among them.
    settings: Mapping[str, Any]
    #: Another renderer, of `peers.client.KINDS`; empty: dermis.
    peer: str = ""

    def seeded(self, first: int) -> Settings:
        """The settings, with `first` added to the method's own seed, which is 0 where it has none."""
        return {**self.settings, "seed": (self.settings.get("seed", 0) + first) % SEEDS}


def parse_method(text: str, defaults: Mapping[str, Any]) -> Method:
    """`mixture`, `mixture:controlVariates=false:normals=4`, `half=poe:classicalFraction=0.5`. Raises MethodError."""
    head, *assignments = text.split(":")
    label, named, walk = head.rpartition("=")
    if named and not label:
        raise MethodError(f"method {text!r}: the label before '=' is empty")
    settings: Settings = {}
    try:
        settings["walk"] = walk_name(walk)
        for assignment in assignments:
            name, value = parse_assignment(assignment, defaults)
            refuse_shared(name)
            if name in settings:
                raise SettingsError(f"{name} is set twice")
            settings[name] = value
    except (argparse.ArgumentTypeError, SettingsError) as error:
        raise MethodError(f"method {text!r}: {str(error).removeprefix('--set ')}") from error
    return Method(label or text, settings)


def parse_methods(texts: Iterable[str], defaults: Mapping[str, Any]) -> list[Method]:
    """All of `texts`, which must differ in their labels. Raises MethodError."""
    methods = [parse_method(text.strip(), defaults) for text in texts]
    labels = [method.label for method in methods]
    for label in labels:
        if labels.count(label) > 1:
            raise MethodError(f"method {label!r} is there twice; label one: other={label}")
    return methods


def peer_methods(names: Iterable[str]) -> list[Method]:
    """Other renderers, labelled by their names. Raises MethodError."""
    from ..peers.client import KINDS

    for name in names:
        if name not in KINDS:
            raise MethodError(f"there is no peer {name!r}; there are {', '.join(KINDS)}")
    return [Method(name, {}, name) for name in dict.fromkeys(names)]


def check(method: Method) -> None:
    """Asks the core whether it takes the settings: values that parse may still be out of range. Raises MethodError."""
    from dermis._core import CoreError, Delegate

    try:
        Delegate().set_settings(json.dumps(method.settings, allow_nan=False))
    except (CoreError, ValueError) as error:
        raise MethodError(f"method {method.label!r}: {error}") from error


def refuse_shared(name: str) -> None:
    if name in SHARED:
        raise SettingsError(f"{name} is alike for all methods; a method cannot set it")
