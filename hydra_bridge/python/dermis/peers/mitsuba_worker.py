"""Mitsuba 3 at work, in its own environment: `python mitsuba_worker.py VARIANT`."""

import json
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from worker import serve

#: Samples per pixel at once in a JIT variant: its memory grows with pixels times samples.
PASS = 16


class Mitsuba:
    def __init__(self, variant: str) -> None:
        mi.set_variant(variant)
        self.jit = not variant.startswith("scalar")

    def load(self, folder: str, threads: int) -> dict[str, Any]:
        if threads:
            dr.set_thread_count(threads)
        description = json.loads((Path(folder) / "scene.json").read_text(encoding="utf-8"))
        self.scene = mi.load_dict(decoded(description["scene"]))
        self.sensor = description["sensor"]
        self.sensors: dict[Any, Any] = {}
        self.compiled: set[Any] = set()
        return {"version": mi.__version__, "variant": mi.variant(), "threads": dr.thread_count()}

    def prepare(self, samples: int, window: tuple[int, int, int, int]) -> None:
        """The sensor of a window; kernels of a JIT variant are compiled before the clock runs."""
        if window not in self.sensors:
            self.sensors[window] = mi.load_dict(decoded(cropped(self.sensor, window)))
        for size in {min(samples, PASS), samples % PASS} - {0} if self.jit else ():
            if (window, size) not in self.compiled:
                self.compiled.add((window, size))
                self.one_pass(size, 0, window)

    def render(self, samples: int, seed: int, window: tuple[int, int, int, int]) -> np.ndarray:
        if not self.jit:
            return self.one_pass(samples, seed, window)
        total, done = 0.0, 0
        seeds = np.random.SeedSequence(seed).generate_state(-(-samples // PASS))
        for own in seeds:
            size = min(PASS, samples - done)
            total = total + size * self.one_pass(size, int(own), window)
            done += size
        return total / samples

    def one_pass(self, samples: int, seed: int, window: tuple[int, int, int, int]) -> np.ndarray:
        image = mi.render(self.scene, sensor=self.sensors[window], spp=samples, seed=seed)
        return np.array(image, dtype=np.float64)

    def write(self, image: np.ndarray, file: str) -> None:
        np.save(file, image)


def cropped(sensor: dict[str, Any], window: tuple[int, int, int, int]) -> dict[str, Any]:
    x0, y0, x1, y1 = window
    crop = {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    return {**sensor, "film": {**sensor["film"], **crop}}


def decoded(value: Any) -> Any:
    """What `mitsuba_export` wrote, with transforms and bitmaps in place of their descriptions."""
    if not isinstance(value, dict):
        return value
    if value.keys() == {"matrix"}:
        return mi.ScalarTransform4f(np.array(value["matrix"]))
    if value.keys() == {"image"}:
        return mi.Bitmap(np.load(value["image"]))
    return {key: decoded(item) for key, item in value.items()}


if __name__ == "__main__":
    serve(Mitsuba(sys.argv[1]))
