"""What every flattening asks of the stage as a whole: lights, domes with portals, cameras, primvars that shaders read,
what may move, skeletons.

Found in one traversal, prototypes once instead of all their instances. USD's notices say which prims have to be looked
at again, so that the edit of one prim costs that of one prim.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import count
from threading import RLock
from typing import Any
from weakref import WeakKeyDictionary, ref

from pxr import Sdf, Tf, Usd, UsdGeom, UsdShade

from .linking import Links
from .reading import Report

MOVING = frozenset(
    (
        *("points", "normals", "primvars:normals", "velocities", "accelerations"),
        *("positions", "orientations", "orientationsf", "scales", "angularVelocities"),
        *("rotations", "translations", "blendShapeWeights"),
        *("size", "radius", "height", "length", "width"),
    )
)
"""Attributes whose samples are times at which something may move, beside xformOps."""

OF_LINKS = ("collection:", "light")
OF_SKELETONS = (
    *("skel:", "primvars:skel:", "joint", "bindTransforms", "restTransforms", "blendShape"),
    *("rotations", "translations", "scales"),
)
OF_SHADERS = ("inputs:", "outputs:")
"""How properties begin that are read once and kept: by light links, by UsdSkel's cache, of primvars."""


@dataclass(frozen=True)
class Facts:
    """Of a prim that has any. `reads`: a shader that reads primvars; `moving`: attributes that have samples; `bends`:
    it does not go straight between them."""

    light: bool = False
    dome: bool = False
    camera: bool = False
    reads: bool = False
    moving: tuple[str, ...] = ()
    bends: bool = False


NOTHING = Facts()

NAMES = ("varname", "geomprop")
"""Inputs of shaders that name the primvar they read."""


def facts(prim: Usd.Prim) -> Facts:
    names = prim.GetAuthoredPropertyNames()
    kind = str(prim.GetTypeName())
    moving = [name for name in names if name in MOVING or name.startswith("xformOp:")]
    return Facts(
        light=prim.HasAPI("LightAPI"),
        dome=kind.startswith("DomeLight"),
        camera=prim.IsA(UsdGeom.Camera),
        reads=kind == "Shader" and any(prim.HasAttribute(f"inputs:{name}") for name in NAMES),
        moving=tuple(name for name in moving if varies(prim, name)),
        bends="accelerations" in names or "angularVelocities" in names or prim.IsA("Skeleton"),
    )


def varies(prim: Usd.Prim, name: str) -> bool:
    attribute = prim.GetAttribute(name)
    return bool(attribute) and attribute.ValueMightBeTimeVarying()


def primvars_of(shader: Usd.Prim) -> Iterator[str]:
    """Names of the primvars that it reads."""
    for name in NAMES:
        shader_input = UsdShade.Shader(shader).GetInput(name)
        if shader_input:
            for attribute in UsdShade.Utils.GetValueProducingAttributes(shader_input):
                if found := str(attribute.Get() or ""):
                    yield found


@dataclass
class Stale:
    """What notices said since the last look: subtrees, single prims."""

    subtrees: set[Sdf.Path] = field(default_factory=set)
    prims: set[Sdf.Path] = field(default_factory=set)


VERSIONS = count()
"""Of all stages, so that what was read of one is never taken for another's."""


class Index:
    """Of one stage, which it does not keep alive: every call takes it. Threads may flatten one stage at a time that
    nobody edits."""

    def __init__(self, stage: Usd.Stage) -> None:
        self.facts: dict[Sdf.Path, Facts] = {}
        self.prototypes: set[Sdf.Path] = set()
        #: Held while anything is looked up or noted.
        self.lock = RLock()
        #: Changes whenever the stage does.
        self.version = next(VERSIONS)
        self.stale = Stale({Sdf.Path.absoluteRootPath})
        #: UsdSkel.Cache by SkelRoot.
        self.skeletons: dict[str, Any] = {}
        self._links: tuple[Links, Report] | None = None
        self._render_pass = ""
        self._primvars: set[str] | None = None
        me = ref(self)

        def note(notice: Usd.Notice.ObjectsChanged, sender: Any) -> None:
            if (index := me()) is not None:
                with index.lock:
                    index.note(notice)

        # USD does not keep what it calls.
        self.listener = note, Tf.Notice.Register(Usd.Notice.ObjectsChanged, note, stage)

    def note(self, notice: Usd.Notice.ObjectsChanged) -> None:
        self.version = next(VERSIONS)
        resynced = notice.GetResyncedPaths()
        for path in (*resynced, *notice.GetChangedInfoOnlyPaths()):
            if path.IsPropertyPath():
                self.stale.prims.add(path.GetPrimPath())
                if path.name.startswith(OF_LINKS):
                    self._links = None
                if path.name.startswith(OF_SKELETONS):
                    self.skeletons.clear()
                if path.name.startswith(OF_SHADERS):
                    self._primvars = None
            else:
                self.stale.prims.add(path)
        subtrees = [path for path in resynced if not path.IsPropertyPath()]
        if subtrees:
            self.stale.subtrees.update(subtrees)
            self._links = self._primvars = None
            self.skeletons.clear()

    def fresh(self, stage: Usd.Stage) -> dict[Sdf.Path, Facts]:
        """The facts, after a look at what changed."""
        with self.lock:
            stale, self.stale = self.stale, Stale()
            if stale.subtrees:
                self.resync(stage, stale.subtrees)
            for path in stale.prims:
                if not is_below(path, stale.subtrees):
                    self.look(path, stage.GetPrimAtPath(path))
            # Another thread may bring it up to date while this one goes through it.
            return dict(self.facts)

    def resync(self, stage: Usd.Stage, subtrees: set[Sdf.Path]) -> None:
        """Looks again at subtrees, and at prototypes that came or went with them."""
        prototypes = {prototype.GetPath() for prototype in stage.GetPrototypes()}
        roots = Sdf.Path.RemoveDescendentPaths([*subtrees, *(prototypes ^ self.prototypes)])
        if Sdf.Path.absoluteRootPath in subtrees:
            roots = [Sdf.Path.absoluteRootPath, *prototypes]
            self.facts.clear()
        self.prototypes = prototypes
        gone = set(roots)
        self.facts = {path: found for path, found in self.facts.items() if not is_below(path, gone)}
        for root in roots:
            prim = stage.GetPrimAtPath(root)
            there = prim and not prim.IsInstanceProxy()
            for below in Usd.PrimRange(prim, Usd.PrimAllPrimsPredicate) if there else ():
                self.look(below.GetPath(), below)

    def look(self, path: Sdf.Path, prim: Usd.Prim) -> None:
        # What is in instances is in their prototypes.
        found = facts(prim) if prim and not prim.IsInstanceProxy() else NOTHING
        if found != NOTHING:
            self.facts[path] = found
        else:
            self.facts.pop(path, None)

    def lights(self, stage: Usd.Stage) -> list[Usd.Prim]:
        """By path. In instances those of every instance: a collection may name one of them."""
        paths = [path for path, found in self.fresh(stage).items() if found.light]
        prims = [prim for path in paths for prim in proxies(stage.GetPrimAtPath(path))]
        # Point instancers take prototypes that are `over` or `class`, too.
        return sorted((p for p in prims if p.IsActive() and p.IsLoaded()), key=Usd.Prim.GetPath)

    def domes(self, stage: Usd.Stage) -> list[Usd.Prim]:
        paths = [path for path, found in self.fresh(stage).items() if found.dome]
        return [prim for path in paths for prim in proxies(stage.GetPrimAtPath(path)) if shows(prim)]

    def cameras(self, stage: Usd.Stage, name: str) -> list[Usd.Prim]:
        """Those of a name, in no order."""
        paths = [path for path, found in self.fresh(stage).items() if found.camera]
        prims = [prim for path in paths for prim in proxies(stage.GetPrimAtPath(path))]
        return [prim for prim in prims if prim.GetName() == name and shows(prim)]

    def primvars_read(self, stage: Usd.Stage) -> set[str]:
        """Names of those that shaders read."""
        with self.lock:
            known = self.fresh(stage)
            if self._primvars is None:
                shaders = (stage.GetPrimAtPath(path) for path, found in known.items() if found.reads)
                self._primvars = {name for shader in shaders if shows(shader) for name in primvars_of(shader)}
            return self._primvars

    def movers(self, stage: Usd.Stage) -> list[tuple[Usd.Prim, Facts]]:
        """Prims with attributes of `MOVING` that have samples, or that go by other rules than straight ones."""
        known = self.fresh(stage).items()
        return [(stage.GetPrimAtPath(path), found) for path, found in known if found.moving or found.bends]

    def links(self, stage: Usd.Stage, render_pass: str = "") -> tuple[Links, Report]:
        """Light links and the collections of a pass, and what there is to be said of them. Expressions may ask for
        anything of the stage: what they find is not kept."""
        with self.lock:
            if self._links is None or not self._links[0].by_rules or self._render_pass != render_pass:
                report, prim = Report(), stage.GetPrimAtPath(render_pass) if render_pass else None
                self._links = Links(self.lights(stage), report, prim), report
                self._render_pass = render_pass
            return self._links

    def skeletons_of(self, root: Usd.Prim) -> Any:
        """UsdSkel.Cache of a SkelRoot; one each, for instances that share a skeleton may bind different animations to
        it."""
        from pxr import UsdSkel  # only where there are skeletons

        path = str(root.GetPath())
        with self.lock:
            if path not in self.skeletons:
                self.skeletons[path] = UsdSkel.Cache()
                self.skeletons[path].Populate(UsdSkel.Root(root), Usd.TraverseInstanceProxies())
            return self.skeletons[path]


INDICES: "WeakKeyDictionary[Usd.Stage, Index]" = WeakKeyDictionary()
MAKING = RLock()
"""Held while one is looked for: a stage has one index."""


def index_of(stage: Usd.Stage) -> Index:
    """The index of a stage, made when it is first asked for."""
    with MAKING:
        index = INDICES.get(stage)
        if index is None:
            index = INDICES[stage] = Index(stage)
        return index


def is_below(path: Sdf.Path, roots: set[Sdf.Path]) -> bool:
    """Whether `path` is one of `roots` or below one: in a time that does not grow with their number."""
    return Sdf.Path.absoluteRootPath in roots or not roots.isdisjoint(path.GetPrefixes())


def proxies(prim: Usd.Prim) -> Iterable[Usd.Prim]:
    """Where a prim is on the stage: by itself, or of a prototype in each of its instances."""
    if not prim.IsInPrototype():
        return (prim,)
    root = prim.GetPath().GetPrefixes()[0]
    stage, below = prim.GetStage(), prim.GetPath()
    instances = stage.GetPrimAtPath(root).GetInstances()
    places = (place for instance in instances for place in proxies(instance))
    return [stage.GetPrimAtPath(below.ReplacePrefix(root, place.GetPath())) for place in places]


def shows(prim: Usd.Prim) -> bool:
    """Whether a traversal comes across it."""
    return prim.IsActive() and prim.IsLoaded() and prim.IsDefined() and not prim.IsAbstract()
