"""`pixelFilterMode`: samples for their own pixel alone, or for all under whose filter they lie: less noise."""

import functools

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from light_layers import LAYERS, assert_layers_sum_up
from stability.rendering import snapshots
from stability.scenes import camera, dome, light, medium, move, sphere

SIZE = 40
"""Three tiles across, the last of 8 pixels."""


def ball():
    """Its silhouette, a shadow line and light that comes through."""
    return {
        "/O": sphere(24, 0.8),
        "/M": medium((0.99, 0.9, 0.8), 0.1),
        "/C": camera((0, 0, 8), 12.0),
        "/L0": light("sphere", move(2.0, 2.5, -3.0), 60.0, radius=0.4),
        "/L1": light("sphere", move(-2.0, 0.5, 2.0), 5.0, radius=0.2),
    }


def pictures(prims, seeds, aovs=(), **settings):
    return snapshots(prims, seeds, SIZE, aovs, **{"walk": "classical", **settings})


def colors(prims, seeds, **settings):
    """By seed, row, column and channel: of alpha, too."""
    return np.stack([picture["color"].astype(np.float64) for picture in pictures(prims, seeds, **settings)])


@functools.cache
def balls(mode, samples, seeds, crop=(0.0, 0.0, 1.0, 1.0), **settings):
    more = {"pixelFilterMode": mode, "dataWindowNDC": list(crop), **settings}
    return colors(ball(), range(seeds), samples=samples, **more)


CROP = (0.05, 0.3, 0.37, 0.5)
"""13 by 8 pixels of the silhouette: no sample lies in what is beyond, but those of its pixels that reach there."""


def compare(own, spread):
    """z of the means by pixel and channel, and their relative error."""
    error = np.hypot(own.std(0, ddof=1), spread.std(0, ddof=1)) / len(own) ** 0.5
    alpha = own[..., 3].mean(0)
    assert np.abs(alpha - spread[..., 3].mean(0)).max() < 5.0 * error[..., 3].max() + 1e-3
    # A pixel's own samples seldom find what its filter barely reaches: their mean is then no normal variable.
    there = (alpha > 0.25)[..., None] & (error[..., :3] > 1e-6)
    own, spread, error = (values[..., :3][there] for values in (own.mean(0), spread.mean(0), error))
    return (own - spread) / error, error / own


@pytest.mark.parametrize("crop", [(0.0, 0.0, 1.0, 1.0), CROP], ids=["whole", "crop"])
def test_each_pixel_has_the_same_mean(crop):
    z, error = compare(balls("importance", 64, 32, crop=crop), balls("weighted", 64, 32, crop=crop))
    # Some 3000 numbers, t with some 60 degrees of freedom, of neighbours not independent.
    assert np.abs(z).max() < 5.5 and (z**2).mean() < 1.35
    assert np.median(error) < 0.05


def test_it_takes_noise_away():
    """Of 1 / (the integral of the squared filter) = 2.25 samples, where all have the same variance."""
    own, spread = (balls(mode, 64, 32).var(0, ddof=1) for mode in ("importance", "weighted"))
    lit = balls("importance", 64, 32)[..., 3].mean(0) > 0.999
    assert 1.7 < own[lit].mean() / spread[lit].mean() < 2.6


def test_variance_is_that_between_seeds():
    made = pictures(ball(), range(32), ["variance"], samples=64, pixelFilterMode="weighted")
    said = np.mean([picture["variance"].astype(np.float64) for picture in made], axis=0)
    seen = np.var([picture["color"][..., :3].astype(np.float64) for picture in made], axis=0, ddof=1)
    inner = slice(8, -8), slice(8, -8)
    # Sobol numbers do better than the independent ones that the estimate takes them for.
    assert 0.8 < said[inner].sum() / seen[inner].sum() < 1.6


def test_what_is_even_stays_even():
    """The sum of a pixel's shares is not the number of its samples; the mean is by the sum."""
    prims = {
        "/O": sphere(16, 0.8),
        "/M": medium(0.0, 0.3),
        "/C": camera((0, 0, 8), 30.0),
        "/L0": dome(1.0),
    }
    image = colors(prims, [3], samples=3, pixelFilterMode="weighted", lightsVisibleToCamera=True)[0]
    np.testing.assert_allclose(image[0], 1.0, rtol=1e-6)  # the sky, far from the ball


def test_layers_go_with_the_picture():
    seen = pictures(ball(), [3], [*LAYERS, "alpha"], samples=16, pixelFilterMode="weighted")[0]
    assert_layers_sum_up(seen)
    np.testing.assert_array_equal(seen["alpha"].squeeze(), seen["color"][..., 3])


def test_any_number_of_threads():
    one, two = (
        colors(ball(), [5], samples=24, walk="auto", pixelFilterMode="weighted", threads=threads)[0]
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one, two)


def test_tiles_of_few_samples_count_as_much():
    """Where a noise threshold gives them other numbers of samples, each is still worth its area."""
    settings = {"samples": 128, "noiseThreshold": 0.15}
    spread = colors(ball(), range(100, 132), pixelFilterMode="weighted", **settings)
    z, _ = compare(balls("importance", 64, 32), spread)
    assert np.abs(z).max() < 5.5 and (z**2).mean() < 1.35
