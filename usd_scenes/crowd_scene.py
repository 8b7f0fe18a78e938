"""Writes a shot as a pipeline sends it: crowd.usda, its layers and assets.

python usd_scenes/crowd_scene.py [--out DIR]   (numpy, Pillow and usd-core; DIR is out/crowd)

More than 500 prims, 200 materials and 50 lights, a crowd of instanced heads of skin, a camera that moves over frames
1001 to 1008, and the prims of ODD, none of which dermis can render as they stand.
"""

import argparse
import math
import random
from pathlib import Path

import numpy as np
from crowd_assets import (
    KINDS,
    SKINS,
    bind,
    cube_sphere,
    mesh,
    set_material,
    shader,
    shaped,
    textured,
    write_creature,
)
from PIL import Image
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdRender, UsdVol, Vt

FRAMES = range(1001, 1009)
MATERIALS, PROPS, ROWS, FAR = 208, 360, 12, 1500

#: Prims that a shot has and dermis has no way to render as they stand, and a word of why.
ODD = {
    "/World/Odd/Smoke": "Volume",
    "/World/Odd/Patch": "NurbsPatch",
    "/World/Odd/BrokenMesh": "point",
    "/World/Odd/Missing": "not_there.usda",
    "/World/Odd/Renderman": "PxrSurface",
    "/World/Odd/LostTexture/Image": "lost.png",
    "/World/Odd/Neon": "PluginLight",
}


def write_texture(file: Path) -> None:
    """Bricks: something that has edges."""
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    row = y // 32
    mortar = (y % 32 < 3) | ((x + 32 * (row % 2)) % 64 < 3)
    brick = np.where(mortar[..., None], (170, 165, 155), (150, 80, 60))
    Image.fromarray(brick.astype(np.uint8)).save(file)


def new_layer(file: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(file))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    return stage


def place(prim, where, turn=(0.0, 0.0, 0.0), scale: float = 1.0) -> None:
    """Translate, rotate (degrees), scale."""
    common = UsdGeom.XformCommonAPI(prim)
    common.SetTranslate(where)
    common.SetRotate(turn)
    common.SetScale((scale, scale, scale))


def write_camera(file: Path) -> None:
    stage = new_layer(file)
    camera = UsdGeom.Camera.Define(stage, "/World/main_cam")
    camera.CreateFocalLengthAttr(32.0)
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateVerticalApertureAttr(15.0)
    move, turn = camera.AddTranslateOp(), camera.AddRotateXYZOp()
    for frame in FRAMES:
        t = (frame - FRAMES[0]) / (len(FRAMES) - 1)
        move.Set(Gf.Vec3d(-3.0 + 6.0 * t, 9.0 - t, 21.0 - 2.0 * t), frame)
        turn.Set(Gf.Vec3f(-17.0 + t, -6.0 + 12.0 * t, 0.0), frame)
    stage.Save()


def write_lights(file: Path) -> None:
    """Four rows of lamps above the crowd, a sun, a sky, a tube: 54 lights."""
    stage, chance = new_layer(file), random.Random(1)
    for i in range(48):
        kind = (UsdLux.SphereLight, UsdLux.DiskLight, UsdLux.RectLight)[i % 3]
        lamp = kind.Define(stage, f"/World/Rig/Lamp{i:02d}")
        lamp.CreateColorAttr(Gf.Vec3f(1.0, 0.6 + 0.3 * chance.random(), 0.3 + 0.5 * chance.random()))
        lamp.CreateIntensityAttr(26.0)
        lamp.CreateNormalizeAttr(True)
        if kind is not UsdLux.RectLight:
            lamp.CreateRadiusAttr(0.3)
        place(lamp, (3.4 * (i % 12 - 5.5), 6.0, 4.0 - 7.0 * (i // 12)), turn=(-90.0, 0.0, 0.0))
    flicker = stage.GetPrimAtPath("/World/Rig/Lamp06").GetAttribute("inputs:intensity")
    for frame in FRAMES:
        flicker.Set(26.0 + 12.0 * math.sin(frame), frame)
    for i in range(4):
        tube = UsdLux.CylinderLight.Define(stage, f"/World/Rig/Tube{i}")
        tube.CreateLengthAttr(4.0)
        tube.CreateRadiusAttr(0.08)
        tube.CreateIntensityAttr(6.0)
        place(tube, (-9.0 + 6.0 * i, 4.5, -16.0))
    sun = UsdLux.DistantLight.Define(stage, "/World/Rig/Moon")
    sun.CreateIntensityAttr(900.0)
    sun.CreateColorAttr(Gf.Vec3f(0.6, 0.75, 1.0))
    place(sun, (0.0, 0.0, 0.0), turn=(-35.0, 140.0, 0.0))
    UsdLux.DomeLight.Define(stage, "/World/Rig/Sky").CreateIntensityAttr(0.06)
    stage.Save()


def write_set(file: Path) -> None:
    """The floor, and props of every look beside and behind the crowd."""
    stage, chance = new_layer(file), random.Random(1)
    looks = [set_material(stage, f"/World/Looks/Look{i:03d}", i, "./bricks.png") for i in range(MATERIALS)]
    floor = UsdGeom.Plane.Define(stage, "/World/Set/Floor")
    floor.CreateAxisAttr("Y")
    floor.CreateWidthAttr(200.0)
    floor.CreateLengthAttr(200.0)
    bind(floor, looks[7])
    points, counts, indices, st = cube_sphere(6)
    for i in range(PROPS):
        path = f"/World/Set/Prop{i:03d}"
        if i % 3 == 0:
            prop = mesh(stage, path, shaped(points, [((0.3, 1.0, 0.1), 0.6, 0.5)]), counts, indices, st)
        else:
            prop = (UsdGeom.Cube if i % 3 == 1 else UsdGeom.Cylinder).Define(stage, path)
        row, column = divmod(i // 2, 8)
        side = (-1.0 if i % 2 else 1.0) * (12.5 + 1.9 * column + 0.3 * chance.random())
        where = (side, 0.6, 8.0 - 2.1 * row)
        place(prop, where, turn=(0.0, 360.0 * chance.random(), 0.0), scale=0.5 + 0.15 * chance.random())
        bind(prop, looks[i % MATERIALS])
    add_flag(stage, looks[0])
    stage.Save()


def add_flag(stage: Usd.Stage, look) -> None:
    """A cloth whose points move."""
    grid = [(i, j) for j in range(9) for i in range(13)]
    faces = [a + o for j in range(8) for a in range(13 * j, 13 * j + 12) for o in (0, 1, 14, 13)]
    flat = np.array([(0.3 * i, 0.3 * j, 0.0) for i, j in grid])
    st = np.array([(grid[v][0] / 12, grid[v][1] / 8) for v in faces])
    flag = mesh(stage, "/World/Set/Flag", flat, [4] * 96, faces, st)
    flag.CreateDoubleSidedAttr(True)
    for frame in FRAMES:
        flat[:, 2] = 0.25 * np.sin(2.0 * flat[:, 0] - 0.9 * frame)
        flag.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(flat.astype(np.float32)), frame)
    place(flag, (-1.8, 6.5, -17.0))
    bind(flag, look)


def write_crowd(file: Path) -> None:
    """Rows of instanceable references in front, some of which hop; a point instancer behind."""
    stage, chance = new_layer(file), random.Random(1)
    for i in range(ROWS * ROWS):
        head = UsdGeom.Xform.Define(stage, f"/World/Crowd/Head{i:03d}")
        kind = chance.choice(KINDS)
        head.GetPrim().GetReferences().AddReference(f"./{kind}.usdc")
        head.GetPrim().SetInstanceable(True)
        head.GetPrim().GetVariantSets().SetSelection("skin", f"skin{chance.randrange(SKINS)}")
        where = Gf.Vec3d(1.8 * (i % ROWS - 5.5) + 0.5 * chance.random(), 1.0, 7.0 - 2.0 * (i // ROWS))
        place(head, where, turn=(0.0, 60.0 * chance.random() - 30.0, 0.0), scale=0.55 + 0.2 * chance.random())
        if i % 7 == 0:
            hop = head.GetPrim().GetAttribute("xformOp:translate")
            for frame in FRAMES:
                hop.Set(where + Gf.Vec3d(0.0, 0.5 * abs(math.sin(0.8 * frame + i)), 0.0), frame)
    crowd = UsdGeom.PointInstancer.Define(stage, "/World/Far")
    prototypes = [f"/World/Far/Prototypes/{kind}" for kind in KINDS]
    for path, kind in zip(prototypes, KINDS, strict=True):
        stage.DefinePrim(path).GetReferences().AddReference(f"./{kind}.usdc")
    crowd.CreatePrototypesRel().SetTargets(prototypes)
    crowd.CreateProtoIndicesAttr([chance.randrange(len(KINDS)) for _ in range(FAR)])
    crowd.CreatePositionsAttr(
        [Gf.Vec3f(50.0 * chance.random() - 25.0, 0.6, -20.0 - 60.0 * chance.random()) for _ in range(FAR)]
    )
    crowd.CreateScalesAttr([Gf.Vec3f(0.5 + 0.2 * chance.random()) for _ in range(FAR)])
    stage.Save()


def write_odd(file: Path) -> None:
    """The prims of ODD: what is not rendered, or not as it stands."""
    stage = new_layer(file)
    UsdVol.Volume.Define(stage, "/World/Odd/Smoke")
    UsdGeom.NurbsPatch.Define(stage, "/World/Odd/Patch")
    broken = UsdGeom.Mesh.Define(stage, "/World/Odd/BrokenMesh")
    broken.CreatePointsAttr([Gf.Vec3f(0.0), Gf.Vec3f(1.0, 0.0, 0.0), Gf.Vec3f(0.0, 1.0, 0.0)])
    broken.CreateFaceVertexCountsAttr([3])
    broken.CreateFaceVertexIndicesAttr([0, 1, 7])
    stage.DefinePrim("/World/Odd/Missing", "Xform").GetReferences().AddReference("./not_there.usda")
    for i, look in enumerate(
        (
            shader(stage, "/World/Odd/Renderman", "PxrSurface", "ri", diffuseColor=(0.5, 0.5, 0.5)),
            textured(stage, "/World/Odd/LostTexture", "./lost.png", 0.5),
        )
    ):
        ball = UsdGeom.Sphere.Define(stage, f"/World/Odd/Ball{i}")
        place(ball, (-1.5 + 3.0 * i, 1.0, 10.0))
        bind(ball, look)
    UsdLux.PluginLight.Define(stage, "/World/Odd/Neon")
    stage.Save()


def write_shot(folder: Path) -> Path:
    """Everything into a folder; the path of its crowd.usda."""
    folder.mkdir(parents=True, exist_ok=True)
    write_texture(folder / "bricks.png")
    for kind in KINDS:
        write_creature(folder / f"{kind}.usdc")
    layers = {
        "camera": write_camera,
        "lights": write_lights,
        "set": write_set,
        "crowd": write_crowd,
        "odd": write_odd,
    }
    for name, write in layers.items():
        write(folder / f"crowd_{name}.usda")
    stage = new_layer(folder / "crowd.usda")
    stage.GetRootLayer().subLayerPaths = [f"./crowd_{name}.usda" for name in layers]
    stage.SetStartTimeCode(FRAMES[0])
    stage.SetEndTimeCode(FRAMES[-1])
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateResolutionAttr(Gf.Vec2i(960, 400))
    settings.CreateCameraRel().SetTargets(["/World/main_cam"])
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    stage.Save()
    return folder / "crowd.usda"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/crowd"))
    print(write_shot(parser.parse_args().out))
