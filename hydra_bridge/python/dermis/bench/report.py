"""What a run leaves in its folder: results.json, table.md, pictures."""

import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

from .. import __version__
from ..cli import output
from . import figure, measures, plots, reference, table
from .results import Row, means_of, reference_noise, rows_of, same_images, warnings_of
from .runner import Run
from .scenes import Scene
from .suite import Suite

LIBRARIES = ("numpy", "usd-core", "openimageio", "opencolorio", "matplotlib")


def write(run: Run, suite: Suite, scenes: Sequence[Scene], out: Path, pictures: bool) -> str:
    """Writes everything but the contact sheet; returns the text of table.md."""
    rows = rows_of(run.cells, suite)
    output.write_json(out / "results.json", results(run, rows, suite, scenes))
    text = table.report(rows, suite, notes(run, rows, suite))
    with output.replacing(out / "table.md") as temporary:
        temporary.write_text(text, encoding="utf-8")
    if pictures:
        write_plots(run, rows, suite, out)
    return text


def write_plots(run: Run, rows: list[Row], suite: Suite, out: Path) -> None:
    plots.write_error_maps(run.cells, suite, out / "errors")
    plots.write_convergence(rows, suite, out / "relmse_over_time.png", "cpu")
    plots.write_convergence(rows, suite, out / "relmse_over_samples.png", "samples")


def write_figure(run: Run, suite: Suite, places: Sequence[str], file: Path) -> None:
    figure.write_contact_sheet(run.cells, rows_of(run.cells, suite), suite, places, file)


def notes(run: Run, rows: Sequence[Row], suite: Suite) -> list[str]:
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
    found = [f"Warning: {message}" for message in messages]
    found += [f"failed: {failure}" for failure in run.failures]
    return [*found, *(["interrupted: not all that was asked for is here"] if run.interrupted else [])]


def results(run: Run, rows: Sequence[Row], suite: Suite, scenes: Sequence[Scene]) -> dict[str, Any]:
    """All of it, for programs."""
    return {
        "definition": measures.DEFINITION,
        "command": sys.argv,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine(),
        "suite": {
            "works": [asdict(work) for work in suite.works],
            "repeats": suite.repeats,
            "seed": suite.seed,
            "crops": suite.crops,
            "baseline": suite.baseline,
            "reference_samples": suite.reference_samples,
            "reference_method": asdict(suite.reference_method),
            "methods": [asdict(method) for method in suite.methods],
        },
        "scenes": [scene_entry(scene, run, suite) for scene in scenes],
        "rows": [row_entry(row) for row in rows],
        "reference_noise": [asdict(noise) for noise in reference_noise(list(rows))],
        "means": [asdict(mean) for mean in means_of(list(rows), suite)],
        "renders": [
            {**key._asdict(), "work": asdict(key.work), **render}
            for key, cell in run.cells.items()
            for render in cell.renders
        ],
        "failures": run.failures,
        "interrupted": run.interrupted,
    }


def row_entry(row: Row) -> dict[str, Any]:
    efficiency = (
        1.0 / (row.relmse.mean * row.cpu.mean) if row.relmse.mean > 0.0 and row.cpu.mean > 0.0 else None
    )
    return {**asdict(row), "efficiency": efficiency}


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
        "regions": [
            {
                "name": region.name,
                "ndc": region.ndc,
                "pixels": scene.window(region),
                **of_reference(run, scene, region.name),
            }
            for region in scene.regions
        ],
    }


def of_reference(run: Run, scene: Scene, region: str) -> dict[str, Any]:
    found = run.references.get((scene.spec.name, region))
    if found is None:
        return {}
    return {"reference": [str(file) for file in found.files], "noise_from": found.noise_from}


def machine() -> dict[str, Any]:
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "dermis": __version__,
        **{name: version(name) for name in LIBRARIES},
    }


def processor() -> str:
    """The model, where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
