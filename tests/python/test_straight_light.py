"""Light without a bounce and light after one, apart: `C[LO]` and `C.[LO]`."""

from __future__ import annotations

import numpy as np
import pytest
from looked_up import camera, glowing, quads, render, shader, stage_of

dermis = pytest.importorskip("dermis")

AOVS = ["emission", "firstBounce", "direct", "indirect"]
GLOW = (0.7, 0.2, 0.4)
SKY = 'def DomeLight "Sky"\n{\n    float inputs:intensity = 0.8\n    bool inputs:visibility:camera = 1\n}\n'


def look(*lines: str) -> str:
    surface = shader("S", "UsdPreviewSurface", *lines, "token outputs:surface")
    return f'def Material "Look"\n{{\n    token outputs:surface.connect = </Look/S.outputs:surface>\n{surface}}}\n'


def layers(text: str, **settings: object) -> tuple[np.ndarray, ...]:
    image = render(text, 1, **{"samples": 64, "aovs": AOVS, **settings})
    direct = image["emission"] + image["firstBounce"]
    np.testing.assert_allclose(image["direct"], direct, rtol=1e-5, atol=1e-6)
    return image["emission"], image["firstBounce"], image["color"][..., :3]


def test_a_glow_is_all_emission():
    text = glowing(
        shader("C", "ND_constant_color3", f"color3f inputs:value = {GLOW}", "color3f outputs:out"),
        "C.outputs:out",
    )
    emission, bounced, color = layers(text + quads(1, ""))
    np.testing.assert_allclose(emission, color, rtol=1e-5)
    np.testing.assert_allclose(emission[1, 1], GLOW, rtol=1e-6)
    assert not bounced.any()


def test_a_lit_surface_is_all_bounce_and_the_sky_behind_it_none():
    text = look("color3f inputs:diffuseColor = (0.5, 0.5, 0.5)") + quads(1, "") + SKY
    emission, bounced, color = layers(text, resolution=[9, 9])
    assert not emission[4, 4].any() and (bounced[4, 4] > 0.1).all()
    # Past the quad there is only sky: with the camera's square twice as wide.
    wide = text.replace(
        "point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]",
        "point3f[] points = [(0, 0, 0), (0.4, 0, 0), (0.4, 1, 0), (0, 1, 0)]",
    )
    emission, bounced, color = layers(wide, resolution=[9, 9])
    np.testing.assert_allclose(emission[4, 7], 0.8, rtol=1e-5)
    assert not bounced[4, 7].any() and not emission[4, 1].any()
    np.testing.assert_allclose(color[4, 7], emission[4, 7], rtol=1e-5)


def test_what_shines_through_counts_once():
    """Half of the sky, and the glow of the surface in front of it; what the surface reflects is a bounce."""
    text = look(
        f"color3f inputs:emissiveColor = {GLOW}",
        "color3f inputs:diffuseColor = (0.5, 0.5, 0.5)",
        'token inputs:opacityMode = "presence"',
        "float inputs:opacity = 0.5",
    )
    emission, bounced, _ = layers(text + quads(1, "") + SKY, samples=4096)
    np.testing.assert_allclose(emission[1, 1], 0.5 * np.array(GLOW) + 0.5 * 0.8, rtol=0.02)
    assert (bounced[1, 1] > 0.05).all()


def test_other_layers_do_not_change():
    text = look("color3f inputs:diffuseColor = (0.5, 0.5, 0.5)") + quads(1, "") + SKY
    settings = {"camera": "/Eye", "resolution": [9, 9], "samples": 4}
    with_them = dermis.render(stage_of(text + camera(1)), aovs=["albedo", *AOVS], **settings)
    without = dermis.render(stage_of(text + camera(1)), aovs=["albedo"], **settings)
    assert all(np.array_equal(with_them[name], without[name]) for name in ("color", "albedo"))
