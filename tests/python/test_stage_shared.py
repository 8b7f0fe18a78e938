"""The four production rigs of ../shared in every look; skipped where they are absent."""

import pytest

from dermis.stage import encode, flatten, open_stage

RIGS = ["backlit_bunny", "card_skull", "creature_spot", "envmap_dragon"]
SHADERS = {
    "preview_surface": "UsdPreviewSurface",
    "openpbr": "ND_open_pbr_surface_surfaceshader",
    "openpbr_transmission": "ND_open_pbr_surface_surfaceshader",
    "standard_surface": "ND_standard_surface_surfaceshader",
}


@pytest.mark.parametrize("rig", RIGS)
def test_every_look(shared_scenes, rig):
    stage = open_stage(shared_scenes / f"{rig}.usda")
    looks = stage.GetPrimAtPath("/World").GetVariantSet("look")
    assert looks.GetVariantNames()
    for look in looks.GetVariantNames():
        looks.SetVariantSelection(look)
        flat = flatten(stage)
        subject = flat.prims["/World/Subject/Geom"]
        assert subject["type"] == "Mesh" and subject["material"] == "/World/Looks/SSS"
        assert flat.prims["/World/Looks/SSS"]["shader"] == SHADERS[look]
        assert flat.prims[flat.settings["camera"]]["type"] == "Camera"
        assert {"alpha", "depth", "normal"} <= set(flat.settings["aovs"])
        assert any(prim["type"] == "Light" for prim in flat.prims.values())
        assert all("only /Render/Products/beauty is rendered" in message for _, message in flat.warnings)
        for prim in flat.prims.values():
            encode(prim)


def test_triangle_counts_are_those_of_the_card(shared_scenes):
    counts = {}
    for rig in RIGS:
        prims = flatten(open_stage(shared_scenes / f"{rig}.usda")).prims.values()
        meshes = [prim for prim in prims if prim["type"] == "Mesh"]
        counts[rig] = sum(int((mesh["faceVertexCounts"] - 2).sum()) for mesh in meshes)
    assert counts == {
        "backlit_bunny": 59664,
        "card_skull": 100006,
        "creature_spot": 23062,
        "envmap_dragon": 100000,
    }


def test_turntable_turns(shared_scenes):
    stage = open_stage(shared_scenes / "envmap_dragon.usda")
    first, third = (flatten(stage, time).prims["/World/Turntable/Cam"]["transform"] for time in (1, 3))
    # 90 degrees about +Y: z becomes x.
    assert third[3][0] == pytest.approx(first[3][2]) and third[3][2] == pytest.approx(-first[3][0])


def test_sky_is_decoded(shared_scenes):
    pytest.importorskip("OpenImageIO")
    prims = flatten(open_stage(shared_scenes / "envmap_dragon.usda")).prims
    sky = prims[prims["/World/Lights/Sky"]["shape"]["texture"]]
    assert sky["pixels"].shape == (sky["width"] * sky["height"], 3) == (512 * 256, 3)
    assert sky["pixels"].max() == 9000.0
    # Row 0 is the top: the sun stands in the upper half.
    assert sky["pixels"].max(axis=1).argmax() < 512 * 128
