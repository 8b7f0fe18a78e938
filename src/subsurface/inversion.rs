//! From the colour an artist asks for to the single-scattering albedo that shows it, by boundary.
//!
//! C = (1 - s)(1 - p s) / (1 + q s + r s^2), s = sqrt((1 - a) / (1 - a g)) is the share of transmitted
//! light that a half-space returns; coefficients fitted to adding-doubling solutions within 6e-5
//! (guiding.md section 5.3). C = 1 gives s = 0, hence a = 1: white is exactly white.

use crate::math::Rgb;

/// How light enters: collimated at normal incidence (OpenPBR's definition behind a dielectric) or diffuse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Illumination {
    Normal,
    Diffuse,
}

/// eta, (p, q, r) for normal incidence, (p, q, r) for diffuse incidence; smooth dielectric.
const FITS: [(f32, [f32; 3], [f32; 3]); 10] = [
    (1.0, [-0.44998, 2.35797, 1.36672], [-0.34476, 1.65425, 0.63236]),
    (1.1, [-0.26814, 2.54954, 1.93764], [-0.26320, 2.12774, 1.49904]),
    (1.2, [-0.33612, 3.13569, 3.11573], [-0.33719, 2.81422, 2.60696]),
    (1.3, [-0.38071, 3.79575, 4.34654], [-0.37811, 3.53225, 3.75683]),
    (1.33, [-0.39075, 4.00754, 4.72881], [-0.38700, 3.75751, 4.11607]),
    (1.4, [-0.40989, 4.52697, 5.64850], [-0.40383, 4.30382, 4.98498]),
    (1.5, [-0.42970, 5.33212, 7.03861], [-0.42125, 5.13935, 6.30899]),
    (1.6, [-0.44356, 6.21420, 8.52916], [-0.43366, 6.04535, 7.74013]),
    (1.8, [-0.46089, 8.22093, 11.84943], [-0.44983, 8.08743, 10.95638]),
    (2.0, [-0.47062, 10.57008, 15.67175], [-0.45962, 10.46141, 14.68873]),
];

/// Coefficients at `eta`, linear between the rows (error of the colour <= .0017); constant beyond them.
fn coefficients(eta: f32, illumination: Illumination) -> [f32; 3] {
    let row = |i: usize| match illumination {
        Illumination::Normal => FITS[i].1,
        Illumination::Diffuse => FITS[i].2,
    };
    let upper = FITS.iter().position(|fit| fit.0 >= eta).unwrap_or(FITS.len() - 1).max(1);
    let (eta0, eta1) = (FITS[upper - 1].0, FITS[upper].0);
    let x = ((eta - eta0) / (eta1 - eta0)).clamp(0.0, 1.0);
    let (a, b) = (row(upper - 1), row(upper));
    std::array::from_fn(|i| a[i] + x * (b[i] - a[i]))
}

/// Single-scattering albedo for multiple-scattering albedo `color` (0..=1); `eta` of the boundary, 1 for
/// diffuse and index-matched ones; `g` by similarity.
pub fn single_scattering_albedo(color: Rgb, g: f32, eta: f32, illumination: Illumination) -> Rgb {
    let [p, q, r] = coefficients(eta, illumination);
    let invert = |c: f32| {
        let b = 1.0 + p + c * q;
        let s = 2.0 * (1.0 - c) / (b + (b * b - 4.0 * (p - c * r) * (1.0 - c)).max(0.0).sqrt());
        ((1.0 - s * s) / (1.0 - g * s * s)).clamp(0.0, 1.0)
    };
    Rgb::new(invert(color.x), invert(color.y), invert(color.z))
}

/// The forward map: colour of a half-space of single-scattering albedo `albedo`.
pub fn multiple_scattering_albedo(albedo: Rgb, g: f32, eta: f32, illumination: Illumination) -> Rgb {
    let [p, q, r] = coefficients(eta, illumination);
    let forward = |a: f32| {
        let s = ((1.0 - a) / (1.0 - a * g)).max(0.0).sqrt();
        (1.0 - s) * (1.0 - p * s) / (1.0 + q * s + r * s * s)
    };
    Rgb::new(forward(albedo.x), forward(albedo.y), forward(albedo.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_is_exactly_white_and_black_is_black() {
        for eta in [1.0, 1.05, 1.33, 1.4, 1.5, 2.4] {
            for illumination in [Illumination::Normal, Illumination::Diffuse] {
                assert_eq!(single_scattering_albedo(Rgb::ONE, 0.3, eta, illumination), Rgb::ONE);
                assert!(single_scattering_albedo(Rgb::ZERO, 0.0, eta, illumination).max_element() < 1e-5);
            }
        }
    }

    #[test]
    fn round_trip() {
        for eta in [1.0, 1.17, 1.4, 1.75] {
            for g in [-0.4, 0.0, 0.8] {
                let color = Rgb::new(0.05, 0.46, 0.97);
                let albedo = single_scattering_albedo(color, g, eta, Illumination::Diffuse);
                let back = multiple_scattering_albedo(albedo, g, eta, Illumination::Diffuse);
                assert!((back - color).abs().max_element() < 1e-4, "eta {eta} g {g}: {back}");
            }
        }
    }

    /// Half-space values of guiding.md section 6 (adding-doubling).
    #[test]
    fn known_half_spaces() {
        let c = |a: f32, eta, ill| multiple_scattering_albedo(Rgb::splat(a), 0.0, eta, ill).x;
        assert!((c(0.95, 1.0, Illumination::Normal) - 0.535541).abs() < 1e-4);
        assert!((c(0.99, 1.0, Illumination::Diffuse) - 0.794564).abs() < 1e-4);
        assert!((c(0.95, 1.4, Illumination::Normal) - 0.369386).abs() < 1e-4);
        assert!((c(0.99, 1.4, Illumination::Normal) - 0.620835).abs() < 1e-4);
    }
}
