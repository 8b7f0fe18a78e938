//! What else a walk meets inside an instance: objects and lights within its medium, or the objects that share its
//! interior. Found at compile, by boxes: most bodies have no company, and their walks never ask.

use super::accel::{Aabb, Tlas};
use super::overlap::{Boxes, overlap};
use super::{Coating, Instance};
use crate::bsdf::Boundary;
use crate::light::Lights;
use glam::Vec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Placed objects, and what finds those that a ray may meet.
pub struct Objects {
    pub instances: Vec<u32>,
    /// -1 where the mesh is inside out.
    pub outward: Vec<f32>,
    /// Render space.
    pub tlas: Tlas,
}

impl Objects {
    fn new(ids: Vec<u32>, instances: &[Instance], boxes: &[Aabb]) -> Self {
        let of = |i: &u32| boxes[*i as usize];
        let outward = ids.iter().map(|&i| outward(&instances[i as usize])).collect();
        Self { tlas: Tlas::build(&ids.iter().map(of).collect::<Vec<_>>()), outward, instances: ids }
    }
}

/// The company of one instance.
pub enum Company {
    /// Light passes from the medium to what is in it: a walk ends at the `objects`, too. `lights`: some are within.
    Guests { objects: Objects, lights: bool },
    /// Its diffuse boundary is that of the union with others: a walk leaves where it leaves them all.
    Set(Arc<Objects>),
}

/// By instance; empty where no instance has any.
pub type Companies = Vec<Option<Box<Company>>>;

/// Roundings of a box's coordinates by which what only touches it is no guest.
const TOUCHING: f32 = 16.0 * f32::EPSILON;

/// What the surfaces of a mesh enclose.
#[derive(Clone, Copy, Default)]
struct Encloses {
    /// A medium that scatters behind a boundary that light passes without being spread: its walks see what is within.
    open: bool,
    /// That boundary refracts.
    bends: bool,
    diffuse: bool,
}

/// `sets`: instances by the name of the set that they are declared to be in.
pub fn companies(
    instances: &[Instance],
    boxes: &[Aabb],
    surfaces: &[Coating],
    lights: &Lights,
    sets: &BTreeMap<String, Vec<u32>>,
) -> Companies {
    let mut known: FxHashMap<u32, Encloses> = FxHashMap::default();
    let enclosed: Vec<Encloses> = instances
        .iter()
        .map(|instance| *known.entry(instance.surfaces).or_insert_with(|| encloses(instance, surfaces)))
        .collect();
    let mut found: Companies = if enclosed.iter().any(|of| of.open) {
        let tree = Boxes::new(boxes);
        let shapes: Vec<Aabb> = lights.shapes().map(|(_, (min, max))| Aabb { min, max }).collect();
        let guests = |i: usize| {
            let of = enclosed[i].open.then_some(enclosed[i])?;
            guests(i, of, instances, boxes, &tree, &shapes)
        };
        (0..instances.len()).into_par_iter().map(guests).collect()
    } else {
        Vec::new()
    };
    for set in sets.values() {
        let members: Vec<u32> = set.iter().copied().filter(|&i| enclosed[i as usize].diffuse).collect();
        if members.len() > 1 {
            found.resize_with(instances.len(), || None);
            let objects = Arc::new(Objects::new(members.clone(), instances, boxes));
            members.iter().for_each(|&i| found[i as usize] = Some(Box::new(Company::Set(objects.clone()))));
        }
    }
    if found.iter().all(Option::is_none) { Vec::new() } else { found }
}

fn encloses(instance: &Instance, surfaces: &[Coating]) -> Encloses {
    let mut all = Encloses::default();
    for interior in instance.interiors(surfaces) {
        all.diffuse |= interior.boundary == Boundary::Diffuse;
        if interior.boundary != Boundary::Diffuse && interior.medium.scatters() {
            all.open = true;
            all.bends |= interior.boundary == Boundary::Dielectric;
        }
    }
    all
}

fn guests(
    i: usize,
    of: Encloses,
    instances: &[Instance],
    boxes: &[Aabb],
    tree: &Boxes,
    shapes: &[Aabb],
) -> Option<Box<Company>> {
    let within = shrunk(&boxes[i]);
    let mut ids = tree.overlapping(&within);
    ids.retain(|&j| j as usize != i && reaches_into(&instances[j as usize], &boxes[j as usize], &within));
    // Straight through a matched boundary every light is asked at collisions anyway.
    let lights = ids.iter().any(|&j| instances[j as usize].light.is_some())
        || of.bends && shapes.iter().any(|shape| overlap(shape, &within));
    let objects = Objects::new(ids, instances, boxes);
    (lights || !objects.instances.is_empty()).then(|| Box::new(Company::Guests { objects, lights }))
}

fn shrunk(of: &Aabb) -> Aabb {
    let by = TOUCHING * of.min.abs().max(of.max.abs());
    Aabb { min: of.min + by, max: of.max - by }
}

/// Whether a triangle of `instance`, whose box is `bounds`, may have a point in a box.
fn reaches_into(instance: &Instance, bounds: &Aabb, within: &Aabb) -> bool {
    // What moves is somewhere in its box.
    if instance.is_moving() || within.min.cmple(bounds.min).all() && bounds.max.cmple(within.max).all() {
        return true;
    }
    let (centre, half) = (within.centre(), within.extent() * 0.5);
    let linear = instance.to_render.linear;
    let shift = instance.to_render.translation - centre;
    let near = |of: &Aabb| {
        let (middle, side) = (linear * of.centre() + shift, linear.abs() * (of.extent() * 0.5));
        // What the map rounds, and more.
        let slack = TOUCHING * (middle.abs() + side + shift.abs() + half);
        (middle.abs() - side).cmple(half + slack).all()
    };
    instance.geometry.any_triangle(near, |corners| touches(corners.map(|p| linear * p + shift), half))
}

/// Whether a triangle may have a point in the box of half the sides `half` about the origin: by its own box and by its plane
/// (two of the three tests of Akenine-Moeller 2001; the third saves little).
fn touches([a, b, c]: [Vec3; 3], half: Vec3) -> bool {
    let (min, max) = (a.min(b).min(c), a.max(b).max(c));
    let n = (b - a).cross(c - a);
    min.cmple(half).all() && max.cmpge(-half).all() && n.dot(a).abs() <= n.abs().dot(half)
}

/// The sign of the volume that the winding of a mesh says it has.
pub fn outward(instance: &Instance) -> f32 {
    let corners = (0..instance.geometry.triangles.len() as u32).map(|t| instance.geometry.corners(t, 0.0));
    let volume: f32 = corners.map(|[a, b, c]| a.dot(b.cross(c))).sum();
    if volume < 0.0 { -1.0 } else { 1.0 }
}

impl Instance {
    /// Of `surfaces`, all of a scene, those that its triangles wear.
    pub fn coatings<'a>(&self, surfaces: &'a [Coating]) -> &'a [Coating] {
        let slots = self.geometry.slots.as_ref().and_then(|slots| slots.iter().max()).map_or(0, |&slot| slot as usize);
        let first = self.surfaces as usize;
        &surfaces[first..=first + slots]
    }

    /// What these enclose.
    pub(super) fn interiors<'a>(&self, surfaces: &'a [Coating]) -> impl Iterator<Item = &'a super::Interior> + use<'a> {
        self.coatings(surfaces).iter().filter_map(|coating| coating.interior.as_ref())
    }
}

/// A body around a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Around {
    pub instance: u32,
    /// Where a ray from the point leaves it.
    pub surface: u32,
    t: f32,
}

/// No mesh is modelled along them.
const PROBES: [Vec3; 3] =
    [Vec3::new(0.269, 0.534, 0.802), Vec3::new(-0.843, 0.104, -0.527), Vec3::new(0.398, -0.875, 0.276)];

/// Crossings of one ray with one mesh that are counted.
const MOST_CROSSINGS: usize = 4096;

impl super::Moment<'_> {
    /// The bodies around `p` (render space) but for the instance `but`, outermost first: closed meshes with a medium.
    pub fn around(&self, p: Vec3, but: u32) -> Vec<Around> {
        let mut found = Vec::new();
        // Boxes that hold the point are those that the shortest ray meets.
        let mut ray = super::Ray { o: p, d: PROBES[0], t_max: f32::MIN_POSITIVE };
        self.tlas.traverse(&mut ray, |i, _| {
            let has_medium = self.instances[i as usize].interiors(&self.surfaces).next().is_some();
            if i != but && has_medium {
                found.extend(self.within(i, p));
            }
            false
        });
        // A ray leaves the inner one first.
        found.sort_by(|a, b| b.t.total_cmp(&a.t).then(a.instance.cmp(&b.instance)));
        found
    }

    /// Whether `p` is inside, as most of three rays say.
    fn within(&self, instance: u32, p: Vec3) -> Option<Around> {
        let seen = PROBES.map(|d| self.winding(instance, p, d));
        let inside = seen.iter().filter(|(winding, _)| *winding != 0).count() >= 2;
        let (t, triangle) = seen[0].1.or(seen[1].1)?;
        let of = &self.instances[instance as usize];
        let surface = of.surfaces + of.geometry.slot(triangle) as u32;
        inside.then_some(Around { instance, surface, t })
    }

    /// Crossings outward less those inward, and the first one.
    fn winding(&self, instance: u32, p: Vec3, d: Vec3) -> (i32, Option<(f32, u32)>) {
        let of = &self.instances[instance as usize];
        let placed = of.placed(self.time);
        let (mut o, mut skip, mut winding, mut first) = (p - placed.translation, u32::MAX, 0, None);
        // A crossing on an edge counts once: the next begins a few roundings later.
        let step = 16.0 * f32::EPSILON * of.half_size().max_element();
        for _ in 0..MOST_CROSSINGS {
            let local = of.local_ray(&placed, o, d, f32::INFINITY);
            let Some(hit) = of.geometry.closest(&local, skip, self.time) else { break };
            let [a, b, c] = of.geometry.corners(hit.triangle, self.time);
            winding += if placed.normal((b - a).cross(c - a)).dot(d) > 0.0 { 1 } else { -1 };
            first = first.or(Some((hit.t, hit.triangle)));
            (o, skip) = (o + d * (hit.t + step), hit.triangle);
        }
        (winding, first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::{self, FlatScene};
    use crate::sampling::sampler::Sampler;

    /// A sheet with many triangles, bent, turned and sheared.
    fn sheet() -> super::super::Scene {
        const N: i32 = 24;
        let point = |i: i32| {
            let (x, y) = ((i % (N + 1)) as f32 / N as f32 - 0.5, (i / (N + 1)) as f32 / N as f32 - 0.5);
            [4.0 * x, 4.0 * y, (3.0 * x).sin() + 0.3 * (9.0 * y).cos()]
        };
        let corner = |x: i32, y: i32| y * (N + 1) + x;
        let face = |i: i32| [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| corner(i % N + x, i / N + y));
        let mut transform = flat::IDENTITY;
        transform[0] = [0.8, 0.5, -0.3, 0.0];
        transform[1] = [-0.4, 1.1, 0.6, 0.0];
        transform[3] = [1.0, 2.0, -3.0, 1.0];
        let mesh = flat::Mesh {
            points: (0..(N + 1) * (N + 1)).map(point).collect::<Vec<_>>().into(),
            face_vertex_counts: vec![4; (N * N) as usize].into(),
            face_vertex_indices: (0..N * N).flat_map(face).collect::<Vec<_>>().into(),
            transform,
            ..flat::Mesh::default()
        };
        let mut flat = FlatScene::default();
        flat.settings.camera = "/C".into();
        flat.cameras.insert("/C".into(), flat::Camera::default());
        flat.meshes.insert("/Sheet".into(), mesh);
        super::super::compile(&flat, &mut Default::default(), &mut Vec::new()).expect("a scene").0
    }

    #[test]
    fn what_reaches_into_a_box_is_what_asking_every_triangle_finds() {
        let scene = sheet();
        let instance = &scene.instances[0];
        let bounds = super::super::instances::render_bounds(std::slice::from_ref(instance))[0];
        let mut sampler = Sampler::new(3, 0, 0);
        let mut v = || Vec3::from_array(std::array::from_fn(|_| sampler.random()));
        let (mut found, n) = (0, 4000);
        for i in 0..n {
            let min = bounds.min - 0.5 + v() * (bounds.extent() + 0.5);
            let within = Aabb { min, max: min + v() * [0.05, 0.4, 2.0, 9.0][i % 4] };
            let (centre, half) = (within.centre(), within.extent() * 0.5);
            let shift = instance.to_render.translation - centre;
            let any = (0..instance.geometry.triangles.len() as u32).any(|triangle| {
                let corners = instance.geometry.corners(triangle, 0.0).map(|p| instance.to_render.linear * p + shift);
                touches(corners, half)
            });
            assert_eq!(reaches_into(instance, &bounds, &within), any, "{within:?}");
            found += u32::from(any);
        }
        assert!((n as u32 / 10..n as u32 * 9 / 10).contains(&found), "{found}");
    }
}
