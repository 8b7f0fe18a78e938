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


FOG = """
def Cube "Fog" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    double size = 40
    rel material:binding = </Mist>
}
def Material "Mist"
{
    token outputs:surface.connect = </Mist/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        color3f inputs:subsurfaceColor = (0.8, 0.8, 0.8)
        color3f inputs:subsurfaceRadius = (4, 4, 4)
        token inputs:subsurfaceBoundary = "indexMatched"
        token outputs:surface
    }
}
"""


def test_what_is_seen_through_fog_is_no_scattered_light():
    """The camera is in the fog, 5 from a quad: what passes 5 / 4 mean free paths unscattered is the quad's own."""
    glow = glowing(
        shader("C", "ND_constant_color3", f"color3f inputs:value = {GLOW}", "color3f outputs:out"),
        "C.outputs:out",
    )
    # Of the 3 x 3 pixels the one in the middle.
    middle = [1 / 3, 1 / 3, 2 / 3, 2 / 3]
    settings = {"samples": 16384, "maxDepth": 2, "dataWindowNDC": middle}
    emission, bounced, _ = layers(glow + quads(1, "") + FOG, **settings)
    np.testing.assert_allclose(emission[0, 0], np.exp(-5.0 / 4.0) * np.array(GLOW), rtol=0.06)
    assert not bounced[0, 0].any()
    lamp = 'def SphereLight "Lamp"\n{\n    float inputs:intensity = 30\n    float inputs:radius = 0.5\n'
    lamp += '    double3 xformOp:translate = (2, 0.5, 2)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    text = (
        look("color3f inputs:diffuseColor = (0.5, 0.5, 0.5)", "float inputs:roughness = 1")
        + quads(1, "")
        + lamp
    )
    image = render(text + FOG, 1, **settings | {"aovs": [*AOVS, "subsurface"]})
    clear = render(text, 1, **settings | {"aovs": AOVS})
    assert not image["emission"][0, 0].any() and (image["subsurface"][0, 0] > 0.01).all()
    # Light that reaches the quad unscattered by the way it came, its own way dimmed by 2.5 to 3.5 / 4.
    share = image["firstBounce"][0, 0] / (np.exp(-5.0 / 4.0) * clear["firstBounce"][0, 0])
    assert (np.exp(-3.6 / 4.0) < share).all() and (share < np.exp(-1.9 / 4.0)).all(), share
