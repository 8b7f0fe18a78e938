//! Techniques of a mixture of walks, with their exact densities over whole paths.
//!
//! A technique is a channel whose distances are drawn and a slab normal along which, or none (classical,
//! non-analog). The density of a path under a slab normal needs only its length, its displacement, the number of its
//! collisions and its first and last direction (guiding.md 1.3), so the marginal over all techniques costs an exponential each,
//! once per walk. Densities are ratios to one reference per path, chosen so that the largest is near 1: they span
//! hundreds of decades.

use super::kernel::Kernel;
use crate::math::Rgb;
use crate::medium::Medium;
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

/// Slab normals per region: a vector register of f32.
pub const LANES: usize = 8;

/// A value per channel and slab normal, with one per channel for the classical technique.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PerTechnique {
    pub guided: [[f32; LANES]; 3],
    pub classical: [f32; 3],
}

/// A technique, as index into [`PerTechnique`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Technique {
    pub channel: usize,
    /// `None`: classical.
    pub lane: Option<usize>,
}

/// Techniques in all: nine per channel.
pub const TECHNIQUES: usize = 3 * (LANES + 1);

impl PerTechnique {
    /// Sum over all techniques of the products.
    pub fn dot(&self, other: &Self) -> f32 {
        let mut sums = [0.0; LANES];
        for c in 0..3 {
            for (sum, (a, b)) in sums.iter_mut().zip(self.guided[c].iter().zip(&other.guided[c])) {
                *sum += a * b;
            }
        }
        let classical: f32 = (0..3).map(|c| self.classical[c] * other.classical[c]).sum();
        sums.iter().sum::<f32>() + classical
    }

    pub fn sum(&self) -> f32 {
        self.guided.as_flattened().iter().chain(&self.classical).sum()
    }

    pub fn scaled(&self, by: f32) -> Self {
        Self { guided: self.guided.map(|g| g.map(|x| x * by)), classical: self.classical.map(|x| x * by) }
    }

    /// Channel by channel: classical, then the lanes.
    pub fn as_list(&self) -> [f32; TECHNIQUES] {
        let mut list = [0.0; TECHNIQUES];
        for c in 0..3 {
            let channel = &mut list[c * (LANES + 1)..(c + 1) * (LANES + 1)];
            channel[0] = self.classical[c];
            channel[1..].copy_from_slice(&self.guided[c]);
        }
        list
    }

    /// Inverse of [`Self::as_list`].
    pub fn from_list(list: &[f32; TECHNIQUES]) -> Self {
        let mut all = Self::default();
        for c in 0..3 {
            let channel = &list[c * (LANES + 1)..(c + 1) * (LANES + 1)];
            all.classical[c] = channel[0];
            all.guided[c].copy_from_slice(&channel[1..]);
        }
        all
    }
}

/// The mixture of one walk: normals in lanes, the probability of every technique.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Techniques {
    /// Components of the slab normals; unused lanes are zero and have no share.
    pub x: [f32; LANES],
    pub y: [f32; LANES],
    pub z: [f32; LANES],
    /// Sums to 1.
    pub shares: PerTechnique,
    /// The first distance of guided walks is drawn along the normal.
    pub guided_first: bool,
}

/// Share of the start's weight below which a channel is still drawn; see `walk::MIN_CHOICE`.
const MIN_CHOICE: f32 = 0.05;

impl Techniques {
    pub fn normal(&self, lane: usize) -> Vec3 {
        Vec3::new(self.x[lane], self.y[lane], self.z[lane])
    }

    pub fn set_normal(&mut self, lane: usize, n: Vec3) {
        (self.x[lane], self.y[lane], self.z[lane]) = (n.x, n.y, n.z);
    }

    /// Shares in proportion to what the channels carry into the walk: a walk that starts again at every internal
    /// reflection would otherwise multiply weights without bound.
    pub fn tilted(mut self, weight: Rgb) -> Self {
        let weight = (weight / weight.max_element()).max(Rgb::splat(MIN_CHOICE));
        for c in 0..3 {
            self.shares.classical[c] *= weight[c];
            self.shares.guided[c].iter_mut().for_each(|share| *share *= weight[c]);
        }
        self.shares = self.shares.scaled(1.0 / self.shares.sum());
        self
    }

    /// The technique at `u` in [0, 1), channel by channel so that neighbouring numbers share a channel.
    pub fn choose(&self, u: f32) -> Technique {
        let mut left = u;
        // Rounding may leave a remainder beyond the last share: it is the last positive one's.
        let mut chosen = 0;
        for (i, share) in self.shares.as_list().into_iter().enumerate().filter(|(_, share)| *share > 0.0) {
            chosen = i;
            left -= share;
            if left < 0.0 {
                break;
            }
        }
        Technique { channel: chosen / (LANES + 1), lane: (chosen % (LANES + 1)).checked_sub(1) }
    }

    /// 1 - n . w for every lane, without cancellation: half the squared distance of unit vectors.
    fn complements(&self, w: Vec3) -> [f32; LANES] {
        std::array::from_fn(|i| {
            let (x, y, z) = (w.x - self.x[i], w.y - self.y[i], w.z - self.z[i]);
            0.5 * (x * x + y * y + z * z)
        })
    }

    /// Way along the normal of every lane, of the segments that follow it. Vectors are unit only to f32: a segment
    /// goes 1 - complement per length, as in the stretch that drew it, or a thousand of them add up the difference.
    fn along(&self, prefix: &Prefix) -> [f64; LANES] {
        let (mut v, mut length, mut excess) = (prefix.displacement, prefix.length, prefix.excess);
        if !self.guided_first {
            v -= prefix.first.as_dvec3() * prefix.first_length;
            length -= prefix.first_length;
            excess -= excess_of(prefix.first) * prefix.first_length;
        }
        std::array::from_fn(|i| {
            let (x, y, z) = (f64::from(self.x[i]), f64::from(self.y[i]), f64::from(self.z[i]));
            let squared = x * x + y * y + z * z;
            // Lanes without a normal go nowhere.
            let unit = if squared > 0.0 { 0.5 * (squared - 1.0) * length + excess } else { 0.0 };
            x * v.x + y * v.y + z * v.z - unit
        })
    }
}

/// A medium with what its guided walks need: kernels, coefficients relative to the densest channel.
#[derive(Debug, Clone)]
pub struct GuidedMedium {
    pub medium: Medium,
    pub kernels: [Kernel; 3],
    /// Channels that differ: 1 of a grey medium, whose densities are then those of one.
    channels: usize,
    /// Largest sigma_t: path lengths are kept in its mean free paths.
    pub scale: f32,
    /// sigma_t / scale.
    sigma: DVec3,
    ln_sigma: DVec3,
    ln_albedo: DVec3,
    ln_alpha_hat: DVec3,
}

impl GuidedMedium {
    pub fn new(medium: Medium) -> Self {
        Self::with_kernels(medium, [0, 1, 2].map(|c| Kernel::new(medium.albedo[c], medium.g)))
    }

    /// For classical walks only: quick for any phase function.
    pub fn unguided(medium: Medium) -> Self {
        Self::with_kernels(medium, [0, 1, 2].map(|_| Kernel::classical(medium.g)))
    }

    fn with_kernels(medium: Medium, kernels: [Kernel; 3]) -> Self {
        let scale = medium.sigma_t.max_element();
        let sigma = medium.sigma_t.as_dvec3() / f64::from(scale);
        // A channel without extinction or scattering never collides: 1e-300 per collision is as good as never.
        let ln = |v: DVec3| v.max(DVec3::splat(1e-300)).map(f64::ln);
        Self {
            channels: if grey(medium.sigma_t) && grey(medium.albedo) { 1 } else { 3 },
            scale,
            sigma,
            ln_sigma: ln(sigma),
            ln_albedo: ln(medium.albedo.as_dvec3()),
            ln_alpha_hat: ln(Rgb::from_array([0, 1, 2].map(|c| kernels[c].alpha_hat)).as_dvec3()),
            medium,
            kernels,
        }
    }
}

fn grey(c: Rgb) -> bool {
    c.x == c.y && c.y == c.z
}

/// What the densities of a path under way depend on; lengths in mean free paths of the densest channel,
/// summed in f64 from the segments as they were drawn.
#[derive(Debug, Clone, Copy)]
pub struct Prefix {
    pub collisions: u32,
    pub length: f64,
    pub displacement: DVec3,
    /// First direction and its length.
    pub first: Vec3,
    pub first_length: f64,
    /// Direction of the last segment.
    pub last: Vec3,
    /// Sum of lengths times [`excess_of`] their directions.
    excess: f64,
}

/// Half of what the squared length of a unit vector exceeds 1 by, for rounding.
fn excess_of(w: Vec3) -> f64 {
    0.5 * (w.as_dvec3().length_squared() - 1.0)
}

impl Prefix {
    pub fn new(d: Vec3) -> Self {
        let displacement = DVec3::ZERO;
        Self { collisions: 0, length: 0.0, displacement, first: d, first_length: 0.0, last: d, excess: 0.0 }
    }

    /// A segment of length `t` (mean free paths of the densest channel) along `last`.
    pub fn travel(&mut self, t: f64) {
        self.length += t;
        self.displacement += self.last.as_dvec3() * t;
        self.excess += excess_of(self.last) * t;
        if self.collisions == 0 {
            self.first_length = t;
        }
    }
}

/// Where a prefix ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum At {
    Boundary,
    /// At a collision, before its direction is drawn.
    Collision,
}

/// Densities of one path under every technique and what it carries, relative to a common reference.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Densities {
    pub p: PerTechnique,
    /// The path's contribution per channel, albedos included.
    pub f: Rgb,
    /// Sum of shares times densities.
    pub mixture: f32,
}

impl Densities {
    /// f / pdf of the marginal.
    pub fn weight(&self) -> Rgb {
        self.f / self.mixture
    }

    /// Densities over that of the mixture: expectation 1 each, for every technique of the mixture.
    pub fn ratios(&self) -> PerTechnique {
        self.p.scaled(1.0 / self.mixture)
    }
}

/// Largest exponent kept relative to the reference: exp of it is finite in f32. What is beyond has a probability below
/// e^-80 under every technique that could have drawn it.
const LARGEST: f32 = 80.0;

/// Smallest: what is less is nothing beside it.
const SMALLEST: f32 = -87.0;

impl Techniques {
    /// Densities of the path `prefix` under every technique (guiding.md 1.3, 1.5, 8.2; restated for prefixes that
    /// end at a collision).
    pub fn densities(&self, medium: &GuidedMedium, prefix: &Prefix, at: At) -> Densities {
        let n = f64::from(prefix.collisions);
        let turns = if at == At::Boundary { n } else { n - 1.0 };
        let plain = medium.ln_sigma * n - medium.sigma * prefix.length;
        let carried = plain + medium.ln_albedo * n;

        // In f64 until the largest is subtracted: they reach thousands where their differences matter to 1e-5.
        let along = self.along(prefix);
        let mut guided = [[0.0; LANES]; 3];
        for c in 0..medium.channels {
            let base = plain[c] + turns * medium.ln_alpha_hat[c];
            let slope = f64::from(medium.kernels[c].kappa) * medium.sigma[c];
            for i in 0..LANES {
                guided[c][i] = base + slope * along[i];
            }
        }
        for c in medium.channels..3 {
            guided[c] = guided[0];
        }
        let largest = self.largest_drawn(&guided, plain);
        let mut p = PerTechnique::default();
        for c in 0..medium.channels {
            p.guided[c] = exp8(guided[c], largest);
            p.classical[c] = crate::math::exp1(((plain[c] - largest) as f32).min(LARGEST));
        }
        self.turn(medium, prefix, at, &mut p);
        for c in medium.channels..3 {
            (p.guided[c], p.classical[c]) = (p.guided[0], p.classical[0]);
        }
        let f = (carried - largest).as_vec3().min(Rgb::splat(LARGEST));
        Densities { mixture: self.shares.dot(&p), p, f: crate::math::exp(f) }
    }

    /// Largest exponent among the techniques that are drawn at all.
    fn largest_drawn(&self, guided: &[[f64; LANES]; 3], plain: DVec3) -> f64 {
        let mut largest = f64::NEG_INFINITY;
        for c in 0..3 {
            for (e, share) in guided[c].iter().zip(self.shares.guided[c]) {
                largest = largest.max(if share > 0.0 { *e } else { f64::NEG_INFINITY });
            }
            if self.shares.classical[c] > 0.0 {
                largest = largest.max(plain[c]);
            }
        }
        largest
    }

    /// The factors of the first and the last direction: phi(last) / phi(first), at a collision times the stretch
    /// of the last distance, over that of the first distance where it was drawn classically.
    fn turn(&self, medium: &GuidedMedium, prefix: &Prefix, at: At, p: &mut PerTechnique) {
        let (first, last) = (self.complements(prefix.first), self.complements(prefix.last));
        let classical_first = !self.guided_first && prefix.collisions > 0;
        if prefix.collisions == 0 && !classical_first && at == At::Boundary {
            return;
        }
        for c in 0..medium.channels {
            let kernel = &medium.kernels[c];
            let (phi_first, phi_last) = (kernel.phi8(&first), kernel.phi8(&last));
            let stretch = |complement: f32| kernel.stretch_at(complement);
            for i in 0..LANES {
                let mut factor = phi_last[i] / phi_first[i];
                if at == At::Collision {
                    factor *= stretch(last[i]);
                }
                if classical_first {
                    factor /= stretch(first[i]);
                }
                p.guided[c][i] *= factor;
            }
        }
    }

    /// Solid-angle pdf of the direction `wi` after the collision at the end of `prefix`, whose densities are
    /// `densities`: the techniques' pdfs, weighted by how likely each brought the path here.
    pub fn direction_pdf(
        &self,
        medium: &GuidedMedium,
        prefix: &Prefix,
        densities: &Densities,
        phase: f32,
        wi: Vec3,
    ) -> f32 {
        let (last, next) = (self.complements(prefix.last), self.complements(wi));
        let mut pdf = 0.0;
        for c in 0..3 {
            let kernel = &medium.kernels[c];
            let (phi_last, phi_next) = (kernel.phi8(&last), kernel.phi8(&next));
            for i in 0..LANES {
                let turned = kernel.alpha_hat * phi_next[i] / (kernel.stretch_at(last[i]) * phi_last[i]);
                pdf += self.shares.guided[c][i] * densities.p.guided[c][i] * turned;
            }
            pdf += self.shares.classical[c] * densities.p.classical[c];
        }
        phase * pdf / densities.mixture
    }
}

/// exp(x - shift), exponents clamped to what f32 holds.
fn exp8(x: [f64; LANES], shift: f64) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    for i in 0..LANES {
        out[i] = crate::math::exp_in_lanes(((x[i] - shift) as f32).clamp(SMALLEST, LARGEST));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One channel's work stands for all three of a grey medium, bit for bit.
    #[test]
    fn grey_media_have_the_densities_of_three_channels() {
        let grey = GuidedMedium::new(Medium { sigma_t: Rgb::splat(3.0), albedo: Rgb::splat(0.9), g: 0.4 });
        assert_eq!(grey.channels, 1);
        let three = GuidedMedium { channels: 3, ..grey.clone() };
        let mut techniques = Techniques::default();
        techniques.set_normal(0, Vec3::Z);
        techniques.set_normal(1, Vec3::new(0.6, 0.0, -0.8));
        techniques.shares = PerTechnique { guided: [[0.1; LANES]; 3], classical: [0.1; 3] };
        let mut prefix = Prefix::new(Vec3::new(0.0, 0.6, 0.8));
        for (t, w) in [(0.7, Vec3::X), (1.9, Vec3::NEG_Z)] {
            prefix.travel(t);
            prefix.collisions += 1;
            prefix.last = w;
            for at in [At::Boundary, At::Collision] {
                assert_eq!(techniques.densities(&grey, &prefix, at), techniques.densities(&three, &prefix, at));
            }
        }
        let colored = Medium { albedo: Rgb::new(0.9, 0.9, 0.8), ..grey.medium };
        assert_eq!(GuidedMedium::new(colored).channels, 3);
    }
}
