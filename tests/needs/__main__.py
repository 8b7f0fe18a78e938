"""Measures what capabilities cost, in use and not, and writes the table that `dermis explain` shows.

Without valgrind, seconds and bytes only. Exit code 0: what is not in use costs nothing, wherever that was counted.
"""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from dermis import costs
from dermis.bench.machine import machine
from dermis.cli import output

from . import driver
from .capabilities import CAPABILITIES
from .measure import Bench

TABLE = "hydra_bridge/python/dermis/costs.json"
"""In the checkout, which need not be the package that runs."""


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m needs", description=__doc__)
    parser.add_argument("--out", type=Path, help=f"file of the table (`make needs`: {TABLE})")
    parser.add_argument("--only", default="", metavar="WORD", help="capabilities whose name contains WORD")
    parser.add_argument(
        "--repeats", type=int, default=7, metavar="N", help="timed runs of each stage; 0: no times"
    )
    parser.add_argument("--uncounted", action="store_true", help="do without valgrind")
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> int:
    options = arguments(words)
    chosen = [capability for capability in CAPABILITIES if options.only in capability.name]
    if not chosen:
        print(f"no capability contains {options.only!r}", file=sys.stderr)
        return 2
    counter = None if options.uncounted else driver.counter()
    if counter is None:
        print("instructions are not counted: valgrind is not there, or not wanted", file=sys.stderr)
    bench = Bench(counter is not None, options.repeats)
    rows = []
    for capability in chosen:
        print(f"{capability.name} ...", file=sys.stderr, flush=True)
        rows.append(bench.row(capability))
    table = {"made": made(counter, options.repeats), "rows": rows}
    if options.out:
        output.write_json(options.out, table)
    found = costs.Costs(table)
    print(found.markdown())
    wrong = found.not_free()
    for line in wrong:
        print(f"not in use, and not free: {line}", file=sys.stderr)
    return 1 if wrong else 0


def made(counter: str | None, repeats: int) -> dict[str, Any]:
    """When, on what and how the table was made."""
    facts = machine()
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": commit(),
        **{name: facts[name] for name in ("processor", "cores", "load", "system", "dermis")},
        "counter": counter and f"{counter}, callgrind",
        "pixels": driver.SIZE**2,
        "counted_samples": driver.COUNTED,
        "timed_samples": driver.TIMED if repeats else None,
        "repeats": repeats,
    }


def commit() -> str | None:
    """Of this checkout; with a + where files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=driver.ROOT, capture_output=True, text=True, check=True
        ).stdout

    try:
        # The table itself is what this run replaces.
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/", f":(exclude,top){TABLE}")
        return git("rev-parse", "--short", "HEAD").strip() + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None


if __name__ == "__main__":
    sys.exit(main())
