"""One render of one window by one method: its image, and what it cost."""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._core import Delegate
from .crops import Window
from .scenes import Scene

#: Seconds between looks at a running render; a look costs nothing that can be measured.
POLL = 0.5


@dataclass(frozen=True)
class Render:
    #: Linear RGB, (height, width, 3), of the window.
    image: NDArray[np.float64]
    #: Process CPU seconds, user and system, of all threads, from start to end, training included.
    cpu: float
    wall: float
    #: Largest resident set of the process during this render, in bytes: the scene, and all that Python holds, included.
    #: None where the system cannot start that count anew, as only Linux can.
    peak: int | None
    stats: dict[str, Any]


#: Told the share of a render that is done.
Watch = Callable[[float], None]


def render(
    scene: Scene,
    settings: Mapping[str, Any],
    window: Window,
    file: Path | None = None,
    watch: Watch = lambda share: None,
) -> Render:
    """Renders from nothing: what one render has learned must not help the next. Writes an EXR to `file`, if given.

    Raises CoreError.
    """
    counted = restart_peak()
    delegate = Delegate.load(str(scene.file))
    view = {"dataWindowNDC": window.ndc(scene.resolution), "threads": scene.threads}
    delegate.set_settings(json.dumps({**view, **settings}))
    delegate.commit()
    cpu, wall = time.process_time(), time.perf_counter()
    finish(delegate, watch)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    image = delegate.snapshot()["color"][..., :3].astype(np.float64)
    width, height = window.size
    if image.shape[:2] != (height, width):
        raise RuntimeError(f"the core rendered {image.shape[1]} x {image.shape[0]} pixels of {window}")
    if file:
        delegate.write_exr(str(file), "{}")
    stats = json.loads(delegate.stats())
    return Render(image, cpu, wall, stats["peak_rss_bytes"] if counted else None, stats)


def restart_peak() -> bool:
    """Makes VmHWM count from here; False where the system knows no such thing (see proc(5), clear_refs)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def finish(delegate: Delegate, watch: Watch) -> None:
    """Renders to the end; an interrupt stops it first."""
    delegate.start()
    try:
        while not delegate.wait(POLL):
            watch(delegate.poll()[0])
    except BaseException:
        delegate.stop()
        raise
