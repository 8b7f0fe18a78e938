"""UsdSkel against usd-core's own baked result: the same stage, once as it is, once through UsdSkelBakeSkinning."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

import dermis
from dermis.stage import flatten

HEIGHT = 8
TIMES = (1.0, 3.5, 10.0)


def tube(stage: Usd.Stage, path: str, interpolation: str | None) -> UsdGeom.Mesh:
    """Four sides, HEIGHT segments; normals where `interpolation` is one."""
    corners = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)], float)
    points = [(x, float(h), z) for h in range(HEIGHT + 1) for x, z in corners]
    faces = [
        (4 * h + s, 4 * h + 4 + s, 4 * h + 4 + (s + 1) % 4, 4 * h + (s + 1) % 4)
        for h in range(HEIGHT)
        for s in range(4)
    ]
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr([4] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(np.ravel(faces).tolist())
    if interpolation:
        mesh.CreateSubdivisionSchemeAttr("none")
        normals = np.array([(x, 0.2, z) for x, _, z in points])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        chosen = normals if interpolation == "vertex" else normals[np.ravel(faces)]
        mesh.CreateNormalsAttr([tuple(n) for n in chosen])
        mesh.SetNormalsInterpolation(interpolation)
    return mesh


def skeleton(stage: Usd.Stage, root: str) -> UsdSkel.Skeleton:
    skel = UsdSkel.Skeleton.Define(stage, f"{root}/Skel")
    skel.CreateJointsAttr(["hip", "hip/knee"])
    skel.CreateBindTransformsAttr([Gf.Matrix4d(1.0), Gf.Matrix4d().SetTranslate((0, 4, 0))])
    skel.CreateRestTransformsAttr([Gf.Matrix4d(1.0), Gf.Matrix4d().SetTranslate((0, 4, 0))])
    UsdGeom.Xformable(skel).AddTranslateOp().Set((0.5, 0, 0.25))
    return skel


def animation(stage: Usd.Stage, path: str, degrees: float) -> UsdSkel.Animation:
    anim = UsdSkel.Animation.Define(stage, path)
    anim.CreateJointsAttr(["hip/knee", "hip"])
    anim.CreateTranslationsAttr([(0, 4, 0), (0, 0, 0)])
    anim.CreateScalesAttr([(1, 1.5, 1), (1, 1, 1)])
    rotations = anim.CreateRotationsAttr()
    for time, share in ((1.0, 0.0), (10.0, 1.0)):
        turn = Gf.Quatf(Gf.Rotation((0, 0, 1), degrees * share).GetQuat())
        rotations.Set([turn, Gf.Quatf(1.0)], time)
    anim.CreateBlendShapesAttr(["bulge", "lean"])
    weights = anim.CreateBlendShapeWeightsAttr()
    weights.Set([0.0, 1.0], 1.0)
    weights.Set([1.0, 0.25], 10.0)
    return anim


def influences(mesh: UsdGeom.Mesh) -> UsdSkel.BindingAPI:
    """Two joints a point, from the first at the foot to the second at the head."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    share = np.repeat(np.linspace(0, 1, HEIGHT + 1), 4)
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * len(share))
    binding.CreateJointWeightsPrimvar(False, 2).Set(np.stack([1 - share, share], 1).ravel().tolist())
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetScale((1.0, 1.0, 0.5)))
    return binding


def shapes(stage: Usd.Stage, mesh: UsdGeom.Mesh) -> None:
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    path = mesh.GetPath()
    bulge = UsdSkel.BlendShape.Define(stage, path.AppendChild("Bulge"))
    bulge.CreateOffsetsAttr([(0, 0, 0.5), (0.25, 0, 0)])
    bulge.CreateNormalOffsetsAttr([(0, 0, 0.2), (0, -0.3, 0)])
    bulge.CreatePointIndicesAttr([9, 16])
    between = bulge.CreateInbetween("half")
    between.SetWeight(0.5)
    between.SetOffsets([(0, 0, 2.0), (0.5, 0, 0)])
    lean = UsdSkel.BlendShape.Define(stage, path.AppendChild("Lean"))
    lean.CreateOffsetsAttr([(0.1 * h, 0, 0) for h in range(HEIGHT + 1) for _ in range(4)])
    binding.CreateBlendShapesAttr(["lean", "bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets([lean.GetPath(), bulge.GetPath()])


def character(
    stage: Usd.Stage, root: str = "/World/Hero", interpolation: str | None = None, shaped: bool = False
):
    skel_root = UsdSkel.Root.Define(stage, root)
    UsdGeom.Xformable(skel_root).AddRotateYOp().Set(30.0)
    skel = skeleton(stage, root)
    anim = animation(stage, f"{root}/Anim", 70.0)
    UsdSkel.BindingAPI.Apply(skel.GetPrim()).CreateAnimationSourceRel().SetTargets([anim.GetPath()])
    mesh = tube(stage, f"{root}/Body", interpolation)
    UsdGeom.Xformable(mesh).AddScaleOp().Set((2.0, 1.0, 1.0))
    influences(mesh).CreateSkeletonRel().SetTargets([skel.GetPath()])
    if shaped:
        shapes(stage, mesh)
    return mesh


def new_stage() -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(10)
    return stage


def placed(stage: Usd.Stage, time: float, path: str) -> tuple[np.ndarray, np.ndarray | None]:
    """World points and normals of a mesh as dermis flattens it."""
    flat = flatten(stage, time)
    assert not flat.warnings, flat.warnings
    mesh = flat.prims[path]
    matrix = np.array(mesh["transform"])
    points = mesh["points"] @ matrix[:3, :3] + matrix[3, :3]
    if "normals" not in mesh:
        return points, None
    values = mesh["normals"]["values"]
    normals = (
        values[mesh["normals"]["indices"]] if "indices" in mesh["normals"] else values
    ) @ np.linalg.inv(matrix[:3, :3]).T
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def baked(stage: Usd.Stage) -> Usd.Stage:
    copy = Usd.Stage.Open(stage.Flatten())
    assert UsdSkel.BakeSkinning(copy.Traverse(), Gf.Interval(1.0, 10.0))
    return copy


@pytest.mark.parametrize("method", ["classicLinear", "dualQuaternion"])
@pytest.mark.parametrize("shaped", [False, True])
@pytest.mark.parametrize("interpolation", [None, "vertex", "faceVarying"])
def test_skinning_is_that_of_usd(interpolation, shaped, method):
    stage = new_stage()
    mesh = character(stage, interpolation=interpolation, shaped=shaped)
    UsdSkel.BindingAPI(mesh.GetPrim()).CreateSkinningMethodAttr(method)
    # Baking writes samples where the skeleton has them; between them it is interpolated, which skinning is not.
    for time in (1.0, 10.0):
        points, normals = placed(stage, time, "/World/Hero/Body")
        expected, expected_normals = placed(baked(stage), time, "/World/Hero/Body")
        np.testing.assert_allclose(points, expected, atol=2e-5)
        if interpolation:
            np.testing.assert_allclose(normals, expected_normals, atol=2e-4)
    rest = np.asarray(mesh.GetPointsAttr().Get())
    assert np.abs(flatten(stage, 10.0).prims["/World/Hero/Body"]["points"] - rest).max() > 0.5


def test_between_samples_the_rotation_is_interpolated_not_the_points():
    stage = new_stage()
    character(stage)
    at = {time: placed(stage, time, "/World/Hero/Body")[0] for time in (1.0, 5.5, 10.0)}
    lengths = [np.linalg.norm(points[-4:] - points[16:20], axis=1) for points in at.values()]
    assert np.abs((at[1.0] + at[10.0]) / 2.0 - at[5.5]).max() > 0.1
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=0.3)


def test_a_rigid_mesh_moves_with_its_joint():
    stage = new_stage()
    character(stage)
    hat = tube(stage, "/World/Hero/Hat", "vertex")
    binding = UsdSkel.BindingAPI.Apply(hat.GetPrim())
    binding.SetRigidJointInfluence(1)
    binding.CreateSkeletonRel().SetTargets([Sdf.Path("/World/Hero/Skel")])
    for time in (1.0, 10.0):
        points, normals = placed(stage, time, "/World/Hero/Hat")
        expected, expected_normals = placed(baked(stage), time, "/World/Hero/Hat")
        np.testing.assert_allclose(points, expected, atol=2e-5)
        np.testing.assert_allclose(normals, expected_normals, atol=2e-4)


def bound(stage: Usd.Stage, kind: str) -> Usd.Prim:
    """A prim other than a mesh on the bones of the character: a line of points, or one that stays as it is."""
    prim = stage.DefinePrim("/World/Hero/Other", kind)
    binding = UsdSkel.BindingAPI.Apply(prim)
    binding.CreateSkeletonRel().SetTargets([Sdf.Path("/World/Hero/Skel")])
    UsdGeom.Xformable(prim).AddTranslateOp().Set((0.3, 0.0, 0.2))
    if not prim.IsA(UsdGeom.PointBased):
        binding.SetRigidJointInfluence(1)
        return prim
    share = np.linspace(0, 1, 9)
    UsdGeom.PointBased(prim).CreatePointsAttr([(0.0, float(y), 0.0) for y in range(9)])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 9)
    binding.CreateJointWeightsPrimvar(False, 2).Set(np.stack([1 - share, share], 1).ravel().tolist())
    (UsdGeom.Curves if kind == "BasisCurves" else UsdGeom.Points)(prim).CreateWidthsAttr([0.1] * 9)
    if kind == "BasisCurves":
        UsdGeom.BasisCurves(prim).CreateTypeAttr("linear")
        UsdGeom.Curves(prim).CreateCurveVertexCountsAttr([9])
    return prim


@pytest.mark.parametrize("kind", ["BasisCurves", "Points", "Sphere", "Cube"])
def test_curves_points_and_implicit_prims_hang_on_bones_too(kind):
    stage = new_stage()
    character(stage)
    bound(stage, kind)
    path = "/World/Hero/Other"
    if kind == "Points":
        places = [flatten(s, 10.0).prims[f"{path}.points"]["transforms"] for s in (stage, baked(stage))]
    else:
        places = [placed(s, 10.0, path)[0] for s in (stage, baked(stage))]
    np.testing.assert_allclose(*places, atol=2e-5)
    stage.RemovePrim("/World/Hero/Anim")
    rest = flatten(stage, 10.0).prims
    still = rest[f"{path}.points"]["transforms"] if kind == "Points" else placed(stage, 10.0, path)[0]
    assert np.abs(still - places[0]).max() > 0.5


def test_what_of_curves_stays_at_rest_is_said():
    stage = new_stage()
    character(stage)
    curves = UsdGeom.BasisCurves(bound(stage, "BasisCurves"))
    curves.CreateNormalsAttr([(0.0, 0.0, 1.0)] * 9)
    [(path, message)] = flatten(stage, 10.0).warnings
    assert path == "/World/Hero/Other" and message.startswith(
        "normals: skeletons and blend shapes move points"
    )


def test_instances_that_share_a_skeleton_have_their_own_animations():
    stage = new_stage()
    character(stage, "/Asset")
    stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    stage.GetPrimAtPath("/Asset/Skel").GetRelationship("skel:animationSource").ClearTargets(True)
    animations = [animation(stage, f"/Moves/m{i}", degrees) for i, degrees in enumerate((0.0, 80.0))]
    for i, anim in enumerate((0, 1, 1)):
        prim = stage.DefinePrim(f"/World/i{i}")
        prim.GetReferences().AddInternalReference("/Asset")
        prim.SetInstanceable(True)
        binding = UsdSkel.BindingAPI.Apply(prim)
        binding.CreateAnimationSourceRel().SetTargets([animations[anim].GetPath()])
    flat = flatten(stage, 10.0)
    meshes = {path: prim for path, prim in flat.prims.items() if prim["type"] == "Mesh"}
    assert sorted(meshes) == ["/World/i0/Body", "/World/i1/Body"]
    assert np.abs(meshes["/World/i0/Body"]["points"] - meshes["/World/i1/Body"]["points"]).max() > 0.5
    assert len(flat.prims["/World/i1.instances"]["transforms"]) == 2


def instanced(stage: Usd.Stage, kind: str, *turns: float) -> None:
    """Instances /World/i0 ... of class /Asset, turned and moved; the asset's own rotation is theirs."""
    for i, degrees in enumerate(turns):
        prim = stage.DefinePrim(f"/World/i{i}", kind)
        prim.GetReferences().AddInternalReference("/Asset")
        prim.SetInstanceable(True)
        xform = UsdGeom.Xformable(prim)
        xform.SetXformOpOrder([])
        xform.AddTranslateOp(opSuffix="here").Set((7.0 * i + 3.0, 1.0, -2.0))
        xform.AddRotateYOp(opSuffix="here").Set(degrees)


def worlds(flat, path: str) -> list[np.ndarray]:
    """World points of a mesh in every place where it is."""
    mesh = flat.prims[path]
    shared = flat.prims[mesh["instancer"]]["transforms"] if mesh.get("instancer") else np.eye(4)[None]
    own = np.array(mesh["transform"])
    points = mesh["points"] @ own[:3, :3] + own[3, :3]
    return [points @ matrix[:3, :3] + matrix[3, :3] for matrix in np.asarray(shared)]


def unshared(stage: Usd.Stage, time: float) -> list[np.ndarray]:
    """World points of the bodies as usd-core bakes them where nothing is an instance."""
    copy = Usd.Stage.Open(stage.Flatten())
    for i in range(2):
        copy.GetPrimAtPath(f"/World/i{i}").SetInstanceable(False)
    flat = flatten(baked(copy), time)
    return [worlds(flat, f"/World/i{i}/Body")[0] for i in range(2)]


def test_a_skeleton_stands_where_its_instance_stands():
    stage = new_stage()
    character(stage, "/Asset")
    stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    instanced(stage, "SkelRoot", 20.0, 130.0)
    for time in (1.0, 10.0):
        flat = flatten(stage, time)
        assert [path for path, prim in flat.prims.items() if prim["type"] == "Mesh"] == ["/World/i0/Body"]
        for found, expected in zip(worlds(flat, "/World/i0/Body"), unshared(stage, time), strict=True):
            np.testing.assert_allclose(found, expected, atol=5e-5)
    assert np.abs(unshared(stage, 10.0)[0] - unshared(stage, 1.0)[0]).max() > 0.5


def test_instances_around_one_skeleton_stand_where_it_stands():
    """UsdSkel: the skeleton says where skinned points are, whatever the place of the mesh."""
    stage = new_stage()
    character(stage, "/World")
    UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath("/World")).CreateSkeletonRel().SetTargets(["/World/Skel"])
    stage.RemovePrim("/World/Body")
    influences(tube(stage, "/Asset/Body", None))
    stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    instanced(stage, "Xform", 20.0, 130.0)
    flat = flatten(stage, 10.0)
    for i, expected in enumerate(unshared(stage, 10.0)):
        [found] = worlds(flat, f"/World/i{i}/Body")
        np.testing.assert_allclose(found, expected, atol=5e-5)


def test_a_mesh_outside_a_skel_root_stays_at_rest():
    stage = new_stage()
    character(stage)
    stage.GetPrimAtPath("/World/Hero").SetTypeName("Xform")
    rest = UsdGeom.Mesh.Get(stage, "/World/Hero/Body").GetPointsAttr().Get()
    np.testing.assert_array_equal(flatten(stage, 10.0).prims["/World/Hero/Body"]["points"], rest)


def test_what_does_not_fit_is_named_and_the_mesh_stays_at_rest():
    stage = new_stage()
    mesh = character(stage)
    UsdSkel.BindingAPI(mesh.GetPrim()).GetJointIndicesPrimvar().Set([0, 1])
    UsdSkel.BindingAPI(mesh.GetPrim()).GetJointWeightsPrimvar().Set([0.5, 0.5])
    flat = flatten(stage, 10.0)
    np.testing.assert_array_equal(flat.prims["/World/Hero/Body"]["points"], mesh.GetPointsAttr().Get())
    assert [(path, "jointIndices" in message) for path, message in flat.warnings] == [
        ("/World/Hero/Body", True)
    ]


def test_our_stage(usd_scenes):
    """usd_scenes/skel.usda at its last frame, by linear blend skinning written down in numpy."""
    stage = Usd.Stage.Open(str(usd_scenes / "skel.usda"))
    mesh = UsdGeom.Mesh.Get(stage, "/World/Arm/Flesh")
    rest = np.array(mesh.GetPointsAttr().Get(), float)
    shape = UsdSkel.BlendShape.Get(stage, "/World/Arm/Flesh/Flex")
    rest[list(shape.GetPointIndicesAttr().Get())] += np.array(shape.GetOffsetsAttr().Get())
    share = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("skel:jointWeights").Get()).reshape(-1, 2)[:, 1:]
    cos, sin = np.cos(np.radians(-80)), np.sin(np.radians(-80))
    elbow = np.array([0.0, 2.0, 0.0])
    bent = (rest - elbow) @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + elbow
    expected = (1 - share) * rest + share * bent + [-0.8, 0, 0]
    points, _ = placed(stage, 24.0, "/World/Arm/Flesh")
    np.testing.assert_allclose(points, expected, atol=1e-4)
    # And seen: of the cage no pixel is further to the right than its rightmost point, and one is there.
    image = dermis.render(stage, time=24.0, resolution=[160, 90], samples=4, aovs=["albedo"])
    flesh = (
        np.abs(image["albedo"] / image["albedo"].sum(-1, keepdims=True) * 1.32 - [0.62, 0.4, 0.3]).max(-1)
        < 0.02
    )
    x, distance = expected[expected[:, 0].argmax()][[0, 2]]
    column = 80 + x / (np.hypot(11.0, 2.6) - distance) * 45 / 36 * 160
    assert abs(np.argwhere(flesh)[:, 1].max() + 0.5 - column) < 2
