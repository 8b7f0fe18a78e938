"""report.html in a real browser: what it shows, what its wipe, zoom and menus do, that it asks nobody for anything."""

import base64
import re

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")
pytest.importorskip("matplotlib", reason="the report needs the extra `bench`")
pytest.importorskip("flip_evaluator", reason="the report needs the extra `bench`")

from browser import browser  # noqa: F401  (a fixture)
from test_bench import STAGE, run

PANE = "[data-kind=picture] .pane"
MAPS = "[data-kind=map]"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A page of two crops of different shape and three methods, one of them with a name that is no HTML."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "block.usda").write_text(STAGE)
    named = "classical,<b>&poe=poe,again=classical:seed=9"
    flags = (
        "--crops",
        "wide=.2,.3,.8,.6",
        "--crops",
        "tall=.3,.1,.5,.9",
        "--referenceSamples",
        "64",
        "--quiet",
    )
    amounts = ("-w", "40", "--samples", "2,8", "--seeds", "2")
    assert run(folder / "block.usda", "--methods", named, "--out", folder, *flags, *amounts) == 0
    return folder / "report.html"


@pytest.fixture
def page(browser, report):  # noqa: F811
    browser.errors.clear()
    browser.requests.clear()
    browser.open(report)
    return browser


def picture(page, label: str, crop: str, kind: str = "picture") -> str:
    """Data URI of a picture of the contact sheet."""
    lines = f'.line[data-name="block/{crop}"] figure'
    found = f"[...document.querySelectorAll('{lines}')].find((f) => f.dataset.label === '{label}')"
    return page.evaluate(f"{found}.querySelector('.{kind}').src")


def wipe(page) -> float:
    """Place of the line, as a share of the pane, as it is drawn."""
    x, _, width, _ = page.box(PANE)
    at, _, thick, _ = page.box(f"{PANE} .wipe")
    return (at + thick / 2.0 - x) / width


def drag_line(page, share: float) -> None:
    x, y, width, height = page.box(PANE)
    start = (
        x + min(max(wipe(page), 0.005), 0.995) * width
    )  # within the pane also where the line is on its edge
    page.drag((start, y + height / 2.0), (x + share * width, y + height / 2.0))


def test_nothing_is_asked_for_and_nothing_goes_wrong(page, report):
    page.choose("#crop", "block/tall")
    assert page.errors == [] and page.requests == []
    text = report.read_text()
    # By its words, too: what loads a resource names data alone.
    assert set(re.findall(r'(?:src|href)="(?!#)([^"]{0,5})', text)) == {"data:"} and "@import" not in text
    assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", text)


def test_the_watch_sees_errors_and_requests(browser, tmp_path):  # noqa: F811
    bad = tmp_path / "bad.html"
    bad.write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('so'); null.x;</script>")
    browser.open(bad)
    assert browser.requests == ["http://127.0.0.1:9/x.png"] and len(browser.errors) >= 2


def test_the_wipe_moves_and_divides_the_pictures(page):
    assert wipe(page) == pytest.approx(0.5, abs=0.01)
    page.choose("#left", "reference")
    page.choose("#right", "classical")
    seen = {}
    for share in (0.0, 1.0, 0.25):
        drag_line(page, share)
        assert wipe(page) == pytest.approx(share, abs=0.01)
        seen[share] = page.pixels(PANE)
    right, left, both = seen[0.0], seen[1.0], seen[0.25]
    height, width, _ = both.shape
    below = slice(height // 4, None)  # names are above
    near, far = slice(12, width // 4 - 12), slice(width // 4 + 12, width - 12)
    assert np.array_equal(both[below, near], left[below, near])
    assert np.array_equal(both[below, far], right[below, far])
    assert np.abs(left - right)[below, far].mean() > 2.0
    page.evaluate(f"document.querySelector('{PANE} .wipe').focus()")
    for kind in ("keyDown", "keyUp"):
        page.send(
            "Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight", windowsVirtualKeyCode=39
        )
    assert wipe(page) == pytest.approx(0.27, abs=0.01)
    assert page.errors == []


def test_crops_and_methods_are_chosen(page):
    def shown(side: str, kind: str = "picture") -> str:
        return page.evaluate(f"document.querySelector('[data-kind={kind}] .{side} img').src")

    assert shown("base") == picture(page, "classical", "wide")
    _, _, width, height = page.box(PANE)
    page.choose("#crop", "block/tall")
    assert shown("base") == picture(page, "classical", "tall")
    _, _, narrow, high = page.box(PANE)
    assert width / height == pytest.approx(24 / 12, rel=0.02) and narrow / high == pytest.approx(
        8 / 32, rel=0.02
    )
    page.choose("#right", "<b>&poe")
    assert shown("right") == picture(page, "<b>&poe", "tall")
    assert shown("right", "map") == picture(page, "<b>&poe", "tall", "map")
    assert page.evaluate(f"document.querySelector('{PANE} .b').textContent") == "<b>&poe"
    page.click('.line[data-name="block/wide"] figure[data-label=again] .picture')
    assert page.evaluate("document.querySelector('#crop').selectedOptions[0].text") == "block/wide"
    assert shown("base") == picture(page, "again", "wide")
    assert page.errors == []


def test_zoom_is_about_the_pointer_and_moves_by_dragging(page):
    def state() -> dict[str, float]:
        return page.evaluate("({...state})")

    x, y, width, height = page.box(PANE)
    page.mouse("mouseWheel", x + 0.75 * width, y + 0.5 * height, deltaX=0, deltaY=-400)
    found = state()
    assert found["zoom"] == pytest.approx(np.exp(1.0), rel=0.01)
    # What was under the pointer still is.
    assert found["x"] == pytest.approx(0.75 * (1.0 - found["zoom"]), rel=0.02)
    page.drag((x + 0.2 * width, y + 0.5 * height), (x + 0.3 * width, y + 0.5 * height))
    moved = state()
    assert moved["x"] == pytest.approx(found["x"] + 0.1, abs=0.01) and moved["wipe"] == 0.5
    # Both panes show the same place.
    placed = page.evaluate(
        "[...document.querySelectorAll('.pane img')].map((i) => getComputedStyle(i).transform.split(',')[0])"
    )
    assert len(placed) == 4 and len(set(placed)) == 1
    page.mouse("mouseWheel", x + 0.5 * width, y + 0.5 * height, deltaX=0, deltaY=4000)
    assert (state()["zoom"], state()["x"], state()["y"]) == (1, 0, 0)


def test_error_maps_are_switched(page):
    width = page.box(MAPS)[2]
    assert width > 100
    page.click("#maps")
    assert page.box(MAPS)[2] == 0
    page.click("#maps")
    assert page.box(MAPS)[2] == width


def test_the_page_prints(page):
    page.send("Emulation.setEmulatedMedia", media="print")
    try:
        assert page.box("#viewer")[3] == 0
        assert page.box(".line figure .picture")[3] > 10 and page.box(".crop svg")[3] > 100
    finally:
        page.send("Emulation.setEmulatedMedia", media="")
    printed = base64.b64decode(page.send("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert printed.startswith(b"%PDF") and len(printed) > 20_000


def test_tables_have_what_was_measured(page):
    def words(selector: str) -> list[str]:
        return page.evaluate(f"[...document.querySelectorAll('{selector}')].map((e) => e.textContent)")

    assert words("h3") == ["block/wide", "block/tall"]
    heads = words(".crop table:nth-of-type(1) th")[:8] + words(".crop table:nth-of-type(2) th")[:11]
    assert heads == ["work", "method", "relMSE", "trimmed", "MSE", "FLIP", "bias z", "slope", "work", "method", "spp",
                     "cpu s", "efficiency", "ratio", "ratio trimmed", "training", "samples/s", "peak MB",
                     "steps/walk"]  # fmt: skip
    assert len(words(".crop table:nth-of-type(1) tbody tr")) == 2 * 2 * 3
    said = " ".join(words("li"))
    for name in ("0.01 s^2", "LDR-FLIP", "largest resident set", "own relMSE", "cannot be its own reference"):
        assert name in said
