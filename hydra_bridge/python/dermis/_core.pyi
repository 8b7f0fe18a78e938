"""The Rust core, as the bridge sees it. Prims arrive as JSON (`flat::Prim`, tag `type`) with their arrays beside it."""

from collections.abc import Sequence
from pathlib import Path

from numpy.typing import NDArray

__version__: str

class CoreError(Exception):
    """An error of the core; the text names the prim, attribute or file."""

def single_scattering_albedo(
    color: Sequence[float], anisotropy: float, eta: float, dielectric: bool
) -> list[float]:
    """The single-scattering albedo per channel that shows `color` (RGB) behind a boundary. `eta`: of a dielectric one,
    which is lit at normal incidence; 1 for others, which are lit diffusely."""

def write_channels(
    file: str,
    frame: tuple[Sequence[int], Sequence[int], Sequence[int], float],
    channels: Sequence[tuple[str, NDArray]],
    attributes: str,
) -> None:
    """Writes float32 or uint32 arrays (height, width) as channels of an EXR like the renderer's own. `frame`:
    resolution, origin and size of the data window, pixel aspect ratio; `attributes`: a JSON object."""

class Delegate:
    """Hydra's render delegate: prims come by `sync`, changes take effect at `commit`. Threads may share one: each call
    waits for its turn, `wait` lets others in."""

    def __init__(self) -> None: ...
    @staticmethod
    def load(file: str) -> Delegate:
        """A delegate holding the flattened scene of a `.dermis` file (memory-mapped)."""

    def save(self, file: str) -> None:
        """Writes the flattened scene as one `.dermis` file (temporary name, then renamed)."""

    def sync(self, path: str, prim: str, arrays: Sequence[NDArray | memoryview], dirty_bits: int) -> None:
        """Inserts or edits a prim. `prim` is JSON in which `{"array": i}` stands for `arrays[i]`
        (C-contiguous float32, float64 or int32; shape (n,), (n, k) or (n, 4, 4)); views of USD's arrays, which
        nobody writes to, are read in place, others are copied.
        Of an existing prim only the aspects named by `dirty_bits` are replaced."""

    def remove(self, path: str) -> None: ...
    def set_stage(self, info: str) -> None:
        """JSON of `flat::StageInfo`."""

    def set_settings(self, settings: str) -> None:
        """JSON of `flat::RenderSettings`; absent names keep their value."""

    def settings(self) -> str:
        """JSON of the current `flat::RenderSettings`, every name with its value."""

    def clear_warnings(self) -> None:
        """Lets go the warnings of the bridge, before those of another flattening."""

    def warn(self, path: str, message: str) -> None:
        """Adds a warning of the bridge to those of the scene."""

    def commit(self, last: bool = False) -> str:
        """Compiles what is dirty; JSON with what was rebuilt (`blas_built`, `instances`, `lights`, `seconds`...).
        `last`: points and faces of meshes are let go as soon as they are compiled; another commit then fails, and
        `save`."""

    def explain(self) -> str:
        """JSON: what the committed scene needs (`needs`), what was switched on and why (`capabilities`), which walk
        each medium takes and why (`media`: `prim`, `walk`, `exact`, `why`), what became of each subdivision surface
        (`subdivision`: `prim`, `scheme`, `level`, `cageFaces`, `triangles`), `warnings`."""

    def bounds(self) -> tuple[list[float], list[float]] | None:
        """World bounds (min, max) of the visible meshes; None without any."""

    def cameras(self) -> list[str]: ...
    def start(self, checkpoint: str | None = None, every: float = 0.0, resume: bool = False) -> Path | None:
        """Starts the render in the background; call after `commit`. With `checkpoint`, its state is written to that
        file `every` so many seconds and where it is stopped, and what training finds at once beside it, with the
        suffix `.training`; with `resume` it goes on from there, to the image of an uninterrupted render. The file
        that it goes on from, if there is one. Raises CoreError for one of another scene or other settings."""

    def poll(self) -> tuple[float, bool]:
        """(fraction done, finished). Raises CoreError if the render failed."""

    def wait(self, seconds: float) -> bool:
        """Waits with the GIL released; True when finished."""

    def stop(self) -> None:
        """Asks the render to end after the tiles under way, and waits for it."""

    def snapshot(self) -> dict[str, NDArray]:
        """AOVs so far: name -> float32 array (height, width, channels), linear; `color` is the beauty (RGBA).
        Those of guided walks (`slabNormal`, `entryAgreement`, `walkLength`, `region`, `cacheIrradiance`,
        `techniqueShares`) only where the settings ask for them."""

    def check(self) -> tuple[bool, bool]:
        """Whether all of the image is finite, and whether any of it is not black."""

    def stats(self) -> str:
        """JSON with the names of the contract (`samples_per_pixel`, `seconds.total`, `guide.media`, ...)."""

    def write_exr(self, file: str, attributes: str, layers: str | None = None) -> None:
        """Writes AOVs as one multi-layer EXR (temporary name, then renamed); `attributes` is a JSON object of strings
        for the header, `layers` a JSON list of `{name, aov, half}`, without it all AOVs under their own names. Honours
        the data window."""
