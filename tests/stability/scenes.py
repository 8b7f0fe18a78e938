"""Flat prims made by hand: bodies, media, lights, a camera. Dicts as in `FlatStage.prims`."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Prim = dict[str, Any]
Matrix = NDArray[np.float64]
"""Row vectors: translation in the last row, the first of a product acts first."""


def scale(x: float, y: float | None = None, z: float | None = None) -> Matrix:
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def move(x: float, y: float, z: float) -> Matrix:
    matrix = np.eye(4)
    matrix[3, :3] = x, y, z
    return matrix


def turn(axis: int, degrees: float) -> Matrix:
    """About a coordinate axis."""
    matrix, (sin, cos) = np.eye(4), (math.sin(math.radians(degrees)), math.cos(math.radians(degrees)))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    matrix[a, a] = matrix[b, b] = cos
    matrix[a, b], matrix[b, a] = sin, -sin
    return matrix


def rows(matrix: Matrix) -> list[list[float]]:
    return [[float(x) for x in row] for row in matrix]


def mesh(
    points: ArrayLike, counts: ArrayLike, indices: ArrayLike, material: str = "/M", **fields: Any
) -> Prim:
    points = np.asarray(points, np.float32).reshape(-1, 3)
    counts, indices = np.asarray(counts, np.int32), np.asarray(indices, np.int32).ravel()
    topology = {"faceVertexCounts": counts, "faceVertexIndices": indices}
    return {"type": "Mesh", "points": points, **topology, "material": material, **fields}


def placed(prim: Prim, matrix: Matrix) -> Prim:
    return {**prim, "transform": rows(matrix)}


def baked(prim: Prim, matrix: Matrix) -> Prim:
    """The points themselves transformed, in f64; windings turned where the matrix mirrors."""
    points = prim["points"].astype(np.float64) @ matrix[:3, :3] + matrix[3, :3]
    moved = {**prim, "points": points.astype(np.float32)}
    return flipped(moved) if np.linalg.det(matrix[:3, :3]) < 0.0 else moved


def flipped(prim: Prim) -> Prim:
    """Windings turned: normals point inward."""
    ends = np.cumsum(prim["faceVertexCounts"])
    faces = np.split(prim["faceVertexIndices"], ends[:-1])
    return {**prim, "faceVertexIndices": np.concatenate([face[::-1] for face in faces])}


def joined(*parts: Prim) -> Prim:
    """One mesh of several."""
    first = np.cumsum([0, *(len(part["points"]) for part in parts)])
    indices = [part["faceVertexIndices"] + np.int32(at) for part, at in zip(parts, first, strict=False)]
    points, counts = ([part[name] for part in parts] for name in ("points", "faceVertexCounts"))
    return mesh(np.concatenate(points), np.concatenate(counts), np.concatenate(indices), parts[0]["material"])


def sphere(
    rings: int = 24, radius: float = 1.0, columns: int | None = None, polar: ArrayLike | None = None
) -> Prim:
    """Closed, of flat triangles, outward, poles on Y. `polar`: angles of the rings between the poles."""
    columns = columns or 2 * rings
    theta = np.pi * np.arange(1, rings) / rings if polar is None else np.asarray(polar)
    phi = 2.0 * np.pi * np.arange(columns) / columns
    sin, cos = radius * np.sin(theta)[:, None], radius * np.cos(theta)[:, None]
    belt = np.stack([sin * np.cos(phi), np.broadcast_to(cos, (len(theta), columns)), -sin * np.sin(phi)], -1)
    points = np.concatenate([[[0, radius, 0]], belt.reshape(-1, 3), [[0, -radius, 0]]])
    ring = 1 + columns * np.arange(len(theta))[:, None]
    here, next_ = ring + np.arange(columns), ring + (np.arange(columns) + 1) % columns
    south = len(points) - 1
    cap = [np.stack([np.zeros(columns), here[0], next_[0]], -1)]
    quads = [here[:-1], here[1:], next_[1:], next_[:-1]]
    belts = [np.stack([quads[0], quads[1], quads[2]], -1), np.stack([quads[0], quads[2], quads[3]], -1)]
    base = [np.stack([here[-1], np.full(columns, south), next_[-1]], -1)]
    triangles = np.concatenate([t.reshape(-1, 3) for t in (*cap, *belts, *base)])
    return mesh(points, np.full(len(triangles), 3), triangles)


QUADS = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Faces of a box, outward: -x, +x, -y, +y, -z, +z."""


def box(low: ArrayLike, high: ArrayLike, faces: tuple[tuple[int, ...], ...] = QUADS) -> Prim:
    corners = [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    return mesh(corners, [4] * len(faces), faces)


def plate(thickness: float, half: float = 10.0) -> Prim:
    """Its top is at z = 0."""
    return box((-half, -half, -thickness), (half, half, 0.0))


def medium(albedo: ArrayLike, radius: ArrayLike, boundary: str = "diffuse", **fields: Any) -> Prim:
    """UsdPreviewSurface that is all medium. Index of refraction 1, so that a diffuse boundary reflects nothing."""
    albedo, radius = (np.broadcast_to(np.float32(x), 3).tolist() for x in (albedo, radius))
    asked = {"subsurface": 1.0, "ior": 1.0, "roughness": 0.0, "subsurfaceBoundary": boundary}
    named = {"subsurfaceAlbedo": albedo, "subsurfaceRadius": radius}
    return {"type": "Material", "shader": "UsdPreviewSurface", **asked, **named, **fields}


def light(kind: str, matrix: Matrix | None = None, intensity: float = 1.0, **fields: Any) -> Prim:
    """`fields` of the shape, but for those of every light."""
    common = {name: fields.pop(name) for name in ("cameraVisible", "normalize", "color") if name in fields}
    shape = {"kind": kind, **fields}
    placement = rows(np.eye(4) if matrix is None else matrix)
    return {"type": "Light", "shape": shape, "transform": placement, "intensity": intensity, **common}


def dome(radiance: float = 1.0, texture: str = "") -> Prim:
    """Seen by the camera too."""
    return light("dome", intensity=radiance, texture=texture, poleAxis="Y", cameraVisible=True)


def sun(degrees: float = 0.0, irradiance: float = 1.0) -> Prim:
    """Without extent, from +z turned towards +x; `irradiance` across its rays."""
    return light("distant", turn(1, degrees), irradiance, angle=0.0)


def camera(eye: ArrayLike, fov: float, target: ArrayLike = (0, 0, 0), orthographic: float = 0.0) -> Prim:
    """Square; `fov` in degrees, or the width of an orthographic picture."""
    eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    distance = float(np.linalg.norm(eye - target))
    back = (eye - target) / distance
    right = np.cross((0, 1, 0) if abs(back[1]) < 0.9 else (1, 0, 0), back)
    right /= np.linalg.norm(right)
    frame = np.eye(4)
    frame[:3, :3] = right, np.cross(back, right), back
    frame[3, :3] = eye
    focal = 10.0 / math.tan(math.radians(fov) / 2) if fov else 1.0
    aperture = 10.0 * orthographic or 20.0
    return {
        "type": "Camera",
        "transform": rows(frame),
        "projection": "orthographic" if orthographic else "perspective",
        "horizontalAperture": aperture,
        "verticalAperture": aperture,
        "focalLength": focal,
        "clippingRange": [1e-6 * distance, 1e3 * distance],
    }


FRONT = camera((0, 0, 8), 6.0)
"""Sees nothing but the middle of a body of radius 1."""
ABOVE = camera((0, 0, 200), 0.02)
"""Sees a patch of 0.07 about the origin, straight on."""
