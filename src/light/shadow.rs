//! `UsdLuxShadowAPI` and shadow linking: how the shadows of a light differ from those of everything.

use super::{Categories, Members};
use crate::{flat, math::Rgb};

#[derive(Debug, Clone, PartialEq)]
pub struct Shadow {
    enable: bool,
    /// Category of what casts them; `None`: everything.
    casters: Option<u32>,
    /// In place of the light that is held up.
    pub color: Rgb,
    /// From the shaded point to what casts; infinite without limit.
    pub distance: f32,
    /// Where in the distance shadows begin to fade.
    fades: f32,
    gamma: f32,
}

impl Shadow {
    /// `None` where shadows are those of everything, black, and without end.
    pub fn new(light: &flat::Light, categories: &Categories) -> Option<Self> {
        let casters = categories.category(&light.shadow_link);
        let standard = flat::Shadow::default();
        let authored = light.shadow.as_ref().unwrap_or(&standard);
        if casters.is_none() && *authored == standard {
            return None;
        }
        let distance = if authored.distance < 0.0 { f32::INFINITY } else { authored.distance };
        // A zone needs a limit, and does not exceed it.
        let zone = if distance.is_finite() { authored.falloff.clamp(0.0, distance) } else { 0.0 };
        Some(Self {
            enable: authored.enable,
            casters,
            color: authored.color.into(),
            distance,
            fades: distance - zone,
            gamma: authored.falloff_gamma,
        })
    }

    /// Whether things of the set `set` of categories cast shadows.
    pub fn is_cast_by(&self, set: u32, members: &Members) -> bool {
        self.enable && self.casters.is_none_or(|category| members.has(set, category))
    }

    /// Share of the light that something opaque at distance `t` holds up: 1, within the falloff zone the way left to its
    /// end to the power of the gamma, beyond the distance 0.
    pub fn strength(&self, t: f32) -> f32 {
        if t <= self.fades {
            return 1.0;
        }
        if t >= self.distance {
            return 0.0;
        }
        ((self.distance - t) / (self.distance - self.fades)).powf(self.gamma)
    }

    /// What arrives where `lit` gets through.
    pub fn shown(&self, lit: Rgb) -> Rgb {
        lit + (Rgb::ONE - lit) * self.color
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shadow(distance: f32, falloff: f32, falloff_gamma: f32) -> Shadow {
        let shadow = Some(flat::Shadow { distance, falloff, falloff_gamma, ..flat::Shadow::default() });
        Shadow::new(&flat::Light { shadow, ..flat::Light::default() }, &Categories::default()).expect("a rule")
    }

    #[test]
    fn strength_fades_within_the_zone() {
        let s = shadow(4.0, 2.0, 2.0);
        assert_eq!([1.0, 2.0, 3.0, 4.0, 9.0].map(|t| s.strength(t)), [1.0, 1.0, 0.25, 0.0, 0.0]);
        // The zone does not exceed the distance; none, and the shadow ends at once.
        assert_eq!(shadow(4.0, 8.0, 1.0).strength(1.0), 0.75);
        assert_eq!([3.9, 4.1].map(|t| shadow(4.0, -1.0, 1.0).strength(t)), [1.0, 0.0]);
        assert_eq!(shadow(-1.0, 2.0, 1.0).strength(1e9), 1.0);
    }

    #[test]
    fn the_standard_is_no_rule() {
        let light = flat::Light { shadow: Some(flat::Shadow::default()), ..flat::Light::default() };
        assert_eq!(Shadow::new(&light, &Categories::default()), None);
    }
}
