"""UsdLux lights with the specification's names; what dermis does not do is said once per light."""

from typing import Any

from pxr import Usd, UsdGeom

from .portal import portals
from .reading import Reader

LIGHT_TYPES = (
    "RectLight",
    "DiskLight",
    "SphereLight",
    "CylinderLight",
    "DistantLight",
    "DomeLight",
    "DomeLight_1",
)
UNSUPPORTED_LIGHTS = ("GeometryLight", "PluginLight", "PluginLightFilter", "LightFilter")

Fields = dict[str, Any]


def flatten_light(
    prim: Usd.Prim, kind: str, reader: Reader, textures: dict[str, Fields] | None, domes_visible: bool
) -> Fields:
    """Fields of `flat::Light` except transform and visible. `kind` is a light type, or `Mesh` for a mesh
    light.

    Decoded images are added to `textures`; None: the light is not rendered, so its image is not read.
    """
    is_dome = kind.startswith("DomeLight")
    found = portals(prim, reader) if is_dome else []
    light = {
        "type": "Light",
        "cameraVisible": reader.value(prim, "inputs:visibility:camera", domes_visible and is_dome),
        **emission(prim, kind, reader),
        **response(prim, reader),
        "shaping": shaping(prim, reader),
        "shadow": shadow(prim, reader),
        "shape": shape(prim, kind, reader, textures),
        **group(prim, reader),
        **({"portals": found} if found else {}),
    }
    warn_ignored(prim, reader)
    return light


def emission(prim: Usd.Prim, kind: str, reader: Reader) -> Fields:
    temperature = reader.value(prim, "inputs:colorTemperature", 6500.0)
    enabled = reader.value(prim, "inputs:enableColorTemperature", False)
    return {
        "intensity": reader.value(prim, "inputs:intensity", 50000.0 if kind == "DistantLight" else 1.0),
        "exposure": reader.value(prim, "inputs:exposure", 0.0),
        "color": list(reader.color(prim, "inputs:color", (1.0, 1.0, 1.0))),
        "normalize": reader.value(prim, "inputs:normalize", False),
        "enableColorTemperature": enabled,
        "colorTemperature": temperature,
        "blackbody": list(reader.colors.from_rec709(blackbody(temperature))) if enabled else [1.0, 1.0, 1.0],
    }


def blackbody(temperature: float) -> Any:
    """Rec.709 of luminance 1, by UsdLux."""
    from pxr import UsdLux  # only where a temperature counts

    return UsdLux.BlackbodyTemperatureAsRgb(temperature)


def response(prim: Usd.Prim, reader: Reader) -> Fields:
    """Factors of its effect on diffuse and specular lobes, where they are not 1."""
    factors = {name: reader.value(prim, f"inputs:{name}", 1.0) for name in ("diffuse", "specular")}
    return {name: factor for name, factor in factors.items() if factor != 1.0}


def shaping(prim: Usd.Prim, reader: Reader) -> Fields | None:
    """UsdLuxShapingAPI where it is applied, or authored without being applied."""
    authored = any(
        a.HasAuthoredValue() for a in prim.GetAttributes() if a.GetName().startswith("inputs:shaping:")
    )
    if not prim.HasAPI("ShapingAPI") and not authored:
        return None
    fields = {
        "focus": reader.value(prim, "inputs:shaping:focus", 0.0),
        "focusTint": list(reader.color(prim, "inputs:shaping:focusTint", (0.0, 0.0, 0.0))),
        "coneAngle": reader.value(prim, "inputs:shaping:cone:angle", 90.0),
        "coneSoftness": reader.value(prim, "inputs:shaping:cone:softness", 0.0),
    }
    from .ies import flatten_profile

    profile = flatten_profile(prim, reader)
    return {**fields, "ies": profile} if profile else fields


GROUP_NAMES = (
    "dermis:lightGroup",
    "inputs:ri:light:lightGroup",
    "ri:light:lightGroup",
    "karma:light:lpetag",
    "primvars:arnold:aov",
)
"""Where dermis and others have the name of a light's group; the first that is authored counts."""


def group(prim: Usd.Prim, reader: Reader) -> Fields:
    """The light group, if the light is in one."""
    for name in GROUP_NAMES:
        if label := reader.value(prim, name, ""):
            return {"group": label}
    return {}


def shadow(prim: Usd.Prim, reader: Reader) -> Fields | None:
    """UsdLuxShadowAPI where something in it is authored; the core leaves out what says nothing."""
    if not any(is_shadow(a) for a in prim.GetAttributes()):
        return None
    distance = reader.value(prim, "inputs:shadow:distance", -1.0)
    falloff = reader.value(prim, "inputs:shadow:falloff", -1.0)
    if falloff > 0.0 and distance < 0.0:
        reader.warn(
            prim, "inputs:shadow:falloff: without inputs:shadow:distance shadows have no end; ignored"
        )
    return {
        "enable": reader.value(prim, "inputs:shadow:enable", True),
        "color": list(reader.color(prim, "inputs:shadow:color", (0.0, 0.0, 0.0))),
        "distance": distance,
        "falloff": falloff,
        "falloffGamma": reader.value(prim, "inputs:shadow:falloffGamma", 1.0),
    }


def shape(prim: Usd.Prim, kind: str, reader: Reader, textures: dict[str, Fields] | None) -> Fields:
    """`flat::LightShape`; for `Mesh` the walk fills in the key of the mesh."""

    def number(name: str, default: float) -> float:
        return reader.value(prim, f"inputs:{name}", default)

    match kind:
        case "RectLight":
            texture = image(prim, reader, textures)
            return {
                "kind": "rect",
                "width": number("width", 1.0),
                "height": number("height", 1.0),
                "texture": texture,
            }
        case "DiskLight":
            return {"kind": "disk", "radius": number("radius", 0.5)}
        case "SphereLight":
            return {"kind": "sphere", "radius": number("radius", 0.5)}
        case "CylinderLight":
            return {"kind": "cylinder", "length": number("length", 1.0), "radius": number("radius", 0.5)}
        case "DistantLight":
            return {"kind": "distant", "angle": number("angle", 0.53)}
        case "DomeLight" | "DomeLight_1":
            return {
                "kind": "dome",
                "texture": dome_texture(prim, reader, textures),
                "poleAxis": pole(prim, kind, reader),
            }
    return {"kind": "mesh", "mesh": ""}


def image(prim: Usd.Prim, reader: Reader, textures: dict[str, Fields] | None) -> str:
    if textures is None or reader.asset(prim, "inputs:texture:file") is None:
        return ""
    from .texture import flatten_texture  # only where there is one

    return flatten_texture(prim, "inputs:texture:file", reader, textures)


def dome_texture(prim: Usd.Prim, reader: Reader, textures: dict[str, Fields] | None) -> str:
    from .dome_layout import LAYOUTS, to_latlong

    layout = reader.value(prim, "inputs:texture:format", "automatic")
    if layout not in ("automatic", "latlong", *LAYOUTS):
        reader.warn(prim, f"inputs:texture:format: '{layout}' is not known; the dome emits its plain colour")
        return ""
    if textures is None or layout not in LAYOUTS:
        return image(prim, reader, textures)
    found: dict[str, Fields] = {}
    key = image(prim, reader, found)
    if not key:
        return key
    texture = found[key]
    pixels = to_latlong(texture["pixels"].reshape(texture["height"], texture["width"], 3), layout)
    textures[f"{key}{layout}"] = {
        **texture,
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "pixels": pixels.reshape(-1, 3),
    }
    return f"{key}{layout}"


def pole(prim: Usd.Prim, kind: str, reader: Reader) -> str:
    """`Y` for DomeLight always; DomeLight_1 names it, `scene` being the stage's up axis."""
    if kind == "DomeLight":
        return "Y"
    axis = reader.value(prim, "poleAxis", "scene")
    if axis not in ("scene", "Y", "Z"):
        reader.warn(prim, f"poleAxis: '{axis}' is not supported; 'scene' is used")
    return axis if axis in ("Y", "Z") else str(UsdGeom.GetStageUpAxis(prim.GetStage()))


def warn_ignored(prim: Usd.Prim, reader: Reader) -> None:
    """A warning with what of this light is not rendered."""
    warn_connected(prim, reader)
    if targets(prim, "light:filters"):
        reader.warn(prim, "light:filters: not supported yet; ignored")


def is_shadow(attribute: Usd.Attribute) -> bool:
    return attribute.GetName().startswith("inputs:shadow:") and attribute.HasAuthoredValue()


def targets(prim: Usd.Prim, name: str) -> bool:
    relationship = prim.GetRelationship(name)
    return bool(relationship and relationship.GetTargets())


def warn_connected(prim: Usd.Prim, reader: Reader) -> None:
    """Inputs of lights may be driven as those of shaders are (UsdLux); here they have the values of their own."""
    for attribute in prim.GetAuthoredPropertiesInNamespace("inputs"):
        if isinstance(attribute, Usd.Attribute) and (sources := attribute.GetConnections()):
            message = f"driven by {sources[0]}, which is not supported; its own value is used"
            reader.warn(prim, f"{attribute.GetName()}: {message}")
