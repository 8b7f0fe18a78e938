"""The RenderSettings prim as far as dermis knows it: `flat::RenderSettings` names, authored values only."""

from typing import Any

from pxr import Sdf, Usd

from .colorspace import REC709, linear_name
from .products import product_aovs, product_layers, related_products
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
    "sharedPaths": "auto",
    "pixelFilterMode": "importance",
    "cacheFill": "surface",
    "cacheResolution": 0,
    "subsurfaceBoundary": "auto",
    "textureMemory": 4096,
    "lightsVisibleToCamera": False,
}
"""Custom attributes `dermis:NAME` of the settings prim, with the type each has."""


def find_settings(stage: Usd.Stage, path: str, reader: Reader) -> Usd.Prim | None:
    """The RenderSettings prim at `path`, else the one that the stage's metadata names; None without."""
    named = path or stage.GetMetadata("renderSettingsPrimPath") or ""
    if not named:
        return None
    prim = stage.GetPrimAtPath(named) if Sdf.Path.IsValidPathString(named) else None
    if prim and prim.IsA("RenderSettings"):
        return prim
    reader.warn(named, "renderSettingsPrimPath: there is no RenderSettings prim; default settings are used")
    return None


def flatten_settings(prim: Usd.Prim, reader: Reader) -> dict[str, Any]:
    """Authored settings; those of the first product override (UsdRenderSettingsBase)."""
    products = related_products(prim, reader)
    settings: dict[str, Any] = {}
    for source in (prim, *products[:1]):
        settings.update(base_settings(source, reader))
    settings.update(dermis_settings(prim, reader))
    if reader.colors.rendering != REC709:
        settings["renderingColorSpace"] = reader.colors.rendering
    if products and products[0].GetRelationship("orderedVars").GetForwardedTargets():
        settings["aovs"] = product_aovs(product_layers(products[0], reader))
    return settings


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
        window = reader.value(prim, "dataWindowNDC", (0.0, 0.0, 1.0, 1.0))
        if window[0] < window[2] and window[1] < window[3]:
            settings["dataWindowNDC"] = list(window)
        else:
            message = "give x0 y0 x1 y1 with x0 < x1 and y0 < y1; the whole image is rendered"
            reader.warn(prim, f"dataWindowNDC: {window} has no pixels; {message}")
    if authored(prim, "disableDepthOfField"):
        settings["disableDepthOfField"] = reader.value(prim, "disableDepthOfField", False)
    # The older name has the same meaning; either may switch motion blur off.
    names = [name for name in ("disableMotionBlur", "instantaneousShutter") if authored(prim, name)]
    if names:
        settings["disableMotionBlur"] = any(reader.value(prim, name, False) for name in names)
    policy = reader.value(prim, "aspectRatioConformPolicy", CONFORM_POLICIES[0])
    if policy not in CONFORM_POLICIES:
        reader.warn(prim, f"aspectRatioConformPolicy: '{policy}' is not supported; 'expandAperture' is used")
    elif authored(prim, "aspectRatioConformPolicy"):
        settings["aspectRatioConformPolicy"] = policy
    return settings


def rendering_color_space(prim: Usd.Prim | None, reader: Reader, chosen: str = "") -> str:
    """usd-core's name of the linear space of all colours of a render: the `chosen` one, else that of the settings."""
    name = chosen or (reader.value(prim, "renderingColorSpace", "") if prim else "")
    space = linear_name(name) if name else REC709
    if space is None:
        reader.warn(
            "render settings" if chosen or not prim else prim,
            f"renderingColorSpace: '{name}' is no linear space of usd-core; linear Rec.709 is used",
        )
    return space or REC709


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


def included_purposes(prim: Usd.Prim | None, reader: Reader) -> tuple[str, ...]:
    """`includedPurposes` of the settings; default and render without."""
    purposes = reader.tokens(prim, "includedPurposes") if prim else None
    for purpose in sorted({*(purposes or ())} - {"default", "render", "proxy", "guide"}):
        reader.warn(prim, f"includedPurposes: '{purpose}' is no purpose; ignored")
    return ("default", "render") if purposes is None else tuple(purposes)


def binding_purposes(prim: Usd.Prim | None, reader: Reader) -> tuple[str, ...]:
    """Material purposes in the order in which bindings are looked for; full, then those for all purposes (`""`)."""
    purposes = reader.tokens(prim, "materialBindingPurposes") if prim else None
    if purposes is None:
        return ("full", "")
    # Stages are met that have the name of UsdShade's token in place of its text, which is empty.
    purposes = ["" if purpose == "allPurpose" else purpose for purpose in purposes]
    known = ("full", "preview", "")
    for purpose in (purpose for purpose in purposes if purpose not in known):
        reader.warn(prim, f"materialBindingPurposes: '{purpose}' is no material purpose; ignored")
    return tuple(dict.fromkeys(purpose for purpose in purposes if purpose in known))


def authored(prim: Usd.Prim, name: str) -> bool:
    attribute = prim.GetAttribute(name)
    return bool(attribute) and attribute.HasAuthoredValue()
