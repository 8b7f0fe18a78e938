"""Warnings: each said once, on stderr, and the checks that find a wrong image where nothing failed."""

import sys
from collections.abc import Iterable
from typing import Any

#: Shares of the walks that may be lost before it is said: leaks through a crack or two are common and
#: invisible; the safety nets are meant never to be reached.
LEAKED_SHARE, ENDED_SHARE = 1e-2, 1e-3

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


def self_check(is_finite: bool, is_lit: bool, stats: dict[str, Any], name: str = "image") -> list[Warning]:
    """What is suspicious about a finished image, a frame's file: exit code 0 with a wrong picture is the common
    failure."""
    found: list[Warning] = []
    if bad := int(stats.get("non_finite_samples", 0)):
        found.append((name, f"{bad} samples were not finite and were left out"))
    if not is_finite:
        found.append((name, "the image has pixels that are not finite"))
    if not is_lit:
        found.append((name, "the image is all black"))
    return found + walk_check(stats, name)


def walk_check(stats: dict[str, Any], name: str = "image") -> list[Warning]:
    """Walks and paths that ended black in numbers that show: the picture is darker than it should be."""
    walks, paths = int(stats.get("walks", 0)), int(stats.get("rays", {}).get("path", 0))
    leaked, too_long = int(stats.get("walks_leaked", 0)), int(stats.get("walks_too_long", 0))
    found: list[Warning] = []
    if leaked > LEAKED_SHARE * walks:
        message = (
            f"{leaked} of {walks} subsurface walks leaked and ended black: "
            "a mesh with a medium is open, intersects itself or overlaps another (primvars:dermis:subsurfaceSet joins "
            "diffuse ones), or the camera is inside of one"
        )
        found.append((name, message))
    if too_long > ENDED_SHARE * walks or int(stats.get("paths_trapped", 0)) > ENDED_SHARE * paths:
        message = "walks_too_long or paths_trapped in the statistics: light was lost, the picture is too dark"
        found.append((name, message))
    return found
