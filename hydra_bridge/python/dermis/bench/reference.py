"""The truth as far as it is known: two independent halves, made and kept by the command, or EXR files given."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from .._core import __version__
from ..cli.settings import Settings
from .crops import Window
from .measures import Array, Mask
from .render import Watch, render
from .scenes import Scene
from .suite import Suite

#: Seeds of the halves, far from those of methods: noise in common with a method would hide its error.
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
    #: Pixels that are measured; None: all.
    mask: Mask = None

    def crop(self, window: Window) -> tuple[Array, Array | None, Mask]:
        """Image, variance and mask of a window inside."""
        at = window.slices(self.window)
        parts = (None if part is None else part[at] for part in (self.variance, self.mask))
        return self.image[at], *parts


def of_halves(first: Array, second: Array) -> tuple[Array, Array]:
    """Mean of two independent images of equal work, and the variance of that mean: unbiased from one difference."""
    return (first + second) / 2.0, ((first - second) / 2.0) ** 2


def reference_of(
    scene: Scene, suite: Suite, window: Window, folder: Path, watch: Callable[[int, bool], Watch]
) -> Reference:
    """The reference over `window`: given, kept in `folder` from an earlier run, or rendered now. `watch` is told of
    each half, and whether it was kept.

    Raises BadReference, CoreError.
    """
    if scene.spec.reference:
        found = given(scene, suite, window)
    else:
        files = made(scene, suite, window, folder, watch)
        halves = [read_color(file, scene, window) for file in files]
        found = Reference(*of_halves(*halves), window, files, HALVES)
    return replace(found, mask=lit_below(found, scene)) if suite.subsurface_only else found


def made(
    scene: Scene, suite: Suite, window: Window, folder: Path, watch: Callable[[int, bool], Watch]
) -> tuple[Path, ...]:
    """Files of both halves; those that are not there are rendered."""
    method, samples = suite.reference_method, (suite.reference_samples + 1) // 2
    assert method is not None  # a scene without a reference has one
    files = []
    for half, seed in enumerate(SEEDS):
        settings = {**method.settings, "samples": samples, "seed": seed, "aovs": ["subsurface"]}
        file = kept_file(scene, settings, window, folder)
        share = watch(half, file.exists())
        if not file.exists():
            render(scene, settings, window, file, share)
        files.append(file)
    return tuple(files)


def kept_file(scene: Scene, settings: Settings, window: Window, folder: Path) -> Path:
    """Name of one half, by all that its pixels depend on but the source of the renderer, of which only the version
    is known."""
    content = json.dumps([__version__, scene.key, settings, list(window)], sort_keys=True)
    return folder / f"{hashlib.sha256(content.encode()).hexdigest()[:24]}.exr"


def lit_below(reference: Reference, scene: Scene) -> NDArray[np.bool_]:
    """Pixels where light came out from below a surface, in either half."""
    mask = np.zeros(reference.image.shape[:2], dtype=bool)
    for file in reference.files:
        light = read_channels(file, scene, reference.window, "subsurface.")
        if light is None:
            raise BadReference(f"{file}: it has no subsurface AOV, which --subsurfaceOnly goes by")
        mask |= (light != 0.0).any(axis=-1)
    return mask


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
        for repeat in range(suite.seeds):
            if method.seeded(suite.seed + repeat)["seed"] == seed:
                raise BadReference(
                    f"{file}: it was rendered with seed {seed}, as is repeat {repeat} of {method.label}: "
                    "their noise may be the same; choose another --seed"
                )
