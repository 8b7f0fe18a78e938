"""What MaterialX's nodes compute of numbers, channels and conditions, in the words of `network`, by the node graphs and
shader code of its standard library; hair.
"""

from .network import Unsupported, Value, constant
from .nodes import HALF, ONE, ZERO, Handler, Node

# Arithmetic.


def binary(operation: str, second: float) -> Handler:
    def handler(node: Node) -> Value:
        return node.network.math(operation, node.get("in1", ZERO), node.get("in2", constant(second)))

    return handler


def unary(operation: str, default: float = 0.0) -> Handler:
    def handler(node: Node) -> Value:
        return node.network.math(operation, node.get("in", constant(default)))

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
    return node.network.signed_power(node.get("in1", ZERO), node.get("in2", ONE))


def trianglewave(node: Node) -> Value:
    n = node.network
    x = n.math("modulo", n.math("absval", node.get("in", ZERO)), ONE)
    return n.subtract(HALF, n.math("absval", n.subtract(x, HALF)))


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
        share = n.signed_power(share, n.divide(ONE, gamma))
    out = stretched(node, share)
    if not node.number("doclamp", 0):
        return out
    return n.clamp(out, node.get("outlow", ZERO), node.get("outhigh", ONE))


def smoothstep(node: Node) -> Value:
    n, low, high = node.network, node.get("low", ZERO), node.get("high", ONE)
    x = n.divide(n.subtract(node.get("in", ZERO), low), n.subtract(high, low))
    return n.smooth(n.clamp(x, ZERO, ONE))


def mix(node: Node) -> Value:
    return node.network.mix(node.get("bg", ZERO), node.get("fg", ZERO), node.get("mix", ZERO))


def choice(operation: str, a: str, b: str, then: str, other: str) -> Handler:
    first = ZERO if operation == "ifequal" else ONE

    def handler(node: Node) -> Value:
        values = {"value1": node.get("value1", first), "value2": node.get("value2", ZERO)}
        # What gives a boolean has nothing to choose from.
        yes = ONE if "_boolean" in node.identifier else ZERO
        inputs = {"in1": node.get("in1", yes), "in2": node.get("in2", ZERO)}
        return node.network.math(operation, values[a], values[b], inputs[then], inputs[other])

    return handler


def switch(node: Node) -> Value:
    """The first below 1, the second below 2 and so on, zero from 10 on."""
    which, value = node.get("which", ZERO), ZERO
    last = max((i for i in range(1, 11) if node.has(f"in{i}")), default=0)
    for i in range(last, 0, -1):
        value = node.network.greater(constant(float(i)), which, node.get(f"in{i}", ZERO), value)
    return value


# Booleans: 0 and 1.


def both(node: Node) -> Value:
    return node.network.multiply(node.get("in1", ZERO), node.get("in2", ZERO))


def either(node: Node) -> Value:
    return node.network.math("max", node.get("in1", ZERO), node.get("in2", ZERO))


def one_alone(node: Node) -> Value:
    n = node.network
    return n.math("absval", n.subtract(node.get("in1", ZERO), node.get("in2", ZERO)))


def negated(node: Node) -> Value:
    return node.network.subtract(ONE, node.get("in", ZERO))


# Channels.


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
    **{name: unary(name) for name in ("absval", "sign", "floor", "ceil", "round", "sqrt", "exp")},
    "ln": unary("ln", 1.0),
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
    "trianglewave": trianglewave,
    "logical_and": both,
    "logical_or": either,
    "logical_xor": one_alone,
    "logical_not": negated,
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
    "chiang_hair_roughness": hair_roughness,
    "chiang_hair_absorption_from_color": hair_absorption_from_color,
    "deon_hair_absorption_from_melanin": hair_absorption_from_melanin,
}
