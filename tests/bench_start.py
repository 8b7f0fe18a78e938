"""Processor seconds from the command line to an image: `python tests/bench_start.py [STAGE] [TURNS]`, medians of whole
processes in turns. usd-core opens the stage and reads every attribute; then the same with numpy, which dermis
loads where a stage has more than meshes."""

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

STAGE = Path(__file__).resolve().parents[2] / "shared" / "scenes" / "creature_spot.usda"

READ = """
import sys
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[1])
for prim in stage.Traverse():
    for attribute in prim.GetAttributes():
        attribute.Get()
"""

RECORD = ("--samples", "1", "--imageWidth", "16", "--walk", "classical", "--threads", "1")


def seconds(command: list[str]) -> float:
    """Of the processor, of a process from its start to its end."""
    with open(os.devnull, "w") as nowhere:
        child = subprocess.Popen(command, stdout=nowhere, stderr=nowhere)
        _, status, usage = os.wait4(child.pid, 0)
    if status:
        sys.exit(f"{' '.join(command)}: it failed")
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    stage = sys.argv[1] if len(sys.argv) > 1 else str(STAGE)
    turns = int(sys.argv[2]) if len(sys.argv) > 2 else 9
    # Python keeps what it compiled, as it does of what is installed.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryDirectory() as folder:
        image = str(Path(folder) / "o.exr")
        commands = {
            "usd-core": [sys.executable, "-c", READ, stage],
            "usd-core and numpy": [sys.executable, "-c", "import numpy\n" + READ, stage],
            "dermis record": [sys.executable, "-m", "dermis", "record", stage, image, *RECORD],
        }
        for command in commands.values():
            seconds(command)  # the first of each reads from disks
        taken = {name: [] for name in commands}
        for _ in range(turns):
            for name, command in commands.items():
                taken[name].append(seconds(command))
    least = statistics.median(taken["usd-core"])
    for name, of_name in taken.items():
        median = statistics.median(of_name)
        print(
            f"{name:20} {median:.3f} s ({min(of_name):.3f} to {max(of_name):.3f}), {median / least:.2f} times"
        )


if __name__ == "__main__":
    main()
