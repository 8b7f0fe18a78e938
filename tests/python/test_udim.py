"""Tiles that faces are in and that have no file are named; nothing is said of what is only touched."""

from pathlib import Path

import numpy as np
import pytest
from conftest import stage_of
from PIL import Image

from dermis.stage import flatten

LOOK = """
def Material "%(name)s"
{
    token outputs:surface.connect = </%(name)s/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </%(name)s/T.outputs:rgb>
        token outputs:surface
    }
    def Shader "T"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @%(file)s@
        float2 inputs:st.connect = </%(name)s/R.outputs:result>
        float3 outputs:rgb
    }
    def Shader "R"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""

CORNERS = [(0, 0), (1, 0), (1, 1), (0, 1)]


def squares(places: list[tuple[float, float]], interpolation: str, more: str = "") -> str:
    """Squares that fill a tile each, at `places` of st."""
    st = [(u + x, v + y) for u, v in places for x, y in CORNERS]
    n = len(places)
    return f"""
def Mesh "M" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    int[] faceVertexCounts = {[4] * n}
    int[] faceVertexIndices = {list(range(4 * n))}
    point3f[] points = {[(x, y, float(i)) for i in range(n) for x, y in CORNERS]}
    texCoord2f[] primvars:st = {st} (interpolation = "{interpolation}")
    uniform token subdivisionScheme = "none"
    rel material:binding = </Look>
{more}
}}
"""


@pytest.fixture
def tiles(tmp_path: Path) -> Path:
    """Of 1001, 1002 and 1011 there are files."""
    for number in (1001, 1002, 1011):
        Image.fromarray(np.full((2, 2, 3), 200, np.uint8)).save(tmp_path / f"t.{number}.png")
    return tmp_path / "t.<UDIM>.png"


def said(text: str, **looks: Path | str) -> list[tuple[str, str]]:
    materials = "".join(LOOK % {"name": name, "file": file} for name, file in looks.items())
    return flatten(stage_of(text + materials)).warnings


@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_tiles_without_a_file_are_named(tiles, interpolation):
    text = squares([(0, 0), (1, 0), (0, 1), (1, 1), (9, 2), (11, 0), (-1, 0)], interpolation)
    message = "primvars:st: of /Look there is t.1001.png, but not 1012, 1030; these faces get the fallback"
    assert said(text, Look=tiles) == [("/M", message)]


def test_what_faces_only_touch_is_not_missed(tiles):
    assert said(squares([(0, 0), (1, 0), (0, 1)], "vertex"), Look=tiles) == []


def test_subsets_look_into_their_own_images(tiles, tmp_path):
    subset = """
    def GeomSubset "Part" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1]
        rel material:binding = </Other>
    }
"""
    Image.fromarray(np.full((2, 2, 3), 200, np.uint8)).save(tmp_path / "o.1001.png")
    text = squares([(0, 0), (3, 0)], "vertex", subset)
    found = said(text, Look=tiles, Other=tmp_path / "o.<UDIM>.png")
    assert [message.split(";")[0] for _, message in found] == [
        "primvars:st: of /Other there is o.1001.png, but not 1004"
    ]
    (tmp_path / "plain.png").write_bytes((tmp_path / "o.1001.png").read_bytes())
    assert said(text, Look=tiles, Other=tmp_path / "plain.png") == []
