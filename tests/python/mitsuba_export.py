"""A flattened stage as a Mitsuba 3 scene, for a second opinion on the same radiance.

Written from the specifications of UsdGeomCamera and UsdLux and from the definition of dermis' subsurface inputs,
not from dermis' core. What cannot be said exactly in Mitsuba raises ValueError: a comparison of two different
scenes would be worth nothing.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis.stage import FlatStage

Fields = dict[str, Any]
Matrix = NDArray[np.float64]
"""4 x 4, for column vectors: the transpose of USD's."""

TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Half a turn about Y: USD's cameras and lights look along -Z, Mitsuba's along +Z."""


def scene_dicts(flat: FlatStage, folder: Path) -> list[Fields]:
    """Scenes for `mitsuba.load_dict` (RGB variants), one for each light: the image of the stage is the sum of theirs.

    Not one scene with all lights, because dermis' lights block nothing and reflect nothing, and Mitsuba's nearest
    equivalent, an area light with a `null` BSDF, keeps part of a dome's light from coming through (volpathmis 3.9.1:
    a white furnace with a rectangle in it that does not even shine comes out at 0.996; without, at 1).
    Lights are visible to the camera, the dome included: `visibility:camera` must be on.
    Meshes are written to `folder` as PLY files. Raises ValueError for whatever has no equivalent.
    """
    # Roulette later than the default 5: it ends long walks without most of its noise.
    integrator = {"type": "volpathmis", "max_depth": -1, "rr_depth": 16, "hide_emitters": False}
    common: Fields = {"type": "scene", "integrator": integrator, "sensor": sensor(flat)}
    lights = []
    for number, (path, prim) in enumerate(flat.prims.items()):
        match prim["type"]:
            case "Mesh" if prim["visible"]:
                common[f"mesh{number}"] = mesh(flat, path, folder / f"mesh{number}.ply")
            case "Light" if prim["visible"]:
                lights.append(light(prim, path))
            case "Mesh" | "Light" | "Camera" | "Material":
                pass
            case other:
                raise ValueError(f"{path}: {other} is not exported")
    return [{**common, "light": fields} for fields in lights]


def require(value: Any, path: str, name: str, holds: bool) -> None:
    if not holds:
        raise ValueError(f"{path}: {name} {value} has no equivalent in Mitsuba")


def matrix(prim: Fields) -> Matrix:
    return np.array(prim["transform"], dtype=np.float64).reshape(4, 4).T


def transform(columns: Matrix) -> Any:
    import mitsuba as mi

    return mi.ScalarTransform4f(columns)


def rgb(values: Any) -> Fields:
    return {"type": "rgb", "value": [float(value) for value in values]}


# Camera and film.


def sensor(flat: FlatStage) -> Fields:
    """The render camera with the film of the settings. Both pixel filters are tents of radius 1 pixel."""
    path = flat.settings["camera"]
    camera, (width, height) = flat.prims[path], flat.settings["resolution"]
    require(camera["projection"], path, "projection", camera["projection"] == "perspective")
    require(camera["fStop"], path, "fStop", camera["fStop"] == 0.0)
    require(camera["exposureScale"], path, "exposure", camera["exposureScale"] == 1.0)
    for name in ("horizontalApertureOffset", "verticalApertureOffset"):
        require(camera[name], path, name, camera[name] == 0.0)
    policy = flat.settings.get("aspectRatioConformPolicy", "expandAperture")
    require(policy, path, "aspectRatioConformPolicy", policy == "expandAperture")
    # expandAperture: the smaller of the two grows until the window has the image's aspect.
    aperture = max(camera["horizontalAperture"], camera["verticalAperture"] * width / height)
    near, far = camera["clippingRange"]
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "tent", "radius": 1.0},
        # Pixels at the edge gather as far as the others.
        "sample_border": True,
    }
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": math.degrees(2.0 * math.atan(0.5 * aperture / camera["focalLength"])),
        "near_clip": near,
        "far_clip": far,
        "to_world": transform(matrix(camera) @ TURN),
        "sampler": {"type": "independent"},
        "film": film,
    }


# Bodies.


def mesh(flat: FlatStage, path: str, file: Path) -> Fields:
    """A flat-shaded mesh filled with a medium; its triangles go to `file`."""
    prim = flat.prims[path]
    for name in ("normals", "instancer", "geomSubsets", "holeIndices"):
        require(name, path, "mesh with", not prim.get(name))
    require(prim["subdivisionScheme"], path, "subdivisionScheme", prim["subdivisionScheme"] == "none")
    require(prim["material"], path, "material", bool(prim["material"]))
    write_ply(file, prim)
    material = flat.prims[prim["material"]]
    return {
        "type": "ply",
        "filename": str(file),
        "face_normals": True,
        "bsdf": boundary(material, prim["material"]),
        "interior": medium(material, prim["material"]),
    }


def write_ply(file: Path, prim: Fields) -> None:
    """World-space triangles; polygons as fans, which needs them convex."""
    linear, shift = matrix(prim)[:3, :3], matrix(prim)[:3, 3]
    points = prim["points"] @ linear.T + shift
    triangles = fan(prim["faceVertexCounts"], prim["faceVertexIndices"])
    if (prim["orientation"] == "leftHanded") != (np.linalg.det(linear) < 0.0):
        triangles = triangles[:, ::-1]
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    faces["count"], faces["indices"] = 3, triangles
    file.write_bytes(header.encode() + points.astype("<f4").tobytes() + faces.tobytes())


def fan(counts: NDArray[np.int32], indices: NDArray[np.int32]) -> NDArray[np.int32]:
    starts = np.cumsum(counts) - counts
    corners = [
        (start, start + i, start + i + 1)
        for start, count in zip(starts, counts, strict=True)
        for i in range(1, count - 1)
    ]
    return indices[np.array(corners)]


def boundary(material: Fields, path: str) -> Fields:
    kind, share = material["subsurfaceBoundary"], material.get("subsurface", 0.0)
    require(share, path, "subsurface", material["shader"] == "UsdPreviewSurface" and share == 1.0)
    for name in ("metallic", "clearcoat"):
        require(material.get(name), path, name, material.get(name, 0.0) == 0.0)
    require(kind, path, "subsurfaceBoundary", kind in ("indexMatched", "dielectric"))
    if kind == "indexMatched":
        return {"type": "null"}
    return {
        "type": "roughdielectric",
        "distribution": "ggx",
        "alpha": material["roughness"] ** 2,
        "int_ior": material["ior"],
        "ext_ior": 1.0,
    }


def medium(material: Fields, path: str) -> Fields:
    """sigma_t = 1 / (subsurfaceRadius subsurfaceScale); the albedo is that of a single scattering."""
    require(None, path, "colour inversion", "subsurfaceAlbedo" in material)
    radius = np.array(material["subsurfaceRadius"]) * material.get("subsurfaceScale", 1.0)
    sigma_t = 1.0 / radius
    # Mitsuba's rgb values outside of emitters stay within [0, 1]; `scale` is the rest.
    return {
        "type": "homogeneous",
        "sigma_t": rgb(sigma_t / sigma_t.max()),
        "scale": float(sigma_t.max()),
        "albedo": rgb(material["subsurfaceAlbedo"]),
        "phase": {"type": "hg", "g": material.get("subsurfaceAnisotropy", 0.0)},
    }


# Lights.


def light(prim: Fields, path: str) -> Fields:
    require(prim["cameraVisible"], path, "visibility:camera", prim["cameraVisible"])
    require(prim["shaping"], path, "shaping", prim["shaping"] is None)
    shape = prim["shape"]
    require(shape.get("texture"), path, "texture", not shape.get("texture"))
    if shape["kind"] == "dome":
        return {"type": "constant", "radiance": rgb(radiance(prim, 1.0))}
    require(shape["kind"], path, "light", shape["kind"] in SHAPES)
    fields, area = SHAPES[shape["kind"]](shape, matrix(prim))
    emitter = {"type": "area", "radiance": rgb(radiance(prim, area))}
    return {**fields, "emitter": emitter, "bsdf": {"type": "null"}}


def radiance(prim: Fields, area: float) -> Matrix:
    """intensity 2^exposure color, over the area if normalised (UsdLuxLightAPI)."""
    scale = prim["intensity"] * 2.0 ** prim["exposure"] / (area if prim["normalize"] else 1.0)
    tint = prim["blackbody"] if prim["enableColorTemperature"] else (1.0, 1.0, 1.0)
    return scale * np.array(prim["color"]) * np.array(tint)


def rect(shape: Fields, to_world: Matrix) -> tuple[Fields, float]:
    edges = to_world @ TURN @ np.diag([0.5 * shape["width"], 0.5 * shape["height"], 1.0, 1.0])
    return {"type": "rectangle", "to_world": transform(edges)}, 4.0 * spanned(edges)


def disk(shape: Fields, to_world: Matrix) -> tuple[Fields, float]:
    axes = to_world @ TURN @ np.diag([shape["radius"], shape["radius"], 1.0, 1.0])
    return {"type": "disk", "to_world": transform(axes)}, math.pi * spanned(axes)


def sphere(shape: Fields, to_world: Matrix) -> tuple[Fields, float]:
    scales = np.linalg.norm(to_world[:3, :3], axis=0)
    if np.ptp(scales) > 1e-6 * scales.max():
        raise ValueError(f"an ellipsoid (scale {scales}) has no equivalent in Mitsuba")
    radius = float(shape["radius"] * scales[0])
    fields = {"type": "sphere", "center": [float(x) for x in to_world[:3, 3]], "radius": radius}
    return fields, 4.0 * math.pi * radius**2


def spanned(columns: Matrix) -> float:
    """Area of the parallelogram of the images of X and Y."""
    return float(np.linalg.norm(np.cross(columns[:3, 0], columns[:3, 1])))


SHAPES: dict[str, Callable[[Fields, Matrix], tuple[Fields, float]]] = {
    "rect": rect,
    "disk": disk,
    "sphere": sphere,
}
