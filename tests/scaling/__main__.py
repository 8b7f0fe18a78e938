"""Renders stages of growing size and writes scaling.csv and scaling.png.

Each number is from a process of its own; times are CPU seconds where one thread renders.
"""

import argparse
import csv
import sys
import tempfile
from pathlib import Path

from . import figure, runs
from .stages import AXES


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m scaling", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of table and figure")
    parser.add_argument("--only", default="", metavar="AXIS[,AXIS...]", help=f"of {', '.join(AXES)}, threads")
    parser.add_argument("--largest", type=int, default=0, metavar="N", help="leave out sizes above N")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="of one thread and two, in turns")
    return parser.parse_args()


def main() -> int:
    options = arguments()
    chosen = options.only.split(",") if options.only else [*AXES, "threads"]
    if unknown := [axis for axis in chosen if axis not in (*AXES, "threads")]:
        print(f"--only: {', '.join(unknown)} is none of {', '.join(AXES)}, threads", file=sys.stderr)
        return 2
    rows: list[runs.Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for row in runs.all_rows(chosen, options.largest, options.rounds, Path(folder)):
            print(row.line(), flush=True)
            rows.append(row)
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "scaling.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, runs.COLUMNS)
        writer.writeheader()
        writer.writerows(row.fields() for row in rows)
    figure.write(rows, options.out / "scaling.png")
    print(f"{options.out / 'scaling.csv'}, {options.out / 'scaling.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
