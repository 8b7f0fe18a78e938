"""The assets of the crowd: heads of skin with eyes and teeth, and the materials of the set."""

import colorsys
import math
import random
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

KINDS = ("goblin", "troll", "imp")
SKINS = 8
COLOR, FLOAT = Sdf.ValueTypeNames.Color3f, Sdf.ValueTypeNames.Float

#: Per kind: lumps on the unit sphere as (direction, height, width in radians).
LUMPS = {
    "goblin": [((1.0, 0.25, -0.1), 1.1, 0.2), ((0.0, -0.05, 1.0), 0.5, 0.16), ((0.0, -0.7, 0.6), 0.25, 0.4)],
    "troll": [((0.7, 0.3, 0.1), 0.25, 0.3), ((0.0, 0.0, 1.0), 0.3, 0.3), ((0.0, -0.6, 0.7), 0.6, 0.45)],
    "imp": [((0.6, 0.8, 0.1), 0.9, 0.15), ((0.9, 0.0, -0.1), 0.7, 0.14), ((0.0, -0.1, 1.0), 0.25, 0.15)],
}


def new_asset(file: Path) -> tuple[Usd.Stage, Usd.Prim]:
    """A stage in centimetres whose default prim is an Xform named after the file."""
    stage = Usd.Stage.CreateNew(str(file))
    root = UsdGeom.Xform.Define(stage, f"/{file.stem}").GetPrim()
    stage.SetDefaultPrim(root)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    return stage, root


def write_creature(file: Path) -> None:
    """A head 2 to 3 units wide; its variant set `skin` has eight skins."""
    stage, root = new_asset(file)
    path = str(root.GetPath())
    points, counts, indices, st = cube_sphere(14)
    head = mesh(stage, f"{path}/Head", shaped(points, LUMPS[file.stem]), counts, indices, st)
    UsdGeom.PrimvarsAPI(head).CreatePrimvar("dermis:refineLevel", Sdf.ValueTypeNames.Int).Set(1)
    eye = preview(stage, f"{path}/Looks/Eye", diffuseColor=(0.8, 0.75, 0.6), roughness=0.05)
    ivory = preview(stage, f"{path}/Looks/Ivory", diffuseColor=(0.8, 0.74, 0.58), roughness=0.3)
    for name, x in (("EyeLeft", 0.36), ("EyeRight", -0.36)):
        ball = UsdGeom.Sphere.Define(stage, f"{path}/{name}")
        ball.CreateRadiusAttr(0.26)
        UsdGeom.XformCommonAPI(ball).SetTranslate((x, 0.3, 0.88))
        bind(ball, eye)
    tooth = UsdGeom.Cone.Define(stage, f"{path}/Tooth")
    tooth.CreateRadiusAttr(0.08)
    tooth.CreateHeightAttr(0.35)
    tooth.CreateAxisAttr("Y")
    UsdGeom.XformCommonAPI(tooth).SetTranslate((0.25, -0.35, 1.05))
    bind(tooth, ivory)
    skins = root.GetVariantSets().AddVariantSet("skin")
    for i in range(SKINS):
        skins.AddVariant(f"skin{i}")
        skins.SetVariantSelection(f"skin{i}")
        with skins.GetVariantEditContext():
            bind(head, skin(stage, f"{path}/Looks/Skin", i))
    skins.SetVariantSelection("skin0")
    stage.Save()


def cube_sphere(n: int) -> tuple[NDArray, list[int], list[int], NDArray]:
    """Unit sphere of 6 n n quads without poles: points, face counts, vertex indices, st per face vertex."""
    places: dict[tuple[int, int, int], int] = {}
    indices, st = [], []
    for axis in range(3):
        for sign in (-1, 1):
            for j in range(n):
                for i in range(n):
                    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    for a, b in corners if sign > 0 else reversed(corners):
                        key = [0, 0, 0]
                        key[axis], key[(axis + 1) % 3], key[(axis + 2) % 3] = n * sign, 2 * a - n, 2 * b - n
                        indices.append(places.setdefault(tuple(key), len(places)))
                        st.append((a / n, b / n))
    cube = np.tan(np.array(list(places)) / n * (math.pi / 4))
    return cube / np.linalg.norm(cube, axis=1, keepdims=True), [4] * (6 * n * n), indices, np.array(st)


def shaped(points: NDArray, lumps: list) -> NDArray:
    """The sphere with its lumps, alike on either side of x = 0."""
    radius = np.ones(len(points))
    for direction, height, width in lumps:
        for side in (1.0, -1.0) if direction[0] else (1.0,):
            towards = np.array(direction) * (side, 1.0, 1.0)
            angle = np.arccos(np.clip(points @ towards / np.linalg.norm(towards), -1.0, 1.0))
            radius += height * np.exp(-((angle / width) ** 2))
    return points * radius[:, None]


def mesh(stage, path, points, counts, indices, st) -> UsdGeom.Mesh:
    prim = UsdGeom.Mesh.Define(stage, path)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    prim.CreateFaceVertexCountsAttr(counts)
    prim.CreateFaceVertexIndicesAttr(indices)
    prim.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(prim.GetPointsAttr().Get()))
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    primvar.Set(Vt.Vec2fArray.FromNumpy(st.astype(np.float32)))
    return prim


def bind(prim, material: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)


def shader(stage: Usd.Stage, path: str, identifier: str, context: str = "", **inputs) -> UsdShade.Material:
    """A Material of one shader; numbers are floats, triples colours."""
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr(identifier)
    for name, value in inputs.items():
        kind = FLOAT if isinstance(value, float) else COLOR
        surface.CreateInput(name, kind).Set(value if isinstance(value, float) else Gf.Vec3f(*value))
    output = material.CreateSurfaceOutput(context) if context else material.CreateSurfaceOutput()
    output.ConnectToSource(surface.ConnectableAPI(), "out" if context else "surface")
    return material


def preview(stage: Usd.Stage, path: str, **inputs) -> UsdShade.Material:
    return shader(stage, path, "UsdPreviewSurface", **inputs)


def skin(stage: Usd.Stage, path: str, number: int) -> UsdShade.Material:
    hue = colorsys.hsv_to_rgb((0.04 + 0.045 * number) % 1.0, 0.5, 0.75)
    return preview(
        stage,
        path,
        diffuseColor=hue,
        roughness=0.4,
        ior=1.4,
        subsurface=1.0,
        subsurfaceColor=hue,
        subsurfaceRadius=(0.08, 0.04, 0.02),
    )


def set_material(stage: Usd.Stage, path: str, number: int, texture: str) -> UsdShade.Material:
    """One of the many looks of the set, in turn: preview surface, textured, OpenPBR, Standard Surface, glass, wax."""
    chance = random.Random(number)
    color = colorsys.hsv_to_rgb(chance.random(), 0.2 + 0.5 * chance.random(), 0.3 + 0.4 * chance.random())
    rough = 0.15 + 0.7 * chance.random()
    match number % 8:
        case 0:
            return textured(stage, path, texture, rough)
        case 1 | 2:
            return shader(
                stage,
                path,
                "ND_open_pbr_surface_surfaceshader",
                "mtlx",
                base_color=color,
                specular_roughness=rough,
            )
        case 3 | 4:
            return shader(
                stage, path, "ND_standard_surface_surfaceshader", "mtlx", base_color=color, coat=0.5, base=0.8
            )
        case 5:
            return preview(stage, path, diffuseColor=color, metallic=1.0, roughness=rough)
        case 6:
            return preview(
                stage, path, subsurface=1.0, subsurfaceColor=color, subsurfaceRadius=(0.2, 0.1, 0.05)
            )
        case _:
            return preview(stage, path, diffuseColor=color, roughness=rough)


def textured(stage: Usd.Stage, path: str, file: str, roughness: float) -> UsdShade.Material:
    material = preview(stage, path, roughness=roughness)
    reader = UsdShade.Shader.Define(stage, f"{path}/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    image = UsdShade.Shader.Define(stage, f"{path}/Image")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
    for wrap in ("wrapS", "wrapT"):
        image.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("repeat")
    image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    surface = UsdShade.Shader(stage.GetPrimAtPath(f"{path}/Surface"))
    surface.CreateInput("diffuseColor", COLOR).ConnectToSource(image.ConnectableAPI(), "rgb")
    return material
