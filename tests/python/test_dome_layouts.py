"""Layouts of dome images: painted by direction, they come back as the latlong image of those directions."""

import numpy as np
import pytest
from conftest import stage_of
from pinhole import rays
from pxr import Usd

import dermis
from dermis.dome_layout import LAYOUTS, to_latlong

oiio = pytest.importorskip("OpenImageIO")


def painted(direction: np.ndarray) -> np.ndarray:
    """Smooth, and no turn or mirror image of itself. `direction`: dome space, unit."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([2.0 + x + 0.5 * y, 2.0 + y * z + 0.3 * x, 2.0 + z - 0.4 * x * y], axis=-1)


def disk_image(size: int, layout: str) -> np.ndarray:
    c = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    right, down = np.meshgrid(c, c)
    radius = np.hypot(right, down)
    angle = np.pi * radius if layout == "angular" else 2.0 * np.arcsin(np.minimum(radius, 1.0))
    across = np.sin(angle) / np.maximum(radius, 1e-9)
    # Seen from within, with +Y up, looking along +Z: right is -X.
    return painted(np.stack([-right * across, -down * across, np.cos(angle)], axis=-1))


FACES = {
    # Cell (column, row): what is ahead, to the right and up on the face, in dome space.
    (1, 1): ((0, 0, 1), (-1, 0, 0), (0, 1, 0)),
    (2, 1): ((-1, 0, 0), (0, 0, -1), (0, 1, 0)),
    (0, 1): ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    (1, 0): ((0, 1, 0), (-1, 0, 0), (0, 0, -1)),
    (1, 2): ((0, -1, 0), (-1, 0, 0), (0, 0, 1)),
    (1, 3): ((0, 0, -1), (-1, 0, 0), (0, -1, 0)),
}


def cross_image(size: int) -> np.ndarray:
    image = np.zeros((4 * size, 3 * size, 3))
    c = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    s, t = np.meshgrid(c, -c)
    for (column, row), axes in FACES.items():
        ahead, right, up = np.array(axes, float)
        direction = ahead + s[..., None] * right + t[..., None] * up
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        image[row * size : (row + 1) * size, column * size : (column + 1) * size] = painted(direction)
    return image


def image_of(layout: str, size: int) -> np.ndarray:
    return cross_image(size // 2) if layout == "cubeMapVerticalCross" else disk_image(size, layout)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_directions_come_back(layout):
    latlong = to_latlong(image_of(layout, 128), layout)
    rows, columns = latlong.shape[:2]
    assert columns == 2 * rows
    lat = np.pi / 2.0 - (np.arange(rows) + 0.5) * np.pi / rows
    lon = np.pi - (np.arange(columns) + 0.5) * 2.0 * np.pi / columns
    lat, lon = np.meshgrid(lat, lon, indexing="ij")
    expected = painted(np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], axis=-1))
    error = np.abs(latlong - expected)
    # Behind, a ball and an angular map have all directions on their rim.
    behind = np.cos(lat) * np.cos(lon) < -0.9
    assert error[~behind].max() < 0.06 and error.mean() < 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_dome_lights_by_its_layout(layout, tmp_path):
    """A floor below the dome: irradiance by quadrature of what was painted."""
    pixels = image_of(layout, 64).astype(np.float32)
    out = oiio.ImageOutput.create(str(tmp_path / "dome.exr"))
    out.open(str(tmp_path / "dome.exr"), oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float"))
    out.write_image(pixels)
    out.close()
    stage = stage_of(f"""
def DomeLight "Sky"
{{
    asset inputs:texture:file = @{tmp_path / "dome.exr"}@
    token inputs:texture:format = "{layout}"
}}
def Mesh "Wall"
{{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)]
    color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]
    uniform token subdivisionScheme = "none"
    rel material:binding = </Matte>
}}
def Material "Matte"
{{
    token outputs:mtlx:surface.connect = </Matte/S.outputs:out>
    def Shader "S"
    {{
        uniform token info:id = "ND_open_pbr_surface_surfaceshader"
        color3f inputs:base_color = (0.5, 0.5, 0.5)
        float inputs:specular_weight = 0
        token outputs:out
    }}
}}
def Camera "Cam"
{{
    double3 xformOp:translate = (0, 0, 20)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
""")
    image = dermis.render(stage, resolution=(8, 8), samples=256, camera="/Cam", aovs=[], maxDepth=0)
    assert image.stats["warnings"] == []
    # Facing +Z: integral of cos times painted over that half.
    theta, phi = np.meshgrid((np.arange(200) + 0.5) * np.pi / 400, (np.arange(400) + 0.5) * np.pi / 200)
    d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    weight = (np.cos(theta) * np.sin(theta))[..., None]
    expected = 0.5 * (painted(d) * weight).sum((0, 1)) / weight.sum()
    assert np.allclose(image.color[..., :3].mean((0, 1)), expected, rtol=0.01)


@pytest.mark.parametrize("layout", ["latlong", *LAYOUTS])
def test_our_stage(layout, usd_scenes, monkeypatch):
    """The sky that its images were painted with: in the mirror, and by quadrature on the matte ball."""
    monkeypatch.syspath_prepend(usd_scenes)
    from dome_scene import sky

    stage = Usd.Stage.Open(str(usd_scenes / "dome_layouts.usda"))
    assert stage.GetPrimAtPath("/World").GetVariantSet("layout").SetVariantSelection(layout)
    image = dermis.render(stage, resolution=(60, 30), samples=64, maxDepth=1, aovs=[])
    assert image.stats["warnings"] == []
    color, sight = image.color[..., :3].astype(float), rays((60, 30), 40, 24, (0, 0, 9))
    # About the middle, where neither ball sees much of the other.
    mirror = sight.sphere(np.array([-1.3, 0, 0]), 1.1)
    there = ((np.abs(mirror[..., 0] + 1.3) < 0.35) & (np.abs(mirror[..., 1]) < 0.8)).all(0)
    normal = (mirror[:, there] - [-1.3, 0, 0]) / 1.1
    d = sight.d[:, there]
    expected = sight.mean(sky(d - 2 * (d * normal).sum(-1, keepdims=True) * normal))
    # The images are coarse: a pixel is 3 to 5 degrees.
    assert there.sum() > 60 and np.allclose(color[there].mean(0), expected.mean(0), rtol=0.015)
    assert np.median(np.abs(color[there] / expected - 1)) < 0.04
    matte = sight.sphere(np.array([1.3, 0, 0]), 1.1)
    there = ((np.abs(matte[..., 0] - 1.3) < 0.3) & (np.abs(matte[..., 1]) < 0.8)).all(0)
    theta, phi = np.meshgrid((np.arange(90) + 0.5) * np.pi / 90, (np.arange(180) + 0.5) * np.pi / 90)
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    received = sky(d) * np.sin(theta).reshape(-1, 1) * (np.pi / 90) ** 2
    normal = (sight.mean(matte[:, there]) - [1.3, 0, 0]) / 1.1
    expected = 0.5 / np.pi * np.clip(normal @ d.T, 0, None) @ received
    assert np.allclose(color[there].mean(0), expected.mean(0), rtol=0.015)
