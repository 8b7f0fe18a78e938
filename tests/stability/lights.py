"""Lights: dim and blinding, small, many, grazing, in the surface. Under them a dense half-space of known albedo."""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from .closed_forms import half_space, half_space_radiance, sphere_light, sphere_on_horizon
from .media import DEEP, body
from .rendering import measured, render, resolving
from .row import Case, Limit, Row, about
from .scenes import ABOVE, Prim, camera, light, medium, move, sun, turn

FAMILY = "lights"
ALBEDO = 0.9
SHOWN = half_space(ALBEDO) / math.pi
"""Radiance per irradiance."""
DIRECT = "albedo of the half-space / pi times the irradiance"
SKIN = medium(ALBEDO, 1e-4)
"""Light spreads over a thousandth at most."""


def extremes() -> Iterator[Case]:
    """1e30 is the most that a light may have: 1e20 per texel, and less where a sum of squares would overflow."""
    for intensity in (1e-30, 1e-20, 1e10, 1e30):
        kinds: dict[str, tuple[Prim, float]] = {
            "dome": (light("dome", intensity=intensity, texture="", poleAxis="Y"), math.pi),
            "sun": (sun(0.0, intensity), 1.0),
            "sphere": (light("sphere", move(0, 0, 30), intensity, radius=0.5), sphere_light(0.5, 30.0)),
        }
        for kind, (lamp, irradiance) in kinds.items():
            for boundary in ("diffuse", "indexMatched"):

                def rows(
                    kind: str = kind,
                    lamp: Prim = lamp,
                    irradiance: float = irradiance,
                    intensity: float = intensity,
                    boundary: str = boundary,
                ) -> Iterator[Row]:
                    if boundary == "diffuse":
                        expected, source = SHOWN * irradiance * intensity, DIRECT
                    else:
                        radiance = (
                            half_space(ALBEDO, 1.0) if kind == "dome" else half_space_radiance(ALBEDO, 1, 1)
                        )
                        expected = radiance * intensity * (1.0 if kind == "dome" else irradiance)
                        source = "half-space of matched index (Chandrasekhar)"
                    prims = body(DEEP, medium(ALBEDO, 1e-3, boundary), ABOVE, [lamp])
                    # The sphere is seen under two degrees: a beam, to second order.
                    tolerance = (1e-3 if kind == "sphere" and boundary != "diffuse" else 1e-4) * expected
                    stressed = f"{kind} of {intensity:g}, {boundary}"
                    yield measured(
                        resolving(prims, expected), FAMILY, stressed, source, expected, tolerance=tolerance
                    )

                quick = (kind, boundary) == ("dome", "diffuse") and intensity in (1e-30, 1e30)
                yield Case(f"{kind} of {intensity:g}, {boundary}", rows, quick=quick)


def texel() -> Iterator[Case]:
    """One texel of a map holds all energy; its bilinear tent stands for a delta of known integral."""
    width, height = 1024, 512
    for row in (1, 100, 200):

        def rows(row: int = row) -> Iterator[Row]:
            pixels = np.zeros((height, width, 3), np.float32)
            pixels[row, width // 3] = 1e4
            texture = {"type": "Texture", "file": "one texel", "width": width, "height": height}
            # The pole of the map is turned to +z, which the half-space faces.
            lamp = light("dome", turn(0, 90.0), texture="/T", poleAxis="Y")
            prims = body(DEEP, SKIN, ABOVE, [lamp]) | {"/T": {**texture, "pixels": pixels.reshape(-1, 3)}}
            # Integral of the tent in polar angle times sin cos, in longitude exactly one pixel.
            theta = (np.arange(20_000) + 0.5) / 10_000 * math.pi / height + (row - 0.5) * math.pi / height
            tent = 1.0 - np.abs(theta * height / math.pi - row - 0.5)
            weight = (tent * np.sin(theta) * np.cos(theta)).sum() * math.pi / height / 10_000
            expected = SHOWN * 1e4 * 2.0 * math.pi / width * weight
            picture = resolving(prims, expected)
            stressed = f"one texel of {width} x {height} holds all energy, row {row}"
            yield measured(picture, FAMILY, stressed, DIRECT, expected, tolerance=1e-3 * expected)

        yield Case(f"one texel, row {row}", rows, quick=row == 100)


def many() -> Iterator[Case]:
    """2000 lamps over the half-space, one of them a hundred times as bright as all others together."""
    spiral = np.arange(2000) + 0.5
    height, azimuth = 0.05 + 0.95 * spiral / 2000, spiral * math.pi * (1 + math.sqrt(5))
    distance = 3.0 + 2.0 * np.cos(spiral)
    across = np.sqrt(1.0 - height**2)
    points = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], -1) * distance[:, None]
    irradiance = [sphere_light(0.05, d, h) for d, h in zip(distance, height, strict=True)]
    for bright in (False, True):

        def rows(bright: bool = bright) -> Iterator[Row]:
            strength = np.ones(2000)
            strength[1234] = 200_000.0 if bright else 1.0
            lamps = [
                light("sphere", move(*p), float(s), radius=0.05)
                for p, s in zip(points, strength, strict=True)
            ]
            expected = SHOWN * float(np.dot(strength, irradiance))
            # Every exit weighs all of them.
            picture = resolving(body(DEEP, SKIN, ABOVE, lamps), expected, 16, 48)
            stressed = "2000 lights" + (", one a hundred times as bright as all others" if bright else "")
            yield measured(picture, FAMILY, stressed, DIRECT, expected, tolerance=1e-3 * expected)

        yield Case("2000 lights" + (", one of them bright" if bright else ""), rows)


def touching() -> Iterator[Case]:
    """Lights in the surface, on it, and just above it."""

    def horizon() -> Iterator[Row]:
        lamp = light("sphere", move(0.6, 0, 0), 10.0, radius=0.3)
        expected = SHOWN * 10.0 * sphere_on_horizon(0.3, 0.6)
        picture = resolving(body(DEEP, SKIN, camera((0, 0, 50), 0.002), [lamp]), expected)
        source = "upper half of the cone, projected: s - sin s cos s"
        yield measured(
            picture,
            FAMILY,
            "sphere light, half of it in the medium",
            source,
            expected,
            tolerance=2e-3 * expected,
        )

    def above(height: float) -> Iterator[Row]:
        # A disk of radius 0.5 that faces the surface; the camera looks through it, since lights cast no shadow.
        lamp = light("disk", move(0, 0, height), 1.0, radius=0.5)
        sine2 = 0.25 / (0.25 + height**2)
        picture = resolving(body(DEEP, SKIN, ABOVE, [lamp]), SHOWN * math.pi * sine2)
        stressed = f"disk light {height:g} above the surface"
        expected = SHOWN * math.pi * sine2
        yield measured(picture, FAMILY, stressed, DIRECT + ", pi sin^2", expected, tolerance=2e-3 * expected)

    def on() -> Iterator[Row]:
        lamp = light("disk", move(0, 0, 0), 1.0, radius=0.5)
        picture = render(body(DEEP, SKIN, ABOVE, [lamp]))
        yield measured(
            picture,
            FAMILY,
            "disk light exactly on the surface",
            DIRECT + ", as if just above",
            SHOWN * math.pi,
            limit=Limit(-1.0, -0.99, "light in the plane of the surface"),
        )

    yield Case("sphere light in the surface", horizon, quick=True)
    for height in (1.0, 1e-2, 1e-4):
        yield Case(f"disk light {height:g} above", lambda height=height: above(height))
    yield Case("disk light on the surface", on)


def grazing() -> Iterator[Case]:
    for degrees in (80.0, 89.0, 89.9, 89.99):
        cosine = math.cos(math.radians(degrees))

        def diffuse(degrees: float = degrees, cosine: float = cosine) -> Iterator[Row]:
            expected = SHOWN * cosine
            picture = resolving(body(DEEP, SKIN, ABOVE, [sun(degrees)]), expected)
            yield measured(
                picture,
                FAMILY,
                f"sun at {degrees:g} degrees, diffuse",
                DIRECT,
                expected,
                tolerance=1e-3 * expected,
            )

        def matched(
            degrees: float = degrees, cosine: float = cosine, radius: float = 0.02, limit: Limit | None = None
        ) -> Iterator[Row]:
            expected = half_space_radiance(ALBEDO, 1.0, cosine)
            material = medium(ALBEDO, radius, "indexMatched")
            prims = body(DEEP, material, camera((0, 0, 8), 0.1), [sun(degrees)])
            # At the lowest sun, one collision in ten thousand sees it.
            hard = 0.35 if degrees > 89.5 else 0.05
            picture = render(prims, samples=1024) if limit else resolving(prims, expected, samples=256)
            source = "half-space of matched index (Chandrasekhar)"
            stressed = f"sun at {degrees:g} degrees, matched, mean free path {radius:g}"
            row = measured(
                picture, FAMILY, stressed, source, expected, tolerance=1e-3 * expected, resolution=hard
            )
            row.limit = limit
            yield row

        def seen(degrees: float = degrees, cosine: float = cosine) -> Iterator[Row]:
            expected = half_space_radiance(ALBEDO, cosine, 1.0)
            sine = math.sin(math.radians(degrees))
            eye = camera((8 * sine, 0, 8 * cosine), 0.001)
            picture = resolving(body(DEEP, medium(ALBEDO, 1e-3, "indexMatched"), eye, [sun()]), expected)
            source = "half-space of matched index (Chandrasekhar)"
            yield measured(
                picture,
                FAMILY,
                f"camera at {degrees:g} degrees, matched",
                source,
                expected,
                tolerance=2e-3 * expected,
            )

        yield Case(f"sun at {degrees:g}, diffuse", diffuse, quick=degrees == 89.9)
        yield Case(f"sun at {degrees:g}, matched", matched)
        if degrees > 89.5:
            limit = about(-0.08 if degrees < 89.95 else -0.46, "grazing light at the rounding of positions")
            dense = partial(matched, radius=1e-3, limit=limit)
            yield Case(f"sun at {degrees:g}, matched, dense", dense)
        if degrees < 89.95:
            yield Case(f"camera at {degrees:g}", seen)


CASES = [case for family in (extremes, texel, many, touching, grazing) for case in family()]
