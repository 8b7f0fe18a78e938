"""BasisCurves and HermiteCurves as meshes: closed round tubes, or ribbons where normals are authored.

The polygon of a tube has the circumference of its circle, so that areas agree; its radius is within 0.3 % outwards and
0.6 % inwards at 24 sides, 1.2 % and 2.3 % at 12, 4.7 % and 9.3 % at 6. Cubic segments are cut until chords stay
within CHORD_ERROR widths of the curve, or there are MOST_PIECES.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pxr import Usd, UsdGeom

from .arrays import np
from .reading import Reader
from .skel import Skins
from .spline import Floats, Samples, Spline, frames, unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIDES = ((20_000, 24), (200_000, 12))
"""(samples at most, sides): where there are many, each is thin."""
FEWEST_SIDES = 6

CHORD_ERROR = 0.05
"""Distance of a chord from its curve, over the largest width of the segment."""
TWIST = np.radians(10.0)
"""Turn of a ribbon's normal in one piece."""
MOST_PIECES = 32
"""Of one cubic segment."""

MITRE = 4.0
"""Longest ring at a joint, over the width: tips of sharp turns would be as long as the curve."""

Surface = dict[str, Any]
Attribute = tuple[str, Floats]
"""Interpolation and values."""


class Tessellation:
    """Curves as mesh: `surface` has the fields of a Mesh but primvars; `point_sample` and `face_curve` say which
    sample a point belongs to, and which curve a face."""

    def __init__(self, spline: Spline, samples: Samples) -> None:
        self.spline, self.samples = spline, samples
        self.surface: Surface = {}
        self.offsets, self.is_ribbon = np.zeros((0, 3)), False
        self.point_sample = self.face_curve = np.zeros(0, np.int32)

    def strands(self) -> dict[str, dict[str, Any]]:
        """What a hair material asks for (`scene::Strands`): the direction along, and the way from the axis to each
        point over the radius."""
        kind = {"type": "float3", "interpolation": "vertex"}
        offset = "dermis:ribbonOffset" if self.is_ribbon else "dermis:tubeOffset"
        tangents = single(self.samples.tangents())
        return {
            "dermis:tangent": {**kind, "values": tangents, "indices": self.point_sample},
            offset: {**kind, "values": single(self.offsets)},
        }

    def primvar(self, interpolation: str, values: NDArray) -> dict[str, Any]:
        """Values on the curves as primvar of the mesh."""
        match interpolation:
            case "constant":
                return {"interpolation": "constant", "values": single(values)}
            case "uniform":
                return {"interpolation": "uniform", "values": single(values), "indices": self.face_curve}
        values = self.samples.at(values.astype(np.float64), interpolation)
        return {"interpolation": "vertex", "values": single(values), "indices": self.point_sample}


def tessellate_curves(prim: Usd.Prim, reader: Reader, skins: Skins) -> Tessellation | None:
    """None where there is nothing to render, which was said."""
    spline = read_spline(prim, reader, skins)
    if spline is None:
        return None
    widths = read_attribute(prim, "widths", 1, spline, reader)
    if widths is None:
        reader.warn(prim, "widths: none that can be used; 1 is")
        widths = ("constant", np.ones(1))
    normals = read_attribute(prim, "normals", 3, spline, reader)
    samples = spline.sampled(pieces(spline, widths, normals))
    width = np.maximum(samples.at(widths[1], widths[0]), 0.0)
    if not (width > 0.0).any():
        reader.warn(prim, "widths: none is above 0; the curves are not rendered")
        return None
    made = Tessellation(spline, samples)
    if normals is None:
        tubes(made, width)
    else:
        ribbons(made, width, samples.at(normals[1], normals[0]))
    made.surface |= {"orientation": "rightHanded", "subdivisionScheme": "none"}
    return made


def read_spline(prim: Usd.Prim, reader: Reader, skins: Skins) -> Spline | None:
    points = reader.as_array(prim, "points", reader.moved(prim, "points"), "float32", 3)
    counts = reader.array(prim, "curveVertexCounts", "int32", 1)
    for name, array in (("points", points), ("curveVertexCounts", counts)):
        if array is None or not len(array):
            reader.warn(prim, f"{name}: empty; the curves are not rendered")
            return None
    if (counts < 0).any() or counts.sum() != len(points):
        message = f"curveVertexCounts: their sum is {counts.sum()}, there are {len(points)} points"
        reader.warn(prim, message + "; the curves are not rendered")
        return None
    if not np.isfinite(points).all():
        reader.warn(prim, "points: not finite; the curves are not rendered")
        return None
    rest, points = points, skins.moved(prim, points)
    if points is not rest:
        warn_at_rest(prim, reader)
    if is_hermite(prim):
        return read_hermite(prim, points, counts, reader)
    basis = token(prim, "basis", ("bezier", "bspline", "catmullRom"), reader)
    basis = basis if token(prim, "type", ("cubic", "linear"), reader) == "cubic" else "linear"
    wrap = token(prim, "wrap", ("nonperiodic", "periodic", "pinned"), reader)
    spline = Spline(points.astype(np.float64), counts, basis, wrap)
    if bad := int(spline.bad.sum()):
        message = (
            f"curveVertexCounts: {bad} of {len(counts)} curves have a number of points that {wrap} {basis} "
        )
        reader.warn(prim, message + "curves cannot have; they are not rendered")
    return spline if len(spline.curve) else None


def warn_at_rest(prim: Usd.Prim, reader: Reader) -> None:
    """What skins do not turn."""
    names = {"normals", "primvars:normals"} | ({"tangents"} if is_hermite(prim) else set())
    for name in sorted(names.intersection(prim.GetAuthoredPropertyNames())):
        reader.warn(prim, f"{name}: skeletons and blend shapes move points alone; they are those at rest")


def is_hermite(prim: Usd.Prim) -> bool:
    return prim.IsA(UsdGeom.HermiteCurves)


def read_hermite(prim: Usd.Prim, points: NDArray, counts: NDArray, reader: Reader) -> Spline | None:
    """UsdGeomHermiteCurves: open, a tangent for each point."""
    tangents = reader.array(prim, "tangents", "float32", 3)
    number = 0 if tangents is None else len(tangents)
    if tangents is None or number != len(points) or not np.isfinite(tangents).all():
        problem = f"{number} for {len(points)} points" if number != len(points) else "not finite"
        reader.warn(prim, f"tangents: {problem}; the curves are not rendered")
        return None
    spline = Spline.hermite(points.astype(np.float64), tangents.astype(np.float64), counts)
    if bad := int(spline.bad.sum()):
        message = f"curveVertexCounts: {bad} of {len(counts)} curves have fewer than 2 points; "
        reader.warn(prim, message + "they are not rendered")
    return spline if len(spline.curve) else None


def token(prim: Usd.Prim, name: str, tokens: tuple[str, ...], reader: Reader) -> str:
    value = reader.value(prim, name, tokens[0])
    if value in tokens:
        return value
    reader.warn(prim, f"{name}: '{value}' is not supported; '{tokens[0]}' is used")
    return tokens[0]


def read_attribute(
    prim: Usd.Prim, name: str, components: int, spline: Spline, reader: Reader
) -> Attribute | None:
    """`primvars:NAME`, else the attribute NAME; None where neither is there, or it does not fit."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
    if primvar and primvar.HasAuthoredValue():
        return read_primvar(prim, primvar, components, spline, reader)
    schema = UsdGeom.Curves(prim)
    interpolation = schema.GetWidthsInterpolation() if name == "widths" else schema.GetNormalsInterpolation()
    return fitting(prim, name, interpolation, reader.array(prim, name, "float32", components), spline, reader)


def read_primvar(
    prim: Usd.Prim, primvar: UsdGeom.Primvar, components: int, spline: Spline, reader: Reader
) -> Attribute | None:
    name, value = str(primvar.GetName()), primvar.ComputeFlattened(reader.time)
    if components == 1 and np.ndim(value) == 0 and value is not None and not isinstance(value, str):
        value = [value]
    values = reader.as_array(prim, name, value, "float32", components)
    if values is not None:
        values = reader.colors.of(primvar.GetAttr(), values)
    return fitting(prim, name, primvar.GetInterpolation(), values, spline, reader)


def fitting(
    prim: Usd.Prim, name: str, interpolation: str, values: Any, spline: Spline, reader: Reader
) -> Attribute | None:
    """The attribute, or None and a warning where its length does not fit the curves."""
    if values is None or not len(values):
        return None
    if is_hermite(prim) and interpolation == "vertex":
        # Values have no tangents: the schema suggests lines from point to point.
        interpolation = "varying"
    expected = spline.expected(interpolation)
    if expected is None:
        problem = f"interpolation '{interpolation}' is unknown"
    elif len(values) != expected:
        problem = f"{len(values)} values where {interpolation} interpolation needs {expected}"
    elif not np.isfinite(values).all():
        problem = "not finite"
    else:
        return interpolation, values.astype(np.float64)
    reader.warn(prim, f"{name}: {problem}; it is ignored")
    return None


def pieces(spline: Spline, widths: Attribute, normals: Attribute | None) -> NDArray[np.int64]:
    """Pieces of each segment: a chord is |C''| h^2 / 8 away from its curve; a ribbon turns by TWIST at most."""
    number = len(spline.curve)
    at = [Samples(spline, np.arange(number), np.full(number, u)) for u in (0.0, 0.5, 1.0)]
    width = np.max([samples.at(widths[1], widths[0]) for samples in at], axis=0)
    # A width of nothing wants no pieces beyond the most.
    wanted = np.sqrt(spline.bends() / (8.0 * CHORD_ERROR * np.maximum(width, 1e-30)))
    if normals is not None:
        a, b = (unit(samples.at(normals[1], normals[0])) for samples in (at[0], at[2]))
        turn = np.arccos(np.clip(np.sum(a * b, axis=1), -1.0, 1.0))
        wanted = np.maximum(wanted, turn / TWIST)
    return np.clip(np.ceil(wanted), 1, MOST_PIECES).astype(np.int64)


def steps(samples: Samples) -> tuple[NDArray, NDArray]:
    """Pairs of neighbours: samples that a piece of curve joins."""
    following = np.arange(1, len(samples.u) + 1)
    last = samples.first + samples.count - 1
    if samples.spline.closed:
        following[last] = samples.first
        return np.arange(len(following)), following
    here = np.delete(np.arange(len(following)), last)
    return here, following[here]


def tubes(made: Tessellation, width: Floats) -> None:
    samples = made.samples
    points, tangents = samples.along(made.spline.points), samples.tangents()
    across = frames(points, tangents, samples)
    sides = next((sides for most, sides in SIDES if len(points) <= most), FEWEST_SIDES)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    radial = (
        np.cos(angle)[:, None] * across[:, None]
        + np.sin(angle)[:, None] * np.cross(tangents, across)[:, None]
    )
    # The circumference of the polygon is that of the circle.
    outwards = (np.pi / sides) / np.sin(np.pi / sides)
    radius = 0.5 * width * outwards
    made.offsets = outwards * radial.reshape(-1, 3)
    here, there = steps(samples)
    most = longest_rings(points, radius, here, there)
    rings = points[:, None] + radius[:, None, None] * mitred(radial, samples.turns(), most)
    shown = (width[here] > 0.0) | (width[there] > 0.0)
    here, there = here[shown], there[shown]
    j = np.arange(sides)
    k = (j + 1) % sides
    a, b = sides * here[:, None], sides * there[:, None]
    quads = np.stack([a + j, a + k, b + k, b + j], axis=2).reshape(-1, 4)
    starts, stops = caps(samples, width)
    discs = np.concatenate([sides * starts[:, None] + j[::-1], sides * stops[:, None] + j])
    slopes = radial - (slope(points, radius, here, there)[:, None] * tangents)[:, None]
    cap_normals = np.concatenate([-tangents[starts], tangents[stops]])
    made.point_sample = np.repeat(np.arange(len(points), dtype=np.int32), sides)
    curve = samples.curve
    made.face_curve = np.concatenate([np.repeat(curve[here], sides), curve[starts], curve[stops]]).astype(
        np.int32
    )
    caps_at = len(points) * sides + np.arange(len(discs))
    made.surface = {
        "points": single(rings.reshape(-1, 3)),
        "faceVertexCounts": np.concatenate([np.full(len(quads), 4), np.full(len(discs), sides)]).astype(
            np.int32
        ),
        "faceVertexIndices": np.concatenate([quads.ravel(), discs.ravel()]).astype(np.int32),
        "normals": {
            "interpolation": "faceVarying",
            "values": single(np.concatenate([unit(slopes.reshape(-1, 3)), cap_normals])),
            "indices": np.concatenate([quads.ravel(), np.repeat(caps_at, sides)]).astype(np.int32),
        },
    }


def longest_rings(points: Floats, radius: Floats, here: NDArray, there: NDArray) -> Floats:
    """Longest ring of each sample, over its width: one reaches less than half along a piece, so that short pieces
    between two turns do not end up inside out."""
    length = np.linalg.norm(points[there] - points[here], axis=1)
    shortest = np.full(len(points), np.inf)
    np.minimum.at(shortest, here, length)
    np.minimum.at(shortest, there, length)
    reach = 0.4 * shortest / np.where(radius > 0.0, radius, np.inf)
    return np.minimum(MITRE, np.sqrt(1.0 + reach * reach))


def mitred(radial: Floats, turns: Floats, most: Floats) -> Floats:
    """Rings at joints are in the plane half way between two pieces: there they are longer along the turn, so that both
    pieces keep their width. `most`: longer than their width at most."""
    sine = np.linalg.norm(turns, axis=1)
    cosine = np.maximum(np.sqrt(np.maximum(1.0 - sine * sine, 0.0)), 1.0 / most)
    share = (1.0 / cosine - 1.0) / np.where(sine > 0.0, sine * sine, 1.0)
    along = np.sum(radial * turns[:, None], axis=2, keepdims=True)
    return radial + (share[:, None] * turns)[:, None] * along


def caps(samples: Samples, width: Floats) -> tuple[NDArray, NDArray]:
    """First and last samples of open curves, where they have any width."""
    if samples.spline.closed:
        none = np.zeros(0, np.int64)
        return none, none
    starts, stops = samples.first, samples.first + samples.count - 1
    return starts[width[starts] > 0.0], stops[width[stops] > 0.0]


def slope(points: Floats, radius: Floats, here: NDArray, there: NDArray) -> Floats:
    """How fast the radius grows along the curve at each sample: the mean of the pieces beside it."""
    length = np.linalg.norm(points[there] - points[here], axis=1)
    growth = (radius[there] - radius[here]) / np.where(length > 0.0, length, 1.0)
    total, number = np.zeros(len(points)), np.zeros(len(points))
    for end in (here, there):
        np.add.at(total, end, np.where(length > 0.0, growth, 0.0))
        np.add.at(number, end, 1.0)
    return total / np.maximum(number, 1.0)


def ribbons(made: Tessellation, width: Floats, normals: Floats) -> None:
    """Flat, facing along the normals, which are turned square to the curve."""
    samples = made.samples
    points, tangents = samples.along(made.spline.points), samples.tangents()
    across = unit(np.cross(tangents, normals))
    across = np.where(across.any(axis=1, keepdims=True), across, frames(points, tangents, samples))
    half = 0.5 * width[:, None] * across
    made.offsets, made.is_ribbon = np.stack([-across, across], axis=1).reshape(-1, 3), True
    here, there = steps(samples)
    shown = (width[here] > 0.0) | (width[there] > 0.0)
    a, b = 2 * here[shown], 2 * there[shown]
    made.point_sample = np.repeat(np.arange(len(points), dtype=np.int32), 2)
    made.face_curve = samples.curve[here[shown]].astype(np.int32)
    made.surface = {
        "points": single(np.stack([points - half, points + half], axis=1).reshape(-1, 3)),
        "faceVertexCounts": np.full(len(a), 4, np.int32),
        "faceVertexIndices": np.stack([a, a + 1, b + 1, b], axis=1).ravel().astype(np.int32),
        "normals": {
            "interpolation": "vertex",
            "values": single(np.cross(across, tangents)),
            "indices": made.point_sample,
        },
        "doubleSided": True,
    }


def single(values: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)
