"""Runs phases.rs on a stage: natively for seconds and bytes, under callgrind for instructions."""

import json
import re
import shutil
import subprocess
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from dermis.cli import main

from .stages import Stage

ROOT = Path(__file__).resolve().parents[2]
DRIVER = ROOT / "target" / "release" / "examples" / "phases"
"""Where `cargo build --release --example phases` and `cargo test --release` leave it."""

SIZE = 16
"""Pixels along a side: one tile."""

COUNTED = (1, 17)
"""Samples per pixel of the two renders that are counted. The first pass has one, and nothing is learned before it."""

TIMED = (1, 257)

PHASES = ("load", "compile", "short render", "long render")

WAIT = 900.0
"""Seconds after which a run is given up; valgrind is some fifty times slower than the processor."""


class DriverError(Exception):
    """A stage that could not be flattened or rendered."""


@dataclass(frozen=True)
class Run:
    """What the phases took, in the order of PHASES."""

    seconds: tuple[float, ...]
    kept: tuple[int, ...]
    """Bytes of heap that a phase left behind."""
    peak: tuple[int, ...]
    """Most bytes of heap that it had beyond those before it."""
    images: tuple[int, ...]
    """Fingerprints of the two pictures."""
    avx2: bool


def flatten(stage: Stage, folder: Path) -> Path:
    """The stage as `dermis flatten` writes it."""
    source, file = folder / "stage.usda", folder / "stage.dermis"
    source.write_text(stage.text())
    write_image(folder / "image.hdr")
    size = ("--imageWidth", str(SIZE), "--imageHeight", str(SIZE))
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = main(["flatten", str(source), str(file), *size, *stage.flags])
    if code:
        raise DriverError(f"dermis flatten {source}: exit code {code}: {said.getvalue().strip()}")
    return file


def write_image(file: Path) -> None:
    """64 x 32 pixels, a bright spot among them."""
    pixels = np.full((32, 64, 3), 0.1, np.float32)
    pixels[8, 20] = 100.0
    image = oiio.ImageOutput.create(str(file))
    image.open(str(file), oiio.ImageSpec(64, 32, 3, "float"))
    image.write_image(pixels)
    image.close()


def run(file: Path, samples: tuple[int, int]) -> Run:
    found = json.loads(output([str(DRIVER), str(file), *map(str, samples)]))
    phases = found["phases"]
    if tuple(phase["name"] for phase in phases) != PHASES:
        raise DriverError(f"{DRIVER} is not that of this checkout: cargo build --release --example phases")

    def of(name: str) -> tuple[Any, ...]:
        return tuple(phase[name] for phase in phases)

    return Run(of("seconds"), of("kept_bytes"), of("peak_bytes"), tuple(found["images"]), found["avx2"])


def count(file: Path, samples: tuple[int, int]) -> tuple[int, ...]:
    """Instructions of each phase."""
    with tempfile.TemporaryDirectory(prefix="dermis-needs-") as folder:
        dumps = Path(folder) / "dump"
        asked = ("--tool=callgrind", f"--callgrind-out-file={dumps}", "--dump-before=*phase_ends*")
        output(["valgrind", *asked, str(DRIVER), str(file), *map(str, samples)])
        files = sorted(Path(folder).glob("dump.*"), key=lambda file: int(file.suffix[1:]))
        counts = tuple(total(file.read_text()) for file in files)
    # What comes after the last phase is dumped at the end.
    if len(counts) != len(PHASES):
        raise DriverError(f"callgrind dumped {len(counts)} phases, not {len(PHASES)}")
    return counts


def total(dump: str) -> int:
    found = re.search(r"^totals: (\d+)$", dump, re.MULTILINE)
    if not found:
        raise DriverError("a dump of callgrind has no totals")
    return int(found[1])


def output(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DriverError(str(error)) from error
    if done.returncode:
        raise DriverError(f"{' '.join(command)}: {done.stderr.strip()[-500:]}")
    return done.stdout


@cache
def counter() -> str | None:
    """The valgrind that is installed; None: instructions cannot be counted."""
    return output(["valgrind", "--version"]).strip() if shutil.which("valgrind") else None
