"""Minimal stages: a lamp, a ball over a floor, a camera; each capability adds its lines."""

from dataclasses import dataclass

import numpy as np
from stability.scenes import sphere

LAMP = """
    def RectLight "Lamp"
    {
        float inputs:width = 2
        float inputs:height = 2
        float inputs:intensity = 10
        double3 xformOp:translate = (0, 0, 6)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""

OPAQUE = "color3f inputs:diffuseColor = (0.5, 0.5, 0.5)"

RINGS = 12
FACES = 4 * RINGS * (RINGS - 1)
"""Triangles of the ball."""


@dataclass(frozen=True)
class Stage:
    """Lines that are added to the stage; USD's words."""

    look: str = OPAQUE
    """Inputs of the ball's UsdPreviewSurface."""
    ball: str = ""
    """In the ball, beside its mesh."""
    worn: str = "/World/Look"
    """Material of the ball; /World/Look is there in any case."""
    camera: str = ""
    world: str = LAMP
    """All other prims, lights too."""
    flags: tuple[str, ...] = ("--set", "aovs=")
    """Of `dermis flatten`."""
    metadata: str = ""
    """Of the stage."""

    def text(self) -> str:
        return f"""#usda 1.0
(
    upAxis = "Y"
    {self.metadata}
)
def Xform "World"
{{
    def Camera "main_cam"
    {{
        float horizontalAperture = 20
        float verticalAperture = 20
        float focalLength = 50
        double3 xformOp:translate = (0, 0, 8)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {self.camera}
    }}
    def Mesh "Floor"
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-4, -1.2, 4), (4, -1.2, 4), (4, -1.2, -4), (-4, -1.2, -4)]
        uniform token subdivisionScheme = "none"
    }}
    {ball("Ball", self.worn, self.ball)}
    {material("Look", self.look)}
    {self.world}
}}
"""


def ball(name: str, look: str, lines: str = "", radius: float = 1.0) -> str:
    """A mesh that wears the material at `look`."""
    mesh = sphere(RINGS, radius)
    points = ", ".join(f"({x:.6g}, {y:.6g}, {z:.6g})" for x, y, z in mesh["points"])
    return f"""
    def Mesh "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        int[] faceVertexCounts = {numbers(mesh["faceVertexCounts"])}
        int[] faceVertexIndices = {numbers(mesh["faceVertexIndices"])}
        point3f[] points = [{points}]
        uniform token subdivisionScheme = "none"
        rel material:binding = <{look}>
        {lines}
    }}
"""


def numbers(values: np.ndarray) -> str:
    return str([int(value) for value in values])


def material(name: str, inputs: str) -> str:
    return f"""
    def Material "{name}"
    {{
        token outputs:surface.connect = </World/{name}/Surface.outputs:surface>
        token outputs:displacement.connect = </World/{name}/Surface.outputs:displacement>
        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            token outputs:surface
            token outputs:displacement
            {inputs}
        }}
    }}
"""


def medium(
    boundary: str = "diffuse",
    color: tuple[float, float, float] = (0.8, 0.8, 0.8),
    radius: tuple[float, float, float] = (0.1, 0.1, 0.1),
    more: str = "",
) -> str:
    """Inputs of a UsdPreviewSurface that is all medium."""
    return f"""
            float inputs:subsurface = 1
            color3f inputs:subsurfaceColor = {color}
            color3f inputs:subsurfaceRadius = {radius}
            token inputs:subsurfaceBoundary = "{boundary}"
            {more}
"""
