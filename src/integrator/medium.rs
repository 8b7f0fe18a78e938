//! Passing an object's inside: sub-walks from boundary to boundary until the light gets out.

use super::direct::CollisionLight;
use super::nest::Inside;
use super::{Bucket, Path, Previous};
use crate::bsdf::{Boundary, Bsdf, Event, Side};
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, InstanceEnclosure, Interior, SurfaceHit};
use crate::subsurface::walk::{Start, WalkEnd, walk};
use glam::{Vec2, Vec3};

impl Path<'_> {
    /// Enters the medium behind `si` along `wi` and follows it to the outside. The medium and the boundary
    /// are those of the entry, wherever the walk comes out.
    pub(super) fn enter_medium(
        &mut self,
        hit: &SurfaceHit,
        si: &Interaction,
        wi: Vec3,
        sampler: &mut Sampler,
    ) -> Option<()> {
        let scene = self.scene;
        let interior = scene.surfaces[si.surface as usize].interior?;
        if self.depth == 0 {
            self.bucket = Bucket::Subsurface;
        }
        let enclosure = InstanceEnclosure::new(scene, si.instance);
        let entry = BoundaryHit { triangle: hit.triangle, u: hit.u, v: hit.v };
        let mut start = Start { p: enclosure.point(&entry), d: wi, normal: si.ng, hit: entry, weight: Rgb::ONE };
        loop {
            let (at, d) = self.sub_walk(&enclosure, &interior, start, si.instance, sampler)?;
            let exit = scene.interaction(&enclosure.surface_hit(&at), d, Side::Inside);
            match interior.boundary {
                Boundary::IndexMatched => {
                    self.continue_from(&exit, d);
                    return self.cross();
                }
                Boundary::Diffuse => return self.leave_diffuse(&exit, sampler),
                Boundary::Dielectric => match self.meet_dielectric(si.surface, &exit, sampler)? {
                    Some(reflected) => {
                        self.cross()?;
                        start =
                            Start { p: enclosure.point(&at), d: reflected, normal: exit.ng, hit: at, weight: Rgb::ONE };
                    }
                    None => return Some(()),
                },
            }
        }
    }

    /// One walk to the next boundary point: where, and in which direction it arrives.
    fn sub_walk(
        &mut self,
        enclosure: &InstanceEnclosure,
        interior: &Interior,
        mut start: Start<BoundaryHit>,
        instance: u32,
        sampler: &mut Sampler,
    ) -> Option<(BoundaryHit, Vec3)> {
        let medium = &interior.medium;
        let scale = self.throughput.max_element();
        (scale > 0.0).then_some(())?;
        start.weight = self.throughput / scale;
        // Light reaches collisions straight only where the boundary does not bend it.
        let matched = interior.boundary == Boundary::IndexMatched;
        let inside = if matched { self.enter(Inside { instance, medium: Some(*medium) })? } else { self.inside };
        let light =
            matched.then_some(CollisionLight { scene: self.scene, inside, g: medium.g, scale, bucket: self.bucket });
        let sample = &mut self.sample;
        let shadow_rays = &mut self.stats.shadow_rays;
        let end = walk(enclosure, medium, start, sampler, &mut self.stats.walk, |collision, sampler| {
            if let Some(light) = &light {
                *shadow_rays += 1;
                let u = Vec2::new(sampler.random(), sampler.random());
                light.add(collision, enclosure.to_render(collision.p), sampler.random(), u, sample);
            }
        });
        let WalkEnd::Boundary { hit, d, weight, scattered, .. } = end else { return None };
        self.throughput = scale * weight;
        if let (Some((p, pdf)), Boundary::IndexMatched) = (scattered, interior.boundary) {
            self.previous = Previous::Sampled { p: enclosure.to_render(p), n: None, pdf };
        }
        Some((hit, d))
    }

    /// Lambertian transmission out of a diffuse boundary.
    fn leave_diffuse(&mut self, exit: &Interaction, sampler: &mut Sampler) -> Option<()> {
        // wo is below; the exit lobe does not depend on it.
        let bsdf = Bsdf::lambert_exit();
        let (u_choice, u_light) = (sampler.next_1d(), sampler.next_2d());
        self.next_event(exit, &bsdf, u_choice, u_light);
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d())?;
        let wi = exit.frame.to_world(chosen.wi);
        (wi.dot(exit.ng) > 0.0).then_some(())?;
        self.throughput *= chosen.f / chosen.pdf;
        self.bounce(exit, wi, chosen.delta, chosen.pdf)?;
        self.roulette(sampler)
    }

    /// A dielectric boundary seen from inside: `Some(Some(wi))` reflected back in along wi, `Some(None)` out.
    fn meet_dielectric(&mut self, surface: u32, exit: &Interaction, sampler: &mut Sampler) -> Option<Option<Vec3>> {
        let surface = &self.scene.surfaces[surface as usize].surface;
        let bsdf = surface.bsdf(exit.local(exit.wo), Side::Inside);
        let (u_choice, u_light) = (sampler.next_1d(), sampler.next_2d());
        self.next_event(exit, &bsdf, u_choice, u_light);
        let chosen = bsdf.sample(sampler.next_1d(), sampler.next_2d())?;
        let wi = exit.frame.to_world(chosen.wi);
        self.throughput *= chosen.f / chosen.pdf;
        let outward = wi.dot(exit.ng) > 0.0;
        match chosen.event {
            Event::Reflect => (!outward).then_some(Some(wi)),
            _ => {
                outward.then_some(())?;
                self.bounce(exit, wi, chosen.delta, chosen.pdf)?;
                Some(None)
            }
        }
    }
}
