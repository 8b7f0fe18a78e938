"""BasisCurves: points against the bases' own formulas, tubes closed and of the right area, primvars that follow."""

import ast
from collections import Counter

import numpy as np
import pytest

from dermis.curves import CHORD_ERROR
from dermis.spline import Spline


def around(count):
    angles = np.arange(count) * 2 * np.pi / count
    return ", ".join(f"({np.cos(a)}, {np.sin(a)}, {0.1 * np.cos(2 * a)})" for a in angles)


POINTS = "(0, 0, 0), (1, 1, 0), (2, 0, 1), (3, 0, 0), (3, 1, 1), (2, 2, 2), (1, 2, 0)"


def curves(points=POINTS, counts="[7]", widths="[0.1]", interpolation="constant", more="", **tokens):
    words = {"type": "cubic", **tokens}
    lines = "\n".join(f'uniform token {name} = "{value}"' for name, value in words.items())
    return f"""def BasisCurves "C"
{{
    {lines}
    int[] curveVertexCounts = {counts}
    point3f[] points = [{points}]
    float[] widths = {widths} (
        interpolation = "{interpolation}"
    )
    {more}
}}
"""


def faces(mesh):
    ends = np.cumsum(mesh["faceVertexCounts"])
    return np.split(mesh["faceVertexIndices"], ends[:-1])


def area(mesh):
    points = mesh["points"].astype(float)
    corners = [points[face] for face in faces(mesh)]
    fans = [np.cross(p[i] - p[0], p[i + 1] - p[0]) for p in corners for i in range(1, len(p) - 1)]
    return 0.5 * np.linalg.norm(fans, axis=1).sum()


def centres(mesh, sides=24):
    return mesh["points"].astype(float).reshape(-1, sides, 3).mean(axis=1)


def test_a_straight_tube_has_the_area_of_its_cylinder(flat):
    result = flat(curves("(0, 0, 0), (0, 0, 1), (0, 0, 3)", "[3]", "[0.5]", type="linear"))
    assert result.warnings == []
    # Lateral area exactly; the two discs are polygons, 2.3 % too small of a radius 0.3 % too large.
    assert area(result.prims["/C"]) == pytest.approx(np.pi * 0.5 * 3 + 2 * np.pi * 0.25**2, rel=2e-3)
    cone = flat(curves("(0, 0, 0), (0, 0, 1), (0, 0, 3)", "[3]", "[0.6, 0.4, 0]", "vertex", type="linear"))
    assert area(cone.prims["/C"]) == pytest.approx(np.pi * (0.3 * np.hypot(3, 0.3) + 0.09), rel=3e-3)


def test_a_bent_tube_keeps_its_width(flat):
    """Cut half way between two pieces, each has the area of its cylinder; where a curve turns back, the cut ends at
    the limit of mitres."""
    bent = flat(curves("(0, 0, 0), (0, 0, 2), (2, 0, 2)", "[3]", "[0.5]", type="linear"))
    assert area(bent.prims["/C"]) == pytest.approx(np.pi * 0.5 * 4 + 2 * np.pi * 0.25**2, rel=2e-3)
    sharp = flat(curves("(0, 0, 0), (0, 0, 2), (1.6, 0, 0.6)", "[3]", "[0.2]", type="linear"))
    assert area(sharp.prims["/C"]) == pytest.approx(
        np.pi * 0.2 * (2 + np.hypot(1.6, 1.4)) + 2 * np.pi * 0.1**2, rel=3e-3
    )
    back = flat(curves("(0, 0, 0), (0, 0, 2), (1e-4, 0, 0)", "[3]", "[0.2]", type="linear")).prims["/C"]
    assert np.isfinite(back["points"]).all() and 2.0 < back["points"][:, 2].max() < 2.0 + 4.0 * 0.11


def test_short_pieces_between_turns_are_not_inside_out(flat):
    """Three of the length of a width, turning the same way twice: along each, every edge goes forward."""
    text = "(0, 0, 0), (0, 0, 2), (0.5, 0, 2), (0.5, 0, 0)"
    rings = (
        flat(curves(text, "[4]", "[0.5]", type="linear"))
        .prims["/C"]["points"]
        .astype(float)
        .reshape(4, -1, 3)
    )
    forward = np.array([(0, 0, 1), (1, 0, 0), (0, 0, -1)])
    along = np.einsum("isx,ix->is", np.diff(rings, axis=0), forward)
    assert along.min() > 0.02


SHAPES = [
    ("linear", "nonperiodic"),
    ("linear", "periodic"),
    ("bezier", "nonperiodic"),
    ("bezier", "periodic"),
    ("bezier", "pinned"),
    ("bspline", "nonperiodic"),
    ("bspline", "periodic"),
    ("bspline", "pinned"),
    ("catmullRom", "nonperiodic"),
    ("catmullRom", "periodic"),
    ("catmullRom", "pinned"),
]


@pytest.mark.parametrize(("basis", "wrap"), SHAPES)
def test_tubes_are_closed_and_face_outwards(flat, basis, wrap):
    kind = {"type": "linear"} if basis == "linear" else {"basis": basis}
    # Segments of closed Beziers have three points each.
    count = 9 if (basis, wrap) == ("bezier", "periodic") else 7
    mesh = flat(curves(around(count), f"[{count}]", wrap=wrap, **kind)).prims["/C"]
    sides = Counter((face[i], face[i - 1]) for face in faces(mesh) for i in range(len(face)))
    assert set(sides.values()) == {1} and all((b, a) in sides for a, b in sides)
    points, normals = mesh["points"].astype(float), mesh["normals"]
    corner_normals = np.split(normals["values"][normals["indices"]], np.cumsum(mesh["faceVertexCounts"])[:-1])
    for face, corners in zip(faces(mesh), corner_normals, strict=True):
        a, b, c = points[face[:3]]
        facet = np.cross(b - a, c - a)
        # At the joints of linear ones, and of Beziers through these points, normals are half way between two pieces.
        least = 0.8 if basis in ("linear", "bezier") else 0.95
        assert (corners @ (facet / np.linalg.norm(facet))).min() > least


def test_segments_are_those_of_their_basis(flat):
    p = np.array(ast.literal_eval(f"[{POINTS}]"), float)
    bezier = centres(flat(curves(basis="bezier")).prims["/C"])
    assert np.allclose(bezier[[0, -1]], p[[0, 6]], atol=1e-6)
    assert np.abs(bezier - (p[0] + 3 * p[1] + 3 * p[2] + p[3]) / 8).sum(axis=1).min() < 0.15
    bspline = centres(flat(curves(basis="bspline")).prims["/C"])
    assert np.allclose(bspline[0], (p[0] + 4 * p[1] + p[2]) / 6, atol=1e-6)
    assert np.allclose(bspline[-1], (p[4] + 4 * p[5] + p[6]) / 6, atol=1e-6)
    catmull_rom = centres(flat(curves(basis="catmullRom")).prims["/C"])
    assert np.allclose(catmull_rom[[0, -1]], p[[1, 5]], atol=1e-6)
    for basis in ("bspline", "catmullRom"):
        pinned = centres(flat(curves(basis=basis, wrap="pinned")).prims["/C"])
        assert np.allclose(pinned[[0, -1]], p[[0, 6]], atol=1e-6)
    through = centres(flat(curves(basis="catmullRom", wrap="periodic")).prims["/C"])
    assert all(np.abs(through - point).sum(axis=1).min() < 1e-5 for point in p)


def test_chords_stay_close_to_their_curve(flat):
    width = 0.1
    points = np.array([[0, 0, 0], [0, 3, 0], [3, 3, 0], [3, 0, 2]], float)
    text = ", ".join(str(tuple(p)) for p in points.tolist())
    chain = centres(flat(curves(text, "[4]", f"[{width}]", basis="bezier")).prims["/C"])
    samples = Spline(points, np.array([4], np.int32), "bezier", "nonperiodic").sampled(np.array([1000]))
    along = chain[1:] - chain[:-1]
    worst = 0.0
    for point in samples.along(points):
        t = np.clip(np.sum((point - chain[:-1]) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
        worst = max(worst, np.linalg.norm(chain[:-1] + along * t[:, None] - point, axis=1).min())
    assert 0.2 * CHORD_ERROR * width < worst < CHORD_ERROR * width


def test_primvars_follow_the_curves(flat):
    colors = "[(1, 0, 0), (0, 1, 0)]"
    two = "(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1)"

    def colored(interpolation, values):
        more = (
            f'color3f[] primvars:displayColor = {values} (\n        interpolation = "{interpolation}"\n    )'
        )
        result = flat(curves(two, "[2, 2]", more=more, type="linear"))
        return result, result.prims["/C"].get("displayColor")

    result, uniform = colored("uniform", colors)
    mesh = result.prims["/C"]
    first = np.array([mesh["points"][face][:, 0].max() < 0.5 for face in faces(mesh)])
    assert np.array_equal(uniform["values"][uniform["indices"]][:, 0], first.astype(float))
    for interpolation in ("vertex", "varying"):
        result, vertex = colored(interpolation, "[(0, 0, 0), (1, 0, 0), (1, 0, 0), (0, 0, 0)]")
        x, z = result.prims["/C"]["points"][:, [0, 2]].T
        value = vertex["values"][vertex["indices"]][:, 0]
        assert vertex["interpolation"] == "vertex" and np.allclose(
            value, np.where(x < 0.5, z, 1 - z), atol=1e-6
        )
    result, none = colored("vertex", colors)
    assert none is None and "2 values where vertex interpolation needs 4" in result.warnings[0][1]


def test_normals_make_ribbons(flat):
    more = "normal3f[] normals = [(0, 1, 0), (0, 1, 0)]"
    mesh = flat(curves("(0, 0, 0), (0, 0, 2)", "[2]", "[0.5]", more=more, type="linear")).prims["/C"]
    assert area(mesh) == pytest.approx(1.0) and mesh["doubleSided"] is True
    assert np.allclose(mesh["normals"]["values"], [0, 1, 0])
    a, b, c = mesh["points"][mesh["faceVertexIndices"][:3]]
    assert np.cross(b - a, c - a)[1] > 0.0


def test_frames_do_not_twist(flat):
    """Around a plane circle the frames stay in the plane or across it: no face is skewed."""
    circle = ", ".join(f"({np.cos(a)}, {np.sin(a)}, 0)" for a in np.arange(8) * np.pi / 4)
    mesh = flat(curves(circle, "[8]", "[0.2]", basis="catmullRom", wrap="periodic")).prims["/C"]
    rings = mesh["points"].reshape(-1, 24, 3)
    assert np.ptp(rings[:, 0, 2]) < 1e-5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"counts": "[6]"}, "curveVertexCounts: their sum is 6, there are 7 points"),
        ({"counts": "[5, 2]", "basis": "bezier"}, "2 of 2 curves have a number of points"),
        ({"widths": "[0.1, 0.2]"}, "widths: 2 values where constant interpolation needs 1"),
        ({"widths": "[0]"}, "widths: none is above 0"),
        ({"basis": "hermite"}, "basis: 'hermite' is not supported; 'bezier' is used"),
        ({"points": POINTS.replace("(3, 0, 0)", "(nan, 0, 0)")}, "points: not finite"),
    ],
)
def test_what_cannot_be_used_is_named(flat, changes, message):
    result = flat(curves(**changes))
    assert any(path == "/C" and message in text for path, text in result.warnings)


HERMITE = """def HermiteCurves "C"
{{
    int[] curveVertexCounts = {counts}
    point3f[] points = [(0, 0, 0), (1, 1, 0), (2, 0, 1), (5, 0, 0), (5, 3, 0)]
    vector3f[] tangents = {tangents}
    float[] widths = [0.1, 0.1, 0.1, 0.1, 0.1] (
        interpolation = "{interpolation}"
    )
    {more}
}}
"""
TANGENTS = np.array([(3, 0, 0), (0, 2, 1), (1, -1, 0), (0, 0, 4), (0, 3, -4)], float)


def hermite(counts="[3, 2]", tangents=TANGENTS, interpolation="varying", more=""):
    text = str([tuple(t) for t in np.asarray(tangents).tolist()])
    return HERMITE.format(counts=counts, tangents=text, interpolation=interpolation, more=more)


def test_hermite_curves_are_their_polynomials(flat):
    """h00 p0 + h10 m0 + h01 p1 + h11 m1 of each segment, through every point, along every tangent."""
    result = flat(hermite())
    assert result.warnings == []
    found = centres(result.prims["/C"])
    points = np.array([(0, 0, 0), (1, 1, 0), (2, 0, 1), (5, 0, 0), (5, 3, 0)], float)
    u = np.linspace(0, 1, 4001)[:, None]
    for a, b in ((0, 1), (1, 2), (3, 4)):
        curve = (2 * u**3 - 3 * u**2 + 1) * points[a] + (u**3 - 2 * u**2 + u) * TANGENTS[a]
        curve += (3 * u**2 - 2 * u**3) * points[b] + (u**3 - u**2) * TANGENTS[b]
        near = [np.linalg.norm(found - at, axis=1).min() for at in curve[[0, -1]]]
        assert max(near) < 1e-6
        mine = found[:, 0] < 4 if a < 3 else found[:, 0] >= 4
        distance = np.array([np.linalg.norm(curve - at, axis=1).min() for at in found[mine]])
        # Half of the first curve's samples belong to each of its segments.
        assert (distance < 1e-3).sum() >= 0.3 * mine.sum()
    assert len(np.unique(result.prims["/C"]["points"], axis=0)) == 24 * len(found)


def test_hermite_primvars_are_lines_from_point_to_point(flat):
    colors = "[(0, 0, 0), (1, 0, 0), (0, 0, 0), (0, 0, 0), (1, 0, 0)]"
    more = f'color3f[] primvars:displayColor = {colors} (\n        interpolation = "vertex"\n    )'
    mesh = flat(hermite(more=more, interpolation="vertex")).prims["/C"]
    value = mesh["displayColor"]["values"][mesh["displayColor"]["indices"]][::24, 0]
    second = np.linalg.norm(centres(mesh) - (5, 0, 0), axis=1).argmin()
    steps = np.diff(value[second:])
    assert value[second] == 0.0 and value[-1] == 1.0 and np.allclose(steps, steps[0], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tangents": TANGENTS[:4]}, "tangents: 4 for 5 points; the curves are not rendered"),
        ({"counts": "[4, 1]"}, "curveVertexCounts: 1 of 2 curves have fewer than 2 points"),
        ({"counts": "[4]"}, "curveVertexCounts: their sum is 4, there are 5 points"),
    ],
)
def test_hermite_curves_that_cannot_be_are_named(flat, changes, message):
    result = flat(hermite(**changes))
    assert any(path == "/C" and message in text for path, text in result.warnings)
