"""Signed distance tools of a sculptor: shapes, smooth blends, brush strokes, smooth noise.

Points are arrays (n, 3) in centimetres; a field maps them to n signed distances, negative inside. The fields
are bounds rather than exact distances, with slopes near one; meshing projects onto the zero set anyway.
"""

from dataclasses import dataclass, field

import numpy as np


def vec(*xyz):
    return np.array(xyz, dtype=np.float64)


def unit(v):
    return v / np.linalg.norm(v)


def smooth_abs(x, eps):
    """|x| without its kink, so that mirrored halves meet smoothly; eps is the radius of the rounding."""
    return np.sqrt(x * x + eps * eps)


def smooth_min(a, b, k):
    """Cubic smooth minimum (Quilez 2013): twice differentiable, equal to min where |a - b| > k."""
    h = np.maximum(k - np.abs(a - b), 0) / k
    return np.minimum(a, b) - h * h * h * (k / 6)


def smooth_max(a, b, k):
    return -smooth_min(-a, -b, k)


def bell(x):
    """Gaussian bump, one at zero."""
    return np.exp(-x * x)


def ramp(x, lo, hi):
    """Quintic step from 0 at lo to 1 at hi (lo > hi turns it round), twice differentiable."""
    t = np.clip((x - lo) / (hi - lo), 0, 1)
    return t * t * t * (t * (6 * t - 15) + 10)


class Spline:
    """Natural cubic spline through (x, y); y may be vectors. Outside the knots its end values hold."""

    def __init__(self, x, y):
        self.x, self.y = np.asarray(x, float), np.asarray(y, float)
        n, h = len(self.x), np.diff(self.x)
        a, rhs = np.eye(n), np.zeros_like(self.y)
        slope = (np.diff(self.y, axis=0).T / h).T
        for i in range(1, n - 1):
            a[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
            rhs[i] = 6 * (slope[i] - slope[i - 1])
        self.bend = np.linalg.solve(a, rhs)

    def __call__(self, x):
        x = np.clip(x, self.x[0], self.x[-1])
        i = np.clip(np.searchsorted(self.x, x) - 1, 0, len(self.x) - 2)
        h = self.x[i + 1] - self.x[i]
        b = (x - self.x[i]) / h
        a = 1 - b
        if self.y.ndim > 1:
            a, b, h = a[:, None], b[:, None], h[:, None]
        curve = (a**3 - a) * self.bend[i] + (b**3 - b) * self.bend[i + 1]
        return a * self.y[i] + b * self.y[i + 1] + curve * h * h / 6


def smooth_line(points, count):
    """count points along the spline through the given ones (any dimension), by chord length."""
    points = np.asarray(points, float)
    chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return Spline(chord, points)(np.linspace(0, chord[-1], count))


def rotation(x=0, y=0, z=0):
    """Rotation matrix from degrees about X, then Y, then Z; columns are the turned axes."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians([x, y, z])), np.sin(np.radians([x, y, z]))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


class Ellipsoid:
    def __init__(self, center, radii, **turn):
        self.center, self.radii, self.frame = vec(*center), vec(*radii), rotation(**turn)
        self.reach = max(radii)

    def __call__(self, p):
        q = (p - self.center.astype(p.dtype)) @ self.frame.astype(p.dtype)
        r = self.radii.astype(p.dtype)
        k0 = np.sqrt(np.sum((q / r) ** 2, axis=1))
        k1 = np.sqrt(np.sum((q / (r * r)) ** 2, axis=1))
        # k1 vanishes at the centre only, far from the surface; the floor keeps 0 / 0 away.
        return k0 * (k0 - 1) / np.maximum(k1, 1e-6)


class Tube:
    """A round body along the spline through points, its radius interpolated along it."""

    def __init__(self, points, radii, count=9):
        self.line = smooth_line(points, count)
        radii = np.broadcast_to(np.asarray(radii, float), (len(points),))
        self.radii = np.interp(np.linspace(0, 1, count), np.linspace(0, 1, len(radii)), radii)
        self.center = (self.line.min(0) + self.line.max(0)) / 2
        self.reach = np.linalg.norm(self.line - self.center, axis=1).max() + self.radii.max()

    def __call__(self, p):
        return closest_on_line(p, self.line, self.radii)[0]


def closest_on_line(p, line, radii):
    """Distance to a polyline less the radius there, and the parameter (0..1) of the nearest point."""
    best, where = np.full(len(p), np.inf, p.dtype), np.zeros(len(p), p.dtype)
    for i in range(len(line) - 1):
        a, ab = line[i].astype(p.dtype), (line[i + 1] - line[i]).astype(p.dtype)
        q = p - a
        t = np.clip((q @ ab) / (ab @ ab), 0, 1)
        q -= t[:, None] * ab
        d = np.sqrt(np.einsum("ij,ij->i", q, q)) - (radii[i] + t * (radii[i + 1] - radii[i]))
        closer = d < best
        best, where = np.where(closer, d, best), np.where(closer, (i + t) / (len(line) - 1), where)
    return best, where.astype(p.dtype)


@dataclass
class Stroke:
    """A brush stroke: raises (height > 0) or engraves the surface along a line, fading at both ends."""

    line: np.ndarray
    height: float
    width: float
    fade: float = 0.5

    def __post_init__(self):
        self.center = (self.line.min(0) + self.line.max(0)) / 2
        # Beyond three widths the bell is 1e-4 of the height: invisible.
        self.reach = np.linalg.norm(self.line - self.center, axis=1).max() + 3 * self.width

    def __call__(self, p):
        d, t = closest_on_line(p, self.line, np.zeros(len(self.line)))
        ends = np.clip(np.sin(np.pi * np.clip(t, 0.02, 0.98)), 0, 1) ** self.fade
        return (self.height * ends * bell(d / self.width)).astype(p.dtype)


def lattice_hash(i, j, k, seed):
    """Pseudo-random integers of lattice points, the same on every machine."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791) ^ (seed * 2654435761)
    h = (h ^ (h >> 13)) * 1274126177 & 0x7FFFFFFF
    return (h ^ (h >> 16)) & 0xFFFF


def noise(p, scale, seed=0):
    """Gradient noise (Perlin 2002) of the given feature size, in about -1..1, twice differentiable."""
    q = p / np.asarray(scale, p.dtype)
    base = np.floor(q)
    f = (q - base).astype(p.dtype)
    w = f * f * f * (f * (6 * f - 15) + 10)
    cell, total = base.astype(np.int64), np.zeros(len(p), p.dtype)
    for c in range(8):
        o = np.array([c & 1, c >> 1 & 1, c >> 2])
        h = lattice_hash(*(cell + o).T, seed)
        slope = np.stack([h & 31, h >> 5 & 31, h >> 10 & 31], axis=1).astype(p.dtype) / 15.5 - 1
        weight = np.prod(np.where(o == 1, w, 1 - w), axis=1)
        total += weight * np.einsum("ij,ij->i", slope, f - o.astype(p.dtype))
    return total * 1.4


@dataclass
class Op:
    kind: str
    shape: object
    k: float
    mirrored: bool


@dataclass
class Sculpture:
    """An ordered list of operations; mirrored ones see (|x|, y, z), the others the whole space."""

    mirror_rounding: float = 0.3
    ops: list = field(default_factory=list)
    pending: list = field(default_factory=list)

    def add(self, shape, k=0.6, mirrored=True):
        self.ops.append(Op("add", shape, k, mirrored))

    def carve(self, shape, k=0.4, mirrored=True):
        self.ops.append(Op("carve", shape, k, mirrored))

    def displace(self, function, mirrored=False):
        """function(p) is the height added along the normal, everywhere."""
        self.ops.append(Op("displace", function, 0.0, mirrored))

    def stroke(self, line, height, width, mirrored=True, fade=0.5):
        self.ops.append(Op("stroke", Stroke(np.asarray(line), height, width, fade), 0.0, mirrored))

    def front(self, points, *brush, count=14, **how):
        """A stroke drawn in the front view: (x, y) pairs, to be laid on the surface seen from +Z."""
        self.pending.append((np.insert(smooth_line(points, count), 2, 14, axis=1), vec(0, 0, -1), brush, how))

    def side(self, points, *brush, count=14, **how):
        """A stroke drawn in the side view: (z, y) pairs, to be laid on the surface seen from +X."""
        line = np.insert(smooth_line(points, count)[:, ::-1], 0, 12, axis=1)
        self.pending.append((line, vec(-1, 0, 0), brush, how))

    def settle(self):
        """Lays the pending strokes on the surface made so far: sphere tracing, all in one go."""
        p = np.concatenate([line for line, *_ in self.pending])
        toward = np.concatenate([np.tile(way, (len(line), 1)) for line, way, *_ in self.pending])
        for _ in range(60):
            # Shortened steps: blends and bumps make the field steeper than a distance.
            p += 0.6 * np.clip(self(p), -1, 3)[:, None] * toward
        for line, _, brush, how in self.pending:
            self.stroke(p[: len(line)], *brush, **how)
            p = p[len(line) :]
        self.pending.clear()

    def __call__(self, p):
        folded = p.copy()
        folded[:, 0] = smooth_abs(p[:, 0], self.mirror_rounding)
        d = np.full(len(p), 1e3, p.dtype)
        for op in self.ops:
            apply(op, d, folded if op.mirrored else p)
        return d


def apply(op, d, p):
    """One operation in place, evaluated only where its bounding sphere says that it can matter."""
    if op.kind == "displace":
        near = np.abs(d) < 1.5
        d[near] -= op.shape(p[near])
        return
    away = np.linalg.norm(p - op.shape.center.astype(p.dtype), axis=1) - op.shape.reach
    if op.kind == "add":
        near = away < d + op.k
        d[near] = smooth_min(d[near], op.shape(p[near]), op.k)
    elif op.kind == "carve":
        near = away < op.k - d
        d[near] = smooth_max(d[near], -op.shape(p[near]), op.k)
    else:
        near = away < 0
        d[near] -= op.shape(p[near])
