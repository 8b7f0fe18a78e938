"""Looks, lights and media of usd_scenes: texels looked up a second time, irradiance by quadrature, light that is
linked, the ways of rays through bodies in bodies; and frames of one of them as a batch."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from command_line import channels, names, run
from lux_quadrature import Light, irradiance
from numpy.typing import NDArray
from own_stages import eye, opened
from pinhole import rays
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade

import dermis
from dermis import stage as stages

oiio = pytest.importorskip("OpenImageIO")


def watched(stage: Usd.Stage, path: str, half: float, at: tuple, turn: tuple) -> str:
    """An orthographic camera below a prim, `half` units to each side."""
    camera = UsdGeom.Camera.Define(stage, f"{path}/Eye")
    camera.CreateProjectionAttr("orthographic")
    camera.CreateHorizontalApertureAttr(20 * half)
    camera.CreateVerticalApertureAttr(20 * half)
    UsdGeom.XformCommonAPI(camera).SetTranslate(at)
    UsdGeom.XformCommonAPI(camera).SetRotate(turn)
    return f"{path}/Eye"


def picture(scenes, name: str) -> NDArray:
    return oiio.ImageBuf(str(scenes / "textures" / name)).get_pixels(oiio.FLOAT)


def texels(image: NDArray, st: NDArray) -> NDArray:
    """Bilinear, repeated; (0, 0) is the lower left corner."""
    height, width = image.shape[:2]
    x, y = st[..., 0] * width - 0.5, (1 - st[..., 1]) * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = (x - i)[..., None], (y - j)[..., None]

    def row(j: NDArray) -> NDArray:
        return image[j % height, i % width] * (1 - u) + image[j % height, (i + 1) % width] * u

    return row(j) * (1 - v) + row(j + 1) * v


# Textures


def of_preview(scenes, st: NDArray) -> NDArray:
    encoded = texels(picture(scenes, "spots.png")[..., :3], st * [4, 2])
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def of_openpbr(_scenes, st: NDArray) -> NDArray:
    """ND_ramptb_color3: `valuet` where t is 1."""
    t = st[..., 1:]
    return t * np.array([0.9, 0.75, 0.3]) + (1 - t) * np.array([0.3, 0.7, 0.6])


def of_standard(scenes, st: NDArray) -> NDArray:
    """Where it is wet, metal of the base colour, else the subsurface colour."""
    wet = texels(picture(scenes, "wet.png")[..., :1], st * [2, 1])
    return wet * np.array([0.9, 0.6, 0.3]) + (1 - wet) * np.array([0.8, 0.5, 0.4])


@pytest.mark.parametrize(
    ("name", "expected"), [("Preview", of_preview), ("OpenPBR", of_openpbr), ("Standard", of_standard)]
)
def test_texels_are_those_of_the_pictures(usd_scenes, name, expected):
    """Albedo of each ball of textures.usda from near, at the texture coordinates that are seen there. Away from the
    seam; filtered over the triangles, so that single pixels differ a little."""
    stage = opened(usd_scenes, "textures", name)
    stage.GetPrimAtPath("/World/Looks").SetActive(True)
    camera = watched(stage, f"/World/{name}", 0.2, (5, 0.1, 0), (0, 90, 0))
    aovs = ["albedo", "primvars:st"]
    image = dermis.render(stage, camera=camera, resolution=(32, 32), samples=1, maxDepth=0, aovs=aovs)
    st = image["primvars:st"][..., :2].astype(float)
    assert np.ptp(st[..., 0]) > 0.05 and np.ptp(st[..., 1]) > 0.1
    known, found = expected(usd_scenes, st), image["albedo"].astype(float)
    assert known.std((0, 1)).max() > 0.01
    assert np.abs(found - known).max() < 0.04 and np.abs(found - known).mean() < 0.015
    share = np.corrcoef(found[..., 0].ravel(), known[..., 0].ravel())[0, 1]
    assert share > 0.96


# Displacement


def test_the_pebble_is_as_high_as_its_picture(usd_scenes):
    """The upper side of displacement.usda's pebble is that without displacement, moved along its normals by 0.12
    times the texel."""
    interpolate = pytest.importorskip("scipy.interpolate")
    stage = opened(usd_scenes, "displacement", "Pebble")
    camera = watched(stage, "/World/Pebble", 0.5, (0, 5, 0), (-90, 0, 0))
    pebble = stage.GetPrimAtPath("/World/Pebble")
    to_pebble = np.linalg.inv(np.array(UsdGeom.XformCache().GetLocalToWorldTransform(pebble)))
    aovs = ["position", "normal", "primvars:st"]

    def surface() -> tuple[NDArray, NDArray, NDArray]:
        image = dermis.render(stage, camera=camera, resolution=(48, 48), samples=1, maxDepth=0, aovs=aovs)
        position, normal, st = (image[aov].reshape(-1, 3).astype(float) for aov in aovs)
        return position @ to_pebble[:3, :3] + to_pebble[3, :3], normal @ to_pebble[:3, :3], st

    moved, _, _ = surface()
    shader = UsdShade.Shader.Get(stage, "/World/Looks/Stone/Surface")
    shader.GetInput("displacement").GetAttr().SetConnections([])
    smooth, normal, st = surface()
    height = 0.12 * texels(picture(usd_scenes, "wet.png")[..., :1], st)
    there = smooth + normal * height
    expected = interpolate.LinearNDInterpolator(there[:, [0, 2]], there[:, 1])(moved[:, [0, 2]])
    inner = np.isfinite(expected) & (np.abs(moved[:, [0, 2]]).max(1) < 0.35)
    assert inner.sum() > 800 and height[inner].std() > 0.03
    assert np.abs(expected - moved[:, 1])[inner].mean() < 0.004
    slope, _ = np.polyfit(expected[inner], moved[inner, 1], 1)
    assert slope == pytest.approx(1.0, abs=0.03)


# Lights


def matte(stage: Usd.Stage, path: str, albedo: float) -> None:
    """A prim without gloss: what it reflects is its irradiance times `albedo` over pi."""
    look = UsdShade.Material.Define(stage, "/Matte")
    shader = UsdShade.Shader.Define(stage, "/Matte/S")
    shader.CreateIdAttr("ND_open_pbr_surface_surfaceshader")
    shader.CreateInput("base_color", Sdf.ValueTypeNames.Color3f).Set((albedo,) * 3)
    shader.CreateInput("specular_weight", Sdf.ValueTypeNames.Float).Set(0.0)
    out = shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
    look.CreateSurfaceOutput("mtlx").ConnectToSource(out)
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(path)).Bind(look)


def light_of(prim: Usd.Prim) -> Light:
    """As the quadrature takes it: authored inputs by UsdLux's names."""
    authored = (a for a in prim.GetAttributes() if a.GetName().startswith("inputs:") and a.IsAuthored())
    values = {a.GetName().removeprefix("inputs:"): a.Get() for a in authored}
    kind, matrix = (
        prim.GetTypeName(),
        np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim)),
    )
    if prim.HasAPI(UsdLux.MeshLightAPI):  # a sphere of that radius, scaled
        kind, values["radius"] = "SphereLight", UsdGeom.Sphere(prim).GetRadiusAttr().Get()
    kind = "DomeLight" if kind == "DomeLight_1" else kind
    return Light(kind, values, matrix, prim.HasAPI(UsdLux.ShapingAPI))


@pytest.mark.parametrize("name", ["Rect", "Disk", "Sphere", "Cylinder", "Mesh", "Distant", "Dome", "Dome1"])
def test_each_light_lights_the_ground_as_its_quadrature_says(usd_scenes, name):
    """lights.usda with one light at a time, and all that it says of it: shaping, temperature, exposure. What is seen
    of the light itself hides ground: those pixels are left out."""
    stage = opened(usd_scenes, "lights", "Ground")
    matte(stage, "/World/Ground", 0.5)
    lights = stage.GetPrimAtPath("/World/Lights")
    for prim in lights.GetAllChildren():
        prim.SetActive(prim.GetName() == name)
    prim = lights.GetChild(name)
    settings = {"resolution": (48, 27), "samples": 256, "maxDepth": 0}
    image = dermis.render(stage, aovs=["normal"], **settings)
    assert image.stats["warnings"] == []
    sight = eye(stage, per_axis=2, size=(48, 27))
    ground = sight.plane(1)
    p = ground.reshape(-1, 3)
    on = (sight.d[..., 1] < 0) & (np.abs(ground[..., [0, 2]]).max(-1) < 15)
    # What is near the light, or before it, is its shape, or too near for the quadrature.
    middle = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))[3, :3]
    away = np.linalg.norm(np.cross(middle - sight.o, sight.d), axis=-1) > 1.6
    free = (on & (away | ("Dome" in name) | (name == "Distant"))).all(0)
    normals = np.tile([0.0, 1.0, 0.0], (len(p), 1))
    received = irradiance(light_of(prim), p, normals, 12).reshape(ground.shape)
    expected = (0.5 / np.pi * sight.mean(np.where(on[..., None], received, 0)))[free]
    found = image.color[..., :3].astype(float)[free]
    assert free.sum() > 150 and expected.max() > 1e-3
    np.testing.assert_allclose(found.sum(0), expected.sum(0), rtol=0.02)
    bright = expected.max(1) > 0.2 * expected.max()
    np.testing.assert_allclose(found[bright], expected[bright], rtol=0.12, atol=0.06 * expected.max())


# Linking


def test_the_lamp_lights_what_it_is_for_and_shadows_are_coloured(usd_scenes):
    """Of linking.usda: without the sky the third ball is black; the shadow of the second hat is the colour of the
    shadow times the light without it; the first hat casts none."""
    size = (160, 80)
    stage = Usd.Stage.Open(str(usd_scenes / "linking.usda"))
    stage.SetEditTarget(stage.GetSessionLayer())
    stage.GetPrimAtPath("/World/Sky").SetActive(False)
    matte(stage, "/World/Ground", 0.4)
    settings = {"resolution": size, "samples": 16, "maxDepth": 0, "camera": "/World/main_cam"}

    def image() -> NDArray:
        return dermis.render(stage, aovs=[], **settings).color[..., :3].astype(float)

    with_shadows = image()
    lamp = stage.GetPrimAtPath("/World/Lamp")
    UsdLux.ShadowAPI(lamp).CreateShadowEnableAttr(False)
    without = image()
    sight = rays(size, 40, 24, (0, 3.2, 15), tilt=-9)
    balls = {x: ~np.isnan(sight.sphere(np.array([x, 1, 0]), 0.95)[..., 0]).any(0) for x in (-3.0, 0.0, 3.0)}
    assert all(ball.sum() > 20 for ball in balls.values())
    assert without[balls[3.0]].max() == 0.0 and with_shadows[balls[3.0]].max() == 0.0
    # In front, on the ground: lit by the inverse square law, from the sphere's middle, whatever is between.
    ground = sight.plane(1)
    near = ((sight.d[..., 1] < 0) & (ground[..., 2] > 3) & (ground[..., 2] < 8)).all(0)
    way = np.array([1.0, 9.0, 5.0]) - ground
    distance2 = (way**2).sum(-1)
    lit = 0.4 * 250 * 0.4**2 * way[..., 1] / distance2**1.5
    expected = sight.mean(np.where(ground[..., 2] > -30, lit, 0))[near]
    assert near.sum() > 200
    found = without[near] / np.array([1, 0.8, 0.55])
    np.testing.assert_allclose(found.mean(0), expected.mean(), rtol=0.01)
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 3, 1), rtol=0.05)
    # Balls under hats, seen from the front: their upper halves look at the lamp through them.
    below = {x: umbra(sight, x) for x in (-3.0, 0.0)}
    assert all(mask.sum() > 5 for mask in below.values())
    ratio = {x: (with_shadows[mask] / without[mask]).mean(0) for x, mask in below.items()}
    np.testing.assert_allclose(ratio[-3.0], 1.0, rtol=0.02)
    np.testing.assert_allclose(ratio[0.0], [0.05, 0.1, 0.4], rtol=0.02)


def umbra(sight, x: float) -> NDArray:
    """Pixels of the ball at x all of whose points see the whole lamp through the hat above."""
    p = sight.sphere(np.array([x, 1.0, 0.0]), 1.0)
    covered = ~np.isnan(p[..., 0])
    for corner in ((-0.4, 0, 0), (0.4, 0, 0), (0, 0, -0.4), (0, 0, 0.4), (0, 0.4, 0), (0, -0.4, 0)):
        way = np.array([1.0, 9.0, 5.0]) + corner - p
        at = p + way * ((2.35 - p[..., 1]) / way[..., 1])[..., None]
        covered &= np.hypot(at[..., 0] - x, at[..., 2]) < 1.15
        covered &= (way * (p - [x, 1.0, 0.0])).sum(-1) > 0.2
    return covered.all(0)


# Bodies in bodies


def clear(stage: Usd.Stage, name: str, ior: float, color: tuple[float, float, float]) -> None:
    """In place of a look of the stage, one that lets through `color` of a unit of way, with its index of refraction."""
    path = f"/World/{name}"
    shader = UsdShade.Shader.Define(stage, f"{path}/Clear")
    shader.CreateIdAttr("ND_open_pbr_surface_surfaceshader")
    inputs = {
        "transmission_weight": 1.0,
        "specular_roughness": 0.0,
        "specular_ior": ior,
        "transmission_depth": 1.0,
    }
    for key, value in inputs.items():
        shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    shader.CreateInput("transmission_color", Sdf.ValueTypeNames.Color3f).Set(color)
    out = shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
    material = UsdShade.Material.Get(stage, path)
    for output in material.GetSurfaceOutputs():
        output.ClearSources()
    material.CreateSurfaceOutput().ClearSources()
    material.CreateSurfaceOutput("mtlx").ConnectToSource(out)


def clear_milk(stage: Usd.Stage, ior: float) -> None:
    """Its priority was that of its look: it goes to the prim."""
    surface = stage.GetPrimAtPath("/World/MilkLook/Surface")
    priority = surface.GetAttribute("inputs:subsurfacePriority").Get()
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/Drink/Milk"))
    primvars.CreatePrimvar("dermis:mediumPriority", Sdf.ValueTypeNames.Int).Set(priority)
    clear(stage, "MilkLook", ior, tuple(INNER))


def passed(stage: Usd.Stage, x: float, y: float) -> NDArray:
    """What a narrow beam along -Z at (x, y) meets of a glowing wall behind everything."""
    wall = UsdGeom.Mesh.Define(stage, "/Wall")
    wall.CreatePointsAttr([(-90, -90, -5), (90, -90, -5), (90, 90, -5), (-90, 90, -5)])
    wall.CreateFaceVertexCountsAttr([4])
    wall.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    wall.CreateSubdivisionSchemeAttr("none")
    look = UsdShade.Material.Define(stage, "/Glow")
    shader = UsdShade.Shader.Define(stage, "/Glow/S")
    shader.CreateIdAttr("UsdPreviewSurface")
    for key, value in (("diffuseColor", (0, 0, 0)), ("emissiveColor", (1, 1, 1))):
        shader.CreateInput(key, Sdf.ValueTypeNames.Color3f).Set(value)
    shader.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.0)
    look.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(wall.GetPrim()).Bind(look)
    UsdGeom.Xform.Define(stage, "/Beam")
    camera = watched(stage, "/Beam", 0.005, (x, y, 20), (0, 0, 0))
    image = dermis.render(stage, camera=camera, resolution=(16, 16), samples=256, maxDepth=12, aovs=[])
    return image.color[..., :3].astype(float).mean((0, 1))


def fresnel(*indices: float) -> float:
    """What passes interfaces at normal incidence once; twice reflected light is absorbed or goes elsewhere."""
    return float(np.prod([1 - ((a - b) / (a + b)) ** 2 for a, b in pairwise(indices)]))


GLASS, INNER = np.array([0.3, 0.8, 0.9]), np.array([0.9, 0.5, 0.7])


def test_glass_wins_over_milk_within_its_wall(usd_scenes):
    """Through the tumbler of nested.usda at half its height: the milk reaches into the wall, 0.945 of 0.89 to 1, and
    the glass of higher priority is there all the same."""
    stage = opened(usd_scenes, "nested", "Drink")
    for name in ("Spoon", "Ice"):
        stage.GetPrimAtPath(f"/World/Drink/{name}").SetActive(False)
    clear(stage, "GlassLook", 1.5, tuple(GLASS))
    clear_milk(stage, 1.35)
    found = passed(stage, -2.6, 1.0)
    stack = fresnel(1, 1.5, 1.35, 1.5, 1)
    np.testing.assert_allclose(found, stack * GLASS**0.22 * INNER**1.78, rtol=0.015)
    # Were the milk the stronger one, its colour would be that of 1.89.
    assert abs(found[1] / (stack * GLASS[1] ** 0.11 * INNER[1] ** 1.89) - 1) > 0.03


def test_ice_wins_over_milk(usd_scenes):
    """A ray through the part of the ice that is under the milk, by slabs of the turned cube."""
    stage = opened(usd_scenes, "nested", "Drink")
    stage.GetPrimAtPath("/World/Drink/Spoon").SetActive(False)
    # Without refraction: the ray is straight, and the glass that tints nothing ends the milk.
    clear(stage, "GlassLook", 1.0, (1, 1, 1))
    clear_milk(stage, 1.0)
    clear(stage, "IceLook", 1.0, tuple(GLASS))
    x, y = -2.9, 1.7
    ice = stage.GetPrimAtPath("/World/Drink/Ice")
    to_ice = np.linalg.inv(np.array(UsdGeom.XformCache().GetLocalToWorldTransform(ice)))
    o, d = np.array([x, y, 20, 1]) @ to_ice, np.array([0, 0, -1, 0]) @ to_ice
    near, far = (-0.31 - o[:3]) / d[:3], (0.31 - o[:3]) / d[:3]
    length = np.maximum(near, far).min() - np.minimum(near, far).max()
    assert length > 0.3
    inner = 0.89 + (0.95 - 0.89) * (y - 1.0) / 0.9
    milk = 2 * np.sqrt(inner**2 - 0.3**2) - length
    expected = GLASS**length * INNER**milk
    np.testing.assert_allclose(passed(stage, x, y), expected, rtol=0.03)


def test_wax_within_glass(usd_scenes):
    """Through the middle of the wax ball of the paperweight: 1.2 of it, the rest of the chord of the glass."""
    stage = opened(usd_scenes, "nested", "Paperweight")
    clear(stage, "GlassLook", 1.5, tuple(GLASS))
    clear(stage, "WaxLook", 1.44, tuple(INNER))
    around = 2 * np.sqrt(1.2**2 - 0.1**2) - 1.2
    expected = fresnel(1, 1.5, 1.44, 1.5, 1) * GLASS**around * INNER**1.2
    np.testing.assert_allclose(passed(stage, 0.3, 1.1), expected, rtol=0.02)


# Frames


def test_frames_of_a_stage_as_a_batch(usd_scenes, tmp_path, monkeypatch, capsys):
    """motion.usda: opened once; a frame that cannot be written fails alone, and the exit code says so; the others are
    what they are alone."""
    opened_stages = []
    open_stage = stages.open_stage
    monkeypatch.setattr(stages, "open_stage", lambda *args: opened_stages.append(args) or open_stage(*args))
    stage, flags = usd_scenes / "motion.usda", ("-w", "32", "--samples", "2", "--maxDepth", "1")
    (tmp_path / "out.2.exr").mkdir()
    assert run("record", stage, tmp_path / "out.#.exr", "-f", "1:3", *flags) == 1
    assert len(opened_stages) == 1
    assert "out.2.exr" in capsys.readouterr().err
    assert names(tmp_path) == ["out.1.exr", "out.2.exr", "out.3.exr"]
    found = {n: channels(tmp_path / f"out.{n}.exr") for n in (1, 3)}
    assert "motionVector.X" in found[1] or any(name.startswith("motionVector") for name in found[1])
    for n in (1, 3):
        assert run("record", stage, tmp_path / "alone.#.exr", "-f", str(n), *flags) == 0
        alone = channels(tmp_path / f"alone.{n}.exr")
        assert alone.keys() == found[n].keys()
        for name, values in alone.items():
            np.testing.assert_array_equal(values, found[n][name], err_msg=name)
    assert np.abs(found[1]["R"] - found[3]["R"]).mean() > 0.01
