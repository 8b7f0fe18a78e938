"""`dermis` and `python -m dermis`: the command line."""

import os
import signal
import sys

INTERRUPTED = 130


def main() -> int:
    """The exit code of the command line.

    Ctrl-C while libraries are imported or a stage is opened ends the process without a word: nothing was written yet,
    and some of them turn a KeyboardInterrupt into errors of their own. Commands set their own handlers when they begin.
    """
    # numpy starts a thread of linear algebra per processor, which nobody here asks for: .03 s on two processors.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
    from .cli import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
