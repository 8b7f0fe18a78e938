"""RenderPass: which RenderSettings it renders, and the collections that say which prims take part."""

from typing import Any

from pxr import Sdf, Usd

#: Collections of UsdRenderPass that need what the renderer has not got.
UNSUPPORTED = ("cameraVisibility", "matte")

Warnings = list[tuple[str, str]]


def pass_warnings(prim: Usd.Prim) -> Warnings:
    """What of a pass is not done."""
    return [
        (str(prim.GetPath()), f"collection:{name}: not supported; every prim is seen as it is")
        for name in UNSUPPORTED
        if is_authored(prim, name)
    ]


def hide_excluded(prim: Usd.Prim, prims: dict[str, Any]) -> None:
    """Makes meshes and lights invisible that the pass prunes or leaves out of `renderVisibility`.

    Instances of one prototype are one mesh, which is hidden where the collection says so of the prototype.
    """
    visible = Usd.CollectionAPI(prim, "renderVisibility").ComputeMembershipQuery()
    pruned = Usd.CollectionAPI(prim, "prune").ComputeMembershipQuery() if is_authored(prim, "prune") else None
    for key, fields in prims.items():
        if fields["type"] not in ("Mesh", "Light") or not Sdf.Path.IsValidPathString(key):
            continue
        path = Sdf.Path(key).GetPrimPath()
        included = not is_authored(prim, "renderVisibility") or visible.IsPathIncluded(path)
        if not included or (pruned and pruned.IsPathIncluded(path)):
            fields["visible"] = False


def is_authored(prim: Usd.Prim, name: str) -> bool:
    return any(found.IsAuthored() for found in prim.GetPropertiesInNamespace(f"collection:{name}"))


def is_pass(prim: Usd.Prim) -> bool:
    return bool(prim) and prim.IsA("RenderPass")
