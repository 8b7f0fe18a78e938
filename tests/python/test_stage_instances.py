"""Instances: native, point instancers, nested either way; every placement is where USD says."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from dermis.stage import flatten, open_stage

BALL = (
    'def Sphere "Ball"\n{\n    double3 xformOp:translate = (0, 1, 0)\n'
    '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
)


def world_matrices(flat) -> dict[str, np.ndarray]:
    """World matrices of every mesh of the flat stage, by key, instances multiplied out."""
    result = {}
    for key, prim in flat.prims.items():
        if prim["type"] == "Mesh":
            local = np.array(prim["transform"])[None]
            outer = flat.prims[prim["instancer"]]["transforms"] if prim["instancer"] else np.eye(4)[None]
            result[key] = local @ outer
    return result


def sorted_rows(matrices: np.ndarray) -> np.ndarray:
    rows = np.round(np.reshape(matrices, (-1, 16)), 9) + 0.0
    return rows[np.lexsort(rows.T)]


def assert_places_like_usd(stage: Usd.Stage) -> None:
    """All placements against XformCache on every instance proxy, whatever the grouping."""
    cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
    proxies = [p for p in stage.Traverse(Usd.TraverseInstanceProxies()) if p.IsA(UsdGeom.Gprim)]
    expected = np.array([cache.GetLocalToWorldTransform(p) for p in proxies])
    found = np.concatenate(list(world_matrices(flatten(stage)).values()))
    assert sorted_rows(found) == pytest.approx(sorted_rows(expected), abs=1e-9)


def xform(name: str, x: float, body: str = "", metadata: str = "") -> str:
    return (
        f'def Xform "{name}" (\n{metadata}\n)\n{{\n    double3 xformOp:translate = ({x}, 0, 0)\n'
        f"    float3 xformOp:rotateXYZ = (0, {10 * x}, 0)\n"
        f'    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]\n{body}\n}}\n'
    )


def instance(name: str, of: str, x: float, body: str = "") -> str:
    return xform(name, x, body, f"    instanceable = true\n    references = <{of}>")


NESTED = (
    f'class Xform "Leaf"\n{{\n{BALL}}}\n'
    f'class Xform "Twig"\n{{\n{instance("A", "/Leaf", 1)}{instance("B", "/Leaf", 2)}'
    f'def Cube "Knot"\n{{\n}}\n}}\n'
    + xform("Group", 0.5, instance("T1", "/Twig", 10) + instance("T2", "/Twig", 20))
    + instance("T3", "/Twig", 30)
    + instance("L", "/Leaf", 40)
)


def test_nested_native_instances_share_one_mesh_each(make_stage):
    stage = make_stage(NESTED)
    assert_places_like_usd(stage)
    flat = flatten(stage)
    meshes = world_matrices(flat)
    assert sorted(len(m) for m in meshes.values()) == [3, 7]
    assert sorted(meshes) == ["/Group/T1/A/Ball", "/Group/T1/Knot"]
    assert all(flat.prims[k]["visible"] is True for k in flat.prims if flat.prims[k]["type"] == "Instancer")
    # Opened again, the keys are the same.
    assert list(flatten(make_stage(NESTED)).prims) == list(flat.prims)


def test_hidden_instances_are_not_placed(make_stage):
    body = NESTED.replace('def Xform "T3" (', 'def Xform "T3" (').replace(
        "double3 xformOp:translate = (30, 0, 0)",
        'token visibility = "invisible"\n    double3 xformOp:translate = (30, 0, 0)',
    )
    meshes = world_matrices(flatten(make_stage(body)))
    assert sorted(len(m) for m in meshes.values()) == [2, 5]


MATERIALS = 'def Material "Red"\n{\n}\ndef Material "Blue"\n{\n}\n'


def bind(target: str, strength: str = "") -> str:
    metadata = f' (\n        bindMaterialAs = "{strength}"\n    )' if strength else ""
    return f"    rel material:binding = <{target}>{metadata}"


def test_one_prototype_copy_per_distinct_inherited_binding(flat):
    body = f'class Xform "Leaf"\n{{\n{BALL}}}\n{MATERIALS}' + "".join(
        instance(f"I{i}", "/Leaf", i, bind(target))
        for i, target in enumerate(["/Red", "/Blue", "/Red", "/Blue", "/Red"])
    )
    result = flat(body)
    by_material = {
        prim["material"]: len(result.prims[prim["instancer"]]["transforms"])
        for prim in result.prims.values()
        if prim["type"] == "Mesh"
    }
    assert by_material == {"/Red": 3, "/Blue": 2}


def test_a_binding_that_a_stronger_one_overrules_splits_nothing(flat):
    body = f'class Xform "Leaf"\n{{\n{BALL}}}\n{MATERIALS}' + xform(
        "Strong",
        0,
        bind("/Red", "strongerThanDescendants")
        + "\n"
        + instance("A", "/Leaf", 1, bind("/Blue"))
        + instance("B", "/Leaf", 2),
    )
    result = flat(body)
    meshes = [prim for prim in result.prims.values() if prim["type"] == "Mesh"]
    assert [m["material"] for m in meshes] == ["/Red"]
    assert len(result.prims[meshes[0]["instancer"]]["transforms"]) == 2


def test_collection_binding_of_one_instance(flat):
    body = f'class Xform "Leaf"\n{{\n{BALL}}}\n{MATERIALS}' + (
        'def Xform "All" (\n    prepend apiSchemas = ["MaterialBindingAPI", "CollectionAPI:some"]\n)\n{\n'
        "    rel collection:some:includes = </All/B>\n"
        "    rel material:binding = </Red>\n"
        "    rel material:binding:collection:some = [</All.collection:some>, </Blue>]\n"
        + "".join(instance(n, "/Leaf", i) for i, n in enumerate("ABC"))
        + "}\n"
    )
    result = flat(body)
    by_material = {
        prim["material"]: len(result.prims[prim["instancer"]]["transforms"])
        for prim in result.prims.values()
        if prim["type"] == "Mesh"
    }
    assert by_material == {"/Red": 2, "/Blue": 1}


def test_inherited_display_color_splits_instances(flat):
    colors = ["(1, 0, 0)", "(0, 1, 0)", "(1, 0, 0)"]
    body = f'class Xform "Leaf"\n{{\n{BALL}}}\n' + "".join(
        instance(f"I{i}", "/Leaf", i, f"    color3f[] primvars:displayColor = [{c}]")
        for i, c in enumerate(colors)
    )
    result = flat(body)
    found = {
        tuple(prim["displayColor"]["values"][0]): len(result.prims[prim["instancer"]]["transforms"])
        for prim in result.prims.values()
        if prim["type"] == "Mesh"
    }
    assert found == {(1.0, 0.0, 0.0): 2, (0.0, 1.0, 0.0): 1}


def test_material_inside_the_prototype_is_emitted_once(flat):
    body = (
        'class Xform "Leaf"\n{\n    def Material "Mat"\n    {\n    }\n'
        '    def Sphere "Ball"\n    {\n        rel material:binding = </Leaf/Mat>\n    }\n}\n'
        + instance("B", "/Leaf", 1)
        + instance("A", "/Leaf", 2)
    )
    prims = flat(body).prims
    assert [k for k, v in prims.items() if v["type"] == "Material"] == ["/A/Mat"]
    assert prims["/B/Ball"]["material"] == "/A/Mat"


def points(body: str, extra: str = "", prototypes: str = "</PI/Ball>") -> str:
    return (
        'def PointInstancer "PI"\n{\n'
        "    point3f[] positions = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]\n"
        "    int[] protoIndices = [0, 0, 0]\n"
        f"    rel prototypes = [{prototypes}]\n"
        "    double3 xformOp:translate = (0, 0, 5)\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n'
        f"{extra}{body}}}\n"
    )


def assert_like_usd_instancer(stage: Usd.Stage, flat) -> None:
    instancer = UsdGeom.PointInstancer.Get(stage, "/PI")
    time = Usd.TimeCode.EarliestTime()
    with_prototype = instancer.ComputeInstanceTransformsAtTime(time, time)
    world = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(instancer.GetPrim()))
    (found,) = world_matrices(flat).values()
    assert found == pytest.approx(np.asarray(with_prototype) @ world, abs=1e-6)


def test_point_instancer_places_like_usd(make_stage):
    arrays = (
        "    float3[] scales = [(1, 2, 3), (1, 1, 1), (0.5, 0.5, 0.5)]\n"
        "    %s[] %s = [(0.7071068, 0.7071068, 0, 0), (1, 0, 0, 0), (0.6, 0, 0.8, 0)]\n"
        "    int64[] ids = [10, 11, 12]\n    int64[] invisibleIds = [11]\n"
    )
    for kind, name in (("quath", "orientations"), ("quatf", "orientationsf")):
        stage = make_stage(points(BALL, arrays % (kind, name)))
        flat = flatten(stage)
        assert_like_usd_instancer(stage, flat)
        assert list(flat.prims) == ["/PI.prototypes[0]", "/PI.prototypes[0].instances"]
        assert flat.prims["/PI.prototypes[0]"]["transform"] == np.eye(4).tolist()
        UsdGeom.PointInstancer.Get(stage, "/PI").DeactivateId(12)
        flat = flatten(stage)
        assert len(world_matrices(flat)["/PI.prototypes[0]"]) == 1
        assert_like_usd_instancer(stage, flat)


def test_velocities_move_instances_between_samples(make_stage):
    extra = (
        "    vector3f[] velocities.timeSamples = {\n        1: [(24, 0, 0), (0, 24, 0), (0, 0, 0)],\n    }\n"
        "    int[] protoIndices.timeSamples = {\n        1: [0, 0, 0],\n    }\n"
    )
    body = (
        points(BALL, extra)
        .replace("    int[] protoIndices = [0, 0, 0]\n", "")
        .replace(
            "    point3f[] positions = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]\n",
            "    point3f[] positions.timeSamples = {\n        1: [(0, 0, 0), (1, 0, 0), (2, 0, 0)],\n    }\n",
        )
    )
    (found,) = world_matrices(flatten(make_stage(body), 1.5)).values()
    assert found[:, 3, :3] == pytest.approx(np.array([[0.5, 1, 5], [1, 1.5, 5], [2, 1, 5]]))


@pytest.mark.parametrize("kind", ["over", "class", "def"])
def test_prototypes_elsewhere(flat, kind):
    prototype = f'{kind} Xform "Proto"\n{{\n{BALL}}}\n'.replace("over Xform", "over")
    result = flat(prototype + points("", prototypes="</Proto>"))
    meshes = world_matrices(result)
    assert len(meshes["/PI.prototypes[0]/Ball"]) == 3
    # What is defined in the scene also renders where it stands.
    assert ("/Proto/Ball" in meshes) == (kind == "def")


def test_point_instancer_of_native_instances_and_the_other_way(make_stage):
    leaf = f'class Xform "Leaf"\n{{\n{BALL}}}\n'
    stage = make_stage(leaf + points(instance("P", "/Leaf", 3), prototypes="</PI/P>"))
    (matrices,) = world_matrices(flatten(stage)).values()
    assert len(matrices) == 3
    bush = 'class Xform "Bush"\n{\n' + points(BALL, prototypes="</Bush/PI/Ball>") + "}\n"
    flat = flatten(make_stage(bush + instance("A", "/Bush", 10) + instance("B", "/Bush", 0)))
    (matrices,) = world_matrices(flat).values()
    assert len(matrices) == 6
    # /B is the identity: its instances stand as the instancer says.
    assert matrices[3:, 3, :3] == pytest.approx(np.array([[0, 1, 5], [1, 1, 5], [2, 1, 5]]))


def test_nested_point_instancers(flat):
    inner = points(BALL, prototypes="</PI/Inner/PI/Ball>")
    outer = points(f'def Xform "Inner"\n{{\n{inner}}}\n', prototypes="</PI/Inner>")
    (matrices,) = world_matrices(flat(outer)).values()
    x = sorted(matrices[:, 3, 0])
    assert x == [0, 1, 1, 2, 2, 2, 3, 3, 4]
    assert set(matrices[:, 3, 2]) == {10.0}


def test_damaged_point_instancers(flat):
    result = flat(points(BALL).replace("[0, 0, 0]", "[0, 7, -1]"))
    (matrices,) = world_matrices(result).values()
    assert len(matrices) == 1
    assert [prim for prim, message in result.warnings if "protoIndices: 2 values" in message] == ["/PI"]

    result = flat(points(BALL, "    float3[] scales = [(2, 2, 2)]\n").replace("[0, 0, 0]", "[0, 0]"))
    (matrices,) = world_matrices(result).values()
    assert len(matrices) == 2 and matrices[0, 0, 0] == 1.0
    assert [message.split(":")[0] for _, message in result.warnings] == ["positions", "scales"]

    result = flat(points("", prototypes="</Gone>"))
    assert result.prims == {} and "/Gone does not exist" in result.warnings[0][1]


def test_instancer_inside_itself_ends(flat):
    cyclic = 'def Xform "Loop"\n{\n' + BALL + points("", prototypes="</Loop>") + "}\n"
    result = flat(cyclic)
    meshes = world_matrices(result)
    assert {key: len(m) for key, m in meshes.items()} == {"/Loop/Ball": 1, "/Loop/PI.prototypes[0]/Ball": 3}
    assert any("contains its own instancer" in message for _, message in result.warnings)


def test_reset_xform_stack_inside_an_instance(make_stage):
    reset = BALL.replace('["xformOp', '["!resetXformStack!", "xformOp')
    body = f'class Xform "Leaf"\n{{\n{reset}}}\n' + instance("A", "/Leaf", 3) + instance("B", "/Leaf", 4)
    (matrices,) = world_matrices(flatten(make_stage(body))).values()
    # The instances coincide, so one is as good as two.
    assert matrices[:, 3, :3].tolist() == [[0, 1, 0]]


def test_lights_in_instances_are_lights_each(flat):
    lamp = (
        'class Xform "Lamp"\n{\n    def SphereLight "Bulb"\n    {\n    }\n'
        '    def Sphere "Glow" (\n        prepend apiSchemas = ["MeshLightAPI"]\n    )\n    {\n    }\n}\n'
    )
    prims = flat(lamp + instance("A", "/Lamp", 1) + instance("B", "/Lamp", 2)).prims
    assert [prims[f"/A/Bulb[{i}]"]["transform"][3][0] for i in range(2)] == [1, 2]
    for i in range(2):
        light, mesh = prims[f"/A/Glow.light[{i}]"], prims[f"/A/Glow[{i}].mesh"]
        assert light["shape"] == {"kind": "mesh", "mesh": f"/A/Glow[{i}].mesh"}
        assert light["transform"] == mesh["transform"] and mesh["instancer"] == ""
    assert not any(prim["type"] == "Instancer" for prim in prims.values())


def test_our_stage(usd_scenes):
    flat = flatten(open_stage(usd_scenes / "instancing.usda"))
    assert flat.warnings == []
    counts = sorted(len(prim["transforms"]) for prim in flat.prims.values() if prim["type"] == "Instancer")
    assert counts == [2, 2, 3, 4]


def test_many_native_instances_are_quick_to_group(make_stage):
    body = f'class Xform "Leaf"\n{{\n{BALL}}}\n' + "".join(instance(f"I{i}", "/Leaf", i) for i in range(2000))
    (matrices,) = world_matrices(flatten(make_stage(body))).values()
    assert len(matrices) == 2000
