"""Collections that say what takes part: what a light lights and what casts its shadows, as Hydra's categories, and what
a RenderPass shows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pxr import Sdf, Usd, UsdGeom

from .reading import Report, usd_words

LINKS = ("lightLink", "shadowLink")
PASS = ("renderVisibility", "prune")


@dataclass(frozen=True)
class Placer:
    """The innermost point instancer around a prim, and which collections it is in as a whole."""

    path: Sdf.Path
    within: tuple[bool, ...]


class Collection:
    """Membership of paths, as UsdCollectionAPI has it."""

    def __init__(self, name: str, query: Any) -> None:
        self.name = name
        self.query = query
        self.rules = query.GetAsPathExpansionRuleMap() if query.UsesPathExpansionRuleMap() else None

    def has(self, path: Sdf.Path, placer: tuple[Sdf.Path, bool] | None = None) -> bool:
        """Whether the prim is a member. `placer`: the point instancer that places it, and whether that is one: a
        collection that names nothing nearer to the prim means the instancer by it."""
        own = bool(self.query.IsPathIncluded(path))
        if placer is None:
            return own
        instancer, within = placer
        return own if self.singles_out(path, instancer, own) else within

    def singles_out(self, path: Sdf.Path, instancer: Sdf.Path, own: bool) -> bool:
        """Whether it says something of the prim that it does not say of the instancer anyway."""
        if self.rules is not None:
            named = (prefix for prefix in path.GetPrefixes() if prefix in self.rules)
            return any(not instancer.HasPrefix(prefix) for prefix in named)
        return path.HasPrefix(instancer) and own != bool(self.query.IsPathIncluded(instancer))


class Links:
    """The collections of a stage's lights that leave something out, equal ones once, and those of the pass.

    Rules name few paths, instances are many: what no rule names is a member where its neighbours are, so rules are
    asked once for all of them.
    """

    def __init__(
        self, lights: Iterable[Usd.Prim], report: Report, render_pass: Usd.Prim | None = None
    ) -> None:
        self.collections: list[Collection] = []
        self.names: dict[tuple[str, str], str] = {}
        known: dict[Any, str] = {}
        for prim in lights:
            for link in LINKS:
                self.add(prim, link, known, report)
        #: Those before are the lights'.
        self.linked = len(self.collections)
        #: Index of the pass's collections, by name.
        self.of_pass: dict[str, int] = {}
        if render_pass:
            self.add_pass(render_pass, report)
        #: Whether rules are all there is; expressions know more of a prim than its path.
        self.by_rules = all(collection.rules is not None for collection in self.collections)
        self._named = {path for collection in self.collections for path in collection.rules or ()}
        self._above = {above for path in self._named for above in path.GetParentPath().GetPrefixes()}
        self._above.add(Sdf.Path.absoluteRootPath)
        self._members: dict[tuple[Sdf.Path, Placer | None], tuple[bool, ...]] = {}

    def add_pass(self, prim: Usd.Prim, report: Report) -> None:
        """Of a RenderPass; what it does not author leaves nothing out."""
        for name in filter(lambda name: is_authored(prim, name), PASS):
            if collection := collected(prim, name, report, "every prim is rendered"):
                self.of_pass[name] = len(self.collections)
                self.collections.append(collection)

    def add(self, prim: Usd.Prim, link: str, known: dict[Any, str], report: Report) -> None:
        collection = collected(prim, link, report, "the light is for everything")
        if collection is None or collection.rules == {Sdf.Path.absoluteRootPath: "expandPrims"}:
            return
        key = tuple(sorted(collection.rules.items())) if collection.rules is not None else collection.name
        if key not in known:
            known[key] = collection.name
            self.collections.append(collection)
        self.names[str(prim.GetPath()), link] = known[key]

    def name(self, prim: Usd.Prim, link: str) -> str:
        """Category of a light's collection; empty: everything."""
        return self.names.get((str(prim.GetPath()), link), "")

    def memberships(self, path: Sdf.Path, placer: Placer | None) -> tuple[bool, ...]:
        """Of a prim, per collection."""
        if not self.by_rules or path in self._named:
            return self.asked(path, placer)
        alike = path.GetParentPath(), placer
        if alike not in self._members:
            self._members[alike] = self.asked(path, placer)
        return self._members[alike]

    def asked(self, path: Sdf.Path, placer: Placer | None) -> tuple[bool, ...]:
        if placer is None:
            return tuple(c.has(path) for c in self.collections)
        within = zip(self.collections, placer.within, strict=True)
        return tuple(c.has(path, (placer.path, inside)) for c, inside in within)

    def categories(self, path: Sdf.Path, placer: Placer | None) -> list[str]:
        """Names of the lights' collections that a prim is in."""
        if not self.linked:
            return []
        within = zip(self.collections[: self.linked], self.memberships(path, placer), strict=False)
        return [collection.name for collection, inside in within if inside]

    def shows(self, path: Sdf.Path, placer: Placer | None) -> bool:
        """Whether the pass has a prim among those rendered."""
        place = self.of_pass.get("renderVisibility")
        return place is None or self.memberships(path, placer)[place]

    def prunes(self, path: Sdf.Path, placer: Placer | None) -> bool:
        """Whether the pass takes a prim away, and what is below it."""
        place = self.of_pass.get("prune")
        return place is not None and self.memberships(path, placer)[place]

    def below(self, instance: Usd.Prim, predicate: Any, placer: Placer | None) -> tuple:
        """What is in which collection within a native instance: alike instances give alike answers."""
        path = instance.GetPath()
        own = self.memberships(path, placer)
        if self.by_rules and path not in self._above:
            return own
        prims: Iterable[Usd.Prim] = Usd.PrimRange(instance, predicate)
        shown = [p.GetPath() for p in prims if p.IsA(UsdGeom.Imageable)]
        return (own, *(self.memberships(p, placer) for p in shown))

    def placed_by(self, instancer: Sdf.Path, placer: Placer | None) -> Placer | None:
        """For the prototypes of a point instancer; None where nothing is linked."""
        return Placer(instancer, self.memberships(instancer, placer)) if self.collections else None


def collected(prim: Usd.Prim, name: str, report: Report, without: str) -> Collection | None:
    """A collection of a prim; none, and what that means, where it is damaged: it must not cost the picture."""
    try:
        query = Usd.CollectionAPI(prim, name).ComputeMembershipQuery()
    except Exception as error:
        report.warn(prim, f"collection:{name}: {usd_words(error)}; {without}")
        return None
    return Collection(f"{prim.GetPath()}.collection:{name}", query)


def is_authored(prim: Usd.Prim, name: str) -> bool:
    return any(found.IsAuthored() for found in prim.GetPropertiesInNamespace(f"collection:{name}"))
