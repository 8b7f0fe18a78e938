"""Edits of a stage through the real core: only what is dirty is sent and compiled, the image is a fresh load's."""

from __future__ import annotations

import json
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, Vt

core = pytest.importorskip("dermis._core")

from dermis import hydra, merging  # noqa: E402
from dermis.hydra import Delegate  # noqa: E402
from dermis.stage import flatten  # noqa: E402

STAGE = """#usda 1.0
(upAxis = "Y")
def Camera "Cam"
{
    float horizontalAperture = 20
    float verticalAperture = 20
    float focalLength = 50
    float2 clippingRange = (0.1, 1000)
    double3 xformOp:translate = (0, 0, 12)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    double radius = 1
    double3 xformOp:translate = (-1, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    rel material:binding = </Skin>
}
def Cube "Box"
{
    double size = 1.2
    color3f[] primvars:displayColor = [(0.2, 0.5, 0.8)]
    double3 xformOp:translate = (1.2, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Material "Skin"
{
    token outputs:surface.connect = </Skin/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:subsurface = 1
        color3f inputs:subsurfaceColor = (0.8, 0.5, 0.4)
        color3f inputs:subsurfaceRadius = (0.3, 0.1, 0.05)
        token outputs:surface
    }
}
def SphereLight "Lamp"
{
    float inputs:intensity = 60
    double3 xformOp:translate = (3, 4, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""

SETTINGS = {"camera": "/Cam", "resolution": [24, 24], "samples": 4, "aovs": []}


def open_stage() -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(STAGE)
    return stage


def image(delegate: core.Delegate) -> tuple[np.ndarray, dict]:
    delegate.set_settings(json.dumps(SETTINGS))
    built = json.loads(delegate.commit())
    delegate.start()
    assert delegate.wait(120)
    return delegate.snapshot()["color"], built


def move(stage: Usd.Stage) -> None:
    UsdGeom.XformCommonAPI(stage.GetPrimAtPath("/Ball")).SetTranslate(Gf.Vec3d(-0.6, 0.4, 0.2))


def recolour(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Skin/Surface").GetAttribute("inputs:subsurfaceColor").Set(Gf.Vec3f(0.1, 0.8, 0.3))


def reshape(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Box").GetAttribute("size").Set(1.7)


def relight(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Lamp").GetAttribute("inputs:intensity").Set(20.0)


def hide(stage: Usd.Stage) -> None:
    UsdGeom.Imageable(stage.GetPrimAtPath("/Box")).MakeInvisible()


def deactivate(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath("/Ball").SetActive(False)


EDITS = [
    # edit, prims that are synced again, geometries that it compiles
    (move, {"/Ball"}, 0),
    (recolour, {"/Skin"}, 0),
    (reshape, {"/Box"}, 1),
    (relight, {"/Lamp"}, 0),
    (hide, {"/Box"}, 0),
    (deactivate, set(), 0),  # gone prims are removed, not synced
]


@pytest.mark.parametrize(("edit", "touched", "built"), EDITS, ids=[edit[0].__name__ for edit in EDITS])
def test_edit_equals_fresh_load(edit: Callable[[Usd.Stage], None], touched: set[str], built: int) -> None:
    stage = open_stage()
    delegate = core.Delegate()
    before = flatten(stage)
    hydra.populate(delegate, before)
    first, first_built = image(delegate)
    assert first_built["blas_built"] == 2

    edit(stage)
    changed = hydra.populate(delegate, flatten(stage), previous=before)
    assert set(changed) == touched
    edited, edited_built = image(delegate)
    assert edited_built["blas_built"] == built

    fresh = core.Delegate()
    hydra.populate(fresh, flatten(stage))
    expected, _ = image(fresh)
    np.testing.assert_array_equal(edited, expected)
    assert not np.array_equal(edited, first)


def test_edit_stops_a_render_under_way() -> None:
    delegate = core.Delegate()
    hydra.populate(delegate, flatten(open_stage()))
    delegate.set_settings(json.dumps({**SETTINGS, "samples": 1_000_000}))
    delegate.commit()
    delegate.start()
    assert not delegate.wait(0.2)
    partial = delegate.snapshot()["color"]
    assert np.isfinite(partial).all()
    delegate.remove("/Lamp")
    assert delegate.poll()[1], "an edit ends the render"
    with pytest.raises(core.CoreError, match="commit"):
        delegate.start()


SURFACE = STAGE.replace(
    'def Cube "Box"\n{\n    double size = 1.2',
    """def Mesh "Box"
{
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]
    point3f[] points = [(-1, -1, -1), (1, -1, -1), (-1, 1, -1), (1, 1, -1),
        (-1, -1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, 1)]""",
)


def test_a_refine_level_and_creases_are_edits_of_their_mesh():
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(SURFACE)
    delegate, flat = hydra.Delegate(), flatten(stage)
    hydra.populate(delegate.core, flat)
    delegate.set_settings(camera="/Cam", resolution=[8, 8], refineLevel=2)

    def triangles() -> tuple[int, int]:
        built = delegate.commit()["blas_built"]
        (surface,) = json.loads(delegate.core.explain())["subdivision"]
        return built, surface["triangles"]

    assert triangles() == (2, 192)
    delegate.set_settings(samples=1)
    assert triangles() == (0, 192)
    delegate.set_settings(refineLevel=1)
    assert triangles() == (1, 48)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Box"))
    mesh.CreateCreaseIndicesAttr([0, 1])
    mesh.CreateCreaseLengthsAttr([2])
    mesh.CreateCreaseSharpnessesAttr([3.0])
    edited = flatten(stage)
    assert hydra.populate(delegate.core, edited, flat) == {"/Box": hydra.DirtyBits.TOPOLOGY}
    assert triangles() == (1, 48)


def widths(points: object) -> Iterator[float]:
    """Of a mesh that has them in a delegate, as often as they are asked for."""
    delegate = Delegate()
    triangle = {
        "faceVertexCounts": np.array([3], np.int32),
        "faceVertexIndices": np.arange(3, dtype=np.int32),
    }
    delegate.sync("/M", {"type": "Mesh", "points": points, **triangle})
    while True:
        yield delegate.core.bounds()[1][0]


def test_arrays_are_shared_only_where_nobody_writes_to_them():
    """USD copies its arrays when one of several owners writes; numpy does not."""
    owned = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float32)
    of_usd = Vt.Vec3fArray.FromNumpy(owned)
    frozen = owned.copy()
    frozen.flags.writeable = False

    def thaw() -> None:
        frozen.flags.writeable = True
        frozen[1, 0] = 7

    for points, change in (
        (owned, lambda: owned.__setitem__((1, 0), 7)),
        (np.asarray(of_usd), lambda: of_usd.__setitem__(1, Gf.Vec3f(7, 0, 0))),
        (frozen, thaw),
    ):
        width = widths(points)
        assert next(width) == 1.0
        change()
        assert next(width) == 1.0


def test_a_large_mesh_of_usd_is_in_memory_once():
    def resident() -> int:
        return 4096 * int(Path("/proc/self/statm").read_text().split()[1])

    count = 2_000_000
    points = np.asarray(Vt.Vec3fArray(count))
    before, delegate = resident(), Delegate()
    delegate.sync("/M", {"type": "Mesh", "points": points})
    assert resident() - before < 12 * count / 4


def test_the_last_commit_lets_go_what_meshes_are_made_of(tmp_path):
    """The same picture, the same fingerprint, and an error for whoever goes on."""
    settings = {"camera": "/Cam", "resolution": [16, 16], "samples": 2}
    images, files = [], []
    for last in (False, True):
        delegate = Delegate()
        hydra.populate(delegate.core, flatten(open_stage()))
        delegate.set_settings(**settings)
        assert delegate.commit(last)["blas_built"] == 2
        delegate.start()
        assert delegate.wait(60.0)
        images.append(delegate.snapshot()["color"])
        files.append(tmp_path / f"{last}.exr")
        delegate.core.write_exr(str(files[-1]), "{}")
        assert delegate.core.bounds()[1][0] == pytest.approx(1.8)
    np.testing.assert_array_equal(*images)
    assert len({merging.read_part(str(file)).attributes["dermis:fingerprint"] for file in files}) == 1
    delegate.set_settings(samples=3)
    for follow in (
        delegate.commit,
        lambda: delegate.commit(True),
        lambda: delegate.core.save(str(tmp_path / "a")),
    ):
        with pytest.raises(core.CoreError, match="last commit"):
            follow()


def test_a_last_commit_that_fails_can_be_mended():
    delegate = Delegate()
    hydra.populate(delegate.core, flatten(open_stage()))
    delegate.set_settings(camera="/Nowhere")
    with pytest.raises(core.CoreError, match="no such camera"):
        delegate.commit(last=True)
    delegate.set_settings(camera="/Cam")
    assert delegate.commit(last=True)["blas_built"] == 2


def test_indices_beyond_the_values_of_a_primvar_cost_the_primvar():
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(STAGE)
    box = UsdGeom.Mesh.Define(stage, "/Sheet")
    box.GetPointsAttr().Set([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    box.GetFaceVertexCountsAttr().Set([3])
    box.GetFaceVertexIndicesAttr().Set([0, 1, 2])
    color = box.CreateDisplayColorPrimvar("uniform")
    color.Set([(1, 0, 0), (0, 1, 0)])
    said = []
    for index in (1, 2):
        color.SetIndices([index])
        delegate = Delegate()
        hydra.populate(delegate.core, flatten(stage))
        delegate.set_settings(camera="/Cam")
        delegate.commit()
        said.append([entry for entry in delegate.stats()["warnings"] if entry["prim"] == "/Sheet"])
    assert said[0] == [] and "indices are outside its 2 values" in said[1][0]["message"]


def test_bounds_go_around_the_boxes_of_meshes():
    turned = np.array([[1, 1, 0, 0], [-1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)
    moved = np.eye(4)
    moved[3, 0] = 10.0
    places = np.stack([np.eye(4), moved])
    triangle = {
        "type": "Mesh",
        "points": np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float32),
        "faceVertexCounts": np.array([3], np.int32),
        "faceVertexIndices": np.arange(3, dtype=np.int32),
        "transform": turned.tolist(),
        "instancer": "/Many",
    }
    delegate = Delegate()
    hydra.populate(delegate.core, flatten(open_stage()))
    for path in [path for path, prim in flatten(open_stage()).prims.items() if prim["type"] == "Mesh"]:
        delegate.remove(path)
    delegate.sync("/Many", {"type": "Instancer", "transforms": places})
    delegate.sync("/M", triangle)
    delegate.set_settings(camera="/Cam")
    for commit in (False, True):
        delegate.commit(commit)
        # The corner (1, 1) of the box, where the triangle has no point, goes to (0, 2).
        assert delegate.core.bounds() == ([-1.0, 0.0, 0.0], [11.0, 2.0, 0.0])


def test_warnings_of_the_bridge_are_those_of_the_last_flattening():
    delegate, said = Delegate(), lambda: [entry["message"] for entry in delegate.stats()["warnings"]]
    first, second = flatten(open_stage()), flatten(open_stage())
    first.warnings, second.warnings = [("/A", "in both"), ("/A", "once")], [("/A", "in both"), ("/B", "new")]
    hydra.populate(delegate.core, first)
    assert said() == ["in both", "once"]
    hydra.populate(delegate.core, second, first)
    assert said() == ["in both", "new"]


def test_arrays_of_usd_are_given_back_with_the_last_commit():
    points = Vt.Vec3fArray.FromNumpy(np.eye(3, dtype=np.float32))
    view = np.asarray(points)
    gone = weakref.ref(view)
    delegate = Delegate()
    hydra.populate(delegate.core, flatten(open_stage()))
    faces = {"faceVertexCounts": np.array([3], np.int32), "faceVertexIndices": np.arange(3, dtype=np.int32)}
    delegate.sync("/M", {"type": "Mesh", "points": view, **faces})
    delegate.set_settings(camera="/Cam")
    del view, points
    assert gone() is not None
    delegate.commit(last=True)
    assert gone() is None
