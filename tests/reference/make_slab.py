"""Writes slab.csv, the fluxes of slabs that tests/guided_slabs.rs compares with, by adding-doubling.

Needs numpy and scipy, and the folder that holds the solver slab_reference.py:

    python tests/reference/make_slab.py ../shared/reference
"""

import csv
import sys
from itertools import product
from pathlib import Path

sys.path.insert(0, sys.argv[1])
from slab_reference import Slab

GS = (0.0, 0.5, 0.8, -0.4)
ETAS = (1.0, 1.4)
ALBEDOS = (0.0, 0.05, 0.5, 0.8, 0.95, 0.99, 0.999, 1.0)
THICKNESSES = (0.01, 0.1, 1.0, 10.0, 50.0)
HEADER = """\
# Fluxes out of a slab (thickness tau mean free paths, Henyey-Greenstein g, smooth faces of index eta) per unit
# incident flux, by adding-doubling: python tests/reference/make_slab.py ../shared/reference
# R with the first reflection. error: largest relative difference of R and T to fewer quadrature nodes.
"""


def fluxes(slab, tau, light, operators):
    solution = slab.solve(tau, light, operators)
    return max(0.0, solution["spec"]) + solution["R_ms"], solution["T"]


def rows():
    for g, eta, albedo in product(GS, ETAS, ALBEDOS):
        if albedo == 0.0 and g != 0.0:
            continue  # the phase function does not matter
        fine, coarse = Slab(albedo, eta, g, n=32), Slab(albedo, eta, g, n=22)
        for tau in THICKNESSES:
            operators = fine.ops(tau), coarse.ops(tau)
            for light in ("diffuse", "normal"):
                a, b = fluxes(fine, tau, light, operators[0]), fluxes(coarse, tau, light, operators[1])
                error = max(abs(y / x - 1) for x, y in zip(a, b, strict=True) if x > 0.0)
                yield [g, eta, albedo, tau, light, f"{a[0]:.9e}", f"{a[1]:.9e}", f"{error:.0e}"]


with (Path(__file__).parent / "slab.csv").open("w", newline="") as file:
    file.write(HEADER)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["g", "eta", "albedo", "tau", "light", "R", "T", "error"])
    writer.writerows(rows())
