"""Points as instances of one sphere: a matrix and a colour each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pxr import Usd, UsdGeom

from .arrays import np
from .implicit import sphere
from .instancer import Matrices
from .reading import Reader
from .skel import Skins

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass
class Spheres:
    """`mesh` has fields of a Mesh, a sphere of width 1; `matrices` (n, 4, 4) place it in the prim's space; `colors`
    (n, 3), or None where all have that of the mesh."""

    mesh: dict[str, Any]
    matrices: Matrices
    colors: NDArray[np.float32] | None


def flatten_points(
    prim: Usd.Prim, reader: Reader, inherited: Mapping[str, UsdGeom.Primvar], skins: Skins
) -> Spheres | None:
    """None where there is nothing to render, which was said."""
    points = reader.as_array(prim, "points", reader.moved(prim, "points"), "float32", 3)
    if points is None or not len(points):
        reader.warn(prim, "points: empty; they are not rendered")
        return None
    points = skins.moved(prim, points)
    widths = per_point(prim, "widths", *authored_widths(prim, reader), len(points), reader)
    if widths is None:
        reader.warn(prim, "widths: none that can be used; 1 is")
        widths = np.ones(1, np.float32)
    widths = np.broadcast_to(widths, len(points))
    shown = np.isfinite(points).all(axis=1) & (widths > 0.0) & np.isfinite(widths)
    if not shown.all():
        number = int((~shown).sum())
        reader.warn(prim, f"widths, points: {number} points are not finite or have no width; not rendered")
    mesh = {"orientation": "rightHanded", "subdivisionScheme": "none", "doubleSided": False, **sphere(0.5)}
    del mesh["st"]
    colors = display_colors(prim, inherited, len(points), mesh, reader)
    matrices = np.tile(np.eye(4), (int(shown.sum()), 1, 1))
    matrices[:, [0, 1, 2], [0, 1, 2]] = widths[shown, None]
    matrices[:, 3, :3] = points[shown]
    return Spheres(mesh, matrices, colors if colors is None else colors[shown]) if shown.any() else None


def authored_widths(prim: Usd.Prim, reader: Reader) -> tuple[str, Any]:
    """`primvars:widths` beats `widths` (UsdGeomPoints)."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
    if primvar and primvar.HasAuthoredValue():
        values = reader.as_array(prim, "widths", primvar.ComputeFlattened(reader.time), "float32", 1)
        return primvar.GetInterpolation(), values
    return UsdGeom.Points(prim).GetWidthsInterpolation(), reader.array(prim, "widths", "float32", 1)


def per_point(
    prim: Usd.Prim, name: str, interpolation: str, values: Any, count: int, reader: Reader
) -> NDArray | None:
    """One value, or one per point; None and a warning where neither is there."""
    if values is None or not len(values):
        return None
    one = interpolation in ("constant", "uniform")
    if len(values) == (1 if one else count):
        return values
    reader.warn(
        prim, f"{name}: {len(values)} values where {interpolation} interpolation needs {1 if one else count}"
    )
    return None


def display_colors(
    prim: Usd.Prim,
    inherited: Mapping[str, UsdGeom.Primvar],
    count: int,
    mesh: dict[str, Any],
    reader: Reader,
) -> NDArray[np.float32] | None:
    """Colours of the points; a single colour or opacity goes to the mesh."""
    api = UsdGeom.PrimvarsAPI(prim)
    for name, components in (("displayOpacity", 1), ("displayColor", 3)):
        primvar = api.GetPrimvar(name)
        primvar = primvar if primvar and primvar.HasAuthoredValue() else inherited.get(name)
        if not primvar:
            continue
        values = reader.as_array(prim, name, primvar.ComputeFlattened(reader.time), "float32", components)
        values = per_point(prim, name, primvar.GetInterpolation(), values, count, reader)
        if values is None:
            continue
        values = reader.colors.of(primvar.GetAttr(), values)
        if len(values) == 1 or components == 1:
            if len(values) > 1 and np.ptp(values) > 0.0:
                reader.warn(prim, f"primvars:{name}: of points with different ones the first is used")
            mesh[name] = {"interpolation": "constant", "values": np.ascontiguousarray(values[:1])}
        elif components == 3:
            return values
    return None
