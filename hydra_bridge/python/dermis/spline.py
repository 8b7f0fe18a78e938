"""Curves as numbers: segments of every basis and wrap, samples along them, frames that do not twist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from .arrays import np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Floats: TypeAlias = "NDArray[np.float64]"
Ints: TypeAlias = "NDArray[np.int64]"

BASES = {
    "linear": np.array([[0, 0, 0, 0], [0, 0, 0, 0], [-1, 1, 0, 0], [1, 0, 0, 0]], float),
    "bezier": np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 3, 0, 0], [1, 0, 0, 0]], float),
    "bspline": np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]) / 6.0,
    "catmullRom": np.array([[-1, 3, -3, 1], [2, -5, 4, -1], [-1, 0, 1, 0], [0, 2, 0, 0]]) / 2.0,
}
"""Rows: powers 3 to 0 of the parameter; columns: control points."""


class Spline:
    """Curves of one basis ("linear" for linear ones) and wrap. `controls` (segments, 4) index the points as `extended`
    makes them, `ends` (segments, 2) the varying values, `curve` (segments,) the curve; `bad` curves have none."""

    def __init__(self, points: Floats, counts: NDArray[np.int32], basis: str, wrap: str) -> None:
        self.points, self.basis, self.closed = points, basis, wrap == "periodic"
        self.counts = counts.astype(np.int64)
        # A pinned Bezier or linear curve reaches its ends anyway.
        self.pinned = wrap == "pinned" and basis in ("bspline", "catmullRom")
        self.first = np.cumsum(self.counts) - self.counts
        segments = self.segments()
        self.bad = segments <= 0
        segments = np.where(self.bad, 0, segments)
        varying = np.where(self.bad, 0, segments + (0 if self.closed else 1))
        self.varying = int(varying.sum())
        self.curve = np.repeat(np.arange(len(self.counts)), segments)
        starts = np.cumsum(segments) - segments
        self.within = np.arange(len(self.curve)) - starts[self.curve]
        self.last = self.within == segments[self.curve] - 1
        first_varying = (np.cumsum(varying) - varying)[self.curve]
        following = (self.within + 1) % np.maximum(varying[self.curve], 1)
        self.ends = np.stack([first_varying + self.within, first_varying + following], axis=1)
        self.controls = self.control_points()

    @staticmethod
    def hermite(points: Floats, tangents: Floats, counts: NDArray[np.int32]) -> Spline:
        """The same cubics as Beziers: their inner control points are a third of the tangents away."""
        counts = counts.astype(np.int64)
        third = tangents / 3.0
        controls = np.stack([points - third, points, points + third], axis=1).reshape(-1, 3)
        last = np.cumsum(counts)[counts > 0] - 1
        first = last + 1 - counts[counts > 0]
        controls = np.delete(controls, np.concatenate([3 * first, 3 * last + 2]), axis=0)
        return Spline(controls, np.maximum(3 * counts - 2, 0), "bezier", "nonperiodic")

    def segments(self) -> Ints:
        """Per curve; 0 or less where its number of points does not fit."""
        n = self.counts
        match self.basis:
            case "linear":
                return np.where(n >= 3, n, 0) if self.closed else n - 1
            case "bezier":
                whole = (n % 3 == 0) if self.closed else (n % 3 == 1)
                return np.where(whole, n // 3, 0)
        if self.pinned:
            return n - 1
        return np.where(n >= 3, n, 0) if self.closed else n - 3

    def control_points(self) -> Ints:
        n, first = self.counts[self.curve], self.first[self.curve]
        step = 3 if self.basis == "bezier" else 1
        within = self.within[:, None] * step + np.arange(4)[None]
        if self.basis == "linear":
            within = np.minimum(within, self.within[:, None] + 1)
        if self.pinned:
            within -= 1
        if self.closed:
            within %= n[:, None]
        controls = first[:, None] + within
        if self.pinned:
            total, curves = len(self.points), len(self.counts)
            controls = np.where(within < 0, (total + self.curve)[:, None], controls)
            controls = np.where(within >= n[:, None], (total + curves + self.curve)[:, None], controls)
        return controls

    def extended(self, values: Floats) -> Floats:
        """With the points before and behind a pinned curve, so that it begins and ends at its own."""
        if not self.pinned:
            return values
        first = np.minimum(self.first, len(values) - 1)
        last = np.maximum(self.first + self.counts - 1, 0)
        second, before = np.minimum(first + 1, len(values) - 1), np.maximum(last - 1, 0)
        return np.concatenate(
            [values, 2.0 * values[first] - values[second], 2.0 * values[last] - values[before]]
        )

    def coefficients(self, values: Floats) -> Floats:
        """(segments, 4, components): powers 3 to 0."""
        return np.einsum("pc,sc...->sp...", BASES[self.basis], self.extended(values)[self.controls])

    def bends(self) -> Floats:
        """Largest second derivative per segment; it is linear, so at an end."""
        c = self.coefficients(self.points)
        start, end = 2.0 * c[:, 1], 6.0 * c[:, 0] + 2.0 * c[:, 1]
        return np.maximum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1))

    def expected(self, interpolation: str) -> int | None:
        """Number of values; None for an interpolation that there is not."""
        lengths = {"constant": 1, "uniform": len(self.counts), "vertex": len(self.points)}
        return self.varying if interpolation in ("varying", "faceVarying") else lengths.get(interpolation)

    def sampled(self, pieces: Ints) -> Samples:
        """`pieces` of each segment; open curves end with a sample of their own."""
        number = pieces + (self.last & (not self.closed))
        segment = np.repeat(np.arange(len(number)), number)
        within = np.arange(len(segment)) - np.repeat(np.cumsum(number) - number, number)
        return Samples(self, segment, within / pieces[segment])


@dataclass
class Samples:
    """Places along curves, one curve after the other: segment and parameter."""

    spline: Spline
    segment: Ints
    u: Floats

    def __post_init__(self) -> None:
        self.curve = self.spline.curve[self.segment]
        #: First sample and number of samples of each curve that has any.
        _, self.first, self.count = np.unique(self.curve, return_index=True, return_counts=True)

    def at(self, values: Floats, interpolation: str) -> Floats:
        """A primvar at every sample."""
        match interpolation:
            case "constant":
                return np.repeat(values[:1], len(self.u), axis=0)
            case "uniform":
                return values[self.curve]
            case "vertex":
                return self.along(values)
        a, b = values[self.spline.ends[self.segment]].swapaxes(0, 1)
        u = self.u.reshape(-1, *[1] * (values.ndim - 1))
        return a + (b - a) * u

    def along(self, values: Floats) -> Floats:
        u = self.u.reshape(-1, *[1] * (values.ndim - 1))
        a, b, c, d = self.spline.coefficients(values)[self.segment].swapaxes(0, 1)
        return ((a * u + b) * u + c) * u + d

    def tangents(self) -> Floats:
        """Unit; at a joint half way between those of its segments."""
        c = self.spline.coefficients(self.spline.points)
        own = unit(derivative(c[self.segment], self.u))
        before = self.before()
        joined = before >= 0
        own[joined] += unit(derivative(c[before[joined]], np.ones(joined.sum())))
        return unit(self.mended(unit(own)))

    def turns(self) -> Floats:
        """Half the difference of the unit tangents that meet at a joint: across the one half way between them, and as
        long as the sine of half the turn; 0 elsewhere."""
        c = self.spline.coefficients(self.spline.points)
        before, half = self.before(), np.zeros((len(self.u), 3))
        joined = before >= 0
        arrives = unit(derivative(c[before[joined]], np.ones(joined.sum())))
        leaves = unit(derivative(c[self.segment[joined]], self.u[joined]))
        half[joined] = 0.5 * (leaves - arrives)
        return half

    def before(self) -> Ints:
        """For samples at the start of a segment, the segment that ends there; else -1."""
        spline = self.spline
        segments = np.arange(len(spline.curve))
        _, first, count = np.unique(spline.curve, return_index=True, return_counts=True)
        previous = np.where(spline.within > 0, segments - 1, -1)
        if spline.closed:
            previous[first] = first + count - 1
        return np.where(self.u == 0.0, previous[self.segment], -1)

    def mended(self, tangents: Floats) -> Floats:
        """Where control points coincide there is no derivative: the way from neighbour to neighbour instead."""
        lost = np.flatnonzero(~tangents.any(axis=1))
        if len(lost):
            points = self.along(self.spline.points)
            ends = self.first[np.searchsorted(self.first, lost, "right") - 1]
            count = self.count[np.searchsorted(self.first, lost, "right") - 1]
            ahead = np.minimum(lost + 1, ends + count - 1)
            tangents[lost] = points[ahead] - points[np.maximum(lost - 1, ends)]
            tangents[lost[~tangents[lost].any(axis=1)]] = (0.0, 0.0, 1.0)
        return tangents


def derivative(c: Floats, u: Floats) -> Floats:
    u = u[:, None]
    return (3.0 * c[:, 0] * u + 2.0 * c[:, 1]) * u + c[:, 2]


def unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), 0.0)


def frames(points: Floats, tangents: Floats, samples: Samples) -> Floats:
    """Unit vectors across the tangents that turn about them as little as can be: double reflection (Wang et al. 2008),
    all curves at once. Around closed curves the turn that is left over is spread evenly."""
    across = perpendicular(tangents)
    for i in range(1, int(samples.count.max())):
        here = samples.first[samples.count > i] + i
        across[here] = transported(points, tangents, across, here - 1, here)
    if samples.spline.closed:
        spread_turn(points, tangents, across, samples)
    return across


def perpendicular(tangents: Floats) -> Floats:
    smallest = np.eye(3)[np.abs(tangents).argmin(axis=1)]
    return unit(np.cross(tangents, smallest))


def transported(points: Floats, tangents: Floats, across: Floats, at: Ints, to: Ints) -> Floats:
    step = points[to] - points[at]
    r, t = reflected(across[at], step), reflected(tangents[at], step)
    r = reflected(r, tangents[to] - t)
    # Rounding: what is left along the tangent would grow from step to step.
    r = unit(r - tangents[to] * np.sum(r * tangents[to], axis=1, keepdims=True))
    return np.where(r.any(axis=1, keepdims=True), r, perpendicular(tangents[to]))


def reflected(vectors: Floats, across: Floats) -> Floats:
    square = np.sum(across * across, axis=1, keepdims=True)
    share = 2.0 * np.sum(vectors * across, axis=1, keepdims=True) / np.where(square > 0.0, square, 1.0)
    return vectors - share * across


def spread_turn(points: Floats, tangents: Floats, across: Floats, samples: Samples) -> None:
    first, last = samples.first, samples.first + samples.count - 1
    arrived = transported(points, tangents, across, last, first)
    other = np.cross(tangents[first], across[first])
    angle = np.arctan2(np.sum(arrived * other, axis=1), np.sum(arrived * across[first], axis=1))
    curve = np.repeat(np.arange(len(first)), samples.count)
    share = (np.arange(len(points)) - first[curve]) / samples.count[curve]
    turn = (-angle[curve] * share)[:, None]
    across[:] = np.cos(turn) * across + np.sin(turn) * np.cross(tangents, across)
