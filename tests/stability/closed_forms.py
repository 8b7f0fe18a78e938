"""What ought to be seen: closed forms, and the adding-doubling table."""

import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TABLE = Path(__file__).with_name("reference.csv")


@cache
def table() -> dict[tuple[float, float, float, float, str], tuple[float, float]]:
    """(g, eta, albedo, tau, light) -> (R, T)."""
    with TABLE.open() as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        keys = ("g", "eta", "albedo", "tau")
        return {(*(float(r[k]) for k in keys), r["light"]): (float(r["R"]), float(r["T"])) for r in rows}


def slab(
    albedo: float, tau: float, g: float = 0.0, eta: float = 1.0, light: str = "diffuse"
) -> tuple[float, float]:
    """Reflected and transmitted flux per incident flux."""
    return table()[g, eta, albedo, tau, light]


@cache
def h_nodes(albedo: float) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes and weights of a quadrature on [0, 1], Chandrasekhar's H there, isotropic scattering."""
    x, w = np.polynomial.legendre.leggauss(200)
    x = 0.5 * (x + 1)
    mu, w = x**3, 1.5 * x**2 * w  # denser at grazing angles, where H bends
    h, kernel = np.ones_like(mu), mu[None, :] / (mu[:, None] + mu[None, :]) * w
    for _ in range(100_000):
        last, h = h, 1.0 / (math.sqrt(max(0.0, 1.0 - albedo)) + 0.5 * albedo * kernel @ h)
        if np.abs(h - last).max() < 1e-13:
            break
    return mu, w, h


def h_function(albedo: float, mu: float) -> float:
    nodes, w, h = h_nodes(albedo)
    kernel = nodes / (mu + nodes) * w
    return float(1.0 / (math.sqrt(max(0.0, 1.0 - albedo)) + 0.5 * albedo * kernel @ h))


def half_space(albedo: float, mu: float | None = None) -> float:
    """Share of a beam of cosine `mu` (None: of diffuse light) that a half-space returns (Chandrasekhar 1960)."""
    albedo = float(np.float32(albedo))  # as the renderer has it: near 1 that matters
    loss = math.sqrt(max(0.0, 1.0 - albedo))
    if mu is not None:
        return 1.0 - h_function(albedo, mu) * loss
    nodes, w, h = h_nodes(albedo)
    return float(1.0 - 2.0 * (h * nodes * w).sum() * loss)


def half_space_radiance(albedo: float, mu: float, mu0: float) -> float:
    """Radiance of an index-matched half-space seen under `mu`, in a beam of `mu0` with irradiance 1 across it."""
    albedo = float(np.float32(albedo))
    h = h_function(albedo, mu) * h_function(albedo, mu0)
    return albedo * mu0 * h / (4.0 * math.pi * (mu + mu0))


def absorbing_sphere(depth: float) -> float:
    """Share of Lambertian light that crosses a sphere of optical diameter `depth` which only absorbs."""
    if depth < 1e-3:
        return 1.0 - 2.0 * depth / 3.0
    return 2.0 * (1.0 - (1.0 + depth) * math.exp(-depth)) / depth**2


def sphere_light(radius: float, distance: float, cosine: float = 1.0) -> float:
    """Irradiance from a sphere of radiance 1 that is wholly above the horizon."""
    return math.pi * cosine * (radius / distance) ** 2


def sphere_on_horizon(radius: float, distance: float) -> float:
    """Irradiance from a sphere of radiance 1 whose centre lies in the surface: the projected upper half of its cone."""
    s = math.asin(radius / distance)
    return s - math.sin(s) * math.cos(s)
