"""The measuring: every method at every region and amount of work, in mixed order, several times."""

import itertools
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._core import CoreError
from ..cli import warnings
from .measures import MeasureError, weights
from .methods import Method
from .reference import Reference, reference_of
from .regions import Region, Window
from .render import Render, render
from .results import Cell, CellKey
from .scenes import Scene
from .suite import Suite, Work


@dataclass(frozen=True)
class Target:
    """What is rendered at once: the window of one region, or the frame with its regions in it."""

    name: str
    window: Window
    regions: tuple[Region, ...]


@dataclass(frozen=True)
class Job:
    repeat: int
    target: Target
    method: Method
    work: Work


@dataclass
class Run:
    """What was measured, as far as it went."""

    cells: dict[CellKey, Cell] = field(default_factory=dict)
    references: dict[tuple[str, str], Reference] = field(default_factory=dict)
    #: Effective settings of each method in each scene, by (scene, method).
    settings: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    interrupted: bool = False


class Runner:
    def __init__(
        self, suite: Suite, out: Path, say: Callable[[str], None], printer: warnings.Printer
    ) -> None:
        self.suite = suite
        self.out = out
        self.say = say
        self.printer = printer
        self.result = Run()

    def run(self, scenes: list[Scene]) -> Run:
        """Measures scene by scene; an interrupt ends it and keeps what is complete. Raises BadReference."""
        try:
            targets = {scene.spec.name: self.prepare(scene) for scene in scenes}
            for scene in scenes:
                self.measure_scene(scene, targets[scene.spec.name])
        except KeyboardInterrupt:
            self.result.interrupted = True
        return self.result

    def prepare(self, scene: Scene) -> list[Target]:
        """Targets with their references, before hours go into what then cannot be compared."""
        targets = []
        for target in targets_of(scene, self.suite.crops):
            try:
                reference = reference_of(scene, self.suite, target.window, self.out / "reference", self.say)
                for region in target.regions:
                    weights(reference.crop(scene.window(region))[0])
            except (CoreError, MeasureError) as error:
                self.fail(f"{scene.spec.name} {target.name}: reference: {error}")
                continue
            targets.append(target)
            self.result.references.update({(scene.spec.name, r.name): reference for r in target.regions})
        return targets

    def measure_scene(self, scene: Scene, targets: list[Target]) -> None:
        if not targets:
            return
        self.warm_up(scene, targets)
        jobs = list(jobs_of(scene, targets, self.suite))
        for number, job in enumerate(jobs, 1):
            place = f"{scene.spec.name} {job.target.name}: {job.method.label}, {job.work.label}"
            self.say(f"[{number}/{len(jobs)}] {place}, repeat {job.repeat + 1} of {self.suite.repeats}")
            try:
                self.measure(scene, job)
            except (CoreError, MeasureError) as error:
                self.fail(f"{place}: {error}")

    def warm_up(self, scene: Scene, targets: list[Target]) -> None:
        """One sample by each method, not measured: the first render of a process fills tables and caches for all."""
        for method in self.suite.methods:
            self.say(f"{scene.spec.name}: warming up {method.label}")
            try:
                rendered = render(scene, {**method.settings, "samples": 1}, targets[0].window)
            except CoreError as error:
                self.fail(f"{scene.spec.name}: {method.label}: {error}")
                continue
            self.result.settings[scene.spec.name, method.label] = rendered.stats["settings"]

    def measure(self, scene: Scene, job: Job) -> None:
        settings = {**job.method.seeded(self.suite.seed + job.repeat), **job.work.settings}
        last = job.work == self.suite.works[-1] and job.repeat == 0
        file = self.image_file(scene, job) if last else None
        rendered = render(scene, settings, job.target.window, file)
        self.printer.print(
            warnings.merge(warnings.of_stats(rendered.stats), warnings.walk_check(rendered.stats))
        )
        for region in job.target.regions:
            self.add(scene, job, region, rendered, settings["seed"])

    def add(self, scene: Scene, job: Job, region: Region, rendered: Render, seed: int) -> None:
        reference = self.result.references[scene.spec.name, region.name]
        window = scene.window(region)
        image = rendered.image[window.slices(job.target.window)]
        key = CellKey(scene.spec.name, region.name, job.method.label, job.work)
        cell = self.result.cells.get(key) or Cell(*reference.crop(window))
        cell.add(image, rendered, job.repeat, seed)
        self.result.cells[key] = cell

    def image_file(self, scene: Scene, job: Job) -> Path:
        number = self.suite.methods.index(job.method)
        return (
            self.out
            / "images"
            / file_name(scene.spec.name, job.target.name, number, job.method.label, ".exr")
        )

    def fail(self, message: str) -> None:
        if message not in self.result.failures:
            self.result.failures.append(message)
            self.say(f"failed: {message}")


def targets_of(scene: Scene, crops: bool) -> Iterator[Target]:
    if not crops:
        yield Target("frame", scene.frame, scene.regions)
        return
    for region in scene.regions:
        yield Target(region.name, scene.window(region), (region,))


def jobs_of(scene: Scene, targets: list[Target], suite: Suite) -> Iterator[Job]:
    """Repeat after repeat; within one in random order, so that a busy machine hits all methods alike."""
    for repeat in range(suite.repeats):
        jobs = [Job(repeat, *rest) for rest in itertools.product(targets, suite.methods, suite.works)]
        random.Random(f"{suite.seed} {scene.spec.name} {repeat}").shuffle(jobs)
        yield from jobs


def file_name(scene: str, region: str, number: int, method: str, ending: str) -> str:
    """`scene.region.number_method`; the number tells labels apart that are the same once made safe."""
    safe = ["".join(c if c.isalnum() or c in "-=" else "_" for c in text) for text in (scene, region, method)]
    return f"{safe[0]}.{safe[1]}.{number}_{safe[2]}{ending}"
