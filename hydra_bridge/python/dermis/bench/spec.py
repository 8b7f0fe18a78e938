"""Suites from flags, and from a JSON description with the flags on top."""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..cli.settings import Settings, SettingsError, format_value, parse_assignment
from .crops import Crop, CropError, make_crop, parse_crop
from .methods import SHARED, Method, MethodError, check, parse_methods, peer_methods
from .suite import FIRST_SEED, SceneSpec, Suite, SuiteError, Work, make_works, whole

SUITE_KEYS = {
    *(
        "about",
        "methods",
        "peers",
        "baseline",
        "budget",
        "samples",
        "seeds",
        "seed",
        "wholeFrames",
        "subsurfaceOnly",
        "settings",
        "exposure",
    ),
    *("reference", "scenes"),
}
SCENE_KEYS = {
    *("about", "name", "stage", "crops", "settings", "overrides", "variants", "reference", "exposure"),
}

#: What renders references: the first that is not under test. Classical walks are unbiased, learn nothing and share
#: nothing with the guided ones. The second has neither caches nor learning; its weights are exact, and a half of
#: classical walks bounds them: at most twice the second moment of classical ones, wherever the light is.
REFERENCE_METHODS = ("classical", "poe:walkPdf=exact:classicalFraction=0.5")

#: Samples of a reference over the most of any method, and its samples where methods have a time budget.
REFERENCE_WORK, REFERENCE_SAMPLES = 64, 4096

#: Settings that the comparison itself decides; of those that methods share, a scene has its view.
DECIDED = {*SHARED, "walk", "seed"} - {"camera", "resolution", "pixelAspectRatio", "aspectRatioConformPolicy"}


def build_suite(args: argparse.Namespace, defaults: Mapping[str, Any]) -> Suite:
    """The suite of the flags, or of `--spec` with the flags on top. Raises SuiteError."""
    try:
        spec = read_spec(Path(args.spec)) if args.spec else {}
        scenes = spec_scenes(spec, args, defaults) if args.spec else flag_scenes(args, defaults)
        suite = assemble(spec, args, scenes, defaults)
    except (MethodError, CropError, SettingsError) as error:
        raise SuiteError(str(error)) from error
    suite.check()
    return suite


def assemble(
    spec: Mapping[str, Any], args: argparse.Namespace, scenes: list[SceneSpec], defaults: Mapping[str, Any]
) -> Suite:
    walks = methods_of(args.methods or texts(spec, "methods"), defaults)
    methods = (*walks, *peer_methods(args.peers or texts(spec, "peers")))
    amounts = works(args, spec)
    made = mapping(spec, "reference", args.spec)
    known(made, {"samples", "method"}, "reference")
    reference, note = None, ""
    if not all(scene.reference for scene in scenes):
        reference, note = reference_method(args.referenceMethod or made.get("method"), walks, defaults)
    return Suite(
        methods,
        args.baseline or spec.get("baseline") or methods[0].label,
        amounts,
        tuple(scenes),
        reference,
        whole(chosen(args.seeds, spec, "seeds", 3), "seeds", 1),
        whole(chosen(args.seed, spec, "seed", FIRST_SEED), "seed", 0),
        flag(args.wholeFrames, spec, "wholeFrames"),
        flag(args.subsurfaceOnly, spec, "subsurfaceOnly"),
        whole(chosen(args.referenceSamples, made, "samples", enough(amounts)), "reference samples", 0),
        note,
    )


def enough(amounts: Sequence[Work]) -> int:
    """Samples of a reference where none are asked for; its own error is then some percent of the smallest measured."""
    most = amounts[-1]
    return int(most.amount) * REFERENCE_WORK if most.kind == "samples" else REFERENCE_SAMPLES


def reference_method(
    named: str | None, methods: Sequence[Method], defaults: Mapping[str, Any]
) -> tuple[Method, str]:
    """The method that is asked for, else the first of `REFERENCE_METHODS` that is not under test; with a note."""
    if named:
        (asked,) = methods_of([named], defaults)
        tested = under_test(asked, methods, defaults)
        return (
            asked,
            f"{asked.label} renders the reference, as was asked for, and is {tested}" if tested else "",
        )
    passed = []
    for choice in methods_of(list(REFERENCE_METHODS), defaults):
        tested = under_test(choice, methods, defaults)
        if not tested:
            return choice, "; ".join([*passed, f"{choice.label} renders the reference"]) if passed else ""
        passed.append(f"{choice.label} is {tested} and cannot be its own reference")
    raise SuiteError(
        "; ".join([*passed, "name another method by --referenceMethod, or give --reference FILE"])
    )


def under_test(method: Method, methods: Sequence[Method], defaults: Mapping[str, Any]) -> str:
    """Says which of `methods` walks as `method` does; empty: none.

    `auto` is classical in some bodies. Settings that only the other one makes do not tell the two apart: to this kind
    of walk they may mean nothing.
    """
    for other in methods:
        settings = {**defaults, **other.settings}
        walks = {"auto", "classical"} if method.settings["walk"] == "classical" else {method.settings["walk"]}
        same = all(settings[name] == value for name, value in method.settings.items() if name != "walk")
        if settings["walk"] in walks and same:
            return "under test" if other.label == method.label else f"under test, as {other.label}"
    return ""


def methods_of(named: list[str], defaults: Mapping[str, Any]) -> tuple[Method, ...]:
    if not named:
        raise SuiteError("name at least one method, as in --methods classical,mixture")
    methods = tuple(parse_methods(named, defaults))
    for method in methods:
        check(method)
    return methods


def works(args: argparse.Namespace, spec: Mapping[str, Any]) -> tuple[Work, ...]:
    """Amounts of work: of the flags, else of the description."""
    typed = {"samples": args.samples, "budget": args.budget}
    source = typed if any(typed.values()) else spec
    found = [(kind, source[kind]) for kind in ("samples", "budget") if source.get(kind)]
    if len(found) != 1:
        raise SuiteError("give one of --budget S (seconds per render) and --samples N[,N...]")
    kind, amounts = found[0]
    return make_works(kind, amounts if isinstance(amounts, list) else [amounts])


def flag_scenes(args: argparse.Namespace, defaults: Mapping[str, Any]) -> list[SceneSpec]:
    """One scene per STAGE, called by its stem."""
    if not args.stages:
        raise SuiteError("which stage? Give STAGE, or --spec FILE.json")
    if args.only:
        raise SuiteError("--only chooses among the scenes of --spec")
    names = [Path(stage).stem for stage in args.stages]
    for name in names:
        if names.count(name) > 1:
            raise SuiteError(f"two stages are called {name}: describe them in a file for --spec, with names")
    if args.reference and len(names) > 1:
        raise SuiteError("--reference is for one stage; with several, use --referenceSamples, or --spec")
    settings = typed_settings(args, defaults)
    reference = tuple(Path(file) for file in args.reference or ())
    crops = flag_crops(args.crops or [], names)
    return [
        SceneSpec(
            name, Path(stage), crops[name], settings, reference=reference, exposure=args.exposure or 0.0
        )
        for name, stage in zip(names, args.stages, strict=True)
    ]


def flag_crops(named: list[str], scenes: list[str]) -> dict[str, tuple[Crop, ...]]:
    """Crops by the name of their scene; one that names none belongs to all."""
    crops: dict[str, tuple[Crop, ...]] = dict.fromkeys(scenes, ())
    for text in named:
        scene, crop = parse_crop(text)
        if scene and scene not in crops:
            raise SuiteError(f"--crops {text}: there is no stage {scene!r}; there are {', '.join(scenes)}")
        for name in [scene] if scene else scenes:
            crops[name] = (*crops[name], crop)
    return crops


def read_spec(file: Path) -> dict[str, Any]:
    """The JSON description. Raises SuiteError."""
    try:
        spec = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise SuiteError(f"--spec {file}: {error.strerror or error}") from error
    except ValueError as error:
        raise SuiteError(f"--spec {file}: it is no JSON: {error}") from error
    known(spec, SUITE_KEYS, str(file))
    if not isinstance(spec.get("scenes"), list) or not spec["scenes"]:
        raise SuiteError(f"--spec {file}: scenes: expected a list of at least one")
    return spec


def spec_scenes(
    spec: Mapping[str, Any], args: argparse.Namespace, defaults: Mapping[str, Any]
) -> list[SceneSpec]:
    for flag, given in (("STAGE", args.stages), ("--crops", args.crops), ("--reference", args.reference)):
        if given:
            raise SuiteError(f"{flag} does not go with --spec: {args.spec} describes it")
    common, typed = settings_of(spec, args.spec, defaults), typed_settings(args, defaults)
    scenes = []
    for number, entry in enumerate(spec["scenes"]):
        where = f"{args.spec}: scenes[{number}]"
        known(entry, SCENE_KEYS, where)
        settings = {**common, **settings_of(entry, where, defaults), **typed}
        stops = entry.get("exposure", spec.get("exposure", 0.0)) if args.exposure is None else args.exposure
        scenes.append(spec_scene(entry, where, Path(args.spec).parent, settings, float(stops)))
    return only(scenes, args.only or [])


def spec_scene(entry: Any, where: str, folder: Path, settings: Settings, exposure: float) -> SceneSpec:
    """A scene of the description, whose files are relative to its `folder`."""
    if not isinstance(entry.get("stage"), str):
        raise SuiteError(f"{where}: stage: expected a file name")
    stage = folder / entry["stage"]
    crops = mapping(entry, "crops", where)
    return SceneSpec(
        str(entry.get("name", stage.stem)),
        stage,
        tuple(make_crop(name, ndc) for name, ndc in crops.items()),
        settings,
        mapping(entry, "overrides", where),
        mapping(entry, "variants", where),
        tuple(folder / file for file in texts(entry, "reference")),
        exposure,
    )


def only(scenes: list[SceneSpec], names: list[str]) -> list[SceneSpec]:
    """Those of the scenes that are named; all without names."""
    for name in names:
        if name not in [scene.name for scene in scenes]:
            raise SuiteError(f"--only {name}: the scenes are {', '.join(scene.name for scene in scenes)}")
    return [scene for scene in scenes if not names or scene.name in names]


def settings_of(entry: Mapping[str, Any], where: str, defaults: Mapping[str, Any]) -> Settings:
    """`settings` of an entry, checked as typed ones are."""
    given = mapping(entry, "settings", where)
    return parse_settings([f"{name}={format_value(value)}" for name, value in given.items()], defaults)


def typed_settings(args: argparse.Namespace, defaults: Mapping[str, Any]) -> Settings:
    return parse_settings(args.assignments or [], defaults)


def parse_settings(assignments: list[str], defaults: Mapping[str, Any]) -> Settings:
    settings: Settings = {}
    for assignment in assignments:
        name, value = parse_assignment(assignment, defaults)
        if name in DECIDED:
            raise SettingsError(f"--set {assignment}: {name} is for the comparison itself to decide")
        settings[name] = value
    return settings


def known(entry: Any, keys: set[str], where: str) -> None:
    """Refuses keys that nobody reads: a slip in a long description would go unseen."""
    if not isinstance(entry, dict):
        raise SuiteError(f"{where}: expected an object, got {entry!r}")
    for key in entry:
        if key not in keys:
            raise SuiteError(f"{where}: there is no {key!r}; there are {', '.join(sorted(keys))}")


def mapping(entry: Mapping[str, Any], key: str, where: str | None) -> dict[str, Any]:
    value = entry.get(key, {})
    if not isinstance(value, dict):
        raise SuiteError(f"{where}: {key}: expected an object, got {value!r}")
    return value


def texts(entry: Mapping[str, Any], key: str) -> list[str]:
    """A list of strings, or one string."""
    value = entry.get(key, [])
    value = [value] if isinstance(value, str) else value
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise SuiteError(f"{key}: expected a list of strings, got {value!r}")
    return value


def flag(typed: bool | None, spec: Mapping[str, Any], key: str) -> bool:
    value = chosen(typed, spec, key, False)
    if not isinstance(value, bool):
        raise SuiteError(f"{key}: expected true or false, got {value!r}")
    return value


def chosen(typed: Any, spec: Mapping[str, Any], key: str, default: Any) -> Any:
    return typed if typed is not None else spec.get(key, default)
