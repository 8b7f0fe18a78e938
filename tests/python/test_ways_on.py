"""Paths that go on in several ways out of a diffuse boundary, and later walks that are left to a roulette.

In bodies that light finds again, where a weight that is off by 2 % shows."""

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from stability.rendering import load, run
from stability.scenes import box, camera, flipped, joined, light, medium, move, placed, sphere

EYE = camera((0, 0, 0.45), 60.0, target=(0, 0, -1))


def hollow(**lights):
    """A shell of wax, seen from within: most light has been in it more than once."""
    shell = joined(sphere(12, 1.0), flipped(sphere(12, 0.6)))
    lamp = light("sphere", move(0.25, 0.3, -0.1), 5.0, radius=0.05)
    return {"/O": shell, "/M": medium(0.97, 0.05), "/C": EYE, "/L0": lamp, **lights}


def in_a_glowing_box():
    """All light comes by the ways: what materials emit is not asked for."""
    glow = {
        "type": "Material",
        "shader": "UsdPreviewSurface",
        "diffuseColor": [0.0] * 3,
        "emissiveColor": [1.0] * 3,
        "ior": 1.0,
        "roughness": 1.0,
    }
    walls = {**box((-9, -9, -9), (9, 9, 9)), "material": "/W"}
    eye = camera((0, 0, 8), 6.0)
    return {
        "/O": sphere(16, 1.0),
        "/M": medium((0.999, 0.95, 0.9), (0.2, 0.1, 0.05)),
        "/C": eye,
        "/K": walls,
        "/W": glow,
    }


@pytest.mark.parametrize(
    ("prims", "size", "classical", "guided"),
    [(in_a_glowing_box, 16, 1024, 512), (hollow, 12, 1536, 768)],
    ids=["ways", "later walks"],
)
def test_the_mean_is_that_of_classical_walks(prims, size, classical, guided):
    plain = run(load(prims()), size, classical, seed=7, walk="classical")
    in_ways = run(load(prims()), size, guided, seed=8, walk="mixture")
    assert in_ways.stats["rays"]["path"] > 1.2 * guided / classical * plain.stats["rays"]["path"], "one way"
    for channel in range(3):
        (a, of_a), (b, of_b) = plain.mean(channel, alike=False), in_ways.mean(channel, alike=False)
        error = np.hypot(of_a, of_b)
        assert abs(a - b) < 4.0 * error
        assert error < 0.005 * a, "2 % would not be seen"


def pictures(prims, aovs, seeds, **settings):
    delegate = load(prims)
    made = []
    for seed in seeds:
        delegate.set_settings(
            camera="/C", resolution=[12, 12], seed=seed, walk="mixture", aovs=aovs, **settings
        )
        delegate.commit()
        delegate.start()
        assert delegate.wait(120.0)
        made.append(delegate.snapshot())
    return made


def test_any_number_of_threads():
    one, two = (pictures(hollow(), [], [5], samples=40, threads=threads)[0] for threads in (1, 2))
    np.testing.assert_array_equal(one["color"], two["color"])


def test_a_dim_light_has_its_own_noise():
    """What belongs to no light is shared by what lights give: 250 to 1 here."""
    dim = {"/L1": light("sphere", move(-0.3, -0.2, -0.2), 0.02, radius=0.05)}
    aovs = ["light_L0", "light_L1"]
    seen = pictures(hollow(**dim), aovs, range(5), samples=64)
    lights = {name: np.stack([picture[name][..., 1] for picture in seen]) for name in aovs}
    noise = {name: values.std(axis=0, ddof=1).mean() / values.mean() for name, values in lights.items()}
    assert noise["light_L1"] < 2.0 * noise["light_L0"]
    together = sum(picture.astype(np.float64) for picture in (seen[0]["light_L0"], seen[0]["light_L1"]))
    np.testing.assert_allclose(together, seen[0]["color"][..., :3], atol=1e-5 * seen[0]["color"].max())


def test_few_samples_make_no_fireflies():
    """Regions that saw too little of a small light that is met by chance know nothing of it."""
    prims = hollow()
    del prims["/L0"]
    prims["/K"] = {**placed(sphere(6, 0.06), move(0.25, 0.3, -0.1)), "material": "/W"}
    prims["/W"] = {**in_a_glowing_box()["/W"], "emissiveColor": [100.0] * 3}
    seen = np.stack([picture["color"][..., 1] for picture in pictures(prims, [], range(8), samples=16)])
    spread = (seen - seen.mean(axis=0)) / seen.mean()
    assert (spread**4).mean() / (spread**2).mean() ** 2 < 25.0, (
        "kurtosis: 7 without ways, 71 with weights that are not bounded"
    )
    assert seen.min() > -0.2 * seen.mean()
