"""light:materialSyncMode: what the material of a mesh light has to do with its light."""

from typing import Any

from pxr import Usd

from .reading import Reader

Fields = dict[str, Any]

TINTS, INDEPENDENT, NO_RESPONSE = "materialGlowTintsLight", "independent", "noMaterialResponse"

BLACK = "/dermis/NoMaterialResponse"
"""Where the material is that reflects nothing."""

REFLECTS_NOTHING: Fields = {
    "type": "Material",
    "shader": "UsdPreviewSurface",
    "diffuseColor": [0.0, 0.0, 0.0],
    "useSpecularWorkflow": 1,
    "specularColor": [0.0, 0.0, 0.0],
    "ior": 1.0,
}

GLOWS = {
    "UsdPreviewSurface": ("emissiveColor", None),
    "ND_open_pbr_surface_surfaceshader": ("emission_color", "emission_luminance"),
    "ND_standard_surface_surfaceshader": ("emission_color", "emission"),
}
"""Of each shader the colour of its glow, and the input that turns it on."""


def sync_mode(prim: Usd.Prim, reader: Reader) -> str:
    """The schema's default is that of MeshLightAPI, or of LightAPI by itself."""
    mode = reader.value(prim, "light:materialSyncMode", TINTS)
    if mode in (TINTS, INDEPENDENT, NO_RESPONSE):
        return mode
    reader.warn(prim, f"light:materialSyncMode: '{mode}' is not known; '{TINTS}' is used")
    return TINTS


def glow(material: Fields) -> tuple[float, ...] | str:
    """Colour of the glow, white where there is none: what does not glow tints nothing. A word where a network drives
    it."""
    color, switch = GLOWS[material["shader"]]
    driven = material.get("network", {}).get("inputs", {})
    for name in (color, switch):
        if name in driven:
            return name
    if switch and not material.get(switch, 0.0):
        return 1.0, 1.0, 1.0
    value = tuple(material.get(color, (1.0, 1.0, 1.0) if switch else (0.0, 0.0, 0.0)))
    return value if any(value) else (1.0, 1.0, 1.0)


def respond(
    prim: Usd.Prim, mode: str, mesh: Fields, lights: list[Fields], prims: dict[str, Fields], reader: Reader
) -> None:
    """Makes mesh and lights what the mode says, once materials are bound."""
    if mode == NO_RESPONSE:
        prims[BLACK] = dict(REFLECTS_NOTHING)
        for part in (mesh, *mesh["geomSubsets"]):
            part["material"] = BLACK
    material = prims.get(mesh["material"])
    if mode != TINTS or material is None or material.get("shader") not in GLOWS:
        return
    tint = glow(material)
    if isinstance(tint, str):
        reader.warn(
            prim,
            f"light:materialSyncMode: {mesh['material']}: a network drives {tint}; the light is not tinted by it",
        )
        return
    for light in lights:
        light["color"] = [c * t for c, t in zip(light["color"], tint, strict=True)]
