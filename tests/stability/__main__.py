"""Runs the stability rows and writes stability.csv and stability.html.

Exit code 0: every row holds or is a known limit.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from . import caches, lights, media, meshes, rendering, report, space, walks
from .row import Case, Row

FAMILIES = {
    "media": media,
    "space": space,
    "meshes": meshes,
    "lights": lights,
    "caches": caches,
    "walks": walks,
}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m stability", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the report")
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose family or name contains WORD")
    parser.add_argument("--quick", action="store_true", help="the cases that `make test` runs")
    parser.add_argument("--threads", type=int, default=0, help="of every render; 0: all")
    return parser.parse_args()


def chosen(only: str, quick: bool) -> list[tuple[str, Case]]:
    named = [(family, case) for family, module in FAMILIES.items() for case in module.CASES]
    return [
        (family, case)
        for family, case in named
        if (case.quick or not quick) and only in f"{family}: {case.stressed}"
    ]


def measure(cases: list[tuple[str, Case]]) -> Iterator[Row]:
    """The rows of all cases, said as they come; a case that raises is a row that fails."""
    for family, case in cases:
        try:
            for row in case.rows():
                print(report.line(row), flush=True)
                yield row
        except Exception as error:
            row = Row(family, case.stressed, "", 0.0, float("nan"), note=f"{type(error).__name__}: {error}")
            print(report.line(row), flush=True)
            yield row


def main() -> int:
    options = arguments()
    rendering.THREADS = options.threads
    cases = chosen(options.only, options.quick)
    if not cases:
        print(f"no case contains {options.only!r}", file=sys.stderr)
        return 2
    start = time.monotonic()
    rows = list(measure(cases))
    seconds = time.monotonic() - start
    report.write(rows, seconds, options.out)
    failed = [row for row in rows if not row.holds]
    known = sum(row.verdict == "known limit" for row in rows)
    print(
        f"{len(rows)} rows in {seconds:.0f} s: {len(rows) - len(failed) - known} hold, {known} known limits, "
        f"{len(failed)} fail; {options.out / 'stability.html'}"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
