"""The contact sheet: a column per method, a row per crop, each picture above its error."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..color import DisplayTransform, display_pixels
from .plots import COLORS, color_scale, new_figure, save
from .results import Cell, CellKey, Row
from .suite import Suite
from .table import ratio_text

#: Inches per picture.
SIDE = 1.9


class FigureError(Exception):
    """Rows that do not exist; the text lists those that do."""


def figure_rows(suite: Suite, names: Sequence[str] | None) -> list[str]:
    """SCENE/CROP of the rows asked for, all without. Raises FigureError."""
    known = [
        f"{scene.name}/{crop}"
        for scene in suite.scenes
        for crop in ([crop.name for crop in scene.crops] or ["frame"])
    ]
    for name in names or []:
        if name not in known:
            raise FigureError(f"--figureRows {name}: the crops are {', '.join(known)}")
    return list(names or known)


def write_contact_sheet(
    cells: dict[CellKey, Cell], rows: Sequence[Row], suite: Suite, places: Sequence[str], file: Path
) -> None:
    """Images of the first seed through the display transform, above the mean error map, relMSE and ratios beneath.

    Of the most work; one scale of false colour for each crop.
    """
    chosen = [row for row in rows if row.work == suite.works[-1] and place(row) in places]
    if not chosen:
        return
    shown = {name: [row for row in chosen if place(row) == name] for name in places}
    shown = {name: line for name, line in shown.items() if line}
    labels = [method.label for method in suite.methods]
    measured = {name: [cells[key_of(row)] for row in line] for name, line in shown.items()}
    figure, axes = empty_sheet({name: line[0].error_map.shape for name, line in measured.items()}, labels)
    transform, stops = DisplayTransform(), {scene.name: scene.exposure for scene in suite.scenes}
    for number, (name, line) in enumerate(shown.items()):
        norm = color_scale([cell.error_map for cell in measured[name]])
        for row, cell in zip(line, measured[name], strict=True):
            upper, lower = axes[2 * number : 2 * number + 2, labels.index(row.method)]
            pixels = display_pixels(cell.image * 2.0 ** stops[row.scene], transform, alpha=False)
            upper.imshow(pixels, interpolation="nearest")
            drawn = lower.imshow(cell.error_map, norm=norm, cmap=COLORS, interpolation="nearest")
            lower.set_xlabel(caption(row), fontsize=7)
        bar = figure.colorbar(
            drawn, ax=axes[2 * number : 2 * number + 2, :], extend="both", aspect=28, pad=0.01
        )
        bar.set_label("relative squared error", fontsize=6)
        bar.ax.tick_params(labelsize=6)
    save(figure, file, dpi=150)


def key_of(row: Row) -> CellKey:
    return CellKey(row.scene, row.crop, row.method, row.work)


def place(row: Row) -> str:
    return f"{row.scene}/{row.crop}"


def empty_sheet(shapes: Mapping[str, tuple[int, int]], labels: Sequence[str]) -> tuple[Any, Any]:
    """The figure and its axes: two rows per place, as high as its pictures are."""
    heights = [SIDE * height / width for height, width in shapes.values() for _ in range(2)]
    figure = new_figure(SIDE * len(labels) + 1.3, sum(heights) + 0.25 * len(shapes) + 0.4)
    axes = figure.subplots(len(heights), len(labels), squeeze=False, height_ratios=heights)
    figure.get_layout_engine().set(h_pad=0.02, hspace=0.0, w_pad=0.02, wspace=0.0)
    for panel in axes.ravel():
        panel.set_xticks([])
        panel.set_yticks([])
        panel.set_frame_on(False)
    for label, panel in zip(labels, axes[0], strict=True):
        panel.set_title(label.replace(":", "\n"), fontsize=8)
    for name, panel in zip(shapes, axes[::2, 0], strict=True):
        panel.set_ylabel(name.replace("/", "\n"), fontsize=8)
    return figure, axes


def caption(row: Row) -> str:
    ratios = [ratio_text(ratio.mean) for ratio in (row.ratio, row.ratio_trimmed) if ratio is not None]
    return f"{row.relmse.mean:.2e}" + (f"  ×{' / '.join(ratios)}" if ratios else "")
