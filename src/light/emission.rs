//! How bright a light is: UsdLux' radiometry, the same for every shape.
//!
//! `intensity` 1, white, is 1 nit: seen directly it renders as 1.

use super::{
    choice::Spread,
    ies::Profile,
    shaping::{Shaping, angle_between},
};
use crate::{flat, math::Rgb};
use glam::{Mat3, Vec3};

/// Radiance above which products with pdfs leave the range of f32. As f32 has it, so that 1e30 itself may be authored.
pub const RADIANCE_LIMIT: f64 = 1e30_f32 as f64;

/// Radiance of a light before its texture.
#[derive(Debug, Clone, PartialEq)]
pub struct Emission {
    /// On the axis.
    pub radiance: Rgb,
    /// The light's -Z axis, render space, unit.
    pub axis: Vec3,
    shaping: Option<Shaping>,
    profile: Option<Box<Profile>>,
}

impl Emission {
    /// intensity 2^exposure / sizeFactor, times color and blackbody (UsdLuxLightAPI). `Err` says which
    /// attribute is at fault.
    pub fn new(light: &flat::Light, axis: Vec3, size_factor: f64) -> Result<Self, String> {
        check(light)?;
        let size = if light.normalize { size_factor } else { 1.0 };
        let scalar = f64::from(light.intensity) * f64::from(light.exposure).exp2() / size;
        let channel = |i: usize| {
            let blackbody = if light.enable_color_temperature { f64::from(light.blackbody[i]) } else { 1.0 };
            scalar * f64::from(light.color[i]) * blackbody
        };
        let radiance = [channel(0), channel(1), channel(2)];
        if radiance.iter().any(|c| !c.is_finite() || c.abs() > RADIANCE_LIMIT) {
            return Err("inputs:intensity, inputs:exposure and inputs:normalize give a radiance beyond 1e30".into());
        }
        let radiance = Vec3::from(radiance.map(|c| c as f32));
        Ok(Self { radiance, axis, shaping: light.shaping.as_ref().map(Shaping::new), profile: None })
    }

    pub fn without_shaping(self) -> Self {
        Self { shaping: None, profile: None, ..self }
    }

    /// With the IES profile of `light`, if it has one; `to_light`: from render space to its own. `Err` says what is at
    /// fault.
    pub fn profiled(self, light: &flat::Light, to_light: Mat3) -> Result<Self, String> {
        let Some(ies) = light.shaping.as_ref().and_then(|shaping| shaping.ies.as_ref()) else { return Ok(self) };
        let profile = Profile::new(ies, to_light);
        let (brightest, largest) = (f64::from(self.radiance.abs().max_element()), f64::from(profile.largest()));
        if brightest * largest > RADIANCE_LIMIT || !largest.is_finite() {
            return Err(format!(
                "inputs:shaping:ies:file: with its largest factor, {largest:e}, inputs:intensity and inputs:exposure give a \
                 radiance beyond 1e30: lower them, or set inputs:shaping:ies:normalize"
            ));
        }
        Ok(Self { profile: Some(Box::new(profile)), ..self })
    }

    pub fn scaled(self, factor: f32) -> Self {
        Self { radiance: self.radiance * factor, ..self }
    }

    /// Radiance along the unit direction `wo` that leaves the light.
    pub fn towards(&self, wo: Vec3) -> Rgb {
        let Some(shaping) = &self.shaping else { return self.radiance };
        let shaped = self.radiance * shaping.factor(angle_between(self.axis, wo));
        self.profile.as_ref().map_or(shaped, |profile| shaped * profile.factor(wo))
    }

    /// Angle off the axis beyond which nothing is emitted, radians; `None`: there is no cone.
    pub fn cutoff(&self) -> Option<f32> {
        self.shaping.as_ref().map(Shaping::cutoff)
    }

    /// Estimate of the radiance, mean of the channels' magnitudes, over the directions within `spread` of
    /// `wo`; positive wherever it is not zero there.
    pub fn bound(&self, wo: Vec3, spread: &Spread) -> f32 {
        let Some(shaping) = &self.shaping else { return magnitude(self.radiance) };
        let (theta, spread) = (angle_between(self.axis, wo), spread.angle());
        let hi = (theta + spread).min(std::f32::consts::PI);
        let largest = self.profile.as_ref().map_or(1.0, |profile| profile.largest());
        magnitude(self.radiance * shaping.bound((theta - spread).max(0.0), hi)) * largest
    }
}

/// Mean of the channels' magnitudes: zero only where the colour is, even out of gamut.
pub fn magnitude(c: Rgb) -> f32 {
    crate::math::mean(c.abs())
}

fn check(light: &flat::Light) -> Result<(), String> {
    let finite = |name: &str, values: &[f32]| match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(format!("{name} is not finite")),
    };
    finite("inputs:intensity", &[light.intensity])?;
    finite("inputs:exposure", &[light.exposure])?;
    finite("inputs:color", &light.color)?;
    if light.enable_color_temperature {
        finite("inputs:colorTemperature", &light.blackbody)?;
    }
    if light.intensity < 0.0 {
        return Err(format!("inputs:intensity is negative ({})", light.intensity));
    }
    let Some(shaping) = &light.shaping else { return Ok(()) };
    finite("inputs:shaping:focus", &[shaping.focus])?;
    finite("inputs:shaping:focusTint", &shaping.focus_tint)?;
    finite("inputs:shaping:cone:angle", &[shaping.cone_angle])?;
    finite("inputs:shaping:cone:softness", &[shaping.cone_softness])?;
    if shaping.cone_angle <= 0.0 {
        return Err(format!("inputs:shaping:cone:angle leaves no light ({})", shaping.cone_angle));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factors_multiply() {
        let light = flat::Light {
            intensity: 3.0,
            exposure: 2.0,
            color: [1.0, 0.5, 0.25],
            enable_color_temperature: true,
            blackbody: [2.0, 1.0, 4.0],
            normalize: true,
            ..Default::default()
        };
        let e = Emission::new(&light, Vec3::NEG_Z, 6.0).unwrap();
        assert_eq!(e.radiance, Vec3::new(4.0, 1.0, 2.0));
        let plain = flat::Light { normalize: false, enable_color_temperature: false, ..light };
        assert_eq!(Emission::new(&plain, Vec3::NEG_Z, 6.0).unwrap().radiance, Vec3::new(12.0, 6.0, 3.0));
    }

    #[test]
    fn faults_name_their_attribute() {
        let fault = |light: flat::Light| Emission::new(&light, Vec3::NEG_Z, 1.0).unwrap_err();
        assert!(fault(flat::Light { intensity: f32::NAN, ..Default::default() }).contains("inputs:intensity"));
        assert!(fault(flat::Light { intensity: -1.0, ..Default::default() }).contains("inputs:intensity"));
        assert!(fault(flat::Light { exposure: f32::INFINITY, ..Default::default() }).contains("inputs:exposure"));
        assert!(fault(flat::Light { exposure: 200.0, ..Default::default() }).contains("1e30"));
        assert!(fault(flat::Light { color: [f32::NAN; 3], ..Default::default() }).contains("inputs:color"));
        let shaping = Some(flat::Shaping { cone_angle: 0.0, ..Default::default() });
        assert!(fault(flat::Light { shaping, ..Default::default() }).contains("cone:angle"));
    }
}
