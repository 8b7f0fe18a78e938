//! The zero-variance kernel of Henyey-Greenstein scattering along a slab normal: eigenvalue and eigenfunction.
//!
//! The largest eigenvalue nu0 of the transport equation and its eigenfunction phi satisfy
//! (1 - kappa mu) phi(w) = alpha int HG(w.w') phi(w') dw', kappa = 1 / nu0 (Case and Zweifel 1967, chapter 4). In
//! moments, phi(mu) = N(mu) / (1 - kappa mu) with N(mu) = sum (2l + 1) g^l h_l P_l(mu), where h is the decaying
//! solution of (2l + 1)(1 - alpha g^l) nu0 h_l = (l + 1) h_{l+1} + l h_{l-1} (guiding.md section 8.2). N is as
//! smooth as the phase function and is tabulated; the factor 1 / (1 - kappa mu) is not, it can be sharp.

use super::dwivedi::{Dwivedi, kappa as isotropic_kappa, representable};
use crate::math::{Frame, TAU};
use crate::medium::{phase_eval, phase_sample};
use crate::sampling::direction_in;
use crate::sampling::sampler::Sampler;
use glam::{Vec2, Vec3};

/// Powers g^l below it are nothing beside 1.
const NEGLIGIBLE: f64 = 1e-17;

/// Decays of the moments by which the downward recursion forgets its start: exp(-40) of the error is left.
const DECAYS: f64 = 20.0;

/// Longest recursion: resolves nu0 - 1 down to 2e-7, next to f32's roundoff.
const MAX_MOMENTS: f64 = 3e4;

/// Table cells times 1 - |g|, the width of the phase function: linear interpolation errs by about 1e-6.
const CELLS: f32 = 800.0;

#[derive(Debug)]
pub(super) struct Eigenfunction {
    pub kappa: f32,
    pub complement: f32,
    pub alpha_hat: f32,
    g: f32,
    /// N at equal steps of [`coordinate`], one more than cells.
    table: Vec<f32>,
    /// Table cells per unit of the coordinate.
    scale: f32,
    proposal: Proposal,
}

/// What rejection draws from; `accept` times the rest of the density is a probability.
#[derive(Debug)]
enum Proposal {
    /// The phase function, accepted with phi.
    Phase { accept: f32 },
    /// 1 / (1 - kappa mu), accepted with the phase function times N: where kappa is near 1 and phi sharp.
    Slab { dwivedi: Dwivedi, accept: f32 },
}

impl Eigenfunction {
    /// For the eigenpair with a representable kappa next to that of `albedo`.
    pub fn new(albedo: f32, g: f32) -> Self {
        let kappa = representable(kappa(f64::from(albedo), f64::from(g)));
        let alpha = albedo_of(kappa, f64::from(g));
        let cells = (CELLS / (1.0 - g.abs())).max(1024.0) as usize;
        let table = tabulate(&series(alpha, f64::from(g), kappa), cells);
        let mut new = Self {
            kappa: kappa as f32,
            complement: (1.0 - kappa) as f32,
            alpha_hat: alpha as f32,
            g,
            table,
            scale: cells as f32 * 0.5,
            proposal: Proposal::Phase { accept: 1.0 },
        };
        new.proposal = new.best_proposal();
        new
    }

    /// N at 1 - mu.
    #[inline(always)]
    pub fn source(&self, one_minus_mu: f32) -> f32 {
        let x = coordinate(one_minus_mu) * self.scale;
        let i = (x as usize).min(self.table.len() - 2);
        let (a, b) = (self.table[i], self.table[i + 1]);
        a + (b - a) * (x - i as f32)
    }

    /// [`Eigenfunction::source`] of eight.
    pub fn source8(&self, one_minus_mu: &[f32; 8]) -> [f32; 8] {
        let x = one_minus_mu.map(|c| coordinate(c) * self.scale);
        let i = x.map(|x| (x as usize).min(self.table.len() - 2));
        std::array::from_fn(|k| {
            let (a, b) = (self.table[i[k]], self.table[i[k] + 1]);
            a + (b - a) * (x[k] - i[k] as f32)
        })
    }

    fn stretch(&self, one_minus_mu: f32) -> f32 {
        self.complement + self.kappa * one_minus_mu
    }

    /// Direction with density alpha_hat HG(d.w) phi(n.w) / N(n.d), n the normal of `frame`.
    pub fn sample(&self, frame: &Frame, d: Vec3, sampler: &mut Sampler) -> Vec3 {
        loop {
            let u = Vec2::new(sampler.random(), sampler.random());
            let (w, probability) = match &self.proposal {
                Proposal::Phase { accept } => {
                    let w = phase_sample(self.g, d, u);
                    let c = 0.5 * (w - frame.n).length_squared();
                    (w, accept * self.source(c) / self.stretch(c))
                }
                Proposal::Slab { dwivedi, accept } => {
                    let c = dwivedi.sample(u.x);
                    let w = direction_in(frame, c, u.y);
                    (w, accept * self.source(c) * phase_eval(self.g, d.dot(w)))
                }
            };
            if sampler.random() < probability {
                return w;
            }
        }
    }

    /// Expected draws per direction are alpha_hat times either bound over N(n.d).
    fn best_proposal(&self) -> Proposal {
        let dwivedi = Dwivedi::from_kappa(f64::from(self.kappa));
        let peak = phase_eval(self.g, 1.0_f32.copysign(self.g));
        let source_max = self.table.iter().copied().fold(0.0, f32::max);
        // Over a cell phi is at most its larger N over the stretch of its near end.
        let cell = |(i, ends): (usize, &[f32])| {
            ends[0].max(ends[1]) / self.stretch(complement_at(i as f64 / f64::from(self.scale)) as f32)
        };
        let phi_max = self.table.windows(2).enumerate().map(cell).fold(0.0, f32::max);
        if phi_max < 2.0 * TAU * peak * source_max / dwivedi.alpha_hat {
            Proposal::Phase { accept: 1.0 / phi_max }
        } else {
            Proposal::Slab { dwivedi, accept: 1.0 / (source_max * peak) }
        }
    }
}

/// From 1 - mu to 0..=2, about proportional to the angle near both poles, where the phase function peaks.
#[inline(always)]
fn coordinate(one_minus_mu: f32) -> f32 {
    let r = one_minus_mu.min(2.0 - one_minus_mu).max(0.0).sqrt(); // rounding beyond the poles
    if one_minus_mu <= 1.0 { r } else { 2.0 - r }
}

/// Inverse of [`coordinate`].
fn complement_at(x: f64) -> f64 {
    if x <= 1.0 { x * x } else { 2.0 - (2.0 - x) * (2.0 - x) }
}

/// 1 / nu0 for single-scattering albedo `alpha` in 0..=1 and |g| < 1; 1 where nu0 - 1 is below f32's roundoff.
pub(super) fn kappa(alpha: f64, g: f64) -> f64 {
    if alpha >= 1.0 {
        return 0.0;
    }
    if g == 0.0 {
        return isotropic_kappa(alpha as f32);
    }
    bisect(|kappa| above_spectrum(alpha, g, kappa))
}

/// The albedo for which `kappa` is exact: nu0 grows with the albedo.
fn albedo_of(kappa: f64, g: f64) -> f64 {
    bisect(|alpha| above_spectrum(alpha, g, kappa))
}

/// End of the interval from 0 on, within 0..=1, in which `holds`; to 1e-21.
fn bisect(holds: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..70 {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    0.5 * (low + high)
}

/// Whether 1 / kappa exceeds all eigenvalues of the moment equations: their tridiagonal matrix is then positive
/// definite, which is to say all pivots of its elimination from below are positive.
fn above_spectrum(alpha: f64, g: f64, kappa: f64) -> bool {
    let mut positive = true;
    recursion(alpha, g, kappa, |_, pivot| positive &= pivot > 0.0);
    positive
}

/// Calls `visit(l, pivot)` for falling l, pivot = (2l + 1)(1 - alpha g^l) nu0 - (l + 1)^2 / next pivot;
/// h_l / h_{l-1} = l / pivot.
fn recursion(alpha: f64, g: f64, kappa: f64, mut visit: impl FnMut(usize, f64)) {
    let nu = 1.0 / kappa;
    let scattering = NEGLIGIBLE.ln() / g.abs().ln();
    // Beyond, h_l falls like exp(-l acosh(nu0)), and going down the error of its ratio like the square of that.
    let free = (DECAYS / nu.acosh()).min(MAX_MOMENTS);
    let moments = (scattering + free) as usize + 2;
    let mut next = (moments + 1) as f64 * (nu + (nu * nu - 1.0).max(0.0).sqrt());
    let mut power = 0.0;
    for l in (0..=moments).rev() {
        power = match l {
            0 => 1.0,
            l if l as f64 > scattering => 0.0,
            l if power == 0.0 => g.powi(l as i32),
            _ => power / g,
        };
        let l1 = (l + 1) as f64;
        let pivot = (l as f64 + l1) * (1.0 - alpha * power) * nu - l1 * l1 / next;
        visit(l, pivot);
        next = pivot;
    }
}

/// Coefficients (2l + 1) g^l h_l of N, h_0 = 1, as far as they count.
fn series(alpha: f64, g: f64, kappa: f64) -> Vec<f64> {
    let mut pivots = Vec::new();
    recursion(alpha, g, kappa, |_, pivot| pivots.push(pivot));
    pivots.reverse();
    let mut h = 1.0;
    let term = |(l, pivot): (usize, &f64)| {
        h *= if l == 0 { 1.0 } else { g * l as f64 / pivot };
        (2 * l + 1) as f64 * h
    };
    pivots.iter().enumerate().map(term).take_while(|c| c.abs() > NEGLIGIBLE).collect()
}

/// The Legendre series at the ends of `cells` equal cells of the coordinate, eight at a time.
fn tabulate(series: &[f64], cells: usize) -> Vec<f32> {
    let node = |i: usize| 1.0 - complement_at(2.0 * i as f64 / cells as f64);
    let eight = |first: usize| legendre8(series, &std::array::from_fn(|i| node((first + i).min(cells))));
    (0..=cells).step_by(8).flat_map(eight).take(cells + 1).map(|n| n as f32).collect()
}

/// sum c_l P_l(x) by Clenshaw's recurrence, b_l = c_l + (2l + 1)/(l + 1) x b_{l+1} - (l + 1)/(l + 2) b_{l+2}.
fn legendre8(c: &[f64], x: &[f64; 8]) -> [f64; 8] {
    let (mut b1, mut b2) = ([0.0; 8], [0.0; 8]);
    for (l, &c) in c.iter().enumerate().rev() {
        let l = l as f64;
        let (p, q) = ((2.0 * l + 1.0) / (l + 1.0), (l + 1.0) / (l + 2.0));
        let b = std::array::from_fn(|i| c + p * x[i] * b1[i] - q * b2[i]);
        (b1, b2) = (b, b1);
    }
    b1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// alpha int HG(d.w) phi(n.w) dw / N(n.d) - 1, in f64 from the table that sampling uses. Gauss-Legendre in kappa's
    /// own distribution of mu, where phi is flat, and midpoints of the azimuth.
    fn residual(e: &Eigenfunction, d: f64) -> f64 {
        // From the poles every azimuth looks alike.
        let (cells, azimuths) = if d.abs() == 1.0 { (20_000, 1) } else { (800, 256) };
        let gauss = [(-0.6_f64.sqrt(), 5.0 / 18.0), (0.0, 4.0 / 9.0), (0.6_f64.sqrt(), 5.0 / 18.0)];
        let (kappa, g) = (f64::from(e.kappa), f64::from(e.g));
        let (y, rest) = (kappa.atanh(), f64::from(e.complement));
        let sin_d = (1.0 - d * d).sqrt();
        let mut sum = 0.0;
        for (i, (at, weight)) in (0..cells).flat_map(|i| gauss.map(|node| (i, node))) {
            let c = rest * (2.0 * y * (i as f64 + 0.5 + 0.5 * at) / cells as f64).exp_m1() / kappa;
            let sin = (c * (2.0 - c)).sqrt();
            for j in 0..azimuths {
                let phi = std::f64::consts::PI * (j as f64 + 0.5) / azimuths as f64;
                let cos = d * (1.0 - c) + sin_d * sin * phi.cos();
                sum += weight * f64::from(e.source(c as f32)) / (1.0 + g * g - 2.0 * g * cos).powf(1.5);
            }
        }
        // dmu = (1 - kappa mu) 2y / kappa du takes the stretch out of phi.
        let integral = (1.0 - g * g) * sum / (cells * azimuths) as f64 * y / kappa;
        f64::from(e.alpha_hat) * integral / f64::from(e.source((1.0 - d) as f32)) - 1.0
    }

    /// The pdf that divides by N(n.d) is the density of what is drawn from the table.
    #[test]
    fn the_table_solves_the_eigenvalue_equation() {
        for g in [0.01, 0.3, 0.5, 0.8, 0.9, -0.4, -0.8] {
            for albedo in [0.15_f32, 0.5, 0.8, 0.99, 0.999] {
                let e = Eigenfunction::new(albedo.max(0.15 + 0.4 * f32::max(-g, 0.0)), g);
                assert!(e.table.iter().all(|&n| n > 0.0));
                for d in [-1.0, -0.7, 0.0, 0.5, 0.9, 1.0] {
                    let r = residual(&e, d);
                    assert!(r.abs() < 3e-6, "g {g} albedo {albedo} mu {d}: {r:e}");
                }
            }
        }
    }

    /// Largest eigenvalues computed with scipy's eigvalsh_tridiagonal from 3000 moments.
    #[test]
    fn known_eigenvalues() {
        for (alpha, g, complement) in KNOWN {
            let got = 1.0 - kappa(alpha, g);
            assert!((got / complement - 1.0).abs() < 1e-8, "albedo {alpha} g {g}: {got:e}");
            let back = albedo_of(1.0 - complement, g);
            assert!((back / alpha - 1.0).abs() < 1e-8, "albedo {alpha} g {g}: back {back}");
        }
    }

    const KNOWN: [(f64, f64, f64); 8] = [
        (0.3, 0.5, 0.0588163671929),
        (0.8, 0.5, 0.458166336511),
        (0.99, 0.5, 0.877567571171),
        (0.5, 0.8, 0.308120860945),
        (0.99, 0.8, 0.921862192524),
        (0.999, 0.95, 0.987686837148),
        (0.8, -0.4, 0.199684300203),
        (0.9, -0.8, 0.35386191943),
    ];
}
