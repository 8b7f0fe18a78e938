"""Light and shadow linking: black where a light is not for a thing, no shadow of what casts none; ShadowAPI."""

import json

import numpy as np
import pytest
from conftest import stage_of
from pxr import Sdf, Usd, UsdLux

import dermis
from dermis.hydra import Delegate, DirtyBits, edits, populate
from dermis.stage import flatten, open_stage

CAMERA = """
def Camera "Cam"
{
    token projection = "orthographic"
    float horizontalAperture = 40
    float verticalAperture = 20
    double3 xformOp:translate = (0, 0, 50)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""

CARD = """
    def Mesh "{name}" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-0.8, -0.8, 0), (0.8, -0.8, 0), (0.8, 0.8, 0), (-0.8, 0.8, 0)]
        color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]
        uniform token subdivisionScheme = "none"
        rel material:binding = </Look>
        double3 xformOp:translate = ({x}, 0, {z})
        double3 xformOp:scale = ({size}, {size}, 1)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }}
"""

LOOK = """
def Material "Look"
{{
    token outputs:surface.connect = </Look/Surface.outputs:surface>
    def Shader "Surface"
    {{
        uniform token info:id = "UsdPreviewSurface"
        {inputs}
        token outputs:surface
    }}
}}
"""


def card(name: str, x: float, z: float = 0.0, size: float = 1.0) -> str:
    return CARD.format(name=name, x=x, z=z, size=size)


def lamp(body: str = "", kind: str = "RectLight", z: float = 6.0, name: str = "Lamp", apis: str = "") -> str:
    metadata = f" (\n    prepend apiSchemas = [{apis}]\n)" if apis else ""
    return f"""
def {kind} "{name}"{metadata}
{{
    float inputs:intensity = 3
    {body}
    double3 xformOp:translate = (0, 0, {z})
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""


def rendered(body: str, inputs: str = "", **settings: object) -> np.ndarray:
    stage = stage_of(body + CAMERA + LOOK.format(inputs=inputs)) if isinstance(body, str) else body
    settings = {"resolution": (20, 10), "samples": 16, "camera": "/Cam", "aovs": [], **settings}
    return dermis.render(stage, **settings).color[..., :3].astype(float)


def halves(image: np.ndarray) -> tuple[float, float]:
    """Means over the middle of the left card and of the right one."""
    return float(image[3:7, 3:7].mean()), float(image[3:7, 13:17].mean())


CARDS = 'def Xform "World"\n{' + card("Left", -1) + card("Right", 1) + "}\n"

LINKS = {
    "excludes": "rel collection:lightLink:excludes = </World/Right>",
    "includes": "bool collection:lightLink:includeRoot = 0\n rel collection:lightLink:includes = </World/Left>",
    "excludes above, includes below": (
        "rel collection:lightLink:excludes = </World>\n rel collection:lightLink:includes = </World/Left>"
    ),
    "expression": 'pathExpression collection:lightLink:membershipExpression = "//Left"'
    "\n bool collection:lightLink:includeRoot = 0",
}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("inputs", ["", "float inputs:metallic = 1\n float inputs:roughness = 0.2"])
def test_what_a_light_is_not_for_is_black(link, inputs):
    plain = rendered(CARDS + lamp(), inputs)
    linked = rendered(CARDS + lamp(LINKS[link]), inputs)
    assert np.array_equal(linked[:, :10], plain[:, :10])
    left, right = halves(linked)
    assert left > 0.01 and right == 0.0


def test_the_camera_and_mirrors_see_what_they_are_for():
    """A mirror that the light is for shows the light; another one does not."""
    mirrors = CARDS + lamp("float inputs:width = 9\n float inputs:height = 9\n" + LINKS["excludes"], z=55.0)
    left, right = halves(rendered(mirrors, "float inputs:metallic = 1\n float inputs:roughness = 0"))
    assert left > 0.5 and right == 0.0


@pytest.mark.parametrize("kind", ["SphereLight", "DiskLight", "CylinderLight", "DistantLight", "DomeLight"])
def test_every_kind_of_light_is_linked(kind):
    left, right = halves(rendered(CARDS + lamp(LINKS["excludes"], kind), "float inputs:roughness = 0.3"))
    assert left > 1e-5 and right == 0.0


@pytest.mark.parametrize("boundary", ["diffuse", "dielectric", "indexMatched"])
def test_walks_are_lit_by_what_their_object_is_linked_to(boundary):
    def ball(name: str, x: float) -> str:
        return f"""
        def Sphere "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
        {{
            double radius = 0.8
            rel material:binding = </Look>
            double3 xformOp:translate = ({x}, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        """

    def world(*balls: str) -> str:
        return 'def Xform "World"\n{' + "".join(balls) + "}\n"

    both = world(ball("Left", -1), ball("Right", 1))
    looks = f"""
        float inputs:subsurface = 1
        color3f inputs:subsurfaceRadius = (0.3, 0.3, 0.3)
        token inputs:subsurfaceBoundary = "{boundary}"
        float inputs:roughness = 0
    """
    dome = lamp(LINKS["excludes"], "DomeLight")
    assert rendered(world(ball("Right", 1)) + dome, looks, samples=64).max() == 0.0
    alone = rendered(world(ball("Left", -1)) + lamp(kind="DomeLight"), looks, samples=64)
    linked = rendered(world(ball("Left", -1)) + dome, looks, samples=64)
    assert np.array_equal(alone, linked)
    # What light the right ball shows has come by way of the left one.
    left, right = halves(rendered(both + dome, looks, samples=64))
    assert right < 0.5 * left


INSTANCES = (
    'def Xform "Proto"\n{ token visibility = "inherited"\n'
    + card("A", 0)
    + card("B", 0.2, -0.5)
    + """}
def Xform "World"
{
    def Xform "I0" (instanceable = true
        references = </Proto>)
    {
        double3 xformOp:translate = (-1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "I1" (instanceable = true
        references = </Proto>)
    {
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "I2" (instanceable = true
        references = </Proto>)
    {
        double3 xformOp:translate = (9, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
)


def categories(flat_stage) -> dict[str, list[str]]:
    return {k: p.get("categories", []) for k, p in flat_stage.prims.items() if p["type"] == "Mesh"}


def members(flat_stage) -> set[str]:
    return {key for key, names in categories(flat_stage).items() if names}


def test_instances_that_are_linked_alike_share_geometry(flat):
    of = flat(INSTANCES + lamp("rel collection:lightLink:excludes = </World/I1>"))
    inside = members(of) - {"/Proto/A", "/Proto/B"}
    assert inside == {"/World/I0/A", "/World/I0/B"}
    assert set(categories(of)) == inside | {"/Proto/A", "/Proto/B", "/World/I1/A", "/World/I1/B"}
    assert len(of.prims["/World/I0.instances"]["transforms"]) == 2


def test_a_prim_within_an_instance(flat):
    of = flat(INSTANCES + lamp("rel collection:lightLink:excludes = </World/I1/A>"))
    assert members(of) == {"/Proto/A", "/Proto/B", "/World/I0/A", "/World/I0/B", "/World/I1/B"}


def test_native_instances_render_by_their_links():
    hidden = INSTANCES.replace('token visibility = "inherited"', 'token visibility = "invisible"')
    hidden = hidden.replace('def Xform "Proto"', 'class Xform "Proto"').replace('"invisible"', '"inherited"')
    left, right = halves(rendered(hidden + lamp("rel collection:lightLink:excludes = </World/I1>")))
    assert left > 0.01 and right == 0.0


NESTED = (
    'class Xform "Inner"\n{\n'
    + card("A", 0)
    + """}
class Xform "Outer"
{
    def Xform "In" (instanceable = true
        references = </Inner>)
    {
    }
}
def Xform "World"
{
    def Xform "O0" (instanceable = true
        references = </Outer>)
    {
        double3 xformOp:translate = (-1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "O1" (instanceable = true
        references = </Outer>)
    {
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
)


def test_instances_within_instances():
    left, right = halves(rendered(NESTED + lamp("rel collection:lightLink:excludes = </World/O1/In/A>")))
    assert left > 0.01 and right == 0.0


def instancer(name: str, prototypes: str, x: float, inside: str = "", positions: str = "[(0, 0, 0)]") -> str:
    count = positions.count("(")
    return f"""
    def PointInstancer "{name}"
    {{
        rel prototypes = {prototypes}
        int[] protoIndices = {[0] * count}
        point3f[] positions = {positions}
        double3 xformOp:translate = ({x}, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {inside}
    }}
    """


def test_point_instancers_by_instancer_and_by_prototype(flat):
    def world(link: str) -> str:
        shared = 'over "Protos"\n{' + card("P", 0) + "}\n"
        left = instancer("PI0", "</Protos/P>", -1)
        right = instancer("PI1", "</World/PI1/Own>", 1, card("Own", 0))
        both = instancer("PI2", "</Protos/P>", 9)
        return shared + 'def Xform "World"\n{' + left + right + both + "}\n" + lamp(link)

    zero, one, two = "/World/PI0.prototypes[0]", "/World/PI1.prototypes[0]", "/World/PI2.prototypes[0]"
    without = {
        "</World/PI1>": {zero, two},
        "</World/PI0>": {one, two},
        "</Protos/P>": {one},
        "</Protos>": {one},
        "</World/PI1/Own>": {zero, two},
        "</World>": set(),
    }
    for excluded, expected in without.items():
        assert members(flat(world(f"rel collection:lightLink:excludes = {excluded}"))) == expected, excluded
    root = "bool collection:lightLink:includeRoot = 0\n"
    assert members(flat(world(root + "rel collection:lightLink:includes = </World/PI0>"))) == {zero}
    assert members(flat(world(root + "rel collection:lightLink:includes = </Protos>"))) == {zero, two}
    left, right = halves(rendered(world("rel collection:lightLink:excludes = </World/PI1>")))
    assert left > 0.01 and right == 0.0


def test_instancers_within_instancers():
    def world(link: str) -> str:
        inner = instancer("Inner", "</World/Protos/P>", 0)
        protos = 'over "Protos"\n{' + card("P", 0) + inner + "}\n"
        outer = [instancer(f"O{i}", "</World/Protos/Inner>", 2 * i - 1) for i in range(2)]
        return 'def Xform "World"\n{' + protos + "".join(outer) + "}\n" + lamp(link)

    left, right = halves(rendered(world("rel collection:lightLink:excludes = </World/O1>")))
    assert left > 0.01 and right == 0.0
    assert halves(rendered(world("rel collection:lightLink:excludes = </World/Protos/P>"))) == (0.0, 0.0)
    assert halves(rendered(world("rel collection:lightLink:excludes = </World/Protos/Inner>"))) == (0.0, 0.0)


def test_links_that_hold_everything_cost_nothing():
    plain = stage_of(CARDS + lamp() + CAMERA + LOOK.format(inputs=""))
    everything = lamp(
        "bool collection:lightLink:includeRoot = 0\n rel collection:lightLink:includes = </World>"
    )
    linked = stage_of(CARDS + everything + CAMERA + LOOK.format(inputs=""))
    images = [dermis.render(s, resolution=(20, 10), samples=4, camera="/Cam") for s in (plain, linked)]
    assert np.array_equal(images[0].color, images[1].color)
    assert images[1].stats["needs"]["linked_lights"] == 0
    partly = stage_of(CARDS + lamp(LINKS["excludes"]) + CAMERA + LOOK.format(inputs=""))
    image = dermis.render(partly, resolution=(20, 10), samples=1, camera="/Cam")
    assert image.stats["needs"]["linked_lights"] == 1 and image.stats["warnings"] == []


def test_an_edit_of_a_collection_is_one_of_categories():
    stage = stage_of(CARDS + lamp(LINKS["excludes"]) + CAMERA + LOOK.format(inputs=""))
    before = flatten(stage)
    delegate = Delegate()
    populate(delegate.core, before)
    UsdLux.LightAPI(stage.GetPrimAtPath("/Lamp")).GetLightLinkCollectionAPI().GetExcludesRel().SetTargets(
        [Sdf.Path("/World/Left")]
    )
    after = flatten(stage)
    assert edits(after, before) == {"/World/Left": DirtyBits.CATEGORIES, "/World/Right": DirtyBits.CATEGORIES}
    populate(delegate.core, after, before)
    delegate.set_settings(resolution=(20, 10), samples=4, camera="/Cam")
    assert delegate.commit()["blas_built"] >= 0
    delegate.start()
    while not delegate.wait(5.0):
        pass
    edited = delegate.snapshot()["color"]
    fresh = dermis.render(stage, resolution=(20, 10), samples=4, camera="/Cam").color
    assert np.array_equal(edited, fresh)
    left, right = halves(edited[..., :3])
    assert left == 0.0 and right > 0.01
    json.dumps(after.prims["/Lamp"]["lightLink"])


FLOOR = card("Floor", 0, 0.0, 2.4)
BLOCKER = """
    def Mesh "Blocker" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, -3, 4), (3, -3, 4), (3, 3, 4), (0, 3, 4)]
        uniform token subdivisionScheme = "none"
        rel material:binding = </Black>
    }
"""
BLACK = """
def Material "Black"
{
    token outputs:surface.connect = </Black/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (0, 0, 0)
        int inputs:useSpecularWorkflow = 1
        color3f inputs:specularColor = (0, 0, 0)
        float inputs:ior = 1
        token outputs:surface
    }
}
"""
NO_SHADOW = "rel collection:shadowLink:excludes = </World/Blocker>"
#: A camera below the blocker: it sees the floor alone.
NEAR = CAMERA.replace("(0, 0, 50)", "(0, 0, 2)")

SURFACES = {
    "matte": "float inputs:roughness = 1",
    "glossy": "float inputs:metallic = 1\n float inputs:roughness = 0.25",
    "mirror": "float inputs:metallic = 1\n float inputs:roughness = 0",
    "clear coat": "float inputs:clearcoat = 1\n float inputs:clearcoatRoughness = 0.05",
}


def floor_under(light: str, inputs: str, blocker: str = BLOCKER, **settings: object) -> np.ndarray:
    world = 'def Xform "World"\n{' + FLOOR + blocker + "}\n" + BLACK + light + NEAR
    stage = stage_of(world + LOOK.format(inputs=inputs))
    settings = {"resolution": (20, 10), "samples": 400, "camera": "/Cam", "aovs": ["variance"], **settings}
    image = dermis.render(stage, **settings)
    return image.color[..., :3].astype(float), image["variance"].astype(float)


def assert_same(a: tuple, b: tuple, sigmas: float = 4.0, at_most: float = 0.02) -> None:
    """Image means within the statistical error, which is small enough to see 2 %."""
    error = np.sqrt((a[1].sum() + b[1].sum()) / (a[0].size * b[0].size))
    assert error * sigmas < at_most * b[0].mean(), (error, b[0].mean())
    assert abs(a[0].mean() - b[0].mean()) < sigmas * error, (a[0].mean(), b[0].mean(), error)


WIDE = "float inputs:width = 6\n float inputs:height = 6\n"


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("kind", ["RectLight", "SphereLight", "DomeLight"])
def test_what_casts_no_shadow_is_as_if_it_were_not_there(kind, surface):
    """Light sampled, and light met by chance, by one and the same rule."""
    body = WIDE + "float inputs:radius = 3\n"
    none = floor_under(lamp(body, kind, z=9.0), SURFACES[surface], blocker="")
    linked = floor_under(lamp(body + NO_SHADOW, kind, z=9.0), SURFACES[surface])
    assert_same(linked, none)
    if surface == "matte":
        assert floor_under(lamp(body, kind, z=9.0), SURFACES[surface])[0].mean() < 0.9 * none[0].mean()


def test_a_light_that_is_a_mesh_shines_past_what_casts_no_shadow():
    def mesh(link: str) -> str:
        return (
            'def Mesh "Panel" (\n prepend apiSchemas = ["MeshLightAPI", "MaterialBindingAPI"]\n)\n{\n'
            "int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 3, 2, 1]\n"
            "point3f[] points = [(-3, -3, 9), (3, -3, 9), (3, 3, 9), (-3, 3, 9)]\n"
            'uniform token subdivisionScheme = "none"\n float inputs:intensity = 3\n'
            f"rel material:binding = </Black>\n {link}\n}}\n"
        )

    glossy = SURFACES["glossy"]
    assert_same(floor_under(mesh(NO_SHADOW), glossy), floor_under(mesh(""), glossy, blocker=""))


SMALL = "float inputs:radius = 0.001\n bool inputs:normalize = 1\n"


def shadow_ratio(rule: str, **settings: object) -> np.ndarray:
    """Floor in the umbra of a small light, as a share of what is there without the blocker: per channel."""
    at = lamp(SMALL + rule, "SphereLight", z=9.0, apis='"ShadowAPI"').replace("(0, 0, 9.0)", "(2, 0, 9)")
    plain = lamp(SMALL, "SphereLight", z=9.0).replace("(0, 0, 9.0)", "(2, 0, 9)")
    shadowed = floor_under(at, SURFACES["matte"], samples=64, **settings)[0][3:7, 12:16]
    free = floor_under(plain, SURFACES["matte"], blocker="", samples=64, **settings)[0][3:7, 12:16]
    return (shadowed / free).reshape(-1, 3)


def test_shadow_color_and_enable_are_exact():
    color = shadow_ratio("color3f inputs:shadow:color = (0.2, 0.4, 0.6)")
    assert np.allclose(color, [0.2, 0.4, 0.6], rtol=1e-3)
    assert np.allclose(shadow_ratio("bool inputs:shadow:enable = 0"), 1.0, rtol=1e-3)
    assert np.allclose(shadow_ratio("float inputs:shadow:falloff = -1"), 0.0)


def test_shadow_distance_and_falloff_are_exact():
    """The blocker is at 4 / cos from the floor's points, the light about above them."""
    assert np.allclose(shadow_ratio("float inputs:shadow:distance = 3.9"), 1.0, rtol=1e-3)
    assert np.allclose(shadow_ratio("float inputs:shadow:distance = 4.3"), 0.0)
    zone = "float inputs:shadow:distance = 5\n float inputs:shadow:falloff = 2\n"
    for gamma in (1.0, 2.0):
        got = shadow_ratio(zone + f"float inputs:shadow:falloffGamma = {gamma}")
        # Pixel centres: 20 pixels over 4 units, from the left; 10 over 2, from the top.
        x = -2.0 + (np.arange(12, 16) + 0.5) * 0.2
        y = 1.0 - (np.arange(3, 7) + 0.5) * 0.2
        way = 4.0 / 9.0 * np.sqrt((2.0 - x[None, :]) ** 2 + y[:, None] ** 2 + 81.0)
        expected = 1.0 - ((5.0 - way) / 2.0) ** gamma
        assert np.allclose(got.reshape(4, 4, 3), expected[..., None], atol=3e-3)


def test_a_falloff_without_distance_is_said(flat):
    body = lamp("float inputs:shadow:falloff = 2", apis='"ShadowAPI"')
    assert "inputs:shadow:falloff" in flat(body).warnings[0][1]


def test_shadows_are_seen_in_glass_and_by_walks_alike():
    """A light without shadows lights a body of wax behind a wall as if there were none, by every boundary."""
    for boundary in ("diffuse", "dielectric", "indexMatched"):
        ball = """
        def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            double radius = 0.9
            rel material:binding = </Look>
        }
        """
        look = f"""
        float inputs:subsurface = 1
        color3f inputs:subsurfaceRadius = (0.5, 0.5, 0.5)
        color3f inputs:subsurfaceColor = (0.7, 0.7, 0.7)
        token inputs:subsurfaceBoundary = "{boundary}"
        float inputs:roughness = 0
        """
        images = []
        for rule, blocker in (("bool inputs:shadow:enable = 0", BLOCKER), ("", "")):
            light = lamp("float inputs:radius = 1.5\n" + rule, "SphereLight", z=9.0, apis='"ShadowAPI"')
            world = 'def Xform "World"\n{' + ball + blocker + "}\n" + BLACK + light + NEAR
            stage = stage_of(world + LOOK.format(inputs=look))
            image = dermis.render(stage, resolution=(20, 10), samples=400, camera="/Cam", aovs=["variance"])
            images.append((image.color[..., :3].astype(float), image["variance"].astype(float)))
        # Without shadows the far side is lit through the ball itself: it must only not be darker.
        free = images[1][0].mean()
        assert images[0][0].mean() > 0.98 * free, boundary
        if boundary == "indexMatched":
            # Its own medium is no shadow: the same picture.
            assert_same(images[0], images[1], at_most=0.03)


def test_files_keep_links(tmp_path):
    stage = stage_of(CARDS + lamp(LINKS["excludes"]) + CAMERA + LOOK.format(inputs=""))
    delegate = Delegate()
    populate(delegate.core, flatten(stage))
    delegate.core.save(str(tmp_path / "s.dermis"))
    settings = {"resolution": (20, 10), "samples": 4, "camera": "/Cam"}
    kept = dermis.render(tmp_path / "s.dermis", **settings).color
    assert np.array_equal(kept, dermis.render(stage, **settings).color)


def test_a_stage_without_links_has_no_categories(flat):
    assert all("categories" not in prim for prim in flat(CARDS + lamp()).prims.values())


def test_usd_says_the_same():
    """Every prim of a stage with rules within rules, by usd-core's own query."""
    link = (
        "rel collection:lightLink:excludes = [</World/I1>, </World/I0/B>]\n"
        "rel collection:lightLink:includes = </World/I1/A>"
    )
    stage = stage_of(INSTANCES + lamp(link))
    query = UsdLux.LightAPI(stage.GetPrimAtPath("/Lamp")).GetLightLinkCollectionAPI().ComputeMembershipQuery()
    placed: dict[str, bool] = {}
    for key, names in categories(flatten(stage)).items():
        placed[key] = bool(names)
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() == "Mesh" and str(prim.GetPath()) in placed:
            assert placed[str(prim.GetPath())] == query.IsPathIncluded(prim.GetPath()), prim
    assert len(placed) == 8


def test_our_stage(usd_scenes):
    of = flatten(open_stage(usd_scenes / "linking.usda"))
    lamp = of.prims["/World/Lamp"]
    lit, casting = (
        {k for k, names in categories(of).items() if lamp[link] in names}
        for link in ("lightLink", "shadowLink")
    )
    meshes = set(categories(of))
    assert meshes - lit == {"/World/Balls/Third"} and meshes - casting == {"/World/Hats/First"}
    assert of.warnings == []


WALL = "[(-90, -90, 4), (90, -90, 4), (90, 90, 4), (-90, 90, 4)]"


def test_the_distance_of_a_shadow_from_a_collision_is_the_same_however_it_is_lit():
    """A ball of fog beneath a wall, which is nearer than the distance to some of the fog, farther to the rest: alone
    the fog is walked through from boundary to boundary, with a speck in it to the next surface."""
    fog = """
    def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double radius = 0.9
        rel material:binding = </Look>
    }
    """
    speck = """
    def Mesh "Speck"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (1e-4, 0, 0), (0, 1e-4, 0)]
        uniform token subdivisionScheme = "none"
    }
    """
    look = """
    float inputs:subsurface = 1
    color3f inputs:subsurfaceRadius = (0.7, 0.7, 0.7)
    color3f inputs:subsurfaceColor = (0.7, 0.7, 0.7)
    token inputs:subsurfaceBoundary = "indexMatched"
    """
    wall = BLOCKER.replace("[(0, -3, 4), (3, -3, 4), (3, 3, 4), (0, 3, 4)]", WALL)
    rule = "float inputs:shadow:distance = 5\n"
    images = []
    for inner in ("", speck):
        world = 'def Xform "World"\n{' + fog + inner + wall + "}\n" + BLACK
        light = lamp(rule, "DomeLight", apis='"ShadowAPI"')
        stage = stage_of(world + light + NEAR + LOOK.format(inputs=look))
        image = dermis.render(stage, resolution=(20, 10), samples=1600, camera="/Cam", aovs=["variance"])
        assert (image.stats["needs"]["hosts"] > 0) == bool(inner)
        images.append((image.color[..., :3].astype(float), image["variance"].astype(float)))
    assert_same(*images)


@pytest.mark.parametrize("others", [8, 40])
def test_lights_for_others_make_no_noise(others):
    """Few lights are weighed one by one, many are in a tree: either way those that are for the other card cost the
    left one no draw."""
    rest = "".join(
        lamp(
            "rel collection:lightLink:excludes = </World/Left>\n float inputs:radius = 0.4",
            "SphereLight",
            name=f"Other{i}",
            z=3.0 + 0.1 * i,
        )
        for i in range(others)
    )

    def left(lights: str) -> tuple[np.ndarray, np.ndarray]:
        world = CARDS + lamp("float inputs:radius = 1.5", "SphereLight") + lights
        stage = stage_of(world + CAMERA + LOOK.format(inputs="float inputs:roughness = 1"))
        settings = {"samples": 256, "maxDepth": 0, "exitLights": "one"}
        image = dermis.render(stage, resolution=(20, 10), camera="/Cam", aovs=["variance"], **settings)
        return tuple(image[name][3:7, 3:7, :3].astype(float) for name in ("color", "variance"))

    alone, among = left(""), left(rest)
    assert_same(among, alone, at_most=0.1)
    assert among[1].mean() < 1.5 * alone[1].mean()
