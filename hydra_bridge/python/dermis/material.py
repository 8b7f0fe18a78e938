"""Materials: the surface shader behind the outputs, its inputs followed through their connections."""

from typing import Any

from pxr import Usd, UsdShade

from .reading import Reader
from .shaders import ANY, SHADERS, Shader

Fields = dict[str, Any]

PLAIN: Fields = {"type": "Material", "shader": "UsdPreviewSurface"}
"""Nothing authored: displayColor of the mesh, or 18 % grey."""


def flatten_material(prim: Usd.Prim, reader: Reader) -> Fields:
    """Fields of `flat::Material`; only authored inputs, the rest has its specification's default."""
    surface = find_surface(prim, reader)
    if surface is None:
        return dict(PLAIN)
    node, shader = surface
    fields = {"type": "Material", "shader": shader.name}
    for shader_input in UsdShade.Shader(node).GetInputs():
        name = shader_input.GetBaseName()
        if name in shader.inputs:
            value = input_value(shader_input, shader.inputs[name], reader)
            if value is not None:
                fields[name] = list(value) if isinstance(value, tuple) else value
        elif name not in shader.idle:
            warn_ignored(shader_input, shader, reader)
    if UsdShade.Material(prim).GetDisplacementOutput().HasConnectedSource():
        reader.warn(prim, "outputs:displacement: displacement is not supported yet; ignored")
    return fields


def find_surface(prim: Usd.Prim, reader: Reader) -> tuple[Usd.Prim, Shader] | None:
    """The first surface shader dermis knows: MaterialX before the universal output before other renderers'
    outputs."""
    dropped = []
    for output in surface_outputs(UsdShade.Material(prim)):
        node = source_node(output)
        identifier = shader_id(node) if node else ""
        if identifier in SHADERS:
            if dropped:
                reader.warn(
                    prim,
                    f"{'; '.join(dropped)}: not supported; '{identifier}' of {output.GetFullName()} is used",
                )
            return node, SHADERS[identifier]
        dropped.append(
            f"{output.GetFullName()}: {f'shader {identifier!r}' if node else 'no shader is connected'}"
        )
    what = "; ".join(dropped) or "no surface output"
    reader.warn(prim, f"{what}: no supported surface shader; displayColor is used")
    return None


def surface_outputs(material: UsdShade.Material) -> list[UsdShade.Output]:
    """Authored surface outputs, preferred first."""
    outputs = {str(output.GetFullName()): output for output in material.GetSurfaceOutputs()}
    rank = {"outputs:mtlx:surface": 0, "outputs:surface": 1}
    ordered = sorted(outputs, key=lambda name: (rank.get(name, 2), name))
    return [outputs[name] for name in ordered if outputs[name].HasConnectedSource()]


def source_node(output: UsdShade.Output) -> Usd.Prim | None:
    """The shader prim at the far end of an output, through node graphs."""
    for attribute in UsdShade.Utils.GetValueProducingAttributes(output):
        if attribute.GetPrim().IsA(UsdShade.Shader):
            return attribute.GetPrim()
    return None


def shader_id(node: Usd.Prim) -> str:
    identifier = UsdShade.Shader(node).GetIdAttr().Get()
    return identifier if isinstance(identifier, str) else ""


def warn_ignored(shader_input: UsdShade.Input, shader: Shader, reader: Reader) -> None:
    node, name = shader_input.GetPrim(), shader_input.GetBaseName()
    if name not in shader.ignored:
        reader.warn(node, f"inputs:{name}: not an input of {shader.name}; ignored")
        return
    default = shader.ignored[name]
    value = input_value(shader_input, default, reader, quiet=True) if default is not ANY else None
    if shader_input.HasConnectedSource() or (default is ANY and shader_input.Get() is not None):
        reader.warn(node, f"inputs:{name}: not supported yet; ignored")
    elif value is not None and value != default:
        reader.warn(
            node, f"inputs:{name}: not supported yet; {value} is ignored, the default {default} rendered"
        )


def input_value(shader_input: UsdShade.Input, default: Any, reader: Reader, quiet: bool = False) -> Any:
    """The input's value as the type of `default`, or None where nothing usable is authored."""
    node, name = shader_input.GetPrim(), shader_input.GetFullName()
    attributes = UsdShade.Utils.GetValueProducingAttributes(shader_input)
    if not attributes and shader_input.GetAttr().HasAuthoredConnections() and not quiet:
        reader.warn(node, f"{name}: its connection leads to no value; the default is used")
    for attribute in attributes[:1]:
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            return None if quiet else node_value(node, name, attribute, default, reader)
        value = attribute.Get(reader.time)
        return (
            None
            if value is None
            else reader.coerced(attribute.GetPrim(), attribute.GetName(), value, default)
        )
    return None


def node_value(user: Usd.Prim, name: str, output: Usd.Attribute, default: Any, reader: Reader) -> Any:
    """What a pattern node gives: a constant its value, a texture its fallback, a displayColor reader None."""
    node = UsdShade.Shader(output.GetPrim())
    identifier = shader_id(output.GetPrim())
    if identifier.startswith("ND_constant_"):
        value = node.GetInput("value")
        return input_value(value, default, reader) if value else None
    if identifier == "UsdUVTexture":
        reader.warn(
            user,
            f"{name}: textures are not supported yet: using the fallback of {output.GetPrim().GetPath()}",
        )
        return channel(node.GetInput("fallback"), str(output.GetName()), default, reader)
    if identifier.startswith(("ND_image_", "ND_tiledimage_", "ND_UsdUVTexture")):
        reader.warn(
            user,
            f"{name}: textures are not supported yet: using the fallback of {output.GetPrim().GetPath()}",
        )
        return optional_value(node.GetInput("default") or node.GetInput("fallback"), default, reader)
    if identifier.startswith("UsdPrimvarReader"):
        return primvar_value(user, name, node, default, reader)
    reader.warn(user, f"{name}: node '{identifier}' is not supported yet; the default is used")
    return None


def optional_value(shader_input: UsdShade.Input, default: Any, reader: Reader) -> Any:
    return input_value(shader_input, default, reader) if shader_input else None


def channel(fallback: UsdShade.Input, output: str, default: Any, reader: Reader) -> Any:
    """The part of a UsdUVTexture's fallback (rgba) that an output gives; None where no fallback is
    authored."""
    rgba = optional_value(fallback, (0.0, 0.0, 0.0, 1.0), reader)
    if rgba is None:
        return None
    if isinstance(default, tuple):
        return rgba[:3]
    index = "rgba".find(output.removeprefix("outputs:"))
    return type(default)(rgba[max(index, 0)])


def primvar_value(user: Usd.Prim, name: str, node: UsdShade.Shader, default: Any, reader: Reader) -> Any:
    """displayColor as diffuseColor is what an unauthored diffuseColor means; others give their fallback."""
    variable = optional_value(node.GetInput("varname"), "", reader)
    if variable == "displayColor" and name == "inputs:diffuseColor":
        return None
    reader.warn(user, f"{name}: primvar '{variable}' cannot drive it yet: using the reader's fallback")
    return optional_value(node.GetInput("fallback"), default, reader)
