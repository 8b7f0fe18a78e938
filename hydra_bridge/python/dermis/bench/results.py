"""From measurements to the numbers of the report: means over seeds, ratios to the baseline, means over crops."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..color import DisplayTransform
from .measures import (
    BLOCK,
    Array,
    Errors,
    Mask,
    Number,
    bias,
    efficiency_ratio,
    error_map,
    flip,
    geometric_mean,
    measure,
    noise_map,
    number,
    slope,
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
    crop: str
    method: str
    work: Work


class Cell:
    """All repeats of one method at one crop and amount of work. FLIP is of what `transform` shows after `stops`."""

    def __init__(
        self,
        reference: Array,
        variance: Array | None,
        mask: Mask = None,
        transform: DisplayTransform | None = None,
        stops: float = 0.0,
        owner: str = "",
    ) -> None:
        self.reference = reference
        self.variance = variance
        self.mask = mask
        #: The method that the reference is of, where it is scored against one of its own.
        self.owner = owner
        self._transform = transform
        self._stops = stops
        #: Whether neighbouring pixels share paths.
        self.shares = False
        self.errors: list[Errors] = []
        self.renders: list[dict[str, Any]] = []
        #: Of the first repeat.
        self.image: Array = np.zeros_like(reference)
        self._images = np.zeros_like(reference)
        self._maps = np.zeros(reference.shape[:2])

    def add(self, image: Array, rendered: Render, repeat: int, seed: int) -> None:
        errors = measure(image, self.reference, self.variance, self.mask)
        if not self.errors:
            self.image = image
        self.errors.append(errors)
        self.shares |= any(medium["shares"] for medium in rendered.stats.get("guide", {}).get("media", []))
        self._images += image
        self._maps += error_map(image, self.reference, self.mask)
        bias_z = max(self.bias_of(image), key=abs)
        measured = {
            "repeat": repeat,
            "seed": seed,
            "relmse": errors.relmse,
            "relmse_trimmed": errors.relmse_trimmed,
            "mse": errors.mse,
            "flip": self.flip_of(image),
            "bias_z": bias_z,
        }
        # Before the reference's noise is taken off, and that noise.
        measured |= {f"raw_{name}": value for name, value in asdict(errors).items()}
        self.renders.append({**measured, **cost_of(rendered)})

    def bias_of(self, image: Array) -> list[float]:
        return bias(image, self.reference, self.mask, BLOCK if self.shares else 1)

    def flip_of(self, image: Array) -> float | None:
        if self._transform is None:
            return None
        return flip(
            self.shown(image, self._transform), self.shown(self.reference, self._transform), self.mask
        )

    def shown(self, image: Array, transform: DisplayTransform) -> NDArray[np.float32]:
        """Display values in [0, 1]."""
        return transform.apply(image * 2.0**self._stops)

    @property
    def own_map(self) -> Array | None:
        """Relative squared error of the reference itself, per pixel, as one difference of two halves tells it."""
        return None if self.variance is None else noise_map(self.variance, self.reference, self.mask)

    @property
    def mean_image(self) -> Array:
        return self._images / len(self.errors)

    @property
    def error_map(self) -> Array:
        """Relative squared error per pixel, mean over the seeds."""
        return self._maps / len(self.errors)

    def values(self, name: str) -> list[float]:
        """A number of each repeat."""
        return [float(render[name]) for render in self.renders]

    def mean(self, name: str) -> Number:
        return number(self.values(name))

    def known(self, name: str) -> Number | None:
        """The mean of a number that not every run has."""
        return None if any(render[name] is None for render in self.renders) else self.mean(name)


#: Slope of log relMSE over log samples by (scene, crop, method); None where there is none.
CropSlopes = dict[tuple[str, str, str], Number | None]


def cost_of(rendered: Render) -> dict[str, Any]:
    """Numbers of one render that are not errors; seconds, and bytes of `peak`."""
    stats = rendered.stats
    height, width, _ = rendered.image.shape
    samples = stats["samples_per_pixel"] * height * width
    return {
        **{"cpu": rendered.cpu, "wall": rendered.wall, "peak": rendered.peak},
        **{name: stats[name] for name in ("samples_per_pixel", "walks", "walk_steps", "walks_leaked")},
        "non_finite_samples": stats["non_finite_samples"],
        "train": stats["seconds"]["train"],
        "training_share": stats["guide"]["training_share"],
        "samples_per_second": samples / rendered.cpu if rendered.cpu > 0.0 else None,
    }


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    scene: str
    crop: str
    method: str
    work: Work
    seeds: int
    #: Corrected for the reference's noise.
    relmse: Number
    trimmed: Number
    mse: Number
    #: The reference's own part of relMSE, already subtracted.
    noise: float
    #: None where it was not measured.
    flip: Number | None
    cpu: Number
    wall: Number
    samples: Number
    #: Of the render's time.
    training_share: Number
    #: Of all pixels, per CPU second.
    samples_per_second: Number | None
    #: Bytes: largest peak of any repeat, see `Render.peak`.
    peak: int | None
    #: Segments per subsurface walk; None without walks.
    steps: float | None
    #: z per channel.
    bias: list[float]
    #: The method, where its reference is one of its own.
    owner: str = ""
    #: Efficiency over the baseline's, and of trimmed errors; None where the baseline or a positive error lacks.
    ratio: Number | None = None
    ratio_trimmed: Number | None = None

    @property
    def largest_bias(self) -> float:
        return max(self.bias, key=abs)

    @property
    def efficiency(self) -> float | None:
        positive = self.relmse.mean > 0.0 and self.cpu.mean > 0.0
        return 1.0 / (self.relmse.mean * self.cpu.mean) if positive else None


def rows_of(cells: dict[CellKey, Cell], suite: Suite) -> list[Row]:
    """Rows in the order of the suite: scene, crop, work, method."""
    rows = [compared(key, cells, suite.baseline) for key in cells]
    methods = [method.label for method in suite.methods]
    scenes = {scene.name: number for number, scene in enumerate(suite.scenes)}
    crops = {
        (scene.name, crop.name): number for scene in suite.scenes for number, crop in enumerate(scene.crops)
    }

    def order(row: Row) -> tuple[float, ...]:
        place = crops.get((row.scene, row.crop), 0)
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
            ([e.relmse for e in cell.errors], [e.relmse for e in base.errors]),
            ([e.relmse_trimmed for e in cell.errors], [e.relmse_trimmed for e in base.errors]),
        )
    )
    return replace(row, ratio=plain, ratio_trimmed=trimmed)


def row_of(key: CellKey, cell: Cell) -> Row:
    walks = sum(render["walks"] for render in cell.renders)
    return Row(
        *key,
        seeds=len(cell.errors),
        relmse=number([errors.relmse for errors in cell.errors]),
        trimmed=number([errors.relmse_trimmed for errors in cell.errors]),
        mse=number([errors.mse for errors in cell.errors]),
        noise=float(np.mean([errors.noise for errors in cell.errors])),
        flip=cell.known("flip"),
        cpu=cell.mean("cpu"),
        wall=cell.mean("wall"),
        samples=cell.mean("samples_per_pixel"),
        training_share=cell.mean("training_share"),
        samples_per_second=cell.known("samples_per_second"),
        peak=max((r["peak"] for r in cell.renders if r["peak"]), default=None),
        steps=sum(render["walk_steps"] for render in cell.renders) / walks if walks else None,
        bias=cell.bias_of(cell.mean_image),
        owner=cell.owner,
    )


@dataclass(frozen=True)
class Mean:
    """Geometric means of a method's ratios over crops."""

    #: Empty: over all scenes.
    scene: str
    method: str
    work: Work
    ratio: Number | None
    ratio_trimmed: Number | None
    #: Crops that have a ratio, and all.
    crops: int
    of: int


def slopes_of(cells: dict[CellKey, Cell], suite: Suite) -> CropSlopes:
    """From seeds that have every amount of work."""
    found: CropSlopes = {}
    for scene, crop, method in dict.fromkeys(key[:3] for key in cells):
        line = [cells.get(CellKey(scene, crop, method, work)) for work in suite.works]
        by_seed: dict[int, list[dict[str, Any]]] = {}
        for cell in line:
            for render in cell.renders if cell else ():
                by_seed.setdefault(render["repeat"], []).append(render)
        whole = [renders for renders in by_seed.values() if len(renders) == len(suite.works)]
        found[scene, crop, method] = slope(
            [[render["samples_per_pixel"] for render in renders] for renders in whole],
            [[render["relmse"] for render in renders] for renders in whole],
        )
    return found


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
    """What a reference brings into the errors of one crop."""

    scene: str
    crop: str
    #: Its own relMSE.
    noise: float
    #: Of the smallest error that was measured there.
    share: float


def reference_noise(rows: list[Row]) -> list[ReferenceNoise]:
    """Per crop, in the order of the rows."""
    found = []
    for scene, crop, owner in dict.fromkeys((row.scene, row.crop, row.owner) for row in rows):
        here = [row for row in rows if (row.scene, row.crop, row.owner) == (scene, crop, owner)]
        place = (scene, f"{crop} of {owner}" if owner else crop)
        smallest = min(row.relmse.mean + row.noise for row in here)
        noise = here[0].noise
        found.append(ReferenceNoise(*place, noise, noise / smallest if smallest > 0.0 else 0.0))
    return found


def warnings_of(noises: list[ReferenceNoise]) -> list[str]:
    """What is to be said about references that are too noisy."""
    large = [f"{n.scene}/{n.crop} {n.share:.0%}" for n in noises if n.share > NOISE_SHARE]
    loose = [f"{n.scene}/{n.crop} {n.noise:.2g}" for n in noises if n.noise > NOISE_LIMIT]
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
