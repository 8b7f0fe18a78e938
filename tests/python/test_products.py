"""RenderProducts, RenderVars and the settings that they share or override: which files come out, with what in them."""

import json

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from command_line import CAMERA, CARD, DOME, channels, names, read_exr, run, stage_text, write_stage

from dermis.products import flatten_products, source_aov
from dermis.reading import Reader, Report
from dermis.settings import included_purposes

METADATA = 'renderSettingsPrimPath = "/Render/S"'


def var(name: str, source: str, kind: str = "raw", data: str = "color3f") -> str:
    return (
        f'def RenderVar "{name}"\n{{\nuniform string sourceName = "{source}"\n'
        f'uniform token sourceType = "{kind}"\nuniform token dataType = "{data}"\n}}\n'
    )


def product(name: str, file: str, variables: str, more: str = "") -> str:
    targets = ", ".join(f"</Render/{v}>" for v in variables.split())
    return f'def RenderProduct "{name}"\n{{\ntoken productName = "{file}"\nrel orderedVars = [{targets}]\n{more}\n}}\n'


VARS = (
    var("beauty", "C.*[LO]", "lpe", "color4f")
    + var("Z", "z", data="float")
    + var("N", "N", data="normal3h")
    + var("sss", "C<TD>.*[LO]", "lpe")
    + var("who", "cryptoObject")
    + var("late", "C<RD>[DS]+[LO]", "lpe")
    + var("any", "C<RD>.+[LO]", "lpe")
)


def settings(*products: str, more: str = "") -> str:
    listed = ", ".join(f"</Render/{text.split(chr(34))[1]}>" for text in products)
    return (
        f'def Scope "Render"\n{{\ndef RenderSettings "S"\n{{\nrel products = [{listed}]\nint dermis:samples = 2\n'
        f"uniform int2 resolution = (16, 8)\n{more}\n}}\n" + "".join(products) + VARS + "}\n"
    )


@pytest.fixture
def stage(tmp_path):
    def write(*products: str, more: str = "", prims: str = "") -> str:
        text = stage_text(
            CARD, CAMERA, DOME, prims, metadata=METADATA, outside=settings(*products, more=more)
        )
        return write_stage(tmp_path / "stage.usda", text)

    return write


def test_several_products_in_one_run(stage, tmp_path, capsys):
    small = "uniform int2 resolution = (6, 6)\nrel camera = </World/other>"
    file = stage(
        product("A", f"{tmp_path}/a.exr", "beauty N"),
        product("B", f"{tmp_path}/deep/b.exr", "Z beauty"),
        product("C", f"{tmp_path}/c.png", "beauty", small),
        prims=CAMERA.replace("main_cam", "other"),
    )
    assert run("record", file, "--stats", tmp_path / "s.json") == 0
    assert names(tmp_path) == ["a.exr", "c.png", "deep", "s.json", "stage.usda"]
    assert list(channels(tmp_path / "a.exr")) == ["R", "G", "B", "A", "N.X", "N.Y", "N.Z"]
    assert list(channels(tmp_path / "deep" / "b.exr")) == ["R", "G", "B", "A", "Z.Z"]
    a, b = channels(tmp_path / "a.exr"), channels(tmp_path / "deep" / "b.exr")
    # One render: the same samples.
    np.testing.assert_array_equal(a["R"], b["R"])
    assert a["R"].shape == (8, 16)
    from PIL import Image

    assert Image.open(tmp_path / "c.png").size == (6, 6)
    # The camera is 10 units away, the card fills the middle.
    assert b["Z.Z"][4, 8] == pytest.approx(10.0)
    assert a["N.Z"][4, 8] == 1.0
    oiio = pytest.importorskip("OpenImageIO")
    spec = oiio.ImageInput.open(str(tmp_path / "a.exr")).spec()
    formats = dict(zip(spec.channelnames, map(str, spec.channelformats), strict=True))
    assert formats["N.X"] == "half" and formats["R"] == "float"
    assert "Camera: /World/main_cam" in capsys.readouterr().out
    # It is the image of a run of its own.
    assert run("record", file, tmp_path / "alone.exr", "--aov", "depth") == 0
    np.testing.assert_array_equal(channels(tmp_path / "alone.exr")["R"], a["R"])


def test_output_takes_the_place_of_the_first_product(stage, tmp_path, capsys):
    file = stage(
        product("A", f"{tmp_path}/a.exr", "beauty"),
        product("B", f"{tmp_path}/b.exr", "Z", "uniform int2 resolution = (4, 4)"),
    )
    assert run("record", file, tmp_path / "mine.exr", "-w", "12") == 0
    said = capsys.readouterr().out
    assert (
        f"OUTPUT overrides productName of </Render/A>: {tmp_path}/mine.exr instead of {tmp_path}/a.exr"
        in said
    )
    assert "Flag overrides resolution of </Render/A>: 12,12 instead of 16,8" in said
    assert "Flag overrides resolution of </Render/B>: 12,12 instead of 4,4" in said
    assert names(tmp_path) == ["b.exr", "mine.exr", "stage.usda"]
    assert channels(tmp_path / "b.exr")["Z.Z"].shape == (12, 12)


def test_typed_aovs_win_over_vars(stage, tmp_path, capsys):
    assert run("record", stage(product("A", "", "beauty N")), tmp_path / "a.exr", "--aov", "primId") == 0
    assert "Flag overrides aovs of </Render/A>: primId instead of normal" in capsys.readouterr().out
    assert list(channels(tmp_path / "a.exr")) == ["R", "G", "B", "A", "primId.id"]


def test_without_output_and_products(stage, tmp_path, capsys):
    assert run("record", stage()) == 2
    assert "the following arguments are required: OUTPUT" in capsys.readouterr().err
    assert run("record", stage(product("A", f"{tmp_path}/a.tif", "beauty"))) == 1
    assert "/Render/A: productName: " in capsys.readouterr().err
    twice = stage(product("A", f"{tmp_path}/a.exr", "beauty"), product("B", f"{tmp_path}/a.exr", "Z"))
    assert run("record", twice) == 1
    assert "is made by another product already" in capsys.readouterr().err


def test_products_of_a_sequence(stage, tmp_path, capsys):
    timed = product("A", "", "beauty").replace(
        'token productName = ""',
        f'token productName.timeSamples = {{1: "{tmp_path}/one.exr", 2: "{tmp_path}/two.exr"}}',
    )
    assert run("record", stage(timed), "-f", "1:2") == 0
    assert run("record", stage(product("A", f"{tmp_path}/marked.##.exr", "beauty")), "-f", "1:2") == 0
    assert names(tmp_path) == ["marked.01.exr", "marked.02.exr", "one.exr", "stage.usda", "two.exr"]
    capsys.readouterr()
    for flags in ((), ("--skipExisting",)):
        (tmp_path / "same.exr").unlink(missing_ok=True)
        same = stage(product("A", f"{tmp_path}/same.exr", "beauty"))
        assert run("record", same, "-f", "1:3", *flags) == 1
        assert capsys.readouterr().err.count("same.exr is that of the frame before, too") == 2


def test_every_frame_of_several_products_has_the_settings_of_each(stage, tmp_path):
    file = stage(
        product("A", f"{tmp_path}/a.#.exr", "beauty"),
        product("B", f"{tmp_path}/b.#.exr", "beauty", "uniform int2 resolution = (6, 4)"),
    )
    assert run("record", file, "-f", "1:3") == 0
    shapes = {name: channels(tmp_path / name)["R"].shape for name in names(tmp_path) if name[1] == "."}
    assert shapes == {
        f"{of}.{n}.exr": size for of, size in (("a", (8, 16)), ("b", (4, 6))) for n in (1, 2, 3)
    }


@pytest.mark.parametrize(
    ("source", "kind", "aov"),
    [
        ("C.*[LO]", "lpe", "color"),
        ("lpe:C.*[<L.>O]", "raw", "color"),
        ("C.?[LO]", "lpe", "direct"),
        ('C<T"subsurface">.*[LO]', "lpe", "subsurface"),
        ("C[LO]", "lpe", "emission"),
        ("lpe:C.[<L.>O]", "raw", "firstBounce"),
        ("Ci", "raw", "color"),
        ("cameraDepth", "raw", "depth"),
        ("deviceDepth", "intrinsic", "deviceDepth"),
        ("Neye", "raw", "Neye"),
        ("C<RS>L", "lpe", "directSpecular"),
        ("C<TS>.*[<L.>O]", "raw", "transmission"),
        ("C[DSV][DSVOB].*", "lpe", "indirect+subsurface"),
        ("diffuse+subsurface", "raw", "diffuse+subsurface"),
        ("C<RS'coat'>L", "lpe", None),
        ("st", "primvar", "primvars:st"),
        ("primvars:st", "raw", "primvars:st"),
        ("motionvector", "raw", "motionVector"),
        ("whatever", "intrinsic", None),
    ],
)
def test_sources(make_stage, source, kind, aov):
    quoted = source.replace('"', "'")
    body = (
        'def RenderSettings "S"\n{\nrel products = [</Render/A>]\n}\ndef Scope "Render"\n{\n'
        + product("A", "a.exr", "v")
        + var("v", quoted, kind)
        + "}\n"
    )
    usd, report = make_stage(body), Report()
    found = flatten_products(usd.GetPrimAtPath("/S"), Reader(1.0, report))
    # A product without a var that can be written has the beauty.
    assert [layer["aov"] for layer in found[0].layers] == [aov or "color"]
    assert len(report.warnings) == (2 if aov is None else 0)


@pytest.mark.parametrize(
    ("name", "source", "kind", "aov", "said"),
    [
        ("diffuse", "diffuse+subsurface", "raw", "diffuse+subsurface", []),
        ("diffuse", "C<RD>.+L", "raw", "indirectDiffuse", []),
        ("diffuse", "C.*<L.'key'>", "raw", "light_key", []),
        ("diffuse", "light_key", "raw", "light_key", []),
        ("diffuse", "z", "raw", "depth", []),
        ("diffuse", "", "raw", "diffuse", []),
        ("diffuse", "elsewhere", "raw", "diffuse", ["'diffuse', as the var is named, is"]),
        ("diffuse", "C<RD[^'skin']>.*L", "lpe", "diffuse", ["its own is written"]),
    ],
)
def test_the_source_of_a_var_counts_before_its_name(make_stage, name, source, kind, aov, said):
    found, report = make_stage(var(name, source, kind)), Report()
    assert source_aov(found.GetPrimAtPath(f"/{name}"), Reader(1.0, report)) == aov
    assert len(report.warnings) == len(said)
    assert all(words in message for words, (_, message) in zip(said, report.warnings, strict=True))


def test_products_rendered_apart_are_skipped_apart(stage, tmp_path, capsys):
    """What a killed run had finished of a frame is not rendered again; the statistics are of the first."""
    small = "uniform int2 resolution = (6, 6)"
    file = stage(product("A", f"{tmp_path}/a.exr", "beauty"), product("B", f"{tmp_path}/b.exr", "Z", small))
    flags = ("record", file, "--skipExisting")
    for missing, done in (("b", "a"), ("a", "b")):
        assert run(*flags) == 0
        before = (tmp_path / f"{done}.exr").stat().st_mtime_ns
        (tmp_path / f"{missing}.exr").unlink()
        capsys.readouterr()
        assert run(*flags) == 0
        assert f"{tmp_path}/{done}.exr is there" in capsys.readouterr().out
        assert (tmp_path / f"{done}.exr").stat().st_mtime_ns == before
        assert channels(tmp_path / f"{missing}.exr")
    before = [(tmp_path / f"{name}.exr").stat().st_mtime_ns for name in "ab"]
    assert run(*flags, "--stats", tmp_path / "s.json") == 0
    after = [(tmp_path / f"{name}.exr").stat().st_mtime_ns for name in "ab"]
    assert after[0] > before[0] and after[1] == before[1]
    assert json.loads((tmp_path / "s.json").read_text())["settings"]["resolution"] == [16, 8]


def test_tiles_of_products_have_files_of_their_own(stage, tmp_path):
    """OUTPUT is typed for each tile; a productName is not."""
    file = stage(product("A", f"{tmp_path}/a.exr", "beauty"), product("B", f"{tmp_path}/b.exr", "Z beauty"))
    assert run("record", file) == 0
    tiles = ("--tileCount", "2", "1", "--tileIndex")
    for index in (0, 1):
        assert run("record", file, tmp_path / f"out{index}.exr", "--skipExisting", *tiles, index) == 0
    found = {"out0.exr", "out1.exr", "b_tile00.exr", "b_tile01.exr"}
    assert {name for name in names(tmp_path) if name.endswith(".exr")} == found | {"a.exr", "b.exr"}
    parts = [tmp_path / f"b_tile0{index}.exr" for index in (0, 1)]
    assert run("merge", *parts, "--output", tmp_path / "whole.exr") == 0
    whole, single = channels(tmp_path / "whole.exr"), channels(tmp_path / "b.exr")
    assert all(np.array_equal(whole[name], single[name]) for name in single)


def layered(make_stage, **expressions):
    """What is said of RenderVars with these expressions in one product."""
    stage = make_stage(
        'def RenderSettings "S"\n{\nrel products = [</P>]\n}\n'
        + "".join(var(name, text, "lpe") for name, text in expressions.items())
        + product("P", "a.exr", " ".join(expressions)).replace("/Render/", "/")
    )
    report = Report()
    flatten_products(stage.GetPrimAtPath("/S"), Reader(0.0, report))
    return report.warnings


def test_glossy_and_mirrors_are_said_to_be_one(make_stage):
    [(prim, both)] = layered(make_stage, gloss="C<RG>.*[LO]", mirror="C<RS>.*[LO]", both="C<R[GS]>.*[LO]")
    assert prim == "/S" and "not kept apart; each of these has the two" in both
    assert both.endswith("'C<RG>.*[LO]' of </gloss>, 'C<RS>.*[LO]' of </mirror>")
    [(_, glass)] = layered(make_stage, rough="C<TG>L", clear="C<TS>L", diffuse="C<RD>.*L")
    assert "'C<TG>L' of </rough>, 'C<TS>L' of </clear>" in glass and "diffuse" not in glass
    [(_, later)] = layered(make_stage, gloss="C<RD>[DG]+L", mirror="C<RD>[DS]+L")
    assert "each of these has the two" in later
    [(_, karma)] = layered(make_stage, gloss="C<RG>L")
    assert karma.endswith("G is the two, as Karma has it, in 'C<RG>L' of </gloss>")
    # RenderMan and Arnold: all that is specular.
    assert layered(make_stage, specular="C<RS>[DS]+[<L.>O]", glass="C<TS>.*", whole="C<.[GS]>.*L") == []


FOG = """
    def Material "Fog"
    {
        token outputs:surface.connect = </World/Fog/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            token inputs:subsurfaceBoundary = "BOUNDARY"
            color3f inputs:subsurfaceRadius = (9, 9, 9)
            color3f inputs:subsurfaceColor = (0.9, 0.9, 0.9)
            token outputs:surface
        }
    }
    def Cube "Body" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        rel material:binding = </World/Fog>
    }
"""


@pytest.mark.parametrize("boundary", ["indexMatched", "diffuse"])
def test_layers_say_what_they_hold_of_fog(boundary, stage, tmp_path, capsys):
    file = stage(
        product("A", f"{tmp_path}/a.exr", "beauty sss late any"),
        prims=FOG.replace("BOUNDARY", boundary),
    )
    assert run("record", file) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "fog" in line]
    if boundary == "diffuse":
        assert said == []
        return
    [sss, late] = said
    assert "/Render/sss: sourceName: 'C<TD>.*[LO]'" in sss and "to the camera is in the layer" in sss
    assert "seen not in it" in sss
    assert "/Render/late" in late and "camera is not in the layer" in late and "seen in it" in late


def test_targets_that_are_not_there_are_said(make_stage):
    stage = make_stage(
        'def RenderSettings "S"\n{\nrel products = [</P>, </Gone>, </v>]\n'
        'uniform token[] includedPurposes = ["render", "renders"]\n}\n'
        + var("v", "N", data="normal")
        + product("P", "a.exr", "v w").replace("/Render/", "/")
    )
    report = Report()
    reader = Reader(0.0, report)
    [made] = flatten_products(stage.GetPrimAtPath("/S"), reader)
    assert [layer["aov"] for layer in made.layers] == ["normal"]
    included_purposes(stage.GetPrimAtPath("/S"), reader)
    assert report.warnings == [
        ("/S", "products: /Gone is not there; it is left out"),
        ("/S", "products: /v is no RenderProduct; it is left out"),
        ("/P", "orderedVars: /w is not there; it is left out"),
        ("/v", "dataType: 'normal' is no type; floats are written"),
        ("/S", "includedPurposes: 'renders' is no purpose; ignored"),
    ]


def test_deep_products_are_dropped_with_a_warning(make_stage):
    body = 'def RenderSettings "S"\n{\nrel products = [</P>]\n}\n'
    body += 'def RenderProduct "P"\n{\ntoken productType = "deepRaster"\n}\n'
    report = Report()
    assert flatten_products(make_stage(body).GetPrimAtPath("/S"), Reader(1.0, report)) == []
    assert report.warnings == [("/P", "productType: 'deepRaster' is not supported; the product is not made")]


def test_cryptomatte_and_ids_have_a_manifest(stage, tmp_path):
    second = CARD.replace("Card", "Second").replace(
        "uniform token",
        'double3 xformOp:translate = (1, 0, 1)\nuniform token[] xformOpOrder = ["xformOp:translate"]\nuniform token',
    )
    file = stage(product("A", f"{tmp_path}/a.exr", "beauty who"), prims=second)
    assert run("record", file, "--samples", "16", "-w", "32", "--imageHeight", "16") == 0
    found = channels(tmp_path / "a.exr")
    oiio = pytest.importorskip("OpenImageIO")
    spec = oiio.ImageInput.open(str(tmp_path / "a.exr")).spec()
    attributes = {a.name: a.value for a in spec.extra_attribs if a.name.startswith("cryptomatte/")}
    assert len(attributes) == 4
    manifest = json.loads(next(value for name, value in attributes.items() if name.endswith("/manifest")))
    assert sorted(manifest) == ["/World/Card", "/World/Second"]
    covered = {name: np.zeros((16, 32)) for name in manifest}
    for identity, coverage in (("00.R", "00.G"), ("00.B", "00.A"), ("01.R", "01.G")):
        bits = found[f"cryptoObject{identity}"].view(np.uint32)
        for name, digest in manifest.items():
            covered[name] += np.where(bits == int(digest, 16), found[f"cryptoObject{coverage}"], 0.0)
    total = sum(covered.values())
    np.testing.assert_allclose(total, found["A"], atol=1e-6)
    assert (covered["/World/Card"] > 0.9).any() and (covered["/World/Second"] > 0.9).any()
    assert (
        run("record", file, tmp_path / "ids.exr", "--aov", "primId", "-w", "32", "--imageHeight", "16") == 0
    )
    ids = channels(tmp_path / "ids.exr")["primId.id"]
    listed = json.loads(read_exr(tmp_path / "ids.exr")[0].getattribute("dermis:primIds"))
    assert listed == ["/World/Card", "/World/Second"]
    assert set(np.unique(ids)) == {0, 1, 0xFFFFFFFF}
    assert (covered[listed[1]][ids == 1] > 0.0).all()


def test_kinds_of_depth(stage, tmp_path):
    kinds = ("depth", "distance", "deviceDepth", "Peye", "Neye", "position")
    flags = [word for kind in kinds for word in ("--aov", kind)]
    assert run("record", stage(), tmp_path / "a.exr", *flags) == 0
    found = channels(tmp_path / "a.exr")
    hit = found["A"] == 1.0
    x, y = found["position.X"][hit], found["position.Y"][hit]
    np.testing.assert_allclose(found["depth.Z"][hit], 10.0, rtol=1e-5)
    np.testing.assert_allclose(found["distance.Z"][hit], np.sqrt(x**2 + y**2 + 100.0), rtol=1e-5)
    # USD's default clipping range is 1 to 1e6.
    np.testing.assert_allclose(found["deviceDepth.Z"][hit], 1e6 * 9.0 / (10.0 * (1e6 - 1.0)), rtol=1e-5)
    np.testing.assert_allclose(found["Peye.Z"][hit], -10.0, rtol=1e-5)
    np.testing.assert_allclose(found["Peye.X"][hit], x, rtol=1e-5)
    np.testing.assert_allclose(found["Neye.Z"][hit], 1.0)
    assert (found["deviceDepth.Z"][found["A"] == 0.0] == 1.0).all()


@pytest.mark.parametrize(
    ("policy", "width"),
    # The camera's aperture is 20 x 20, the image 16 x 8, the card 2 of 4 units wide at that aperture.
    [
        ("expandAperture", 4),
        ("cropAperture", 8),
        ("adjustApertureWidth", 4),
        ("adjustApertureHeight", 8),
        ("adjustPixelAspectRatio", 8),
    ],
)
def test_conform_policies(stage, tmp_path, policy, width):
    file = stage(more=f'uniform token aspectRatioConformPolicy = "{policy}"')
    assert run("record", file, tmp_path / "a.exr", "--samples", "4") == 0
    spec, pixels = read_exr(tmp_path / "a.exr")
    alpha = pixels[..., 3]
    assert alpha[4].sum() == pytest.approx(width, abs=0.3)
    assert spec.getattribute("PixelAspectRatio") == (0.5 if policy == "adjustPixelAspectRatio" else 1.0)


def test_pixel_aspect_ratio(stage, tmp_path):
    assert (
        run(
            "record", stage(more="uniform float pixelAspectRatio = 0.5"), tmp_path / "a.exr", "--samples", "4"
        )
        == 0
    )
    spec, pixels = read_exr(tmp_path / "a.exr")
    # 16 x 8 pixels of aspect 1/2 are square, as is the camera's aperture.
    assert spec.getattribute("PixelAspectRatio") == 0.5
    assert pixels[4, :, 3].sum() == pytest.approx(8.0, abs=0.3)
    assert pixels[:, 8, 3].sum() == pytest.approx(4.0, abs=0.3)


def test_overscan_is_rendered_around_the_same_pixels(stage, tmp_path):
    file = stage(more="uniform float4 dataWindowNDC = (-0.25, -0.5, 1.125, 1.25)")
    assert run("record", file, tmp_path / "a.exr") == 0
    assert run("record", stage(), tmp_path / "b.exr") == 0
    spec, pixels = read_exr(tmp_path / "a.exr")
    assert (spec.x, spec.y, spec.width, spec.height) == (-4, -2, 22, 14)
    assert (spec.full_width, spec.full_height) == (16, 8)
    np.testing.assert_array_equal(pixels[2:10, 4:20], read_exr(tmp_path / "b.exr")[1])


def test_settings_pass_and_namespaced_settings(stage, tmp_path, capsys):
    text = stage_text(
        CARD,
        CAMERA,
        DOME,
        outside=settings(product("A", f"{tmp_path}/a.exr", "beauty"), more="int dermis:seed = 7")
        + 'def RenderPass "Pass"\n{\nrel renderSource = </Render/S>\n}\n',
    )
    (tmp_path / "stage.usda").write_text(text)
    flags = ("-rp", "/Pass", "--stats", tmp_path / "s.json", "--samples", "1")
    assert run("record", tmp_path / "stage.usda", *flags) == 0
    found = json.loads((tmp_path / "s.json").read_text())["settings"]
    assert (found["seed"], found["samples"], found["resolution"]) == (7, 1, [16, 8])
    assert "Flag overrides samples of </Render/A>: 1 instead of 2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("collection", "seen", "said"),
    [
        ("", True, ""),
        ("rel collection:renderVisibility:excludes = </World/Red>", False, ""),
        (
            "uniform bool collection:renderVisibility:includeRoot = 0\n"
            "rel collection:renderVisibility:includes = [</World/Card>, </World/Dome>]",
            False,
            "",
        ),
        ("rel collection:prune:includes = </World/Red>", False, ""),
        (
            "rel collection:cameraVisibility:excludes = </World/Red>",
            True,
            "collection:cameraVisibility: not supported",
        ),
    ],
)
def test_collections_of_a_pass(tmp_path, capsys, collection, seen, said):
    red = CARD.replace("Card", "Red").replace("(1, 1, 1)]", "(1, 0, 0)]").replace(", 0)", ", 1)")
    outside = settings() + f'def RenderPass "Pass"\n{{\nrel renderSource = </Render/S>\n{collection}\n}}\n'
    (tmp_path / "stage.usda").write_text(stage_text(CARD, red, CAMERA, DOME, outside=outside))
    assert run("record", tmp_path / "stage.usda", tmp_path / "a.exr", "-rp", "/Pass") == 0
    assert (read_exr(tmp_path / "a.exr")[1][4, 8, 1] < 0.2) == seen
    assert said in capsys.readouterr().err


PLACED = """
    class Xform "Proto"
    {
        def Plane "Card"
        {
            double width = 0.6
            double length = 0.6
        }
    }
    def Xform "A" (
        instanceable = true
        references = </World/Proto>
    )
    {
        double3 xformOp:translate = (-1, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "B" (
        instanceable = true
        references = </World/Proto>
    )
    {
        double3 xformOp:translate = (1, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def PointInstancer "Points"
    {
        rel prototypes = [</World/Proto>, </World/Points/Own>]
        int[] protoIndices = [0, 1]
        point3f[] positions = [(-1, -1, 0), (1, -1, 0)]
        def Plane "Own"
        {
            double width = 0.6
            double length = 0.6
        }
    }
"""


@pytest.mark.parametrize(
    ("collection", "seen"),
    [
        ("rel collection:renderVisibility:excludes = </World/A>", [0, 1, 1, 1]),
        ("rel collection:renderVisibility:excludes = </World/B>", [1, 0, 1, 1]),
        ("rel collection:renderVisibility:excludes = </World/B/Card>", [1, 0, 1, 1]),
        ("rel collection:renderVisibility:excludes = </World/Points>", [1, 1, 0, 0]),
        ("rel collection:renderVisibility:excludes = </World/Points/Own>", [1, 1, 1, 0]),
        ("rel collection:prune:includes = </World/A>", [0, 1, 1, 1]),
        ("rel collection:prune:includes = [</World/B>, </World/Points>]", [1, 0, 0, 0]),
        (
            'uniform token collection:prune:expansionRule = "explicitOnly"\n'
            "rel collection:prune:includes = [</World/A>, </World/Points>]",
            [0, 1, 0, 0],
        ),
        (
            "uniform bool collection:renderVisibility:includeRoot = 0\n"
            "rel collection:renderVisibility:includes = [</World/A>, </World/Points>, </World/Dome>]",
            [1, 0, 1, 1],
        ),
    ],
)
def test_collections_of_a_pass_tell_instances_apart(tmp_path, collection, seen):
    outside = settings() + f'def RenderPass "Pass"\n{{\nrel renderSource = </Render/S>\n{collection}\n}}\n'
    (tmp_path / "stage.usda").write_text(stage_text(PLACED, CAMERA, DOME, outside=outside))
    flags = ("-rp", "/Pass", "--set", "resolution=16,16")
    assert run("record", tmp_path / "stage.usda", tmp_path / "a.exr", *flags) == 0
    alpha = channels(tmp_path / "a.exr")["A"]
    assert [round(float(alpha[y, x])) for y in (4, 12) for x in (4, 12)] == seen


BOUND = """
def Mesh "Card" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
    %s
}
def Material "All" {}
def Material "Full" {}
def Material "Preview" {}
def RenderSettings "S"
{
    uniform token[] materialBindingPurposes = [%s]
}
"""
ALL, FULL, PREVIEW = (
    "rel material:binding = </All>\n",
    "rel material:binding:full = </Full>\n",
    "rel material:binding:preview = </Preview>\n",
)


@pytest.mark.parametrize(
    ("bindings", "purposes", "material"),
    [
        (ALL + FULL + PREVIEW, '"full", ""', "/Full"),
        (ALL + FULL + PREVIEW, '"preview", "full", ""', "/Preview"),
        (ALL + FULL, '"preview", "full", ""', "/Full"),
        (ALL + FULL, '"preview", ""', "/All"),
        (ALL, '"preview", "full"', ""),
        (ALL + PREVIEW, '""', "/All"),
        (ALL + PREVIEW, '"full", "allPurpose"', "/All"),
    ],
)
def test_material_binding_purposes(flat, bindings, purposes, material):
    found = flat(BOUND % (bindings, purposes), render_settings="/S")
    assert found.prims["/Card"].get("material", "") == material
