//! Light groups: which AOVs of single lights, or of several, a light is part of.

use super::Lights;
use crate::error::Warning;
use crate::flat::{self, LIGHT_AOV, Prims};
use crate::math::Rgb;
use glam::Vec3;

/// In place of a light: what materials emit by themselves.
pub const GLOW: u32 = u32::MAX;

/// Group of lights that are in none, and of what materials emit.
pub const DEFAULT_GROUP: &str = "default";

/// AOVs of lights that an image can have at once: a bit each.
const MOST: usize = 64;

/// The AOVs of lights that were asked for, in the order of their sums.
#[derive(Debug, Clone, Default)]
pub struct Groups {
    /// Per light, a bit per AOV.
    of_light: Vec<u64>,
    of_glow: u64,
    /// What the lights that each AOV shows give to the scene, without shadows, of what all do: its part of what belongs to none.
    shares: Vec<f32>,
}

impl Lights {
    /// Takes groups from the flat lights. An AOV is named after a group, or a light by its prim's name or path. `places`: some of
    /// those that are lit.
    pub fn group(
        &mut self,
        aovs: &[String],
        lights: &Prims<flat::Light>,
        places: &[Vec3],
        warnings: &mut Vec<Warning>,
    ) {
        let labels: Vec<&str> = aovs.iter().filter_map(|aov| aov.strip_prefix(LIGHT_AOV)).collect();
        if labels.len() > MOST {
            let message = format!("aovs: {} are of lights; the first {MOST} are rendered", labels.len());
            warnings.push(Warning::new("render settings", message));
        }
        let labels = &labels[..labels.len().min(MOST)];
        let groups: Vec<&str> = lights.values().map(group_of).collect();
        let mask = |path: &str| {
            let shows = |label: &str| match groups.contains(&label) || label == DEFAULT_GROUP {
                true => group_of(&lights[path]) == label,
                false => {
                    prim_of(path) == label || [path, &lights[path].prim].into_iter().any(|of| name_of(of) == label)
                }
            };
            labels.iter().enumerate().filter(|(_, label)| shows(label)).fold(0, |mask, (i, _)| mask | 1 << i)
        };
        let known = lights.keys().fold(0, |known, path| known | mask(path));
        let of_light: Vec<u64> = self.paths.iter().map(|path| mask(path)).collect();
        let bit = |i: usize| 1_u64 << i;
        let default = labels.iter().position(|label| *label == DEFAULT_GROUP).map_or(0, bit);
        let weights = if labels.is_empty() { Vec::new() } else { self.shares_at(places) };
        let share = |i: usize| match of_light.len() {
            // Only materials glow.
            0 => f32::from(default & bit(i) != 0),
            _ => of_light.iter().zip(&weights).filter(|(mask, _)| *mask & bit(i) != 0).map(|(_, weight)| weight).sum(),
        };
        let shares = (0..labels.len()).map(share).collect();
        for (_, label) in labels.iter().enumerate().filter(|(i, _)| (known | default) & bit(*i) == 0) {
            let message =
                format!("aovs: {LIGHT_AOV}{label} is black: no light is '{label}' or in a group of that name");
            warnings.push(Warning::new("render settings", message));
        }
        self.groups = Groups { of_light, of_glow: default, shares };
    }

    /// What each light gives of all light at `places`, without shadows, on average.
    fn shares_at(&self, places: &[Vec3]) -> Vec<f32> {
        let mut shares = vec![0.0_f32; self.lights.len()];
        for &p in places {
            let weights: Vec<f32> = self.lights.iter().map(|light| light.importance(p, None).min(f32::MAX)).collect();
            let sum: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
            for (share, weight) in shares.iter_mut().zip(weights).filter(|_| sum > 0.0) {
                *share += (f64::from(weight) / sum) as f32;
            }
        }
        let sum: f32 = shares.iter().sum();
        let alike = 1.0 / shares.len() as f32;
        shares.iter().map(|share| if sum > 0.0 { share / sum } else { alike }).collect()
    }

    /// Adds the light of `source`, a light or [`GLOW`], to the sums that show it.
    pub fn sort(&self, sums: &mut [Rgb], source: u32, light: Rgb) {
        let mut mask = self.groups.of_light.get(source as usize).copied().unwrap_or(self.groups.of_glow);
        while mask != 0 {
            sums[mask.trailing_zeros() as usize] += light;
            mask &= mask - 1;
        }
    }

    /// Adds what belongs to no light, and is zero on average: to each sum its part, so that together they are the image.
    pub fn share_out(&self, sums: &mut [Rgb], light: Rgb) {
        sums.iter_mut().zip(&self.groups.shares).for_each(|(sum, share)| *sum += *share * light);
    }
}

fn group_of(light: &flat::Light) -> &str {
    if light.group.is_empty() { DEFAULT_GROUP } else { &light.group }
}

/// Path of the prim that is a light: a mesh that is one is two things.
fn prim_of(path: &str) -> &str {
    path.strip_suffix(".light").unwrap_or(path)
}

/// Name of that prim, which all its placements have.
fn name_of(path: &str) -> &str {
    let placed = path.rsplit('/').next().unwrap_or(path);
    prim_of(placed.split_once('[').map_or(placed, |(name, _)| name))
}
