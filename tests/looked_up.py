"""What a shading network gives at chosen texture coordinates: quads that glow in it, one pixel of each."""

import json
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd

import dermis
from dermis._core import Delegate
from dermis.hydra import populate
from dermis.stage import Options, flatten

PIXELS = 3
"""Side of a quad in pixels: the filter reaches one pixel, so that the middle one sees its quad alone."""


def shader(name: str, identifier: str, *lines: str) -> str:
    body = "\n".join(f"        {line}" for line in lines)
    return (
        f'    def Shader "{name}"\n    {{\n        uniform token info:id = "{identifier}"\n{body}\n    }}\n'
    )


def connect(kind: str, name: str, node: str) -> str:
    """An input of a MaterialX node that another one drives."""
    return f"{kind} inputs:{name}.connect = </Look/{node}.outputs:out>"


ST = shader("ST", "ND_texcoord_vector2", "int inputs:index = 0", "float2 outputs:out")


def reader(name: str = "R", varname: str = "st", kind: str = "float2", fallback: str = "") -> str:
    lines = [f'string inputs:varname = "{varname}"', f"{kind} outputs:result"]
    lines += [f"{kind} inputs:fallback = {fallback}"] if fallback else []
    return shader(name, f"UsdPrimvarReader_{kind}", *lines)


def glowing(nodes: str, source: str, extra: str = "") -> str:
    """A material that emits what `source`, an output of `nodes`, gives, and reflects nothing."""
    return (
        'def Material "Look"\n{\n    token outputs:surface.connect = </Look/S.outputs:surface>\n'
        + shader(
            "S",
            "UsdPreviewSurface",
            "color3f inputs:diffuseColor = (0, 0, 0)",
            "int inputs:useSpecularWorkflow = 1",
            f"color3f inputs:emissiveColor.connect = </Look/{source}>",
            extra,
            "token outputs:surface",
        )
        + nodes
        + "}\n"
    )


def quads(count: int, primvars: str) -> str:
    """Unit squares in a row along x, bound to the material."""
    points = [(x + dx, dy, 0) for x in range(count) for dx, dy in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return (
        'def Mesh "Row" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n{\n'
        f"    rel material:binding = </Look>\n    int[] faceVertexCounts = {[4] * count}\n"
        f"    int[] faceVertexIndices = {list(range(4 * count))}\n    point3f[] points = {points}\n"
        f'    uniform token subdivisionScheme = "none"\n{primvars}\n}}\n'
    )


def primvar(name: str, kind: str, values: Sequence, interpolation: str = "uniform") -> str:
    listed = ", ".join(repr(v) for v in values)
    return f'    {kind}[] primvars:{name} = [{listed}] (\n        interpolation = "{interpolation}"\n    )'


def camera(width: float, height: float = 1.0) -> str:
    """Looks down on width x height at the origin; apertures are tenths of a unit."""
    return (
        'def Camera "Eye"\n{\n    token projection = "orthographic"\n    float2 clippingRange = (0.1, 100)\n'
        f"    float horizontalAperture = {10 * width}\n    float verticalAperture = {10 * height}\n"
        f"    double3 xformOp:translate = ({width / 2}, {height / 2}, 5)\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )


def stage_of(text: str) -> Usd.Stage:
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString("#usda 1.0\n" + text)
    return Usd.Stage.Open(layer)


def looked_up(material: str, st: Sequence[tuple[float, float]], primvars: str = "") -> NDArray[np.float32]:
    """(n, 3): the glow at each of `st`, which is constant over its quad, so that images show their finest level."""
    n = len(st)
    body = material + quads(n, primvar("st", "texCoord2f", [tuple(p) for p in st]) + "\n" + primvars)
    return middles(render(body, n), n)


def render(text: str, count: int, **settings: object) -> dermis.Image:
    settings = {"resolution": [count * PIXELS, PIXELS], "samples": 1, "aovs": ["albedo"], **settings}
    return dermis.render(stage_of(text + camera(count)), camera="/Eye", **settings)


def middles(image: dermis.Image, count: int) -> NDArray[np.float32]:
    return image.color[1, 1::PIXELS, :3][:count]


def images_of_edits(texts: Sequence[str], **settings: object) -> Iterator[tuple[int, dict, dict]]:
    """(meshes built, AOVs after the edit, AOVs of a fresh load): one stage after the other is brought to a delegate."""
    edited, previous = Delegate(), None
    for text in texts:
        flat = flatten(stage_of(text), None, Options(aovs=tuple(settings["aovs"])))
        fresh = Delegate()
        populate(edited, flat, previous)
        populate(fresh, flat)
        previous, images = flat, []
        for core in (edited, fresh):
            core.set_settings(json.dumps({"camera": "/Eye", **settings}))
            built = json.loads(core.commit())["blas_built"]
            core.start()
            assert core.wait(60.0)
            images.append((built, core.snapshot()))
        yield images[0][0], images[0][1], images[1][1]
