"""What each of UsdShade's own nodes computes, in the words of `network`."""

from .network import Unsupported, Value, constant
from .nodes import ZERO, Handler, Node, chosen, default_st, read_primvar

WRAPS = {name: name for name in ("black", "clamp", "repeat", "mirror", "useMetadata")}
TWIN_WRAPS = {"black": "black", "clamp": "clamp", "periodic": "repeat", "mirror": "mirror"}
"""Of MaterialX's `ND_UsdUVTexture`."""


def primvar_reader(node: Node) -> Value:
    if node.identifier.endswith(("_string", "_matrix")):
        raise Unsupported("only numbers and vectors can drive an input")
    name = node.token("varname", "")
    if not name:
        raise Unsupported("its varname is empty")
    fallback = node.network.resized(node.get("fallback", ZERO), node.width)
    return read_primvar(node, name, fallback)


def uv_texture(node: Node) -> Value:
    network = node.network
    twin = node.identifier.startswith("ND_")
    wraps, wrap = (TWIN_WRAPS, "periodic") if twin else (WRAPS, "useMetadata")
    st = default_st(node) if twin and not node.has("st") else node.get("st", constant((0.0, 0.0)))
    fallback = node.get("fallback", constant((0.0, 0.0, 0.0, 1.0)))
    if fallback.lanes is None:
        raise Unsupported("its fallback is not constant")
    words = {
        "wrapS": wraps[chosen(node, "wrapS", wrap, wraps)],
        "wrapT": wraps[chosen(node, "wrapT", wrap, wraps)],
        "border": [0.0, 0.0, 0.0, 0.0],
        "fallback": list(fallback.lanes),
    }
    image = node.image("file", node.token("sourceColorSpace", "auto"), {**words, "st": network.index(st)})
    if not image["tiles"]:
        return channels(node, fallback)
    texel = network.node(4, image)
    texel = network.multiply(texel, node.get("scale", constant((1.0,) * 4)))
    return channels(node, network.add(texel, node.get("bias", constant((0.0,) * 4))))


def channels(node: Node, rgba: Value) -> Value:
    """What an output named by channels takes."""
    name = node.output
    if name == "rgba":
        return rgba
    if name == "rgb":
        return node.network.resized(rgba, 3)
    if name in "rgba" and len(name) == 1:
        return node.network.gather((rgba, "rgba".index(name)))
    raise Unsupported(f"it has no output '{name}'")


def transform2d(node: Node) -> Value:
    n = node.network
    pair, none = constant((1.0, 1.0)), constant((0.0, 0.0))
    scaled = n.multiply(node.get("in", none), node.get("scale", pair))
    return n.add(n.rotate(scaled, node.get("rotation", ZERO)), node.get("translation", none))


USD_NODES: dict[str, Handler] = {
    "UsdPrimvarReader": primvar_reader,
    "UsdUVTexture": uv_texture,
    "UsdTransform2d": transform2d,
}
