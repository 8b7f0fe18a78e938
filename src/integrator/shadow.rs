//! What of a light gets through: opaque things, opacity and matched media hold it up, or what its own rules make of them.

use super::Path;
use super::Previous;
use super::nest::{Nest, crossed, hides, side_of};
use crate::bsdf::{Boundary, Side};
use crate::light::{SHORT, Shadow, ShapeHit};
use crate::math::Rgb;
use crate::scene::{Coating, Moment, Origin, SurfaceHit};
use glam::Vec3;

/// Faces that a shadow ray may pass before it counts as blocked.
const MAX_LAYERS: u32 = 256;

/// Share of `light` that reaches along (o, d) from distance `t_max`. `inside`: the objects around `o`.
pub(super) fn visibility(
    scene: Moment,
    light: u32,
    o: Vec3,
    d: Vec3,
    t_max: f32,
    origin: Origin,
    inside: &Nest,
) -> Rgb {
    match scene.lights.shadow(light) {
        None => transmittance(scene, o, d, t_max, origin, inside),
        Some(shadow) => Ruled { scene, shadow, around: inside }.visibility(o, d, t_max, origin),
    }
}

/// [`visibility`] from `o` within the matched medium of an object; `hit` is the first surface along (o, d).
pub(super) fn visibility_beyond(
    scene: Moment,
    light: u32,
    o: Vec3,
    hit: Option<SurfaceHit>,
    d: Vec3,
    t_max: f32,
    inside: &Nest,
) -> Rgb {
    match scene.lights.shadow(light) {
        None => transmittance_beyond(scene, hit, d, t_max, inside),
        Some(shadow) => {
            let ruled = Ruled { scene, shadow, around: inside };
            let hit = match hit {
                // An object in the medium that casts no shadow.
                Some(at) if !ruled.holds_up(at.instance) => ruled.closest(o, d, t_max, None),
                first => first,
            };
            ruled.beyond(hit, d, t_max)
        }
    }
}

/// Share of light that reaches along (o, d) from distance `t_max`: 0 or 1 past opaque things, opacity and
/// index-matched media in between. `inside`: the objects around `o`.
fn transmittance(scene: Moment, o: Vec3, d: Vec3, t_max: f32, origin: Origin, inside: &Nest) -> Rgb {
    if !scene.needs.transparency && inside.is_empty() {
        return if scene.occluded(o, d, t_max, origin) { Rgb::ZERO } else { Rgb::ONE };
    }
    transmittance_beyond(scene, scene.closest(o, d, t_max, origin), d, t_max, inside)
}

/// [`transmittance`] of a ray whose first surface is `hit`.
fn transmittance_beyond(scene: Moment, mut hit: Option<SurfaceHit>, d: Vec3, t_max: f32, inside: &Nest) -> Rgb {
    let (mut left, mut inside, mut beyond) = (t_max, inside, None);
    let mut passed = Rgb::ONE;
    for _ in 0..MAX_LAYERS {
        passed *= inside.transmittance(hit.map_or(left, |hit| hit.t));
        let Some(at) = hit else { return passed };
        let mut si = scene.interaction(&at, d, side_of(inside, at.instance));
        // The edge of a cut-out is that of its finest level.
        let coating = scene.shade(&mut si, 0.0);
        if is_passed(scene, inside, at.instance, &coating) {
            let Some(nest) = crossed(scene, inside, &si, &coating) else { return Rgb::ZERO };
            inside = beyond.insert(nest);
        } else {
            passed *= coating.surface.transparency(si.frame.n.dot(d).abs());
        }
        if passed.max_element() <= 0.0 {
            return Rgb::ZERO;
        }
        left -= at.t;
        hit = scene.closest(si.origin(d), d, left, Some((at.instance, at.triangle)));
    }
    Rgb::ZERO
}

/// Whether light goes straight on through a surface of `instance`, into or out of it.
fn is_passed(scene: Moment, inside: &Nest, instance: u32, coating: &Coating) -> bool {
    let matched = coating.interior.is_some_and(|interior| interior.boundary == Boundary::IndexMatched);
    matched || hides(scene, inside, instance, coating)
}

/// Shadows by the rules of a light.
///
/// What the objects around the point do to light on its way in, Beer's law and their boundaries, is no shadow: no rule is
/// for that.
struct Ruled<'a> {
    scene: Moment<'a>,
    shadow: &'a Shadow,
    around: &'a Nest,
}

impl Ruled<'_> {
    fn visibility(&self, o: Vec3, d: Vec3, t_max: f32, origin: Origin) -> Rgb {
        self.beyond(self.closest(o, d, t_max, origin), d, t_max)
    }

    /// The next thing that casts, or that the light has to get out of.
    fn closest(&self, o: Vec3, d: Vec3, t_max: f32, origin: Origin) -> Option<SurfaceHit> {
        self.scene.closest_where(o, d, t_max, origin, |instance| self.holds_up(instance))
    }

    fn holds_up(&self, instance: u32) -> bool {
        let set = self.scene.instances[instance as usize].categories;
        self.shadow.is_cast_by(set, &self.scene.members) || self.around.contains(instance)
    }

    fn beyond(&self, mut hit: Option<SurfaceHit>, d: Vec3, t_max: f32) -> Rgb {
        let (scene, mut inside, mut beyond) = (self.scene, self.around, None);
        let (mut way, mut entering, mut lit) = (0.0, Rgb::ONE, Rgb::ONE);
        for _ in 0..MAX_LAYERS {
            let until = hit.map_or(t_max - way, |hit| hit.t);
            let through = inside.transmittance(until);
            if inside.top().is_some_and(|body| !self.around.contains(body.instance)) {
                lit *= self.dimmed(through, way);
            } else {
                entering *= through;
            }
            way += until;
            let done = entering.max_element() <= 0.0 || lit.max_element() <= 0.0 && inside.medium().is_none();
            let Some(at) = hit.filter(|_| !done) else { return entering * self.shadow.shown(lit) };
            let mut si = scene.interaction(&at, d, side_of(inside, at.instance));
            let coating = scene.shade(&mut si, 0.0);
            if is_passed(scene, inside, at.instance, &coating) {
                let Some(nest) = crossed(scene, inside, &si, &coating) else { return Rgb::ZERO };
                inside = beyond.insert(nest);
            } else {
                let through = coating.surface.transparency(si.frame.n.dot(d).abs());
                if si.side == Side::Inside { entering *= through } else { lit *= self.dimmed(through, way) }
            }
            hit = self.closest(si.origin(d), d, t_max - way, Some((at.instance, at.triangle)));
        }
        entering * self.shadow.shown(Rgb::ZERO)
    }

    /// What the rules leave of the shadow of something `through` which light gets, `way` from the shaded point.
    fn dimmed(&self, through: Rgb, way: f32) -> Rgb {
        Rgb::ONE - self.shadow.strength(way) * (Rgb::ONE - through)
    }
}

impl Path<'_> {
    /// Whether the light is one that [`Self::meet_ruled_lights`] has asked for: the camera sees what there is to see.
    pub(super) fn asked(&self, light: u32) -> bool {
        self.scene.lights.shadow(light).is_some() && !matches!(self.previous, Previous::Camera)
    }

    /// Adds the lights with shadow rules along the direction just drawn, as next-event estimation towards it would: what a
    /// light shows must not depend on which of the two finds it.
    pub(super) fn meet_ruled_lights(&mut self) {
        let (scene, o, d) = (self.scene, self.o, self.d);
        scene.light_shapes(o, d, f32::INFINITY, |light, hit| self.meet_ruled(light, hit));
        for &light in scene.lights.infinite() {
            if scene.lights.shadow(light).is_none() {
                continue;
            }
            let radiance = scene.lights().escaped(light, d);
            if radiance != Rgb::ZERO {
                let weight = self.weight_of_escaped(light, d);
                self.see_ruled(light, weight * radiance, f32::INFINITY);
            }
        }
        self.meet_ruled_meshes();
    }

    fn meet_ruled_meshes(&mut self) {
        let (scene, d) = (self.scene, self.d);
        let ruled =
            |i: u32| scene.instances[i as usize].light.filter(|(light, _)| scene.lights.shadow(*light).is_some());
        if !scene.has_ruled_meshes {
            return;
        }
        let (mut o, mut origin) = (self.o, self.origin);
        for _ in 0..MAX_LAYERS {
            let Some(hit) = scene.closest_where(o, d, f32::INFINITY, origin, |i| ruled(i).is_some()) else { return };
            let mut si = scene.interaction(&hit, d, Side::Outside);
            // In a mirror the material's glow is seen in place of the light.
            let glows = self.looks && scene.shade(&mut si, 0.0).surface.emission() != Rgb::ZERO;
            if let (Some((light, first)), true) = (ruled(hit.instance), si.front && !glows) {
                let on_mesh = ShapeHit::on_mesh((si.p - self.o).dot(d), first + hit.triangle);
                self.meet_ruled(light, &on_mesh);
            }
            (o, origin) = (si.origin(d), Some((hit.instance, hit.triangle)));
        }
    }

    fn meet_ruled(&mut self, light: u32, hit: &ShapeHit) {
        let (scene, o, d) = (self.scene, self.o, self.d);
        let radiance = scene.lights().radiance_hit(light, d, hit);
        if radiance != Rgb::ZERO && scene.lights.shadow(light).is_some() {
            let weight = self.weight_of_hit(light, o, d, hit);
            self.see_ruled(light, weight * radiance, hit.t * SHORT);
        }
    }

    fn see_ruled(&mut self, light: u32, seen: Rgb, reach: f32) {
        if seen == Rgb::ZERO {
            return;
        }
        self.stats.shadow_rays += 1;
        let visible = visibility(self.scene, light, self.o, self.d, reach, self.origin, &self.inside);
        self.add(light, seen * visible);
    }
}
