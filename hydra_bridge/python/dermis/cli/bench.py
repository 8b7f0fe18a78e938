"""`dermis bench STAGE... --methods a,b,c --budget S --reference REF.exr --out DIR`: speed against error."""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from . import output
from .arguments import (
    SetAction,
    add_composition_arguments,
    add_view_arguments,
    count,
    display_path,
    not_negative,
    positive,
)
from .interrupt import Interrupt
from .settings import SettingsError, default_settings
from .warnings import Printer

NAME = "bench"
FILES = "STAGE... --out DIR"
HELP = "Compares subsurface estimators: error against a reference, and the CPU time that it took"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "stages",
        nargs="*",
        metavar="STAGE",
        help="USD files or .dermis files; each is called by its stem",
    )
    add_suite_arguments(parser)
    add_reference_arguments(parser)
    add_report_arguments(parser)
    add_composition_arguments(parser)
    add_view_arguments(parser)


def add_suite_arguments(parser: argparse.ArgumentParser) -> None:
    """What is compared, and with how much work."""
    group = parser.add_argument_group("comparison")
    group.add_argument("--spec", metavar="FILE.json", help="description of stages, crops, methods")
    group.add_argument("--only", type=_names, metavar="SCENE[,SCENE...]", help="of the scenes of --spec")
    group.add_argument(
        "--methods",
        type=_names,
        metavar="METHOD[,METHOD...]",
        help="subsurface walks with settings: [LABEL=]WALK[:NAME=VALUE...], as "
        "classical,mixture:normals=4,half=poe:classicalFraction=0.5; the names of --set",
    )
    group.add_argument(
        "--peers",
        type=_names,
        metavar="NAME[,NAME...]",
        help="other renderers, rendered in turn with the methods: mitsuba (volpath), mitsuba-mis (volpathmis), "
        "cycles; see `dermis peers`",
    )
    group.add_argument("--baseline", metavar="LABEL", help="method that ratios refer to (default: the first)")
    group.add_argument(
        "--budget",
        type=_list_of(not_negative),
        metavar="S[,S...]",
        help="seconds per render, training included",
    )
    group.add_argument(
        "--samples",
        type=_list_of(positive),
        metavar="N[,N...]",
        help="samples per pixel, instead of --budget",
    )
    group.add_argument("--seeds", type=positive, metavar="N", help="independent seeds (default=3)")
    group.add_argument("--seed", type=count, metavar="N", help="seed of the first repeat (default=1)")
    group.add_argument(
        "--crops",
        action="append",
        metavar="[STEM/]NAME=X0,Y0,X1,Y1",
        help="part of the image that is measured on its own, in the coordinates of --crop (repeatable; "
        "default: the frame)",
    )
    group.add_argument(
        "--wholeFrames",
        action="store_true",
        default=None,
        help="cut crops from whole frames (default: each is rendered for itself, all work in it)",
    )
    group.add_argument(
        "--subsurfaceOnly",
        action="store_true",
        default=None,
        help="measure only pixels where the subsurface AOV of the reference is not zero (default: all)",
    )
    group.add_argument(
        "--set",
        dest="assignments",
        nargs="?",
        metavar="NAME=VALUE",
        action=SetAction,
        help="a render setting for all methods (repeatable); alone, lists them with their defaults",
    )


def add_reference_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("reference")
    group.add_argument(
        "--reference",
        action="append",
        metavar="FILE.exr",
        help="image to compare to, of the same resolution; given twice: two halves with different seeds, whose "
        "difference tells the reference's own noise (else its variance AOV does)",
    )
    group.add_argument(
        "--referenceSamples",
        type=positive,
        metavar="N",
        help="of the one that is made otherwise, in two halves, and kept in DIR/reference for further runs "
        "(default: 64 times the most --samples, 4096 with --budget)",
    )
    group.add_argument(
        "--referenceMethod",
        metavar="METHOD",
        help="of that one (default: classical, unless it is under test)",
    )


def add_report_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("report")
    group.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="folder for report, numbers, renders; what is complete in it is taken up",
    )
    group.add_argument(
        "--figure", type=display_path, metavar="FILE.png", help="contact sheet: methods across, crops down"
    )
    group.add_argument("--figureRows", type=_names, metavar="SCENE/CROP[,...]", help="of the contact sheet")
    group.add_argument("--exposure", type=float, metavar="STOPS", help="of pictures, and of FLIP")
    group.add_argument(
        "--numbersOnly",
        action="store_true",
        help="numbers only, FLIP not among them; needs neither matplotlib nor flip-evaluator",
    )
    group.add_argument("--quiet", action="store_true", help="no progress on stderr")


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    """Exit code: 0 done, 1 something failed, 130 interrupted; usage errors leave through `parser`."""
    from ..bench import figure, plots, spec, suite

    defaults = default_settings()
    try:
        described = spec.build_suite(args, defaults)
        places = figure.figure_rows(described, args.figureRows)
        if not args.numbersOnly:
            plots.require_libraries()
        elif args.figure:
            parser.error("--figure does not go with --numbersOnly")
    except (suite.SuiteError, figure.FigureError, plots.PlotsError) as error:
        parser.error(str(error))
    for file in ("results.json", "reference/a", "runs/a"):
        output.prepare_folder(Path(args.out) / file)
    if args.figure:
        output.prepare_folder(args.figure)
    with Interrupt(), tempfile.TemporaryDirectory(prefix="dermis-bench-") as folder:
        return measure(parser, args, described, defaults, places, Path(folder))


def measure(
    parser: argparse.ArgumentParser,
    args: argparse.Namespace,
    suite: Any,
    defaults: Any,
    places: list[str],
    folder: Path,
) -> int:
    """Opens the scenes, measures, reports; `folder` is for flattened scenes."""
    from .. import color
    from ..bench import reference, report, runner, scenes

    if suite.reference_note and not args.quiet:
        print(f"Note: {suite.reference_note}", file=sys.stderr)
    printer = Printer()
    opened = []
    try:
        for spec in suite.scenes:
            scene = scenes.open_bench_scene(spec, parser, args, defaults, folder)
            printer.print(scene.warnings)
            opened.append(scene)
    except SettingsError as error:
        parser.error(str(error))
    out = Path(args.out)
    try:
        transform = None if args.numbersOnly else color.DisplayTransform()
        found = runner.Runner(suite, out, args.quiet, printer, transform).run(opened)
    except (color.ColorError, reference.BadReference) as error:
        print(error, file=sys.stderr)
        return 1
    text = report.write(found, suite, opened, out, transform)
    if args.figure:
        report.write_figure(found, suite, places, Path(args.figure))
    print(text, end="", flush=True)
    for failure in found.failures:
        print(f"failed: {failure}", file=sys.stderr)
    if found.interrupted:
        return 130
    return 1 if found.failures else 0


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"{text!r} has an empty name")
    return names


def _list_of(one: Any) -> Any:
    def parse(text: str) -> list[Any]:
        try:
            return [one(item) for item in text.split(",")]
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is no list of numbers") from None

    return parse
