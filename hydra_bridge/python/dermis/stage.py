"""A composed stage at one time as flat prims: the dicts that `dermis._core` takes, with numpy arrays in
them."""

import importlib.util
import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Ar, Gf, Sdf, Tf, Usd, UsdGeom, UsdShade

from .aovs import PRIMVAR
from .arrays import np
from .camera import auto_camera, camera_fields, find_camera, find_shutter
from .colorspace import Colors
from .emit import Emitter, Still
from .index import index_of
from .instancer import Placements
from .material import flatten_material, is_fog
from .portal import domes_through
from .products import Product, flatten_products, warn_fog
from .reading import Reader, Report, usd_words
from .settings import (
    binding_purposes,
    find_settings,
    flatten_settings,
    included_purposes,
    rendering_color_space,
)
from .walk import Frame, Walk

__all__ = [
    "FlatStage",
    "Options",
    "StageError",
    "auto_camera",
    "camera_fields",
    "encode",
    "find_camera",
    "flatten",
    "flatten_prim",
    "open_stage",
]

Prim = dict[str, Any]
"""`type` (Mesh, Instancer, Material, Light, Camera, Texture, Image) and the fields of `flat::Prim` in serde's
names; arrays are C-contiguous numpy arrays: float32 (n,) or (n, k), int32 (n,), float64 (n, 4, 4), uint8 (n,),
uint16 (n,); or memoryviews of such memory of USD's, where they go to the core. An Image is a file and a colour space
until `encode` decodes it."""


class StageError(Exception):
    """A stage that cannot be opened; the text is usdrecord's."""


@dataclass(frozen=True)
class Options:
    """What decides about a flattening besides the stage.

    purposes: rendered besides `default`; None: `includedPurposes` of the render settings, else `render`.
    enable_dome_light_visibility: camera rays see dome lights that do not say otherwise themselves.
    render_settings: path of a RenderSettings prim; empty: the one named by the stage's metadata, if any.
    rendering_color_space: that of all colours; empty: `renderingColorSpace` of the render settings.
    aovs: whose primvars are read beside those of the render settings.
    camera: path of a camera to include although the walk may not reach it (inactive purpose, inside an
    instance).
    shutter_camera: name or path of the camera whose shutter counts; empty: that of the settings, else `main_cam`.
    render_pass: path of the RenderPass whose collections say what is rendered; empty: everything is.
    motion: whether to sample what moves while it is open; None: as the settings say.
    """

    purposes: tuple[str, ...] | None = None
    enable_dome_light_visibility: bool = False
    render_settings: str = ""
    camera: str = ""
    rendering_color_space: str = ""
    aovs: tuple[str, ...] = ()
    shutter_camera: str = ""
    render_pass: str = ""
    motion: bool | None = None


@dataclass
class FlatStage:
    """`prims` by path or key; `stage`: fields of `flat::StageInfo`; `settings`: authored
    `flat::RenderSettings`; `warnings`: (prim, message) of everything dropped or replaced; `products`: the
    files that the settings ask for; `purposes`: those rendered; `shutter`: open and close from the frame on; `still`:
    meshes without samples, by key, as they were read of the stage's `version`."""

    prims: dict[str, Prim] = field(default_factory=dict)
    stage: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    products: list[Product] = field(default_factory=list)
    purposes: tuple[str, ...] = ("default",)
    shutter: tuple[float, float] = (0.0, 0.0)
    still: dict[str, Still] = field(default_factory=dict)
    version: int = -1


def open_stage(
    path: str | Path,
    session_layer: str | Path | None = None,
    mask: Any = None,
    context: Ar.ResolverContext | None = None,
) -> Usd.Stage:
    """Opens .usda, .usdc or .usdz with all payloads. `mask`: prim paths of a population mask, or None. `context`:
    where its assets are looked for; None: as its root layer says.

    Raises StageError ("Could not open layer: ...") where a layer is missing or damaged.
    """
    find_materialx()
    root = open_layer(path)
    session = open_layer(session_layer) if session_layer else Sdf.Layer.CreateAnonymous(".usda")
    try:
        given = (root, session) if context is None else (root, session, context)
        if not mask:
            return Usd.Stage.Open(*given)
        paths = [mask] if isinstance(mask, str) else mask
        return Usd.Stage.OpenMasked(*given, Usd.StagePopulationMask([Sdf.Path(str(p)) for p in paths]))
    except Tf.ErrorException as error:
        raise StageError(f"Could not open layer: {path} ({usd_words(error)})") from error


def open_layer(path: str | Path) -> Sdf.Layer:
    try:
        layer = Sdf.Layer.FindOrOpen(str(path))
    except Tf.ErrorException as error:
        raise StageError(f"Could not open layer: {path} ({with_remedy(usd_words(error))})") from error
    if layer is None:
        raise StageError(f"Could not open layer: {path}")
    return layer


def flatten(
    stage: Usd.Stage,
    time: Usd.TimeCode | float | None = None,
    options: Options | None = None,
    previous: FlatStage | None = None,
) -> FlatStage:
    """The stage at `time` (None: its first). Damage costs the prim and gives a warning, never an
    exception. `previous`: at another time, with the same options; meshes without samples are not read again."""
    return in_numpy(flatten_for_core(stage, time, options, previous))


def flatten_for_core(
    stage: Usd.Stage,
    time: Usd.TimeCode | float | None = None,
    options: Options | None = None,
    previous: FlatStage | None = None,
) -> FlatStage:
    """As `flatten`, without numpy where the stage needs none."""
    flattening = Flattening(stage, time, options or Options())
    flattening.run(previous)
    return flattening.flat


def in_numpy(flat: FlatStage) -> FlatStage:
    """The same with numpy arrays alone."""

    def changed(value: Any) -> Any:
        match value:
            case memoryview():
                return np.asarray(value)
            case dict():
                return {name: changed(item) for name, item in value.items()}
            case list():
                return [changed(item) for item in value]
        return value

    flat.prims = changed(flat.prims)
    return flat


def flatten_prim(
    prim: Usd.Prim, time: Usd.TimeCode | float | None = None, options: Options | None = None
) -> FlatStage:
    """One prim, what is below it, the materials and textures these use, and the domes whose portals are among them;
    `stage` and `settings` stay empty."""
    return in_numpy(flatten_prim_for_core(prim, time, options))


def flatten_prim_for_core(
    prim: Usd.Prim, time: Usd.TimeCode | float | None = None, options: Options | None = None
) -> FlatStage:
    """As `flatten_prim`, without numpy where the prim needs none."""
    options = options or Options()
    flat = flatten_alone(prim, time, options)
    if not prim.IsA(UsdShade.Material):
        for dome in domes_through(prim):
            beside = flatten_alone(dome, time, options)
            flat.prims |= beside.prims
            flat.warnings += [warning for warning in beside.warnings if warning not in flat.warnings]
    return flat


def flatten_alone(prim: Usd.Prim, time: Usd.TimeCode | float | None, options: Options) -> FlatStage:
    """[`flatten_prim_for_core`] without the domes."""
    flattening = Flattening(prim.GetStage(), time, options, prim)
    if prim.IsA(UsdShade.Material):
        images: dict[str, Prim] = {}
        material = flatten_material(prim, flattening.reader, images)
        flattening.flat.prims = {str(prim.GetPath()): material, **images}
        flattening.flat.warnings = flattening.reader.report.warnings
    else:
        flattening.run()
    return flattening.flat


class Flattening:
    """One look at a stage, or at `root` and below: the settings that decide, then the prims."""

    def __init__(
        self,
        stage: Usd.Stage,
        time: Usd.TimeCode | float | None,
        options: Options,
        root: Usd.Prim | None = None,
    ) -> None:
        self.stage, self.options, self.root = stage, options, root
        time = first_time(stage) if time is None else Usd.TimeCode(time)
        self.reader = reader = Reader(time, Report())
        index = index_of(stage)
        reader.primvars = tuple(sorted(index.primvars_read(stage) | {"st"}))
        if root is None:
            warn_composition(stage, reader.report)
        settings = find_settings(stage, options.render_settings, reader)
        space = rendering_color_space(settings, reader, options.rendering_color_space)
        reader.colors = Colors(space, reader.warn)
        purposes = included_purposes(settings, reader) if options.purposes is None else options.purposes
        self.flat = FlatStage(purposes=tuple(sorted({"default", *purposes})), version=index.version)
        if root is None:
            self.flat.stage = stage_info(stage, time, reader)
        self.settings_prim = settings
        self.authored, self.products = self.settings(settings)
        if root is None:
            self.flat.settings, self.flat.products = self.authored, self.products
        reader.show(aov.removeprefix(PRIMVAR) for aov in self.aovs() if aov.startswith(PRIMVAR))
        self.binding = binding_purposes(settings, reader)
        self.links, said = index.links(stage, options.render_pass)
        for warning in said.warnings:
            reader.warn(*warning)

    def settings(self, prim: Usd.Prim | None) -> tuple[dict[str, Any], list[Product]]:
        """Those of a RenderSettings prim, and its products. Their faults are said with the whole stage."""
        reader = self.reader
        if self.root is not None:
            reader = Reader(reader.time, Report())
            reader.colors = self.reader.colors
        return (flatten_settings(prim, reader), flatten_products(prim, reader)) if prim else ({}, [])

    def aovs(self) -> list[str]:
        """All that are asked for."""
        layers = [layer["aov"] for product in self.products for layer in product.layers or ()]
        return [*self.options.aovs, *self.authored.get("aovs", ()), *layers]

    def run(self, previous: FlatStage | None = None) -> None:
        """Fills in the prims, and what was to be said."""
        flat, reader = self.flat, self.reader
        placements = Walk(self.stage, reader, flat.purposes, self.binding, self.links).run(self.root)
        emitter = Emitter(reader, self.binding, self.options.enable_dome_light_visibility, self.links)
        if previous is not None and previous.version == flat.version:
            emitter.known = previous.still
        flat.prims, flat.still = emitter.emit(placements), emitter.still
        self.sample_motion(placements, self.add_cameras())
        if self.settings_prim and self.root is None and any(map(is_fog, flat.prims.values())):
            warn_fog(self.settings_prim, reader)
        flat.warnings = reader.report.warnings

    def add_cameras(self) -> list[Usd.Prim]:
        """Adds those to render from that the walk does not come to, as in an invisible instance. One that is not there
        is dropped from the settings, with a warning."""
        path = self.options.camera or self.authored.get("camera", "")
        if path and self.root is None and find_camera(self.stage, path) is None:
            self.reader.warn(path, "camera: there is no such camera; it is ignored")
            if self.flat.settings.get("camera") == path:
                del self.flat.settings["camera"]
        names = [path, *(product.settings.get("camera", "") for product in self.products)]
        asked = [find_camera(self.stage, name) for name in names if name]
        below = self.root.GetPath() if self.root else Sdf.Path.absoluteRootPath
        added = []
        for camera in filter(None, (*asked, self.shutter_camera())):
            if camera.GetPath().HasPrefix(below) and not is_camera(self.flat.prims, str(camera.GetPath())):
                fields = camera_fields(camera, self.reader.time, self.reader.report)
                self.flat.prims[str(camera.GetPath())] = fields
                added.append(camera.GetPrim())
        return added

    def shutter_camera(self) -> UsdGeom.Camera | None:
        """Whose shutter counts."""
        name = self.options.shutter_camera or self.options.camera or self.authored.get("camera", "")
        return (find_camera(self.stage, name) if name else None) or find_camera(self.stage)

    def sample_motion(self, placements: dict[Frame, Placements], cameras: list[Usd.Prim]) -> None:
        """Adds the keys of what moves while the shutter is open; `cameras` stand beside `placements`."""
        camera = self.shutter_camera()
        if camera is None:
            return
        self.flat.shutter = opens, closes = find_shutter(camera.GetPrim(), self.reader)
        if self.wants_motion() and closes > opens:
            from .motion import Scene, Shutter, add_motion  # only where something may move

            scene = Scene(
                self.stage, self.reader, self.flat.purposes, self.binding, self.root, placements, self.links
            )
            scene.cameras = cameras
            add_motion(self.flat.prims, scene, Shutter(self.reader.time.GetValue(), opens, closes))

    def wants_motion(self) -> bool:
        """For blur in one of the products, or for vectors."""
        if self.options.motion is not None:
            return self.options.motion
        off = self.authored.get("disableMotionBlur", False)
        sharp = [product.settings.get("disableMotionBlur", off) for product in self.products] or [off]
        return "motionVector" in self.aovs() or not all(sharp)


def first_time(stage: Usd.Stage) -> Usd.TimeCode:
    """The start of the stage's range; without one the earliest sample, since at the default time animated
    attributes may have no value."""
    start = stage.GetStartTimeCode()
    return Usd.TimeCode(start) if stage.HasAuthoredMetadata("startTimeCode") else Usd.TimeCode.EarliestTime()


def is_camera(prims: dict[str, Prim], path: str) -> bool:
    return path in prims and prims[path]["type"] == "Camera"


def stage_info(stage: Usd.Stage, time: Usd.TimeCode, reader: Reader) -> dict[str, Any]:
    layer = stage.GetRootLayer()
    scale = UsdGeom.GetStageMetersPerUnit(stage)
    if not (math.isfinite(scale) and scale > 0.0):
        reader.warn("/", f"metersPerUnit: {scale} is not positive; 0.01 is used")
        scale = 0.01
    return {
        "file": layer.realPath or layer.identifier,
        "upAxis": str(UsdGeom.GetStageUpAxis(stage)),
        "metersPerUnit": scale,
        "timeCode": 0.0 if time.IsDefault() or time.IsEarliestTime() else time.GetValue(),
    }


def warn_composition(stage: Usd.Stage, report: Report) -> None:
    """References, payloads and sublayers that did not resolve; the rest of the stage renders."""
    for error in stage.GetCompositionErrors():
        site = str(getattr(error, "rootSite", "")).rstrip(">")
        path = site.rsplit("<", 1)[-1] if "<" in site else "/"
        report.warn(path, f"composition: {with_remedy(str(error))}")


def with_remedy(message: str) -> str:
    """USD's words about a layer it has no reader for, and what to do where that is a MaterialX file."""
    if ".mtlx" not in message or "file format" not in message:
        return message
    return (
        f"{message.rstrip('.')}: usd-core has no reader for MaterialX files; pip uninstall usd-core, then pip install "
        "usd-exchange MaterialX"
    )


def find_materialx() -> None:
    """Tells USD's reader of MaterialX files, where there is one, where the standard library is: without it materials
    come without shaders, and without a word."""
    package = importlib.util.find_spec("MaterialX")
    if package and package.submodule_search_locations:
        libraries = Path(package.submodule_search_locations[0]) / "libraries"
        os.environ.setdefault("PXR_MTLX_STDLIB_SEARCH_PATHS", str(libraries))


def encode(prim: Prim) -> tuple[str, list[Any]]:
    """JSON of a prim in which {"array": i} stands for the i-th of the arrays returned beside it. Images of materials
    are decoded here, so that their texels are in memory once, in the core.

    Raises ValueError where a number that is not finite would reach the JSON.
    """
    arrays: list[Any] = []
    if prim["type"] == "Image" and "texels" not in prim:
        from .images import load_image

        prim = load_image(prim)

    def default(value: Any) -> Any:
        if isinstance(value, (Gf.Matrix4d, Gf.Vec2f, Gf.Vec3f, Gf.Vec4f)):
            return [list(row) if isinstance(value, Gf.Matrix4d) else row for row in value]
        if isinstance(value, memoryview):
            arrays.append(value)
            return {"array": len(arrays) - 1}
        if isinstance(value, np.ndarray):
            arrays.append(np.ascontiguousarray(value))
            return {"array": len(arrays) - 1}
        if isinstance(value, np.generic):
            return value.item()
        raise TypeError(f"{type(value).__name__} cannot be part of a prim")

    return json.dumps(prim, default=default, allow_nan=False), arrays
