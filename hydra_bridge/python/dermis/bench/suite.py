"""What is to be compared: methods, work, scenes and their crops. `flags` and `spec` make suites."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .crops import Crop
from .methods import Method

#: More samples than any time limit lets pass.
ENDLESS = 1 << 31

#: Seed of the first repeat: not `record`'s default, with which a reference may have been made.
FIRST_SEED = 1


class SuiteError(Exception):
    """A comparison that cannot be made as described; the text says which entry, and what it takes."""


@dataclass(frozen=True)
class Work:
    """How much is rendered: samples per pixel, or seconds of time limit (`budget`)."""

    kind: str
    amount: float

    @property
    def label(self) -> str:
        return f"{self.amount:g} {'spp' if self.kind == 'samples' else 's'}"

    @property
    def settings(self) -> dict[str, Any]:
        if self.kind == "samples":
            return {"samples": int(self.amount), "timeLimit": 0.0}
        return {"samples": ENDLESS, "timeLimit": self.amount}


@dataclass(frozen=True)
class SceneSpec:
    """A stage, what is changed in it, and where it is looked at."""

    name: str
    stage: Path
    crops: tuple[Crop, ...] = ()
    #: Render settings by name, for all methods.
    settings: Mapping[str, Any] = field(default_factory=dict)
    #: Property path -> value, authored in the session layer.
    overrides: Mapping[str, Any] = field(default_factory=dict)
    #: Prim path -> {variant set: variant}.
    variants: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    #: One EXR, or two independent halves; empty: made by the command.
    reference: tuple[Path, ...] = ()
    #: Stops, of pictures only.
    exposure: float = 0.0


@dataclass(frozen=True)
class Suite:
    methods: tuple[Method, ...]
    baseline: str
    works: tuple[Work, ...]
    scenes: tuple[SceneSpec, ...]
    #: None where no reference has to be made.
    reference_method: Method | None
    seeds: int = 3
    #: Of the first repeat.
    seed: int = FIRST_SEED
    #: Crops are cut from whole frames; else each is rendered for itself, with all work in it.
    whole_frames: bool = False
    #: Errors are measured only where the reference has subsurface light.
    subsurface_only: bool = False
    #: Samples per pixel of both halves together.
    reference_samples: int = 0
    #: Why the reference method is the one it is, where that is not the default.
    reference_note: str = ""

    def check(self) -> None:
        """What no single entry shows. Raises SuiteError."""
        labels = [method.label for method in self.methods]
        if self.baseline not in labels:
            raise SuiteError(f"--baseline {self.baseline}: the methods are {', '.join(labels)}")
        for scene in self.scenes:
            distinct([crop.name for crop in scene.crops], f"{scene.name}: crop")
            if not scene.reference and self.reference_samples < 2:
                raise SuiteError("a reference is made in two halves: --referenceSamples 2 or more")
        distinct([scene.name for scene in self.scenes], "scene")


def distinct(names: list[str], kind: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise SuiteError(f"{kind} {name!r} is there twice")


def make_works(kind: str, amounts: list[Any]) -> tuple[Work, ...]:
    """Works in ascending order. Raises SuiteError."""
    for amount in amounts:
        if kind == "samples":
            whole(amount, "samples", 1)
        elif isinstance(amount, bool) or not isinstance(amount, int | float) or not 0.0 < amount < 1e9:
            raise SuiteError(f"budget: expected seconds above 0, got {amount!r}")
    return tuple(Work(kind, amount) for amount in sorted(set(amounts)))


def whole(value: Any, name: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value < ENDLESS:
        raise SuiteError(f"{name}: expected a whole number of at least {least}, got {value!r}")
    return value
