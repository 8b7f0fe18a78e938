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
    objects: [Option<Inside>; DEPTH],
}

impl Nest {
    pub const OUTSIDE: Self = Self { objects: [None; DEPTH] };

    pub fn contains(&self, instance: u32) -> bool {
        self.objects.iter().flatten().any(|object| object.instance == instance)
    }

    /// With one more object around; `None` where there is no room left.
    pub fn entered(mut self, object: Inside) -> Option<Self> {
        *self.objects.iter_mut().find(|place| place.is_none())? = Some(object);
        Some(self)
    }

    /// Without the innermost entry of `instance`.
    pub fn left(self, instance: u32) -> Self {
        let Some(at) = self.objects.iter().rposition(|o| o.is_some_and(|o| o.instance == instance)) else {
            return self;
        };
        let mut rest = Self::OUTSIDE;
        let kept = self.objects.iter().enumerate().filter(|(i, _)| *i != at);
        rest.objects.iter_mut().zip(kept).for_each(|(place, (_, object))| *place = *object);
        rest
    }

    pub fn medium(&self) -> Option<Medium> {
        self.objects.iter().flatten().last().and_then(|object| object.medium)
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
        assert_eq!(two.objects.iter().flatten().map(|o| o.instance).collect::<Vec<_>>(), [1, 3]);
        assert!((4..20).try_fold(three, |nest, i| nest.entered(object(i))).is_none());
    }
}
