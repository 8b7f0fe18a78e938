"""PointInstancer arrays as placements, and nested placements multiplied out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from pxr import Usd, UsdGeom

from .arrays import np
from .reading import Reader, numeric

if TYPE_CHECKING:
    from numpy.typing import NDArray

Matrices: TypeAlias = "NDArray[np.float64]"
"""(n, 4, 4), row vectors."""


@dataclass(frozen=True)
class Placements:
    """`placed`: None where it is once, at its own place. `primvars`: (n, components) float32 by name; a row of NaN
    where an instance has none."""

    placed: Matrices | None = None
    primvars: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    def __len__(self) -> int:
        return 1 if self.placed is None else len(self.placed)

    @property
    def matrices(self) -> Matrices:
        return np.eye(4)[None] if self.placed is None else self.placed

    def within(self, outer: Placements) -> Placements:
        """Every one of these in every outer one; what an inner instance has not, it has from the outer one."""
        inner, outside = len(self), len(outer)
        primvars = {name: np.repeat(values, inner, axis=0) for name, values in outer.primvars.items()}
        for name, values in self.primvars.items():
            own = np.tile(values, (outside, 1))
            primvars[name] = over(own, primvars[name]) if name in primvars else own
        return Placements(nested(self.matrices, outer.matrices), primvars)


def over(values: NDArray, below: NDArray) -> NDArray:
    """`values`, and where they are NaN those `below`; of the width of the wider ones."""
    width = max(values.shape[1], below.shape[1])
    values, below = (np.pad(v, ((0, 0), (0, width - v.shape[1]))) for v in (values, below))
    return np.where(np.isnan(values[:, :1]), below, values)


def point_instances(prim: Usd.Prim, reader: Reader) -> tuple[NDArray, Placements]:
    """(prototype index, instance to instancer without the prototype's own transform) of every instance that
    shows.

    Damaged arrays lose what cannot be used, with a warning each.
    """
    indices = reader.array(prim, "protoIndices", "int32", 1)
    positions = reader.array(prim, "positions", "float32", 3)
    if indices is None or positions is None or not len(indices) or not len(positions):
        return np.zeros(0, np.int32), Placements(np.zeros((0, 4, 4)))
    count = min(len(indices), len(positions))
    if len(indices) != len(positions):
        reader.warn(
            prim, f"positions: {len(positions)} for {len(indices)} protoIndices; the first {count} are used"
        )
    at_frame = reader.moment == reader.time
    matrices = None if at_frame and not flies(prim, reader) else moved_matrices(prim, count, reader)
    if matrices is None:
        if not at_frame:
            return np.zeros(0, np.int32), Placements(np.zeros((0, 4, 4)))
        matrices = instance_matrices(prim, positions[:count], reader)
    keep = shown(prim, count, reader) & in_range(prim, indices[:count], reader)
    primvars = {name: values[:count][keep] for name, values in instance_primvars(prim, len(indices), reader)}
    return indices[:count][keep], Placements(matrices[keep], primvars)


def instance_primvars(
    prim: Usd.Prim, count: int, reader: Reader
) -> Iterable[tuple[str, NDArray[np.float32]]]:
    """(name, (count, components)) of the primvars that materials read, and displayColor: one value per instance is
    what every interpolation but constant and uniform means on an instancer (UsdImaging)."""
    api = UsdGeom.PrimvarsAPI(prim)
    for name in ("displayColor", *(name for name in reader.primvars if name != "displayColor")):
        primvar = api.GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()) or primvar.GetInterpolation() in (
            "constant",
            "uniform",
        ):
            continue
        values = numeric(primvar.ComputeFlattened(reader.time))
        if values is None or values.ndim not in (1, 2) or len(values) < count:
            found = "no numbers" if values is None else f"{len(values)} values"
            reader.warn(prim, f"primvars:{name}: {found} for {count} instances; it is ignored")
            continue
        values = values.reshape(len(values), -1)[:count, :4].astype(np.float32)
        values = reader.colors.of(primvar.GetAttr(), values)
        yield name, np.ascontiguousarray(np.where(np.isfinite(values).all(axis=1)[:, None], values, np.nan))


def instance_matrices(prim: Usd.Prim, positions: NDArray, reader: Reader) -> Matrices:
    """scale, then rotate, then translate (UsdGeomPointInstancer)."""
    scales = optional_array(prim, ("scales",), 3, len(positions), reader)
    orientations = optional_array(prim, ("orientationsf", "orientations"), 4, len(positions), reader)
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    if orientations is not None:
        set_rotations(matrices, orientations.astype(np.float64))
    if scales is not None:
        matrices[:, :3, :3] *= scales[:, :, None]
    matrices[:, 3, :3] = positions + drift(prim, len(positions), reader)
    return matrices


def flies(prim: Usd.Prim, reader: Reader) -> bool:
    """Whether instances go by velocities between samples: at the frame by the same rules as beside it."""
    if reader.time.IsDefault() or reader.time.IsEarliestTime():
        return False
    return any(prim.GetAttribute(name).HasAuthoredValue() for name in ("velocities", "angularVelocities"))


def moved_matrices(prim: Usd.Prim, count: int, reader: Reader) -> Matrices | None:
    """At the moment, by USD's own rules of velocities, accelerations and angular velocities; None where it has none."""
    instancer = UsdGeom.PointInstancer(prim)
    exclude, ignore = UsdGeom.PointInstancer.ExcludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
    found = instancer.ComputeInstanceTransformsAtTimes([reader.moment], reader.time, exclude, ignore)
    matrices = np.array(found[0]).reshape(-1, 4, 4) if found else np.zeros((0, 4, 4))
    return matrices[:count] if len(matrices) >= count else None


def optional_array(
    prim: Usd.Prim, names: tuple[str, ...], components: int, count: int, reader: Reader
) -> NDArray | None:
    """The first authored of `names` if it has one value per instance."""
    for name in names:
        values = reader.array(prim, name, "float32", components)
        if values is None or not len(values):
            continue
        if len(values) >= count:
            return values[:count]
        reader.warn(prim, f"{name}: {len(values)} values for {count} instances; it is ignored")
    return None


def set_rotations(matrices: Matrices, quaternions: NDArray) -> None:
    """Quaternions (n, 4) as (i, j, k, real), not normalised, as GfMatrix4d.SetRotate takes them."""
    x, y, z, w = quaternions.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )
    for i, row in enumerate(rows):
        for j, values in enumerate(row):
            matrices[:, i, j] = values


def drift(prim: Usd.Prim, count: int, reader: Reader) -> NDArray | float:
    """Way since the last sample of `positions` where velocities are authored: they beat interpolation."""
    if not prim.GetAttribute("velocities").HasAuthoredValue() or reader.time.IsDefault():
        return 0.0
    attribute = prim.GetAttribute("positions")
    bracket = attribute.GetBracketingTimeSamples(reader.time.GetValue())
    if not bracket or reader.time.GetValue() <= bracket[0]:
        return 0.0
    sample = Reader(Usd.TimeCode(bracket[0]), reader.report)
    velocities = optional_array(prim, ("velocities",), 3, count, sample)
    start = sample.array(prim, "positions", "float32", 3)
    now = reader.array(prim, "positions", "float32", 3)
    if velocities is None or start is None or len(start) < count or len(now) < count:
        return 0.0
    seconds = (reader.time.GetValue() - bracket[0]) / prim.GetStage().GetTimeCodesPerSecond()
    return start[:count] + velocities * seconds - now[:count]


def shown(prim: Usd.Prim, count: int, reader: Reader) -> NDArray:
    """Instances that are neither in `invisibleIds` nor deactivated."""
    ids = reader.array(prim, "ids", "int64", 1)
    if ids is None or len(ids) < count:
        ids = np.arange(count)
    hidden = reader.array(prim, "invisibleIds", "int64", 1)
    inactive = prim.GetMetadata("inactiveIds")
    gone = list(hidden) if hidden is not None else []
    gone += list(inactive.ApplyOperations([])) if inactive else []
    return ~np.isin(ids[:count], np.array(gone, np.int64))


def in_range(prim: Usd.Prim, indices: NDArray, reader: Reader) -> NDArray:
    prototypes = len(prim.GetRelationship("prototypes").GetForwardedTargets())
    good = (indices >= 0) & (indices < prototypes)
    if not good.all():
        bad = int(indices[~good][0])
        reader.warn(
            prim,
            f"protoIndices: {int((~good).sum())} values like {bad} name none of the {prototypes} prototypes; "
            "these instances are not rendered",
        )
    return good


def nested(inner: Matrices, outer: Matrices) -> Matrices:
    """Every inner placement in every outer one: (m, 4, 4), (n, 4, 4) -> (n * m, 4, 4)."""
    if len(outer) == 1 and np.array_equal(outer[0], np.eye(4)):
        return inner
    if len(inner) == 1 and np.array_equal(inner[0], np.eye(4)):
        return outer
    return np.matmul(inner[None], outer[:, None]).reshape(-1, 4, 4)


def place(edges: dict[Any, list[tuple[Any, Placements]]], root: Any, warn: Any) -> dict[Any, Placements]:
    """World placements of every frame. `edges[frame]` lists (child frame, child root to frame).

    A frame inside itself has no end: that edge is dropped, with `warn(child)`.
    """
    order = topological(edges, root, warn)
    parts: dict[Any, list[Placements]] = {root: [Placements()]}
    placements: dict[Any, Placements] = {}
    for frame in order:
        placements[frame] = joined(parts.get(frame, []))
        for child, inner in edges.get(frame, []):
            parts.setdefault(child, []).append(inner.within(placements[frame]))
    return placements


def joined(parts: list[Placements]) -> Placements:
    """One after the other; those of a part that has not a primvar have none."""
    if len(parts) == 1:
        return parts[0]
    widths: dict[str, int] = {}
    for part in parts:
        for name, values in part.primvars.items():
            widths[name] = max(widths.get(name, 0), values.shape[1])
    matrices = np.concatenate([part.matrices for part in parts]) if parts else np.zeros((0, 4, 4))
    return Placements(matrices, {name: column(parts, name, width) for name, width in widths.items()})


def column(parts: list[Placements], name: str, width: int) -> NDArray[np.float32]:
    none = [np.full((len(part), width), np.nan, np.float32) for part in parts]
    return np.concatenate(
        [over(part.primvars.get(name, nan), nan) for part, nan in zip(parts, none, strict=True)]
    )


def topological(edges: dict[Any, list[tuple[Any, Placements]]], root: Any, warn: Any) -> list[Any]:
    """Parents before children; cuts `edges` that close a cycle."""
    order: list[Any] = []
    visit(root, edges, {}, order, warn)
    return order[::-1]


def visit(frame: Any, edges: dict, state: dict[Any, str], order: list[Any], warn: Any) -> None:
    """Appends a frame to `order`, behind those within it."""
    state[frame] = "open"
    for child, _ in list(edges.get(frame, [])):
        if state.get(child) == "open":
            edges[frame] = [edge for edge in edges[frame] if edge[0] is not child]
            warn(child)
        elif child not in state:
            visit(child, edges, state, order, warn)
    state[frame] = "done"
    order.append(frame)
