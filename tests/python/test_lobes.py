"""Light by the lobe of the first surface, and lights that shine on some lobes more than on others."""

import math

import numpy as np
import pytest
from command_line import channels, run
from looked_up import quads, shader, stage_of

import dermis

CELLS = ["emission", "directDiffuse", "indirectDiffuse", "directSpecular", "indirectSpecular"]
CELLS += ["directTransmission", "indirectTransmission", "subsurface"]

#: Straight down on a spot so small that everything is the same over it.
EYE = """
def Camera "Eye"
{
    token projection = "orthographic"
    float2 clippingRange = (0.1, 100)
    float horizontalAperture = 0.1
    float verticalAperture = 0.1
    double3 xformOp:translate = (0.5, 0.5, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
BLOCK = """
def Cube "Block" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    double size = 1
    rel material:binding = </Look>
    double3 xformOp:translate = (0.5, 0.5, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def preview(*lines: str) -> str:
    surface = shader("S", "UsdPreviewSurface", *lines, "token outputs:out")
    return (
        f'def Material "Look"\n{{\n    token outputs:surface.connect = </Look/S.outputs:out>\n{surface}}}\n'
    )


def open_pbr(*lines: str) -> str:
    return (
        preview(*lines)
        .replace("UsdPreviewSurface", "ND_open_pbr_surface_surfaceshader")
        .replace("outputs:surface", "outputs:mtlx:surface")
    )


def lamp(kind: str, *lines: str) -> str:
    """Above the middle of the quad, shining down on it."""
    size = {
        "RectLight": "float inputs:width = 4\n float inputs:height = 4\n float inputs:intensity = 3",
        "SphereLight": "float inputs:radius = 0.6\n float inputs:intensity = 8",
        "DistantLight": "float inputs:angle = 40\n float inputs:intensity = 2",
        "DomeLight": "float inputs:intensity = 0.7",
        "Mesh": "int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 3, 2, 1]\n"
        "point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]\n"
        'uniform token subdivisionScheme = "none"\n float inputs:intensity = 5',
    }[kind]
    schemas = '(prepend apiSchemas = ["MeshLightAPI"])' if kind == "Mesh" else ""
    body = "\n".join(lines)
    # Above the camera, which must not see the mesh.
    return f"""
def {kind} "Lamp" {schemas}
{{
    {size}
    {body}
    double3 xformOp:translate = (0.5, 0.5, {6 if kind == "Mesh" else 2})
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""


KINDS = ["RectLight", "SphereLight", "DistantLight", "DomeLight", "Mesh"]


def factors(diffuse: float, specular: float) -> tuple[str, str]:
    return f"float inputs:diffuse = {diffuse}", f"float inputs:specular = {specular}"


def rendered(*text: str, aovs: tuple[str, ...] = (), **settings: object) -> dermis.Image:
    settings = {"resolution": [4, 4], "samples": 64, "camera": "/Eye", **settings}
    return dermis.render(stage_of("".join(text) + EYE), aovs=["variance", *aovs], **settings)


def mean(values: np.ndarray) -> np.ndarray:
    return values[..., :3].astype(float).mean((0, 1))


def error(image: dermis.Image) -> np.ndarray:
    """Standard error of the mean of all pixels."""
    variance = image["variance"].astype(float)
    return np.sqrt(variance.sum((0, 1))) / variance[..., 0].size


def assert_parts(image: dermis.Image) -> None:
    color = image.color[..., :3].astype(float)
    total = sum(image[cell].astype(float) for cell in CELLS)
    np.testing.assert_allclose(total, color, rtol=1e-4, atol=1e-5 * color.max())


MIXED = (
    "float inputs:roughness = 0.35",
    "float inputs:clearcoat = 0.8",
    "float inputs:clearcoatRoughness = 0.15",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_light_shines_on_each_lobe_by_its_factor(kind):
    """The same samples with other factors are other sums of the same layers, whichever sampler found the light."""
    look = preview("color3f inputs:diffuseColor = (0.6, 0.3, 0.1)", *MIXED) + quads(1, "")
    plain = rendered(look, lamp(kind), aovs=("diffuse", "specular"))
    diffuse, specular = (plain[name].astype(float) for name in ("diffuse", "specular"))
    assert mean(diffuse).min() > 0.0 and mean(specular).min() > 0.0
    for factor_d, factor_s in ((0.0, 1.0), (1.0, 0.0), (0.3, 2.0)):
        image = rendered(look, lamp(kind, *factors(factor_d, factor_s)), aovs=("diffuse", "specular"))
        expected = factor_d * diffuse + factor_s * specular
        np.testing.assert_allclose(image.color[..., :3], expected, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(image["diffuse"], factor_d * diffuse, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_layers_are_images_of_their_lobes(kind):
    """Against images of surfaces that have one of the lobes alone, other random numbers, z-scores."""
    look = preview("color3f inputs:diffuseColor = (0.6, 0.3, 0.1)", *MIXED) + quads(1, "") + lamp(kind)
    black = preview("color3f inputs:diffuseColor = (0, 0, 0)", *MIXED) + quads(1, "") + lamp(kind)
    settings = {"samples": 1024}
    whole = rendered(look, aovs=("diffuse", "specular"), seed=1, **settings)
    shiny, other = rendered(black, seed=2, **settings), rendered(look, seed=3, **settings)
    # Twice the error of the whole bounds that of a layer of it.
    wide = np.hypot(error(shiny), error(whole))
    z = (mean(whole["specular"]) - mean(shiny.color)) / wide
    assert (np.abs(z) < 4.0).all(), z
    assert (wide < 0.05 * mean(shiny.color)).all()
    z = (mean(whole["diffuse"]) - mean(other.color) + mean(shiny.color)) / np.hypot(wide, error(other))
    assert (np.abs(z) < 4.0).all(), z


def test_half_of_a_rect_light_on_lambert():
    """By the form factor of a rectangle over the middle of which one stands (Modest, Radiative Heat Transfer, C-11)."""
    look = open_pbr("color3f inputs:base_color = (0.5, 0.25, 0.1)", "float inputs:specular_weight = 0")
    image = rendered(look + quads(1, ""), lamp("RectLight", *factors(0.5, 7.0)), samples=4096)
    # Half the side over the height.
    a = 1.0
    root = math.sqrt(1.0 + a * a)
    form_factor = 4.0 / (2.0 * math.pi) * 2.0 * a / root * math.atan(a / root)
    expected = 0.5 * 3.0 * form_factor * np.array([0.5, 0.25, 0.1])
    assert (np.abs(mean(image.color) - expected) < 4.0 * error(image) + 1e-5).all()
    assert (error(image) < 0.005 * expected).all()


@pytest.mark.parametrize("kind", ["RectLight", "DomeLight"])
def test_a_mirror_shows_a_quarter(kind):
    look = preview(
        "color3f inputs:diffuseColor = (0.9, 0.5, 0.3)",
        "float inputs:metallic = 1",
        "float inputs:roughness = 0",
    )
    image = rendered(look + quads(1, ""), lamp(kind, *factors(0.0, 0.25)), samples=4, aovs=tuple(CELLS))
    radiance = {"RectLight": 3.0, "DomeLight": 0.7}[kind]
    np.testing.assert_allclose(mean(image.color), 0.25 * radiance * np.array([0.9, 0.5, 0.3]), rtol=1e-3)
    np.testing.assert_array_equal(image["directSpecular"], image.color[..., :3])
    # Seen straight, a light is what it is.
    seen = rendered(lamp(kind, *factors(0.0, 0.25), "bool inputs:visibility:camera = 1"), aovs=tuple(CELLS))
    if kind == "DomeLight":
        np.testing.assert_allclose(mean(seen["emission"]), radiance, rtol=1e-4)


@pytest.mark.parametrize("roughness", [0.0, 0.3])
def test_glass_is_specular_and_transmission(roughness):
    """A block that absorbs nothing, in a white sky of factor 2 for what is specular: white of 2."""
    look = open_pbr(
        "float inputs:transmission_weight = 1",
        "float inputs:specular_ior = 1.5",
        f"float inputs:specular_roughness = {roughness}",
    )
    sky = lamp("DomeLight", *factors(0.0, 2.0), "bool inputs:visibility:camera = 1")
    image = rendered(look + BLOCK, sky, samples=1024, aovs=(*CELLS, "transmission", "specular"))
    assert_parts(image)
    white = 2.0 * 0.7
    # Paths end after some bounces inside.
    assert (np.abs(mean(image.color) - white) < 4.0 * error(image) + 0.01 * white).all()
    assert not image["emission"].any() and not image["directDiffuse"].any()
    if roughness == 0.0:
        # Fresnel at normal incidence.
        reflected = image["directSpecular"].astype(float)
        sigma = white * math.sqrt(0.04 * 0.96 / (1024 * 16))
        assert abs(reflected[..., 0].mean() - 0.04 * white) < 4.0 * sigma
        assert not image["indirectSpecular"].any()
    assert (mean(image["transmission"]) > 0.8 * white).all()


@pytest.mark.parametrize("boundary", ["diffuse", "dielectric", "indexMatched"])
@pytest.mark.parametrize("kind", ["RectLight", "DomeLight"])
def test_media_answer_as_what_is_diffuse(boundary, kind):
    look = preview(
        "float inputs:subsurface = 1",
        "color3f inputs:subsurfaceColor = (0.8, 0.6, 0.4)",
        "color3f inputs:subsurfaceRadius = (0.3, 0.2, 0.1)",
        f'token inputs:subsurfaceBoundary = "{boundary}"',
        "float inputs:roughness = 0.3",
    )
    settings = {"walk": "classical", "samples": 128, "aovs": tuple(CELLS)}
    plain = rendered(look + BLOCK, lamp(kind), **settings)
    assert_parts(plain)
    # What comes out unscattered is transmission to the layers, and comes out of a medium to the light.
    out = ("subsurface", "directTransmission", "indirectTransmission")
    inside = sum(plain[name].astype(float) for name in out)
    image = rendered(look + BLOCK, lamp(kind, *factors(0.5, 0.0)), **settings)
    np.testing.assert_allclose(image.color[..., :3], 0.5 * inside, rtol=1e-3, atol=1e-5)
    assert mean(inside).min() > 0.0
    if boundary == "indexMatched":
        seen = plain["subsurface"] + plain["emission"]
        np.testing.assert_allclose(seen, plain.color[..., :3], rtol=1e-5)


@pytest.mark.parametrize("boundary", ["diffuse", "dielectric", "indexMatched"])
def test_control_variates_are_in_the_layers(boundary):
    look = preview(
        "float inputs:subsurface = 1",
        "color3f inputs:subsurfaceColor = (0.8, 0.6, 0.4)",
        "color3f inputs:subsurfaceRadius = (0.03, 0.02, 0.01)",
        f'token inputs:subsurfaceBoundary = "{boundary}"',
        "float inputs:roughness = 0.3",
    )
    settings = {"walk": "mixture", "samples": 256, "aovs": tuple(CELLS)}
    image = rendered(look + BLOCK, lamp("RectLight"), **settings)
    assert image.stats["guide"]["control_regions"] > 0
    assert mean(image["subsurface"].astype(float)).min() > 0.0
    assert_parts(image)


def test_guided_walks_and_small_lights():
    """What is learned of a dimmed light is another thing: z-scores; smooth dielectrics are connected to."""
    for boundary in ("diffuse", "dielectric"):
        look = preview(
            "float inputs:subsurface = 1",
            "color3f inputs:subsurfaceColor = (0.8, 0.6, 0.4)",
            "color3f inputs:subsurfaceRadius = (0.3, 0.2, 0.1)",
            f'token inputs:subsurfaceBoundary = "{boundary}"',
            "float inputs:roughness = 0",
        )
        small = (
            lamp("SphereLight").replace("0.6", "0.2"),
            lamp("SphereLight", *factors(0.25, 9.0)).replace("0.6", "0.2"),
        )
        settings = {"samples": 4096, "aovs": ("subsurface",), "refractedLight": "on", "sharedPaths": "off"}
        plain, dim = (rendered(look + BLOCK, text, seed=i, **settings) for i, text in enumerate(small))
        # All pixels see the same: their scatter is the noise of the layer, which the beauty's says nothing of.
        scatter = [image["subsurface"].reshape(-1, 3).std(0, ddof=1) / 4.0 for image in (plain, dim)]
        wide = np.hypot(0.25 * scatter[0], scatter[1])
        z = (mean(dim["subsurface"]) - 0.25 * mean(plain["subsurface"])) / wide
        assert (np.abs(z) < 4.0).all(), (boundary, z)
        assert (wide < 0.05 * mean(dim["subsurface"])).all()


HAIR = """
def Material "Look"
{
    token outputs:mtlx:surface.connect = </Look/S.outputs:out>
    def Shader "B"
    {
        uniform token info:id = "ND_chiang_hair_bsdf"
        token outputs:out
    }
    def Shader "S"
    {
        uniform token info:id = "ND_surface"
        token inputs:bsdf.connect = </Look/B.outputs:out>
        token outputs:out
    }
}
def BasisCurves "Strand" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    int[] curveVertexCounts = [2]
    point3f[] points = [(-1, 0.5, 0), (2, 0.5, 0)]
    uniform token type = "linear"
    float[] widths = [0.5, 0.5]
    rel material:binding = </Look>
}
"""


def test_hair_is_specular():
    plain = rendered(HAIR, lamp("DomeLight"), aovs=tuple(CELLS))
    assert mean(plain["directSpecular"]).min() > 0.0
    np.testing.assert_allclose(
        plain["directSpecular"] + plain["indirectSpecular"], plain.color[..., :3], rtol=1e-5
    )
    dim = rendered(HAIR, lamp("DomeLight", *factors(0.0, 0.5)))
    np.testing.assert_allclose(dim.color[..., :3], 0.5 * plain.color[..., :3], rtol=1e-4)


def test_groups_show_what_is_taken():
    look = preview("color3f inputs:diffuseColor = (0.6, 0.3, 0.1)", *MIXED) + quads(1, "")
    two = lamp("RectLight", *factors(0.5, 0.0)) + lamp("SphereLight", *factors(0.0, 2.0)).replace(
        "Lamp", "Other"
    )
    image = rendered(look, two, aovs=("light_Lamp", "light_Other", "diffuse", "specular"))
    np.testing.assert_allclose(image["light_Lamp"], image["diffuse"], rtol=1e-4)
    np.testing.assert_allclose(image["light_Other"], image["specular"], rtol=1e-4)


def test_explain_says_which_lights_tell_lobes_apart(tmp_path, capsys):
    for lines, said in (
        ((), "every light is the same to all lobes"),
        (factors(1.0, 0.5), "1 lights with inputs:"),
    ):
        stage = stage_of(
            quads(1, "") + lamp("RectLight", *lines) + lamp("DomeLight").replace("Lamp", "Sky") + EYE
        )
        stage.Export(str(tmp_path / "lights.usda"))
        assert run("explain", tmp_path / "lights.usda") == 0
        assert f"  lights by lobe: {said}" in capsys.readouterr().out


def test_values_that_are_none_are_said():
    image = rendered(quads(1, ""), lamp("RectLight", "float inputs:specular = -2"), samples=1)
    assert any("inputs:specular" in warning["message"] for warning in image.stats["warnings"])


def test_our_stage(usd_scenes, tmp_path):
    """Its layers are its beauty, which is that of a render without them."""
    stage, flags = usd_scenes / "render_layers.usda", ("-w", "96", "--samples", "16")
    assert run("record", stage, tmp_path / "layers.exr", *flags) == 0
    found = channels(tmp_path / "layers.exr")
    for channel in "RGB":
        layers = [values for name, values in found.items() if name.endswith(f".{channel}")]
        assert len(layers) == 7 and all(values.max() > 0.0 for values in layers)
        beauty = found[channel]
        total = np.sum(layers, axis=0, dtype=float)
        np.testing.assert_allclose(total, beauty, rtol=1e-4, atol=1e-5 * beauty.max())
    more = [word for aov in ("direct", "indirect", "firstBounce") for word in ("--aov", aov)]
    assert run("record", stage, tmp_path / "plain.exr", *flags, *more) == 0
    plain = channels(tmp_path / "plain.exr")
    np.testing.assert_array_equal(plain["R"], found["R"])
    sums = [
        word for aov in ("direct+subsurface", "transmission", "diffuse+specular") for word in ("--aov", aov)
    ]
    assert run("record", stage, tmp_path / "sums.exr", *flags, *sums) == 0
    sums = channels(tmp_path / "sums.exr")
    expected = plain["direct.G"] + found["subsurface.G"]
    np.testing.assert_allclose(sums["direct+subsurface.G"], expected, rtol=1e-4, atol=1e-6)
    bounces = found["directDiffuse.G"] + found["directSpecular.G"]
    np.testing.assert_allclose(plain["firstBounce.G"], bounces, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(sums["transmission.G"], found["transmission.G"])


def test_sums_that_count_twice_are_refused(usd_scenes, tmp_path):
    stage = usd_scenes / "render_layers.usda"
    assert run("record", stage, tmp_path / "a.exr", "--aov", "diffuse+directDiffuse") == 2


def test_checkpoints_keep_layers(usd_scenes, tmp_path):
    flags = ("-w", "48", "--samples", "8", "--aov", "specular")
    stage = usd_scenes / "render_layers.usda"
    assert run("record", stage, tmp_path / "a.exr", *flags) == 0
    assert run("record", stage, tmp_path / "b.exr", *flags, "--checkpoint", "0.001", "--resume") == 0
    a, b = channels(tmp_path / "a.exr"), channels(tmp_path / "b.exr")
    assert all(np.array_equal(a[name], b[name]) for name in a)
