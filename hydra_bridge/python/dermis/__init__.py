"""dermis: a renderer for USD shots with subsurface scattering at its heart.

>>> import dermis
>>> image = dermis.render("shot.usda", samples=64)
>>> image.color.shape
(540, 960, 4)

`Delegate` speaks Hydra for interactive hosts; `flatten` and `open_stage` are the USD side alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._core import CoreError, __version__
    from .hydra import Delegate, DirtyBits, populate
    from .image import Image, render
    from .stage import FlatStage, Options, StageError, encode, flatten, open_stage

__all__ = [
    "CoreError",
    "Delegate",
    "DirtyBits",
    "FlatStage",
    "Image",
    "Options",
    "StageError",
    "__version__",
    "encode",
    "flatten",
    "open_stage",
    "populate",
    "render",
]

HOMES = {
    "_core": ("CoreError", "__version__"),
    "hydra": ("Delegate", "DirtyBits", "populate"),
    "image": ("Image", "render"),
    "stage": ("FlatStage", "Options", "StageError", "encode", "flatten", "open_stage"),
}


def __getattr__(name: str) -> Any:
    """Imports on first use, so that reading stages needs no core and `dermis --help` no USD."""
    for module, names in HOMES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module 'dermis' has no attribute '{name}'")
