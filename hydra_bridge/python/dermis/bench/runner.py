"""The measuring: every method at every crop and amount of work, in mixed order, several times."""

import itertools
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .._core import CoreError
from ..cli import warnings
from ..color import DisplayTransform
from ..peers.appearance import ExportError
from ..peers.environments import PeerError
from .crops import Crop, Window
from .measures import MeasureError, weights
from .methods import Method
from .peers import Peers
from .reference import Reference, reference_of
from .render import Render, Watch, render
from .results import Cell, CellKey
from .scenes import Scene
from .steps import Steps
from .store import Store
from .suite import Suite, Work


@dataclass(frozen=True)
class Target:
    """What is rendered at once: the window of one crop, or the frame with its crops in it."""

    name: str
    window: Window
    crops: tuple[Crop, ...]


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
    #: Those of other renderers, by (scene, crop, method).
    peer_references: dict[tuple[str, str, str], Reference] = field(default_factory=dict)
    #: Effective settings of each method in each scene, by (scene, method).
    settings: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    #: What other renderers do differently, and which of them were not to be had.
    peer_notes: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    interrupted: bool = False
    #: Renders, and those of them that an earlier run had left.
    renders: int = 0
    kept: int = 0


class Runner:
    """Measures `suite`; FLIP compares what `transform` shows, without it there is none."""

    def __init__(
        self,
        suite: Suite,
        out: Path,
        quiet: bool,
        printer: warnings.Printer,
        transform: DisplayTransform | None,
    ) -> None:
        self.suite = suite
        self.out = out
        self.quiet = quiet
        self.printer = printer
        self.transform = transform
        self.store = Store(out / "runs")
        self.result = Run()

    def run(self, scenes: list[Scene]) -> Run:
        """Measures scene by scene; an interrupt ends it and keeps what is complete. Raises BadReference."""
        try:
            with Peers(self.suite, self.out) as self.peers:
                self.result.absent, self.result.peer_notes = self.peers.absent, self.peers.notes
                self.measure_all(scenes)
        except KeyboardInterrupt:
            self.result.interrupted = True
        return self.result

    def measure_all(self, scenes: list[Scene]) -> None:
        total = sum(steps_of(scene, self.suite, self.peers) for scene in scenes)
        with Steps(total, self.quiet) as self.steps:
            targets = {scene.spec.name: self.prepare(scene) for scene in scenes}
            for scene in scenes:
                self.measure_scene(scene, targets[scene.spec.name])

    def prepare(self, scene: Scene) -> list[Target]:
        """Targets with their references, before hours go into what then cannot be compared."""
        targets = []
        for target in targets_of(scene, self.suite.whole_frames):

            def watch(half: int, kept: bool, place: str = f"{scene.spec.name} {target.name}") -> Watch:
                return self.steps.next(f"{place}: reference, half {half + 1} of 2", kept)

            try:
                reference = reference_of(scene, self.suite, target.window, self.out / "reference", watch)
                for crop in target.crops:
                    image, _, mask = reference.crop(scene.window(crop))
                    weights(image, mask)
            except (CoreError, MeasureError) as error:
                self.fail(f"{scene.spec.name} {target.name}: reference: {error}")
                continue
            targets.append(target)
            self.result.references.update({(scene.spec.name, r.name): reference for r in target.crops})
            for method in self.suite.methods:
                if method.peer and self.peers.has(method):
                    self.prepare_peer(scene, target, method, reference)
        return targets

    def prepare_peer(self, scene: Scene, target: Target, method: Method, reference: Reference) -> None:
        """The reference that another renderer is scored against; without one it is left out there."""
        place = f"{scene.spec.name} {target.name}: {method.label}"

        def watch(half: int, kept: bool) -> Watch:
            return self.steps.next(f"{place}: reference, half {half + 1} of 2", kept)

        try:
            own = self.peers.reference(scene, method, target.name, target.window, reference, watch)
            for crop in target.crops:
                image, _, mask = own.crop(scene.window(crop))
                weights(image, mask)
                self.result.peer_references[scene.spec.name, crop.name, method.label] = own
        except (PeerError, MeasureError) as error:
            self.fail(f"{place}: {error}")
        except ExportError as error:
            self.result.absent.append(f"{place}: {error}; it is left out there")

    def measure_scene(self, scene: Scene, targets: list[Target]) -> None:
        warm: set[str] = set()
        for job in jobs_of(scene, targets, self.suite):
            if job.method.peer and not self.comparable(scene, job):
                continue
            place = f"{scene.spec.name} {job.target.name}: {job.method.label}, {job.work.label}"
            try:
                self.measure(scene, job, place, warm)
            except (CoreError, MeasureError, PeerError) as error:
                self.fail(f"{place}: {error}")

    def comparable(self, scene: Scene, job: Job) -> bool:
        found = self.result.peer_references
        return all((scene.spec.name, crop.name, job.method.label) in found for crop in job.target.crops)

    def measure(self, scene: Scene, job: Job, place: str, warm: set[str]) -> None:
        """Of `warm` methods the first render is behind; the others get one."""
        settings = self.settings_of(job)
        file = self.store.file(scene, job.target.name, job.method.label, settings, job.target.window)
        rendered = self.store.load(file)
        self.result.kept += rendered is not None
        watch = self.steps.next(f"{place}, seed {job.repeat + 1} of {self.suite.seeds}", rendered is not None)
        if rendered is None:
            if job.method.label not in warm and not job.method.peer:
                self.warm_up(scene, job)
                warm.add(job.method.label)
            rendered = self.rendered(scene, job, settings, watch)
            self.store.keep(file, rendered)
        self.result.renders += 1
        self.result.settings[scene.spec.name, job.method.label] = rendered.stats["settings"]
        self.printer.print(
            warnings.merge(warnings.of_stats(rendered.stats), warnings.walk_check(rendered.stats))
        )
        for crop in job.target.crops:
            self.add(scene, job, crop, rendered, settings["seed"])

    def settings_of(self, job: Job) -> dict[str, Any]:
        seed = self.suite.seed + job.repeat
        if job.method.peer:
            return self.peers.settings(job.method, job.work, seed)
        return {**job.method.seeded(seed), **job.work.settings}

    def rendered(self, scene: Scene, job: Job, settings: dict[str, Any], watch: Watch) -> Render:
        if job.method.peer:  # warms itself up
            return self.peers.render(scene, job.method, job.work, settings["seed"], job.target.window)
        return render(scene, settings, job.target.window, watch=watch)

    def warm_up(self, scene: Scene, job: Job) -> None:
        """One sample by the method, not measured: the first render of a process fills tables and caches for all."""
        render(scene, {**job.method.settings, "samples": 1}, job.target.window)

    def add(self, scene: Scene, job: Job, crop: Crop, rendered: Render, seed: int) -> None:
        known, peer = self.result.references[scene.spec.name, crop.name], job.method.label
        reference = self.result.peer_references.get((scene.spec.name, crop.name, peer), known)
        window = scene.window(crop)
        image = rendered.image[window.slices(job.target.window)]
        key = CellKey(scene.spec.name, crop.name, job.method.label, job.work)
        cell = self.result.cells.get(key) or Cell(
            *reference.crop(window), self.transform, scene.spec.exposure, "" if reference is known else peer
        )
        cell.add(image, rendered, job.repeat, seed)
        self.result.cells[key] = cell

    def fail(self, message: str) -> None:
        if message not in self.result.failures:
            self.result.failures.append(message)


def targets_of(scene: Scene, whole_frames: bool) -> Iterator[Target]:
    if whole_frames:
        yield Target("frame", scene.frame, scene.crops)
        return
    for crop in scene.crops:
        yield Target(crop.name, scene.window(crop), (crop,))


def steps_of(scene: Scene, suite: Suite, peers: Peers) -> int:
    """Renders that the scene takes, halves of references included."""
    halves = (0 if scene.spec.reference else 2) + 2 * len(peers)
    methods = sum(peers.has(method) for method in suite.methods)
    each = halves + methods * len(suite.works) * suite.seeds
    return each * len(list(targets_of(scene, suite.whole_frames)))


def jobs_of(scene: Scene, targets: list[Target], suite: Suite) -> Iterator[Job]:
    """Repeat after repeat; within one in random order, so that a busy machine hits all methods alike."""
    for repeat in range(suite.seeds):
        jobs = [Job(repeat, *rest) for rest in itertools.product(targets, suite.methods, suite.works)]
        random.Random(f"{suite.seed} {scene.spec.name} {repeat}").shuffle(jobs)
        yield from jobs
