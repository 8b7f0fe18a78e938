"""Stages from strings, and what the repository and its neighbours hold."""

from collections.abc import Callable
from pathlib import Path

import pytest
from bench_runs import stage  # noqa: F401  (a fixture, as the next)
from browser import browser  # noqa: F401
from pxr import Sdf, Usd

from dermis.stage import FlatStage, Options, flatten

REPOSITORY = Path(__file__).resolve().parents[2]
USD_SCENES = REPOSITORY / "usd_scenes"
SHARED_SCENES = REPOSITORY.parent / "shared" / "scenes"


def stage_of(body: str, metadata: str = "") -> Usd.Stage:
    """A stage from USD's text format without the header line."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(f"#usda 1.0\n(\n{metadata}\n)\n{body}")
    return Usd.Stage.Open(layer)


@pytest.fixture
def make_stage() -> Callable[..., Usd.Stage]:
    return stage_of


@pytest.fixture
def flat() -> Callable[..., FlatStage]:
    """flat(body, time=None, metadata="", **options) -> FlatStage"""

    def flat_of(body: str, time: float | None = None, metadata: str = "", **options: object) -> FlatStage:
        return flatten(stage_of(body, metadata), time, Options(**options))

    return flat_of


@pytest.fixture
def usd_scenes() -> Path:
    return USD_SCENES


@pytest.fixture
def shared_scenes() -> Path:
    if not SHARED_SCENES.is_dir():
        pytest.skip("../shared/scenes is not there")
    return SHARED_SCENES
