"""The rows as a line, a table for programs and a page for eyes."""

import csv
import io
from collections.abc import Iterable
from html import escape
from itertools import groupby
from pathlib import Path

from dermis import costs

from .row import RESOLUTION, Z_LIMIT, Row

COLUMNS = (
    "family",
    "stressed",
    "walk",
    "source",
    "expected",
    "measured",
    "error",
    "tolerance",
    "deviation",
    "z",
    "resolved",
    "non_finite",
    "verdict",
    "note",
    "seconds",
)


def line(row: Row) -> str:
    numbers = f"expected {row.expected:.6g} measured {row.measured:.6g} +- {row.error:.2g}"
    tail = f"z {row.z:+.1f} sees {row.resolved:.1e} {row.seconds:.1f} s"
    note = f" ({row.note})" if row.note else ""
    return f"{row.verdict:12} {row.family}: {row.stressed} [{row.walk}] {numbers} {tail}{note}"


def write(rows: list[Row], seconds: float, folder: Path) -> None:
    """stability.csv and stability.html, each under a temporary name first."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (("stability.csv", table(rows)), ("stability.html", page(rows, seconds))):
        temporary = folder / f".{name}.tmp"
        temporary.write_text(text)
        temporary.replace(folder / name)


def table(rows: list[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        values = [getattr(row, name) for name in COLUMNS]
        writer.writerow([f"{v:.9g}" if isinstance(v, float) else v for v in values])
    return text.getvalue()


STYLE = """
body { font: 13px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem; color: #1c1c1c; }
h1 { font-size: 20px; margin: 0 0 .3rem } h2 { font-size: 15px; margin: 1.6rem 0 .4rem }
p { margin: .3rem 0; max-width: 75em } table { border-collapse: collapse; width: 100% }
th { text-align: left; font-weight: 600; border-bottom: 1px solid #888 }
th, td { padding: .18rem .6rem .18rem 0; vertical-align: top } tr + tr td { border-top: 1px solid #e6e6e6 }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
td.z { white-space: nowrap } td.s { color: #666; max-width: 22em } td.t { max-width: 26em }
.holds { color: #1a6b2d } .known { color: #8a5a00; font-weight: 600 } .fails { color: #b00020; font-weight: 700 }
svg { vertical-align: middle }
"""

ABOUT = f"""
White furnace: a closed body that absorbs nothing vanishes in uniform light of radiance 1. A row holds if the measured
mean is the expected one within {Z_LIMIT} standard errors (and the tolerance of its source), no sample and no pixel of
any AOV was not a number, and the row would have flagged a deviation of {RESOLUTION:.0%}; "sees" is the smallest that it
would have, a few rows allow more. A known limit is one of the README, and has the size that is written there.
"""


def page(rows: list[Row], seconds: float) -> str:
    words = {name: sum(kind(row) == name for row in rows) for name in ("holds", "known", "fails")}
    bad = sum(row.non_finite for row in rows)
    summary = (
        f"{len(rows)} rows in {seconds:.0f} s: {words['holds']} hold, {words['known']} are known limits, "
        f"{words['fails']} fail. Values that are not finite: {bad}."
    )
    worst = max((abs(row.z) for row in rows if kind(row) == "holds"), default=0.0)
    summary += f" Largest |z| of those that hold: {worst:.1f}."
    attention = [row for row in rows if kind(row) != "holds"]
    parts = [f"<h1>Stability</h1><p>{summary}</p><p>{ABOUT}</p>"]
    if attention:
        parts += ["<h2>What does not hold</h2>", table_of(attention, family=True)]
    for family, of in groupby(rows, key=lambda row: row.family):
        parts += [f"<h2>{escape(family)}</h2>", table_of(of)]
    parts.append(costs.section())
    head = f'<meta charset="utf-8"><title>dermis: stability</title><style>{STYLE}</style>'
    return f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'


def kind(row: Row) -> str:
    return row.verdict.split()[0].rstrip(":")


HEAD = (
    ("", "verdict"),
    ("", "what is stressed"),
    ("", "walk"),
    ("n", "expected"),
    ("n", "measured"),
    ("n", "&plusmn;"),
    ("n", "deviation"),
    ("", "z"),
    ("n", "sees"),
    ("n", "not finite"),
    ("", "where the expected value is from"),
    ("", "note"),
)


def table_of(rows: Iterable[Row], family: bool = False) -> str:
    head = "".join(f'<th class="{css}">{name}</th>' for css, name in HEAD)
    return f"<table><tr>{head}</tr>{''.join(line_of(row, family) for row in rows)}</table>"


def line_of(row: Row, family: bool) -> str:
    known = row.limit.words if row.limit else ""
    cells = (
        (kind(row), escape(row.verdict)),
        ("t", escape(f"{row.family}: {row.stressed}" if family else row.stressed)),
        ("", escape(row.walk)),
        ("n", f"{row.expected:.5g}"),
        ("n", f"{row.measured:.5g}"),
        ("n", f"{row.error:.1g}" if row.error else "exact"),
        ("n", percent(row, row.deviation, "+")),
        ("z", z_mark(row)),
        ("n", "" if row.limit else percent(row, row.resolved)),
        ("n", str(row.non_finite) if row.non_finite else "0"),
        ("s", escape(row.source)),
        ("s", escape("; ".join(word for word in (known, row.note) if word))),
    )
    return "<tr>" + "".join(f'<td class="{css}">{text}</td>' for css, text in cells) + "</tr>"


def percent(row: Row, deviation: float, sign: str = "") -> str:
    """Relative deviations in percent; absolute ones where nothing is expected."""
    return f"{100 * deviation:{sign}.2g} %" if row.expected else f"{deviation:{sign}.1g}"


def z_mark(row: Row) -> str:
    """The z-score as a dot between the limits, the number beside it."""
    at = 40 + 36 * max(-1.0, min(1.0, row.z / Z_LIMIT))
    color = {"holds": "#1a6b2d", "known": "#8a5a00", "fails": "#b00020"}[kind(row)]
    dot = '<line x1="4" y1="6" x2="76" y2="6" stroke="#bbb"/><line x1="40" y1="2" x2="40" y2="10" stroke="#bbb"/>'
    return f'<svg width="80" height="12">{dot}<circle cx="{at:.1f}" cy="6" r="3" fill="{color}"/></svg> {row.z:+.1f}'
