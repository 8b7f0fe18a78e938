"""What lights cost: `make bench-lights`, or `python tests/bench_lights.py`, prints two tables.

A body on a floor, lit by five rectangles; 20 to 2000 lights are the same rectangles cut into tiles, so that the
picture is the same (1 light: the first rectangle alone). `cost` is the processor's microseconds per sample,
`efficiency` is 1 / (relMSE seconds) over that with five lights; `gain` compares with another compiled core
(`--against _core.abi3.so`), rendered in turn. Every picture is rendered in turn with the others, on one thread;
medians of `--rounds`.
"""

import argparse
import importlib.util
import json
from dataclasses import dataclass, field
from math import cos, pi, sin
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

import dermis
from dermis._core import Delegate

CUTS = {1: (1, 1), 5: (1, 1), 20: (2, 2), 100: (5, 4), 500: (10, 10), 2000: (20, 20)}
"""Tiles of each rectangle, by the number of lights."""


@dataclass(frozen=True)
class Rectangle:
    eye: tuple[float, float, float]
    at: tuple[float, float, float]
    size: tuple[float, float]
    color: tuple[float, float, float]


RECTANGLES = [
    Rectangle((4, 5, 4), (0, 1, 0), (3, 2), (12, 11, 9)),
    Rectangle((-5, 2, 2), (0, 1, 0), (1, 4), (3, 5, 9)),
    Rectangle((-1, 2.5, -5), (0, 1, 0), (4, 1), (14, 10, 6)),
    Rectangle((2.5, 0.6, -1.5), (0, 0.6, 0), (0.5, 0.5), (40, 12, 6)),
    Rectangle((0, 9, 0), (0, 0, 0.01), (6, 6), (1, 1, 1.2)),
]


def blob(stage: Usd.Stage, rings: int = 96) -> UsdGeom.Mesh:
    """A closed, lumpy sphere."""
    segments = 2 * rings

    def point(ring: int, segment: int) -> Gf.Vec3f:
        theta, phi = pi * ring / rings, 2 * pi * segment / segments
        r = 1 + 0.12 * sin(5 * theta) * sin(4 * phi) * sin(theta)
        return Gf.Vec3f(r * sin(theta) * cos(phi), 1.05 + r * cos(theta), -r * sin(theta) * sin(phi))

    inner = [point(ring, segment) for ring in range(1, rings) for segment in range(segments)]
    points = [point(0, 0), *inner, point(rings, 0)]

    def index(ring: int, segment: int) -> int:
        if ring in (0, rings):
            return 0 if ring == 0 else len(points) - 1
        return 1 + (ring - 1) * segments + segment % segments

    corners: list[int] = []
    for ring in range(rings):
        for s in range(segments):
            a, b = index(ring, s), index(ring + 1, s)
            c, d = index(ring + 1, s + 1), index(ring, s + 1)
            if ring < rings - 1:
                corners += [a, b, c]
            if ring > 0:
                corners += [a, c, d]
    mesh = UsdGeom.Mesh.Define(stage, "/World/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray(points))
    mesh.CreateFaceVertexCountsAttr([3] * (len(corners) // 3))
    mesh.CreateFaceVertexIndicesAttr(corners)
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def coat(stage: Usd.Stage, mesh: UsdGeom.Mesh, subsurface: bool) -> None:
    material = UsdShade.Material.Define(stage, "/World/Look")
    shader = UsdShade.Shader.Define(stage, "/World/Look/Preview")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((0.8, 0.6, 0.5))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.5)
    if subsurface:
        shader.CreateInput("subsurface", Sdf.ValueTypeNames.Float).Set(1.0)
        shader.CreateInput("subsurfaceColor", Sdf.ValueTypeNames.Color3f).Set((0.8, 0.6, 0.5))
        shader.CreateInput("subsurfaceRadius", Sdf.ValueTypeNames.Color3f).Set((0.1, 0.05, 0.03))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def tile(stage: Usd.Stage, path: str, of: Rectangle, cut: tuple[int, int], at: tuple[int, int]) -> None:
    light = UsdLux.RectLight.Define(stage, path)
    width, height = (of.size[i] / cut[i] for i in range(2))
    light.CreateWidthAttr(width)
    light.CreateHeightAttr(height)
    light.CreateColorAttr(of.color)
    place = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*of.eye), Gf.Vec3d(*of.at), Gf.Vec3d(0, 1, 0)).GetInverse()
    offset = [(at[i] + 0.5) * of.size[i] / cut[i] - 0.5 * of.size[i] for i in range(2)]
    light.AddTransformOp().Set(Gf.Matrix4d().SetTranslate(Gf.Vec3d(*offset, 0)) * place)


def make_stage(lights: int, subsurface: bool) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    floor = UsdGeom.Plane.Define(stage, "/World/Floor")
    floor.CreateAxisAttr("Y")
    floor.CreateWidthAttr(30)
    floor.CreateLengthAttr(30)
    coat(stage, blob(stage), subsurface)
    cut = CUTS[lights]
    for number, rectangle in enumerate(RECTANGLES[: 1 if lights == 1 else None]):
        for x in range(cut[0]):
            for y in range(cut[1]):
                tile(stage, f"/World/Lights/R{number}_{x}_{y}", rectangle, cut, (x, y))
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(35)
    camera.CreateHorizontalApertureAttr(24)
    camera.CreateVerticalApertureAttr(24)
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(0, 2.5, 6), Gf.Vec3d(0, 0.9, 0), Gf.Vec3d(0, 1, 0))
    camera.AddTransformOp().Set(view.GetInverse())
    return stage


@dataclass
class Measured:
    seconds: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    shadow_rays: float = 0.0
    megabytes: float = 0.0

    def inefficiency(self) -> float:
        return float(np.median(self.seconds) * np.mean(self.errors))


def load_core(path: str) -> Any:
    """The Delegate of another compiled `_core`."""
    spec = importlib.util.spec_from_file_location("_core", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"--against {path}: not a compiled module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Delegate


def rel_mse(image: np.ndarray, reference: np.ndarray) -> float:
    """Over channels of pixels that are not black, with a hundredth of the mean beside the reference."""
    floor = 0.01 * reference.mean() ** 2
    return float(np.mean((image - reference) ** 2 / (reference**2 + floor)))


def render(stage: Usd.Stage, core: Any, **settings: Any) -> tuple[dermis.Image, float]:
    """The picture, and the processor's seconds: others may be at work on this machine."""
    delegate = core()
    dermis.populate(delegate, dermis.flatten(stage))
    delegate.set_settings(json.dumps(settings))
    delegate.commit()
    begun = process_time()
    delegate.start()
    while not delegate.wait(0.5):
        pass
    seconds = process_time() - begun
    return dermis.Image(delegate.snapshot(), json.loads(delegate.stats())), seconds


def measure(measured: Measured, picture: tuple[dermis.Image, float], reference: np.ndarray) -> None:
    image, seconds = picture
    stats = image.stats
    measured.seconds.append(seconds)
    measured.errors.append(rel_mse(image.color[..., :3].astype(np.float64), reference))
    pixels = image.color.shape[0] * image.color.shape[1]
    measured.shadow_rays = stats["rays"]["shadow"] / pixels / stats["samples_per_pixel"]
    measured.megabytes = stats.get("guide", {}).get("bytes", 0) / 2**20


def table(options: argparse.Namespace, subsurface: bool) -> None:
    size = {"resolution": (options.size, options.size), "camera": "/World/Camera", "threads": 1}
    counts = options.lights
    stages = {lights: make_stage(lights, subsurface) for lights in counts}
    cores = {"": Delegate} | ({"before": load_core(options.against)} if options.against else {})
    asked = dict(pair.split("=", 1) for pair in options.set)
    references = {}
    for lights in {1, 5} & {min(count, 5) for count in counts}:
        stage = stages.get(lights) or make_stage(lights, subsurface)
        image, _ = render(stage, Delegate, samples=options.reference, seed=977, **size)
        references[lights] = image.color[..., :3].astype(np.float64)
    measured = {(lights, name): Measured() for lights in counts for name in cores}
    for round_ in range(options.rounds):
        for (lights, name), of in measured.items():
            picture = render(
                stages[lights], cores[name], samples=options.samples, seed=round_, **size, **asked
            )
            measure(of, picture, references[min(lights, 5)])
    print(
        f"{'subsurface' if subsurface else 'surface'}: {options.size} x {options.size}, {options.samples} samples"
    )
    print(
        "lights  cost us  shadow rays   relMSE  efficiency  guide MB"
        + ("    gain" if options.against else "")
    )
    samples = options.size**2 * options.samples
    for lights in counts:
        of = measured[lights, ""]
        cost = np.median(of.seconds) / samples * 1e6
        five = measured.get((5, ""))
        ratio = five.inefficiency() / of.inefficiency() if five else float("nan")
        line = f"{lights:6} {cost:8.2f} {of.shadow_rays:12.2f} {np.mean(of.errors):8.5f} "
        line += f"{ratio:11.2f} {of.megabytes:9.1f}"
        if options.against:
            line += f" {measured[lights, 'before'].inefficiency() / of.inefficiency():7.2f}"
        print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lights", type=int, nargs="+", default=list(CUTS), choices=list(CUTS))
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--reference", type=int, default=4096, help="samples of the reference")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--against", help="another compiled core, for a before and after")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="of what is measured")
    parser.add_argument("--write", type=Path, help="write the stages there, and render nothing")
    options = parser.parse_args()
    if options.write:
        for lights in options.lights:
            make_stage(lights, subsurface=True).Export(str(options.write / f"lights_{lights}.usda"))
        return
    for subsurface in (False, True):
        table(options, subsurface)


if __name__ == "__main__":
    main()
