"""Colours, and one over another, by MaterialX's nodes against its specification's formulas in numpy."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest
from looked_up import connect
from materialx_values import ALL, COLOR, LUMA, OTHER, WITH_ALPHA, C, Q, U, V, check, mix, result_of, value_of


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

SHAPES = {
    "mix_color3": (
        [COLOR[0].format("bg"), OTHER[0].format("fg"), connect("float", "mix", "U")],
        mix(COLOR[1], OTHER[1], U[:, None]),
    ),
    "contrast_float": ([connect("float", "in", "U"), "float inputs:amount = 0.5"], (U - 0.5) * 0.5 + 0.5),
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


@pytest.mark.parametrize("name", SHAPES)
def test_shaping_nodes(name):
    lines, wanted = SHAPES[name]
    check(value_of(f"ND_{name}", result_of(name), *lines), wanted)


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
