//! Subdivision surfaces: uniform refinement of a cage, then every vertex to its limit.
//!
//! `cage` reads the tags of UsdGeomMesh into the first level, `topology` splits faces, `creases` has the
//! rules that all schemes share, `catmull_clark` and `loop_scheme` the smooth masks, `limit` the normals,
//! `face_varying` turns seams into boundaries. The rules are OpenSubdiv's (uniform creasing); `tests/subdivision.rs`
//! compares with its values.
//!
//! A level has four times the faces of the one before. While a mesh is refined, all its levels are in memory: by the
//! sizes of their arrays some 90 bytes for each face of the last, and as much again for one face-varying primvar at a
//! time. The build of the BVH of its triangles, which follows, needs more.

mod cage;
mod catmull_clark;
mod creases;
mod face_varying;
mod limit;
mod loop_scheme;
mod topology;

use crate::flat::{self, AnyPrimvar, Array, GeomSubset, Interpolation, Mesh, Orientation, Primvar, array::Element};
use cage::Cage;
use creases::Rules;
use face_varying::Linear;
use glam::{Vec2, Vec3, Vec4};
use topology::Topology;

/// UsdImaging's highest refine level.
pub const MAX_LEVEL: u32 = 8;

/// Faces beyond which a level is left out: indices are 32 bits, and a scene of so many has no memory left.
const MAX_FACES: u64 = 1 << 28;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scheme {
    CatmullClark { smooth_triangles: bool },
    Loop,
    Bilinear,
}

/// What was made of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// Refine level asked for, and the one that was made; 0: the cage.
    pub asked: u32,
    pub level: u32,
    pub cage_faces: usize,
    /// Tags and topology that could not be used, in words that begin with the attribute.
    pub faults: Vec<String>,
}

/// A mesh without subdivision that stands for the limit surface; its points are apart.
pub struct Refined {
    /// All but `points`.
    pub mesh: Mesh,
    pub points: Vec<Vec3>,
    pub refinement: Refinement,
}

/// A value that can be averaged.
trait Value:
    Copy + Default + std::ops::Add<Output = Self> + std::ops::Mul<f32, Output = Self> + std::ops::AddAssign
{
}
impl<T> Value for T where
    T: Copy + Default + std::ops::Add<Output = T> + std::ops::Mul<f32, Output = T> + std::ops::AddAssign
{
}

/// Whether a mesh is the cage of a subdivision surface.
pub fn is_subdivided(mesh: &Mesh) -> bool {
    mesh.subdivision_scheme != "none"
}

/// The limit surface of a validated mesh at `level` (1 or more) refinements. `points`: those of the mesh, in the space
/// that the result is wanted in.
pub fn refine(mesh: &Mesh, points: &[Vec3], level: u32) -> Refined {
    let (scheme, fault) = Scheme::of(mesh);
    let mut cage = Cage::build(mesh, scheme);
    cage.faults.extend(fault);
    let asked = level;
    let level = affordable(&mut cage, asked);
    let surface = Hierarchy::new(scheme, cage.topology.clone(), level);
    let control = surface.refine(points);
    let normals = surface.normals(&control, mesh.orientation);
    let last = surface.last();
    let per_face = |face: u32| (cage.faces_below(face, scheme, level), cage.face_source[face as usize]);
    let mut parents = vec![0; last.faces()];
    (0..cage.face_source.len() as u32).map(per_face).for_each(|(children, face)| parents[children].fill(face as i32));
    let primvars = Primvars { surface: &surface, cage: &cage, parents: &parents, linear: linear(mesh) };
    let refined = Mesh {
        points: Array::default(),
        face_vertex_counts: vec![if scheme == Scheme::Loop { 3 } else { 4 }; last.faces()].into(),
        face_vertex_indices: last.corner_vertex.iter().map(|v| *v as i32).collect::<Vec<_>>().into(),
        hole_indices: cage.holes.iter().flat_map(|f| per_face(*f).0).map(|f| f as i32).collect::<Vec<_>>().into(),
        subdivision_scheme: "none".into(),
        normals,
        primvars: mesh.primvars.iter().map(|(name, primvar)| (name.clone(), primvars.any(primvar))).collect(),
        display_color: mesh.display_color.as_ref().map(|p| primvars.refine::<_, Vec3>(p)),
        display_opacity: mesh.display_opacity.as_ref().map(|p| primvars.refine::<_, f32>(p)),
        geom_subsets: mesh.geom_subsets.iter().map(|subset| below(subset, &parents)).collect(),
        ..mesh.clone()
    };
    let refinement = Refinement { asked, level, cage_faces: cage.face_source.len(), faults: cage.faults };
    Refined { mesh: refined, points: surface.limit(&control), refinement }
}

/// Lowers a level that would make more faces than can be.
fn affordable(cage: &mut Cage, level: u32) -> u32 {
    let corners = cage.topology.corner_vertex.len() as u64;
    let fits = |level: &u32| corners << (2 * (level - 1)) <= MAX_FACES;
    let most = (1..=level.min(MAX_LEVEL)).rev().find(fits).unwrap_or(1);
    if most < level {
        let message = format!(
            "refineLevel: {level} would be more than {MAX_FACES} faces, or is above {MAX_LEVEL}; {most} is used"
        );
        cage.faults.push(message);
    }
    most
}

fn linear(mesh: &Mesh) -> Linear {
    Linear::named(&mesh.subdiv_tags.face_varying_linear_interpolation)
}

/// A subset with the faces below its own.
fn below(subset: &GeomSubset, parents: &[i32]) -> GeomSubset {
    let chosen: std::collections::HashSet<i32> = subset.indices.iter().copied().collect();
    let faces = parents.iter().enumerate().filter(|(_, parent)| chosen.contains(parent)).map(|(face, _)| face as i32);
    GeomSubset { indices: faces.collect::<Vec<_>>().into(), ..subset.clone() }
}

impl Scheme {
    fn of(mesh: &Mesh) -> (Self, Option<String>) {
        let catmull_clark =
            Self::CatmullClark { smooth_triangles: mesh.subdiv_tags.triangle_subdivision_rule == "smooth" };
        match mesh.subdivision_scheme.as_str() {
            "loop" => match mesh.face_vertex_counts.iter().filter(|n| **n != 3).count() {
                0 => (Self::Loop, None),
                n => {
                    let message =
                        format!("subdivisionScheme: loop needs triangles, {n} faces are none; catmullClark is used");
                    (catmull_clark, Some(message))
                }
            },
            "bilinear" => (Self::Bilinear, None),
            _ => (catmull_clark, None),
        }
    }

    fn split(self, t: &Topology) -> Topology {
        if self == Self::Loop { t.split_triangles() } else { t.split_into_quads() }
    }

    fn refine<T: Value>(self, t: &Topology, rules: &Rules, values: &[T], first: bool) -> Vec<T> {
        match self {
            Self::CatmullClark { smooth_triangles } => {
                catmull_clark::refine(t, rules, values, smooth_triangles && first)
            }
            Self::Loop => loop_scheme::refine(t, rules, values),
            Self::Bilinear => self.linear(t, values),
        }
    }

    /// Middles of edges and faces.
    fn linear<T: Value>(self, t: &Topology, values: &[T]) -> Vec<T> {
        let mut out = values.to_vec();
        out.extend(t.edges.iter().map(|[a, b]| (values[*a as usize] + values[*b as usize]) * 0.5));
        if self != Self::Loop {
            out.extend((0..t.faces()).map(|face| {
                let corners = &t.corner_vertex[t.corners(face)];
                corners.iter().fold(T::default(), |sum, v| sum + values[*v as usize]) * (1.0 / corners.len() as f32)
            }));
        }
        out
    }
}

impl Cage {
    /// The faces of the last level below one of the first: they follow each other.
    fn faces_below(&self, face: u32, scheme: Scheme, level: u32) -> std::ops::Range<usize> {
        let corners = self.topology.corners(face as usize);
        let first = if scheme == Scheme::Loop { 4 * face as usize..4 * (face as usize + 1) } else { corners };
        let scale = 4_usize.pow(level - 1);
        first.start * scale..first.end * scale
    }
}

/// All levels of one topology, the cage first.
struct Hierarchy {
    scheme: Scheme,
    levels: Vec<(Topology, Rules)>,
}

impl Hierarchy {
    fn new(scheme: Scheme, cage: Topology, level: u32) -> Self {
        let rules = Rules::of(&cage);
        let mut levels = vec![(cage, rules)];
        for i in 0..level as usize {
            let fine = scheme.split(&levels[i].0);
            let rules = Rules::of(&fine);
            levels.push((fine, rules));
        }
        Self { scheme, levels }
    }

    fn last(&self) -> &Topology {
        &self.levels[self.levels.len() - 1].0
    }

    /// Control values of the last level from those of the cage.
    fn refine<T: Value>(&self, values: &[T]) -> Vec<T> {
        let mut values = values.to_vec();
        for (i, (topology, rules)) in self.levels[..self.levels.len() - 1].iter().enumerate() {
            values = self.scheme.refine(topology, rules, &values, i == 0);
        }
        values
    }

    fn limit<T: Value>(&self, control: &[T]) -> Vec<T> {
        let (topology, rules) = &self.levels[self.levels.len() - 1];
        match self.scheme {
            Scheme::CatmullClark { .. } => catmull_clark::limit(topology, rules, control),
            Scheme::Loop => loop_scheme::limit(topology, rules, control),
            Scheme::Bilinear => control.to_vec(),
        }
    }

    fn linear<T: Value>(&self, values: &[T]) -> Vec<T> {
        let coarse = &self.levels[..self.levels.len() - 1];
        coarse.iter().fold(values.to_vec(), |values, (topology, _)| self.scheme.linear(topology, &values))
    }

    /// Limit normals; a bilinear surface has those of its faces.
    fn normals(&self, control: &[Vec3], orientation: Orientation) -> Option<Primvar<[f32; 3]>> {
        if self.scheme == Scheme::Bilinear {
            return None;
        }
        let (topology, rules) = &self.levels[self.levels.len() - 1];
        let normals = limit::normals(self.scheme, topology, rules, control);
        let outwards = if orientation == Orientation::LeftHanded { -1.0 } else { 1.0 };
        let unit = |n: Vec3| (n * outwards).normalize_or_zero().to_array();
        let values = normals.values.into_iter().map(unit).collect::<Vec<_>>().into();
        Some(if normals.by_vertex {
            Primvar { interpolation: Interpolation::Vertex, values, indices: None }
        } else {
            let indices = normals.of_corner.iter().map(|i| *i as i32).collect::<Vec<_>>().into();
            Primvar { interpolation: Interpolation::FaceVarying, values, indices: Some(indices) }
        })
    }
}

/// Refines primvars by their interpolation.
struct Primvars<'a> {
    surface: &'a Hierarchy,
    cage: &'a Cage,
    /// Face as authored of each face.
    parents: &'a [i32],
    linear: Linear,
}

impl Primvars<'_> {
    fn any(&self, primvar: &AnyPrimvar) -> AnyPrimvar {
        match primvar {
            AnyPrimvar::Float(primvar) => AnyPrimvar::Float(self.refine::<_, f32>(primvar)),
            AnyPrimvar::Float2(primvar) => AnyPrimvar::Float2(self.refine::<_, Vec2>(primvar)),
            AnyPrimvar::Float3(primvar) => AnyPrimvar::Float3(self.refine::<_, Vec3>(primvar)),
            AnyPrimvar::Float4(primvar) => AnyPrimvar::Float4(self.refine::<_, Vec4>(primvar)),
        }
    }

    fn refine<T: Element + Into<V>, V: Value + Into<T>>(&self, primvar: &Primvar<T>) -> Primvar<T> {
        let lower = |values: Vec<V>| values.into_iter().map(Into::into).collect::<Vec<T>>().into();
        let of_points = || -> Vec<V> {
            match &primvar.indices {
                Some(indices) => indices.iter().map(|i| primvar.values[*i as usize].into()).collect(),
                None => primvar.values.iter().map(|value| (*value).into()).collect(),
            }
        };
        let (values, indices): (Array<T>, Option<Array<i32>>) = match primvar.interpolation {
            Interpolation::Constant => return primvar.clone(),
            Interpolation::Uniform => {
                let of = |face: &i32| primvar.indices.as_ref().map_or(*face, |indices| indices[*face as usize]);
                let indices = self.parents.iter().map(of).collect::<Vec<_>>();
                (primvar.values.clone(), Some(indices.into()))
            }
            Interpolation::Vertex => (lower(self.surface.limit(&self.surface.refine(&of_points()))), None),
            Interpolation::Varying => (lower(self.surface.linear(&of_points())), None),
            Interpolation::FaceVarying => {
                let (values, indices) = self.face_varying::<T, V>(primvar);
                (lower(values), Some(indices))
            }
        };
        Primvar { interpolation: primvar.interpolation, values, indices }
    }

    fn face_varying<T: Element + Into<V>, V: Value>(&self, primvar: &Primvar<T>) -> (Vec<V>, Array<i32>) {
        let (topology, values) = face_varying::channel(self.cage, primvar, self.linear);
        let values: Vec<V> = values.into_iter().map(Into::into).collect();
        // Linear interpolation is bilinear subdivision, but of triangles where the faces are.
        let level = self.surface.levels.len() as u32 - 1;
        let hierarchy = Hierarchy::new(self.surface.scheme, topology, level);
        let values = match self.linear {
            Linear::All => hierarchy.linear(&values),
            _ => hierarchy.limit(&hierarchy.refine(&values)),
        };
        (values, hierarchy.last().corner_vertex.iter().map(|v| *v as i32).collect::<Vec<_>>().into())
    }
}

/// The level that a mesh is refined to under the settings: its own, else theirs; 0 where it is no cage.
pub fn level_of(mesh: &Mesh, settings: &flat::RenderSettings) -> u32 {
    if is_subdivided(mesh) { mesh.refine_level.unwrap_or(settings.refine_level) } else { 0 }
}
