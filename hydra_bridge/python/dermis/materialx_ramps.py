"""MaterialX's ramps and splits: values along texture space, whose top is at V = 1 (before 1.39.5 its shader code said
otherwise)."""

import math

from .network import Network, Unsupported, Value, constant
from .nodes import HALF, ONE, TINY, ZERO, Handler, Node, default_st

BLACK, WHITE = constant((0.0, 0.0, 0.0, 1.0)), constant((1.0, 1.0, 1.0, 1.0))


def texture_space(node: Node) -> Value:
    return node.get("texcoord", ZERO) if node.has("texcoord") else default_st(node)


def within(node: Node) -> tuple[Value, Value]:
    n = node.network
    st = n.clamp(texture_space(node), ZERO, ONE)
    return n.lane(st, 0), n.lane(st, 1)


def ramplr(node: Node) -> Value:
    return node.network.mix(node.get("valuel", ZERO), node.get("valuer", ZERO), within(node)[0])


def ramptb(node: Node) -> Value:
    return node.network.mix(node.get("valueb", ZERO), node.get("valuet", ZERO), within(node)[1])


def ramp4(node: Node) -> Value:
    n, (s, t) = node.network, within(node)
    bottom = n.mix(node.get("valuebl", ZERO), node.get("valuebr", ZERO), s)
    return n.mix(bottom, n.mix(node.get("valuetl", ZERO), node.get("valuetr", ZERO), s), t)


def split(first: str, second: str, axis: int) -> Handler:
    """`first` below the center, `second` from it on."""

    def handler(node: Node) -> Value:
        n, st = node.network, texture_space(node)
        a, b = node.get(first, ZERO), node.get(second, ZERO)
        return n.greater(node.get("center", HALF), n.lane(st, axis), a, b)

    return handler


# `ramp`: colours at up to ten places.


def ramp(node: Node) -> Value:
    x, color = place_of(node), node.get("color1", BLACK)
    shape, count = node.number("interpolation", 1), int(node.number("num_intervals", 2))
    for i in range(1, min(count, 10)):
        color = segment(node, x, shape, (i, i + 1), color)
    return color


def ramp_gradient(node: Node) -> Value:
    """One segment of a ramp over what is before it."""
    before = node.get("prev_color", BLACK)
    if node.number("interval_num", 1) >= node.number("num_intervals", 2):
        return before
    return segment(node, node.get("x", ZERO), node.number("interpolation", 1), (1, 2), before)


def segment(node: Node, x: Value, shape: float, ends: tuple[int, int], before: Value) -> Value:
    """`before` up to the place of the first end, then from its colour to that of the second."""
    n = node.network
    low, high = (node.get(f"interval{i}", ZERO if i == 1 else ONE) for i in ends)
    first, second = (node.get(f"color{i}", BLACK if i == 1 else WHITE) for i in ends)
    return n.greater(x, low, between(n, shape, (low, high), x, (first, second)), before)


def between(
    n: Network, shape: float, ends: tuple[Value, Value], x: Value, colors: tuple[Value, Value]
) -> Value:
    if shape == 2:
        return n.greater(ends[1], x, *colors)
    if shape not in (0, 1):
        raise Unsupported(f"its interpolation is {shape:g}")
    # Of ends in one place the second: x is beyond both.
    length = n.math("max", n.subtract(ends[1], ends[0]), TINY)
    share = n.clamp(n.divide(n.subtract(x, ends[0]), length), ZERO, ONE)
    return n.mix(*colors, n.smooth(share) if shape == 1 else share)


def place_of(node: Node) -> Value:
    """What a ramp goes by: s, the angle, the distance from the middle, or the larger of its two parts."""
    n, kind, st = node.network, node.number("type", 0), texture_space(node)
    if kind == 0:
        return n.lane(st, 0)
    middle = n.subtract(st, HALF)
    s, t = n.lane(middle, 0), n.lane(middle, 1)
    if kind == 1:
        return n.add(n.divide(n.math("atan2", s, t), constant(2.0 * math.pi)), HALF)
    if kind == 2:
        # MaterialX's root of two: the corners are at 0.9998.
        return n.length(n.multiply(middle, constant(1.414)))
    if kind == 3:
        return n.multiply(n.math("max", n.math("absval", s), n.math("absval", t)), constant(2.0))
    raise Unsupported(f"its type is {kind:g}")


RAMP_NODES: dict[str, Handler] = {
    "ramplr": ramplr,
    "ramptb": ramptb,
    "ramp4": ramp4,
    "splitlr": split("valuel", "valuer", 0),
    "splittb": split("valueb", "valuet", 1),
    "ramp": ramp,
    "ramp_gradient": ramp_gradient,
}
