"""Alpha and albedo of what is partly transparent: by opacity, whichever lobe a sample took."""

import numpy as np
import pytest

import dermis

CARD = """
    def Mesh "Card{i}" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-9, -9, {z}), (9, -9, {z}), (9, 9, {z}), (-9, 9, {z})]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Look{i}>
    }}
    def Material "Look{i}"
    {{
        token outputs:surface.connect = </World/Look{i}/Surface.outputs:surface>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.{i}, 0.2, 0.3)
            float inputs:opacity = {opacity}
            token inputs:opacityMode = "presence"
            token outputs:surface
        }}
    }}
"""
STAGE = """#usda 1.0
(
    upAxis = "Y"
)
def Xform "World"
{{
    def Camera "Eye"
    {{
        double3 xformOp:translate = (0, 0, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def DistantLight "Sun"
    {{
    }}
    {cards}
}}
"""


@pytest.mark.parametrize(
    ("opacities", "alpha"), [((1.0,), 1.0), ((0.25,), 0.25), ((0.25, 0.5), 0.625), ((0.0, 0.0), 0.0)]
)
def test_alpha_is_what_is_held_up(tmp_path, opacities, alpha):
    cards = "".join(CARD.format(i=i + 1, z=-i, opacity=opacity) for i, opacity in enumerate(opacities))
    stage = tmp_path / "cards.usda"
    stage.write_text(STAGE.format(cards=cards))
    image = dermis.render(stage, samples=16, resolution=(32, 32), camera="/World/Eye", aovs=["albedo"])
    seen = image.color[..., 3]
    # The first card holds up its share in every sample; of what is behind it is a sample's luck what it sees.
    noise = 4.0 * float(seen.std()) / 32.0 if len(opacities) == 2 else 0.0
    assert float(seen.mean()) == pytest.approx(alpha, abs=noise + 1e-5)
    if len(opacities) == 1:
        np.testing.assert_allclose(image["albedo"][..., 1], 0.2 * alpha, rtol=0.35, atol=1e-6)
