//! Displacement: the points of a mesh moved along its smooth normal by what its materials say, in object units.
//!
//! A position has one offset, the mean over all corners that meet there: seams of texture coordinates, of materials and
//! of split points stay closed. An image is filtered over the edges of the triangle, so that the mesh can follow it.

use super::attribute::{Attribute, Values};
use super::image::{Image, ImageCache};
use super::network::{Lookup, Program};
use crate::flat::{self, Network, Prims};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What displaces a mesh: one network per material slot, empty where a material moves nothing.
#[derive(Clone)]
pub struct Displacement {
    networks: Vec<Network>,
    /// Those that the networks read: an image that is compiled anew is another one.
    images: Vec<Arc<Image>>,
}

/// Triangles of a mesh that is to be displaced.
pub(super) struct Surface<'a> {
    pub points: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    pub slots: Option<&'a [u16]>,
    pub primvars: &'a BTreeMap<String, Values>,
    pub normals: Option<&'a Attribute<Vec3>>,
}

/// The surface after it.
pub(super) struct Moved {
    pub points: Vec<Vec3>,
    pub normals: Option<Attribute<Vec3>>,
    /// Offsets that were no number: these points stay.
    pub not_finite: usize,
}

/// Corners of needles have no angle, and still a say.
const LEAST_ANGLE: f32 = 1e-6;

impl Displacement {
    /// `None` where no material of the mesh displaces it.
    pub fn of(mesh: &flat::Mesh, materials: &Prims<flat::Material>, images: &ImageCache) -> Option<Self> {
        let own = |name: &String| materials.get(name).map(|m| m.displacement().clone()).unwrap_or_default();
        let subsets =
            mesh.geom_subsets.iter().map(|s| if s.material.is_empty() { &mesh.material } else { &s.material });
        let networks: Vec<Network> = std::iter::once(&mesh.material).chain(subsets).map(own).collect();
        networks.iter().any(|network| !network.is_empty()).then_some(())?;
        let read = networks.iter().flat_map(Network::images).filter_map(|key| images.get(key).cloned()).collect();
        Some(Self { images: read, networks })
    }

    /// Whether it gives the same offsets as `other`.
    pub fn same(&self, other: &Self) -> bool {
        let (a, b) = (&self.images, &other.images);
        self.networks == other.networks && a.len() == b.len() && a.iter().zip(b).all(|(a, b)| Arc::ptr_eq(a, b))
    }

    pub(super) fn apply(&self, surface: &Surface, images: &ImageCache) -> Moved {
        let programs: Vec<Option<(Program, usize)>> = self.networks.iter().map(|n| program(n, images)).collect();
        let welded = Welded::of(surface);
        let offsets: Vec<[f32; 3]> =
            (0..surface.triangles.len()).into_par_iter().map(|i| offsets(surface, i, &programs)).collect();
        let not_finite = offsets.iter().flatten().filter(|offset| !offset.is_finite()).count();
        let offset =
            welded.mean(surface, |i, corner| if offsets[i][corner].is_finite() { offsets[i][corner] } else { 0.0 });
        let faces = |points: &[Vec3]| welded.directions(surface, points, |i, _| normal(points, surface.triangles[i]));
        let before = faces(surface.points);
        let along = match surface.normals {
            Some(normals) => welded.directions(surface, surface.points, |i, corner| {
                normals.corners(i, surface.triangles[i])[corner].normalize_or_zero()
            }),
            None => before.clone(),
        };
        let move_point = |(p, &id): (&Vec3, &u32)| *p + along[id as usize] * offset[id as usize];
        let points: Vec<Vec3> = surface.points.iter().zip(&welded.ids).map(move_point).collect();
        let turns: Vec<Vec3> = faces(&points).iter().zip(&before).map(|(after, before)| *after - *before).collect();
        let normals = surface.normals.map(|normals| welded.turned(surface, normals, &turns));
        Moved { points, normals, not_finite }
    }
}

/// The program of a network, and the step that gives the offset.
fn program(network: &Network, images: &ImageCache) -> Option<(Program, usize)> {
    let step = *network.inputs.get("displacement")?;
    Some((Program::compile(network, images), step))
}

/// At the corners of a triangle.
fn offsets(surface: &Surface, i: usize, programs: &[Option<(Program, usize)>]) -> [f32; 3] {
    let slot = surface.slots.map_or(0, |slots| usize::from(slots[i]));
    let Some((program, step)) = &programs[slot] else { return [0.0; 3] };
    let corners = [Vec2::ZERO, Vec2::X, Vec2::Y];
    std::array::from_fn(|k| {
        let at = corners[k];
        let across = Some([corners[(k + 1) % 3] - at, corners[(k + 2) % 3] - at]);
        let lookup = Lookup {
            primvars: surface.primvars,
            instance: None,
            triangle: i,
            corners: surface.triangles[i],
            at,
            across,
            time: 0.0,
        };
        program.run(&lookup, |value| value(*step).x)
    })
}

/// Unit normal of a triangle; zero where it has no area.
fn normal(points: &[Vec3], triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|i| points[i as usize]);
    (b - a).cross(c - a).normalize_or_zero()
}

/// Angle of a triangle at one of its corners.
fn angle(points: &[Vec3], triangle: [u32; 3], corner: usize) -> f32 {
    let [a, b, c] = [0, 1, 2].map(|k| points[triangle[(corner + k) % 3] as usize]);
    let angle = (b - a).angle_between(c - a);
    if angle > LEAST_ANGLE { angle } else { LEAST_ANGLE }
}

/// Points by position.
struct Welded {
    /// By point: which position it has.
    ids: Vec<u32>,
    count: usize,
}

impl Welded {
    fn of(surface: &Surface) -> Self {
        let mut known = rustc_hash::FxHashMap::default();
        let id = |p: &Vec3| {
            let next = known.len() as u32;
            // + 0.0 makes -0 and 0 one key.
            *known.entry((*p + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(next)
        };
        let ids = surface.points.iter().map(id).collect();
        Self { ids, count: known.len() }
    }

    /// By position: sums over the corners there, weighted by their angles, which makes them independent of how polygons
    /// are cut into triangles (Thürmer and Wüthrich 1998).
    fn sum<T: Copy + std::ops::AddAssign>(
        &self,
        surface: &Surface,
        points: &[Vec3],
        zero: T,
        value: impl Fn(usize, usize, f32) -> T,
    ) -> Vec<T> {
        let mut sums = vec![zero; self.count];
        for (i, triangle) in surface.triangles.iter().enumerate() {
            for corner in 0..3 {
                let id = self.ids[triangle[corner] as usize];
                sums[id as usize] += value(i, corner, angle(points, *triangle, corner));
            }
        }
        sums
    }

    fn mean(&self, surface: &Surface, value: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        let sums = self
            .sum(surface, surface.points, Vec2::ZERO, |i, corner, weight| Vec2::new(weight * value(i, corner), weight));
        // Points that no triangle has stay where they are.
        sums.into_iter().map(|sum| if sum.y > 0.0 { sum.x / sum.y } else { 0.0 }).collect()
    }

    fn directions(&self, surface: &Surface, points: &[Vec3], value: impl Fn(usize, usize) -> Vec3) -> Vec<Vec3> {
        let sums = self.sum(surface, points, Vec3::ZERO, |i, corner, weight| value(i, corner) * weight);
        sums.into_iter().map(Vec3::normalize_or_zero).collect()
    }

    /// Shading normals after the surface below them has turned: what they were bent away from its own normals stays.
    fn turned(&self, surface: &Surface, normals: &Attribute<Vec3>, turns: &[Vec3]) -> Attribute<Vec3> {
        let turned = |n: Vec3, point: u32| n.normalize_or_zero() + turns[self.ids[point as usize] as usize];
        if let Attribute::Point(normals) = normals {
            return Attribute::Point(normals.iter().zip(0..).map(|(n, point)| turned(*n, point)).collect());
        }
        let corners = surface.triangles.iter().enumerate().map(|(i, triangle)| {
            let normals = normals.corners(i, *triangle);
            std::array::from_fn(|k| turned(normals[k], triangle[k]))
        });
        Attribute::Corner(corners.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::{Interpolation, Material, Mesh, Node, PreviewSurface, Primvar};
    use crate::scene::Geometry;

    fn material(nodes: Vec<Node>) -> Prims<Material> {
        let inputs = [("displacement".to_owned(), nodes.len() - 1)].into();
        let displacement = Network { nodes, inputs, ..Network::default() };
        let surface = PreviewSurface { displacement, ..PreviewSurface::default() };
        [("/M".to_owned(), Material::UsdPreviewSurface(surface))].into()
    }

    fn geometry(mesh: &Mesh, level: u32, materials: &Prims<Material>) -> Geometry {
        let images = ImageCache::new();
        Geometry::compile(mesh.clone(), level, false, Displacement::of(mesh, materials, &images), &images)
    }

    /// A cube of side 2; with `split`, each face has points of its own. Primvar h is by face and differs between faces.
    fn cube(scheme: &str, split: bool) -> Mesh {
        let corner = |i: i32| [i & 1, (i >> 1) & 1, i >> 2].map(|bit| 2.0 * bit as f32 - 1.0);
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let flat = faces.as_flattened();
        let (points, indices): (Vec<_>, Vec<i32>) = match split {
            true => (flat.iter().map(|&i| corner(i)).collect(), (0..24).collect()),
            false => ((0..8).map(corner).collect(), flat.to_vec()),
        };
        let values = (0..24).map(|i| 0.1 * (i / 4) as f32).collect::<Vec<_>>().into();
        let h = Primvar { interpolation: Interpolation::FaceVarying, values, indices: None };
        Mesh {
            points: points.into(),
            face_vertex_counts: vec![4; 6].into(),
            face_vertex_indices: indices.into(),
            subdivision_scheme: scheme.into(),
            primvars: [("h".to_owned(), flat::AnyPrimvar::Float(h))].into(),
            material: "/M".into(),
            ..Mesh::default()
        }
    }

    #[test]
    fn a_constant_moves_every_point_by_itself_along_the_limit_normal() {
        let constant = material(vec![Node::Constant { value: [0.25; 4] }]);
        let mesh = cube("catmullClark", false);
        let (plain, moved) = (geometry(&mesh, 4, &Prims::new()), geometry(&mesh, 4, &constant));
        let Some(Attribute::Point(normals)) = &plain.normals else { panic!("limit normals") };
        for ((p, q), n) in plain.points.iter().zip(&moved.points).zip(normals) {
            assert!((*q - *p - *n * 0.25).length() < 1e-6, "{p} to {q}");
        }
        // An offset surface has the normals of the one it comes from, but for what its facets are off.
        let Some(Attribute::Point(after)) = &moved.normals else { panic!("normals") };
        let worst = normals.iter().zip(after).map(|(a, b)| a.angle_between(*b)).fold(0.0, f32::max);
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn seams_stay_closed() {
        let fallback = [0.0; 4];
        let driven = material(vec![Node::Primvar { varname: "h".into(), fallback }]);
        for (scheme, split, level) in [("none", true, 0), ("catmullClark", false, 3), ("bilinear", true, 2)] {
            let mesh = cube(scheme, split);
            assert_eq!(geometry(&mesh, level, &Prims::new()).open_edges(), 0, "{scheme}");
            let moved = geometry(&mesh, level, &driven);
            assert_eq!(moved.open_edges(), 0, "{scheme}");
            assert_ne!(moved.points, geometry(&mesh, level, &Prims::new()).points);
        }
        // The mean of the three faces that meet at (1, 1, 1): 0.1, 0.3 and 0.5, along their mean normal.
        let moved = geometry(&cube("none", true), 0, &driven);
        let corner = moved.points.iter().find(|p| p.min_element() > 0.9).expect("the corner");
        assert!((*corner - Vec3::splat(1.0 + 0.3 / 3.0_f32.sqrt())).length() < 1e-5, "{corner}");
    }

    #[test]
    fn slopes_turn_normals() {
        // A flat grid refined from one quad, raised by s / 2: normal (-1, 0, 2) / sqrt 5.
        let values = vec![0.0, 0.5, 0.5, 0.0].into();
        let h = Primvar { interpolation: Interpolation::FaceVarying, values, indices: None };
        let mesh = Mesh {
            points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].into(),
            face_vertex_counts: vec![4].into(),
            face_vertex_indices: vec![0, 1, 2, 3].into(),
            normals: Some(Primvar {
                interpolation: Interpolation::Constant,
                values: vec![[0.0, 0.0, 3.0]].into(),
                indices: None,
            }),
            primvars: [("h".to_owned(), flat::AnyPrimvar::Float(h))].into(),
            material: "/M".into(),
            ..Mesh::default()
        };
        let moved = geometry(&mesh, 0, &material(vec![Node::Primvar { varname: "h".into(), fallback: [0.0; 4] }]));
        let Some(Attribute::Corner(normals)) = &moved.normals else { panic!("normals") };
        for n in normals.as_flattened() {
            assert!((n.normalize() - Vec3::new(-1.0, 0.0, 2.0).normalize()).length() < 1e-6, "{n}");
        }
    }

    #[test]
    fn numbers_that_are_none_move_nothing() {
        let nan =
            material(vec![Node::Constant { value: [0.0; 4] }, Node::Math { op: flat::Op::Divide, args: vec![0, 0] }]);
        let moved = geometry(&cube("none", false), 0, &nan);
        assert_eq!(moved.points, geometry(&cube("none", false), 0, &Prims::new()).points);
        assert_eq!(moved.not_displaced, 36);
    }
}
