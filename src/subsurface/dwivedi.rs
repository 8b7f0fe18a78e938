//! The isotropic Dwivedi kernel: cosines with density alpha_hat / (2 (1 - kappa mu)) along a slab normal.
//!
//! nu0 solves 1 = (alpha nu0 / 2) ln((nu0 + 1) / (nu0 - 1)) (Krivanek and d'Eon 2014; guiding.md section 1.3). With
//! y = atanh(1 / nu0) that is tanh y = alpha y, and kappa = 1 / nu0 = tanh y. Any kappa in (0, 1) is a valid
//! density, exact for the albedo alpha_hat = kappa / atanh(kappa).

use crate::math::exp_m1;

/// kappa is a multiple of this below 1, so that kappa and 1 - kappa are both exact in f32 and everybody
/// computes with the same number. It caps y at 8.7: below albedo 0.115 kappa is that of 0.115.
const GRID: f64 = 1.0 / (1 << 24) as f64;

/// Below it the kernel is isotropic and classical but for rounding (guiding.md section 1.4).
const MIN_Y: f64 = 1e-3;

/// Below this albedo nu0 - 1 < 1e-43 (2 exp(-2 / alpha)), nothing even in f64.
const MIN_ALBEDO: f64 = 0.02;

#[derive(Debug, Clone, Copy)]
pub(super) struct Dwivedi {
    pub kappa: f32,
    /// 1 - kappa.
    pub complement: f32,
    /// Albedo for which kappa is exact.
    pub alpha_hat: f32,
    /// (1 - kappa) / kappa.
    growth: f32,
    /// 2 atanh(kappa).
    rate: f32,
}

impl Dwivedi {
    /// The kernel whose kappa is exact for `albedo`, as far as the limits of kappa allow.
    pub fn new(albedo: f32) -> Self {
        Self::from_kappa(kappa(albedo).max(MIN_Y.tanh()))
    }

    /// The kernel of the representable kappa next to `kappa`, 0 < kappa.
    pub fn from_kappa(kappa: f64) -> Self {
        let kappa = representable(kappa);
        let y = kappa.atanh();
        Self {
            kappa: kappa as f32,
            complement: (1.0 - kappa) as f32,
            alpha_hat: (kappa / y) as f32,
            growth: ((1.0 - kappa) / kappa) as f32,
            rate: (2.0 * y) as f32,
        }
    }

    /// 1 - mu of a cosine with density alpha_hat / (2 (1 - kappa mu)); falls from 2 to 0 as `u` grows from 0 to 1.
    pub fn sample(&self, u: f32) -> f32 {
        // 1 - kappa mu = exp(y (1 - 2u)) / cosh(y) = (1 - kappa) exp(2y (1 - u)), less 1 - kappa.
        (self.growth * exp_m1(self.rate * (1.0 - u))).clamp(0.0, 2.0) // rounding at the poles
    }
}

/// `kappa` on the grid, within (0, 1).
pub(super) fn representable(kappa: f64) -> f64 {
    (kappa / GRID).round().clamp(1.0, 1.0 / GRID - 1.0) * GRID
}

/// 1 / nu0 for `albedo` in 0..=1.
pub(super) fn kappa(albedo: f32) -> f64 {
    let alpha = f64::from(albedo);
    if alpha < MIN_ALBEDO {
        return 1.0;
    }
    let epsilon = 1.0 - alpha;
    if epsilon <= 0.0 {
        return 0.0;
    }
    // Newton on tanh y - alpha y from the two limits; in f64 the cancellation at albedo 1 - 2^-24 costs 1e-8.
    let mut y = if epsilon < 0.35 { (3.0 * epsilon * (1.0 + 1.2 * epsilon)).sqrt() } else { 1.0 / alpha };
    for _ in 0..6 {
        let t = y.tanh();
        y -= (t - alpha * y) / (1.0 - t * t - alpha);
    }
    y.tanh()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half the logarithm of (nu + 1) / (nu - 1) is atanh(1 / nu): root of alpha nu atanh(1 / nu) - 1 in y, by bisection.
    fn exact(alpha: f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.0 / alpha);
        for _ in 0..100 {
            let y: f64 = 0.5 * (low + high);
            // y / tanh(y) without cancellation for small y: its series is exact to 1e-16 below 0.01.
            let excess = if y < 0.01 { y * y / 3.0 - y.powi(4) / 45.0 } else { y / y.tanh() - 1.0 };
            *(if alpha * excess < 1.0 - alpha { &mut low } else { &mut high }) = y;
        }
        (0.5_f64 * (low + high)).tanh()
    }

    #[test]
    fn kappa_solves_the_dispersion_relation() {
        let mut worst = 0.0_f64;
        for i in 0..=400 {
            // epsilon from 1e-7 to 0.95, as representable by an albedo.
            let albedo = 1.0 - 10.0_f32.powf(-7.0 + i as f32 / 400.0 * 6.977_723_6);
            let (got, expected) = (kappa(albedo) as f32, exact(f64::from(albedo)));
            worst = worst.max((f64::from(got) / expected - 1.0).abs());
        }
        assert!(worst < 3e-7, "{worst}");
    }

    #[test]
    fn limits() {
        assert_eq!(kappa(1.0), 0.0);
        assert_eq!(kappa(0.0), 1.0);
        let (black, white) = (Dwivedi::new(0.0), Dwivedi::new(1.0));
        assert_eq!((black.kappa, black.complement), (1.0 - 2.0_f32.powi(-24), 2.0_f32.powi(-24)));
        assert!((black.alpha_hat - 0.115).abs() < 1e-3);
        assert!((white.kappa - 1e-3).abs() < 1e-6 && white.alpha_hat > 1.0 - 4e-7);
        for dwivedi in [black, white] {
            assert!((dwivedi.sample(0.0) - 2.0).abs() < 1e-6, "{}", dwivedi.sample(0.0));
            assert_eq!(dwivedi.sample(1.0), 0.0);
        }
    }

    /// kappa and its complement are one number, and alpha_hat is the albedo asked for.
    #[test]
    fn kappa_lies_on_its_grid() {
        for i in 12..=100 {
            let albedo = i as f32 / 100.0;
            let d = Dwivedi::new(albedo);
            assert_eq!(f64::from(d.kappa) + f64::from(d.complement), 1.0, "albedo {albedo}");
            let tolerance = if albedo < 0.2 { 0.02 } else { 1e-4 };
            assert!((d.alpha_hat / albedo - 1.0).abs() < tolerance, "{} for {albedo}", d.alpha_hat);
        }
    }
}
