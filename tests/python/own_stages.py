"""What tests of usd_scenes share: stages with some of their prims, rays of their cameras, splines written down."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pinhole import Rays, rays
from pxr import Usd, UsdGeom

import dermis

SIZE = (64, 36)


def only(stage: Usd.Stage, *names: str) -> Usd.Stage:
    """Of the prims of /World, these, its cameras and its materials are left; edits are of the session."""
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in stage.GetPrimAtPath("/World").GetAllChildren():
        stays = prim.GetName() in names or prim.GetTypeName() in ("Camera", "Material", "Scope")
        prim.SetActive(stays)
    return stage


def opened(scenes: Path, name: str, *names: str) -> Usd.Stage:
    return only(Usd.Stage.Open(str(scenes / f"{name}.usda")), *names)


def eye(stage: Usd.Stage, per_axis: int = 6, size: tuple[int, int] = SIZE) -> Rays:
    """Rays of the camera of a stage, which is turned about X alone."""
    (prim,) = (prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera))
    camera = UsdGeom.Camera(prim)
    matrix = UsdGeom.XformCache().GetLocalToWorldTransform(prim)
    tilt = np.degrees(np.arctan2(matrix[1][2], matrix[1][1]))
    focal, aperture = camera.GetFocalLengthAttr().Get(), camera.GetHorizontalApertureAttr().Get()
    return rays(size, focal, aperture, tuple(matrix.ExtractTranslation()), tilt, per_axis)


def alpha(stage: Usd.Stage, samples: int = 256, **settings: object) -> NDArray:
    image = dermis.render(stage, resolution=SIZE, samples=samples, maxDepth=0, aovs=["alpha"], **settings)
    return image["alpha"][..., 0].astype(float)


def assert_covers(found: NDArray, expected: NDArray, rel: float, atol: float = 0.1) -> None:
    """The whole by `rel`; pixels at edges by the noise of their samples."""
    assert expected.sum() > 5.0, "the expected picture shows something"
    assert found.sum() == pytest.approx(expected.sum(), rel=rel)
    np.testing.assert_allclose(found, expected, atol=atol)


def along(points: NDArray, basis: str, wrap: str) -> NDArray:
    """Many points of a curve, from the definitions of UsdGeomBasisCurves: `points` may have any number of columns."""
    p = [*points]
    if wrap == "pinned":  # phantom points on the lines through the ends
        p = [2 * p[0] - p[1], *p, 2 * p[-1] - p[-2]]
    if wrap == "periodic":
        p = [*p, *p[:3]]
    u = np.linspace(0, 1, 33)[:, None]
    if basis == "linear":
        return np.concatenate([(1 - u) * a + u * b for a, b in pairwise(p)])
    step = 3 if basis == "bezier" else 1
    weights = {
        "bezier": ((1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u * u * (1 - u), u**3),
        "bspline": (
            (1 - u) ** 3 / 6,
            (3 * u**3 - 6 * u * u + 4) / 6,
            (3 * u * u - 3 * u**3 + 3 * u + 1) / 6,
            u**3 / 6,
        ),
        "catmullRom": (
            (2 * u * u - u - u**3) / 2,
            (3 * u**3 - 5 * u * u + 2) / 2,
            (4 * u * u + u - 3 * u**3) / 2,
            (u**3 - u * u) / 2,
        ),
    }[basis]
    segments = range(0, len(p) - 3, step)
    return np.concatenate([sum(w * c for w, c in zip(weights, p[i : i + 4], strict=True)) for i in segments])
