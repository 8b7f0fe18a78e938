//! Which bodies are worth a cache of their own, and how many records each: by what the camera may see of them.

use crate::guiding::Guide;
use crate::guiding::plan::{Looks, Plan};
use crate::scene::{Instance, Scene};
use std::collections::{BTreeMap, HashMap};

/// Of a body that has any: fewer than that know nothing.
const LEAST_RECORDS: u32 = 256;

/// Share of the records below which a body has none. It covers a few pixels: what walks teach about it comes too late, and
/// among ten thousand of its kind the least of each would be more than all.
const WORTH: f64 = 64.0;

/// What points of boundaries are looked at for. A mesh may have parts for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// Caches.
    Records,
    /// Light that is refracted inside.
    Beams,
}

impl Aim {
    fn needs(self, guide: &Guide, plan: &Plan) -> bool {
        match self {
            Self::Records => guide.must_know(plan),
            Self::Beams => plan.looks == Looks::Smooth,
        }
    }

    /// Whether a plan needs to know the boundary at `triangle`.
    pub(super) fn has(self, guide: &Guide, instance: &Instance, triangle: u32) -> bool {
        let surface = instance.surfaces + instance.geometry.slot(triangle) as u32;
        guide.plan(surface).is_some_and(|(plan, _)| self.needs(guide, plan))
    }
}

/// Records from which on a body has a cache of its own: the least of a whole scene. Others share one with those that light
/// reaches alike, if there are any.
const OWN: f64 = 8_000.0;

/// Instances that have a cache together, and the number of its records. The first is that of the largest in the image.
pub(super) struct Body {
    pub members: Vec<u32>,
    pub records: u32,
}

/// Bodies with a share of `records`, and how many instances are too small for any.
pub(super) fn share_records(scene: &Scene, guide: &Guide, aim: Aim, records: u32) -> (Vec<Body>, usize) {
    if !guide.plans.iter().flatten().any(|plan| aim.needs(guide, plan)) {
        return (Vec::new(), 0);
    }
    let sizes = apparent_sizes(scene, guide, aim);
    let all: f64 = sizes.iter().map(|(_, size)| size).sum();
    let of = |size: f64| f64::from(records) * size / all;
    let mut bodies: BTreeMap<u32, Vec<(u32, f64)>> = BTreeMap::new();
    for &(instance, size) in &sizes {
        let alike = scene.alike.get(instance as usize).filter(|_| of(size) < OWN);
        // An own cache beside one that others share: keys of the latter are above all instances.
        let key = alike.map_or(instance, |first| first + scene.instances.len() as u32);
        bodies.entry(key).or_default().push((instance, size));
    }
    let (mut large, mut small) = (Vec::new(), 0);
    for mut members in bodies.into_values() {
        let size: f64 = members.iter().map(|(_, size)| size).sum();
        if of(size) < WORTH {
            small += members.len();
            continue;
        }
        members.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let records = (of(size) as u32).max(LEAST_RECORDS);
        large.push(Body { members: members.into_iter().map(|(instance, _)| instance).collect(), records });
    }
    (large, small)
}

/// Instances that need records, with their area over the squared distance from the camera, which is no nearer than the
/// body is large.
fn apparent_sizes(scene: &Scene, guide: &Guide, aim: Aim) -> Vec<(u32, f64)> {
    // Instances of one mesh share its area: a crowd costs a look at each, not at each triangle of each.
    let mut areas: HashMap<u32, f64> = HashMap::new();
    let mut sizes = Vec::new();
    for (index, instance) in scene.instances.iter().enumerate() {
        if aim == Aim::Beams && !scene.is_alone(index as u32) {
            continue; // no collision looks there
        }
        let area = *areas.entry(instance.surfaces).or_insert_with(|| object_area(guide, instance, aim));
        // Exact for similarities; of a stretched body it is good enough to share records by.
        let scale = f64::from(instance.to_render.linear.determinant().abs()).powf(2.0 / 3.0);
        let distance = instance.to_render.translation.length().max(instance.half_size().length());
        let size = area * scale / f64::from(distance * distance).max(f64::MIN_POSITIVE);
        if size > 0.0 {
            sizes.push((index as u32, size));
        }
    }
    sizes
}

/// Area of what needs records, object space.
fn object_area(guide: &Guide, instance: &Instance, aim: Aim) -> f64 {
    let area = |triangle: u32| {
        let [a, b, c] = instance.geometry.corners(triangle, 0.5);
        f64::from(0.5 * (b - a).cross(c - a).length())
    };
    if instance.geometry.slots.is_none() && !aim.has(guide, instance, 0) {
        return 0.0; // most objects of most scenes: their triangles are not looked at one by one
    }
    let triangles = 0..instance.geometry.triangles.len() as u32;
    triangles.filter(|&triangle| aim.has(guide, instance, triangle)).map(area).sum()
}
