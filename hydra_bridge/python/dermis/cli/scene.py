"""What a command works on: a USD stage that is flattened per frame, or a `.dermis` file."""

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Usd, UsdGeom

from dermis import camera as cameras
from dermis import hydra, passes, products, stage
from dermis._core import CoreError, Delegate
from dermis.image import AUTO_CAMERA
from dermis.reading import Reader, Report
from dermis.settings import base_settings, dermis_settings

from . import view
from .frames import Frames, resolve_times
from .outputs import Output, View, grouped, planned, shared_aovs
from .settings import Settings, SettingsError, overrides, typed_settings

#: Flags that a flattened file has already answered.
STAGE_FLAGS = (
    "populationMask",
    "purposes",
    "sessionLayerPath",
    "frames",
    "defaultTime",
    "rpPrimPath",
    "rsPrimPath",
    "enableDomeLightVisibility",
    "disableCameraLight",
)

Warnings = list[tuple[str, str]]


class SceneError(Exception):
    """A scene that cannot be opened or flattened; the text names it."""


@dataclass
class Loaded:
    """A scene in the delegate, not yet committed."""

    delegate: Delegate
    #: Path of the camera; empty when the stage is framed automatically.
    camera: str
    #: Seconds spent to open and flatten.
    seconds: float
    warnings: Warnings = field(default_factory=list)
    #: Lines for the log.
    log: list[str] = field(default_factory=list)
    #: What is rendered, one after the other; the delegate has the settings of the first.
    views: list[View] = field(default_factory=list)


class FlatFile:
    """A `.dermis` file: one time, its settings inside, camera and sampling still to be chosen."""

    def __init__(self, parser: argparse.ArgumentParser, args: argparse.Namespace, typed: Settings) -> None:
        for flag in STAGE_FLAGS:
            if getattr(args, flag, None):
                parser.error(f"{flag} applies to a USD stage; {args.usdFilePath} is already flattened")
        self.args = args
        self.typed = typed
        self.times: Frames | list[None] = [None]

    def outputs(self, when: None, file: str | None) -> list[Output]:
        """The files of the only time there is."""
        return planned(file, [])

    def load(self, when: None, outputs: list[Output] | None = None, last: bool = True) -> Loaded:
        began = time.monotonic()
        delegate = Delegate.load(self.args.usdFilePath)
        stored = json.loads(delegate.settings())
        loaded = Loaded(delegate, stored["camera"], 0.0)
        self._choose_camera(loaded)
        width, height = stored["resolution"]
        kept = stored if self.args.imageWidth is None else {}
        size = view.image_size(self.args, self.typed, kept, width / height)
        shown = "" if loaded.camera == AUTO_CAMERA else loaded.camera
        settings = {**stored, **self.typed, "camera": loaded.camera, "resolution": size}
        space = stored["renderingColorSpace"]
        if settings["renderingColorSpace"] != space:
            message = f"renderingColorSpace: its colours are in {space} already, which is used; flatten the stage again"
            loaded.warnings.append((self.args.usdFilePath, message))
            settings["renderingColorSpace"] = space
        settings["dataWindowNDC"] = view.tile_window(self.args, settings["dataWindowNDC"])
        delegate.set_settings(json.dumps(settings))
        loaded.views = [View(settings, outputs or [])]
        loaded.camera, loaded.seconds = shown, time.monotonic() - began
        return loaded

    def _choose_camera(self, loaded: Loaded) -> None:
        name = self.args.camera or self.typed.get("camera", "")
        if not name:
            return
        found = view.find_named(loaded.delegate.cameras(), name)
        if found is None:
            loaded.warnings.append(
                (name, f"camera: not found in {self.args.usdFilePath}; {loaded.camera} is used")
            )
        else:
            loaded.camera = found


class Stage:
    """A USD stage, opened once and flattened for each time; the delegate is kept from time to time."""

    def __init__(
        self,
        parser: argparse.ArgumentParser,
        args: argparse.Namespace,
        typed: Settings,
        defaults: Settings,
        paths: tuple[str, ...],
    ) -> None:
        began = time.monotonic()
        self.args = args
        self.typed = typed
        self.defaults = defaults
        mask = (args.populationMask or "").replace(",", " ").split() or None
        context = Ar.GetResolver().GetCurrentContext() if args.resolver == "inherit" else None
        self.stage = stage.open_stage(args.usdFilePath, args.sessionLayerPath, mask, context)
        self.times = resolve_times(parser, args, self.stage, paths)
        self.warnings: Warnings = [
            (path, "mask: there is no such prim") for path in mask or () if not self.stage.GetPrimAtPath(path)
        ]
        self.settings_path = self._settings_path()
        self.purposes = self._purposes()
        self._opening = time.monotonic() - began
        self._delegate: Delegate | None = None
        self._previous: Any = None
        #: What the last `load` sent, by path.
        self.synced: dict[str, hydra.DirtyBits] = {}

    def outputs(self, when: Usd.TimeCode, file: str | None) -> list[Output]:
        """The files of a time: `file`, which takes the place of the first product, and those of the other products.

        Raises OutputError for products that cannot be told apart.
        """
        prim = self._settings_prim()
        found = products.flatten_products(prim, Reader(when, Report())) if prim else []
        tile = getattr(self.args, "tileIndex", None)
        return planned(file, found, bool(self.args.frames), when, "aovs" in self.typed, tile)

    def load(self, when: Usd.TimeCode, outputs: list[Output] | None = None, last: bool = False) -> Loaded:
        """`last`: no other follows, so that nothing is kept for it."""
        began = time.monotonic()
        delegate, previous = self._delegate or Delegate(), self._previous
        self._delegate = self._previous = None  # not kept if this frame fails half-way
        flat = stage.flatten_for_core(self.stage, when, self._options(), previous)
        loaded = Loaded(delegate, "", 0.0, warnings=[*self.warnings])
        flat.settings = self._taken(flat.settings, loaded)
        authored = {**flat.settings}
        loaded.views = [
            self._settle_view(flat, when, loaded, authored, group) for group in grouped(outputs or [])
        ]
        flat.settings = dict(loaded.views[0].settings)
        self._light(flat, flat.settings["camera"], loaded)
        self.synced = hydra.populate(delegate, flat, previous)
        loaded.camera = loaded.views[0].camera
        loaded.warnings.extend(flat.warnings)
        loaded.seconds = self._opening + time.monotonic() - began
        self._opening = 0.0
        if not last:
            self._delegate, self._previous = delegate, flat
        return loaded

    def _taken(self, authored: Settings, loaded: Loaded) -> Settings:
        """The settings of the stage that the core takes; a typing error in one of them costs that one."""
        tried, good = Delegate(), {}
        for name, value in authored.items():
            try:
                tried.set_settings(json.dumps({name: value}))
                good[name] = value
            except (CoreError, ValueError) as error:
                fault = self.settings_path, str(error).removeprefix("render settings: ") + "; it is ignored"
                loaded.warnings.extend({fault} - {*loaded.warnings})
        return good

    def _options(self) -> stage.Options:
        typed = self.typed.get("disableMotionBlur")
        vectors = "motionVector" in self.typed.get("aovs", ())
        return stage.Options(
            self.purposes,
            self.args.enableDomeLightVisibility,
            self.settings_path,
            rendering_color_space=self.typed.get("renderingColorSpace", ""),
            aovs=tuple(self.typed.get("aovs", ())),
            shutter_camera=self.args.camera or self.typed.get("camera", ""),
            render_pass=self.args.rpPrimPath or "",
            motion=True if vectors else None if typed is None else not typed,
        )

    def _purposes(self) -> tuple[str, ...] | None:
        """Typed, else (None) those that the settings prim authors, else usdrecord's default."""
        if self.args.purposes:
            return self.args.purposes
        prim = self._settings_prim()
        if prim and prim.GetAttribute("includedPurposes").HasAuthoredValue():
            return None
        hidden = [p for p in self.stage.Traverse() if p.IsA(UsdGeom.Gprim) and _purpose(p) == "render"]
        if hidden:
            message = f"purpose: render is left out, here and at {len(hidden) - 1} more prims; --purposes render has it"
            self.warnings.append((str(hidden[0].GetPath()), message))
        return ("default", "proxy")

    def _settings_prim(self) -> Usd.Prim | None:
        path = self.settings_path
        prim = self.stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
        return prim if prim and prim.IsA("RenderSettings") else None

    def _settle_view(
        self, flat: Any, when: Usd.TimeCode, loaded: Loaded, authored: Settings, outputs: list[Output]
    ) -> View:
        """Settings of the view that `outputs` share, with its camera, which joins the flattened stage, and size."""
        first = outputs[0] if outputs else None
        source = f"<{(first and first.product) or self.settings_path}>"
        if first and first.product:
            vars_of_first = {"aovs": authored["aovs"]} if "aovs" in self.typed and "aovs" in authored else {}
            authored = {**self._shared_settings(authored, when), **first.settings, **vars_of_first}
            authored = self._taken(authored, loaded)
        if any(prim == authored.get("camera") and said.startswith("camera:") for prim, said in flat.warnings):
            del authored["camera"]
        loaded.log += overrides(self.typed, authored, source)
        camera = self._find_camera(authored.get("camera", ""), loaded)
        path = str(camera.GetPath()) if camera else AUTO_CAMERA
        shown = path if camera else ""
        if camera and path not in flat.prims:
            flat.prims[path] = cameras.camera_fields(camera, when)
        elif not camera:
            aspect = view.framing_aspect(self.args, self.typed, authored)
            flat.prims[path] = cameras.auto_camera(self.stage, when, flat.purposes, aspect)
        if camera and list(flat.shutter) != flat.prims[path]["shutter"]:
            spans = [
                f"{opens:g} to {closes:g}" for opens, closes in (flat.prims[path]["shutter"], flat.shutter)
            ]
            message = f"shutter:open, shutter:close: {spans[0]}; motion is sampled from {spans[1]}, for all products"
            loaded.warnings.append((path, message))
        size = view.image_size(self.args, self.typed, authored, view.aspect_ratio(flat.prims[path]))
        if "resolution" in authored and size != authored["resolution"]:
            loaded.log += overrides({"resolution": size}, authored, source)
        aovs = {} if "aovs" in self.typed else shared_aovs(outputs)
        settings = {**self.defaults, **authored, **aovs, **self.typed, "camera": path, "resolution": size}
        settings["dataWindowNDC"] = view.tile_window(self.args, settings["dataWindowNDC"])
        return View(settings, outputs, shown)

    def _shared_settings(self, authored: Settings, when: Usd.TimeCode) -> Settings:
        """What the RenderSettings prim says for all products: `authored` is that with the first product over it."""
        prim = self._settings_prim()
        reader = Reader(when, Report())
        if not prim:
            return authored
        space = {name: authored[name] for name in ("renderingColorSpace",) if name in authored}
        return {**base_settings(prim, reader), **dermis_settings(prim, reader), **space}

    def _find_camera(self, authored: str, loaded: Loaded) -> UsdGeom.Camera | None:
        """Typed, else of the settings prim, else `main_cam`; None when there is none of them."""
        typed = self.args.camera or self.typed.get("camera", "")
        for name, attribute in ((typed, "camera"), (authored, f"camera of {self.settings_path}")):
            camera = cameras.find_camera(self.stage, name) if name else None
            if camera:
                return camera
            if name:
                loaded.warnings.append((name, f"{attribute}: there is no such camera on the stage"))
        camera = cameras.find_camera(self.stage)
        if camera is None:
            loaded.warnings.append(("/", "camera: none found; the stage is framed automatically"))
        return camera

    def _light(self, flat: Any, camera: str, loaded: Loaded) -> None:
        if any(prim["type"] == "Light" for prim in flat.prims.values()):
            return
        if self.args.disableCameraLight:
            loaded.warnings.append(("/", "lights: the stage has none and the camera light is disabled"))
            return
        flat.prims[view.CAMERA_LIGHT] = view.camera_light(flat.prims[camera])
        loaded.warnings.append(
            (
                "/",
                "lights: the stage has none; it is lit from the camera (--disableCameraLight turns that off)",
            )
        )

    def _settings_path(self) -> str:
        """Path of the RenderSettings prim: typed, of the typed pass, or of the stage's metadata; or empty."""
        if self.args.rsPrimPath and self.args.rpPrimPath:
            raise SceneError("Cannot specify both --renderSettingsPrimPath and --renderPassPrimPath")
        if self.args.rpPrimPath:
            return self._pass_settings(self.args.rpPrimPath)
        return self.args.rsPrimPath or str(self.stage.GetMetadata("renderSettingsPrimPath") or "")

    def _pass_settings(self, path: str) -> str:
        prim = self.stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else Usd.Prim()
        if not passes.is_pass(prim):
            raise SceneError(f"Unknown render pass <{path}>")
        self.warnings.extend(passes.pass_warnings(prim))
        targets = prim.GetRelationship("renderSource").GetTargets()
        if not targets:
            raise SceneError(f"Render source not authored on {path}")
        if len(targets) > 1:
            self.warnings.append((path, f"renderSource: has multiple targets; using <{targets[0]}>"))
        return str(targets[0])


def open_scene(
    parser: argparse.ArgumentParser, args: argparse.Namespace, defaults: Settings, paths: tuple[str, ...] = ()
) -> Stage | FlatFile:
    """The scene that the arguments name; `paths` are the arguments that name a file per frame.

    Raises SceneError and SettingsError; leaves with a usage error for frames that do not fit `paths`.
    """
    typed = typed_settings(args, defaults)
    view.image_size(args, typed, {}, 1.0)  # only for what it refuses: before the stage is opened
    if Path(args.usdFilePath).suffix.lower() == ".dermis":
        return FlatFile(parser, args, typed)
    try:
        return Stage(parser, args, typed, defaults, paths)
    except stage.StageError as error:
        raise SceneError(str(error)) from error


#: What a frame can fail by; anything else is a bug and shows its traceback.
#: (ValueError: a setting or a number that the core does not take.)
FRAME_ERRORS = (SceneError, SettingsError, stage.StageError, CoreError, ValueError, OSError)


def _purpose(prim: Usd.Prim) -> str:
    return str(UsdGeom.Imageable(prim).ComputePurpose())
