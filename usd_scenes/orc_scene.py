"""Writes the orc's meshes (usdc) and its stage (usda): rig, looks, camera and render settings."""

import numpy as np
from orc_sdf import unit, vec
from pxr import Sdf, Usd, UsdGeom, Vt

EYE_HEIGHT = 24.0
EYE_BINDINGS = {
    "pupil": "Pupil",
    "irisDark": "IrisDark",
    "irisMiddle": "IrisMiddle",
    "irisBright": "IrisBright",
    "limbus": "Limbus",
    "sclera": "Sclera",
}
BINDINGS = {"Skin": "Skin", "TuskLeft": "Ivory", "TuskRight": "Ivory", "Earring": "Gold"}


def write_meshes(path, meshes):
    """meshes: {name: (points, triangles, normals[, subsets])}, below the default prim /Orc."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Orc").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    for name, (points, triangles, normals, *subsets) in meshes.items():
        mesh = define_mesh(stage, f"/Orc/{name}", points, triangles, normals)
        for region, faces in (subsets[0] if subsets else {}).items():
            indices = Vt.IntArray.FromNumpy(faces.astype(np.int32))
            UsdGeom.Subset.CreateGeomSubset(
                mesh, region, UsdGeom.Tokens.face, indices, "materialBind", "partition"
            )
    stage.GetRootLayer().Save()


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


def look(name, **inputs):
    """A Material with one UsdPreviewSurface; keyword values are (type, value) pairs."""
    lines = "".join(
        f"\n                {kind} inputs:{key} = {value}" for key, (kind, value) in inputs.items()
    )
    return f'''
        def Material "{name}"
        {{
            token outputs:surface.connect = </World/Looks/{name}/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"{lines}
                token outputs:surface
            }}
        }}
'''


def scattering(name, color, mean_free_path, roughness, **more):
    return look(
        name,
        diffuseColor=("color3f", color),
        ior=("float", 1.4),
        roughness=("float", roughness),
        **more,
        subsurface=("float", 1),
        subsurfaceColor=("color3f", color),
        subsurfaceRadius=("color3f", mean_free_path),
        subsurfaceBoundary=("token", '"diffuse"'),
    )


def wet(name, color):
    coat = {"clearcoat": ("float", 1), "clearcoatRoughness": ("float", 0.06)}
    return look(name, diffuseColor=("color3f", color), ior=("float", 1.38), roughness=("float", 0.25), **coat)


def looks():
    coat = {"clearcoat": ("float", 0.5), "clearcoatRoughness": ("float", 0.15)}
    parts = [
        "\n        # Very thick: the red mean free path is about a tenth of the ear's membrane (0.4 to 0.5 cm).",
        scattering("Skin", "(0.76, 0.66, 0.37)", "(0.055, 0.02, 0.012)", 0.38),
        scattering("Ivory", "(0.86, 0.77, 0.58)", "(0.11, 0.075, 0.045)", 0.3, **coat),
        "\n        # The eye: the tear film is a clear coat over sclera, limbus, three tones of iris, and pupil.",
        wet("Sclera", "(0.62, 0.5, 0.36)"),
        wet("Limbus", "(0.07, 0.035, 0.015)"),
        wet("IrisDark", "(0.2, 0.055, 0.012)"),
        wet("IrisMiddle", "(0.5, 0.17, 0.025)"),
        wet("IrisBright", "(0.85, 0.4, 0.06)"),
        wet("Pupil", "(0.004, 0.003, 0.003)"),
        look(
            "Gold",
            diffuseColor=("color3f", "(0.86, 0.6, 0.26)"),
            metallic=("float", 1),
            roughness=("float", 0.28),
        ),
        look("Backdrop", diffuseColor=("color3f", "(0.1, 0.11, 0.13)"), roughness=("float", 0.9)),
    ]
    return "".join(parts)


def binding(material, indent):
    return f"{' ' * indent}rel material:binding = </World/Looks/{material}>\n"


def bound(kind, name, material, indent, inside=""):
    pad = " " * indent
    head = f'{pad}over "{name}" (\n{pad}    prepend apiSchemas = ["MaterialBindingAPI"]\n{pad})\n'
    return head + f"{pad}{{\n{binding(material, indent + 4)}{inside}{pad}}}\n"


def bust():
    parts = [bound("Mesh", name, material, 8) for name, material in BINDINGS.items()]
    subsets = "".join("\n" + bound("GeomSubset", region, m, 12) for region, m in EYE_BINDINGS.items())
    parts += [bound("Mesh", name, "Sclera", 8, subsets) for name in ("EyeLeft", "EyeRight")]
    return "\n".join(parts)


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
