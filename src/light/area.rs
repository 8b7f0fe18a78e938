//! A shape that emits.

use super::{
    choice::{Spread, facing},
    emission::Emission,
    rect::Rect,
    shape::{Shape, ShapeHit},
    texels::Texels,
};
use crate::math::{FRAC_1_PI, Rgb};
use glam::Vec3;

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
        // Rounding must not leave an emitting point outside its bound.
        let radius = shape.radius() * 1.001;
        let projected_area = shape.projected_area();
        Self { shape, emission, texture, brightness, center: 0.5 * (min + max), radius, projected_area }
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

    /// Estimated irradiance at p without shadows; positive wherever light may arrive. The bounds of the
    /// cosines and of the shaping over the bounding sphere are those of Conty Estevez and Kulla 2018,
    /// "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 4.
    pub fn importance(&self, p: Vec3, n: Option<Vec3>) -> f32 {
        if !self.shape.faces(p) {
            return 0.0;
        }
        let to = self.center - p;
        let (d2, wi) = (to.length_squared(), to.normalize_or_zero());
        let spread = Spread::of_ball(self.radius, d2);
        let cos_light = self.shape.common_normal().map_or(1.0, |normal| facing(-normal, wi, &spread));
        let cos_receiver = n.map_or(1.0, |n| facing(n, wi, &spread));
        let radiance = self.emission.bound(-wi, spread.angle()) * self.brightness;
        // Saturates at pi L, the most a surface can receive.
        let solid_angle = self.projected_area / (d2 + self.projected_area * FRAC_1_PI);
        radiance * cos_light * cos_receiver * solid_angle
    }
}
