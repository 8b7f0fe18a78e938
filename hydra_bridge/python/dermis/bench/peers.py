"""Other renderers as methods of a comparison: what they render, at what cost, and against which reference."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..cli.output import replacing
from ..peers import client
from ..peers.client import Peer, Picture
from ..peers.environments import PeerError
from ..peers.flat_file import read_flat
from ..peers.mitsuba_export import Exported
from .crops import Window
from .methods import Method
from .reference import HALVES, SEEDS, Reference, of_halves
from .render import Render, Watch
from .scenes import Scene
from .store import Store, safe
from .suite import Suite, Work

#: Told of each half of a reference, and whether it was kept.
Watching = Callable[[int, bool], Watch]


@dataclass
class Opened:
    """A peer with the scene that it holds."""

    peer: Peer
    scene: str = ""
    exported: Exported | None = None
    #: Samples per pixel that fit into a budget, by window and seconds.
    fitting: dict[tuple[Window, float], int] = field(default_factory=dict)


class Peers:
    """The peers of a suite, as far as they are installed; use as a context: their processes live as long."""

    def __init__(self, suite: Suite, out: Path) -> None:
        self.suite = suite
        self.folder = out / "reference"
        self.ratios = out / "peers"
        #: What is to be said about each in the report.
        self.notes: list[str] = []
        #: Why some are not there.
        self.absent: list[str] = []
        self._opened: dict[str, Opened] = {}

    def __enter__(self) -> "Peers":
        for method in self.suite.methods:
            if method.peer:
                try:
                    self._opened[method.label] = Opened(Peer(method.peer))
                except PeerError as error:
                    self.absent.append(f"{error}; it is left out")
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: Any) -> None:
        for opened in self._opened.values():
            # A render under way would be waited for.
            opened.peer.close(at_once=kind is not None)

    def __len__(self) -> int:
        return len(self._opened)

    def has(self, method: Method) -> bool:
        """Of a walk of dermis always."""
        return not method.peer or method.label in self._opened

    def settings(self, method: Method, work: Work, seed: int) -> dict[str, Any]:
        """What a render depends on, by which it is kept."""
        about = self._opened[method.label].peer.environment.about
        return {"peer": method.peer, "about": about, "source": source(), **work.settings, "seed": seed}

    def render(self, scene: Scene, method: Method, work: Work, seed: int, window: Window) -> Render:
        """Raises PeerError, ExportError."""
        opened = self._open(scene, method)
        if work.kind == "samples":
            samples = int(work.amount)
        else:
            key = (window, work.amount)
            if key not in opened.fitting:
                opened.fitting[key] = opened.peer.samples_in(work.amount, window)
            samples = opened.fitting[key]
        picture = opened.peer.render(samples, seed, window)
        return Render(picture.image, picture.cpu, picture.wall, None, statistics(method, picture, samples))

    def reference(
        self, scene: Scene, method: Method, target: str, window: Window, known: Reference, watch: Watching
    ) -> Reference:
        """What the peer converges to: its own long render where its model differs from dermis', else `known`.

        Raises PeerError, ExportError.
        """
        opened = self._open(scene, method)
        assert opened.exported
        if not opened.exported.differences:
            self._note(
                f"{method.label}: {scene.spec.name}: the model is dermis': scored against its reference"
            )
            for half in range(len(SEEDS)):
                watch(half, True)
            return known
        files = tuple(self._half(scene, method, opened, window, *half, watch) for half in enumerate(SEEDS))
        halves = [self._load(file) for file in files]
        own = Reference(*of_halves(*halves), window, files, HALVES, known.mask)
        self._compare(scene, method, target, opened.exported.differences, own, known)
        return own

    def _open(self, scene: Scene, method: Method) -> Opened:
        opened = self._opened[method.label]
        if opened.scene != scene.key:
            opened.scene, opened.fitting = "", {}
            opened.exported, _ = opened.peer.load(read_flat(scene.file), scene.threads)
            opened.scene = scene.key
            self._note(f"{method.label}: {opened.peer.environment.about}; {opened.peer.kind.film}")
        return opened

    def _half(
        self,
        scene: Scene,
        method: Method,
        opened: Opened,
        window: Window,
        half: int,
        seed: int,
        watch: Watching,
    ) -> Path:
        """File of one half; rendered if it is not there."""
        samples = (self.suite.reference_samples + 1) // 2
        about = opened.peer.environment.about
        content = [method.peer, about, source(), scene.key, samples, seed, list(window)]
        key = hashlib.sha256(json.dumps(content).encode()).hexdigest()[:24]
        file = self.folder / f"{safe(method.label)}.{key}.exr"
        share = watch(half, file.exists())
        if not file.exists():
            picture = opened.peer.render(samples, seed, window)
            stats = statistics(method, picture, samples)
            Store(self.folder).keep(file, Render(picture.image, picture.cpu, picture.wall, None, stats))
            share(1.0)
        return file

    def _load(self, file: Path) -> np.ndarray:
        found = Store(self.folder).load(file)
        if found is None:
            raise PeerError(f"{file}: it cannot be read; delete it")
        return found.image

    def _compare(
        self,
        scene: Scene,
        method: Method,
        target: str,
        differences: list[str],
        own: Reference,
        known: Reference,
    ) -> None:
        """Says how the picture that the peer converges to differs; the ratio image goes to DIR/peers."""
        means = [image.image.mean(axis=(0, 1)) for image in (own, known)]
        ratio = " ".join(f"{mine:.3f}" for mine in means[0] / np.maximum(means[1], 1e-30))
        file = self.ratios / f"{safe(f'{scene.spec.name}.{target}.{method.label}')}.ratio.png"
        write_ratio(own.image, known.image, file)
        self._note(
            f"{method.label}: {scene.spec.name}/{target}: the model differs ({'; '.join(differences)}): scored "
            f"against its own reference, whose mean over that of dermis' is {ratio} (RGB; ratio image {file.name}, "
            "black 0, grey 1, white 2)"
        )

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


@cache
def source() -> str:
    """Of what is told to peers, and how: a hash, for a picture may change with it."""
    files = sorted(Path(client.__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:24]


def write_ratio(own: np.ndarray, known: np.ndarray, file: Path) -> None:
    from PIL import Image

    # A thousandth of the mean: where both are black there is nothing to compare, and that is grey.
    floor = 1e-3 * max(float(known.mean()), 1e-30)
    ratio = np.clip((own + floor) / (np.maximum(known, 0.0) + floor) / 2.0, 0.0, 1.0)
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as temporary:
        Image.fromarray((255.0 * ratio + 0.5).astype(np.uint8)).save(temporary, format="PNG")


def statistics(method: Method, picture: Picture, samples: int) -> dict[str, Any]:
    """Those of dermis' names that mean something for another renderer; walks it does not count."""
    return {
        "settings": {"peer": method.peer, "samples": samples},
        "samples_per_pixel": samples,
        **dict.fromkeys(("walks", "walk_steps", "walks_leaked", "walks_too_long", "paths_trapped"), 0),
        "non_finite_samples": int((~np.isfinite(picture.image)).any(axis=-1).sum()),
        "seconds": {"train": 0.0, "render": picture.wall},
        "guide": {"training_share": 0.0},
        "warnings": [],
    }
