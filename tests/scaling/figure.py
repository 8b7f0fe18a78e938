"""The rows as curves: one panel per axis, log-log."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from .runs import Row


def write(rows: list[Row], file: Path) -> None:
    axes = list(dict.fromkeys(row.axis for row in rows if row.axis != "processes"))
    figure, panels = plt.subplots(
        2, len(axes), figsize=(3.2 * len(axes), 6), squeeze=False, layout="constrained"
    )
    for axis, (above, below) in zip(axes, panels.T, strict=True):
        own = [row for row in rows if row.axis == axis]
        sizes = [row.size for row in own]
        above.loglog(sizes, [row.sample_us for row in own], "o-", color="C0")
        above.set(title=axis, ylabel="one thread, us per sample" if axis != "threads" else "us per sample")
        below.loglog(sizes, [row.start_s for row in own], "o-", label="start, s")
        below.loglog(sizes, [row.usd_s for row in own], "o--", label="usd-core alone, s")
        below.loglog(sizes, [row.rss_mb / 1000.0 for row in own], "o:", label="resident, GB")
        below.set(xlabel=axis)
        for panel in (above, below):
            panel.grid(alpha=0.3)
    panels[1, 0].legend(fontsize=8)
    partial = file.with_name(f".{file.name}.partial.png")
    figure.savefig(partial, dpi=110)
    plt.close(figure)
    partial.replace(file)
