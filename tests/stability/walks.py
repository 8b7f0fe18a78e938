"""The rows below the scene, measured by tests/stability.rs: f32 against f64, thick slabs, deliberate mistakes."""

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from .row import Case, Row

FAMILY = "walks"
REPOSITORY = Path(__file__).resolve().parents[2]
TESTS = {
    "f32 against f64": "walks_are_those_of_f64",
    "thick slabs": "thick_slabs",
    "deliberate mistakes": "deliberate_mistakes_are_caught",
    "chi-square": "chi_square_catches_a_wrong_pdf",
}


def rust(test: str) -> Iterator[Row]:
    """The rows that a test prints; its own verdict is a row too."""
    start = time.monotonic()
    command = ["cargo", "test", "--release", "--test", "stability", "--", test, "--exact", "--nocapture"]
    ran = subprocess.run([*command, "--include-ignored"], cwd=REPOSITORY, capture_output=True, text=True)
    found = [json.loads(line.partition("row:")[2]) for line in ran.stdout.splitlines() if "row: {" in line]
    seconds = (time.monotonic() - start) / max(1, len(found))
    for numbers in found:
        yield Row(FAMILY, seconds=seconds, **numbers, resolution=float("inf"))
    words = ran.stderr.strip().splitlines()
    passed = float(ran.returncode == 0 and bool(found))
    yield Row(
        FAMILY, f"{test} passes", "cargo test", 1.0, passed, note="" if passed else "; ".join(words[-5:])
    )


CASES = [Case(name, lambda test=test: rust(test)) for name, test in TESTS.items()]
