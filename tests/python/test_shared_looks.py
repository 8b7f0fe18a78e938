"""The four shared stages render in every look, and the looks that describe one medium agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

dermis = pytest.importorskip("dermis")

SCENES = Path(__file__).parents[2] / ".." / "shared" / "scenes"
STAGES = ["backlit_bunny", "card_skull", "creature_spot", "envmap_dragon"]
PRODUCTION = ["preview_surface", "openpbr", "standard_surface"]

pytestmark = pytest.mark.skipif(
    not SCENES.is_dir(), reason=f"{SCENES} is absent: shared stages are not tested"
)


def stage_in_look(name: str, look: str) -> Usd.Stage:
    stage = Usd.Stage.Open(str(SCENES / f"{name}.usda"))
    assert stage.GetPrimAtPath("/World").GetVariantSet("look").SetVariantSelection(look)
    return stage


def looks(name: str) -> list[str]:
    stage = Usd.Stage.Open(str(SCENES / f"{name}.usda"))
    return stage.GetPrimAtPath("/World").GetVariantSet("look").GetVariantNames()


def render(name: str, look: str, samples: int, seed: int, **settings: object) -> dermis.Image:
    return rendered(stage_in_look(name, look), samples, seed, **settings)


def rendered(stage: Usd.Stage, samples: int, seed: int, **settings: object) -> dermis.Image:
    return dermis.render(
        stage,
        resolution=[48, 48],
        samples=samples,
        seed=seed,
        aovs=["variance", "albedo", "position"],
        **settings,
    )


@pytest.mark.parametrize("name", STAGES)
def test_every_look_renders(name: str) -> None:
    for look in looks(name):
        image = render(name, look, samples=4, seed=1)
        assert np.isfinite(image.color).all()
        assert image.color[..., :3].max() > 0.01, look
        assert image.stats["non_finite_samples"] == 0
        assert image.stats["walks"] > 0, look
        assert image.stats["walks_leaked"] <= 1e-4 * image.stats["walks"], look


@pytest.mark.parametrize("name", STAGES)
def test_production_looks_agree(name: str) -> None:
    """preview, openpbr and standard_surface are one medium under one specular lobe: same picture within noise.

    Block means over 8x8 pixels, variances from the AOV; 36 blocks x 3 channels x 2 pairs are 216 z-scores.
    """
    images = [
        render(name, look, samples=48, seed=seed, subsurfaceBoundary="diffuse")
        for seed, look in enumerate(PRODUCTION)
    ]
    blocks = [(block_sum(image.color[..., :3]), block_sum(image["variance"])) for image in images]
    for look, (total, variance) in zip(PRODUCTION[1:], blocks[1:], strict=True):
        z = (total - blocks[0][0]) / np.sqrt(variance + blocks[0][1] + 1e-12)
        assert np.abs(z).max() < 5.5, f"{look} against preview_surface: worst block |z| {np.abs(z).max():.1f}"
        ratio = total.sum((0, 1)) / blocks[0][0].sum((0, 1))
        error = np.sqrt((variance + blocks[0][1]).sum((0, 1))) / total.sum((0, 1))
        assert error.max() < 0.03, f"{look}: the whole picture is too noisy to compare: {error}"
        assert (np.abs(ratio - 1) < 4 * error).all(), (
            f"{look} / preview_surface, whole picture: {ratio} +- {error}"
        )


def block_sum(image: np.ndarray) -> np.ndarray:
    height, width, channels = image.shape
    return image.reshape(height // 8, 8, width // 8, 8, channels).sum((1, 3))


@pytest.mark.parametrize("name", ["backlit_bunny", "envmap_dragon"])
def test_transmission_is_the_medium_of_its_formula(name: str) -> None:
    """OpenPBR 1.1, "Translucent base", also where more than 1 scatters in a depth: the picture of the medium that has
    that mean free path and albedo."""
    stage = stage_in_look(name, "openpbr_transmission")
    color, depth, scatter = (
        np.array(surface(stage, "openpbr_transmission").GetInput(f"transmission_{part}").Get(), float)
        for part in ("color", "depth", "scatter")
    )
    assert scatter.max() > 1
    extinction, scattering = -np.log(color) / depth, scatter / depth
    absorption = extinction - scattering
    absorption -= min(absorption.min(), 0)
    extinction = absorption + scattering
    known = stage_in_look(name, "preview_surface")
    shader = surface(known, "preview_surface")
    shader.GetInput("subsurfaceRadius").Set(Gf.Vec3f(*(1 / extinction)))
    shader.GetInput("subsurfaceScale").Set(1.0)
    albedo = shader.CreateInput("subsurfaceAlbedo", Sdf.ValueTypeNames.Color3f)
    albedo.Set(Gf.Vec3f(*(scattering / extinction)))
    images = [rendered(one, 48, seed) for seed, one in enumerate((stage, known))]
    assert all(image.stats["warnings"] == [] for image in images)
    assert scores(*images).max() < 5.5
    (total, variance), (other, more) = map(sums, images)
    error = np.sqrt((variance + more).sum((0, 1))) / total.sum((0, 1))
    ratio = other.sum((0, 1)) / total.sum((0, 1))
    assert (np.abs(ratio - 1) < 4 * error).all() and error.max() < 0.15, f"{ratio} +- {error}"


# Textured: the colour of what scatters by an image, in each shader's own nodes.

COLORS = ("diffuseColor", "subsurfaceColor", "base_color", "subsurface_color", "transmission_color")


def write_image(file: Path, pixels: np.ndarray) -> Path:
    oiio = pytest.importorskip("OpenImageIO")
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.FLOAT)
    image = oiio.ImageBuf(spec)
    assert image.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels, np.float32)) and image.write(str(file))
    return file


def surface(stage: Usd.Stage, look: str) -> UsdShade.Shader:
    """The shader of what scatters."""
    names = {
        "preview_surface": "Preview",
        "openpbr": "OpenPBR",
        "openpbr_transmission": "OpenPBRTransmission",
        "standard_surface": "StandardSurface",
    }
    return UsdShade.Shader(stage.GetPrimAtPath(f"/World/Looks/SSS/{names[look]}"))


def color_of(stage: Usd.Stage, look: str) -> np.ndarray:
    shader = surface(stage, look)
    return np.array([shader.GetInput(name).Get() for name in COLORS if shader.GetInput(name)][-1])


def textured(name: str, look: str, file: Path) -> Usd.Stage:
    """Its colours are the image's; s runs along x, t along the height, over the whole subject."""
    stage = stage_in_look(name, look)
    shader = surface(stage, look)
    path = shader.GetPath().GetParentPath().AppendChild("Image")
    image = UsdShade.Shader.Define(stage, path)
    if look == "preview_surface":
        image.CreateIdAttr("UsdUVTexture")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(str(file))
        image.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("raw")
        reader = UsdShade.Shader.Define(stage, path.GetParentPath().AppendChild("Coordinates"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        st = image.CreateInput("st", Sdf.ValueTypeNames.Float2)
        st.ConnectToSource(reader.ConnectableAPI(), "result")
        output = image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    else:
        image.CreateIdAttr("ND_image_color3")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(str(file))
        for axis in "uv":
            image.CreateInput(f"{axis}addressmode", Sdf.ValueTypeNames.String).Set("clamp")
        output = image.CreateOutput("out", Sdf.ValueTypeNames.Color3f)
    for color in COLORS:
        if shader.GetInput(color):
            shader.GetInput(color).ConnectToSource(output)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Subject/Geom"))
    points = np.array(mesh.GetPointsAttr().Get())
    up = 2 if UsdGeom.GetStageUpAxis(stage) == "Z" else 1
    st = points[:, [0, up]]
    st = (st - st.min(0)) / np.ptp(st, axis=0)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
    )
    primvar.Set(Vt.Vec2fArray([Gf.Vec2f(float(a), float(b)) for a, b in st]))
    return stage


def sums(image: dermis.Image) -> tuple[np.ndarray, np.ndarray]:
    return block_sum(image.color[..., :3]), block_sum(image["variance"])


def scores(a: dermis.Image, b: dermis.Image) -> np.ndarray:
    (total, variance), (other, more) = sums(a), sums(b)
    return np.abs(total - other) / np.sqrt(variance + more + 1e-12)


@pytest.mark.parametrize("name", STAGES)
def test_an_image_of_one_colour_is_that_colour(name: str, tmp_path: Path) -> None:
    """In every look: the picture of the constant, though another one per point is compiled."""
    for look in looks(name):
        color = color_of(stage_in_look(name, look), look)
        file = write_image(tmp_path / f"{look}.exr", np.broadcast_to(color, (4, 4, 3)))
        plain, image = render(name, look, 16, 1), rendered(textured(name, look, file), 16, 2)
        assert image.stats["warnings"] == plain.stats["warnings"] == [], look
        assert image.stats["needs"]["driven_surfaces"] == 1 and plain.stats["needs"]["driven_surfaces"] == 0
        if look in PRODUCTION:
            seen = [(np.abs(of["albedo"] - color) < 1e-3).all(-1).sum() for of in (plain, image)]
            assert min(seen) > 50, f"{look}: the colour is in {seen} pixels"
        assert scores(plain, image).max() < 5.5, look
        (total, variance), (other, more) = sums(plain), sums(image)
        error = np.sqrt((variance + more).sum((0, 1))) / total.sum((0, 1))
        ratio = other.sum((0, 1)) / total.sum((0, 1))
        assert (np.abs(ratio - 1) < 4 * error).all() and error.max() < 0.2, f"{look}: {ratio} +- {error}"


@pytest.mark.parametrize("name", STAGES)
def test_textured_looks_agree(name: str, tmp_path: Path) -> None:
    """Red below and blue above, hard against each other: one picture in the production looks, and no other."""
    pixels = np.full((8, 8, 3), 0.2)
    pixels[:4, :, 2], pixels[4:, :, 0] = 0.9, 0.9
    file = write_image(tmp_path / "halves.exr", pixels)
    images = [
        rendered(textured(name, look, file), 32, seed, subsurfaceBoundary="diffuse")
        for seed, look in enumerate(PRODUCTION)
    ]
    for look, image in zip(PRODUCTION, images, strict=True):
        assert image.stats["warnings"] == [], look
        assert scores(image, images[0]).max() < 5.5, look
    # Seen: the subject's own halves, by the albedo of what the camera meets.
    albedo, y = images[0]["albedo"], images[0]["position"][..., 2 if name == "backlit_bunny" else 1]
    subject = (np.abs(albedo - 0.2) < 0.05).any(-1) & (albedo.max(-1) > 0.6)
    red = subject & (albedo[..., 0] > albedo[..., 2])
    blue = subject & (albedo[..., 2] > albedo[..., 0])
    assert red.sum() > 30 and blue.sum() > 30
    assert np.median(y[red]) < np.median(y[blue])
