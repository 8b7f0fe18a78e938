"""`dermis merge PART PART... --output IMAGE`: tiles and sample ranges of one image put together."""

import argparse
import json
import sys

from . import output
from .arguments import image_path

NAME = "merge"
FILES = "PART PART..."
HELP = "Puts tiles and sample ranges of one image together, weighted by their samples"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", metavar="PART", nargs="+", help="EXR that `dermis record` wrote")
    parser.add_argument(
        "--output", "-o", required=True, metavar="IMAGE.exr", type=image_path, help="the merged image"
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="merge images of different scenes or settings, or with common samples",
    )


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    from dermis import merging
    from dermis._core import write_channels

    if not args.output.lower().endswith(".exr"):
        parser.error(f"argument --output: {args.output!r} must end in .exr")
    output.prepare_folder(args.output)
    try:
        parts = [merging.read_part(file) for file in args.parts]
        merged = merging.merge(parts, force=args.force)
    except merging.MergeError as error:
        print(error, file=sys.stderr)
        return 1
    for warning in merged.warnings:
        print(f"Warning: {warning}", file=sys.stderr)
    write_channels(args.output, merged.frame, list(merged.channels.items()), json.dumps(merged.attributes))
    print(f"Merged {len(parts)} parts into {args.output}: {merged.summary}")
    return 1 if merged.holes else 0
