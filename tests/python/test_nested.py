"""Media within media: what a stage says of them, and the picture of it."""

import itertools
import json

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

import dermis
from dermis.hydra import Delegate, DirtyBits, dirty_bits, populate
from dermis.stage import flatten

BODIES = """
def Xform "Group"
{
    int primvars:dermis:mediumPriority = 4
    token primvars:dermis:subsurfaceSet = "head"
    def Sphere "Skull" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        rel material:binding = </Milk>
    }
    def Sphere "Ear"
    {
        int primvars:dermis:mediumPriority = 7
        token primvars:dermis:subsurfaceSet = "ears"
    }
}
def Points "Bubbles"
{
    point3f[] points = [(0, 0, 0), (3, 0, 0)]
    float[] widths = [1, 1]
    int primvars:dermis:mediumPriority = -1
}
def Sphere "Plain"
{
}
def Material "Milk"
{
    token outputs:surface.connect = </Milk/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        int inputs:subsurfacePriority = 2
        token outputs:surface
    }
}
"""


def test_priorities_and_sets_are_handed_down(flat):
    prims = flat(BODIES).prims
    said = {
        path: (prims[path].get("mediumPriority"), prims[path].get("subsurfaceSet"))
        for path in ("/Group/Skull", "/Group/Ear", "/Bubbles", "/Plain")
    }
    assert said == {
        "/Group/Skull": (4, "head"),
        "/Group/Ear": (7, "ears"),
        "/Bubbles": (-1, None),
        "/Plain": (None, None),
    }
    assert prims["/Milk"]["subsurfacePriority"] == 2


def test_a_value_of_another_type_is_named(flat):
    result = flat('def Sphere "S"\n{\n string primvars:dermis:mediumPriority = "high"\n}')
    assert [prim for prim, text in result.warnings if "dermis:mediumPriority" in text] == ["/S"]
    assert result.prims["/S"]["mediumPriority"] == 0


def test_a_set_without_a_diffuse_boundary_is_named(make_stage):
    stage = make_stage(
        'def Sphere "S"\n{\n token primvars:dermis:subsurfaceSet = "a"\n}\ndef Camera "C"\n{\n}',
        'defaultPrim = "S"',
    )
    delegate = Delegate()
    populate(delegate.core, flatten(stage))
    delegate.set_settings(camera="/C")
    delegate.commit()
    warned = [w["prim"] for w in delegate.stats()["warnings"] if "subsurfaceSet" in w["message"]]
    assert warned == ["/S"]


GLASS = """
        uniform token info:id = "ND_open_pbr_surface_surfaceshader"
        float inputs:transmission_weight = 1
        float inputs:specular_roughness = 0
        float inputs:specular_ior = %s
        token outputs:out
"""


def slab(name: str, low: float, high: float, look: str, lines: str = "") -> str:
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return f"""
def Cube "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    double size = 2
    double3 xformOp:translate = (0, 0, {middle})
    float3 xformOp:scale = (50, 50, {half})
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    rel material:binding = </{look}>
    {lines}
}}
"""


def glass(name: str, ior: float) -> str:
    return f"""
def Material "{name}"
{{
    token outputs:mtlx:surface.connect = </{name}/S.outputs:out>
    def Shader "S"
    {{ {GLASS % ior} }}
}}
"""


SLABS = (
    slab("Dense", 0.0, 2.0, "DenseLook", "int primvars:dermis:mediumPriority = 1")
    + slab("Light", 1.0, 3.0, "LightLook", "int primvars:dermis:mediumPriority = 0")
    + slab("Wall", -3.0, -2.0, "Glow")
    + glass("DenseLook", 2.4)
    + glass("LightLook", 1.2)
    + """
def Material "Glow"
{
    token outputs:surface.connect = </Glow/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (0, 0, 0)
        color3f inputs:emissiveColor = (1, 1, 1)
        float inputs:ior = 1
        token outputs:surface
    }
}
def Camera "C"
{
    float horizontalAperture = 20
    float verticalAperture = 20
    float focalLength = 2000
    double3 xformOp:translate = (0, 0, 20)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
)


def transmittance(*indices: float) -> float:
    """Of parallel interfaces at normal incidence, incoherent: the order of a stack does not matter to what passes."""
    ratios = [((a - b) / (a + b)) ** 2 for a, b in itertools.pairwise(indices)]
    lost = sum(r / (1.0 - r) for r in ratios)
    return 1.0 / (1.0 + lost)


def seen(stage) -> float:
    image = dermis.render(stage, camera="/C", samples=256, resolution=(32, 32), seed=3)
    return float(np.mean(image.color[..., 0]))


def test_an_overlap_by_priority_is_a_stack_and_an_edit_is_a_fresh_load(make_stage):
    stage = make_stage(SLABS)
    for priority in (0, 2):
        attribute = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Light")).GetPrimvar("dermis:mediumPriority")
        attribute.Set(priority)
        # Half a million choices by Fresnel reflectance: a standard deviation of 0.0009.
        assert seen(stage) == pytest.approx(transmittance(1.0, 2.4, 1.2, 1.0), abs=0.004)
    before = flatten(stage)
    attribute.Set(5)
    after = flatten(stage)
    assert dirty_bits(before.prims["/Light"], after.prims["/Light"]) == DirtyBits.MATERIAL_ID


def test_edits_reach_the_core(make_stage):
    stage = make_stage(SLABS.replace("ior = 2.4", "ior = 1.3"))
    settings = {"camera": "/C", "samples": 4, "resolution": (16, 16)}

    def image(delegate):
        delegate.set_settings(**settings)
        delegate.commit()
        delegate.start()
        delegate.wait(60.0)
        return delegate.snapshot()["color"]

    edited, before = Delegate(), flatten(stage)
    populate(edited.core, before)
    first = image(edited)
    cube = UsdGeom.Cube(stage.GetPrimAtPath("/Light"))
    UsdGeom.PrimvarsAPI(cube).GetPrimvar("dermis:mediumPriority").Set(3)
    UsdGeom.XformCommonAPI(cube).SetScale(Gf.Vec3f(50, 50, 0.9))
    after = flatten(stage)
    populate(edited.core, after, before)
    fresh = Delegate()
    populate(fresh.core, after)
    assert np.array_equal(image(edited), image(fresh))
    assert first.shape == (16, 16, 4)


def test_explain_says_what_is_nested(usd_scenes):
    delegate = Delegate()
    populate(delegate.core, flatten(Usd.Stage.Open(str(usd_scenes / "nested.usda"))))
    delegate.set_settings(camera="/World/main_cam")
    delegate.commit()
    lines = {line["capability"]: line for line in json.loads(delegate.core.explain())["capabilities"]}
    assert (
        lines["media with objects in them"]["on"]
        and "1 scattering media" in lines["media with objects in them"]["why"]
    )
    assert lines["subsurface sets"]["on"] and lines["subsurface sets"]["why"].startswith("3 placements")
    assert not lines["camera in a medium"]["on"]


PLACED = """
class Xform "Proto"
{
    def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double radius = 0.4
        rel material:binding = </Fog>
    }
}
def Material "Fog"
{
    token outputs:surface.connect = </Fog/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        color3f inputs:subsurfaceAlbedo = (1, 1, 1)
        color3f inputs:subsurfaceRadius = (0.2, 0.2, 0.2)
        token inputs:subsurfaceBoundary = "indexMatched"
        token outputs:surface
    }
}
def DomeLight "Sky"
{
}
"""


def test_placements_of_one_mesh_that_overlap_are_as_two_meshes(make_stage):
    """Their caches, too, begin in the body that a point of the boundary is in: else their walks leak."""
    images = []
    for shared in ("true", "false"):
        places = "".join(
            f'def Xform "{name}" (\n    instanceable = {shared}\n    references = </Proto>\n)\n{{\n'
            f"    double3 xformOp:translate = ({x}, 0, 0)\n"
            '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
            for name, x in (("A", -0.25), ("B", 0.25))
        )
        settings = {"resolution": (8, 8), "samples": 16, "walk": "mixture"}
        images.append(dermis.render(make_stage(PLACED + places), **settings))
    assert [image.stats["needs"]["instanced"] for image in images] == [1, 0]
    assert [image.stats["walks_leaked"] for image in images] == [0, 0]
    np.testing.assert_array_equal(images[0].color, images[1].color)
