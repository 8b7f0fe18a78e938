"""`dermis record STAGE OUTPUT`: usdrecord with a path tracer behind it."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from .. import color
from . import diagnostics, output, warnings
from .arguments import (
    add_output_arguments,
    add_sampling_arguments,
    add_stage_arguments,
    add_view_arguments,
    image_path,
)
from .frames import frame_path
from .interrupt import Interrupt
from .progress import Progress, default_kind
from .settings import SettingsError, default_settings

NAME = "record"
FILES = "STAGE OUTPUT"
HELP = "Generates images from a USD file"

#: Seconds between looks at a running render: short enough for Ctrl-C, long enough to cost nothing.
POLL = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_stage_arguments(parser)
    parser.add_argument(
        "outputImagePath",
        metavar="OUTPUT",
        type=image_path,
        help="Output image path: .exr (scene-linear, all AOVs), .png or .jpg. For frame ranges, the path must contain "
        'exactly one frame number placeholder of the form "###" or "###.###". Note that the number of hash marks is '
        "variable in each group. A missing folder is made.",
    )
    add_view_arguments(parser)
    add_sampling_arguments(parser)
    add_output_arguments(parser)


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    """Exit code: 0 done, 1 a frame failed, 130 interrupted; usage errors leave through `parser`."""
    refuse_one_file_twice(parser, args)
    transform = display_transform(parser, args)
    with diagnostics.recording(args):
        return Recorder(parser, args, transform).record()


def refuse_one_file_twice(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Outputs of one name would replace each other; only the last would be left."""
    named = [path for path in (args.outputImagePath, args.displayImage, args.stats) if path]
    if len({Path(path).absolute() for path in named}) < len(named):
        parser.error("OUTPUT, --displayImage and --stats must be different files")


def display_transform(parser: argparse.ArgumentParser, args: argparse.Namespace) -> color.DisplayTransform:
    """Made before the render, so that a mistyped view costs no render."""
    mode = args.colorCorrectionMode or "openColorIO"
    ocio_flags = [args.ocioConfig, args.ocioDisplay, args.ocioView, args.ocioLook]
    if mode != "openColorIO" and any(ocio_flags):
        parser.error(
            f"--colorCorrectionMode {mode} does not go with --ocioConfig, --ocioDisplay, --ocioView, --ocioLook"
        )
    shown = args.displayImage or Path(args.outputImagePath).suffix.lower() in color.EXTENSIONS
    if not shown and not any(ocio_flags):
        return color.DisplayTransform("disabled")
    try:
        return color.DisplayTransform(mode, *(flag or "" for flag in ocio_flags))
    except color.ColorError as error:
        parser.error(str(error))


class Recorder:
    """One run: the scene, its frames, their files."""

    def __init__(
        self, parser: argparse.ArgumentParser, args: argparse.Namespace, transform: color.DisplayTransform
    ) -> None:
        from .scene import open_scene

        self.began = time.monotonic()
        self.args = args
        self.transform = transform
        self.printer = warnings.Printer()
        paths = ("outputImagePath", "displayImage", "stats")
        try:
            self.scene = open_scene(parser, args, default_settings(), paths)
        except SettingsError as error:
            parser.error(str(error))
        self.said: list[str] = []

    def record(self) -> int:
        from .scene import FRAME_ERRORS

        failed = False
        with (
            Progress(self.args.progress or default_kind(), len(self.scene.times)) as progress,
            Interrupt() as interrupt,
        ):
            for number, when in enumerate(self.scene.times):
                try:
                    self.frame(number, when, progress, interrupt)
                except (*FRAME_ERRORS, output.OutputError) as error:
                    failed = True
                    print(_failure(when, error), file=sys.stderr)
                if interrupt.requested:
                    return 130
        return 1 if failed else 0

    def frame(self, number: int, when: Any, progress: Progress, interrupt: Interrupt) -> None:
        began = self.began if number == 0 else time.monotonic()
        for path in (self.args.outputImagePath, self.args.displayImage, self.args.stats):
            if path:
                output.prepare_folder(self.named(path, when))
        loaded = self.scene.load(when)
        self.say(f"Camera: {loaded.camera}", "Renderer plugin: dermis", *loaded.log)
        if when is not None:
            print(f"Recording time code: {when.GetValue():f}", flush=True)
        self.printer.print(loaded.warnings)
        loaded.delegate.commit()
        self.say(*refinement_lines(json.loads(loaded.delegate.explain())["subdivision"]))
        with interrupt.deferred():
            render(loaded.delegate, lambda fraction: progress.update(number, fraction), interrupt)
            stats = self.finish(loaded, began)
            self.write(loaded, when, stats)

    def finish(self, loaded: Any, began: float) -> dict[str, Any]:
        """The statistics of a frame, after the self-check of its image."""
        stats = json.loads(loaded.delegate.stats())
        checks = warnings.self_check(loaded.delegate.snapshot()["color"], stats)
        merged = warnings.merge(loaded.warnings, warnings.of_stats(stats), checks)
        self.printer.print(merged)
        stats["warnings"] = [{"prim": prim, "message": message} for prim, message in merged]
        stats.setdefault("settings", json.loads(loaded.delegate.settings()))
        stats["stage"], stats["camera"] = self.args.usdFilePath, loaded.camera
        stats.setdefault("seconds", {})["flatten"] = loaded.seconds
        stats["seconds"]["total"] = time.monotonic() - began
        return stats

    def write(self, loaded: Any, when: Any, stats: dict[str, Any]) -> None:
        image = self.named(self.args.outputImagePath, when)
        if Path(image).suffix.lower() == ".exr":
            loaded.delegate.write_exr(image, json.dumps(exr_attributes(stats, when)))
        else:
            self.write_display(loaded, image)
        if self.args.displayImage:
            self.write_display(loaded, self.named(self.args.displayImage, when))
        if self.args.stats:
            output.write_json(self.named(self.args.stats, when), stats)

    def named(self, path: str, when: Any) -> str:
        return frame_path(path, when.GetValue()) if self.args.frames else path

    def write_display(self, loaded: Any, file: str) -> None:
        with output.replacing(file) as temporary:
            color.write_display_image(temporary, loaded.delegate.snapshot()["color"], self.transform)

    def say(self, *lines: str) -> None:
        """Prints what usdrecord says once per run; again only when it changes."""
        for line in lines:
            if line not in self.said:
                self.said.append(line)
                print(line, flush=True)


def refinement_lines(surfaces: list[dict[str, Any]]) -> list[str]:
    """What was refined: a line per level."""
    lines = []
    for level in sorted({surface["level"] for surface in surfaces}):
        triangles = [surface["triangles"] for surface in surfaces if surface["level"] == level]
        hint = " (their cages; --complexity refines them)" if level == 0 else ""
        lines.append(
            f"Subdivision surfaces at level {level}: {len(triangles)}, {sum(triangles)} triangles{hint}"
        )
    return lines


def render(delegate: Any, report: Any, interrupt: Interrupt) -> None:
    """Renders to the end, or to the first interrupt. Raises CoreError if the render failed."""
    delegate.start()
    while not delegate.wait(POLL):
        if interrupt.requested:
            delegate.stop()
            break
        report(delegate.poll()[0])
    report(delegate.poll()[0])


def exr_attributes(stats: dict[str, Any], when: Any) -> dict[str, str]:
    """Statistics and settings as attributes of the EXR header, under dotted names."""
    attributes = {f"dermis.{name}": text for name, text in _flattened(stats) if text}
    if when is not None:
        attributes["dermis.timeCode"] = f"{when.GetValue():g}"
    return attributes


def _flattened(value: Any, name: str = "") -> list[tuple[str, str]]:
    if isinstance(value, dict):
        return [
            pair for key, item in value.items() for pair in _flattened(item, f"{name}.{key}" if name else key)
        ]
    return [(name, value if isinstance(value, str) else json.dumps(value))]


def _failure(when: Any, error: Exception) -> str:
    if when is None:
        return f"Recording aborted due to the following failure: {error}"
    return f"Recording aborted due to the following failure at time code {when.GetValue()}: {error}"
