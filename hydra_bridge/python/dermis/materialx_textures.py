"""What each of MaterialX's nodes computes by the place on the surface: primvars, images, texture space. Noise,
geometry and procedural patterns are not here.
"""

from .network import Unsupported, Value, constant
from .nodes import ZERO, Handler, Node, chosen, default_st, read_primvar


def geompropvalue(node: Node) -> Value:
    if node.identifier.endswith(("_string", "_filename")):
        raise Unsupported("only numbers and vectors can drive an input")
    name = node.token("geomprop", "")
    if not name:
        raise Unsupported("its geomprop is empty")
    return read_primvar(node, name, node.network.resized(node.get("default", ZERO), node.width))


def texcoord(node: Node) -> Value:
    index = int(node.number("index", 0))
    name = "st" if index == 0 else f"st{index}"
    return node.network.primvar(node.width, name, node.network.resized(ZERO, node.width))


def geomcolor(node: Node) -> Value:
    if node.number("index", 0):
        raise Unsupported("only its index 0, displayColor, is read")
    return read_primvar(node, "displayColor", node.network.resized(ZERO, node.width))


# Images.


ADDRESS_MODES = {"constant": "black", "clamp": "clamp", "periodic": "repeat", "mirror": "mirror"}

NOT_READ = {
    "layer": ("", "the first channels of the file are used"),
    "framerange": ("", "the file that is named is used in every frame"),
    "frameoffset": ("0", "the file that is named is used in every frame"),
    "frameendaction": ("constant", "the file that is named is used in every frame"),
}
"""Inputs of images: the default, and what is done instead of what they say."""


def image(node: Node) -> Value:
    st = node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)
    return sampled(
        node,
        st,
        *(ADDRESS_MODES[chosen(node, f"{axis}addressmode", "periodic", ADDRESS_MODES)] for axis in "uv"),
    )


def tiledimage(node: Node) -> Value:
    network = node.network
    st = node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)
    pair, none = constant((1.0, 1.0)), constant((0.0, 0.0))
    st = network.multiply(st, node.get("uvtiling", pair))
    st = network.subtract(st, node.get("uvoffset", none))
    st = network.divide(st, node.get("realworldimagesize", pair))
    return sampled(node, network.multiply(st, node.get("realworldtilesize", pair)), "repeat", "repeat")


def sampled(node: Node, st: Value, wrap_s: str, wrap_t: str) -> Value:
    network = node.network
    for name, (idle, instead) in NOT_READ.items():
        word = node.token(name, idle)
        if word != idle:
            node.warn(name, f"'{word}' is not read; {instead}")
    default = network.resized(node.get("default", ZERO), max(node.width, 1))
    if default.lanes is None:
        raise Unsupported("its default is not constant")
    words = {
        "wrapS": wrap_s,
        "wrapT": wrap_t,
        "border": list(default.lanes),
        "fallback": list(default.lanes),
        "closest": chosen(node, "filtertype", "linear", ("closest", "linear")) == "closest",
        "st": network.index(st),
    }
    # Colours without a word are what UsdUVTexture takes them for; floats and vectors are data.
    space = "auto" if node.is_color else "raw"
    found = node.image("file", space, words)
    if not found["tiles"]:
        return default
    texel = network.node(4, found)
    return network.resized(texel, node.width)


# Texture space.


def rotate2d(node: Node) -> Value:
    # MaterialX turns clockwise.
    degrees = node.network.subtract(ZERO, node.get("amount", ZERO))
    return node.network.rotate(node.get("in", constant((0.0, 0.0))), degrees)


def place2d(node: Node) -> Value:
    n = node.network
    pair, none = constant((1.0, 1.0)), constant((0.0, 0.0))
    st = node.get("texcoord", none) if node.has("texcoord") else default_st(node)
    pivot, scale, offset = node.get("pivot", none), node.get("scale", pair), node.get("offset", none)
    degrees = n.subtract(ZERO, node.get("rotate", ZERO))
    st = n.subtract(st, pivot)
    if node.number("operationorder", 0) == 0:
        st = n.subtract(n.rotate(n.divide(st, scale), degrees), offset)
    else:
        st = n.divide(n.rotate(n.subtract(st, offset), degrees), scale)
    return n.add(st, pivot)


TEXTURE_NODES: dict[str, Handler] = {
    "texcoord": texcoord,
    "geompropvalue": geompropvalue,
    "geompropvalueuniform": geompropvalue,
    "geomcolor": geomcolor,
    "image": image,
    "tiledimage": tiledimage,
    "rotate2d": rotate2d,
    "place2d": place2d,
}
