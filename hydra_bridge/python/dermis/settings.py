"""The RenderSettings prim as far as dermis knows it: `flat::RenderSettings` names, authored values only."""

from typing import Any

from pxr import Sdf, Usd, UsdRender

from .aovs import AOVS, GUIDE_AOVS
from .reading import Reader

CONFORM_POLICIES = (
    "expandAperture",
    "cropAperture",
    "adjustApertureWidth",
    "adjustApertureHeight",
    "adjustPixelAspectRatio",
)

DERMIS_SETTINGS: dict[str, Any] = {
    "samples": 64,
    "sampleOffset": 0,
    "seed": 0,
    "threads": 0,
    "timeLimit": 0.0,
    "noiseThreshold": 0.0,
    "refineLevel": 0,
    "maxDepth": 12,
    "walk": "auto",
    "walkPdf": "auto",
    "classicalFraction": 0.0,
    "firstDistance": "dwivedi",
    "normals": 7,
    "learnShares": True,
    "stratifyTechniques": True,
    "controlVariates": True,
    "exitLights": "auto",
    "refractedLight": "auto",
    "guideExits": True,
    "cacheFill": "surface",
    "cacheResolution": 0,
    "subsurfaceBoundary": "auto",
    "textureMemory": 4096,
    "lightsVisibleToCamera": False,
}
"""Custom attributes `dermis:NAME` of the settings prim, with the type each has."""

RAW_SOURCES = {"a": "alpha", "z": "depth", "N": "normal", "P": "position", "Neye": "normal"} | {
    a: a for a in (*AOVS, *GUIDE_AOVS)
}

BEAUTY_SOURCES = ("C.*[LO]", "C.*", "Ci", "color", "C")


def find_settings(stage: Usd.Stage, path: str, reader: Reader) -> Usd.Prim | None:
    """The RenderSettings prim at `path`, else the one that the stage's metadata names; None without."""
    named = path or stage.GetMetadata("renderSettingsPrimPath") or ""
    if not named:
        return None
    prim = stage.GetPrimAtPath(named) if Sdf.Path.IsValidPathString(named) else None
    if prim and prim.IsA(UsdRender.Settings):
        return prim
    reader.warn(named, "renderSettingsPrimPath: there is no RenderSettings prim; default settings are used")
    return None


def flatten_settings(prim: Usd.Prim, reader: Reader) -> dict[str, Any]:
    """Authored settings; those of the first product override (UsdRenderSettingsBase)."""
    products = [p for p in related(prim, "products") if p.IsA(UsdRender.Product)]
    if len(products) > 1:
        reader.warn(prim, f"products: only {products[0].GetPath()} is rendered")
    settings: dict[str, Any] = {}
    for source in (prim, *products[:1]):
        settings.update(base_settings(source, reader))
    settings.update(dermis_settings(prim, reader))
    aovs = [name for product in products[:1] for name in product_aovs(product, reader)]
    return {**settings, "aovs": list(dict.fromkeys(aovs))} if aovs else settings


def base_settings(prim: Usd.Prim, reader: Reader) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    cameras = prim.GetRelationship("camera").GetForwardedTargets()
    if cameras:
        settings["camera"] = str(cameras[0])
    if authored(prim, "resolution") and (size := resolution(prim, reader)):
        settings["resolution"] = size
    if authored(prim, "pixelAspectRatio"):
        settings["pixelAspectRatio"] = reader.value(prim, "pixelAspectRatio", 1.0)
    if authored(prim, "dataWindowNDC"):
        settings["dataWindowNDC"] = list(reader.value(prim, "dataWindowNDC", (0.0, 0.0, 1.0, 1.0)))
    if authored(prim, "disableDepthOfField"):
        settings["disableDepthOfField"] = reader.value(prim, "disableDepthOfField", False)
    policy = reader.value(prim, "aspectRatioConformPolicy", CONFORM_POLICIES[0])
    if policy not in CONFORM_POLICIES:
        reader.warn(prim, f"aspectRatioConformPolicy: '{policy}' is not supported; 'expandAperture' is used")
    elif authored(prim, "aspectRatioConformPolicy"):
        settings["aspectRatioConformPolicy"] = policy
    space = reader.value(prim, "renderingColorSpace", "")
    if space not in ("", "lin_rec709", "lin_rec709_scene"):
        reader.warn(prim, f"renderingColorSpace: '{space}' is not supported; linear Rec.709 is used")
    return settings


def resolution(prim: Usd.Prim, reader: Reader) -> list[int] | None:
    size = reader.value(prim, "resolution", (960.0, 540.0))
    if min(size) < 1:
        reader.warn(prim, f"resolution: {size} is not positive; it is ignored")
        return None
    return [int(x) for x in size]


def dermis_settings(prim: Usd.Prim, reader: Reader) -> dict[str, Any]:
    settings = {}
    for attribute in prim.GetAuthoredPropertiesInNamespace("dermis"):
        name = attribute.GetName().removeprefix("dermis:")
        if name not in DERMIS_SETTINGS:
            reader.warn(prim, f"dermis:{name}: there is no such setting; ignored")
            continue
        default = DERMIS_SETTINGS[name]
        value = reader.value(prim, attribute.GetName(), default)
        if not isinstance(value, str) and value < 0:
            reader.warn(prim, f"dermis:{name}: {value} is negative; {default} is used")
            value = default
        settings[name] = value
    return settings


def product_aovs(product: Usd.Prim, reader: Reader) -> list[str]:
    """AOV names of the product's RenderVars; beauty needs no name."""
    names = []
    for var in related(product, "orderedVars"):
        source = reader.value(var, "sourceName", "") or var.GetName()
        name = RAW_SOURCES.get(source) or RAW_SOURCES.get(var.GetName())
        if name:
            names.append(name)
        elif source not in BEAUTY_SOURCES:
            reader.warn(var, f"sourceName: '{source}' is no AOV of dermis; it is not written")
    return names


def included_purposes(prim: Usd.Prim | None, reader: Reader) -> tuple[str, ...]:
    """`includedPurposes` of the settings; default and render without."""
    purposes = reader.tokens(prim, "includedPurposes") if prim else None
    return ("default", "render") if purposes is None else tuple(purposes)


def binding_purpose(prim: Usd.Prim | None, reader: Reader) -> str:
    """The first named material purpose; bindings for all purposes stand in where it has none."""
    purposes = reader.tokens(prim, "materialBindingPurposes") if prim else None
    return next((purpose for purpose in purposes or () if purpose in ("full", "preview")), "full")


def related(prim: Usd.Prim, name: str) -> list[Usd.Prim]:
    relationship = prim.GetRelationship(name)
    paths = relationship.GetForwardedTargets() if relationship else []
    prims = [prim.GetStage().GetPrimAtPath(path) for path in paths]
    return [p for p in prims if p]


def authored(prim: Usd.Prim, name: str) -> bool:
    attribute = prim.GetAttribute(name)
    return bool(attribute) and attribute.HasAuthoredValue()
