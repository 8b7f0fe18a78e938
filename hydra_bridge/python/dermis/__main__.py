"""`dermis` and `python -m dermis`: the command line."""

import gc
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
    # Libraries make objects by the ten thousand as they are loaded, which stay: looking through them takes .01 s.
    gc.set_threshold(100_000)
    from .cli import main as command

    code = command()
    if sys.argv[1] in ("bench", "peers"):
        return code  # they have folders to remove
    # The system frees at once what usd-core and the interpreter would free piece by piece.
    try:
        if sys.stdout:  # there is none where it was closed
            sys.stdout.flush()
    except BrokenPipeError:
        pass  # whoever read our output has enough
    except OSError as error:
        print(f"standard output: {error}", file=sys.stderr)
        code = code or 1
    os._exit(code)


if __name__ == "__main__":
    sys.exit(main())
