"""Warnings: each said once, on stderr, and the checks that find a wrong image where nothing failed."""

import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: (prim, message)
Warning = tuple[str, str]


class Printer:
    """Prints each warning once, whatever the number of frames."""

    def __init__(self) -> None:
        self._printed: set[Warning] = set()

    def print(self, warnings: Iterable[Warning]) -> None:
        for warning in warnings:
            if warning not in self._printed:
                self._printed.add(warning)
                print("Warning: {}: {}".format(*warning), file=sys.stderr, flush=True)


def merge(*sources: Iterable[Warning]) -> list[Warning]:
    """All warnings in order, each once."""
    return list(dict.fromkeys((str(prim), str(message)) for source in sources for prim, message in source))


def of_stats(stats: dict[str, Any]) -> list[Warning]:
    """The warnings in the core's statistics."""
    return [(entry["prim"], entry["message"]) for entry in stats.get("warnings", [])]


def self_check(color: NDArray[np.floating], stats: dict[str, Any]) -> list[Warning]:
    """What is suspicious about a finished image: exit code 0 with a wrong picture is the common failure."""
    found: list[Warning] = []
    if bad := int(stats.get("non_finite_samples", 0)):
        found.append(("image", f"{bad} samples were not finite and were left out"))
    if not np.isfinite(color).all():
        found.append(("image", "the image has pixels that are not finite"))
    if not np.any(color[..., :3] > 0.0):
        found.append(("image", "the image is all black"))
    return found
