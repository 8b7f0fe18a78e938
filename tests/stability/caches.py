"""What guided walks know: nothing, too little, or of a light that is no longer there."""

import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .closed_forms import slab
from .media import SLAB, body, plate
from .rendering import Picture, counts, difference, load, mean_and_error, render, run, walk_of
from .row import Case, Row
from .scenes import ABOVE, Prim, box, camera, light, medium, move, placed, sphere, sun

FAMILY = "caches"
GUIDED = ("poe", "cp", "bono", "bill", "mixture")
POOR = "256 records, one sample"


def largest(picture: Picture, stressed: str, source: str) -> Row:
    """Nothing is expected, of any pixel."""
    peak = float(np.abs(picture.color).max())
    lit, regions = picture.stats["guide"]["lit_regions"], picture.stats["guide"]["regions"]
    note = ", ".join(word for word in (f"{lit} of {regions} regions lit", counts(picture)) if word)
    return Row(
        FAMILY,
        stressed,
        source,
        0.0,
        peak,
        non_finite=picture.non_finite,
        note=note,
        walk=walk_of(picture),
        seconds=picture.seconds,
    )


def unlit() -> Iterator[Case]:
    """No region learns anything: no light at all, one that does not reach it, one that goes out."""
    skin = medium(0.95, 0.1)
    eye = camera((0, 0, 8), 20.0)
    wall = {"/W": {**box((-50, -50, 2.9), (50, 50, 3.0)), "material": ""}}
    # Behind the wall, the camera within the gap.
    scenes: dict[str, dict[str, Prim]] = {
        "no light": body(sphere(), skin, eye, []),
        "a light of intensity 0": body(sphere(), skin, eye, [sun(0.0, 0.0)]),
        "a light that faces away": body(
            sphere(), skin, eye, [light("disk", move(0, 0, -3), 1.0, radius=1.0)]
        ),
        "a sun behind a wall": body(sphere(), skin, camera((0, 0, 2.8), 20.0), [sun(0.0)]) | wall,
    }
    for name, prims in scenes.items():
        for walk in ("auto", *GUIDED):

            def rows_(name: str = name, prims: dict[str, Prim] = prims, walk: str = walk) -> Iterator[Row]:
                picture = render(prims, 16, 64, walk=walk)
                yield largest(picture, f"unlit: {name}, {walk}", "nothing")

            yield Case(f"unlit: {name}, {walk}", rows_, quick=walk == "auto")


STARVED = (("mixture", "exact"), ("bono", "exact"), ("bono", "conditional"), ("bill", "conditional"))
"""Walks that ask the cache, and their weights."""
RENDERS = 100
BESIDE = placed(sphere(8, 0.5), move(0, 0, 280))
"""Behind the camera `ABOVE`, 80 from it: seen large enough to leave a plate of 0.4 fewer than 256 of 8000 records, the
least of a body, and too far from the plate to light it."""


def starved() -> Iterator[Case]:
    """The mean over many renders whose caches know next to nothing is the expected one."""
    for name, settings in (
        ("one sample per pixel, 16 pixels", {}),
        ("one cell for everything", {"cacheResolution": 1}),
        ("a cell for every record", {"cacheResolution": 1024}),
        ("filled from the camera, one sample", {"cacheFill": "camera"}),
        (POOR, {}),
    ):
        for walk, weight in STARVED:
            quick = name == POOR and (walk, weight) in (("mixture", "exact"), ("bono", "conditional"))
            asked = {"walk": walk, "walkPdf": weight, **settings}
            stressed = f"{name}, {walk} {weight}"
            yield Case(stressed, functools.partial(from_behind, name, asked), quick=quick)


def from_behind(name: str, settings: dict[str, Any]) -> Iterator[Row]:
    """A plate in light from behind: what its cache knows is of the other face."""
    prims = body(plate(0.01, 0.2), medium(0.9, 0.01), ABOVE, [sun(180.0)])
    delegate = load({**prims, "/B": BESIDE} if name == POOR else prims)
    # The second sample has what the walks of the first taught.
    runs = [run(delegate, 4, 2, seed=seed, **settings) for seed in range(RENDERS)]
    for guide in (r.stats["guide"] for r in runs):
        assert guide["records"] > 0 and guide["regions"] > 0, "nothing is asked of a cache"
        # What is above was given to the plate, which else had less than its least.
        assert name != POOR or guide["records"] > 8000, "the plate is not poor"
        assert {asked["walk"] for asked in guide["media"]} == {settings["walk"]}
    mean, error = mean_and_error(np.stack([r.color[..., 1] for r in runs]))
    expected = slab(0.9, 1.0)[1] / math.pi
    yield Row(
        FAMILY,
        f"{name}, {settings['walkPdf']} weights, mean of {RENDERS} renders",
        SLAB,
        expected,
        mean,
        error,
        # Of the light that spreads, by the rim, twenty mean free paths away.
        tolerance=1e-4 * expected,
        non_finite=sum(r.non_finite for r in runs),
        walk=walk_of(runs[0]),
        seconds=sum(r.seconds for r in runs),
        resolution=0.2,
    )


def moved_light() -> Iterator[Case]:
    """A cache that was trained on a light which has moved since, and edits back."""
    skin = medium((0.95, 0.8, 0.6), (0.2, 0.1, 0.05))
    eye = camera((0, 0, 6), 26.0)

    def lamp(x: float, z: float) -> Prim:
        return light("sphere", move(x, 1.0, z), 40.0, radius=0.5)

    def edited() -> Iterator[Row]:
        delegate = load(body(sphere(16), skin, eye, [lamp(2.0, 3.0)]))
        before = run(delegate, 24, 16)
        delegate.sync("/L0", lamp(-2.0, -3.0), 512 | 4)
        after = run(delegate, 24, 16)
        fresh = render(body(sphere(16), skin, eye, [lamp(-2.0, -3.0)]), 24, 16)
        assert not np.array_equal(before.color, after.color), "the lamp did not move"
        difference = float(np.abs(after.color - fresh.color).max())
        yield Row(
            FAMILY,
            "a light that moved: largest difference to a fresh load",
            "the same image, bit for bit",
            0.0,
            difference,
            non_finite=after.non_finite,
            walk=walk_of(after),
            seconds=after.seconds,
        )

    # Thin enough that classical walks find the way, too.
    prims = body(sphere(16), medium(0.95, 0.5), eye, [lamp(-2.0, -3.0)])

    @functools.cache
    def by(walk: str) -> Picture:
        return render(prims, 24, 4096, walk=walk, seed=int(walk == "classical"))

    def against_classical(walk: str) -> Iterator[Row]:
        stressed = f"light from behind, {walk}"
        yield difference(by(walk), by("classical"), FAMILY, stressed, "classical walks", resolution=0.05)

    yield Case("a light that moved", edited, quick=True)
    for walk in GUIDED:
        yield Case(f"light from behind, {walk}", lambda walk=walk: against_classical(walk))


CASES = [case for family in (unlit, starved, moved_light) for case in family()]
