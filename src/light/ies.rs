//! IES profiles: a factor on the emission by its direction in the light's own space.

use crate::flat;
use glam::{Mat3, Vec3};
use std::f64::consts::{FRAC_PI_2, PI};

#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Render space to the light's.
    to_light: Mat3,
    /// Radians, ascending; horizontal ones from 0 to 2 pi, or a single 0.
    vertical: Vec<f32>,
    horizontal: Vec<f32>,
    /// Rows of vertical angles, one per horizontal angle.
    factors: Vec<f32>,
    largest: f32,
    angle_scale: f32,
}

/// Vertical extent, radians, up to which a profile describes a hemisphere: a luminaire that shines down, with some slack.
const HEMISPHERE: f64 = FRAC_PI_2 + 0.1;

impl Profile {
    pub fn new(ies: &flat::Ies, to_light: Mat3) -> Self {
        let radians = |angles: &[f32]| angles.iter().map(|a| a.to_radians()).collect::<Vec<f32>>();
        let (vertical, horizontal) = (radians(&ies.vertical), radians(&ies.horizontal));
        let power = if ies.normalize { power(&vertical, &horizontal, &ies.candela) } else { 1.0 };
        let scale = if power > 0.0 { (1.0 / power) as f32 } else { 0.0 };
        let factors: Vec<f32> = ies.candela.iter().map(|c| c * scale).collect();
        let largest = factors.iter().copied().fold(0.0, f32::max);
        Self { to_light, vertical, horizontal, factors, largest, angle_scale: ies.angle_scale }
    }

    /// Of all directions.
    pub fn largest(&self) -> f32 {
        self.largest
    }

    /// Factor in the direction `wo` that leaves the light. UsdLux' polar coordinates of it: the nadir is the light's -Z, the
    /// horizontal angle goes from +X to +Y.
    pub fn factor(&self, wo: Vec3) -> f32 {
        let d = (self.to_light * wo).normalize_or(Vec3::NEG_Z);
        let across = d.truncate().length();
        let theta = self.scaled(across.atan2(-d.z));
        let phi = d.y.atan2(d.x);
        let phi = if phi < 0.0 { phi + 2.0 * PI as f32 } else { phi };
        // Outside of the vertical angles that were measured there is no light.
        let Some((v, s)) = place(&self.vertical, theta) else { return 0.0 };
        let (h, t) = place(&self.horizontal, phi).unwrap_or((0, 0.0));
        let row = |h: usize| {
            let at = |v: usize| self.factors[h * self.vertical.len() + v.min(self.vertical.len() - 1)];
            at(v) + (at(v + 1) - at(v)) * s
        };
        let next = (h + 1).min(self.horizontal.len() - 1);
        row(h) + (row(next) - row(h)) * t
    }

    /// UsdLuxShapingAPI's shaping:ies:angleScale.
    fn scaled(&self, theta: f32) -> f32 {
        let pi = PI as f32;
        let scaled = match self.angle_scale {
            0.0 => theta,
            scale if scale > 0.0 => theta / scale,
            scale => (theta - pi) / -scale + pi,
        };
        scaled.clamp(0.0, pi)
    }
}

/// Interval of ascending `angles` that holds `x`, and where in it; `None` outside.
fn place(angles: &[f32], x: f32) -> Option<(usize, f32)> {
    let (first, last) = (*angles.first()?, *angles.last()?);
    // Rounding of the angle must not leave the last interval.
    let slack = 1e-6;
    if !(first - slack..=last + slack).contains(&x) {
        return None;
    }
    let i = angles.partition_point(|&a| a <= x).saturating_sub(1).min(angles.len().saturating_sub(2));
    let Some(next) = angles.get(i + 1) else { return Some((0, 0.0)) };
    Some((i, ((x - angles[i]) / (next - angles[i])).clamp(0.0, 1.0)))
}

/// Mean candela over the sphere, or the hemisphere, that the vertical angles describe: what UsdLux calls the profile's
/// power is divided by, so that a uniform profile is 1 (as its reference renderer does; the schema's text multiplies).
/// Integral of the bilinear interpolant, exact in the horizontal angle; per vertical interval by Simpson's rule in 8 parts.
fn power(vertical: &[f32], horizontal: &[f32], candela: &[f32]) -> f64 {
    let row = |h: usize| &candela[h * vertical.len()..(h + 1) * vertical.len()];
    let band = |row: &[f32]| -> f64 {
        let interval = |i: usize| {
            let (a, b) = (f64::from(vertical[i]), f64::from(vertical[i + 1]));
            let at = |t: f64| {
                let c = f64::from(row[i]) * (1.0 - t) + f64::from(row[i + 1]) * t;
                c * (a + (b - a) * t).sin()
            };
            let simpson = |k: u32| {
                let t = |half: f64| (f64::from(k) + half) / 8.0;
                (at(t(0.0)) + 4.0 * at(t(0.5)) + at(t(1.0))) / 48.0
            };
            (b - a) * (0..8).map(simpson).sum::<f64>()
        };
        (0..vertical.len().saturating_sub(1)).map(interval).sum()
    };
    let around = if horizontal.len() == 1 {
        2.0 * PI * band(row(0))
    } else {
        let slice = |h: usize| 0.5 * f64::from(horizontal[h + 1] - horizontal[h]) * (band(row(h)) + band(row(h + 1)));
        (0..horizontal.len() - 1).map(slice).sum()
    };
    let span = f64::from(vertical.last().unwrap_or(&0.0) - vertical.first().unwrap_or(&0.0));
    around / if span > HEMISPHERE { 4.0 * PI } else { 2.0 * PI }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(vertical: &[f32], candela: Vec<f32>, normalize: bool) -> Profile {
        let vertical = vertical.to_vec().into();
        let horizontal = vec![0.0].into();
        let ies = flat::Ies { vertical, horizontal, candela: candela.into(), angle_scale: 0.0, normalize };
        Profile::new(&ies, Mat3::IDENTITY)
    }

    #[test]
    fn uniform_profiles_are_one_when_normalized() {
        let sphere = profile(&[0.0, 60.0, 180.0], vec![7.0; 3], true);
        assert!((sphere.factor(Vec3::new(0.6, 0.0, 0.8)) - 1.0).abs() < 1e-5);
        let hemisphere = profile(&[0.0, 90.0], vec![3.0; 2], true);
        assert!((hemisphere.factor(Vec3::NEG_Z) - 1.0).abs() < 1e-5);
        assert_eq!(hemisphere.factor(Vec3::Z), 0.0);
    }

    #[test]
    fn angles_are_scaled_from_either_pole() {
        let ramp = profile(&[0.0, 180.0], vec![0.0, 180.0], false);
        let at = |scale: f32, degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Profile { angle_scale: scale, ..ramp.clone() }.factor(Vec3::new(sin, 0.0, -cos))
        };
        for (scale, degrees, expected) in
            [(0.0, 50.0, 50.0), (2.0, 50.0, 25.0), (0.5, 50.0, 100.0), (0.5, 120.0, 180.0), (-0.5, 150.0, 120.0)]
        {
            assert!((at(scale, degrees) - expected).abs() < 1e-3, "{scale} {degrees}: {}", at(scale, degrees));
        }
    }
}
