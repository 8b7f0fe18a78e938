"""Meshes: topology, primvars of every interpolation, normals, inherited state, bad input."""

import numpy as np
import pytest

QUADS = """
    int[] faceVertexCounts = [4, 3]
    int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)]
    uniform token subdivisionScheme = "none"
"""


def mesh(extra: str = "", body: str = QUADS) -> str:
    return f'def Mesh "M"\n{{{body}{extra}\n}}\n'


def test_topology(flat):
    m = flat(
        mesh(
            "    int[] holeIndices = [1]\n    uniform token orientation = 'leftHanded'\n"
            "    bool doubleSided = 1"
        )
    )
    m = m.prims["/M"]
    assert m["faceVertexCounts"].tolist() == [4, 3]
    assert m["faceVertexIndices"].dtype == np.int32 and m["points"].dtype == np.float32
    assert m["points"].shape == (5, 3)
    assert m["holeIndices"].tolist() == [1]
    assert m["orientation"] == "leftHanded" and m["doubleSided"] is True
    assert m["subdivisionScheme"] == "none" and m["visible"] is True


def test_unauthored_scheme_is_catmull_clark_without_normals(flat):
    body = QUADS.replace('uniform token subdivisionScheme = "none"', "")
    result = flat(mesh("    normal3f[] normals = [(0, 0, 1)]", body))
    assert result.prims["/M"]["subdivisionScheme"] == "catmullClark"
    assert "normals" not in result.prims["/M"] and result.warnings == []


READER = """
def Material "Reads"
{
    token outputs:surface.connect = </Reads/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </Reads/R.outputs:result>
        token outputs:surface
    }
    def Shader "R"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 inputs:fallback = (0, 1)
        float2 outputs:result
    }
}
"""


def reading(extra: str) -> str:
    """The mesh with a material that reads st."""
    bound = mesh(f"    rel material:binding = </Reads>\n{extra}")
    return READER + bound.replace('"M"', '"M" (prepend apiSchemas = ["MaterialBindingAPI"])', 1)


@pytest.mark.parametrize(
    ("interpolation", "count"),
    [("constant", 1), ("uniform", 2), ("varying", 5), ("vertex", 5), ("faceVarying", 7)],
)
def test_every_interpolation(flat, interpolation, count):
    values = ", ".join(f"({i}, 0)" for i in range(count))
    primvar = f'    texCoord2f[] primvars:st = [{values}] (\n        interpolation = "{interpolation}"\n    )'
    st = flat(reading(primvar)).prims["/M"]["primvars"]["st"]
    assert st["type"] == "float2" and st["interpolation"] == interpolation
    assert st["values"].shape == (count, 2)
    assert "indices" not in st
    wrong = primvar.replace("(0, 0)", "(0, 0), (9, 9)")
    assert "primvars" not in flat(mesh(primvar)).prims["/M"], "nobody reads it"
    result = flat(reading(wrong))
    problem = f"{count + 1} values where {interpolation} interpolation needs {count}"
    assert "primvars" not in result.prims["/M"]
    assert result.warnings == [("/M", f"primvars:st: {problem}; it is ignored")]


def test_indexed_primvar_keeps_its_indices(flat):
    text = (
        "    color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] (\n"
        '        interpolation = "uniform"\n    )\n'
        "    int[] primvars:displayColor:indices = [1, 0]"
    )
    color = flat(mesh(text)).prims["/M"]["displayColor"]
    assert color["indices"].tolist() == [1, 0] and len(color["values"]) == 2


def test_inherited_constant_primvars(flat):
    body = """
def Xform "A"
{
    color3f[] primvars:displayColor = [(0.5, 0.25, 0)]
    float[] primvars:displayOpacity = [0.5] (
        interpolation = "constant"
    )
    def Mesh "Plain"
    {
        %s
    }
    def Mesh "Own"
    {
        %s
        color3f[] primvars:displayColor = [(1, 1, 1)]
    }
    def Xform "Blocked"
    {
        color3f[] primvars:displayColor = [(1, 1, 1), (1, 1, 1)] (
            interpolation = "vertex"
        )
        def Mesh "Below"
        {
            %s
        }
    }
}
""".replace("%s", QUADS)
    prims = flat(body).prims
    assert prims["/A/Plain"]["displayColor"]["values"].tolist() == [[0.5, 0.25, 0.0]]
    assert prims["/A/Plain"]["displayOpacity"]["values"].tolist() == [0.5]
    assert prims["/A/Own"]["displayColor"]["values"].tolist() == [[1.0, 1.0, 1.0]]
    assert "displayColor" not in prims["/A/Blocked/Below"]


def test_primvar_normals_beat_normals(flat):
    plain = '    normal3f[] normals = [(0, 0, 1), (0, 0, 1)] (\n        interpolation = "uniform"\n    )\n'
    primvar = '    normal3f[] primvars:normals = [(1, 0, 0)] (\n        interpolation = "constant"\n    )\n'
    assert flat(mesh(plain)).prims["/M"]["normals"]["interpolation"] == "uniform"
    assert flat(mesh(plain + primvar)).prims["/M"]["normals"]["values"].tolist() == [[1.0, 0.0, 0.0]]


def test_reset_xform_stack(flat):
    body = """
def Xform "A"
{
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Sphere "Below"
    {
    }
    def Sphere "Reset"
    {
        double3 xformOp:translate = (10, 0, 0)
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate"]
    }
}
"""
    prims = flat(body).prims
    assert prims["/A/Below"]["transform"][3][:3] == [1, 2, 3]
    assert prims["/A/Reset"]["transform"][3][:3] == [10, 0, 0]


def test_visibility_and_purpose(flat):
    body = """
def Xform "Hidden"
{
    token visibility = "invisible"
    def Sphere "S"
    {
    }
}
def Xform "Proxy"
{
    uniform token purpose = "proxy"
    def Sphere "S"
    {
    }
    def Sphere "Render"
    {
        uniform token purpose = "render"
    }
    def Sphere "Default"
    {
        uniform token purpose = "default"
    }
}
def Sphere "Guide"
{
    uniform token purpose = "guide"
}
"""
    prims = flat(body, purposes=("proxy",)).prims
    assert list(prims) == ["/Hidden/S", "/Proxy/S", "/Proxy/Default"]
    assert prims["/Hidden/S"]["visible"] is False
    assert list(flat(body, purposes=()).prims) == ["/Hidden/S", "/Proxy/Default"]
    # Without a word the render settings decide; without those, default and render.
    assert list(flat(body).prims) == ["/Hidden/S", "/Proxy/Render", "/Proxy/Default"]


@pytest.mark.parametrize(
    ("attribute", "word"),
    [
        ("point3f[] points = []", "points"),
        ("string points = 'x'", "points"),
        ("int[] faceVertexCounts = []", "faceVertexCounts"),
        ("float[] faceVertexIndices = [0.5, 1, 2]", "faceVertexIndices"),
    ],
)
def test_unusable_arrays_cost_the_mesh_and_say_so(flat, attribute, word):
    name = attribute.split(" ")[1]
    lines = [line for line in QUADS.splitlines() if f" {name} " not in line]
    result = flat(mesh(f"    {attribute}", "\n".join(lines) + "\n") + 'def Sphere "Ball"\n{\n}\n')
    assert list(result.prims) == ["/Ball"]
    assert all(prim == "/M" and word in message for prim, message in result.warnings) and result.warnings


def test_damaged_scalars_become_defaults(flat):
    result = flat(
        mesh("    string doubleSided = 'yes'\n    uniform token orientation = 'sideways'\n")
        + 'def Sphere "Nan"\n{\n    double radius = nan\n}\n'
        + 'def Cube "Inf"\n{\n    double3 xformOp:translate = (inf, 0, 0)\n'
        + '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    )
    assert result.prims["/M"]["doubleSided"] is False
    assert result.prims["/M"]["orientation"] == "rightHanded"
    assert result.prims["/Nan"]["points"].max() == pytest.approx(1.0)
    assert result.prims["/Inf"]["transform"][3] == [0, 0, 0, 1]
    said = {(prim, message.split(":")[0]) for prim, message in result.warnings}
    assert said == {
        ("/M", "doubleSided"),
        ("/M", "orientation"),
        ("/Nan", "radius"),
        ("/Inf", "xformOpOrder"),
    }


def test_wrong_types_cost_an_attribute_and_not_the_prim(flat):
    body = """
def Sphere "S" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    string xformOp:translate = "far"
    uniform token[] xformOpOrder = ["xformOp:translate"]
    double radius = 1e300
    int visibility = 3
    string primvars:displayColor = "red"
}
def SphereLight "L"
{
    string collection:lightLink:membershipExpression = "x"
    float3 inputs:shaping:ies:file = (1, 2, 3)
    token[] inputs:color = ["red"]
}
"""
    result = flat(body)
    assert result.prims["/S"]["transform"][3] == [0, 0, 0, 1]
    assert result.prims["/S"]["points"].max() == pytest.approx(1.0)
    assert "displayColor" not in result.prims["/S"]
    assert result.prims["/L"]["color"] == [1.0, 1.0, 1.0]
    said = {(prim, message.split(": ")[0]) for prim, message in result.warnings}
    assert said == {
        ("/S", "xformOpOrder"),
        ("/S", "radius"),
        ("/S", "visibility"),
        ("/S", "primvars:displayColor"),
        ("/L", "inputs:shaping:ies:file"),
        ("/L", "inputs:color"),
    }


def test_prims_not_rendered_yet_are_named_once_per_type(flat):
    body = "".join(
        f'def {kind} "{kind}{i}"\n{{\n}}\n'
        for kind in ("NurbsCurves", "NurbsPatch", "Volume", "TetMesh")
        for i in range(2)
    )
    warnings = flat(body).warnings
    assert sorted(prim for prim, _ in warnings) == [
        "/NurbsCurves0",
        "/NurbsPatch0",
        "/TetMesh0",
        "/Volume0",
    ]
    assert all("not rendered yet; nor are /" in message for _, message in warnings)


def model(name: str, metadata: str = "", *lines: str, inner: str = "") -> str:
    text = "\n".join(f"    {line}" for line in lines)
    return (
        f'def Xform "{name}" (\n{metadata}\n)\n{{\n{text}\n    def Cube "Body"\n    {{\n    }}\n{inner}\n}}\n'
    )


CARDS, BOUNDS = ('uniform token model:drawMode = "cards"', 'uniform token model:drawMode = "bounds"')
APPLY, COMPONENT = "uniform bool model:applyDrawMode = 1", 'kind = "component"'


def test_models_that_would_be_drawn_as_something_else_are_named(flat):
    """usdrecord draws cards, bounds or an origin for components, and for what asks for it."""
    body = model("A", COMPONENT, CARDS) + model("B", 'kind = "group"', CARDS, APPLY)
    body += model("C", 'kind = "group"', BOUNDS, inner=model("Part", COMPONENT))
    result = flat(body)
    assert result.warnings == [
        ("/A", "model:drawMode: 'cards' is not drawn; the model itself is rendered; so is /B"),
        ("/C/Part", "model:drawMode: 'bounds' is not drawn; the model itself is rendered"),
    ]
    assert set(result.prims) == {"/A/Body", "/B/Body", "/C/Body", "/C/Part/Body"}


@pytest.mark.parametrize(
    "body",
    [
        model("A", 'kind = "group"', CARDS),
        model("A", COMPONENT),
        model("A", COMPONENT, 'uniform token model:drawMode = "default"'),
        model("A", COMPONENT, CARDS, 'token visibility = "invisible"'),
        model("A", 'kind = "group"', CARDS, inner=model("P", COMPONENT, CARDS.replace("cards", "default"))),
        model("A", 'kind = "group"', APPLY),
    ],
)
def test_models_that_are_drawn_as_they_are(flat, body):
    assert flat(body).warnings == []


CREASED = QUADS.replace(
    'uniform token subdivisionScheme = "none"',
    """uniform token interpolateBoundary = "edgeOnly"
    uniform token faceVaryingLinearInterpolation = "all"
    uniform token triangleSubdivisionRule = "smooth"
    int[] creaseIndices = [0, 1]
    int[] creaseLengths = [2]
    float[] creaseSharpnesses = [2.5]
    int[] cornerIndices = [3]
    float[] cornerSharpnesses = [1.5]
    int primvars:dermis:refineLevel = 2""",
)


def test_subdivision_tags(flat):
    result = flat(mesh(body=CREASED))
    fields = result.prims["/M"]
    assert result.warnings == [] and fields["refineLevel"] == 2
    tags = {name: list(v) if isinstance(v, np.ndarray) else v for name, v in fields["subdivTags"].items()}
    assert tags == {
        "interpolateBoundary": "edgeOnly",
        "faceVaryingLinearInterpolation": "all",
        "triangleSubdivisionRule": "smooth",
        "creaseIndices": [0, 1],
        "creaseLengths": [2],
        "creaseSharpnesses": [2.5],
        "cornerIndices": [3],
        "cornerSharpnesses": [1.5],
    }


def test_a_refine_level_is_inherited_and_checked(flat):
    group = 'def Xform "G"\n{\n    int primvars:dermis:refineLevel = 3\n'
    body = CREASED.replace("    int primvars:dermis:refineLevel = 2", "")
    assert flat(group + mesh(body=body) + "}\n").prims["/G/M"]["refineLevel"] == 3
    assert flat(group + mesh(body=CREASED) + "}\n").prims["/G/M"]["refineLevel"] == 2
    result = flat(mesh(body=CREASED.replace("Level = 2", "Level = 9")))
    assert "refineLevel" not in result.prims["/M"] and "9 is none of 0 to 8" in result.warnings[0][1]
