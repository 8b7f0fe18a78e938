"""A flattened scene for Cycles, as JSON that `cycles_worker` builds with bpy; arrays lie beside it as .npy.

A diffuse boundary is the Principled BSDF's random walk; media behind a dielectric, and those without boundary, are
volumes. Cycles' walk has a model of its own, see WALK, and takes no single-scattering albedo.
"""

import math
from pathlib import Path

import numpy as np

from ..stage import FlatStage
from .appearance import (
    ExportError,
    Fields,
    Medium,
    diffuse_color,
    distant_irradiance,
    dome_turn,
    lights_of,
    lights_seen,
    matrix,
    medium_of,
    radiance,
    require,
    rigid,
    spanned,
    surface_of,
    uniform_scale,
    view_of,
)
from .geometry import triangles_of
from .mitsuba_export import Exported

#: Cycles takes a radius of 4 pi mean free paths (`bssrdf_setup_radius`), in memory of its older models.
RADIUS_PER_MEAN_FREE_PATH = 4.0 * math.pi

#: Of the colour .4, lit and seen along the normal, 15 % less comes back than of a diffuse boundary; of .8, 4 %.
WALK = (
    "Cycles' random walk enters refracted where dermis' enters diffusely, inverts colours by another fit, takes no "
    "more than 256 steps, isotropic ones from the tenth on"
)

#: Blackman-Harris filter, in pixels, with the variance of dermis' tent: 1/6 = 0.01918 width^2. Cycles has no tent.
FILTER_WIDTH = 2.948


def export(flat: FlatStage, folder: Path) -> Exported:
    """The scene; arrays go to `folder`. Raises ExportError for whatever has no equivalent."""
    view, lights = view_of(flat), lights_of(flat)
    near, far = view.clipping
    camera = {
        "to_world": view.to_world.tolist(),
        "fov_x": math.radians(view.fov_x),
        "near": near,
        "far": far,
        "resolution": list(view.resolution),
        "filter_width": FILTER_WIDTH,
    }
    scene: Fields = {"camera": camera, "meshes": [], "lights": [], "world": None, "seen": lights_seen(lights)}
    exported = Exported({"scene": scene, "exposure": view.exposure})
    exported.differs("a Blackman-Harris pixel filter of the tent's variance")
    scene["bounces"] = flat.settings.get("maxDepth", 12)
    for number, (path, prim) in enumerate(flat.prims.items()):
        if prim["type"] == "Mesh" and prim["visible"]:
            scene["meshes"].append(mesh(flat, path, folder / f"mesh{number}", exported))
        elif path in lights and prim["shape"]["kind"] == "dome":
            if scene["world"]:
                raise ExportError("several dome lights: Cycles takes one")
            scene["world"] = dome(flat, path, folder / f"light{number}.npy")
        elif path in lights:
            scene["lights"].append(light(prim, path, exported))
    return exported


# Bodies.


def mesh(flat: FlatStage, path: str, stem: Path, exported: Exported) -> Fields:
    prim = flat.prims[path]
    triangles = triangles_of(prim, path, flat.settings.get("refineLevel", 0))
    files = {"points": triangles.points, "corners": triangles.corners}
    if triangles.normals is not None:
        files["normals"] = triangles.normals
    names = {}
    for name, values in files.items():
        names[name] = f"{stem}.{name}.npy"
        np.save(names[name], values)
    material, where = surface_of(flat, prim)
    medium = medium_of(material, flat.settings.get("subsurfaceBoundary", "auto"))
    if medium is None:
        exported.differs("opaque surfaces are Lambertian, without UsdPreviewSurface's specular lobe")
        return {**names, "material": {"kind": "diffuse", "color": diffuse_color(material, prim, where)}}
    return {**names, "material": body(medium, where, exported)}


def body(medium: Medium, path: str, exported: Exported) -> Fields:
    if medium.boundary == "diffuse":
        return random_walk(medium, path, exported)
    sigma_t, albedo = 1.0 / np.array(medium.radius), np.array(medium.albedo)
    volume = {
        "absorption": list(sigma_t * (1.0 - albedo)),
        "scattering": list(sigma_t * albedo),
        "g": medium.g,
    }
    if medium.boundary == "indexMatched":
        exported.differs("at most 1024 scatterings in a volume")
        return {"kind": "volume", **volume}
    exported.differs("glass: Cycles' GGX and at most 1024 bounces in it and in its volume")
    return {
        "kind": "glass",
        "ior": medium.ior,
        "roughness": 0.0 if medium.smooth else medium.roughness,
        **volume,
    }


def random_walk(medium: Medium, path: str, exported: Exported) -> Fields:
    if medium.color is None:
        raise ExportError(f"{path}: subsurfaceAlbedo: Cycles takes a colour, not a single-scattering albedo")
    exported.differs(WALK)
    return {
        "kind": "subsurface",
        "color": medium.color,
        "radius": [RADIUS_PER_MEAN_FREE_PATH * radius for radius in medium.radius],
        "g": medium.g,
        "ior": medium.ior,
        "roughness": medium.roughness,
    }


# Lights.


def light(prim: Fields, path: str, exported: Exported) -> Fields:
    """A lamp: Cycles' lamps, like dermis' lights, block nothing and reflect nothing."""
    shape, to_world = prim["shape"], matrix(prim)
    common = {"to_world": rigid(to_world).tolist(), "cone": cone(prim, path)}
    scales = np.linalg.norm(to_world[:3, :3], axis=0)
    match shape["kind"]:
        case "rect" | "disk":
            sheared = abs(to_world[:3, 0] @ to_world[:3, 1]) > 1e-6 * scales[0] * scales[1]
            require(not sheared, path, "transform", "that shears a light")
            factor, size = (
                (math.pi / 4.0, [2.0 * shape["radius"]] * 2)
                if shape["kind"] == "disk"
                else (
                    1.0,
                    [shape["width"], shape["height"]],
                )
            )
            area = factor * size[0] * size[1] * spanned(to_world)
            size = [size[0] * scales[0], size[1] * scales[1]]
            return {**common, "kind": shape["kind"], "size": size, "radiance": radiance(prim, area)}
        case "sphere":
            radius = shape["radius"] * uniform_scale(to_world, path)
            area = 4.0 * math.pi * radius**2
            return {**common, "kind": "sphere", "radius": radius, "radiance": radiance(prim, area)}
        case "distant":
            angle = math.radians(shape["angle"])
            return {**common, "kind": "distant", "angle": angle, "irradiance": distant_irradiance(prim)}
    raise ExportError(f"{path}: a {shape['kind']} light is not exported to other renderers")


def cone(prim: Fields, path: str) -> list[float] | None:
    """Off-axis angles in radians where UsdLuxShapingAPI's cone begins to soften, and where it ends."""
    shaping, shape = prim["shaping"], prim["shape"]["kind"]
    if shaping is None:
        return None
    require(shape in ("disk", "rect"), path, "shaping of a", shape)
    require(shaping["focus"] == 0.0, path, "shaping:focus", shaping["focus"])
    cutoff = math.radians(shaping["coneAngle"])
    return [cutoff * (1.0 - min(max(shaping["coneSoftness"], 0.0), 1.0)), cutoff]


def dome(flat: FlatStage, path: str, file: Path) -> Fields:
    prim = flat.prims[path]
    require(prim["shaping"] is None, path, "shaping", "of a dome")
    emitted = radiance(prim, 1.0)
    texture = prim["shape"]["texture"]
    if not texture:
        return {"radiance": emitted}
    image = flat.prims[texture]
    np.save(
        file, (image["pixels"].reshape(image["height"], image["width"], 3) * np.array(emitted)).astype("f4")
    )
    return {"image": str(file), "to_map": np.linalg.inv(dome_turn(prim)[:3, :3]).tolist()}
