"""What each of MaterialX's nodes computes by the place on the surface: primvars, images, ramps, texture space. Noise,
geometry and procedural patterns are not here.
"""

from .network import Unsupported, Value, constant
from .nodes import HALF, ONE, ZERO, Handler, Node, read_primvar


def geompropvalue(node: Node) -> Value:
    name = node.token("geomprop", "")
    if not name:
        raise Unsupported("its geomprop is empty")
    return read_primvar(node, name, node.network.resized(node.get("default", ZERO), node.width))


def texcoord(node: Node) -> Value:
    index = int(node.number("index", 0))
    name = "st" if index == 0 else f"st{index}"
    return node.network.primvar(node.width, name, node.network.resized(ZERO, node.width))


def default_st(node: Node) -> Value:
    return node.network.primvar(2, "st", constant((0.0, 0.0)))


def geomcolor(node: Node) -> Value:
    return read_primvar(node, "displayColor", node.network.resized(ZERO, node.width))


# Images.


ADDRESS_MODES = {"constant": "black", "clamp": "clamp", "periodic": "repeat", "mirror": "mirror"}


def image(node: Node) -> Value:
    st = node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)
    modes = [ADDRESS_MODES.get(node.token(f"{axis}addressmode", "periodic"), "repeat") for axis in "uv"]
    return sampled(node, st, *modes)


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
    default = network.resized(node.get("default", ZERO), max(node.width, 1))
    if default.lanes is None:
        raise Unsupported("its default is not constant")
    words = {
        "wrapS": wrap_s,
        "wrapT": wrap_t,
        "border": list(default.lanes),
        "fallback": list(default.lanes),
        "closest": node.token("filtertype", "linear") == "closest",
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


def ramp_st(node: Node) -> tuple[Value, Value]:
    n = node.network
    st = node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)
    st = n.clamp(st, ZERO, ONE)
    return n.lane(st, 0), n.lane(st, 1)


def ramplr(node: Node) -> Value:
    return node.network.mix(node.get("valuel", ZERO), node.get("valuer", ZERO), ramp_st(node)[0])


def ramptb(node: Node) -> Value:
    # The top is at t = 0, as in MaterialX's shader code.
    return node.network.mix(node.get("valuet", ZERO), node.get("valueb", ZERO), ramp_st(node)[1])


def ramp4(node: Node) -> Value:
    n, (s, t) = node.network, ramp_st(node)
    top = n.mix(node.get("valuetl", ZERO), node.get("valuetr", ZERO), s)
    return n.mix(top, n.mix(node.get("valuebl", ZERO), node.get("valuebr", ZERO), s), t)


def split(first: str, second: str, axis: int) -> Handler:
    def handler(node: Node) -> Value:
        n = node.network
        st = node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)
        a, b = node.get(first, ZERO), node.get(second, ZERO)
        return n.greater(node.get("center", HALF), n.lane(st, axis), a, b)

    return handler


TEXTURE_NODES: dict[str, Handler] = {
    "texcoord": texcoord,
    "geompropvalue": geompropvalue,
    "geompropvalueuniform": geompropvalue,
    "geomcolor": geomcolor,
    "image": image,
    "tiledimage": tiledimage,
    "rotate2d": rotate2d,
    "place2d": place2d,
    "ramplr": ramplr,
    "ramptb": ramptb,
    "ramp4": ramp4,
    "splitlr": split("valuel", "valuer", 0),
    "splittb": split("valuet", "valueb", 1),
}
