//! Authored numbers made usable: what is out of range is clamped, and said.

use crate::error::Warning;
use crate::math::Rgb;
use glam::Vec3;

/// Largest index of refraction (and 1 over the smallest) that is taken as authored.
const MAX_IOR: f32 = 50.0;

/// Henyey-Greenstein is a delta at 1; beyond this a walk never turns.
const MAX_ANISOTROPY: f32 = 0.99;

/// Collects the warnings of one material.
pub struct Check<'a> {
    pub prim: &'a str,
    /// `None`: nobody listens, and nothing is put into words.
    pub warnings: Option<&'a mut Vec<Warning>>,
}

impl Check<'_> {
    pub fn warn(&mut self, message: impl FnOnce() -> String) {
        if let Some(warnings) = &mut self.warnings {
            warnings.push(Warning::new(self.prim, message()));
        }
    }

    /// In [lo, hi]; what is not finite becomes `default`.
    pub fn range(&mut self, name: &str, value: f32, lo: f32, hi: f32, default: f32) -> f32 {
        self.color_range(name, [value; 3], lo, hi, Rgb::splat(default)).x
    }

    pub fn unit(&mut self, name: &str, value: f32, default: f32) -> f32 {
        self.range(name, value, 0.0, 1.0, default)
    }

    pub fn positive(&mut self, name: &str, value: f32, default: f32) -> f32 {
        self.range(name, value, 0.0, f32::MAX, default)
    }

    pub fn ior(&mut self, name: &str, value: f32) -> f32 {
        self.range(name, value, 1.0 / MAX_IOR, MAX_IOR, 1.5)
    }

    pub fn anisotropy(&mut self, name: &str, value: f32) -> f32 {
        self.range(name, value, -MAX_ANISOTROPY, MAX_ANISOTROPY, 0.0)
    }

    /// An albedo or reflectance.
    pub fn color(&mut self, name: &str, value: [f32; 3], default: f32) -> Rgb {
        self.color_range(name, value, 0.0, 1.0, Rgb::splat(default))
    }

    /// A colour without an upper limit.
    pub fn radiance(&mut self, name: &str, value: [f32; 3], default: Rgb) -> Rgb {
        self.color_range(name, value, 0.0, f32::MAX, default)
    }

    fn color_range(&mut self, name: &str, value: [f32; 3], lo: f32, hi: f32, default: Rgb) -> Rgb {
        let value = Vec3::from(value);
        let finite = Vec3::select(value.is_finite_mask(), value, default);
        let used = finite.clamp(Vec3::splat(lo), Vec3::splat(hi));
        if used != value {
            self.warn(|| {
                let allowed = limits(lo, hi);
                format!("inputs:{name} is {}, allowed is {allowed}; {} is used", show(value), show(used))
            });
        }
        used
    }
}

fn show(v: Vec3) -> String {
    if v.x.to_bits() == v.y.to_bits() && v.x.to_bits() == v.z.to_bits() { v.x.to_string() } else { v.to_string() }
}

fn limits(lo: f32, hi: f32) -> String {
    if hi == f32::MAX { format!("a finite number from {lo}") } else { format!("{lo} to {hi}") }
}
