"""Material bindings by the purposes that the render settings ask for, in their order."""

from collections.abc import Sequence

from pxr import Usd, UsdShade

Bound = tuple[UsdShade.Material, Usd.Relationship]


def bound_materials(prims: Sequence[Usd.Prim], purposes: Sequence[str]) -> list[Bound]:
    """Material and binding of each prim: the first of `purposes` for which it has one; `""` are bindings for all
    purposes, which count where they are listed."""
    found: list[Bound | None] = [None] * len(prims)
    for purpose in purposes:
        left = [i for i, bound in enumerate(found) if bound is None]
        if not left:
            break
        compute = UsdShade.MaterialBindingAPI.ComputeBoundMaterials
        materials, sources = compute([prims[i] for i in left], purpose)
        for i, material, source in zip(left, materials, sources, strict=True):
            # USD itself goes on to bindings for all purposes; here that is decided by the list.
            if source and binding_purpose(source) == purpose:
                found[i] = (material, source)
    return [bound or (UsdShade.Material(), Usd.Relationship()) for bound in found]


def binding_purpose(relationship: Usd.Relationship) -> str:
    """Of `material:binding[:PURPOSE]` or `material:binding:collection[:PURPOSE]:NAME`; empty: for all purposes."""
    parts = relationship.GetName().split(":")[2:]
    if parts[:1] == ["collection"]:
        return parts[1] if len(parts) > 2 else ""
    return parts[0] if parts else ""
