"""Values of MaterialX's nodes, driven by texture coordinates so that the core computes them, and what to compare."""

from __future__ import annotations

import numpy as np
from looked_up import ST, connect, glowing, looked_up, shader

POINTS = [(0.1, 0.93), (0.5, 0.25), (0.8, 0.35)]
U, V = np.array(POINTS).T
ALL = np.ones(3)

S = shader("U", "ND_extract_vector2", connect("float2", "in", "ST"), "float outputs:out")
T = shader(
    "V", "ND_extract_vector2", connect("float2", "in", "ST"), "int inputs:index = 1", "float outputs:out"
)


def combined(name: str, kind: str, *lanes: object) -> str:
    """A vector or colour of other nodes and numbers."""
    inputs = [
        connect("float", f"in{i}", lane) if isinstance(lane, str) else f"float inputs:in{i} = {lane}"
        for i, lane in enumerate(lanes, 1)
    ]
    return shader(name, f"ND_combine{len(lanes)}_{kind}", *inputs, f"{TYPES[kind]} outputs:out")


TYPES = {
    "float": "float",
    "integer": "int",
    "boolean": "bool",
    "color3": "color3f",
    "color4": "color4f",
    "vector2": "float2",
    "vector3": "vector3f",
    "vector4": "float4",
}

HELPERS = (
    ST
    + S
    + T
    + combined("A", "vector3", "U", 0.5, 0.75)
    + combined("C", "color3", "U", 0.25, "V")
    + combined("Q", "color4", "U", 0.25, 0.5, "V")
    + shader(
        "W", "ND_multiply_float", connect("float", "in1", "U"), "float inputs:in2 = 1.5", "float outputs:out"
    )
)
A = np.stack([U, 0.5 * ALL, 0.75 * ALL], axis=1)
C = np.stack([U, 0.25 * ALL, V], axis=1)
Q = np.stack([U, 0.25 * ALL, 0.5 * ALL, V], axis=1)


def value_of(
    identifier: str, kind: str, *lines: str, output: str = "out", points: list = POINTS
) -> np.ndarray:
    """(n, lanes) of a node's output, as an emission shows it: what is negative is 0. Alpha by a node of its own."""
    lanes = {"float2": 2, "color4f": 4, "float4": 4}.get(TYPES.get(kind, ""), 3)
    lanes = 1 if kind in ("float", "integer", "boolean") else lanes
    node = shader("N", identifier, *lines, f"{TYPES[kind]} outputs:{output}")
    got = looked_up(glowing(HELPERS + node, f"N.outputs:{output}"), points)
    if lanes < 4:
        return got[:, :lanes]
    last = shader(
        "X",
        f"ND_extract_{kind}",
        f"{TYPES[kind]} inputs:in.connect = </Look/N.outputs:{output}>",
        "int inputs:index = 3",
        "float outputs:out",
    )
    alpha = looked_up(glowing(HELPERS + node + last, "X.outputs:out"), points)
    return np.concatenate([got, alpha[:, :1]], axis=1)


def check(got: np.ndarray, wanted: np.ndarray) -> None:
    wanted = np.asarray(wanted, float)
    wanted = wanted[:, None] if wanted.ndim == 1 else wanted
    assert got.shape == wanted.shape
    np.testing.assert_allclose(got, np.maximum(wanted, 0), rtol=1e-5, atol=1e-6)


def result_of(name: str) -> str:
    """The type that a node gives."""
    words = name.split("_")
    if words[0] in ("magnitude", "distance", "dotproduct"):
        return "float"
    return words[-1].removesuffix("CF").removesuffix("VV")


def mix(a, b, x):
    return a + (b - a) * x


COLOR = ("color3f inputs:{} = (0.2, 0.4, 0.9)", np.array([0.2, 0.4, 0.9]))
OTHER = ("color3f inputs:{} = (0.7, 0.1, 0.3)", np.array([0.7, 0.1, 0.3]))
WITH_ALPHA = ("color4f inputs:{} = (0.6, 0.3, 0.1, 0.4)", np.array([0.6, 0.3, 0.1, 0.4]))
LUMA = np.array([0.2722287, 0.6740818, 0.0536895])
