"""What moves while the shutter is open: every flat prim sampled at times within it.

The walk is made again at each time, so that whatever moves a prim counts: ancestors, resets, instances, instancers with
their velocities. Times are those at which the stage has samples, the ends, and more where a matrix turns: dermis goes
straight from one matrix to the next, as Hydra does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from pxr import Gf, Usd, UsdGeom

from .arrays import np
from .index import MOVING, index_of
from .instancer import Matrices, Placements, nested
from .linking import Links
from .mesh import MESH_TYPES, flatten_mesh
from .points import flatten_points
from .reading import Reader, Report
from .skel import Skins, is_skinned
from .walk import Found, Frame, Walk

if TYPE_CHECKING:
    from numpy.typing import NDArray

Prim = dict[str, Any]

OF_CAMERAS = (
    "focalLength",
    "horizontalAperture",
    "verticalAperture",
    "fStop",
    "focusDistance",
    "clippingRange",
)
"""What of a camera may have samples and is that of the frame; of lights all inputs, of what has a shape all but:"""

SAMPLED = ("points", "velocities", "accelerations", "extent")
OF_MESHES = ("normals", "primvars:normals")
TOPOLOGY = ("faceVertexCounts", "faceVertexIndices")

MOST_TIMES = 33
"""Of one prim: as many as one segment turned into thirty-two, the finest that `refined` makes."""

SAME = 1e-6
"""Share of the largest number of a matrix, or of the extent of points, by which they may differ and be one."""

TURN = 1e-3
"""By which a straight way may miss a matrix that turns: a turn of five degrees."""

LIT_TURN = 3e-5
"""The same of the meshes of mesh lights, whose light turns without missing: their shadow rays end 1e-4 before them."""

SAG = 0.02
"""By which a straight way may miss a position on an arc, over the length of the way: a turn of five degrees, too."""


@dataclass(frozen=True)
class Shutter:
    """Time codes: of the frame, and from it to where the shutter opens and closes."""

    frame: float
    open: float
    close: float

    def times(self, shares: NDArray, scale: float) -> NDArray:
        """Time codes of shares of the shutter (0 open, 1 closed), as a prim of `motion:blurScale` sees it."""
        return self.frame + scale * (self.open + np.asarray(shares) * (self.close - self.open))

    def shares(self, times: NDArray, scale: float) -> NDArray:
        return ((np.asarray(times) - self.frame) / scale - self.open) / (self.close - self.open)


@dataclass
class Scene:
    """What is sampled: `found` and placements of the frame, and how to walk again. `cameras`: those that the walk does
    not come to."""

    stage: Usd.Stage
    reader: Reader
    purposes: tuple[str, ...]
    binding_purposes: tuple[str, ...]
    root: Usd.Prim | None
    placements: dict[Frame, Placements]
    links: Links
    cameras: list[Usd.Prim] = field(default_factory=list)

    def at(self, time: float) -> Reader:
        """Reads what moves at `time`, all else at the frame. What it has to say was said at the frame."""
        reader = Reader(self.reader.time, Report(), Usd.TimeCode(time))
        reader.primvars = self.reader.primvars
        return reader

    def walk(self, reader: Reader) -> dict[Frame, Placements]:
        return Walk(self.stage, reader, self.purposes, self.binding_purposes, self.links).run(self.root)

    def standing(self, reader: Reader) -> Iterator[tuple[str, Matrices]]:
        """Where the cameras are that the walk does not come to."""
        place = UsdGeom.XformCache(reader.moment).GetLocalToWorldTransform
        for camera in self.cameras:
            matrix = reader.transform(camera, place, Gf.Matrix4d(1.0))
            yield str(camera.GetPath()), np.array(matrix)[None]


def add_motion(prims: dict[str, Prim], scene: Scene, shutter: Shutter) -> None:
    """Adds `transformKeys` and `pointKeys` to the prims that move."""
    for frame, of_frame in scene.placements.items():
        if frame.instancer and len(of_frame):
            warn_unaligned(frame.instancer, "positions", scene.reader)
        for found in frame.found if len(of_frame) else ():
            warn_unsampled(found.prim, found.kind, scene.reader, shutter)
            warn_unaligned(found.prim, "points", scene.reader)
    scales = {scale for scale, _ in owners(scene, scene.placements).values()}
    for scale in sorted(scales):
        if scale > 0.0:
            Sampling(prims, scene, shutter, scale).add()


def warn_unsampled(prim: Usd.Prim, kind: str, reader: Reader, shutter: Shutter) -> None:
    """Names what changes while the shutter is open and is taken from the frame."""
    names = unsampled(prim, kind)
    attributes = [attribute for name in names if (attribute := prim.GetAttribute(name))]
    ends = [Usd.TimeCode(float(time)) for time in shutter.times(np.array([0.0, 1.0]), 1.0)]
    varying = [a for a in attributes if a.ValueMightBeTimeVarying() and a.Get(ends[0]) != a.Get(ends[1])]
    if varying:
        changed = ", ".join(a.GetName() for a in varying)
        reader.warn(prim, f"{changed}: not sampled while the shutter is open; the value of the frame is used")


def warn_unaligned(prim: Usd.Prim, name: str, reader: Reader) -> None:
    """Says where there are velocities and USD's rules do not move by them: both need samples, at one time."""
    velocities, places = prim.GetAttribute("velocities"), prim.GetAttribute(name)
    # An empty array is how layers take velocities away.
    if not (velocities and velocities.HasAuthoredValue() and len(velocities.Get(reader.time) or ())):
        return
    first, second = (a.GetBracketingTimeSamples(reader.time.GetValue())[:1] for a in (velocities, places))
    if not first or first != second:
        reader.warn(
            prim, f"velocities: no time sample at one of {name}, as USD's rules want; nothing moves by them"
        )


def unsampled(prim: Usd.Prim, kind: str) -> list[str]:
    """Attributes that are taken from the frame."""
    if kind == "Camera":
        return [*OF_CAMERAS]
    names = prim.GetAuthoredPropertyNames()
    if kind.endswith("Light") or kind.startswith("DomeLight"):
        return [name for name in names if name.startswith("inputs:")]
    sampled = SAMPLED + (OF_MESHES if kind == "Mesh" else ())
    if "velocities" in names:  # then the points are those of the frame, however many there are at other times
        sampled += TOPOLOGY
    return [name for name in names if name not in sampled and not name.startswith("xformOp")]


def owners(scene: Scene, placements: dict[Frame, Placements]) -> dict[str, tuple[float, Usd.Prim]]:
    """`motion:blurScale` of each key, and the prim to name in warnings."""
    found: dict[str, tuple[float, Usd.Prim]] = {}

    def scale(prim: Usd.Prim) -> float:
        value = UsdGeom.MotionAPI(prim).ComputeMotionBlurScale(scene.reader.time)
        return float(value) if np.isfinite(value) and value >= 0.0 else 1.0

    for frame, of_frame in placements.items():
        matrices = of_frame.matrices
        if frame.root and len(matrices):
            prim = scene.stage.GetPrimAtPath(frame.base.split(".prototypes[")[0].split("[")[0])
            if prim:
                found[f"{frame.base}.instances"] = scale(prim), prim
        for each in frame.found if len(matrices) else ():
            own = scale(each.prim), each.prim
            found |= {key: own for key, _ in places(each, matrices)}
            found[each.key] = own
    return found | {str(camera.GetPath()): (scale(camera), camera) for camera in scene.cameras}


def places(found: Found, matrices: Matrices) -> Iterator[tuple[str, Matrices]]:
    """Flat keys of a prim that has a transform of its own, with the (1, 4, 4) matrix of each; as `Emitter.prim` has
    them."""
    world = nested(np.array(found.matrix)[None], matrices)
    if found.kind == "Camera":
        yield found.key, world[:1]
    elif found.kind in MESH_TYPES and not found.emits:
        yield found.key, np.array(found.matrix)[None]
    elif found.kind == "Points":
        yield f"{found.key}.placed", world
    else:
        several = len(world) > 1
        for i, matrix in enumerate(world):
            key = found.key + (".light" if found.emits else "")
            yield (f"{key}[{i}]" if several else key), matrix[None]
            if found.emits:
                yield (f"{found.key}[{i}].mesh" if several else found.key), matrix[None]


class Sampling:
    """The prims of one `motion:blurScale`."""

    def __init__(self, prims: dict[str, Prim], scene: Scene, shutter: Shutter, scale: float) -> None:
        self.prims, self.scene, self.shutter, self.scale = prims, scene, shutter, scale
        self.owners = {
            key: prim for key, (own, prim) in owners(scene, scene.placements).items() if own == scale
        }
        #: Matrices by key, by share of the shutter.
        self.taken: dict[float, dict[str, Matrices]] = {}

    def add(self) -> None:
        shares = self.shares
        for key, owner in self.owners.items():
            # Points are placed by an instancer of their own, which moves in their stead.
            if key in self.prims and f"{key}.placed" not in self.prims:
                self.transforms(key, owner, shares)
        for frame, of_frame in self.scene.placements.items():
            for found in frame.found if len(of_frame) else ():
                if found.key in self.owners and found.key in self.prims:
                    self.deformation(found, shares)

    @cached_property
    def shares(self) -> NDArray:
        return self.refined(self.authored())

    @cached_property
    def skins(self) -> list[Skins]:
        """By share, each with its reader: skeletons move all their meshes."""
        times = self.shutter.times(self.shares, self.scale)
        return [Skins(self.scene.at(float(time))) for time in times]

    def authored(self) -> NDArray:
        """The ends, and where the stage has samples in between; evenly spread ones where motion is not linear."""
        ends = self.shutter.times(np.array([0.0, 1.0]), self.scale)
        span, times, count = Gf.Interval(*ends, False, False), set(), 2
        for prim, facts in index_of(self.scene.stage).movers(self.scene.stage):
            for name in facts.moving:
                times.update(prim.GetAttribute(name).GetTimeSamplesInInterval(span))
            if facts.bends:
                count = max(
                    count, UsdGeom.MotionAPI(prim).ComputeNonlinearSampleCount(self.scene.reader.time)
                )
        between = self.shutter.shares(np.array(sorted(times)), self.scale) if times else np.zeros(0)
        shares = np.unique(np.concatenate([np.linspace(0.0, 1.0, min(count, MOST_TIMES)), between]))
        if len(shares) > MOST_TIMES:
            message = f"time samples: {len(shares)} while the shutter is open; {MOST_TIMES} evenly spread ones are used"
            self.scene.reader.warn("/", message)
            return np.linspace(0.0, 1.0, MOST_TIMES)
        return shares

    def matrices(self, share: float) -> dict[str, Matrices]:
        if share not in self.taken:
            time = float(self.shutter.times(share, self.scale))
            found = {}
            reader = self.scene.at(time)
            found.update(self.scene.standing(reader))
            for frame, of_frame in self.scene.walk(reader).items():
                matrices = of_frame.matrices
                if frame.root:
                    found[f"{frame.base}.instances"] = matrices
                for each in frame.found if len(matrices) else ():
                    found.update(places(each, matrices))
            self.taken[share] = {key: value for key, value in found.items() if key in self.owners}
        return self.taken[share]

    def refined(self, shares: NDArray) -> NDArray:
        """More times where the straight way misses what is in the middle of it."""
        if not any(turns(self.matrices(a), self.matrices(b)) for a, b in pairs(shares)):
            return shares
        done, waiting = [shares[0]], [(a, b, 0) for a, b in reversed(pairs(shares))]
        while waiting:
            a, b, depth = waiting.pop()
            middle = 0.5 * (a + b)
            if depth < 5 and misses(self.matrices(a), self.matrices(middle), self.matrices(b)):
                waiting += [(middle, b, depth + 1), (a, middle, depth + 1)]
            else:
                done.append(b)
        return np.array(done if len(done) <= 4 * MOST_TIMES else np.linspace(0.0, 1.0, 4 * MOST_TIMES))

    def transforms(self, key: str, owner: Usd.Prim, shares: NDArray) -> None:
        prim = self.prims[key]
        field = "transforms" if prim["type"] == "Instancer" else "transform"
        count = len(prim[field]) if field == "transforms" else 1
        sampled = [self.matrices(share).get(key, np.zeros((0, 4, 4))) for share in shares]
        if any(len(matrices) != count for matrices in sampled):
            self.scene.reader.warn(
                owner, "instances: their number changes while the shutter is open; they stay"
            )
            return
        kept = needed(shares, sampled, lambda m: SAME * max(1.0, np.abs(m).max(initial=0.0)))
        if kept:
            prim["transformKeys"] = {
                "times": [float(shares[i]) for i in kept],
                "transforms": [np.ascontiguousarray(sampled[i]) for i in kept],
            }

    def deformation(self, found: Found, shares: NDArray) -> None:
        if found.kind != "Points" and not may_deform(found):
            return
        if found.kind == "Points":
            self.spheres(found, shares)
        elif found.kind in MESH_TYPES:
            self.points(found, shares)

    def points(self, found: Found, shares: NDArray) -> None:
        mesh, inherited = self.prims[found.key], found.context.inherited()
        sampled = [flatten_mesh(found.prim, found.kind, at.reader, inherited, at) for at in self.skins]
        points = [np.asarray(there["points"]) if there else np.zeros((0, 3)) for there in sampled]
        if any(len(p) != len(mesh["points"]) for p in points):
            message = "points: their number changes while the shutter is open and there are no velocities"
            self.scene.reader.warn(found.prim, f"{message}; it keeps its shape")
            return
        normals = [
            np.asarray(there["normals"]["values"]) for there in sampled if there and "normals" in there
        ]
        own = np.asarray(mesh.get("normals", {}).get("values", ()))
        if not len(own) or len(normals) != len(shares) or any(n.shape != own.shape for n in normals):
            normals = []
        both = [np.concatenate(pair) for pair in zip(points, normals, strict=True)] if normals else points
        kept = needed(shares, both, lambda p: SAME * max(np.ptp(p, axis=0).max(initial=0.0), 1e-30))
        if not kept:
            return
        keys = {"times": [float(shares[i]) for i in kept], "points": [single(points[i]) for i in kept]}
        if normals and any(not np.array_equal(n, own) for n in normals):
            keys["normals"] = [single(normals[i]) for i in kept]
        for key in mesh_keys(found, self.prims):
            self.prims[key]["pointKeys"] = keys

    def spheres(self, found: Found, shares: NDArray) -> None:
        key = f"{found.key}.points"
        sampled = []
        for share, at in zip(shares, self.skins, strict=True):
            there = flatten_points(found.prim, at.reader, found.context.inherited(), at)
            placed = self.matrices(share).get(f"{found.key}.placed", np.zeros((0, 4, 4)))
            sampled.append(nested(there.matrices, placed) if there and len(placed) else np.zeros((0, 4, 4)))
        if any(len(m) != len(self.prims[key]["transforms"]) for m in sampled):
            message = "points: their number changes while the shutter is open and there are no velocities; they stay"
            self.scene.reader.warn(found.prim, message)
            return
        kept = needed(shares, sampled, lambda m: SAME * max(1.0, np.abs(m).max(initial=0.0)))
        if kept:
            self.prims[key]["transformKeys"] = {
                "times": [float(shares[i]) for i in kept],
                "transforms": [np.ascontiguousarray(sampled[i]) for i in kept],
            }


def mesh_keys(found: Found, prims: dict[str, Prim]) -> list[str]:
    """Keys of the meshes that a prim became; of a mesh light in instances one each."""
    if found.key in prims and prims[found.key]["type"] == "Mesh":
        return [found.key]
    return [key for key in prims if key.startswith(f"{found.key}[") and key.endswith(".mesh")]


def may_deform(found: Found) -> bool:
    """Whether its points may move: they have samples or velocities, or joints or shapes move them."""
    prim, names = found.prim, found.prim.GetAuthoredPropertyNames()
    # Joints may be those of a prim above.
    if found.context.skel or is_skinned(prim) or "velocities" in names:
        return True
    return any(name in MOVING and prim.GetAttribute(name).ValueMightBeTimeVarying() for name in names)


def pairs(shares: NDArray) -> list[tuple[float, float]]:
    return list(pairwise(map(float, shares)))


def turns(a: dict[str, Matrices], b: dict[str, Matrices]) -> bool:
    both = ((a[key], b[key]) for key in a.keys() & b.keys() if len(a[key]) == len(b[key]))
    return any(not np.allclose(x[:, :3, :3], y[:, :3, :3], rtol=0.0, atol=TURN) for x, y in both)


def misses(a: dict[str, Matrices], middle: dict[str, Matrices], b: dict[str, Matrices]) -> bool:
    for key in a.keys() & middle.keys() & b.keys():
        x, m, y = a[key], middle[key], b[key]
        if not (len(x) == len(m) == len(y) > 0):
            continue
        off = np.abs(0.5 * (x + y) - m)
        size = np.abs(m[:, :3, :3]).max(axis=(1, 2))
        way = np.abs(y - x)[:, 3, :3].max(axis=1)
        # No name of a prim has a dot: `places` says which are of mesh lights.
        turn = LIT_TURN if ".light" in key else TURN
        if (off[:, :3, :3].max(axis=(1, 2)) > turn * size).any():
            return True
        if (off[:, 3, :3].max(axis=1) > SAG * way + SAME * np.abs(m[:, 3, :3]).max(axis=1)).any():
            return True
    return False


def needed(shares: NDArray, values: list[NDArray], tolerance: Callable[[NDArray], float]) -> list[int]:
    """Indices of the keys that are not on the straight way between those before and behind; none where all are one."""
    if all(np.array_equal(values[0], value) for value in values[1:]):
        return []
    kept = [0]
    for i in range(1, len(values) - 1):
        before, behind = values[kept[-1]], values[i + 1]
        share = (shares[i] - shares[kept[-1]]) / (shares[i + 1] - shares[kept[-1]])
        straight = before + (np.asarray(behind, np.float64) - before) * share
        if np.abs(straight - values[i]).max(initial=0.0) > tolerance(values[i]):
            kept.append(i)
    return [*kept, len(values) - 1]


def single(values: NDArray) -> NDArray:
    return np.ascontiguousarray(values, np.float32)
