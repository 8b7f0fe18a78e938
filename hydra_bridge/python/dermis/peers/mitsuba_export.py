"""A flattened scene for Mitsuba 3 (RGB variants), as JSON that `mitsuba_worker` hands to `mitsuba.load_dict`.

Where plain JSON has no word for it: `{"matrix": rows}` is a transform, `{"image": FILE.npy}` a bitmap.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..stage import FlatStage
from .appearance import (
    ExportError,
    Fields,
    Matrix,
    Medium,
    View,
    diffuse_color,
    distant_irradiance,
    dome_turn,
    lights_of,
    lights_seen,
    matrix,
    medium_of,
    radiance,
    require,
    spanned,
    surface_of,
    uniform_scale,
    view_of,
)
from .geometry import Triangles, triangles_of

#: Half a turn about Y: USD's cameras and lights look along -Z, Mitsuba's along +Z.
TURN = np.diag([-1.0, 1.0, -1.0, 1.0])


@dataclass
class Exported:
    #: JSON for the worker.
    description: Fields
    #: In what the peer's model differs from dermis'; empty: both converge to one picture.
    differences: list[str] = field(default_factory=list)

    def differs(self, what: str) -> None:
        if what not in self.differences:
            self.differences.append(what)


def export(flat: FlatStage, folder: Path, integrator: str = "volpath") -> Exported:
    """The scene; meshes and images go to `folder`. `integrator`: `volpath` or `volpathmis`.

    Raises ExportError for whatever has no equivalent.
    """
    lights = lights_of(flat)
    view = view_of(flat)
    scene: Fields = {
        "type": "scene",
        # Russian roulette as Mitsuba has it by default: from the fifth scattering on at least one walk in twenty ends,
        # so that in a thick white medium few and heavy ones carry the light.
        "integrator": {"type": integrator, "max_depth": -1, "hide_emitters": not lights_seen(lights)},
    }
    exported = Exported({"scene": scene, "sensor": sensor(view), "exposure": view.exposure})
    for number, (path, prim) in enumerate(flat.prims.items()):
        if prim["type"] == "Mesh" and prim["visible"]:
            scene[f"mesh{number}"] = mesh(flat, path, folder / f"mesh{number}.ply", exported)
        elif path in lights:
            scene[f"light{number}"] = light(flat, path, folder / f"light{number}.npy", exported)
    if sum(prim["shape"]["kind"] == "dome" for prim in lights.values()) > 1:
        raise ExportError("several dome lights: Mitsuba takes one")
    return exported


def export_mis(flat: FlatStage, folder: Path) -> Exported:
    """For `volpathmis`, which weighs the distances of all channels where `volpath` draws one channel's."""
    exported = export(flat, folder, "volpathmis")
    # A white sphere in a white furnace, 3.9.1: 0.9978 at 1 mean free path, 0.984 at 16; `volpath` 0.9998.
    exported.differs("volpathmis loses up to 2 % of the light in white media")
    return exported


def transform(columns: Matrix) -> Fields:
    return {"matrix": columns.tolist()}


def rgb(values: Any) -> Fields:
    return {"type": "rgb", "value": [float(value) for value in values]}


def sensor(view: View) -> Fields:
    """The camera, with a film whose crop is the worker's. Both pixel filters are tents of radius 1 pixel."""
    width, height = view.resolution
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
    near, far = view.clipping
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": view.fov_x,
        "near_clip": near,
        "far_clip": far,
        "to_world": transform(view.to_world @ TURN),
        "sampler": {"type": "independent"},
        "film": film,
    }


# Bodies.


def mesh(flat: FlatStage, path: str, file: Path, exported: Exported) -> Fields:
    """Triangles in `file`, their surface, and the medium within."""
    prim = flat.prims[path]
    triangles = triangles_of(prim, path, flat.settings.get("refineLevel", 0))
    write_ply(file, triangles)
    material, where = surface_of(flat, prim)
    medium = medium_of(material, flat.settings.get("subsurfaceBoundary", "auto"))
    fields: Fields = {"type": "ply", "filename": str(file), "face_normals": triangles.normals is None}
    if medium is None:
        reflectance = rgb(diffuse_color(material, prim, where))
        exported.differs("opaque surfaces are Lambertian, without UsdPreviewSurface's specular lobe")
        return {
            **fields,
            "bsdf": {"type": "twosided", "nested": {"type": "diffuse", "reflectance": reflectance}},
        }
    if medium.boundary == "dielectric" and triangles.smooth:
        # The Stanford dragon in a grey sky: Mitsuba 2 to 3 % brighter with its normals, equal within 0.6 % without.
        exported.differs("interpolated normals refract otherwise where they disagree with the faces")
    return {**fields, "bsdf": boundary(medium, exported), "interior": interior(medium)}


def write_ply(file: Path, triangles: Triangles) -> None:
    columns, names = [triangles.points], ["x", "y", "z"]
    if triangles.normals is not None:
        columns, names = [*columns, triangles.normals], [*names, "nx", "ny", "nz"]
    vertices = np.concatenate(columns, axis=1).astype("<f4")
    properties = "".join(f"property float {name}\n" for name in names)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(triangles.corners)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles.corners), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    faces["count"], faces["indices"] = 3, triangles.corners
    file.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())


def boundary(medium: Medium, exported: Exported) -> Fields:
    match medium.boundary:
        case "indexMatched":
            return {"type": "null"}
        case "diffuse":
            if medium.ior != 1.0:
                exported.differs("no specular lobe above a diffuse boundary")
            # A thin sheet that only transmits, and that diffusely: cos / pi of the other side, to the digit.
            return {
                "type": "principledthin",
                "base_color": rgb([1.0] * 3),
                "diff_trans": 2.0,
                "spec_trans": 0.0,
            }
    iors = {"int_ior": medium.ior, "ext_ior": 1.0}
    if medium.smooth:
        return {"type": "dielectric", **iors}
    exported.differs("a rough dielectric loses what scatters between its facets; dermis' gives it back")
    return {"type": "roughdielectric", "distribution": "ggx", "alpha": medium.roughness**2, **iors}


def interior(medium: Medium) -> Fields:
    sigma_t = 1.0 / np.array(medium.radius)
    # Mitsuba's rgb values outside of emitters stay within [0, 1]; `scale` is the rest.
    return {
        "type": "homogeneous",
        "sigma_t": rgb(sigma_t / sigma_t.max()),
        "scale": float(sigma_t.max()),
        "albedo": rgb(medium.albedo),
        "phase": {"type": "hg", "g": medium.g},
    }


# Lights.


def light(flat: FlatStage, path: str, file: Path, exported: Exported) -> Fields:
    prim = flat.prims[path]
    shape = prim["shape"]
    match shape["kind"]:
        case "dome":
            require(prim["shaping"] is None, path, "shaping", "of a dome")
            return dome(flat, prim, file)
        case "distant":
            require(prim["shaping"] is None, path, "shaping", "of a distant light")
            if shape["angle"] > 0.0:
                exported.differs(f"{path}: its angle of {shape['angle']:g} degrees is 0")
            fields = {"type": "directional", "irradiance": rgb(distant_irradiance(prim))}
            return {**fields, "to_world": transform(matrix(prim) @ TURN)}
    require(shape["kind"] in SHAPES, path, "light shape", shape["kind"])
    fields, area = SHAPES[shape["kind"]](prim, path)
    emitted = radiance(prim, area)
    if prim["shaping"] is not None:
        return spot(prim, path, area, exported)
    # A `null` BSDF: dermis' lights block nothing and reflect nothing.
    return {**fields, "emitter": {"type": "area", "radiance": rgb(emitted)}, "bsdf": {"type": "null"}}


def dome(flat: FlatStage, prim: Fields, file: Path) -> Fields:
    texture = prim["shape"]["texture"]
    if not texture:
        return {"type": "constant", "radiance": rgb(radiance(prim, 1.0))}
    image = flat.prims[texture]
    pixels = image["pixels"].reshape(image["height"], image["width"], 3)
    np.save(file, (pole_to_pole(pixels) * np.array(radiance(prim, 1.0))).astype(np.float32))
    # Mitsuba's map too has its pole at +Y, the middle of the image at +Z and +X to its left.
    return {"type": "envmap", "bitmap": {"image": str(file)}, "to_world": transform(dome_turn(prim))}


def pole_to_pole(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Twice the rows and one, the same function of the latitude.

    Mitsuba's first and last row lie at the poles, dermis' (and everyone's) end there: edges and centres of the rows
    are places where a piecewise linear function may be sampled without changing it.
    """
    padded = np.concatenate([pixels[:1], pixels, pixels[-1:]])
    rows = np.empty((2 * len(pixels) + 1, *pixels.shape[1:]), dtype=np.float32)
    rows[0::2], rows[1::2] = 0.5 * (padded[:-1] + padded[1:]), pixels
    return rows


def spot(prim: Fields, path: str, area: float, exported: Exported) -> Fields:
    """A point with the cone of a disk or rectangle: the nearest that Mitsuba has to UsdLuxShapingAPI."""
    shaping, shape = prim["shaping"], prim["shape"]["kind"]
    require(shape in ("disk", "rect"), path, "shaping of a", shape)
    require(shaping["focus"] == 0.0, path, "shaping:focus", shaping["focus"])
    require(0.0 < shaping["coneAngle"] < 90.0, path, "shaping:cone:angle", shaping["coneAngle"])
    exported.differs(f"{path}: a light with a cone is a point, and its edge is linear")
    return {
        "type": "spot",
        "intensity": rgb(area * np.array(radiance(prim, area))),
        "cutoff_angle": shaping["coneAngle"],
        "beam_width": shaping["coneAngle"] * (1.0 - min(max(shaping["coneSoftness"], 0.0), 1.0)),
        "to_world": transform(matrix(prim) @ TURN),
    }


def rect(prim: Fields, path: str) -> tuple[Fields, float]:
    shape = prim["shape"]
    edges = matrix(prim) @ TURN @ np.diag([0.5 * shape["width"], 0.5 * shape["height"], 1.0, 1.0])
    return {"type": "rectangle", "to_world": transform(edges)}, 4.0 * spanned(edges)


def disk(prim: Fields, path: str) -> tuple[Fields, float]:
    radius = prim["shape"]["radius"]
    axes = matrix(prim) @ TURN @ np.diag([radius, radius, 1.0, 1.0])
    return {"type": "disk", "to_world": transform(axes)}, math.pi * spanned(axes)


def sphere(prim: Fields, path: str) -> tuple[Fields, float]:
    to_world = matrix(prim)
    radius = prim["shape"]["radius"] * uniform_scale(to_world, path)
    fields = {"type": "sphere", "center": [float(x) for x in to_world[:3, 3]], "radius": radius}
    return fields, 4.0 * math.pi * radius**2


SHAPES: dict[str, Callable[[Fields, str], tuple[Fields, float]]] = {
    "rect": rect,
    "disk": disk,
    "sphere": sphere,
}
