"""Cycles at work, in its own environment, through Blender as a Python module."""

import json
import math
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
from worker import serve

#: Of volumes and refraction; the most that Cycles allows.
MOST_BOUNCES = 1024


class Cycles:
    def load(self, folder: str, threads: int) -> dict[str, Any]:
        self.folder = Path(folder)
        description = json.loads((self.folder / "scene.json").read_text(encoding="utf-8"))["scene"]
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.resolution = description["camera"]["resolution"]
        set_up(self.scene, description, threads)
        add_camera(self.scene, description["camera"])
        for mesh in description["meshes"]:
            add_mesh(self.scene, mesh)
        for light in description["lights"]:
            add_light(self.scene, light, description["seen"])
        add_world(self.scene, description["world"], description["seen"])
        self.window: tuple[int, int, int, int] | None = None
        return {"version": bpy.app.version_string, "variant": "CPU", "threads": self.scene.render.threads}

    def prepare(self, samples: int, window: tuple[int, int, int, int]) -> None:
        """The window, as Blender's border: fractions of the frame, y up."""
        (width, height), render = self.resolution, self.scene.render
        x0, y0, x1, y1 = window
        render.border_min_x, render.border_max_x = x0 / width, x1 / width
        render.border_min_y, render.border_max_y = 1.0 - y1 / height, 1.0 - y0 / height
        if window != self.window:
            self.window = window
            # Trees are built before the clock runs.
            self.render(1, 0, window)

    def render(self, samples: int, seed: int, window: tuple[int, int, int, int]) -> None:
        self.scene.cycles.samples = samples
        # Blender's integers have a sign.
        self.scene.cycles.seed = seed % (1 << 31)
        self.scene.render.filepath = str(self.folder / "render.exr")
        bpy.ops.render.render(write_still=True)

    def write(self, image: None, file: str) -> None:
        (self.folder / "render.exr").replace(file)


def set_up(scene: Any, description: dict[str, Any], threads: int) -> None:
    """No denoising, no adaptive sampling, no clamping, nothing filtered, no light left out."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = description["camera"]["resolution"]
    render.resolution_percentage = 100
    render.use_border = render.use_crop_to_border = True
    render.film_transparent = not description["seen"]
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = threads
    # The scene stays in Cycles between renders.
    render.use_persistent_data = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    cycles.device = "CPU"
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.filter_width = description["camera"]["filter_width"]
    cycles.diffuse_bounces = cycles.glossy_bounces = description["bounces"]
    cycles.max_bounces = cycles.transmission_bounces = MOST_BOUNCES
    cycles.volume_bounces = cycles.transparent_max_bounces = MOST_BOUNCES


def add_camera(scene: Any, fields: dict[str, Any]) -> None:
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "HORIZONTAL"
    camera.lens_unit = "FOV"
    camera.angle_x = fields["fov_x"]
    camera.clip_start, camera.clip_end = fields["near"], fields["far"]
    scene.camera = add(scene, camera, fields["to_world"])


def add(scene: Any, data: Any, to_world: Any = None) -> Any:
    thing = bpy.data.objects.new(data.name, data)
    if to_world is not None:
        thing.matrix_world = mathutils.Matrix(to_world)
    scene.collection.objects.link(thing)
    return thing


# Bodies.


def add_mesh(scene: Any, fields: dict[str, Any]) -> None:
    points, corners = np.load(fields["points"]), np.load(fields["corners"])
    mesh = bpy.data.meshes.new("mesh")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.add(corners.size)
    mesh.loops.foreach_set("vertex_index", corners.ravel().astype(np.int32))
    mesh.polygons.add(len(corners))
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 3, dtype=np.int32))
    smooth = "normals" in fields
    mesh.polygons.foreach_set("use_smooth", np.full(len(corners), smooth))
    mesh.update(calc_edges=True)
    if smooth:
        mesh.normals_split_custom_set_from_vertices(np.load(fields["normals"]))
    mesh.materials.append(material(fields["material"]))
    add(scene, mesh)


def material(fields: dict[str, Any]) -> Any:
    made = bpy.data.materials.new("material")
    tree = node_tree(made)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    match fields["kind"]:
        case "diffuse":
            surface = node(tree, "ShaderNodeBsdfDiffuse", {"Color": [*fields["color"], 1.0]})
        case "subsurface":
            surface = principled(tree, fields)
        case "glass":
            inputs = {"Color": [1.0] * 4, "Roughness": fields["roughness"], "IOR": fields["ior"]}
            surface = node(tree, "ShaderNodeBsdfGlass", inputs)
            # Plain GGX, as in Mitsuba, for smooth and rough alike; MULTI_GGX only rescales the former.
            surface.distribution = "MULTI_GGX" if fields["roughness"] else "GGX"
        case "volume":
            surface = None
    if surface:
        tree.links.new(surface.outputs[0], output.inputs["Surface"])
    if "scattering" in fields:
        tree.links.new(volume(tree, fields).outputs[0], output.inputs["Volume"])
    return made


def principled(tree: Any, fields: dict[str, Any]) -> Any:
    surface = node(
        tree,
        "ShaderNodeBsdfPrincipled",
        {
            "Base Color": [*fields["color"], 1.0],
            "Roughness": fields["roughness"],
            "IOR": fields["ior"],
            "Subsurface Weight": 1.0,
            "Subsurface Radius": fields["radius"],
            "Subsurface Scale": 1.0,
            "Subsurface Anisotropy": fields["g"],
        },
    )
    surface.subsurface_method = "RANDOM_WALK"
    return surface


def volume(tree: Any, fields: dict[str, Any]) -> Any:
    made = tree.nodes.new("ShaderNodeVolumeCoefficients")
    made.phase = "HENYEY_GREENSTEIN"
    coefficients = {
        "Absorption Coefficients": "absorption",
        "Scatter Coefficients": "scattering",
        "Anisotropy": "g",
    }
    for name, key in coefficients.items():
        made.inputs[name].default_value = fields[key]
    return made


def node_tree(owner: Any) -> Any:
    """An empty one."""
    owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def node(tree: Any, kind: str, inputs: dict[str, Any]) -> Any:
    made = tree.nodes.new(kind)
    for name, value in inputs.items():
        made.inputs[name].default_value = value
    return made


# Lights.


def add_light(scene: Any, fields: dict[str, Any], seen: bool) -> None:
    kind = fields["kind"]
    light = bpy.data.lights.new("light", {"distant": "SUN", "sphere": "POINT"}.get(kind, "AREA"))
    color = np.array(fields.get("radiance", fields.get("irradiance")))
    if kind == "distant":
        light.angle, light.energy = fields["angle"], 1.0
    elif kind == "sphere":
        light.shadow_soft_size = fields["radius"]
        light.use_soft_falloff = False
        # Watt to radiance: power over pi and the area, as of any Lambertian emitter.
        light.energy = 4.0 * math.pi**2 * fields["radius"] ** 2
    else:
        light.shape = "RECTANGLE" if kind == "rect" else "ELLIPSE"
        light.size, light.size_y = fields["size"]
        area = fields["size"][0] * fields["size"][1] * (1.0 if kind == "rect" else 0.25 * math.pi)
        light.energy = math.pi * area
    emit(light, color, fields["cone"])
    made = add(scene, light, fields["to_world"])
    made.visible_camera = seen


def emit(light: Any, color: np.ndarray, cone: list[float] | None) -> None:
    """`color` as strength of an emission node, which takes what is brighter than a colour may be."""
    tree = node_tree(light)
    output = tree.nodes.new("ShaderNodeOutputLight")
    strength = float(color.max())
    emission = node(
        tree, "ShaderNodeEmission", {"Color": [*(color / (strength or 1.0)), 1.0], "Strength": strength}
    )
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    if cone:
        tree.links.new(faded(tree, strength, cone), emission.inputs["Strength"])


def faded(tree: Any, strength: float, cone: list[float]) -> Any:
    """strength (1 - smoothstep(angle off the axis, start, cutoff))."""
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    cosine = tree.nodes.new("ShaderNodeVectorMath")
    cosine.operation = "DOT_PRODUCT"
    tree.links.new(geometry.outputs["Normal"], cosine.inputs[0])
    tree.links.new(geometry.outputs["Incoming"], cosine.inputs[1])
    angle = tree.nodes.new("ShaderNodeMath")
    angle.operation = "ARCCOSINE"
    tree.links.new(cosine.outputs["Value"], angle.inputs[0])
    # A hard edge as the narrowest step that there is: start and end must differ.
    start, cutoff = min(cone[0], cone[1] - 1e-5), cone[1]
    fade = node(
        tree, "ShaderNodeMapRange", {"From Min": start, "From Max": cutoff, "To Min": strength, "To Max": 0.0}
    )
    fade.interpolation_type = "SMOOTHSTEP"
    tree.links.new(angle.outputs[0], fade.inputs["Value"])
    return fade.outputs["Result"]


def add_world(scene: Any, fields: dict[str, Any] | None, seen: bool) -> None:
    scene.world = world = bpy.data.worlds.new("world")
    tree = node_tree(world)
    world.cycles_visibility.camera = seen
    if fields is None:
        return
    output = tree.nodes.new("ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    if "radiance" in fields:
        strength = max(fields["radiance"])
        background.inputs["Color"].default_value = [*(x / (strength or 1.0) for x in fields["radiance"]), 1.0]
        background.inputs["Strength"].default_value = strength
    else:
        tree.links.new(environment(tree, fields), background.inputs["Color"])


def environment(tree: Any, fields: dict[str, Any]) -> Any:
    """The latlong map. Blender's has its pole at +Z, the middle of the image at +X and +Y to its left."""
    pixels = np.load(fields["image"])
    height, width, _ = pixels.shape
    image = bpy.data.images.new("dome", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    rgba = np.ones((height, width, 4), dtype=np.float32)
    rgba[..., :3] = pixels[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    to_map = np.array(fields["to_map"])
    tree.links.new(turned(tree, to_map[[2, 0, 1]]), texture.inputs["Vector"])
    return texture.outputs["Color"]


def turned(tree: Any, rows: np.ndarray) -> Any:
    """The direction of the ray times a matrix."""
    direction = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    combined = tree.nodes.new("ShaderNodeCombineXYZ")
    for row, place in zip(rows, combined.inputs, strict=True):
        dot = tree.nodes.new("ShaderNodeVectorMath")
        dot.operation = "DOT_PRODUCT"
        dot.inputs[1].default_value = list(row)
        tree.links.new(direction, dot.inputs[0])
        tree.links.new(dot.outputs["Value"], place)
    return combined.outputs[0]


if __name__ == "__main__":
    serve(Cycles())
