"""Where things stand: far away, in other units, transformed, around the camera, within each other."""

import math
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from .media import FURNACE, body
from .rendering import BUDGET, Picture, compared, measured, render, resolving
from .row import Case, Limit, Row, about
from .scenes import (
    Matrix,
    Prim,
    baked,
    box,
    camera,
    light,
    medium,
    move,
    placed,
    rows,
    scale,
    sphere,
    turn,
)

FAMILY = "space"
TOUCHING = "coincident faces"
OVERLAPPING = "diffuse media that overlap"
SKIN = (0.95, 0.8, 0.6), (0.2, 0.1, 0.05)
"""Albedo and mean free path of the lit body, in radii."""
EYE = camera((0, 0, 6), 26.0)


def moved(prim: Prim, matrix: Matrix) -> Prim:
    """With its own placement first."""
    return {**prim, "transform": rows(np.array(prim.get("transform", np.eye(4))) @ matrix)}


def lit(
    boundary: str, size: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> dict[str, Prim]:
    """A sphere, a round lamp and a dim dome, all of them scaled and moved."""
    albedo, radius = SKIN
    lamp = light("sphere", scale(size) @ move(*(size * x for x in (2, 3, 3))) @ move(*at), 40.0, radius=0.5)
    eye = camera(np.array([0, 0, 6]) * size + at, 26.0, at)
    material = medium(albedo, np.array(radius) * size, boundary)
    return {
        "/O": placed(sphere(16, size), move(*at)),
        "/M": material,
        "/C": eye,
        "/Lamp": lamp,
        "/Dome": light("dome", intensity=0.1, texture="", poleAxis="Y"),
    }


@cache
def at_home(boundary: str) -> Picture:
    return render(lit(boundary), samples=1024, seed=1)


def same_picture() -> Iterator[Case]:
    """Nothing depends on where the world's origin is, or on the unit of length."""
    places: dict[str, dict[str, Any]] = {
        "1e6 units from the origin": {"at": (1e6, -1e6, 1e6)},
        "1e6 radii from the origin, in units of 1e-4": {"size": 1e-4, "at": (1e2, -1e2, 1e2)},
        "object 1e-4 units large": {"size": 1e-4},
        "object 1e5 units large": {"size": 1e5},
        "millimetres (1000 units)": {"size": 1e3},
        "kilometres (1e-6 units)": {"size": 1e-6},
    }
    for boundary in ("diffuse", "indexMatched"):
        for name, place in places.items():

            def rows_(
                boundary: str = boundary, name: str = name, place: dict[str, Any] = place
            ) -> Iterator[Row]:
                pictures = [
                    render(lit(boundary, **p), samples=1024, seed=i) for i, p in enumerate((place, {}))
                ]
                stressed = f"{name}, {boundary}"
                yield from compared(*pictures, FAMILY, stressed, "the same at the origin, radius 1")

            quick = boundary == "diffuse" and name in ("1e6 units from the origin", "kilometres (1e-6 units)")
            yield Case(f"{name}, {boundary}", rows_, quick=quick)


TRANSFORMS = {
    "non-uniform 4:1:0.3": scale(2.0, 0.5, 0.15) @ turn(1, 30.0),
    "mirrored": scale(-1.0, 1.0, 1.0) @ turn(2, 40.0),
    "mirrored and sheared": np.array([[1, 0, 0, 0], [0.6, 0.8, 0, 0], [0.2, 0.3, -0.7, 0], [0, 0, 0, 1.0]]),
    "scale 1e-3 of a body of 1e3": scale(1e-3, 1e-3, 2e-3),
}


def transforms() -> Iterator[Case]:
    for name, matrix in TRANSFORMS.items():
        prim = sphere(16, 1e3 if "1e3" in name else 1.0)

        def against_points(name: str = name, matrix: Matrix = matrix, prim: Prim = prim) -> Iterator[Row]:
            points = {**lit("diffuse"), "/O": baked(prim, matrix)}
            instancer = {"type": "Instancer", "visible": True, "transforms": matrix[None].copy()}
            instanced = {**lit("diffuse"), "/O": {**prim, "instancer": "/I"}, "/I": instancer}
            pictures = [render(prims, samples=1024, seed=i) for i, prims in enumerate((instanced, points))]
            yield from compared(
                *pictures, FAMILY, f"{name} instance", "points that are transformed themselves"
            )

        def furnace(name: str = name, matrix: Matrix = matrix, prim: Prim = prim) -> Iterator[Row]:
            # The middle of the flattest of them is 0.1 wide.
            eye = camera((0, 0, 8), 0.7)
            picture = resolving(body(placed(prim, matrix), medium(1.0, 0.1), eye), 1.0, 16)
            yield measured(picture, FAMILY, f"{name} transform, albedo 1", FURNACE, 1.0)

        yield Case(f"{name} instance", against_points, quick=name == "mirrored and sheared")
        yield Case(f"{name} furnace", furnace)


def inside_camera() -> Iterator[Case]:
    """The camera sees the light around it, but a diffuse boundary is opaque from within."""
    for boundary, ior in (("diffuse", 1.0), ("indexMatched", 1.0), ("dielectric", 1.4)):

        def furnace(boundary: str = boundary, ior: float = ior) -> Iterator[Row]:
            prims = body(sphere(), medium(1.0, 0.5, boundary, ior=ior), camera((0, 0, 0.2), 40.0))
            dark = Limit(-1.0, -0.95, "camera inside a diffuse medium") if boundary == "diffuse" else None
            picture = render(prims, 16, 64) if dark else resolving(prims, 1.0, 16)
            yield measured(picture, FAMILY, f"camera inside, {boundary}, albedo 1", FURNACE, 1.0, limit=dark)

        yield Case(f"camera inside, {boundary}", furnace)


def inside_lights() -> Iterator[Case]:
    """All that a lamp in the middle of a white sphere emits comes out: its power over 4 pi towards every side."""
    radius, width = 0.05, 2.2
    expected = math.pi * radius**2 / width**2
    source = "power of the lamp / 4 pi / area of the orthographic picture"
    eye = camera((0, 0, 8), 0.0, orthographic=width)
    for boundary in ("indexMatched", "diffuse", "dielectric"):

        def rows_(boundary: str = boundary) -> Iterator[Row]:
            # The lamp has an extent, and casts no shadow.
            lamp = light("sphere", radius=radius, cameraVisible=True)
            material = medium(1.0, 0.3, boundary, ior=1.4 if boundary == "dielectric" else 1.0)
            prims = body(sphere(48), material, eye, [lamp])
            dark = Limit(-1.0, -0.999, "lights inside a diffuse medium")
            limit = dark if boundary == "diffuse" else None
            budget = BUDGET / 8.0  # enough for the 10 % below
            picture = (
                render(prims, 48, 16)
                if limit
                else resolving(prims, expected, 32, 64, alike=False, budget=budget)
            )
            stressed = f"light inside, {boundary}, albedo 1"
            yield measured(
                picture, FAMILY, stressed, source, expected, limit=limit, alike=False, resolution=0.1
            )

        yield Case(f"light inside, {boundary}", rows_, quick=boundary == "indexMatched")


def nested() -> Iterator[Case]:
    """White within white, whether the walk of the outer one sees the inner one or not."""
    inner = placed(sphere(16, 0.5), move(0.1, 0.2, 0.3))
    for outside in ("diffuse", "indexMatched"):
        for inside in ("diffuse", "indexMatched"):

            def white(outside: str = outside, inside: str = inside) -> Iterator[Row]:
                prims = body(sphere(), medium(1.0, 0.2, outside))
                prims |= {"/I": {**inner, "material": "/N"}, "/N": medium(1.0, 0.05, inside)}
                stressed = f"{inside} within {outside}, albedo 1"
                yield measured(resolving(prims, 1.0, 16), FAMILY, stressed, FURNACE, 1.0)

            yield Case(f"{inside} within {outside}", white, quick=inside == outside == "indexMatched")


def absorbing() -> Iterator[Case]:
    """A box from 2 deep to 0, of mean free path 2, and one from `low` to `high`, of mean free path 1."""
    coincident = Limit(-1.0, -0.99, TOUCHING)
    for name, low, high, depth, limit in (
        ("absorbing within absorbing", -1.5, -0.5, 0.5 + 1.0, None),
        ("absorbing behind absorbing, a gap of 1e-3", -3.0, -2.001, 1.0 + 0.999, None),
        ("absorbing across absorbing", -3.0, -1.0, 0.5 + 2.0, None),
        ("absorbing behind absorbing, faces touch", -3.0, -2.0, 1.0 + 1.0, coincident),
        ("absorbing before absorbing, faces touch", 0.0, 1.0, 1.0 + 1.0, coincident),
        ("absorbing in absorbing, front faces coincide", -1.0, 0.0, 1.0 + 0.5, coincident),
    ):

        def rows_(
            name: str = name,
            low: float = low,
            high: float = high,
            depth: float = depth,
            limit: Limit | None = limit,
        ) -> Iterator[Row]:
            eye = camera((0, 0, 200), 0.1)
            prims = body(box((-2, -2, -2), (2, 2, 0)), medium(0.0, 2.0, "indexMatched"), eye)
            inner = {**box((-1, -1, low), (1, 1, high)), "material": "/N"}
            prims |= {"/I": inner, "/N": medium(0.0, 1.0, "indexMatched")}
            picture, expected = render(prims, 16, 16), math.exp(-depth)
            yield measured(picture, FAMILY, name, "Beer-Lambert", expected, tolerance=1e-4, limit=limit)

        yield Case(name, rows_, quick="gap" in name or "touch" in name)


def neighbours() -> Iterator[Case]:
    """White beside white."""
    spheres = placed(sphere(), move(-0.3, 0, 0)), placed(sphere(), move(0.3, 0, 0))
    boxes = box((-2, -1, -1), (0, 1, 1)), box((0, -1, -1), (2, 1, 1))
    apart = box((-2, -1, -1), (-1e-4, 1, 1)), boxes[1]
    for boundary, losses in (
        ("diffuse", (-0.16, -0.32)),
        ("indexMatched", (None, -0.34)),
        ("dielectric", (None, -0.34)),
    ):
        overlapping, touching = losses
        for name, pair, limit in (
            ("overlapping spheres", spheres, overlapping and about(overlapping, OVERLAPPING)),
            ("boxes with a common face, seen there", boxes, about(touching, TOUCHING)),
            ("boxes 1e-4 apart, seen there", apart, None),
        ):

            def rows_(
                boundary: str = boundary,
                name: str = name,
                pair: tuple[Prim, Prim] = pair,
                limit: Limit | None = limit,
            ) -> Iterator[Row]:
                ior = 1.4 if boundary == "dielectric" else 1.0
                prims = body(pair[0], medium(1.0, 0.2, boundary, ior=ior))
                prims |= {"/I": {**pair[1], "material": "/N"}, "/N": medium(1.0, 0.05, boundary, ior=ior)}
                # Paths that go from one to the other and back are long; twelve bounces cut a few of them.
                picture = render(prims, 32, 64) if limit else resolving(prims, 1.0, 16, maxDepth=64)
                yield measured(
                    picture, FAMILY, f"{name}, {boundary}", FURNACE, 1.0, tolerance=1e-3, limit=limit
                )

            yield Case(f"{name}, {boundary}", rows_)


FAMILIES = (same_picture, transforms, inside_camera, inside_lights, nested, absorbing, neighbours)
CASES = [case for family in FAMILIES for case in family()]
