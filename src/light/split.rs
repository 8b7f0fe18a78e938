//! Two clusters out of one, by the surface area orientation heuristic (Conty Estevez and Kulla 2018, section 4.4).

use super::bound::Bound;

const BINS: usize = 12;

/// Halvings after which clusters are halved by count: the heuristic may peel off one light at a time.
const DEEPEST: u32 = 40;

/// Sorts the lights into two clusters; the number of those in the first, which is neither 0 nor all.
pub fn split(lights: &mut [(u32, Bound)], depth: u32) -> usize {
    let centre = |bound: &Bound| 0.5 * (bound.min + bound.max);
    let (lo, hi) = lights
        .iter()
        .map(|(_, bound)| (centre(bound), centre(bound)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        .expect("a cluster holds lights");
    let size = hi - lo;
    let bin = |bound: &Bound, axis: usize| {
        let x = (centre(bound)[axis] - lo[axis]) / size[axis];
        ((x * BINS as f32) as usize).min(BINS - 1)
    };
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| depth < DEEPEST && size[axis] > 0.0 && size[axis].is_finite()) {
        let mut bins: [Option<Bound>; BINS] = [const { None }; BINS];
        for (_, bound) in lights.iter() {
            let slot = &mut bins[bin(bound, axis)];
            *slot = Some(slot.as_ref().map_or(bound.clone(), |old| old.union(bound)));
        }
        // Thin slices of long boxes are worse than their area says (Conty Estevez and Kulla 2018, section 4.4).
        let regularity = f64::from(size.max_element() / size[axis]);
        for (plane, cost) in costs(&bins) {
            if best.is_none_or(|(least, ..)| regularity * cost < least) {
                best = Some((regularity * cost, axis, plane));
            }
        }
    }
    let Some((_, axis, plane)) = best else { return lights.len() / 2 };
    // Stable: the tree is a function of the scene.
    lights.sort_by_key(|(_, bound)| bin(bound, axis) >= plane);
    lights.iter().filter(|(_, bound)| bin(bound, axis) < plane).count()
}

/// Cost of a split before each bin that leaves lights on both sides.
fn costs(bins: &[Option<Bound>; BINS]) -> impl Iterator<Item = (usize, f64)> {
    let mut below: [Option<Bound>; BINS] = [const { None }; BINS];
    let mut above = below.clone();
    let join = |a: &Option<Bound>, b: &Option<Bound>| match (a, b) {
        (Some(a), Some(b)) => Some(a.union(b)),
        (a, b) => a.clone().or_else(|| b.clone()),
    };
    for i in 1..BINS {
        below[i] = join(&below[i - 1], &bins[i - 1]);
    }
    above[BINS - 1] = bins[BINS - 1].clone();
    for i in (0..BINS - 1).rev() {
        above[i] = join(&above[i + 1], &bins[i]);
    }
    (1..BINS).filter_map(move |i| Some((i, below[i].as_ref()?.cost() + above[i].as_ref()?.cost())))
}
