"""Materials: bindings, surface resolution, inputs through connections, fallbacks and what is said."""

import pytest

from dermis.stage import flatten, open_stage


def material(
    shader_id: str, inputs: str = "", name: str = "M", output: str = "outputs:surface", extra: str = ""
) -> str:
    return (
        f'def Material "{name}"\n{{\n    token {output}.connect = </{name}/S.outputs:out>\n'
        f'    def Shader "S"\n    {{\n        uniform token info:id = "{shader_id}"\n{inputs}\n'
        f"        token outputs:out\n    }}\n{extra}}}\n"
    )


def ball(target: str = "/M", name: str = "B", body: str = "") -> str:
    return (
        f'def Sphere "{name}" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n'
        f"{{\n    rel material:binding = <{target}>\n{body}}}\n"
    )


@pytest.mark.parametrize("shader_id", ["UsdPreviewSurface", "ND_UsdPreviewSurface_surfaceshader"])
def test_preview_surface(flat, shader_id):
    inputs = """
        color3f inputs:diffuseColor = (0.1, 0.2, 0.3)
        int inputs:useSpecularWorkflow = 1
        float inputs:subsurface = 0.5
        color3f inputs:subsurfaceRadius = (3, 2, 1)
        token inputs:subsurfaceBoundary = "dielectric"
        float inputs:occlusion = 0.5
        normal3f inputs:normal = (0, 0, 1)
"""
    result = flat(material(shader_id, inputs) + ball())
    assert result.warnings == []
    assert result.prims["/B"]["material"] == "/M"
    assert result.prims["/M"] == {
        "type": "Material",
        "shader": "UsdPreviewSurface",
        "diffuseColor": pytest.approx([0.1, 0.2, 0.3]),
        "useSpecularWorkflow": 1,
        "subsurface": 0.5,
        "subsurfaceRadius": [3.0, 2.0, 1.0],
        "subsurfaceBoundary": "dielectric",
    }


@pytest.mark.parametrize(
    ("shader_id", "name"),
    [
        ("ND_open_pbr_surface_surfaceshader", "subsurface_radius_scale"),
        ("ND_standard_surface_surfaceshader", "subsurface_radius"),
    ],
)
def test_materialx_surfaces(flat, shader_id, name):
    inputs = f"        color3f inputs:{name} = (1, 0.5, 0.25)\n        float inputs:specular_roughness = 0.1"
    result = flat(material(shader_id, inputs, output="outputs:mtlx:surface") + ball())
    assert result.warnings == []
    assert result.prims["/M"] == {
        "type": "Material",
        "shader": shader_id,
        name: [1.0, 0.5, 0.25],
        "specular_roughness": pytest.approx(0.1),
    }


def test_materialx_output_comes_first_and_unknown_shaders_fall_back(flat):
    both = material(
        "UsdPreviewSurface",
        extra='    token outputs:mtlx:surface.connect = </M/X.outputs:out>\n    def Shader "X"\n    {\n'
        '        uniform token info:id = "%s"\n        token outputs:out\n    }\n',
    )
    assert (
        flat(both % "ND_standard_surface_surfaceshader" + ball())
        .prims["/M"]["shader"]
        .startswith("ND_standard")
    )
    result = flat(both % "ND_unknown" + ball())
    assert result.prims["/M"] == {"type": "Material", "shader": "UsdPreviewSurface"}
    ((prim, message),) = result.warnings
    assert prim == "/M" and "ND_unknown" in message and "outputs:surface is used" in message


@pytest.mark.parametrize("text", [material("PxrSurface"), 'def Material "M"\n{\n}\n'])
def test_nothing_known_is_display_color(flat, text):
    result = flat(text + ball())
    assert result.prims["/M"] == {"type": "Material", "shader": "UsdPreviewSurface"}
    assert "displayColor is used" in result.warnings[0][1]


def test_missing_material_is_said(flat):
    result = flat(ball("/Gone"))
    assert result.prims["/B"]["material"] == ""
    assert result.warnings[0][0] == "/B" and "/Gone is no material" in result.warnings[0][1]


def test_interfaces_graphs_and_constants(usd_scenes):
    result = flatten(open_stage(usd_scenes / "materials.usda"))
    assert result.warnings == []
    skin = pytest.approx([0.8, 0.5, 0.4])
    assert result.prims["/World/Looks/OpenPBR"]["base_color"] == skin
    assert result.prims["/World/Looks/OpenPBR"]["subsurface_color"] == skin
    assert result.prims["/World/Looks/StandardSurface"]["base_color"] == skin


def node(name: str, shader_id: str, body: str) -> str:
    return f'    def Shader "{name}"\n    {{\n        uniform token info:id = "{shader_id}"\n{body}\n    }}\n'


@pytest.mark.parametrize(
    ("fallback", "output", "target", "expected"),
    [
        (
            "float4 inputs:fallback = (0.1, 0.2, 0.3, 0.4)",
            "rgb",
            "color3f inputs:diffuseColor",
            [0.1, 0.2, 0.3],
        ),
        ("float4 inputs:fallback = (0.1, 0.2, 0.3, 0.4)", "g", "float inputs:roughness", 0.2),
        ("float4 inputs:fallback = (0.1, 0.2, 0.3, 0.4)", "a", "float inputs:opacity", 0.4),
        ("", "rgb", "color3f inputs:diffuseColor", [0.0, 0.0, 0.0]),
    ],
)
def test_missing_textures_give_their_fallback(flat, fallback, output, target, expected):
    texture = node(
        "T",
        "UsdUVTexture",
        f"        {fallback}\n        asset inputs:file = @a.png@\n        float outputs:{output}",
    )
    result = flat(
        material("UsdPreviewSurface", f"        {target}.connect = </M/T.outputs:{output}>", extra=texture)
        + ball()
    )
    value = result.prims["/M"].get(target.split(":")[1])
    assert value == pytest.approx(expected)
    assert result.warnings == [("/M/T", "inputs:file: a.png: the file was not found; the fallback is used")]


def test_missing_materialx_image_gives_its_default(flat):
    image = node(
        "T",
        "ND_image_color3",
        "        color3f inputs:default = (1, 0, 0)\n        asset inputs:file = @no.exr@\n        color3f outputs:out",
    )
    inputs = "        color3f inputs:base_color.connect = </M/T.outputs:out>"
    result = flat(material("ND_open_pbr_surface_surfaceshader", inputs, extra=image) + ball())
    assert result.prims["/M"]["base_color"] == [1.0, 0.0, 0.0]
    assert result.warnings == [("/M/T", "inputs:file: no.exr: the file was not found; the fallback is used")]


def test_display_color_reader_leaves_diffuse_unset(flat):
    reader = node(
        "R",
        "UsdPrimvarReader_float3",
        '        string inputs:varname = "displayColor"\n        float3 outputs:result',
    )
    inputs = "        color3f inputs:diffuseColor.connect = </M/R.outputs:result>"
    result = flat(material("UsdPreviewSurface", inputs, extra=reader) + ball())
    assert result.prims["/M"] == {"type": "Material", "shader": "UsdPreviewSurface"} and result.warnings == []


@pytest.mark.parametrize(
    ("shader_id", "text", "word"),
    [
        ("ND_standard_surface_surfaceshader", "float inputs:sheen = 0.5", "sheen"),
        ("ND_standard_surface_surfaceshader", "float inputs:coat_affect_color = 1", "coat_affect_color"),
        ("ND_standard_surface_surfaceshader", "bool inputs:thin_walled = 1", "thin_walled"),
        ("ND_open_pbr_surface_surfaceshader", "float inputs:thin_film_weight = 1", "thin_film_weight"),
        ("UsdPreviewSurface", "float inputs:displacement = 0.5", "displacement"),
        ("ND_standard_surface_surfaceshader", "vector3f inputs:normal = (0, 1, 1)", "normal"),
        ("UsdPreviewSurface", "float inputs:nonsense = 1", "nonsense"),
        ("UsdPreviewSurface", "string inputs:roughness = 'x'", "roughness"),
        ("UsdPreviewSurface", "float inputs:roughness = nan", "roughness"),
        ("UsdPreviewSurface", "float inputs:roughness.connect = </Gone.outputs:out>", "roughness"),
    ],
)
def test_what_is_not_rendered_is_said(flat, shader_id, text, word):
    result = flat(material(shader_id, f"        {text}") + ball())
    ((prim, message),) = result.warnings
    assert prim == "/M/S" and f"inputs:{word}" in message


def test_unrendered_inputs_at_their_default_say_nothing(flat):
    inputs = (
        "        float inputs:sheen = 0\n        color3f inputs:sheen_color = (1, 0, 0)\n"
        "        bool inputs:thin_walled = 0"
    )
    assert flat(material("ND_standard_surface_surfaceshader", inputs) + ball()).warnings == []


def test_only_bound_materials_are_emitted(flat):
    prims = flat(material("UsdPreviewSurface") + material("UsdPreviewSurface", name="Idle") + ball()).prims
    assert "/M" in prims and "/Idle" not in prims


def group(body: str, strength: str) -> str:
    return (
        'def Xform "G" (\n    prepend apiSchemas = ["MaterialBindingAPI"]\n)\n{\n'
        "    rel material:binding = </Weak> (\n"
        f'        bindMaterialAs = "{strength}"\n    )\n{body}}}\n'
    )


def test_inherited_bindings_and_strength(flat):
    materials = material("UsdPreviewSurface", name="Weak") + material("UsdPreviewSurface")
    weak = flat(materials + group(ball() + 'def Sphere "Plain"\n{\n}\n', "weakerThanDescendants")).prims
    assert (weak["/G/B"]["material"], weak["/G/Plain"]["material"]) == ("/M", "/Weak")
    strong = flat(materials + group(ball(), "strongerThanDescendants")).prims
    assert strong["/G/B"]["material"] == "/Weak"


def test_full_purpose_beats_all_purpose(flat):
    body = "    rel material:binding:full = </Full>\n    rel material:binding:preview = </Gone>\n"
    prims = flat(
        material("UsdPreviewSurface") + material("UsdPreviewSurface", name="Full") + ball(body=body)
    ).prims
    assert prims["/B"]["material"] == "/Full"


def test_collection_binding(flat):
    body = (
        'def Xform "G" (\n    prepend apiSchemas = ["MaterialBindingAPI", "CollectionAPI:some"]\n)\n{\n'
        "    rel collection:some:includes = </G/In>\n"
        "    rel material:binding:collection:some = [</G.collection:some>, </M>]\n"
        '    def Sphere "In"\n    {\n    }\n    def Sphere "Out"\n    {\n    }\n}\n'
    )
    prims = flat(material("UsdPreviewSurface") + body).prims
    assert (prims["/G/In"]["material"], prims["/G/Out"]["material"]) == ("/M", "")


def test_geometry_subsets(flat):
    subset = (
        '    def GeomSubset "%s" (\n        prepend apiSchemas = ["MaterialBindingAPI"]\n    )\n    {\n'
        '        uniform token elementType = "face"\n        uniform token familyName = "%s"\n'
        "        int[] indices = [1]\n        rel material:binding = </M>\n    }\n"
    )
    mesh = (
        'def Mesh "X"\n{\n    int[] faceVertexCounts = [3, 3]\n'
        "    int[] faceVertexIndices = [0, 1, 2, 2, 1, 3]\n"
        "    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]\n"
        f"{subset % ('Skin', 'materialBind')}{subset % ('Other', 'parts')}}}\n"
    )
    result = flat(material("UsdPreviewSurface") + mesh)
    (skin,) = result.prims["/X"]["geomSubsets"]
    assert (skin["path"], skin["material"], skin["indices"].tolist()) == ("/X/Skin", "/M", [1])
    assert result.prims["/X"]["material"] == ""


@pytest.mark.parametrize(
    ("kind", "lines", "said"),
    [
        ("Mesh", ("[0]", "face", "[1]", "face"), ()),
        ("Mesh", ("[0, 1]", "face", "[1]", "face"), (("/X", "subsets of family materialBind overlap"),)),
        ("Mesh", ("[0]", "face", "[1]", "point"), (("/X/B", "elementType: 'point', of a Mesh"),)),
        (
            "Sphere",
            ("[0]", "face", "[]", "face"),
            (("/X/A", "elementType: 'face', of a Sphere"), ("/X/B", "")),
        ),
    ],
)
def test_subsets_that_do_not_count_are_said(flat, kind, lines, said):
    subset = (
        '    def GeomSubset "%s"\n    {\n        uniform token familyName = "materialBind"\n'
        '        int[] indices = %s\n        uniform token elementType = "%s"\n    }\n'
    )
    body = (
        "    int[] faceVertexCounts = [3, 3]\n    int[] faceVertexIndices = [0, 1, 2, 2, 1, 3]\n"
        "    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]\n"
    )
    subsets = subset % ("A", *lines[:2]) + subset % ("B", *lines[2:])
    result = flat(f'def {kind} "X"\n{{\n{body if kind == "Mesh" else ""}{subsets}}}\n')
    for (path, message), (prim, words) in zip(result.warnings, said, strict=True):
        assert path == prim and message.startswith(words)
