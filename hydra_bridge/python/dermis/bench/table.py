"""The report as Markdown that reads well in a terminal too."""

from collections.abc import Sequence

from .measures import DEFINITION, Number, bias_threshold
from .results import Mean, Row, means_of, reference_noise
from .suite import Suite

COLUMNS = (
    *(
        "region",
        "method",
        "spp",
        "cpu s",
        "relMSE",
        "trimmed",
        "ratio",
        "ratio trimmed",
        "steps/walk",
        "bias z",
    ),
)
MEAN_COLUMNS = ("scene", "method", "ratio", "ratio trimmed", "regions")


def report(rows: Sequence[Row], suite: Suite, notes: Sequence[str]) -> str:
    """Everything but the pictures."""
    threshold = bias_threshold(3 * len(rows))
    parts = [heading(suite)]
    for scene in dict.fromkeys(row.scene for row in rows):
        for work in suite.works:
            chosen = [row for row in rows if (row.scene, row.work) == (scene, work)]
            if chosen:
                parts += [
                    f"## {scene}, {work.label}",
                    markdown(COLUMNS, [cells(row, threshold) for row in chosen]),
                ]
    means = means_of(list(rows), suite)
    for work in suite.works:
        lines = [mean_cells(mean) for mean in means if mean.work == work]
        if lines:
            title = f"## Geometric means over regions, {work.label}"
            parts += [title, markdown(MEAN_COLUMNS, lines)]
    if len(suite.works) > 1:
        parts += ["## relMSE x samples: constant where the error is noise alone", constancy(rows, suite)]
    parts += ["## References", references(rows)]
    parts.append("\n".join(f"- {note}" for note in [*legend(suite, threshold), *notes]))
    return "\n\n".join(parts) + "\n"


def heading(suite: Suite) -> str:
    works = ", ".join(work.label for work in suite.works)
    return (
        f"# Speed against error\n\n{len(suite.methods)} methods, {works} per render, {suite.repeats} repeats; "
        f"ratios are efficiency over that of {suite.baseline}"
    )


def legend(suite: Suite, threshold: float) -> list[str]:
    return [
        DEFINITION + ".",
        "± is the standard error over repeats; ratios compare what was measured side by side in this run.",
        "bias z: mean of I - R over its standard error, all repeats, in the channel where it is largest. Unbiased "
        f"methods exceed {threshold:.1f} (marked !) anywhere in this table once in 100 runs; what is biased has no "
        "efficiency. A reference that is off marks all methods.",
    ]


def cells(row: Row, threshold: float) -> list[str]:
    mark = " !" if abs(row.largest_bias) > threshold else ""
    return [
        row.region,
        row.method,
        f"{row.samples.mean:.5g}",
        with_share(row.cpu, ".3g"),
        with_share(row.relmse, ".3e"),
        with_share(row.trimmed, ".3e"),
        with_error(row.ratio),
        with_error(row.ratio_trimmed),
        "-" if row.steps is None else f"{row.steps:.1f}",
        f"{row.largest_bias:+.1f}{mark}",
    ]


def mean_cells(mean: Mean) -> list[str]:
    count = f"{mean.regions}" if mean.regions == mean.of else f"{mean.regions} of {mean.of}"
    return [mean.scene or "all", mean.method, with_error(mean.ratio), with_error(mean.ratio_trimmed), count]


def constancy(rows: Sequence[Row], suite: Suite) -> str:
    """relMSE x samples per pixel by amount of work."""
    lines = []
    for scene, region, method in dict.fromkeys((row.scene, row.region, row.method) for row in rows):
        found = {
            row.work: row for row in rows if (row.scene, row.region, row.method) == (scene, region, method)
        }
        products = [
            found[work].relmse.mean * found[work].samples.mean if work in found else None
            for work in suite.works
        ]
        lines.append([scene, region, method, *("-" if p is None else f"{p:.3g}" for p in products)])
    return markdown(("scene", "region", "method", *(work.label for work in suite.works)), lines)


def references(rows: Sequence[Row]) -> str:
    lines = [[n.scene, n.region, f"{n.noise:.2e}", f"{n.share:.1%}"] for n in reference_noise(list(rows))]
    return markdown(("scene", "region", "own relMSE", "of the smallest"), lines)


def with_share(number: Number, form: str) -> str:
    """Mean and standard error in percent of it."""
    return f"{number.mean:{form}}" + (f" ±{number.relative:.0%}" if number.error is not None else "")


def with_error(number: Number | None) -> str:
    if number is None:
        return "-"
    return f"{number.mean:.2f}" + (f" ±{number.error:.2f}" if number.error is not None else "")


def markdown(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table padded to equal widths; the first two columns to the left, numbers to the right."""
    escaped = [[text.replace("|", "\\|") for text in line] for line in lines]
    widths = [max(len(text) for text in column) for column in zip(columns, *escaped, strict=True)]
    left = [name in ("scene", "region", "method") for name in columns]

    def padded(line: Sequence[str]) -> str:
        texts = [t.ljust(w) if at else t.rjust(w) for t, w, at in zip(line, widths, left, strict=True)]
        return f"| {' | '.join(texts)} |"

    rule = "|".join("-" * (w + 2) if at else "-" * (w + 1) + ":" for w, at in zip(widths, left, strict=True))
    return "\n".join([padded(columns), f"|{rule}|", *(padded(line) for line in escaped)])
