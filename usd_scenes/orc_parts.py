"""The parts beside skin and eyes: tusks and an earring; closed meshes, and how they are made."""

import numpy as np
from orc_sdf import smooth_line, unit, vec
from orc_shape import TUSK, TUSK_RADII, ears


def skin_rings(rings, first, last):
    """Closed mesh of rings (n, m, 3) between two poles: points and outward triangles (rings turn about the
    direction first -> last by the right hand)."""
    n, m, _ = rings.shape
    points = np.concatenate([[first], rings.reshape(-1, 3), [last]])
    j = np.arange(m)
    k = (j + 1) % m
    triangles = [np.stack([np.zeros(m, int), 1 + k, 1 + j], 1)]
    for i in range(n - 1):
        a, b = 1 + i * m + j, 1 + i * m + k
        triangles += [np.stack([a, b, b + m], 1), np.stack([a, b + m, a + m], 1)]
    base = 1 + (n - 1) * m
    triangles.append(np.stack([np.full(m, len(points) - 1), base + j, base + k], 1))
    return points, np.concatenate(triangles)


def smooth_normals(points, triangles):
    """Unit vertex normals, the faces around weighted by area."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    cross, total = np.cross(b - a, c - a), np.zeros_like(points)
    for i in range(3):
        np.add.at(total, triangles[:, i], cross)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def frames_along(line):
    """Two unit vectors across a curve at each of its points, without twist."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across, a = [], unit(np.cross(tangent[0], vec(0.3, 0, 1)))
    for t in tangent:
        a = unit(a - t * (a @ t))
        across.append(a)
    a = np.array(across)
    return a, np.cross(tangent, a)


def tusk(side, shorter=0.0, rings=90, segments=56):
    """A tusk along its spline, grooved lengthwise, its root buried in the gum; the tip may be worn shorter."""
    line = smooth_line(TUSK, rings + 2)
    s = np.linspace(0, 1, rings + 2)
    end = round((rings + 1) * (1 - shorter))
    line, s = smooth_line(line[: end + 1], rings + 2), np.linspace(0, s[end], rings + 2)
    radii = smooth_line(np.stack([np.linspace(0, 1, len(TUSK)), TUSK_RADII], 1), 200)
    # An elliptic end, so that tip and root are round and not cones.
    to_end = np.minimum(np.arange(rings + 2), np.arange(rings + 2)[::-1]) / 7
    radius = np.interp(s, radii[:, 0], radii[:, 1]) * np.sqrt(1 - np.clip(1 - to_end, 0, 1) ** 2)
    a, b = frames_along(line)
    phi = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    groove = 1 + 0.02 * np.cos(9 * phi + 1) + 0.015 * np.cos(17 * phi)
    ring = np.cos(phi)[:, None] * a[1:-1, None] + np.sin(phi)[:, None] * b[1:-1, None]
    rings3 = line[1:-1, None] + radius[1:-1, None, None] * groove[:, None] * ring
    points, triangles = skin_rings(rings3, line[0], line[-1])
    return mirrored(points, triangles, side)


def mirrored(points, triangles, side):
    if side < 0:
        points, triangles = points * vec(-1, 1, 1), triangles[:, ::-1]
    return points, triangles, smooth_normals(points, triangles)


def earring(u=2.3, ring=0.85, wire=0.1, segments=96, around=24):
    """A torus through the lower edge of the +X ear, hanging in the plane across that edge."""
    ear = ears()[0]
    low = float(ear.bottom(np.array([u]))[0])
    middle = float(ear.middle(np.array([u]), np.array([low + 0.4]))[0])
    center = ear.root + ear.frame @ vec(u, low + 0.45, middle) - vec(0, ring, 0)
    out, up = unit(ear.frame[:, 2] * vec(1, 0, 1)), vec(0, 1, 0)
    turn, phi = (np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (segments, around))
    spoke = np.cos(turn)[:, None] * out + np.sin(turn)[:, None] * up
    axis = np.cross(out, up)
    cross = np.cos(phi)[:, None] * spoke[:, None] + np.sin(phi)[:, None] * axis
    points = (center + ring * spoke[:, None] + wire * cross).reshape(-1, 3)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(segments), np.arange(around), indexing="ij"))
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = (i + 1) % segments * around + (j + 1) % around, (i + 1) % segments * around + j
    triangles = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
    return points, triangles, smooth_normals(points, triangles)
