"""A stage made ready for many renders: opened as `dermis record` does, changed, flattened once into a file."""

import argparse
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd

from .. import stage as stages
from ..cli.scene import FRAME_ERRORS, SceneError, open_scene
from ..cli.settings import Settings, SettingsError, format_value
from .crops import FRAME, Crop, Window, window
from .suite import SceneSpec

#: What each render decides for itself. In the flattened file it is the same for all, so that a reference, which is
#: known by the file's content, outlives a change of it.
NEUTRAL: Settings = {
    **{"samples": 1, "sampleOffset": 0, "timeLimit": 0.0, "noiseThreshold": 0.0, "seed": 0, "threads": 0},
    **{"walk": "classical", "aovs": [], "dataWindowNDC": [0.0, 0.0, 1.0, 1.0]},
}


@dataclass(frozen=True)
class Scene:
    """A flattened stage on disk."""

    spec: SceneSpec
    file: Path
    #: Of the file's content: geometry, materials, lights, textures, camera, settings.
    key: str
    resolution: tuple[int, int]
    camera: str
    threads: int
    warnings: list[tuple[str, str]]

    @property
    def crops(self) -> tuple[Crop, ...]:
        return self.spec.crops or (FRAME,)

    @property
    def frame(self) -> Window:
        return Window(0, 0, *self.resolution)

    def window(self, crop: Crop) -> Window:
        return window(crop.ndc, self.resolution)


def open_bench_scene(
    spec: SceneSpec,
    parser: argparse.ArgumentParser,
    args: argparse.Namespace,
    defaults: Mapping[str, Any],
    folder: Path,
) -> Scene:
    """Flattens the stage of `spec` into `folder`. Raises SceneError, SettingsError."""
    session = session_layer(args.sessionLayerPath)
    opened = open_scene(parser, scene_arguments(spec, args, session), defaults)
    if len(opened.times) > 1:
        raise SettingsError("--frames: one frame can be compared at a time")
    if spec.variants or spec.overrides:
        change(opened, spec)
    try:
        loaded = opened.load(opened.times[0])
        stored = json.loads(loaded.delegate.settings())
        loaded.delegate.set_settings(json.dumps(NEUTRAL))
        file = folder / f"{hashlib.sha256(spec.name.encode()).hexdigest()[:16]}.dermis"
        loaded.delegate.save(str(file))
    except FRAME_ERRORS as error:
        raise SceneError(f"{spec.name}: {error}") from error
    key = hashlib.sha256(file.read_bytes()).hexdigest()
    width, height = stored["resolution"]
    return Scene(spec, file, key, (width, height), loaded.camera, stored["threads"], loaded.warnings)


def session_layer(file: str | None) -> Sdf.Layer:
    """A layer to change the stage in, over the session layer that was asked for, which stays as it is."""
    layer = Sdf.Layer.CreateAnonymous("bench.usda")
    if file:
        try:
            layer.subLayerPaths.append(stages.open_layer(file).identifier)
        except stages.StageError as error:
            raise SceneError(str(error)) from error
    return layer


def scene_arguments(spec: SceneSpec, args: argparse.Namespace, session: Sdf.Layer) -> argparse.Namespace:
    """What `record` would have been told to open this scene."""
    own = {
        "usdFilePath": str(spec.stage),
        "assignments": [f"{name}={format_value(value)}" for name, value in spec.settings.items()],
        "sessionLayerPath": None if spec.stage.suffix.lower() == ".dermis" else session.identifier,
        **dict.fromkeys(("samples", "seed")),
    }
    return argparse.Namespace(**{**vars(args), **own})


def change(opened: Any, spec: SceneSpec) -> None:
    """Selects variants, then authors overrides, in the session layer. Raises SceneError."""
    if not hasattr(opened, "stage"):
        raise SceneError(
            f"{spec.name}: variants and overrides are for a USD stage; {spec.stage} is flattened"
        )
    with Usd.EditContext(opened.stage, opened.stage.GetSessionLayer()):
        for path, selections in spec.variants.items():
            for name, variant in selections.items():
                select(opened.stage, spec.name, path, name, variant)
        for path, value in spec.overrides.items():
            override(opened.stage, spec.name, path, value)


def select(stage: Usd.Stage, scene: str, path: str, name: str, variant: str) -> None:
    prim = stage.GetPrimAtPath(path) if Sdf.Path.IsValidPathString(path) else None
    known = prim.GetVariantSet(name).GetVariantNames() if prim else []
    if variant not in known:
        there = f"there are {', '.join(known)}" if known else "there is no such variant set"
        raise SceneError(f"{scene}: variants: {path}{{{name}={variant}}}: {there}")
    prim.GetVariantSet(name).SetVariantSelection(variant)


def override(stage: Usd.Stage, scene: str, path: str, value: Any) -> None:
    """Authors `value`, which must fit an attribute that exists: a misspelt one would change nothing."""
    valid = Sdf.Path.IsValidPathString(path) and Sdf.Path(path).IsPropertyPath()
    attribute = stage.GetAttributeAtPath(path) if valid else None
    if not attribute:
        raise SceneError(f"{scene}: overrides: there is no attribute <{path}>")
    if attribute.HasAuthoredConnections():
        raise SceneError(f"{scene}: overrides: <{path}> is connected; its own value is not read")
    try:
        attribute.Set(tuple(value) if isinstance(value, list) else value)
    except (Tf.ErrorException, TypeError, ValueError) as error:
        kind = attribute.GetTypeName()
        raise SceneError(f"{scene}: overrides: <{path}> is a {kind}, which {value!r} is not") from error
