"""Implicit prims as closed meshes: shared points (no seam, no double pole), outward right-handed winding.

Texture coordinates, which Hydra has none of, are never mirrored as seen from outside: s once around the axis from the
first direction after it, t along the profile from pole to pole or over the side; all of the image on each flat cap, on
each face of a cube and on a plane.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pxr import Usd

from .arrays import np
from .reading import Reader

if TYPE_CHECKING:
    from numpy.typing import NDArray

SEGMENTS = 96
"""Around the axis; the silhouette stays within 0.06 % of the radius."""
STACKS = 48
"""Pole to pole of a sphere."""

IMPLICIT_TYPES = ("Sphere", "Cube", "Cone", "Cylinder", "Cylinder_1", "Capsule", "Capsule_1", "Plane")

Surface = dict[str, Any]


def texture_coordinates(prim: Usd.Prim, kind: str, reader: Reader) -> Surface | None:
    """Face-varying `st` as fields of a Primvar."""
    surface = tessellate(prim, kind, reader, with_st=True)
    return surface and surface["st"]


def tessellate(prim: Usd.Prim, kind: str, reader: Reader, with_st: bool = False) -> Surface | None:
    """Points, topology and normals of an implicit prim as fields of a Mesh; None where it has no extent.

    `with_st`: with texture coordinates as `st`, which is no field of a Mesh.
    """

    def length(name: str, default: float) -> float:
        value = reader.value(prim, name, default)
        if value < 0.0:
            reader.warn(prim, f"{name}: {value:g} is negative; its absolute value is used")
        return abs(value)

    surface = build(prim, kind, reader, length)
    if surface is not None and not with_st:
        del surface["st"]
    if surface is None or np.ptp(surface["points"], axis=0).max() == 0.0:
        reader.warn(prim, f"{kind} without extent; it is not rendered")
        return None
    return surface


def build(prim: Usd.Prim, kind: str, reader: Reader, length: Any) -> Surface | None:
    axis = reader.value(prim, "axis", "Z")
    if axis not in ("X", "Y", "Z"):
        reader.warn(prim, f"axis: '{axis}' is none of X, Y, Z; Z is used")
        axis = "Z"
    match kind:
        case "Sphere":
            return sphere(length("radius", 1.0), axis)
        case "Cube":
            return cube(length("size", 2.0))
        case "Plane":
            return plane(length("width", 2.0), length("length", 2.0), axis)
        case "Cone":
            return frustum(length("radius", 1.0), 0.0, length("height", 2.0), axis)
        case "Cylinder":
            radius = length("radius", 1.0)
            return frustum(radius, radius, length("height", 2.0), axis)
        case "Cylinder_1":
            return frustum(length("radiusBottom", 1.0), length("radiusTop", 1.0), length("height", 2.0), axis)
        case "Capsule":
            radius = length("radius", 0.5)
            return capsule(radius, radius, length("height", 1.0), axis)
        case "Capsule_1":
            return capsule(length("radiusBottom", 0.5), length("radiusTop", 0.5), length("height", 1.0), axis)
    return None


def arc(radius: float, start: float, end: float, steps: int, z: float = 0.0) -> tuple[NDArray, NDArray]:
    """Profile (r, z) and normals of its bands for a spherical cap from latitude `start` to `end` in
    degrees."""
    latitude = np.radians(np.linspace(start, end, steps + 1))
    normals = np.stack([np.cos(latitude), np.sin(latitude)], axis=1)
    # The poles are exact, so that `revolve` recognises them.
    normals[np.abs(latitude) == np.pi / 2, 0] = 0.0
    return radius * normals + [0.0, z], np.stack([normals[:-1], normals[1:]], axis=1)


def sphere(radius: float, axis: str = "Z") -> Surface:
    return revolve(*arc(radius, -90.0, 90.0, STACKS), axis)


def frustum(bottom: float, top: float, height: float, axis: str) -> Surface | None:
    """Cylinder, cone or what lies between, with flat caps."""
    h = height / 2
    profile, normals = [(0.0, -h)], []
    if bottom > 0.0:
        profile.append((bottom, -h))
        normals.append(flat((0.0, -1.0)))
    if top > 0.0:
        profile.append((top, h))
    profile.append((0.0, h))
    normals.append(flat(slope(bottom, top, height)))
    if top > 0.0:
        normals.append(flat((0.0, 1.0)))
    return revolve(np.array(profile), np.array(normals), axis) if bottom > 0.0 or top > 0.0 else None


def capsule(bottom: float, top: float, height: float, axis: str) -> Surface | None:
    """Two hemispheres and the frustum between them."""
    if bottom == 0.0 or top == 0.0:
        return frustum(bottom, top, height, axis)
    low, low_normals = arc(bottom, -90.0, 0.0, STACKS // 2, -height / 2)
    high, high_normals = arc(top, 0.0, 90.0, STACKS // 2, height / 2)
    if height == 0.0 and bottom == top:
        return revolve(np.concatenate([low, high[1:]]), np.concatenate([low_normals, high_normals]), axis)
    side = np.array([flat(slope(bottom, top, height))])
    return revolve(np.concatenate([low, high]), np.concatenate([low_normals, side, high_normals]), axis)


def slope(bottom: float, top: float, height: float) -> tuple[float, float]:
    """Outward normal (r, z) of a frustum's side."""
    size = np.hypot(height, bottom - top)
    return (height / size, (bottom - top) / size) if size > 0.0 else (1.0, 0.0)


def flat(normal: tuple[float, float]) -> list[tuple[float, float]]:
    return [normal, normal]


def revolve(profile: NDArray, normals: NDArray, axis: str) -> Surface:
    """Turns a profile about `axis`.

    `profile` (n, 2) holds (r, z) from the lower pole to the upper, r = 0 at both ends and nowhere else;
    `normals` (n - 1, 2, 2) the normals (r, z) at the two ends of each band.
    """
    phi = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    rings = around(profile[1:-1], phi).reshape(-1, 3)
    points = np.concatenate([[[0.0, 0.0, profile[0, 1]]], rings, [[0.0, 0.0, profile[-1, 1]]]])
    faces, corners = zip(*(band(i, len(profile) - 1) for i in range(len(profile) - 1)), strict=True)
    values = around(normals.reshape(-1, 2), phi).reshape(-1, 3)
    counts = np.concatenate([np.full(SEGMENTS, face.shape[1], np.int32) for face in faces])
    return surface(
        turn(points, axis),
        counts,
        np.concatenate([face.ravel() for face in faces]),
        turn(values, axis),
        np.concatenate([corner.ravel() for corner in corners]),
        np.concatenate([st.reshape(-1, 2) for st in band_coordinates(profile)]),
    )


def band_coordinates(profile: NDArray) -> list[NDArray]:
    """st at the corners of the faces of each band, as `band` orders them."""
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    flat = np.diff(profile[:, 1]) == 0.0
    t = np.concatenate([[0.0], np.cumsum(np.where(flat, 0.0, steps))])
    t = t / (t[-1] or 1.0)
    s = np.arange(SEGMENTS + 1) / SEGMENTS
    bands = []
    for i in range(len(profile) - 1):
        poles = profile[i, 0] == 0.0, profile[i + 1, 0] == 0.0
        if flat[i]:
            # Seen from below with the same upwards direction, the first axis points to the left.
            x, y = np.cos(2.0 * np.pi * s), np.sin(2.0 * np.pi * s)
            rim = 0.5 + 0.5 * np.stack([x if poles[1] else -x, y], axis=1)
            pole = np.full((SEGMENTS, 2), 0.5)
            low, high = rim, rim
        else:
            low, high = (np.stack([s, np.full_like(s, height)], axis=1) for height in t[i : i + 2])
            pole = np.stack([0.5 * (s[:-1] + s[1:]), np.full(SEGMENTS, t[i if poles[0] else i + 1])], axis=1)
        if poles[0]:
            corners = [pole, high[1:], high[:-1]]
        elif poles[1]:
            corners = [low[:-1], low[1:], pole]
        else:
            corners = [low[:-1], low[1:], high[1:], high[:-1]]
        bands.append(np.stack(corners, axis=1))
    return bands


def around(rz: NDArray, phi: NDArray) -> NDArray:
    """(n, 2) of (r, z) -> (n, segments, 3)."""
    r, z = rz[:, None, 0], rz[:, None, 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z, (len(rz), len(phi)))], axis=2)


def band(i: int, bands: int) -> tuple[NDArray, NDArray]:
    """Point and normal indices of the faces of band `i`: triangles at a pole, else quads; counter-clockwise
    outside."""
    j = np.arange(SEGMENTS)
    k = (j + 1) % SEGMENTS
    low, high = 1 + (i - 1) * SEGMENTS, 1 + i * SEGMENTS
    normal_low, normal_high = 2 * i * SEGMENTS, (2 * i + 1) * SEGMENTS
    if i == 0:
        pole = np.zeros_like(j)
        return np.stack([pole, high + k, high + j], 1), np.stack(
            [normal_low + j, normal_high + k, normal_high + j], 1
        )
    if i == bands - 1:
        pole = np.full_like(j, high)
        return np.stack([low + j, low + k, pole], 1), np.stack(
            [normal_low + j, normal_low + k, normal_high + j], 1
        )
    return (
        np.stack([low + j, low + k, high + k, high + j], 1),
        np.stack([normal_low + j, normal_low + k, normal_high + k, normal_high + j], 1),
    )


def turn(vectors: NDArray, axis: str) -> NDArray:
    """Z to `axis` by a cyclic permutation, which keeps the winding."""
    return vectors[:, {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[axis]]


def cube(size: float) -> Surface:
    points = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
    faces = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])
    normals = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
    # Y is up on the sides, -Z and Z on top and bottom.
    up = np.array([[0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0, 1, 0], [0, 1, 0]])
    corners = np.sign(points)[faces]
    s = np.einsum("fci,fi->fc", corners, np.cross(up, normals))
    st = 0.5 + 0.5 * np.stack([s, np.einsum("fci,fi->fc", corners, up)], axis=-1)
    return surface(
        points, np.full(6, 4), faces.ravel(), normals, np.repeat(np.arange(6), 4), st.reshape(-1, 2)
    )


def plane(width: float, length: float, axis: str) -> Surface:
    """A quad facing along +`axis`; width runs along Z, X, X and length along Y, Z, Y for axes X, Y, Z."""
    x, y, z = np.eye(3)
    u, v = {"X": (length * y, width * z), "Y": (length * z, width * x), "Z": (width * x, length * y)}[axis]
    points = 0.5 * np.stack([-u - v, u - v, u + v, v - u])
    normal = {"X": x, "Y": y, "Z": z}[axis]
    st = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return surface(points, np.array([4]), np.arange(4), normal[None], np.zeros(4), st)


def surface(
    points: NDArray, counts: NDArray, indices: NDArray, normals: NDArray, corners: NDArray, st: NDArray
) -> Surface:
    return {
        "points": np.ascontiguousarray(points, np.float32),
        "faceVertexCounts": np.ascontiguousarray(counts, np.int32),
        "faceVertexIndices": np.ascontiguousarray(indices, np.int32),
        "normals": {
            "interpolation": "faceVarying",
            "values": np.ascontiguousarray(normals, np.float32),
            "indices": np.ascontiguousarray(corners, np.int32),
        },
        "st": {"interpolation": "faceVarying", "values": np.ascontiguousarray(st, np.float32)},
    }
