"""Portals of domes: they guide samples and cut off no light; what they are made from, and edits of them."""

from pathlib import Path

import numpy as np
import pytest
from command_line import run
from conftest import stage_of
from pxr import Gf, Usd, UsdGeom

import dermis
from dermis.hydra import Delegate, DirtyBits, edits, populate
from dermis.stage import FlatStage, flatten

ROOM = Path(__file__).parents[2] / "usd_scenes" / "portal.usda"
SETTINGS = {"resolution": (24, 12), "camera": "/World/main_cam"}

DOME = """
def DomeLight "Sky"
{
    rel portals = [</Frame/A>, </Frame/B>]
}
def Xform "Frame"
{
    double3 xformOp:translate = (0, 5, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def PortalLight "A"
    {
        float inputs:width = 2
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def PortalLight "B"
    {
        float inputs:height = 3
        token visibility = "invisible"
    }
}
"""


def room() -> Usd.Stage:
    """Whose edits are its own."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().subLayerPaths.append(str(ROOM))
    return stage


def without_portal() -> Usd.Stage:
    stage = room()
    stage.GetPrimAtPath("/World/Sky").GetRelationship("portals").SetTargets([])
    return stage


def moved(translate: tuple, rotate: tuple = (0, 90, 0)) -> Usd.Stage:
    stage = room()
    window = stage.GetPrimAtPath("/World/Window")
    window.GetAttribute("xformOp:translate").Set(Gf.Vec3d(*translate))
    window.GetAttribute("xformOp:rotateXYZ").Set(Gf.Vec3f(*rotate))
    return stage


def rendered(stage: Usd.Stage, **settings: object) -> np.ndarray:
    return dermis.render(stage, **{**SETTINGS, "samples": 16, **settings}).color[..., :3].astype(float)


def runs(stage: Usd.Stage) -> np.ndarray:
    return np.array([rendered(stage, seed=seed, samples=128) for seed in range(20)])


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return runs(without_portal())


def assert_same_light(a: np.ndarray, b: np.ndarray) -> None:
    """Of images by seed: the means of whole images."""
    of_runs = [x.mean(axis=(1, 2, 3)) for x in (a, b)]
    error = np.sqrt(sum(x.var(ddof=1) / len(x) for x in of_runs))
    assert error < 0.01 * of_runs[0].mean()
    assert abs(of_runs[0].mean() - of_runs[1].mean()) < 3.5 * error


def noise(images: np.ndarray) -> float:
    """Variance of a pixel, the mean over pixels."""
    return float(images.var(axis=0, ddof=1).mean())


def test_a_room_lit_through_a_window_is_as_bright_and_less_noisy(plain):
    guided = runs(room())
    assert_same_light(plain, guided)
    assert noise(guided) < 0.4 * noise(plain)


@pytest.mark.parametrize("translate", [(2.5, 1.2, 0.5), (6.0, 3.0, -0.5)])
def test_a_portal_in_a_wrong_place_changes_no_light(plain, translate):
    """Half in the room, off outside: light comes in beside it."""
    assert_same_light(plain, runs(moved(translate)))


def test_a_portal_that_is_turned_away_guides_nothing():
    away = rendered(moved((3.2, 1.6, -0.5), (0, -90, 0)))
    assert np.array_equal(away, rendered(without_portal()))
    assert not np.array_equal(away, rendered(room()))


def test_portals_are_flattened_where_they_stand():
    flat = flatten(stage_of(DOME))
    transform = np.identity(4)
    transform[3, :3] = (1, 5, 0)
    portal = {"path": "/Frame/A", "transform": transform.tolist(), "width": 2.0, "height": 1.0}
    assert flat.prims["/Sky"]["portals"] == [portal] and flat.warnings == []
    assert "portals" not in flatten(stage_of(DOME.replace("</Frame/A>, ", ""))).prims["/Sky"]


@pytest.mark.parametrize("target", ["</Frame>", "</Gone>", "</Sky>"])
def test_targets_that_are_no_portals_are_said(target):
    flat = flatten(stage_of(DOME.replace("</Frame/A>", target)))
    assert flat.warnings == [
        ("/Sky", f"portals: {target[1:-1]} is no PortalLight of the stage; the dome is sampled without it")
    ]
    assert "portals" not in flat.prims["/Sky"]


def test_damaged_portals_name_themselves():
    stage = room()
    stage.GetPrimAtPath("/World/Window").GetAttribute("inputs:width").Set(0.0)
    image = dermis.render(stage, **SETTINGS, samples=16)
    assert [w["prim"] for w in image.stats["warnings"]] == ["/World/Window"]
    assert np.array_equal(image.color[..., :3], rendered(without_portal()))


def image_of(delegate: Delegate) -> np.ndarray:
    delegate.set_settings(**SETTINGS, samples=16, aovs=[])
    delegate.commit()
    delegate.start()
    while not delegate.wait(5.0):
        pass
    return delegate.snapshot()["color"][..., :3]


def started(flat: FlatStage) -> Delegate:
    delegate = Delegate()
    populate(delegate.core, flat)
    return delegate


def test_a_moved_portal_is_an_edit_of_its_dome():
    stage = room()
    before = flatten(stage)
    flattened, single = started(before), started(before)
    first = image_of(flattened)
    window = stage.GetPrimAtPath("/World/Window")
    UsdGeom.XformCommonAPI(window).SetTranslate(Gf.Vec3d(3.0, 1.6, 0.2))
    after = flatten(stage)
    assert edits(after, before) == {"/World/Sky": DirtyBits.PARAMS}
    populate(flattened.core, after, before)
    single.sync("/World/Window", window, DirtyBits.TRANSFORM)
    fresh = image_of(started(after))
    assert not np.array_equal(first, fresh)
    assert np.array_equal(image_of(flattened), fresh) and np.array_equal(image_of(single), fresh)


def test_the_file_keeps_portals(tmp_path):
    file = tmp_path / "room.dermis"
    assert run("flatten", ROOM, file) == 0
    image = dermis.render(file, **SETTINGS, samples=16)
    assert image.stats["needs"]["guided_domes"] == 1
    assert np.array_equal(image.color[..., :3], rendered(room()))
