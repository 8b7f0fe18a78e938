"""Primvars as layers: of the first surface, filtered as the albedo."""

from __future__ import annotations

import numpy as np
import pytest
from command_line import channels, run
from looked_up import camera, primvar, quads, render, stage_of
from pxr import UsdGeom
from test_instance_primvars import TINTS, instancer, listed

from dermis.hydra import Delegate, DirtyBits, populate
from dermis.stage import Options, flatten

dermis = pytest.importorskip("dermis")


HEATS = [0.25, 3.5, -2.0, 100.0]
BARE = {
    "samples": 4,
    "aovs": ["primvars:tint", "primvars:heat", "primvars:st", "primvars:displayColor", "albedo"],
}


def unbound(text: str) -> str:
    return text.replace("rel material:binding = </Look>", "")


def row() -> str:
    st = [(x, y) for _ in range(4) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return unbound(
        quads(
            4,
            primvar("tint", "color3f", TINTS)
            + "\n"
            + primvar("heat", "float", HEATS)
            + "\n"
            + primvar("st", "texCoord2f", st, "vertex")
            + "\n"
            + primvar("displayColor", "color3f", TINTS),
        )
    )


def said(image: dermis.Image) -> list[str]:
    return [warning["message"] for warning in image.stats["warnings"]]


def test_values_are_those_of_the_mesh():
    image = render(row(), 4, **BARE)
    assert said(image) == []
    np.testing.assert_allclose(image["primvars:tint"][1, 1::3], TINTS, rtol=1e-6)
    np.testing.assert_allclose(image["primvars:displayColor"][1, 1::3], TINTS, rtol=1e-6)
    np.testing.assert_allclose(image["primvars:heat"][1, 1::3, 0], HEATS, rtol=1e-6)


def test_what_varies_is_averaged_by_the_filter():
    """The filter is symmetric: the mean of st over the middle pixel of a quad is that of its middle."""
    image = render(row(), 4, **{**BARE, "samples": 1024})
    np.testing.assert_allclose(image["primvars:st"][1, 1::3, :2], 0.5, atol=2e-3)
    # A quarter of the quad to the left of it: pixels are thirds, and one sixth is the middle of the first.
    wide = render(row(), 4, **{**BARE, "samples": 64, "resolution": [4 * 15, 15]})
    np.testing.assert_allclose(wide["primvars:st"][7, 2:13, 0], (np.arange(2, 13) + 0.5) / 15, atol=5e-3)


def test_what_covers_a_pixel_in_part_counts_in_part():
    image = render(row(), 4, **{**BARE, "samples": 64})
    corner = image["color"][0, 0, 3]
    assert 0.3 < corner < 0.9
    np.testing.assert_allclose(image["primvars:tint"][0, 0], corner * np.array(TINTS[0]), rtol=1e-5)


def test_instances_have_their_own_without_a_material():
    text = unbound(instancer(4, listed("tint", "color3f", TINTS, "vertex")))
    image = render(text, 4, samples=1, aovs=["primvars:tint"])
    np.testing.assert_allclose(image["primvars:tint"][1, 1::3], TINTS, rtol=1e-6)


def test_other_layers_do_not_change():
    with_them, without = render(row(), 4, **BARE), render(row(), 4, **{**BARE, "aovs": ["albedo"]})
    for name in ("color", "albedo"):
        np.testing.assert_array_equal(with_them[name], without[name])
    assert "primvars:tint" not in list(without)


def test_what_no_mesh_has_is_said():
    image = render(row(), 4, samples=1, aovs=["primvars:nothing"])
    assert said(image) == ["aovs: primvars:nothing: no mesh has it; it is black"]
    assert not image["primvars:nothing"].any()


@pytest.mark.parametrize("asked", ["settings of the delegate", "options"])
def test_they_are_there_after_an_edit_of_the_prim(asked):
    """No material reads the primvar: only the AOV asks for it."""
    stage = stage_of(row() + camera(4))
    options = Options(aovs=("primvars:heat",))
    flat = flatten(stage, options=options)
    delegate = Delegate()
    populate(delegate.core, flat)
    delegate.set_settings(camera="/Eye", resolution=[12, 3], samples=1, aovs=["primvars:heat"])
    mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    UsdGeom.PrimvarsAPI(mesh).GetPrimvar("heat").Set([2.0 * heat for heat in HEATS])
    options = options if asked == "options" else None
    delegate.sync(str(mesh.GetPath()), mesh, DirtyBits.PRIMVAR, options=options)
    delegate.commit()
    delegate.start()
    assert delegate.wait(60.0)
    found = delegate.snapshot()["primvars:heat"][1, 1::3, 0]
    np.testing.assert_allclose(found, 2.0 * np.array(HEATS), rtol=1e-6)


def stage_with_vars(folder, *flags: str) -> int:
    variables = {"tint": "color3f", "heat": "float", "st": "texCoord2f"}
    listed_vars = ", ".join(f"</R/{name}>" for name in variables)
    prims = "".join(
        f'    def RenderVar "{name}"\n    {{\n        token dataType = "{kind}"\n'
        f'        string sourceName = "{name}"\n        token sourceType = "primvar"\n    }}\n'
        for name, kind in variables.items()
    )
    settings = (
        'def RenderSettings "R"\n{\n    rel camera = </Eye>\n    rel products = [</R/P>]\n'
        "    int2 resolution = (12, 3)\n"
        f'    def RenderProduct "P"\n    {{\n        token productName = "{folder}/a.exr"\n'
        f"        rel orderedVars = [{listed_vars}]\n    }}\n{prims}}}\n"
    )
    head = '#usda 1.0\n(\n    renderSettingsPrimPath = "/R"\n)\n'
    (folder / "a.usda").write_text(head + row() + camera(4) + settings)
    return run("record", folder / "a.usda", "--samples", "4", *flags)


def test_render_vars_are_layers_with_channels_by_type(tmp_path):
    assert stage_with_vars(tmp_path) == 0
    found = channels(tmp_path / "a.exr")
    assert {"tint.R", "tint.G", "tint.B", "heat.Y", "st.X", "st.Y"} == set(found)
    np.testing.assert_allclose(found["heat.Y"][1, 1::3], HEATS, rtol=1e-6)
    np.testing.assert_allclose(found["tint.G"][1, 1::3], np.array(TINTS)[:, 1], rtol=1e-6)


def test_flags_take_any_primvar(tmp_path):
    assert stage_with_vars(tmp_path) == 0
    stage = tmp_path / "a.usda"
    assert run("record", stage, tmp_path / "b.exr", "--aov", "primvars:heat", "--samples", "1") == 0
    assert {name for name in channels(tmp_path / "b.exr") if "heat" in name} == {
        f"primvars:heat.{c}" for c in "RGB"
    }
    assert run("record", stage, tmp_path / "b.exr", "--aov", "primvars:") == 2


def test_tiles_keep_them(tmp_path):
    assert stage_with_vars(tmp_path) == 0
    whole = channels(tmp_path / "a.exr")
    for i in range(2):
        tile = ["--tileCount", "2", "1", "--tileIndex", str(i), "--samples", "4"]
        assert run("record", tmp_path / "a.usda", tmp_path / f"t{i}.exr", *tile) == 0
    assert run("merge", tmp_path / "t0.exr", tmp_path / "t1.exr", "--output", tmp_path / "m.exr") == 0
    merged = channels(tmp_path / "m.exr")
    assert all(np.array_equal(merged[name], values) for name, values in whole.items())
