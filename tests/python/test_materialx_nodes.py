"""Numbers, conditions, channels and primvars of MaterialX's nodes against its specification's formulas in numpy;
what is not read."""

from __future__ import annotations

from pathlib import Path

import materialx_values
import numpy as np
import pytest
from looked_up import connect, glowing, looked_up, primvar, quads, shader
from materialx_values import (
    ALL,
    COLOR,
    HELPERS,
    OTHER,
    POINTS,
    TYPES,
    A,
    C,
    Q,
    U,
    V,
    check,
    result_of,
    value_of,
)

from dermis.graph import handlers
from dermis.usd_nodes import USD_NODES

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


CHOICE = [
    connect("float", "value1", "U"),
    "float inputs:value2 = 0.5",
    "float inputs:in1 = 1",
    connect("float", "in2", "V"),
]

SHAPES = {
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
    "ifgreater_float": (CHOICE, np.where(U > 0.5, 1, V)),
    "ifgreatereq_float": (CHOICE, np.where(U >= 0.5, 1, V)),
    "ifequal_float": (CHOICE, np.where(U == 0.5, 1, V)),
    "ifgreater_boolean": (CHOICE[:2], U > 0.5),
    "ifgreatereq_boolean": (CHOICE[:2], U >= 0.5),
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
    "switch_color3": (
        [COLOR[0].format("in1"), OTHER[0].format("in2"), connect("float", "which", "W")],
        np.where((U * 1.5 < 1)[:, None], COLOR[1], OTHER[1]),
    ),
}


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
    files = [*Path(__file__).parent.glob("test_materialx_*.py"), Path(materialx_values.__file__)]
    text = "".join(file.read_text() for file in files)
    elsewhere = {"image", "tiledimage", "constant", *USD_NODES}
    left = {name for name in handlers() if not name.startswith(("chiang_", "deon_"))} - elsewhere
    assert sorted(name for name in left if f'"{name}' not in text and f"ND_{name}" not in text) == []
