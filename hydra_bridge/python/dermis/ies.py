"""IES profiles (IESNA LM-63-1986 to ANSI/IES LM-63-19): candela over vertical and horizontal angles, type C."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pxr import Ar, Usd

from .arrays import np
from .reading import Reader
from .texture import TextureError, stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray

TYPE_C = 1
KINDS = {2: "B", 3: "A"}
LARGEST = 10_000
"""Angles of one kind: more is damage."""


class ProfileError(Exception):
    """A file that is no usable profile; the text says why."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Angles in degrees, ascending, vertical ones from the nadir (the light's -Z), horizontal ones from +X towards +Y;
    the candela (horizontal, vertical) are all around, or a single row where they are the same all around."""

    vertical: NDArray[np.float32]
    horizontal: NDArray[np.float32]
    candela: NDArray[np.float32]


def flatten_profile(prim: Usd.Prim, reader: Reader) -> dict[str, Any] | None:
    """`flat::Ies` of inputs:shaping:ies:*; None where there is no file, or, with a warning, none that can be used."""
    name = "inputs:shaping:ies:file"
    asset = reader.asset(prim, name)
    if asset is None:
        return None
    try:
        if not asset.resolvedPath:
            raise ProfileError("the file was not found")
        profile = load(asset.resolvedPath, stamp(asset.resolvedPath))
    except (ProfileError, TextureError) as error:
        reader.warn(prim, f"{name}: {asset.path}: {error}; the light shines without it")
        return None
    return {
        "vertical": profile.vertical,
        "horizontal": profile.horizontal,
        "candela": profile.candela.reshape(-1),
        "angleScale": reader.value(prim, "inputs:shaping:ies:angleScale", 0.0),
        "normalize": reader.value(prim, "inputs:shaping:ies:normalize", False),
    }


@lru_cache(maxsize=64)
def load(path: str, _stamp: tuple[int, int]) -> Profile:
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    if not asset:
        raise ProfileError("the file cannot be opened")
    return parse(bytes(asset.GetBuffer()).decode("latin-1"))


def parse(text: str) -> Profile:
    lines = text.splitlines()
    tilt = next((i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT")), None)
    if tilt is None:
        raise ProfileError("it has no line TILT=, so it is no IES file")
    words = " ".join(lines[tilt + 1 :]).replace(",", " ").split()
    numbers = Numbers(words)
    if lines[tilt].split("=")[-1].strip().upper() == "INCLUDE":
        # How the lamp's tilt changes its output: the light stands as its stage says.
        numbers.take(1)
        numbers.take(2 * numbers.count("tilt angles"))
    _lamps, _lumens, multiplier = numbers.take(3)
    verticals, horizontals = numbers.count("vertical angles"), numbers.count("horizontal angles")
    (kind,) = numbers.take(1)
    if kind != TYPE_C:
        raise ProfileError(f"photometry of type {KINDS.get(kind, kind)} is not supported; type C is")
    numbers.take(4)  # units, width, length, height of the luminaire
    ballast, lamp_ballast, _watts = numbers.take(3)
    vertical, horizontal = numbers.take(verticals), numbers.take(horizontals)
    candela = numbers.take(horizontals * verticals).reshape(horizontals, verticals)
    check(vertical, horizontal, candela)
    factor = multiplier * ballast * (lamp_ballast if lamp_ballast > 0.0 else 1.0)
    around, rows = all_around(horizontal, candela * factor)
    return Profile(*(np.ascontiguousarray(a, np.float32) for a in (vertical, around, rows)))


class Numbers:
    """The numbers of a file, taken one after the other."""

    def __init__(self, words: list[str]) -> None:
        self.words = words
        self.at = 0

    def take(self, count: int) -> NDArray[np.float64]:
        words = self.words[self.at : self.at + count]
        self.at += count
        if len(words) < count:
            raise ProfileError("it ends too early")
        try:
            return np.array([float(word) for word in words])
        except ValueError as error:
            raise ProfileError(f"a number was expected ({error})") from error

    def count(self, what: str) -> int:
        count = self.take(1)[0]
        if not 1 <= count <= LARGEST:
            raise ProfileError(f"it has {count:g} {what}")
        return int(count)


def check(vertical: NDArray, horizontal: NDArray, candela: NDArray) -> None:
    if not np.isfinite(candela).all() or (candela < 0.0).any():
        raise ProfileError("its candela are negative or not finite")
    for name, angles, top in (("vertical", vertical, 180.0), ("horizontal", horizontal, 360.0)):
        if (np.diff(angles) <= 0.0).any() or angles[0] < 0.0 or angles[-1] > top:
            raise ProfileError(f"its {name} angles do not ascend between 0 and {top:g}")


def all_around(horizontal: NDArray, candela: NDArray) -> tuple[NDArray, NDArray]:
    """By the symmetry that the range of horizontal angles stands for (LM-63, type C): 0 alone, a quadrant, a half of
    either kind, or all around."""
    if len(horizontal) == 1:
        return np.zeros(1), candela
    first, last = horizontal[0], horizontal[-1]
    if (first, last) == (90.0, 270.0):
        # Symmetric about the plane of 90 and 270.
        mirrored, rows = (540.0 - horizontal)[::-1][1:], candela[::-1][1:]
        angles, values = np.concatenate([horizontal, mirrored]), np.concatenate([candela, rows])
        start = int(np.searchsorted(angles, 360.0))
        angles = np.concatenate([angles[start:] - 360.0, angles[:start]])
        values = np.concatenate([values[start:], values[:start]])
        # 90 is there as the last of the second half, too.
        keep = np.concatenate([[True], np.diff(angles) > 0.0])
        return closed(angles[keep], values[keep])
    if (first, last) == (0.0, 90.0):
        horizontal = np.concatenate([horizontal, (180.0 - horizontal)[::-1][1:]])
        candela = np.concatenate([candela, candela[::-1][1:]])
        last = 180.0
    if (first, last) == (0.0, 180.0):
        horizontal = np.concatenate([horizontal, (360.0 - horizontal)[::-1][1:]])
        return horizontal, np.concatenate([candela, candela[::-1][1:]])
    if first == 0.0 and last == 360.0:
        return horizontal, candela
    if first == 0.0 and 180.0 < last < 360.0:
        # Many files leave out the 360 that repeats 0.
        return closed(horizontal, candela)
    raise ProfileError(f"its horizontal angles span {first:g} to {last:g}, which stands for no symmetry")


def closed(angles: NDArray, rows: NDArray) -> tuple[NDArray, NDArray]:
    """From 0 to 360, both given, by interpolation across the seam where 0 is not given."""
    if angles[0] > 0.0:
        way = angles[0] + 360.0 - angles[-1]
        seam = rows[0] + (rows[-1] - rows[0]) * (angles[0] / way)
        angles, rows = np.concatenate([[0.0], angles]), np.concatenate([seam[None], rows])
    if angles[-1] < 360.0:
        angles, rows = np.concatenate([angles, [360.0]]), np.concatenate([rows, rows[:1]])
    return angles, rows
