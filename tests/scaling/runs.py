"""Renders in processes of their own, and what they cost."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from .stages import AXES, triangles

#: Pixels a side, where resolution is not the axis.
SIDE = 128
SAMPLES = 16

#: What usd-core itself needs for the work that a renderer cannot do without: open, visit, read every value.
READ = """
import sys
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[1])
for prim in stage.Traverse():
    for attribute in prim.GetAttributes():
        attribute.Get()
"""


@dataclass
class Row:
    axis: str
    size: int
    #: Microseconds per sample of a pixel, training included.
    sample_us: float
    #: Seconds from the command's start until the first sample, and of that: trees and tables.
    start_s: float
    compile_s: float
    #: Of a Python that opens the stage and reads all of it.
    usd_s: float
    #: Largest resident set of the render, Python and usd-core included.
    rss_mb: float

    def fields(self) -> dict[str, Any]:
        return {
            name: round(value, 4) if isinstance(value, float) else value
            for name, value in asdict(self).items()
        }

    def line(self) -> str:
        return (
            f"{self.axis:>10} {self.size:>9}  {self.sample_us:8.2f} us/sample  start {self.start_s:6.2f} s"
            f" (compile {self.compile_s:.2f}, usd-core alone {self.usd_s:.2f})  {self.rss_mb:8.1f} MB"
        )


COLUMNS = list(Row.__dataclass_fields__)


def all_rows(chosen: list[str], largest: int, rounds: int, folder: Path) -> Iterator[Row]:
    for axis in chosen:
        if axis == "threads":
            yield from thread_rows(rounds, folder)
            continue
        make, sizes = AXES[axis]
        for size in sizes:
            if not largest or size <= largest:
                stage = folder / f"{axis}_{size}.usdc"
                make(stage, size)
                yield row(axis, size, stage, size if axis == "resolution" else SIDE, 1)
                stage.unlink()


def row(axis: str, size: int, stage: Path, side: int, threads: int) -> Row:
    stats, seconds = render(stage, side, SAMPLES, threads)
    parts = stats["seconds"]
    rendering = parts["render"]  # training included
    return Row(
        axis,
        size,
        rendering / (side * side * SAMPLES) * 1e6,
        seconds - rendering,
        parts["compile"],
        usd_seconds(stage),
        stats["peak_rss_bytes"] / 1e6,
    )


def render(stage: Path, side: int, samples: int, threads: int) -> tuple[dict[str, Any], float]:
    """The statistics of `dermis record`, and the seconds of the whole command."""
    out, stats = stage.with_suffix(".exr"), stage.with_suffix(".json")
    command = [sys.executable, "-m", "dermis", "record", str(stage), str(out), "--aov", "alpha"]
    command += ["--camera", "/World/Camera", "--imageWidth", str(side), "--imageHeight", str(side)]
    command += ["--samples", str(samples), "--threads", str(threads), "--stats", str(stats)]
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return json.loads(stats.read_text()), time.perf_counter() - start


def usd_seconds(stage: Path) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", READ, str(stage)], check=True)
    return time.perf_counter() - start


def thread_rows(rounds: int, folder: Path) -> Iterator[Row]:
    """The same picture by one thread, by two, and by two processes of one thread at a time, in turns: of each the
    fastest of so many rounds. The processes share nothing but the machine: what they reach is what it has to give."""
    stages = [folder / "threads.usdc", folder / "threads_beside.usdc"]
    for stage in stages:
        triangles(stage, 20_000)
    turns = [
        lambda: row("threads", 1, stages[0], 2 * SIDE, 1),
        lambda: row("threads", 2, stages[0], 2 * SIDE, 2),
        lambda: beside_each_other(stages),
    ]
    best = [turn() for turn in turns]
    for _ in range(rounds - 1):
        best = [
            min(old, turn(), key=lambda row: row.sample_us) for old, turn in zip(best, turns, strict=True)
        ]
    yield from best


def beside_each_other(stages: list[Path]) -> Row:
    with ThreadPoolExecutor(len(stages)) as pool:
        rows = list(pool.map(lambda stage: row("processes", len(stages), stage, 2 * SIDE, 1), stages))
    return replace(rows[0], sample_us=sum(row.sample_us for row in rows) / len(rows) ** 2)
