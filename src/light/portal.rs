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
    /// A direction through one of them, drawn by its solid angle.
    pub fn sample(&self, u: Vec2) -> Option<Vec3> {
        let mut left = f64::from(u.x) * self.total;
        for (rect, weight) in self.weighed() {
            if left < weight {
                let u = Vec2::new((left / weight) as f32, u.y);
                return rect.sample(self.p, u).map(|sample| sample.wi);
            }
            left -= weight;
        }
        None
    }

    /// Solid-angle pdf of [`Self::sample`]; portals may overlap.
    pub fn pdf(&self, wi: Vec3) -> f32 {
        let density = |(rect, weight): (&Rect, f64)| {
            let hit = rect.intersect(self.p, wi)?;
            Some(weight / self.total * f64::from(rect.pdf(self.p, wi, hit.t)))
        };
        self.weighed().filter_map(density).sum::<f64>() as f32
    }

    /// Those that send light to the receiver, -Z towards it, with their solid angles.
    fn weighed(&self) -> impl Iterator<Item = (&Rect, f64)> {
        let sends = |rect: &&Rect| rect.patch.faces(self.p) && self.n.is_none_or(|n| rect.patch.rises(self.p, n));
        self.portals.0.iter().filter(sends).map(|rect| (rect, rect.solid_angle(self.p)))
    }
}
