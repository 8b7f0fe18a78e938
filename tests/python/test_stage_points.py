"""Points: one sphere, a matrix and a colour for each."""

import numpy as np

BODY = """def Xform "X"
{
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]

    def Points "P"
    {
        point3f[] points = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
        float[] widths = %s
        color3f[] primvars:displayColor = %s (
            interpolation = "%s"
        )
    }
}
"""
COLORS = "[(1, 0, 0), (0, 1, 0), (0, 0, 1)]"


def test_a_matrix_and_a_colour_each(flat):
    result = flat(BODY % ("[1, 0.5, 0.25]", COLORS, "vertex"))
    assert result.warnings == []
    sphere, instancer = result.prims["/X/P"], result.prims[result.prims["/X/P"]["instancer"]]
    assert np.allclose(np.linalg.norm(sphere["points"], axis=1), 0.5)
    assert "displayColor" not in sphere
    assert np.array_equal(instancer["displayColor"], np.eye(3))
    matrices = instancer["transforms"]
    assert np.allclose(matrices[:, 3, :3], [(0, 0, 5), (1, 0, 5), (2, 0, 5)])
    assert np.allclose(matrices[:, [0, 1, 2], [0, 1, 2]], np.array([[1], [0.5], [0.25]]))


def test_one_colour_is_that_of_the_sphere(flat):
    result = flat(BODY % ("[1, 1, 1]", "[(0.1, 0.2, 0.3)]", "constant"))
    assert np.allclose(result.prims["/X/P"]["displayColor"]["values"], [(0.1, 0.2, 0.3)])
    assert "displayColor" not in result.prims["/X/P.points"]


def test_in_instances_every_placement_has_all_points(flat):
    body = BODY % ("[1, 0.5, 0.25]", COLORS, "vertex")
    twice = """
def PointInstancer "I"
{
    rel prototypes = </X/P>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 0), (0, 9, 0)]
}
"""
    result = flat(body + twice)
    inner = result.prims["/I.prototypes[0].points"]
    assert np.allclose(inner["transforms"][:, 3, :3], [(x, y, 0) for y in (0, 9) for x in (0, 1, 2)])
    assert np.array_equal(inner["displayColor"], np.tile(np.eye(3), (2, 1)))


def test_what_cannot_be_used_is_named(flat):
    result = flat(BODY % ("[1, 0.5]", "[(1, 0, 0), (0, 1, 0)]", "vertex"))
    said = [text for _, text in result.warnings]
    assert "widths: 2 values where vertex interpolation needs 3" in said[0]
    assert any("widths: none that can be used; 1 is" in text for text in said)
    assert any("displayColor: 2 values where vertex interpolation needs 3" in text for text in said)
    assert len(result.prims["/X/P.points"]["transforms"]) == 3
    result = flat(BODY % ("[1, -1, 0]", COLORS, "vertex"))
    assert len(result.prims["/X/P.points"]["transforms"]) == 1
    assert "2 points are not finite or have no width" in result.warnings[0][1]
