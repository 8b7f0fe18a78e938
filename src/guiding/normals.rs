//! Slab normals of a receiving cell: those of the cells that its light comes from.

use super::cache::{Cache, Cell, Record};
use super::weights::Profile;
use crate::math::{Rgb, mean};
use crate::subsurface::technique::{LANES, Techniques};
use glam::Vec3;
use std::f32::consts::TAU;

/// Directions that weights are gathered in before they are clustered: the cost is then that of the bins.
const BINS: usize = 96;

/// A gathered direction: its mean normal, not unit, and its weight per channel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gathered {
    sum: Vec3,
    weight: Rgb,
}

/// What sends light to the cells of a boundary.
#[derive(Debug, Clone)]
pub struct Sources {
    /// Coarse enough that there are not many.
    pub cache: Cache,
    pub profile: Profile,
    /// Numbers of the lit cells.
    pub lit: Vec<u32>,
    /// The bins of their normals.
    bins: Vec<u8>,
}

/// Most sources of a receiver: clusters of them do not change with more, and the cost is theirs.
const MOST_SOURCES: usize = 1024;

impl Sources {
    /// From the cache at `size`, or twice that as often as it takes.
    pub fn new(records: &[Record], build: impl Fn(f32) -> Cache, size: f32, profile: Profile, bill: bool) -> Self {
        let mut size = size;
        loop {
            let cache = build(size);
            let lit: Vec<u32> = (0..cache.means.len() as u32).filter(|&i| cache.means[i as usize].lit).collect();
            if lit.len() <= MOST_SOURCES {
                let cache = if bill { cache.with_incident(records) } else { cache };
                let bins = lit.iter().map(|&i| bin_of(cache.means[i as usize].normal) as u8).collect();
                return Self { cache, profile, lit, bins };
            }
            size *= 2.0;
        }
    }

    /// The source that a receiver lies in, as place in `lit`.
    pub fn own(&self, receiver: &Cell) -> Option<usize> {
        let cell = self.cache.cells.find(receiver.point, receiver.normal)?;
        self.lit.binary_search(&cell).ok()
    }

    /// Weight of each lit cell for a receiver, per channel; its own by its disk.
    pub fn weights(&self, receiver: &Cell) -> impl Iterator<Item = (u32, &Cell, Rgb)> {
        let (own, receiver) = (self.own(receiver), *receiver);
        self.lit.iter().enumerate().map(move |(place, &at)| {
            let source = &self.cache.means[at as usize];
            let weight = if own == Some(place) {
                self.profile.of_own(source)
            } else {
                self.profile.of_cell(receiver.point, receiver.normal, source)
            };
            (at, source, weight)
        })
    }
}

/// Cosine to the receiver's own normal above which light is the point of entry's to follow.
const OWN: f32 = 0.94;

/// Share of a mixture that starts as classical walks (mixture_3d.md section 5).
pub const CLASSICAL_START: f32 = 0.1;

/// Share of the start that all normals have in equal parts: learning must find what the weights deny.
const EVEN: f32 = 0.5;

/// The mixture that a receiver starts with: the point of entry in lane 0, clustered normals, classical.
pub fn initial_techniques(
    sources: &Sources,
    receiver: &Cell,
    normals: usize,
    classical: f32,
    guided_first: bool,
) -> Techniques {
    let own = receiver.normal;
    let mut bins = [Gathered::default(); BINS];
    let mut near = Rgb::ZERO;
    for ((_, source, weight), &bin) in sources.weights(receiver).zip(&sources.bins) {
        if source.normal.dot(own) > OWN {
            near += weight;
        } else {
            let bin = &mut bins[bin as usize];
            bin.sum += source.normal * mean(weight);
            bin.weight += weight;
        }
    }
    let clusters = cluster(&bins, normals.min(LANES - 1));
    let mut lanes = vec![(own, near)];
    lanes.extend(clusters);
    techniques(&lanes, classical, guided_first)
}

/// A mixture of the given normals (lane 0 first) by their weights per channel.
fn techniques(lanes: &[(Vec3, Rgb)], classical: f32, guided_first: bool) -> Techniques {
    let mut techniques = Techniques { guided_first, ..Techniques::default() };
    let total: Rgb = lanes.iter().map(|lane| lane.1).sum();
    let even = 1.0 / lanes.len() as f32;
    for (i, (normal, weight)) in lanes.iter().enumerate() {
        techniques.set_normal(i, *normal);
        for c in 0..3 {
            let share = if total[c] > 0.0 { EVEN * even + (1.0 - EVEN) * weight[c] / total[c] } else { even };
            techniques.shares.guided[c][i] = (1.0 - classical) / 3.0 * share;
        }
    }
    techniques.shares.classical = [classical / 3.0; 3];
    techniques
}

/// Point of entry and classical walks alone: where nothing is known.
pub fn without_cache(classical: f32, guided_first: bool) -> Techniques {
    techniques(&[(Vec3::Z, Rgb::ONE)], classical, guided_first)
}

/// The paper's normals without a point of entry, as the marginal over clusters of them: those of the lit cells, or the
/// directions of the light there. `None` where nothing is lit.
pub fn paper_techniques(sources: &Sources, receiver: &Cell, classical: f32, guided_first: bool) -> Option<Techniques> {
    let mut bins = [Gathered::default(); BINS];
    let mut gather = |n: Vec3, weight: Rgb| {
        let bin = &mut bins[bin_of(n)];
        bin.sum += n * mean(weight);
        bin.weight += weight;
    };
    for (at, source, weight) in sources.weights(receiver) {
        match sources.cache.incident.get(at as usize) {
            Some(Some(incident)) => {
                incident.lobes().for_each(|(share, lobe)| gather(lobe.mean, weight * share));
            }
            Some(None) => {}
            None => gather(source.normal, weight),
        }
    }
    let clusters = cluster(&bins, LANES);
    (!clusters.is_empty()).then(|| techniques(&clusters, classical, guided_first))
}

/// Of equal bands in z, each cut into equal angles: 8 x 12.
fn bin_of(n: Vec3) -> usize {
    let band = ((n.z * 0.5 + 0.5) * 8.0).clamp(0.0, 7.0) as usize;
    let sector = ((n.y.atan2(n.x) / TAU + 0.5) * 12.0).clamp(0.0, 11.0) as usize;
    band * 12 + sector
}

/// At most `k` unit normals with their weights: greedy farthest and heaviest first, then Lloyd's iterations.
pub fn cluster(bins: &[Gathered], k: usize) -> Vec<(Vec3, Rgb)> {
    let bins: Vec<(Vec3, f32, Rgb)> =
        bins.iter().filter_map(|bin| Some((unit(bin.sum)?, mean(bin.weight), bin.weight))).collect();
    let mut centres: Vec<Vec3> = Vec::new();
    // Of each bin: 1 - cosine to the nearest centre.
    let mut apart = vec![2.0_f32; bins.len()];
    while centres.len() < k.min(bins.len()) {
        let cost = |i: usize| bins[i].1 * apart[i];
        let Some(best) = (0..bins.len()).max_by(|&a, &b| cost(a).total_cmp(&cost(b))) else { break };
        if cost(best) <= 0.0 {
            break;
        }
        let centre = bins[best].0;
        apart.iter_mut().zip(&bins).for_each(|(apart, bin)| *apart = apart.min(1.0 - centre.dot(bin.0)));
        centres.push(centre);
    }
    let mut weights = Vec::new();
    for _ in 0..4 {
        let mut sums = vec![(Vec3::ZERO, Rgb::ZERO); centres.len()];
        for (n, weight, rgb) in &bins {
            let Some(nearest) = nearest(&centres, *n) else { break };
            sums[nearest].0 += *n * *weight;
            sums[nearest].1 += *rgb;
        }
        for (centre, (sum, _)) in centres.iter_mut().zip(&sums) {
            *centre = unit(*sum).unwrap_or(*centre);
        }
        weights = sums;
    }
    centres.into_iter().zip(weights).map(|(n, (_, weight))| (n, weight)).collect()
}

/// In f64: squares of what grazing light weighs are nothing in f32, and a normal that is not unit makes densities wrong.
fn unit(sum: Vec3) -> Option<Vec3> {
    sum.as_dvec3().try_normalize().map(|n| n.as_vec3())
}

fn nearest(centres: &[Vec3], n: Vec3) -> Option<usize> {
    let cosines = centres.iter().map(|centre| centre.dot(n)).enumerate();
    cosines.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Parts;
    use crate::medium::Medium;

    fn bin(n: Vec3, weight: f32) -> Gathered {
        Gathered { sum: n * weight, weight: Rgb::splat(weight) }
    }

    /// However faint: a normal that is not unit makes densities wrong, here by a tenth at 1e-22 if squares are of f32.
    #[test]
    fn clusters_have_unit_normals() {
        let n = Vec3::new(0.48, -0.6, 0.64);
        for weight in [1.0, 1e10, 1e-15, 1e-20, 1e-21, 1e-22, 1e-23, 1e-30] {
            for rest in [1.0, weight] {
                let clusters = cluster(&[bin(Vec3::NEG_Z, rest), bin(n, weight)], 2);
                assert_eq!(clusters.len(), 2, "{weight}");
                for (normal, _) in &clusters {
                    assert!((normal.length() - 1.0).abs() < 1e-6, "{weight}: {normal} of length {}", normal.length());
                }
                assert!(clusters.iter().any(|(normal, _)| (*normal - n).length() < 1e-6), "{weight}: {clusters:?}");
            }
        }
    }

    /// Records over the six faces of a cube that is lit from +x and, dimly, from +z.
    fn lit_cube(scale: f32) -> Vec<Record> {
        let faces = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        let place = |n: Vec3, i: usize| {
            let (u, v) = ((i % 8) as f32 / 8.0 - 0.4375, (i / 8) as f32 / 8.0 - 0.4375);
            0.5 * n + u * Vec3::new(n.y, n.z, n.x).abs() + v * Vec3::new(n.z, n.x, n.y).abs()
        };
        let record = |(n, i): (Vec3, usize)| Record {
            p: scale * place(n, i),
            n,
            area: scale * scale / 64.0,
            irradiance: Rgb::new(1.0, 0.8, 0.5) * (n.x.max(0.0) + 0.1 * n.z.max(0.0)),
            lights: Vec::new(),
            directions: Vec::new(),
            indirect: None,
        };
        faces.into_iter().flat_map(|n| (0..64).map(move |i| (n, i))).map(record).collect()
    }

    /// Techniques of a cell in the middle of the face with normal `n`.
    fn techniques_of(n: Vec3, scale: f32) -> Techniques {
        let records = lit_cube(scale);
        let medium = Medium { sigma_t: Rgb::new(4.0, 8.0, 12.0) / scale, albedo: Rgb::new(0.99, 0.9, 0.8), g: 0.0 };
        let build = |size: f32| Cache::build(size, &records, 2, &Parts::default());
        let sources = Sources::new(&records, build, 0.25 * scale, Profile::new(&medium), false);
        let at = sources.cache.cells.find(scale * (0.5 * n + 0.1), n).expect("records are everywhere");
        let receiver = sources.cache.means[at as usize];
        initial_techniques(&sources, &receiver, 7, 0.1, true)
    }

    #[test]
    fn shares_do_not_know_the_unit_of_length() {
        for n in [Vec3::X, Vec3::NEG_X, Vec3::Z, Vec3::NEG_Z] {
            let techniques = techniques_of(n, 1.0);
            assert!((techniques.shares.sum() - 1.0).abs() < 1e-6);
            for scale in [1024.0, 1.0 / 1024.0] {
                assert_eq!(techniques_of(n, scale), techniques, "{n} scale {scale}");
            }
        }
    }

    /// The lit faces that look another way have lanes of their own, the face of the receiver has the point of entry's.
    #[test]
    fn light_of_the_own_side_is_left_to_the_point_of_entry() {
        let lanes = |n: Vec3| {
            let techniques = techniques_of(n, 1.0);
            let used = (0..LANES).filter(|&lane| techniques.shares.guided[1][lane] > 0.0);
            (techniques.shares.guided[1], used.map(|lane| techniques.normal(lane)).collect::<Vec<_>>())
        };
        let alike = |found: &[Vec3], expected: &[Vec3]| {
            found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (*a - *b).length() < 1e-6)
        };
        let (_, dark) = lanes(Vec3::NEG_X);
        assert!(alike(&dark, &[Vec3::NEG_X, Vec3::X, Vec3::Z]), "{dark:?}");
        let (shares, lit) = lanes(Vec3::X);
        assert!(alike(&lit, &[Vec3::X, Vec3::Z]), "{lit:?}");
        assert!(shares[0] > 2.0 * shares[1], "{shares:?}");
        // No lane is denied altogether: half of all is even.
        assert!(shares[1] > 0.9 / 3.0 * 0.5 / 2.0, "{shares:?}");
    }
}
