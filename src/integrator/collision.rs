//! Light at collisions: next-event estimation from within a medium, straight through matched boundaries and bent by
//! dielectric ones.

use super::bent::{Aim, Bent};
use super::lobes::By;
use super::nest::Nest;
use super::rough::{Glance, Rough, Sought};
use super::shadow::visibility_beyond;
use super::suns::Search;
use super::{Bucket, add_to};
use crate::bsdf::Response;
use crate::film::Sample;
use crate::light::Choice;
use crate::math::Rgb;
use crate::sampling::power_heuristic;
use crate::sampling::sampler::Sampler;
use crate::scene::{InstanceEnclosure, Moment, SurfaceHit};
use crate::subsurface::steps::Enclosure;
use crate::subsurface::walk::{Collision, Role};
use glam::{Vec2, Vec3};

/// Where a path's light goes.
pub(super) struct Into<'a> {
    pub sample: &'a mut Sample,
    /// Sums of AOVs of lights.
    pub groups: &'a mut [Rgb],
    /// By [`crate::flat::LOBE_AOVS`].
    pub lobes: &'a mut [Rgb],
    /// How the last collision looked for refracted light; `None`: it did not.
    pub aim: Option<Aim>,
    /// What collisions look for through a rough boundary.
    pub sought: Sought,
    /// The look that the collision takes there; `None`: none.
    pub glance: Option<Glance>,
    /// Its search for a sun through a smooth one; `None`: none.
    pub search: Option<Search>,
}

impl<'a> Into<'a> {
    pub fn new(sample: &'a mut Sample, groups: &'a mut [Rgb], lobes: &'a mut [Rgb]) -> Self {
        Self { sample, groups, lobes, aim: None, sought: Sought::default(), glance: None, search: None }
    }
}

/// A boundary that bends light on its way in.
#[derive(Clone, Copy)]
pub(super) enum Bends<'a> {
    Smooth(Bent<'a>),
    Rough(Rough<'a>),
}

/// Light sampled at the collisions of a walk.
#[derive(Clone, Copy)]
pub(super) struct CollisionLight<'a> {
    pub scene: Moment<'a>,
    /// The body that the collisions are in.
    pub instance: u32,
    /// Of objects around the path: those around the collision where the boundary is matched, around the object where it
    /// is not.
    pub around: &'a Nest,
    /// Path throughput per unit of the walk's weight.
    pub scale: f32,
    pub bucket: Bucket,
    pub by: By,
    /// The boundary that bends the light; `None`: matched.
    pub bends: Option<Bends<'a>>,
    /// Outward normal of the boundary where the walk started.
    pub entry: Vec3,
}

impl CollisionLight<'_> {
    /// Whether the collision at `p` looks for light, by what is known without its weight.
    pub fn looks(
        &self,
        p: Vec3,
        role: Role,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> bool {
        match &self.bends {
            None => true,
            Some(Bends::Smooth(bent)) => {
                let counted = matches!(role, Role::Counted(_));
                into.search = if counted { None } else { bent.search(enclosure, p, sampler) };
                bent.has_beams() || into.search.is_some()
            }
            Some(Bends::Rough(rough)) => {
                into.glance = rough.glance(self, enclosure, p, sampler, into);
                into.glance.is_some()
            }
        }
    }

    /// Adds what a collision that [`Self::looks`] sees of a light. Returns the shadow rays that took.
    pub fn add(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        match &self.bends {
            None => self.add_straight(collision, enclosure, sampler, into),
            Some(Bends::Smooth(bent)) => bent.add(self, collision, enclosure, sampler, into),
            Some(Bends::Rough(rough)) => {
                into.glance.take().map_or(0, |glance| rough.look(self, &glance, collision, enclosure, sampler, into))
            }
        }
    }

    /// Weighted against the walk's own directions.
    fn add_straight(
        &self,
        collision: &Collision,
        enclosure: &InstanceEnclosure,
        sampler: &mut Sampler,
        into: &mut Into,
    ) -> u64 {
        let u = Vec2::new(sampler.random(), sampler.random());
        let p = enclosure.to_render(collision.p);
        let light = self.scene.lights_for(self.instance).sample(p, None, Choice::ONE, sampler.random(), u);
        let Some(light) = light.filter(|light| light.radiance != Rgb::ZERO) else { return 0 };
        let (phase, pdf) = (collision.scatter)(light.wi);
        if phase <= 0.0 {
            return 0;
        }
        let hit = enclosure.cast(collision.p, light.wi, light.reach(), None);
        let hit = hit.map(|(t, hit)| SurfaceHit { t, ..enclosure.surface_hit(&hit) });
        let visible = visibility_beyond(self.scene, light.light, p, hit, light.wi, light.reach(), self.around);
        // Walks meet no light shapes before the next surface: those within the medium are ours alone.
        let within = hit.is_none() && light.distance.is_finite() && !self.scene.lights.is_mesh(light.light);
        // Nor do they look for lights with shadow rules.
        let ours = light.delta || within || self.scene.lights.shadow(light.light).is_some();
        let weight = if ours { 1.0 } else { power_heuristic(light.pdf, pdf) };
        self.give(into, light.light, collision.weight * visible * light.radiance * (phase * weight / light.pdf));
        1
    }

    pub(super) fn give(&self, into: &mut Into, source: u32, light: Rgb) {
        let mut light = self.scale * light;
        if self.by.told {
            let by = Some(Response::Scattered);
            light = self.by.sorted(&self.scene, self.bucket, by, source, light, into.lobes);
        }
        add_to(into.sample, self.bucket, light);
        if !into.groups.is_empty() {
            self.scene.lights.sort(into.groups, source, light);
        }
    }
}

#[cfg(test)]
impl<'a> CollisionLight<'a> {
    /// In the one body of `scene`, alone.
    pub fn alone(scene: Moment<'a>) -> Self {
        Self {
            scene,
            instance: 0,
            around: &Nest::OUTSIDE,
            scale: 1.0,
            bucket: Bucket::Subsurface,
            by: By::nothing(false),
            bends: None,
            entry: Vec3::Z,
        }
    }
}
