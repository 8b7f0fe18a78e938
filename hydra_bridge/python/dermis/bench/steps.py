"""How far a run is, on stderr: a bar on a terminal, a line per render elsewhere."""

import sys
from types import TracebackType

from ..cli.progress import Progress, default_kind
from .render import Watch


class Steps:
    """Counts `total` renders; use as a context."""

    def __init__(self, total: int, quiet: bool) -> None:
        self.total = total
        self._lines = not quiet and default_kind() == "none"
        self._progress = Progress("none" if quiet else default_kind(), max(total, 1))
        self._number = 0

    def __enter__(self) -> "Steps":
        self._progress.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.__exit__(kind, error, trace)

    def next(self, text: str, kept: bool = False) -> Watch:
        """Begins the next render, which may be there already; its progress goes to what is returned."""
        number = self._number
        self._number += 1
        if self._lines:
            state = ", kept" if kept else ""
            print(f"[{self._number}/{self.total}] {text}{state}", file=sys.stderr, flush=True)
        self._progress.update(number, float(kept), text)
        return lambda share: self._progress.update(number, share, text)
