"""The command line: one module per command, each with NAME, FILES, HELP, `add_arguments` and `run`."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from .interrupt import INTERRUPTED
from .output import OutputError

COMMANDS = ("record", "explain", "flatten", "merge", "bench", "peers")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs `dermis ARGUMENTS`; exit codes: 0 done, 1 scene or render error, 2 usage, 130 interrupted."""
    arguments = sys.argv[1:] if arguments is None else arguments
    parser, parsers = build_parser(arguments[0] if arguments else "")
    args = parser.parse_args(arguments)
    if args.command in ("bench", "peers"):
        # They have children to end; see `__main__` for the others.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return args.run(parsers[args.command], args)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output (`| head`) has enough; the interpreter's own flush must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (_scene_error(), OutputError, OSError) as error:
        print(error, file=sys.stderr)
        return 1


def build_parser(command: str = "") -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """Of all commands, or, where `command` is one of them, of that one: nobody waits for the others."""
    parser = argparse.ArgumentParser(
        prog="dermis", description="A path tracer for USD shots with subsurface scattering"
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    parsers = {}
    for name in (command,) if command in COMMANDS else COMMANDS:
        module = import_module(f".{name}", __name__)
        usage = f"dermis {module.NAME} {module.FILES} [flags]"
        added = commands.add_parser(module.NAME, help=module.HELP, description=module.HELP, usage=usage)
        module.add_arguments(added)
        added.set_defaults(run=module.run)
        parsers[module.NAME] = added
    return parser, parsers


def _scene_error() -> type[Exception]:
    # Imported late: `--help` and usage errors need no USD and no core.
    from .scene import SceneError

    return SceneError


class _Version(argparse.Action):
    def __init__(self, option_strings, dest, **options):
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser, namespace, values, option_string=None):
        from dermis._core import __version__

        print(f"dermis {__version__}")
        parser.exit(0)
