//! The footprint of a path: which level of an image it sees.

/// The footprint of a path, for the levels of images (after Igehy 1999 and Bekaert et al. 2003, with one width).
#[derive(Debug, Clone, Copy)]
pub(super) struct Cone {
    /// Across the ray where it starts, stage units.
    pub width: f32,
    /// Growth of the width per stage unit.
    pub spread: f32,
}

impl Cone {
    /// Of a path that has scattered already.
    pub const WIDE: Self = Self { width: 0.0, spread: 0.5 };

    pub fn at(&self, t: f32) -> f32 {
        self.width + self.spread * t
    }

    /// After a direction of density `pdf` was drawn: the quarter of the solid angle that a sample stands for keeps what
    /// a few samples see sharp.
    pub fn scattered(&mut self, pdf: f32) {
        self.spread = self.spread.max(0.25 * pdf.max(1e-3).sqrt().recip()).min(Self::WIDE.spread);
    }
}
