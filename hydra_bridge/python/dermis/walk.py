"""The walk over the composed stage: what is rendered, where, and under which inherited state.

A *frame* is a subtree that is placed as a whole: the world (once), the prototype of native instances, or a
prototype of a point instancer. Every frame is walked once; instances only add placements. Instances of one
prototype that inherit different things (bindings, constant primvars, purpose) are different frames.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from pxr import Gf, Kind, Usd, UsdGeom, UsdShade, Vt

from .arrays import np
from .bindings import bound_materials
from .instancer import Placements, nested, place, point_instances
from .light import LIGHT_TYPES, UNSUPPORTED_LIGHTS
from .linking import Links, Placer
from .mesh import INHERITED_PRIMVARS, MESH_TYPES, choice
from .reading import Reader
from .skel import bones_outside

UNSUPPORTED_PRIMS = (
    "GenerativeProcedural",
    "NurbsCurves",
    "NurbsPatch",
    "ParticleField3DGaussianSplat",
    "TetMesh",
    "Volume",
)

WITH_LIGHT_API = (*LIGHT_TYPES, *UNSUPPORTED_LIGHTS, "PortalLight")
"""Types that have LightAPI built in; portals go with their domes."""

DRAW_MODES = ("cards", "bounds", "origin")
VISIBILITIES = ("inherited", "invisible")
PURPOSES = ("default", "render", "proxy", "guide")

IDENTITY = Gf.Matrix4d(1.0)
INSTANCES = Usd.TraverseInstanceProxies()
PROTOTYPES = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)
"""Point instancers take prototypes that are `over` or `class` too."""


@dataclass(frozen=True)
class Context:
    """What a prim has from its ancestors. `primvars`: name, primvar, bytes of its value; `bindings`: direct
    material bindings in force as (relationship, material, stronger than descendants); `skel`: skeleton and
    animation bound, as (relationship, targets); `placer`: the point instancer around it, where collections ask;
    `draw_mode`: what models are drawn as in place of their geometry."""

    visible: bool = True
    purpose: str = "default"
    primvars: tuple[tuple[str, UsdGeom.Primvar, bytes], ...] = ()
    bindings: tuple[tuple[str, str, bool], ...] = ()
    collections: bool = False
    skel: tuple[tuple[str, str], ...] = ()
    placer: Placer | None = None
    draw_mode: str = "default"

    def inherited(self) -> dict[str, UsdGeom.Primvar]:
        return {name: primvar for name, primvar, _ in self.primvars}


@dataclass(eq=False)
class Frame:
    """A subtree placed as a whole. `base` replaces the first `root` characters of prim paths to make keys;
    `instancer`: the point instancer that places it, the first of several."""

    base: str
    root: int
    predicate: Any
    in_point_instancer: bool = False
    instancer: Usd.Prim | None = None
    found: list["Found"] = field(default_factory=list)
    native: dict["Frame", list[Gf.Matrix4d]] = field(default_factory=dict)
    points: list[tuple["Frame", Placements]] = field(default_factory=list)

    def key(self, prim: Usd.Prim) -> str:
        return self.base + str(prim.GetPath())[self.root :]

    def edges(self) -> list[tuple["Frame", Placements]]:
        native = [
            (child, Placements(np.asarray(Vt.Matrix4dArray(matrices))))
            for child, matrices in self.native.items()
        ]
        return native + self.points


@dataclass
class Found:
    """A prim to render, of schema type `kind`; `matrix` is local to its frame; `emits`: a mesh that is a
    light too."""

    prim: Usd.Prim
    kind: str
    key: str
    matrix: Gf.Matrix4d
    context: Context
    emits: bool = False


class Walk:
    """Fills `world` and the frames below it."""

    def __init__(
        self,
        stage: Usd.Stage,
        reader: Reader,
        purposes: Iterable[str],
        binding_purposes: tuple[str, ...],
        links: Links,
    ) -> None:
        self.stage = stage
        self.reader = reader
        self.purposes = {"default", *purposes}
        self.binding_purposes = binding_purposes
        self.links = links
        self.xforms = UsdGeom.XformCache(reader.moment)
        self.world = Frame("", 0, INSTANCES)
        self.frames: dict[Any, Frame] = {}
        self.unsupported: dict[str, list[str]] = {}
        self.drawn_as: dict[str, list[str]] = {}
        # (prim, frame, context above, matrix of the parent, None at a prototype's root: no transform of its
        # own)
        self.open: list[tuple[Usd.Prim, Frame, Context, Gf.Matrix4d | None]] = []

    def run(self, root: Usd.Prim | None = None) -> dict[Frame, Placements]:
        """World placements by frame, the world among them, in a fixed order. `root`: only this prim and
        below."""
        if root is None or root.IsPseudoRoot():
            self.push(
                self.stage.GetPseudoRoot().GetFilteredChildren(INSTANCES), self.world, Context(), IDENTITY
            )
        else:
            parent = self.reader.transform(root, self.xforms.GetParentToWorldTransform, IDENTITY)
            self.push([root], self.world, ancestry(root, self.reader), parent)
        while self.open:
            prim, frame, context, parent = self.open.pop()
            try:
                self.visit(prim, frame, context, parent)
            except Exception as error:  # one bad prim must not cost the picture
                self.reader.warn(prim, f"cannot be read ({error}); it is not rendered")
        self.report_unsupported()
        frames = [self.world, *self.frames.values()]
        return place({f: f.edges() for f in frames}, self.world, self.warn_cycle)

    def push(self, prims: Iterable[Usd.Prim], frame: Frame, context: Context, parent: Gf.Matrix4d) -> None:
        self.open.extend((prim, frame, context, parent) for prim in reversed(list(prims)))

    def visit(self, prim: Usd.Prim, frame: Frame, context: Context, parent: Gf.Matrix4d | None) -> None:
        context = descend(prim, context, self.reader)
        if self.links.prunes(prim.GetPath(), context.placer):
            context = replace(context, visible=False)
        context = self.drawn(prim, context)
        frame, matrix = self.matrix(prim, frame, parent)
        kind = str(prim.GetPrimTypeInfo().GetSchemaTypeName())
        if kind == "PointInstancer":
            if context.purpose in self.purposes and context.visible:
                self.point_instancer(prim, frame, context, matrix)
            return
        self.note(prim, kind, frame, context, matrix)
        if prim.IsInstance():
            self.native_instance(prim, frame, context, matrix)
        else:
            self.push(prim.GetFilteredChildren(frame.predicate), frame, context, matrix)

    def drawn(self, prim: Usd.Prim, context: Context) -> Context:
        """Notes a model that usdrecord draws as something else (UsdGeomModelAPI); what is in it goes with it."""
        mode = context.draw_mode
        if mode not in DRAW_MODES or not context.visible or not applies_draw_mode(prim):
            return context
        self.drawn_as.setdefault(mode, []).append(str(prim.GetPath()))
        return replace(context, draw_mode="default")

    def matrix(self, prim: Usd.Prim, frame: Frame, parent: Gf.Matrix4d | None) -> tuple[Frame, Gf.Matrix4d]:
        """Frame and prim-to-frame; a reset of the transform stack takes a prim out of its native instance."""
        if parent is None:
            return frame, IDENTITY
        local, resets = self.local(prim)
        if not resets:
            return frame, local * parent
        # Inside a point instancer a reset ends at the prototype's root, as in Hydra.
        return frame if frame.in_point_instancer else self.world, local

    def local(self, prim: Usd.Prim) -> tuple[Gf.Matrix4d, bool]:
        """Prim to parent, and whether it starts anew from the world."""
        return self.reader.transform(prim, self.xforms.GetLocalTransformation, (IDENTITY, False))

    def note(self, prim: Usd.Prim, kind: str, frame: Frame, context: Context, matrix: Gf.Matrix4d) -> None:
        """Adds a prim to the frame if it is one that renders."""
        if not self.links.shows(prim.GetPath(), context.placer):
            context = replace(context, visible=False)
        if kind in MESH_TYPES:
            if context.purpose in self.purposes:
                emits = prim.HasAPI("LightAPI")
                frame.found.append(Found(prim, kind, frame.key(prim), matrix, context, emits))
        elif kind == "Points":
            if context.purpose in self.purposes:
                frame.found.append(Found(prim, kind, frame.key(prim), matrix, context))
        elif kind in LIGHT_TYPES or kind == "Camera":
            frame.found.append(Found(prim, kind, frame.key(prim), matrix, context))
        elif kind in UNSUPPORTED_LIGHTS:
            self.reader.warn(prim, f"{kind} is not supported yet; ignored")
        elif kind in UNSUPPORTED_PRIMS and context.purpose in self.purposes and context.visible:
            self.unsupported.setdefault(kind, []).append(str(prim.GetPath()))
        elif not kind and prim.GetTypeName():
            unknown = f"'{prim.GetTypeName()}', a type that USD does not know,"
            self.unsupported.setdefault(unknown, []).append(str(prim.GetPath()))
        if kind not in (*MESH_TYPES, *WITH_LIGHT_API) and prim.HasAPI("LightAPI"):
            what = kind or "prim without a type"
            self.reader.warn(prim, f"LightAPI: a {what} does not shine; the API is for meshes")

    def native_instance(self, prim: Usd.Prim, frame: Frame, context: Context, matrix: Gf.Matrix4d) -> None:
        if not context.visible:
            return
        signature = (prim.GetPrototype().GetPath(), frame.predicate is PROTOTYPES, frame.in_point_instancer)
        signature += (context.purpose, tuple((name, value) for name, _, value in context.primvars))
        signature += (self.bound_below(prim) if context.collections else context.bindings, context.skel)
        signature += (self.links.below(prim, frame.predicate, context.placer), context.placer)
        signature += (prim.GetPath() if context.skel and bones_outside(prim) else None,)
        child = self.frames.get(signature)
        if child is None:
            child = Frame(
                frame.key(prim), len(str(prim.GetPath())), frame.predicate, frame.in_point_instancer
            )
            self.frames[signature] = child
            self.push(prim.GetFilteredChildren(child.predicate), child, context, IDENTITY)
        frame.native.setdefault(child, []).append(matrix)

    def bound_below(self, instance: Usd.Prim) -> tuple[str, ...]:
        """Materials of everything in an instance: what collection bindings, which name paths, make of it."""
        prims = [
            p for p in Usd.PrimRange(instance, INSTANCES) if p.IsA(UsdGeom.Imageable) or p.IsA(UsdGeom.Subset)
        ]
        bound = bound_materials(prims, self.binding_purposes)
        return tuple(canonical_path(m.GetPrim()) if m else "" for m, _ in bound)

    def point_instancer(self, prim: Usd.Prim, frame: Frame, context: Context, matrix: Gf.Matrix4d) -> None:
        indices, placements = point_instances(prim, self.reader)
        targets = prim.GetRelationship("prototypes").GetForwardedTargets()
        for i in np.unique(indices):
            prototype = self.stage.GetPrimAtPath(targets[i])
            if not prototype or not prototype.IsActive():
                self.reader.warn(
                    prim, f"prototypes: {targets[i]} does not exist; its instances are not rendered"
                )
                continue
            child = self.prototype_frame(prim, int(i), prototype, frame, context)
            local = self.local(prototype)[0]
            chosen = indices == i
            instances = nested(np.array(local)[None], placements.matrices[chosen] @ np.array(matrix))
            primvars = {name: values[chosen] for name, values in placements.primvars.items()}
            frame.points.append((child, Placements(instances, primvars)))

    def prototype_frame(
        self, prim: Usd.Prim, i: int, prototype: Usd.Prim, frame: Frame, context: Context
    ) -> Frame:
        placer = self.links.placed_by(prim.GetPath(), context.placer)
        signature = (prototype.GetPath(), context.purpose, placer)
        child = self.frames.get(signature)
        if child is None:
            base = f"{frame.key(prim)}.prototypes[{i}]"
            child = Frame(base, len(str(prototype.GetPath())), PROTOTYPES, True, prim)
            self.frames[signature] = child
            above = ancestry(prototype, self.reader)
            inherited = replace(above, visible=True, purpose=context.purpose, placer=placer)
            self.open.append((prototype, child, inherited, None))
        return child

    def warn_cycle(self, frame: Frame) -> None:
        self.reader.warn(
            frame.base, "prototypes: a prototype contains its own instancer; the inner is not rendered"
        )

    def report_unsupported(self) -> None:
        for kind, paths in self.unsupported.items():
            others = f"; nor are {', '.join(map(str, paths[1:]))}" if paths[1:] else ""
            self.reader.warn(paths[0], f"{kind} is not rendered yet{others}")
        for mode, paths in self.drawn_as.items():
            others = f"; so {'are' if paths[2:] else 'is'} {', '.join(paths[1:])}" if paths[1:] else ""
            self.reader.warn(
                paths[0], f"model:drawMode: '{mode}' is not drawn; the model itself is rendered{others}"
            )


def applies_draw_mode(prim: Usd.Prim) -> bool:
    """Components do, and what says so."""
    apply = prim.GetAttribute("model:applyDrawMode")
    return Usd.ModelAPI(prim).IsKind(Kind.Tokens.component) or bool(apply and apply.Get() is True)


def descend(prim: Usd.Prim, context: Context, reader: Reader) -> Context:
    """The context of a prim from that of its parent."""
    changes: dict[str, Any] = {}
    names = prim.GetAuthoredPropertyNames()
    if "visibility" in names and choice(prim, "visibility", VISIBILITIES, reader) == "invisible":
        changes["visible"] = False
    if "purpose" in names:
        changes["purpose"] = choice(prim, "purpose", PURPOSES, reader)
    if "model:drawMode" in names:
        mode = prim.GetAttribute("model:drawMode").Get()
        changes["draw_mode"] = context.draw_mode if mode in (None, "inherited") else mode
    if any(name.startswith("primvars:") for name in names):
        changes["primvars"] = constant_primvars(prim, context, reader)
    if any(name.startswith("material:binding") for name in names):
        changes["bindings"] = direct_bindings(prim, context)
        changes["collections"] = context.collections or any("binding:collection" in name for name in names)
    if any(name.startswith("skel:") for name in names):
        changes["skel"] = skel_bindings(prim, context)
    return replace(context, **changes) if changes else context


def skel_bindings(prim: Usd.Prim, context: Context) -> tuple:
    """Skeleton and animation are inherited (UsdSkelBindingAPI)."""
    bindings = dict(context.skel)
    for name in ("skel:skeleton", "skel:animationSource"):
        relationship = prim.GetRelationship(name)
        if relationship and relationship.HasAuthoredTargets():
            targets = relationship.GetForwardedTargets()
            bindings[name] = " ".join(canonical(prim.GetStage(), path) for path in targets)
    return tuple(sorted(bindings.items()))


def constant_primvars(prim: Usd.Prim, context: Context, reader: Reader) -> tuple:
    """Constant primvars are inherited; one of another interpolation ends that (UsdGeomPrimvarsAPI)."""
    primvars = {entry[0]: entry for entry in context.primvars}
    api = UsdGeom.PrimvarsAPI(prim)
    for name in (*INHERITED_PRIMVARS, *reader.primvars):
        primvar = api.GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()):
            continue
        primvars.pop(name, None)
        if primvar.GetInterpolation() == UsdGeom.Tokens.constant:
            primvars[name] = (name, primvar, repr(primvar.ComputeFlattened(reader.time)).encode())
    return tuple(primvars.values())


def direct_bindings(prim: Usd.Prim, context: Context) -> tuple:
    """Per purpose the nearest binding holds, unless one above is stronger than descendants."""
    bindings = {entry[0]: entry for entry in context.bindings}
    for relationship in prim.GetAuthoredPropertiesInNamespace("material"):
        name = str(relationship.GetName())
        if not name.startswith("material:binding") or not isinstance(relationship, Usd.Relationship):
            continue
        if name in bindings and bindings[name][2]:
            continue
        stronger = UsdShade.MaterialBindingAPI.GetMaterialBindingStrength(relationship)
        targets = [canonical(prim.GetStage(), path) for path in relationship.GetForwardedTargets()]
        bindings[name] = (name, " ".join(targets), stronger == UsdShade.Tokens.strongerThanDescendants)
    return tuple(sorted(bindings.values()))


def ancestry(prim: Usd.Prim, reader: Reader) -> Context:
    """The context above a prim anywhere on the stage."""
    chain = []
    parent = prim.GetParent()
    while parent and not parent.IsPseudoRoot():
        chain.append(parent)
        parent = parent.GetParent()
    context = Context()
    for ancestor in reversed(chain):
        context = descend(ancestor, context, reader)
    return context


def canonical(stage: Usd.Stage, path: Any) -> str:
    prim = stage.GetPrimAtPath(path)
    return canonical_path(prim) if prim else str(path)


def canonical_path(prim: Usd.Prim) -> str:
    """One path for a prim that native instances share: that below the first instance of its prototype.

    Prototype names change from open to open, instance paths do not.
    """
    if prim.IsInstanceProxy():
        prim = prim.GetPrimInPrototype()
    if not prim.IsInPrototype():
        return str(prim.GetPath())
    root = prim.GetPath().GetPrefixes()[0]
    instances = prim.GetStage().GetPrimAtPath(root).GetInstances()
    first = min(canonical_path(instance) for instance in instances)
    return first + str(prim.GetPath())[len(str(root)) :]
