//! The image of a textured light, looked up bilinearly.

use crate::{flat, math::Rgb};

/// Linear Rec.709 pixels, row 0 at the top.
#[derive(Debug, Clone)]
pub struct Texels {
    width: usize,
    height: usize,
    pixels: flat::Array<[f32; 3]>,
    /// Whether the left edge continues at the right one (latlong maps); the others clamp.
    wrap: bool,
}

impl Texels {
    /// `None` where the image cannot be used; `warn` hears why, or what was repaired.
    pub fn new(texture: &flat::Texture, wrap: bool, warn: &mut dyn FnMut(String)) -> Option<Self> {
        let (width, height) = (texture.width as usize, texture.height as usize);
        let n = texture.pixels.len();
        if n == 0 || width.checked_mul(height) != Some(n) {
            warn(format!("has {n} pixels where {width} x {height} were announced: not used"));
            return None;
        }
        let mut pixels = texture.pixels.clone();
        let damaged = pixels.iter().filter(|&&p| !sound(p)).count();
        if damaged > 0 {
            warn(format!("has {damaged} pixels that are not finite or beyond 1e20: rendered black"));
            pixels = pixels.iter().map(|&p| if sound(p) { p } else { [0.0; 3] }).collect::<Vec<_>>().into();
        }
        Some(Self { width, height, pixels, wrap })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Bilinear value at (s, t) in [0, 1]^2, (0, 0) the outer corner of the first pixel.
    pub fn lookup(&self, s: f32, t: f32) -> Rgb {
        let (x, y) = (s * self.width as f32 - 0.5, t * self.height as f32 - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let row = |j: i64| self.pixel(x0 as i64, j).lerp(self.pixel(x0 as i64 + 1, j), x - x0);
        row(y0 as i64).lerp(row(y0 as i64 + 1), y - y0)
    }

    /// Mean of the channels' magnitudes at the centre of pixel (x, y), wrapped or clamped as [`Self::lookup`] does: what that
    /// interpolates is zero only where these are.
    pub fn magnitude(&self, x: i64, y: i64) -> f32 {
        super::emission::magnitude(self.pixel(x, y))
    }

    /// Mean magnitude of the whole image.
    pub fn average(&self) -> f64 {
        let sum: f64 = self.pixels.iter().map(|&p| f64::from(super::emission::magnitude(p.into()))).sum();
        sum / self.pixels.len() as f64
    }

    fn pixel(&self, x: i64, y: i64) -> Rgb {
        let (w, h) = (self.width as i64, self.height as i64);
        let x = match (0..w).contains(&x) {
            // A division less where whole rows are read.
            true => x,
            false if self.wrap => x.rem_euclid(w),
            false => x.clamp(0, w - 1),
        };
        self.pixels[(y.clamp(0, h - 1) * w + x) as usize].into()
    }
}

/// Beyond 1e20, sums of squares leave the range of f32.
fn sound(pixel: [f32; 3]) -> bool {
    pixel.iter().all(|c| c.abs() < 1e20)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> flat::Texture {
        let pixels: Vec<[f32; 3]> = (0..8).map(|i| [i as f32; 3]).collect();
        flat::Texture { width: 4, height: 2, pixels: pixels.into(), ..Default::default() }
    }

    fn texels(texture: &flat::Texture, wrap: bool) -> (Option<Texels>, Vec<String>) {
        let mut said = Vec::new();
        (Texels::new(texture, wrap, &mut |message| said.push(message)), said)
    }

    #[test]
    fn values_stand_at_pixel_centres_and_edges_wrap_or_clamp() {
        let (clamped, wrapped) = (texels(&ramp(), false).0.unwrap(), texels(&ramp(), true).0.unwrap());
        assert_eq!(clamped.lookup(0.125, 0.25).x, 0.0);
        assert_eq!(clamped.lookup(0.875, 0.75).x, 7.0);
        assert_eq!(clamped.lookup(0.25, 0.25).x, 0.5);
        assert_eq!(clamped.lookup(0.0, 0.0).x, 0.0);
        assert_eq!(wrapped.lookup(0.0, 0.0).x, 1.5);
        assert_eq!(wrapped.lookup(1.0, 0.0).x, 1.5);
    }

    #[test]
    fn damaged_images_are_refused_or_repaired_aloud() {
        let (refused, said) = texels(&flat::Texture { width: 5, ..ramp() }, false);
        assert!(refused.is_none() && said.len() == 1);
        assert!(texels(&flat::Texture::default(), false).0.is_none());
        let pixels = vec![[2.0, f32::INFINITY, 0.0], [1.0; 3]].into();
        let (repaired, said) = texels(&flat::Texture { width: 2, height: 1, pixels, ..Default::default() }, false);
        assert_eq!(repaired.unwrap().lookup(0.5, 0.5), Rgb::splat(0.5));
        assert!(said[0].contains("1 pixels"));
    }
}
