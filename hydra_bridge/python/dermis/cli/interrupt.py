"""Ctrl-C during a render ends the render and keeps its image."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


INTERRUPTED = 130


class Interrupt:
    """While `deferred`, a first SIGINT or SIGTERM only sets `requested`; a second one, or one at any
    other time, raises KeyboardInterrupt. SIGUSR1 sets `snapshot`."""

    def __init__(self) -> None:
        self.requested = False
        self.snapshot = False
        self._deferring = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Interrupt":
        self._before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        if hasattr(signal, "SIGUSR1"):
            self._before[signal.SIGUSR1] = signal.signal(signal.SIGUSR1, self._ask_for_snapshot)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def deferred(self) -> Iterator[None]:
        self._deferring = True
        try:
            yield
        finally:
            self._deferring = False

    def _ask_for_snapshot(self, number: int, frame: FrameType | None) -> None:
        self.snapshot = True

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._deferring and not self.requested:
            self.requested = True
        else:
            raise KeyboardInterrupt
