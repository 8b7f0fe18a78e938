"""Other renderers: what they are told, without them; and, where they are installed, the light that they see."""

import json
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import stage_of

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from bench_runs import STAGE as BLOCK

from dermis import hydra
from dermis._core import Delegate, single_scattering_albedo
from dermis.cli import main
from dermis.peers import cycles_export, environments, mitsuba_export
from dermis.peers.appearance import ExportError, medium_of, view_of
from dermis.peers.client import Peer
from dermis.peers.environments import Environment, PeerError
from dermis.peers.flat_file import read_flat
from dermis.peers.geometry import fan, triangles_of
from dermis.stage import FlatStage, flatten

WIDTH, HEIGHT = 64, 48

#: A tilted sheet, and a smaller one that shades it.
SHEETS = """
def Mesh "Sheet" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    point3f[] points = [(-2, -2, 0), (2, -2, 0), (2, 2, 0.5), (-2, 2, 0)]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
    uniform token subdivisionScheme = "none"
    rel material:binding = </Look>
}

def Mesh "Shade" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    point3f[] points = [(-0.3, -0.2, 0.3), (0.5, -0.3, 0.3), (0.2, 0.5, 0.4)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    uniform token subdivisionScheme = "none"
    rel material:binding = </Look>
}

def Material "Look"
{
    token outputs:surface.connect = </Look/Surface.outputs:surface>

    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor = (0.5, 0.5, 0.5)
        float inputs:ior = 1
        float inputs:roughness = 0.05
        token outputs:surface
    }
}

def Camera "Eye"
{
    float horizontalAperture = 20
    float verticalAperture = 20
    float focalLength = 25
    double3 xformOp:translate = (0.3, -0.2, 5)
    float3 xformOp:rotateXYZ = (5, 5, 5)
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
}

def RenderSettings "Settings"
{
    rel camera = </Eye>
    uniform int2 resolution = (64, 48)
}
"""


def placed(
    kind: str, inputs: str, turn: str, place: str = "(0, 0, 0)", api: str = "", scale: str = "(1, 1, 1)"
) -> str:
    return f"""
def {kind} "Lamp" {api}
{{
    {inputs}
    double3 xformOp:translate = {place}
    float3 xformOp:rotateXYZ = {turn}
    float3 xformOp:scale = {scale}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
}}
"""


RECT = "float inputs:width = 2\nfloat inputs:intensity = 3\ncolor3f inputs:color = (1, 0.5, 0.25)"
CONE = "float inputs:shaping:cone:angle = 20\nfloat inputs:shaping:cone:softness = 0.5"
DOME = "float inputs:intensity = 2\nasset inputs:texture:file = @sky.exr@"

LIGHTS = {
    "rect": placed("RectLight", RECT, "(-20, 15, 30)", "(0.5, 1, 2)"),
    "disk": placed(
        "DiskLight",
        "float inputs:radius = 0.8\nfloat inputs:intensity = 3\nbool inputs:normalize = 1",
        "(20, -15, 0)",
        "(-0.5, -1, 2)",
        scale="(1, 1.5, 1)",
    ),
    "cone": placed(
        "DiskLight",
        f"float inputs:radius = 0.1\nfloat inputs:intensity = 300\n{CONE}",
        "(20, -15, 0)",
        "(-0.5, -1, 2)",
        '(prepend apiSchemas = ["ShapingAPI"])',
    ),
    "sphere": placed(
        "SphereLight", "float inputs:radius = 0.4\nfloat inputs:intensity = 3", "(0, 0, 0)", "(1, 1, 1.5)"
    ),
    "distant": placed("DistantLight", "float inputs:intensity = 30\nfloat inputs:angle = 8", "(20, -15, 0)"),
    "dome": placed("DomeLight", DOME, "(20, 50, 10)"),
    "dome of pole Z": placed("DomeLight_1", f'{DOME}\ntoken poleAxis = "Z"', "(20, 50, 10)"),
    "grey dome": placed("DomeLight", "float inputs:intensity = 2", "(0, 0, 0)"),
}


@pytest.fixture(scope="module")
def sky(tmp_path_factory: Any) -> Path:
    """A latlong map without symmetry: dim, with a bright patch."""
    import OpenImageIO as oiio

    pixels = np.full((32, 64, 3), 0.2, dtype=np.float32)
    pixels[4:12, 10:18] = (8.0, 5.0, 3.0)
    pixels[:, 32:] *= (0.5, 1.0, 1.5)
    file = tmp_path_factory.mktemp("sky") / "sky.exr"
    image = oiio.ImageBuf(oiio.ImageSpec(64, 32, 3, oiio.FLOAT))
    image.set_pixels(oiio.ROI(), pixels)
    assert image.write(str(file))
    return file


def lit(light: str, sky: Path) -> FlatStage:
    text = (SHEETS + LIGHTS[light]).replace("sky.exr", str(sky))
    flat = flatten(stage_of(text, 'renderSettingsPrimPath = "/Settings"'))
    assert flat.warnings == []
    return flat


def rendered(flat: FlatStage, **settings: Any) -> dict[str, np.ndarray]:
    delegate = Delegate()
    hydra.populate(delegate, flat)
    delegate.set_settings(json.dumps(settings))
    delegate.commit()
    delegate.start()
    while not delegate.wait(0.1):
        pass
    return delegate.snapshot()


# What they are told.


def close(ours: Any, theirs: Any) -> None:
    """Numbers of the text are written as singles."""
    if isinstance(theirs, (str, type(None))):
        assert ours == theirs
    else:
        np.testing.assert_allclose(np.asarray(ours), np.asarray(theirs), rtol=1e-6)


def test_a_flattened_file_reads_as_it_was_written(tmp_path, sky):
    flat = lit("dome", sky)
    delegate = Delegate()
    hydra.populate(delegate, flat)
    delegate.save(str(tmp_path / "scene.dermis"))
    read = read_flat(tmp_path / "scene.dermis")
    assert read.prims.keys() == flat.prims.keys()
    for path, prim in flat.prims.items():
        for name, value in prim.items():
            # Files leave out what is not there.
            there = value is not None and not (isinstance(value, str) and value == "")
            if there and not isinstance(value, dict):
                close(read.prims[path][name], value)
    assert read.settings["resolution"] == [WIDTH, HEIGHT]
    assert (
        mitsuba_export.export(read, tmp_path).description == mitsuba_export.export(flat, tmp_path).description
    )


def test_a_file_that_is_cut_off_is_refused(tmp_path, sky):
    delegate = Delegate()
    hydra.populate(delegate, lit("rect", sky))
    delegate.save(str(tmp_path / "scene.dermis"))
    (tmp_path / "cut.dermis").write_bytes((tmp_path / "scene.dermis").read_bytes()[:-8])
    with pytest.raises(ValueError, match="not a whole"):
        read_flat(tmp_path / "cut.dermis")


def test_points_are_seen_in_the_pixels_where_the_core_sees_them(sky):
    flat = lit("rect", sky)
    view = view_of(flat)
    seen = rendered(flat, samples=1, aovs=["position", "depth"])
    hits = np.argwhere(seen["depth"][..., 0] < 1e20)
    offsets = np.array(
        [np.array(view.pixel(seen["position"][y, x].astype(float))) - (x + 0.5, y + 0.5) for y, x in hits]
    )
    # One sample, drawn by the filter: within a pixel of the centre, and without bias.
    assert len(hits) > 1000 and np.abs(offsets).max() < 1.01
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=0.05)


def test_both_peers_are_told_the_same_camera(tmp_path, sky):
    flat = lit("rect", sky)
    mitsuba = mitsuba_export.export(flat, tmp_path).description["sensor"]
    cycles = cycles_export.export(flat, tmp_path).description["scene"]["camera"]
    assert math.radians(mitsuba["fov"]) == pytest.approx(cycles["fov_x"])
    turned = np.array(mitsuba["to_world"]["matrix"]) @ mitsuba_export.TURN
    np.testing.assert_allclose(turned, cycles["to_world"])
    np.testing.assert_allclose(np.linalg.det(turned[:3, :3]), 1.0)
    assert (mitsuba["film"]["width"], mitsuba["film"]["height"]) == (WIDTH, HEIGHT)


def test_lights_have_the_power_of_usdlux(tmp_path, sky):
    def told(light: str) -> tuple[dict, dict]:
        flat = lit(light, sky)
        mitsuba = mitsuba_export.export(flat, tmp_path).description["scene"]
        (lamp,) = (fields for name, fields in mitsuba.items() if name.startswith("light"))
        scene = cycles_export.export(flat, tmp_path).description["scene"]
        return lamp, (scene["lights"] or [scene["world"]])[0]

    lamp, other = told("rect")
    assert lamp["emitter"]["radiance"]["value"] == pytest.approx([3.0, 1.5, 0.75])
    assert other["radiance"] == pytest.approx((3.0, 1.5, 0.75)) and other["size"] == pytest.approx([2.0, 1.0])
    lamp, other = told("disk")
    expected = 3.0 / (math.pi * 0.8**2 * 1.5)
    assert lamp["emitter"]["radiance"]["value"] == pytest.approx([expected] * 3)
    assert other["radiance"] == pytest.approx((expected,) * 3) and other["size"] == pytest.approx([1.6, 2.4])
    lamp, other = told("distant")
    facing = 30.0 * math.pi * math.sin(math.radians(4.0)) ** 2
    assert lamp["irradiance"]["value"] == pytest.approx([facing] * 3)
    assert other["irradiance"] == pytest.approx((facing,) * 3)
    lamp, other = told("cone")
    assert lamp["intensity"]["value"] == pytest.approx([300.0 * math.pi * 0.01] * 3)
    assert (lamp["beam_width"], lamp["cutoff_angle"]) == pytest.approx((10.0, 20.0))
    assert other["cone"] == pytest.approx([math.radians(10.0), math.radians(20.0)])
    lamp, other = told("grey dome")
    assert lamp["radiance"]["value"] == [2.0] * 3 and other["radiance"] == (2.0, 2.0, 2.0)


def block(**inputs: Any) -> FlatStage:
    """The block of wax of the bench's tests; `inputs` of its material."""
    stage = stage_of(BLOCK.partition(")")[2])
    flat = flatten(stage)
    flat.settings = {
        "camera": "/World/main_cam",
        "resolution": [16, 16],
    }
    flat.prims["/World/Wax"].update(inputs)
    return flat


def told_body(flat: FlatStage, folder: Path) -> tuple[dict, dict]:
    mitsuba = mitsuba_export.export(flat, folder)
    (body,) = (fields for name, fields in mitsuba.description["scene"].items() if name.startswith("mesh"))
    (mesh,) = cycles_export.export(flat, folder).description["scene"]["meshes"]
    return body, mesh["material"]


def test_media_by_boundary(tmp_path):
    body, other = told_body(block(subsurfaceColor=[0.8, 0.6, 0.4]), tmp_path)
    albedo = single_scattering_albedo([0.8, 0.6, 0.4], 0.0, 1.0, False)
    assert body["bsdf"]["type"] == "principledthin" and body["bsdf"]["diff_trans"] == 2.0
    assert body["interior"]["albedo"]["value"] == pytest.approx(albedo)
    sigma = np.array(body["interior"]["sigma_t"]["value"]) * body["interior"]["scale"]
    np.testing.assert_allclose(sigma, [1 / 0.3, 1 / 0.2, 1 / 0.1], rtol=1e-6)
    assert other["kind"] == "subsurface" and other["color"] == pytest.approx((0.8, 0.6, 0.4))
    np.testing.assert_allclose(other["radius"], 4.0 * math.pi * np.array([0.3, 0.2, 0.1]), rtol=1e-6)

    body, other = told_body(block(subsurfaceBoundary="dielectric", ior=1.4, roughness=0.3), tmp_path)
    assert body["bsdf"]["type"] == "roughdielectric" and body["bsdf"]["alpha"] == pytest.approx(0.09)
    assert other["kind"] == "glass" and (other["ior"], other["roughness"]) == pytest.approx((1.4, 0.3))
    np.testing.assert_allclose(
        np.add(other["absorption"], other["scattering"]), [1 / 0.3, 1 / 0.2, 1 / 0.1], rtol=1e-6
    )

    assert (
        told_body(block(subsurfaceBoundary="dielectric", roughness=0.0), tmp_path)[0]["bsdf"]["type"]
        == "dielectric"
    )
    for boundary, ior in (("indexMatched", 1.5), ("dielectric", 1.0)):
        body, other = told_body(block(subsurfaceBoundary=boundary, ior=ior), tmp_path)
        assert body["bsdf"] == {"type": "null"} and other["kind"] == "volume"


def test_the_setting_wins_over_the_boundary_of_the_material(tmp_path):
    flat = block()
    flat.settings["subsurfaceBoundary"] = "indexMatched"
    assert told_body(flat, tmp_path)[0]["bsdf"] == {"type": "null"}


def test_what_differs_is_said_and_what_does_not_is_not(tmp_path):
    def differences(**inputs: Any) -> list[str]:
        return mitsuba_export.export(block(**inputs), tmp_path).differences

    assert differences(subsurfaceBoundary="indexMatched") == []
    assert differences(subsurfaceBoundary="dielectric", roughness=0.0) == []
    assert differences(subsurfaceBoundary="diffuse", ior=1.0) == []
    assert "specular" in differences(subsurfaceBoundary="diffuse", ior=1.4)[0]
    assert "rough dielectric" in differences(subsurfaceBoundary="dielectric", roughness=0.3)[0]
    smooth = block(subsurfaceBoundary="dielectric", roughness=0.0)
    smooth.prims["/World/Block"]["subdivisionScheme"] = "catmullClark"
    assert "interpolated normals" in mitsuba_export.export(smooth, tmp_path).differences[0]
    mis = mitsuba_export.export_mis(block(subsurfaceBoundary="indexMatched"), tmp_path)
    assert mis.description["scene"]["integrator"]["type"] == "volpathmis" and len(mis.differences) == 1


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"subsurface": 0.5}, "/World/Wax: subsurface 0.5"),
        ({"metallic": 1.0}, "/World/Wax: metallic"),
        ({"shader": "ND_open_pbr_surface_surfaceshader"}, "/World/Wax: shader"),
    ],
)
def test_what_has_no_equivalent_is_refused(tmp_path, inputs, message):
    for export in (mitsuba_export.export, cycles_export.export):
        with pytest.raises(ExportError, match=message):
            export(block(**inputs), tmp_path)


def test_cycles_takes_no_single_scattering_albedo(tmp_path):
    with pytest.raises(ExportError, match="subsurfaceAlbedo"):
        cycles_export.export(block(subsurfaceAlbedo=[0.5, 0.5, 0.5]), tmp_path)
    medium = medium_of({**block().prims["/World/Wax"], **MATERIAL}, "auto")
    assert medium and medium.albedo == (0.5, 0.4, 0.3) and medium.color is None


MATERIAL = {
    "subsurfaceAlbedo": [0.5, 0.4, 0.3],
    "subsurfaceAnisotropy": 0.0,
    "subsurfaceBoundary": "diffuse",
    "ior": 1.5,
}


def test_polygons_become_fans_and_normals_follow_the_corners():
    np.testing.assert_array_equal(fan(np.array([3, 5, 4])), [
        [0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7], [8, 9, 10], [8, 10, 11],
    ])  # fmt: skip
    turned = np.eye(4)
    turned[:3, :3] = np.diag([2.0, 1.0, 1.0])  # stretches, so that normals turn the other way
    mesh = {
        "transform": turned,
        "points": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32),
        "faceVertexCounts": np.array([4]),
        "faceVertexIndices": np.array([0, 1, 2, 3]),
        "orientation": "rightHanded",
        "subdivisionScheme": "none",
    }
    flat = triangles_of(mesh, "/M")
    assert flat.normals is None and flat.corners.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert triangles_of({**mesh, "orientation": "leftHanded"}, "/M").corners.tolist() == [
        [2, 1, 0],
        [3, 2, 0],
    ]
    values = np.array([[1, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 1]], dtype=np.float32)
    corner = triangles_of({**mesh, "normals": {"interpolation": "faceVarying", "values": values}}, "/M")
    assert corner.points.shape == (6, 3)
    assert corner.smooth and not flat.smooth
    same = np.tile(np.array([[0, 0, 1]], dtype=np.float32), (4, 1))
    assert not triangles_of({**mesh, "normals": {"interpolation": "vertex", "values": same}}, "/M").smooth
    np.testing.assert_allclose(corner.normals[0], np.array([1, 0, 2]) / math.sqrt(5.0), rtol=1e-6)
    np.testing.assert_allclose(corner.normals[5], np.array([0, 1, 1]) / math.sqrt(2.0), rtol=1e-6)


# Environments and processes.


def test_a_peer_that_is_not_installed_says_how_to_install_it(tmp_path):
    with pytest.raises(PeerError, match="dermis peers install cycles"):
        environments.find("cycles", tmp_path)


def test_a_broken_installation_is_named(tmp_path):
    (tmp_path / "mitsuba").mkdir()
    (tmp_path / "mitsuba" / "peer.json").write_text('{"name": "mitsuba", "python": "/nowhere/python"}')
    with pytest.raises(PeerError, match="/nowhere/python is gone"):
        environments.find("mitsuba", tmp_path)
    (tmp_path / "mitsuba" / "peer.json").write_text("{")
    with pytest.raises(PeerError, match="peer.json"):
        environments.find("mitsuba", tmp_path)


def test_a_worker_that_dies_says_its_last_words(tmp_path, sky):
    """This interpreter has no Mitsuba, or no such variant: either way the worker ends."""
    made = Environment("mitsuba", sys.executable, ["no_such_variant"])
    (tmp_path / "mitsuba").mkdir()
    (tmp_path / "mitsuba" / "peer.json").write_text(json.dumps(made.__dict__))
    with Peer("mitsuba", tmp_path) as peer, pytest.raises(PeerError, match="mitsuba ended: .*Error"):
        peer.load(lit("rect", sky), 1)


def test_the_command_refuses_what_it_does_not_know(capsys):
    for arguments in (["install"], ["install", "arnold"], ["remove"]):
        with pytest.raises(SystemExit) as leave:
            main(["peers", *arguments])
        assert leave.value.code == 2
    assert "mitsuba, cycles" in capsys.readouterr().err


def test_peers_of_a_suite_do_not_choose_its_reference(tmp_path):
    from bench_runs import suite_of

    described = suite_of("a.usda", "--methods", "mixture", "--peers", "mitsuba,cycles", "--samples", 2)
    assert [(method.label, method.peer) for method in described.methods] == [
        ("mixture", ""),
        ("mitsuba", "mitsuba"),
        ("cycles", "cycles"),
    ]
    assert described.reference_method.label == "classical" and described.reference_note == ""


def test_a_bench_without_peers_goes_on_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("DERMIS_PEERS", str(tmp_path / "none"))
    (tmp_path / "block.usda").write_text(BLOCK)
    flags = [
        "-w",
        "16",
        "--samples",
        "2",
        "--seeds",
        "1",
        "--referenceSamples",
        "16",
        "--numbersOnly",
        "--quiet",
    ]
    arguments = ["--methods", "classical", "--peers", "mitsuba,cycles", "--out", str(tmp_path / "out")]
    assert main(["bench", str(tmp_path / "block.usda"), *arguments, *flags]) == 0
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [row["method"] for row in found["rows"]] == ["classical"]
    assert found["suite"]["baseline"] == "classical"
    assert len(found["peers"]["absent"]) == 2 and "dermis peers install" in found["peers"]["absent"][0]


# Where they are installed.


@pytest.fixture(scope="module", params=["mitsuba", "mitsuba-mis", "cycles"])
def peer(request: Any) -> Iterator[Peer]:
    try:
        started = Peer(request.param)
    except PeerError as error:
        pytest.skip(str(error))
    with started:
        yield started


@pytest.mark.parametrize("light", LIGHTS)
def test_light_is_where_dermis_sees_it(peer, light, sky):
    flat = lit(light, sky)
    ours = rendered(flat, samples=128)["color"][..., :3].astype(float)
    peer.load(flat, 1)
    theirs = peer.render(128, 1, (0, 0, WIDTH, HEIGHT)).image
    # A point stands for Mitsuba's light with a cone.
    loose = 0.06 if light == "cone" and "mitsuba" in peer.name else 0.01
    np.testing.assert_allclose(theirs.mean((0, 1)), ours.mean((0, 1)), rtol=loose)
    # Over blocks of 8: a mirrored or turned light would be off by much more.
    blocks = [image.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).mean((1, 3)) for image in (theirs, ours)]
    assert np.abs(blocks[0] - blocks[1]).max() < (0.15 if loose > 0.01 else 0.05) * blocks[1].max()


def test_a_crop_is_the_same_part_of_the_picture(peer, sky):
    peer.load(lit("rect", sky), 1)
    whole = peer.render(64, 1, (0, 0, WIDTH, HEIGHT)).image
    part = peer.render(64, 2, (9, 5, 41, 29))
    assert part.image.shape == (24, 32, 3)
    np.testing.assert_allclose(part.image.mean((0, 1)), whole[5:29, 9:41].mean((0, 1)), rtol=0.02)
    assert part.cpu > 0.0 and part.wall > 0.0
    assert peer.samples_in(0.2, (0, 0, WIDTH, HEIGHT)) > 1


def test_the_exposure_of_the_camera_scales_the_picture(peer, sky):
    flat = lit("grey dome", sky)
    window = (20, 10, 40, 30)
    peer.load(flat, 1)
    plain = peer.render(64, 1, window).image
    brighter = {**flat.prims["/Eye"], "exposureScale": 4.0}
    peer.load(replace(flat, prims={**flat.prims, "/Eye": brighter}), 1)
    np.testing.assert_allclose(peer.render(64, 1, window).image.mean(), 4.0 * plain.mean(), rtol=0.02)


def test_a_diffuse_boundary_looks_alike(peer):
    """Lambertian transmission into the same medium for Mitsuba: the very model, specular lobe aside."""
    flat = block(ior=1.0, subsurfaceColor=[0.8, 0.6, 0.4], subsurfaceRadius=[0.2, 0.2, 0.2])
    flat.settings["resolution"] = [32, 32]
    ours = rendered(flat, samples=256)["color"][..., :3].astype(float)
    exported, _ = peer.load(flat, 1)
    theirs = peer.render(256, 1, (0, 0, 32, 32)).image
    assert (exported.differences == []) == (peer.name == "mitsuba")
    ratio = theirs.mean((0, 1)) / ours.mean((0, 1))
    if peer.name == "cycles":
        # Enters refracted, see cycles_export.WALK: darker, the more so the darker the colour.
        assert ((ratio > 0.8) & (ratio < 1.0)).all() and ratio[0] > ratio[1] > ratio[2]
    else:
        np.testing.assert_allclose(ratio, 1.0, atol=0.02)


def test_what_the_peer_refuses_is_its_error(peer, sky):
    peer.load(lit("rect", sky), 1)
    with pytest.raises(PeerError, match=peer.name):
        peer.render(1, 1, (0, 0, 0, 0))
    # It goes on.
    assert peer.render(1, 1, (0, 0, 8, 8)).image.shape == (8, 8, 3)


def test_bench_scores_a_peer_of_another_model_against_itself(peer, tmp_path, monkeypatch):
    (tmp_path / "block.usda").write_text(BLOCK)
    monkeypatch.setenv("DERMIS_PEERS", os.environ.get("DERMIS_PEERS", str(environments.home())))
    flags = [
        "-w",
        "16",
        "--samples",
        "4",
        "--seeds",
        "2",
        "--referenceSamples",
        "64",
        "--numbersOnly",
        "--quiet",
    ]
    arguments = ["--methods", "classical", "--peers", peer.name, "--out", str(tmp_path / "out")]
    assert main(["bench", str(tmp_path / "block.usda"), *arguments, *flags]) == 0
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    row = next(row for row in found["rows"] if row["method"] == peer.name)
    assert row["owner"] == peer.name and row["ratio"]["mean"] > 0.0 and row["samples"]["mean"] == 4
    assert any(f"{peer.name}: block/frame: the model differs" in note for note in found["peers"]["notes"])
    assert list((tmp_path / "out" / "peers").glob("*.ratio.png"))
    # What is complete is taken up.
    assert main(["bench", str(tmp_path / "block.usda"), *arguments, *flags]) == 0
    assert json.loads((tmp_path / "out" / "results.json").read_text())["kept"] == 4
