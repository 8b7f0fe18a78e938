"""The tables of the report, and their Markdown, which reads well in a terminal too."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .measures import Number, bias_threshold
from .results import CropSlopes, Mean, Row, means_of, reference_noise
from .suite import Suite, Work

#: Columns that hold words.
WORDS = ("scene", "crop", "method", "work")


@dataclass(frozen=True)
class Table:
    title: str
    columns: tuple[str, ...]
    lines: list[list[str]]
    words: tuple[str, ...] = WORDS


def efficiency_tables(rows: Sequence[Row], suite: Suite, work: Work) -> list[Table]:
    """Ratios by crop and method, geometric means below; then those of trimmed errors."""
    means = means_of(list(rows), suite)
    return [
        ratio_table(
            f"Efficiency over that of {suite.baseline}{what}, {work.label}", part, rows, means, work, suite
        )
        for what, part in (("", ratio), (", trimmed errors", ratio_trimmed))
        if any(row.work == work for row in rows)
    ]


def ratio(row: Row | Mean) -> Number | None:
    return row.ratio


def ratio_trimmed(row: Row | Mean) -> Number | None:
    return row.ratio_trimmed


def ratio_table(
    title: str,
    part: Callable[[Row | Mean], Number | None],
    rows: Sequence[Row],
    means: Sequence[Mean],
    work: Work,
    suite: Suite,
) -> Table:
    labels = [method.label for method in suite.methods]
    lines = []
    for place in dict.fromkeys((row.scene, row.crop) for row in rows):
        found = {r.method: r for r in rows if (r.scene, r.crop) == place and r.work == work}
        lines.append([*place, *(with_error(part(found[m])) if m in found else "-" for m in labels)])
    for scene in dict.fromkeys(mean.scene for mean in means):
        of = {mean.method: mean for mean in means if mean.scene == scene and mean.work == work}
        lines.append([scene or "all", "geometric mean", *(mean_cell(of.get(m), part) for m in labels)])
    return Table(title, ("scene", "crop", *labels), lines)


def mean_cell(mean: Mean | None, part: Callable[[Row | Mean], Number | None]) -> str:
    """The mean, and of how many crops where not of all."""
    if mean is None:
        return "-"
    return with_error(part(mean)) + (f" ({mean.crops} of {mean.of})" if mean.crops < mean.of else "")


def crop_tables(rows: Sequence[Row], slopes: CropSlopes, threshold: float) -> tuple[Table, Table]:
    """Errors, and costs, of the rows of one crop."""
    errors = ("work", "method", "relMSE", "trimmed", "MSE", "FLIP", "bias z", "slope")
    costs = ("work", "method", "spp", "cpu s", "efficiency", "ratio", "ratio trimmed", "training", "samples/s",
             "peak MB", "steps/walk")  # fmt: skip
    return (
        Table("Errors", errors, [error_cells(row, slopes, threshold) for row in rows]),
        Table("Costs", costs, [cost_cells(row) for row in rows]),
    )


def error_cells(row: Row, slopes: CropSlopes, threshold: float) -> list[str]:
    return [
        row.work.label,
        row.method,
        with_share(row.relmse, ".3e"),
        with_share(row.trimmed, ".3e"),
        with_share(row.mse, ".3e"),
        "-" if row.flip is None else with_share(row.flip, ".4f"),
        f"{row.largest_bias:+.1f}{' !' if abs(row.largest_bias) > threshold else ''}",
        with_error(slopes.get((row.scene, row.crop, row.method))),
    ]


def cost_cells(row: Row) -> list[str]:
    return [
        row.work.label,
        row.method,
        f"{row.samples.mean:.5g}",
        with_share(row.cpu, ".3g"),
        "-" if row.efficiency is None else f"{row.efficiency:.3g}",
        with_error(row.ratio),
        with_error(row.ratio_trimmed),
        f"{row.training_share.mean:.1%}",
        "-" if row.samples_per_second is None else f"{row.samples_per_second.mean:.3g}",
        "-" if row.peak is None else f"{row.peak / 1e6:.0f}",
        "-" if row.steps is None else f"{row.steps:.1f}",
    ]


def references(rows: Sequence[Row]) -> Table:
    """What the references bring along themselves."""
    lines = [[n.scene, n.crop, f"{n.noise:.2e}", f"{n.share:.1%}"] for n in reference_noise(list(rows))]
    return Table("References", ("scene", "crop", "own relMSE", "of the smallest"), lines)


def summary(rows: Sequence[Row], slopes: CropSlopes, suite: Suite, notes: Sequence[str]) -> str:
    """All tables as Markdown."""
    parts = [f"# Speed against error\n\n{heading(suite)}"]
    threshold = bias_threshold(3 * len(rows))
    for work in suite.works:
        for table in efficiency_tables(rows, suite, work):
            parts += [f"## {table.title}", markdown(table)]
    for scene, crop in dict.fromkeys((row.scene, row.crop) for row in rows):
        here = [row for row in rows if (row.scene, row.crop) == (scene, crop)]
        parts += [f"## {scene}/{crop}", *(markdown(table) for table in crop_tables(here, slopes, threshold))]
    parts += ["## References", markdown(references(rows)), "\n".join(f"- {note}" for note in notes)]
    return "\n\n".join(parts) + "\n"


def heading(suite: Suite) -> str:
    works = ", ".join(work.label for work in suite.works)
    return (
        f"{len(suite.methods)} methods, {works} per render, {suite.seeds} seeds; ratios are efficiency over that of "
        f"{suite.baseline}"
    )


def with_share(number: Number, form: str) -> str:
    """Mean and standard error in percent of it."""
    return f"{number.mean:{form}}" + (f" ±{number.relative:.0%}" if number.error is not None else "")


def with_error(number: Number | None) -> str:
    if number is None:
        return "-"
    return ratio_text(number.mean) + (f" ±{ratio_text(number.error)}" if number.error is not None else "")


def ratio_text(ratio: float) -> str:
    """Two decimals; two digits where these would say little."""
    return f"{ratio:.2f}" if abs(ratio) >= 0.1 or ratio == 0.0 else f"{ratio:.2g}"


def markdown(table: Table) -> str:
    """Padded to equal widths; words to the left, numbers to the right."""
    columns = [text.replace("|", "\\|") for text in table.columns]
    escaped = [[text.replace("|", "\\|") for text in line] for line in table.lines]
    widths = [max(len(text) for text in column) for column in zip(columns, *escaped, strict=True)]
    left = [name in table.words for name in table.columns]

    def padded(line: Sequence[str]) -> str:
        texts = [t.ljust(w) if at else t.rjust(w) for t, w, at in zip(line, widths, left, strict=True)]
        return f"| {' | '.join(texts)} |"

    rule = "|".join("-" * (w + 2) if at else "-" * (w + 1) + ":" for w, at in zip(widths, left, strict=True))
    return "\n".join([padded(columns), f"|{rule}|", *(padded(line) for line in escaped)])
