"""The rows of the table. One more is one more entry of CAPABILITIES, by the name that `dermis explain` has for it."""

import math
from dataclasses import dataclass, replace
from functools import partial

from .stages import FACES, LAMP, OPAQUE, Stage, ball, material, medium


@dataclass(frozen=True)
class Compared:
    """Two stages that differ in nothing but what is measured."""

    what: str
    """Of `having`."""
    having: Stage
    without: Stage
    against: str
    """What `without` is."""


@dataclass(frozen=True)
class Capability:
    name: str
    unused: Compared
    """Declared on the stage, and of no effect."""
    used: Compared


#: The ball is opaque; nothing beside colour and alpha is asked for.
PLAIN = Stage()
against_plain = partial(Compared, without=PLAIN, against="an opaque ball, a rect light")

#: The ball is a grey medium, lit, walked as `auto` decides: by the mixture.
WAX = Stage(look=medium())
CLASSICAL = replace(WAX, flags=(*WAX.flags, "--walk", "classical"))
against_classical = partial(Compared, without=CLASSICAL, against="a grey medium, classical walks")

SMOOTH = replace(CLASSICAL, look=medium("dielectric", more="float inputs:roughness = 0"))

COLORED = f"""
    color3f[] primvars:tint = {[(0.5, 0.5, 0.5)] * FACES} (interpolation = "uniform")
"""
DRIVEN = """
    color3f inputs:diffuseColor.connect = <Reader.outputs:result>
    def Shader "Reader"
    {
        uniform token info:id = "UsdPrimvarReader_float3"
        string inputs:varname = "tint"
        float3 outputs:result
    }
"""


def moved(x: float, y: float = 0.0) -> str:
    return f"""
        double3 xformOp:translate = ({x}, {y}, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    """


INVISIBLE = 'token visibility = "invisible"'


def pip(x: float, lines: str = "") -> str:
    """A small opaque ball: within the large one, or beside it."""
    return LAMP + ball("Pip", "/World/Plain", moved(x) + lines, 0.3) + material("Plain", OPAQUE)


SET = 'token primvars:dermis:subsurfaceSet = "one"'


def neighbour(lines: str = "") -> str:
    """Another ball of the same medium, across the first."""
    return LAMP + ball("Neighbour", "/World/Look", moved(1.2) + lines)


def tank(y: float, lines: str = "") -> str:
    """A ball of thin grey air: around the camera, or far above."""
    air = medium("indexMatched", radius=(1e3, 1e3, 1e3), more="color3f inputs:subsurfaceAlbedo = (0, 0, 0)")
    return LAMP + ball("Tank", "/World/Air", moved(0.0, y) + lines, 20.0) + material("Air", air)


def twin(turned: float = 0.0, lines: str = "") -> str:
    """Two more balls of the medium, instances of one: lit alike unless one of them is turned."""
    orientation = f"({math.cos(math.radians(turned / 2))}, 0, 0, {math.sin(math.radians(turned / 2))})"
    return (
        f"""
    def PointInstancer "Twins"
    {{
        rel prototypes = </World/Twins/One>
        {lines}
        int[] protoIndices = [0, 0]
        point3f[] positions = [(2.1, 0, 0), (-2.1, 0, 0)]
        quath[] orientations = [(1, 0, 0, 0), {orientation}]
    """
        + ball("One", "/World/Look")
        + "}"
    )


TWIN = twin()
SKY = """
    def DomeLight "Sky"
    {
        float inputs:intensity = 1
    }
"""

DARK = replace(WAX, world="", flags=(*WAX.flags, "--disableCameraLight"))
"""Media, and no light to walk to."""


TIMED = "startTimeCode = 1\n    endTimeCode = 1"
SHUTTER = "double shutter:open = -0.25\n        double shutter:close = 0.25"
FLIGHT = """
        double3 xformOp:translate.timeSamples = { 0: (-0.3, 0, 0), 2: (0.3, 0, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
"""


def setting(stage: Stage, *flags: str) -> Stage:
    return replace(stage, flags=(*stage.flags, *flags))


def hidden(look: str, stage: Stage = PLAIN) -> Stage:
    """A material on a ball that is not rendered, and on the other one, where a subset of all faces wears its own."""
    subset = f"""
        def GeomSubset "All" (prepend apiSchemas = ["MaterialBindingAPI"])
        {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = {list(range(FACES))}
            rel material:binding = </World/Look>
        }}
    """
    invisible = ball("Hidden", "/World/Other", 'token visibility = "invisible"', 0.5)
    world = stage.world + material("Other", look) + invisible
    return replace(stage, world=world, ball=subset, worn="/World/Other")


def unrendered(what: str, look: str, stage: Stage = PLAIN) -> Compared:
    """`look` against an opaque or grey material on what is hidden."""
    plain = OPAQUE if stage is PLAIN else stage.look
    return Compared(
        f"{what} on what is not rendered", hidden(look, stage), hidden(plain, stage), "an opaque or grey one"
    )


def light(kind: str, name: str, lines: str) -> str:
    return f"""
    def {kind} "{name}"
    {{
        {lines}
    }}
"""


def lit(*prims: str, stage: Stage = PLAIN) -> Stage:
    """With prims beside the lamp."""
    return replace(stage, world=LAMP + "".join(prims))


def lamp_beside(lines: str = "") -> str:
    place = 'double3 xformOp:translate = (2, 1, 5)\n uniform token[] xformOpOrder = ["xformOp:translate"]'
    return light("RectLight", "Beside", f"float inputs:intensity = 5\n {lines}\n {place}")


def dome_through(lines: str) -> str:
    """A dome with a portal."""
    return light("DomeLight", "Sky", f"{DOME}\n rel portals = </World/Gate>") + light(
        "PortalLight", "Gate", lines
    )


def glowing(intensity: float) -> str:
    """A small ball beside the other one that is a light, or would be."""
    shines = f"color3f inputs:color = (1, 1, 1)\n float inputs:intensity = {intensity}"
    place = 'double3 xformOp:translate = (1.6, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]'
    mesh = ball("Glow", "/World/Look", f"{shines}\n {place}", 0.3)
    return mesh.replace("MaterialBindingAPI", 'MaterialBindingAPI", "MeshLightAPI')


def scattered(count: int) -> list[tuple[float, float, float]]:
    """Places of small balls, on a helix."""
    return [(0.9 * (i % 4 - 1.5), 0.9 * (i // 4 - 1.5), -0.2 * i) for i in range(count)]


def copies(count: int) -> str:
    """Balls, each a mesh of its own."""
    placed = (
        f'double3 xformOp:translate = {place}\n uniform token[] xformOpOrder = ["xformOp:translate"]'
        for place in scattered(count)
    )
    return "".join(ball(f"Many{i}", "/World/Look", lines, 0.4) for i, lines in enumerate(placed))


def instances(places: list[tuple[float, float, float]], name: str = "Many") -> str:
    """The same by a PointInstancer."""
    return f"""
    def PointInstancer "{name}"
    {{
        point3f[] positions = {places}
        int[] protoIndices = {[0] * len(places)}
        rel prototypes = </World/{name}/Ball>
        {ball("Ball", "/World/Look", radius=0.4)}
    }}
"""


CREASE = "int[] creaseIndices = [0, 1]\n int[] creaseLengths = [2]\n float[] creaseSharpnesses = [2]"


def refined(level: int) -> Stage:
    """With a subdivision surface in place of some balls."""
    surface = copies(1).replace('subdivisionScheme = "none"', 'subdivisionScheme = "loop"')
    return setting(lit(surface), "--set", f"refineLevel={level}")


def displaced(offset: float) -> str:
    return f"{OPAQUE}\nfloat inputs:displacement = {offset}"


IMAGE = "asset inputs:texture:file = @image.hdr@"
"""`driver.flatten` writes it beside the stage."""
DOME = "float inputs:intensity = 0.5"
GATE = 'double3 xformOp:translate = (0, 0, 5)\n uniform token[] xformOpOrder = ["xformOp:translate"]'
UNBOUND_IMAGE = """
    def Material "Unbound"
    {
        token outputs:surface.connect = </World/Unbound/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Unbound/Image.outputs:rgb>
            token outputs:surface
        }
        def Shader "Image"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @image.hdr@
            float3 outputs:rgb
        }
    }
"""
UNORDERED_VAR = """
    def RenderVar "Normal"
    {
        uniform string sourceName = "normal"
    }
"""
OPACITY = OPAQUE + "\n float inputs:opacity = 0.5"
GLASS = medium("dielectric", more="float3 inputs:subsurfaceAlbedo = (0, 0, 0)\n float inputs:roughness = 0")
AOVS = ("--set", "aovs=alpha,depth,normal,position,albedo,primId,direct,indirect,subsurface,variance")
WALK_AOVS = ("--set", "aovs=slabNormal,entryAgreement,walkLength,region,cacheIrradiance,techniqueShares")
PALE = (0.9, 0.8, 0.7)

HAIR = """
    def Material "Hair"
    {
        token outputs:mtlx:surface.connect = </World/Hair/Surface.outputs:out>
        def Shader "Surface"
        {
            uniform token info:id = "ND_surface"
            token inputs:bsdf.connect = </World/Hair/Strand.outputs:out>
            token outputs:out
        }
        def Shader "Strand"
        {
            uniform token info:id = "ND_chiang_hair_bsdf"
            float3 inputs:absorption_coefficient = (0.2, 0.4, 0.8)
            token outputs:out
        }
    }
"""


def strand(look: str, lines: str = "") -> str:
    """A curve across the ball."""
    return f"""
    def BasisCurves "Strand" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        uniform token type = "linear"
        int[] curveVertexCounts = [2]
        point3f[] points = [(-2, -1, 1.2), (2, 1, 1.2)]
        float[] widths = [0.4] (
            interpolation = "constant"
        )
        rel material:binding = <{look}>
        {lines}
    }}
"""


CAPABILITIES = (
    Capability(
        "subsurface walk",
        unrendered("a medium", medium()),
        against_plain("a grey medium, diffuse boundary, classical walks", CLASSICAL),
    ),
    Capability(
        "spectral MIS",
        unrendered("radii 1 : 2 : 4", medium("diffuse", PALE, (0.2, 0.1, 0.05)), CLASSICAL),
        against_classical(
            "radii 1 : 2 : 4, three colours",
            replace(CLASSICAL, look=medium("diffuse", PALE, (0.2, 0.1, 0.05))),
        ),
    ),
    Capability(
        "anisotropic phase function",
        against_classical(
            "g = 0", replace(CLASSICAL, look=medium(more="float inputs:subsurfaceAnisotropy = 0"))
        ),
        against_classical(
            "g = 0.5", replace(CLASSICAL, look=medium(more="float inputs:subsurfaceAnisotropy = 0.5"))
        ),
    ),
    Capability(
        "dielectric boundaries",
        unrendered("one", medium("dielectric")),
        against_classical("a rough dielectric boundary", replace(CLASSICAL, look=medium("dielectric"))),
    ),
    Capability(
        "Beer-Lambert interiors",
        unrendered("clear glass", GLASS),
        against_plain("a ball of clear glass", replace(PLAIN, look=GLASS)),
    ),
    Capability(
        "light at collisions",
        unrendered("an index-matched medium", medium("indexMatched")),
        against_classical("an index-matched boundary", replace(CLASSICAL, look=medium("indexMatched"))),
    ),
    Capability(
        "media with objects in them",
        Compared(
            "an invisible ball in an index-matched medium",
            replace(CLASSICAL, look=medium("indexMatched"), world=pip(0.2, INVISIBLE)),
            replace(CLASSICAL, look=medium("indexMatched"), world=pip(2.0, INVISIBLE)),
            "the ball aside",
        ),
        Compared(
            "a ball in an index-matched medium",
            replace(CLASSICAL, look=medium("indexMatched"), world=pip(0.2)),
            replace(CLASSICAL, look=medium("indexMatched"), world=pip(2.0)),
            "the ball aside",
        ),
    ),
    Capability(
        "subsurface sets",
        Compared("a set of one", replace(CLASSICAL, ball=SET), CLASSICAL, "no set"),
        Compared(
            "a set of two that touch",
            replace(CLASSICAL, ball=SET, world=neighbour(SET)),
            replace(CLASSICAL, world=neighbour()),
            "no set",
        ),
    ),
    Capability(
        "shared boundary caches",
        Compared(
            "two invisible bodies under a dome",
            replace(WAX, world=SKY + twin(0.0, INVISIBLE)),
            replace(WAX, world=SKY + twin(90.0, INVISIBLE)),
            "one of them turned",
        ),
        Compared(
            "two bodies under a dome",
            replace(WAX, world=SKY + TWIN),
            replace(WAX, world=SKY + twin(90.0)),
            "one of them turned",
        ),
    ),
    Capability(
        "camera in a medium",
        Compared(
            "in an invisible one",
            replace(PLAIN, world=tank(0.0, INVISIBLE)),
            replace(PLAIN, world=tank(60.0, INVISIBLE)),
            "it is beside it",
        ),
        Compared(
            "in thin index-matched air",
            replace(PLAIN, world=tank(0.0)),
            replace(PLAIN, world=tank(60.0)),
            "it is beside it",
        ),
    ),
    Capability(
        "refracted light",
        Compared(
            "auto, with a diffuse boundary",
            CLASSICAL,
            setting(CLASSICAL, "--set", "refractedLight=off"),
            "refractedLight=off",
        ),
        Compared(
            "a smooth dielectric boundary, classical walks",
            SMOOTH,
            setting(SMOOTH, "--set", "refractedLight=off"),
            "the same, refractedLight=off",
        ),
    ),
    Capability(
        "guided walks",
        Compared(
            "walk=auto where nothing is lit",
            DARK,
            setting(DARK, "--walk", "classical"),
            "the same with classical walks",
        ),
        against_classical("walk=auto: the mixture", WAX),
    ),
    Capability(
        "learned shares",
        Compared(
            "on, with classical walks",
            CLASSICAL,
            setting(CLASSICAL, "--set", "learnShares=false"),
            "learnShares=false",
        ),
        Compared(
            "the mixture", WAX, setting(WAX, "--set", "learnShares=false"), "the mixture, learnShares=false"
        ),
    ),
    Capability(
        "control variates",
        Compared(
            "on, with classical walks",
            CLASSICAL,
            setting(CLASSICAL, "--set", "controlVariates=false"),
            "controlVariates=false",
        ),
        Compared(
            "the mixture",
            WAX,
            setting(WAX, "--set", "controlVariates=false"),
            "the mixture, controlVariates=false",
        ),
    ),
    Capability(
        "transparent shadows",
        unrendered("opacity 0.5", OPACITY),
        against_plain("the ball has opacity 0.5", replace(PLAIN, look=OPACITY)),
    ),
    Capability(
        "instancing",
        Compared(
            "a PointInstancer of one instance, one of none",
            lit(instances(scattered(1)), instances([], "None")),
            lit(copies(1)),
            "a mesh",
        ),
        Compared("16 instances", lit(instances(scattered(16))), lit(copies(16)), "16 meshes"),
    ),
    Capability(
        "subdivision",
        Compared(
            "a refine level, and a crease, of a mesh that is none",
            Stage(ball=CREASE, flags=(*PLAIN.flags, "--set", "refineLevel=2")),
            PLAIN,
            "a mesh",
        ),
        Compared("a surface refined twice", refined(2), refined(0), "its cage"),
    ),
    Capability(
        "displacement",
        Compared(
            "a displacement of 0",
            Stage(look=displaced(0.0)),
            PLAIN,
            "an opaque ball",
        ),
        Compared("a displacement of 0.02", Stage(look=displaced(0.02)), PLAIN, "an opaque ball"),
    ),
    Capability(
        "mesh lights",
        Compared(
            "a MeshLightAPI of intensity 0",
            lit(glowing(0.0)),
            lit(glowing(5.0).replace(', "MeshLightAPI"', "")),
            "the mesh alone",
        ),
        Compared(
            "528 triangles that shine",
            lit(glowing(5.0)),
            lit(glowing(5.0).replace(', "MeshLightAPI"', "")),
            "the mesh alone",
        ),
    ),
    Capability(
        "environment sampling",
        against_plain(
            "an invisible dome, and a black one",
            lit(
                light("DomeLight", "Off", INVISIBLE),
                light("DomeLight", "Black", "float inputs:intensity = 0"),
            ),
        ),
        against_plain("a plain dome beside the lamp", lit(light("DomeLight", "Sky", DOME))),
    ),
    Capability(
        "portals",
        Compared(
            "a dome with an invisible portal",
            lit(dome_through(INVISIBLE)),
            lit(light("DomeLight", "Sky", DOME)),
            "a dome",
        ),
        Compared(
            "a dome with a portal",
            lit(dome_through(GATE)),
            lit(light("DomeLight", "Sky", DOME)),
            "a dome",
        ),
    ),
    Capability(
        "light linking",
        Compared(
            "a collection that leaves out what is not there",
            lit(lamp_beside("rel collection:lightLink:excludes = </World/None>")),
            lit(lamp_beside()),
            "a second lamp",
        ),
        Compared(
            "a second lamp that is not for the floor",
            lit(lamp_beside("rel collection:lightLink:excludes = </World/Floor>")),
            lit(lamp_beside()),
            "a second lamp",
        ),
    ),
    Capability(
        "shadow rules",
        Compared(
            "ShadowAPI with its defaults",
            lit(lamp_beside("bool inputs:shadow:enable = 1")),
            lit(lamp_beside()),
            "a second lamp",
        ),
        Compared(
            "a second lamp, of which the ball casts no shadow",
            lit(lamp_beside("rel collection:shadowLink:excludes = </World/Ball>")),
            lit(lamp_beside()),
            "a second lamp",
        ),
    ),
    Capability(
        "textures",
        against_plain(
            "an image on an unbound material, and on an invisible dome",
            lit(UNBOUND_IMAGE, light("DomeLight", "Off", f"{INVISIBLE}\n {IMAGE}")),
        ),
        Compared(
            "a dome with an image of 64 x 32",
            lit(light("DomeLight", "Sky", f"{DOME}\n {IMAGE}")),
            lit(light("DomeLight", "Sky", DOME)),
            "a plain dome",
        ),
    ),
    Capability(
        "driven surfaces",
        unrendered("a colour that a primvar drives", DRIVEN),
        Compared(
            "a colour that a primvar drives",
            replace(PLAIN, ball=COLORED, look=DRIVEN),
            replace(PLAIN, ball=COLORED),
            "an opaque ball with the primvar",
        ),
    ),
    Capability(
        "hair",
        Compared(
            "hair on what is not rendered",
            lit(HAIR, strand("/World/Hair", INVISIBLE)),
            lit(HAIR, strand("/World/Look", INVISIBLE)),
            "an opaque one",
        ),
        Compared(
            "a strand of hair",
            lit(HAIR, strand("/World/Hair")),
            lit(HAIR, strand("/World/Look")),
            "an opaque one",
        ),
    ),
    Capability(
        "depth of field",
        against_plain("fStop 0", replace(PLAIN, camera="float focusDistance = 7\n float fStop = 0")),
        against_plain("fStop 2.8", replace(PLAIN, camera="float focusDistance = 7\n float fStop = 2.8")),
    ),
    Capability(
        "motion blur",
        against_plain("a shutter that opens, nothing moves", replace(PLAIN, camera=SHUTTER, metadata=TIMED)),
        against_plain("a ball that moves", replace(PLAIN, camera=SHUTTER, metadata=TIMED, ball=FLIGHT)),
    ),
    Capability(
        "AOVs",
        against_plain("a RenderVar that no product orders", lit(UNORDERED_VAR)),
        against_plain("all of the default", replace(PLAIN, flags=AOVS)),
    ),
    Capability(
        "AOVs of walks",
        Compared(
            "a RenderVar that no product orders", lit(UNORDERED_VAR, stage=WAX), WAX, "the mixture, no AOVs"
        ),
        Compared("all of them", replace(WAX, flags=WALK_AOVS), WAX, "the mixture, no AOVs"),
    ),
)
