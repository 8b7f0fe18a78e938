"""From measurements to the numbers of the report: means over repeats, ratios to the baseline, means over regions."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .measures import (
    Array,
    Errors,
    Number,
    bias,
    efficiency_ratio,
    error_map,
    geometric_mean,
    measure,
    number,
)
from .render import Render
from .suite import Suite, Work

#: Share of the smallest error above which the reference's own noise is warned about.
NOISE_SHARE = 0.1

#: Own relMSE of a reference (its pixels are off by 22 %) above which errors relative to it are doubtful: R^2 in the
#: denominator is noise as well, and holds an estimate of that noise below 1.
NOISE_LIMIT = 0.05


class CellKey(NamedTuple):
    scene: str
    region: str
    method: str
    work: Work


class Cell:
    """All repeats of one method at one region and amount of work."""

    def __init__(self, reference: Array, variance: Array | None) -> None:
        self.reference = reference
        self.variance = variance
        self.errors: list[Errors] = []
        self.renders: list[dict[str, Any]] = []
        #: Of the first repeat.
        self.image: Array = np.zeros_like(reference)
        self._images = np.zeros_like(reference)
        self._maps = np.zeros(reference.shape[:2])

    def add(self, image: Array, rendered: Render, repeat: int, seed: int) -> None:
        errors = measure(image, self.reference, self.variance)
        if not self.errors:
            self.image = image
        self.errors.append(errors)
        self._images += image
        self._maps += error_map(image, self.reference)
        stats = rendered.stats
        self.renders.append(
            {
                **{
                    "repeat": repeat,
                    "seed": seed,
                    **asdict(errors),
                    "cpu": rendered.cpu,
                    "wall": rendered.wall,
                },
                **{
                    name: stats[name] for name in ("samples_per_pixel", "walks", "walk_steps", "walks_leaked")
                },
                **{"non_finite_samples": stats["non_finite_samples"], "train": stats["seconds"]["train"]},
            }
        )

    @property
    def mean_image(self) -> Array:
        return self._images / len(self.errors)

    @property
    def error_map(self) -> Array:
        """Relative squared error per pixel, mean over the repeats."""
        return self._maps / len(self.errors)

    def values(self, name: str) -> list[float]:
        """A number of each repeat."""
        return [float(render[name]) for render in self.renders]

    def mean(self, name: str) -> Number:
        return number(self.values(name))


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    scene: str
    region: str
    method: str
    work: Work
    repeats: int
    #: Corrected for the reference's noise.
    relmse: Number
    trimmed: Number
    #: The reference's own share, already subtracted.
    noise: float
    cpu: Number
    wall: Number
    samples: Number
    train: Number
    #: Segments per subsurface walk; None without walks.
    steps: float | None
    #: z per channel.
    bias: list[float]
    #: Efficiency over the baseline's, and of trimmed errors; None where the baseline or a positive error lacks.
    ratio: Number | None = None
    ratio_trimmed: Number | None = None

    @property
    def largest_bias(self) -> float:
        return max(self.bias, key=abs)


def rows_of(cells: dict[CellKey, Cell], suite: Suite) -> list[Row]:
    """Rows in the order of the suite: scene, region, work, method."""
    rows = [compared(key, cells, suite.baseline) for key in cells]
    methods = [method.label for method in suite.methods]
    scenes = {scene.name: number for number, scene in enumerate(suite.scenes)}
    regions = {
        (scene.name, region.name): number
        for scene in suite.scenes
        for number, region in enumerate(scene.regions)
    }

    def order(row: Row) -> tuple[float, ...]:
        place = regions.get((row.scene, row.region), 0)
        return scenes[row.scene], place, row.work.amount, methods.index(row.method)

    return sorted(rows, key=order)


def compared(key: CellKey, cells: dict[CellKey, Cell], baseline: str) -> Row:
    row, cell = row_of(key, cells[key]), cells[key]
    base = cells.get(key._replace(method=baseline))
    if base is None:
        return row
    if base is cell:
        return replace(row, ratio=Number(1.0, None), ratio_trimmed=Number(1.0, None))
    times = cell.values("cpu"), base.values("cpu")
    plain, trimmed = (
        efficiency_ratio(mine, times[0], theirs, times[1])
        for mine, theirs in (
            ([e.corrected for e in cell.errors], [e.corrected for e in base.errors]),
            ([e.corrected_trimmed for e in cell.errors], [e.corrected_trimmed for e in base.errors]),
        )
    )
    return replace(row, ratio=plain, ratio_trimmed=trimmed)


def row_of(key: CellKey, cell: Cell) -> Row:
    walks = sum(render["walks"] for render in cell.renders)
    return Row(
        *key,
        repeats=len(cell.errors),
        relmse=number([errors.corrected for errors in cell.errors]),
        trimmed=number([errors.corrected_trimmed for errors in cell.errors]),
        noise=float(np.mean([errors.noise for errors in cell.errors])),
        cpu=cell.mean("cpu"),
        wall=cell.mean("wall"),
        samples=cell.mean("samples_per_pixel"),
        train=cell.mean("train"),
        steps=sum(render["walk_steps"] for render in cell.renders) / walks if walks else None,
        bias=bias(cell.mean_image, cell.reference),
    )


@dataclass(frozen=True)
class Mean:
    """Geometric means of a method's ratios over regions."""

    #: Empty: over all scenes.
    scene: str
    method: str
    work: Work
    ratio: Number | None
    ratio_trimmed: Number | None
    #: Regions that have a ratio, and all.
    regions: int
    of: int


def means_of(rows: list[Row], suite: Suite) -> list[Mean]:
    """Per scene, where there are several, and over all."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    means = []
    for scene in [*(scenes if len(scenes) > 1 else []), ""]:
        for work in suite.works:
            for method in suite.methods:
                chosen = [
                    row
                    for row in rows
                    if (row.work, row.method) == (work, method.label) and scene in ("", row.scene)
                ]
                if chosen:
                    means.append(mean_of(scene, method.label, work, chosen))
    return means


def mean_of(scene: str, method: str, work: Work, rows: list[Row]) -> Mean:
    def over(ratios: Iterable[Number | None]) -> Number | None:
        return geometric_mean([ratio for ratio in ratios if ratio is not None])

    ratios = [row.ratio for row in rows]
    return Mean(
        scene,
        method,
        work,
        over(ratios),
        over(row.ratio_trimmed for row in rows),
        sum(ratio is not None for ratio in ratios),
        len(rows),
    )


@dataclass(frozen=True)
class ReferenceNoise:
    """What a reference brings into the errors of one region."""

    scene: str
    region: str
    #: Its own relMSE.
    noise: float
    #: Of the smallest error that was measured there.
    share: float


def reference_noise(rows: list[Row]) -> list[ReferenceNoise]:
    """Per region, in the order of the rows."""
    found = []
    for place in dict.fromkeys((row.scene, row.region) for row in rows):
        here = [row for row in rows if (row.scene, row.region) == place]
        smallest = min(row.relmse.mean + row.noise for row in here)
        noise = here[0].noise
        found.append(ReferenceNoise(*place, noise, noise / smallest if smallest > 0.0 else 0.0))
    return found


def warnings_of(noises: list[ReferenceNoise]) -> list[str]:
    """What is to be said about references that are too noisy."""
    large = [f"{n.scene}/{n.region} {n.share:.0%}" for n in noises if n.share > NOISE_SHARE]
    loose = [f"{n.scene}/{n.region} {n.noise:.2g}" for n in noises if n.noise > NOISE_LIMIT]
    messages = []
    if large:
        share = f"more than {NOISE_SHARE:.0%} of the smallest error measured"
        messages.append(f"the reference's own relMSE is {share}; give it more samples: {', '.join(large)}")
    if loose:
        what = "so that what is relative to it, its own noise too, says little"
        messages.append(f"the reference's own relMSE is above {NOISE_LIMIT:g}, {what}: {', '.join(loose)}")
    return messages


def same_images(cells: dict[CellKey, Cell], suite: Suite) -> list[str]:
    """Says which methods render an earlier one's images, bit for bit: their comparison is of nothing but the clock."""
    messages = []
    for place, method in enumerate(suite.methods):
        mine = [(key, cell.image) for key, cell in cells.items() if key.method == method.label]
        for other in suite.methods[:place]:
            theirs = [cells.get(key._replace(method=other.label)) for key, _ in mine]
            pairs = zip(mine, theirs, strict=True)
            if mine and all(
                cell is not None and np.array_equal(image, cell.image) for (_, image), cell in pairs
            ):
                what = "what its settings ask for has no effect in this renderer, on these stages"
                messages.append(f"{method.label} renders the images of {other.label}, bit for bit: {what}")
                break
    return messages
