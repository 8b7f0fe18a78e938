"""What capabilities cost, in use and declared but not in use: the table that `make needs` measures."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("costs.json")
"""Written by `make needs`, never by hand."""

FREE = 1e-3
"""Share of the instructions per sample that what is not in use may add: below what a clock can tell."""

FREE_BYTES = 8192
"""What the description of a prim may take: its names and numbers are kept, whatever they are for."""

NAMES = 64
"""Bytes that are not shown: names of files and prims differ by as many, whatever is measured."""

COLUMNS = (
    "capability",
    "declared, not in use",
    "instructions",
    "bytes",
    "in use",
    "instructions",
    "time",
    "once",
    "scene",
    "render",
)

WORDS = ("capability", "declared, not in use", "in use")

LEGEND = (
    "Minimal stages: a ball over a floor, a lamp, 16 x 16 pixels. instructions and time: per sample, over those of the "
    "same stage without the capability (in brackets); once: million instructions more per render, for training and "
    "film; scene, render: bytes of heap more, of the compiled scene with its description and at the height of a "
    "render. Instructions repeat to a few millionths, times are CPU time on a machine that may have been busy."
)


@dataclass(frozen=True)
class Costs:
    """The table with what it says of itself."""

    table: dict[str, Any]

    @property
    def rows(self) -> list[dict[str, Any]]:
        return self.table["rows"]

    def made(self) -> str:
        """When, of what, on what."""
        made = self.table["made"]
        counter = made["counter"] or "instructions not counted"
        return (
            f"{made['date'][:10]}, dermis {made['commit'] or made['dermis']}, {made['processor']}, {counter}; "
            "`make needs`"
        )

    def row(self, capability: str) -> dict[str, Any] | None:
        return next((row for row in self.rows if row["capability"] == capability), None)

    def lines(self) -> list[list[str]]:
        """Cells of the table, one per COLUMNS."""
        return [line(row) for row in self.rows]

    def not_free(self) -> list[str]:
        """What costs more than nothing though it is not in use, in words."""
        return [said for row in self.rows for said in faults(row["capability"], row["unused"])]

    def html(self) -> str:
        """A table for the reports, which both leave words and numbers to these classes."""
        kinds = ["word" if name in WORDS else "n" for name in COLUMNS]

        def cells(tag: str, texts: Sequence[str]) -> str:
            return "".join(
                f'<{tag} class="{kind}">{escape(text)}</{tag}>'
                for kind, text in zip(kinds, texts, strict=True)
            )

        body = "".join(f"<tr>{cells('td', line)}</tr>" for line in self.lines())
        return f"<table><tr>{cells('th', COLUMNS)}</tr>{body}</table>"

    def markdown(self) -> str:
        from .bench.table import Table, markdown

        return f"{markdown(Table('', COLUMNS, self.lines(), WORDS))}\n\n{LEGEND}\n\n{self.made()}"


def in_use(used: dict[str, Any]) -> str:
    """What use adds, in words."""
    ratios = (times(used["instructions"], "instructions"), times(used["time"], "time"))
    memory = (used["scene_bytes"], "in the scene"), (used["render_bytes"], "while rendering")
    said = [ratio for ratio in ratios if ratio] + [
        f"{more(count)} {where}" for count, where in memory if abs(count) >= NAMES
    ]
    return ", ".join(said)


def declared(unused: dict[str, Any]) -> str:
    """What a declaration without use adds, in words."""
    return ", ".join(
        part
        for part in (change(unused["instructions"]), more(unused["scene_bytes"] + unused["render_bytes"]))
        if part
    )


def faults(capability: str, unused: dict[str, Any]) -> list[str]:
    found = []
    ratio = unused["instructions"]
    if ratio is not None and ratio - 1.0 > FREE:
        found.append(f"{capability}: {unused['what']}: {ratio:.4f} times the instructions per sample")
    for name in ("scene_bytes", "render_bytes"):
        if unused[name] > FREE_BYTES:
            found.append(f"{capability}: {unused['what']}: {unused[name]} {name.replace('_', ' ')} more")
    if not unused["same_image"]:
        found.append(f"{capability}: {unused['what']}: another image")
    return found


def line(row: dict[str, Any]) -> list[str]:
    unused, used = row["unused"], row["used"]
    once = used["once_instructions"]
    return [
        row["capability"],
        described(unused),
        change(unused["instructions"]) or "-",
        more(unused["scene_bytes"] + unused["render_bytes"]),
        described(used),
        times(used["instructions"]) or "-",
        times(used["time"]) or "-",
        "-" if once is None else f"{once / 1e6:+.1f}",
        more(used["scene_bytes"]),
        more(used["render_bytes"]),
    ]


def described(compared: dict[str, Any]) -> str:
    return f"{compared['what']} ({compared['against']})"


def times(ratio: float | None, of: str = "") -> str:
    return "" if ratio is None else f"x {ratio:.2f} {of}".strip()


def change(ratio: float | None) -> str:
    """In percent, to where counts repeat."""
    if ratio is None:
        return ""
    percent = round(100 * (ratio - 1), 2)
    return f"{percent:+.2f} %" if percent else "0.00 %"


def more(count: int) -> str:
    """Bytes, with a sign."""
    if abs(count) < NAMES:
        return "0 B"
    if abs(count) < 1000:
        return f"{count:+d} B"
    size, unit = (count / 1e3, "kB") if abs(count) < 1e6 else (count / 1e6, "MB")
    return f"{size:+.3g} {unit}"


def load() -> Costs | None:
    """The table of this build; None where none was made."""
    try:
        return Costs(json.loads(FILE.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None


def section() -> str:
    """Of a report: the table under a heading; empty where none was made."""
    found = load()
    if found is None:
        return ""
    about = f"<p>{escape(LEGEND)}</p><p>{escape(found.made())}</p>"
    return f'<h2>What a scene needs, and what that costs</h2>{about}<div class="scroll">{found.html()}</div>'
