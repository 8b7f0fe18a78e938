"""What a run leaves in its folder: results.json and results.csv, and with pictures report.html and curves.png."""

import csv
import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from ..cli import output
from ..color import DisplayTransform
from . import figure, measures, page, plots, reference, table
from .machine import machine
from .results import Row, means_of, reference_noise, rows_of, same_images, slopes_of, warnings_of
from .runner import Run
from .scenes import Scene
from .suite import Suite


def write(
    run: Run, suite: Suite, scenes: Sequence[Scene], out: Path, transform: DisplayTransform | None
) -> str:
    """Writes everything but the contact sheet, page and curves only with a `transform`; returns the tables."""
    rows = rows_of(run.cells, suite)
    found = results(run, rows, suite, scenes)
    output.write_json(out / "results.json", found)
    write_csv(found["renders"], out / "results.csv")
    warnings, notes = warnings_in(run, rows, suite), notes_in(run, suite)
    legend = legend_of(rows, suite, run, transform)
    if transform and rows:
        facts = page.Facts(
            heading(run, suite, scenes), warnings, notes, legend, machine_line(found["machine"])
        )
        write_page(run, rows, suite, transform, facts, out)
    return table.summary(rows, slopes_of(run.cells, suite), suite, [*legend, *notes, *warnings])


def write_page(
    run: Run, rows: list[Row], suite: Suite, transform: DisplayTransform, facts: page.Facts, out: Path
) -> None:
    text = page.page(run.cells, rows, slopes_of(run.cells, suite), suite, transform, facts)
    with output.replacing(out / "report.html") as temporary:
        temporary.write_text(text, encoding="utf-8")
    plots.save(plots.curves(rows, suite), out / "curves.png")


def write_figure(run: Run, suite: Suite, places: Sequence[str], file: Path) -> None:
    figure.write_contact_sheet(run.cells, rows_of(run.cells, suite), suite, places, file)


def write_csv(renders: Sequence[dict[str, Any]], file: Path) -> None:
    """A line per render, with the names of results.json."""
    lines = [
        {**render, "work": render["work"]["kind"], "amount": render["work"]["amount"]} for render in renders
    ]
    names = list(dict.fromkeys(name for line in lines for name in line))
    with output.replacing(file) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, names)
        writer.writeheader()
        writer.writerows(lines)


def heading(run: Run, suite: Suite, scenes: Sequence[Scene]) -> str:
    stages = ", ".join(f"{scene.spec.name} ({scene.spec.stage})" for scene in scenes)
    return f"{stages}: {table.heading(suite)}; {run.renders} renders"


def machine_line(facts: dict[str, Any]) -> str:
    when = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    return (
        f"dermis {facts['dermis']}, {facts['processor']}, {facts['cores']} cores, {facts['system']}; {when}"
    )


def legend_of(rows: Sequence[Row], suite: Suite, run: Run, transform: DisplayTransform | None) -> list[str]:
    """How the numbers are to be read."""
    threshold = measures.bias_threshold(3 * len(rows))
    measured = (
        "Measured pixels: those with subsurface light in the reference (its subsurface AOV is not zero); error maps "
        "are grey elsewhere."
        if suite.subsurface_only
        else "Measured pixels: all of the crop."
    )
    return [
        measures.DEFINITION + ".",
        measured,
        "± is the standard error over seeds; ratios compare what was measured side by side, paired by seed.",
        "bias z: mean of I - R over its standard error, all seeds, in the channel where it is largest. Unbiased "
        f"methods exceed {threshold:.1f} (marked !) anywhere in this table once in 100 runs; what is biased has no "
        "efficiency. A reference that is off marks all methods.",
        "slope: of log relMSE over log samples; -1 where the error is that of independent samples.",
        flip_line(transform),
        "cpu s: of the process, user and system, training included; training: its share of the render's time; "
        "samples/s: of all pixels, per CPU second; peak MB: largest resident set of the process during the render, "
        "Python included ('-' where the system is not Linux, which can tell).",
        reference_line(suite, run),
    ]


def flip_line(transform: DisplayTransform | None) -> str:
    if transform is None:
        return "FLIP: not measured (--numbersOnly)."
    shown = f"OpenColorIO {transform.config_name}, display {transform.display}, view {transform.view}"
    return (
        "FLIP: mean LDR-FLIP (Andersson et al. 2020; 67 pixels per degree), of the pictures as this report shows "
        f"them, after --exposure: {shown}. The reference's noise is not taken from it."
    )


def reference_line(suite: Suite, run: Run) -> str:
    sources = ", ".join(dict.fromkeys(used.noise_from for used in run.references.values()))
    made = suite.reference_method
    how = f"; made by {made.label}, {suite.reference_samples} samples in two halves" if made else ""
    return f"own relMSE: of the reference, estimated by: {sources or 'nothing'}{how}; it is subtracted from the errors."


def warnings_in(run: Run, rows: Sequence[Row], suite: Suite) -> list[str]:
    """What is to be known before the numbers are believed, and what went wrong."""
    messages = [*same_images(run.cells, suite), *warnings_of(reference_noise(list(rows)))]
    sources = {place: used.noise_from for place, used in run.references.items()}
    unknown = ["/".join(place) for place, source in sources.items() if source == reference.UNKNOWN]
    bound = ["/".join(place) for place, source in sources.items() if source == reference.VARIANCE_AOV]
    if unknown:
        messages.append(
            f"the reference's noise is not known and still in the errors (no variance AOV, no second half): "
            f"{', '.join(unknown)}"
        )
    if bound:
        messages.append(
            "the reference's noise is that of its variance AOV, an upper bound: errors not far above it come out too "
            f"small: {', '.join(bound)}"
        )
    short = [f"{row.scene}/{row.crop} {row.method}" for row in rows if row.samples.mean < 1.0]
    if short:
        messages.append(
            f"the budget ended before every pixel had a sample, the others are black: {', '.join(short)}"
        )
    found = [f"Warning: {message}" for message in [*messages, *run.absent]]
    found += [f"failed: {failure}" for failure in run.failures]
    return [*found, *(["interrupted: not all that was asked for is here"] if run.interrupted else [])]


def notes_in(run: Run, suite: Suite) -> list[str]:
    found = [f"Note: {suite.reference_note}"] if suite.reference_note else []
    found += [f"Note: {note}" for note in run.peer_notes]
    if 0 < run.kept < run.renders:
        kept = f"{run.kept} of {run.renders} renders are of an earlier run"
        found.append(f"Note: {kept}: their times were not taken in the hour of the others")
    return found


def results(run: Run, rows: Sequence[Row], suite: Suite, scenes: Sequence[Scene]) -> dict[str, Any]:
    """All of it, for programs."""
    return {
        "definition": measures.DEFINITION,
        "command": sys.argv,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine(),
        "suite": {
            "works": [asdict(work) for work in suite.works],
            "seeds": suite.seeds,
            "seed": suite.seed,
            "whole_frames": suite.whole_frames,
            "subsurface_only": suite.subsurface_only,
            "baseline": suite.baseline,
            "reference_samples": suite.reference_samples,
            "reference_method": asdict(suite.reference_method) if suite.reference_method else None,
            "methods": [asdict(method) for method in suite.methods],
        },
        "scenes": [scene_entry(scene, run, suite) for scene in scenes],
        "rows": [row_entry(row) for row in rows],
        "reference_noise": [asdict(noise) for noise in reference_noise(list(rows))],
        "slopes": [
            {"scene": scene, "crop": crop, "method": method, "slope": found and asdict(found)}
            for (scene, crop, method), found in slopes_of(run.cells, suite).items()
        ],
        "means": [asdict(mean) for mean in means_of(list(rows), suite)],
        "renders": [
            {**key._asdict(), "work": asdict(key.work), **render}
            for key, cell in run.cells.items()
            for render in cell.renders
        ],
        "failures": run.failures,
        "peers": {"notes": run.peer_notes, "absent": run.absent},
        "interrupted": run.interrupted,
        "kept": run.kept,
    }


def row_entry(row: Row) -> dict[str, Any]:
    return {**asdict(row), "relmse_band": row.relmse.band, "efficiency": row.efficiency}


def scene_entry(scene: Scene, run: Run, suite: Suite) -> dict[str, Any]:
    spec = scene.spec
    return {
        "name": spec.name,
        "stage": str(spec.stage),
        "key": scene.key,
        "resolution": scene.resolution,
        "camera": scene.camera,
        "settings": dict(spec.settings),
        "overrides": dict(spec.overrides),
        "variants": dict(spec.variants),
        "method_settings": {
            method.label: run.settings.get((spec.name, method.label)) for method in suite.methods
        },
        "warnings": [{"prim": prim, "message": message} for prim, message in scene.warnings],
        "crops": [
            {
                "name": crop.name,
                "ndc": crop.ndc,
                "pixels": scene.window(crop),
                **of_reference(run, scene, crop.name),
            }
            for crop in scene.crops
        ],
    }


def of_reference(run: Run, scene: Scene, crop: str) -> dict[str, Any]:
    found = run.references.get((scene.spec.name, crop))
    if found is None:
        return {}
    return {"reference": [str(file) for file in found.files], "noise_from": found.noise_from}
