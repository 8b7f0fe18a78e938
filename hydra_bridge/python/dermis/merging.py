"""Tiles and sample ranges of one image put together.

Where one part covers a pixel its values are copied, bit for bit. Where several do, means are weighted by their
numbers of samples in double precision (a single render sums samples in another order, so that it differs in the last
bits), variances are pooled (Chan et al. 1983), and what belongs to the nearest sample comes from the part that has it.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .aovs import GUIDE_AOVS

#: AOVs of the nearest sample of a pixel.
NEAREST = ("depth", "normal", "position", "primId", "distance", "deviceDepth", "Peye", "Neye", "motionVector")
#: Of them, those that tell how near it is, the best first.
DEPTHS = ("depth", "distance", "deviceDepth")
COUNT = "sampleCount"
COLOR_ATTRIBUTES = ("chromaticities", "colorInteropID")
VARIANCE = "variance"
CRYPTO = "cryptoObject"


class MergeError(Exception):
    """Parts that cannot be merged; the text names them and says what to do."""


@dataclass
class Part:
    file: str
    #: Display window, and the data window's origin and size (width, height), in pixels, y down.
    resolution: tuple[int, int]
    origin: tuple[int, int]
    size: tuple[int, int]
    pixel_aspect: float
    channels: dict[str, NDArray]
    attributes: dict[str, Any]
    #: AOV of each layer, by its name in the file.
    aovs: dict[str, str]
    #: Samples per pixel.
    counts: NDArray[np.int64]

    def window(self, origin: tuple[int, int]) -> tuple[slice, slice]:
        """Rows and columns of an image whose data window begins at `origin`."""
        x, y = self.origin[0] - origin[0], self.origin[1] - origin[1]
        return slice(y, y + self.size[1]), slice(x, x + self.size[0])

    def range(self) -> tuple[int, int]:
        """Numbers of its samples, half open."""
        first = int(self.attributes.get("dermis:sampleOffset", 0))
        return first, first + int(self.counts.max())


@dataclass
class Merged:
    #: As `_core.write_channels` takes it.
    frame: tuple[list[int], list[int], list[int], float]
    channels: dict[str, NDArray] = field(default_factory=dict)
    attributes: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    summary: str = ""
    #: Pixels of the data window without a sample.
    holes: int = 0


def read_part(file: str) -> Part:
    """An EXR of `dermis record`. Raises MergeError."""
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(file)
    if image is None:
        raise MergeError(f"{file}: it cannot be read ({oiio.geterror().strip()})")
    spec = image.spec()
    channels = {}
    for i, name in enumerate(spec.channelnames):
        kind = oiio.UINT32 if is_id(name) else oiio.FLOAT
        values = image.read_image(0, 0, i, i + 1, kind)
        if values is None:
            raise MergeError(f"{file}: it cannot be read ({image.geterror().strip()})")
        channels[name] = values.reshape(spec.height, spec.width)
    attributes = {
        a.name: a.value
        for a in spec.extra_attribs
        if a.name.startswith(("dermis", "cryptomatte/")) or a.name in COLOR_ATTRIBUTES
    }
    if "chromaticities" in attributes:
        attributes["chromaticities"] = [float(x) for x in attributes["chromaticities"]]
    image.close()
    if "dermis:fingerprint" not in attributes:
        raise MergeError(f"{file}: it is not of `dermis record`, or of a version before `dermis merge`")
    aovs = json.loads(attributes.get("dermis:layers", "{}"))
    return Part(
        file,
        (spec.full_width, spec.full_height),
        (spec.x, spec.y),
        (spec.width, spec.height),
        float(spec.getattribute("PixelAspectRatio") or 1.0),
        channels,
        attributes,
        aovs,
        sample_counts(file, channels, aovs, attributes, (spec.height, spec.width)),
    )


def is_id(channel: str) -> bool:
    return channel.endswith((".id", ".count"))


def layer_of(channel: str) -> str:
    return channel.rpartition(".")[0]


def sample_counts(
    file: str,
    channels: dict[str, NDArray],
    aovs: dict[str, str],
    attributes: dict[str, Any],
    shape: tuple[int, int],
) -> NDArray[np.int64]:
    for name, values in channels.items():
        if aovs.get(layer_of(name)) == COUNT:
            return values.astype(np.int64)
    if "dermis:samples" in attributes:
        return np.full(shape, int(attributes["dermis:samples"]), np.int64)
    raise MergeError(f"{file}: its pixels have different numbers of samples; render it with --aov {COUNT}")


def merge(parts: Sequence[Part], force: bool = False) -> Merged:
    """The image of all parts. Raises MergeError where they are not of one image, or share samples."""
    if not force:
        refuse_strangers(parts)
        refuse_common_samples(parts)
    refuse_other_frames(parts)
    origin = tuple(min(part.origin[i] for part in parts) for i in (0, 1))
    end = tuple(max(part.origin[i] + part.size[i] for part in parts) for i in (0, 1))
    shape = (end[1] - origin[1], end[0] - origin[0])
    merger = Merger(parts, origin, shape)
    first = parts[0]
    frame = (list(first.resolution), list(origin), [shape[1], shape[0]], first.pixel_aspect)
    merged = Merged(frame, merger.merged(), warnings=merger.warnings, holes=int((merger.counts == 0).sum()))
    if merged.holes:
        merged.warnings.append(
            f"{merged.holes} of {merger.counts.size} pixels are in none of the parts; they are black"
        )
    merged.attributes = attributes(parts, merger.counts)
    least, most = int(merger.counts.min()), int(merger.counts.max())
    if least < most and not any(layer_of(name) == COUNT for name in merged.channels):
        merged.channels[f"{COUNT}.count"] = merger.counts.astype(np.uint32)
        layers = json.loads(merged.attributes.get("dermis:layers", "{}"))
        merged.attributes["dermis:layers"] = json.dumps({**layers, COUNT: COUNT})
    merged.summary = f"{shape[1]} x {shape[0]} pixels, {least} to {most} samples each"
    return merged


def refuse_strangers(parts: Sequence[Part]) -> None:
    for part in parts[1:]:
        if part.attributes["dermis:fingerprint"] != parts[0].attributes["dermis:fingerprint"]:
            raise MergeError(
                f"{part.file}: scene or settings are not those of {parts[0].file} (only window, samples, sampleOffset, "
                "seed, noiseThreshold and AOVs may differ); --force merges them all the same"
            )


def refuse_other_frames(parts: Sequence[Part]) -> None:
    for part in parts[1:]:
        if part.resolution != parts[0].resolution:
            raise MergeError(
                f"{part.file}: its image is {part.resolution}, that of {parts[0].file} {parts[0].resolution}"
            )


def refuse_common_samples(parts: Sequence[Part]) -> None:
    """The same samples twice would count as more than they are."""
    for a, b in combinations(parts, 2):
        apart = any(
            a.origin[i] + a.size[i] <= b.origin[i] or b.origin[i] + b.size[i] <= a.origin[i] for i in (0, 1)
        )
        if apart or a.attributes.get("dermis:seed") != b.attributes.get("dermis:seed"):
            continue
        first, last = max(a.range()[0], b.range()[0]), min(a.range()[1], b.range()[1])
        if first < last:
            raise MergeError(
                f"{b.file}: it has samples {first} to {last - 1} in common with {a.file}; "
                "render parts with another --sampleOffset or --seed, or --force it"
            )


class Merger:
    """Channel by channel over the union of the data windows."""

    def __init__(self, parts: Sequence[Part], origin: tuple[int, int], shape: tuple[int, int]) -> None:
        self.parts, self.shape = parts, shape
        self.windows = [part.window(origin) for part in parts]
        self.counts = np.zeros(shape, np.int64)
        self.covered = np.zeros(shape, np.int64)
        for part, window in zip(parts, self.windows, strict=True):
            self.counts[window] += part.counts
            self.covered[window] += part.counts > 0
        self.overlaps = bool((self.covered > 1).any())
        self.warnings: list[str] = []

    def merged(self) -> dict[str, NDArray]:
        names = [name for name in self.parts[0].channels if all(name in part.channels for part in self.parts)]
        for name in dict.fromkeys(name for part in self.parts for name in part.channels if name not in names):
            self.warnings.append(f"{name}: not in every part; it is left out")
        owner = self.nearest_part(names)
        channels = {}
        for name in names:
            aov = self.parts[0].aovs.get(layer_of(name), layer_of(name))
            if aov == COUNT:
                channels[name] = self.counts.astype(np.uint32)
            elif self.overlaps and aov in GUIDE_AOVS:
                self.warnings.append(f"{name}: means over walks cannot be merged; it is left out")
            elif aov in NEAREST or not self.overlaps:
                channels[name] = self.chosen(name, owner)
            elif aov == VARIANCE:
                if (pooled := self.pooled(name)) is not None:
                    channels[name] = pooled
            elif not aov.startswith(CRYPTO):
                channels[name] = self.mean(name)
        if self.overlaps:
            channels.update(self.ranks([name for name in names if layer_of(name).startswith(CRYPTO)]))
        return channels

    def pieces(self, name: str) -> list[tuple[tuple[slice, slice], NDArray[np.int64], NDArray]]:
        return [
            (window, part.counts, part.channels[name])
            for part, window in zip(self.parts, self.windows, strict=True)
        ]

    def nearest_part(self, names: list[str]) -> NDArray[np.int64]:
        """Of each pixel the part with the nearest sample, the first of equals; -1 where there is none."""
        owner = np.full(self.shape, -1, np.int64)
        kinds = {self.parts[0].aovs.get(layer_of(name), layer_of(name)): name for name in names}
        depth = next((kinds[kind] for kind in DEPTHS if kind in kinds), None)
        if depth is None and self.overlaps and any(kind in NEAREST for kind in kinds):
            self.warnings.append(
                "depth is in none of the parts; what is of the nearest sample comes from the first part"
            )
        nearest = np.full(self.shape, np.inf)
        for number, (part, window) in enumerate(zip(self.parts, self.windows, strict=True)):
            values = part.channels[depth] if depth else np.zeros(part.counts.shape)
            better = (part.counts > 0) & ((owner[window] < 0) | (values < nearest[window]))
            owner[window][better] = number
            nearest[window][better] = values[better]
        return owner

    def chosen(self, name: str, owner: NDArray[np.int64]) -> NDArray:
        result = np.zeros(self.shape, np.uint32 if is_id(name) else np.float32)
        for number, (window, _, values) in enumerate(self.pieces(name)):
            mine = owner[window] == number
            result[window][mine] = values[mine]
        return result

    def mean(self, name: str) -> NDArray[np.float32]:
        """Weighted by samples; as it is where one part covers a pixel."""
        total, alone = np.zeros(self.shape), np.zeros(self.shape, np.float32)
        for window, counts, values in self.pieces(name):
            total[window] += counts * values.astype(np.float64)
            mine = (counts > 0) & (self.covered[window] == 1)
            alone[window][mine] = values[mine]
        mean = (total / np.maximum(self.counts, 1)).astype(np.float32)
        return np.where(self.covered == 1, alone, mean)

    def pooled(self, name: str) -> NDArray[np.float32] | None:
        """Variance of the mean over all samples, from those of the parts: V = S / (N (N - 1)) with
        S = sum n (n - 1) v + n (m - M)^2."""
        color = name.rpartition(".")[2]
        if color not in self.parts[0].channels:
            self.warnings.append(f"{name}: it cannot be pooled without the beauty; it is left out")
            return None
        mean = self.mean(color).astype(np.float64)
        squares, alone = np.zeros(self.shape), np.zeros(self.shape, np.float32)
        for (window, counts, values), (_, _, means) in zip(
            self.pieces(name), self.pieces(color), strict=True
        ):
            squares[window] += counts * (counts - 1.0) * values + counts * (means - mean[window]) ** 2
            mine = (counts > 0) & (self.covered[window] == 1)
            alone[window][mine] = values[mine]
        many = np.maximum(self.counts, 2).astype(np.float64)
        return np.where(self.covered == 1, alone, squares / (many * (many - 1.0))).astype(np.float32)

    def ranks(self, names: list[str]) -> dict[str, NDArray[np.float32]]:
        """Cryptomatte: the coverages of each id, weighted by samples and ranked anew."""
        layers = sorted({layer_of(name) for name in names})
        pairs = [(f"{layer}.{a}", f"{layer}.{b}") for layer in layers for a, b in (("R", "G"), ("B", "A"))]
        ids, weights = [], []
        for part, window in zip(self.parts, self.windows, strict=True):
            for identity, coverage in pairs:
                ids.append(spread(self.shape, window, part.channels[identity].view(np.uint32)))
                # Coverages are whole samples over their number.
                samples = np.rint(part.channels[coverage] * part.counts)
                weights.append(spread(self.shape, window, samples))
        if not ids:
            return {}
        order, weight = add_equal(np.stack(ids, -1), np.stack(weights, -1))
        coverage = weight / np.maximum(self.counts, 1)[..., None]
        found: dict[str, NDArray[np.float32]] = {}
        for k, (a, b) in enumerate(pairs):
            covers = coverage[..., k] > 0.0
            found[a] = np.where(covers, order[..., k], 0).astype(np.uint32).view(np.float32)
            found[b] = coverage[..., k].astype(np.float32)
        return found


def spread(shape: tuple[int, int], window: tuple[slice, slice], values: NDArray) -> NDArray:
    whole = np.zeros(shape, values.dtype)
    whole[window] = values
    return whole


def add_equal(ids: NDArray[np.uint32], weights: NDArray) -> tuple[NDArray[np.uint32], NDArray]:
    """Sums the weights of equal ids along the last axis; the largest first."""
    order = np.argsort(ids, -1, kind="stable")
    ids, weights = np.take_along_axis(ids, order, -1), np.take_along_axis(weights, order, -1)
    for k in range(ids.shape[-1] - 1, 0, -1):
        same = ids[..., k] == ids[..., k - 1]
        weights[..., k - 1] += np.where(same, weights[..., k], 0.0)
        weights[..., k] = np.where(same, 0.0, weights[..., k])
    order = np.argsort(-weights, -1, kind="stable")
    return np.take_along_axis(ids, order, -1), np.take_along_axis(weights, order, -1)


def attributes(parts: Sequence[Part], counts: NDArray[np.int64]) -> dict[str, Any]:
    """What all parts say alike, and what the merged image is."""
    first = parts[0].attributes
    alike = {
        name: value
        for name, value in first.items()
        if all(part.attributes.get(name) == value for part in parts) and not name.startswith("dermis:samples")
    }
    if counts.min() == counts.max():
        alike["dermis:samples"] = int(counts.max())
    alike["dermis:sampleOffset"] = min(part.range()[0] for part in parts)
    alike["dermis:parts"] = json.dumps([part.file for part in parts])
    return alike
