"""Displacement of a material: the scalar that moves points along the normal, as a network of its own."""

from typing import Any

from pxr import Usd, UsdShade

from .graph import Graph, shader_id
from .network import Unsupported, Value, constant
from .reading import Reader

Fields = dict[str, Any]

INPUTS = {
    "UsdPreviewSurface": ("displacement",),
    "ND_UsdPreviewSurface_surfaceshader": ("displacement",),
    "ND_displacement_float": ("displacement", "scale"),
}
"""Displacement shaders by `info:id`: the inputs whose product moves a point."""

DEFAULTS = {"displacement": constant(0.0), "scale": constant(1.0)}


def flatten_displacement(material: Usd.Prim, reader: Reader, images: dict[str, Fields]) -> Fields | None:
    """`flat::Network` with the one input `displacement`; None where nothing is moved. Images are added to `images`."""
    node = displacement_node(material, reader)
    if node is None:
        return None
    graph = Graph(reader, images)
    try:
        value = product(graph, node)
    except Unsupported as error:
        reader.warn(node, f"displacement: {error}; nothing is displaced")
        return None
    if value.lanes is not None and value.lanes[0] == 0.0:
        return None
    # A constant is a node like others: where it moves points, nothing else is asked of it.
    graph.inputs["displacement"] = value
    return graph.flattened()


def displacement_node(material: Usd.Prim, reader: Reader) -> Usd.Prim | None:
    """The displacement shader; MaterialX before the universal output before other renderers' outputs."""
    outputs = {
        str(output.GetFullName()): output for output in UsdShade.Material(material).GetDisplacementOutputs()
    }
    rank = {"outputs:mtlx:displacement": 0, "outputs:displacement": 1}
    dropped = []
    for name in sorted(outputs, key=lambda name: (rank.get(name, 2), name)):
        if not outputs[name].HasConnectedSource():
            continue
        node = next((a.GetPrim() for a in UsdShade.Utils.GetValueProducingAttributes(outputs[name])), None)
        if node and shader_id(node) in INPUTS:
            return node
        dropped.append(f"{name}: {f'shader {shader_id(node)!r}' if node else 'no shader is connected'}")
    if dropped:
        reader.warn(material, f"{'; '.join(dropped)}: no supported displacement; nothing is displaced")
    return None


def product(graph: Graph, node: Usd.Prim) -> Value:
    """Raises Unsupported."""
    shader, value = UsdShade.Shader(node), constant(1.0)
    for name in INPUTS[shader_id(node)]:
        shader_input = shader.GetInput(name)
        factor = graph.value(shader_input, DEFAULTS[name]) if shader_input else DEFAULTS[name]
        if factor.width != 1:
            raise Unsupported(f"inputs:{name} is no number")
        value = graph.network.multiply(factor, value)
    return value
