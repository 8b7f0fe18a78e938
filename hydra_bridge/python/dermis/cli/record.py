"""`dermis record STAGE OUTPUT`: usdrecord with a path tracer behind it."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from .. import color
from . import diagnostics, files, output, warnings
from .arguments import (
    add_batch_arguments,
    add_output_arguments,
    add_sampling_arguments,
    add_stage_arguments,
    add_view_arguments,
    check_tile,
    image_path,
)
from .frames import frame_path
from .interrupt import INTERRUPTED, Interrupt
from .listeners import lasting
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
        nargs="?",
        type=image_path,
        help="Output image path: .exr (scene-linear, all AOVs), .png or .jpg. For frame ranges, the path must contain "
        'exactly one frame number placeholder of the form "###" or "###.###". Note that the number of hash marks is '
        "variable in each group. A missing folder is made. It takes the place of the first RenderProduct's "
        "productName, and may be left out where the stage has one.",
    )
    add_view_arguments(parser)
    add_sampling_arguments(parser)
    add_batch_arguments(parser)
    add_output_arguments(parser)


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    """Exit code: 0 done, 1 a frame failed, 130 interrupted; usage errors leave through `parser`."""
    refuse_one_file_twice(parser, args)
    check_tile(parser, args)
    transform = display_transform(parser, args)
    with lasting(), diagnostics.recording(args):
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
    shown = args.displayImage or Path(args.outputImagePath or "").suffix.lower() in (*color.EXTENSIONS, "")
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
        self.writer = files.Writer(transform)
        self.printer = warnings.Printer()
        paths = ("outputImagePath", "displayImage", "stats")
        try:
            self.scene = open_scene(parser, args, default_settings(), paths)
        except SettingsError as error:
            parser.error(str(error))
        if not self.outputs(self.scene.times[0]):
            parser.error("the following arguments are required: OUTPUT (the stage has no RenderProduct)")
        self.said: list[str] = []
        #: File of each product in the frame before, by product.
        self.made: dict[str, str] = {}

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
                    return INTERRUPTED
        return 1 if failed else 0

    def frame(self, number: int, when: Any, progress: Progress, interrupt: Interrupt) -> None:
        began = self.began if number == 0 else time.monotonic()
        outputs = self.outputs(when)
        self.refuse_same_file(outputs)
        if self.args.skipExisting and self.is_there(outputs, when):
            print(f"Skipping{_at(when)}: {outputs[0].file} is there", flush=True)
            progress.update(number, 1.0)
            return
        for file in self.files(outputs, when):
            output.prepare_folder(file)
        last = number == len(self.scene.times) - 1
        loaded = self.scene.load(when, outputs, last)
        self.say(
            f"Camera: {loaded.camera}", "Renderer plugin: dermis", *loaded.log, *_replaced(outputs, self.args)
        )
        if when is not None:
            print(f"Recording time code: {when.GetValue():f}", flush=True)
        self.printer.print(loaded.warnings)
        for i, view in enumerate(loaded.views):
            if self.args.skipExisting and self.is_there(view.outputs, when, first=i == 0):
                print(f"Skipping{_at(when)}: {view.outputs[0].file} is there", flush=True)
                continue
            # The delegate has those of the last view of the frame before.
            if len(loaded.views) > 1:
                loaded.delegate.set_settings(json.dumps(view.settings))
                loaded.camera = view.camera
            loaded.delegate.commit(last and view is loaded.views[-1])
            self.say(*refinement_lines(json.loads(loaded.delegate.explain())["subdivision"]))
            shown = (number * len(loaded.views) + i) / len(loaded.views)
            with interrupt.deferred():
                self.view(
                    loaded,
                    view,
                    i,
                    when,
                    began,
                    lambda f, at=shown: progress.update(0, at + f / len(loaded.views)),
                    interrupt,
                )
            if interrupt.requested:
                return

    def view(
        self, loaded: Any, view: Any, number: int, when: Any, began: float, report: Any, interrupt: Interrupt
    ) -> None:
        """Renders one view and writes its files; those for eyes and the statistics are of the first."""
        keep = self.checkpoint(view)
        first = number == 0

        def snapshot() -> None:
            stats = {"complete": False}
            for made in view.outputs:
                self.writer.write(
                    loaded.delegate, made, files.snapshot_name(made.file), exr_attributes(stats, when)
                )

        complete = render(loaded.delegate, report, interrupt, keep, self.args, snapshot, self.say)
        stats = self.finish(loaded, began, complete, view.outputs[0].file)
        attributes = exr_attributes(stats, when)
        for made in view.outputs:
            self.writer.write(loaded.delegate, made, made.file, attributes)
        if self.args.displayImage and first:
            self.writer.write_display(loaded.delegate, self.named(self.args.displayImage, when), complete)
        if self.args.stats and first:
            output.write_json(self.named(self.args.stats, when), stats)
        for made in view.outputs:
            Path(files.snapshot_name(made.file)).unlink(missing_ok=True)
        # A limit that ended training ended what a longer one goes on from.
        if complete and keep and stats["samples_per_pixel"] > 0.0:
            Path(keep).unlink(missing_ok=True)
            Path(f"{keep}.training").unlink(missing_ok=True)

    def outputs(self, when: Any) -> list[Any]:
        file = self.args.outputImagePath
        return self.scene.outputs(when, self.named(file, when) if file else None)

    def files(self, outputs: list[Any], when: Any, first: bool = True) -> list[str]:
        """Everything that a frame, or a view of it, writes: the `first` has more."""
        others = (self.args.displayImage, self.args.stats) if first else ()
        return [*(made.file for made in outputs), *(self.named(path, when) for path in others if path)]

    def is_there(self, outputs: list[Any], when: Any, first: bool = True) -> bool:
        return all(files.is_complete(Path(file)) for file in self.files(outputs, when, first))

    def refuse_same_file(self, outputs: list[Any]) -> None:
        """A productName without time samples or placeholder would write every frame over the one before."""
        for made in outputs:
            if made.product and self.made.get(made.product) == made.file:
                message = f"{made.product}: productName: {made.file} is that of the frame before, too; "
                raise output.OutputError(message + "give it time samples, or a placeholder ####")
            self.made[made.product] = made.file

    def checkpoint(self, view: Any) -> str:
        """Name of the view's checkpoint; empty: none is asked for."""
        wanted = self.args.checkpoint or self.args.resume
        return f"{view.outputs[0].file}.checkpoint" if wanted and view.outputs else ""

    def finish(self, loaded: Any, began: float, complete: bool, file: str) -> dict[str, Any]:
        """The statistics of a frame, after the self-check of its image."""
        stats = json.loads(loaded.delegate.stats())
        checks = warnings.self_check(*loaded.delegate.check(), stats, file)
        merged = warnings.merge(loaded.warnings, warnings.of_stats(stats), checks)
        self.printer.print(merged)
        self.say(*_adaptive(stats))
        stats["warnings"] = [{"prim": prim, "message": message} for prim, message in merged]
        stats.setdefault("settings", json.loads(loaded.delegate.settings()))
        stats["stage"], stats["camera"] = self.args.usdFilePath, loaded.camera
        stats["complete"] = complete
        stats.setdefault("seconds", {})["flatten"] = loaded.seconds
        stats["seconds"]["total"] = time.monotonic() - began
        return stats

    def named(self, path: str, when: Any) -> str:
        return frame_path(path, when.GetValue()) if self.args.frames else path

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


#: Seconds between checkpoints where only `--resume` is typed.
CHECKPOINT_SECONDS = 300.0


def render(
    delegate: Any,
    report: Any,
    interrupt: Interrupt,
    keep: str,
    args: argparse.Namespace,
    snapshot: Any,
    say: Any,
) -> bool:
    """Renders to the end, or to the first interrupt: False. Raises CoreError if the render failed."""
    if keep:
        resumed = delegate.start(keep, args.checkpoint or CHECKPOINT_SECONDS, args.resume)
        if resumed:
            say(f"Resuming from {resumed}")
    else:
        delegate.start()
    last = time.monotonic()
    while not delegate.wait(POLL):
        if interrupt.requested:
            delegate.stop()
            report(delegate.poll()[0])
            return False
        if interrupt.snapshot or (args.snapshot and time.monotonic() - last >= args.snapshot):
            snapshot()
            interrupt.snapshot, last = False, time.monotonic()
        report(delegate.poll()[0])
    report(delegate.poll()[0])
    return True


def _replaced(outputs: list[Any], args: argparse.Namespace) -> list[str]:
    """What OUTPUT does to the first product."""
    if not args.outputImagePath or not outputs or not outputs[0].product or not outputs[0].product_name:
        return []
    first = outputs[0]
    return [
        f"OUTPUT overrides productName of <{first.product}>: {first.file} instead of {first.product_name}"
    ]


def _adaptive(stats: dict[str, Any]) -> list[str]:
    """What a noise threshold did."""
    found = stats.get("adaptive")
    if not found:
        return []
    least, most, mean = found["leastSamples"], found["mostSamples"], found["meanSamples"]
    line = f"noiseThreshold: {found['pilotSamples']} pilot samples, then {least} to {most} per pixel (mean {mean:.1f})"
    line += f" for an expected error of {found['predictedError']:.3g}"
    missed = f"; {found['tilesAtLimit']} of {found['tiles']} tiles need more" if found["tilesAtLimit"] else ""
    return [line + missed]


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


def _at(when: Any) -> str:
    return "" if when is None else f" time code {when.GetValue():f}"


def _failure(when: Any, error: Exception) -> str:
    if when is None:
        return f"Recording aborted due to the following failure: {error}"
    return f"Recording aborted due to the following failure at time code {when.GetValue()}: {error}"
