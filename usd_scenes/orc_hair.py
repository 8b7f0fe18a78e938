"""The orc's lashes and brows: hairs that grow out of the skin, as curves of four control points each."""

import numpy as np
from orc_sdf import smooth_line, unit, vec
from orc_shape import EYE_CENTER, EYE_RADIUS, Lids

LASH_WIDTH, BROW_WIDTH = 0.032, 0.04
"""At the root, cm."""


class Skin:
    """The nearest vertex of the skin, and its normal."""

    def __init__(self, points, normals):
        near = (points[:, 2] > 2) & (np.abs(points[:, 1]) < 6)
        self.points, self.normals = points[near], normals[near]

    def at(self, p):
        i = np.linalg.norm(self.points - p, axis=1).argmin()
        return self.points[i], self.normals[i]


def lid_edge(share, upper, side):
    """A point on a lid's edge, `share` of the way from the inner to the outer corner, and the ways forward and up."""
    frame = Lids().frame
    x = -1.05 + 2.1 * share
    y = -1.6 + np.sqrt(2.05**2 - (x - 0.1) ** 2) if upper else 1.35 - np.sqrt(1.88**2 - (x + 0.1) ** 2)
    z = np.sqrt((EYE_RADIUS + 0.28) ** 2 - x * x - y * y)
    turn = vec(side, 1, 1)
    return (
        (EYE_CENTER + frame @ vec(x, y, z)) * turn,
        frame[:, 2] * turn,
        frame[:, 1] * turn,
        frame[:, 0] * turn,
    )


def hair(root, normal, first, then, length):
    """Leaves the skin along `first`, ends along `then`; its root is below the skin."""
    base = root - 0.06 * normal
    bend = [base, base + 0.35 * length * first, base + 0.7 * length * unit(first + then)]
    return np.array([*bend, bend[2] + 0.4 * length * then])


def lashes(skin, rng):
    hairs = []
    for side in (1, -1):
        for upper, number, length in ((True, 46, 0.62), (False, 26, 0.34)):
            for k in range(number):
                share = (k + rng.uniform(-0.3, 0.3)) / (number - 1)
                share = np.clip(share, 0.06, 0.98)
                edge, forward, up, out = lid_edge(share, upper, side)
                root, normal = skin.at(edge)
                up = up if upper else -up
                # Fanned out to both corners, and clumped a little.
                aside = out * (1.5 * (share - 0.42) + rng.normal(0, 0.14))
                first = unit(forward + 0.15 * up + 0.3 * aside)
                then = unit(0.35 * forward + (1.0 if upper else 0.7) * up + 0.8 * aside)
                hairs.append(hair(root, normal, first, then, length * rng.uniform(0.75, 1.1)))
    return hairs


def brows(skin, rng):
    hairs = []
    for side in (1, -1):
        line = smooth_line([(1.35, 1.55, 8.4), (2.6, 2.15, 8.6), (4.1, 2.75, 7.6), (5.5, 2.1, 5.9)], 120)
        for _ in range(170):
            share = rng.beta(1.2, 1.4)
            at = line[int(share * 119)] + rng.normal(0, 0.16, 3) * vec(0.6, 1.2, 0.6)
            root, normal = skin.at(at * vec(side, 1, 1))
            # Up at the nose, outwards and down at the temples.
            flow = unit(vec((0.35 + share) * side, 0.8 - 1.1 * share, 0.1) + rng.normal(0, 0.18, 3))
            first = unit(0.8 * normal + flow)
            then = unit(flow + 0.15 * normal)
            hairs.append(hair(root, normal, first, then, rng.uniform(0.5, 0.95) * (1.1 - 0.55 * share)))
    return hairs


def tufts(points, normals):
    """{name: (points (n, 4, 3), width at the root)}"""
    skin, rng = Skin(points, normals), np.random.default_rng(3)
    return {
        "Lashes": (np.array(lashes(skin, rng)), LASH_WIDTH),
        "Brows": (np.array(brows(skin, rng)), BROW_WIDTH),
    }
