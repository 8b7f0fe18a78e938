"""Curves and points of usd_scenes against rays near lines and spheres, and the definitions of the bases."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from own_stages import SIZE, along, alpha, assert_covers, eye, opened
from pinhole import Rays
from pxr import Usd, UsdGeom

import dermis
from dermis.stage import flatten


def curve_of(stage: Usd.Stage, name: str) -> tuple[UsdGeom.BasisCurves, NDArray, str, str]:
    prim = UsdGeom.BasisCurves.Get(stage, f"/World/{name}")
    place = UsdGeom.XformCache().GetLocalToWorldTransform(prim.GetPrim()).ExtractTranslation()
    basis = "linear" if prim.GetTypeAttr().Get() == "linear" else prim.GetBasisAttr().Get()
    return prim, np.array(prim.GetPointsAttr().Get(), float) + place, basis, prim.GetWrapAttr().Get()


def tube(sight: Rays, line: NDArray, radius: float, closed: bool) -> NDArray:
    """Pixels of a round tube with flat ends: rays nearer to the line than its radius, not beyond its ends."""
    nearest = np.full(sight.d.shape[:-1], np.inf)
    inside = np.zeros(sight.d.shape[:-1], bool)
    for i, (a, b) in enumerate(pairwise(line)):
        if (a == b).all():
            continue
        # The segment and the ray as two lines: least |a + s e - o - t d|.
        e, w = b - a, a - sight.o
        de, dw, ew, ee = sight.d @ e, sight.d @ w, e @ w, e @ e
        free = (de * dw - ew) / (ee - de * de)
        s = np.clip(free, 0, 1)
        gap = w + s[..., None] * e
        distance = np.linalg.norm(gap - (gap * sight.d).sum(-1, keepdims=True) * sight.d, axis=-1)
        beyond = ((i == 0) & (free < 0)) | ((i == len(line) - 2) & (free > 1))
        better = distance < nearest
        nearest = np.where(better, distance, nearest)
        inside = np.where(better, closed | ~beyond, inside)
    covered = inside & (nearest < radius)
    for end, other in ((line[0], line[1]), (line[-1], line[-2])):
        normal = (end - other) / np.linalg.norm(end - other)
        hit = sight.o + ((end - sight.o) @ normal / (sight.d @ normal))[..., None] * sight.d
        covered |= (np.linalg.norm(hit - end, axis=-1) < radius) & (not closed)
    return sight.mean(covered.astype(float))


@pytest.mark.parametrize("name", ["linear", "bezier", "bspline", "catmullRom", "Ring"])
def test_curves_cover_what_their_tubes_do(usd_scenes, name):
    stage = opened(usd_scenes, "curves", name)
    prim, points, basis, wrap = curve_of(stage, name)
    line = along(points, basis, wrap)
    line = points if basis == "linear" else line[np.r_[: len(line) - 1 : 3, -1]]
    expected = tube(eye(stage, 8), line, prim.GetWidthsAttr().Get()[0] / 2, wrap == "periodic")
    found = alpha(stage, 512)
    if basis == "linear":
        # Joints are mitred, those of this sum are round: only the tips differ.
        sight = eye(stage)
        ways = [np.linalg.norm(np.cross(p - sight.o, sight.d), axis=-1) for p in points[1:-1]]
        tips = np.min(ways, axis=(0, 1)) < 0.2
        assert found[tips].sum() == pytest.approx(expected[tips].sum(), rel=0.2)
        found[tips] = expected[tips] = 0.0
    assert_covers(found, expected, 0.03 if basis == "linear" else 0.02, 0.13)


def test_the_ribbon_faces_along_its_normals(usd_scenes):
    """Both edges are half a width from the curve, square to it and to the normals."""
    stage = opened(usd_scenes, "curves", "Ribbon")
    prim, points, basis, wrap = curve_of(stage, "Ribbon")
    line = along(points, basis, wrap)
    normal = along(np.array(prim.GetNormalsAttr().Get(), float), basis, wrap)
    keep = np.r_[True, np.abs(np.diff(line, axis=0)).sum(1) > 0]
    line, normal = line[keep], normal[keep]
    left, right = (
        flatten(stage).prims["/World/Ribbon"]["points"].astype(float).reshape(-1, 2, 3).swapaxes(0, 1)
    )
    line = line - [3.2, 0, 0]
    np.testing.assert_allclose(np.linalg.norm(right - left, axis=1), 0.5, rtol=1e-4)
    ways = np.linalg.norm((0.5 * (left + right))[:, None] - line, axis=2)
    at = ways.argmin(1).clip(1, len(line) - 2)
    assert len(at) > 30 and ways.min(1).max() < 0.03 and np.ptp(at) > len(line) - 5
    for across in (normal[at], line[at + 1] - line[at - 1]):
        cosine = ((right - left) * across).sum(1) / 0.5 / np.linalg.norm(across, axis=1)
        assert np.abs(cosine).max() < 0.06


def area(mesh: dict) -> float:
    points, counts = mesh["points"].astype(float), mesh["faceVertexCounts"]
    first, total = np.cumsum(counts) - counts, 0.0
    for i in range(1, counts.max() - 1):
        a, b, c = (
            points[mesh["faceVertexIndices"][first[counts > i + 1] + corner]] for corner in (0, i, i + 1)
        )
        total += 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    return float(total)


def test_the_tuft_tapers_and_its_colours_run_along_it(usd_scenes):
    """Its area is that of round tubes of the widths between, and the colour of each point that of its height: both
    run along a hair as its points do."""
    stage = opened(usd_scenes, "curves", "Tuft")
    prim, points, basis, wrap = curve_of(stage, "Tuft")
    widths = np.array(prim.GetWidthsAttr().Get(), float).reshape(-1, 5, 1)
    expected = 0.0
    for hair, width in zip(points.reshape(-1, 5, 3), widths, strict=True):
        line, across = along(hair, basis, wrap), along(width, basis, wrap)[:, 0]
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        expected += np.pi * (steps * (across[1:] + across[:-1]) / 2).sum()
    mesh = flatten(stage).prims["/World/Tuft"]
    assert area(mesh) == pytest.approx(expected, rel=0.02)
    color = mesh["displayColor"]["values"]
    if (indices := mesh["displayColor"].get("indices")) is not None:
        color = color[indices]
    hair = along(points[:5], basis, wrap)
    shade = along(np.array(UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(), float)[:5], basis, wrap)
    # Every hair is as high; a ring of a tube lies up to half a width above or below its middle.
    height = hair[:, 1] - hair[0, 1]
    got_height = mesh["points"][:, 1]
    for i in range(3):
        by_height = np.interp(got_height, height, shade[:, i])
        assert np.abs(color[:, i] - by_height).max() < 0.02
    assert np.ptp(color[:, 0]) == pytest.approx(0.4, abs=1e-3)


# Points


def test_points_cover_their_discs_in_their_colours(usd_scenes):
    """The nearest sphere along each ray: alpha, and the colour of each point."""
    stage = opened(usd_scenes, "points", "Spiral")
    prim = UsdGeom.Points.Get(stage, "/World/Spiral")
    points, widths = (np.array(a.Get(), float) for a in (prim.GetPointsAttr(), prim.GetWidthsAttr()))
    colors = np.array(UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(), float)
    sight = eye(stage, 8)
    nearest = np.full(sight.d.shape[:-1], np.inf)
    color = np.zeros(sight.d.shape)
    for point, width, tint in zip(points, widths, colors, strict=True):
        to = point - sight.o
        b = sight.d @ to
        square = b * b - to @ to + (width / 2) ** 2
        t = b - np.sqrt(np.maximum(square, 0))
        closer = (square > 0) & (t < nearest)
        nearest, color = np.where(closer, t, nearest), np.where(closer[..., None], tint, color)
    name = "primvars:displayColor"
    image = dermis.render(stage, resolution=SIZE, samples=512, maxDepth=0, aovs=["alpha", name])
    covered = sight.mean(np.isfinite(nearest).astype(float))
    assert_covers(image["alpha"][..., 0].astype(float), covered, 0.015, 0.15)
    found, expected = image[name].astype(float), sight.mean(color)
    np.testing.assert_allclose(found.sum((0, 1)), expected.sum((0, 1)), rtol=0.02)
    assert np.abs(found - expected).mean() < 0.01
