"""Writes textures.usda and its images: three balls whose inputs are driven, one per shader.

python usd_scenes/textures_scene.py [--out DIR]   (numpy, Pillow and usd-core)
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, Vt

SIZE = 256
COLOR, VECTOR, FLOAT = Sdf.ValueTypeNames.Color3f, Sdf.ValueTypeNames.Vector3f, Sdf.ValueTypeNames.Float
PAIR, TOKEN = Sdf.ValueTypeNames.Float2, Sdf.ValueTypeNames.Token


def noise(seed: int, width: float) -> NDArray:
    """Periodic, of mean 0 and variance 1, smooth over `width` texels."""
    frequency = np.fft.fftfreq(SIZE)
    squared = frequency[:, None] ** 2 + frequency[None] ** 2
    white = np.fft.fft2(np.random.default_rng(seed).standard_normal((SIZE, SIZE)))
    smooth = np.real(np.fft.ifft2(white * np.exp(-2.0 * (np.pi * width) ** 2 * squared)))
    return (smooth - smooth.mean()) / smooth.std()


def write_images(folder: Path) -> None:
    """spots.png: sRGB colours; bumps.png: normals; wet.png: one channel of data."""
    folder.mkdir(parents=True, exist_ok=True)
    share = 1.0 / (1.0 + np.exp(-4.0 * noise(1, 8.0)))[..., None]
    linear = np.array([0.87, 0.5, 0.4]) * (1.0 - share) + np.array([0.6, 0.2, 0.15]) * share
    save(
        folder / "spots.png",
        np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055),
    )
    height = noise(2, 2.0)
    # Rows run down, t runs up.
    slopes = np.stack(
        [np.roll(height, 1, 1) - np.roll(height, -1, 1), np.roll(height, -1, 0) - np.roll(height, 1, 0)], -1
    )
    normal = np.concatenate([0.3 * slopes, np.ones((SIZE, SIZE, 1))], -1)
    save(folder / "bumps.png", 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True))
    save(folder / "wet.png", 1.0 / (1.0 + np.exp(-6.0 * noise(3, 12.0))))


def save(file: Path, values: NDArray) -> None:
    Image.fromarray(np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)).save(file, optimize=True)


def add_ball(stage: Usd.Stage, path: str, x: float, material: UsdShade.Material) -> UsdGeom.Mesh:
    """A closed sphere of radius 1 with st once around; the seam is between face vertices."""
    bands, ring = 16, 32
    theta, phi = np.pi * np.arange(1, bands) / bands, 2.0 * np.pi * np.arange(ring) / ring
    sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
    rows = np.stack([sin * np.sin(phi), np.broadcast_to(cos, (bands - 1, ring)), sin * np.cos(phi)], -1)
    points = np.concatenate([rows.reshape(-1, 3), [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    north, south = len(points) - 2, len(points) - 1
    counts, indices, st = [], [], []
    for i in range(bands):
        for j in range(ring):
            k = (j + 1) % ring
            above, below = (i - 1) * ring, i * ring
            s, t = (j / ring, (j + 1) / ring), (1.0 - i / bands, 1.0 - (i + 1) / bands)
            if i == 0:
                face, uv = [north, below + j, below + k], [(s[0], t[0]), (s[0], t[1]), (s[1], t[1])]
            elif i == bands - 1:
                face, uv = [above + j, south, above + k], [(s[0], t[0]), (s[0], t[1]), (s[1], t[0])]
            else:
                face = [above + j, below + j, below + k, above + k]
                uv = [(s[0], t[0]), (s[0], t[1]), (s[1], t[1]), (s[1], t[0])]
            counts.append(len(face))
            indices.extend(face)
            st.extend(uv)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.round(points, 5).astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(indices)
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.faceVarying).Set(
        Vt.Vec2fArray.FromNumpy(np.array(st, np.float32))
    )
    UsdGeom.XformCommonAPI(mesh).SetTranslate((x, 1.0, 0.0))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return mesh


class Look:
    """A material and its nodes."""

    def __init__(self, stage: Usd.Stage, path: str, identifier: str, **inputs: object) -> None:
        self.stage, self.path = stage, Sdf.Path(path)
        self.material = UsdShade.Material.Define(stage, path)
        self.surface = self.node("Surface", identifier, **inputs)
        context = "" if identifier == "UsdPreviewSurface" else "mtlx"
        output = (
            self.material.CreateSurfaceOutput(context) if context else self.material.CreateSurfaceOutput()
        )
        output.ConnectToSource(self.surface.CreateOutput("surface", TOKEN))

    def node(self, name: str, identifier: str, **inputs: object) -> UsdShade.Shader:
        """Inputs are outputs of other nodes, or (type, value)."""
        shader = UsdShade.Shader.Define(self.stage, self.path.AppendChild(name))
        shader.CreateIdAttr(identifier)
        for key, value in inputs.items():
            if isinstance(value, UsdShade.Output):
                kind = (
                    COLOR
                    if identifier == "UsdPreviewSurface" and key.endswith("Color")
                    else value.GetTypeName()
                )
                shader.CreateInput(key, kind).ConnectToSource(value)
            else:
                shader.CreateInput(key, value[0]).Set(value[1])
        return shader

    def texture(
        self, name: str, file: str, space: str, st: UsdShade.Output, **inputs: object
    ) -> UsdShade.Shader:
        words = {"sourceColorSpace": (TOKEN, space), "wrapS": (TOKEN, "repeat"), "wrapT": (TOKEN, "repeat")}
        return self.node(name, "UsdUVTexture", file=asset(file), st=st, **words, **inputs)


def asset(file: str) -> tuple[Sdf.ValueTypeName, Sdf.AssetPath]:
    return Sdf.ValueTypeNames.Asset, Sdf.AssetPath(f"./textures/{file}")


def preview(stage: Usd.Stage) -> Look:
    """Spotted, bumpy skin, wet in places: twice around."""
    look = Look(stage, "/World/Looks/Preview", "UsdPreviewSurface", subsurface=(FLOAT, 1.0), ior=(FLOAT, 1.4))
    look.surface.CreateInput("subsurfaceRadius", COLOR).Set(Gf.Vec3f(0.12, 0.05, 0.03))
    reader = look.node("St", "UsdPrimvarReader_float2", varname=(Sdf.ValueTypeNames.String, "st"))
    st = reader.CreateOutput("result", PAIR)
    twice = look.node("Twice", "UsdTransform2d", **{"in": st, "scale": (PAIR, Gf.Vec2f(4, 2))})
    twice = twice.CreateOutput("result", PAIR)
    four = Sdf.ValueTypeNames.Float4
    scale = {"scale": (four, Gf.Vec4f(2, 2, 2, 1)), "bias": (four, Gf.Vec4f(-1, -1, -1, 0))}
    spots = look.texture("Spots", "spots.png", "sRGB", twice).CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    bumps = look.texture("Bumps", "bumps.png", "raw", twice, **scale).CreateOutput(
        "rgb", Sdf.ValueTypeNames.Float3
    )
    words = {"scale": (four, Gf.Vec4f(-0.4, 1, 1, 1)), "bias": (four, Gf.Vec4f(0.5, 0, 0, 0))}
    wet = look.texture("Wet", "wet.png", "raw", twice, **words).CreateOutput("r", FLOAT)
    look.surface.CreateInput("subsurfaceColor", COLOR).ConnectToSource(spots)
    look.surface.CreateInput("normal", Sdf.ValueTypeNames.Normal3f).ConnectToSource(bumps)
    look.surface.CreateInput("roughness", FLOAT).ConnectToSource(wet)
    return look


def openpbr(stage: Usd.Stage) -> Look:
    """Wax whose colour and mean free path run from pole to pole."""
    look = Look(stage, "/World/Looks/OpenPBR", "ND_open_pbr_surface_surfaceshader")
    colors = {"valuet": (COLOR, Gf.Vec3f(0.9, 0.75, 0.3)), "valueb": (COLOR, Gf.Vec3f(0.3, 0.7, 0.6))}
    color = look.node("Color", "ND_ramptb_color3", **colors).CreateOutput("out", COLOR)
    radii = {"valuet": (FLOAT, 0.05), "valueb": (FLOAT, 0.5)}
    radius = look.node("Radius", "ND_ramptb_float", **radii).CreateOutput("out", FLOAT)
    look.surface.CreateInput("subsurface_weight", FLOAT).Set(1.0)
    look.surface.CreateInput("subsurface_color", COLOR).ConnectToSource(color)
    look.surface.CreateInput("subsurface_radius", FLOAT).ConnectToSource(radius)
    return look


def standard(stage: Usd.Stage) -> Look:
    """Metal where it is wet, skin elsewhere; tiled bumps by a normalmap."""
    look = Look(stage, "/World/Looks/Standard", "ND_standard_surface_surfaceshader")
    tiling = (PAIR, Gf.Vec2f(8, 4))
    bumps = look.node("Bumps", "ND_tiledimage_vector3", file=asset("bumps.png"), uvtiling=tiling)
    bent = look.node(
        "Bent", "ND_normalmap", **{"in": bumps.CreateOutput("out", VECTOR), "scale": (FLOAT, 0.5)}
    )
    wet = look.node("Wet", "ND_tiledimage_float", file=asset("wet.png"), uvtiling=(PAIR, Gf.Vec2f(2, 1)))
    wet = wet.CreateOutput("out", FLOAT)
    dry = look.node("Dry", "ND_invert_float", **{"in": wet}).CreateOutput("out", FLOAT)
    look.surface.CreateInput("base_color", COLOR).Set(Gf.Vec3f(0.9, 0.6, 0.3))
    look.surface.CreateInput("metalness", FLOAT).ConnectToSource(wet)
    look.surface.CreateInput("subsurface", FLOAT).ConnectToSource(dry)
    look.surface.CreateInput("subsurface_color", COLOR).Set(Gf.Vec3f(0.8, 0.5, 0.4))
    look.surface.CreateInput("subsurface_radius", COLOR).Set(Gf.Vec3f(0.1, 0.05, 0.03))
    look.surface.CreateInput("normal", VECTOR).ConnectToSource(bent.CreateOutput("out", VECTOR))
    return look


def write_stage(file: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.SetMetadata("renderSettingsPrimPath", "/Render/Settings")
    stage.GetRootLayer().documentation = "Driven inputs of three shaders; written by textures_scene.py."
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    for x, make in ((-2.4, preview), (0.0, openpbr), (2.4, standard)):
        look = make(stage)
        add_ball(stage, f"/World/{look.path.name}", x, look.material)
    ground = UsdGeom.Plane.Define(stage, "/World/Ground")
    ground.CreateAxisAttr("Y")
    ground.CreateWidthAttr(40.0)
    ground.CreateLengthAttr(40.0)
    key = UsdLux.RectLight.Define(stage, "/World/Key")
    key.CreateWidthAttr(3.0)
    key.CreateHeightAttr(3.0)
    key.CreateIntensityAttr(14.0)
    UsdGeom.XformCommonAPI(key).SetTranslate((4.0, 6.0, 3.0))
    UsdGeom.XformCommonAPI(key).SetRotate((-55.0, 45.0, 0.0))
    UsdLux.DomeLight.Define(stage, "/World/Sky").CreateIntensityAttr(0.25)
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(35.0)
    UsdGeom.XformCommonAPI(camera).SetTranslate((0.0, 2.2, 11.0))
    UsdGeom.XformCommonAPI(camera).SetRotate((-7.0, 0.0, 0.0))
    settings = UsdRender.Settings.Define(stage, "/Render/Settings")
    settings.CreateCameraRel().SetTargets(["/World/Camera"])
    settings.CreateResolutionAttr(Gf.Vec2i(720, 300))
    stage.GetRootLayer().Export(str(file))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    folder = parser.parse_args().out
    write_images(folder / "textures")
    write_stage(folder / "textures.usda")


if __name__ == "__main__":
    main()
