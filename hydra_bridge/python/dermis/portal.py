"""Portals of dome lights: rectangles through which their light comes in."""

from collections.abc import Iterator
from typing import Any

from pxr import Gf, Sdf, Tf, Usd, UsdGeom

from .index import index_of
from .reading import Reader

Fields = dict[str, Any]


def portals(dome: Usd.Prim, reader: Reader) -> list[Fields]:
    """`flat::Portal` of each visible portal that a dome names, where it is at the frame."""
    flattened = []
    for path in targets(dome):
        prim = dome.GetStage().GetPrimAtPath(path)
        if not prim or not prim.IsActive() or str(prim.GetTypeName()) != "PortalLight":
            reader.warn(
                dome, f"portals: {path} is no PortalLight of the stage; the dome is sampled without it"
            )
        elif UsdGeom.Imageable(prim).ComputeVisibility(reader.time) != UsdGeom.Tokens.invisible:
            flattened.append(flatten_portal(prim, reader))
    return flattened


def flatten_portal(prim: Usd.Prim, reader: Reader) -> Fields:
    place = UsdGeom.XformCache(reader.time).GetLocalToWorldTransform
    return {
        "path": str(prim.GetPath()),
        "transform": reader.matrix(prim, reader.transform(prim, place, Gf.Matrix4d(1.0))),
        "width": reader.value(prim, "inputs:width", 1.0),
        "height": reader.value(prim, "inputs:height", 1.0),
    }


def domes_through(root: Usd.Prim) -> Iterator[Usd.Prim]:
    """Domes elsewhere on the stage with a portal at or below `root`."""
    for prim in index_of(root.GetStage()).domes(root.GetStage()):
        if prim.GetPath().HasPrefix(root.GetPath()):
            continue
        if any(path.HasPrefix(root.GetPath()) for path in targets(prim)):
            yield prim


def targets(prim: Usd.Prim) -> list[Sdf.Path]:
    relationship = prim.GetRelationship("portals")
    is_dome = str(prim.GetTypeName()).startswith("DomeLight")
    if not (is_dome and relationship):
        return []
    try:
        return relationship.GetForwardedTargets()
    except Tf.ErrorException:  # `portals` is no relationship, or its targets are none
        return []
