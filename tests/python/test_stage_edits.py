"""Hydra: dirty bits from one flattened stage to the next, and what a delegate is told."""

import json
import subprocess
import sys

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdShade, Vt

from dermis.hydra import Delegate, DirtyBits, dirty_bits, populate
from dermis.image import AUTO_CAMERA, Image, render
from dermis.stage import StageError, flatten

STAGE = """
def Mesh "M" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
    color3f[] primvars:displayColor = [(1, 0, 0)]
    rel material:binding = </Mat>
    double3 xformOp:translate = (0, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Material "Mat"
{
    token outputs:surface.connect = </Mat/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        float inputs:roughness = 0.5
        token outputs:surface
    }
}
def Material "Other"
{
}
def SphereLight "L"
{
}
def PointInstancer "PI"
{
    point3f[] positions = [(0, 0, 0), (1, 0, 0)]
    int[] protoIndices = [0, 0]
    rel prototypes = </PI/Ball>
    def Sphere "Ball"
    {
    }
}
"""


class Core:
    """Records the calls that `dermis._core.Delegate` would get."""

    def __init__(self) -> None:
        self.calls: list[tuple] = []
        self.prims: dict[str, dict] = {}

    def sync(self, path: str, prim: str, arrays: list, bits: int) -> None:
        self.prims[path] = json.loads(prim)
        assert all(a.c_contiguous and a.format in ("f", "d", "i") for a in map(memoryview, arrays))
        self.calls.append(("sync", path, DirtyBits(bits)))

    def settings(self) -> str:
        return "{}"

    def __getattr__(self, name: str):
        return lambda *args: self.calls.append((name, *args))


class Renderer(Core):
    """A core that finishes at once."""

    def wait(self, seconds: float) -> bool:
        self.calls.append(("wait",))
        return True

    def snapshot(self) -> dict:
        return {"color": np.zeros((2, 3, 4), np.float32)}

    def stats(self) -> str:
        return '{"samples_per_pixel": 1}'


def synced(core: Core) -> dict[str, DirtyBits]:
    return {call[1]: call[2] for call in core.calls if call[0] == "sync"}


EDITS = {
    "points": (
        lambda s: attribute(s, "/M.points").Set([(0, 0, 1), (1, 0, 1), (0, 1, 1)]),
        {"/M": DirtyBits.POINTS},
    ),
    "transform": (lambda s: attribute(s, "/M.xformOp:translate").Set((1, 2, 3)), {"/M": DirtyBits.TRANSFORM}),
    "color": (lambda s: attribute(s, "/M.primvars:displayColor").Set([(0, 1, 0)]), {"/M": DirtyBits.PRIMVAR}),
    "topology": (lambda s: attribute(s, "/M.faceVertexIndices").Set([0, 2, 1]), {"/M": DirtyBits.TOPOLOGY}),
    "orientation": (lambda s: attribute(s, "/M.orientation").Set("leftHanded"), {"/M": DirtyBits.TOPOLOGY}),
    "normals": (lambda s: attribute(s, "/M.normals").Set([(0, 0, 1)] * 3), {"/M": DirtyBits.NORMALS}),
    "sides": (lambda s: attribute(s, "/M.doubleSided").Set(True), {"/M": DirtyBits.DOUBLE_SIDED}),
    "visibility": (lambda s: attribute(s, "/M.visibility").Set("invisible"), {"/M": DirtyBits.VISIBILITY}),
    "material": (lambda s: attribute(s, "/Mat/S.inputs:roughness").Set(0.1), {"/Mat": DirtyBits.PARAMS}),
    "binding": (
        lambda s: UsdShade.MaterialBindingAPI(s.GetPrimAtPath("/M")).Bind(UsdShade.Material.Get(s, "/Other")),
        {"/M": DirtyBits.MATERIAL_ID, "/Other": DirtyBits.ALL},
    ),
    "light": (lambda s: UsdLux.SphereLight.Get(s, "/L").GetIntensityAttr().Set(3), {"/L": DirtyBits.PARAMS}),
    "light transform": (
        lambda s: UsdGeom.Xformable.Get(s, "/L").AddTranslateOp().Set(Gf.Vec3d(1, 0, 0)),
        {"/L": DirtyBits.PARAMS | DirtyBits.TRANSFORM},
    ),
    "instances": (
        lambda s: attribute(s, "/PI.positions").Set([(0, 0, 0), (5, 0, 0)]),
        {"/PI.prototypes[0].instances": DirtyBits.INSTANCER},
    ),
    "nothing": (lambda s: attribute(s, "/M.points").Set(attribute(s, "/M.points").Get()), {}),
}


def attribute(stage: Usd.Stage, path: str) -> Usd.Attribute:
    prim, name = path.split(".", 1)
    return stage.GetPrimAtPath(prim).GetAttribute(name)


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_sends_only_what_it_touches(make_stage, name):
    stage = make_stage(STAGE)
    edit, expected = EDITS[name]
    before = flatten(stage)
    core = Core()
    edit(stage)
    assert populate(core, flatten(stage), before) == expected
    assert synced(core) == expected
    removed = [call for call in core.calls if call[0] == "remove"]
    assert removed == ([("remove", "/Mat")] if name == "binding" else [])


def test_populate_from_nothing_sends_all(make_stage):
    stage = make_stage(STAGE + 'def DiskLight "Odd"\n{\n    rel light:filters = </F>\n}\n')
    core, flat = Core(), flatten(stage)
    populate(core, flat)
    assert synced(core) == dict.fromkeys(flat.prims, DirtyBits.ALL)
    assert [call[0] for call in core.calls][:1] == ["set_stage"]
    assert [call[1] for call in core.calls if call[0] == "warn"] == ["/Odd"]


def test_removal_and_change_of_type(make_stage):
    stage = make_stage(STAGE)
    before, core = flatten(stage), Core()
    stage.RemovePrim("/L")
    stage.DefinePrim("/M", "SphereLight")
    populate(core, flatten(stage), before)
    assert {call[1] for call in core.calls if call[0] == "remove"} == {"/L", "/M", "/Mat"}
    assert synced(core) == {"/M": DirtyBits.ALL}


def test_subset_bits():
    faces = np.array([0], np.int32)
    old = {"type": "Mesh", "geomSubsets": [{"path": "/M/a", "indices": faces, "material": "/A"}]}
    new = {"type": "Mesh", "geomSubsets": [{"path": "/M/a", "indices": faces, "material": "/B"}]}
    assert dirty_bits(old, new) == DirtyBits.MATERIAL_ID
    new["geomSubsets"][0] |= {"indices": faces + 1, "material": "/A"}
    assert dirty_bits(old, new) == DirtyBits.TOPOLOGY


def test_equal_arrays_of_other_memory_are_clean(make_stage):
    first, second = flatten(make_stage(STAGE)), flatten(make_stage(STAGE))
    assert populate(Core(), second, first) == {}


def test_delegate_takes_dicts_and_stage_prims(make_stage):
    core = Core()
    delegate = Delegate(core)
    delegate.sync("/A", {"type": "Mesh", "points": np.asarray(Vt.Vec3fArray(3))})
    assert core.prims["/A"]["points"] == {"array": 0}
    stage = make_stage(STAGE)
    delegate.sync("/M", stage.GetPrimAtPath("/M"))
    assert core.prims["/M"]["material"] == "/Mat" and core.prims["/Mat"]["shader"] == "UsdPreviewSurface"
    core.calls.clear()
    delegate.sync("/M", stage.GetPrimAtPath("/M"), DirtyBits.TRANSFORM)
    assert synced(core) == {"/M": DirtyBits.TRANSFORM}
    delegate.sync("/Mat", stage.GetPrimAtPath("/Mat"), DirtyBits.PARAMS)
    assert synced(core)["/Mat"] == DirtyBits.PARAMS
    with pytest.raises(ValueError, match="[Oo]ut of range"):
        delegate.sync("/L", {"type": "Light", "intensity": float("inf")})


def test_stage_prim_keeps_its_inherited_state(make_stage):
    body = (
        'def Xform "G"\n{\n    double3 xformOp:translate = (1, 2, 3)\n    token visibility = "invisible"\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n    def Sphere "S"\n    {\n    }\n}\n'
    )
    core = Core()
    stage = make_stage(body)
    Delegate(core).sync("/G/S", stage.GetPrimAtPath("/G/S"))
    assert core.prims["/G/S"]["transform"][3] == [1, 2, 3, 1] and core.prims["/G/S"]["visible"] is False


def test_render_frames_a_stage_without_camera(make_stage):
    made: list[Renderer] = []

    def core() -> Renderer:
        made.append(Renderer())
        return made[0]

    image = render(make_stage(STAGE), core=core, samples=4)
    assert isinstance(image, Image) and image.color.shape == (2, 3, 4) and list(image) == ["color"]
    assert image.stats == {"samples_per_pixel": 1}
    assert made[0].prims[AUTO_CAMERA]["type"] == "Camera"
    names = [call[0] for call in made[0].calls]
    assert names[-3:] == ["commit", "start", "wait"]
    settings = [json.loads(call[1]) for call in made[0].calls if call[0] == "set_settings"]
    assert settings == [{"camera": AUTO_CAMERA, "resolution": [960, 700]}, {"samples": 4}]
    with pytest.raises(AttributeError, match="has no 'depth'"):
        _ = image.depth


def test_render_stops_on_interrupt(make_stage):
    class Interrupted(Renderer):
        def wait(self, seconds: float) -> bool:
            raise KeyboardInterrupt

    core = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        render(make_stage(STAGE), core=lambda: core)
    assert core.calls[-1] == ("stop",)


def test_render_of_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(StageError, match="Could not open layer"):
        render(tmp_path / "gone.usda", core=Core)


def test_reading_stages_needs_no_core():
    code = "import sys, dermis, dermis.stage; dermis.flatten; assert 'dermis._core' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    code = "import sys, dermis; assert 'pxr' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
