"""How far a render is, for people (a bar on the terminal) and for farms (lines on stdout)."""

import json
import sys
import time
from types import TracebackType
from typing import Any

KINDS = ("none", "bar", "alf", "json")


def default_kind() -> str:
    """A bar on a terminal; nothing where the output is collected."""
    return "bar" if sys.stderr.isatty() else "none"


class Progress:
    """Progress of `frames` images, in one of `KINDS`; use as a context."""

    def __init__(self, kind: str, frames: int = 1) -> None:
        self.kind = kind
        self.frames = frames
        self._began = time.monotonic()
        self._last = ""
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> "Progress":
        if self.kind == "bar":
            self._start_bar()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, frame: int, fraction: float, text: str = "Rendering") -> None:
        """`fraction` of image number `frame` (from 0) is done; `text` stands before the bar."""
        done = min(max((frame + fraction) / self.frames, 0.0), 1.0)
        if self.kind == "bar":
            self._bar.update(self._task, completed=done, description=text)
        elif self.kind == "alf":
            self._line(f"ALF_PROGRESS {int(done * 100)}%")
        elif self.kind == "json":
            # Whole per mille, so that a long render does not print a line per poll.
            seconds = round(time.monotonic() - self._began, 1)
            self._line(
                json.dumps({"progress": round(done, 3)}), json.dumps({"frame": frame, "seconds": seconds})
            )

    def _line(self, text: str, details: str = "") -> None:
        """Prints a line when `text` is new; flushed, for the reader is a pipe."""
        if text == self._last:
            return
        self._last = text
        print(f"{text[:-1]}, {details[1:]}" if details else text, flush=True)

    def _start_bar(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Bar

        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        # Lines printed meanwhile go above the bar; those for a pipe are left alone.
        shared = sys.stdout.isatty()
        self._bar = Bar(*columns, console=Console(stderr=True), redirect_stdout=shared, refresh_per_second=5)
        self._task = self._bar.add_task("Rendering", total=1.0)
        self._bar.start()
