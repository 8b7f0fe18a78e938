"""Pictures of the numbers: error over time and samples, error maps in false colour."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cli.output import replacing
from .measures import Array
from .results import Row
from .suite import Suite

INSTALL = (
    "the report needs matplotlib and flip-evaluator, of which {} is not installed: pip install matplotlib "
    "flip-evaluator (the extra `bench` of dermis has them), or go without the report: --numbersOnly"
)

#: Decades of false colour below the brightest.
DECADES = 3

#: Share of the pixels that may be brighter than the scale: fireflies would leave the rest black.
CLIPPED = 0.002

COLORS = "inferno"

#: Of methods in curves and tables, to be told apart by all eyes (Okabe and Ito 2008); then from the start again.
METHOD_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#555555")


class PlotsError(Exception):
    """A library is missing; the text says how to install it."""


def require_libraries() -> None:
    """Raises PlotsError; called before the first render."""
    try:
        import flip_evaluator  # noqa: F401
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise PlotsError(INSTALL.format(error.name)) from error


def new_figure(width: float, height: float) -> Any:
    """An empty figure, in inches, for files alone: it needs no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save(figure: Any, file: Path, dpi: int = 120) -> None:
    with replacing(file) as temporary:
        figure.savefig(temporary, dpi=dpi)


def svg(figure: Any) -> str:
    """The figure as an element for a page: letters as shapes, nothing outside referred to."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.fonttype": "path"}):
        figure.savefig(
            text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    drawn = text.getvalue()
    return drawn[drawn.index("<svg") :]


def color_scale(maps: Sequence[Array]) -> Any:
    """One logarithmic scale for the maps of a crop by all methods: to be compared, they must share it."""
    from matplotlib.colors import LogNorm

    values = np.concatenate([errors.ravel() for errors in maps])
    top = float(np.quantile(values, 1.0 - CLIPPED))
    top = top if top > 0.0 else 1.0
    return LogNorm(top * 10.0**-DECADES, top, clip=True)


def false_color(errors: Array, scale: Any) -> NDArray[np.uint8]:
    """RGB of 8 bits. An error of 0 is as dark as the scale gets."""
    from matplotlib import colormaps

    return colormaps[COLORS](scale(np.maximum(errors, scale.vmin)), bytes=True)[..., :3]


def color_stops(count: int = 13) -> list[str]:
    """The false colours from dark to bright, as CSS writes them."""
    from matplotlib import colormaps, colors

    return [colors.to_hex(color) for color in colormaps[COLORS](np.linspace(0.0, 1.0, count))]


def method_color(suite: Suite, label: str) -> str:
    labels = [method.label for method in suite.methods]
    return METHOD_COLORS[labels.index(label) % len(METHOD_COLORS)]


def curves(rows: Sequence[Row], suite: Suite) -> Any:
    """A figure with a line per crop: relMSE over CPU seconds, and over samples."""
    places = list(dict.fromkeys((row.scene, row.crop) for row in rows))
    figure = new_figure(9.0, 2.9 * len(places) + 0.5)
    axes = figure.subplots(len(places), 2, squeeze=False, sharey="row")
    for (scene, crop), line in zip(places, axes, strict=True):
        here = [row for row in rows if (row.scene, row.crop) == (scene, crop)]
        for panel, quantity, name in zip(
            line, ("cpu", "samples"), ("CPU seconds", "samples per pixel"), strict=True
        ):
            draw_panel(panel, here, suite, quantity)
            panel.set_xlabel(name, fontsize=8)
        line[0].set_ylabel("relMSE", fontsize=8)
        if len(places) > 1:
            line[0].set_title(f"{scene}/{crop}", fontsize=9, loc="left")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(len(labels), 4), fontsize=8, frameon=False
    )
    return figure


def draw_panel(axes: Any, rows: Sequence[Row], suite: Suite, quantity: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    label_ticks(axes.xaxis, 2.0 if quantity == "samples" else 10.0)
    label_ticks(axes.yaxis, 10.0)
    axes.grid(True, which="major", linewidth=0.3)
    for method in suite.methods:
        points = [row for row in rows if row.method == method.label and row.relmse.mean > 0.0]
        if points:
            draw_method(axes, points, quantity, method_color(suite, method.label))


def draw_method(axes: Any, points: Sequence[Row], quantity: str, color: str) -> None:
    """The mean, its 95 % band, and the slope -1 of independent samples through the last point."""
    points = sorted(points, key=lambda row: getattr(row, quantity).mean)
    x = np.array([getattr(row, quantity).mean for row in points])
    y = np.array([row.relmse.mean for row in points])
    axes.plot(x, y, "o-", color=color, label=points[0].method, markersize=3.5, linewidth=1.2)
    bands = [row.relmse.band for row in points]
    if None not in bands:
        low, high = np.transpose(bands)
        if len(points) > 1:
            axes.fill_between(x, low, high, color=color, alpha=0.18, linewidth=0)
        else:
            axes.vlines(x, low, high, color=color, alpha=0.5, linewidth=3)
    span = np.geomspace(x.min() / 1.5, x.max() * 1.5, 2)
    axes.plot(span, y[-1] * x[-1] / span, linestyle=":", color=color, linewidth=0.8)


def label_ticks(axis: Any, base: float) -> None:
    """1, 2, 5, readable over half a decade and over four; or powers of two."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(base=base, subs=(1.0, 2.0, 5.0) if base == 10.0 else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_tick_params(labelsize=7)
