"""What training costs and gains: `make bench-training`, or `python tests/bench_training.py STAGE...`.

Every stage is rendered for budgets of seconds of one thread's processor time, by classical walks and as `auto` decides,
both twice with other seeds. `share` is training's part of the render, `gain` the efficiency 1 / (relMSE seconds) of
`auto` over that of classical walks; relMSE by half the squared difference of the two pictures, the brightest 2 % of the
errors left out.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from pxr import Usd, UsdGeom

import dermis
from dermis._core import Delegate

SHARED = Path(__file__).parents[2] / "shared" / "scenes"
STAGES = ["backlit_bunny", "card_skull", "creature_spot", "envmap_dragon"]

#: Samples that say what one costs.
PILOT = 4

#: Of the errors, those that count: fireflies decide the mean of a few seconds.
TRIMMED = 0.98


@dataclass
class Measured:
    samples: int
    seconds: float
    share: float
    error: float

    @property
    def efficiency(self) -> float:
        return 1 / (self.error * self.seconds)


def render(scene: dermis.FlatStage, **settings: object) -> tuple[dermis.Image, float]:
    delegate = Delegate()
    dermis.populate(delegate, scene)
    delegate.set_settings(json.dumps({"threads": 1, **settings}))
    delegate.commit()
    begun = process_time()
    delegate.start()
    while not delegate.wait(0.5):
        pass
    return dermis.Image(delegate.snapshot(), json.loads(delegate.stats())), process_time() - begun


def error(a: np.ndarray, b: np.ndarray) -> float:
    mean = 0.5 * (a + b)
    floor = 0.01 * mean.mean() ** 2
    errors = np.sort((0.5 * (a - b) ** 2 / (mean**2 + floor)).mean(axis=-1), axis=None)
    return float(errors[: int(TRIMMED * errors.size)].mean())


def measure(scene: dermis.FlatStage, budget: float, **asked: object) -> Measured:
    _, begun = render(scene, samples=PILOT, **asked)
    _, later = render(scene, samples=4 * PILOT, **asked)
    samples = max(1, round(budget / max(1e-9, (later - begun) / (3 * PILOT))))
    pictures, seconds, share = [], 0.0, 0.0
    for seed in (1, 2):
        image, took = render(scene, samples=samples, seed=seed, **asked)
        pictures.append(np.asarray(image.color[..., :3], dtype=np.float64))
        seconds += 0.5 * took
        share = max(share, image.stats.get("guide", {}).get("training_share", 0.0))
    return Measured(samples, seconds, share, error(*pictures))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stages", nargs="*", type=Path, help="the four shared ones by default")
    parser.add_argument("--budgets", nargs="+", type=float, default=[1, 2, 4, 10, 20])
    parser.add_argument("--size", nargs=2, type=int, default=(160, 120), metavar=("WIDTH", "HEIGHT"))
    options = parser.parse_args()
    print("stage              budget   samples: classical  auto   seconds        share   gain")
    for stage in options.stages or [SHARED / f"{name}.usda" for name in STAGES]:
        opened = Usd.Stage.Open(str(stage))
        camera = next(str(prim.GetPath()) for prim in opened.Traverse() if prim.IsA(UsdGeom.Camera))
        scene, asked = dermis.flatten(opened), {"camera": camera, "resolution": tuple(options.size)}
        for budget in options.budgets:
            plain, auto = (measure(scene, budget, walk=walk, **asked) for walk in ("classical", "auto"))
            gain = auto.efficiency / plain.efficiency
            line = f"{stage.stem:18} {budget:6g} {plain.samples:19} {auto.samples:5} {plain.seconds:9.2f}"
            print(f"{line} {auto.seconds:6.2f} {auto.share:7.1%} {gain:6.2f}", flush=True)


if __name__ == "__main__":
    main()
