"""Primvars of point instancers that have a value for each instance, in materials and as colours."""

from __future__ import annotations

import numpy as np
import pytest
from looked_up import (
    camera,
    glowing,
    images_of_edits,
    middles,
    primvar,
    quads,
    reader,
    render,
    shader,
    stage_of,
)

dermis = pytest.importorskip("dermis")
from dermis.stage import flatten  # noqa: E402

TINTS = [(0.9, 0.1, 0.2), (0.2, 0.8, 0.3), (0.4, 0.3, 0.7), (0.6, 0.6, 0.1)]
TINTED = glowing(reader(varname="tint", kind="float3", fallback="(0.05, 0.5, 0.05)"), "R.outputs:result")


def listed(name: str, kind: str, values: list, interpolation: str) -> str:
    return f'    {kind}[] primvars:{name} = {values} (interpolation = "{interpolation}")\n'


def instancer(count: int, primvars: str, more: str = "", own: str = "") -> str:
    """The square of `quads(1)` at 0, 1, 2, ... along x."""
    return (
        'def PointInstancer "Many"\n{\n    rel prototypes = [</Many/Row>]\n'
        f"    int[] protoIndices = {[0] * count}\n    point3f[] positions = {[(i, 0, 0) for i in range(count)]}\n"
        f"{primvars}{more}    {quads(1, own)}}}\n"
    )


def seen(text: str, count: int) -> np.ndarray:
    return middles(render(text, count), count)


@pytest.mark.parametrize("interpolation", ["vertex", "varying"])
def test_each_instance_has_its_value(interpolation):
    text = TINTED + instancer(4, listed("tint", "color3f", TINTS, interpolation))
    np.testing.assert_allclose(seen(text, 4), TINTS, rtol=1e-6)
    assert flatten(stage_of(text)).warnings == []


def test_indices_and_hidden_instances_are_followed():
    values = (
        listed("tint", "color3f", TINTS[:2], "vertex") + "    int[] primvars:tint:indices = [1, 0, 1, 0]\n"
    )
    text = TINTED + instancer(4, values, more="    int64[] invisibleIds = [1]\n")
    wanted = np.array([TINTS[1], (0, 0, 0), TINTS[1], TINTS[0]])
    np.testing.assert_allclose(seen(text, 4), wanted, rtol=1e-6)


def test_the_instance_wins_over_its_mesh_and_only_where_it_has_a_value():
    own = '    color3f[] primvars:tint = [(0.3, 0.3, 0.3)] (interpolation = "constant")\n'
    for values, wanted in (
        (TINTS, TINTS),
        ([(float("nan"),) * 3, *TINTS[1:]], [(0.3, 0.3, 0.3), *TINTS[1:]]),
    ):
        text = TINTED + instancer(4, listed("tint", "color3f", values, "vertex"), own=own)
        np.testing.assert_allclose(seen(text, 4), wanted, rtol=1e-6)


@pytest.mark.parametrize("interpolation", ["constant", "uniform"])
def test_other_interpolations_are_not_of_instances(interpolation):
    text = TINTED + instancer(2, listed("tint", "color3f", TINTS[:1], interpolation))
    wanted = TINTS[:1] * 2 if interpolation == "constant" else [(0.05, 0.5, 0.05)] * 2
    np.testing.assert_allclose(seen(text, 2), wanted, rtol=1e-6)


def test_a_wrong_number_is_said():
    text = TINTED + instancer(3, listed("tint", "color3f", TINTS[:2], "vertex"))
    ((prim, message),) = flatten(stage_of(text)).warnings
    assert prim == "/Many" and "primvars:tint: 2 values for 3 instances" in message


def test_nested_instancers_hand_down_what_the_inner_ones_lack():
    """Two copies of a row of two: `tint` is of the inner instancer, `shift` of the outer one."""
    added = shader(
        "Sum",
        "ND_add_color3",
        "color3f inputs:in1.connect = </Look/R.outputs:result>",
        "color3f inputs:in2.connect = </Look/S2.outputs:result>",
        "color3f outputs:out",
    )
    nodes = reader(varname="tint", kind="float3") + reader("S2", "shift", "float3") + added
    inner = instancer(2, listed("tint", "color3f", [(0.1, 0.2, 0.3), (0.3, 0.1, 0.0)], "vertex"))
    inner = inner.replace("/Many/", "/Outer/Many/")
    shift = listed("shift", "color3f", [(0.5, 0, 0), (0, 0.5, 0)], "vertex")
    outer = (
        'def PointInstancer "Outer"\n{\n    rel prototypes = [</Outer/Many>]\n    int[] protoIndices = [0, 0]\n'
        f"    point3f[] positions = [(0, 0, 0), (2, 0, 0)]\n{shift}{inner}}}\n"
    )
    wanted = [(0.6, 0.2, 0.3), (0.8, 0.1, 0.0), (0.1, 0.7, 0.3), (0.3, 0.6, 0.0)]
    np.testing.assert_allclose(seen(glowing(nodes, "Sum.outputs:out") + outer, 4), wanted, rtol=1e-6)


def test_display_colors_of_instances_are_those_of_meshes():
    many = instancer(4, listed("displayColor", "color3f", TINTS, "vertex"))
    row = quads(4, primvar("displayColor", "color3f", TINTS))
    # Without a material that is there, displayColor is all there is.
    settings = {"camera": "/Eye", "resolution": [12, 3], "samples": 1, "aovs": ["albedo"]}
    images = [
        dermis.render(stage_of(text.replace("rel material:binding = </Look>", "") + camera(4)), **settings)
        for text in (many, row)
    ]
    np.testing.assert_array_equal(*(image["albedo"] for image in images))
    assert len(np.unique(images[0]["albedo"][1, 1::3], axis=0)) == 4


def test_edits_give_the_image_of_a_fresh_load():
    several = [TINTS, TINTS[::-1], [(float("nan"),) * 3, *TINTS[1:]]]
    texts = [
        TINTED + instancer(4, listed("tint", "color3f", tints, "vertex")) + camera(4) for tints in several
    ]
    seen_before = None
    for _, edited, fresh in images_of_edits(texts, resolution=[12, 3], samples=1, aovs=["primvars:tint"]):
        assert all(np.array_equal(edited[name], fresh[name]) for name in ("color", "primvars:tint"))
        assert not np.array_equal(edited["color"], seen_before)
        seen_before = edited["color"]
