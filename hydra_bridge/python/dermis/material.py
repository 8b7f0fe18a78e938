"""Materials: the surface shader behind the outputs, and what its inputs are or are driven by."""

from typing import Any

from pxr import Usd, UsdShade

from .displacement import flatten_displacement
from .graph import Graph, shader_id
from .network import Unsupported, Value, constant
from .reading import Reader
from .shaders import ANY, HAIR, SHADERS, SURFACE, Shader

Fields = dict[str, Any]

PLAIN: Fields = {"type": "Material", "shader": "UsdPreviewSurface"}
"""Nothing authored: displayColor of the mesh, or 18 % grey."""


def flatten_material(prim: Usd.Prim, reader: Reader, images: dict[str, Fields]) -> Fields:
    """Fields of `flat::Material`; only authored inputs, the rest has its specification's default. What drives inputs
    is in `network`, what displaces in `displacement`, the images that they read are added to `images`."""
    fields = flatten_surface(prim, reader, images)
    displacement = flatten_displacement(prim, reader, images)
    return fields if displacement is None else {**fields, "displacement": displacement}


def flatten_surface(prim: Usd.Prim, reader: Reader, images: dict[str, Fields]) -> Fields:
    surface = find_surface(prim, reader)
    if surface is None:
        return dict(PLAIN)
    node, shader = surface
    fields = {"type": "Material", "shader": shader.name}
    graph = Graph(reader, images)
    # displayColor as diffuseColor is what an unauthored diffuseColor means, but then displayOpacity counts by itself.
    opacity = UsdShade.Shader(node).GetInput("opacity")
    left = {"diffuseColor": "displayColor"} if not reads_primvar(opacity, "displayOpacity", reader) else {}
    if shader is HAIR:
        node = hair_of(node, fields, graph)
    for shader_input in UsdShade.Shader(node).GetInputs():
        name = shader_input.GetBaseName()
        if name in shader.inputs:
            if name not in left or not reads_primvar(shader_input, left[name], reader):
                set_input(fields, graph, shader_input, shader.inputs[name])
        elif name == shader.normal:
            set_normal(graph, shader_input, shader)
        elif name == "displacement" and name in shader.idle:
            warn_unconnected(graph, shader_input, prim)
        elif name not in shader.idle:
            warn_ignored(graph, shader_input, shader)
    if graph.inputs:
        fields["network"] = graph.flattened()
    return fields


def is_fog(fields: Fields) -> bool:
    """Whether a material has a medium that light gets into without an event: behind an index-matched boundary, or a
    dielectric one of index 1."""
    boundary = fields.get("subsurfaceBoundary", "diffuse")
    ior = next((fields[name] for name in ("ior", "specular_ior", "specular_IOR") if name in fields), 1.5)
    within = boundary == "dielectric" or any(fields.get("transmission_scatter", ()))
    return fields["type"] == "Material" and (boundary == "indexMatched" or (within and ior == 1.0))


def hair_of(surface: Usd.Prim, fields: Fields, graph: Graph) -> Usd.Prim:
    """The BSDF of a MaterialX `surface`, whose own inputs are read here."""
    for shader_input in UsdShade.Shader(surface).GetInputs():
        name = shader_input.GetBaseName()
        if name in SURFACE.inputs:
            set_input(fields, graph, shader_input, SURFACE.inputs[name])
        elif name not in SURFACE.idle:
            warn_ignored(graph, shader_input, SURFACE)
    node = bsdf_node(surface)
    assert node is not None
    return node


def bsdf_node(surface: Usd.Prim) -> Usd.Prim | None:
    shader_input = UsdShade.Shader(surface).GetInput("bsdf")
    return source_node(shader_input) if shader_input else None


def find_surface(prim: Usd.Prim, reader: Reader) -> tuple[Usd.Prim, Shader] | None:
    """The first surface shader dermis knows: MaterialX before the universal output before other renderers'
    outputs."""
    dropped = []
    for output in surface_outputs(UsdShade.Material(prim)):
        node = source_node(output)
        identifier = shader_id(node) if node else ""
        known = SHADERS.get(identifier)
        if identifier == SURFACE.name and node:
            bsdf = bsdf_node(node)
            identifier = shader_id(bsdf) if bsdf else f"{identifier} without a bsdf"
            known = HAIR if identifier == HAIR.name else None
        if node and known:
            if dropped:
                reader.warn(
                    prim,
                    f"{'; '.join(dropped)}: not supported; '{identifier}' of {output.GetFullName()} is used",
                )
            return node, known
        dropped.append(
            f"{output.GetFullName()}: {described(node, identifier) if node else 'no shader is connected'}"
        )
    what = "; ".join(dropped) or "no surface output"
    reader.warn(prim, f"{what}: no supported surface shader; displayColor is used")
    return None


def described(node: Usd.Prim, identifier: str) -> str:
    return f"shader {identifier!r}" if identifier else f"{node.GetPath()}, which has no info:id"


def surface_outputs(material: UsdShade.Material) -> list[UsdShade.Output]:
    """Authored surface outputs, preferred first."""
    outputs = {str(output.GetFullName()): output for output in material.GetSurfaceOutputs()}
    rank = {"outputs:mtlx:surface": 0, "outputs:surface": 1}
    ordered = sorted(outputs, key=lambda name: (rank.get(name, 2), name))
    return [outputs[name] for name in ordered if outputs[name].HasConnectedSource()]


def source_node(output: UsdShade.Output | UsdShade.Input) -> Usd.Prim | None:
    """The shader prim at the far end of an output or an input, through node graphs."""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(output):
        if attribute.GetPrim().IsA(UsdShade.Shader):
            return attribute.GetPrim()
    return None


def warn_ignored(graph: Graph, shader_input: UsdShade.Input, shader: Shader) -> None:
    node, name, reader = shader_input.GetPrim(), shader_input.GetBaseName(), graph.reader
    if name not in shader.ignored:
        reader.warn(node, f"inputs:{name}: not an input of {shader.name}; ignored")
        return
    default, source = shader.ignored[name], graph.source(shader_input)
    if source is None:
        return
    value = None if graph.is_output(source) else source.Get(reader.time)
    if graph.is_output(source) or (default is ANY and value is not None):
        reader.warn(node, f"inputs:{name}: not supported yet; ignored")
    elif value is not None and (value := reader.coerced(node, f"inputs:{name}", value, default)) != default:
        reader.warn(
            node, f"inputs:{name}: not supported yet; {value} is ignored, the default {default} rendered"
        )


def warn_unconnected(graph: Graph, shader_input: UsdShade.Input, material: Usd.Prim) -> None:
    """The displacement of a surface shader counts where it is the material's."""
    if any(output.HasConnectedSource() for output in UsdShade.Material(material).GetDisplacementOutputs()):
        return
    source = graph.source(shader_input)
    if source and (graph.is_output(source) or source.Get(graph.reader.time)):
        message = (
            "inputs:displacement: outputs:displacement of the material is not connected; nothing is displaced"
        )
        graph.reader.warn(shader_input.GetPrim(), message)


def set_input(fields: Fields, graph: Graph, shader_input: UsdShade.Input, default: Any) -> None:
    """The input's constant among the fields, or what drives it among the graph's; neither where nothing usable is
    authored."""
    node, name, reader = shader_input.GetPrim(), shader_input.GetBaseName(), graph.reader
    source = graph.source(shader_input)
    if source is None:
        return
    if not graph.is_output(source):
        value = source.Get(reader.time)
        if value is not None:
            value = reader.coerced(source.GetPrim(), source.GetName(), value, default)
            if isinstance(value, tuple) and "radius" not in name.lower():
                # Mean free paths are colours by type alone.
                value = reader.colored(source, value)
            fields[name] = list(value) if isinstance(value, tuple) else value
        return
    try:
        value = graph.output(source)
        if value.lanes is None:
            if isinstance(default, (str, int)):
                raise Unsupported("only a constant can drive it")
            graph.inputs[name] = value
            return
    except Unsupported as error:
        reader.warn(node, f"inputs:{name}: {error}; the default is used")
        return
    constant = reader.coerced(node, f"inputs:{name}", plain(value, default), default)
    fields[name] = list(constant) if isinstance(constant, tuple) else constant


def plain(value: Value, default: Any) -> Any:
    """A constant as an input of the type of `default` takes it."""
    assert value.lanes is not None
    return value.lanes[: len(default)] if isinstance(default, tuple) else value.lanes[0]


def set_normal(graph: Graph, shader_input: UsdShade.Input, shader: Shader) -> None:
    """The normal in tangent space: what UsdPreviewSurface takes, and what leads into MaterialX's `normalmap`."""
    reader, name = graph.reader, shader_input.GetFullName()
    try:
        if shader.tangent_space:
            value = graph.value(shader_input, constant((0.0, 0.0, 1.0)))
        else:
            value = graph.normal_map(shader_input)
    except Unsupported as error:
        reader.warn(shader_input.GetPrim(), f"{name}: {error}; it is ignored")
        return
    if value is None or (value.lanes is not None and value.lanes[:3] == (0.0, 0.0, 1.0)):
        return
    graph.inputs["normal"] = value


def reads_primvar(shader_input: UsdShade.Input, name: str, reader: Reader) -> bool:
    """Whether a primvar of that name is all that drives the input."""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(shader_input)[:1] if shader_input else ():
        node = UsdShade.Shader(attribute.GetPrim())
        if node and shader_id(attribute.GetPrim()).startswith("UsdPrimvarReader"):
            variable = node.GetInput("varname")
            return bool(variable) and str(variable.Get(reader.time)) == name
    return False
