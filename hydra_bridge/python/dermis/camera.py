"""UsdGeomCamera, and usdrecord's rules for finding one or framing the stage without."""

import math
from typing import Any

from pxr import Gf, Tf, Usd, UsdGeom

from .index import index_of
from .reading import Reader, Report, finite

APERTURES = {
    "horizontalAperture": 20.955,
    "verticalAperture": 15.2908,
    "horizontalApertureOffset": 0.0,
    "verticalApertureOffset": 0.0,
    "focalLength": 50.0,
}
"""Tenths of a stage unit; UsdGeomCamera's defaults."""


def flatten_camera(prim: Usd.Prim, reader: Reader, matrix: Gf.Matrix4d) -> dict[str, Any]:
    """Fields of `flat::Camera`; `matrix` is local to world."""
    projection = reader.value(prim, "projection", "perspective")
    if projection not in ("perspective", "orthographic"):
        reader.warn(prim, f"projection: '{projection}' is not supported; 'perspective' is used")
        projection = "perspective"
    if reader.raw(prim, "clippingPlanes"):
        reader.warn(prim, "clippingPlanes: not supported; ignored")
    return {
        "type": "Camera",
        "transform": reader.matrix(prim, matrix),
        "projection": projection,
        **{name: reader.value(prim, name, default) for name, default in APERTURES.items()},
        "clippingRange": list(reader.value(prim, "clippingRange", (1.0, 1_000_000.0))),
        "fStop": reader.value(prim, "fStop", 0.0),
        "focusDistance": reader.value(prim, "focusDistance", 0.0),
        "exposureScale": exposure_scale(prim, reader),
        "shutter": list(find_shutter(prim, reader)),
    }


def find_shutter(camera: Usd.Prim, reader: Reader) -> tuple[float, float]:
    """`shutter:open` and `shutter:close`; (0, 0) where there are no usable ones."""
    if reader.time.IsDefault() or reader.time.IsEarliestTime():
        return 0.0, 0.0
    opens, closes = (reader.value(camera, f"shutter:{name}", 0.0) for name in ("open", "close"))
    if closes < opens:
        reader.warn(camera, f"shutter:close: {closes:g} is before shutter:open, {opens:g}; nothing moves")
        return 0.0, 0.0
    return opens, closes


def exposure_scale(prim: Usd.Prim, reader: Reader) -> float:
    """`UsdGeomCamera.ComputeLinearExposureScale`: responsivity * time * iso / 100 * 2^exposure / fStop^2.

    The formula is repeated here because USD's own call fails on an authored value of the wrong type.
    """
    exposure = reader.value(prim, "exposure", 0.0)
    time = reader.value(prim, "exposure:time", 1.0)
    iso = reader.value(prim, "exposure:iso", 100.0)
    f_stop = reader.value(prim, "exposure:fStop", 1.0)
    responsivity = reader.value(prim, "exposure:responsivity", 1.0)
    try:
        return finite(responsivity * time * iso / 100.0 * 2.0**exposure / f_stop**2)
    except (ArithmeticError, ValueError):
        reader.warn(prim, "exposure: the exposure attributes give no finite scale; 1 is used")
        return 1.0


def find_camera(stage: Usd.Stage, name_or_path: str = "") -> UsdGeom.Camera | None:
    """usdrecord's search: a path is taken exactly, a bare name is any prim's of that name; default
    `main_cam`."""
    if not name_or_path:
        from pxr import UsdUtils  # takes as long to load as a small stage

        name_or_path = UsdUtils.GetPrimaryCameraName()
    if "/" in name_or_path:
        prim = stage.GetPrimAtPath(name_or_path) if name_or_path.startswith("/") else Usd.Prim()
        return UsdGeom.Camera(prim) if prim and prim.IsA(UsdGeom.Camera) else None
    found = index_of(stage).cameras(stage, name_or_path)
    if len(found) > 1:  # the first that usdrecord comes across
        alike, every = set(found), stage.Traverse(Usd.TraverseInstanceProxies())
        found = [next(prim for prim in every if prim in alike)]
    return UsdGeom.Camera(found[0]) if found else None


def camera_fields(camera: UsdGeom.Camera, time: Usd.TimeCode, report: Report | None = None) -> dict[str, Any]:
    """A camera of the stage as `flat::Camera` by itself, for a camera that the walk does not reach."""
    prim, reader = camera.GetPrim(), Reader(time, report or Report())
    compute = UsdGeom.XformCache(time).GetLocalToWorldTransform
    return flatten_camera(prim, reader, reader.transform(prim, compute, Gf.Matrix4d(1.0)))


def auto_camera(
    stage: Usd.Stage, time: Usd.TimeCode, purposes: tuple[str, ...], aspect: float | None = None
) -> dict[str, Any]:
    """usdrecord's framing of a stage without camera: 50 mm, the whole world bound in view.

    `aspect` (width over height) changes the vertical aperture only, as usdrecord frames by width.
    """
    bounds = world_bounds(stage, UsdGeom.BBoxCache(time, sorted({"default", *purposes}), useExtentsHint=True))
    center, size = (
        (Gf.Vec3d(0.0), Gf.Vec3d(0.0)) if bounds.IsEmpty() else (bounds.GetMidpoint(), bounds.GetSize())
    )
    camera = Gf.Camera()
    z_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    camera.transform = framing(camera, center, size, z_up)
    if aspect:
        camera.verticalAperture = camera.horizontalAperture / aspect
    return {
        "type": "Camera",
        "transform": [list(row) for row in camera.transform],
        "projection": "perspective",
        **{name: getattr(camera, name) for name in APERTURES},
        "clippingRange": [camera.clippingRange.min, camera.clippingRange.max],
        "fStop": 0.0,
        "focusDistance": 0.0,
        "exposureScale": 1.0,
    }


def world_bounds(stage: Usd.Stage, cache: UsdGeom.BBoxCache) -> Gf.Range3d:
    """Of the whole stage; where damage spoils that, of the prims that are sound. Empty for an empty stage."""
    whole = sound_bounds(stage.GetPseudoRoot(), cache)
    if whole is not None:
        return whole
    bounds = Gf.Range3d()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Gprim) and (part := sound_bounds(prim, cache)) is not None:
            bounds.UnionWith(part)
    return bounds


def sound_bounds(prim: Usd.Prim, cache: UsdGeom.BBoxCache) -> Gf.Range3d | None:
    """World bounds of a prim; None where they are not finite or cannot be computed."""
    try:
        bounds = cache.ComputeWorldBound(prim).ComputeAlignedRange()
    except Tf.ErrorException:
        return None
    ends = (*bounds.min, *bounds.max)
    # USD's empty range goes from the largest float to its negative: no infinity there.
    return bounds if all(math.isfinite(x) for x in ends) else None


def framing(camera: Gf.Camera, center: Gf.Vec3d, size: Gf.Vec3d, z_up: bool) -> Gf.Matrix4d:
    """Local to world of a camera that sees a box: along -Z, or along +Y in a Z-up world."""
    height, depth = (size[2], size[1]) if z_up else (size[1], size[2])
    radius = Gf.Vec2d(size[0], height).GetLength() / 2
    half_angle = Gf.DegreesToRadians(camera.GetFieldOfView(Gf.Camera.FOVHorizontal) / 2)
    distance = radius / math.tan(half_angle) + depth / 2
    # A small object that fills its box would reach through the near plane.
    near = camera.clippingRange.min
    distance += near if distance < near else 0.0
    if not z_up:
        return Gf.Matrix4d(1.0).SetTranslate(center + Gf.Vec3d(0, 0, distance))
    turned = Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), 90))
    return turned.SetTranslateOnly(center - Gf.Vec3d(0, distance, 0))
