"""Writes subdivision.usda, curves.usda, points.usda and hair.usda: python usd_scenes/geometry_scenes.py"""

import math
import random
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, Vt

HERE = Path(__file__).parent
SKIN = (0.72, 0.48, 0.36)
CUBE = [Gf.Vec3f(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
CUBE_FACES = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]


def new_stage(name: str, doc: str, camera: tuple[float, float, float], focal: float = 50.0) -> Usd.Stage:
    """A stage with a floor, a soft light from the upper left, a dome, a camera and render settings."""
    stage = Usd.Stage.CreateNew(str(HERE / name))
    stage.SetMetadata("metersPerUnit", 0.01)
    stage.GetRootLayer().documentation = doc
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    floor = UsdGeom.Plane.Define(stage, "/World/Floor")
    floor.CreateAxisAttr("Y")
    floor.CreateWidthAttr(400.0)
    floor.CreateLengthAttr(400.0)
    floor.CreateDisplayColorAttr([Gf.Vec3f(0.3)])
    key = UsdLux.RectLight.Define(stage, "/World/Key")
    key.CreateWidthAttr(6.0)
    key.CreateHeightAttr(6.0)
    key.CreateIntensityAttr(25.0)
    UsdGeom.XformCommonAPI(key).SetTranslate((-6.0, 9.0, 6.0))
    UsdGeom.XformCommonAPI(key).SetRotate((-46.0, -45.0, 0.0))
    UsdLux.DomeLight.Define(stage, "/World/Dome").CreateIntensityAttr(0.35)
    view = UsdGeom.Camera.Define(stage, "/World/main_cam")
    view.CreateFocalLengthAttr(focal)
    view.CreateHorizontalApertureAttr(36.0)
    view.CreateVerticalApertureAttr(20.25)
    UsdGeom.XformCommonAPI(view).SetTranslate(camera)
    UsdGeom.XformCommonAPI(view).SetRotate((-math.degrees(math.atan2(camera[1] - 1.0, camera[2])), 0.0, 0.0))
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateResolutionAttr(Gf.Vec2i(640, 360))
    settings.CreateCameraRel().SetTargets(["/World/main_cam"])
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    return stage


def short(v) -> Gf.Vec3f:
    """Four decimals, to keep the files small."""
    return Gf.Vec3f(*(round(x, 4) for x in v))


def place(prim, x: float, y: float, z: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    UsdGeom.XformCommonAPI(prim).SetTranslate((x, y, z))
    UsdGeom.XformCommonAPI(prim).SetRotate(turn)


def cage(stage: Usd.Stage, path: str, points: list, counts: list[int], indices: list[int]) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(indices)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*SKIN)])
    return mesh


def crease(mesh: UsdGeom.Mesh, chains: list[list[int]], sharpness: list[float]) -> None:
    mesh.CreateCreaseIndicesAttr([v for chain in chains for v in chain])
    mesh.CreateCreaseLengthsAttr([len(chain) for chain in chains])
    mesh.CreateCreaseSharpnessesAttr(sharpness)


def subdivision() -> None:
    """Back: cubes whose upper edges are creases of sharpness 0, 1, 2.3 and infinite. Front: sheets whose boundary has
    corners, is smooth, ends a face early; a hole and corners; Loop; a cage (level 0 by primvar)."""
    stage = new_stage("subdivision.usda", " ".join(subdivision.__doc__.split()), (0.0, 5.5, 13.0), 36.0)
    attribute = stage.GetPrimAtPath("/Render/Settings").CreateAttribute(
        "dermis:refineLevel", Sdf.ValueTypeNames.Int
    )
    attribute.Set(3)
    for i, sharpness in enumerate((0.0, 1.0, 2.3, 10.0)):
        cube = cage(stage, f"/World/Cube{i}", CUBE, [4] * 6, CUBE_FACES)
        crease(cube, [[2, 3, 7, 6, 2]], [sharpness])
        place(cube, -4.5 + 3 * i, 1.0, -2.0, (0.0, 25.0, 0.0))
    for i, boundary in enumerate(("edgeAndCorner", "edgeOnly", "none")):
        points = [
            Gf.Vec3f(x - 1.5, 0.9 - 0.5 * math.cos(1.3 * x + y), y - 1.5) for y in range(4) for x in range(4)
        ]
        faces = [v + o for y in range(3) for v in range(4 * y, 4 * y + 3) for o in (0, 4, 5, 1)]
        sheet = cage(stage, f"/World/Sheet_{boundary}", [p * 0.6 for p in points], [4] * 9, faces)
        sheet.CreateInterpolateBoundaryAttr(boundary)
        sheet.CreateDoubleSidedAttr(True)
        place(sheet, -4.3 + 2.1 * i, 0.1, 2.2)
    box = cage(stage, "/World/Hole", CUBE, [4] * 6, CUBE_FACES)
    box.CreateHoleIndicesAttr([1])
    box.CreateDoubleSidedAttr(True)
    box.CreateCornerIndicesAttr([4, 5, 6, 7])
    box.CreateCornerSharpnessesAttr([10.0] * 4)
    place(box, 1.4, 0.75, 2.2, (-20.0, -30.0, 0.0))
    ring = [0, 1, 2, 3]
    octahedron = [
        Gf.Vec3f(*p) for p in ((1, 0, 0), (0, 0, -1), (-1, 0, 0), (0, 0, 1), (0, 1.3, 0), (0, -1.3, 0))
    ]
    triangles = [v for i in ring for v in (i, (i + 1) % 4, 4)] + [
        v for i in ring for v in ((i + 1) % 4, i, 5)
    ]
    loop = cage(stage, "/World/Loop", octahedron, [3] * 8, triangles)
    loop.CreateSubdivisionSchemeAttr("loop")
    crease(loop, [[0, 1, 2, 3, 0]], [2.0])
    place(loop, 3.1, 0.9, 2.2)
    plain = cage(stage, "/World/Cage", CUBE, [4] * 6, CUBE_FACES)
    UsdGeom.PrimvarsAPI(plain).CreatePrimvar("dermis:refineLevel", Sdf.ValueTypeNames.Int).Set(0)
    plain.AddScaleOp().Set((0.45, 0.45, 0.45))
    plain.AddTranslateOp().Set((10.2, 1.0, 5.5))
    stage.Save()


def curves_prim(
    stage: Usd.Stage, path: str, counts: list[int], points: list, widths: list[float], **tokens: str
):
    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateCurveVertexCountsAttr(counts)
    curves.CreatePointsAttr(Vt.Vec3fArray(points))
    curves.CreateWidthsAttr(widths)
    curves.SetWidthsInterpolation("constant" if len(widths) == 1 else "vertex")
    curves.CreateTypeAttr(tokens.get("type", "cubic"))
    curves.CreateBasisAttr(tokens.get("basis", "bspline"))
    curves.CreateWrapAttr(tokens.get("wrap", "nonperiodic"))
    return curves


def curves() -> None:
    """One zigzag as linear, bezier, bspline and catmullRom (pinned where it can be); a closed ring; a ribbon; a tuft
    of tapering hair with a colour per vertex."""
    stage = new_stage("curves.usda", " ".join(curves.__doc__.split()), (0.0, 4.0, 13.0), 38.0)
    zigzag = [Gf.Vec3f(0.9 * math.sin(2.1 * i), 0.35 * i + 0.3, 0.5 * math.cos(1.3 * i)) for i in range(7)]
    looks = {"linear": "nonperiodic", "bezier": "nonperiodic", "bspline": "pinned", "catmullRom": "pinned"}
    for i, (basis, wrap) in enumerate(looks.items()):
        kind = {"type": "linear"} if basis == "linear" else {"basis": basis}
        rope = curves_prim(stage, f"/World/{basis}", [7], zigzag, [0.25], wrap=wrap, **kind)
        rope.CreateDisplayColorAttr([Gf.Vec3f(*SKIN)])
        place(rope, -4.9 + 2.1 * i, 0.0, 0.0)
    circle = [
        Gf.Vec3f(math.cos(a), 0.25 * math.sin(3 * a) + 0.5, math.sin(a))
        for a in (k * math.pi / 4 for k in range(8))
    ]
    ring = curves_prim(stage, "/World/Ring", [8], circle, [0.3], wrap="periodic")
    ring.CreateDisplayColorAttr([Gf.Vec3f(0.25, 0.4, 0.6)])
    place(ring, -3.2, 0.0, 3.2)
    ribbon = curves_prim(stage, "/World/Ribbon", [7], zigzag, [0.5], wrap="pinned", basis="catmullRom")
    ribbon.CreateNormalsAttr([Gf.Vec3f(math.sin(i), 0.2, math.cos(i)) for i in range(7)])
    ribbon.SetNormalsInterpolation("vertex")
    ribbon.CreateDisplayColorAttr([Gf.Vec3f(0.6, 0.2, 0.15)])
    place(ribbon, 3.2, 0.0, 0.0)
    tuft(stage)
    stage.Save()


def tuft(
    stage: Usd.Stage, path: str = "/World/Tuft", at: tuple[float, float] = (1.0, 3.4)
) -> UsdGeom.BasisCurves:
    chance = random.Random(1)
    points, colors, widths = [], [], []
    number = 300
    for _ in range(number):
        a, r = 2 * math.pi * chance.random(), 0.7 * math.sqrt(chance.random())
        root = Gf.Vec3f(r * math.cos(a), 0.0, r * math.sin(a))
        lean = Gf.Vec3f(root[0] * 1.2 + chance.gauss(0, 0.15), 0.0, root[2] * 1.2 + chance.gauss(0, 0.15))
        for k in range(5):
            t = k / 4
            points.append(short(root + Gf.Vec3f(0, 2.2 * t - 0.7 * t * t, 0) + lean * (t * t)))
            colors.append(short(Gf.Vec3f(0.18 + 0.4 * t, 0.08 + 0.25 * t, 0.03 + 0.1 * t)))
            widths.append(round(0.045 * (1.0 - t) ** 0.7, 4))
    hair = curves_prim(stage, path, [5] * number, points, widths, basis="catmullRom", wrap="pinned")
    UsdGeom.PrimvarsAPI(hair).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex").Set(
        colors
    )
    place(hair, at[0], 0.0, at[1])
    return hair


def points() -> None:
    """A spiral of points with widths and colours of their own; a handful of wax beads."""
    stage = new_stage("points.usda", points.__doc__, (0.0, 5.0, 13.0), 40.0)
    number = 400
    turns = [0.25 * i for i in range(number)]
    places = [
        Gf.Vec3f(0.009 * i * math.cos(a), 4.0 * (1 - i / number) ** 1.5 + 0.12, 0.009 * i * math.sin(a))
        for i, a in enumerate(turns)
    ]
    spiral = UsdGeom.Points.Define(stage, "/World/Spiral")
    spiral.CreatePointsAttr([short(p) for p in places])
    spiral.CreateIdsAttr(list(range(number)))
    spiral.CreateWidthsAttr([0.12 + 0.12 * (i % 5) / 4 for i in range(number)])
    hues = [
        Gf.Vec3f(
            0.5 + 0.4 * math.cos(a / 4), 0.4 + 0.3 * math.cos(a / 4 + 2), 0.4 + 0.35 * math.cos(a / 4 + 4)
        )
        for a in turns
    ]
    UsdGeom.PrimvarsAPI(spiral).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex").Set(
        hues
    )
    wax = UsdShade.Material.Define(stage, "/World/Wax")
    shader = UsdShade.Shader.Define(stage, "/World/Wax/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    for name, kind, value in (
        ("subsurface", Sdf.ValueTypeNames.Float, 1.0),
        ("subsurfaceColor", Sdf.ValueTypeNames.Color3f, Gf.Vec3f(0.9, 0.7, 0.4)),
        ("subsurfaceRadius", Sdf.ValueTypeNames.Color3f, Gf.Vec3f(0.3, 0.15, 0.06)),
    ):
        shader.CreateInput(name, kind).Set(value)
    wax.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    beads = UsdGeom.Points.Define(stage, "/World/Beads")
    beads.CreatePointsAttr([Gf.Vec3f(-3.2 + 1.6 * i, 0.6, 4.0) for i in range(5)])
    beads.CreateWidthsAttr([1.2, 0.9, 1.1, 0.8, 1.2])
    UsdShade.MaterialBindingAPI.Apply(beads.GetPrim()).Bind(wax)
    stage.Save()


def node(stage: Usd.Stage, path: str, name: str, **inputs: object) -> UsdShade.Shader:
    shader = UsdShade.Shader.Define(stage, path)
    shader.CreateIdAttr(name)
    for key, value in inputs.items():
        shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    return shader


def hair_look(stage: Usd.Stage, path: str, melanin: float, redness: float) -> UsdShade.Material:
    """MaterialX: a surface around chiang_hair_bsdf, its roughness and absorption by nodes of their own."""
    material = UsdShade.Material.Define(stage, path)
    strand = node(stage, f"{path}/Strand", "ND_chiang_hair_bsdf", cuticle_angle=0.515)
    pigment = node(
        stage,
        f"{path}/Melanin",
        "ND_deon_hair_absorption_from_melanin",
        melanin_concentration=melanin,
        melanin_redness=redness,
    )
    rough = node(stage, f"{path}/Roughness", "ND_chiang_hair_roughness", longitudinal=0.2, azimuthal=0.3)
    absorption = pigment.CreateOutput("absorption", Sdf.ValueTypeNames.Float3)
    strand.CreateInput("absorption_coefficient", Sdf.ValueTypeNames.Float3).ConnectToSource(absorption)
    for lobe in ("R", "TT", "TRT"):
        output = rough.CreateOutput(f"roughness_{lobe}", Sdf.ValueTypeNames.Float2)
        strand.CreateInput(f"roughness_{lobe}", Sdf.ValueTypeNames.Float2).ConnectToSource(output)
    surface = node(stage, f"{path}/Surface", "ND_surface")
    bsdf = strand.CreateOutput("out", Sdf.ValueTypeNames.Token)
    surface.CreateInput("bsdf", Sdf.ValueTypeNames.Token).ConnectToSource(bsdf)
    material.CreateSurfaceOutput("mtlx").ConnectToSource(
        surface.CreateOutput("out", Sdf.ValueTypeNames.Token)
    )
    return material


def hair() -> None:
    """One tuft in chiang_hair_bsdf: with little melanin, with red one, with much; lit from the side and from behind."""
    stage = new_stage("hair.usda", " ".join(hair.__doc__.split()), (0.0, 2.6, 9.0), 45.0)
    strands = tuft(stage, "/Tuft", (0.0, 0.0)).GetPrim()
    strands.RemoveProperty("primvars:displayColor")
    strands.SetSpecifier(Sdf.SpecifierClass)
    for name, x, melanin, redness in (
        ("Fair", -2.2, 0.12, 0.2),
        ("Red", 0.0, 0.45, 0.9),
        ("Dark", 2.2, 0.9, 0.2),
    ):
        prim = stage.DefinePrim(f"/World/{name}")
        prim.GetReferences().AddInternalReference("/Tuft")
        place(UsdGeom.BasisCurves(prim), x, 0.0, 0.0)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(hair_look(stage, f"/World/{name}Look", melanin, redness))
    back = UsdLux.RectLight.Define(stage, "/World/Back")
    back.CreateWidthAttr(4.0)
    back.CreateHeightAttr(2.0)
    back.CreateIntensityAttr(30.0)
    UsdGeom.XformCommonAPI(back).SetTranslate((2.0, 5.0, -6.0))
    UsdGeom.XformCommonAPI(back).SetRotate((-35.0, 160.0, 0.0))
    stage.Save()


if __name__ == "__main__":
    for write in (subdivision, curves, points, hair):
        (HERE / f"{write.__name__}.usda").unlink(missing_ok=True)
        write()
