"""The four shared stages render in every look, and the looks that describe one medium agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

dermis = pytest.importorskip("dermis")

SCENES = Path(__file__).parents[2] / ".." / "shared" / "scenes"
STAGES = ["backlit_bunny", "card_skull", "creature_spot", "envmap_dragon"]
PRODUCTION = ["preview_surface", "openpbr", "standard_surface"]

pytestmark = pytest.mark.skipif(
    not SCENES.is_dir(), reason=f"{SCENES} is absent: shared stages are not tested"
)


def stage_in_look(name: str, look: str) -> Usd.Stage:
    stage = Usd.Stage.Open(str(SCENES / f"{name}.usda"))
    assert stage.GetPrimAtPath("/World").GetVariantSet("look").SetVariantSelection(look)
    return stage


def looks(name: str) -> list[str]:
    stage = Usd.Stage.Open(str(SCENES / f"{name}.usda"))
    return stage.GetPrimAtPath("/World").GetVariantSet("look").GetVariantNames()


def render(name: str, look: str, samples: int, seed: int, **settings: object) -> dermis.Image:
    return dermis.render(
        stage_in_look(name, look),
        resolution=[48, 48],
        samples=samples,
        seed=seed,
        aovs=["variance"],
        **settings,
    )


@pytest.mark.parametrize("name", STAGES)
def test_every_look_renders(name: str) -> None:
    for look in looks(name):
        image = render(name, look, samples=4, seed=1)
        assert np.isfinite(image.color).all()
        assert image.color[..., :3].max() > 0.01, look
        assert image.stats["non_finite_samples"] == 0
        assert image.stats["walks"] > 0, look
        assert image.stats["walks_leaked"] <= 1e-4 * image.stats["walks"], look


@pytest.mark.parametrize("name", STAGES)
def test_production_looks_agree(name: str) -> None:
    """preview, openpbr and standard_surface are one medium under one specular lobe: same picture within noise.

    Block means over 8x8 pixels, variances from the AOV; 36 blocks x 3 channels x 2 pairs are 216 z-scores.
    """
    images = [
        render(name, look, samples=48, seed=seed, subsurfaceBoundary="diffuse")
        for seed, look in enumerate(PRODUCTION)
    ]
    blocks = [(block_sum(image.color[..., :3]), block_sum(image["variance"])) for image in images]
    for look, (total, variance) in zip(PRODUCTION[1:], blocks[1:], strict=True):
        z = (total - blocks[0][0]) / np.sqrt(variance + blocks[0][1] + 1e-12)
        assert np.abs(z).max() < 5.5, f"{look} against preview_surface: worst block |z| {np.abs(z).max():.1f}"
        ratio = total.sum((0, 1)) / blocks[0][0].sum((0, 1))
        error = np.sqrt((variance + blocks[0][1]).sum((0, 1))) / total.sum((0, 1))
        assert error.max() < 0.03, f"{look}: the whole picture is too noisy to compare: {error}"
        assert (np.abs(ratio - 1) < 4 * error).all(), (
            f"{look} / preview_surface, whole picture: {ratio} +- {error}"
        )


def block_sum(image: np.ndarray) -> np.ndarray:
    height, width, channels = image.shape
    return image.reshape(height // 8, 8, width // 8, 8, channels).sum((1, 3))
