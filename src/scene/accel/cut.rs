//! Where to cut a set of boxes in two: the plane of least cost by the surface area heuristic, binned (Wald 2007, "On fast
//! Construction of SAH-based Bounding Volume Hierarchies"), as a sample of the boxes sees it.

use super::guide::Guides;
use glam::Vec3A;
use obvhs::aabb::Aabb;

const SAMPLE: usize = 4096;
const BINS: usize = 16;

/// Neither side gets less than this share, so that no chain of cuts is long.
const LEAST: usize = 8;

/// Sorts `ids` into those of one side and those of the other, and says how many are of the first.
pub(super) fn cut(guides: &Guides, ids: &mut [u32]) -> usize {
    let sample = Vec::from_iter(ids.iter().step_by(ids.len().div_ceil(SAMPLE)).map(|&i| guides.get(i)));
    let (axis, plane) = best_plane(&sample);
    let first = partition(ids, |i| guides.middle(i, axis) < plane);
    if first.min(ids.len() - first) >= ids.len() / LEAST {
        return first;
    }
    // The middle one: always a cut, even where all are in one place.
    let half = ids.len() / 2;
    ids.select_nth_unstable_by(half, |&a, &b| {
        guides.middle(a, axis).total_cmp(&guides.middle(b, axis)).then(a.cmp(&b))
    });
    half
}

/// Axis and place.
fn best_plane(sample: &[Aabb]) -> (usize, f32) {
    let points = Vec::from_iter(sample.iter().map(Aabb::center));
    let (min, max) = (fold(&points, Vec3A::min), fold(&points, Vec3A::max));
    let planes = (0..3).flat_map(|axis| costs(sample, axis, min[axis], max[axis]));
    let best = planes.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or((0, 0.0), |(_, axis, plane)| (axis, plane))
}

fn fold(points: &[Vec3A], f: fn(Vec3A, Vec3A) -> Vec3A) -> Vec3A {
    points.iter().copied().reduce(f).unwrap_or_default()
}

/// Cost, axis and place of the planes between bins.
fn costs(sample: &[Aabb], axis: usize, min: f32, max: f32) -> impl Iterator<Item = (f32, usize, f32)> {
    let width = (max - min) / BINS as f32;
    let mut bins = [(0, Aabb::empty()); BINS];
    for b in sample {
        let bin = &mut bins[(((b.center()[axis] - min) / width) as usize).min(BINS - 1)];
        *bin = joined(*bin, (1, *b));
    }
    let sides = move |k: usize| [&bins[..k], &bins[k..]].map(cost).iter().sum::<f32>();
    (1..BINS).map(move |k| (sides(k), axis, min + width * k as f32))
}

/// Boxes times surface area of what bins hold.
fn cost(bins: &[(u32, Aabb)]) -> f32 {
    let (count, all) = bins.iter().copied().fold((0, Aabb::empty()), joined);
    if count == 0 { 0.0 } else { count as f32 * all.half_area() }
}

fn joined(a: (u32, Aabb), b: (u32, Aabb)) -> (u32, Aabb) {
    (a.0 + b.0, a.1.union(&b.1))
}

/// Those that `first` takes to the front; how many they are.
fn partition(ids: &mut [u32], first: impl Fn(u32) -> bool) -> usize {
    let (mut i, mut end) = (0, ids.len());
    while i < end {
        if first(ids[i]) {
            i += 1;
        } else {
            end -= 1;
            ids.swap(i, end);
        }
    }
    i
}
