"""AOVs of light groups and of single lights: together they are the image, each is what its lights give."""

import numpy as np
import pytest
from command_line import CAMERA, CARD, channels, run, stage_text, write_stage
from pinhole import rays
from pxr import Sdf, Usd

import dermis
from dermis.stage import flatten


def opened(text: str) -> Usd.Stage:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(text)
    return Usd.Stage.Open(layer)


def lamp(name: str, x: float, group: str = "", kind: str = "SphereLight", lines: str = "") -> str:
    label = f'string dermis:lightGroup = "{group}"' if group else ""
    return f"""
    def {kind} "{name}"
    {{
        float inputs:intensity = 20
        float inputs:radius = 0.4
        {label}
        {lines}
        double3 xformOp:translate = ({x}, 2.5, 3)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
"""


KEYS = lamp("KeyA", -2.5, "key") + lamp("KeyB", 2.5, "key", lines="color3f inputs:color = (1, 0.5, 0.2)")
FILL = lamp("Fill", 0, "fill", "DomeLight", "color3f inputs:color = (0.01, 0.02, 0.04)")
RIM = lamp("Rim", 0.5, lines="color3f inputs:color = (0.1, 1, 0.1)")

GLOW = """
    def Sphere "Glow" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {
        double radius = 0.3
        rel material:binding = </World/Hot>
        double3 xformOp:translate = (1.2, -1, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Material "Hot"
    {
        token outputs:surface.connect = </World/Hot/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:emissiveColor = (3, 2, 1)
            token outputs:surface
        }
    }
"""


def ball(boundary: str) -> str:
    return f"""
    def Sphere "Ball" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        double radius = 1
        rel material:binding = </World/Wax>
        double3 xformOp:translate = (0, 0, 1.1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Material "Wax"
    {{
        token outputs:surface.connect = </World/Wax/Surface.outputs:surface>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            color3f inputs:subsurfaceColor = (0.8, 0.6, 0.5)
            color3f inputs:subsurfaceRadius = (0.2, 0.1, 0.05)
            token inputs:subsurfaceBoundary = "{boundary}"
            float inputs:roughness = 0
            token outputs:surface
        }}
    }}
"""


def rendered(*prims: str, aovs: list[str], samples: int = 32, **settings: object) -> dermis.Image:
    stage = opened(stage_text(CAMERA, CARD, *prims))
    settings = {"resolution": (24, 24), "samples": samples, "camera": "/World/main_cam", **settings}
    return dermis.render(stage, aovs=aovs, **settings)


ALL = ["light_key", "light_fill", "light_default"]


@pytest.mark.parametrize("boundary", ["diffuse", "dielectric", "indexMatched"])
def test_groups_are_the_image(boundary):
    """Control variates and signed estimates included; asking for them changes nothing of the beauty."""
    prims = (KEYS, FILL, RIM, GLOW, ball(boundary))
    image = rendered(*prims, aovs=ALL)
    color = image.color[..., :3].astype(float)
    total = sum(image[name].astype(float) for name in ALL)
    assert np.allclose(total, color, rtol=1e-4, atol=1e-5 * color.max())
    assert np.array_equal(rendered(*prims, aovs=[]).color, image.color)
    assert all(image[name].max() > 0.0 for name in ALL)


def means(image: dermis.Image, name: str) -> tuple[np.ndarray, np.ndarray]:
    values = image[name][..., :3].astype(float)
    return values.mean((0, 1)), values


@pytest.mark.parametrize("boundary", ["diffuse", "indexMatched"])
def test_a_group_is_the_image_of_its_lights(boundary):
    prims = (KEYS, FILL, RIM, GLOW, ball(boundary))
    seeds = range(8)
    images = [
        rendered(*prims, aovs=[*ALL, "light_KeyB", "light_/World/Rim"], samples=64, seed=s) for s in seeds
    ]
    alone = {
        "light_key": (KEYS,),
        "light_fill": (FILL,),
        "light_default": (RIM, GLOW),
        "light_KeyB": (KEYS.replace('SphereLight "KeyA"', 'Scope "KeyA"'),),
        "light_/World/Rim": (RIM,),
    }
    for name, lights in alone.items():
        dark = GLOW.replace("(3, 2, 1)", "(0, 0, 0)") if GLOW not in lights else ""
        others = [rendered(*lights, dark, ball(boundary), aovs=[], samples=64, seed=20 + s) for s in seeds]
        got, expected = (
            np.array([means(image, of)[0] for image in many])
            for many, of in ((images, name), (others, "color"))
        )
        # What belongs to no light is shared out: a dim light's layer has some of the others' noise.
        error = np.sqrt((got.var(0, ddof=1) + expected.var(0, ddof=1)) / len(seeds))
        got, expected = got.mean(0), expected.mean(0)
        assert (error < 0.015 * expected).all(), "6 % would not be seen"
        assert (np.abs(got - expected) < 4.0 * error).all(), (name, got, expected, error)


def test_labels_of_other_renderers(flat):
    labels = {
        "string inputs:ri:light:lightGroup": "a",
        "string karma:light:lpetag": "b",
        "string primvars:arnold:aov": "c",
        "token dermis:lightGroup": "d",
    }
    for attribute, label in labels.items():
        found = flat(f'def SphereLight "L"\n{{\n{attribute} = "{label}"\n}}\n').prims["/L"]
        assert found["group"] == label


FIXTURE = """
    class Xform "Fixture"
    {
        def Mesh "Panel" (
            prepend apiSchemas = ["MeshLightAPI"]
        )
        {
            int[] faceVertexCounts = [4]
            int[] faceVertexIndices = [0, 1, 2, 3]
            point3f[] points = [(-1, 0, 3), (1, 0, 3), (1, 1, 3), (-1, 1, 3)]
            uniform token orientation = "leftHanded"
            uniform token subdivisionScheme = "none"
            float inputs:intensity = 5
        }
    }
"""
HUNG = """
    def "%s" (
        instanceable = true
        references = </World/Fixture>
    )
    {
    }
"""


@pytest.mark.parametrize("places", [("A",), ("A", "B")])
def test_meshes_and_instances_are_lights_by_their_names(places):
    """All placements of a light have the name of its prim; only a single one has its path."""
    prims = (KEYS, FIXTURE, *(HUNG % place for place in places))
    path = "light_/World/A/Panel"
    image = rendered(*prims, aovs=["light_Panel", "light_key", path])
    np.testing.assert_allclose(image["light_Panel"] + image["light_key"], image.color[..., :3], rtol=1e-4)
    assert image["light_Panel"].max() > 0.0
    black = [w["message"] for w in image.stats["warnings"] if "is black" in w["message"]]
    assert (len(black), image[path].max() > 0.0) == ((0, True) if len(places) == 1 else (1, False))


def test_prototypes_of_point_instancers_are_lights_by_their_names():
    """Also where the prototype is the light itself."""
    scattered = """
    def PointInstancer "Lamps"
    {
        int[] protoIndices = [0, 0]
        point3f[] positions = [(-1, 0, 3), (1, 0, 3)]
        rel prototypes = [</World/Lamps/Kinds/Bulb>]
        def Scope "Kinds"
        {
            def SphereLight "Bulb"
            {
                float inputs:radius = 0.3
                float inputs:intensity = 5
            }
        }
    }
"""
    image = rendered(KEYS, scattered, aovs=["light_Bulb", "light_key"])
    np.testing.assert_allclose(image["light_Bulb"] + image["light_key"], image.color[..., :3], rtol=1e-4)
    assert image["light_Bulb"].max() > 0.0


def test_a_label_that_no_light_has_is_said():
    image = rendered(KEYS, aovs=["light_nobody", "light_key"], samples=1)
    assert image["light_nobody"].max() == 0.0 and image["light_key"].max() > 0.0
    [message] = [w["message"] for w in image.stats["warnings"] if "light_nobody" in w["message"]]
    assert "no light is 'nobody'" in message


VARS = """
def Scope "Render"
{
    def RenderSettings "Settings"
    {
        rel products = </Render/Product>
        rel camera = </World/main_cam>
        uniform int2 resolution = (8, 8)
    }
    def RenderProduct "Product"
    {
        token productName = "image.exr"
        rel orderedVars = [</Render/Ci>, </Render/keys>, </Render/one>]
    }
    def RenderVar "Ci"
    {
        string sourceName = "Ci"
    }
    def RenderVar "keys"
    {
        string sourceName = "C.*<L.'key'>"
        token sourceType = "lpe"
    }
    def RenderVar "one"
    {
        string sourceName = "C.*[O]<L.'Rim'>"
        token sourceType = "lpe"
    }
}
"""


def test_render_vars_and_flags_name_lights(tmp_path):
    metadata = 'renderSettingsPrimPath = "/Render/Settings"'
    text = stage_text(CAMERA, CARD, KEYS, RIM, metadata=metadata, outside=VARS)
    stage = write_stage(tmp_path / "s.usda", text)
    assert run("record", stage, tmp_path / "vars.exr", "--samples", "2", "--disableCameraLight") == 0
    found = channels(tmp_path / "vars.exr")
    assert {"R", "keys.R", "one.G"} <= set(found)
    assert np.allclose(found["keys.R"] + found["one.R"], found["R"], rtol=1e-4)
    assert found["keys.R"].max() > 0.0 and found["one.G"].max() > 0.0
    flags = ("--samples", "2", "--aov", "light_key", "--aov", "light_default", "--disableCameraLight")
    assert run("record", stage, tmp_path / "flags.exr", *flags) == 0
    typed = channels(tmp_path / "flags.exr")
    assert np.allclose(typed["light_key.B"] + typed["light_default.B"], typed["B"], rtol=1e-4)
    assert run("record", stage, tmp_path / "no.exr", "--aov", "light_") == 2


def test_checkpoints_keep_groups(tmp_path):
    """Half of a render, and the other half from its checkpoint."""
    text = stage_text(CAMERA, CARD, KEYS, RIM)
    stage = write_stage(tmp_path / "s.usda", text)
    flags = ("--aov", "light_key", "--imageHeight", "16", "--disableCameraLight", "--samples", "8")
    assert run("record", stage, tmp_path / "a.exr", *flags) == 0
    assert run("record", stage, tmp_path / "b.exr", *flags, "--checkpoint", "0.001", "--resume") == 0
    a, b = channels(tmp_path / "a.exr"), channels(tmp_path / "b.exr")
    assert all(np.array_equal(a[name], b[name]) for name in a)


# light:materialSyncMode

PANEL = """
    def Mesh "Panel" (
        prepend apiSchemas = ["{api}", "MaterialBindingAPI"]
    )
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]
        uniform token subdivisionScheme = "none"
        float inputs:intensity = 2
        color3f inputs:color = (1, 0.5, 0.25)
        rel material:binding = </World/Glass>
        {mode}
    }}
    def Material "Glass"
    {{
        token outputs:surface.connect = </World/Glass/Surface.outputs:surface>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:emissiveColor = {glow}
            color3f inputs:diffuseColor = (0.5, 0.5, 0.5)
            token outputs:surface
        }}
    }}
"""
#: Faces the panel, out of the camera's sight: behind it.
CATCHER = """
    def Mesh "Catcher"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-3, 1.6, -1), (3, 1.6, -1), (3, 1.6, 3), (-3, 1.6, 3)]
        color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]
        uniform token subdivisionScheme = "none"
    }
"""


def panel(mode: str = "", glow: str = "(0.2, 0.4, 0.8)", api: str = "MeshLightAPI") -> str:
    line = f'uniform token light:materialSyncMode = "{mode}"' if mode else ""
    return PANEL.format(mode=line, glow=glow, api=api)


def seen_and_lit(text: str, lit_by: str = "") -> tuple[np.ndarray, np.ndarray]:
    """What the camera sees of the panel, and what the catcher above it shows of its light."""
    stage = opened(stage_text(CAMERA, CATCHER, text, lit_by))
    image = dermis.render(
        stage, resolution=(24, 24), samples=256, camera="/World/main_cam", aovs=[], maxDepth=0
    ).color[..., :3]
    return image[10:14, 10:14].mean((0, 1)), image[1:3, 8:16].mean((0, 1))


def test_a_glow_tints_the_light_and_is_what_is_seen():
    seen, lit = seen_and_lit(panel())
    assert np.allclose(seen, [0.2, 0.4, 0.8], rtol=1e-3)
    # Light without material is white times its own colour.
    _, plain = seen_and_lit(panel("noMaterialResponse"))
    assert np.allclose(lit / plain, [0.2, 0.4, 0.8], rtol=0.01)


def test_an_independent_light_has_its_own_colour():
    seen, lit = seen_and_lit(panel("independent"))
    _, plain = seen_and_lit(panel("noMaterialResponse"))
    assert np.allclose(seen, [0.2, 0.4, 0.8], rtol=1e-3) and np.allclose(lit / plain, 1.0, rtol=0.01)


def test_a_light_without_material_response_reflects_nothing():
    lamp_in_front = lamp("Lamp", 0).replace("2.5, 3)", "0.5, 4)")
    for text in (panel("noMaterialResponse"), panel(api="LightAPI")):
        seen, _ = seen_and_lit(text, lamp_in_front)
        assert np.allclose(seen, [2.0, 1.0, 0.5], rtol=1e-4)
    reflecting, _ = seen_and_lit(panel("independent", "(0, 0, 0)"), lamp_in_front)
    assert (reflecting > np.array([2.0, 1.0, 0.5]) * 1.01).all()


def test_what_does_not_glow_tints_nothing():
    seen, lit = seen_and_lit(panel(glow="(0, 0, 0)"))
    _, plain = seen_and_lit(panel("noMaterialResponse"))
    assert np.allclose(seen, [2.0, 1.0, 0.5], rtol=1e-3) and np.allclose(lit / plain, 1.0, rtol=0.01)


def test_modes_that_are_not_known_are_said():
    result = flatten(opened(stage_text(panel("sometimes"))))
    assert any("light:materialSyncMode: 'sometimes'" in message for _, message in result.warnings)


def of_panel(p: np.ndarray, x: float) -> np.ndarray:
    """Irradiance over radiance at points of the floor, from the panel of usd_scenes/sync_modes.usda at `x`."""
    u, v = np.meshgrid(*2 * [(np.arange(24) + 0.5) / 24 * 1.2 - 0.6])
    way = np.stack([u + x, v + 0.8, np.full_like(u, -0.5)], -1).reshape(-1, 3) - p[..., None, :]
    distance2 = (way**2).sum(-1)
    return (way[..., 1] * -way[..., 2] / distance2**2).sum(-1) * (1.2 / 24) ** 2


def test_our_stage_of_sync_modes(usd_scenes):
    """What is seen of the panels, and what the floor before each gets of it."""
    image = dermis.render(
        usd_scenes / "sync_modes.usda", resolution=(80, 40), samples=64, maxDepth=0, aovs=[]
    )
    sight = rays((80, 40), 30, 24, (0, 4.6, 8.6), tilt=-24)
    panels, floors = sight.plane(2, -0.5), sight.plane(1)
    color = image.color[..., :3].astype(float)
    glow = np.array([0.1, 0.35, 0.9])
    for x, lit, seen in ((-2.4, 2 * glow, glow), (0.0, 2.0, glow), (2.4, 2.0, [2.0] * 3)):
        panel = (np.abs(panels - [x, 0.8, -0.5]) < [0.6, 0.6, 1]).all((0, -1))
        assert panel.sum() > 40 and np.allclose(color[panel], seen, rtol=1e-3), x
        floor = (np.abs(floors - [x, 0.0, 1.0]) < [0.9, 1, 1.0]).all((0, -1))
        # Nearer to the middle a wall stands before the outer parts.
        floor &= (np.abs(floors[..., 0]) > 1.9).all(0) | (x == 0.0)
        received = sight.mean(of_panel(floors[:, floor], x)).mean()
        expected = 0.5 / np.pi * received * np.broadcast_to(lit, 3)
        assert floor.sum() > 100 and np.allclose(color[floor].mean(0), expected, rtol=0.015), x


def test_our_stage_of_groups(usd_scenes):
    """Its groups are the image; on the free floor, the keys are what spheres of their radiance give."""
    names = ["light_key", "light_fill", "light_default"]
    settings = {"resolution": (80, 40), "samples": 128, "maxDepth": 0}
    image = dermis.render(usd_scenes / "light_groups.usda", aovs=[*names, "light_KeyRight"], **settings)
    total = sum(image[name].astype(float) for name in names)
    assert np.allclose(total, image.color[..., :3], rtol=1e-4, atol=1e-5)
    sight = rays((80, 40), 40, 24, (0, 3.2, 15), tilt=-9)
    p = sight.plane(1)
    free = (sight.d[..., 1] < 0) & (np.abs(p[..., 0]) < 9) & (np.abs(p[..., 2]) < 9)
    spheres = (np.array([-1, 1.2, 0]), 1.2), (np.array([2, 0.5, 1]), 0.5)
    for middle, radius in spheres:
        free &= np.isnan(sight.sphere(middle, radius)[..., 0])
    expected = {}
    keys = {"KeyLeft": ((-6, 6, 4), 160, (1, 0.7, 0.4)), "KeyRight": ((6, 5, 4), 110, (0.4, 0.6, 1))}
    for name, (at, intensity, color) in keys.items():
        way = np.array(at, float) - p
        distance2 = (way**2).sum(-1)
        cosine = way[..., 1] / np.sqrt(distance2)
        expected[name] = (0.4 * intensity * 0.5**2 * cosine / distance2)[..., None] * np.array(color)
        for middle, radius in spheres:
            along = np.clip(((middle - p) * way).sum(-1) / distance2, 0, 1)[..., None]
            free &= np.linalg.norm(middle - p - along * way, axis=-1) > radius + 0.5
    free = free.all(0)
    assert free.sum() > 400
    for name, parts in (("light_KeyRight", ["KeyRight"]), ("light_key", list(keys))):
        lit = sight.mean(sum(expected[part][:, free] for part in parts)).mean(0)
        assert np.allclose(image[name][free].mean(0), lit, rtol=0.01), name


PANE = """
    def Cube "Pane" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double size = 2
        rel material:binding = </World/Clear>
        double3 xformOp:translate = (0, 0, -0.7)
        double3 xformOp:scale = (1.6, 1.5, 0.05)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }
    def Material "Clear"
    {
        token outputs:mtlx:surface.connect = </World/Clear/S.outputs:out>
        def Shader "S"
        {
            uniform token info:id = "ND_open_pbr_surface_surfaceshader"
            float inputs:transmission_weight = 1
            float inputs:specular_roughness = 0
            token outputs:out
        }
    }
"""


def test_through_glass_a_panel_lights_with_its_light_not_its_glow():
    """The catcher sees the panel through the pane, which no light is sampled through: by chance it meets the same
    light. The camera sees the glow, through the pane too."""

    def image(glow: str) -> np.ndarray:
        stage = opened(stage_text(CAMERA, CATCHER, panel("independent", glow), PANE))
        settings = {"samples": 256, "camera": "/World/main_cam", "aovs": [], "maxDepth": 6}
        return dermis.render(stage, resolution=(24, 24), **settings).color[..., :3]

    glowing, dark = image("(0.2, 0.4, 40)"), image("(0, 0, 0)")
    assert glowing[10:14, 10:14, 2].mean() > 20.0 > 3.0 > dark[10:14, 10:14, 2].mean()
    assert dark[1:3, 8:16].mean() > 0.01
    assert np.array_equal(glowing[1:3, 8:16], dark[1:3, 8:16])
