"""RenderProducts and RenderVars: which files a render makes, and which AOVs are their layers."""

import re
from dataclasses import dataclass, field
from typing import Any

from pxr import Sdf, Usd

from . import lpe
from .aovs import AOVS, CELLS, EXTRA_AOVS, GUIDE_AOVS, LIGHT_AOV, PRIMVAR, SUMS, is_sum
from .reading import Reader

BEAUTY = "color"

RAW_SOURCES = {
    "Ci": BEAUTY,
    "C": BEAUTY,
    "color": BEAUTY,
    "rgba": BEAUTY,
    "a": "alpha",
    "z": "depth",
    "cameraDepth": "depth",
    "linearDepth": "depth",
    "N": "normal",
    "P": "position",
    "motion": "motionVector",
    "motionvector": "motionVector",
    "motionVectors": "motionVector",
} | {aov: aov for aov in (*AOVS, *EXTRA_AOVS, *GUIDE_AOVS)}
"""`sourceName` of sourceType `raw` and `intrinsic` -> AOV; the names of Hydra, RenderMan and dermis."""

NOT_KEPT = {
    "velocity": "motionVector has the motion on the image",
    "motionFore": "motionVector has the motion over the shutter",
    "motionBack": "motionVector has the motion over the shutter",
    "instanceId": "instances of one prim share its primId",
    "elementId": "faces are not told apart",
}
"""Sources that other renderers have, and why they are missing here."""

OF_LIGHT = re.compile(r"^C\.\*(?:\[?O\]?)?<L\.?'([^']+)'>$")
"""Light of one group, or of one light, on any path."""

HALF = re.compile(r"^half|[34]h$")


@dataclass
class Product:
    """A RenderProduct: `settings` as far as it authors them, `layers` as the core's `write_exr` takes them; None: all
    AOVs of the render."""

    path: str
    name: str
    settings: dict[str, Any] = field(default_factory=dict)
    layers: list[dict[str, Any]] | None = None


def related_products(settings: Usd.Prim, reader: Reader) -> list[Usd.Prim]:
    return related(settings, "products", "RenderProduct", reader)


def flatten_products(settings: Usd.Prim, reader: Reader) -> list[Product]:
    """The products of a RenderSettings prim that can be made; of the others a warning."""
    from .settings import base_settings

    products = []
    for prim in related_products(settings, reader):
        kind = reader.value(prim, "productType", "raster")
        if kind != "raster":
            reader.warn(prim, f"productType: '{kind}' is not supported; the product is not made")
            continue
        name = reader.value(prim, "productName", "")
        product = Product(str(prim.GetPath()), name, base_settings(prim, reader))
        if prim.GetRelationship("orderedVars").GetForwardedTargets():
            product.layers = product_layers(prim, reader)
        products.append(product)
    warn_specular(settings, reader)
    return products


def expressions(settings: Usd.Prim, reader: Reader) -> dict[Usd.Prim, str]:
    """RenderVars of light path expressions that are layers of the render, with their expressions."""
    found = {}
    for product in related_products(settings, reader):
        raster = reader.value(product, "productType", "raster") == "raster"
        for var in related(product, "orderedVars", "RenderVar", reader) if raster else ():
            text = str(reader.raw(var, "sourceName") or "").removeprefix("lpe:")
            if text not in RAW_SOURCES and lpe.cells_of(text):
                found[var] = text
    return found


def warn_specular(settings: Usd.Prim, reader: Reader) -> None:
    """Says which layers hold what OSL keeps apart. Where S stands alone it is RenderMan's and Arnold's: all of it."""
    asked = {
        var: text for var, text in expressions(settings, reader).items() if lpe.letters_of(text) & {"G", "S"}
    }
    if not any("G" in lpe.letters_of(text) for text in asked.values()):
        return
    parted = {var: text for var, text in asked.items() if lpe.parts_mirrors(text)}
    used = {letter for text in parted.values() for letter in lpe.letters_of(text) & {"G", "S"}}
    listed = ", ".join(f"'{text}' of <{var.GetPath()}>" for var, text in parted.items())
    both = (
        "light path expressions: glossy (G) and mirror events (S), rough and clear glass, are not kept apart"
    )
    if used == {"G", "S"}:
        reader.warn(settings, f"{both}; each of these has the two: {listed}")
    elif used == {"G"}:
        reader.warn(settings, f"{both}; G is the two, as Karma has it, in {listed}")


def warn_fog(settings: Usd.Prim, reader: Reader) -> None:
    """Says what layers hold of fog, in a scene with fog, where their expressions say something else of V."""
    for var, text in expressions(settings, reader).items():
        if lpe.parts_fog(text):
            cells = lpe.cells_of(text)
            first = "" if "subsurface" in cells else "not "
            later = "" if any(cell.startswith("indirect") for cell in cells) else "not "
            reader.warn(
                var,
                f"sourceName: '{text}': what fog scatters is <TD> here, no V; light that fog sends to the camera is "
                f"{first}in the layer, light that it sends to what is seen {later}in it",
            )


def product_layers(product: Usd.Prim, reader: Reader) -> list[dict[str, Any]]:
    """A layer per RenderVar that has a source here; the first beauty takes the place without a prefix."""
    layers: list[dict[str, Any]] = []
    for var in related(product, "orderedVars", "RenderVar", reader):
        aov = source_aov(var, reader)
        if aov is None:
            continue
        taken = {layer["name"] for layer in layers}
        name = "" if aov == BEAUTY and "" not in taken else var.GetName()
        if name in taken:
            reader.warn(var, f"orderedVars: a var named '{name}' is there already; this one is not written")
            continue
        kind = reader.value(var, "dataType", "color3f")
        if not Sdf.ValueTypeNames.Find(kind):
            reader.warn(var, f"dataType: '{kind}' is no type; floats are written")
        layer: dict[str, Any] = {"name": name, "aov": aov, "half": bool(HALF.search(kind))}
        if aov.startswith(PRIMVAR):
            layer["channels"] = channels_of(kind)
        layers.append(layer)
    if not layers:
        reader.warn(product, "orderedVars: none of them can be written; the beauty is")
        return [{"name": "", "aov": BEAUTY, "half": False}]
    return layers


def channels_of(kind: str) -> str:
    """Channels of a primvar by `dataType`."""
    if kind.startswith("color"):
        return "RGB"
    if kind in ("float", "half", "double", "int", "bool", "uchar"):
        return "Y"
    return "XY" if re.search(r"2[fhd]?$", kind) else "XYZ"


def product_aovs(layers: list[dict[str, Any]]) -> list[str]:
    """AOVs that the renderer must keep for these layers; the beauty needs no name."""
    return list(dict.fromkeys(layer["aov"] for layer in layers if layer["aov"] != BEAUTY))


def source_aov(var: Usd.Prim, reader: Reader) -> str | None:
    """The AOV that a RenderVar shows; None, and a warning, where there is none."""
    kind = reader.value(var, "sourceType", "raw")
    source = reader.value(var, "sourceName", "") or var.GetName()
    if kind == "lpe" or source.startswith("lpe:"):
        return lpe_aov(var, source.removeprefix("lpe:"), reader)
    if kind == "primvar" or source.startswith("primvars:"):
        return PRIMVAR + source.removeprefix(PRIMVAR)
    if kind not in ("raw", "intrinsic"):
        reader.warn(var, f"sourceType: '{kind}' is not known; it is taken as 'raw'")
    if found := raw_aov(source):
        return found
    why = NOT_KEPT.get(source, "it is no AOV of dermis")
    if own := RAW_SOURCES.get(var.GetName()):
        reader.warn(var, f"sourceName: '{source}' is not written: {why}; '{own}', as the var is named, is")
        return own
    reader.warn(var, f"sourceName: '{source}' is not written: {why}")
    return None


def raw_aov(source: str) -> str | None:
    """The AOV of a raw source, which many exporters write light path expressions as."""
    if (source.startswith(LIGHT_AOV) and source != LIGHT_AOV) or is_sum(source):
        return source
    return RAW_SOURCES.get(source) or read_lpe(source)


def read_lpe(text: str) -> str | None:
    """The AOV of an expression: a sum of parts, or the light of a group."""
    plain = re.sub(r"\s+", "", text).replace('"', "'")
    label = OF_LIGHT.match(plain)
    return named_lpe(plain) or (LIGHT_AOV + label[1] if label else None)


def lpe_aov(var: Usd.Prim, text: str, reader: Reader) -> str | None:
    if found := read_lpe(text):
        return found
    # The name of the var says what it is for, where the expression has labels of another renderer.
    if var.GetName() in SUMS:
        reader.warn(
            var, f"sourceName: '{text}' is not among the light path expressions of dermis; its own is written"
        )
        return var.GetName()
    reader.warn(
        var,
        f"sourceName: light path expression '{text}' is not written; kept apart are C[LO], C<RD>[LO], C<RD>.+[LO], "
        "C<RS>[LO], C<RS>.+[LO], C<TS>[LO], C<TS>.+[LO], C<TD>.*[LO], their sums, and C.*<L.'NAME'>",
    )
    return None


def named_lpe(text: str) -> str | None:
    """The AOV that a light path expression means, if it is one that is kept apart."""
    cells = lpe.cells_of(text)
    if len(cells) == len(CELLS):
        return BEAUTY
    return lpe.sum_of(cells) if cells else None


def related(prim: Usd.Prim, name: str, kind: str, reader: Reader) -> list[Usd.Prim]:
    """Targets of schema type `kind`; the others are said."""
    relationship = prim.GetRelationship(name)
    paths = relationship.GetForwardedTargets() if relationship else []
    prims = []
    for path in paths:
        target = prim.GetStage().GetPrimAtPath(path)
        if target and target.IsA(kind):
            prims.append(target)
        else:
            reader.warn(prim, f"{name}: {path} is {'no ' + kind if target else 'not there'}; it is left out")
    return prims
