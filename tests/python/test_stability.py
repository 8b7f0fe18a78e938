"""The quick part of `make stability`, and that its judge can say no."""

import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from stability import caches, lights, media, meshes, space
from stability.closed_forms import half_space
from stability.media import DEEP, body
from stability.rendering import measured, render, resolving
from stability.row import Limit, Row
from stability.scenes import ABOVE, FRONT, dome, medium, sphere

QUICK = [case for family in (media, space, meshes, lights, caches) for case in family.CASES if case.quick]


@pytest.mark.parametrize("case", QUICK, ids=[case.stressed for case in QUICK])
def test_quick_rows_hold(case):
    rows = list(case.rows())
    assert rows
    for row in rows:
        assert row.holds, (
            f"{row.stressed}: {row.verdict}, {row.measured} +- {row.error} of {row.expected} {row.note}"
        )


def row(**numbers) -> Row:
    return Row("judge", "nothing", "made up", **numbers)


def test_the_judge_says_no():
    assert row(expected=1.0, measured=1.001, error=0.001).verdict == "holds"
    assert row(expected=1.0, measured=1.02, error=0.001).verdict == "fails: off"
    assert row(expected=1.0, measured=0.98, error=0.001).verdict == "fails: off"
    assert row(expected=1.0, measured=1.02, error=0.02).verdict == "fails: would overlook 9.0%"
    assert row(expected=0.0, measured=1e-30).verdict == "fails: off"
    assert row(expected=1.0, measured=float("nan")).verdict == "fails: not finite"
    assert row(expected=1.0, measured=1.0, non_finite=1).verdict == "fails: 1 values are not finite"
    known = Limit(-0.1, -0.05, "darker")
    assert row(expected=1.0, measured=0.93, limit=known).verdict == "known limit"
    assert row(expected=1.0, measured=1.0, limit=known).verdict == "fails: limit is -0.1 to -0.05"


@pytest.mark.parametrize("walk", ["auto", "classical"])
def test_deliberate_mistakes_fail(walk):
    """A light that is 2 % brighter than it should be, a medium 2 % less white."""
    bright = resolving(body(sphere(), medium(1.0, 0.1), FRONT, [dome(1.02)]), 1.0, 16, walk=walk)
    assert measured(bright, "", "", "", 1.0).verdict == "fails: off"
    grey = resolving(body(DEEP, medium(0.98 * 0.9, 1e-3), ABOVE), half_space(0.9), walk=walk)
    assert measured(grey, "", "", "", half_space(0.9)).verdict == "fails: off"


def test_too_few_samples_do_not_hold():
    noisy = render(body(DEEP, medium(0.5, 1e-3), ABOVE), 4, 1, walk="classical")
    assert measured(noisy, "", "", "", half_space(0.5)).verdict.startswith("fails")
