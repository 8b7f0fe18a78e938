"""From a stage to named arrays in one call."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pxr import Usd

from .arrays import np
from .hydra import populate
from .stage import (
    FlatStage,
    Options,
    auto_camera,
    camera_fields,
    find_camera,
    first_time,
    flatten_for_core,
    is_camera,
    open_stage,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

AUTO_CAMERA = "/dermis/AutoCamera"
"""Where the camera goes that frames a stage without one."""


class Image(Mapping[str, "NDArray[np.float32]"]):
    """AOVs by name, float32 (height, width, channels), linear: `image["color"]` or `image.color` (RGBA).

    `stats` has the names of `--stats`.
    """

    def __init__(self, arrays: dict[str, NDArray[np.float32]], stats: dict[str, Any]) -> None:
        self._arrays = arrays
        self.stats = stats

    def __getitem__(self, name: str) -> NDArray[np.float32]:
        return self._arrays[name]

    def __getattr__(self, name: str) -> NDArray[np.float32]:
        arrays = self.__dict__.get("_arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"the image has no '{name}'; it has {', '.join(sorted(arrays))}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        height, width = next(iter(self._arrays.values())).shape[:2] if self._arrays else (0, 0)
        return f"Image({width} x {height}: {', '.join(self._arrays)})"


def render(
    stage_or_path: Usd.Stage | str | Path,
    *,
    time: Usd.TimeCode | float | None = None,
    purposes: tuple[str, ...] | None = None,
    enable_dome_light_visibility: bool = False,
    core: Any = None,
    **settings: Any,
) -> Image:
    """Renders a stage (or a `.dermis` file) and returns its AOVs.

    `settings` are render settings by name (`samples=64`, `camera="/World/Cam"`, `resolution=(960, 540)`,
    ...) and win over the stage's; `time` None is the stage's first. Without camera the stage is framed as
    usdrecord does. Ctrl-C stops the render. Raises StageError or CoreError.
    """
    if core is None:
        from ._core import Delegate as core
    if not isinstance(stage_or_path, Usd.Stage) and Path(stage_or_path).suffix == ".dermis":
        delegate = core.load(str(stage_or_path))
    else:
        stage = stage_or_path if isinstance(stage_or_path, Usd.Stage) else open_stage(stage_or_path)
        still, vectors = settings.get("disableMotionBlur"), "motionVector" in settings.get("aovs", ())
        options = Options(
            purposes,
            enable_dome_light_visibility,
            camera=settings.get("camera", ""),
            rendering_color_space=settings.get("renderingColorSpace", ""),
            aovs=tuple(settings.get("aovs", ())),
            motion=True if vectors else None if still is None else not still,
        )
        flat = flatten_for_core(stage, time, options)
        ensure_camera(stage, time, flat, settings)
        delegate = core()
        # Before images are synced, which go where it says.
        if "textureMemory" in settings:
            flat.settings["textureMemory"] = settings["textureMemory"]
        populate(delegate, flat)
        del flat  # its arrays are let go with the last commit
    if settings:
        delegate.set_settings(json.dumps(settings, allow_nan=False))
    delegate.commit(True)
    run(delegate)
    return Image(delegate.snapshot(), json.loads(delegate.stats()))


def ensure_camera(stage: Usd.Stage, time: Any, flat: FlatStage, settings: dict[str, Any]) -> None:
    """Settles camera and resolution in `flat`: those given, those authored, else usdrecord's defaults."""
    path = settings.get("camera") or flat.settings.get("camera", "")
    if not is_camera(flat.prims, path):
        code = first_time(stage) if time is None else Usd.TimeCode(time)
        camera = find_camera(stage, path)
        path = str(camera.GetPath()) if camera else AUTO_CAMERA
        if not camera:
            flat.prims[path] = auto_camera(stage, code, flat.purposes)
        elif path not in flat.prims:
            flat.prims[path] = camera_fields(camera, code)
        settings.pop("camera", None)
        flat.settings["camera"] = path
    if "resolution" not in flat.settings:
        fields = flat.prims[path]
        aspect = fields["horizontalAperture"] / (fields["verticalAperture"] or 1.0)
        flat.settings["resolution"] = [960, max(1, int(960 / aspect)) if aspect > 0.0 else 1]


def run(delegate: Any) -> None:
    """Renders to the end; an interrupt stops it first."""
    delegate.start()
    try:
        while not delegate.wait(0.1):
            pass
    except BaseException:
        delegate.stop()
        raise
