"""What each node of a shading network computes, in the words of `network`: UsdShade's own nodes, and MaterialX's by
the node graphs and shader code of its standard library. Noise, geometry and procedural patterns are not here.
"""

from collections.abc import Callable
from typing import Any, Protocol

from .network import Network, Unsupported, Value, constant

ZERO, ONE, HALF = constant(0.0), constant(1.0), constant(0.5)

LUMA = constant((0.2722287, 0.6740818, 0.0536895))
"""Default of MaterialX: ACEScg."""


class Node(Protocol):
    """A node of the stage, one of its outputs asked for."""

    network: Network
    identifier: str
    category: str
    output: str
    width: int
    is_color: bool

    def get(self, name: str, default: Value) -> Value:
        """An input, driven or not."""
        ...

    def token(self, name: str, default: str) -> str:
        """An input that is a word."""
        ...

    def number(self, name: str, default: float) -> float:
        """An input that must be constant."""
        ...

    def has(self, name: str) -> bool:
        """Whether an input is authored or connected."""
        ...

    def image(self, file: str, space: str, node: dict[str, Any]) -> dict[str, Any]:
        """The node with its tiles, from the file of an input."""
        ...


Handler = Callable[[Node], Value]


def category(identifier: str) -> str:
    """`ND_multiply_color3FA` is a `multiply`; nodes of one type alone have no more than their name."""
    if identifier.startswith("ND_"):
        if identifier[3:] in HANDLERS:
            return identifier[3:]
        return identifier[3:].split("_")[0]
    return identifier.split("_")[0]


def evaluate(node: Node) -> Value:
    """Raises Unsupported."""
    handler = HANDLERS.get(node.category)
    if handler is None:
        raise Unsupported("it is not supported")
    return handler(node)


# Where values come from.


def primvar_reader(node: Node) -> Value:
    if node.identifier.endswith(("_string", "_matrix")):
        raise Unsupported("only numbers and vectors can drive an input")
    name = node.token("varname", "")
    if not name:
        raise Unsupported("its varname is empty")
    fallback = node.network.resized(node.get("fallback", ZERO), node.width)
    return read_primvar(node, name, fallback)


def geompropvalue(node: Node) -> Value:
    name = node.token("geomprop", "")
    if not name:
        raise Unsupported("its geomprop is empty")
    return read_primvar(node, name, node.network.resized(node.get("default", ZERO), node.width))


def read_primvar(node: Node, name: str, fallback: Value) -> Value:
    value = node.network.primvar(node.width, name, fallback)
    # A mesh may have more components than the reader wants.
    return node.network.gather((value, 0)) if node.width == 1 else value


def texcoord(node: Node) -> Value:
    index = int(node.number("index", 0))
    name = "st" if index == 0 else f"st{index}"
    return node.network.primvar(node.width, name, node.network.resized(ZERO, node.width))


def default_st(node: Node) -> Value:
    return node.network.primvar(2, "st", constant((0.0, 0.0)))


def geomcolor(node: Node) -> Value:
    return read_primvar(node, "displayColor", node.network.resized(ZERO, node.width))


# Images.


def uv_texture(node: Node) -> Value:
    network = node.network
    st = node.get("st", constant((0.0, 0.0)))
    fallback = node.get("fallback", constant((0.0, 0.0, 0.0, 1.0)))
    if fallback.lanes is None:
        raise Unsupported("its fallback is not constant")
    words = {
        "wrapS": node.token("wrapS", "useMetadata"),
        "wrapT": node.token("wrapT", "useMetadata"),
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


# Arithmetic.


def binary(operation: str, second: float) -> Handler:
    def handler(node: Node) -> Value:
        return node.network.math(operation, node.get("in1", ZERO), node.get("in2", constant(second)))

    return handler


def unary(operation: str) -> Handler:
    def handler(node: Node) -> Value:
        return node.network.math(operation, node.get("in", ZERO))

    return handler


def atan2(node: Node) -> Value:
    # 1.39 names them by what they are.
    y = node.get("iny", node.get("in1", ZERO))
    return node.network.math("atan2", y, node.get("inx", node.get("in2", ONE)))


def invert(node: Node) -> Value:
    return node.network.subtract(node.get("amount", ONE), node.get("in", ZERO))


def fract(node: Node) -> Value:
    a = node.get("in", ZERO)
    return node.network.subtract(a, node.network.math("floor", a))


def safepower(node: Node) -> Value:
    n, a = node.network, node.get("in1", ZERO)
    return n.multiply(n.math("sign", a), n.math("power", n.math("absval", a), node.get("in2", ONE)))


def clamp(node: Node) -> Value:
    return node.network.clamp(node.get("in", ZERO), node.get("low", ZERO), node.get("high", ONE))


def fitted(node: Node) -> Value:
    """(in - inlow) / (inhigh - inlow)."""
    n, low = node.network, node.get("inlow", ZERO)
    return n.divide(n.subtract(node.get("in", ZERO), low), n.subtract(node.get("inhigh", ONE), low))


def stretched(node: Node, share: Value) -> Value:
    n, low = node.network, node.get("outlow", ZERO)
    return n.add(low, n.multiply(share, n.subtract(node.get("outhigh", ONE), low)))


def remap(node: Node) -> Value:
    return stretched(node, fitted(node))


def range_node(node: Node) -> Value:
    n, share = node.network, fitted(node)
    gamma = node.get("gamma", ONE)
    if gamma.lanes is None or set(gamma.numbers()) != {1.0}:
        power = n.math("power", n.math("absval", share), n.divide(ONE, gamma))
        share = n.multiply(n.math("sign", share), power)
    out = stretched(node, share)
    if not node.number("doclamp", 0):
        return out
    return n.clamp(out, node.get("outlow", ZERO), node.get("outhigh", ONE))


def smoothstep(node: Node) -> Value:
    n, low, high = node.network, node.get("low", ZERO), node.get("high", ONE)
    x = n.divide(n.subtract(node.get("in", ZERO), low), n.subtract(high, low))
    x = n.clamp(x, ZERO, ONE)
    return n.multiply(n.multiply(x, x), n.subtract(constant(3.0), n.multiply(constant(2.0), x)))


def mix(node: Node) -> Value:
    return node.network.mix(node.get("bg", ZERO), node.get("fg", ZERO), node.get("mix", ZERO))


def choice(operation: str, a: str, b: str, then: str, other: str) -> Handler:
    def handler(node: Node) -> Value:
        values = {"value1": node.get("value1", ONE), "value2": node.get("value2", ZERO)}
        inputs = {"in1": node.get("in1", ZERO), "in2": node.get("in2", ZERO)}
        return node.network.math(operation, values[a], values[b], inputs[then], inputs[other])

    return handler


def switch(node: Node) -> Value:
    n = node.network
    which = node.get("which", ZERO)
    which = n.math("floor", which)
    value = ZERO
    for i in reversed(range(10)):
        if node.has(f"in{i + 1}"):
            value = n.math("ifequal", which, constant(float(i)), node.get(f"in{i + 1}", ZERO), value)
    return value


# Vectors and colours.


def combine(node: Node) -> Value:
    names = ("in1", "in2", "in3", "in4")
    picks: list[tuple[Value, int]] = []
    for name in names:
        if node.has(name) or len(picks) < node.width:
            value = node.get(name, ZERO)
            picks.extend((value, i) for i in range(value.width))
    return node.network.gather(*picks[: node.width])


def extract(node: Node) -> Value:
    index = int(node.number("index", 0))
    if not 0 <= index < 4:
        raise Unsupported(f"its index is {index}")
    return node.network.gather((node.get("in", ZERO), index))


def separate(node: Node) -> Value:
    letter = node.output.removeprefix("out")
    index = "rgba".find(letter) if letter in "rgba" else "xyzw".find(letter)
    if index < 0 or len(letter) != 1:
        raise Unsupported(f"it has no output '{node.output}'")
    return node.network.gather((node.get("in", ZERO), index))


def swizzle(node: Node) -> Value:
    value = node.get("in", ZERO)
    picks: list[tuple[Value, int]] = []
    for letter in node.token("channels", ""):
        if letter in "01":
            picks.append((constant(float(letter)), 0))
        elif letter in "rgbaxyzw":
            index = "rgba".find(letter) if letter in "rgba" else "xyzw".find(letter)
            picks.append((value, 0 if value.width == 1 else index))
    if len(picks) < node.width:
        raise Unsupported(f"its channels are '{node.token('channels', '')}'")
    return node.network.gather(*picks[: node.width])


def convert(node: Node) -> Value:
    return node.network.resized(node.get("in", ZERO), node.width)


def through(node: Node) -> Value:
    return node.get("in", ZERO)


def luminance_of(node: Node) -> Value:
    value = node.get("in", ZERO)
    weights = node.network.resized(node.get("lumacoeffs", LUMA), 3)
    return node.network.dot(node.network.resized(value, 3), weights)


def luminance(node: Node) -> Value:
    grey, value = luminance_of(node), node.get("in", ZERO)
    if node.width < 4:
        return node.network.gather(*[(grey, 0)] * node.width)
    return node.network.gather((grey, 0), (grey, 0), (grey, 0), (value, 3))


def saturate(node: Node) -> Value:
    return node.network.mix(luminance(node), node.get("in", ZERO), node.get("amount", ONE))


def contrast(node: Node) -> Value:
    n, pivot = node.network, node.get("pivot", HALF)
    return n.add(n.multiply(n.subtract(node.get("in", ZERO), pivot), node.get("amount", ONE)), pivot)


def hsvadjust(node: Node) -> Value:
    n, amount = node.network, node.get("amount", constant((0.0, 1.0, 1.0)))
    color = node.get("in", ZERO)
    hsv = n.math("rgbtohsv", color)
    parts = [n.add(n.lane(hsv, 0), n.lane(amount, 0))]
    parts += [n.multiply(n.lane(hsv, i), n.lane(amount, i)) for i in (1, 2)]
    alpha = [(color, 3)] if color.width == 4 else []
    return n.math("hsvtorgb", n.gather(*((part, 0) for part in parts), *alpha))


def magnitude(node: Node) -> Value:
    return node.network.length(node.get("in", ZERO))


def distance(node: Node) -> Value:
    return node.network.length(node.network.subtract(node.get("in1", ZERO), node.get("in2", ZERO)))


def normalize(node: Node) -> Value:
    value = node.get("in", ZERO)
    return node.network.divide(value, node.network.length(value))


def dotproduct(node: Node) -> Value:
    return node.network.dot(node.get("in1", ZERO), node.get("in2", ZERO))


def crossproduct(node: Node) -> Value:
    return node.network.cross(node.get("in1", ZERO), node.get("in2", ZERO))


# Compositing: an operation on background and foreground, by share.


def blend(operation: Callable[[Network, Value, Value], Value]) -> Handler:
    def handler(node: Node) -> Value:
        back, front = node.get("bg", ZERO), node.get("fg", ZERO)
        return node.network.mix(back, operation(node.network, back, front), node.get("mix", ONE))

    return handler


def screen(n: Network, back: Value, front: Value) -> Value:
    return n.subtract(ONE, n.multiply(n.subtract(ONE, front), n.subtract(ONE, back)))


# Texture space.


def transform2d(node: Node) -> Value:
    n = node.network
    pair, none = constant((1.0, 1.0)), constant((0.0, 0.0))
    scaled = n.multiply(node.get("in", none), node.get("scale", pair))
    return n.add(n.rotate(scaled, node.get("rotation", ZERO)), node.get("translation", none))


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


# Hair (MaterialX PBS).


def hair_roughness(node: Node) -> Value:
    """Chiang et al. 2016, eqs. 7 and 8, without the sqrt(pi / 8) of the latter: (variance, scale) of one lobe."""
    n = node.network

    def input_of(name: str, default: float) -> Value:
        return n.clamp(node.get(name, constant(default)), constant(0.001), ONE)

    def fit(x: Value, *terms: tuple[float, float]) -> Value:
        powers = [n.multiply(constant(c), n.math("power", x, constant(p))) for c, p in terms]
        return n.add(n.add(powers[0], powers[1]), powers[2])

    root = fit(input_of("longitudinal", 0.1), (0.726, 1.0), (0.812, 2.0), (3.7, 20.0))
    scale = fit(input_of("azimuthal", 0.2), (0.265, 1.0), (1.194, 2.0), (5.372, 22.0))
    factors = {
        "roughness_R": ONE,
        "roughness_TT": node.get("scale_TT", HALF),
        "roughness_TRT": node.get("scale_TRT", constant(2.0)),
    }
    if node.output not in factors:
        raise Unsupported(f"it has no output '{node.output}'")
    root = n.multiply(root, factors[node.output])
    return n.gather((n.multiply(root, root), 0), (scale, 0))


def hair_absorption_from_color(node: Node) -> Value:
    """Chiang et al. 2016, eq. 9."""
    n, beta = node.network, node.get("azimuthal_roughness", constant(0.2))
    factors = (5.969, -0.215, 2.532, -10.73, 5.574, 0.245)
    fit = constant(0.0)
    for factor in reversed(factors):
        fit = n.add(n.multiply(fit, beta), constant(factor))
    color = n.clamp(node.get("color", constant((1.0, 1.0, 1.0))), constant(0.001), ONE)
    root = n.divide(n.math("ln", color), fit)
    return n.resized(n.multiply(root, root), 3)


EUMELANIN, PHEOMELANIN = constant((0.657704, 0.498077, 0.254107)), constant((0.829444, 0.67032, 0.349938))


def hair_absorption_from_melanin(node: Node) -> Value:
    """d'Eon et al. 2011, section 6.1; colours are exp(-absorption) of each pigment."""
    n = node.network
    clear = n.subtract(ONE, node.get("melanin_concentration", constant(0.25)))
    melanin = n.subtract(ZERO, n.math("ln", n.math("max", clear, constant(0.0001))))
    red = node.get("melanin_redness", HALF)

    def absorption(share: Value, color: str, default: Value) -> Value:
        return n.multiply(
            n.multiply(melanin, share), n.subtract(ZERO, n.math("ln", node.get(color, default)))
        )

    eumelanin = absorption(n.subtract(ONE, red), "eumelanin_color", EUMELANIN)
    total = n.add(eumelanin, absorption(red, "pheomelanin_color", PHEOMELANIN))
    return n.resized(n.math("max", total, ZERO), 3)


HANDLERS: dict[str, Handler] = {
    "UsdPrimvarReader": primvar_reader,
    "UsdUVTexture": uv_texture,
    "UsdTransform2d": transform2d,
    "constant": lambda node: node.network.resized(node.get("value", ZERO), node.width),
    "texcoord": texcoord,
    "geompropvalue": geompropvalue,
    "geompropvalueuniform": geompropvalue,
    "geomcolor": geomcolor,
    "image": image,
    "tiledimage": tiledimage,
    "add": binary("add", 0.0),
    "subtract": binary("subtract", 0.0),
    "multiply": binary("multiply", 1.0),
    "divide": binary("divide", 1.0),
    "modulo": binary("modulo", 1.0),
    "power": binary("power", 1.0),
    "min": binary("min", 0.0),
    "max": binary("max", 0.0),
    **{name: unary(name) for name in ("absval", "sign", "floor", "ceil", "round", "sqrt", "exp", "ln")},
    **{name: unary(name) for name in ("sin", "cos", "tan", "asin", "acos", "rgbtohsv", "hsvtorgb")},
    "atan2": atan2,
    "invert": invert,
    "fract": fract,
    "safepower": safepower,
    "clamp": clamp,
    "remap": remap,
    "range": range_node,
    "smoothstep": smoothstep,
    "mix": mix,
    "ifgreater": choice("ifgreater", "value1", "value2", "in1", "in2"),
    "ifgreatereq": choice("ifgreater", "value2", "value1", "in2", "in1"),
    "ifequal": choice("ifequal", "value1", "value2", "in1", "in2"),
    "switch": switch,
    "combine2": combine,
    "combine3": combine,
    "combine4": combine,
    "extract": extract,
    "separate2": separate,
    "separate3": separate,
    "separate4": separate,
    "swizzle": swizzle,
    "convert": convert,
    "dot": through,
    "luminance": luminance,
    "saturate": saturate,
    "contrast": contrast,
    "hsvadjust": hsvadjust,
    "magnitude": magnitude,
    "distance": distance,
    "normalize": normalize,
    "dotproduct": dotproduct,
    "crossproduct": crossproduct,
    "plus": blend(lambda n, back, front: n.add(back, front)),
    "minus": blend(lambda n, back, front: n.subtract(back, front)),
    "difference": blend(lambda n, back, front: n.math("absval", n.subtract(back, front))),
    "screen": blend(screen),
    "chiang_hair_roughness": hair_roughness,
    "chiang_hair_absorption_from_color": hair_absorption_from_color,
    "deon_hair_absorption_from_melanin": hair_absorption_from_melanin,
    "rotate2d": rotate2d,
    "place2d": place2d,
    "ramplr": ramplr,
    "ramptb": ramptb,
    "ramp4": ramp4,
    "splitlr": split("valuel", "valuer", 0),
    "splittb": split("valuet", "valueb", 1),
}
