"""Writes reference.csv, the fluxes of slabs that the stability rows compare with, by adding-doubling.

Needs numpy and scipy, and the folder that holds the solver slab_reference.py:

    python tests/stability/make_reference.py ../shared/reference
"""

import csv
import math
import sys
from itertools import product
from pathlib import Path

sys.path.insert(0, sys.argv[1])
from slab_reference import Slab

THICKNESSES = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0)
CASES = [
    # g, eta, albedo, thicknesses, light
    *product((0.0,), (1.0,), (1e-4, 0.05, 0.5, 0.9, 0.99, 0.99999, 1.0), (THICKNESSES,), ("diffuse",)),
    *product((-0.9, -0.5, 0.5, 0.9, 0.95), (1.0,), (0.05, 0.9), ((1.0, math.inf),), ("diffuse",)),
    *product((0.0,), (1.0001, 1.5, 2.4), (0.5, 0.9), ((math.inf,),), ("normal",)),
]
HEADER = """\
# Fluxes out of a slab (thickness tau mean free paths, Henyey-Greenstein g, smooth faces of index eta) per unit
# incident flux, by adding-doubling: python tests/stability/make_reference.py ../shared/reference
# R with the first reflection. error: largest relative difference of R and T to fewer quadrature nodes.
"""


def fluxes(slab, tau, light):
    solution = slab.solve(tau, light)
    return max(0.0, solution["spec"]) + solution["R_ms"], solution["T"]


def rows():
    for g, eta, albedo, thicknesses, light in CASES:
        fine, coarse = (Slab(albedo, eta, g, n=64 if abs(g) > 0.6 else n) for n in (40, 28))
        if abs(g) > 0.6:
            coarse = Slab(albedo, eta, g, n=48)
        for tau in thicknesses:
            a, b = fluxes(fine, tau, light), fluxes(coarse, tau, light)
            error = max((abs(y / x - 1) for x, y in zip(a, b, strict=True) if x > 1e-40), default=0.0)
            yield [g, eta, albedo, tau, light, f"{a[0]:.9e}", f"{a[1]:.9e}", f"{error:.0e}"]


with (Path(__file__).parent / "reference.csv").open("w", newline="") as file:
    file.write(HEADER)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["g", "eta", "albedo", "tau", "light", "R", "T", "error"])
    writer.writerows(rows())
