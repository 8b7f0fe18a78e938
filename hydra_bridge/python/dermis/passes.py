"""RenderPass: what of it is not done; its collections are linking's."""

from pxr import Usd

from .linking import is_authored

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


def is_pass(prim: Usd.Prim) -> bool:
    return bool(prim) and prim.IsA("RenderPass")
