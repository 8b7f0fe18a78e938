"""What is not in use costs nothing, and the table that says so: tiny stages, counted where valgrind is installed."""

import json
from pathlib import Path

import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from needs import driver
from needs.__main__ import main as needs
from needs.capabilities import CAPABILITIES, PLAIN, Capability
from needs.measure import Bench

from dermis import costs
from dermis.cli import main

CHEAP = (
    "subsurface walk",
    "dielectric boundaries",
    "Beer-Lambert interiors",
    "light at collisions",
    "transparent shadows",
    "instancing",
    "environment sampling",
    "textures",
    "depth of field",
    "AOVs",
)
"""Their stages are opaque: seconds under valgrind."""


@pytest.fixture(scope="module")
def driven() -> None:
    if not driver.DRIVER.is_file():
        pytest.skip("no driver: cargo build --release --example phases, or cargo test --release, builds it")


@pytest.fixture(scope="module")
def bench(driven) -> Bench:
    if driver.counter() is None:
        pytest.skip("valgrind is not installed: apt install valgrind")
    return Bench(counting=True, repeats=0)


def row(name: str) -> Capability:
    return next(capability for capability in CAPABILITIES if capability.name == name)


@pytest.mark.parametrize("name", CHEAP)
def test_what_is_not_in_use_costs_nothing(bench, name):
    assert costs.faults(name, bench.compare(row(name).unused)) == []


def test_what_is_in_use_is_found_out(bench):
    """The judge of the test above says no: a lens, or planes for AOVs, passed off as not in use."""
    lens = costs.faults("lens", bench.compare(row("depth of field").used))
    assert len(lens) == 2
    assert lens[0].endswith("times the instructions per sample") and lens[1].endswith("another image")
    planes = costs.faults("planes", bench.compare(row("AOVs").used))
    assert any("render bytes more" in line for line in planes)
    assert not any("another image" in line for line in planes)


def test_counts_are_repeatable(bench, tmp_path):
    file = driver.flatten(PLAIN, tmp_path)
    once, again = (driver.count(file, (1, 2)) for _ in range(2))
    # What the loader and the clock do differs a little from run to run.
    assert once == pytest.approx(again, rel=1e-4)
    assert min(once) > 1000


def test_the_table_is_made_without_valgrind(driven, tmp_path, capsys):
    file = tmp_path / "costs.json"
    assert needs(["--out", str(file), "--only", "depth", "--repeats", "1", "--uncounted"]) == 0
    said = capsys.readouterr()
    assert "instructions are not counted" in said.err and "| depth of field " in said.out
    table = json.loads(file.read_text())
    assert table["made"]["counter"] is None and table["made"]["processor"] and table["made"]["date"]
    (found,) = table["rows"]
    assert found["used"]["instructions"] is None and found["used"]["time"] > 0.5
    assert found["unused"]["same_image"] and not found["used"]["same_image"]


COMPARED = {
    "what": "fStop 2.8",
    "against": "a pinhole",
    "instructions": 1.25,
    "sample_instructions": 5000.0,
    "once_instructions": 3e6,
    "compile_instructions": 0,
    "time": 1.5,
    "scene_bytes": 0,
    "render_bytes": 123_456,
    "same_image": False,
}
UNUSED = {
    **COMPARED,
    "what": "fStop 0",
    "instructions": 1.0,
    "time": 1.01,
    "render_bytes": 0,
    "same_image": True,
}
TABLE = {
    "made": {"date": "2026-01-02T03:04:05+00:00", "commit": "abc1234", "dermis": "0.1.0", "processor": "A <chip>",
             "counter": "valgrind-3.19.0, callgrind"},
    "rows": [{"capability": "depth of field", "unused": UNUSED, "used": COMPARED}],
}  # fmt: skip


@pytest.fixture
def known(monkeypatch, tmp_path) -> Path:
    """A table of one row in place of the one that is kept."""
    monkeypatch.setattr(costs, "FILE", tmp_path / "costs.json")
    costs.FILE.write_text(json.dumps(TABLE))
    return costs.FILE


def explained(stage, capsys) -> list[str]:
    assert main(["explain", str(stage)]) == 0
    return capsys.readouterr().out.splitlines()


def test_explain_shows_what_each_capability_costs(known, tmp_path, capsys):
    stage = tmp_path / "plain.usda"
    stage.write_text(PLAIN.text())
    said = explained(stage, capsys)
    used = "in use x 1.25 instructions, x 1.50 time, +123 kB while rendering"
    assert f"  off depth of field  {used}  declared only 0.00 %, 0 B" in said
    assert any("abc1234, A <chip>" in line for line in said)
    missing = next(line for line in said if line.startswith("  not measured: "))
    assert "spectral MIS" in missing and "depth of field" not in missing
    # And why it is off.
    off = said[said.index("off:") :]
    assert "  depth of field: fStop or focusDistance of the camera is 0, or it is switched off" in off


def test_explain_says_where_there_is_no_table(known, tmp_path, capsys):
    known.unlink()
    stage = tmp_path / "plain.usda"
    stage.write_text(PLAIN.text())
    assert "costs: not measured for this build; `make needs` does" in explained(stage, capsys)


@pytest.mark.parametrize("capability", CAPABILITIES, ids=[capability.name for capability in CAPABILITIES])
def test_explain_calls_on_what_is_in_use_and_nothing_else(capability, tmp_path):
    """By the name of the row: one that nobody could look up is a mistake."""
    from dermis._core import Delegate

    for stage, on in ((capability.used.having, True), (capability.unused.having, False)):
        delegate = Delegate.load(str(driver.flatten(stage, tmp_path)))
        delegate.commit()
        lines = json.loads(delegate.explain())["capabilities"]
        assert [line["on"] for line in lines if line["capability"] == capability.name] == [on]


def test_images_of_invisible_lights_are_not_read(tmp_path):
    textures = next(capability for capability in CAPABILITIES if capability.name == "textures")
    sizes = [driver.flatten(stage, tmp_path).stat().st_size for stage in (textures.unused.having, PLAIN)]
    assert sizes[0] - sizes[1] < 2048, "64 x 32 pixels are 24 kB"


def test_reports_have_the_table(known):
    from stability.report import page

    for text in (costs.section(), page([], 0.0)):
        assert '<td class="word">depth of field</td>' in text
        assert "A &lt;chip&gt;" in text and "x 1.25" in text
    known.unlink()
    assert "depth of field" not in page([], 0.0)


def test_the_table_that_is_kept_is_whole():
    """That of `make needs` in the checkout: made by the command, of all rows, and free where nothing is in use."""
    found = costs.load()
    assert found is not None, "make needs"
    assert [row["capability"] for row in found.rows] == [capability.name for capability in CAPABILITIES]
    assert found.not_free() == []
