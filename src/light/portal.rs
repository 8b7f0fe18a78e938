//! Portals: rectangles that guide the samples of a dome to where its light comes in.
//!
//! They cut off nothing: half of the samples of a receiver go through the portals it sees, half as if there were none, and the
//! pdf is that of the mixture. What comes in beside the portals is there, only not helped.

use super::rect::Rect;
use glam::{Vec2, Vec3};

#[derive(Debug, Clone)]
pub struct Portals(Vec<Rect>);

impl Portals {
    /// `None`: there are none.
    pub fn new(rects: Vec<Rect>) -> Option<Self> {
        (!rects.is_empty()).then_some(Self(rects))
    }

    /// `None` where no portal sends light to the receiver: all are turned away from p, or below its horizon.
    pub fn seen_from(&self, p: Vec3, n: Option<Vec3>) -> Option<View<'_>> {
        let mut view = View { portals: self, p, n, total: 0.0 };
        view.total = view.weighed().map(|(_, weight)| weight).sum();
        (view.total > 0.0).then_some(view)
    }
}

/// The portals as a receiver sees them.
pub struct View<'a> {
    portals: &'a Portals,
    p: Vec3,
    n: Option<Vec3>,
    total: f64,
}

impl View<'_> {
    /// A direction through one of them, drawn by its solid angle, and its solid-angle pdf.
    pub fn sample(&self, u: Vec2) -> Option<(Vec3, f32)> {
        let mut left = f64::from(u.x) * self.total;
        for (i, (rect, weight)) in self.weighed().enumerate() {
            if left < weight {
                let u = Vec2::new((left / weight) as f32, u.y);
                let drawn = rect.sample(self.p, u)?;
                // Rounding may put the direction beside the rectangle that it was drawn through.
                return Some((drawn.wi, self.density(drawn.wi, Some((i, drawn.hit.t)))));
            }
            left -= weight;
        }
        None
    }

    /// Solid-angle pdf of [`Self::sample`]; portals may overlap.
    pub fn pdf(&self, wi: Vec3) -> f32 {
        self.density(wi, None)
    }

    /// `met`: a portal that is known to be met, and at which distance.
    fn density(&self, wi: Vec3, met: Option<(usize, f32)>) -> f32 {
        let density = |(i, (rect, weight)): (usize, (&Rect, f64))| {
            let known = met.filter(|(portal, _)| *portal == i).map(|(_, t)| t);
            let t = rect.intersect(self.p, wi).map(|hit| hit.t).or(known)?;
            Some(weight / self.total * f64::from(rect.pdf(self.p, wi, t)))
        };
        self.weighed().enumerate().filter_map(density).sum::<f64>() as f32
    }

    /// Those that send light to the receiver, -Z towards it, with their solid angles.
    fn weighed(&self) -> impl Iterator<Item = (&Rect, f64)> {
        let sends = |rect: &&Rect| rect.patch.faces(self.p) && self.n.is_none_or(|n| rect.patch.rises(self.p, n));
        self.portals.0.iter().filter(sends).map(|rect| (rect, rect.solid_angle(self.p)))
    }
}
