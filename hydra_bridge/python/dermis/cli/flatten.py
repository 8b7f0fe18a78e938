"""`dermis flatten STAGE OUT.dermis`: the flattened scene, with its camera and settings, in one file."""

import argparse
import sys
from pathlib import Path
from typing import Any

from .arguments import add_sampling_arguments, add_stage_arguments, add_view_arguments
from .frames import frame_path
from .output import OutputError, prepare_folder
from .settings import SettingsError, default_settings
from .warnings import Printer

NAME = "flatten"
FILES = "STAGE OUT.dermis"
HELP = "Writes the flattened scene as one file that `record` and `explain` take in place of a stage"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_stage_arguments(parser)
    parser.add_argument(
        "outputPath",
        metavar="OUT.dermis",
        type=_dermis_path,
        help='file to write; with --frames it must contain one placeholder "###" or "###.###"',
    )
    add_view_arguments(parser)
    add_sampling_arguments(parser)


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    from .scene import FRAME_ERRORS, open_scene

    try:
        scene = open_scene(parser, args, default_settings(), ("outputPath",))
    except SettingsError as error:
        parser.error(str(error))
    printer = Printer()
    code = 0
    for when in scene.times:
        try:
            flatten(scene.load(when), args, when, printer)
        except (*FRAME_ERRORS, OutputError) as error:
            code = 1
            print(error, file=sys.stderr)
    return code


def flatten(loaded: Any, args: argparse.Namespace, when: Any, printer: Printer) -> None:
    printer.print(loaded.warnings)
    file = frame_path(args.outputPath, when.GetValue()) if args.frames else args.outputPath
    prepare_folder(file)
    loaded.delegate.save(file)
    print(file)


def _dermis_path(text: str) -> str:
    if Path(text).suffix.lower() != ".dermis":
        raise argparse.ArgumentTypeError(f"{text!r} must end in .dermis")
    return text
