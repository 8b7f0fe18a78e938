"""Writes the orc's meshes (usdc) and its stage (usda): rig, camera and render settings."""

import numpy as np
from orc_looks import looks
from orc_maps import coordinates
from orc_sdf import unit, vec
from pxr import Sdf, Usd, UsdGeom, Vt

EYE_HEIGHT = 24.0
BINDINGS = {
    "Skin": "Skin",
    "EyeLeft": "Eye",
    "EyeRight": "Eye",
    "CorneaLeft": "Tears",
    "CorneaRight": "Tears",
    "TearLeft": "Tears",
    "TearRight": "Tears",
    "TuskLeft": "Ivory",
    "TuskRight": "Ivory",
    "Earring": "Gold",
}
TUFT_BINDINGS = {"Lashes": "Hair", "Brows": "Hair"}


def write_meshes(path, meshes, tufts):
    """meshes: {name: (points, triangles, normals[, st])}, tufts: {name: (points (n, 4, 3), width)}, below the
    default prim /Orc. `st` is one per point; the skin's are made here."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Orc").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    for name, (points, triangles, normals, *st) in meshes.items():
        mesh = define_mesh(stage, f"/Orc/{name}", points, triangles, normals)
        if name == "Skin":
            define_coordinates(mesh, *coordinates(points, triangles))
        elif st:
            define_coordinates(mesh, *st)
    for name, (points, width) in tufts.items():
        define_tuft(stage, f"/Orc/{name}", points, width)
    stage.GetRootLayer().Save()


def define_coordinates(mesh, st, indices=None):
    """One per point, or by indices of all corners."""
    interpolation = UsdGeom.Tokens.vertex if indices is None else UsdGeom.Tokens.faceVarying
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, interpolation)
    primvar.Set(Vt.Vec2fArray.FromNumpy(st.astype(np.float32)))
    if indices is not None:
        primvar.SetIndices(Vt.IntArray.FromNumpy(indices.astype(np.int32).ravel()))


def define_tuft(stage, path, points, width):
    """Hairs that taper to a tip."""
    curves = UsdGeom.BasisCurves.Define(stage, path)
    flat = Vt.Vec3fArray.FromNumpy(points.reshape(-1, 3).astype(np.float32))
    curves.CreatePointsAttr(flat)
    curves.CreateCurveVertexCountsAttr(Vt.IntArray(len(points), points.shape[1]))
    curves.CreateTypeAttr(UsdGeom.Tokens.cubic)
    curves.CreateBasisAttr(UsdGeom.Tokens.catmullRom)
    curves.CreateWrapAttr(UsdGeom.Tokens.pinned)
    taper = width * np.array([1.0, 0.9, 0.6, 0.08], np.float32)
    curves.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.tile(taper, len(points))))
    curves.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    curves.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(flat))


def define_mesh(stage, path, points, triangles, normals):
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.astype(np.int32).ravel()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(triangles), 3))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "normals", Sdf.ValueTypeNames.Normal3fArray, UsdGeom.Tokens.vertex
    )
    primvar.Set(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    return mesh


def looking(origin, target):
    """The row-vector matrix of a light or camera at origin that looks along its -Z at target, as USD text."""
    back = unit(vec(*origin) - vec(*target))
    right = unit(np.cross(vec(0, 1, 0), back))
    rows = [*right, 0], [*np.cross(back, right), 0], [*back, 0], [*origin, 1]
    return "( " + ", ".join("(" + ", ".join(f"{x:.6g}" for x in row) + ")" for row in rows) + " )"


def around(degrees, height, distance):
    """A point at a distance round the head: 0 degrees is in front of the face, positive towards +X."""
    a = np.radians(degrees)
    return vec(distance * np.sin(a), EYE_HEIGHT + height, distance * np.cos(a))


def rect_light(name, origin, size, color, intensity, target=(0, EYE_HEIGHT - 2, 0)):
    return f'''
        def RectLight "{name}"
        {{
            color3f inputs:color = {color}
            float inputs:intensity = {intensity}
            bool inputs:normalize = 0
            float inputs:width = {size[0]}
            float inputs:height = {size[1]}
            matrix4d xformOp:transform = {looking(origin, target)}
            uniform token[] xformOpOrder = ["xformOp:transform"]
        }}
'''


def eye_spot(origin, target):
    return f"""
        def DiskLight "EyeSpot" (
            prepend apiSchemas = ["ShapingAPI"]
        )
        {{
            color3f inputs:color = (1, 0.95, 0.88)
            float inputs:intensity = 700
            bool inputs:normalize = 0
            float inputs:radius = 3
            float inputs:shaping:cone:angle = 2.5
            float inputs:shaping:cone:softness = 0.4
            float inputs:shaping:focus = 0
            matrix4d xformOp:transform = {looking(origin, target)}
            uniform token[] xformOpOrder = ["xformOp:transform"]
        }}
"""


def lights(eye):
    """The production rig: two keys in front at the sides, back lights at nine times their intensity, an eye spot."""
    parts = [
        "\n        # Keys: in front, sixty degrees to either side.",
        rect_light("KeyRight", around(62, 14, 75), (22, 34), "(1, 0.95, 0.88)", 17),
        rect_light("KeyLeft", around(-58, 8, 75), (22, 34), "(0.8, 0.9, 1)", 8),
        "\n        # Back lights: ten times the keys, one behind either ear, warm and cool.",
        rect_light(
            "BackRight", around(148, 16, 62), (20, 20), "(1, 0.84, 0.66)", 150, (12, EYE_HEIGHT + 3, -3)
        ),
        rect_light(
            "BackLeft", around(-146, 18, 62), (20, 20), "(0.82, 0.9, 1)", 150, (-12, EYE_HEIGHT + 3, -3)
        ),
        "\n        # Eye spot: a five degree cone on the eye that is nearer to the camera.",
        eye_spot(around(8, 9, 95), eye),
    ]
    return "".join(parts)


def bound(name, material):
    return f'''        over "{name}" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        )
        {{
            rel material:binding = </World/Looks/{material}>
        }}
'''


def bust():
    return "\n".join(bound(name, material) for name, material in {**BINDINGS, **TUFT_BINDINGS}.items())


RENDER_VARS = {
    "color": ("color3f", "C.*[LO]", "lpe"),
    "alpha": ("float", "a", "raw"),
    "depth": ("float", "z", "raw"),
    "normal": ("normal3f", "N", "raw"),
    "position": ("point3f", "P", "raw"),
    "albedo": ("color3f", "albedo", "raw"),
    "primId": ("int", "primId", "raw"),
}


def render_vars():
    return "".join(
        f'''
        def RenderVar "{name}"
        {{
            uniform token dataType = "{kind}"
            uniform string sourceName = "{source}"
            uniform token sourceType = "{source_type}"
        }}
'''
        for name, (kind, source, source_type) in RENDER_VARS.items()
    )


def stage_text(camera, target, eye):
    """The whole stage as text; camera, target and eye are points in stage space."""
    focus = np.linalg.norm(vec(*camera) - vec(*target))
    ordered = "".join(f"\n                </Render/Vars/{name}>," for name in RENDER_VARS)
    return f'''#usda 1.0
(
    defaultPrim = "World"
    doc = """An orc's head under a production rig: two keys, strong back lights through thin ears, a spot on one eye.
Written by orc_model.py, which also models the meshes."""
    metersPerUnit = 0.01
    renderSettingsPrimPath = "/Render/Settings"
    upAxis = "Y"
)

def Xform "World"
{{
    def Xform "Bust" (
        prepend references = @./orc_meshes.usdc@
    )
    {{
        # The model's eye line is at y = 0; the bust stands on the floor.
        double3 xformOp:translate = (0, {EYE_HEIGHT:g}, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]

{bust()}    }}

    def Mesh "Backdrop" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-400, -200, -170), (400, -200, -170), (400, 300, -170), (-400, 300, -170)]
        float3[] extent = [(-400, -200, -170), (400, 300, -170)]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Looks/Backdrop>
    }}

    def Scope "Lights"
    {{{lights(eye)}    }}

    def Scope "Cameras"
    {{
        # 85 mm on a portrait frame of 24 x 27 mm.
        def Camera "Main"
        {{
            float2 clippingRange = (1, 2000)
            float focalLength = 85
            float focusDistance = {focus:.6g}
            float fStop = 0
            float horizontalAperture = 24
            float verticalAperture = 27
            token projection = "perspective"
            matrix4d xformOp:transform = {looking(camera, target)}
            uniform token[] xformOpOrder = ["xformOp:transform"]
        }}
    }}

    def Scope "Looks"
    {{{looks()}    }}
}}

def Scope "Render"
{{
    def RenderSettings "Settings"
    {{
        uniform token aspectRatioConformPolicy = "expandAperture"
        rel camera = </World/Cameras/Main>
        uniform token[] includedPurposes = ["default", "render"]
        uniform token[] materialBindingPurposes = ["full", "allPurpose"]
        uniform float pixelAspectRatio = 1
        rel products = </Render/Products/beauty>
        uniform token renderingColorSpace = "lin_rec709"
        uniform int2 resolution = (640, 720)
    }}

    def Scope "Vars"
    {{{render_vars()}    }}

    def Scope "Products"
    {{
        def RenderProduct "beauty"
        {{
            rel camera = </World/Cameras/Main>
            rel orderedVars = [{ordered}
            ]
            token productName = "orc.exr"
            uniform token productType = "raster"
        }}
    }}
}}
'''
