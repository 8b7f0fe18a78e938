//! The objects that a path is inside of: dielectrics and matched media whose surfaces it has crossed.

use crate::math::Rgb;
use crate::medium::Medium;

/// Objects within objects that are tracked; deeper ones end the path, counted as trapped.
const DEPTH: usize = 6;

/// One object around the path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inside {
    pub instance: u32,
    /// What fills it; `None`: nothing.
    pub medium: Option<Medium>,
}

/// Objects around a path, outermost first. The innermost decides the medium: overlaps have no priorities.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nest {
    objects: [Inside; DEPTH],
    /// Of the places, those that are taken; a path outside looks at no other.
    count: usize,
}

impl Nest {
    pub const OUTSIDE: Self = Self { objects: [Inside { instance: u32::MAX, medium: None }; DEPTH], count: 0 };

    fn around(&self) -> &[Inside] {
        &self.objects[..self.count]
    }

    pub fn contains(&self, instance: u32) -> bool {
        self.around().iter().any(|object| object.instance == instance)
    }

    /// With one more object around; `None` where there is no room left.
    pub fn entered(mut self, object: Inside) -> Option<Self> {
        *self.objects.get_mut(self.count)? = object;
        self.count += 1;
        Some(self)
    }

    /// Without the innermost entry of `instance`.
    pub fn left(mut self, instance: u32) -> Self {
        if let Some(at) = self.around().iter().rposition(|object| object.instance == instance) {
            self.objects.copy_within(at + 1..self.count, at);
            self.count -= 1;
        }
        self
    }

    pub fn innermost(&self) -> Option<u32> {
        self.around().last().map(|object| object.instance)
    }

    pub fn medium(&self) -> Option<Medium> {
        self.around().last().and_then(|object| object.medium)
    }

    /// Absorption over `t` stage units of what the path is in.
    pub fn transmittance(&self, t: f32) -> Rgb {
        self.medium().map_or(Rgb::ONE, |medium| medium.transmittance(t))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_left_in_any_order() {
        let object = |instance| Inside { instance, medium: None };
        let three = [1, 2, 3].into_iter().try_fold(Nest::OUTSIDE, |nest, i| nest.entered(object(i))).expect("room");
        let two = three.left(2).left(7);
        assert!(two.contains(1) && two.contains(3) && !two.contains(2));
        assert_eq!(two.around().iter().map(|o| o.instance).collect::<Vec<_>>(), [1, 3]);
        assert!((4..20).try_fold(three, |nest, i| nest.entered(object(i))).is_none());
    }
}
