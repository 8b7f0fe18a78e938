//! What walks and path densities are in f64, as products over vertices: nothing of the renderer but its coefficients.

use dermis::subsurface::technique::{At, GuidedMedium, LANES, Prefix, TECHNIQUES, Techniques};
use glam::{DVec3, Vec3};

/// The eigenfunction phi = N / (1 - kappa mu) of Henyey-Greenstein scattering in f64 from its Legendre moments
/// (guiding.md 8.2): nothing of the renderer's table but the eigenvalue.
pub struct Eigenfunction {
    pub kappa: f64,
    terms: Vec<f64>,
}

impl Eigenfunction {
    pub fn new(kappa: f64, alpha: f64, g: f64) -> Self {
        if g == 0.0 {
            return Self { kappa, terms: vec![1.0] };
        }
        // h_l / h_(l - 1) = l / ((2l + 1)(1 - alpha g^l) nu - (l + 1) h_(l + 1) / h_l), downwards from far beyond.
        let (nu, last) = (1.0 / kappa, 4000_usize);
        let mut ratios = vec![0.0; last + 2];
        for l in (1..=last).rev() {
            let a = (2 * l + 1) as f64 * (1.0 - alpha * g.powi(l as i32)) * nu;
            ratios[l] = l as f64 / (a - (l + 1) as f64 * ratios[l + 1]);
        }
        let (mut h, mut terms) = (1.0, vec![1.0]);
        for l in 1..last {
            h *= g * ratios[l];
            terms.push((2 * l + 1) as f64 * h);
            if h.abs() < 1e-18 {
                break;
            }
        }
        Self { kappa, terms }
    }

    /// N at 1 - mu.
    pub fn source(&self, complement: f64) -> f64 {
        let (mu, mut p, mut before) = (1.0 - complement, 1.0, 0.0);
        let mut sum = 0.0;
        for (l, term) in self.terms.iter().enumerate() {
            sum += term * p;
            let l = l as f64;
            (p, before) = (((2.0 * l + 1.0) * mu * p - l * before) / (l + 1.0), p);
        }
        sum
    }

    pub fn stretch(&self, complement: f64) -> f64 {
        (1.0 - self.kappa) + self.kappa * complement
    }
}

/// 1 - n.w.
pub fn complement(n: Vec3, w: Vec3) -> f64 {
    0.5 * (w.as_dvec3() - n.as_dvec3()).length_squared()
}

/// Logarithms of all densities of a path under way, vertex by vertex; phase functions left out, all share them.
pub struct Product<'a> {
    pub medium: &'a GuidedMedium,
    pub techniques: &'a Techniques,
    pub functions: &'a [Eigenfunction; 3],
    pub p: [f64; TECHNIQUES],
    pub f: DVec3,
    pub collisions: u32,
}

impl Product<'_> {
    fn index(channel: usize, lane: Option<usize>) -> usize {
        channel * (LANES + 1) + lane.map_or(0, |lane| lane + 1)
    }

    /// Extinction of the technique's distances along `w`.
    pub fn rate(&self, channel: usize, lane: Option<usize>, w: Vec3) -> f64 {
        let along = lane.filter(|_| self.techniques.guided_first || self.collisions > 0);
        let stretch =
            along.map_or(1.0, |lane| self.functions[channel].stretch(complement(self.techniques.normal(lane), w)));
        f64::from(self.medium.medium.sigma_t[channel]) * stretch
    }

    fn each(&mut self, term: impl Fn(&Self, usize, Option<usize>) -> f64) {
        for channel in 0..3 {
            for lane in (0..LANES).map(Some).chain([None]) {
                let value = term(self, channel, lane);
                self.p[Self::index(channel, lane)] += value;
            }
        }
    }

    /// A segment of length t along w that met nothing.
    pub fn pass(&mut self, w: Vec3, t: f64) {
        self.each(|this, channel, lane| -this.rate(channel, lane, w) * t);
        self.f -= self.medium.medium.sigma_t.as_dvec3() * t;
    }

    /// A collision at its end.
    pub fn collide(&mut self, w: Vec3) {
        self.each(|this, channel, lane| this.rate(channel, lane, w).ln());
        let scattering = (self.medium.medium.sigma_t.as_dvec3() * self.medium.medium.albedo.as_dvec3()).map(f64::ln);
        self.f += scattering;
        self.collisions += 1;
    }

    /// A new direction `wi` after light came along `w`: alpha_hat phi(wi) / (stretch phi)(w), the phase function aside.
    pub fn turn(&mut self, w: Vec3, wi: Vec3) {
        self.each(|this, channel, lane| {
            let Some(lane) = lane else { return 0.0 };
            let (n, function) = (this.techniques.normal(lane), &this.functions[channel]);
            let (before, after) = (complement(n, w), complement(n, wi));
            let alpha_hat = f64::from(this.medium.kernels[channel].alpha_hat);
            (alpha_hat * function.source(after) / (function.stretch(after) * function.source(before))).ln()
        });
    }

    /// What the path carries over the density of the mixture.
    pub fn weight(&self) -> DVec3 {
        let shares = self.techniques.shares.as_list().map(f64::from);
        let drawn = self.p.iter().zip(shares).filter(|(_, share)| *share > 0.0);
        let highest = drawn.map(|(p, _)| *p).fold(f64::NEG_INFINITY, f64::max);
        let mixture: f64 = shares.iter().zip(self.p).map(|(share, p)| share * (p - highest).exp()).sum();
        self.f.map(|f| (f - highest).exp() / mixture)
    }

    /// Pdf of the direction just taken under the mixture, over the phase function; `before` is of the collision.
    pub fn direction_pdf(&self, before: &[f64; TECHNIQUES]) -> f64 {
        let highest = before.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let shares = self.techniques.shares.as_list().map(f64::from);
        let sum =
            |p: &[f64; TECHNIQUES]| -> f64 { shares.iter().zip(p).map(|(share, p)| share * (p - highest).exp()).sum() };
        sum(&self.p) / sum(before)
    }

    /// Largest relative error of the renderer's weight and ratios, as far as f32 holds them.
    pub fn error(&self, prefix: &Prefix, at: At) -> f64 {
        let got = self.techniques.densities(self.medium, prefix, at);
        let shares = self.techniques.shares.as_list().map(f64::from);
        let highest = self.p.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mixture: f64 = shares.iter().zip(self.p).map(|(share, p)| share * (p - highest).exp()).sum();
        let ratios = got.ratios().as_list();
        let ratio = |t: usize| (f64::from(ratios[t]), (self.p[t] - highest).exp() / mixture);
        let weight = |c: usize| (f64::from(got.weight()[c]), (self.f[c] - highest).exp() / mixture);
        // Below, exponents are clamped; nothing so small adds to a sum.
        let pairs = (0..TECHNIQUES).map(ratio).chain((0..3).map(weight)).filter(|(_, expected)| *expected > 1e-30);
        pairs.map(|(got, expected)| (got / expected - 1.0).abs()).fold(0.0, f64::max)
    }
}
