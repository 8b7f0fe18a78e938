"""The flags: usdrecord's under their names, with their words, and what dermis adds.

Every flag defaults to None, for typed flags override the stage's RenderSettings and defaults do not.
"""

import argparse
from pathlib import Path
from typing import TypeVar

from .. import color
from ..aovs import AOVS, EXTRA_AOVS, GUIDE_AOVS, LIGHT_AOV, PRIMVAR, is_sum
from . import progress
from .settings import COMPLEXITIES

WALKS = ("auto", "classical", "poe", "cp", "ii", "bono", "bill", "mixture")
LATER_WALKS = ("vpg",)
PURPOSES = ("default", "render", "proxy", "guide")
IMAGE_EXTENSIONS = (".exr", *color.EXTENSIONS)

Number = TypeVar("Number", int, float)


class AovNames(tuple[str, ...]):
    """Those that there are, and any primvar, light group or light, and sums."""

    def __contains__(self, name: object) -> bool:
        prefixes = (PRIMVAR, LIGHT_AOV)
        if not isinstance(name, str):
            return False
        named = name not in prefixes and name.startswith(prefixes)
        return named or super().__contains__(name) or is_sum(name)


def add_stage_arguments(parser: argparse.ArgumentParser) -> None:
    """Which stage, and how it is composed."""
    parser.add_argument(
        "usdFilePath", metavar="STAGE", help="USD file, or a .dermis file made by `dermis flatten`"
    )
    add_composition_arguments(parser)


def add_composition_arguments(parser: argparse.ArgumentParser) -> None:
    """How a stage is composed."""
    parser.add_argument(
        "--mask",
        dest="populationMask",
        metavar="PRIMPATH[,PRIMPATH...]",
        help="Limit stage population to these prims, their descendants and ancestors. To specify multiple paths, "
        "either use commas with no spaces or quote the argument and separate paths by commas and/or spaces.",
    )
    parser.add_argument(
        "--purposes",
        type=_purposes,
        metavar="PURPOSE[,PURPOSE...]",
        help='UsdGeomImageable purposes to include (default=proxy). The "default" purpose is always included. '
        "Separate several by commas, or by spaces within quotes.",
    )
    parser.add_argument(
        "--sessionLayer",
        dest="sessionLayerPath",
        metavar="SESSIONLAYER",
        help="open the stage with this session layer",
    )
    parser.add_argument(
        "--resolver",
        choices=("root", "inherit"),
        default="root",
        help="resolver context: made from the root layer, or that of the process (default=%(default)s)",
    )
    parser.add_argument("--disableGpu", action="store_true", help="accepted; dermis never uses a GPU")
    parser.add_argument(
        "--disableDrawMode", action="store_true", help="accepted; dermis draws no draw-mode standins"
    )


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Which view of the stage: camera, time, size, settings prim."""
    parser.add_argument(
        "--disableCameraLight",
        action="store_true",
        help="do not light a stage that has no lights from the camera",
    )
    parser.add_argument(
        "--camera",
        "-cam",
        help="camera, as prim name or as full prim path (default=main_cam; without one, the stage is framed)",
    )
    time = parser.add_mutually_exclusive_group()
    time.add_argument(
        "--defaultTime",
        "-d",
        action="store_true",
        help="operate at the Default time code (otherwise at the stage's startTimeCode)",
    )
    time.add_argument(
        "--frames",
        "-f",
        metavar="FRAMESPEC[,FRAMESPEC...]",
        help="FrameSpec(s) of the time codes to operate on: 123, 101:105, 105:101, 101:109x2, 101:104x0.5",
    )
    parser.add_argument(
        "--complexity",
        "-c",
        choices=COMPLEXITIES,
        help="level of refinement of subdivision surfaces (default=low: their cages): refineLevel 0, 1, 2, 3",
    )
    parser.add_argument(
        "--renderer", "-r", choices=("dermis",), help="Hydra renderer plugin; there is one here"
    )
    parser.add_argument(
        "--imageWidth",
        "-w",
        type=int,
        help="width of the output image; the height follows from the camera's aspect ratio (default=960)",
    )
    parser.add_argument("--imageHeight", type=positive, help="height of the output image")
    parser.add_argument(
        "--enableDomeLightVisibility",
        action="store_true",
        help="show dome lights in the background; otherwise they only light the scene",
    )
    parser.add_argument(
        "--renderPassPrimPath",
        "-rp",
        dest="rpPrimPath",
        help="RenderPass prim to take the RenderSettings from",
    )
    parser.add_argument(
        "--renderSettingsPrimPath",
        "-rs",
        dest="rsPrimPath",
        help="RenderSettings prim; overrides renderSettingsPrimPath of the stage metadata",
    )


def add_sampling_arguments(parser: argparse.ArgumentParser) -> None:
    """How the image is computed; each is a render setting as well."""
    group = parser.add_argument_group("rendering")
    group.add_argument("--samples", type=positive, metavar="N", help="samples per pixel")
    group.add_argument(
        "--timeLimit", type=not_negative, metavar="S", help="stop after S seconds of rendering"
    )
    group.add_argument(
        "--noiseThreshold",
        type=not_negative,
        metavar="E",
        help="share samples out by the noise of pilot samples, for a relative error E of the image, --samples at most",
    )
    group.add_argument("--seed", type=count, metavar="N", help="image = f(seed, sample range)")
    group.add_argument(
        "--sampleOffset", type=count, metavar="N", help="index of the first sample of each pixel"
    )
    group.add_argument("--threads", type=count, metavar="N", help="threads; 0: all (default)")
    group.add_argument(
        "--crop",
        type=float,
        nargs=4,
        metavar=("X0", "Y0", "X1", "Y1"),
        action=_Crop,
        help="region to render, in [0, 1] with (0, 0) at the lower left as USD's dataWindowNDC",
    )
    group.add_argument(
        "--tileCount",
        type=positive,
        nargs=2,
        metavar=("X", "Y"),
        help="render one of X x Y tiles (--tileIndex)",
    )
    group.add_argument(
        "--tileIndex", type=count, metavar="N", help="which tile, row by row from the top left"
    )
    group.add_argument("--maxDepth", type=count, metavar="N", help="surface bounces")
    group.add_argument(
        "--textureMemory",
        type=count,
        metavar="MB",
        help="memory for the images of materials; the largest are kept coarser where they do not fit (default=4096, "
        "0: no bound)",
    )
    group.add_argument(
        "--walk", type=walk_name, metavar="NAME", help=f"subsurface walk: {', '.join(WALKS)} (default=auto)"
    )
    group.add_argument(
        "--walkPdf",
        choices=("auto", "conditional", "exact"),
        help="weight of a guided walk: that of the sampled slab normal alone, or the marginal over all techniques "
        "(default=auto: exact where it exists)",
    )
    group.add_argument(
        "--classicalFraction",
        type=_share,
        metavar="P",
        help="share of classical walks mixed into guided ones",
    )
    group.add_argument(
        "--aov",
        dest="aovs",
        action="append",
        choices=AovNames((*AOVS, *EXTRA_AOVS, *GUIDE_AOVS)),
        metavar="NAME",
        help=f"AOV to write (repeatable): {', '.join(AOVS)} (default: the stage's RenderVars, else all of these); only "
        f"where asked for: {', '.join(EXTRA_AOVS)}; sums of light as emission+diffuse; "
        f"primvars:NAME of any primvar; {LIGHT_AOV}NAME of a light group or a light; "
        f"for looking at guided walks: {', '.join(GUIDE_AOVS)}",
    )
    group.add_argument(
        "--set",
        dest="assignments",
        nargs="?",
        metavar="NAME=VALUE",
        action=SetAction,
        help="any render setting (repeatable); alone, lists them with their defaults",
    )


def add_output_arguments(parser: argparse.ArgumentParser) -> None:
    """What is written, and what is said meanwhile."""
    group = parser.add_argument_group("output")
    group.add_argument(
        "--displayImage", type=display_path, metavar="FILE", help="also write a PNG or JPEG for eyes"
    )
    group.add_argument(
        "--colorCorrectionMode",
        "-color",
        choices=("disabled", "sRGB", "openColorIO"),
        help="of PNG and JPEG (default=openColorIO): sRGB is the bare transfer curve, disabled keeps linear "
        "values; EXR is always scene-linear",
    )
    group.add_argument(
        "--ocioConfig", metavar="CONFIG", help=f"OpenColorIO config (default=$OCIO, {color.BUILTIN_CONFIG})"
    )
    group.add_argument("--ocioDisplay", metavar="NAME", help="OpenColorIO display")
    group.add_argument("--ocioView", metavar="NAME", help="OpenColorIO view")
    group.add_argument("--ocioLook", metavar="NAME", help="OpenColorIO look")
    group.add_argument(
        "--progress", choices=progress.KINDS, help="default: bar on a terminal, none otherwise"
    )
    group.add_argument("--stats", metavar="FILE.json", help="write settings, timings, counts and warnings")
    group.add_argument("--traceToFile", metavar="FILE", help="trace USD's own work into this file")
    group.add_argument(
        "--traceFormat",
        choices=("chrome", "trace"),
        default="chrome",
        help="of --traceToFile (default=%(default)s)",
    )
    group.add_argument("--memstats", action="store_true", help="account USD's memory by Pxr MallocTags")


def add_batch_arguments(parser: argparse.ArgumentParser) -> None:
    """Runs that are long, many, or end before they are done."""
    group = parser.add_argument_group("batch")
    group.add_argument(
        "--skipExisting",
        action="store_true",
        help="skip frames, and products rendered apart, whose files are there, each complete",
    )
    group.add_argument(
        "--checkpoint",
        type=_seconds,
        metavar="S",
        help="keep the state of the render beside each image, every S seconds, until the image is written",
    )
    group.add_argument(
        "--resume",
        action="store_true",
        help="go on from checkpoints that are there, to the image of an uninterrupted render; writes them every 300 s "
        "unless --checkpoint says otherwise",
    )
    group.add_argument(
        "--snapshot",
        type=_seconds,
        metavar="S",
        help="write the image so far as NAME_snapshot every S seconds (and at SIGUSR1) until it is done",
    )


def check_tile(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Both flags or none, and a tile that there is."""
    if (args.tileCount is None) != (args.tileIndex is None):
        parser.error("--tileCount and --tileIndex go together")
    if args.tileCount and args.tileIndex >= args.tileCount[0] * args.tileCount[1]:
        last = args.tileCount[0] * args.tileCount[1] - 1
        parser.error(
            f"--tileIndex {args.tileIndex}: the last of {args.tileCount[0]} x {args.tileCount[1]} is {last}"
        )


def image_path(text: str) -> str:
    """A file name whose ending says which kind of image it is."""
    return _with_extension(text, IMAGE_EXTENSIONS)


def display_path(text: str) -> str:
    return _with_extension(text, color.EXTENSIONS)


def _with_extension(text: str, extensions: tuple[str, ...]) -> str:
    if Path(text).suffix.lower() not in extensions:
        raise argparse.ArgumentTypeError(f"{text!r} must end in one of {', '.join(extensions)}")
    return text


def _purposes(text: str) -> tuple[str, ...]:
    purposes = text.replace(",", " ").split()
    for purpose in purposes:
        if purpose not in PURPOSES:
            raise argparse.ArgumentTypeError(f"Unrecognized purpose value '{purpose}'.")
    return tuple(dict.fromkeys(["default", *purposes]))


def positive(text: str) -> int:
    return _bounded(int(text), text, 1)


def count(text: str) -> int:
    return _bounded(int(text), text, 0)


def not_negative(text: str) -> float:
    value = float(text)
    if value == float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not finite")
    return _bounded(value, text, 0)


def _seconds(text: str) -> float:
    value = not_negative(text)
    if value == 0.0:
        raise argparse.ArgumentTypeError("0 seconds: give more")
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 1")
    return value


def _bounded(value: Number, text: str, least: int) -> Number:
    if not value >= least:  # also for NaN
        raise argparse.ArgumentTypeError(f"{text} is below {least}")
    if value > 0xFFFF_FFFF:  # the core keeps counts in 32 bits
        raise argparse.ArgumentTypeError(f"{text} is too large")
    return value


def walk_name(name: str) -> str:
    if name in LATER_WALKS:
        raise argparse.ArgumentTypeError(f"walk {name!r} is not available in this version")
    if name not in WALKS:
        raise argparse.ArgumentTypeError(
            f"invalid choice: {name!r} (choose from {', '.join(map(repr, WALKS))})"
        )
    return name


class _Crop(argparse.Action):
    """Checks the order and the range of a data window."""

    def __call__(self, parser, namespace, values, option_string=None):
        x0, y0, x1, y1 = values
        if not (0.0 <= x0 < x1 <= 1.0 and 0.0 <= y0 < y1 <= 1.0):
            parser.error(f"argument {option_string}: 0 <= X0 < X1 <= 1 and 0 <= Y0 < Y1 <= 1 must hold")
        setattr(namespace, self.dest, values)


class SetAction(argparse.Action):
    """Collects NAME=VALUE; without a value, lists the settings and leaves, as `--help` does."""

    def __call__(self, parser, namespace, values, option_string=None):
        from .settings import default_settings, listing

        if values is None:
            print(listing(default_settings()))
            parser.exit(0)
        if "=" not in values:
            parser.error(f"argument {option_string}: expected NAME=VALUE, got {values!r}")
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or []), values])
