"""The truth as far as it is known: two independent halves, made and kept by the command, or EXR files given."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from .._core import __version__
from .methods import Method
from .regions import Window
from .render import render
from .scenes import Scene
from .suite import Suite

Array = NDArray[np.float64]

#: Seeds of the halves, far from those of repeats: noise in common with a method would hide its error.
SEEDS = (0x7E5E_0001, 0x7E5E_0002)

#: Where the noise of a reference is known from.
HALVES, VARIANCE_AOV, UNKNOWN = "difference of two halves", "variance AOV", "unknown"


class BadReference(Exception):
    """A reference that cannot be used; the text names the file."""


@dataclass(frozen=True)
class Reference:
    #: Linear RGB over the window.
    image: Array
    #: Per pixel and channel, of `image`'s noise; None where it is not known.
    variance: Array | None
    window: Window
    files: tuple[Path, ...]
    #: Where the variance comes from.
    noise_from: str

    def crop(self, window: Window) -> tuple[Array, Array | None]:
        """Image and variance of a window inside."""
        at = window.slices(self.window)
        return self.image[at], None if self.variance is None else self.variance[at]


def of_halves(first: Array, second: Array) -> tuple[Array, Array]:
    """Mean of two independent images of equal work, and the variance of that mean: unbiased from one difference."""
    return (first + second) / 2.0, ((first - second) / 2.0) ** 2


def reference_of(
    scene: Scene, suite: Suite, window: Window, folder: Path, say: Callable[[str], None]
) -> Reference:
    """The reference over `window`: given, kept in `folder` from an earlier run, or rendered now.

    Raises BadReference, CoreError.
    """
    if scene.spec.reference:
        return given(scene, suite, window)
    method, samples = suite.reference_method, (suite.reference_samples + 1) // 2
    files = [kept_file(scene, method, samples, seed, window, folder) for seed in SEEDS]
    for file, seed in zip(files, SEEDS, strict=True):
        if not file.exists():
            say(f"reference {scene.spec.name} {file.name}: {samples} spp of {method.label}")
            settings = {**method.settings, "samples": samples, "seed": seed}
            render(scene, settings, window, file)
    halves = [read_color(file, scene, window) for file in files]
    return Reference(*of_halves(*halves), window, tuple(files), HALVES)


def kept_file(scene: Scene, method: Method, samples: int, seed: int, window: Window, folder: Path) -> Path:
    """Name of one half, by all that its pixels depend on but the source of the renderer, of which only the version
    is known."""
    content = [__version__, scene.key, dict(sorted(method.settings.items())), samples, seed, list(window)]
    key = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:24]
    return folder / f"{key}.exr"


def given(scene: Scene, suite: Suite, window: Window) -> Reference:
    """From the files of the scene: two are halves; of one, the variance AOV is used if it is there."""
    files = scene.spec.reference
    if len(files) > 2:
        raise BadReference(f"{scene.spec.name}: a reference is one EXR or two halves, not {len(files)} files")
    for file in files:
        refuse_shared_seed(file, suite)
    if len(files) == 2:
        halves = [read_color(file, scene, window) for file in files]
        return Reference(*of_halves(*halves), window, files, HALVES)
    variance = read_channels(files[0], scene, window, "variance.")
    source = UNKNOWN if variance is None else VARIANCE_AOV
    return Reference(read_color(files[0], scene, window), variance, window, files, source)


def read_color(file: Path, scene: Scene, window: Window) -> Array:
    color = read_channels(file, scene, window, "")
    if color is None:
        raise BadReference(f"{file}: it has no channels R, G, B")
    return color


def read_channels(file: Path, scene: Scene, window: Window, layer: str) -> Array | None:
    """R, G, B of a layer over `window`; None where the file has no such layer. Raises BadReference."""
    image = oiio.ImageBuf(str(file))
    spec = image.spec()
    if image.has_error or spec.width == 0:
        raise BadReference(f"{file}: it cannot be read: {image.geterror()}")
    if (spec.full_width, spec.full_height) != scene.resolution:
        size = "{} x {}".format(*scene.resolution)
        raise BadReference(
            f"{file}: it is of {spec.full_width} x {spec.full_height} pixels, {scene.spec.name} of {size}"
        )
    held = Window(spec.x, spec.y, spec.x + spec.width, spec.y + spec.height)
    if not window.within(held):
        raise BadReference(f"{file}: its data window {tuple(held)} does not cover {tuple(window)}")
    names = [f"{layer}{channel}" for channel in "RGB"]
    if not set(names) <= set(spec.channelnames):
        return None
    at = (*window.slices(held), [spec.channelnames.index(name) for name in names])
    values = np.asarray(image.get_pixels(oiio.FLOAT))[at].astype(np.float64)
    if not np.isfinite(values).all():
        raise BadReference(f"{file}: it has pixels that are not finite")
    return values


def refuse_shared_seed(file: Path, suite: Suite) -> None:
    """A repeat with the seed of the reference may be a part of it: its noise would not count as error."""
    image = oiio.ImageBuf(str(file))
    seed = image.spec().get_int_attribute("dermis:seed", -1)
    for method in suite.methods:
        for repeat in range(suite.repeats):
            if method.seeded(suite.seed + repeat)["seed"] == seed:
                raise BadReference(
                    f"{file}: it was rendered with seed {seed}, as is repeat {repeat} of {method.label}: "
                    "their noise may be the same; choose another --seed"
                )
