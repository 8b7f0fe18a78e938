"""Media: albedo, mean free path, ratios of channels, index, anisotropy, thickness, limits of kappa."""

import functools
import math
from collections.abc import Iterable, Iterator
from typing import Any

from .closed_forms import absorbing_sphere, half_space, slab
from .rendering import BUDGET, Picture, measured, render, resolving
from .row import RESOLUTION, Case, Limit, Row
from .scenes import ABOVE, FRONT, Prim, box, dome, medium, plate, sphere, sun

FAMILY = "media"
FAINT = "light through many diffusion lengths"
LEAST = 1e-35
"""Less is nothing in f32."""
WALKS = ("auto", "classical")
FURNACE = "white furnace"
HALF_SPACE = "half-space, first moment of H (Chandrasekhar)"
SLAB = "slab by adding-doubling (reference.csv)"
DEEP = box((-1, -1, -2), (1, 1, 0))
"""Its top is at z = 0, where the camera above looks."""


def body(
    prim: Prim, material: Prim, camera: Prim = FRONT, lights: Iterable[Prim] = (dome(),)
) -> dict[str, Prim]:
    named = {f"/L{i}": light for i, light in enumerate(lights)}
    return {"/O": prim, "/M": material, "/C": camera, **named}


def albedos() -> Iterator[Case]:
    """A dense half-space under a dome of radiance 1 shows its diffuse albedo, or that of a direction if matched."""
    for albedo in (1e-4, 0.05, 0.5, 0.9, 0.99, 0.999, 0.99999, 1.0):
        for walk in WALKS:

            def rows(albedo: float = albedo, walk: str = walk) -> Iterator[Row]:
                # Walks in white are long, and all weigh the same: few do.
                expected, samples = half_space(albedo), 64 if albedo < 0.999 else 16
                prims = body(DEEP, medium(albedo, 1e-3), ABOVE)
                picture = resolving(prims, expected, samples=samples, walk=walk)
                # 2000 mean free paths are a half-space to 1e-5, even of diffusion length 180. Classical walks are
                # absorbed: at the least albedo, one in fifty thousand returns.
                hard = {1e-4: 0.6, 0.05: 0.04}.get(albedo, RESOLUTION) if walk == "classical" else RESOLUTION
                yield measured(
                    picture,
                    FAMILY,
                    f"albedo {albedo:g}",
                    HALF_SPACE,
                    expected,
                    tolerance=1e-5 * expected,
                    resolution=hard,
                )

            yield Case(f"albedo {albedo:g}, {walk}", rows, quick=albedo == 0.9 and walk == "auto")
    for albedo in (1e-4, 0.5, 0.99, 0.99999):

        def matched(albedo: float = albedo) -> Iterator[Row]:
            source, expected = "half-space, 1 - H(1) sqrt(1 - a) (Chandrasekhar)", half_space(albedo, 1.0)
            prims = body(DEEP, medium(albedo, 1e-3, "indexMatched"), ABOVE)
            # A shadow ray at every collision of walks a thousand long.
            long = albedo > 0.999
            picture = resolving(prims, expected, 12 if long else 24, 16 if long else 64)
            stressed = f"albedo {albedo:g}, matched, camera 2e5 mean free paths away"
            hard = 0.05 if long else RESOLUTION
            yield measured(
                picture, FAMILY, stressed, source, expected, tolerance=1e-5 * expected, resolution=hard
            )

        yield Case(f"albedo {albedo:g}, matched", matched, quick=albedo == 1e-4)


def channels() -> Iterator[Case]:
    """Each channel is what it would be alone."""

    def albedo_rgb(walk: str) -> Iterator[Row]:
        wanted = {0: 1.0, 1: half_space(0.5)}
        picture = resolving(body(DEEP, medium((1.0, 0.5, 0.0), 1e-2), ABOVE), wanted, walk=walk)
        for channel, albedo in enumerate((1.0, 0.5)):
            stressed = f"RGB albedo (1, 0.5, 0), channel of {albedo:g}"
            expected, source = half_space(albedo), HALF_SPACE
            yield measured(
                picture,
                FAMILY,
                stressed,
                source,
                expected,
                channel,
                tolerance=1e-5 * expected,
                resolution=0.03,
            )
        stressed = "RGB albedo (1, 0.5, 0), channel of 0"
        yield measured(picture, FAMILY, stressed, "nothing scatters", 0.0, 2, tolerance=1e-7)

    def ratio(walk: str, radius: tuple[float, ...], taus: tuple[float, ...]) -> Iterator[Row]:
        prims = body(plate(0.01), medium(0.9, radius), ABOVE, [sun(180.0)])
        wanted = {channel: slab(0.9, tau)[1] / math.pi for channel, tau in enumerate(taus)}
        # What comes through the thickest channel takes the most.
        picture = resolving(prims, wanted, samples=256, budget=2 * BUDGET, walk=walk)
        for channel, tau in enumerate(taus):
            stressed = (
                f"mean free paths 1:{max(radius) / min(radius):g}, transmitted by optical thickness {tau:g}"
            )
            expected = wanted[channel]
            yield measured(picture, FAMILY, stressed, SLAB, expected, channel, tolerance=1e-4 * expected)

    for walk in WALKS:
        yield Case(f"RGB albedo, {walk}", lambda walk=walk: albedo_rgb(walk), quick=walk == "auto")
    # As thin as this, `auto` does not guide.
    for walk in ("auto", "mixture"):
        at = walk, (1.0, 0.1, 0.01), (0.01, 0.1, 1.0)
        yield Case(f"RGB ratio 1:100, {walk}", functools.partial(ratio, *at), quick=walk == "mixture")
    yield Case("RGB ratio 1:1000", lambda: ratio("auto", (1.0, 0.01, 0.001), (0.01, 1.0, 10.0)))
    yield Case("RGB ratio 1000:1", lambda: ratio("auto", (0.001, 1.0, 0.1), (10.0, 0.01, 0.1)))


def mean_free_paths() -> Iterator[Case]:
    """A sphere of radius 1 in uniform light: white, absorbing, and grey where thick or thin."""
    for exponent in (-9, -6, -4, -2, 0, 2, 4, 6, 9):
        radius = 10.0**exponent

        def white(radius: float = radius, exponent: int = exponent) -> Iterator[Row]:
            # Mean length of a walk: 4/3 radii, as long as 2^20 steps allow.
            picture = render(body(sphere(), medium(1.0, radius)), 24 if exponent < 0 else 16, 16)
            dark = Limit(-2e-3, -1e-4, "walks end at 2^20 segments") if exponent <= -4 else None
            stressed = f"mean free path 1e{exponent} radii, albedo 1"
            yield measured(picture, FAMILY, stressed, FURNACE, 1.0, limit=dark)

        def grey(radius: float = radius, exponent: int = exponent) -> Iterator[Row]:
            prims = (
                body(DEEP, medium(0.5, radius), ABOVE)
                if exponent < 0
                else body(sphere(), medium(0.5, radius))
            )
            thin = "1 - (1 - a) mean chord / mean free path, to first order"
            expected, source = (
                (half_space(0.5), HALF_SPACE) if exponent < 0 else (1.0 - 2.0 / 3.0 / radius, thin)
            )
            stressed = f"mean free path 1e{exponent} radii, albedo 0.5"
            # Flat triangles of 24 rings are within 1 % of the sphere; second order is below 1 / radius^2.
            tolerance = 1e-4 if exponent < 0 else 0.01 / radius + 1.0 / radius**2
            yield measured(
                resolving(prims, expected), FAMILY, stressed, source, expected, tolerance=tolerance
            )

        def black(radius: float = radius, exponent: int = exponent) -> Iterator[Row]:
            source, expected = "Beer-Lambert over the chords of a sphere", absorbing_sphere(2.0 / radius)
            picture = resolving(body(sphere(96), medium(0.0, radius)), expected)
            yield measured(
                picture,
                FAMILY,
                f"mean free path 1e{exponent} radii, albedo 0",
                source,
                expected,
                tolerance=1e-3 * expected,
            )

        yield Case(f"mean free path 1e{exponent}, white", white, quick=exponent in (-2, 0, 9))
        if exponent <= -4 or exponent >= 2:
            yield Case(f"mean free path 1e{exponent}, grey", grey, quick=exponent in (-9, 9))
        # Denser ones are seen through at their rim only, which is flat triangles.
        if exponent >= 0:
            yield Case(f"mean free path 1e{exponent}, black", black, quick=exponent == 0)


def boundaries() -> Iterator[Case]:
    """Indices: white bodies vanish, dense ones show the table's albedo at normal incidence."""
    for ior in (1.0, 1.0001, 1.5, 2.4):
        for roughness, walk in ((0.0, "auto"), (0.0, "classical"), (0.3, "auto"), (0.3, "classical")):

            def white(ior: float = ior, roughness: float = roughness, walk: str = walk) -> Iterator[Row]:
                material = medium(1.0, (0.01, 0.1, 1.0), "dielectric", ior=ior, roughness=roughness)
                picture = resolving(body(sphere(), material), 1.0, 16, 64, walk=walk)
                stressed = f"eta {ior:g}, roughness {roughness:g}, mean free paths 1:100"
                # Weights multiply from one internal reflection to the next: the channels part.
                hard = 0.1 if ior in (1.0, 2.4) else 0.05
                yield measured(picture, FAMILY, stressed, FURNACE, 1.0, tolerance=1e-4, resolution=hard)

            if ior != 1.0 or roughness == 0.0:
                quick = (ior, roughness, walk) == (1.5, 0.0, "auto")
                yield Case(f"eta {ior:g}, roughness {roughness:g}, {walk}", white, quick=quick)
        for albedo in (0.5, 0.9):

            def dense(ior: float = ior, albedo: float = albedo) -> Iterator[Row]:
                expected = slab(albedo, math.inf, 0.0, ior, "normal")[0]
                prims = body(DEEP, medium(albedo, 1e-3, "dielectric", ior=ior), ABOVE)
                picture = resolving(prims, expected, samples=128)
                stressed = f"eta {ior:g}, albedo {albedo:g}, normal incidence"
                yield measured(picture, FAMILY, stressed, SLAB, expected, tolerance=1e-5)

            if ior != 1.0:
                yield Case(f"eta {ior:g}, albedo {albedo:g}", dense)


def anisotropies() -> Iterator[Case]:
    for g in (-0.9, -0.5, 0.5, 0.9, 0.95):
        for walk in WALKS:

            def white(g: float = g, walk: str = walk) -> Iterator[Row]:
                picture = render(body(sphere(), medium(1.0, 0.1, subsurfaceAnisotropy=g)), 16, 64, walk=walk)
                yield measured(picture, FAMILY, f"g {g:g}, albedo 1", FURNACE, 1.0)

            def dense(g: float = g, walk: str = walk) -> Iterator[Row]:
                # Of classical walks in dark media, one in hundreds returns.
                for albedo in (0.05, 0.9) if walk == "auto" else (0.9,):
                    material = medium(albedo, 1e-3, subsurfaceAnisotropy=g)
                    expected = slab(albedo, math.inf, g)[0]
                    # Draws from a narrow phase function's kernels take long where nearly all is absorbed.
                    dark = albedo == 0.05 and g >= 0.9
                    budget = BUDGET / 8.0 if dark else BUDGET
                    prims = body(DEEP, material, ABOVE)
                    picture = resolving(prims, expected, samples=128, walk=walk, budget=budget)
                    # The table itself is good to 5e-4 at g = 0.95. One classical walk in a thousand returns.
                    tolerance = (1e-3 if g == 0.95 else 1e-5) * expected
                    hard = 0.25 if dark else 0.03
                    stressed = f"g {g:g}, albedo {albedo:g}"
                    yield measured(
                        picture, FAMILY, stressed, SLAB, expected, tolerance=tolerance, resolution=hard
                    )

            yield Case(f"g {g:g}, white, {walk}", white, quick=g == 0.95 and walk == "auto")
            yield Case(f"g {g:g}, dense, {walk}", dense)


def lit_plate(albedo: float, tau: float, behind: bool, **settings: Any) -> tuple[Picture, float]:
    """A plate of thickness 0.01 in light of irradiance 1, from the front or from behind, and what it should show."""
    # Thin ones let grazing light out by their rim unless they are wide; a boundary cache has cells no smaller than
    # 1/128 of the width, and thick ones need it to tell front from back.
    prims = body(plate(0.01, 10.0 if tau < 10.0 else 0.1), medium(albedo, 0.01 / tau), ABOVE)
    prims["/L0"] = sun(180.0 if behind else 0.0)
    expected = slab(albedo, tau)[behind] / math.pi
    if expected < LEAST:
        return render(prims, **settings), 0.0
    return resolving(prims, expected, **settings), expected


def slabs() -> Iterator[Case]:
    for tau in (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0):
        for albedo in (0.9, 1.0) if tau < 0.1 else (0.5, 0.9, 0.99, 1.0):
            for behind in (False, True):

                def rows(
                    tau: float = tau, albedo: float = albedo, behind: bool = behind, walk: str = "auto"
                ) -> Iterator[Row]:
                    samples = 16 if albedo == 1.0 else 64
                    picture, expected = lit_plate(albedo, tau, behind, samples=samples, walk=walk)
                    side = "transmitted" if behind else "reflected"
                    stressed = f"slab of optical thickness {tau:g}, albedo {albedo:g}, {side}"
                    # One walk in a thousand is reflected by the thinnest, as many come through the thickest.
                    hard = {1e-3: 0.2, 1e-2: 0.08, 0.1: 0.03, 10.0: 0.03, 100.0: 0.3}.get(tau, RESOLUTION)
                    # Grazing light that leaves by the rim, a thousandth of the width: below 1e-5.
                    tolerance = 1e-5 * expected or LEAST
                    faint = Limit(-1.0, -0.5, FAINT) if 0.0 < expected < 1e-8 else None
                    row = measured(
                        picture, FAMILY, stressed, SLAB, expected, tolerance=tolerance, resolution=hard
                    )
                    row.limit = faint
                    yield row

                side = "behind" if behind else "front"
                quick = (tau, albedo) in ((10.0, 0.9), (1.0, 0.99))
                # What comes through the thickest white slab is left to the walks themselves, `thick_slabs`.
                if (tau, albedo, behind) != (1000.0, 1.0, True):
                    yield Case(f"slab {tau:g}, {albedo:g}, {side}", rows, quick=quick)
                # `auto` does not guide where it is thin. Of walks into thinner ones, few in a thousand are reflected.
                if tau in (0.1, 1.0):
                    guided = functools.partial(rows, walk="mixture")
                    yield Case(f"slab {tau:g}, {albedo:g}, {side}, mixture", guided, quick=quick)


def kappas() -> Iterator[Case]:
    """Guided walks where kappa is clamped: 1 - 2^-24 below albedo 0.115, 0.001 at albedo 1."""
    for walk in ("poe", "cp", "bono", "bill", "mixture"):
        for albedo, tau, behind in (
            (0.05, 10.0, True),
            (0.05, 1.0, False),
            (1e-4, 1.0, True),
            (1.0, 10.0, True),
        ):

            def rows(
                walk: str = walk, albedo: float = albedo, tau: float = tau, behind: bool = behind
            ) -> Iterator[Row]:
                settings = {"classicalFraction": 0.1} if walk != "mixture" else {}
                picture, expected = lit_plate(albedo, tau, behind, samples=256, walk=walk, **settings)
                kappa = "0.001" if albedo == 1.0 else "1 - 2^-24"
                stressed = f"kappa {kappa}: {walk}, albedo {albedo:g}, optical thickness {tau:g}"
                tolerance = 1e-5 * expected
                yield measured(
                    picture, FAMILY, stressed, SLAB, expected, tolerance=tolerance, resolution=0.05
                )

            # Normals of the lit side only: where light is behind, few walks find it, with weights of any size.
            if (albedo, tau) == (0.05, 10.0) and walk in ("poe", "cp"):
                continue
            yield Case(f"kappa, {walk}, albedo {albedo:g}, {tau:g}", rows, quick=walk == "mixture")


CASES = [
    case
    for family in (albedos, channels, mean_free_paths, boundaries, anisotropies, slabs, kappas)
    for case in family()
]
