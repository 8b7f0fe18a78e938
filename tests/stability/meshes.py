"""Meshes that are not closed, not outward, not simple, not well shaped, or very fine: all white, in a furnace."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from .media import FURNACE, body
from .rendering import measured, resolving
from .row import Case, Limit, Row, about
from .scenes import FRONT, QUADS, Prim, baked, box, camera, flipped, joined, medium, mesh, move, sphere, turn

FAMILY = "meshes"
HALF = (-1, -1, -1), (1, 1, 1)


def needles(count: int = 100_000) -> Prim:
    """A drum of two rings: sides of aspect 1:2e4, caps of slivers that all meet in their middle."""
    return sphere(3, 1.0, columns=count)


def slivers() -> Prim:
    """A box whose front is cut into needles of 2 x 1e-6 and ever flatter triangles about one corner."""
    x = np.concatenate([np.linspace(-1, 1, 3), np.linspace(-0.01, 0.01, 20_001)])
    x = np.unique(x.astype(np.float32))
    n = len(x)
    low, high = (np.stack([x, np.full(n, y), np.ones(n)], -1) for y in (-1.0, 1.0))
    far = [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1]]
    a, b = np.arange(n - 1), np.arange(n, 2 * n - 1)
    front = np.concatenate([np.stack([a, a + 1, b + 1], -1), np.stack([a, b + 1, b], -1)])
    west, east, north_west, north_east = 0, n - 1, n, 2 * n - 1
    back = 2 * n + np.arange(4)
    # The long edges of the front are fans of the neighbouring faces, so that nothing is open.
    bottom = np.stack([np.full(n - 1, back[0]), a + 1, a], -1)
    top = np.stack([np.full(n - 1, back[2]), b, b + 1], -1)
    rest = [
        [back[0], back[1], east],
        [back[2], north_east, back[3]],
        [back[0], back[2], back[3]],
        [back[0], back[3], back[1]],
        [back[0], west, north_west],
        [back[0], north_west, back[2]],
        [back[1], back[3], north_east],
        [back[1], north_east, east],
    ]
    triangles = np.concatenate([front, bottom, top, rest])
    return mesh(np.concatenate([low, high, far]), np.full(len(triangles), 3), triangles)


def graded() -> Prim:
    """A sphere of a million triangles whose rings close in on the pole that the camera sees: edges of 1e-7."""
    polar = np.concatenate([1e-4 * np.arange(1, 400) / 400, np.linspace(1e-4, math.pi - 1e-2, 101)])
    return baked(sphere(0, 1.0, columns=1000, polar=polar), turn(0, 90.0))


@dataclass(frozen=True)
class Shape:
    """A mesh, the camera, and by boundary what is known to be lost of white."""

    name: str
    build: Callable[[], Prim]
    eye: Prim | None = None
    losses: dict[str, Limit] = field(default_factory=dict)
    boundaries: tuple[str, ...] = ("diffuse", "indexMatched", "dielectric")
    size: float = 1.0
    quick: bool = False
    pixels: int = 16
    settings: dict[str, str] = field(default_factory=dict)

    def rows(self, boundary: str) -> Iterator[Row]:
        material = medium(1.0, 0.2 * self.size, boundary, ior=1.4 if boundary == "dielectric" else 1.0)
        picture = resolving(
            body(self.build(), material, self.eye or FRONT), 1.0, self.pixels, **self.settings
        )
        # A walk in 1e4 that rounding leads out is seen in the leak count.
        limit = self.losses.get(boundary)
        yield measured(picture, FAMILY, f"{self.name}, {boundary}", FURNACE, 1.0, tolerance=1e-4, limit=limit)


def lost(words: str, diffuse: float, matched: float, dielectric: float) -> dict[str, Limit]:
    shares = {"diffuse": diffuse, "indexMatched": matched, "dielectric": dielectric}
    return {boundary: about(-share, words) for boundary, share in shares.items()}


OPEN = "an open mesh: walks leak"
NEEDLES = "needles"

SHAPES = (
    Shape("closed", sphere),
    Shape(
        "open: one face of six is missing, behind",
        lambda: box(*HALF, faces=QUADS[:4] + QUADS[5:]),
        losses=lost(OPEN, 0.019, 0.025, 0.048),
    ),
    Shape("flipped", lambda: flipped(sphere()), quick=True),
    Shape("every other face flipped", lambda: half_flipped()),
    Shape("self-intersecting: two spheres across each other", lambda: two(0.3)),
    Shape("every face twice", lambda: two(0.0), quick=True),
    Shape("every face twice, one of them flipped", lambda: joined(sphere(), flipped(sphere()))),
    Shape("shell with a hollow", lambda: joined(sphere(), flipped(sphere(24, 0.6))), quick=True),
    Shape(
        "two sheets 1e-4 apart, a hollow between",
        lambda: joined(sphere(), flipped(sphere(24, 0.9999)), sphere(24, 0.9998)),
    ),
    Shape(
        "needles of 1 x 1e-4",
        lambda: needles(50_000),
        losses={"diffuse": about(-0.006, NEEDLES)},
        boundaries=("diffuse",),
        pixels=12,
        settings={"walk": "classical"},
    ),
    Shape(
        "slivers of 2 x 1e-6",
        slivers,
        camera((0, 0, 8), 0.1),
        losses={"diffuse": about(-0.006, NEEDLES)},
        boundaries=("diffuse",),
        pixels=12,
        settings={"walk": "classical"},
    ),
    Shape(
        "1e6 triangles, edges of 1e-7, radius 1.6e-5",
        lambda: sphere(500, 1.6e-5),
        camera((0, 0, 8 * 1.6e-5), 6.0),
        boundaries=("diffuse", "dielectric"),
        size=1.6e-5,
    ),
    Shape(
        "1e6 triangles, edges from 1e-9 to 0.03, radius 1",
        graded,
        camera((0, 0, 8), 1e-3, (0, 0, 1)),
        boundaries=("diffuse", "dielectric"),
    ),
)


def two(apart: float) -> Prim:
    return joined(*(baked(sphere(), move(x, 0, 0)) for x in (-apart, apart)))


def half_flipped() -> Prim:
    """Every other triangle."""
    prim = sphere()
    faces = prim["faceVertexIndices"].reshape(-1, 3).copy()
    faces[::2] = faces[::2, ::-1]
    return {**prim, "faceVertexIndices": faces.ravel()}


CASES = [
    Case(
        f"{shape.name}, {boundary}",
        lambda shape=shape, boundary=boundary: shape.rows(boundary),
        quick=shape.quick and boundary == "diffuse",
    )
    for shape in SHAPES
    for boundary in shape.boundaries
]
