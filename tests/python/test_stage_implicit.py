"""Implicit prims: closed, oriented, of the right size, smooth where the shape is."""

from collections import Counter

import numpy as np
import pytest

from dermis.stage import flatten, open_stage

SHAPES = {
    'Sphere "S"\n{\n    double radius = 2\n}': (4 / 3 * np.pi * 8, (4, 4, 4)),
    'Cube "S"\n{\n    double size = 3\n}': (27.0, (3, 3, 3)),
    'Cylinder "S"\n{\n    double radius = 1\n    double height = 3\n}': (3 * np.pi, (2, 2, 3)),
    'Cone "S"\n{\n    double radius = 1\n    double height = 3\n}': (np.pi, (2, 2, 3)),
    'Capsule "S"\n{\n    double radius = 1\n    double height = 3\n}': (np.pi * (3 + 4 / 3), (2, 2, 5)),
    'Cylinder_1 "S"\n{\n    double radiusTop = 0.5\n    double radiusBottom = 1\n    double height = 3\n}': (
        np.pi * (1 + 0.5 + 0.25),
        (2, 2, 3),
    ),
    'Cylinder_1 "S"\n{\n    double radiusTop = 1\n    double radiusBottom = 0\n    double height = 3\n}': (
        np.pi,
        (2, 2, 3),
    ),
    'Capsule_1 "S"\n{\n    double radiusTop = 0.5\n    double radiusBottom = 1\n    double height = 3\n}': (
        np.pi * (2 / 3 + 1.75 + 2 / 3 / 8),
        (2, 2, 4.5),
    ),
}


def corners(mesh):
    """(face, corner) -> start offsets, and per face its index range."""
    starts = np.concatenate([[0], np.cumsum(mesh["faceVertexCounts"])])
    return [range(starts[i], starts[i + 1]) for i in range(len(starts) - 1)]


def triangles(mesh):
    """Fans: (n, 3) offsets into faceVertexIndices."""
    return np.array([[r[0], r[i], r[i + 1]] for r in corners(mesh) for i in range(1, len(r) - 1)])


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("shape", SHAPES, ids=lambda text: " ".join(text.split()))
def test_closed_outward_and_of_the_right_size(flat, shape, axis):
    volume, size = SHAPES[shape]
    text = (
        shape
        if shape.startswith(("Sphere", "Cube"))
        else shape[:-1] + f'    uniform token axis = "{axis}"\n}}'
    )
    result = flat(f"def {text}\n")
    assert result.warnings == []
    mesh = result.prims["/S"]
    points, indices = mesh["points"].astype(np.float64), mesh["faceVertexIndices"]
    # Watertight: every directed edge is met once, and once the other way round.
    edges = Counter((indices[r[i]], indices[r[i - 1]]) for r in corners(mesh) for i in range(len(r)))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    assert len(np.unique(points, axis=0)) == len(points)
    # Outward: the signed volume is that of the shape.
    a, b, c = (points[indices[triangles(mesh)[:, k]]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=4e-3)
    order = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[axis]
    assert np.ptp(points, axis=0) == pytest.approx(np.array(size, float)[order], rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda text: " ".join(text.split()))
def test_normals_are_unit_and_near_the_geometric_ones(flat, shape):
    mesh = flat(f"def {shape}\n").prims["/S"]
    normals = mesh["normals"]["values"][mesh["normals"]["indices"]].astype(np.float64)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)), abs=1e-6)
    corner = triangles(mesh)
    a, b, c = (mesh["points"][mesh["faceVertexIndices"][corner[:, k]]].astype(np.float64) for k in range(3))
    geometric = np.cross(b - a, c - a)
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    for k in range(3):
        assert np.einsum("ij,ij->i", geometric, normals[corner[:, k]]).min() > 0.99


def test_sphere_normals_are_exact(flat):
    mesh = flat('def Sphere "S"\n{\n    double radius = 2\n}\n').prims["/S"]
    normals = mesh["normals"]["values"][mesh["normals"]["indices"]]
    assert normals == pytest.approx(mesh["points"][mesh["faceVertexIndices"]] / 2, abs=1e-6)


@pytest.mark.parametrize(
    ("axis", "size", "normal"), [("X", [0, 3, 2], 0), ("Y", [2, 0, 3], 1), ("Z", [2, 3, 0], 2)]
)
def test_plane_is_a_two_sided_quad_along_its_axis(flat, axis, size, normal):
    text = f'    uniform token axis = "{axis}"\n    double width = 2\n    double length = 3\n'
    mesh = flat(f'def Plane "P"\n{{\n{text}}}\n').prims["/P"]
    a, b, c, _ = mesh["points"][mesh["faceVertexIndices"]]
    assert np.ptp(mesh["points"], axis=0).tolist() == size
    assert np.argmax(np.cross(b - a, c - a)) == normal and np.cross(b - a, c - a)[normal] > 0
    assert mesh["doubleSided"] is True
    assert (
        flat(f'def Plane "P"\n{{\n{text}    bool doubleSided = 0\n}}\n').prims["/P"]["doubleSided"] is False
    )


def test_odd_sizes(flat):
    result = flat(
        'def Sphere "Negative"\n{\n    double radius = -2\n}\n'
        'def Sphere "Zero"\n{\n    double radius = 0\n}\n'
        'def Cone "Axis"\n{\n    uniform token axis = "W"\n}\n'
    )
    assert result.prims["/Negative"]["points"].max() == pytest.approx(2.0)
    assert "/Zero" not in result.prims and "/Axis" in result.prims
    assert [prim for prim, _ in result.warnings] == ["/Negative", "/Zero", "/Axis"]


def test_our_stage(usd_scenes):
    result = flatten(open_stage(usd_scenes / "implicit.usda"))
    assert result.warnings == []
    assert sum(prim["type"] == "Mesh" for prim in result.prims.values()) == 8
    assert result.prims["/World/Shapes/Pear"]["displayColor"]["values"].shape == (1, 3)


TEXTURED = """
def Material "M"
{
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S"
    {
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
        color3f inputs:diffuseColor.connect = </M/R.outputs:result>
    }
    def Shader "R"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""


def textured(flat, shape, more=""):
    bound = shape.replace('"S"', '"S" (prepend apiSchemas = ["MaterialBindingAPI"])')
    result = flat(f"def {bound[:-1]}    rel material:binding = </M>\n{more}}}\n{TEXTURED}")
    assert result.warnings == []
    mesh = result.prims["/S"]
    st = mesh["primvars"]["st"]
    values = st["values"][st["indices"]] if "indices" in st else st["values"]
    return mesh, st["interpolation"], values.astype(np.float64)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("shape", [*SHAPES, 'Plane "S"\n{\n}'], ids=lambda text: " ".join(text.split()))
def test_texture_coordinates_are_within_the_image_and_not_mirrored(flat, shape, axis):
    if not shape.startswith("Cube"):
        shape = shape[:-1] + f'    uniform token axis = "{axis}"\n}}'
    mesh, interpolation, st = textured(flat, shape)
    assert interpolation == "faceVarying" and len(st) == len(mesh["faceVertexIndices"])
    assert st.min() == 0.0 and st.max() == 1.0
    a, b, c = (st[triangles(mesh)[:, k]] for k in range(3))
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert areas.min() > 0.0


def test_texture_coordinates_of_a_sphere_are_longitude_and_latitude(flat):
    mesh, _, st = textured(flat, 'Sphere "S"\n{\n    double radius = 2\n}')
    x, y, z = (mesh["points"][mesh["faceVertexIndices"]].astype(np.float64) / 2.0).T
    assert st[:, 1] == pytest.approx(0.5 + np.arcsin(np.clip(z, -1.0, 1.0)) / np.pi, abs=1e-6)
    beside = np.abs(z) < 0.999
    turns = st[beside, 0] - np.arctan2(y, x)[beside] / (2.0 * np.pi)
    assert turns == pytest.approx(np.rint(turns), abs=1e-6)


def test_authored_texture_coordinates_win(flat):
    more = '    texCoord2f[] primvars:st = [(0.25, 0.5)] (interpolation = "constant")\n'
    _, interpolation, st = textured(flat, 'Sphere "S"\n{\n}', more)
    assert interpolation == "constant" and st.tolist() == [[0.25, 0.5]]
