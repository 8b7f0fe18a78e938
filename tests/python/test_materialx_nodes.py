"""What MaterialX's nodes compute, against the formulas of its specification in numpy. Most are driven, so that the core
computes them."""

from __future__ import annotations

import colorsys
from pathlib import Path

import numpy as np
import pytest
from looked_up import ST, connect, glowing, looked_up, primvar, quads, shader

from dermis.graph import HANDLERS
from dermis.usd_nodes import USD_NODES

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


# Numbers.

FLOATS = {
    "add": (lambda u, v: u + v, "in1 in2"),
    "multiply": (lambda u, v: u * v, "in1 in2"),
    "divide": (lambda u, v: u / v, "in1 in2"),
    "subtract": (lambda u, v: v - u, "in2 in1"),
    "power": (lambda u, v: u**v, "in1 in2"),
    "modulo": (lambda u, v: np.mod(v, u), "in2 in1"),
    "min": (np.minimum, "in1 in2"),
    "max": (np.maximum, "in1 in2"),
    "atan2": (np.arctan2, "iny inx"),
    "safepower": (lambda u, v: u**v, "in1 in2"),
}


@pytest.mark.parametrize("name", FLOATS)
def test_arithmetic_of_two(name):
    wanted, (first, second) = FLOATS[name][0], FLOATS[name][1].split()
    check(
        value_of(f"ND_{name}_float", "float", connect("float", first, "U"), connect("float", second, "V")),
        wanted(U, V),
    )


UNARY = {
    "absval": np.abs,
    "floor": np.floor,
    "ceil": np.ceil,
    "round": np.rint,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "ln": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "sign": np.sign,
    "invert": lambda v: 1 - v,
    "fract": lambda v: v,
    "dot": lambda v: v,
}


@pytest.mark.parametrize("name", UNARY)
def test_arithmetic_of_one(name):
    check(value_of(f"ND_{name}_float", "float", connect("float", "in", "V")), UNARY[name](V))


@pytest.mark.parametrize("number", [0.3, 0.5, 1.7, 2.4, -0.3, -1.6])
def test_triangle_waves(number):
    """Up to a half in the middle of a period of 1, the same to both sides of 0."""
    share = abs(number) % 1.0
    wanted = share if share < 0.5 else 1.0 - share
    check(value_of("ND_trianglewave_float", "float", f"float inputs:in = {number}"), wanted * ALL)
    line = shader(
        "M",
        "ND_multiply_float",
        connect("float", "in1", "U"),
        f"float inputs:in2 = {number}",
        "float outputs:out",
    )
    share = np.abs(U * number) % 1.0
    node = shader("N", "ND_trianglewave_float", connect("float", "in", "M"), "float outputs:out")
    got = looked_up(glowing(HELPERS + line + node, "N.outputs:out"), POINTS)[:, :1]
    check(got, np.where(share < 0.5, share, 1 - share))


def test_defaults_of_the_definitions():
    check(value_of("ND_ln_float", "float"), 0 * ALL)
    check(value_of("ND_ln_float", "float", "float inputs:in = 3"), np.log(3) * ALL)
    check(
        value_of("ND_ifequal_float", "float", connect("float", "in1", "U"), connect("float", "in2", "V")), U
    )


def mix(a, b, x):
    return a + (b - a) * x


COLOR = ("color3f inputs:{} = (0.2, 0.4, 0.9)", np.array([0.2, 0.4, 0.9]))
OTHER = ("color3f inputs:{} = (0.7, 0.1, 0.3)", np.array([0.7, 0.1, 0.3]))
WITH_ALPHA = ("color4f inputs:{} = (0.6, 0.3, 0.1, 0.4)", np.array([0.6, 0.3, 0.1, 0.4]))
LUMA = np.array([0.2722287, 0.6740818, 0.0536895])


def hue_shifted(color, amount, s_factor=0.5, v_factor=0.75):
    h, s, v = colorsys.rgb_to_hsv(*color)
    return colorsys.hsv_to_rgb((h + amount) % 1.0, s * s_factor, v * v_factor)


def corrected(color):
    """hue 0.1, saturation 0.5, gamma 2, lift 0.25, gain 1.5, contrast 0.5 about 0.25, exposure 1."""
    color = np.array(hue_shifted(color, 0.1, 1.0, 1.0))
    color = mix(color @ LUMA, color, 0.5) ** 0.5
    color = (color * 0.75 + 0.25) * 1.5
    return ((color - 0.25) * 0.5 + 0.25) * 2.0


CORRECTION = [
    "float inputs:hue = 0.1",
    "float inputs:saturation = 0.5",
    "float inputs:gamma = 2",
    "float inputs:lift = 0.25",
    "float inputs:gain = 1.5",
    "float inputs:contrast = 0.5",
    "float inputs:contrastpivot = 0.25",
    "float inputs:exposure = 1",
]

CHOICE = [
    connect("float", "value1", "U"),
    "float inputs:value2 = 0.5",
    "float inputs:in1 = 1",
    connect("float", "in2", "V"),
]

SHAPES = {
    "mix_color3": (
        [COLOR[0].format("bg"), OTHER[0].format("fg"), connect("float", "mix", "U")],
        mix(COLOR[1], OTHER[1], U[:, None]),
    ),
    "clamp_float": (
        [connect("float", "in", "U"), "float inputs:low = 0.3", "float inputs:high = 0.6"],
        np.clip(U, 0.3, 0.6),
    ),
    "remap_float": (
        [
            connect("float", "in", "U"),
            "float inputs:inlow = 0.1",
            "float inputs:outlow = 2",
            "float inputs:outhigh = 3",
        ],
        2 + (U - 0.1) / 0.9,
    ),
    "range_float": (
        [
            connect("float", "in", "U"),
            "float inputs:gamma = 2",
            "float inputs:outhigh = 3",
            "bool inputs:doclamp = 1",
        ],
        np.clip(3 * U**0.5, 0, 3),
    ),
    "smoothstep_float": (
        [connect("float", "in", "U"), "float inputs:low = 0.2", "float inputs:high = 0.7"],
        (lambda x: x * x * (3 - 2 * x))(np.clip((U - 0.2) / 0.5, 0, 1)),
    ),
    "contrast_float": ([connect("float", "in", "U"), "float inputs:amount = 0.5"], (U - 0.5) * 0.5 + 0.5),
    "ifgreater_float": (CHOICE, np.where(U > 0.5, 1, V)),
    "ifgreatereq_float": (CHOICE, np.where(U >= 0.5, 1, V)),
    "ifequal_float": (CHOICE, np.where(U == 0.5, 1, V)),
    "ifgreater_boolean": (CHOICE[:2], U > 0.5),
    "ifgreatereq_boolean": (CHOICE[:2], U >= 0.5),
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
    "combine2_vector2": (
        [connect("float", "in1", "V"), connect("float", "in2", "U")],
        np.stack([V, U], axis=1),
    ),
    "combine3_color3": (
        [connect("float", "in1", "V"), "float inputs:in2 = 0.5", connect("float", "in3", "U")],
        np.stack([V, 0.5 * ALL, U], axis=1),
    ),
    "combine4_color4": (
        [connect("float", f"in{i}", name) for i, name in enumerate("VUVU", 1)],
        np.stack([V, U, V, U], axis=1),
    ),
    "combine2_color4CF": (
        [connect("color3f", "in1", "C"), connect("float", "in2", "U")],
        np.concatenate([C, U[:, None]], axis=1),
    ),
    "combine2_vector4VV": (
        [connect("float2", "in1", "ST"), "float2 inputs:in2 = (0.25, 0.5)"],
        np.stack([U, V, 0.25 * ALL, 0.5 * ALL], axis=1),
    ),
    "convert_float_color3": ([connect("float", "in", "U")], np.stack([U] * 3, axis=1)),
    "convert_float_color4": ([connect("float", "in", "U")], np.stack([U] * 4, axis=1)),
    "convert_vector2_vector3": ([connect("float2", "in", "ST")], np.stack([U, V, 0 * U], axis=1)),
    "convert_color3_color4": ([connect("color3f", "in", "C")], np.concatenate([C, ALL[:, None]], axis=1)),
    "convert_color4_color3": ([connect("color4f", "in", "Q")], Q[:, :3]),
    "swizzle_vector2_vector3": (
        [connect("float2", "in", "ST"), 'string inputs:channels = "y0x"'],
        np.stack([V, 0 * V, U], axis=1),
    ),
    "swizzle_color4_color4": (
        [connect("color4f", "in", "Q"), 'string inputs:channels = "abr1"'],
        np.stack([V, 0.5 * ALL, U, ALL], axis=1),
    ),
    "luminance_color3": ([connect("color3f", "in", "C")], np.stack([C @ LUMA] * 3, axis=1)),
    "luminance_color4": (
        [connect("color4f", "in", "Q"), "color3f inputs:lumacoeffs = (0.5, 0.25, 0.25)"],
        np.stack([*[Q[:, :3] @ [0.5, 0.25, 0.25]] * 3, V], axis=1),
    ),
    "saturate_color3": (
        [COLOR[0].format("in"), connect("float", "amount", "U")],
        mix(COLOR[1] @ LUMA, COLOR[1], U[:, None]),
    ),
    "hsvadjust_color3": (
        [COLOR[0].format("in"), connect("float3", "amount", "A")],
        np.array([hue_shifted(COLOR[1], u) for u in U]),
    ),
    "rgbtohsv_color3": ([connect("color3f", "in", "C")], np.array([colorsys.rgb_to_hsv(*c) for c in C])),
    "hsvtorgb_color3": ([connect("color3f", "in", "C")], np.array([colorsys.hsv_to_rgb(*c) for c in C])),
    "colorcorrect_color3": (
        [connect("color3f", "in", "C"), *CORRECTION],
        np.array([corrected(c) for c in C]),
    ),
    "colorcorrect_color4": (
        [connect("color4f", "in", "Q"), *CORRECTION],
        np.array([[*corrected(q[:3]), q[3]] for q in Q]),
    ),
    "switch_color3": (
        [COLOR[0].format("in1"), OTHER[0].format("in2"), connect("float", "which", "W")],
        np.where((U * 1.5 < 1)[:, None], COLOR[1], OTHER[1]),
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
    "premult_color4": (
        [connect("color4f", "in", "Q")],
        np.stack([*(Q[:, i] * V for i in range(3)), V], axis=1),
    ),
    "unpremult_color4": (
        [connect("color4f", "in", "Q")],
        np.stack([*(Q[:, i] / V for i in range(3)), V], axis=1),
    ),
    "inside_color3": ([connect("color3f", "in", "C"), connect("float", "mask", "V")], C * V[:, None]),
    "outside_color3": ([connect("color3f", "in", "C"), connect("float", "mask", "V")], C * (1 - V[:, None])),
}


def result_of(name: str) -> str:
    """The type that a node gives."""
    words = name.split("_")
    if words[0] in ("magnitude", "distance", "dotproduct"):
        return "float"
    return words[-1].removesuffix("CF").removesuffix("VV")


@pytest.mark.parametrize("name", SHAPES)
def test_shaping_nodes(name):
    lines, wanted = SHAPES[name]
    check(value_of(f"ND_{name}", result_of(name), *lines), wanted)


@pytest.mark.parametrize(
    ("identifier", "source", "outputs"),
    [
        ("separate2_vector2", "ST", {"outx": U, "outy": V}),
        ("separate3_color3", "C", {"outr": C[:, 0], "outg": C[:, 1], "outb": C[:, 2]}),
        ("separate3_vector3", "A", {"outx": A[:, 0], "outz": A[:, 2]}),
        ("separate4_color4", "Q", {"outr": Q[:, 0], "outb": Q[:, 2], "outa": Q[:, 3]}),
    ],
)
def test_separate(identifier, source, outputs):
    for output, wanted in outputs.items():
        kind = TYPES[identifier.split("_")[1]]
        got = value_of(f"ND_{identifier}", "float", connect(kind, "in", source), output=output)
        check(got, wanted)


@pytest.mark.parametrize("which", [-3.0, 0.0, 0.99, 1.0, 4.5, 9.0, 10.0, 12.0])
def test_switches(which):
    """Below 1 the first, negative or not; from 10 on, and where there is no input, zero."""
    inputs = [f"float inputs:in{i} = {i}" for i in (1, 2, 5, 10)]
    place = int(np.floor(max(which, 0.0))) + 1
    wanted = place if place in (1, 2, 5, 10) else 0
    check(value_of("ND_switch_float", "float", *inputs, f"float inputs:which = {which}"), wanted * ALL)


LOGIC = {
    "logical_and": np.logical_and(U > 0.3, V > 0.3),
    "logical_or": np.logical_or(U > 0.3, V > 0.3),
    "logical_xor": np.logical_xor(U > 0.3, V > 0.3),
}


@pytest.mark.parametrize("name", LOGIC)
def test_logic(name):
    above = "".join(
        shader(
            f"{source}B",
            "ND_ifgreater_boolean",
            connect("float", "value1", source),
            "float inputs:value2 = 0.3",
            "bool outputs:out",
        )
        for source in "UV"
    )
    node = shader(
        "B",
        f"ND_{name}",
        connect("bool", "in1", "UB"),
        connect("bool", "in2", "VB"),
        "bool outputs:out",
    ) + shader("M", "ND_logical_not", connect("bool", "in", "B"), "bool outputs:out")
    for source, wanted in (("B", LOGIC[name]), ("M", ~LOGIC[name])):
        number = shader("N", "ND_convert_boolean_float", connect("bool", "in", source), "float outputs:out")
        got = looked_up(glowing(HELPERS + above + node + number, "N.outputs:out"), POINTS)
        check(got[:, :1], wanted)


# Two colours.

BLENDS = {
    "plus": lambda b, f: b + f,
    "minus": lambda b, f: b - f,
    "difference": lambda b, f: abs(b - f),
    "burn": lambda b, f: 1 - (1 - b) / f,
    "dodge": lambda b, f: b / (1 - f),
    "screen": lambda b, f: 1 - (1 - f) * (1 - b),
    "overlay": lambda b, f: np.where(b < 0.5, 2 * f * b, 1 - 2 * (1 - f) * (1 - b)),
}


@pytest.mark.parametrize("name", BLENDS)
def test_blends(name):
    back = np.array([0.95, 0.4, 0.9])
    lines = ["color3f inputs:bg = (0.95, 0.4, 0.9)", connect("color3f", "fg", "C")]
    check(value_of(f"ND_{name}_color3", "color3", *lines), BLENDS[name](back, C))
    mixed = mix(back, BLENDS[name](back, C), V[:, None])
    check(value_of(f"ND_{name}_color3", "color3", *lines, connect("float", "mix", "V")), mixed)


@pytest.mark.parametrize(("name", "front"), [("burn", 0), ("dodge", 1)])
def test_blends_that_divide_by_zero_give_zero(name, front):
    lines = ["float inputs:bg = 0.5", f"float inputs:fg = {front}", connect("float", "mix", "U")]
    check(value_of(f"ND_{name}_float", "float", *lines), 0 * ALL)


def disjoint(b, f):
    total = f[:, 3:] + b[3]
    color = np.where(total <= 1, f[:, :3] + b[:3], f[:, :3] + b[:3] * (1 - f[:, 3:]) / b[3])
    return np.concatenate([color, np.minimum(total, 1)], axis=1)


def matte(b, f):
    a = f[:, 3:]
    return np.concatenate([f[:, :3] * a + b[:3] * (1 - a), a + b[3] * (1 - a)], axis=1)


MERGES = {
    "in": lambda b, f: f * b[3],
    "out": lambda b, f: f * (1 - b[3]),
    "mask": lambda b, f: b * f[:, 3:],
    "over": lambda b, f: f + b * (1 - f[:, 3:]),
    "matte": matte,
    "disjointover": disjoint,
}


@pytest.mark.parametrize("name", MERGES)
def test_merges(name):
    lines = [WITH_ALPHA[0].format("bg"), connect("color4f", "fg", "Q")]
    back = WITH_ALPHA[1]
    check(value_of(f"ND_{name}_color4", "color4", *lines), MERGES[name](back, Q))
    mixed = mix(back, MERGES[name](back, Q), U[:, None])
    check(value_of(f"ND_{name}_color4", "color4", *lines, connect("float", "mix", "U")), mixed)


def test_without_alpha_nothing_is_divided():
    color = "color4f inputs:in = (0.5, 0.25, 0.125, 0)"
    check(value_of("ND_unpremult_color4", "color4", color), np.array([[0.5, 0.25, 0.125, 0]] * 3))
    lines = ["color4f inputs:bg = (0.5, 0.5, 0.5, 0)", "color4f inputs:fg = (0.5, 0.5, 0.5, 1.5)"]
    check(value_of("ND_disjointover_color4", "color4", *lines), np.array([[0, 0, 0, 1]] * 3))


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


# Primvars.


def test_geompropvalue():
    text = shader("N", "ND_geompropvalue_color3", 'string inputs:geomprop = "mine"', "color3f outputs:out")
    got = looked_up(
        glowing(text, "N.outputs:out"), [(0, 0), (0, 0)], primvar("mine", "color3f", [(1, 2, 3), (4, 5, 6)])
    )
    np.testing.assert_allclose(got, [[1, 2, 3], [4, 5, 6]])


def test_geomcolor(flat):
    text = shader("N", "ND_geomcolor_color3", "color3f outputs:out")
    colors = primvar("displayColor", "color3f", [(0.25, 0.5, 0.75), (1, 0.5, 0)])
    np.testing.assert_allclose(
        looked_up(glowing(text, "N.outputs:out"), [(0, 0), (0, 0)], colors), [[0.25, 0.5, 0.75], [1, 0.5, 0]]
    )
    second = shader("N", "ND_geomcolor_color3", "int inputs:index = 1", "color3f outputs:out")
    ((_, message),) = flat(glowing(second, "N.outputs:out") + quads(2, colors)).warnings
    assert "ND_geomcolor_color3" in message and "only its index 0, displayColor, is read" in message


# What is not there.


NOT_THERE = {
    "ND_geompropvalueuniform_string": "only numbers and vectors can drive an input",
    "ND_checkerboard_color3": "it is not supported",
    "ND_fractal3d_color3": "it is not supported",
    "ND_position_vector3": "it is not supported",
    "ND_transformpoint_vector3": "it is not supported",
    "ND_invertmatrix_matrix33": "it is not supported",
    "ND_frame_float": "it is not supported",
    "ND_reflect_vector3": "its normal is that of the surface, which networks do not know",
    "ND_ramp": "its type is 7",
}


@pytest.mark.parametrize("identifier", NOT_THERE)
def test_what_is_not_read_is_said(flat, identifier):
    lines = ['string inputs:geomprop = "mine"', "int inputs:type = 7"]
    node = shader("N", identifier, *lines, "color3f outputs:out")
    ((prim, message),) = flat(glowing(node, "N.outputs:out") + quads(1, "")).warnings
    assert prim == "/Look/S"
    assert message == (
        f"inputs:emissiveColor: node '{identifier}' at /Look/N: {NOT_THERE[identifier]}; the default is used"
    )


@pytest.mark.parametrize(("above", "below"), [(1, 0), (0, 0), (1e38, 1e-9)])
def test_what_is_not_finite_is_said(flat, above, below):
    """It would be no number in the core's words, and cost the picture."""
    lines = [f"float inputs:in1 = {above}", f"float inputs:in2 = {below}", "float outputs:out"]
    node = shader("D", "ND_divide_float", *lines) + shader(
        "N", "ND_add_float", connect("float", "in1", "U"), connect("float", "in2", "D"), "float outputs:out"
    )
    ((_, message),) = flat(glowing(HELPERS + node, "N.outputs:out") + quads(1, "")).warnings
    assert message == (
        "inputs:emissiveColor: node 'ND_add_float' at /Look/N: what is constant of it is not finite; "
        "the default is used"
    )


def test_constant_vectors_are_divided_by_one_another():
    """0 / 0 in the lane that a vector has not is nothing to stumble over."""
    lines = ["vector3f inputs:in1 = (1, 2, 3)", "vector3f inputs:in2 = (4, 4, 8)"]
    node = shader("D", "ND_divide_vector3", *lines, "vector3f outputs:out")
    sums = [connect("vector3f", "in1", "A"), connect("vector3f", "in2", "D")]
    text = HELPERS + node + shader("N", "ND_add_vector3", *sums, "vector3f outputs:out")
    check(looked_up(glowing(text, "N.outputs:out"), POINTS), A + np.array([0.25, 0.5, 0.375]))


def test_matrices_that_nodes_drive_are_said(flat):
    node = shader("M", "ND_creatematrix_vector3_matrix33", "matrix3d outputs:out") + shader(
        "N", "ND_transformmatrix_vector3", connect("matrix3d", "mat", "M"), "vector3f outputs:out"
    )
    ((_, message),) = flat(glowing(node, "N.outputs:out") + quads(1, "")).warnings
    assert "node 'ND_transformmatrix_vector3' at /Look/N: inputs:mat is driven by a node" in message


def test_every_node_has_a_test():
    """Of numbers and vectors; images, primvar readers and normal maps are in test_textures, hair in test_hair."""
    text = Path(__file__).read_text()
    elsewhere = {"image", "tiledimage", "constant", *USD_NODES}
    left = {name for name in HANDLERS if not name.startswith(("chiang_", "deon_"))} - elsewhere
    assert sorted(name for name in left if f'"{name}' not in text and f"ND_{name}" not in text) == []
