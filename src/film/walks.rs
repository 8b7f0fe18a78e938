//! AOVs for looking at the guide: sums over the first walks behind the camera rays of a pixel.

use super::{Film, Plane};
use crate::math::Rgb;
use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Cosine of the angle, 20 degrees, within which a slab normal agrees with that of the point of entry
/// (the yellow of figure 6 in Gouder et al. 2025).
const AGREES: f32 = 0.939_692_6;

/// The first walk behind a camera ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstWalk {
    /// Slab normal that it followed, world space, unit; `None`: a classical walk.
    pub normal: Option<Vec3>,
    /// Normal where it entered, world space, unit, outward.
    pub entry: Vec3,
    pub segments: u64,
    /// Number of the region where it entered, unique over instances.
    pub region: Option<u32>,
    /// Of that region, as the boundary cache has it: scene units, without the camera's exposure.
    pub irradiance: Rgb,
    /// Of classical walks, of the point of entry's normal, of other normals.
    pub shares: [f32; 3],
}

/// Sums over the samples of a pixel that had a walk.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct WalkSums {
    segments: u64,
    walks: u32,
    guided: u32,
    agreeing: u32,
    normal: Vec3,
    irradiance: Rgb,
    shares: Vec3,
    /// Of the nearest sample, at `depth`; -1: none.
    region: i32,
    depth: f32,
}

impl WalkSums {
    pub const NONE: Self = Self {
        walks: 0,
        guided: 0,
        agreeing: 0,
        segments: 0,
        normal: Vec3::ZERO,
        irradiance: Rgb::ZERO,
        shares: Vec3::ZERO,
        region: -1,
        depth: f32::INFINITY,
    };

    pub fn add(&mut self, depth: f32, walk: &FirstWalk) {
        self.walks += 1;
        self.segments += walk.segments;
        self.irradiance += walk.irradiance;
        self.shares += Vec3::from_array(walk.shares);
        if let Some(normal) = walk.normal {
            self.guided += 1;
            self.agreeing += u32::from(normal.dot(walk.entry) >= AGREES);
            self.normal += normal;
        }
        if depth < self.depth {
            self.depth = depth;
            self.region = walk.region.map_or(-1, |region| region as i32);
        }
    }

    /// Over the samples that had a walk; zero where none had.
    fn mean(&self, sum: Vec3) -> [f32; 4] {
        (sum / self.walks.max(1) as f32).extend(0.0).to_array()
    }
}

impl Film {
    /// The planes that [`crate::flat::GUIDE_AOVS`] names.
    pub(super) fn walk_planes(&self) -> Vec<Plane> {
        let plane = |name, channels, value: &dyn Fn(&WalkSums) -> [f32; 4]| {
            self.plane(name, channels, |tile, i| value(&tile.walks[i]))
        };
        let one = |value: f32| [value, 0.0, 0.0, 0.0];
        vec![
            plane("slabNormal", 3, &|w| w.mean(w.normal)),
            plane("entryAgreement", 1, &|w| one(w.agreeing as f32 / w.guided.max(1) as f32)),
            plane("walkLength", 1, &|w| one(w.segments as f32 / w.walks.max(1) as f32)),
            plane("region", 1, &|w| one(w.region as f32)),
            plane("cacheIrradiance", 3, &|w| w.mean(w.irradiance)),
            plane("techniqueShares", 3, &|w| w.mean(w.shares)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::Sample;
    use super::*;
    use crate::camera::DataWindow;
    use crate::flat::{AOVS, GUIDE_AOVS};

    const WINDOW: DataWindow = DataWindow { x0: 0, y0: 0, x1: 2, y1: 1 };

    fn film(aovs: &[&str]) -> Film {
        Film::new(WINDOW, &aovs.iter().map(|&aov| aov.into()).collect::<Vec<_>>(), false, 2.0).expect("memory")
    }

    /// Three walks of four samples in pixel 0: along the entry, across it, classical. None in pixel 1.
    #[test]
    fn means_are_over_samples_with_a_walk() {
        let film = film(&GUIDE_AOVS);
        let walk = FirstWalk {
            normal: Some(Vec3::Z),
            entry: Vec3::Z,
            segments: 9,
            region: Some(7),
            irradiance: Rgb::splat(3.0),
            shares: [0.25, 0.5, 0.25],
        };
        let across = FirstWalk { normal: Some(Vec3::X), segments: 2, region: Some(8), ..walk };
        let classical = FirstWalk { normal: None, segments: 1, shares: [1.0, 0.0, 0.0], ..walk };
        let mut tile = film.tiles[0].lock().unwrap();
        (0..4).for_each(|_| tile.add(0, &Sample::BLACK));
        [(2.0, walk), (1.0, across), (3.0, classical)].iter().for_each(|(depth, walk)| tile.add_walk(0, *depth, walk));
        drop(tile);
        let planes = film.resolve();
        assert_eq!(planes.iter().skip(1).map(|p| p.name.clone()).collect::<Vec<_>>(), GUIDE_AOVS);
        let of = |name: &str| planes.iter().find(|p| p.name == name).expect("asked for").values.clone();
        let third = 1.0 / 3.0;
        assert_eq!(of("slabNormal"), [third, 0.0, third, 0.0, 0.0, 0.0]);
        assert_eq!(of("entryAgreement"), [0.5, 0.0]);
        assert_eq!(of("walkLength"), [4.0, 0.0]);
        assert_eq!(of("region"), [8.0, -1.0]);
        // Without the exposure of 2.
        assert_eq!(of("cacheIrradiance"), [3.0, 3.0, 3.0, 0.0, 0.0, 0.0]);
        assert_eq!(of("techniqueShares"), [0.5, third, 0.5 * third, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn twenty_degrees_agree() {
        let agreeing = |degrees: f32| {
            let mut sums = WalkSums::NONE;
            let normal = Some(Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos()));
            let (irradiance, shares) = (Rgb::ZERO, [0.0; 3]);
            sums.add(1.0, &FirstWalk { normal, entry: Vec3::Z, segments: 1, region: None, irradiance, shares });
            sums.agreeing
        };
        assert_eq!((agreeing(19.9), agreeing(20.1), agreeing(170.0)), (1, 0, 0));
    }

    #[test]
    fn default_aovs_keep_no_walks() {
        let film = film(&AOVS);
        assert!(!film.watches_walks());
        assert!(film.tiles.iter().all(|tile| tile.lock().unwrap().walks.is_empty()));
    }
}
