"""Direct irradiance from a UsdLux light by plain numerical quadrature: the oracle of the conformance test.

Written from the schema documentation of UsdLux (usd-core 26.11, `usdLux/schema.usda`), not from the renderer.
Matrices are USD's: row vectors, `world = local @ matrix`. Attributes have UsdLux names without `inputs:`.
What the documentation leaves open is settled here: an angle of 0 makes a distant light's emission an irradiance
(lux on a surface that faces it); texture lookups are of the texel; the image of a rect light stands upright as
seen from the lit side.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdLux

Array = NDArray[np.float64]

DEFAULTS: dict[str, Any] = {
    "intensity": 1.0,
    "exposure": 0.0,
    "color": (1.0, 1.0, 1.0),
    "enableColorTemperature": False,
    "colorTemperature": 6500.0,
    "normalize": False,
    "width": 1.0,
    "height": 1.0,
    "radius": 0.5,
    "length": 1.0,
    "angle": 0.53,
    "shaping:focus": 0.0,
    "shaping:focusTint": (0.0, 0.0, 0.0),
    "shaping:cone:angle": 90.0,
    "shaping:cone:softness": 0.0,
}

CHUNK = 128
"""Points times light samples at once: memory stays in the caches."""


@dataclass(frozen=True)
class Light:
    """`kind` is the prim type, or `Mesh`; `shaped` says that ShapingAPI is applied."""

    kind: str
    attributes: dict[str, Any] = field(default_factory=dict)
    matrix: Array = field(default_factory=lambda: np.eye(4))
    shaped: bool = False
    texture: Array | None = None
    """(height, width, 3), linear, first row on top."""
    pole: str = "Y"
    """Where the top of a dome's image points before `matrix`: `Y` or `Z`."""
    triangles: Array | None = None
    """(n, 3, 3) local corners of a mesh, counter-clockwise seen from outside; closed and convex."""

    def __getitem__(self, name: str) -> Any:
        default = 50000.0 if (self.kind, name) == ("DistantLight", "intensity") else DEFAULTS[name]
        return self.attributes.get(name, default)

    @property
    def axis(self) -> Array:
        """World direction in which the light looks: its local -Z."""
        return unit(-self.matrix[2, :3])


@dataclass(frozen=True)
class Patches:
    """Small pieces of an emitting surface in world space."""

    positions: Array
    areas: Array
    """(n, 3): unit normal of the emitting side times area."""
    tint: Array | float = 1.0

    @property
    def area(self) -> float:
        return float(np.linalg.norm(self.areas, axis=1).sum())


def irradiance(light: Light, points: Array, normals: Array, resolution: int = 32) -> Array:
    """RGB irradiance (n, 3) on `points` with unit `normals` (n, 3), nothing in between."""
    if light.kind == "DistantLight":
        return per_normal(light, normals, distant_irradiance)
    if light.kind.startswith("DomeLight"):
        return per_normal(light, normals, dome_irradiance)
    patches = SHAPES[light.kind](light, resolution)
    blocks = np.array_split(np.arange(len(points)), max(1, len(points) // CHUNK))
    radiance = emission(light, patches.area if light["normalize"] else 1.0)
    return radiance * np.concatenate([gather(light, patches, points[b], normals[b]) for b in blocks])


def emission(light: Light, size: float) -> Array:
    """LightAPI: intensity, exposure, normalize, color, colour temperature."""
    scalar = light["intensity"] * 2.0 ** light["exposure"] / size
    color = np.array(light["color"], float)
    if light["enableColorTemperature"]:
        color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(light["colorTemperature"]))
    return scalar * color


def gather(light: Light, patches: Patches, points: Array, normals: Array) -> Array:
    """Sum of cos cos dA / d^2 over the patches that face the points, shaped and tinted."""
    q, areas = patches.positions, patches.areas
    received = (normals @ q.T - dot(normals, points)[:, None]).clip(min=0.0)
    emitted = (points @ areas.T - dot(q, areas)).clip(min=0.0)
    distance2 = dot(points, points)[:, None] + dot(q, q) - 2.0 * points @ q.T
    form = received * emitted / distance2**2
    tint = np.broadcast_to(patches.tint, q.shape)
    if not light.shaped:
        return form @ tint
    cosine = ((points @ light.axis)[:, None] - q @ light.axis) / np.sqrt(distance2)
    off_axis = np.array(light["shaping:focusTint"], float)
    form = form * cone(light, cosine)
    return off_axis * (form @ tint) + (1.0 - off_axis) * ((form * focus(light, cosine)) @ tint)


def focus(light: Light, cosine: Array) -> Array:
    """ShapingAPI: share of white against `focusTint` at `cosine` to the axis; negative exponents are ignored."""
    return np.abs(cosine) ** max(light["shaping:focus"], 0.0)


def cone(light: Light, cosine: Array) -> Array:
    """ShapingAPI: 1 - smoothStep(offAxis, smoothStart, cutoff)."""
    cutoff = np.radians(light["shaping:cone:angle"])
    start = (1.0 - np.clip(light["shaping:cone:softness"], 0.0, 1.0)) * cutoff
    off_axis = np.arccos(np.clip(cosine, -1.0, 1.0))
    if start == cutoff:
        return (off_axis <= cutoff).astype(float)
    t = np.clip((off_axis - start) / (cutoff - start), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)


# Shapes


def rect(light: Light, n: int) -> Patches:
    """u runs from +X to -X, the image from +Y down to -Y."""
    u, du = midpoints(0.0, 1.0, n) if light.texture is not None else gauss(0.0, 1.0, n)
    u, v, weight = grid(u, du, u, du)
    w, h = light["width"], light["height"]
    zero = np.zeros_like(u)
    local = np.stack([(0.5 - u) * w, (0.5 - v) * h, zero], axis=1)
    patches = surface(light, local, fill(u, (w, 0, 0)), fill(u, (0, h, 0)), fill(u, (0, 0, -1)), weight)
    if light.texture is None:
        return patches
    rows, columns = light.texture.shape[:2]
    tint = light.texture[(v * rows).astype(int), (u * columns).astype(int)]
    return Patches(patches.positions, patches.areas, tint)


def disk(light: Light, n: int) -> Patches:
    r, phi, weight = grid(*gauss(0.0, light["radius"], n), *midpoints(0.0, 2.0 * np.pi, 2 * n))
    c, s, zero = np.cos(phi), np.sin(phi), np.zeros_like(phi)
    local = np.stack([r * c, r * s, zero], axis=1)
    d_r, d_phi = np.stack([c, s, zero], axis=1), np.stack([-r * s, r * c, zero], axis=1)
    return surface(light, local, d_r, d_phi, fill(r, (0, 0, -1)), weight)


def sphere(light: Light, n: int) -> Patches:
    """An ellipsoid after a non-uniform scale."""
    radius = light["radius"]
    z, phi, weight = grid(*gauss(-1.0, 1.0, n), *midpoints(0.0, 2.0 * np.pi, 2 * n))
    ring = np.sqrt(1.0 - z * z)
    c, s = np.cos(phi), np.sin(phi)
    normal = np.stack([ring * c, ring * s, z], axis=1)
    d_z = np.stack([-z / ring * c, -z / ring * s, np.ones_like(z)], axis=1)
    d_phi = np.stack([-ring * s, ring * c, np.zeros_like(z)], axis=1)
    return surface(light, radius * normal, radius * d_z, radius * d_phi, normal, weight)


def cylinder(light: Light, n: int) -> Patches:
    """About X, without caps."""
    length, radius = light["length"], light["radius"]
    x, phi, weight = grid(*gauss(-0.5 * length, 0.5 * length, n), *midpoints(0.0, 2.0 * np.pi, 2 * n))
    c, s, zero = np.cos(phi), np.sin(phi), np.zeros_like(phi)
    local = np.stack([x, radius * c, radius * s], axis=1)
    d_phi = np.stack([zero, -radius * s, radius * c], axis=1)
    return surface(light, local, fill(x, (1, 0, 0)), d_phi, np.stack([zero, c, s], axis=1), weight)


def mesh(light: Light, n: int) -> Patches:
    """Each triangle by the square mapped onto it: (u, v) -> a + u (b - a) + u v (c - b)."""
    parts = [triangle(light, corners, n // 2) for corners in light.triangles]
    return Patches(np.concatenate([p.positions for p in parts]), np.concatenate([p.areas for p in parts]))


def triangle(light: Light, corners: Array, n: int) -> Patches:
    a, b, c = corners
    u, v, weight = grid(*gauss(0.0, 1.0, n), *gauss(0.0, 1.0, n))
    u, v = u[:, None], v[:, None]
    local = a + u * (b - a) + u * v * (c - b)
    outward = np.cross(b - a, c - a)
    return surface(light, local, (b - a) + v * (c - b), u * (c - b), fill(weight, outward), weight)


SHAPES: dict[str, Callable[[Light, int], Patches]] = {
    "RectLight": rect,
    "DiskLight": disk,
    "SphereLight": sphere,
    "CylinderLight": cylinder,
    "Mesh": mesh,
}


def surface(light: Light, local: Array, d_s: Array, d_t: Array, normal: Array, weight: Array) -> Patches:
    """Patches from local positions, tangents and the local normal of the emitting side (a covector)."""
    linear = light.matrix[:3, :3]
    areas = np.cross(d_s @ linear, d_t @ linear) * weight[:, None]
    outward = normal @ np.linalg.inv(linear).T
    areas = np.where((areas * outward).sum(axis=1, keepdims=True) < 0.0, -areas, areas)
    return Patches(local @ linear + light.matrix[3, :3], areas)


# Lights at infinity


def per_normal(light: Light, normals: Array, compute: Callable[[Light, Array], Array]) -> Array:
    """These depend on the normal alone, of which there are few."""
    unique, inverse = np.unique(normals, axis=0, return_inverse=True)
    return np.array([compute(light, n) for n in unique])[inverse.reshape(-1)]


def distant_irradiance(light: Light, normal: Array) -> Array:
    """A cone of constant radiance about the direction opposite to the light's axis."""
    half = np.clip(np.radians(light["angle"]) / 2.0, 0.0, np.pi)
    if half == 0.0:
        return emission(light, 1.0) * max(0.0, -light.axis @ normal)
    sine2 = np.sin(half) ** 2
    size = np.pi * (sine2 if half <= np.pi / 2.0 else 2.0 - sine2)
    t, phi, weight = grid(*gauss(0.0, half, 128), *midpoints(0.0, 2.0 * np.pi, 256))
    x, y = across(-light.axis)
    to_light = np.sin(t)[:, None] * (np.cos(phi)[:, None] * x + np.sin(phi)[:, None] * y)
    to_light -= np.cos(t)[:, None] * light.axis
    form = ((to_light @ normal).clip(min=0.0) * np.sin(t) * weight).sum()
    return emission(light, size if light["normalize"] else 1.0) * form


def dome_irradiance(light: Light, normal: Array) -> Array:
    """OpenEXR's latlong map: pixel (0, 0) has latitude pi/2 and longitude pi."""
    image = np.ones((128, 256, 3)) if light.texture is None else light.texture
    finer = max(2, 256 // image.shape[0])
    image = image.repeat(finer, axis=0).repeat(finer, axis=1)
    rows, columns = image.shape[:2]
    latitude = np.pi / 2.0 - midpoints(0.0, np.pi, rows)[0]
    longitude = np.pi - midpoints(0.0, 2.0 * np.pi, columns)[0]
    lat, lon = np.meshgrid(latitude, longitude, indexing="ij")
    solid_angle = np.cos(lat) * (np.pi / rows) * (2.0 * np.pi / columns)
    local = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], axis=-1)
    if light.pole == "Z":
        # Top to +Z, and (latitude 0, longitude 0) from +Z to -Y: a quarter turn about X.
        local = np.stack([local[..., 0], -local[..., 2], local[..., 1]], axis=-1)
    to_light = unit(local @ light.matrix[:3, :3])
    form = (to_light @ normal).clip(min=0.0) * solid_angle
    return emission(light, 1.0) * np.einsum("rc,rck->k", form, image)


# Nodes and weights


def gauss(a: float, b: float, n: int) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(n)
    return a + (b - a) * 0.5 * (x + 1.0), w * 0.5 * (b - a)


def midpoints(a: float, b: float, n: int) -> tuple[Array, Array]:
    return a + (b - a) * (np.arange(n) + 0.5) / n, np.full(n, (b - a) / n)


def grid(s: Array, ds: Array, t: Array, dt: Array) -> tuple[Array, Array, Array]:
    """All pairs: flat s, t and product weights."""
    both = np.meshgrid(s, t, indexing="ij")
    return both[0].ravel(), both[1].ravel(), np.outer(ds, dt).ravel()


def fill(like: Array, vector: Any) -> Array:
    return np.tile(np.array(vector, float), (len(like), 1))


def dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=-1)


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def across(w: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a frame with `w`."""
    x = unit(np.cross(w, np.eye(3)[np.argmin(np.abs(w))]))
    return x, np.cross(w, x)
