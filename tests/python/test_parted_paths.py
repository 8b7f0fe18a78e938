"""What the first surface reflects is followed beside what enters a medium there: the same means."""

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from stability.rendering import load
from test_ways_on import hollow

LAYERS = ("direct", "indirect", "subsurface")
LOBES = ("directDiffuse", "indirectDiffuse", "directSpecular", "indirectSpecular", "subsurface", "emission")


def pictures(opacity, samples, seeds):
    """Surfaces that are not there for one path in a hundred thousand are not parted."""
    prims = hollow()
    prims["/M"] |= {"ior": 2.5, "roughness": 0.25, "opacity": opacity, "opacityMode": "transparent"}
    delegate = load(prims)
    for seed in seeds:
        aovs = [*LAYERS, *LOBES]
        delegate.set_settings(
            camera="/C",
            resolution=[12, 12],
            seed=seed,
            samples=samples,
            walk="mixture",
            aovs=aovs,
            sharedPaths="off",
        )
        delegate.commit()
        delegate.start()
        assert delegate.wait(120.0)
        yield delegate.snapshot(), delegate.stats()["rays"]["path"] / samples


def test_what_is_reflected_beside_a_walk():
    parted, rays = zip(*pictures(1.0, 64, range(14)), strict=True)
    whole, fewer = zip(*pictures(0.99999, 96, range(50, 64)), strict=True)
    assert min(rays) > 1.1 * max(fewer), "nothing was parted"
    for layer in LAYERS:
        a, b = (np.array([image[layer].mean() for image in images]) for images in (parted, whole))
        error = np.hypot(a.std(ddof=1), b.std(ddof=1)) / np.sqrt(len(a))
        assert abs(a.mean() - b.mean()) < 4.0 * error, layer
        assert error < 0.02 * b.mean(), f"{layer}: 8 % would not be seen"
    for image in parted:
        lobes = sum(image[lobe].astype(np.float64) for lobe in LOBES)
        np.testing.assert_allclose(lobes, image["color"][..., :3], atol=1e-4 * image["color"].max())
