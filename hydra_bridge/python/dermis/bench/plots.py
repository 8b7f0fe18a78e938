"""Pictures of the numbers: error maps in false colour, error over time or samples."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..cli.output import replacing
from .measures import Array
from .results import Cell, CellKey, Row
from .runner import file_name
from .suite import Suite

INSTALL = (
    "the pictures are drawn by matplotlib, which is not installed: pip install matplotlib (the extra `bench` of dermis "
    "has it), or go without them: --noPlots"
)

#: Decades of false colour below the brightest.
DECADES = 3

#: Share of the pixels that may be brighter than the scale: fireflies would leave the rest black.
CLIPPED = 0.002

COLORS = "inferno"


class PlotsError(Exception):
    """matplotlib is missing; the text says how to install it."""


def require_matplotlib() -> None:
    """Raises PlotsError; called before the first render."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise PlotsError(INSTALL) from error


def new_figure(width: float, height: float) -> Any:
    """An empty figure, in inches, for files alone: it needs no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save(figure: Any, file: Path, dpi: int = 120) -> None:
    with replacing(file) as temporary:
        figure.savefig(temporary, dpi=dpi)


def color_scale(maps: Sequence[Array]) -> Any:
    """One logarithmic scale for the maps of a region by all methods: to be compared, they must share it."""
    from matplotlib.colors import LogNorm

    values = np.concatenate([errors.ravel() for errors in maps])
    top = float(np.quantile(values, 1.0 - CLIPPED))
    top = top if top > 0.0 else 1.0
    return LogNorm(top * 10.0**-DECADES, top, clip=True)


def write_error_maps(cells: dict[CellKey, Cell], suite: Suite, folder: Path) -> None:
    """A PNG per scene, region and method, of the most work, with the scale beside it."""
    shown = {key: cell for key, cell in cells.items() if key.work == suite.works[-1]}
    labels = [method.label for method in suite.methods]
    for key, cell in shown.items():
        norm = color_scale([other.error_map for at, other in shown.items() if at[:2] == key[:2]])
        height, width = cell.error_map.shape
        figure = new_figure(4.8, max(1.5, 4.0 * height / width))
        axes = figure.add_subplot()
        drawn = axes.imshow(cell.error_map, norm=norm, cmap=COLORS, interpolation="nearest")
        axes.set_axis_off()
        axes.set_title(f"{key.scene} {key.region}\n{key.method}, {key.work.label}", fontsize=8)
        figure.colorbar(drawn, ax=axes, label="relative squared error", extend="both")
        save(figure, folder / file_name(key.scene, key.region, labels.index(key.method), key.method, ".png"))


def write_convergence(rows: Sequence[Row], suite: Suite, file: Path, quantity: str) -> None:
    """relMSE over `cpu` seconds or `samples`, a panel per region, with the slope -1 of independent samples."""
    panels = list(dict.fromkeys((row.scene, row.region) for row in rows))
    if not panels:
        return
    columns = min(len(panels), 3)
    lines = -(-len(panels) // columns)
    figure = new_figure(4.2 * columns + 1.0, 3.2 * lines + 0.6)
    axes = figure.subplots(lines, columns, squeeze=False)
    for panel in axes.ravel()[len(panels) :]:
        panel.set_axis_off()
    for (scene, region), panel in zip(panels, axes.ravel(), strict=False):
        here = [row for row in rows if (row.scene, row.region) == (scene, region)]
        draw_panel(panel, here, suite, quantity)
        panel.set_title(f"{scene} {region}", fontsize=9)
    figure.supxlabel("CPU seconds" if quantity == "cpu" else "samples per pixel", fontsize=9)
    figure.supylabel("relMSE", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4), fontsize=8)
    save(figure, file)


def draw_panel(axes: Any, rows: Sequence[Row], suite: Suite, quantity: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        label_ticks(axis)
    axes.grid(True, which="major", linewidth=0.3)
    for number, method in enumerate(suite.methods):
        points = [row for row in rows if row.method == method.label and row.relmse.mean > 0.0]
        x = np.array([getattr(row, quantity).mean for row in points])
        y = np.array([row.relmse.mean for row in points])
        # A bar down to 0 has no place on a logarithmic axis.
        bars = [min(row.relmse.error or 0.0, 0.9 * row.relmse.mean) for row in points]
        color = f"C{number}"
        axes.errorbar(
            x, y, bars, fmt="o-", color=color, label=method.label, markersize=4, linewidth=1, capsize=2
        )
        if len(points):
            span = np.geomspace(x.min() / 2.0, x.max() * 2.0, 2)
            axes.plot(span, y[-1] * x[-1] / span, linestyle=":", color=color, linewidth=0.8)


def label_ticks(axis: Any) -> None:
    """1, 2, 5: readable over half a decade and over four."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
    axis.set_tick_params(labelsize=7)
