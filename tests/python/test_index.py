"""What a stage is asked as a whole: right after every edit, and asked once, not by prim, instance or motion key."""

import json
import random
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import stage_of
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdSkel
from test_skel import animation, influences, new_stage, skeleton, tube

from dermis import emit, index, linking, stage
from dermis.cli import build_parser
from dermis.cli.scene import open_scene
from dermis.cli.settings import default_settings
from dermis.index import Index, index_of
from dermis.stage import flatten, flatten_prim

SHOT = """
    startTimeCode = 1
    timeCodesPerSecond = 24
"""


@pytest.fixture
def counted(monkeypatch):
    """counted(module, name) counts the calls of a function or method."""
    calls = Counter()

    def count(owner: object, name: str) -> Counter:
        whole = getattr(owner, name)

        def wrapper(*args, **named):
            calls[name] += 1
            return whole(*args, **named)

        monkeypatch.setattr(owner, name, wrapper)
        return calls

    return count


# Edits


def prototype(of: Usd.Stage, path: str) -> None:
    UsdGeom.Mesh.Define(of, f"{path}/Mesh")
    UsdLux.SphereLight.Define(of, f"{path}/Lamp")
    UsdGeom.Camera.Define(of, f"{path}/Eye")


def instance(of: Usd.Stage, path: str, source: str) -> None:
    prim = UsdGeom.Xform.Define(of, path).GetPrim()
    prim.GetReferences().AddInternalReference(source)
    prim.SetInstanceable(True)


def reader_of(of: Usd.Stage, path: str, name: str) -> None:
    shader = UsdShade.Shader.Define(of, path)
    material = UsdShade.Material.Define(of, "/Look")
    wish = material.CreateInput("wish", Sdf.ValueTypeNames.String)
    wish.Set(name)
    shader.CreateInput("varname", Sdf.ValueTypeNames.String).ConnectToSource(wish)


def shift(xform: UsdGeom.Xformable, chance: random.Random) -> None:
    time = chance.choice([Usd.TimeCode.Default(), 1.0, 2.0])
    UsdGeom.XformCommonAPI(xform).SetTranslate((chance.random(), 0, 0), time)


def edit(of: Usd.Stage, chance: random.Random) -> None:
    n = chance.randrange(4)
    if there := of.GetPrimAtPath(f"/World/G{n}"):
        there.SetActive(True)
    xform = UsdGeom.Xformable(UsdGeom.Xform.Define(of, f"/World/G{n}"))
    choices = [
        lambda: prototype(of, f"/World/G{n}/Deep{chance.randrange(3)}"),
        lambda: of.RemovePrim(f"/World/G{n}"),
        lambda: instance(of, f"/World/I{n}", f"/Proto{chance.randrange(2)}"),
        lambda: of.RemovePrim(f"/World/I{n}"),
        lambda: of.RemovePrim("/Proto1/Lamp"),
        lambda: prototype(of, f"/Proto{chance.randrange(2)}"),
        lambda: shift(UsdGeom.Mesh.Define(of, f"/Proto0/More{n}"), chance),
        lambda: shift(xform, chance),
        lambda: xform.ClearXformOpOrder() and xform.GetPrim().RemoveProperty("xformOp:translate"),
        lambda: xform.GetPrim().SetActive(chance.random() < 0.5),
        lambda: reader_of(of, f"/Look/S{n}", f"name{chance.randrange(5)}"),
        lambda: of.RemovePrim(f"/Look/S{n}"),
        lambda: UsdLux.DomeLight.Define(of, f"/World/Dome{n}"),
        lambda: of.GetPrimAtPath("/World").GetPrim() and UsdLux.LightAPI.Apply(xform.GetPrim()),
        lambda: of.OverridePrim(f"/World/G{n}/Over/Lamp").SetTypeName("RectLight"),
    ]
    chance.choice(choices)()


def said(of: Usd.Stage, found: Index) -> tuple:
    """Everything that an index answers."""
    paths = [[str(prim.GetPath()) for prim in prims] for prims in (found.lights(of), found.domes(of))]
    movers = {str(prim.GetPath()): facts for prim, facts in found.movers(of)}
    cameras = sorted(str(prim.GetPath()) for prim in found.cameras(of, "Eye"))
    links = sorted(found.links(of)[0].names.items())
    return paths[0], sorted(paths[1]), movers, cameras, found.primvars_read(of), links


@pytest.mark.parametrize("seed", range(6))
def test_after_any_edits_it_is_that_of_a_stage_just_opened(seed):
    chance, of = random.Random(seed), Usd.Stage.CreateInMemory()
    for path in ("/Proto0", "/Proto1", "/World/G0"):
        prototype(of, path)
    kept, seen = index_of(of), set()
    for _ in range(60):
        for _ in range(chance.randrange(1, 4)):
            edit(of, chance)
        expected = said(of, Index(of))
        assert said(of, kept) == expected
        seen.add(repr(expected))
    assert len(seen) > 30, "the edits changed something"


def test_a_stage_that_is_gone_leaves_no_index():
    of = stage_of('def Sphere "S"\n{\n}\n')
    flatten(of)
    before = len(index.INDICES)
    del of
    assert len(index.INDICES) == before - 1


def many(count: int) -> Usd.Stage:
    of = stage_of(
        'def Camera "main_cam"\n{\n    double shutter:close = 0.5\n}\n'
        'def DomeLight "Dome"\n{\n    rel portals = </Door>\n}\ndef PortalLight "Door"\n{\n}\n',
        SHOT,
    )
    for i in range(count):
        UsdGeom.Sphere.Define(of, f"/World/G{i % 10}/S{i}").AddTranslateOp().Set((i, 0, 0))
    return of


def test_the_edit_of_a_prim_looks_at_that_prim_alone(counted):
    of = many(300)
    flatten(of, 1.0)
    calls = counted(index, "facts")
    counted(stage, "Walk")
    for i in range(5):
        prim = of.GetPrimAtPath(f"/World/G{i}/S{i}")
        UsdGeom.Sphere(prim).GetRadiusAttr().Set(2.0 + i)
        assert set(flatten_prim(prim, 1.0).prims) == {str(prim.GetPath())}
    assert calls["facts"] == 5
    flatten_prim(of.GetPrimAtPath("/World/G7"), 1.0)
    assert calls["facts"] == 5
    # The dome comes along with its portal.
    assert set(flatten_prim(of.GetPrimAtPath("/Door"), 1.0).prims) == {"/Dome"}


def test_many_edits_cost_no_more_than_a_look_at_everything():
    of, roots = many(0), 3000
    for i in range(roots):
        UsdLux.SphereLight.Define(of, f"/R{i}/L")
    found, start = Index(of), time.perf_counter()
    assert len(found.lights(of)) == roots + 2
    whole = time.perf_counter() - start
    found.stale.subtrees.update(Sdf.Path(f"/R{i}") for i in range(roots))
    found.stale.prims.update(Sdf.Path(f"/R{i}/L") for i in range(roots))
    start = time.perf_counter()
    assert len(found.lights(of)) == roots + 2
    assert time.perf_counter() - start < 5.0 * whole + 0.1


@pytest.fixture
def restless():
    """Threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_threads_may_flatten_one_stage(restless):
    of = many(100)
    expected = said(of, Index(of))
    with ThreadPoolExecutor(8) as pool:
        for _ in range(30):
            index_of(of).stale.subtrees.add(Sdf.Path.absoluteRootPath)
            answers = list(pool.map(lambda _: said(of, index_of(of)), range(8)))
            assert all(answer == expected for answer in answers)


# Instances


def linked(instances: int) -> Usd.Stage:
    of = stage_of('def Xform "Proto"\n{\n    def Sphere "S"\n    {\n    }\n}\n')
    for i in range(4):
        lamp = UsdLux.SphereLight.Define(of, f"/Lamp{i}")
        UsdLux.LightAPI(lamp).GetLightLinkCollectionAPI().CreateExcludesRel().SetTargets([f"/World/I{i}"])
    for i in range(instances):
        instance(of, f"/World/I{i}", "/Proto")
    return of


@pytest.mark.parametrize("instances", [10, 200])
def test_rules_of_links_are_asked_once_for_instances_alike(instances, counted):
    calls = counted(linking.Collection, "has")
    of = linked(instances)
    found = flatten(of)
    # Four instances are named; all others of one parent answer once, as do prims below the root and each prototype.
    assert calls["has"] <= 4 * (4 + 1 + 1 + 5 + 2)
    apart = [prim for key, prim in found.prims.items() if key.startswith("/World") and prim["type"] == "Mesh"]
    assert sorted(len(mesh["categories"]) for mesh in apart) == [3, 3, 3, 3, 4]


# Motion keys


def herd(meshes: int) -> Usd.Stage:
    of = new_stage()
    of.SetStartTimeCode(1)
    camera = UsdGeom.Camera.Define(of, "/main_cam")
    camera.CreateShutterCloseAttr(0.5)
    UsdSkel.Root.Define(of, "/Hero")
    skel = skeleton(of, "/Hero")
    anim = animation(of, "/Hero/Anim", 70.0)
    UsdSkel.BindingAPI.Apply(skel.GetPrim()).CreateAnimationSourceRel().SetTargets([anim.GetPath()])
    for i in range(meshes):
        influences(tube(of, f"/Hero/Body{i}", None)).CreateSkeletonRel().SetTargets([skel.GetPath()])
    return of


def test_skeletons_are_populated_once_and_joints_computed_once_a_time(counted):
    calls = counted(UsdSkel.Cache, "Populate")
    counted(UsdSkel.SkeletonQuery, "ComputeSkinningTransforms")
    counted(index, "Links")
    of = herd(5)
    found = flatten(of, 2.0)
    keys = [len(found.prims[f"/Hero/Body{i}"]["pointKeys"]["times"]) for i in range(5)]
    assert min(keys) >= 2
    assert calls["Populate"] == 1 and calls["Links"] == 1
    few = calls["ComputeSkinningTransforms"]
    assert few < 5 * max(keys)
    # As many for fifty meshes, and none for another look at one.
    calls.clear()
    flatten(herd(50), 2.0)
    assert (calls["Populate"], calls["ComputeSkinningTransforms"]) == (1, few)
    flatten_prim(of.GetPrimAtPath("/Hero/Body3"), 2.0)
    assert calls["Populate"] == 1


def test_a_skeleton_that_is_edited_moves_its_mesh():
    of = herd(1)
    before = flatten(of, 5.0).prims["/Hero/Body0"]["points"]
    skel = UsdSkel.Skeleton.Get(of, "/Hero/Skel")
    skel.GetBindTransformsAttr().Set([Gf.Matrix4d(1.0), Gf.Matrix4d().SetTranslate((0, 2, 0))])
    after = flatten(of, 5.0).prims["/Hero/Body0"]["points"]
    fresh = flatten(Usd.Stage.Open(of.Flatten()), 5.0).prims["/Hero/Body0"]["points"]
    assert (after == fresh).all() and not (after == before).all()


@pytest.mark.parametrize(
    ("name", "edited"),
    [
        ("Rotations", lambda old: Gf.Quatf(0.8, 0.0, 0.0, 0.6)),
        ("Translations", lambda old: old + Gf.Vec3f(0, 1, 0)),
        ("Scales", lambda old: old * 2),
    ],
)
def test_an_animation_that_is_edited_moves_its_mesh(name, edited):
    of = herd(1)
    anim = UsdSkel.Animation.Get(of, "/Hero/Anim")
    attribute = getattr(anim, f"Get{name}Attr")()
    rest = attribute.Get(1.0)
    attribute.Clear()
    attribute.Set(rest)
    before = flatten(of, 5.0).prims["/Hero/Body0"]["points"]
    # UsdSkel looks once whether there are samples.
    attribute.Set(type(rest)([edited(value) for value in rest]), 5.0)
    after = flatten(of, 5.0).prims["/Hero/Body0"]["points"]
    fresh = flatten(Usd.Stage.Open(of.Flatten()), 5.0).prims["/Hero/Body0"]["points"]
    assert (after == fresh).all() and not (after == before).all()
    assert index_of(of).skeletons
    anim.GetBlendShapeWeightsAttr().Set([0.5, 0.5], 5.0)
    assert not index_of(of).skeletons


# Frames

RANGE = """
def Camera "main_cam"
{
}
def Xform "World"
{
    color3f[] primvars:displayColor = [(1, 0, 0)]
    def Mesh "Moves"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points.timeSamples = {1: [(0, 0, 1), (1, 0, 1), (0, 1, 1)], 3: [(0, 0, 2), (1, 0, 2), (0, 1, 2)]}
    }
    def Mesh "Flies"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points.timeSamples = {1: [(0, 0, 1), (1, 0, 1), (0, 1, 1)]}
        vector3f[] velocities.timeSamples = {1: [(1, 0, 0), (1, 0, 0), (1, 0, 0)]}
    }
    def Mesh "Stays"
    {
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 1), (1, 0, 1), (0, 1, 1)]
        double3 xformOp:translate.timeSamples = {1: (0, 0, 0), 3: (0, 0, 1)}
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Sphere "Ball"
    {
    }
}
"""


def test_a_range_of_frames_reads_again_what_has_samples(tmp_path, counted):
    of = stage_of(RANGE, SHOT)
    of.GetRootLayer().Export(str(tmp_path / "s.usda"))
    parser, parsers = build_parser()
    args = parser.parse_args(["record", str(tmp_path / "s.usda"), "f.#.exr", "-f", "1:3"])
    scene = open_scene(parsers["record"], args, default_settings(), ("outputImagePath",))
    calls = counted(emit, "flatten_mesh")
    read, prims = [], []
    for when in scene.times:
        loaded = scene.load(when)
        read.append(calls["flatten_mesh"])
        prims.append(scene._previous.prims)
        json.loads(loaded.delegate.commit())
    # Stays has a transform with samples: an attribute of its own, though none of its shape.
    assert [b - a for a, b in zip([0, *read], read, strict=False)] == [4, 3, 3]
    for when, found in zip(scene.times, prims, strict=True):
        alone = flatten(Usd.Stage.Open(str(tmp_path / "s.usda")), when).prims
        for path in ("/World/Moves", "/World/Flies", "/World/Stays", "/World/Ball"):
            assert np.array_equal(found[path]["points"], alone[path]["points"])
            assert found[path]["transform"] == alone[path]["transform"]
            assert found[path]["displayColor"]["values"].tolist() == [[1, 0, 0]]


def test_a_stage_that_was_edited_between_frames_is_read_again():
    of = stage_of(RANGE, SHOT)
    first = flatten(of, 1.0)
    UsdGeom.Sphere.Get(of, "/World/Ball").GetRadiusAttr().Set(3.0)
    second = flatten(of, 2.0, previous=first)
    assert abs(second.prims["/World/Ball"]["points"]).max() > 2.9


def test_meshes_of_another_stage_are_read():
    first = flatten(stage_of(RANGE, SHOT), 1.0)
    larger = 'def Sphere "Ball"\n    {\n        double radius = 3\n'
    other = stage_of(RANGE.replace('def Sphere "Ball"\n    {\n', larger), SHOT)
    assert abs(flatten(other, 1.0, previous=first).prims["/World/Ball"]["points"]).max() > 2.9


def test_inherited_indices_with_samples_are_read_in_every_frame():
    indexed = "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)]\n"
    indexed += "    int[] primvars:displayColor:indices.timeSamples = {1: [0], 2: [1]}"
    of = stage_of(RANGE.replace("color3f[] primvars:displayColor = [(1, 0, 0)]", indexed), SHOT)
    first = flatten(of, 1.0)
    second = flatten(of, 2.0, previous=first)
    colors = [flat.prims["/World/Ball"]["displayColor"]["indices"].tolist() for flat in (first, second)]
    assert colors == [[0], [1]]
