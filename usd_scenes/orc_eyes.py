"""The orc's eyes: a ball whose iris is set back, a clear cornea over all of it, and a line of tears on the lower lid.

Profiles are in the eye's own frame, centimetres: its middle at the origin, its gaze along +Z.
"""

from itertools import pairwise

import numpy as np
from orc_parts import frames_along, skin_rings, smooth_normals
from orc_sdf import noise, ramp, rotation, smooth_line, smooth_max, vec
from orc_shape import CORNEA_OFFSET, CORNEA_RADIUS, EYE_CENTER, EYE_RADIUS, Lids

PUPIL_RADIUS, IRIS_RADIUS, LIMBUS_RADIUS = 0.2, 0.6, 0.67
TEARS = 0.012
"""Between the ball and the film of tears that goes on from the cornea."""
SPAN = 1.33
"""Half the side of the square, seen along the gaze, that the eye's map covers."""


def rounded(corners, rounds=2):
    """A polyline with its corners cut (Chaikin 1974); the ends stay."""
    line = np.array(corners, float)
    for _ in range(rounds):
        cut = np.stack([0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]], 1)
        line = np.concatenate([line[:1], cut.reshape(-1, 2), line[-1:]])
    return line


def dense(line, step):
    """The polyline with points at most `step` apart."""
    parts = [
        np.linspace(a, b, max(1, int(np.ceil(np.linalg.norm(b - a) / step))), endpoint=False)
        for a, b in pairwise(line)
    ]
    return np.concatenate([*parts, line[-1:]])


def ball_profile():
    """(radius, height) from the middle of the pupil to the back: a dark well, the iris, the wall of the limbus, the
    white."""
    edge = np.sqrt(EYE_RADIUS**2 - LIMBUS_RADIUS**2)
    front = [
        (0, 0.88),
        (PUPIL_RADIUS - 0.01, 0.88),
        (PUPIL_RADIUS - 0.01, 1.06),
        (PUPIL_RADIUS + 0.03, 1.075),
        (IRIS_RADIUS, 1.02),
        (LIMBUS_RADIUS, edge),
    ]
    angles = np.linspace(np.arcsin(LIMBUS_RADIUS / EYE_RADIUS), np.pi, 60)[1:]
    white = EYE_RADIUS * np.stack([np.sin(angles), np.cos(angles)], 1)
    # The first points of the white belong to what is rounded, or the limbus would have a kink.
    return np.concatenate([dense(rounded([*front, *white[:3]]), 0.03), white[3:]])


def cornea_profile():
    """(radius, height): a dome over the iris that runs out into a film on the white."""
    angles = np.concatenate([np.linspace(0, 0.7, 50), np.linspace(0.7, np.pi, 50)[1:]])
    bulge = CORNEA_OFFSET * np.cos(angles)
    bulge += np.sqrt(CORNEA_RADIUS**2 - (CORNEA_OFFSET * np.sin(angles)) ** 2)
    radius = smooth_max(bulge, np.full_like(angles, EYE_RADIUS), 0.05) + TEARS
    return radius[:, None] * np.stack([np.sin(angles), np.cos(angles)], 1)


def turned(profile, segments):
    """Points and triangles of a profile turned about the gaze."""
    phi = -np.linspace(0, 2 * np.pi, segments, endpoint=False)
    radius, height = (np.broadcast_to(c[1:-1, None], (len(profile) - 2, segments)) for c in profile.T)
    rings = np.stack([radius * np.cos(phi), radius * np.sin(phi), height], -1)
    return skin_rings(rings, vec(0, 0, profile[0, 1]), vec(0, 0, profile[-1, 1]))


def fibres(p):
    """Height of the iris's fibres, about -1 to 1, of points seen along the gaze (n, 2)."""
    radius, around = np.hypot(*p.T), np.arctan2(p[:, 1], p[:, 0])
    at = np.stack([np.cos(around), np.sin(around), 0.35 * radius], 1)
    return noise(at * vec(9, 9, 9), 1.0, 4) + 0.5 * noise(at * vec(22, 22, 9), 1.0, 7)


def placed(points, side, gaze):
    yaw, pitch = gaze
    return points @ rotation(x=pitch, y=yaw).T + EYE_CENTER * vec(side, 1, 1)


def eyeball(side, gaze, segments=160):
    """Points, triangles, normals and texture coordinates (n, 2); `gaze`: yaw and pitch in degrees."""
    points, triangles = turned(ball_profile(), segments)
    radius = np.hypot(points[:, 0], points[:, 1])
    iris = ramp(radius, PUPIL_RADIUS, 0.26) * ramp(radius, IRIS_RADIUS, 0.5) * (points[:, 2] > 0.9)
    points[:, 2] += 0.012 * iris * fibres(points[:, :2])
    st = 0.5 + 0.5 * points[:, :2] / SPAN
    points = placed(points, side, gaze)
    return points, triangles, smooth_normals(points, triangles), st


def cornea(side, gaze, segments=120):
    points, triangles = turned(cornea_profile(), segments)
    points = placed(points, side, gaze)
    return points, triangles, smooth_normals(points, triangles)


def tear_line(field, side, count=60, around=20, width=0.035):
    """The meniscus where the lower lid meets the eye: a thread along the line on the ball at which `field`, the skin's,
    begins."""
    frame = Lids().frame
    x = np.linspace(-0.92, 0.92, count)[:, None]
    # Down over the ball, from its middle to where the lid certainly is.
    y = np.linspace(0.1, -0.95, 400)
    z = np.sqrt(np.maximum((EYE_RADIUS + TEARS) ** 2 - x**2 - y**2, 0))
    local = np.stack(np.broadcast_arrays(x, y, z), -1)
    p = (local @ frame.T + EYE_CENTER) * vec(side, 1, 1)
    within = field(p.reshape(-1, 3).astype(np.float32)).reshape(count, -1) < 0
    line = smooth_line(p[np.arange(count), within.argmax(1)][within.any(1)][::4], count)
    # Thin at both corners.
    s = np.linspace(0, 1, count)[1:-1]
    radius = width * np.minimum(1, 4 * np.minimum(s, 1 - s)) ** 0.5
    a, b = frames_along(line)
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.cos(phi)[:, None] * a[1:-1, None] + np.sin(phi)[:, None] * b[1:-1, None]
    points, triangles = skin_rings(line[1:-1, None] + radius[:, None, None] * ring, line[0], line[-1])
    return points, triangles, smooth_normals(points, triangles)


IRIS_DARK = np.array([0.20, 0.055, 0.010])
IRIS_BRIGHT = np.array([0.92, 0.50, 0.08])
COLLARETTE = np.array([0.95, 0.70, 0.18])
LIMBUS = np.array([0.05, 0.025, 0.012])
WHITE = np.array([0.66, 0.56, 0.42])
BLOOD = np.array([0.55, 0.16, 0.09])


def mixed(color, other, share):
    return color + (other - color) * np.clip(share, 0, 1)[:, None]


def eye_color(p):
    """Colour of points seen along the gaze, (n, 2) in centimetres."""
    radius, fibre = np.hypot(*p.T), fibres(p)
    color = mixed(np.broadcast_to(IRIS_DARK, (len(p), 3)), IRIS_BRIGHT, 0.55 + 0.75 * fibre)
    wreath = 0.34 + 0.035 * fibre
    color = mixed(color, COLLARETTE, 0.75 * ramp(radius, wreath, wreath - 0.08) * (0.8 + 0.4 * fibre))
    color = mixed(color, IRIS_DARK, 0.8 * ramp(np.abs(radius - wreath), 0.03, 0.0))
    color = mixed(color, LIMBUS, ramp(radius, 0.47 + 0.03 * fibre, 0.6))
    color = mixed(color, white_color(p, radius), ramp(radius, 0.615, 0.72))
    return mixed(color, np.zeros(3), ramp(radius, PUPIL_RADIUS + 0.03, PUPIL_RADIUS - 0.01))


def white_color(p, radius):
    """The white, yellow and bloodshot towards the corners."""
    flat = np.insert(p, 2, 0.0, axis=1)
    bent = flat + 0.12 * np.stack([noise(flat, 0.3, 51), noise(flat, 0.3, 52), 0 * radius], 1)
    color = mixed(np.broadcast_to(WHITE, (len(p), 3)), BLOOD, 0.25 * ramp(radius, 0.75, 1.25))
    for scale, seed, strong in ((0.34, 53, 0.5), (0.19, 54, 0.3)):
        vein = ramp(np.abs(noise(bent * vec(0.6, 1.5, 1), scale, seed)), 0.07, 0.0)
        color = mixed(color, BLOOD, strong * vein * ramp(radius, 0.7, 1.0))
    return color


def eye_map(size=512):
    """(size, size, 3) in 0 to 1, rows from the top."""
    at = SPAN * (2 * (np.arange(size) + 0.5) / size - 1)
    x, y = np.meshgrid(at, -at)
    return np.clip(eye_color(np.stack([x.ravel(), y.ravel()], 1)), 0, 1).reshape(size, size, 3)
