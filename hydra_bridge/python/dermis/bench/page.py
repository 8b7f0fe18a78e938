"""report.html: one page that needs nothing else, to look at pictures side by side, and to print."""

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .. import costs
from ..color import DisplayTransform, quantize
from . import plots, table
from .measures import Array, Mask, bias_threshold, picked
from .results import Cell, CellKey, CropSlopes, Row
from .suite import Suite, Work
from .table import Table

#: Grey of pixels that are not measured, a colour that no error has.
UNMEASURED = np.uint8(90)

TEMPLATE = Path(__file__).with_name("page.html")


@dataclass(frozen=True)
class Facts:
    """Lines of text above and below the numbers."""

    heading: str
    warnings: Sequence[str]
    notes: Sequence[str]
    legend: Sequence[str]
    machine: str


def page(
    cells: dict[CellKey, Cell],
    rows: Sequence[Row],
    slopes: CropSlopes,
    suite: Suite,
    transform: DisplayTransform,
    facts: Facts,
) -> str:
    """The whole page."""
    sheet = Sheet(cells, rows, suite, transform)
    parts = {
        "HEADING": escape(facts.heading),
        "WARNINGS": items(facts.warnings),
        "NOTES": items(facts.notes),
        "METHODS": html_table(methods_table(suite), suite),
        "EFFICIENCY": efficiency(rows, suite, suite.works[-1:]),
        "LESS": less_work(rows, suite),
        "SHEET": sheet.html(),
        "CROPS": crop_sections(rows, slopes, suite),
        "COSTS": costs.section(),
        "REFERENCES": html_table(table.references(rows), suite),
        "LEGEND": items(facts.legend),
        "MACHINE": escape(facts.machine),
        "COLORS": ", ".join(plots.color_stops()),
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part).replace(f"/*{name}*/", part)
    return text


def items(lines: Iterable[str]) -> str:
    return "".join(f"<li>{escape(line)}</li>" for line in lines)


def efficiency(rows: Sequence[Row], suite: Suite, works: Sequence[Work]) -> str:
    tables = (found for work in works for found in table.efficiency_tables(rows, suite, work))
    return "".join(html_table(found, suite) for found in tables)


def less_work(rows: Sequence[Row], suite: Suite) -> str:
    """What is no headline."""
    tables = efficiency(rows, suite, suite.works[-2::-1])
    return f'<h2>Efficiency at less work</h2><div class="scroll tables">{tables}</div>' if tables else ""


def breakable(text: str) -> str:
    """Escaped; a method may go on in the next line before each of its settings."""
    return escape(text).replace(":", "<wbr>:")


def methods_table(suite: Suite) -> Table:
    lines = [
        [method.label, ", ".join(f"{name}={value}" for name, value in method.settings.items())]
        for method in suite.methods
    ]
    return Table("Methods", ("method", "settings"), lines)


def html_table(found: Table, suite: Suite) -> str:
    """Words to the left, numbers to the right; a dot in the colour of its curve before a method."""
    labels = [method.label for method in suite.methods]

    def cell(tag: str, column: str, text: str) -> str:
        kind = "word" if column in (*table.WORDS, "settings") else "bad" if text.endswith(" !") else "number"
        known = text in labels and (column == "method" or tag == "th")
        dot = f'<i style="background:{plots.method_color(suite, text)}"></i>' if known else ""
        return f'<{tag} class="{kind}">{dot}{breakable(text)}</{tag}>'

    head = "".join(cell("th", column, column) for column in found.columns)
    body = "".join(
        f"<tr>{''.join(cell('td', *pair) for pair in zip(found.columns, line, strict=True))}</tr>"
        for line in found.lines
    )
    caption = f"<caption>{escape(found.title)}</caption>"
    return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def crop_sections(rows: Sequence[Row], slopes: CropSlopes, suite: Suite) -> str:
    """Curves and tables of each crop."""
    threshold, parts = bias_threshold(3 * len(rows)), []
    for scene, crop in dict.fromkeys((row.scene, row.crop) for row in rows):
        here = [row for row in rows if (row.scene, row.crop) == (scene, crop)]
        tables = "".join(html_table(found, suite) for found in table.crop_tables(here, slopes, threshold))
        drawn = plots.svg(plots.curves(here, suite))
        parts.append(f'<section class="crop"><h3>{escape(f"{scene}/{crop}")}</h3>{drawn}{tables}</section>')
    return "".join(parts)


class Sheet:
    """The contact sheet: a row per crop with the reference and each method, its error map beneath; of the most work
    that the crop has. The page's viewer takes its pictures from here."""

    def __init__(
        self,
        cells: dict[CellKey, Cell],
        rows: Sequence[Row],
        suite: Suite,
        transform: DisplayTransform,
    ) -> None:
        self.cells, self.rows, self.suite, self.transform = cells, rows, suite, transform

    def html(self) -> str:
        return "".join(self.line(*place) for place in dict.fromkeys((r.scene, r.crop) for r in self.rows))

    def line(self, scene: str, crop: str) -> str:
        here = [row for row in self.rows if (row.scene, row.crop) == (scene, crop)]
        work = max((row.work for row in here), key=lambda work: work.amount)
        shown = [
            (row, self.cells[CellKey(scene, crop, row.method, work)]) for row in here if row.work == work
        ]
        scale = plots.color_scale([picked(cell.error_map, cell.mask) for _, cell in shown])
        first = shown[0][1]
        own = None if first.own_map is None else measured_only(first.own_map, first.mask, scale)
        known = "its own noise" if own is not None else "its own noise is not known"
        pictures = [self.picture("reference", known, self.displayed(first, first.reference), own)]
        for row, cell in shown:
            ratio = f", ratio {table.ratio_text(row.ratio.mean)}" if row.ratio else ""
            words = f"relMSE {row.relmse.mean:.2e}{ratio}"
            image = self.displayed(cell, cell.image)
            pictures.append(
                self.picture(row.method, words, image, measured_only(cell.error_map, cell.mask, scale))
            )
        height, width, _ = first.image.shape
        name, bounds = escape(f"{scene}/{crop}"), f"{scale.vmin:.2g} {scale.vmax:.2g}"
        data = f'data-name="{name}" data-size="{width} {height}" data-range="{bounds}"'
        title = f"{name}, {work.label}"
        return (
            f'<div class="line" {data}><h4>{title}</h4><div class="pictures">{"".join(pictures)}</div></div>'
        )

    def displayed(self, cell: Cell, image: NDArray[np.float64]) -> NDArray[np.uint8]:
        return quantize(cell.shown(image, self.transform))

    def picture(self, label: str, words: str, image: NDArray[Any], errors: NDArray[Any] | None) -> str:
        name = escape(label)
        errors_html = (
            "" if errors is None else f'<img class="map" alt="error map of {name}" src="{data_uri(errors)}">'
        )
        return (
            f'<figure data-label="{name}"><img class="picture" alt="{name}" src="{data_uri(image)}">{errors_html}'
            f"<figcaption><b>{breakable(label)}</b> {escape(words)}</figcaption></figure>"
        )


def measured_only(errors: Array, mask: Mask, scale: Any) -> NDArray[np.uint8]:
    """The error map in false colour; grey where nothing is measured."""
    colors = plots.false_color(errors, scale)
    return colors if mask is None else np.where(mask[..., None], colors, UNMEASURED)


def data_uri(pixels: NDArray[np.uint8]) -> str:
    """A PNG within the page."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
