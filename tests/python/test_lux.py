"""UsdLux conformance: small stages rendered by dermis against the quadrature of `lux_quadrature`.

Each stage has one light and a white Lambertian floor, seen by an orthographic camera from above; with `maxDepth` 0
a pixel is the irradiance over pi, averaged under the pixel filter. The floor is flat, or a four-sided roof whose
ridges lie on pixel borders, so that one image tells directions apart. Pictures agree within 1 % in the mean of
each channel, pixels within 3 %.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
from lux_quadrature import Array, Light, irradiance, unit
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

import dermis

PIXELS = 12
HALF_WIDTH = 2.0
"""Of the image, in stage units."""
CAMERA_HEIGHT = 0.25
MEAN_TOLERANCE = 0.01
PIXEL_TOLERANCE = 0.03
DARK = 0.05
"""Pixels below this share of the brightest are judged by the mean alone."""

FRAMES = {
    "Z": np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    "Y": np.array([[1, 0, 0], [0, 0, -1], [0, 1.0, 0]]),
}
"""Rows: what points right, up and to the camera in the image, by the stage's up axis."""


@dataclass(frozen=True)
class Case:
    name: str
    light: Light
    slope: float = 0.0
    up: str = "Z"
    samples: int = 1024
    cells: int = 2
    """Of the oracle, per pixel and axis: more where the irradiance has an edge."""
    nodes: int = 24
    """Of the oracle, per axis of a light's surface."""
    warns: str = ""
    """What dermis has to say about an attribute out of range."""


# Matrices of row vectors: the first of a product acts first.


def scale(x: float, y: float, z: float) -> Array:
    return np.diag([x, y, z, 1.0])


def move(x: float, y: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[3, :3] = x, y, z
    return matrix


def turn(axis: tuple[float, float, float], degrees: float) -> Array:
    return np.array(Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(*axis), degrees)))


def shear(x_by_y: float) -> Array:
    matrix = np.eye(4)
    matrix[1, 0] = x_by_y
    return matrix


ABOVE = move(0.3, -0.2, 1.5)
TILTED = turn((1, 2, 0.5), 35.0) @ ABOVE
STRETCHED = scale(1.6, 0.7, 1.2) @ TILTED
DOWN = turn((1, 0, 0), -90.0)
"""For stages whose up axis is Y: a light's -Z turns to -Y."""

BOX_CORNERS = np.array([[x, y, z] for x in (-0.4, 0.4) for y in (-0.3, 0.3) for z in (-0.2, 0.2)])
BOX_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""Counter-clockwise seen from outside."""
BOX = np.array([BOX_CORNERS[[f[0], f[i], f[i + 1]]] for f in BOX_FACES for i in (1, 2)])


def quadrants(rows: int, columns: int) -> Array:
    """Four colours, so that no turn or mirror image of it looks the same."""
    image = np.zeros((rows, columns, 3))
    image[: rows // 2, : columns // 2] = 4.0, 0.2, 0.1
    image[: rows // 2, columns // 2 :] = 0.1, 2.0, 0.3
    image[rows // 2 :, : columns // 2] = 0.2, 0.1, 1.5
    image[rows // 2 :, columns // 2 :] = 0.5, 0.5, 0.02
    return image


def bright_texel(row: int, column: int) -> Array:
    image = np.full((32, 64, 3), (0.02, 0.01, 0.03))
    image[row, column] = 400.0, 300.0, 200.0
    return image


AREA_KINDS = ("RectLight", "DiskLight", "SphereLight", "CylinderLight", "Mesh")
SIZES: dict[str, dict[str, float]] = {
    "RectLight": {"width": 1.4, "height": 0.6},
    "DiskLight": {"radius": 0.7},
    "SphereLight": {"radius": 0.4},
    "CylinderLight": {"length": 1.3, "radius": 0.25},
    "Mesh": {},
}


def area(
    kind: str, matrix: Array = ABOVE, shaped: bool = False, texture: Array | None = None, **more: Any
) -> Light:
    triangles = BOX if kind == "Mesh" else None
    return Light(kind, {**SIZES[kind], **more}, matrix, shaped, texture, triangles=triangles)


def shape_cases() -> list[Case]:
    """Every area light: default and own size, placed, stretched and mirrored, normalize off and on."""
    cases = [
        Case(f"{kind}-default", Light(kind, {}, move(0, 0, 1.2))) for kind in AREA_KINDS if kind != "Mesh"
    ]
    for kind in AREA_KINDS:
        cases += [
            Case(f"{kind}-size", area(kind)),
            Case(f"{kind}-tilted-roof", area(kind, TILTED), slope=0.7, cells=4),
            Case(f"{kind}-stretched", area(kind, STRETCHED)),
            Case(f"{kind}-normalize", area(kind, normalize=True)),
            Case(f"{kind}-stretched-normalize", area(kind, STRETCHED, normalize=True)),
            Case(f"{kind}-mirror-z", area(kind, scale(1, 1, -1) @ turn((1, 0, 0), 160.0) @ ABOVE)),
            Case(f"{kind}-mirror-x-normalize", area(kind, scale(-1.3, 0.8, 1) @ TILTED, normalize=True)),
        ]
    return cases


def special_shape_cases() -> list[Case]:
    sheared = shear(0.6) @ scale(1.2, 0.8, 1.0) @ TILTED
    return [
        Case("RectLight-sheared", area("RectLight", sheared)),
        Case("RectLight-sheared-normalize", area("RectLight", sheared, normalize=True)),
        Case("RectLight-away", area("RectLight", turn((1, 0, 0), 180.0) @ ABOVE)),
        Case(
            "RectLight-half-below",
            area("RectLight", turn((0, 1, 0), 90.0) @ move(2.5, 0, 0.2)),
            cells=4,
            nodes=48,
        ),
        Case("SphereLight-near", area("SphereLight", move(0.1, 0.2, 0.5), radius=0.45)),
        Case(
            "SphereLight-half-below", area("SphereLight", move(-2.9, 0, 0.1), radius=0.5), cells=4, nodes=48
        ),
        Case("SphereLight-flat-ellipsoid", area("SphereLight", scale(2.0, 1.0, 0.3) @ ABOVE, normalize=True)),
        Case(
            "SphereLight-long-ellipsoid", area("SphereLight", scale(0.4, 0.4, 1.8) @ TILTED, normalize=True)
        ),
        Case("CylinderLight-elliptic", area("CylinderLight", scale(1, 2.5, 0.6) @ ABOVE, normalize=True)),
        Case("CylinderLight-end-on", area("CylinderLight", turn((0, 1, 0), 80.0) @ ABOVE), cells=4),
        Case(
            "SphereLight-needle", area("SphereLight", scale(2.4, 0.2, 0.2) @ TILTED, normalize=True), cells=4
        ),
        Case("RectLight-up-Y", area("RectLight", DOWN @ turn((1, 0, 0), 20.0) @ move(0.2, 1.5, 0.3)), up="Y"),
        Case("SphereLight-up-Y", area("SphereLight", move(0.2, 1.2, 0.5)), up="Y"),
    ]


def emission_cases() -> list[Case]:
    lights = {
        "intensity": area("DiskLight", intensity=7.5),
        "intensity-0.01": area("SphereLight", intensity=0.01),
        "exposure-2.5": area("RectLight", exposure=2.5),
        "exposure-minus-3": area("SphereLight", exposure=-3.0),
        "color": area("CylinderLight", color=(0.9, 0.4, 0.1)),
        "temperature-off": area("DiskLight", colorTemperature=2500.0),
        "temperature-2500": area("DiskLight", enableColorTemperature=True, colorTemperature=2500.0),
        "temperature-6500": area("SphereLight", enableColorTemperature=True),
        "temperature-10000": area("RectLight", enableColorTemperature=True, colorTemperature=10000.0),
        "everything": area(
            "RectLight",
            STRETCHED,
            intensity=30.0,
            exposure=-1.5,
            color=(0.2, 0.7, 1.0),
            enableColorTemperature=True,
            colorTemperature=3200.0,
            normalize=True,
        ),
    }
    return [Case(f"emission-{name}", light) for name, light in lights.items()]


def shaping_cases() -> list[Case]:
    """`_` stands for `:` in the names of ShapingAPI."""
    cases = [
        with_edge(f"{kind}-cone-{angle}-{softness}", shaped(kind, cone_angle=angle, cone_softness=softness))
        for kind, angle, softness in (
            ("RectLight", 40.0, 0.0),
            ("RectLight", 60.0, 0.5),
            ("DiskLight", 35.0, 0.3),
            ("DiskLight", 70.0, 1.0),
            ("SphereLight", 50.0, 0.0),
            ("SphereLight", 80.0, 0.4),
            ("SphereLight", 150.0, 0.2),
            ("CylinderLight", 45.0, 0.6),
        )
    ]
    cases += [Case(f"{kind}-focus", shaped(kind, focus=3.0)) for kind in AREA_KINDS if kind != "Mesh"]
    behind = turn((1, 0, 0), 150.0) @ ABOVE
    return [
        *cases,
        Case("RectLight-focus-tint", shaped("RectLight", focus=6.0, focusTint=(0.8, 0.1, 0.3))),
        Case("SphereLight-focus-behind", shaped("SphereLight", behind, focus=2.0, cone_angle=180.0)),
        Case("SphereLight-focus-below-0", shaped("SphereLight", focus=-2.0), warns="shaping:focus is -2.0"),
        replace(
            with_edge("DiskLight-softness-above-1", shaped("DiskLight", cone_angle=55.0, cone_softness=1.7)),
            warns="shaping:cone:softness is 1.7",
        ),
        with_edge("SphereLight-default-cone", shaped("SphereLight", turn((1, 0, 0), 40.0) @ ABOVE)),
        with_edge("DiskLight-mirrored-cone", shaped("DiskLight", scale(1, 1, -1) @ behind, cone_angle=60.0)),
        with_edge(
            "DiskLight-all-normalize",
            shaped(
                "DiskLight", STRETCHED, {"normalize": True}, focus=2.0, cone_angle=65.0, cone_softness=0.5
            ),
        ),
    ]


def with_edge(name: str, light: Light) -> Case:
    """A cone's border crosses the image."""
    return Case(name, light, samples=3072, cells=4, nodes=32)


def shaped(kind: str, matrix: Array = ABOVE, more: dict[str, Any] | None = None, **shaping: Any) -> Light:
    names = {f"shaping:{name.replace('_', ':')}": value for name, value in shaping.items()}
    light = area(kind, matrix, shaped=True)
    return replace(light, attributes={**light.attributes, **(more or {}), **names})


def distant_cases() -> list[Case]:
    aside = turn((1, 0.4, 0), 40.0)
    cases = [Case("DistantLight-default", Light("DistantLight", {}, aside), slope=0.7)]
    for angle in (0.0, 0.53, 20.0, 180.0, 300.0):
        for normalize in (False, True):
            attributes = {"angle": angle, "normalize": normalize, "intensity": 5.0}
            name = f"DistantLight-{angle}{'-normalize' if normalize else ''}"
            cases.append(Case(name, Light("DistantLight", attributes, aside), slope=0.7))
    mirrored = Light(
        "DistantLight", {"intensity": 3.0, "angle": 10.0}, scale(2, 1, -1) @ turn((1, 0, 0), 150.0)
    )
    return [*cases, Case("DistantLight-mirrored-scaled", mirrored, slope=0.7)]


def dome_cases() -> list[Case]:
    turned = turn((0.3, 1, 0.5), 75.0)
    spot, map_ = bright_texel(19, 54), quadrants(32, 64)
    plain = {"intensity": 0.7, "normalize": True, "color": (1.0, 0.6, 0.3)}
    cases = [Case("DomeLight-plain", Light("DomeLight", plain), slope=0.7)]
    for up in "YZ":
        cases += [
            mapped(f"DomeLight-texel-up-{up}", Light("DomeLight", {}, texture=spot), up),
            mapped(f"DomeLight-map-turned-up-{up}", Light("DomeLight", {}, turned, texture=map_), up),
        ]
        for axis in ("scene", "Y", "Z"):
            pole = up if axis == "scene" else axis
            light = Light("DomeLight_1", {"poleAxis": axis}, texture=spot, pole=pole)
            cases.append(mapped(f"DomeLight_1-{axis}-texel-up-{up}", light, up))
        light = Light("DomeLight_1", {}, turned, texture=map_, pole=up)
        cases.append(mapped(f"DomeLight_1-scene-map-turned-up-{up}", light, up))
    mirrored = Light("DomeLight", {}, scale(-1, 1, 1) @ turned, texture=map_)
    return [*cases, mapped("DomeLight-mirrored", mirrored, "Y")]


def mapped(name: str, light: Light, up: str) -> Case:
    return Case(name, light, slope=0.7, up=up, samples=4096)


def texture_cases() -> list[Case]:
    """Close to the floor, so that the colours of the quadrants stay apart."""
    low = turn((0, 0, 1), 30.0) @ move(0.2, 0.1, 0.6)
    mirror = scale(-1, 1, 1) @ low
    square = area("RectLight", low, texture=quadrants(64, 64), width=2.5, height=2.0)
    wide = area("RectLight", mirror, texture=quadrants(64, 128), width=2.0, color=(0.5, 1.0, 2.0))
    return [
        Case("RectLight-texture", square, samples=3072, nodes=64),
        Case("RectLight-texture-mirrored-color", wide, samples=3072, nodes=64),
    ]


CASES = [
    *shape_cases(),
    *special_shape_cases(),
    *emission_cases(),
    *shaping_cases(),
    *distant_cases(),
    *dome_cases(),
    *texture_cases(),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_lux(case: Case, tmp_path: Path) -> None:
    assert disagreement(rendered(case, tmp_path), expected(case)) is None


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_two_percent_are_noticed(factor: float, tmp_path: Path) -> None:
    case = CASES[0]
    assert "mean" in (disagreement(rendered(case, tmp_path), factor * expected(case)) or "")


def test_sphere_through_the_floor(tmp_path: Path) -> None:
    """Centre on the floor: E = L (s - sin s cos s) with sin s = r / d; inside nothing arrives, for it emits outward."""
    radius = 0.9
    case = Case("", Light("SphereLight", {"radius": radius}), samples=8192, cells=16)

    def received(points: Array, normals: Array) -> Array:
        distance = np.linalg.norm(points, axis=1)
        s = np.arcsin(radius / np.maximum(distance, radius))
        value = np.where(distance > radius, s - np.sin(s) * np.cos(s), 0.0)
        return np.repeat(value[:, None], 3, axis=1)

    assert disagreement(rendered(case, tmp_path), seen(case, received)) is None


def closed_forms() -> list[tuple[Light, float]]:
    """Irradiance at the origin, facing +Z."""
    up = move(0, 0, 2.0)
    strip = 4.0 / np.sqrt(5.0) * np.arctan(1.0 / np.sqrt(5.0))
    return [
        (Light("DomeLight"), np.pi),
        (Light("DiskLight", {"radius": 1.5}, up), np.pi * 2.25 / 6.25),
        (Light("DiskLight", {"radius": 0.5, "normalize": True}, scale(3, 3, 1) @ up), 1.0 / 6.25),
        (Light("SphereLight", {"radius": 0.6}, up), np.pi * 0.09),
        (Light("SphereLight", {"radius": 0.3, "normalize": True}, scale(2, 2, 2) @ up), 1.0 / 16.0),
        # Four corner rectangles of 1 x 1 at distance 2, each 1/2 (2 / sqrt 5) atan(1 / sqrt 5).
        (Light("RectLight", {"width": 2.0, "height": 2.0}, up), strip),
        (Light("DistantLight", {"angle": 0.0, "intensity": 3.0}, turn((1, 0, 0), 60.0)), 1.5),
        (Light("DistantLight", {"angle": 90.0, "intensity": 3.0, "normalize": True}), 3.0),
        (Light("DistantLight", {"angle": 180.0, "intensity": 1.0}), np.pi),
    ]


@pytest.mark.parametrize(("light", "value"), closed_forms())
def test_quadrature_against_closed_forms(light: Light, value: float) -> None:
    found = irradiance(light, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert found == pytest.approx(np.full((1, 3), value), rel=1e-3)


def disagreement(image: Array, wanted: Array) -> str | None:
    """What is wrong with an image (rows, columns, 3), in words."""
    assert np.isfinite(image).all()
    mean, wanted_mean = image.mean(axis=(0, 1)), wanted.mean(axis=(0, 1))
    if not np.allclose(mean, wanted_mean, rtol=MEAN_TOLERANCE, atol=1e-7):
        return f"the mean is {mean}, {mean / wanted_mean} of {wanted_mean}"
    lit = (wanted > 0.0) & (wanted >= DARK * wanted.max(axis=(0, 1)))
    error = np.abs(image[lit] / wanted[lit] - 1.0)
    worst = np.percentile(error, 99) if lit.any() else 0.0
    return None if worst < PIXEL_TOLERANCE else f"the 99th percentile of the relative error is {worst:.4f}"


# The expected image


def expected(case: Case) -> Array:
    return seen(case, lambda points, normals: irradiance(case.light, points, normals, case.nodes))


def seen(case: Case, received: Callable[[Array, Array], Array]) -> Array:
    """Irradiance over pi under the tent filter of radius one pixel, (rows, columns, 3)."""
    cell = 2.0 * HALF_WIDTH / (PIXELS * case.cells)
    reach = case.cells // 2
    ticks = -HALF_WIDTH + cell * (np.arange(PIXELS * case.cells + 2 * reach) - reach + 0.5)
    x, y = np.meshgrid(ticks, -ticks)
    slope = case.slope
    points = np.stack([x, y, -slope * (np.abs(x) + np.abs(y))], axis=-1).reshape(-1, 3)
    normals = unit(np.stack([slope * np.sign(x), slope * np.sign(y), np.ones_like(x)], axis=-1)).reshape(
        -1, 3
    )
    frame = FRAMES[case.up]
    image = received(points @ frame, normals @ frame).reshape(*x.shape, 3) / np.pi
    return filtered(filtered(image, case.cells).swapaxes(0, 1), case.cells).swapaxes(0, 1)


def filtered(image: Array, cells: int) -> Array:
    """Rows of pixels from rows of cells by a tent that reaches one pixel to either side."""
    tent = 1.0 - np.abs((np.arange(2 * cells) + 0.5) / cells - 1.0)
    return sum(w / cells * image[k : k + PIXELS * cells : cells] for k, w in enumerate(tent))


# The stage


def rendered(case: Case, folder: Path) -> Array:
    image = dermis.render(
        stage_of(case, folder),
        resolution=[PIXELS, PIXELS],
        samples=case.samples,
        maxDepth=0,
        camera="/Camera",
    )
    messages = [warning["message"] for warning in image.stats["warnings"]]
    assert len(messages) == (1 if case.warns else 0), messages
    assert all(case.warns in message for message in messages)
    return image.color[..., :3].astype(float)


def stage_of(case: Case, folder: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, case.up)
    add_camera(stage, FRAMES[case.up])
    add_floor(stage, FRAMES[case.up], case.slope)
    add_light(stage, case.light, folder)
    return stage


def add_camera(stage: Usd.Stage, frame: Array) -> None:
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    camera.CreateProjectionAttr("orthographic")
    camera.CreateHorizontalApertureAttr(20.0 * HALF_WIDTH)
    camera.CreateVerticalApertureAttr(20.0 * HALF_WIDTH)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 100.0))
    matrix = np.eye(4)
    matrix[:3, :3] = frame
    matrix[3, :3] = CAMERA_HEIGHT * frame[2]
    place(camera.GetPrim(), matrix)


def add_floor(stage: Usd.Stage, frame: Array, slope: float) -> None:
    """A flat pyramid over a diamond; Lambertian, for OpenPBR without specular is."""
    far = 4.0 * HALF_WIDTH
    rim = [(far, 0, -slope * far), (0, far, -slope * far), (-far, 0, -slope * far), (0, -far, -slope * far)]
    points = np.array([(0, 0, 0), *rim], float) @ frame
    floor = mesh_of(stage, "/Floor", points, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)])
    material = UsdShade.Material.Define(stage, "/White")
    shader = UsdShade.Shader.Define(stage, "/White/Surface")
    shader.CreateIdAttr("ND_open_pbr_surface_surfaceshader")
    shader.CreateInput("base_color", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(1.0))
    shader.CreateInput("specular_weight", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput("mtlx").ConnectToSource(shader.ConnectableAPI(), "out")
    UsdShade.MaterialBindingAPI.Apply(floor).Bind(material)


def mesh_of(stage: Usd.Stage, path: str, points: Array, faces: list[tuple[int, ...]]) -> Usd.Prim:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(points.tolist())
    mesh.CreateFaceVertexCountsAttr([len(f) for f in faces])
    mesh.CreateFaceVertexIndicesAttr([i for f in faces for i in f])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh.GetPrim()


def add_light(stage: Usd.Stage, light: Light, folder: Path) -> None:
    """Everything of the light as it is authored in a shot."""
    if light.kind == "Mesh":
        prim = mesh_of(stage, "/Light", BOX_CORNERS, BOX_FACES)
        UsdLux.MeshLightAPI.Apply(prim)
    else:
        prim = stage.DefinePrim("/Light", light.kind)
    if light.shaped:
        UsdLux.ShapingAPI.Apply(prim)
    for name, value in light.attributes.items():
        attribute = prim.GetAttribute(name if name == "poleAxis" else f"inputs:{name}")
        assert attribute, f"{light.kind} has no {name}"
        attribute.Set(Gf.Vec3f(*value) if isinstance(value, tuple) else value)
    if light.texture is not None:
        path = folder / "light.exr"
        write_exr(path, light.texture)
        prim.GetAttribute("inputs:texture:file").Set(str(path))
    place(prim, light.matrix)


def write_exr(path: Path, image: Array) -> None:
    rows, columns, channels = image.shape
    buffer = oiio.ImageBuf(oiio.ImageSpec(columns, rows, channels, "float"))
    buffer.set_pixels(oiio.ROI.All, image.astype(np.float32))
    assert buffer.write(str(path)), buffer.geterror()


def place(prim: Usd.Prim, matrix: Array) -> None:
    UsdGeom.Xformable(prim).AddTransformOp().Set(Gf.Matrix4d(matrix.tolist()))
