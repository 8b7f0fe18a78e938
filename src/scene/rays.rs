//! Rays through the scene at a time of the shutter: the nearest surface, whether there is any, light shapes on the way.

use super::accel::Ray;
use super::motion::Placed;
use super::{Instance, Moment, NOBODY, Origin, SurfaceHit};
use crate::light::{LightsAt, ShapeHit};
use crate::math::Affine;
use glam::Vec3;

/// The triangle of `instance` that a ray from `origin` leaves out.
fn skipped(origin: Origin, instance: u32) -> u32 {
    origin.filter(|(at, _)| *at == instance).map_or(u32::MAX, |(_, triangle)| triangle)
}

impl Instance {
    /// A ray whose origin is relative to the instance's own, in centred object space; `t` is unchanged.
    #[inline(always)]
    pub(crate) fn local_ray(&self, placed: &Affine, o: Vec3, d: Vec3, t_max: f32) -> Ray {
        if self.translated {
            return Ray { o, d, t_max };
        }
        Ray { o: placed.inverse * o, d: placed.inverse * d, t_max }
    }
}

impl<'a> Moment<'a> {
    pub fn lights(&self) -> LightsAt<'a> {
        self.scene.lights.at(self.time)
    }

    /// Those that are for the things of `receiver`; a camera, [`NOBODY`], sees all.
    pub fn lights_for(&self, receiver: u32) -> LightsAt<'a> {
        if receiver == NOBODY || !self.scene.lights.has_links() {
            return self.lights();
        }
        self.lights().linked_to(self.scene.instances[receiver as usize].categories)
    }

    /// Where an instance is.
    #[inline]
    pub fn placed(&self, instance: u32) -> Placed<'a> {
        self.scene.instances[instance as usize].placed(self.time)
    }

    /// Closest surface for 0 < t < `t_max`; `d` unit, render space.
    pub fn closest(&self, o: Vec3, d: Vec3, t_max: f32, origin: Origin) -> Option<SurfaceHit> {
        self.closest_where(o, d, t_max, origin, |_| true)
    }

    /// [`Self::closest`] among the instances that are `wanted`.
    #[inline(always)]
    pub fn closest_where(
        &self,
        o: Vec3,
        d: Vec3,
        t_max: f32,
        origin: Origin,
        wanted: impl Fn(u32) -> bool,
    ) -> Option<SurfaceHit> {
        // What stays costs no look at the time.
        if self.moves {
            self.closest_of::<true>(o, d, t_max, origin, wanted)
        } else {
            self.closest_of::<false>(o, d, t_max, origin, wanted)
        }
    }

    #[inline(always)]
    fn closest_of<const MOVES: bool>(
        &self,
        o: Vec3,
        d: Vec3,
        t_max: f32,
        origin: Origin,
        wanted: impl Fn(u32) -> bool,
    ) -> Option<SurfaceHit> {
        let mut ray = Ray { o, d, t_max };
        let mut closest = None;
        self.tlas.traverse(&mut ray, |i, ray| {
            if !wanted(i) {
                return false;
            }
            let instance = &self.instances[i as usize];
            let found = if MOVES {
                let placed = instance.placed(self.time);
                let local = instance.local_ray(&placed, o - placed.translation, d, ray.t_max);
                instance.geometry.closest(&local, skipped(origin, i), self.time)
            } else {
                let placed = &instance.to_render;
                let local = instance.local_ray(placed, o - placed.translation, d, ray.t_max);
                instance.geometry.closest_still(&local, skipped(origin, i))
            };
            if let Some(hit) = found {
                ray.t_max = hit.t;
                closest = Some(SurfaceHit { t: hit.t, instance: i, triangle: hit.triangle, u: hit.u, v: hit.v });
            }
            false
        });
        closest
    }

    /// The boundary of `instance` from a point `p` within it, relative to its origin: far from the camera, render space
    /// is coarser than a short mean free path. As walks, it does not see what else is in there.
    pub fn boundary_from_within(&self, instance: u32, p: Vec3, d: Vec3, t_max: f32) -> Option<SurfaceHit> {
        let of = &self.instances[instance as usize];
        let local = of.local_ray(&of.placed(self.time), p, d, t_max);
        let hit = of.geometry.closest(&local, u32::MAX, self.time)?;
        Some(SurfaceHit { t: hit.t, instance, triangle: hit.triangle, u: hit.u, v: hit.v })
    }

    /// Whether any surface is met for 0 < t < `t_max`.
    pub fn occluded(&self, o: Vec3, d: Vec3, t_max: f32, origin: Origin) -> bool {
        if self.moves {
            self.occluded_of::<true>(o, d, t_max, origin)
        } else {
            self.occluded_of::<false>(o, d, t_max, origin)
        }
    }

    fn occluded_of<const MOVES: bool>(&self, o: Vec3, d: Vec3, t_max: f32, origin: Origin) -> bool {
        let mut occluded = false;
        self.tlas.traverse_any(&Ray { o, d, t_max }, |i| {
            let instance = &self.instances[i as usize];
            occluded = if MOVES {
                let placed = instance.placed(self.time);
                let local = instance.local_ray(&placed, o - placed.translation, d, t_max);
                instance.geometry.any(&local, skipped(origin, i), self.time)
            } else {
                let placed = &instance.to_render;
                let local = instance.local_ray(placed, o - placed.translation, d, t_max);
                instance.geometry.any_still(&local, skipped(origin, i))
            };
            occluded
        });
        occluded
    }

    /// Whether `light` is for the things of `instance`; a camera, [`NOBODY`], sees all.
    pub fn illuminates(&self, light: u32, instance: u32) -> bool {
        let Some(category) = self.lights.category(light) else { return true };
        instance == NOBODY || self.members.has(self.instances[instance as usize].categories, category)
    }

    /// Whether rays may meet light shapes.
    pub fn has_light_shapes(&self) -> bool {
        !self.light_shapes.is_empty()
    }

    /// Calls `visit` for every light shape crossed for 0 < t < `t_max`. Lights cast no shadows.
    pub fn light_shapes(&self, o: Vec3, d: Vec3, t_max: f32, mut visit: impl FnMut(u32, &ShapeHit)) {
        if self.light_shapes.is_empty() {
            return;
        }
        self.light_tlas.traverse(&mut Ray { o, d, t_max }, |i, _| {
            let light = self.light_shapes[i as usize];
            if let Some(hit) = self.lights().intersect(light, o, d, t_max) {
                visit(light, &hit);
            }
            false
        });
    }
}
