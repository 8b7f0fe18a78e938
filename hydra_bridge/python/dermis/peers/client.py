"""A peer at work in a process of its own, which lives as long as its Peer: start-up is paid once."""

import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..stage import FlatStage
from . import cycles_export, mitsuba_export
from .environments import PeerError, find
from .mitsuba_export import Exported


@dataclass(frozen=True)
class Kind:
    """A renderer as it is compared: an installed peer, told the scene in a certain way."""

    environment: str
    export: Callable[[FlatStage, Path], Exported]
    #: Of the image files that its worker writes.
    ending: str
    #: How samples become pixels.
    film: str


#: The integral of the squared tent over the square of its integral is 2/3 in each direction; pixels of dermis have
#: samples of their own, drawn by the filter.
SPLATTED = (
    "a sample counts for all pixels under its tent: 4/9 of the variance per pixel of samples that are a pixel's own, "
    "noise that neighbours share, a bias z 1.5 times too large"
)

KINDS = {
    "mitsuba": Kind("mitsuba", mitsuba_export.export, ".npy", SPLATTED),
    "mitsuba-mis": Kind("mitsuba", mitsuba_export.export_mis, ".npy", SPLATTED),
    "cycles": Kind("cycles", cycles_export.export, ".exr", "samples are a pixel's own, as dermis'"),
}

#: Share of the budget that a calibration render must take to be believed.
CALIBRATED = 0.2

Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class Picture:
    #: Linear RGB, (height, width, 3), of the window.
    image: NDArray[np.float64]
    #: CPU seconds of the peer's process, all threads, and seconds, from start to end of the render.
    cpu: float
    wall: float


class Peer:
    """Raises PeerError where the process ends or refuses."""

    def __init__(self, name: str, folder: Path | None = None) -> None:
        """`name`: of KINDS; `folder`: of the environments, else the usual one."""
        self.name, self.kind = name, KINDS[name]
        self.environment = environment = find(self.kind.environment, folder)
        self._folder = tempfile.TemporaryDirectory(prefix=f"dermis-{self.name}-")
        self._log = open(Path(self._folder.name) / "log.txt", "w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            [environment.python, str(environment.worker), *environment.arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env={**os.environ, **environment.variables},
            # An interrupt is ours to handle: the worker ends with its stdin.
            start_new_session=True,
        )
        self._exposure = 1.0

    def load(self, flat: FlatStage, threads: int) -> tuple[Exported, dict[str, Any]]:
        """Hands over a scene; what was exported, and what the peer says of itself. Raises ExportError too.

        `threads`: 0 for all.
        """
        folder = Path(tempfile.mkdtemp(dir=self._folder.name))
        exported = self.kind.export(flat, folder)
        (folder / "scene.json").write_text(json.dumps(exported.description), encoding="utf-8")
        about = self._ask({"command": "load", "folder": str(folder), "threads": threads})
        self._exposure = exported.description["exposure"]
        return exported, about

    def render(self, samples: int, seed: int, window: Window) -> Picture:
        file = Path(self._folder.name) / f"image{self.kind.ending}"
        request = {
            "command": "render",
            "samples": samples,
            "seed": seed,
            "window": list(window),
            "file": str(file),
        }
        cost = self._ask(request)
        image = read_image(file) * self._exposure
        width, height = window[2] - window[0], window[3] - window[1]
        if image.shape != (height, width, 3):
            raise PeerError(f"{self.name} rendered an array of {image.shape} for {width} x {height} pixels")
        return Picture(image, cost["cpu"], cost["wall"])

    def samples_in(self, seconds: float, window: Window) -> int:
        """Samples per pixel that fit into so much time, by renders of increasing length."""
        self.render(1, 0, window)
        samples = 1
        while True:
            wall = self.render(samples, 0, window).wall
            if wall >= CALIBRATED * seconds:
                return max(1, round(samples * seconds / wall))
            # Towards a third of the budget, but not by more than eightfold: start-up hides in short renders.
            samples = int(np.clip(samples * 0.35 * seconds / wall, samples + 1, 8 * samples))

    def close(self, at_once: bool = False) -> None:
        """`at_once`: without waiting for a render under way."""
        assert self._process.stdin and self._process.stdout
        if at_once:
            self._process.kill()
        self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self._log.close()
        self._folder.cleanup()

    def __enter__(self) -> "Peer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(at_once=error is not None)

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin and self._process.stdout
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise PeerError(f"{self.name} ended: {self._last_words()}")
        answer = json.loads(line)
        if "error" in answer:
            raise PeerError(f"{self.name}: {answer['error']}")
        return answer

    def _last_words(self) -> str:
        self._log.seek(0)
        lines = [line.strip() for line in self._log if line.strip()]
        return lines[-1] if lines else "it said nothing"


def read_image(file: Path) -> NDArray[np.float64]:
    if file.suffix == ".npy":
        return np.load(file)
    import OpenImageIO as oiio

    pixels = oiio.ImageBuf(str(file)).get_pixels(oiio.FLOAT)
    return np.asarray(pixels, dtype=np.float64)[..., :3]
