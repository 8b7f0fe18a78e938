"""Writes skel.usda: python usd_scenes/skel_scene.py"""

import math

import numpy as np
from geometry_scenes import HERE, new_stage, place, short
from pxr import Gf, Usd, UsdGeom, UsdSkel

HEIGHT, RADIUS, RINGS, SIDES = 4.0, 0.7, 12, 12
FIRST, LAST = 1, 24


def tube(stage: Usd.Stage, path: str) -> UsdGeom.Mesh:
    """Along +Y, closed by two caps; Catmull-Clark."""
    angles = [2 * math.pi * side / SIDES for side in range(SIDES)]
    points = [
        short(Gf.Vec3f(RADIUS * math.cos(a), HEIGHT * ring / RINGS, -RADIUS * math.sin(a)))
        for ring in range(RINGS + 1)
        for a in angles
    ]
    sides = [
        (SIDES * ring + a, SIDES * ring + b, SIDES * (ring + 1) + b, SIDES * (ring + 1) + a)
        for ring in range(RINGS)
        for a, b in ((side, (side + 1) % SIDES) for side in range(SIDES))
    ]
    caps = [tuple(range(SIDES))[::-1], tuple(range(SIDES * RINGS, SIDES * (RINGS + 1)))]
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr([len(face) for face in sides + caps])
    mesh.CreateFaceVertexIndicesAttr([v for face in sides + caps for v in face])
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.62, 0.4, 0.3)])
    return mesh


def skeleton(stage: Usd.Stage, root: str) -> UsdSkel.Skeleton:
    """Two joints: at the foot, and in the middle."""
    skel = UsdSkel.Skeleton.Define(stage, f"{root}/Skel")
    rest = [Gf.Matrix4d(1.0), Gf.Matrix4d().SetTranslate((0.0, HEIGHT / 2, 0.0))]
    skel.CreateJointsAttr(["foot", "foot/elbow"])
    skel.CreateBindTransformsAttr(rest)
    skel.CreateRestTransformsAttr(rest)
    move = UsdSkel.Animation.Define(stage, f"{root}/Move")
    move.CreateJointsAttr(["foot", "foot/elbow"])
    move.CreateTranslationsAttr([(0.0, 0.0, 0.0), (0.0, HEIGHT / 2, 0.0)])
    move.CreateScalesAttr([(1, 1, 1), (1, 1, 1)])
    rotations = move.CreateRotationsAttr()
    bent = Gf.Quatf(Gf.Rotation((0, 0, 1), -80.0).GetQuat())
    rotations.Set([Gf.Quatf(1.0), Gf.Quatf(1.0)], FIRST)
    rotations.Set([Gf.Quatf(1.0), bent], LAST)
    move.CreateBlendShapesAttr(["flex"])
    weights = move.CreateBlendShapeWeightsAttr()
    weights.Set([0.0], FIRST)
    weights.Set([1.0], LAST)
    UsdSkel.BindingAPI.Apply(skel.GetPrim()).CreateAnimationSourceRel().SetTargets([move.GetPath()])
    return skel


def bind(mesh: UsdGeom.Mesh, skel: UsdSkel.Skeleton) -> None:
    height = np.asarray(mesh.GetPointsAttr().Get())[:, 1] / HEIGHT
    share = np.round(np.clip((height - 0.35) / 0.3, 0, 1), 4)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skel.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * len(share))
    binding.CreateJointWeightsPrimvar(False, 2).Set(np.stack([1 - share, share], 1).ravel().tolist())


def flex(stage: Usd.Stage, mesh: UsdGeom.Mesh) -> None:
    """A muscle that swells on the inner side of the upper half, of its points alone."""
    points = np.asarray(mesh.GetPointsAttr().Get())
    swell = np.exp(-(((points[:, 1] - 0.72 * HEIGHT) / 0.6) ** 2)) * np.clip(points[:, 0] / RADIUS, 0, 1)
    there = np.flatnonzero(swell > 0.02)
    shape = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild("Flex"))
    shape.CreatePointIndicesAttr(there.tolist())
    shape.CreateOffsetsAttr([short(Gf.Vec3f(0.7 * float(swell[i]), 0, 0)) for i in there])
    binding = UsdSkel.BindingAPI(mesh)
    binding.CreateBlendShapesAttr(["flex"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])


def skel() -> None:
    """A tube with two joints that bends from frame 1 to 24, while a blend shape swells its muscle."""
    stage = new_stage("skel.usda", " ".join(skel.__doc__.split()), (0.0, 3.6, 11.0), 45.0)
    stage.SetStartTimeCode(FIRST)
    stage.SetEndTimeCode(LAST)
    root = UsdSkel.Root.Define(stage, "/World/Arm")
    place(root, -0.8, 0.0, 0.0)
    mesh = tube(stage, "/World/Arm/Flesh")
    bind(mesh, skeleton(stage, "/World/Arm"))
    flex(stage, mesh)
    stage.Save()


if __name__ == "__main__":
    (HERE / "skel.usda").unlink(missing_ok=True)
    skel()
