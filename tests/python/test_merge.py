"""`dermis merge`: tiles and sample ranges against the render of the whole."""

import json

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, DOME, WAX, channels, read_exr, run, stage_text

#: Means of samples, apart from the last bits; compared with the scale of the channel.
ROUNDING = 2e-6


@pytest.fixture
def stage(tmp_path):
    moved = CARD.replace("Card", "Near").replace("0)]", "3)]").replace("(-1, -1, 0)", "(0, 0, 3)")
    (tmp_path / "stage.usda").write_text(stage_text(CARD, moved, CAMERA, DOME, WAX))
    return tmp_path / "stage.usda"


AOVS = [
    word
    for aov in (
        "depth",
        "normal",
        "primId",
        "direct",
        "subsurface",
        "variance",
        "sampleCount",
        "cryptoObject",
    )
    for word in ("--aov", aov)
]
FLAGS = ("-w", "24", "--walk", "classical", *AOVS)


def test_tiles_are_the_whole_bit_for_bit(stage, tmp_path):
    flags = (*FLAGS, "--samples", "4", "--imageHeight", "17")
    tiles = [tmp_path / f"t{i}.exr" for i in range(6)]
    for i, tile in enumerate(tiles):
        assert run("record", stage, tile, *flags, "--tileCount", "3", "2", "--tileIndex", i) == 0
    windows = [read_exr(tile)[0] for tile in tiles]
    assert sum(spec.width * spec.height for spec in windows) == 24 * 17
    assert (windows[0].x, windows[0].y, windows[5].x, windows[5].y) == (0, 0, 16, 8)
    assert run("merge", *tiles, "-o", tmp_path / "merged.exr") == 0
    assert run("record", stage, tmp_path / "whole.exr", *flags) == 0
    merged, whole = channels(tmp_path / "merged.exr"), channels(tmp_path / "whole.exr")
    assert merged.keys() == whole.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(merged[name], values, err_msg=name)
    one, other = read_exr(tmp_path / "merged.exr")[0], read_exr(tmp_path / "whole.exr")[0]
    assert (one.x, one.y, one.width, one.height, one.full_width) == (0, 0, 24, 17, 24)
    for name in ("dermis:fingerprint", "dermis:samples", "dermis:seed", "dermis:sampleOffset"):
        assert one.getattribute(name) == other.getattribute(name), name
    manifests = [
        [a.value for a in spec.extra_attribs if a.name.endswith("/manifest")] for spec in (one, other)
    ]
    assert manifests[0] == manifests[1] and len(manifests[0]) == 1


def test_sample_ranges_are_weighted_by_their_samples(stage, tmp_path):
    parts = [(0, 3), (3, 8), (11, 5)]
    for i, (offset, count) in enumerate(parts):
        flags = ("--samples", str(count), "--sampleOffset", str(offset))
        assert run("record", stage, tmp_path / f"p{i}.exr", *FLAGS, *flags) == 0
    assert run("merge", *(tmp_path / f"p{i}.exr" for i in range(3)), "-o", tmp_path / "merged.exr") == 0
    assert run("record", stage, tmp_path / "whole.exr", *FLAGS, "--samples", "16") == 0
    merged, whole = channels(tmp_path / "merged.exr"), channels(tmp_path / "whole.exr")
    assert merged.keys() == whole.keys()
    for name, values in whole.items():
        # What belongs to the nearest sample, counts and ids are exact; means differ in the last bits.
        if name.startswith(("depth", "normal", "primId", "sampleCount", "crypto")):
            bits = (merged[name].view(np.uint32), values.view(np.uint32))
            np.testing.assert_array_equal(*bits, err_msg=name)
        else:
            # Variances are rounded in the files, and small differences of large numbers.
            tolerance = 1e-4 if name.startswith("variance") else ROUNDING
            np.testing.assert_allclose(
                merged[name], values, atol=tolerance * np.abs(values).max(), err_msg=name
            )
    assert read_exr(tmp_path / "merged.exr")[0].getattribute("dermis:samples") == 16
    # Not the plain mean of the three.
    plain = np.mean([channels(tmp_path / f"p{i}.exr")["R"] for i in range(3)], axis=0)
    assert np.abs(plain - whole["R"]).max() > 100.0 * ROUNDING * whole["R"].max()
    # Merging goes on with what was merged.
    assert run("record", stage, tmp_path / "p3.exr", *FLAGS, "--samples", "4", "--sampleOffset", "16") == 0
    assert run("merge", tmp_path / "merged.exr", tmp_path / "p3.exr", "-o", tmp_path / "more.exr") == 0
    assert read_exr(tmp_path / "more.exr")[0].getattribute("dermis:samples") == 20


def test_overlapping_tiles_of_different_samples(stage, tmp_path):
    left, right = (
        ("--crop", "0", "0", "0.625", "1"),
        ("--crop", "0.375", "0", "1", "1", "--sampleOffset", "2"),
    )
    assert run("record", stage, tmp_path / "a.exr", *FLAGS, *left, "--samples", "2") == 0
    assert run("record", stage, tmp_path / "b.exr", *FLAGS, *right, "--samples", "6") == 0
    assert run("merge", tmp_path / "a.exr", tmp_path / "b.exr", "-o", tmp_path / "m.exr") == 0
    a, b, merged = (channels(tmp_path / f"{name}.exr") for name in "abm")
    assert merged["sampleCount.count"][0].tolist() == [2] * 9 + [8] * 6 + [6] * 9
    np.testing.assert_array_equal(merged["R"][:, :9], a["R"][:, :9])
    np.testing.assert_array_equal(merged["R"][:, 15:], b["R"][:, 6:])
    expected = (2.0 * a["R"][:, 9:] + 6.0 * b["R"][:, :6]) / 8.0
    np.testing.assert_allclose(merged["R"][:, 9:15], expected, rtol=1e-6)
    assert read_exr(tmp_path / "m.exr")[0].getattribute("dermis:samples") is None


def test_what_does_not_belong_together_is_refused(stage, tmp_path, capsys):
    def part(name: str, *flags: str) -> str:
        assert (
            run("record", stage, tmp_path / name, "-w", "8", "--walk", "classical", "--aov", "depth", *flags)
            == 0
        )
        capsys.readouterr()
        return str(tmp_path / name)

    def refused(*parts: str) -> str:
        assert run("merge", *parts, "-o", tmp_path / "m.exr") == 1
        assert not (tmp_path / "m.exr").exists()
        return capsys.readouterr().err

    one = part("one.exr", "--samples", "4")
    assert "it has samples 2 to 3 in common" in refused(
        one, part("two.exr", "--samples", "4", "--sampleOffset", "2")
    )
    assert "scene or settings are not those" in refused(
        one, part("deep.exr", "--maxDepth", "1", "--sampleOffset", "9")
    )
    stage.write_text(stage.read_text().replace("intensity = 1", "intensity = 2"))
    assert "scene or settings are not those" in refused(one, part("lit.exr", "--sampleOffset", "9"))
    assert "it cannot be read" in refused(one, str(tmp_path / "none.exr"))
    assert run("merge", one, tmp_path / "two.exr", "-o", tmp_path / "m.exr", "--force") == 0
    assert run("merge", one, one, "-o", tmp_path / "m.png") == 2


@pytest.mark.parametrize("moved", ["material", "light"])
def test_where_images_lie_does_not_matter_but_what_is_in_them(tmp_path, capsys, moved):
    """One stage with its images beside it in several folders, as farms mount it: parts go together, unless a picture
    is another."""
    oiio = pytest.importorskip("OpenImageIO")
    look = """
    def Material "Look"
    {
        token outputs:surface.connect = </World/Look/S.outputs:surface>
        def Shader "S"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Look/T.outputs:rgb>
            token outputs:surface
        }
        def Shader "T"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./a.exr@
            float3 outputs:rgb
        }
    }
"""
    card = CARD.replace('"Card"', '"Card" (prepend apiSchemas = ["MaterialBindingAPI"])')
    card = card.replace(
        "int[] faceVertexCounts", "rel material:binding = </World/Look>\n int[] faceVertexCounts"
    )
    sky = DOME.replace("float inputs", "asset inputs:texture:file = @./b.exr@\n float inputs")
    text = stage_text(card, look, CAMERA, sky)

    def part(folder: str, first: int, **values: float) -> str:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "s.usda").write_text(text)
        for name in ("a", "b"):
            image = oiio.ImageBuf(oiio.ImageSpec(4, 2, 3, oiio.FLOAT))
            oiio.ImageBufAlgo.fill(image, (values.get(name, 0.5), 0.5, 0.25))
            assert image.write(str(tmp_path / folder / f"{name}.exr"))
        out = tmp_path / folder / "out.exr"
        flags = ("-w", "8", "--samples", "4", "--sampleOffset", first)
        assert run("record", tmp_path / folder / "s.usda", out, *flags) == 0
        return str(out)

    one, two = part("z_one", 0), part("another_two", 4)
    changed = part("three", 8, **{"a" if moved == "material" else "b": 0.625})
    assert run("merge", one, two, "-o", tmp_path / "m.exr") == 0
    capsys.readouterr()
    assert run("merge", one, changed, "-o", tmp_path / "n.exr") == 1
    assert "scene or settings are not those" in capsys.readouterr().err


def test_other_seeds_are_other_samples(stage, tmp_path):
    for seed in "12":
        flags = ("-w", "8", "--samples", "4", "--seed", seed)
        assert run("record", stage, tmp_path / f"{seed}.exr", *flags) == 0
    assert run("merge", tmp_path / "1.exr", tmp_path / "2.exr", "-o", tmp_path / "m.exr") == 0
    one, two, merged = (channels(tmp_path / f"{name}.exr") for name in "12m")
    np.testing.assert_allclose(merged["G"], 0.5 * (one["G"].astype(float) + two["G"]), rtol=1e-6)
    nearer = np.where(one["depth.Z"] <= two["depth.Z"], one["normal.X"], two["normal.X"])
    np.testing.assert_array_equal(merged["normal.X"], nearer)


def test_holes_are_reported(stage, tmp_path, capsys):
    for i in (0, 3):
        flags = ("-w", "8", "--samples", "1", "--tileCount", "2", "2", "--tileIndex", str(i))
        assert run("record", stage, tmp_path / f"{i}.exr", *flags) == 0
    assert run("merge", tmp_path / "0.exr", tmp_path / "3.exr", "-o", tmp_path / "m.exr") == 1
    assert "32 of 64 pixels are in none of the parts" in capsys.readouterr().err
    assert channels(tmp_path / "m.exr")["R"].shape == (8, 8)


def test_layers_of_products_keep_their_meaning(tmp_path):
    outside = """def RenderSettings "S"
{
    rel products = [</P>]
}
def RenderProduct "P"
{
    rel orderedVars = [</beauty>, </near>]
}
def RenderVar "beauty"
{
    uniform string sourceName = "Ci"
}
def RenderVar "near"
{
    uniform string sourceName = "z"
}
"""
    text = stage_text(CARD, CAMERA, DOME, metadata='renderSettingsPrimPath = "/S"', outside=outside)
    (tmp_path / "s.usda").write_text(text)
    for offset in "04":
        flags = ("-w", "8", "--samples", "4", "--sampleOffset", offset)
        assert run("record", tmp_path / "s.usda", tmp_path / f"{offset}.exr", *flags) == 0
    assert run("merge", tmp_path / "0.exr", tmp_path / "4.exr", "-o", tmp_path / "m.exr") == 0
    depth = channels(tmp_path / "m.exr")["near.Z"]
    # A mean with the distance of nothing would lie between.
    assert set(np.unique(np.round(depth, 3))) == {np.float32(10.0), np.float32(1e30)}
    layers = json.loads(read_exr(tmp_path / "m.exr")[0].getattribute("dermis:layers"))
    assert layers == {"": "color", "near": "depth"}


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--tileCount", "2", "2"), "--tileCount and --tileIndex go together"),
        (("--tileIndex", "0"), "--tileCount and --tileIndex go together"),
        (("--tileCount", "2", "2", "--tileIndex", "4"), "the last of 2 x 2 is 3"),
    ],
)
def test_tiles_that_are_not_there(stage, tmp_path, capsys, flags, said):
    assert run("record", stage, tmp_path / "a.exr", *flags) == 2
    assert said in capsys.readouterr().err
