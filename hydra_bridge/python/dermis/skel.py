"""UsdSkel: the points that a mesh has at a time, by blend shapes first and joints after them.

Everything is usd-core's own evaluation. Only normals, for which its Python has no function per mesh, are put together
here, as UsdSkelBakeSkinning does. Where a skeleton or a shape cannot be used the mesh stays at rest, and a warning
says so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pxr import Gf, Usd, UsdGeom, Vt

from .arrays import np
from .index import index_of
from .reading import Reader

if TYPE_CHECKING:
    from numpy.typing import NDArray

if TYPE_CHECKING:
    from pxr import UsdSkel

Mesh = dict[str, Any]


def is_skinned(prim: Usd.Prim) -> bool:
    """Whether joints or shapes may move its points."""
    names = prim.GetAuthoredPropertyNames()
    return prim.HasAPI("SkelBindingAPI") or any(n.startswith(("skel:", "primvars:skel:")) for n in names)


def skel_root(prim: Usd.Prim) -> Usd.Prim | None:
    """The SkelRoot around a prim."""
    while prim and not prim.IsA("SkelRoot"):
        prim = prim.GetParent()
    return prim or None


def bones_outside(instance: Usd.Prim) -> bool:
    """Whether what is in a native instance hangs on a skeleton that is not: the skeleton alone says where it stands."""
    from pxr import UsdSkel  # only where there are skeletons

    skeleton = UsdSkel.BindingAPI(instance).GetInheritedSkeleton()
    return bool(skeleton) and not skeleton.GetPath().HasPrefix(instance.GetPath())


class Skins:
    """Skeletons at one time, of each SkelRoot: instances that share a skeleton may bind different animations to it."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.xforms = UsdGeom.XformCache(reader.moment)
        #: Skinning transforms by SkelRoot and skeleton.
        self.joints: dict[tuple[str, str], Vt.Matrix4dArray | None] = {}

    def moved(self, prim: Usd.Prim, points: NDArray) -> NDArray:
        """Points of a prim that is not made of faces."""
        held: Mesh = {"points": points}
        self.deform(prim, held)
        return held["points"]

    def deform(self, prim: Usd.Prim, mesh: Mesh) -> None:
        """Moves `points` and `normals` of a flat mesh; outside a SkelRoot nothing moves (UsdSkel)."""
        root = skel_root(prim)
        if root is None:
            return
        from pxr import UsdSkel  # only where there are skeletons

        cache = index_of(prim.GetStage()).skeletons_of(root)
        query = cache.GetSkinningQuery(prim)
        if not query:
            return
        # Where it stands: the query has that of the prototype, which stands nowhere, of skeletons in instances.
        bound = UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
        skeleton = cache.GetSkelQuery(bound)
        if not skeleton:
            self.reader.warn(prim, "skel:skeleton: there is no usable skeleton; the mesh stays at rest")
            return
        points = Vt.Vec3fArray.FromNumpy(np.array(mesh["points"]))
        normals = Normals(mesh)
        if query.HasBlendShapes():
            self.blend(prim, query, skeleton, points, normals)
        mesh["points"] = np.asarray(points)
        if query.HasJointInfluences():
            joints = self.transforms(root, skeleton)
            mesh["points"] = self.skin(prim, query, bound.GetPrim(), joints, points, normals)
        normals.store(mesh)

    def transforms(self, root: Usd.Prim, skeleton: UsdSkel.SkeletonQuery) -> Vt.Matrix4dArray | None:
        """Of the joints, from rest."""
        key = str(root.GetPath()), str(skeleton.GetPrim().GetPath())
        if key not in self.joints:
            self.joints[key] = skeleton.ComputeSkinningTransforms(self.reader.moment)
        return self.joints[key]

    def blend(
        self,
        prim: Usd.Prim,
        query: UsdSkel.SkinningQuery,
        skeleton: UsdSkel.SkeletonQuery,
        points: Vt.Vec3fArray,
        normals: Normals,
    ) -> None:
        animation = skeleton.GetAnimQuery()
        weights = animation.ComputeBlendShapeWeights(self.reader.moment) if animation else None
        if not weights:
            return
        mapper = query.GetBlendShapeMapper()
        if mapper:
            weights = mapper.Remap(weights)
        from pxr import UsdSkel

        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
        sub_shapes = shapes.ComputeSubShapeWeights(weights)
        if not sub_shapes:
            self.reader.warn(prim, "skel:blendShapes: the weights do not fit the shapes; none is applied")
            return
        offsets = shapes.ComputeSubShapePointOffsets()
        indices = shapes.ComputeBlendShapePointIndices()
        if not shapes.ComputeDeformedPoints(*sub_shapes, indices, offsets, points):
            self.reader.warn(prim, "skel:blendShapeTargets: a shape does not fit the points; none is applied")
            return
        normals.blend(shapes, sub_shapes, indices)

    def skin(
        self,
        prim: Usd.Prim,
        query: UsdSkel.SkinningQuery,
        skeleton: Usd.Prim,
        joints: Vt.Matrix4dArray | None,
        points: Vt.Vec3fArray,
        normals: Normals,
    ) -> NDArray:
        """The points in the mesh's own space; joints move them in the skeleton's."""
        if not joints:
            self.reader.warn(prim, "skel:skeleton: it has no joint transforms; the mesh stays at rest")
            return np.asarray(points)
        to_mesh = self.xforms.GetLocalToWorldTransform(skeleton)
        to_mesh *= self.xforms.GetLocalToWorldTransform(prim).GetInverse()
        if query.IsRigidlyDeformed():
            to_mesh = query.ComputeSkinnedTransform(joints, self.reader.moment) * to_mesh
        elif query.ComputeSkinnedPoints(joints, points, self.reader.moment):
            normals.skin(query, joints, len(points), self.reader.moment)
        else:
            self.reader.warn(prim, "primvars:skel:jointIndices: they do not fit; the mesh stays at rest")
            return np.asarray(points)
        normals.transform(normal_matrix(to_mesh))
        matrix = np.array(to_mesh)
        return np.ascontiguousarray(np.asarray(points) @ matrix[:3, :3] + matrix[3, :3], np.float32)


class Normals:
    """Authored normals of a flat mesh while it is deformed; there are none where they are computed from the points."""

    def __init__(self, mesh: Mesh) -> None:
        primvar = mesh.get("normals")
        self.values: NDArray | None = None
        if primvar is None:
            return
        #: The point of each normal, where one belongs to one point.
        self.points = {
            "vertex": np.arange(len(mesh["points"])),
            "varying": np.arange(len(mesh["points"])),
            "faceVarying": np.asarray(mesh["faceVertexIndices"]),
        }.get(primvar["interpolation"])
        self.interpolation = primvar["interpolation"]
        values, indices = np.array(primvar["values"]), np.asarray(primvar.get("indices", ()))
        if len(indices) and (indices.min() < 0 or indices.max() >= len(values)):
            return  # which the core says
        self.values = values[indices] if len(indices) else values

    def blend(self, shapes: UsdSkel.BlendShapeQuery, sub_shapes: tuple, indices: list) -> None:
        """Adds the normal offsets of the shapes, by the weights of their sub-shapes; to normals per point only, as
        UsdSkelBakeSkinning does."""
        if self.values is None or self.interpolation not in ("vertex", "varying"):
            return
        sums = np.zeros(self.values.shape)
        for weight, shape, sub_shape in zip(*map(np.asarray, sub_shapes), strict=True):
            between = shapes.GetInbetween(int(sub_shape))
            offsets = (
                between.GetNormalOffsets()
                if between
                else shapes.GetBlendShape(int(shape)).GetNormalOffsetsAttr().Get()
            )
            if not offsets:
                continue
            touched = np.asarray(indices[int(shape)])
            sums[touched if len(touched) else np.arange(len(offsets))] += weight * np.asarray(offsets)
        self.values = normalized(self.values + sums)

    def skin(
        self, query: UsdSkel.SkinningQuery, joints: Vt.Matrix4dArray, count: int, time: Usd.TimeCode
    ) -> None:
        """By the inverse transposes of the joints' transforms, as UsdSkelSkinNormals has it."""
        influences = query.ComputeVaryingJointInfluences(count, time)
        if self.values is None or self.points is None or not influences:
            return
        mapper = query.GetJointMapper()
        if mapper:
            joints = mapper.RemapTransforms(joints)
        width = query.GetNumInfluencesPerComponent()
        indices, weights = (np.asarray(x).reshape(-1, width)[self.points].ravel() for x in influences)
        normals = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(self.values, np.float32))
        inverse_transposes = Vt.Matrix3dArray(
            [Gf.Matrix3d(*normal_matrix(joint).ravel().tolist()) for joint in joints]
        )
        from pxr import UsdSkel

        bind = Gf.Matrix3d(*normal_matrix(query.GetGeomBindTransform(time)).ravel().tolist())
        UsdSkel.SkinNormals(
            query.GetSkinningMethod(),
            bind,
            inverse_transposes,
            Vt.IntArray.FromNumpy(np.ascontiguousarray(indices, np.int32)),
            Vt.FloatArray.FromNumpy(np.ascontiguousarray(weights, np.float32)),
            width,
            normals,
        )
        self.values = np.asarray(normals)

    def transform(self, matrix: NDArray) -> None:
        if self.values is not None:
            self.values = normalized(self.values @ matrix)

    def store(self, mesh: Mesh) -> None:
        if self.values is not None:
            values = np.ascontiguousarray(self.values, np.float32)
            mesh["normals"] = {"interpolation": self.interpolation, "values": values}


def normal_matrix(matrix: Gf.Matrix4d) -> NDArray:
    """What normals as row vectors are multiplied with."""
    return np.linalg.inv(np.array(matrix)[:3, :3]).T


def normalized(vectors: NDArray) -> NDArray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)
