//! The bodies that a path is inside of: dielectrics and index-matched media whose surfaces it has crossed, and which of
//! them fills the place (Schmidt and Budge 2002, "Simple Nested Dielectrics in Ray Traced Images").
//!
//! Where bodies overlap, the one of the highest priority fills the overlap; of equal ones the one entered last, so that
//! a body wholly within another needs no priority. Surfaces of a body that is outranked are not there. An index-matched
//! body takes the index of what is around it: it outranks media, never indices, so that an interface between two
//! indices is seen whatever fills the place.

use crate::bsdf::{Boundary, Side};
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::medium::Medium;
use crate::scene::{Around, Coating, Interior, Moment, Scene};

/// Bodies within bodies that are tracked; deeper ones end the path, counted as trapped.
const DEPTH: usize = 16;

/// One body around the path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inside {
    pub instance: u32,
    /// Where it was entered, an index of `Scene::surfaces`.
    pub surface: u32,
    /// Higher wins.
    pub priority: i32,
    pub boundary: Boundary,
    /// Of refraction, against vacuum; of no meaning where the boundary is index-matched.
    pub index: f32,
    /// What fills it; `None`: nothing.
    pub medium: Option<Medium>,
}

impl Inside {
    /// Behind a surface; without an `interior` it is a dielectric of nothing, which bends no light.
    pub fn new(instance: u32, surface: u32, priority: i32, interior: Option<Interior>) -> Self {
        let boundary = interior.map_or(Boundary::IndexMatched, |interior| interior.boundary);
        let index = interior.map_or(1.0, |interior| interior.index);
        Self { instance, surface, priority, boundary, index, medium: interior.map(|interior| interior.medium) }
    }

    fn bends(&self) -> bool {
        self.boundary == Boundary::Dielectric
    }
}

/// Bodies around a path, in the order of their entry.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nest {
    bodies: [Inside; DEPTH],
    /// Of the places, those that are taken; a path outside looks at no other.
    count: usize,
}

impl Nest {
    pub const OUTSIDE: Self = Self {
        bodies: [Inside {
            instance: u32::MAX,
            surface: u32::MAX,
            priority: 0,
            boundary: Boundary::IndexMatched,
            index: 1.0,
            medium: None,
        }; DEPTH],
        count: 0,
    };

    /// The bodies that `around` lists, outermost first; of too many the innermost.
    pub fn of(scene: &Scene, around: &[Around]) -> Self {
        let body = |at: &Around| {
            let interior = scene.surfaces[at.surface as usize].interior;
            Inside::new(at.instance, at.surface, scene.instances[at.instance as usize].priority, interior)
        };
        let inner = &around[around.len().saturating_sub(DEPTH)..];
        inner.iter().fold(Self::OUTSIDE, |nest, at| nest.entered(body(at)).unwrap_or(nest))
    }

    fn around(&self) -> &[Inside] {
        &self.bodies[..self.count]
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    pub fn contains(&self, instance: u32) -> bool {
        self.around().iter().any(|body| body.instance == instance)
    }

    /// With one more body around; `None` where there is no room left.
    pub fn entered(mut self, body: Inside) -> Option<Self> {
        *self.bodies.get_mut(self.count)? = body;
        self.count += 1;
        Some(self)
    }

    /// Without the innermost entry of `instance`.
    pub fn left(mut self, instance: u32) -> Self {
        if let Some(at) = self.around().iter().rposition(|body| body.instance == instance) {
            self.bodies.copy_within(at + 1..self.count, at);
            self.count -= 1;
        }
        self
    }

    /// The body that fills the place; of equal priorities the last.
    pub fn top(&self) -> Option<&Inside> {
        self.around().iter().max_by_key(|body| body.priority)
    }

    /// Of refraction, where the path is but for `but`.
    pub fn index_beside(&self, but: u32) -> f32 {
        let others = self.around().iter().filter(|body| body.bends() && body.instance != but);
        others.max_by_key(|body| body.priority).map_or(1.0, |body| body.index)
    }

    /// Whether the surface of a body is not there, because another one fills the place on both of its sides. A body that
    /// is not around yet would be the last.
    pub fn hides(&self, instance: u32, priority: i32, boundary: Boundary) -> bool {
        let own = self.around().iter().rposition(|body| body.instance == instance);
        self.around().iter().enumerate().any(|(i, body)| {
            let rivals = Some(i) != own && (body.bends() || boundary == Boundary::IndexMatched);
            let later = own.is_some_and(|own| i > own);
            rivals && (body.priority > priority || body.priority == priority && later)
        })
    }

    pub fn medium(&self) -> Option<Medium> {
        self.top().and_then(|body| body.medium)
    }

    /// The body that the path is in, if it scatters there.
    pub fn scattering(&self) -> Option<&Inside> {
        self.top().filter(|body| body.medium.is_some_and(|medium| medium.scatters()))
    }

    /// Absorption over `t` stage units of what the path is in.
    pub fn transmittance(&self, t: f32) -> Rgb {
        self.medium().map_or(Rgb::ONE, |medium| medium.transmittance(t))
    }
}

pub(super) fn side_of(inside: &Nest, instance: u32) -> Side {
    if inside.contains(instance) { Side::Inside } else { Side::Outside }
}

/// Whether a surface of `instance` is not there, for a path amid the bodies `inside`.
pub(super) fn hides(scene: Moment, inside: &Nest, instance: u32, coating: &Coating) -> bool {
    let Some(interior) = coating.interior.filter(|_| !inside.is_empty()) else { return false };
    let priority = scene.instances[instance as usize].priority;
    interior.boundary != Boundary::Diffuse && inside.hides(instance, priority, interior.boundary)
}

/// The bodies beyond the boundary at `si` for a path amid `inside`; `None` where they are too many.
pub(super) fn crossed(scene: Moment, inside: &Nest, si: &Interaction, coating: &Coating) -> Option<Nest> {
    match si.side {
        Side::Inside => Some(inside.left(si.instance)),
        Side::Outside => {
            let priority = scene.instances[si.instance as usize].priority;
            inside.entered(Inside::new(si.instance, si.surface, priority, coating.interior))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(instance: u32, priority: i32, boundary: Boundary) -> Inside {
        Inside { instance, surface: 0, priority, boundary, index: 1.0 + instance as f32, medium: None }
    }

    fn nest(bodies: &[Inside]) -> Nest {
        bodies.iter().try_fold(Nest::OUTSIDE, |nest, &body| nest.entered(body)).expect("room")
    }

    #[test]
    fn bodies_are_left_in_any_order() {
        let glass = |instance| body(instance, 0, Boundary::Dielectric);
        let three = nest(&[1, 2, 3].map(glass));
        let two = three.left(2).left(7);
        assert!(two.contains(1) && two.contains(3) && !two.contains(2));
        assert_eq!(two.around().iter().map(|body| body.instance).collect::<Vec<_>>(), [1, 3]);
        assert!((4..40).try_fold(three, |nest, i| nest.entered(glass(i))).is_none());
    }

    #[test]
    fn the_highest_priority_fills_the_place_and_of_equals_the_last() {
        use Boundary::{Dielectric, IndexMatched};
        let (glass, water, ice) = (body(1, 2, Dielectric), body(2, 1, Dielectric), body(3, 1, Dielectric));
        let all = nest(&[water, glass, ice]);
        assert_eq!(all.top().map(|body| body.instance), Some(1));
        assert_eq!(all.left(1).top().map(|body| body.instance), Some(3));
        assert_eq!((all.index_beside(9), all.index_beside(1), all.left(3).index_beside(1)), (2.0, 4.0, 3.0));
        assert!(!all.hides(1, 2, Dielectric) && all.hides(2, 1, Dielectric) && all.hides(3, 1, Dielectric));
        // Without the glass the ice is the last of equals, and the water's far side is not there.
        let wet = all.left(1);
        assert!(wet.hides(2, 1, Dielectric) && !wet.hides(3, 1, Dielectric));
        // Entering: as if it were the last.
        assert!(!wet.hides(7, 1, Dielectric) && wet.hides(7, 0, Dielectric));
        // An index-matched body is outranked by all and has no index.
        let fog = body(4, 5, IndexMatched);
        let foggy = nest(&[water, fog]);
        assert_eq!((foggy.top().map(|body| body.instance), foggy.index_beside(9)), (Some(4), 3.0));
        assert!(!foggy.hides(2, 1, Dielectric) && !foggy.hides(4, 5, IndexMatched) && foggy.hides(6, 4, IndexMatched));
    }
}
