"""On what was measured: processor, system, versions."""

import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from .. import __version__

LIBRARIES = ("numpy", "usd-core", "openimageio", "opencolorio", "matplotlib", "flip-evaluator")


def machine() -> dict[str, Any]:
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "dermis": __version__,
        **{name: version(name) for name in LIBRARIES},
    }


@cache
def processor() -> str:
    """The model, where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
