//! A shape that emits.

use super::{
    bound::Bound,
    choice::{Spread, facing},
    emission::Emission,
    rect::Rect,
    shape::{Shape, ShapeHit},
    texels::Texels,
};
use crate::math::{FRAC_1_PI, PI, Rgb};
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

#[derive(Debug, Clone)]
pub struct AreaLight {
    pub shape: Shape,
    emission: Emission,
    texture: Option<Texels>,
    /// Mean magnitude of the texture.
    brightness: f32,
    center: Vec3,
    radius: f32,
    projected_area: f32,
}

impl AreaLight {
    pub fn new(shape: Shape, emission: Emission, texture: Option<Texels>) -> Self {
        let (min, max) = shape.bounds();
        let brightness = texture.as_ref().map_or(1.0, |t| t.average() as f32);
        let center = 0.5 * (min + max);
        // Rounding must not leave an emitting point outside its bound.
        let radius = shape.radius() * 1.001 + 4.0 * f32::EPSILON * center.abs().max_element();
        let projected_area = shape.projected_area();
        Self { shape, emission, texture, brightness, center, radius, projected_area }
    }

    /// Whether it emits at all.
    pub fn shines(&self) -> bool {
        self.emission.radiance != Rgb::ZERO && self.brightness > 0.0
    }

    /// Radiance that arrives along `wi`, from the receiver to `hit`.
    pub fn radiance(&self, wi: Vec3, hit: &ShapeHit) -> Rgb {
        if !self.shape.emits(wi, hit) {
            return Rgb::ZERO;
        }
        let texture = self.texture.as_ref().map_or(Rgb::ONE, |texels| {
            let (s, t) = Rect::st(hit.local);
            texels.lookup(s, t)
        });
        self.emission.towards(-wi) * texture
    }

    /// For a cluster of lights.
    pub fn bound(&self) -> Bound {
        let (min, max) = self.shape.bounds();
        let (axis, spread, falloff) = match (self.emission.cutoff(), self.shape.normals()) {
            // Within a narrow cone the cosine hardly changes.
            (Some(cutoff), _) if cutoff < FRAC_PI_2 => (self.emission.axis, cutoff, 0.0),
            (_, Some((axis, spread))) => (axis, spread, FRAC_PI_2),
            (_, None) => (self.emission.axis, PI, FRAC_PI_2),
        };
        let plane = self.shape.common_normal().filter(|normal| *normal == axis);
        let plane = plane.map_or(f32::NEG_INFINITY, |normal| normal.dot(0.5 * (min + max)));
        // Products of f32 extremes neither vanish nor overflow.
        let intensity = f64::from(self.emission.bound(self.emission.axis, &Spread::of_angle(PI)))
            * f64::from(self.brightness)
            * f64::from(self.projected_area);
        Bound { min, max, axis, spread, falloff, plane, intensity }
    }

    /// Estimated irradiance at p without shadows; positive wherever light may arrive. The bounds of the
    /// cosines and of the shaping over the bounding sphere are those of Conty Estevez and Kulla 2018,
    /// "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.
    pub fn importance(&self, p: Vec3, n: Option<Vec3>) -> f32 {
        if !self.shape.faces(p) {
            return 0.0;
        }
        let to = self.center - p;
        let d2 = to.length_squared();
        // At the centre itself the spread is everything, whatever wi.
        let wi = to * d2.max(f32::MIN_POSITIVE).sqrt().recip();
        let spread = Spread::of_ball(self.radius, d2);
        let cos_light = self.shape.common_normal().map_or(1.0, |normal| facing(-normal, wi, &spread));
        let cos_receiver = n.map_or(1.0, |n| facing(n, wi, &spread));
        let radiance = self.emission.bound(-wi, &spread) * self.brightness;
        // Saturates at pi L, the most a surface can receive.
        let solid_angle = self.projected_area / (d2 + self.projected_area * FRAC_1_PI);
        radiance * cos_light * cos_receiver * solid_angle
    }
}
