"""Where peers live: each in a virtual environment of its own, DIR/NAME, made by `dermis peers install`.

DIR is $DERMIS_PEERS, else the user's cache folder. `peer.json` there says how to start the worker; it is written last,
so that what is half installed is not there.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ..cli import output

NAMES = ("mitsuba", "cycles")

MITSUBA = "mitsuba==3.9.1"

#: bpy is built for one minor version of Python; 5.0.1 is the last for 3.11.
BPY, BPY_PYTHON = "bpy==5.0.1", (3, 11)

#: Dr.Jit compiles through the system's LLVM, and that of version 16 and older aborts on Mitsuba's volume kernels.
OLDEST_LLVM = 17

#: Debian's package with a newer one, and what it needs; unpacked beside the environment, not installed.
LLVM_PACKAGES = ("libllvm19", "libz3-4", "libedit2", "libbsd0", "libmd0")

#: Prints LLVM's version and renders a medium: what does not fit may also abort, hence in a process of its own.
PROBE = """
import sys, drjit as dr, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
body = {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous", "albedo": 0.5}}
sensor = {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}}
scene = {"type": "scene", "integrator": {"type": "volpath"}, "body": body, "sky": {"type": "constant"}, "s": sensor}
mi.render(mi.load_dict(scene), spp=1).numpy()
print(dr.detail.llvm_version()[0])
"""

Say = Callable[[str], None]


class PeerError(Exception):
    """A peer that cannot be installed, started or asked; the text says why."""


@dataclass(frozen=True)
class Environment:
    name: str
    #: Interpreter of the environment.
    python: str
    #: Of the worker.
    arguments: list[str] = field(default_factory=list)
    #: Environment variables of the worker.
    variables: Mapping[str, str] = field(default_factory=dict)
    #: What was installed, and how it runs.
    about: str = ""

    @property
    def worker(self) -> Path:
        return Path(__file__).with_name(f"{self.name}_worker.py")


def home() -> Path:
    if os.environ.get("DERMIS_PEERS"):
        return Path(os.environ["DERMIS_PEERS"])
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "dermis" / "peers"


def find(name: str, folder: Path | None = None) -> Environment:
    """The environment of an installed peer. Raises PeerError."""
    file = (folder or home()) / name / "peer.json"
    try:
        found = Environment(**json.loads(file.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise PeerError(f"{name} is not installed in {file.parent}: dermis peers install {name}") from None
    except (OSError, TypeError, ValueError) as error:
        raise PeerError(f"{file}: {error}; install it again: dermis peers install {name}") from error
    if not Path(found.python).exists():
        raise PeerError(f"{found.python} is gone; install it again: dermis peers install {name}")
    return found


def install(name: str, folder: Path, say: Say) -> Environment:
    """Makes the environment of a peer anew. Raises PeerError."""
    place = folder.absolute() / name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    made = {"mitsuba": install_mitsuba, "cycles": install_cycles}[name](place, say)
    with output.replacing(place / "peer.json") as temporary:
        temporary.write_text(json.dumps(asdict(made), indent=1), encoding="utf-8")
    return made


def install_cycles(place: Path, say: Say) -> Environment:
    python = virtual_environment(python_of(BPY_PYTHON), place, BPY, say)
    run([python, "-c", "import bpy"], "bpy does not start")
    return Environment("cycles", python, about=BPY)


def install_mitsuba(place: Path, say: Say) -> Environment:
    python = virtual_environment(sys.executable, place, MITSUBA, say)
    for variables in llvm_variables(place, say):
        version = probe(python, variables)
        if version >= OLDEST_LLVM:
            about = f"{MITSUBA}, llvm_ad_rgb, LLVM {version}"
            return Environment("mitsuba", python, ["llvm_ad_rgb"], variables, about)
    say(f"mitsuba: there is no LLVM {OLDEST_LLVM} or newer that works: the variant scalar_rgb is used")
    return Environment("mitsuba", python, ["scalar_rgb"], about=f"{MITSUBA}, scalar_rgb")


def virtual_environment(interpreter: str, place: Path, package: str, say: Say) -> str:
    """Its interpreter, with the package and the numpy that this one asks for."""
    say(f"{package}: into {place}")
    run([interpreter, "-m", "venv", str(place / "venv")], "the virtual environment could not be made")
    windows = os.name == "nt"
    python = str(place / "venv" / ("Scripts" if windows else "bin") / ("python.exe" if windows else "python"))
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package, "numpy"]
    run(pip, f"{package} could not be installed")
    return python


def python_of(version: tuple[int, int]) -> str:
    """An interpreter of this minor version: this one, on the PATH, or pyenv's. Raises PeerError."""
    name = "python{}.{}".format(*version)
    if sys.version_info[:2] == version:
        return sys.executable
    known = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    candidates = [shutil.which(name), *map(str, sorted(known.glob("{}.{}.*/bin/python".format(*version))))]
    for candidate in candidates:
        # A shim of pyenv is on the PATH whether or not its version is switched on.
        if candidate and subprocess.run([candidate, "-c", ""], capture_output=True).returncode == 0:
            return candidate
    raise PeerError(f"{BPY} needs {name}, which was not found on the PATH or in {known}")


def llvm_variables(place: Path, say: Say) -> Iterator[dict[str, str]]:
    """Environment variables with which Dr.Jit may find an LLVM, in the order of trial."""
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    yield {"DRJIT_LIBLLVM_PATH": given} if given else {}
    for library in () if given else fetched_llvm(place, say):
        yield {"DRJIT_LIBLLVM_PATH": str(library), "LD_LIBRARY_PATH": str(library.parent)}


def fetched_llvm(place: Path, say: Say) -> list[Path]:
    """LLVM out of Debian's packages, where apt has them."""
    if not (shutil.which("apt-get") and shutil.which("dpkg-deb")):
        return []
    folder = place / "llvm"
    folder.mkdir()
    try:
        # `download` needs no root and installs nothing.
        run(["apt-get", "download", *LLVM_PACKAGES], f"{LLVM_PACKAGES[0]} could not be fetched", folder)
        for package in folder.glob("*.deb"):
            run(["dpkg-deb", "--extract", str(package), str(folder)], f"{package} could not be unpacked")
            package.unlink()
    except PeerError as error:
        say(f"mitsuba: {error}")
    return sorted(folder.rglob("libLLVM-*.so"))


def probe(python: str, variables: Mapping[str, str]) -> int:
    """Major version of an LLVM that renders; 0 for one that does not."""
    environment = {**os.environ, **variables}
    done = subprocess.run([python, "-c", PROBE], capture_output=True, text=True, env=environment)
    words = done.stdout.strip().splitlines()
    return int(words[-1]) if done.returncode == 0 and words else 0


def run(command: list[str], failure: str, folder: Path | None = None) -> None:
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines()
        raise PeerError(f"{failure}: {lines[-1] if lines else f'exit code {done.returncode}'}")
