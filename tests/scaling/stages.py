"""Stages that grow along one axis while the rest stays: a waxen body before a sky, or many of them."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

#: Camera distance from bodies of radius 1 about the origin.
DISTANCE = 4.0


def new(path: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(40.0)
    UsdGeom.Xformable(camera).AddTranslateOp().Set((0.0, 0.0, DISTANCE))
    return stage


def sky(stage: Usd.Stage) -> None:
    UsdLux.DomeLight.Define(stage, "/World/Sky").CreateIntensityAttr(1.0)


def wax(stage: Usd.Stage, path: str, radius: float) -> UsdShade.Material:
    """Subsurface with this mean free path."""
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Preview")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("subsurface", Sdf.ValueTypeNames.Float).Set(1.0)
    shader.CreateInput("subsurfaceColor", Sdf.ValueTypeNames.Color3f).Set((0.8, 0.6, 0.4))
    shader.CreateInput("subsurfaceRadius", Sdf.ValueTypeNames.Color3f).Set(
        (radius, radius / 2.0, radius / 4.0)
    )
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def bumpy(triangles: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Points and triangles, about so many, of a closed body of radius about 1."""
    rings = max(int(math.sqrt(triangles / 4.0)), 3)
    sectors = 2 * rings
    theta = np.linspace(0.0, np.pi, rings + 1)[1:-1, None]
    phi = np.linspace(0.0, 2.0 * np.pi, sectors, endpoint=False)[None]
    r = 1.0 + 0.1 * np.sin(5.0 * theta) * np.sin(7.0 * phi) * np.sin(theta) ** 2
    around = np.stack(
        [r * np.sin(theta) * np.sin(phi), r * np.cos(theta) + 0.0 * phi, r * np.sin(theta) * np.cos(phi)], -1
    )
    points = np.concatenate([around.reshape(-1, 3), [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]])
    index = np.arange(len(points) - 2).reshape(rings - 1, sectors)
    after = np.roll(index, -1, axis=1)
    north, south = np.full(sectors, len(points) - 2), np.full(sectors, len(points) - 1)
    faces = [
        np.stack([index[:-1], index[1:], after[1:]], -1),
        np.stack([index[:-1], after[1:], after[:-1]], -1),
        np.stack([north, index[0], after[0]], -1),
        np.stack([index[-1], south, after[-1]], -1),
    ]
    return points.astype(np.float32), np.concatenate([f.reshape(-1, 3) for f in faces]).astype(np.int32)


def body(stage: Usd.Stage, path: str, triangles: int, material: UsdShade.Material) -> UsdGeom.Mesh:
    points, faces = bumpy(triangles)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(np.full(len(faces), 3, np.int32))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel())
    mesh.CreateSubdivisionSchemeAttr("none")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return mesh


def triangles(path: Path, count: int) -> None:
    stage = new(path)
    sky(stage)
    body(stage, "/World/Body", count, wax(stage, "/World/Wax", 0.05))
    stage.Save()


def lights(path: Path, count: int) -> None:
    """Spheres on a shell around the body, of the same total power."""
    stage = new(path)
    body(stage, "/World/Body", 20_000, wax(stage, "/World/Wax", 0.05))
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for i, direction in enumerate(directions):
        light = UsdLux.SphereLight.Define(stage, f"/World/Lights/l{i}")
        light.CreateRadiusAttr(0.05)
        light.CreateIntensityAttr(2000.0 / count)
        UsdGeom.Xformable(light).AddTranslateOp().Set(Gf.Vec3d(*(2.5 * direction).tolist()))
    stage.Save()


def media(path: Path, count: int) -> None:
    """Small bodies on a grid, each with a material of its own."""
    stage = new(path)
    sky(stage)
    for i, (x, y) in enumerate(grid(count)):
        material = wax(stage, f"/World/Looks/m{i}", 0.05 * (1.0 + i / count))
        mesh = body(stage, f"/World/b{i}", 2_000, material)
        xform = UsdGeom.Xformable(mesh)
        xform.AddTranslateOp().Set((float(x), float(y), 0.0))
        xform.AddScaleOp().Set((0.9 / math.ceil(math.sqrt(count)),) * 3)
    stage.Save()


def instances(path: Path, count: int) -> None:
    """One body of 20,000 triangles, placed by a point instancer on a grid."""
    stage = new(path)
    sky(stage)
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/Crowd")
    body(stage, "/World/Crowd/Body", 20_000, wax(stage, "/World/Wax", 0.05))
    instancer.CreatePrototypesRel().SetTargets([Sdf.Path("/World/Crowd/Body")])
    instancer.CreateProtoIndicesAttr(np.zeros(count, np.int32))
    places = np.zeros((count, 3), np.float32)
    places[:, :2] = grid(count)
    instancer.CreatePositionsAttr(places)
    size = 0.9 / math.ceil(math.sqrt(count))
    instancer.CreateScalesAttr(np.full((count, 3), size, np.float32))
    stage.Save()


def resolution(path: Path, _pixels: int) -> None:
    triangles(path, 20_000)


def grid(count: int) -> NDArray[np.float64]:
    """Centres that fill a square of side 2."""
    side = math.ceil(math.sqrt(count))
    cells = np.stack(np.divmod(np.arange(count), side), axis=1)
    return (cells + 0.5) / side * 2.0 - 1.0


#: Axis -> what makes its stages, the sizes.
AXES: dict[str, tuple[Callable[[Path, int], None], tuple[int, ...]]] = {
    "triangles": (triangles, (10_000, 100_000, 1_000_000, 4_000_000)),
    "lights": (lights, (1, 5, 20, 100, 500, 2000)),
    "media": (media, (1, 10, 50, 200)),
    "instances": (instances, (1, 100, 10_000, 1_000_000)),
    "resolution": (resolution, (64, 256, 1024)),
}
