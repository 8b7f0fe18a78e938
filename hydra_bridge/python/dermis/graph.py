"""The nodes of a stage behind a shader's inputs, through node graphs and their interfaces."""

import math
from collections.abc import Iterator
from functools import cache
from typing import Any

from pxr import Gf, Sdf, Usd, UsdShade

from .network import Network, Unsupported, Value, constant
from .nodes import Handler, Node
from .reading import Reader

Fields = dict[str, Any]


@cache
def handlers() -> dict[str, Handler]:
    """What computes a node, by category; loaded where there are nodes."""
    from .materialx_colors import COLOR_NODES
    from .materialx_nodes import MATERIALX_NODES
    from .materialx_ramps import RAMP_NODES
    from .materialx_textures import TEXTURE_NODES
    from .materialx_vectors import VECTOR_NODES
    from .usd_nodes import USD_NODES

    nodes = (USD_NODES, MATERIALX_NODES, COLOR_NODES, VECTOR_NODES, TEXTURE_NODES, RAMP_NODES)
    return {category: handler for table in nodes for category, handler in table.items()}


class Graph:
    """What drives the inputs of one material. `inputs`: by name, not constant."""

    def __init__(self, reader: Reader, images: dict[str, Fields]) -> None:
        self.reader = reader
        self.images = images
        self.network = Network()
        self.inputs: dict[str, Value] = {}
        # None: under way.
        self._outputs: dict[Sdf.Path, Value | None] = {}

    def source(self, shader_input: UsdShade.Input) -> Usd.Attribute | None:
        """The attribute at the far end of an input's connections: its own, another input's, or a node's output."""
        for attribute in UsdShade.Utils.GetValueProducingAttributes(shader_input):
            return attribute
        node, stage = shader_input.GetPrim(), shader_input.GetPrim().GetStage()
        # An interface input without a value is as good as none; what is not there is a mistake.
        if any(not stage.GetPropertyAtPath(path) for path in shader_input.GetAttr().GetConnections()):
            name = shader_input.GetFullName()
            self.reader.warn(node, f"{name}: its connection leads to no value; the default is used")
        return None

    @staticmethod
    def is_output(attribute: Usd.Attribute) -> bool:
        return UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output

    def value(self, shader_input: UsdShade.Input, default: Value) -> Value:
        """Raises Unsupported."""
        source = self.source(shader_input)
        if source is None:
            return default
        if self.is_output(source):
            return self.output(source)
        value = source.Get(self.reader.time)
        if value is None:
            return default
        constant_value = number(value, shader_input.GetBaseName())
        if constant_value.width < 3:
            return constant_value
        return constant(self.reader.colored(source, constant_value.numbers()))

    def output(self, attribute: Usd.Attribute) -> Value:
        """What a node's output gives. Raises Unsupported."""
        path = attribute.GetPath()
        if path in self._outputs:
            value = self._outputs[path]
            if value is None:
                raise Unsupported(f"the connections at {path.GetPrimPath()} go round in a circle")
            return value
        self._outputs[path] = None
        node = StageNode(self, attribute)
        try:
            value = evaluate(node)
        except Unsupported as error:
            raise Unsupported(self.words(node, error)) from error
        finally:
            del self._outputs[path]
        self._outputs[path] = value
        return value

    @staticmethod
    def words(node: "StageNode", error: Unsupported) -> str:
        """The innermost node is the one that is named."""
        text = str(error)
        return (
            text if text.startswith("node ") else f"node '{node.identifier}' at {node.prim.GetPath()}: {text}"
        )

    def normal_map(self, shader_input: UsdShade.Input) -> Value | None:
        """What a `normalmap` behind the input gets, -1 to 1 in tangent space. Raises Unsupported."""
        source = self.source(shader_input)
        if source is None or not self.is_output(source):
            if source is None or source.Get(self.reader.time) is None:
                return None
            raise Unsupported("a constant normal is not supported")
        node = StageNode(self, source)
        if node.category != "normalmap":
            raise Unsupported(self.words(node, Unsupported("only a normalmap can drive normals")))
        if node.token("space", "tangent") != "tangent":
            raise Unsupported(self.words(node, Unsupported("only its tangent space is supported")))
        for name in ("normal", "tangent", "bitangent"):
            if node.has(name):
                self.reader.warn(node.prim, f"inputs:{name}: the frame of the mesh is used instead")
        n = self.network
        color = node.get("in", constant((0.5, 0.5, 1.0)))
        normal = n.subtract(n.multiply(color, constant(2.0)), constant(1.0))
        scale = node.get("scale", constant(1.0))
        if scale.width == 1:
            scale = n.resized(scale, 2)
        scale = n.gather((scale, 0), (scale, 1), (constant(1.0), 0))
        return n.resized(n.multiply(normal, scale), 3)

    def flattened(self) -> Fields:
        """`flat::Network`: the nodes that inputs need, in order."""
        roots = {name: self.network.index(value) for name, value in self.inputs.items()}
        nodes = self.network.nodes
        needed = set(roots.values())
        for i in reversed(range(len(nodes))):
            if i in needed:
                needed.update(arguments(nodes[i]))
        place = {old: new for new, old in enumerate(sorted(needed))}
        return {
            "nodes": [renumbered(nodes[i], place) for i in sorted(needed)],
            "inputs": {name: place[root] for name, root in sorted(roots.items())},
            "tangents": self.tangents(roots["normal"]) if "normal" in roots else "",
        }

    def tangents(self, root: int) -> str:
        """The coordinates that a normal is looked up with; st where there are none."""
        open_nodes, nodes = [root], self.network.nodes
        while open_nodes:
            node = nodes[open_nodes.pop(0)]
            if node["node"] == "primvar":
                return node["varname"]
            # Coordinates before factors.
            open_nodes.extend(arguments(node))
        return "st"


def arguments(node: Fields) -> Iterator[int]:
    yield from node.get("args", ())
    if node["node"] == "image":
        yield node["st"]


def renumbered(node: Fields, place: dict[int, int]) -> Fields:
    node = dict(node)
    if "args" in node:
        node["args"] = [place[i] for i in node["args"]]
    if node["node"] == "image":
        node["st"] = place[node["st"]]
    return node


class StageNode:
    """`nodes.Node` of a shader prim."""

    def __init__(self, graph: Graph, output: Usd.Attribute) -> None:
        self.graph = graph
        self.network = graph.network
        self.prim = output.GetPrim()
        self.shader = UsdShade.Shader(self.prim)
        self.identifier = shader_id(self.prim)
        self.category = category(self.identifier)
        self.output = output.GetName().removeprefix("outputs:")
        self.width = width_of(output.GetTypeName())
        self.is_color = str(output.GetTypeName()).startswith("color") or "_color" in self.identifier

    def get(self, name: str, default: Value) -> Value:
        shader_input = self.shader.GetInput(name)
        return self.graph.value(shader_input, default) if shader_input else default

    def has(self, name: str) -> bool:
        shader_input = self.shader.GetInput(name)
        return bool(shader_input) and (
            shader_input.HasConnectedSource() or shader_input.Get(self.graph.reader.time) is not None
        )

    def token(self, name: str, default: str) -> str:
        value = self.plain(name)
        return default if value is None else str(value)

    def number(self, name: str, default: float) -> float:
        value = self.plain(name)
        if value is None or isinstance(value, str):
            return default
        found = number(value, name).numbers()
        if len(found) > 1 or not math.isfinite(found[0]):
            raise Unsupported(f"inputs:{name} is no number")
        return found[0]

    def matrix(self, name: str) -> list[list[float]] | None:
        value = self.plain(name)
        if value is None:
            return None
        if not isinstance(value, (Gf.Matrix3d, Gf.Matrix4d)):
            raise Unsupported(f"inputs:{name} is no matrix")
        return [list(row) for row in value]

    def warn(self, name: str, message: str) -> None:
        self.graph.reader.warn(self.prim, f"inputs:{name}: {message}")

    def plain(self, name: str) -> Any:
        """The value of an input that nodes cannot drive."""
        shader_input = self.shader.GetInput(name)
        source = self.graph.source(shader_input) if shader_input else None
        if source is None:
            return None
        if self.graph.is_output(source):
            raise Unsupported(f"inputs:{name} is driven by a node")
        return source.Get(self.graph.reader.time)

    def image(self, file: str, space: str, node: Fields) -> Fields:
        from .images import find_images, wrap_modes

        shader_input = self.shader.GetInput(file)
        source = self.graph.source(shader_input) if shader_input else None
        reader = self.graph.reader
        if source is None or self.graph.is_output(source):
            self.warn(file, f"{'no file' if source is None else 'a node drives it'}; the fallback is used")
            return {"node": "image", **node, "tiles": []}
        # What the file says itself, then what the node expects.
        authored = str(source.GetColorSpace() or "")
        if space == "auto" or (authored and self.category != "UsdUVTexture"):
            space = authored or space
        tiles = find_images(source, space, reader, self.graph.images)
        for axis, i in (("wrapS", 0), ("wrapT", 1)):
            if node.get(axis) not in ("black", "clamp", "repeat", "mirror"):
                path = self.graph.images[tiles[0]["image"]]["file"] if tiles else ""
                node[axis] = (wrap_modes(path)[i] if path else None) or "black"
        return {"node": "image", **node, "tiles": tiles}


def shader_id(node: Usd.Prim) -> str:
    identifier = UsdShade.Shader(node).GetIdAttr().Get()
    return identifier if isinstance(identifier, str) else ""


def category(identifier: str) -> str:
    """`ND_multiply_color3FA` is a `multiply`; nodes of one type alone have no more than their name."""
    if identifier.startswith("ND_"):
        if identifier[3:] in handlers():
            return identifier[3:]
        return identifier[3:].split("_")[0]
    return identifier.split("_")[0]


def evaluate(node: Node) -> Value:
    """Raises Unsupported."""
    handler = handlers().get(node.category)
    if handler is None:
        raise Unsupported("it is not supported")
    return handler(node)


def width_of(kind: Sdf.ValueTypeName) -> int:
    """Numbers in a value of a type; 1 for what is none."""
    value = kind.defaultValue
    return len(value) if hasattr(value, "__len__") and not isinstance(value, str) else 1


def number(value: Any, name: str) -> Value:
    """An authored value. Raises Unsupported."""
    try:
        if isinstance(value, (str, Sdf.AssetPath)):
            raise TypeError
        value = constant([float(x) for x in value] if hasattr(value, "__len__") else float(value))
    except (TypeError, ValueError):
        raise Unsupported(f"inputs:{name} is no number or vector") from None
    if value.width > 4:
        raise Unsupported(f"inputs:{name} has {value.width} numbers")
    return value
