"""What MaterialX's nodes compute of directions and points, by the node graphs and shader code of its standard
library."""

import math

from .network import Unsupported, Value, constant
from .nodes import ONE, ZERO, Handler, Node


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


def rotate3d(node: Node) -> Value:
    """Rodrigues' formula; MaterialX turns clockwise, seen against the axis."""
    n, value = node.network, node.get("in", constant((0.0, 0.0, 0.0)))
    axis = node.get("axis", constant((0.0, 1.0, 0.0)))
    axis = n.divide(axis, n.length(axis))
    angle = n.multiply(node.get("amount", ZERO), constant(math.pi / 180.0))
    cos, sin = n.math("cos", angle), n.math("sin", angle)
    turned = n.add(n.multiply(value, cos), n.multiply(n.cross(value, axis), sin))
    return n.add(turned, n.multiply(axis, n.multiply(n.dot(axis, value), n.subtract(ONE, cos))))


def directions(node: Node) -> tuple[Value, Value]:
    """A direction and the normal that it meets."""
    if not node.has("normal"):
        raise Unsupported("its normal is that of the surface, which networks do not know")
    return node.get("in", constant((1.0, 0.0, 0.0))), node.get("normal", ZERO)


def reflect(node: Node) -> Value:
    n, (direction, normal) = node.network, directions(node)
    return n.subtract(direction, n.multiply(normal, n.multiply(constant(2.0), n.dot(normal, direction))))


def refract(node: Node) -> Value:
    """Zero where all is reflected."""
    n, (direction, normal) = node.network, directions(node)
    ior, cos = node.get("ior", ONE), n.dot(direction, normal)
    k = n.subtract(ONE, n.multiply(n.multiply(ior, ior), n.subtract(ONE, n.multiply(cos, cos))))
    root = n.math("sqrt", n.math("max", k, ZERO))
    bent = n.subtract(n.multiply(direction, ior), n.multiply(normal, n.add(n.multiply(ior, cos), root)))
    return n.greater(ZERO, k, constant((0.0, 0.0, 0.0)), bent)


def transformmatrix(node: Node) -> Value:
    """A row vector times a constant matrix; of a matrix with a row more than the vector has numbers, a point."""
    n, value, rows = node.network, node.get("in", constant((0.0,) * node.width)), node.matrix("mat")
    if rows is None:
        return value
    total = constant((0.0,) * node.width)
    for i, row in enumerate(rows):
        part = n.lane(value, i) if i < node.width else ONE
        total = n.add(total, n.multiply(part, constant(row[: node.width])))
    return total


VECTOR_NODES: dict[str, Handler] = {
    "magnitude": magnitude,
    "distance": distance,
    "normalize": normalize,
    "dotproduct": dotproduct,
    "crossproduct": crossproduct,
    "rotate3d": rotate3d,
    "reflect": reflect,
    "refract": refract,
    "transformmatrix": transformmatrix,
}
