"""Guarded reads: whatever a stage holds, a read gives a usable value or one warning that names prim and
attribute."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from .arrays import np
from .colorspace import Colors

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLOAT32_MAX = (2.0 - 2.0**-23) * 2.0**127

HELD = {
    ("float32", 1): Vt.FloatArray,
    ("float32", 2): Vt.Vec2fArray,
    ("float32", 3): Vt.Vec3fArray,
    ("float32", 4): Vt.Vec4fArray,
    ("int32", 1): Vt.IntArray,
}
"""What holds scalars of a type, so many to an element, as the core takes them."""


class Report:
    """Warnings of one flattening, in the order met; the same words about the same prim are kept once."""

    def __init__(self) -> None:
        self.warnings: list[tuple[str, str]] = []
        self._seen: set[tuple[str, str]] = set()

    def warn(self, prim: str | Usd.Prim, message: str) -> None:
        # One line, whatever libraries have to say.
        entry = (str(prim.GetPath()) if isinstance(prim, Usd.Prim) else str(prim), " ".join(message.split()))
        if entry not in self._seen:
            self._seen.add(entry)
            self.warnings.append(entry)


class Reader:
    """Reads attributes at one time; what cannot be used becomes the default and a warning."""

    def __init__(self, time: Usd.TimeCode, report: Report, moment: Usd.TimeCode | None = None) -> None:
        self.time = time
        #: Within the shutter of the frame `time`: of what moves.
        self.moment = time if moment is None else moment
        self.report = report
        self.colors = Colors()
        #: Primvars that materials read, or AOVs show.
        self.primvars: tuple[str, ...] = ()
        #: Those of AOVs.
        self.shown: tuple[str, ...] = ()

    def show(self, names: Iterable[str]) -> None:
        """Primvars that AOVs show are read of every prim that has them."""
        self.shown = tuple(sorted(set(names)))
        self.primvars = tuple(sorted({*self.primvars, *self.shown}))

    def warn(self, prim: str | Usd.Prim, message: str) -> None:
        self.report.warn(prim, message)

    def value(self, prim: Usd.Prim, name: str, default: Any) -> Any:
        """The attribute as the type of `default` (bool, int, float, str or tuple of float); finite always."""
        return self.coerced(prim, name, self.raw(prim, name), default)

    def color(self, prim: Usd.Prim, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """A colour in the space that is rendered in."""
        value, attribute = self.value(prim, name, default), prim.GetAttribute(name)
        return self.colored(attribute, value) if attribute else value

    def colored(self, attribute: Usd.Attribute, value: tuple[float, ...]) -> tuple[float, ...]:
        """A value of an attribute in the space that is rendered in; the same where it is no colour."""
        if not self.colors.changes(attribute):
            return value
        return tuple(float(x) for x in self.colors.of(attribute, np.asarray(value, np.float64)))

    def raw(self, prim: Usd.Prim, name: str) -> Any:
        """The attribute's value at the time, or None where there is none."""
        attribute = prim.GetAttribute(name)
        return attribute.Get(self.time) if attribute else None

    def coerced(self, prim: Usd.Prim, name: str, value: Any, default: Any) -> Any:
        if value is None:
            return default
        try:
            return coerce(value, default)
        except (TypeError, ValueError, OverflowError) as error:
            self.warn(prim, f"{name}: {error}; {default!r} is used")
            return default

    def array(self, prim: Usd.Prim, name: str, dtype: str, components: int) -> NDArray | None:
        """The attribute as array of shape (n,) or (n, components), a view of USD's own memory where the type
        allows."""
        return self.as_array(prim, name, self.raw(prim, name), dtype, components)

    def moved(self, prim: Usd.Prim, name: str) -> Any:
        """A value at the moment. Points go by their velocities where these are authored (UsdGeomPointBased)."""
        attribute = prim.GetAttribute(name)
        value = attribute.Get(self.moment) if attribute else None
        if name == "points" and not self.moment.IsDefault() and not self.time.IsDefault():
            velocities = prim.GetAttribute("velocities")
            if velocities and velocities.HasAuthoredValue():
                value = self.by_velocities(prim, value)
        elif name == "normals" and "velocities" in prim.GetAuthoredPropertyNames():
            value = self.raw(prim, name)
        return value

    def by_velocities(self, prim: Usd.Prim, value: Any) -> Any:
        """`value`, the points by interpolation, where velocities are of no use."""
        try:
            return UsdGeom.PointBased(prim).ComputePointsAtTimes([self.moment], self.time)[0]
        except (Tf.ErrorException, IndexError) as error:
            self.warn(
                prim,
                f"velocities: {usd_words(error) if isinstance(error, Tf.ErrorException) else error}; ignored",
            )
            return value

    def as_array(self, prim: Usd.Prim, name: str, value: Any, dtype: str, components: int) -> NDArray | None:
        """A value as array of shape (n,) or (n, components); None, and a warning, where it is none."""
        held = self.held(prim, name, value, dtype, components)
        return None if held is None else np.asarray(held)

    def held(
        self, prim: Usd.Prim, name: str, value: Any, dtype: str, components: int
    ) -> memoryview | NDArray | None:
        """As `as_array`, for the core: USD's own memory, without numpy, where USD holds just that."""
        if value is None:
            return None
        if type(value) is HELD.get((dtype, components)):
            return memoryview(value)
        array = numeric(value)
        shape = () if components == 1 else (components,)
        if (
            array is None
            or array.ndim != 1 + len(shape)
            or array.shape[1:] != shape
            or not fits(array, dtype)
        ):
            kind = (
                "integers" if dtype == "int32" else "numbers" if components == 1 else f"{components}-vectors"
            )
            self.warn(
                prim, f"{name}: an array of {kind} was expected, found {describe(value)}; it is ignored"
            )
            return None
        # What is too large for float32 becomes infinity, which the core's validation names.
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, dtype)

    def tokens(self, prim: Usd.Prim, name: str) -> list[str] | None:
        """A token array, or None where there is none."""
        value = self.raw(prim, name)
        if value is None or isinstance(value, (Vt.TokenArray, Vt.StringArray)):
            return None if value is None else [str(x) for x in value]
        self.warn(prim, f"{name}: tokens were expected, found {describe(value)}; it is ignored")
        return None

    def asset(self, prim: Usd.Prim, name: str) -> Sdf.AssetPath | None:
        """An asset path, or None where there is none or an empty one."""
        value = self.raw(prim, name)
        if value is None or isinstance(value, Sdf.AssetPath):
            return value if value is not None and value.path else None
        self.warn(prim, f"{name}: an asset path was expected, found {describe(value)}; it is ignored")
        return None

    def transform(self, prim: Usd.Prim, compute: Callable[[Usd.Prim], Any], damaged: Any) -> Any:
        """What an XformCache computes for a prim; `damaged` where its xformOps hold values of a wrong
        type."""
        try:
            return compute(prim)
        except Tf.ErrorException as error:
            self.warn(prim, f"xformOpOrder: {usd_words(error)}; the identity is used")
            return damaged

    def matrix(self, prim: Usd.Prim, matrix: Any) -> list[list[float]]:
        """A GfMatrix4d as nested lists; identity where it is not finite."""
        rows = [list(row) for row in matrix]
        if all(math.isfinite(x) for row in rows for x in row):
            return rows
        self.warn(prim, "xformOpOrder: the transform is not finite; the identity is used")
        return [[float(i == j) for j in range(4)] for i in range(4)]


def usd_words(error: Tf.ErrorException) -> str:
    """USD's own message without the place in its sources."""
    text = next((line for line in str(error).splitlines() if line.strip()), "")
    return text.split(" : ", 1)[-1].strip().strip("'")


def numeric(value: Any) -> NDArray | None:
    """A Vt array as numpy view, or None where it holds no numbers."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind in "fiub" else None


def fits(array: NDArray, dtype: str) -> bool:
    """Whether the conversion keeps the kind: no fractions into integers."""
    return np.dtype(dtype).kind == "f" or array.dtype.kind in "iub"


def coerce(value: Any, default: Any) -> Any:
    """`value` as the type of `default`; raises TypeError or ValueError in words where that makes no sense."""
    if isinstance(default, str):
        if not isinstance(value, str):
            raise TypeError(f"a token was expected, found {describe(value)}")
        return value
    if isinstance(default, tuple):
        return vector(value, len(default))
    if isinstance(value, str) or not hasattr(value, "__float__") or getattr(value, "ndim", 0):
        raise TypeError(f"a number was expected, found {describe(value)}")
    return type(default)(finite(float(value)))


def vector(value: Any, length: int) -> tuple[float, ...]:
    if isinstance(value, str) or not hasattr(value, "__len__") or len(value) != length:
        raise TypeError(f"{length} numbers were expected, found {describe(value)}")
    return tuple(finite(float(x)) for x in value)


def finite(value: float) -> float:
    """`value` if it is finite in single precision, which is what the core computes in."""
    if not abs(value) <= FLOAT32_MAX:
        raise ValueError(f"{value:g} is not finite in single precision")
    return value


def describe(value: Any) -> str:
    """A value for a message, short whatever its size."""
    text = repr(value)
    return f"{type(value).__name__} {text if len(text) <= 40 else text[:37] + '...'}"
