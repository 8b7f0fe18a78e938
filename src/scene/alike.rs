//! Placements of one medium that light reaches alike: what is learned at the boundary of one holds for all.

use super::company::Companies;
use super::{Coating, Instance};
use crate::light::Lights;
use crate::math::Rgb;
use rustc_hash::FxHashMap;

/// By instance, the first of those that it is like: of one mesh, turned and scaled alike, linked to the same lights, with
/// nothing else in its medium, at rest, under lights that are all infinitely far. Their shadows may differ. Empty where no medium is
/// like another.
pub(super) fn alike(instances: &[Instance], surfaces: &[Coating], lights: &Lights, companies: &Companies) -> Vec<u32> {
    let glows = surfaces.iter().any(|coating| coating.surface.emission() != Rgb::ZERO);
    if lights.is_empty() || !lights.are_infinite() || glows {
        return Vec::new();
    }
    let mut first = FxHashMap::default();
    let mut found = false;
    let of = instances.iter().enumerate().map(|(i, instance)| {
        let alone = companies.get(i).is_none_or(Option::is_none);
        if !alone || instance.is_moving() || instance.interiors(surfaces).next().is_none() {
            return i as u32;
        }
        let linear = instance.to_render.linear.to_cols_array().map(f32::to_bits);
        let of = *first.entry((instance.surfaces, instance.categories, linear)).or_insert(i as u32);
        found |= of != i as u32;
        of
    });
    let of: Vec<u32> = of.collect();
    if found { of } else { Vec::new() }
}
