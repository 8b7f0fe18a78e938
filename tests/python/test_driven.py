"""Driven inputs of surfaces: the same as constants where they are constant, normals that bend, media by their entry."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from looked_up import camera, primvar, quads, reader, shader, stage_of

dermis = pytest.importorskip("dermis")
oiio = pytest.importorskip("OpenImageIO")

ST = "float2 inputs:st.connect = </Look/R.outputs:result>"


def write(path: Path, texels: np.ndarray) -> Path:
    """A float EXR, rows from the top."""
    texels = np.asarray(texels, np.float32)
    out = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(texels.shape[1], texels.shape[0], texels.shape[2], oiio.FLOAT)
    assert out.open(str(path), spec) and out.write_image(texels), out.geterror()
    out.close()
    return path


def texture(name: str, file: Path, *lines: str, output: str = "rgb") -> str:
    kind = "float3" if output == "rgb" else "float"
    wraps = [f'token inputs:wrap{axis} = "clamp"' for axis in "ST"]
    asset = f"asset inputs:file = @{file}@"
    return shader(name, "UsdUVTexture", asset, ST, *wraps, *lines, f"{kind} outputs:{output}")


def look(inputs: str, nodes: str = "", identifier: str = "UsdPreviewSurface") -> str:
    output = "outputs:surface" if identifier == "UsdPreviewSurface" else "outputs:mtlx:surface"
    surface = shader("S", identifier, *inputs.split(";"), "token outputs:out")
    return (
        f'def Material "Look"\n{{\n    token {output}.connect = </Look/S.outputs:out>\n{surface}{nodes}}}\n'
    )


SKY = 'def DomeLight "Sky"\n{\n    float inputs:intensity = 1\n}\n'


def sun(direction: tuple[float, float, float]) -> str:
    """A distant light from a direction in the xz or yz plane: rows are the images of the axes."""
    z = np.array(direction) / np.linalg.norm(direction)
    x = np.cross([0.3, 1, 0.2], z)
    x /= np.linalg.norm(x)
    rows = [(*row, 0.0) for row in np.stack([x, np.cross(z, x), z]).tolist()]
    matrix = ", ".join(str(tuple(row)) for row in [*rows, (0.0, 0.0, 0.0, 1.0)])
    return (
        'def DistantLight "Sun"\n{\n    float inputs:angle = 0\n    float inputs:intensity = 3\n'
        f"    matrix4d xformOp:transform = ({matrix})\n"
        '    uniform token[] xformOpOrder = ["xformOp:transform"]\n}\n'
    )


def row(text: str, st: list, count: int = 1, **settings: object) -> dermis.Image:
    corners = primvar("st", "texCoord2f", st, "faceVarying")
    settings = {"samples": 4, "resolution": [8 * count, 8], **settings}
    return dermis.render(stage_of(text + quads(count, corners) + camera(count)), camera="/Eye", **settings)


UNIT = [(0, 0), (1, 0), (1, 1), (0, 1)]
MATTE = "color3f inputs:diffuseColor = (0.18, 0.18, 0.18);int inputs:useSpecularWorkflow = 1;"


def shading(text: str, st: list = UNIT, direction: tuple = (0.5, 0.3, 1), **settings: object) -> float:
    return float(row(text + sun(direction), st, **settings).color[4, 4, 0])


# Constant images are constants.

CASES = {
    "UsdPreviewSurface": {
        "diffuseColor": (0.25, 0.5, 0.125),
        "roughness": 0.375,
        "metallic": 0.5,
        "clearcoat": 0.5,
        "clearcoatRoughness": 0.25,
        "opacity": 0.75,
        "ior": 1.375,
        "subsurface": 0.5,
        "subsurfaceColor": (0.75, 0.5, 0.25),
        "subsurfaceRadius": (0.5, 0.25, 0.125),
        "subsurfaceScale": 0.5,
        "subsurfaceAnisotropy": 0.25,
        "subsurfaceAlbedo": (0.875, 0.75, 0.5),
    },
    "ND_open_pbr_surface_surfaceshader": {
        "base_color": (0.25, 0.5, 0.125),
        "specular_roughness": 0.375,
        "specular_weight": 0.5,
        "specular_ior": 1.375,
        "coat_weight": 0.5,
        "coat_roughness": 0.25,
        "subsurface_weight": 0.75,
        "subsurface_color": (0.75, 0.5, 0.25),
        "subsurface_radius": 0.25,
        "subsurface_radius_scale": (1.0, 0.5, 0.25),
        "transmission_weight": 0.5,
        "emission_luminance": 0.25,
        "geometry_opacity": 0.5,
    },
    "ND_standard_surface_surfaceshader": {
        "base_color": (0.25, 0.5, 0.125),
        "specular_roughness": 0.375,
        "metalness": 0.5,
        "subsurface": 0.75,
        "subsurface_color": (0.75, 0.5, 0.25),
        "subsurface_radius": (0.5, 0.25, 0.125),
        "transmission": 0.5,
        "coat": 0.5,
        "opacity": (0.5, 0.5, 0.5),
    },
}
BESIDE = {
    "UsdPreviewSurface": ("subsurface", "color3f inputs:subsurfaceRadius = (0.3, 0.2, 0.1)"),
    "ND_open_pbr_surface_surfaceshader": ("subsurface_weight", "float inputs:subsurface_radius = 0.25"),
    "ND_standard_surface_surfaceshader": ("subsurface", "color3f inputs:subsurface_radius = (0.3, 0.2, 0.1)"),
}
"""What makes a medium of each: its weight, and a radius."""


def beside(identifier: str, name: str) -> str:
    """Inputs that a driven `name` needs to matter."""
    if "ubsurface" not in name and name not in ("ior", "roughness"):
        return ""
    weight, radius = BESIDE[identifier]
    inputs = [f"float inputs:{weight} = 0.5", radius]
    return "".join(";" + text for text in inputs if f"inputs:{name} " not in text)


def ball(bands: int = 12) -> str:
    """A closed sphere with st, radius 0.45 in the middle of the unit square."""
    ring, rows = 2 * bands, bands - 1
    points, st = [], []
    for i in range(1, bands):
        for j in range(ring):
            theta, phi = np.pi * i / bands, 2 * np.pi * j / ring
            p = 0.45 * np.array([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)]) + [
                0.5,
                0.5,
                0,
            ]
            points.append(tuple(p.tolist()))
            st.append((round(j / ring, 6), round(1 - i / bands, 6)))
    points += [(0.5, 0.95, 0.0), (0.5, 0.05, 0.0)]
    st += [(0.5, 1.0), (0.5, 0.0)]
    faces = []
    for i in range(rows - 1):
        for j in range(ring):
            k = (j + 1) % ring
            faces.append([i * ring + j, i * ring + k, (i + 1) * ring + k, (i + 1) * ring + j])
    north, south, last = rows * ring, rows * ring + 1, (rows - 1) * ring
    for j in range(ring):
        k = (j + 1) % ring
        faces += [[north, k, j], [south, last + j, last + k]]
    indices = [i for face in faces for i in face]
    return (
        'def Mesh "Ball" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n{\n    rel material:binding = </Look>\n'
        f"    int[] faceVertexCounts = {[len(f) for f in faces]}\n    int[] faceVertexIndices = {indices}\n"
        f'    point3f[] points = {points}\n    uniform token subdivisionScheme = "none"\n'
        f"{primvar('st', 'texCoord2f', st, 'vertex')}\n}}\n"
    )


def body(text: str, **settings: object) -> dermis.Image:
    settings = {"samples": 4, "resolution": [16, 16], "aovs": ["variance"], **settings}
    return dermis.render(stage_of(text + ball() + SKY + camera(1)), camera="/Eye", **settings)


@pytest.mark.parametrize("identifier", CASES)
def test_constant_images_equal_constants(tmp_path, identifier):
    for name, value in CASES[identifier].items():
        is_color = isinstance(value, tuple)
        texels = np.full((4, 4, 3), value)
        file = write(tmp_path / f"{name}.exr", texels)
        kind, output = ("color3f", "rgb") if is_color else ("float", "g")
        others = beside(identifier, name)
        constant = look(f"{kind} inputs:{name} = {value}{others}", identifier=identifier)
        nodes = reader() + texture("T", file, output=output)
        driven = look(f"{kind} inputs:{name}.connect = </Look/T.outputs:{output}>{others}", nodes, identifier)
        # Paths through driven media are not shared.
        images = [body(text, sharedPaths="off") for text in (constant, driven)]
        assert images[1].stats["needs"]["driven_surfaces"] == 1
        # Anisotropic media that are driven have classical walks: the same expectation, not the same image.
        if name == "subsurfaceAnisotropy":
            images = [body(text, walk="classical") for text in (constant, driven)]
        np.testing.assert_array_equal(images[0].color, images[1].color, err_msg=f"{identifier} {name}")


def test_driven_roughness_is_close_to_each_constant(tmp_path):
    """Its albedo curves come from a grid: the sum of specular and diffuse light in a furnace moves by little."""
    values = [0.05, 0.2, 0.45, 0.8, 1.0]
    file = write(tmp_path / "r.exr", np.array(values)[None, :, None].repeat(3, 2))
    inputs = (
        "color3f inputs:diffuseColor = (0.5, 0.5, 0.5);float inputs:metallic = 0.2;float inputs:roughness"
    )
    driven = look(f"{inputs}.connect = </Look/T.outputs:r>", reader() + texture("T", file, output="r"))
    for i, value in enumerate(values):
        st = [((i + 0.5) / len(values), 0.5)] * 4
        pictures = [row(text + SKY, st, samples=64) for text in (driven, look(f"{inputs} = {value}"))]
        a, b = (picture.color[2:6, 2:6, :3].mean() for picture in pictures)
        assert a == pytest.approx(b, rel=4e-3), value
        assert 0.3 < a < 1.001


# Normals.


def normals(file: Path, *lines: str) -> str:
    scale = ("float4 inputs:scale = (2, 2, 2, 1)", "float4 inputs:bias = (-1, -1, -1, 0)")
    nodes = reader() + texture("T", file, *scale, *lines)
    return look(MATTE + "normal3f inputs:normal.connect = </Look/T.outputs:rgb>", nodes)


def test_flat_normal_map_changes_nothing(tmp_path):
    file = write(tmp_path / "n.exr", np.full((4, 4, 3), (0.5, 0.5, 1.0)))
    pictures = [row(text + SKY + sun((1, 1, 2)), UNIT).color for text in (normals(file), look(MATTE))]
    np.testing.assert_array_equal(*pictures)
    rounded = body(normals(file)).color, body(look(MATTE)).color
    np.testing.assert_array_equal(*rounded)


TILTED = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
LIGHT = np.array([0.5, 0.3, 1]) / np.linalg.norm([0.5, 0.3, 1])

FRAMES = {
    "plain": (UNIT, (1, 0, 0), (0, 1, 0)),
    "mirrored s": ([(1, 0), (0, 0), (0, 1), (1, 1)], (-1, 0, 0), (0, 1, 0)),
    "mirrored t": ([(0, 1), (1, 1), (1, 0), (0, 0)], (1, 0, 0), (0, -1, 0)),
    "turned": ([(0, 1), (0, 0), (1, 0), (1, 1)], (0, 1, 0), (-1, 0, 0)),
    "sheared": ([(0, 0), (1, 0), (1.5, 1), (0.5, 1)], (1, 0, 0), (0, 1, 0)),
}


@pytest.mark.parametrize("frame", FRAMES)
def test_tangent_frames(tmp_path, frame):
    """Lambert's cosine of the normal that the map means, by the directions of s and t."""
    st, along_s, along_t = FRAMES[frame]
    n = TILTED[0] * np.array(along_s) + TILTED[1] * np.array(along_t) + TILTED[2] * np.array([0, 0, 1])
    file = write(tmp_path / "n.exr", np.full((4, 4, 3), (TILTED + 1) / 2))
    plain = shading(look(MATTE), st)
    got = shading(normals(file), st)
    assert got / plain == pytest.approx(n @ LIGHT / LIGHT[2], rel=1e-5)
    constant = shading(look(MATTE + f"normal3f inputs:normal = {tuple(TILTED.tolist())}"), st)
    # A constant has no coordinates of its own: st is read for its frame, too.
    assert constant == pytest.approx(got, rel=1e-5)


def test_left_handed_meshes_and_back_faces_bend_alike(tmp_path):
    file = write(tmp_path / "n.exr", np.full((4, 4, 3), (TILTED + 1) / 2))
    text = (
        normals(file)
        + sun((0.5, 0.3, 1))
        + quads(1, primvar("st", "texCoord2f", UNIT, "faceVarying"))
        + camera(1)
    )
    turned = text.replace(
        "int[] faceVertexIndices = [0, 1, 2, 3]", "int[] faceVertexIndices = [0, 3, 2, 1]"
    ).replace(str(UNIT), str([UNIT[i] for i in (0, 3, 2, 1)]))
    left = turned.replace(
        "int[] faceVertexCounts", '    uniform token orientation = "leftHanded"\n    int[] faceVertexCounts'
    )
    settings = {"camera": "/Eye", "samples": 4, "resolution": [8, 8]}
    front, hinder, handed = (
        float(dermis.render(stage_of(t), **settings).color[4, 4, 0]) for t in (text, turned, left)
    )
    assert handed == pytest.approx(front, rel=1e-5)
    # Seen from behind, z of the map points away: the normal is turned to the eye with all that is bent.
    flipped = TILTED * [-1, -1, 1]
    plain = shading(look(MATTE))
    assert hinder / plain == pytest.approx(flipped @ LIGHT / LIGHT[2], rel=1e-5)


@pytest.mark.parametrize(
    "identifier", ["ND_open_pbr_surface_surfaceshader", "ND_standard_surface_surfaceshader"]
)
def test_materialx_normalmap(tmp_path, identifier):
    file = write(tmp_path / "n.exr", np.full((4, 4, 3), (TILTED + 1) / 2))
    name, off = ("geometry_normal", "specular_weight") if "open" in identifier else ("normal", "specular")
    nodes = shader("T", "ND_image_vector3", f"asset inputs:file = @{file}@", "vector3f outputs:out") + shader(
        "N",
        "ND_normalmap",
        "vector3f inputs:in.connect = </Look/T.outputs:out>",
        "float inputs:scale = 0.5",
        "vector3f outputs:out",
    )
    matte = f"float inputs:{off} = 0"
    bent = shading(look(f"{matte};vector3f inputs:{name}.connect = </Look/N.outputs:out>", nodes, identifier))
    half = TILTED * [0.5, 0.5, 1]
    half /= np.linalg.norm(half)
    assert bent / shading(look(matte, identifier=identifier)) == pytest.approx(
        half @ LIGHT / LIGHT[2], rel=1e-4
    )


def test_normal_without_coordinates_is_said():
    text = look(MATTE + "normal3f inputs:normal = (0.5, 0, 1)") + SKY + quads(1, "") + camera(1)
    image = dermis.render(stage_of(text), camera="/Eye", samples=1, resolution=[8, 8])
    assert any("primvars:st for its tangents" in w["message"] for w in image.stats["warnings"])


# Cut-outs.


def test_opacity_maps_cast_shadows_with_holes(tmp_path):
    """A screen, half of it open, between a light and a floor."""
    file = write(tmp_path / "o.exr", np.array([[[0.0] * 3, [1.0] * 3]]).repeat(2, 0))
    nodes = reader() + texture("T", file, output="r")
    screen = look(
        MATTE + "float inputs:opacityThreshold = 0.5;float inputs:opacity.connect = </Look/T.outputs:r>",
        nodes,
    )
    floor = look(MATTE).replace("Look", "Floor")
    ground = quads(2, "").replace("Row", "Ground").replace("</Look>", "</Floor>")
    ground = ground.replace(
        "point3f[] points",
        "double3 xformOp:translate = (0, 0, -1)\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n    point3f[] points',
    )
    # One quad as wide as two, seen from beside it: look at the floor only.
    wide = quads(1, primvar("st", "texCoord2f", UNIT, "faceVarying"))
    wide = wide.replace("(1, 0, 0), (1, 1, 0)", "(2, 0, 0), (2, 1, 0)")
    eye = camera(2).replace("(1.0, 0.5, 5)", "(1.0, 0.5, -0.5)")
    text = screen + floor + ground + wide + sun((0, 0, 1)) + eye
    image = dermis.render(stage_of(text), camera="/Eye", samples=4, resolution=[16, 8]).color[4, :, 0]
    # The screen sends a little back down, the more the nearer.
    assert image[2] > 0.05 and image[2] == pytest.approx(image[5], rel=0.03)
    assert image[10] == 0.0 and image[13] == 0.0


# Media.


def spotted(tmp_path: Path, beside: str = "", **inputs: np.ndarray) -> str:
    nodes, words = reader(), "float inputs:subsurface = 1;float inputs:roughness = 0.6" + beside
    for name, texels in inputs.items():
        nodes += texture(name, write(tmp_path / f"{name}.exr", texels))
        words += f";color3f inputs:{name}.connect = </Look/{name}.outputs:rgb>"
    return look(words, nodes)


def patches(*values: tuple[float, float, float]) -> np.ndarray:
    """Sectors around the ball, of many texels each."""
    return np.array(values)[None].repeat(16, 1)


COLORS = patches((0.9, 0.2, 0.1), (0.2, 0.8, 0.9), (0.7, 0.7, 0.2), (0.97, 0.97, 0.97))
RADII = patches((0.3, 0.1, 0.05), (0.02, 0.05, 0.2), (0.1, 0.1, 0.1), (0.4, 0.3, 0.2))
LAMP = (
    'def SphereLight "Lamp"\n{\n    float inputs:radius = 0.3\n    float inputs:intensity = 40\n'
    '    double3 xformOp:translate = (2.5, 1, -2)\n    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
)


@pytest.mark.parametrize("boundary", ["diffuse", "dielectric", "indexMatched"])
def test_guided_walks_in_driven_media_have_the_mean_of_classical_ones(tmp_path, boundary):
    """4 x 4 blocks of the picture by their variances: 16 blocks x 3 channels."""
    text = (
        spotted(
            tmp_path,
            f';token inputs:subsurfaceBoundary = "{boundary}"',
            subsurfaceColor=COLORS,
            subsurfaceRadius=RADII,
        )
        + LAMP
    )
    samples = 160 if boundary == "dielectric" else 64
    pictures = {
        walk: body(text, walk=walk, samples=samples, seed=seed, resolution=[24, 24])
        for seed, walk in enumerate(("classical", "mixture", "poe"))
    }
    assert pictures["mixture"].stats["guide"]["media"][0]["walk"] == "mixture"
    for walk in ("mixture", "poe"):
        compare(walk, pictures[walk], pictures["classical"])


def compare(name: str, guided: dermis.Image, plain: dermis.Image) -> None:
    """z-scores of 4 x 4 blocks of 24 x 24 pixels, and of the whole, which has to be known to 2 %."""

    def blocks(image: np.ndarray) -> np.ndarray:
        return image.reshape(4, 6, 4, 6, 3).sum((1, 3))

    variance = blocks(plain["variance"]) + blocks(guided["variance"])
    z = (blocks(guided.color[..., :3]) - blocks(plain.color[..., :3])) / np.sqrt(variance + 1e-12)
    assert np.abs(z).max() < 4.7, f"{name}: {np.abs(z).max():.1f}"
    ratio = guided.color[..., :3].sum() / plain.color[..., :3].sum()
    error = np.sqrt(variance.sum()) / plain.color[..., :3].sum()
    assert abs(ratio - 1) < 4 * error and error < 0.02, f"{name}: {ratio} +- {error}"


def test_looks_through_driven_rough_boundaries_find_what_chance_finds(tmp_path):
    """Roughness, too: every walk has the boundary of its entry."""
    roughness = np.linspace(0.2, 0.9, 16)[None, :, None].repeat(16, 0).repeat(3, 2)
    nodes = reader() + texture("rough", write(tmp_path / "rough.exr", roughness), output="g")
    words = (
        "float inputs:subsurface = 1;float inputs:roughness.connect = </Look/rough.outputs:g>"
        ';token inputs:subsurfaceBoundary = "dielectric"'
    )
    for name, texels in (("subsurfaceColor", COLORS), ("subsurfaceRadius", RADII)):
        nodes += texture(name, write(tmp_path / f"{name}.exr", texels))
        words += f";color3f inputs:{name}.connect = </Look/{name}.outputs:rgb>"
    text = look(words, nodes) + LAMP
    for walk in ("classical", "mixture"):
        looks, chance = (
            body(text, walk=walk, refractedLight=word, samples=samples, seed=samples, resolution=[24, 24])
            for word, samples in (("auto", 128), ("off", 512))
        )
        assert "rough boundary" in looks.stats["guide"]["media"][0]["why"]
        compare(walk, looks, chance)


def test_color_of_the_entry_is_the_color_seen(tmp_path):
    """Mean free paths far below the patches: each patch is as bright as a ball of its colour."""
    beside = ";float inputs:subsurfaceScale = 0.002"
    picture = body(spotted(tmp_path, beside, subsurfaceColor=COLORS), samples=64, resolution=[32, 32]).color
    for i, color in enumerate(COLORS[0, ::16]):
        one = body(
            spotted(tmp_path, beside, subsurfaceColor=patches(tuple(color))), samples=64, resolution=[32, 32]
        ).color
        # Columns that sector i covers in the middle of the picture: x = cos(2 pi s), z > 0 is seen.
        for s in (0.125, 0.375):
            if int(s * 4) == i:
                x = int(32 * (0.5 + 0.45 * np.cos(2 * np.pi * s)))
                got, wanted = (p[12:20, x - 1 : x + 1, :3].mean((0, 1)) for p in (picture, one))
                np.testing.assert_allclose(got, wanted, rtol=0.06, atol=0.01)


def test_driven_media_with_a_phase_function_are_walked_classically_and_said(tmp_path):
    dense = ";float inputs:subsurfaceScale = 0.1"
    text = (
        spotted(tmp_path, dense + ";float inputs:subsurfaceAnisotropy = 0.5", subsurfaceColor=COLORS) + LAMP
    )
    (medium,) = body(text, samples=1).stats["guide"]["media"]
    assert medium["walk"] == "classical" and "phase function" in medium["why"]
    (medium,) = body(spotted(tmp_path, dense, subsurfaceColor=COLORS) + LAMP, samples=1).stats["guide"][
        "media"
    ]
    assert medium["walk"] == "mixture" and "medium of its entry" in medium["why"]


def test_driven_boundaries_leave_refracted_light_to_chance(tmp_path):
    """The search knows constants and the mesh's own normals."""
    smooth = ';token inputs:subsurfaceBoundary = "dielectric"'
    driven = spotted(tmp_path, smooth, subsurfaceColor=COLORS).replace("roughness = 0.6", "roughness = 0")
    constant = look("float inputs:subsurface = 1;float inputs:roughness = 0" + smooth)
    for text, left in ((driven, True), (constant, False)):
        pictures = [
            body(text + LAMP, walk="classical", refractedLight=word).color for word in ("off", "auto")
        ]
        assert np.array_equal(*pictures) == left


def test_same_image_for_any_number_of_threads(tmp_path):
    text = spotted(tmp_path, subsurfaceColor=COLORS, subsurfaceRadius=RADII) + LAMP
    images = [body(text, threads=threads, walk="mixture") for threads in (1, 3)]
    np.testing.assert_array_equal(images[0].color, images[1].color)


def test_flattened_file_renders_the_same_image(tmp_path):
    """Images ride along in the .dermis file."""
    from dermis._core import Delegate
    from dermis.hydra import populate
    from dermis.stage import flatten

    text = spotted(tmp_path, subsurfaceColor=COLORS) + LAMP + ball() + camera(1)
    core = Delegate()
    populate(core, flatten(stage_of(text)))
    core.set_settings(json.dumps({"camera": "/Eye", "resolution": [8, 8], "samples": 2}))
    core.save(tmp_path / "scene.dermis")
    for file in tmp_path.glob("*.exr"):
        file.unlink()
    pictures = []
    for delegate in (core, Delegate.load(tmp_path / "scene.dermis")):
        delegate.commit()
        delegate.start()
        assert delegate.wait(60.0)
        pictures.append(delegate.snapshot()["color"])
    assert pictures[0][..., :3].max() > 0.01
    np.testing.assert_array_equal(*pictures)
