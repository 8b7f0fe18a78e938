"""Shading networks as expressions: what is constant is computed here, the rest becomes nodes of `flat::Network`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .arrays import np, single
from .reading import FLOAT32_MAX

Lanes = tuple[float, float, float, float]


class Unsupported(Exception):
    """A node that cannot be rendered; the text says which, and why."""


@dataclass(frozen=True)
class Value:
    """Four lanes, of which `width` mean something; a float fills all of them. `lanes`: constant; else node `index`."""

    width: int
    lanes: Lanes | None
    index: int = -1

    def numbers(self) -> tuple[float, ...]:
        """Of a constant."""
        assert self.lanes is not None
        return self.lanes[: self.width]


def constant(numbers: Any) -> Value:
    """A number or a vector of up to four."""
    if not hasattr(numbers, "__len__"):
        return Value(1, (float(numbers),) * 4)
    values = [float(x) for x in numbers]
    return Value(len(values), tuple([*values, 0.0, 0.0, 0.0, 0.0][:4]))


class Network:
    """Collects nodes. The same node is never there twice."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self._known: dict[str, int] = {}

    def index(self, value: Value) -> int:
        """The node of a value; a constant becomes one. Raises Unsupported where it is not finite."""
        if value.lanes is None:
            return value.index
        if not all(abs(x) <= FLOAT32_MAX for x in value.lanes):
            raise Unsupported("what is constant of it is not finite")
        return self._add({"node": "constant", "value": [single(x) for x in value.lanes]})

    def _add(self, node: dict[str, Any]) -> int:
        key = repr(node)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
        return self._known[key]

    def node(self, width: int, node: dict[str, Any]) -> Value:
        return Value(width, None, self._add(node))

    def math(self, op: str, *args: Value) -> Value:
        """MaterialX's operation, lane by lane."""
        # Of the arguments of a choice the first two are compared.
        width = max(arg.width for arg in (args[2:] or args))
        if all(arg.lanes is not None for arg in args):
            operation = OPERATIONS[op]
            if isinstance(operation, str):
                operation = getattr(np, operation)
            with np.errstate(all="ignore"):
                lanes = operation(*(np.array(arg.lanes, np.float64) for arg in args))
            # Beyond the width anything may come out, 0 / 0 too.
            return Value(
                width, tuple(float(x) if width == 1 or i < width else 0.0 for i, x in enumerate(lanes))
            )
        neutral = NEUTRAL.get(op)
        second = args[1].lanes if neutral is not None and args[0].width == width else None
        if second is not None and all(x == neutral for x in second[:width]):
            return args[0]
        return self.node(width, {"node": "math", "op": op, "args": [self.index(arg) for arg in args]})

    def gather(self, *picks: tuple[Value, int]) -> Value:
        """A vector of one lane each of other values; a single one is a float."""
        width = len(picks)
        picks = picks * 4 if width == 1 else (*picks, *[(constant(0.0), 0)] * (4 - width))
        if all(value.lanes is not None for value, _ in picks):
            return Value(width, tuple(value.lanes[lane] for value, lane in picks))
        nodes, lanes = [self.index(value) for value, _ in picks], [lane for _, lane in picks]
        return self.node(width, {"node": "gather", "args": nodes, "lanes": lanes})

    def primvar(self, width: int, name: str, fallback: Value) -> Value:
        if fallback.lanes is None:
            raise Unsupported("a fallback that is not constant")
        return self.node(width, {"node": "primvar", "varname": name, "fallback": list(fallback.lanes)})

    # What nodes are made of.

    def add(self, a: Value, b: Value) -> Value:
        return self.math("add", a, b)

    def subtract(self, a: Value, b: Value) -> Value:
        return self.math("subtract", a, b)

    def multiply(self, a: Value, b: Value) -> Value:
        return self.math("multiply", a, b)

    def divide(self, a: Value, b: Value) -> Value:
        return self.math("divide", a, b)

    def mix(self, background: Value, foreground: Value, share: Value) -> Value:
        return self.add(background, self.multiply(self.subtract(foreground, background), share))

    def clamp(self, a: Value, low: Value, high: Value) -> Value:
        return self.math("min", self.math("max", a, low), high)

    def greater(self, a: Value, b: Value, then: Value, other: Value) -> Value:
        return self.math("ifgreater", a, b, then, other)

    def smooth(self, x: Value) -> Value:
        """Hermite's step, of x in 0..1."""
        return self.multiply(
            self.multiply(x, x), self.subtract(constant(3.0), self.multiply(constant(2.0), x))
        )

    def signed_power(self, a: Value, exponent: Value) -> Value:
        return self.multiply(self.math("sign", a), self.math("power", self.math("absval", a), exponent))

    def with_alpha(self, color: Value, alpha: Value) -> Value:
        """A colour, and the fourth lane of another one."""
        return self.gather((color, 0), (color, 1), (color, 2), (alpha, 3))

    def lane(self, a: Value, i: int) -> Value:
        return a if a.width == 1 else self.gather((a, i))

    def resized(self, a: Value, width: int) -> Value:
        """MaterialX `convert`: floats are repeated, a colour gets alpha 1, what is too much is dropped."""
        if a.width == width:
            return a
        if a.width == 1:
            return Value(width, a.lanes, a.index)
        if width == 1:
            return self.lane(a, 0)
        one, zero = constant(1.0), constant(0.0)
        more = [(a, i) for i in range(min(a.width, width))]
        return self.gather(*more, *[(one if i == 3 else zero, 0) for i in range(a.width, width)])

    def dot(self, a: Value, b: Value) -> Value:
        product = self.multiply(a, b)
        total = self.lane(product, 0)
        for i in range(1, max(a.width, b.width)):
            total = self.add(total, self.lane(product, i))
        return total

    def cross(self, a: Value, b: Value) -> Value:
        def turned(v: Value, *order: int) -> Value:
            return self.gather(*((v, i) for i in order))

        left = self.multiply(turned(a, 1, 2, 0), turned(b, 2, 0, 1))
        return self.subtract(left, self.multiply(turned(a, 2, 0, 1), turned(b, 1, 2, 0)))

    def length(self, a: Value) -> Value:
        return self.math("sqrt", self.dot(a, a))

    def rotate(self, st: Value, degrees: Value) -> Value:
        """Counterclockwise."""
        if degrees.lanes is not None and degrees.lanes[0] == 0.0:
            return st
        angle = self.multiply(degrees, constant(math.pi / 180.0))
        cos, sin = self.math("cos", angle), self.math("sin", angle)
        s, t = self.lane(st, 0), self.lane(st, 1)
        x = self.subtract(self.multiply(s, cos), self.multiply(t, sin))
        y = self.add(self.multiply(s, sin), self.multiply(t, cos))
        return self.gather((x, 0), (y, 0))


def rgb_to_hsv(c: np.ndarray) -> np.ndarray:
    high, low = max(c[:3]), min(c[:3])
    chroma = high - low
    if chroma <= 0.0 or high <= 0.0:
        return np.array([0.0, 0.0, high, c[3]])
    if c[0] >= high:
        sector = (c[1] - c[2]) / chroma
    elif c[1] >= high:
        sector = 2.0 + (c[2] - c[0]) / chroma
    else:
        sector = 4.0 + (c[0] - c[1]) / chroma
    return np.array([(sector / 6.0) % 1.0, chroma / high, high, c[3]])


def hsv_to_rgb(c: np.ndarray) -> np.ndarray:
    def channel(n: float) -> float:
        k = (n + 6.0 * c[0]) % 6.0
        return c[2] * (1.0 - c[1] * min(max(min(k, 4.0 - k), 0.0), 1.0))

    return np.array([channel(5.0), channel(3.0), channel(1.0), c[3]])


OPERATIONS: dict[str, str | Callable[..., np.ndarray]] = {
    "add": "add",
    "subtract": "subtract",
    "multiply": "multiply",
    "divide": "divide",
    "modulo": lambda a, b: a - b * np.floor(a / b),
    "power": "power",
    "min": "minimum",
    "max": "maximum",
    "atan2": "arctan2",
    "absval": "abs",
    "sign": "sign",
    "floor": "floor",
    "ceil": "ceil",
    "round": lambda a: np.floor(a + 0.5),
    "sqrt": "sqrt",
    "exp": "exp",
    "ln": "log",
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "asin": "arcsin",
    "acos": "arccos",
    "ifgreater": lambda a, b, c, d: np.where(a > b, c, d),
    "ifequal": lambda a, b, c, d: np.where(a == b, c, d),
    "rgbtohsv": rgb_to_hsv,
    "hsvtorgb": hsv_to_rgb,
}
"""`flat::Op` on constants: functions, or the names of numpy's."""

NEUTRAL = {"add": 0.0, "subtract": 0.0, "multiply": 1.0, "divide": 1.0}
"""The second argument that changes nothing."""
