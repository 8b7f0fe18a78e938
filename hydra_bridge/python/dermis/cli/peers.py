"""`dermis peers install NAME...`: other renderers for `dermis bench --peers`, each in an environment of its own."""

import argparse
import sys
from pathlib import Path

NAME = "peers"
FILES = "install|list"
HELP = "Installs the renderers that `dermis bench --peers` compares with"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from ..peers.environments import NAMES

    parser.add_argument("action", choices=("install", "list"), help="install some, or say what is installed")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="folder of the environments (default: $DERMIS_PEERS, else dermis/peers in the user's cache folder); "
        "`dermis bench` looks where $DERMIS_PEERS says",
    )


def run(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    """Exit code: 0 done, 1 a peer could not be installed; the others still are."""
    from ..peers import environments

    for name in args.names:
        if name not in environments.NAMES:
            parser.error(f"there is no peer {name!r}; there are {', '.join(environments.NAMES)}")
    folder = args.into or environments.home()
    if args.action == "list":
        return show(args.names or environments.NAMES, folder)
    if not args.names:
        parser.error(f"install what? {', '.join(environments.NAMES)}")
    code = 0
    for name in dict.fromkeys(args.names):
        try:
            made = environments.install(name, folder, say)
            say(f"{name}: installed: {made.about}")
        except (environments.PeerError, OSError) as error:
            say(f"{name}: not installed: {error}")
            code = 1
    return code


def show(names: tuple[str, ...] | list[str], folder: Path) -> int:
    from ..peers import environments

    for name in names:
        try:
            print(f"{name}: {environments.find(name, folder).about}")
        except environments.PeerError as error:
            print(f"{name}: {error}")
    return 0


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
