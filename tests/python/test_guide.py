"""Guided walks from the command line: what is refused, what is explained, counted and shown. Renders are tiny."""

import json
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from dermis._core import Delegate
from dermis.aovs import AOVS, GUIDE_AOVS
from dermis.cli import main
from dermis.settings import DERMIS_SETTINGS

#: Settings with an attribute of UsdRenderSettings, or with a prim of their own (RenderVars).
USD_SETTINGS = {
    "camera",
    "resolution",
    "pixelAspectRatio",
    "aspectRatioConformPolicy",
    "dataWindowNDC",
    "disableDepthOfField",
    "disableMotionBlur",
    "renderingColorSpace",
    "aovs",
}

STAGE = """#usda 1.0
(
    upAxis = "Y"
    renderSettingsPrimPath = "/Render/Settings"
)
def Xform "World"
{
    def Material "Wax"
    {
        token outputs:surface.connect = </World/Wax/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:ior = 1
            float inputs:subsurface = 1
            color3f inputs:subsurfaceColor = (0.8, 0.8, 0.8)
            color3f inputs:subsurfaceRadius = (0.1, 0.1, 0.1)
            token outputs:surface
        }
    }
    def Material "Glaze"
    {
        token outputs:surface.connect = </World/Glaze/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            color3f inputs:subsurfaceRadius = (30, 30, 30)
            token outputs:surface
        }
    }
    def Cube "Left" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double size = 1
        double3 xformOp:translate = (-1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        rel material:binding = </World/Wax>
    }
    def Cube "Right" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double size = 1
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        rel material:binding = </World/Wax>
    }
    def Cube "Thin" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double size = 0.4
        double3 xformOp:translate = (0, 1.2, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        rel material:binding = </World/Glaze>
    }
    def DistantLight "Back"
    {
        float inputs:angle = 0
        float inputs:intensity = 3
        double xformOp:rotateY = 180
        uniform token[] xformOpOrder = ["xformOp:rotateY"]
    }
    def Camera "main_cam"
    {
        float horizontalAperture = 20
        float verticalAperture = 20
        float focalLength = 50
        double3 xformOp:translate = (0, 0, 10)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
def Scope "Render"
{
    def RenderSettings "Settings"
    {
        uniform int2 resolution = (24, 24)
        int dermis:samples = 16
    }
}
"""

#: Pixels of the front faces, columns from the left: (rows, columns).
LEFT, RIGHT = (slice(10, 14), slice(4, 7)), (slice(10, 14), slice(17, 20))


@pytest.fixture
def wax(tmp_path) -> str:
    """Two waxen cubes and a thin one, lit from behind alone: the front faces are dark but for what walks through."""
    (tmp_path / "wax.usda").write_text(STAGE)
    return str(tmp_path / "wax.usda")


def run(*arguments: str | Path) -> int:
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as leave:
        return leave.code


def channels(file: Path) -> dict[str, np.ndarray]:
    """Channels by name, ids as integers."""
    oiio = pytest.importorskip("OpenImageIO")
    image = oiio.ImageInput.open(str(file))
    spec = image.spec()
    formats = spec.channelformats or [spec.format] * spec.nchannels
    wanted = [oiio.UINT32 if str(f) == "uint" else oiio.FLOAT for f in formats]
    return {
        name: image.read_image(0, 0, i, i + 1, wanted[i])[..., 0] for i, name in enumerate(spec.channelnames)
    }


def render(stage: str, file: Path, *flags: str, aovs: tuple[str, ...] = GUIDE_AOVS) -> dict[str, np.ndarray]:
    named = [flag for aov in aovs for flag in ("--aov", aov)]
    assert run("record", stage, file, *named, *flags) == 0
    return channels(file)


def vector(pixels: dict[str, np.ndarray], aov: str, names: str = "RGB") -> np.ndarray:
    return np.stack([pixels[f"{aov}.{name}"] for name in names], axis=-1)


def test_settings_of_the_prim_are_those_of_the_core():
    core = json.loads(Delegate().settings())
    assert core.keys() == DERMIS_SETTINGS.keys() | USD_SETTINGS
    assert not DERMIS_SETTINGS.keys() & USD_SETTINGS
    for name, default in DERMIS_SETTINGS.items():
        assert (type(core[name]), core[name]) == (type(default), default), name


def test_default_aovs_are_those_of_the_core():
    assert tuple(json.loads(Delegate().settings())["aovs"]) == AOVS
    for aov in GUIDE_AOVS:
        Delegate().set_settings(json.dumps({"aovs": [aov]}))


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--set", "classicalFraction=1.5"], "classicalFraction is 1.5; give a share from 0 to 1"),
        (["--set", "classicalFraction=-0.1"], "classicalFraction is -0.1; give a share from 0 to 1"),
        (["--walk", "ii", "--walkPdf", "exact"], 'walkPdf is "exact"; give conditional or auto'),
        (["--set", "normals=8"], "normals is 8; give 0 to 7"),
        (["--set", "cacheResolution=1025"], "cacheResolution is 1025; give 0 for automatic, at most 1024"),
        (["--set", "walk=vpg"], 'walk is "vpg"; give auto, classical'),
        (["--set", "firstDistance=long"], 'firstDistance is "long"; give dwivedi, classical'),
        (["--set", "exitLights=some"], 'exitLights is "some"; give auto, one, all, learned'),
        (["--set", "cacheFill=light"], 'cacheFill is "light"; give surface, camera'),
        (["--set", "aovs=slabNormals"], 'aovs is "slabNormals"; give alpha, '),
    ],
)
def test_refused_settings(wax, tmp_path, capsys, flags, said):
    assert run("record", wax, tmp_path / "a.exr", *flags) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "a.exr").exists()


def explained(stage: str, capsys, *flags: str) -> str:
    assert run("explain", stage, *flags) == 0
    return capsys.readouterr().out


def test_explain_names_each_medium_and_its_walk(wax, capsys):
    said = explained(wax, capsys)
    for cube in ("Left", "Right"):
        shared = "neighbouring pixels share its paths"
        assert f"  /World/{cube}: mixture (exact weights): 10 mean free paths across, lit; {shared}\n" in said
    assert "  /World/Thin: classical: 0.01 mean free paths across: most light passes" in said
    assert "  boundary cache: filled from the surface: walks in 2 media choose their slab normals" in said
    assert "  learned shares: walks in 2 media" in said
    assert "  control variates: densities of the techniques in 2 media" in said
    assert "  exit lights: all; 1 lights, and up to 8 are all sampled\n" in said


@pytest.mark.parametrize(
    ("flags", "line", "off"),
    [
        (
            ("--walk", "classical"),
            "/World/Left: classical: walk=classical asked for",
            {"boundary cache", "learned shares", "control variates"},
        ),
        (
            ("--walk", "bono", "--walkPdf", "conditional"),
            "/World/Thin: bono (conditional weights): walk=bono asked for",
            {"learned shares", "control variates"},
        ),
        (("--walk", "bono"), "/World/Thin: bono (exact weights): walk=bono asked for", {"learned shares"}),
        (("--set", "learnShares=false"), "/World/Left: mixture (exact weights)", {"learned shares"}),
        (("--set", "controlVariates=false"), "/World/Left: mixture (exact weights)", {"control variates"}),
        (
            ("--walk", "poe", "--set", "exitLights=one"),
            "exit lights: one; exitLights=one asked for",
            {"boundary cache"},
        ),
        (
            ("--walk", "classical", "--set", "exitLights=learned"),
            "boundary cache: filled from the surface: exits choose their light by what is visible there",
            {"learned shares", "control variates"},
        ),
    ],
)
def test_explain_says_what_is_off(wax, capsys, flags, line, off):
    said = explained(wax, capsys, *flags)
    assert f"  {line}" in said
    lines = said.splitlines()
    off_lines = takewhile(lambda line: line.startswith("  "), lines[lines.index("off:") + 1 :])
    named = {line.split(":")[0].strip() for line in off_lines}
    assert named >= off


@pytest.mark.parametrize(
    ("change", "flags", "why"),
    [
        (
            ("def DistantLight", "over DistantLight"),
            ("--disableCameraLight",),
            "nothing emits light, so there is no light to walk to",
        ),
        (
            ("inputs:intensity = 3", "inputs:intensity = 0"),
            (),
            "nothing emits light, so there is no light to walk to",
        ),
        (
            ("subsurfaceColor = (0.8, 0.8, 0.8)", "subsurfaceColor = (0, 0, 0)"),
            (),
            "it only absorbs, so there is nothing to guide",
        ),
        # Glass, so to say: 10 mean free paths do not pay behind it.
        (
            ("float inputs:ior = 1\n", 'token inputs:subsurfaceBoundary = "dielectric"\n'),
            (),
            "10 mean free paths across behind a dielectric: walks are too short for guiding to pay",
        ),
    ],
)
def test_explain_says_why_a_medium_is_not_guided(wax, tmp_path, capsys, change, flags, why):
    """The thick cubes, which else are; and the record says the same."""
    text = Path(wax).read_text()
    assert change[0] in text
    stage = tmp_path / "changed.usda"
    stage.write_text(text.replace(*change))
    said = explained(str(stage), capsys, *flags)
    assert f"  /World/Left: classical: {why}" in said
    assert "walks in 2 media" not in said
    guide = stats_of(str(stage), tmp_path, "--samples", "1", *flags)
    of_cube = {medium["prim"]: medium for medium in guide["media"]}["/World/Left"]
    assert of_cube["walk"] == "classical" and of_cube["why"].startswith(why)
    assert guide["records"] == guide["regions"] == 0


def stats_of(stage: str, folder: Path, *flags: str) -> dict:
    assert run("record", stage, folder / "a.exr", "--stats", folder / "s.json", *flags) == 0
    return json.loads((folder / "s.json").read_text())["guide"]


def test_stats_of_the_guide(wax, tmp_path):
    # Large regions: control variates are fitted from some hundred walks each.
    guide = stats_of(wax, tmp_path, "--samples", "64", "--set", "cacheResolution=2")
    walks = {medium["prim"]: (medium["walk"], medium["exact"]) for medium in guide["media"]}
    assert walks == {
        "/World/Left": ("mixture", True),
        "/World/Right": ("mixture", True),
        "/World/Thin": ("classical", False),
    }
    assert all(medium["why"] for medium in guide["media"])
    assert 0.0 < guide["training_share"] < 1.0
    assert guide["regions"] > guide["lit_regions"] > 0
    assert guide["regions"] >= guide["walked_regions"] >= guide["control_regions"] > 0
    shares = guide["technique_shares"]
    assert shares.keys() == {"classical", "entry", "clusters"}
    assert sum(shares.values()) == pytest.approx(1.0, abs=1e-4)
    # Lit from behind alone, the camera sees the dark side: light comes from elsewhere than the point of entry.
    assert shares["clusters"] > shares["entry"] > 0.0 and shares["classical"] > 0.05


def test_stats_of_classical_walks(wax, tmp_path):
    guide = stats_of(wax, tmp_path, "--walk", "classical")
    assert {medium["walk"] for medium in guide["media"]} == {"classical"}
    assert guide["technique_shares"] == {"classical": 0.0, "entry": 0.0, "clusters": 0.0}
    assert (guide["regions"], guide["walked_regions"], guide["control_regions"]) == (0, 0, 0)


@pytest.mark.parametrize("flags", [("--walk", "mixture"), ("--walk", "bono", "--walkPdf", "conditional")])
def test_aovs_of_a_body_lit_from_behind(wax, tmp_path, flags):
    pixels = render(wax, tmp_path / "a.exr", *flags)
    normals = vector(pixels, "slabNormal", "XYZ")
    shares = vector(pixels, "techniqueShares")
    background = (0, 0)
    assert pixels["region.id"][background] == 0xFFFF_FFFF
    for aov in ("entryAgreement.Y", "walkLength.Y"):
        assert pixels[aov][background] == 0.0
    for face in (LEFT, RIGHT):
        # The camera looks along -z at faces of normal +z; the light is at the faces of normal -z.
        assert normals[face][..., 2].mean() < -0.2
        assert (np.linalg.norm(normals[face], axis=-1) <= 1.0 + 1e-5).all()
        assert 0.0 <= pixels["entryAgreement.Y"][face].mean() < 0.5
        assert (pixels["walkLength.Y"][face] > 1.0).all()
        np.testing.assert_allclose(shares[face].sum(axis=-1), 1.0, atol=1e-4)
        assert shares[face][..., 2].mean() > 0.5
    left, right = (set(pixels["region.id"][face].ravel().tolist()) for face in (LEFT, RIGHT))
    # Numbers do not repeat over instances.
    assert left and right and not left & right and 0xFFFF_FFFF not in left | right


def test_cached_irradiance_is_that_of_the_light(wax, tmp_path):
    """From the front the light of irradiance 3 meets the faces at normal incidence, and nothing else does."""
    front = Path(wax).read_text().replace("xformOp:rotateY = 180", "xformOp:rotateY = 0")
    (tmp_path / "front.usda").write_text(front)
    for flags in (("--walk", "mixture"), ("--walk", "bono", "--walkPdf", "conditional")):
        pixels = render(str(tmp_path / "front.usda"), tmp_path / "a.exr", *flags)
        for face in (LEFT, RIGHT):
            np.testing.assert_allclose(vector(pixels, "cacheIrradiance")[face], 3.0, rtol=1e-3)
            # The lit face is where its walks start.
            assert vector(pixels, "slabNormal", "XYZ")[face][..., 2].mean() > 0.5
            assert pixels["entryAgreement.Y"][face].mean() > 0.5


@pytest.mark.parametrize("weights", ["conditional", "exact"])
def test_aovs_of_the_point_of_entry(wax, tmp_path, weights):
    pixels = render(wax, tmp_path / "a.exr", "--walk", "poe", "--walkPdf", weights)
    for face in (LEFT, RIGHT):
        assert (pixels["entryAgreement.Y"][face] == 1.0).all()
        np.testing.assert_allclose(
            vector(pixels, "slabNormal", "XYZ")[face], [[[0, 0, 1]] * 3] * 4, atol=1e-5
        )
        np.testing.assert_allclose(vector(pixels, "techniqueShares")[face], [[[0, 1, 0]] * 3] * 4, atol=1e-5)
        # No walk asks for a cache, so there are no regions.
        assert (pixels["region.id"][face] == 0xFFFF_FFFF).all()


def test_aovs_of_classical_walks(wax, tmp_path):
    pixels = render(wax, tmp_path / "a.exr", "--walk", "classical")
    for face in (LEFT, RIGHT):
        assert not vector(pixels, "slabNormal", "XYZ")[face].any()
        assert not pixels["entryAgreement.Y"][face].any()
        np.testing.assert_allclose(vector(pixels, "techniqueShares")[face], [[[1, 0, 0]] * 3] * 4)
        assert (pixels["walkLength.Y"][face] >= 1.0).all()


@pytest.mark.parametrize("walk", ["cp", "ii", "bill"])
def test_aovs_of_walks_whose_normal_comes_late_or_from_directions(wax, tmp_path, walk):
    pixels = render(wax, tmp_path / "a.exr", "--walk", walk, "--walkPdf", "conditional")
    normals = vector(pixels, "slabNormal", "XYZ")
    for face in (LEFT, RIGHT):
        # The closest point of a shallow collision is on the face itself; the light is behind.
        sign = 1.0 if walk == "cp" else -1.0
        assert sign * normals[face][..., 2].mean() > 0.3


def test_looking_changes_nothing(wax, tmp_path):
    looked = render(wax, tmp_path / "a.exr")
    plain = render(wax, tmp_path / "b.exr", aovs=("depth",))
    for name in "RGBA":
        np.testing.assert_array_equal(looked[name], plain[name])
    assert not [name for name in plain if name.split(".")[0] in GUIDE_AOVS]


def test_render_vars_name_the_aovs(wax, tmp_path):
    text = (
        Path(wax)
        .read_text()
        .replace(
            "int dermis:samples = 16",
            "int dermis:samples = 1\nrel products = </Render/Product>",
        )
    )
    render_vars = "".join(
        f'def RenderVar "{aov}" {{\nuniform string sourceName = "{aov}"\n}}\n' for aov in GUIDE_AOVS
    )
    targets = ", ".join(f"</Vars/{aov}>" for aov in GUIDE_AOVS)
    product = f'def RenderProduct "Product" {{\nrel orderedVars = [{targets}]\n}}\n'
    text = text.replace('def RenderSettings "Settings"', product + 'def RenderSettings "Settings"')
    (tmp_path / "vars.usda").write_text(f'{text}\ndef Scope "Vars"\n{{\n{render_vars}}}\n')
    assert run("record", tmp_path / "vars.usda", tmp_path / "a.exr") == 0
    written = {name.split(".")[0] for name in channels(tmp_path / "a.exr") if "." in name}
    assert written == set(GUIDE_AOVS)
