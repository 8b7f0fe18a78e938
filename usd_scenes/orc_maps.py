"""The orc's texture coordinates and the maps of his skin: colour, pores, wetness. All are functions of the place in
space, looked up where each texel lies on the skin, so that they have no seams and are nowhere stretched.
"""

import numpy as np
from orc_sdf import noise, ramp
from orc_shape import EYE_CENTER

SIZE = 1024
MIDDLE = np.array([0.0, -3.0, 0.0])
"""What the skin is projected about; its seam is at the back."""

BASE = np.array([0.66, 0.63, 0.34])
PATCH = np.array([0.47, 0.50, 0.25])
FLUSH = np.array([0.80, 0.47, 0.33])
LIP = np.array([0.56, 0.36, 0.31])
SPOT = np.array([0.33, 0.29, 0.17])
PALE = np.array([0.80, 0.72, 0.50])


def coordinates(points, triangles):
    """`st` (m, 2) and indices of every corner: around and up, the face wider than the back. Corners beyond the seam
    have an s above 1."""
    x, y, z = (points - MIDDLE).T
    around = np.arctan2(x, z) / np.pi
    a = np.abs(around)
    s = 0.5 + 0.5 * np.sign(around) * (0.7 * (1 - (1 - a) ** 2) + 0.3 * a)
    t = 0.5 + np.arctan2(y, np.hypot(x, z)) / np.pi
    st = np.stack([s, t], 1)
    corners = s[triangles]
    beyond = (np.ptp(corners, axis=1) > 0.5)[:, None] & (corners < 0.5)
    moved, place = np.unique(triangles[beyond], return_inverse=True)
    indices = triangles.copy()
    indices[beyond] = len(points) + place
    return np.concatenate([st, st[moved] + (1, 0)]), indices


def baked(points, normals, triangles, st, indices):
    """Of each texel: the place on the skin, the unit normal, and the unit directions in which s and t grow, all
    (SIZE, SIZE, 3), rows from the bottom. Where the skin lies over itself, its outermost sheet."""
    corners = st[indices]
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    rng = np.random.default_rng(1)
    # Four hits of every texel on average.
    number = np.clip(np.ceil(2 * np.abs(area) * SIZE**2), 2, 4000).astype(int)
    number[np.abs(area) < 1e-12] = 0
    of = np.repeat(np.arange(len(triangles)), number)
    u, v = rng.random((2, len(of)))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    at = corners[of, 0] + u[:, None] * d1[of] + v[:, None] * d2[of]
    cell = np.floor(at * SIZE).astype(int)
    # The middle of the texel, in the plane of the triangle.
    w = (cell + 0.5) / SIZE - corners[of, 0]
    u = (w[:, 0] * d2[of, 1] - w[:, 1] * d2[of, 0]) / area[of]
    v = (d1[of, 0] * w[:, 1] - d1[of, 1] * w[:, 0]) / area[of]
    weights = np.stack([1 - u - v, u, v], 1)
    near = np.abs(weights).max(1) < 4
    of, weights, cell = of[near], weights[near], cell[near]
    place = np.einsum("nc,nck->nk", weights, points[triangles[of]])
    texel = np.clip(cell[:, 1], 0, SIZE - 1) * SIZE + cell[:, 0] % SIZE
    order = np.argsort(np.linalg.norm(place - MIDDLE, axis=1))
    last = np.full(SIZE**2, -1)
    last[texel[order]] = order
    last = filled(last.reshape(SIZE, SIZE)).ravel()
    of, weights = of[last], weights[last]
    p = points[triangles[of]]
    normal = unit(np.einsum("nc,nck->nk", weights, normals[triangles[of]]))
    e1, e2, (a, b) = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], (d1[of], d2[of])
    along_s = (e1 * b[:, 1:] - e2 * a[:, 1:]) * np.sign(area[of])[:, None]
    along_t = (e2 * a[:, :1] - e1 * b[:, :1]) * np.sign(area[of])[:, None]
    tangent = unit(along_s - normal * np.sum(along_s * normal, 1, keepdims=True))
    side = np.cross(normal, tangent)
    side *= np.where(np.sum(side * along_t, 1, keepdims=True) < 0, -1, 1)
    return place[last], normal, tangent, side


def filled(last):
    """Texels that nothing hit take what their neighbours have."""
    while (empty := last < 0).any():
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            last = np.where(last < 0, np.roll(last, step, axis), last)
        if (last < 0).sum() == empty.sum():
            break
    return last


def unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)


def cells(p, size, seed):
    """Distance to the nearest of points scattered one to each cell of a grid, in sizes, and that cell's own number."""
    rng = np.random.default_rng(seed)
    table = rng.random((8192, 4)).astype(np.float32)
    q = (p / size).astype(np.float32)
    base = np.floor(q).astype(np.int64)
    best, number = np.full(len(p), 9.0, np.float32), np.zeros(len(p), np.float32)
    for offset in np.ndindex(3, 3, 3):
        cell = base + np.array(offset) - 1
        key = (cell[:, 0] * 73856093 ^ cell[:, 1] * 19349663 ^ cell[:, 2] * 83492791) & 8191
        d = np.linalg.norm(cell + table[key, :3] - q, axis=1)
        closer = d < best
        best[closer], number[closer] = d[closer], table[key[closer], 3]
    return best, number


class Places:
    """Where on the head points are: soft masks, 0 to 1."""

    def __init__(self, p):
        x, y, z = p.T
        mirrored = p * np.array([0, 1, 1]) + np.abs(x)[:, None] * np.array([1, 0, 0])
        self.eye = np.linalg.norm(mirrored - EYE_CENTER, axis=1)
        self.ear = ramp(np.abs(x), 7.6, 9.0) * ramp(y, -6, -4)
        front = ramp(z, 5, 6.5)
        lip = ramp(np.abs(y + 7.15 + 0.03 * x**2), 1.15, 0.6) * ramp(np.abs(x), 4.2, 3.2)
        self.lip = lip * front
        self.nose = ramp(np.linalg.norm(p - (0, -3.3, 9.2), axis=1), 2.6, 1.0)
        self.cheek = ramp(np.linalg.norm(mirrored - (4.6, -3.0, 5.8), axis=1), 2.8, 0.8)
        self.lid = ramp(self.eye, 2.3, 1.7)
        self.brow = ramp(np.linalg.norm(mirrored * (0.5, 1, 0.5) - (1.5, 2.0, 3.8), axis=1), 1.8, 0.6)
        self.neck = ramp(y, -11, -15)


def mixed(color, other, share):
    return color + (other - color) * np.clip(share, 0, 1)[:, None]


def skin_color(p):
    """What is seen of the flesh: blotches, blood where the skin is thin, darker lips and lids, moles."""
    at = Places(p)
    color = np.broadcast_to(BASE, p.shape)
    blotch = noise(p, 2.6, 21) + 0.6 * noise(p, 1.1, 22) + 0.35 * noise(p, 0.45, 23)
    color = mixed(color, PATCH, 0.35 + 0.75 * blotch + 0.25 * at.neck)
    color = mixed(color, PALE, 0.5 * ramp(noise(p, 3.3, 24), 0.15, 0.6))
    color = mixed(color, PATCH, 0.5 * at.brow)
    blood = 0.75 * at.nose + 0.45 * at.cheek + 0.55 * at.lid + 0.6 * at.ear
    color = mixed(color, FLUSH, blood * (0.75 + 0.5 * noise(p, 0.7, 25)))
    color = mixed(color, LIP, 0.9 * at.lip)
    d, number = cells(p, 0.9, 26)
    mole = ramp(d, 0.05 + 0.14 * number, 0.02 + 0.07 * number) * (number > 0.35) * (1 - at.lip)
    color = mixed(color, SPOT, 0.75 * mole)
    fine, own = cells(p, 0.16, 27)
    return color * (1 + 0.10 * (own - 0.5) - 0.08 * ramp(fine, 0.3, 0.1))[:, None]


def height(p):
    """Pores and the fine net of lines between them, cm."""
    at = Places(p)
    pore, number = cells(p, 0.17, 31)
    large, own = cells(p, 0.42, 32)
    holes = -0.014 * ramp(pore, 0.42, 0.12) * (0.4 + number) - 0.02 * ramp(large, 0.3, 0.1) * (own > 0.5)
    lines = 0.010 * noise(p, 0.11, 33) + 0.012 * noise(p * np.array([1, 2.2, 1]), 0.28, 34)
    lip_lines = 0.016 * noise(p * np.array([3.2, 0.5, 0.5]), 0.4, 35) * at.lip
    calm = (1 - 0.7 * at.lip) * (1 - 0.8 * at.ear) * ramp(at.eye, 1.5, 2.1)
    return (holes + lines) * calm + lip_lines


def skin_normal(p, tangent, side):
    """(n, 3) in tangent space, from the slopes of `height` along both directions."""
    step = 0.02
    here = height(p)
    slopes = [(height(p + step * along) - here) / step for along in (tangent, side)]
    return unit(np.stack([-slopes[0], -slopes[1], np.ones(len(p))], 1))


def skin_wetness(p):
    """(n, 3): coverage of the wet layer, its roughness, roughness of the skin below."""
    at = Places(p)
    oily = 0.4 * ramp(noise(p, 1.8, 43) + 0.5 * at.nose + 0.4 * at.brow, 0.0, 0.8)
    wet = np.maximum.reduce([0.9 * at.lip, ramp(at.eye, 1.72, 1.5), 0.7 * at.nose, oily])
    coat = 0.26 - 0.14 * np.maximum(at.lip, ramp(at.eye, 1.72, 1.5))
    rough = 0.46 + 0.1 * noise(p, 0.9, 44) - 0.1 * at.nose - 0.06 * at.lip
    return np.clip(np.stack([wet, coat, rough], 1), 0, 1)


def skin_maps(points, normals, triangles):
    """{name: (SIZE, SIZE, 3) in 0 to 1, rows from the top}."""
    st, indices = coordinates(points, triangles)
    p, _, tangent, side = baked(points, normals, triangles, st, indices)
    maps = {
        "color": skin_color(p),
        "normal": 0.5 + 0.5 * skin_normal(p, tangent, side),
        "wet": skin_wetness(p),
    }
    return {name: values.reshape(SIZE, SIZE, 3)[::-1] for name, values in maps.items()}


def write_maps(folder, maps):
    """JPEG; colours are encoded for sRGB, the others are data."""
    import OpenImageIO as oiio

    folder.mkdir(exist_ok=True)
    for name, values in maps.items():
        if name in ("color", "eye"):
            values = np.where(
                values < 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055
            )
        spec = oiio.ImageSpec(values.shape[1], values.shape[0], 3, oiio.UINT8)
        spec.attribute("compression", "jpeg:88")
        spec.attribute("jpeg:subsampling", "4:4:4" if name == "normal" else "4:2:0")
        image = oiio.ImageBuf(spec)
        pixels = np.ascontiguousarray(np.clip(values, 0, 1), np.float32)
        if not (image.set_pixels(oiio.ROI(), pixels) and image.write(str(folder / f"orc_{name}.jpg"))):
            raise SystemExit(image.geterror())
