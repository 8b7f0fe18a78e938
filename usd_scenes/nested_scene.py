"""Writes nested.usda: python usd_scenes/nested_scene.py

A tumbler of milk that reaches into the glass, with a spoon and ice in it; a ball of wax in glass; a head of two meshes
that are one set, with an eye in it.
"""

import math
from pathlib import Path

from geometry_scenes import new_stage, place
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

HERE = Path(__file__).parent
SEGMENTS = 96

#: (radius, height) from the axis below, around the outside, over the rim, down the inside to the axis.
TUMBLER = [
    (0.0, 0.0), (0.6, 0.0), (0.86, 0.02), (0.92, 0.08), (0.95, 0.3), (1.0, 1.0), (1.06, 1.9), (1.1, 2.5),
    (1.09, 2.54), (1.05, 2.56), (1.01, 2.54), (1.0, 2.5), (0.95, 1.9), (0.89, 1.0), (0.84, 0.4), (0.78, 0.28),
    (0.6, 0.25), (0.0, 0.25),
]  # fmt: skip

#: As wide as the middle of the wall, and as deep as that of the bottom.
MILK = [
    (0.0, 0.15),
    (0.6, 0.15),
    (0.8, 0.18),
    (0.9, 0.4),
    (0.945, 1.0),
    (1.0, 1.85),
    (0.6, 1.84),
    (0.0, 1.84),
]


def lathe(stage: Usd.Stage, path: str, profile: list[tuple[float, float]]) -> UsdGeom.Mesh:
    """A profile that begins and ends on the axis, turned about y; winding outward where it goes up on the outside."""
    ring = [2 * math.pi * i / SEGMENTS for i in range(SEGMENTS)]
    points = [(0.0, profile[0][1], 0.0), (0.0, profile[-1][1], 0.0)]
    points += [(r * math.cos(a), y, -r * math.sin(a)) for r, y in profile[1:-1] for a in ring]
    at = lambda row, i: 2 + row * SEGMENTS + i % SEGMENTS  # noqa: E731
    rows = len(profile) - 2
    faces = [(0, at(0, i + 1), at(0, i)) for i in range(SEGMENTS)]
    faces += [
        (at(row, i), at(row, i + 1), at(row + 1, i + 1), at(row + 1, i))
        for row in range(rows - 1)
        for i in range(SEGMENTS)
    ]
    faces += [(at(rows - 1, i), at(rows - 1, i + 1), 1) for i in range(SEGMENTS)]
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([Gf.Vec3f(*(round(x, 5) for x in p)) for p in points])
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([i for face in faces for i in face])
    return mesh


def look(stage: Usd.Stage, name: str, shader_id: str = "UsdPreviewSurface", **inputs) -> UsdShade.Material:
    """Types by value: a number, a colour, a token, a priority."""
    material = UsdShade.Material.Define(stage, f"/World/{name}")
    shader = UsdShade.Shader.Define(stage, f"/World/{name}/Surface")
    shader.CreateIdAttr(shader_id)
    kinds = {
        float: Sdf.ValueTypeNames.Float,
        tuple: Sdf.ValueTypeNames.Color3f,
        str: Sdf.ValueTypeNames.Token,
        int: Sdf.ValueTypeNames.Int,
    }
    for key, value in inputs.items():
        shader.CreateInput(key, kinds[type(value)]).Set(
            Gf.Vec3f(value) if isinstance(value, tuple) else value
        )
    render_context = "mtlx" if shader_id.startswith("ND_") else ""
    material.CreateSurfaceOutput(render_context).ConnectToSource(shader.ConnectableAPI(), "out")
    return material


def wear(prim: UsdGeom.Gprim, material: UsdShade.Material, priority: int | None = None) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)
    if priority is not None:
        api = UsdGeom.PrimvarsAPI(prim)
        api.CreatePrimvar("dermis:mediumPriority", Sdf.ValueTypeNames.Int, "constant").Set(priority)


def ball(stage: Usd.Stage, path: str, radius: float, at: tuple[float, float, float]) -> UsdGeom.Sphere:
    sphere = UsdGeom.Sphere.Define(stage, path)
    sphere.CreateRadiusAttr(radius)
    place(sphere, *at)
    return sphere


def tumbler(stage: Usd.Stage, glass: UsdShade.Material) -> None:
    milk = look(
        stage, "MilkLook", subsurface=1.0, subsurfaceColor=(0.93, 0.88, 0.78), subsurfaceRadius=(0.12, 0.09, 0.06),
        subsurfaceBoundary="dielectric", ior=1.35, roughness=0.0, subsurfacePriority=1,
    )  # fmt: skip
    place(UsdGeom.Xform.Define(stage, "/World/Drink"), -2.6, 0.0, 0.0)
    wear(lathe(stage, "/World/Drink/Tumbler", TUMBLER), glass, 3)
    wear(lathe(stage, "/World/Drink/Milk", MILK), milk)
    steel = look(stage, "Steel", metallic=1.0, diffuseColor=(0.75, 0.73, 0.7), roughness=0.2)
    spoon = UsdGeom.Capsule.Define(stage, "/World/Drink/Spoon")
    spoon.CreateHeightAttr(3.0)
    spoon.CreateRadiusAttr(0.07)
    place(spoon, 0.3, 1.9, 0.1, (74.0, 14.0, 0.0))
    wear(spoon, steel)
    ice = look(stage, "IceLook", "ND_open_pbr_surface_surfaceshader", transmission_weight=1.0, specular_ior=1.31,
               specular_roughness=0.0)  # fmt: skip
    cube = UsdGeom.Cube.Define(stage, "/World/Drink/Ice")
    cube.CreateSizeAttr(0.62)
    place(cube, -0.3, 1.83, 0.35, (20.0, 30.0, 10.0))
    wear(cube, ice, 2)


def paperweight(stage: Usd.Stage, glass: UsdShade.Material) -> None:
    wax = look(
        stage, "WaxLook", subsurface=1.0, subsurfaceColor=(0.9, 0.45, 0.25), subsurfaceRadius=(0.2, 0.1, 0.05),
        subsurfaceBoundary="dielectric", ior=1.44, roughness=0.0,
    )  # fmt: skip
    wear(ball(stage, "/World/Paperweight/Glass", 1.2, (0.3, 1.2, 0.0)), glass)
    wear(ball(stage, "/World/Paperweight/Wax", 0.6, (0.3, 1.1, 0.0)), wax)


def head(stage: Usd.Stage) -> None:
    skin = look(
        stage,
        "Skin",
        subsurface=1.0,
        subsurfaceColor=(0.8, 0.5, 0.38),
        subsurfaceRadius=(0.16, 0.07, 0.04),
        roughness=0.4,
    )
    group = UsdGeom.Xform.Define(stage, "/World/Head")
    api = UsdGeom.PrimvarsAPI(group)
    api.CreatePrimvar("dermis:subsurfaceSet", Sdf.ValueTypeNames.Token, "constant").Set("head")
    wear(ball(stage, "/World/Head/Skull", 1.1, (3.4, 1.3, 0.0)), skin)
    for side, x in (("Left", 2.25), ("Right", 4.55)):
        ear = ball(stage, f"/World/Head/{side}Ear", 0.45, (x, 1.5, 0.0))
        UsdGeom.XformCommonAPI(ear).SetScale((0.8, 1.2, 0.3))
        wear(ear, skin)
    white = look(stage, "EyeLook", diffuseColor=(0.85, 0.85, 0.82), roughness=0.1)
    for side, x in (("Left", 3.0), ("Right", 3.8)):
        wear(ball(stage, f"/World/Eyes/{side}", 0.28, (x, 1.6, 0.85)), white)


def nested() -> None:
    stage = new_stage(
        "nested.usda", "Media within media: priorities, and sets.", (0.0, 3.4, 12.0), focal=46.0
    )
    glass = look(stage, "GlassLook", "ND_open_pbr_surface_surfaceshader", transmission_weight=1.0, specular_ior=1.5,
                 specular_roughness=0.0)  # fmt: skip
    tumbler(stage, glass)
    paperweight(stage, glass)
    head(stage)
    stage.Save()


if __name__ == "__main__":
    (HERE / "nested.usda").unlink(missing_ok=True)
    nested()
