"""From what the walk found to the flat prims: arrays read, materials bound, instances placed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pxr import Gf, Usd

from .arrays import np
from .bindings import bound_materials
from .camera import flatten_camera
from .instancer import Placements, nested
from .light import flatten_light
from .linking import Links
from .material import flatten_material
from .mesh import MESH_TYPES, flatten_mesh, flatten_read_primvars, flatten_subsets, of_medium
from .reading import Reader
from .shaders import HAIR
from .skel import Skins, is_skinned
from .sync_mode import respond, sync_mode
from .udim import warn_missing_tiles
from .walk import Found, Frame, canonical_path

Prim = dict[str, Any]


@dataclass
class Still:
    """What was read of a mesh without samples: fields, and the primvars that materials read, by their names."""

    fields: Prim
    primvars: dict[Any, Prim] = field(default_factory=dict)


class Emitter:
    """Collects the prims of one flattening."""

    def __init__(
        self, reader: Reader, binding_purposes: tuple[str, ...], domes_visible: bool, links: Links
    ) -> None:
        self.reader = reader
        self.links = links
        self.binding_purposes = binding_purposes
        self.domes_visible = domes_visible
        self.skins = Skins(reader)
        self.prims: dict[str, Prim] = {}
        # Images of lights and of materials.
        self.textures: dict[str, Prim] = {}
        self.images: dict[str, Prim] = {}
        # Instancers that place a mesh at all.
        self.instancers: set[str] = set()
        # Where the path of the material bound to a prim goes; all bindings are resolved in one batch.
        self.bindables: list[tuple[Usd.Prim, Prim]] = []
        # Meshes whose primvars wait for their materials to say which they read.
        self.meshes: list[tuple[Found, Prim]] = []
        # Meshes without samples: of this flattening, and of one before.
        self.still: dict[str, Still] = {}
        self.known: dict[str, Still] = {}
        # Mesh lights whose sync mode waits for their materials: mode, mesh, light.
        self.synced: list[tuple[Found, str, Prim, Prim]] = []

    def emit(self, placements: dict[Frame, Placements]) -> dict[str, Prim]:
        """Flat prims by key, from the frames and their world placements."""
        for frame, of_frame in placements.items():
            if len(of_frame):
                self.frame(frame, of_frame)
        self.bind()
        for found, mode, mesh, light in self.synced:
            respond(found.prim, mode, mesh, [light], self.prims, self.reader)
        for found, mesh in self.meshes:
            self.guarded(found, lambda found=found, mesh=mesh: self.read_primvars(found, mesh))
        return {**self.prims, **self.textures, **self.images}

    def frame(self, frame: Frame, placements: Placements) -> None:
        is_world = frame.root == 0
        instancer = "" if is_world else f"{frame.base}.instances"
        for found in frame.found:
            self.guarded(found, lambda found=found: self.prim(found, placements, instancer))
        if instancer in self.instancers:
            self.prims[instancer] = self.instancer(placements)

    def guarded(self, found: Found, emit: Callable[[], None]) -> None:
        try:
            emit()
        except Exception as error:  # one bad prim must not cost the picture
            self.reader.warn(found.prim, f"cannot be read ({error}); it is not rendered")

    def prim(self, found: Found, placements: Placements, instancer: str) -> None:
        if found.kind == "Camera":
            # A camera inside instances counts once, where the first of them stands.
            matrix = local_to_world(found, placements)[0]
            self.prims[found.key] = flatten_camera(found.prim, self.reader, matrix)
        elif found.kind == "Points":
            self.points(found, placements)
        elif found.kind not in MESH_TYPES:
            textures = self.textures if found.context.visible else None
            light = flatten_light(found.prim, found.kind, self.reader, textures, self.domes_visible)
            if not found.key.endswith(f"/{found.prim.GetName()}"):
                light["prim"] = str(found.prim.GetPath())
            self.lights(found, light, placements, [""] * len(placements))
        elif found.emits:
            self.mesh_lights(found, placements)
        elif (mesh := self.mesh(found)) is not None:
            mesh["transform"] = self.reader.matrix(found.prim, found.matrix)
            mesh["instancer"] = instancer
            self.prims[found.key] = mesh
            self.instancers.update({instancer} - {""})

    def categorize(self, found: Found, mesh: Prim) -> None:
        categories = self.links.categories(found.prim.GetPath(), found.context.placer)
        if categories:
            mesh["categories"] = categories

    def mesh(self, found: Found) -> Prim | None:
        """The mesh without its place; its bindings are noted for `bind`."""
        fields = self.fields(found)
        if fields is None:
            return None
        mesh = {"type": "Mesh", "visible": found.context.visible, "material": "", "instancer": "", **fields}
        self.categorize(found, mesh)
        self.bindables.append((found.prim, mesh))
        self.meshes.append((found, mesh))
        subsets = flatten_subsets(found.prim, found.kind, self.reader)
        self.bindables.extend(subsets)
        mesh["geomSubsets"] = [subset for _, subset in subsets]
        return mesh

    def fields(self, found: Found) -> Prim | None:
        """As they were read before, where they cannot be others."""
        still = self.known.get(found.key)
        if still is None:
            said = len(self.reader.report.warnings)
            inherited = found.context.inherited()
            fields = flatten_mesh(found.prim, found.kind, self.reader, inherited, self.skins)
            if fields is None or len(self.reader.report.warnings) > said or not is_still(found):
                return fields
            still = Still(fields)
        self.still[found.key] = still
        return dict(still.fields)

    def points(self, found: Found, placements: Placements) -> None:
        """A sphere, and an instancer of its own that places it for every point in every placement of the prim."""
        from .points import flatten_points

        spheres = flatten_points(found.prim, self.reader, found.context.inherited(), self.skins)
        if spheres is None:
            return
        key = f"{found.key}.points"
        fields = {"type": "Mesh", "visible": found.context.visible, "material": "", "instancer": key}
        medium = of_medium(found.prim, found.context.inherited(), self.reader)
        mesh = self.prims[found.key] = {**fields, **spheres.mesh, **medium}
        self.categorize(found, mesh)
        self.bindables.append((found.prim, mesh))
        colors = {} if spheres.colors is None else {"displayColor": spheres.colors}
        outer = Placements(nested(np.array(found.matrix)[None], placements.matrices), placements.primvars)
        self.prims[key] = self.instancer(Placements(spheres.matrices, colors).within(outer))

    def instancer(self, placements: Placements) -> Prim:
        """Fields of `flat::Instancer`; displayColor has a place of its own beside those that materials read."""
        transforms = np.ascontiguousarray(placements.matrices)
        instancer: Prim = {"type": "Instancer", "visible": True, "transforms": transforms}
        primvars = {name: np.ascontiguousarray(values) for name, values in placements.primvars.items()}
        if (colors := primvars.get("displayColor")) is not None and colors.shape[1] == 3:
            instancer["displayColor"] = colors
        read = {name: primvar_fields(primvars[name]) for name in self.reader.primvars if name in primvars}
        return {**instancer, "primvars": read} if read else instancer

    def mesh_lights(self, found: Found, placements: Placements) -> None:
        """A mesh light is a mesh and a light; inside instances each placement gets its own pair."""
        mesh = self.mesh(found)
        if mesh is None:
            return
        light = flatten_light(found.prim, "Mesh", self.reader, self.textures, self.domes_visible)
        keys = (
            [key + ".mesh" for key in placed_keys(found.key, len(placements))]
            if len(placements) > 1
            else [found.key]
        )
        copies = [mesh] + [dict(mesh) for _ in keys[1:]]
        self.bindables.extend((found.prim, copy) for copy in copies[1:])
        self.meshes.extend((found, copy) for copy in copies[1:])
        for key, copy, matrix in zip(keys, copies, local_to_world(found, placements), strict=True):
            copy["transform"] = self.reader.matrix(found.prim, matrix)
            self.prims[key] = copy
        placed = self.lights(found, light, placements, keys)
        mode = sync_mode(found.prim, self.reader)
        self.synced.extend(
            (found, mode, self.prims[key], light) for key, light in zip(keys, placed, strict=True)
        )

    def lights(self, found: Found, light: Prim, placements: Placements, meshes: list[str]) -> list[Prim]:
        links = {
            "lightLink": self.links.name(found.prim, "lightLink"),
            "shadowLink": self.links.name(found.prim, "shadowLink"),
        }
        keys = placed_keys(found.key + (".light" if found.emits else ""), len(placements))
        for key, mesh, matrix in zip(keys, meshes, local_to_world(found, placements), strict=True):
            shape = {**light["shape"], "mesh": mesh} if mesh else light["shape"]
            transform = self.reader.matrix(found.prim, matrix)
            self.prims[key] = {
                **light,
                **links,
                "transform": transform,
                "visible": found.context.visible,
                "shape": shape,
            }
        return [self.prims[key] for key in keys]

    def bind(self) -> None:
        """Material bindings of all meshes and subsets, and the materials they name."""
        prims = [prim for prim, _ in self.bindables]
        bound = bound_materials(prims, self.binding_purposes)
        for (prim, fields), (material, source) in zip(self.bindables, bound, strict=True):
            if material:
                fields["material"] = self.material(material.GetPrim())
            elif source and (targets := source.GetTargets()):
                self.reader.warn(
                    prim, f"{source.GetName()}: {targets[-1]} is no material; displayColor is used"
                )

    def read_primvars(self, found: Found, mesh: Prim) -> None:
        """The primvars that the materials of a mesh read, and what they are for where they have no fallback."""
        names: dict[str, str] = {}
        hair = False
        for key in (mesh["material"], *(subset["material"] for subset in mesh["geomSubsets"])):
            material = self.prims.get(key, {})
            hair |= material.get("shader") == HAIR.name
            for network in networks(material):
                if network["tangents"]:
                    names.setdefault(network["tangents"], "")
                for node in network["nodes"]:
                    if node["node"] == "primvar":
                        plain = not any(node["fallback"])
                        names[node["varname"]] = key if plain else names.get(node["varname"], "")
        for name in self.reader.shown:
            names.setdefault(name, "")
        # Where instances have a value, a mesh without one is nothing to be said.
        for name in self.prims.get(mesh["instancer"], {}).get("primvars", ()):
            if name in names:
                names[name] = ""
        if names or hair:
            primvars = self.primvars(found, mesh, names, hair)
            if primvars:
                mesh["primvars"] = primvars
                warn_missing_tiles(found.prim, mesh, self.prims, self.reader)

    def primvars(self, found: Found, mesh: Prim, names: dict[str, str], hair: bool) -> Prim:
        """As `fields`."""
        still, asked = self.still.get(found.key), (tuple(names.items()), hair)
        if still and asked in still.primvars:
            return still.primvars[asked]
        said = len(self.reader.report.warnings)
        above = found.context.inherited()
        primvars = flatten_read_primvars(
            found.prim, found.kind, mesh, names, hair, self.reader, above, self.skins
        )
        if still and len(self.reader.report.warnings) == said:
            still.primvars[asked] = primvars
        return primvars

    def material(self, prim: Usd.Prim) -> str:
        key = canonical_path(prim)
        if key not in self.prims:
            try:
                self.prims[key] = flatten_material(prim, self.reader, self.images)
            except Exception as error:  # as above
                self.reader.warn(prim, f"cannot be read ({error}); displayColor is used")
                self.prims[key] = {"type": "Material", "shader": "UsdPreviewSurface"}
        return key


def is_still(found: Found) -> bool:
    """Whether a mesh is the same at all times: nothing of it has samples, velocities or joints."""
    prim, names = found.prim, found.prim.GetAuthoredPropertyNames()
    if "velocities" in names or found.context.skel or is_skinned(prim):
        return False
    # A primvar's indices, too, may have samples.
    inherited = found.context.inherited().values()
    return not any(a.ValueMightBeTimeVarying() for a in (*prim.GetAuthoredAttributes(), *inherited))


def primvar_fields(values: Any) -> Prim:
    width = values.shape[1]
    kind = "float" if width == 1 else f"float{width}"
    return {"type": kind, "interpolation": "vertex", "values": values.reshape(-1) if width == 1 else values}


def networks(material: Prim) -> list[Prim]:
    return [material[name] for name in ("network", "displacement") if name in material]


def local_to_world(found: Found, placements: Placements) -> list[Gf.Matrix4d]:
    if placements.placed is None:
        return [found.matrix]
    matrices = nested(np.array(found.matrix)[None], placements.placed)
    return [Gf.Matrix4d(*matrix) for matrix in matrices.reshape(-1, 16).tolist()]


def placed_keys(key: str, count: int) -> list[str]:
    return [key] if count == 1 else [f"{key}[{i}]" for i in range(count)]
