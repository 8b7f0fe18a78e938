"""Ramps, texture space and directions by MaterialX's nodes against its specification's formulas in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from looked_up import connect, glowing, looked_up, shader
from materialx_values import (
    ALL,
    COLOR,
    HELPERS,
    OTHER,
    POINTS,
    TYPES,
    A,
    Q,
    U,
    V,
    check,
    mix,
    result_of,
    value_of,
)

SHAPES = {
    "ramplr_color3": (
        [COLOR[0].format("valuel"), OTHER[0].format("valuer"), connect("float2", "texcoord", "ST")],
        mix(COLOR[1], OTHER[1], U[:, None]),
    ),
    # The specification: the top is at V = 1.
    "ramptb_color3": (
        [COLOR[0].format("valuet"), OTHER[0].format("valueb")],
        mix(OTHER[1], COLOR[1], V[:, None]),
    ),
    "ramp4_color3": (
        [COLOR[0].format("valuetl"), OTHER[0].format("valuetr"), COLOR[0].format("valuebr")],
        mix(mix(0, COLOR[1], U[:, None]), mix(COLOR[1], OTHER[1], U[:, None]), V[:, None]),
    ),
    "splitlr_color3": (
        [COLOR[0].format("valuel"), OTHER[0].format("valuer"), "float inputs:center = 0.3"],
        np.where((U < 0.3)[:, None], COLOR[1], OTHER[1]),
    ),
    "splittb_color3": (
        [COLOR[0].format("valuet"), OTHER[0].format("valueb"), "float inputs:center = 0.3"],
        np.where((V > 0.3)[:, None], COLOR[1], OTHER[1]),
    ),
    "magnitude_vector2": ([connect("float2", "in", "ST")], np.hypot(U, V)),
    "distance_vector2": (
        [connect("float2", "in1", "ST"), "float2 inputs:in2 = (0.2, 0.3)"],
        np.hypot(U - 0.2, V - 0.3),
    ),
    "dotproduct_vector3": (
        [connect("vector3f", "in1", "A"), "vector3f inputs:in2 = (1, 2, 3)"],
        A @ [1, 2, 3],
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shaping_nodes(name):
    lines, wanted = SHAPES[name]
    check(value_of(f"ND_{name}", result_of(name), *lines), wanted)


# Texture space.


def turned(x, y, degrees):
    """Clockwise."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.stack([c * x + s * y, -s * x + c * y], axis=1)


def test_rotate2d():
    for degrees in (30, -75):
        lines = [connect("float2", "in", "ST"), f"float inputs:amount = {degrees}"]
        check(value_of("ND_rotate2d_vector2", "vector2", *lines), turned(U, V, degrees))


@pytest.mark.parametrize("order", [0, 1])
def test_place2d(order):
    lines = [
        connect("float2", "texcoord", "ST"),
        "float2 inputs:pivot = (0.5, 0.5)",
        "float2 inputs:scale = (0.5, 2)",
        "float inputs:rotate = 30",
        "float2 inputs:offset = (-2, -3)",
        f"int inputs:operationorder = {order}",
    ]
    x, y = U - 0.5, V - 0.5
    scaled = turned(x / 0.5, y / 2, 30) + [2, 3] + 0.5
    moved = turned(x + 2, y + 3, 30) / [0.5, 2] + 0.5
    check(value_of("ND_place2d_vector2", "vector2", *lines), moved if order else scaled)


STOPS = np.array([0.1, 0.4, 0.4, 0.9])
COLORS = np.array([[1, 0, 0.25, 1], [0, 1, 0.5, 0.5], [0.25, 0.25, 1, 0.75], [0.9, 0.8, 0.7, 0]])
PLACES = [(x, y) for x in (0.05, 0.31, 0.45, 0.95) for y in (0.02, 0.6)]


def ramp_lines(interpolation: int, kind: int, count: int) -> list[str]:
    stops = [
        line
        for i, (stop, color) in enumerate(zip(STOPS, COLORS, strict=True), 1)
        for line in (
            f"float inputs:interval{i} = {stop}",
            f"color4f inputs:color{i} = {tuple(color.tolist())}",
        )
    ]
    names = {"interpolation": interpolation, "type": kind, "num_intervals": count}
    return [*stops, *(f"int inputs:{name} = {value}" for name, value in names.items())]


def along_ramp(x: float, interpolation: int, count: int) -> np.ndarray:
    last = int(np.searchsorted(STOPS[:count], x, side="right")) - 1
    if last < 0 or last == count - 1:
        return COLORS[max(last, 0)]
    share = (x - STOPS[last]) / (STOPS[last + 1] - STOPS[last])
    share = {0: share, 1: share * share * (3 - 2 * share), 2: 0.0}[interpolation]
    return mix(COLORS[last], COLORS[last + 1], share)


ALONG = {
    0: lambda x, y: x,
    1: lambda x, y: np.arctan2(x - 0.5, y - 0.5) / (2 * np.pi) + 0.5,
    2: lambda x, y: 1.414 * np.hypot(x - 0.5, y - 0.5),
    3: lambda x, y: 2 * max(abs(x - 0.5), abs(y - 0.5)),
}


@pytest.mark.parametrize("interpolation", [0, 1, 2])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_ramps(interpolation, count):
    """A hard edge at 0.4, where two stops are in one place."""
    got = value_of("ND_ramp", "color4", *ramp_lines(interpolation, 0, count), points=PLACES)
    check(got, np.array([along_ramp(x, interpolation, count) for x, _ in PLACES]))


@pytest.mark.parametrize("kind", ALONG)
def test_ramps_go_along_or_around(kind):
    got = value_of("ND_ramp", "color4", *ramp_lines(0, kind, 4), points=PLACES)
    check(got, np.array([along_ramp(ALONG[kind](x, y), 0, 4) for x, y in PLACES]))


def test_ramps_of_ten_stops_and_of_none():
    colors = np.stack([np.linspace(0, 0.9, 10) ** 2] * 4, axis=1)
    lines = [f"float inputs:interval{i + 1} = {i / 9}" for i in range(10)]
    lines += [f"color4f inputs:color{i + 1} = {tuple(c.tolist())}" for i, c in enumerate(colors)]
    lines += ["int inputs:num_intervals = 10", "int inputs:interpolation = 0"]
    wanted = np.interp([x for x, _ in PLACES], np.arange(10) / 9, colors[:, 0])
    check(value_of("ND_ramp", "color4", *lines, points=PLACES), np.stack([wanted] * 4, axis=1))
    # As it is defined: smoothly from black to white.
    x = np.array([x for x, _ in PLACES])
    smooth = x * x * (3 - 2 * x)
    check(value_of("ND_ramp", "color4", points=PLACES), np.stack([*[smooth] * 3, np.ones(8)], axis=1))


def test_one_segment_of_a_ramp():
    lines = [
        connect("float", "x", "U"),
        "float inputs:interval1 = 0.3",
        "float inputs:interval2 = 0.9",
        "color4f inputs:color1 = (0.5, 0, 0, 1)",
        "color4f inputs:color2 = (0, 0.5, 0, 1)",
        "color4f inputs:prev_color = (0, 0, 0.75, 1)",
        "int inputs:interpolation = 0",
    ]
    share = (U - 0.3) / 0.6
    inside = np.stack([0.5 - 0.5 * share, 0.5 * share, 0 * U, ALL], axis=1)
    wanted = np.where((U > 0.3)[:, None], inside, [0, 0, 0.75, 1])
    check(value_of("ND_ramp_gradient", "color4", *lines), wanted)
    # Beyond the last stop of the ramp.
    over = value_of("ND_ramp_gradient", "color4", *lines, "int inputs:interval_num = 2")
    check(over, np.array([[0, 0, 0.75, 1]] * 3))


# Directions.


def test_cross_products_and_normals():
    nodes = shader(
        "M",
        "ND_crossproduct_vector3",
        connect("vector3f", "in1", "A"),
        "vector3f inputs:in2 = (0, 0, 1)",
        "vector3f outputs:out",
    ) + shader("D", "ND_normalize_vector3", connect("vector3f", "in", "M"), "vector3f outputs:out")
    shifted = shader(
        "P",
        "ND_add_vector3FA",
        connect("vector3f", "in1", "D"),
        "float inputs:in2 = 2",
        "vector3f outputs:out",
    )
    got = looked_up(glowing(HELPERS + nodes + shifted, "P.outputs:out"), POINTS)
    cross = np.cross(A, [0, 0, 1])
    check(got, cross / np.linalg.norm(cross, axis=1)[:, None] + 2)


def lifted(identifier: str, *lines: str) -> np.ndarray:
    """A vector, of which negative numbers are seen, too."""
    node = shader("M", identifier, *lines, "vector3f outputs:out")
    shifted = ["vector3f inputs:in1.connect = </Look/M.outputs:out>", "float inputs:in2 = 4"]
    text = HELPERS + node + shader("N", "ND_add_vector3FA", *shifted, "vector3f outputs:out")
    return looked_up(glowing(text, "N.outputs:out"), POINTS) - 4.0


NORMAL = np.array([0.6, 0.0, 0.8])


def test_rotate3d():
    """Clockwise: a quarter about +Z takes +X to -Y. By scipy, which turns the other way."""
    from scipy.spatial.transform import Rotation

    axis = np.array([1.0, 2.0, 2.0])
    lines = [connect("vector3f", "in", "A"), "float inputs:amount = 40", "vector3f inputs:axis = (1, 2, 2)"]
    wanted = Rotation.from_rotvec(-np.radians(40) * axis / 3).apply(A)
    np.testing.assert_allclose(lifted("ND_rotate3d_vector3", *lines), wanted, atol=3e-6)
    quarter = [
        "vector3f inputs:in = (1, 0, 0)",
        "float inputs:amount = 90",
        "vector3f inputs:axis = (0, 0, 1)",
    ]
    np.testing.assert_allclose(lifted("ND_rotate3d_vector3", *quarter), [[0, -1, 0]] * 3, atol=3e-6)


def test_reflect():
    lines = [connect("vector3f", "in", "A"), "vector3f inputs:normal = (0.6, 0, 0.8)"]
    householder = np.eye(3) - 2 * np.outer(NORMAL, NORMAL)
    np.testing.assert_allclose(lifted("ND_reflect_vector3", *lines), A @ householder, atol=3e-6)


def test_refract():
    """Snell's law in the plane of incidence; nothing where all is reflected."""
    directions = shader("D", "ND_normalize_vector3", connect("vector3f", "in", "A"), "vector3f outputs:out")
    unit = -A / np.linalg.norm(A, axis=1)[:, None]
    down = shader(
        "E",
        "ND_multiply_vector3FA",
        connect("vector3f", "in1", "D"),
        "float inputs:in2 = -1",
        "vector3f outputs:out",
    )
    for ratio in (0.75, 2.5):
        lines = [
            connect("vector3f", "in", "E"),
            "vector3f inputs:normal = (0.6, 0, 0.8)",
            f"float inputs:ior = {ratio}",
        ]
        node = shader("M", "ND_refract_vector3", *lines, "vector3f outputs:out")
        shifted = shader(
            "N",
            "ND_add_vector3FA",
            connect("vector3f", "in1", "M"),
            "float inputs:in2 = 4",
            "vector3f outputs:out",
        )
        text = HELPERS + directions + down + node + shifted
        got = looked_up(glowing(text, "N.outputs:out"), POINTS) - 4.0
        along = unit - (unit @ NORMAL)[:, None] * NORMAL
        sines = ratio * np.linalg.norm(along, axis=1)
        through = sines < 1
        assert through.all() if ratio < 1 else not through.all()
        depth = np.sqrt(np.maximum(1 - sines**2, 0))[:, None]
        wanted = np.where(through[:, None], ratio * along - depth * NORMAL, 0.0)
        np.testing.assert_allclose(got, wanted, atol=5e-6)


MATRIX3 = np.array([[1.0, 2.0, 0.5], [0.25, 1.5, 0.125], [0.5, 0.75, 1.0]])
MATRIX4 = np.array([[1.0, 2, 0.5, 0], [0.25, 1.5, 0.125, 0], [0.5, 0.75, 1.0, 0], [0.1, 0.2, 0.3, 1.0]])


@pytest.mark.parametrize(
    ("name", "kind", "source", "matrix", "wanted"),
    [
        ("vector2M3", "vector2", "ST", MATRIX3, (np.stack([U, V, ALL], axis=1) @ MATRIX3)[:, :2]),
        ("vector3", "vector3", "A", MATRIX3, A @ MATRIX3),
        ("vector3M4", "vector3", "A", MATRIX4, (np.concatenate([A, ALL[:, None]], axis=1) @ MATRIX4)[:, :3]),
        ("vector4", "vector4", "Q", MATRIX4, Q @ MATRIX4),
    ],
)
def test_transformmatrix(name, kind, source, matrix, wanted):
    rows = ", ".join(str(tuple(row.tolist())) for row in matrix)
    lines = [connect(TYPES[kind], "in", source), f"matrix{len(matrix)}d inputs:mat = ({rows})"]
    check(value_of(f"ND_transformmatrix_{name}", kind, *lines), wanted)
    check(
        value_of(f"ND_transformmatrix_{name}", kind, lines[0]),
        {"ST": np.array(POINTS), "A": A, "Q": Q}[source],
    )
