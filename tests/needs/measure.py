"""Stages against each other: what a capability adds to the one without it."""

import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import driver
from .capabilities import Capability, Compared
from .stages import Stage


@dataclass(frozen=True)
class Counts:
    """What one stage takes."""

    sample: float | None
    """Instructions per sample of a pixel; None: not counted."""
    once: float | None
    """Instructions of a render beside its samples: training, film."""
    compile: int | None
    """Instructions of validation and compilation."""
    scene_bytes: int
    render_bytes: int
    image: int


@dataclass
class Bench:
    """Measures stages, each distinct one counted once."""

    counting: bool
    repeats: int = 5
    """Timed runs of either stage, in turn; the fastest counts, since other work on the machine only adds."""
    counts: dict[Stage, Counts] = field(default_factory=dict)

    def row(self, capability: Capability) -> dict[str, Any]:
        forms = {"unused": capability.unused, "used": capability.used}
        return {
            "capability": capability.name,
            **{name: self.compare(compared) for name, compared in forms.items()},
        }

    def compare(self, compared: Compared) -> dict[str, Any]:
        with tempfile.TemporaryDirectory(prefix="dermis-needs-") as folder:
            # Folders whose names are equally long: the stage's path is among what is counted.
            files = []
            for name, stage in (("a", compared.without), ("b", compared.having)):
                of_stage = Path(folder) / name
                of_stage.mkdir()
                files.append(driver.flatten(stage, of_stage))
            without, having = (
                self.count(stage, file)
                for stage, file in zip((compared.without, compared.having), files, strict=True)
            )
            seconds = self.seconds(files)
        return {
            "what": compared.what,
            "against": compared.against,
            "instructions": ratio(having.sample, without.sample),
            "sample_instructions": having.sample,
            "once_instructions": difference(having.once, without.once),
            "compile_instructions": difference(having.compile, without.compile),
            "time": ratio(*reversed(seconds)) if seconds else None,
            "scene_bytes": having.scene_bytes - without.scene_bytes,
            "render_bytes": having.render_bytes - without.render_bytes,
            "same_image": having.image == without.image,
        }

    def count(self, stage: Stage, file: Path) -> Counts:
        if stage not in self.counts:
            self.counts[stage] = counts_of(file, self.counting)
        return self.counts[stage]

    def seconds(self, files: list[Path]) -> list[float]:
        """CPU seconds per sample and pixel of each; empty without `repeats`."""
        runs: list[list[driver.Run]] = [[] for _ in files]
        for _ in range(self.repeats):
            for file, of_file in zip(files, runs, strict=True):
                of_file.append(driver.run(file, driver.TIMED))
        return [
            per_sample([min(r.seconds[i] for r in of_file) for i in (2, 3)], driver.TIMED)
            for of_file in runs
            if of_file
        ]


def counts_of(file: Path, counting: bool) -> Counts:
    run = driver.run(file, driver.COUNTED)
    memory = (run.kept[0] + run.kept[1], run.peak[2], run.images[1])
    if not counting:
        return Counts(None, None, None, *memory)
    try:
        _, compiled, short, long = driver.count(file, driver.COUNTED)
    except driver.DriverError as error:
        # A valgrind that does not know the processor's instructions, say: the rest can still be measured.
        print(f"not counted: {error}", file=sys.stderr, flush=True)
        return Counts(None, None, None, *memory)
    sample = per_sample([short, long], driver.COUNTED)
    once = short - sample * driver.COUNTED[0] * driver.SIZE**2
    return Counts(sample, once, compiled, *memory)


def per_sample(renders: list[float], samples: tuple[int, int]) -> float:
    """Of the difference of two renders: what is done once cancels."""
    return (renders[1] - renders[0]) / ((samples[1] - samples[0]) * driver.SIZE**2)


def ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a / b


def difference(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b
