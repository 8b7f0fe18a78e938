"""Meshes with their primvars: UsdGeomMesh as it stands, implicit prims tessellated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pxr import Usd, UsdGeom

from .arrays import np
from .implicit import IMPLICIT_TYPES, tessellate, texture_coordinates
from .reading import HELD, Reader, numeric
from .skel import Skins

# `curves` is loaded where there are some.
if TYPE_CHECKING:
    from .curves import Tessellation

PRIMVARS = {"displayColor": ("displayColor", 3), "displayOpacity": ("displayOpacity", 1)}
"""Primvar -> field of Mesh, components; others are read where a material asks for them."""

REFINE_LEVEL = "dermis:refineLevel"
"""A constant primvar, which a group hands down to its meshes."""

MEDIUM_PRIORITY, SUBSURFACE_SET = "dermis:mediumPriority", "dermis:subsurfaceSet"
"""As above: which body fills an overlap, and which bodies share their interior."""

INHERITED_PRIMVARS = (*PRIMVARS, REFINE_LEVEL, MEDIUM_PRIORITY, SUBSURFACE_SET)

MAX_LEVEL = 8

SUBDIV_TOKENS = {
    "interpolateBoundary": ("edgeAndCorner", "edgeOnly", "none"),
    "faceVaryingLinearInterpolation": (
        "cornersPlus1",
        "cornersPlus2",
        "cornersOnly",
        "boundaries",
        "none",
        "all",
    ),
    "triangleSubdivisionRule": ("catmullClark", "smooth"),
}
"""Tokens by attribute, the schema's fallback first."""

SUBDIV_ARRAYS = {
    "creaseIndices": "int32",
    "creaseLengths": "int32",
    "creaseSharpnesses": "float32",
    "cornerIndices": "int32",
    "cornerSharpnesses": "float32",
}

CURVES = ("BasisCurves", "HermiteCurves")
MESH_TYPES = ("Mesh", *CURVES, *IMPLICIT_TYPES)

Inherited = Mapping[str, UsdGeom.Primvar]
"""Constant primvars of the ancestors by name."""


def flatten_mesh(
    prim: Usd.Prim, kind: str, reader: Reader, inherited: Inherited, skins: Skins
) -> dict[str, Any] | None:
    """Fields of `flat::Mesh` except transform, visibility and material; None where there is nothing to
    render."""
    if kind in CURVES:
        surface = curves(prim, reader, inherited, skins)
        return surface and {**surface, **of_medium(prim, inherited, reader)}
    if kind == "Mesh":
        mesh = polygons(prim, reader)
        if mesh is not None:
            skins.deform(prim, mesh)
            level = refine_level(prim, inherited, reader) if mesh["subdivisionScheme"] != "none" else None
            mesh |= {} if level is None else {"refineLevel": level}
    elif (surface := tessellate(prim, kind, reader)) is not None:
        mesh = {"orientation": "rightHanded", "subdivisionScheme": "none", **surface}
        skins.deform(prim, mesh)
    else:
        mesh = None
    if mesh is None:
        return None
    mesh["doubleSided"] = reader.value(prim, "doubleSided", kind == "Plane")
    add_primvars(prim, kind, mesh, reader, inherited)
    return mesh | of_medium(prim, inherited, reader)


def curves(prim: Usd.Prim, reader: Reader, inherited: Inherited, skins: Skins) -> dict[str, Any] | None:
    from .curves import read_primvar, tessellate_curves

    made = tessellate_curves(prim, reader, skins)
    if made is None:
        return None
    api = UsdGeom.PrimvarsAPI(prim)
    for name, (field, components) in PRIMVARS.items():
        primvar = api.GetPrimvar(name)
        primvar = primvar if primvar and primvar.HasAuthoredValue() else inherited.get(name)
        attribute = primvar and read_primvar(prim, primvar, components, made.spline, reader)
        if attribute:
            made.surface[field] = made.primvar(*attribute)
    made.surface.setdefault("doubleSided", reader.value(prim, "doubleSided", False))
    return made.surface


def polygons(prim: Usd.Prim, reader: Reader) -> dict[str, Any] | None:
    points = reader.held(prim, "points", reader.moved(prim, "points"), "float32", 3)
    counts, indices = (
        reader.held(prim, name, reader.raw(prim, name), "int32", 1)
        for name in ("faceVertexCounts", "faceVertexIndices")
    )
    for name, array in (("points", points), ("faceVertexCounts", counts), ("faceVertexIndices", indices)):
        if array is None or not len(array):
            reader.warn(prim, f"{name}: empty; the mesh is not rendered")
            return None
    mesh = {
        "points": points,
        "faceVertexCounts": counts,
        "faceVertexIndices": indices,
        "orientation": choice(prim, "orientation", ("rightHanded", "leftHanded"), reader),
        "subdivisionScheme": choice(
            prim, "subdivisionScheme", ("catmullClark", "loop", "bilinear", "none"), reader
        ),
    }
    holes = reader.held(prim, "holeIndices", reader.raw(prim, "holeIndices"), "int32", 1)
    if holes is not None and len(holes):
        mesh["holeIndices"] = holes
    if mesh["subdivisionScheme"] == "none":
        add_normals(prim, mesh, reader)
    else:
        mesh["subdivTags"] = subdiv_tags(prim, reader)
    return mesh


def choice(prim: Usd.Prim, name: str, tokens: tuple[str, ...], reader: Reader) -> str:
    """A token attribute; the first of `tokens` where it is none of them."""
    value = reader.value(prim, name, tokens[0])
    if value in tokens:
        return value
    reader.warn(prim, f"{name}: '{value}' is not supported; '{tokens[0]}' is used")
    return tokens[0]


def subdiv_tags(prim: Usd.Prim, reader: Reader) -> dict[str, Any]:
    """Fields of `flat::SubdivTags`; the core checks the arrays against the mesh."""
    tags: dict[str, Any] = {
        name: choice(prim, name, tokens, reader) for name, tokens in SUBDIV_TOKENS.items()
    }
    for name, dtype in SUBDIV_ARRAYS.items():
        values = reader.held(prim, name, reader.raw(prim, name), dtype, 1)
        if values is not None and len(values):
            tags[name] = values
    return tags


def handed_down(prim: Usd.Prim, name: str, default: Any, inherited: Inherited, reader: Reader) -> Any:
    """A constant primvar of the prim or an ancestor, of the type of `default`, which it is where the value is none;
    None: not authored."""
    own = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
    primvar = own if own and own.HasAuthoredValue() else inherited.get(name)
    return (
        None
        if primvar is None
        else reader.coerced(prim, f"primvars:{name}", primvar.Get(reader.time), default)
    )


def of_medium(prim: Usd.Prim, inherited: Inherited, reader: Reader) -> dict[str, Any]:
    """What a prim says of the medium within it."""
    priority = handed_down(prim, MEDIUM_PRIORITY, 0, inherited, reader)
    shared = handed_down(prim, SUBSURFACE_SET, "", inherited, reader)
    fields: dict[str, Any] = {} if priority is None else {"mediumPriority": priority}
    return fields | ({"subsurfaceSet": shared} if shared else {})


def refine_level(prim: Usd.Prim, inherited: Inherited, reader: Reader) -> int | None:
    """`primvars:dermis:refineLevel` of the prim or an ancestor; None: that of the render settings."""
    level = handed_down(prim, REFINE_LEVEL, -1, inherited, reader)
    if level is None:
        return None
    if 0 <= level <= MAX_LEVEL:
        return level
    reader.warn(prim, f"primvars:{REFINE_LEVEL}: {level} is none of 0 to {MAX_LEVEL}; it is ignored")
    return None


def add_normals(prim: Usd.Prim, mesh: dict[str, Any], reader: Reader) -> None:
    """`primvars:normals` beats `normals` (UsdGeomMesh)."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        normals = flatten_primvar(prim, primvar, 3, mesh, reader, reader.moment)
    else:
        values = reader.held(prim, "normals", reader.moved(prim, "normals"), "float32", 3)
        interpolation = UsdGeom.PointBased(prim).GetNormalsInterpolation()
        normals = checked(prim, "normals", interpolation, values, None, mesh, reader)
    if normals is not None:
        mesh["normals"] = normals


def add_primvars(
    prim: Usd.Prim, kind: str, mesh: dict[str, Any], reader: Reader, inherited: Inherited
) -> None:
    api = UsdGeom.PrimvarsAPI(prim)
    for name, (field, components) in PRIMVARS.items():
        primvar = api.GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()):
            primvar = inherited.get(name)
        if primvar is None:
            continue
        if kind != "Mesh" and primvar.GetInterpolation() != UsdGeom.Tokens.constant:
            reader.warn(prim, f"primvars:{name}: a {kind} takes only constant primvars; it is ignored")
        elif (value := flatten_primvar(prim, primvar, components, mesh, reader)) is not None:
            mesh[field] = value


def flatten_read_primvars(
    prim: Usd.Prim,
    kind: str,
    mesh: dict[str, Any],
    names: dict[str, str],
    hair: bool,
    reader: Reader,
    inherited: Inherited,
    skins: Skins,
) -> dict[str, Any]:
    """`flat::Mesh::primvars` of those among `names` that the prim has; `names`: to what reads it, if a missing one is
    to be said. `hair`: a material is one, which asks curves for more."""
    api, found = UsdGeom.PrimvarsAPI(prim), {}
    made = None
    if kind in CURVES:
        from .curves import tessellate_curves

        made = tessellate_curves(prim, reader, skins)
    for name, user in names.items():
        primvar = api.GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()):
            primvar = inherited.get(name)
        if primvar is None and name == "st" and kind in IMPLICIT_TYPES:
            if (st := texture_coordinates(prim, kind, reader)) is not None:
                found[name] = {"type": "float2", **st}
        elif primvar is None:
            if user:
                reader.warn(prim, f"primvars:{name}: there is none; {user} reads it and gets its fallback")
        elif kind not in ("Mesh", *CURVES) and primvar.GetInterpolation() != UsdGeom.Tokens.constant:
            reader.warn(prim, f"primvars:{name}: a {kind} takes only constant primvars; it is ignored")
        elif (value := read_by(made, prim, primvar, mesh, reader)) is not None:
            components = 1 if value["values"].ndim == 1 else value["values"].shape[1]
            found[name] = {"type": "float" if components == 1 else f"float{components}", **value}
    if made is not None and hair:
        found |= made.strands()
    return found


def read_by(
    curves: Tessellation | None,
    prim: Usd.Prim,
    primvar: UsdGeom.Primvar,
    mesh: dict[str, Any],
    reader: Reader,
) -> dict[str, Any] | None:
    """A primvar of a mesh, or of curves by what they were tessellated to."""
    components = components_of(primvar, reader)
    if curves is None:
        return flatten_primvar(prim, primvar, components, mesh, reader)
    from .curves import read_primvar

    attribute = read_primvar(prim, primvar, components, curves.spline, reader)
    return curves.primvar(*attribute) if attribute else None


def components_of(primvar: UsdGeom.Primvar, reader: Reader) -> int:
    """1 where the value is no array of vectors, which reading it says."""
    value = primvar.Get(reader.time)
    array = memoryview(value) if type(value) in HELD.values() else numeric(value)
    if array is None:
        return 1
    if array.ndim == 1 and not isinstance(value, (list, tuple)) and not is_array(primvar):
        return min(len(array), 4)
    return min(array.shape[1], 4) if array.ndim == 2 else 1


def is_array(primvar: UsdGeom.Primvar) -> bool:
    return bool(primvar.GetTypeName().isArray)


def flatten_primvar(
    prim: Usd.Prim,
    primvar: UsdGeom.Primvar,
    components: int,
    mesh: dict[str, Any],
    reader: Reader,
    time: Usd.TimeCode | None = None,
) -> dict[str, Any] | None:
    name = str(primvar.GetName())
    value = primvar.Get(reader.time if time is None else time)
    if primvar.GetElementSize() != 1:
        reader.warn(prim, f"{name}: elementSize {primvar.GetElementSize()} is not supported; it is ignored")
        return None
    if value is not None and not is_array(primvar) and not isinstance(value, str):
        # A constant may be one value instead of an array of one.
        value = [value]
    values = reader.held(prim, name, value, "float32", components)
    if values is not None:
        values = reader.colors.of(primvar.GetAttr(), values)
    indices = reader.held(prim, f"{name}:indices", indices_of(primvar, reader), "int32", 1)
    return checked(prim, name, primvar.GetInterpolation(), values, indices, mesh, reader)


def indices_of(primvar: UsdGeom.Primvar, reader: Reader) -> Any:
    return primvar.GetIndicesAttr().Get(reader.time) if primvar.IsIndexed() else None


def checked(
    prim: Usd.Prim,
    name: str,
    interpolation: str,
    values: Any,
    indices: Any,
    mesh: dict[str, Any],
    reader: Reader,
) -> dict[str, Any] | None:
    """The primvar, or None and a warning where its length does not fit the mesh."""
    if values is None or not len(values):
        return None
    expected = {
        "constant": 1,
        "uniform": len(mesh["faceVertexCounts"]),
        "varying": len(mesh["points"]),
        "vertex": len(mesh["points"]),
        "faceVarying": len(mesh["faceVertexIndices"]),
    }.get(interpolation)
    count = len(values if indices is None else indices)
    if expected is None:
        problem = f"interpolation '{interpolation}' is unknown"
    elif count != expected:
        problem = f"{count} values where {interpolation} interpolation needs {expected}"
    else:
        primvar = {"interpolation": interpolation, "values": values}
        return primvar if indices is None else {**primvar, "indices": indices}
    reader.warn(prim, f"{name}: {problem}; it is ignored")
    return None


def flatten_subsets(prim: Usd.Prim, kind: str, reader: Reader) -> list[tuple[Usd.Prim, dict[str, Any]]]:
    """Geometry subsets of family materialBind, with the prim whose binding counts."""
    subsets = []
    for subset in UsdGeom.Subset.GetGeomSubsets(UsdGeom.Imageable(prim), "", "materialBind"):
        element = reader.value(subset.GetPrim(), "elementType", "face")
        if kind != "Mesh" or element != "face":
            what = f"elementType: '{element}', of a {kind}: only faces of meshes have materials of their own"
            reader.warn(subset.GetPrim(), f"{what}; ignored")
            continue
        indices = reader.array(subset.GetPrim(), "indices", "int32", 1)
        if indices is not None and len(indices):
            fields = {"path": str(subset.GetPath()), "indices": indices, "material": ""}
            subsets.append((subset.GetPrim(), fields))
    several = sum(len(np.unique(fields["indices"])) for _, fields in subsets)
    if len(subsets) > 1 and several > len(np.unique(np.concatenate([f["indices"] for _, f in subsets]))):
        reader.warn(
            prim, "subsets of family materialBind overlap: faces in several have the material of the last"
        )
    return subsets
