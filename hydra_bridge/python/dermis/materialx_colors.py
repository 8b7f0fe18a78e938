"""What MaterialX's nodes make of colours, and of one colour over another, by the node graphs and shader code of its
standard library."""

from collections.abc import Callable

from .network import Network, Value, constant
from .nodes import HALF, ONE, TINY, ZERO, Handler, Node

LUMA = constant((0.2722287, 0.6740818, 0.0536895))
"""Default of MaterialX: ACEScg."""

NOTHING = constant((0.0, 0.0, 0.0, 0.0))


def luminance_of(node: Node, value: Value) -> Value:
    weights = node.network.resized(node.get("lumacoeffs", LUMA), 3)
    return node.network.dot(node.network.resized(value, 3), weights)


def grey_of(node: Node, value: Value) -> Value:
    """Alpha stays."""
    grey = luminance_of(node, value)
    if node.width < 4:
        return node.network.gather(*[(grey, 0)] * node.width)
    return node.network.gather((grey, 0), (grey, 0), (grey, 0), (value, 3))


def luminance(node: Node) -> Value:
    return grey_of(node, node.get("in", ZERO))


def saturate(node: Node) -> Value:
    value = node.get("in", ZERO)
    return node.network.mix(grey_of(node, value), value, node.get("amount", ONE))


def contrasted(n: Network, value: Value, amount: Value, pivot: Value) -> Value:
    return n.add(n.multiply(n.subtract(value, pivot), amount), pivot)


def contrast(node: Node) -> Value:
    return contrasted(node.network, node.get("in", ZERO), node.get("amount", ONE), node.get("pivot", HALF))


def hsvadjust(node: Node) -> Value:
    amount = node.get("amount", constant((0.0, 1.0, 1.0)))
    return hsv_adjusted(node.network, node.get("in", ZERO), amount)


def hsv_adjusted(n: Network, color: Value, amount: Value) -> Value:
    hsv = n.math("rgbtohsv", color)
    parts = [n.add(n.lane(hsv, 0), n.lane(amount, 0))]
    parts += [n.multiply(n.lane(hsv, i), n.lane(amount, i)) for i in (1, 2)]
    alpha = [(color, 3)] if color.width == 4 else []
    return n.math("hsvtorgb", n.gather(*((part, 0) for part in parts), *alpha))


def colorcorrect(node: Node) -> Value:
    """Hue, saturation, gamma, lift, gain, contrast, exposure, in this order; alpha stays."""
    n, color = node.network, node.get("in", ONE)
    alpha, lift = color, node.get("lift", ZERO)
    color = n.resized(color, 3)
    color = hsv_adjusted(n, color, n.gather((node.get("hue", ZERO), 0), (ONE, 0), (ONE, 0)))
    grey = n.resized(n.dot(color, LUMA), 3)
    color = n.mix(grey, color, node.get("saturation", ONE))
    color = n.signed_power(color, n.divide(ONE, node.get("gamma", ONE)))
    color = n.add(n.multiply(color, n.subtract(ONE, lift)), lift)
    color = n.multiply(color, node.get("gain", ONE))
    color = contrasted(n, color, node.get("contrast", ONE), node.get("contrastpivot", HALF))
    color = n.multiply(color, n.math("power", constant(2.0), node.get("exposure", ZERO)))
    return n.with_alpha(color, alpha) if node.width == 4 else color


# Two colours: an operation on background and foreground, by share.

Operation = Callable[[Network, Value, Value], Value]


def blend(operation: Operation) -> Handler:
    def handler(node: Node) -> Value:
        back, front = (node.get(name, constant((0.0,) * node.width)) for name in ("bg", "fg"))
        return node.network.mix(back, operation(node.network, back, front), node.get("mix", ONE))

    return handler


def divided(n: Network, a: Value, b: Value, otherwise: Value) -> Value:
    """a / b where b is not as good as zero."""
    none = n.greater(TINY, n.math("absval", b), ONE, ZERO)
    return n.greater(none, HALF, otherwise, n.divide(a, n.add(b, none)))


def burn(node: Node) -> Value:
    """1 - (1 - bg) / fg, by share; where fg is zero so is all of it."""
    n, back, front = node.network, node.get("bg", ZERO), node.get("fg", ZERO)
    burnt = n.subtract(front, n.subtract(ONE, back))
    return by_front(node, back, burnt, front)


def dodge(node: Node) -> Value:
    """bg / (1 - fg), by share; where fg is one all of it is zero."""
    n, back, front = node.network, node.get("bg", ZERO), node.get("fg", ZERO)
    return by_front(node, back, back, n.subtract(ONE, front))


def by_front(node: Node, back: Value, above: Value, below: Value) -> Value:
    """The share of above / below over `back`: all over `below`, which may be zero."""
    n, share = node.network, node.get("mix", ONE)
    rest = n.multiply(n.multiply(back, below), n.subtract(ONE, share))
    return divided(n, n.add(n.multiply(above, share), rest), below, ZERO)


def screen(n: Network, back: Value, front: Value) -> Value:
    return n.subtract(ONE, n.multiply(n.subtract(ONE, front), n.subtract(ONE, back)))


def overlay(n: Network, back: Value, front: Value) -> Value:
    twice = constant(2.0)
    dark = n.multiply(twice, n.multiply(front, back))
    bright = n.multiply(twice, n.multiply(n.subtract(ONE, front), n.subtract(ONE, back)))
    return n.greater(HALF, back, dark, n.subtract(ONE, bright))


# Porter and Duff 1984: colours with their alpha.


def uncovered(n: Network, front: Value) -> Value:
    return n.subtract(ONE, n.lane(front, 3))


def matte(n: Network, back: Value, front: Value) -> Value:
    """`over` of a foreground that is not multiplied by its alpha."""
    multiplied = n.with_alpha(n.multiply(front, n.lane(front, 3)), front)
    return n.add(multiplied, n.multiply(back, uncovered(n, front)))


def disjointover(n: Network, back: Value, front: Value) -> Value:
    total, alpha = n.add(n.lane(front, 3), n.lane(back, 3)), n.lane(back, 3)
    # ((1 - a) / b) of the background, all over b.
    beside = n.add(n.multiply(front, alpha), n.multiply(back, uncovered(n, front)))
    beside = divided(n, beside, alpha, NOTHING)
    color = n.greater(total, ONE, beside, n.add(front, back))
    return n.gather(*((color, i) for i in range(3)), (n.math("min", total, ONE), 0))


def premult(node: Node) -> Value:
    n, color = node.network, node.get("in", constant((0.0, 0.0, 0.0, 1.0)))
    return n.with_alpha(n.multiply(color, n.lane(color, 3)), color)


def unpremult(node: Node) -> Value:
    """Of alpha 0 the colour that is there."""
    n, color = node.network, node.get("in", constant((0.0, 0.0, 0.0, 1.0)))
    return n.with_alpha(divided(n, color, n.lane(color, 3), color), color)


def inside(node: Node) -> Value:
    return node.network.multiply(node.get("in", ZERO), node.get("mask", ONE))


def outside(node: Node) -> Value:
    n = node.network
    return n.multiply(node.get("in", ZERO), n.subtract(ONE, node.get("mask", ZERO)))


COLOR_NODES: dict[str, Handler] = {
    "luminance": luminance,
    "saturate": saturate,
    "contrast": contrast,
    "hsvadjust": hsvadjust,
    "colorcorrect": colorcorrect,
    "plus": blend(lambda n, back, front: n.add(back, front)),
    "minus": blend(lambda n, back, front: n.subtract(back, front)),
    "difference": blend(lambda n, back, front: n.math("absval", n.subtract(back, front))),
    "burn": burn,
    "dodge": dodge,
    "screen": blend(screen),
    "overlay": blend(overlay),
    "in": blend(lambda n, back, front: n.multiply(front, n.lane(back, 3))),
    "mask": blend(lambda n, back, front: n.multiply(back, n.lane(front, 3))),
    "matte": blend(matte),
    "out": blend(lambda n, back, front: n.multiply(front, uncovered(n, back))),
    "over": blend(lambda n, back, front: n.add(front, n.multiply(back, uncovered(n, front)))),
    "disjointover": blend(disjointover),
    "premult": premult,
    "unpremult": unpremult,
    "inside": inside,
    "outside": outside,
}
