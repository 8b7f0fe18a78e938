//! A scattering medium with something else in it: one walk to the next surface, be it the boundary or that of an object,
//! which is then met as any surface is. Where nothing else is in a medium, `medium` has it from boundary to boundary.

use super::collision::CollisionLight;
use super::footprint::Cone;
use super::medium::Passage;
use super::nest::Inside;
use super::{Path, Previous};
use crate::bsdf::{Boundary, Response};
use crate::math::Rgb;
use crate::sampling::sampler::Sampler;
use crate::scene::{BoundaryHit, InstanceEnclosure};
use crate::subsurface::steps::Start;

impl Path<'_> {
    /// From where the path is in the medium of `body`, along its direction, to the next surface.
    pub(super) fn wade(&mut self, body: Inside, sampler: &mut Sampler) -> Option<()> {
        self.cross()?;
        let scene = self.scene;
        let (plan, medium) = self.guide.plan(body.surface)?;
        let here;
        let medium = match body.medium.filter(|own| *own != medium.medium) {
            Some(own) => {
                here = plan.medium_at(own);
                &here
            }
            None => medium,
        };
        self.meet_ruled_lights_once();
        let enclosure = InstanceEnclosure::new(scene, body.instance);
        let start = self.start_within(&enclosure);
        let within = self.inside;
        let lit = body.boundary == Boundary::IndexMatched || enclosure.lights_within();
        if lit && scene.has_light_shapes() {
            self.meet_lights_within(&enclosure, start.p, start.d, start.hit, &within);
        }
        let instance = body.instance;
        let (bucket, by) = (self.bucket_of_media(), self.by);
        let light = lit.then_some(CollisionLight {
            scene,
            instance,
            around: &within,
            scale: 1.0,
            bucket,
            by,
            bends: None,
            entry: start.normal,
        });
        let passage = Passage { enclosure, instance, bends: None, plan, medium, first: false, noted: false };
        let (at, d, scattered) = self.sub_walk(&passage, start, light, sampler)?;
        self.o = passage.enclosure.to_render(start.p);
        if let Some((p, pdf)) = scattered {
            let p = passage.enclosure.to_render(p);
            self.o = p;
            self.cone = Cone::WIDE;
            self.hold_up();
            self.be_scattered();
            // Without light at collisions what the walk meets is its own alone.
            self.previous = Previous::Delta;
            self.by.last = Some(Response::Scattered);
            // Lights with shadow rules are all those of next-event estimation: what they shine through would have to be
            // asked from here, and the way to the next surface is behind the path.
            self.drawn = false;
            if lit {
                self.collided(instance, p, pdf);
            }
        }
        self.d = d;
        // A start amid the medium, where the camera is, has no surface to come back to.
        (at.instance != NOWHERE.instance).then_some(())?;
        self.meet_surface(&passage.enclosure.surface_hit(&at), sampler)
    }

    /// The last vertex as the start of a walk: on a surface, or amid the medium.
    fn start_within(&self, enclosure: &InstanceEnclosure) -> Start<BoundaryHit> {
        let d = self.d;
        let Some((instance, triangle)) = self.origin else {
            return Start { p: enclosure.to_walk(self.o), d, normal: -d, hit: NOWHERE, weight: Rgb::ONE };
        };
        let hit = BoundaryHit { instance, triangle, u: self.at.x, v: self.at.y };
        let n = enclosure.normal(&hit);
        // The medium is where the path goes.
        let normal = if n.dot(d) > 0.0 { -n } else { n };
        Start { p: enclosure.point(&hit), d, normal, hit, weight: Rgb::ONE }
    }

    /// A medium has scattered what the camera sees.
    fn hold_up(&mut self) {
        self.sample.alpha += self.seen;
        self.seen = 0.0;
    }
}

/// On no surface.
const NOWHERE: BoundaryHit = BoundaryHit { instance: u32::MAX, triangle: u32::MAX, u: 0.0, v: 0.0 };
