"""Every walk shows what classical walks show: on the shared stages, and in bodies and instances of every boundary."""

import itertools
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from stability.rendering import load, run
from stability.scenes import Prim, camera, dome, light, medium, move, placed, rows, sphere

from dermis._core import Delegate
from dermis.hydra import populate
from dermis.stage import flatten, open_stage

STAGES = {"backlit_bunny": 1.25, "card_skull": 1.02, "creature_spot": 1.2, "envmap_dragon": 2.0}
"""By how much brighter a picture of any walk must not be. The sun of the dragon's sky gets into it by chance alone."""
ON_STAGES = (
    ("mixture", "exact"),
    ("poe", "exact"),
    ("bono", "conditional"),
    ("bill", "conditional"),
    ("ii", "conditional"),
    ("cp", "exact"),
)
ALL_WALKS = tuple(
    (walk, weight)
    for walk in ("poe", "cp", "ii", "bono", "bill", "mixture")
    for weight in ("conditional", "exact")
    if (walk, weight) != ("ii", "exact")  # its normals are not known beforehand
)
BLOCK = 8
"""Pixels on a side."""
CHANCE = 1e-3
"""That any test of a family fails though nothing is wrong."""

Image = NDArray[np.float64]
Scores = dict[str, float]


def scores(name: str, a: Image, b: Image) -> Scores:
    """z of every block of pixels and of all of them, by channel: the sum of the differences over the root of the sum of
    their squares. Pixels are independent, and the expectation of each difference is zero."""
    difference = a - b
    height, width, _ = difference.shape
    parts = {f"block {y}, {x}": difference[y : y + BLOCK, x : x + BLOCK] for y, x in corners(height, width)}
    found = {}
    for part, pixels in (*parts.items(), ("all", difference)):
        sums, squares = pixels.sum((0, 1)), (pixels**2).sum((0, 1))
        for c in range(3):
            if squares[c] > 0.0:
                found[f"{name}, {part}, channel {c}"] = float(sums[c] / math.sqrt(squares[c]))
    return found


def corners(height: int, width: int) -> Iterator[tuple[int, int]]:
    return ((y, x) for y in range(0, height, BLOCK) for x in range(0, width, BLOCK))


def failures(found: Scores) -> Scores:
    """Those that one of as many sums of symmetric differences exceeds with probability `CHANCE` (Hoeffding 1963)."""
    limit = math.sqrt(2.0 * math.log(2.0 * len(found) / CHANCE))
    return {name: z for name, z in found.items() if not abs(z) < limit}


SEEDS = itertools.count(1)
"""No two renders share a random number: a common error of theirs would count as often as there are walks."""


def picture_of(core: Delegate, walk: str, **settings: Any) -> Image:
    core.set_settings(json.dumps({"seed": next(SEEDS), "walk": walk, **settings}))
    core.commit()
    core.start()
    assert core.wait(300.0)
    assert walks(json.loads(core.stats())) == {walk}
    return core.snapshot()["color"][..., :3].astype(np.float64)


def walks(stats: dict[str, Any]) -> set[str]:
    return {medium["walk"] for medium in stats["guide"]["media"]}


def judge(found: Scores, wrong: Scores, cases: set[str]) -> None:
    """Nothing fails, and of what is wrong something does in each case."""
    worst = max(found, key=lambda name: abs(found[name]))
    print(f"worst of {len(found)}: {worst}, z {found[worst]:.1f}")
    assert not failures(found)
    assert {name.partition(", block")[0].partition(", all")[0] for name in failures(wrong)} == cases


def test_every_walk_shows_the_shared_stages(shared_scenes):
    found, wrong, cases = {}, {}, set()
    for name, brighter in STAGES.items():
        core = Delegate()
        populate(core, flatten(open_stage(shared_scenes / f"{name}.usda")))
        core.set_settings(json.dumps({"resolution": [48, 48]}))
        classical = picture_of(core, samples=288, walk="classical")
        for walk, weight in ON_STAGES:
            picture = picture_of(core, samples=64, walk=walk, walkPdf=weight)
            case = f"{name}: {walk} {weight}"
            cases.add(case)
            found |= scores(case, picture, classical)
            wrong |= scores(case, brighter * picture, classical)
    judge(found, wrong, cases)


BOUNDARIES = ("diffuse", "dielectric", "indexMatched")


def skin(albedo: tuple[float, ...], radius: tuple[float, ...], boundary: str) -> Prim:
    return medium(albedo, radius, boundary, ior=1.4 if boundary == "dielectric" else 1.0)


def company(first: str, second: str, instances: str) -> dict[str, Prim]:
    """Two bodies and two instances of a third, by their boundaries; a few mean free paths across, in light from before
    and behind."""
    copies = np.stack([np.array(rows(move(0, y, 0))) for y in (1.3, -1.3)])
    return {
        "/A": placed(sphere(14, 0.6), move(-0.8, 0, 0)),
        "/M": skin((0.95, 0.9, 0.8), (0.4, 0.3, 0.2), first),
        "/B": {**placed(sphere(14, 0.6), move(0.8, 0, 0)), "material": "/N"},
        "/N": skin((0.9, 0.95, 0.99), (0.3, 0.4, 0.5), second),
        "/I": {"type": "Instancer", "visible": True, "transforms": copies},
        "/D": {**sphere(10, 0.4), "material": "/K", "instancer": "/I"},
        "/K": skin((0.95, 0.8, 0.9), (0.2, 0.2, 0.3), instances),
        "/C": camera((0, 0, 6), 34.0),
        "/Behind": light("sphere", move(-2, 3, -3), 60.0, radius=0.6),
        "/Before": light("rect", move(0, 0, 6), 4.0, width=2.0, height=2.0, texture=""),
        "/Sky": dome(0.2),
    }


def test_every_walk_shows_bodies_and_instances_of_every_boundary():
    found, wrong, cases = {}, {}, set()
    for turn in range(3):
        first, second, instances = (BOUNDARIES[(turn + i) % 3] for i in range(3))
        delegate = load(company(first, second, instances))

        def picture(samples: int, walk: str, delegate: Any = delegate, **settings: Any) -> Image:
            image = run(delegate, 24, samples, seed=next(SEEDS), walk=walk, **settings)
            assert image.non_finite == 0 and walks(image.stats) == {walk}
            return image.color

        classical = picture(1024, walk="classical")
        for walk, weight in ALL_WALKS:
            shown = picture(128, walk=walk, walkPdf=weight)
            case = f"{instances} instances: {walk} {weight}"
            cases.add(case)
            found |= scores(case, shown, classical)
            wrong |= scores(case, 1.1 * shown, classical)
    judge(found, wrong, cases)
