"""The orc: a head bust in centimetres, Y up, facing +Z, the eye line at y = 0.

Mirrored parts are written for the +X half. Big forms come first, then folds, then creases; a stroke lies on
the surface that the operations before it have made, so the order is the sculptor's.
"""

import numpy as np
from orc_sdf import (
    Ellipsoid,
    Sculpture,
    Spline,
    Tube,
    bell,
    noise,
    ramp,
    rotation,
    smooth_max,
    unit,
    vec,
)

EYE_CENTER = vec(3.25, -0.15, 6.1)
EYE_RADIUS = 1.3
CORNEA_OFFSET, CORNEA_RADIUS = 0.62, 0.82
TUSK = [(2.25, -8.2, 7.6), (2.5, -6.9, 8.9), (2.95, -5.3, 9.5), (3.25, -3.7, 9.3), (3.3, -2.7, 8.9)]
TUSK_RADII = [0.55, 0.62, 0.5, 0.27, 0.05]


class Ear:
    """A leaf-shaped blade about a bent mid-surface: u runs root to tip, v up across it, w to its front."""

    length = 13.2

    def __init__(self, side, root, tip, torn=()):
        self.side, self.root, self.torn = side, vec(*root), torn
        u = unit(vec(*tip) - self.root)
        w = unit(vec(0.35, -0.1, 1) - u * (vec(0.35, -0.1, 1) @ u))
        self.frame = np.stack([u, np.cross(w, u), w], 1)
        self.center, self.reach = self.world(vec(5.8, 0.5, 0)), 9.2
        knots = [-1.5, 0, 1.5, 3.5, 6, 8.5, 11, 13.2]
        self.top = Spline(knots, [2.0, 2.5, 3.0, 3.15, 2.9, 2.5, 2.15, 2.05])
        self.bottom = Spline(knots, [-2.3, -3.1, -3.15, -2.5, -1.45, -0.45, 0.75, 2.0])

    def world(self, q):
        p = self.root + self.frame @ q
        return p * vec(self.side, 1, 1)

    def __call__(self, p):
        q = (p * np.array([self.side, 1, 1], p.dtype) - self.root.astype(p.dtype)) @ self.frame.astype(
            p.dtype
        )
        u, v, w = q.T
        e = 0.02
        m = self.middle(u, v)
        slope = np.sqrt(1 + ((self.middle(u + e, v) - m) / e) ** 2 + ((self.middle(u, v + e) - m) / e) ** 2)
        rim = 0.15
        outline = self.outline(u, v)
        across = (np.abs(w - m) - self.half_thickness(u, v, -outline)) / slope
        a, b = outline + rim, across + rim
        return np.hypot(np.maximum(a, 0), np.maximum(b, 0)) + np.minimum(np.maximum(a, b), 0) - rim

    def outline(self, u, v):
        top, bottom = self.top(u), self.bottom(u)
        above = (v - top) / np.hypot(1, (self.top(u + 0.05) - top) / 0.05)
        below = (bottom - v) / np.hypot(1, (self.bottom(u + 0.05) - bottom) / 0.05)
        d = smooth_max(smooth_max(above, below, 0.35), u - self.length, 0.3)
        for at, depth, width in self.torn:
            # A tear: a wedge from the lower edge inwards.
            wedge = np.abs(u - at - 0.25 * (v - bottom)) - width * (1 - (v - bottom) / depth)
            d = smooth_max(d, -np.maximum(wedge, v - bottom - depth) / 1.3, 0.25)
        return d

    def across_unit(self, u, v):
        """v scaled to -1..1 between the edges."""
        top, bottom = self.top(u), self.bottom(u)
        return (2 * v - top - bottom) / np.maximum(top - bottom, 0.5)

    def middle(self, u, v):
        """Height w of the mid-surface: cupped, swept back, with the fold of the antihelix and the concha."""
        s = np.clip(self.across_unit(u, v), -1.4, 1.4)
        cup = (1.25 * ramp(u, 13, 1) + 0.2) * s * s
        sweep = -0.011 * np.maximum(u, 0) ** 2
        fold = 0.7 * bell((s - 0.22 - 0.03 * u) / 0.2) * ramp(u, 0.2, 1.8) * ramp(u, 8.5, 4.0)
        branch = 0.4 * bell((s + 0.22 + 0.07 * u) / 0.2) * ramp(u, 2.4, 3.6) * ramp(u, 7.5, 4.5)
        bowl = -1.1 * bell((u - 1.5) / 1.4) * bell((v + 0.8) / 1.2)
        wave = 0.1 * np.sin(1.15 * u + 0.8 * v) * ramp(u, 3, 7) * s
        return cup + sweep + fold + branch + bowl + wave

    def half_thickness(self, u, v, inward):
        """Half the thickness: a membrane of 4 to 5 mm, thinner to the tip, a rolled helix, cartilage ribs."""
        s = self.across_unit(u, v)
        membrane = 0.235 - 0.075 * ramp(u, 3, 13) + 0.3 * ramp(u, 1.5, -1.5)
        helix = 0.19 * bell((inward - 0.28) / 0.26) * ramp(s, -0.2, 0.4) * ramp(u, 12, 5)
        lobe = 0.16 * bell((inward - 0.4) / 0.6) * ramp(s, -0.2, -0.8) * ramp(u, 4.5, 1.5)
        ribs = (
            0.03
            * np.cos(9.5 * s + 0.4 * np.sin(u))
            * ramp(u, 3, 5.5)
            * ramp(u, 12.5, 8)
            * ramp(inward, 0.1, 0.6)
        )
        return membrane + helix + lobe + ribs


def ears():
    """The +X ear, and the -X one with the tears of an old fight: (u, depth, half width) each."""
    root, tip = (7.1, -0.9, -1.5), (16.6, 7.6, -5.4)
    return Ear(1, root, tip), Ear(-1, root, tip, ((6.4, 1.1, 0.4), (9.0, 0.5, 0.3)))


class Lids:
    """The opening between the lids: an almond (two arcs), tilted, cut straight back to the eyeball."""

    def __init__(self):
        self.center, self.reach = EYE_CENTER + vec(0.2, 0, 1.2), 2.3
        self.frame = rotation(x=4, y=14, z=16)

    def __call__(self, p):
        x, y, z = ((p - EYE_CENTER.astype(p.dtype)) @ self.frame.astype(p.dtype)).T
        # Arcs through the corners (+-1.15, 0): the upper lid hangs low, the lower one bows a little.
        upper = np.hypot(x - 0.1, y + 1.6) - 2.05
        lower = np.hypot(x + 0.1, y - 1.35) - 1.88
        almond = smooth_max(upper, lower, 0.12)
        return smooth_max(almond, 0.3 - z, 0.2)


class Eyeball:
    """The ball as the lids feel it; the cornea lies in their opening."""

    def __init__(self, grow):
        self.center, self.reach, self.grow = EYE_CENTER, EYE_RADIUS + 0.3, grow

    def __call__(self, p):
        q = p - EYE_CENTER.astype(p.dtype)
        ball = np.sqrt(np.einsum("ij,ij->i", q, q)) - EYE_RADIUS
        return ball - self.grow


def skull(s):
    s.add(Ellipsoid((0, 3.0, -2.2), (7.2, 6.3, 8.6), x=-8), 1.0)
    s.add(Ellipsoid((0, 3.2, 3.0), (5.7, 4.3, 4.7), x=-24), 2.0)
    s.add(Ellipsoid((0, -3.2, 2.4), (5.9, 6.6, 5.7)), 2.0)
    s.add(Ellipsoid((0, -8.5, 2.5), (4.8, 3.4, 5.0)), 2.0)
    s.carve(Ellipsoid((8.6, 2.6, 3.6), (1.7, 2.6, 2.8)), 1.4)


def neck(s):
    s.add(Tube([(0, -4, -3.2), (0, -12, -3.6), (0, -21, -5.0)], [5.4, 5.9, 7.4]), 2.2)
    s.add(Tube([(2, -11, -7), (8, -19.5, -6.2), (16, -23.5, -4.5)], [4.0, 4.6, 4.8]), 2.5)
    s.add(Ellipsoid((0, -27, -2), (17, 7.5, 9.5)), 3.0)
    s.add(Ellipsoid((16.5, -25, -3.5), (5.2, 6, 5.6)), 2.5)
    s.add(Tube([(6.3, -4.5, -3.4), (5.5, -12, -0.2), (1.6, -19.8, 5.0)], [1.5, 1.7, 1.0]), 1.6)
    s.add(Tube([(1.8, -20.6, 4.6), (7, -21.0, 3.2), (13, -20.4, -1.0)], [1.0, 0.9, 1.0]), 2.2)
    s.add(Ellipsoid((0, -14.2, 2.2), (1.5, 1.9, 1.5)), 1.6)


def jaw(s):
    s.add(
        Tube(
            [(6.3, -3.5, -1.2), (6.8, -8.0, 0.4), (5.3, -10.9, 4.4), (2.3, -12.2, 7.4)], [1.5, 1.8, 1.8, 1.9]
        ),
        1.6,
    )
    s.add(Ellipsoid((0, -11.7, 8.0), (3.1, 1.9, 2.0), x=-10), 1.4)
    s.add(Ellipsoid((1.35, -12.0, 9.2), (1.3, 1.1, 1.0)), 0.9)
    s.add(Ellipsoid((6.0, -6.4, 1.8), (1.5, 3.7, 2.4), x=18), 1.4)


def muzzle(s):
    s.add(Ellipsoid((0, -6.9, 5.8), (4.4, 3.2, 3.3)), 1.6)
    s.add(Ellipsoid((0, -9.0, 6.6), (3.9, 2.2, 3.0)), 1.2)
    s.add(Ellipsoid((2.6, -8.4, 7.4), (1.4, 1.5, 1.5)), 1.0)


def cheeks(s):
    s.add(Ellipsoid((4.9, -2.4, 5.1), (2.1, 1.25, 1.9), z=14, y=35), 1.2)
    s.add(Tube([(4.8, -2.3, 5.4), (6.3, -1.7, 3.0), (6.3, -1.0, -0.6)], [1.1, 0.95, 0.9]), 1.5)
    s.carve(Ellipsoid((6.6, -5.2, 5.9), (1.3, 2.4, 1.8), z=-15), 1.6)


def brow(s):
    s.add(
        Tube([(0, 1.45, 7.5), (2.1, 1.7, 8.1), (4.2, 2.35, 7.2), (5.9, 1.2, 5.0)], [1.0, 1.2, 1.15, 0.75]),
        1.7,
    )
    s.add(Ellipsoid((4.2, 2.5, 7.1), (1.4, 0.8, 1.1), y=30, z=12), 1.0)
    s.carve(Ellipsoid((3.35, -0.3, 8.0), (1.75, 1.15, 1.25), z=8, y=18), 1.0)


def nose(s):
    s.add(Tube([(0, 1.3, 7.6), (0, -0.8, 8.6), (0, -2.6, 9.4)], [0.8, 0.85, 1.15]), 1.0)
    s.add(Ellipsoid((0, -3.3, 9.5), (1.5, 1.05, 1.15), x=-15), 0.7)
    s.add(Ellipsoid((1.9, -3.6, 8.6), (1.1, 1.0, 1.3), y=-22, z=-18), 0.5)
    s.add(Ellipsoid((0, -4.35, 8.9), (0.55, 0.5, 1.0)), 0.4)
    s.carve(Tube([(1.15, -4.8, 9.7), (1.1, -4.0, 9.1), (0.9, -3.1, 8.0)], [0.48, 0.54, 0.3]), 0.3)


def mouth(s):
    s.add(
        Tube(
            [(0, -6.35, 8.9), (1.6, -6.2, 8.6), (3.0, -6.75, 7.6), (3.9, -7.4, 6.5)], [0.6, 0.62, 0.5, 0.35]
        ),
        0.6,
    )
    s.add(
        Tube(
            [(0, -7.9, 9.6), (1.6, -7.75, 9.3), (3.0, -8.0, 8.1), (4.0, -8.0, 6.7)], [0.8, 0.76, 0.62, 0.35]
        ),
        0.6,
    )
    # The gum swells round the tusk and the upper lip gives way to it.
    s.add(Ellipsoid((2.4, -7.75, 8.5), (0.95, 0.75, 0.8)), 0.5)
    s.carve(Tube(TUSK, [r + 0.1 for r in TUSK_RADII[:3]] + [0.3, 0.1]), 0.3)


def eyes(s):
    s.add(Ellipsoid(EYE_CENTER, [EYE_RADIUS + 0.3] * 3), 0.45)
    lids = Lids()
    s.carve(lids, 0.16)
    # The caruncle, which fills the inner corner.
    s.add(Ellipsoid(EYE_CENTER + lids.frame @ vec(-1.1, 0.0, 0.62), (0.26, 0.2, 0.22)), 0.12)
    s.carve(Eyeball(-0.02), 0.05)


def mouth_line(s):
    """The parting of the lips: deep, then a sharp edge; it starts beyond the middle so that it has no end there."""
    line = [(-1.6, -7.0), (0, -7.03), (1.5, -6.92), (2.7, -7.25), (3.7, -7.65), (4.4, -8.2)]
    s.front(line, -0.5, 0.3, count=24, fade=0.7)
    s.settle()
    s.front(line, -0.45, 0.15, count=24, fade=0.7)


def folds(s):
    """Soft forms a thumb would push: brow muscles, cheeks, bags, the nasolabial fold, tendons."""
    s.front([(0.75, 0.6), (0.8, 2.0), (1.5, 3.1)], 0.28, 0.5)
    s.front([(0, 0.9), (0, 2.4)], -0.3, 0.4)
    s.front([(1.4, 3.5), (3.4, 4.0), (5.2, 3.0)], -0.22, 0.8)
    s.front([(1.7, -1.5), (2.4, -4.2), (4.3, -7.4), (4.5, -9.0)], -0.32, 0.42)
    s.front([(2.6, -2.6), (3.6, -4.0), (5.1, -6.6)], 0.35, 0.8)
    s.front([(1.9, -1.35), (3.2, -2.0), (4.7, -1.4)], 0.2, 0.4)
    s.front([(0.0, -9.45), (1.7, -9.3), (3.2, -9.0)], -0.35, 0.55)
    s.front([(0, -10.9), (0, -13.0)], -0.22, 0.35)
    s.front([(0, -4.9), (0, -6.0)], -0.14, 0.3, fade=1)
    s.front([(0.45, -4.9), (0.5, -6.0)], 0.1, 0.25)
    s.side([(1.5, 1.0), (-1.5, 4.0), (-5.5, 4.8)], 0.22, 0.7)


def creases(s):
    """Sharp lines: forehead and frown wrinkles, crow's feet, lip lines, the wing of the nose, a scar."""
    for y, bend, deep in ((3.55, 0.5, 0.2), (4.75, 0.55, 0.2), (5.95, 0.45, 0.15), (7.1, 0.3, 0.1)):
        s.front([(-0.2, y - 0.25), (1.6, y + bend * 0.6), (3.4, y + bend * 0.4), (4.6, y - 0.5)], -deep, 0.2)
        s.front(
            [(0.2, y + 0.35), (1.7, y + bend * 0.6 + 0.55), (3.6, y + bend * 0.4 + 0.5)], deep * 0.7, 0.38
        )
    s.front([(0.42, 0.9), (0.5, 2.0), (0.9, 3.1)], -0.2, 0.17)
    s.front([(1.25, 1.0), (1.35, 1.9), (1.9, 2.8)], -0.13, 0.16)
    for y in (0.0, -0.65, -1.4):
        s.front([(0.0, y + 0.05), (0.7, y), (1.25, y - 0.4)], -0.1, 0.15)
    for k, (dx, dy) in enumerate(((1.6, 0.9), (1.8, 0.1), (1.6, -0.8), (1.3, -1.5))):
        s.front(
            [(4.75, -0.05 - 0.15 * k), (4.75 + 0.5 * dx, -0.1 + 0.45 * dy), (4.75 + 0.8 * dx, dy)], -0.1, 0.15
        )
    s.front([(1.9, -0.9), (3.1, -1.55), (4.6, -0.9)], -0.12, 0.16)
    s.front([(2.0, -1.9), (3.2, -2.65), (4.6, -2.3)], -0.1, 0.18)
    s.front([(1.5, -2.3), (2.5, -2.5), (3.15, -3.3), (3.1, -4.4)], -0.18, 0.24)
    s.front([(4.0, -7.3), (4.6, -8.2), (4.5, -9.4)], -0.15, 0.2)
    for x in (0.45, 1.1, 1.75):
        s.front([(x, -7.3), (x * 1.05, -8.4)], -0.05, 0.12)
        s.front([(x * 0.9 + 0.2, -5.8), (x * 0.9 + 0.2, -6.7)], -0.04, 0.12)


def character(s):
    """What makes him one: a scar across the left brow and cheek, a bump on the nose, warts."""
    scar = [(-2.4, 4.6), (-3.0, 2.4), (-3.4, 1.3)], [(-4.0, -2.0), (-4.5, -3.6), (-4.5, -5.0)]
    for line in scar:
        s.front(line, -0.2, 0.17, mirrored=False)
        s.front([(x + 0.3, y) for x, y in line], 0.1, 0.2, mirrored=False)
    s.front([(0.25, -1.3), (0.3, -1.9)], 0.14, 0.5, mirrored=False)
    for x, y, size in (
        (-2.9, -4.9, 0.2),
        (4.2, 5.2, 0.22),
        (5.4, -3.6, 0.16),
        (-1.3, -10.7, 0.2),
        (3.3, -10.6, 0.17),
    ):
        s.front([(x, y), (x + 0.02, y + 0.02)], size * 0.9, size, mirrored=False, count=3, fade=0.01)


def skin_relief(p):
    """Low bumps of the flesh and the leather of the skin, fading on lids, lips and ears."""
    head = ramp(np.abs(p[:, 0]), 8.2, 6.8)
    eye = np.linalg.norm(
        np.abs(p * np.array([1, 1, 1], p.dtype)) - np.abs(EYE_CENTER).astype(p.dtype), axis=1
    )
    calm = ramp(eye, 1.3, 2.6)
    soft = 0.07 * noise(p, 1.9, 3) + 0.035 * noise(p, 0.8, 5)
    leather = 0.02 * noise(p, 0.42, 9)
    return (soft + leather) * calm * (0.25 + 0.75 * head)


def sag(p):
    """The slight asymmetry of a living face: a smooth displacement of space, at most a few millimetres."""
    x, y, z = p.T
    face = ramp(z, 1, 7)
    dx = 0.16 * np.sin(0.33 * y + 0.6) * face
    dy = 0.012 * x * face + 0.1 * ramp(x, 1, 5) * ramp(y, -4, -7) * ramp(y, -12, -9) * face
    return p + np.stack([dx, dy, np.zeros_like(x)], 1).astype(p.dtype)


def sculpt():
    """The skin's field: points (n, 3) to signed distances (n,)."""
    s = Sculpture()
    for step in (skull, neck, jaw, muzzle, cheeks, brow, nose, mouth, eyes):
        step(s)
    for ear in ears():
        s.add(ear, 0.9, mirrored=False)
    s.add(Ellipsoid((7.4, -1.8, -0.3), (0.55, 0.8, 0.6), y=-30), 0.9)
    s.carve(Tube([(8.7, -1.3, -1.1), (7.6, -1.4, -1.5), (6.2, -1.3, -1.7)], [0.55, 0.45, 0.3]), 0.5)
    for step in (mouth_line, folds, creases, character):
        step(s)
        s.settle()
    s.displace(skin_relief)
    return lambda p: np.maximum(s(p), -24.0 - p[:, 1])
