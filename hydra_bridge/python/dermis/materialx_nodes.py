"""What each of MaterialX's nodes computes of its inputs alone, in the words of `network`, by the node graphs and shader
code of its standard library.
"""

from collections.abc import Callable

from .network import Network, Unsupported, Value, constant
from .nodes import HALF, ONE, ZERO, Handler, Node

LUMA = constant((0.2722287, 0.6740818, 0.0536895))
"""Default of MaterialX: ACEScg."""


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


MATERIALX_NODES: dict[str, Handler] = {
    "constant": lambda node: node.network.resized(node.get("value", ZERO), node.width),
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
}
