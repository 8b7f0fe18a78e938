"""Pixels that share paths through a body: same means, less noise, all layers with them.

Neighbouring pixels are not independent then, so errors are those between seeds."""

import functools

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from light_layers import LAYERS, assert_layers_sum_up
from stability.rendering import load, snapshots
from stability.scenes import (
    QUADS,
    box,
    camera,
    dome,
    flipped,
    joined,
    light,
    medium,
    move,
    placed,
    sphere,
    turn,
)

EYE = camera((0, 0, 8), 12.0)
SIZE = 16


def lit(*bodies, **lights):
    """Bodies of wax lit by a small light from behind and aside: what comes through is noisy."""
    lamp = light("sphere", move(2.0, 2.5, -3.0), 60.0, radius=0.1)
    named = {f"/O{i}": body for i, body in enumerate(bodies)}
    return {**named, "/C": EYE, "/L0": lamp, **lights}


def wax(albedo, radius):
    return lit(sphere(24, 0.8), **{"/M": medium(albedo, radius)})


def sheet():
    """One path in three crosses it without a collision."""
    return lit(box((-0.9, -0.9, -0.1), (0.9, 0.9, 0.1)), **{"/M": medium((0.9, 0.8, 0.5), 0.2)})


def two_media():
    """Neighbours of another medium have nothing to give."""
    other = {**placed(sphere(16, 0.5), move(0.55, 0.0, 0.3)), "material": "/N"}
    media = {"/M": medium((0.99, 0.9, 0.8), (0.3, 0.1, 0.05)), "/N": medium((0.5, 0.9, 0.99), 0.2)}
    return lit(placed(sphere(16, 0.5), move(-0.45, 0.0, 0.0)), other, **media)


def hollow():
    """What leaves it comes in again, and a wall within is in the way from vertex to vertex."""
    return lit(joined(sphere(16, 0.8), flipped(sphere(16, 0.6))), **{"/M": medium(0.95, 0.1)})


def open_box():
    """Half of what gets in leaks out where it has no sides."""
    slabs = box((-0.3, -0.3, -0.1), (0.3, 0.3, 0.1), faces=QUADS[4:])
    return {"/O0": slabs, "/M": medium((0.9, 0.8, 0.5), 0.2), "/C": camera((0, 0, 8), 4.0), "/L0": dome(1.0)}


def behind(absorbs):
    """Half of the picture behind a gel that takes all red, or the lower half of it in a fluid."""
    if absorbs == "gel":
        body, within = box((-0.3, -0.3, -0.1), (0.3, 0.3, 0.1)), box((0.003, -3, 2), (3, 3, 5))
        near = {"/C": camera((0, 0, 8), 4.0), "/L0": light("sphere", move(-2.0, 2.5, 3.0), 60.0, radius=1.0)}
        radius = (1e-2, 1e2, 1e2)
    else:
        body, within, near, radius = sphere(24, 0.8), box((-3, -3, -3), (3, 0, 3)), {}, (0.7, 7e3, 7e3)
    media = {"/M": medium((0.9, 0.9, 0.8), 0.2), "/G": medium(0.0, radius, "indexMatched")}
    return {**lit(body, **media), **near, "/F": {**within, "material": "/G"}}


def behind_fog():
    """Its walks have control variates of their own."""
    fog = {**box((-3, -3, 3), (3, 3, 4)), "material": "/G"}
    media = {"/M": medium((0.99, 0.9, 0.8), (0.2, 0.08, 0.04)), "/G": medium(0.9, 0.5, "indexMatched")}
    return lit(sphere(24, 0.8), **media, **{"/F": fog})


def glassy(roughness, lamp, radius=(0.4, 0.2, 0.1)):
    """Behind a dielectric, which reflects half of what gets there back in."""
    skin = medium((0.999, 0.99, 0.9), radius, "dielectric", ior=1.4, roughness=roughness)
    return {"/O0": sphere(24, 0.8), "/M": skin, "/C": EYE, "/L0": lamp}


def bulb():
    return light("sphere", move(2.0, 2.5, -3.0), 20.0, radius=0.8)


GLASSY = {
    "smooth": lambda: glassy(0.0, bulb()),
    "rough": lambda: glassy(0.5, bulb()),
    "smooth in the sun": lambda: glassy(
        0.0, light("distant", turn(1, 50.0), 30.0, angle=5.0), radius=(0.1, 0.05, 0.03)
    ),
}

SCENES = {
    "skin": lambda: wax((0.99, 0.9, 0.8), (0.2, 0.08, 0.04)),
    "clear": lambda: wax((0.95, 0.9, 0.7), 1.5),
    "one channel absorbs": lambda: wax((0.98, 0.5, 0.0), (0.2, 0.2, 0.4)),
    "dense": lambda: wax((0.999, 0.95, 0.9), (0.04, 0.02, 0.01)),
    "sheet": sheet,
    "two media": two_media,
    "hollow": hollow,
    "open box": open_box,
    "gel": lambda: behind("gel"),
    "fluid": lambda: behind("fluid"),
    "fog": behind_fog,
    **GLASSY,
}


def pictures(prims, seeds, aovs=(), **settings):
    return snapshots(prims, seeds, SIZE, aovs, **settings)


def blocks(prims, seeds, **settings):
    """Means of squares of 4 by 4 pixels by seed, row, column and channel."""
    seen = pictures(prims, seeds, **settings)
    colors = np.stack([picture["color"][..., :3].astype(np.float64) for picture in seen])
    return colors.reshape(len(seen), SIZE // 4, 4, SIZE // 4, 4, 3).mean(axis=(2, 4))


def means(prims, seeds, **settings):
    """By seed and channel."""
    return blocks(prims, seeds, **settings).mean(axis=(1, 2))


def z(a, b):
    """From values by seed."""
    error = np.hypot(a.std(0, ddof=1) / len(a) ** 0.5, b.std(0, ddof=1) / len(b) ** 0.5)
    return (a.mean(0) - b.mean(0)) / np.maximum(error, 1e-30)


@functools.cache
def unshared(scene):
    return blocks(SCENES[scene](), range(100, 124), samples=128, walk="classical", sharedPaths="off")


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("walk", ["classical", "mixture"])
def test_means_are_those_of_paths_that_nobody_shares(scene, walk):
    plain = unshared(scene)
    shared = blocks(SCENES[scene](), range(24), samples=64, walk=walk, sharedPaths="on")
    # What one pixel loses its neighbours get: by square, some 1300 numbers, t with some 40 degrees of freedom.
    lit = (plain.mean(0) > 0.0) & (plain.std(0) + shared.std(0) > 0.0)
    assert np.abs(z(plain, shared)[lit]).max() < 5.5
    plain, shared = plain.mean(axis=(1, 2)), shared.mean(axis=(1, 2))
    # 84 numbers: 4.5 is exceeded once in 200 runs.
    assert np.abs(z(plain, shared)).max() < 4.5
    error = np.hypot(plain.std(0, ddof=1), shared.std(0, ddof=1)) / len(shared) ** 0.5 / plain.mean(0)
    # What a smooth boundary refracts is noisier, in some channels.
    seen, bound = (error.min(), 0.03) if scene in GLASSY else (error[0], 0.02)
    assert seen < bound, f"{4.5 * bound:.0%} would not be seen"


def test_a_furnace_stays_white():
    """Every path brings 1 there, whoever has it."""
    prims = {
        "/O": sphere(16, 0.8),
        "/M": medium(1.0, 0.3),
        "/C": camera((0, 0, 8), 9.0),
        "/L0": dome(1.0),
    }
    seen = means(prims, range(12), samples=64, walk="classical", sharedPaths="on")
    error = seen.std(0, ddof=1) / len(seen) ** 0.5
    assert (np.abs(seen.mean(0) - 1.0) < 4.5 * error + 1e-5).all()
    assert error.max() < 2e-3


@pytest.mark.parametrize("scene", ["skin", "clear", "rough"])
def test_it_takes_noise_away(scene):
    prims = SCENES[scene]()

    def noise(word):
        seen = pictures(prims, range(8), samples=16, walk="mixture", sharedPaths=word)
        stack = np.stack([picture["color"][..., 0].astype(np.float64) for picture in seen])
        return stack.var(axis=0, ddof=1).mean()

    assert noise("on") < 0.6 * noise("off")


@pytest.mark.parametrize("scene", ["skin", "smooth", "rough"])
def test_layers_share_with_the_picture(scene):
    other = {"/L1": light("sphere", move(-2.0, 0.5, 2.0), 5.0, radius=0.2)}
    prims = {**SCENES[scene](), **other}
    for walk in ("classical", "mixture"):
        assert_layers_sum_up(pictures(prims, [3], LAYERS, samples=32, walk=walk, sharedPaths="on")[0])


def test_any_number_of_threads():
    prims = SCENES["skin"]()
    one, two = (
        pictures(prims, [5], samples=24, walk="mixture", sharedPaths="on", threads=threads)[0]
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one["color"], two["color"])


def test_who_shares_and_who_does_not():
    def why(prims, **settings):
        delegate = load(prims)
        delegate.set_settings(camera="/C", resolution=[SIZE, SIZE], samples=1, aovs=[], **settings)
        delegate.commit()
        delegate.start()
        assert delegate.wait(60.0)
        return [medium["why"] for medium in delegate.stats()["guide"]["media"]]

    shares = "neighbouring pixels share its paths"
    skin = SCENES["skin"]()
    assert all(shares in text for text in why(skin))
    assert not any(shares in text for text in why(skin, walk="mixture"))
    assert not any(shares in text for text in why(skin, sharedPaths="off"))
    assert all(shares in text for text in why(SCENES["rough"]()))
    assert not any(shares in text for text in why(skin, subsurfaceBoundary="indexMatched"))
    assert not any(shares in text for text in why({**skin, "/M": medium(0.9, 0.2, subsurfaceAnisotropy=0.5)}))
