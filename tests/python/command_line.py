"""What tests of the command line share: small stages, runs, images read back."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from dermis.cli import main

CARD = """
    def Mesh "Card"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
        color3f[] primvars:displayColor = [(1, 1, 1)]
        uniform token subdivisionScheme = "none"
    }
"""

CAMERA = """
    def Camera "main_cam"
    {
        float horizontalAperture = 20
        float verticalAperture = 20
        float focalLength = 50
        double3 xformOp:translate = (0, 0, 10)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""

DOME = """
    def DomeLight "Dome"
    {
        float inputs:intensity = 1
    }
"""

#: A small lamp beside a ball of wax and a card: guided walks, and pixels of different noise.
WAX = """
    def Sphere "Ball" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {
        double radius = 1
        rel material:binding = </World/Wax>
        double3 xformOp:translate = (0, 0, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Material "Wax"
    {
        token outputs:surface.connect = </World/Wax/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:subsurface = 1
            color3f inputs:subsurfaceColor = (0.8, 0.6, 0.5)
            color3f inputs:subsurfaceRadius = (0.2, 0.1, 0.05)
            token outputs:surface
        }
    }
    def SphereLight "Lamp"
    {
        float inputs:intensity = 60
        float inputs:radius = 0.3
        double3 xformOp:translate = (2, 2, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


def stage_text(*prims: str, metadata: str = "", outside: str = "") -> str:
    """A stage with the given prims below /World."""
    body = "\n".join(prims)
    return f'#usda 1.0\n(\n    upAxis = "Y"\n    {metadata}\n)\ndef Xform "World"\n{{\n{body}\n}}\n{outside}'


def write_stage(file: Path, text: str) -> str:
    """USD keeps a layer open by its name while anything holds it: what was read before is read again."""
    file.write_text(text)
    if layer := Sdf.Layer.Find(str(file)):
        layer.Reload(True)
    return str(file)


def run(*arguments: str | Path) -> int:
    """Exit code of `dermis ARGUMENTS`."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as leave:
        return leave.code


def start(*arguments: str | Path, **options) -> subprocess.Popen:
    """`dermis ARGUMENTS` as a process of its own."""
    command = [sys.executable, "-m", "dermis", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def read_exr(file: Path):
    """The image's specification and its float pixels (height, width, channels)."""
    oiio = pytest.importorskip("OpenImageIO")
    image = oiio.ImageBuf(str(file))
    assert not image.has_error, image.geterror()
    return image.spec(), image.get_pixels(oiio.FLOAT)


def channels(file: Path) -> dict[str, np.ndarray]:
    """Every channel by name; ids as they are."""
    from dermis.merging import read_part

    return read_part(str(file)).channels


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
