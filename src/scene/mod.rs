//! The compiled scene: immutable, in render space (world translated to the camera), ready for rays.

pub mod accel;
mod alike;
mod company;
mod compile;
mod displace;
mod driven;
mod edges;
mod enclosure;
mod geometry;
mod image;
mod motion;
mod needs;
mod nesting;
mod network;
mod paged;
mod strands;

pub use company::Around;
pub use compile::{CompileStats, Kept, compile};
pub use driven::Driven;
pub use enclosure::{BoundaryHit, InstanceEnclosure};
pub use geometry::{Attribute, Geometry};
pub use image::page_out;
pub use motion::{Deformation, Keys, Moves, Placed};
pub use needs::{Explanation, Needs};
pub use paged::{Residency, release};

use crate::bsdf::{Boundary, Side, Surface};
use crate::camera::Camera;
use crate::film::OnSurface;
use crate::interaction::{Interaction, shading_normal};
use crate::light::{Lights, LightsAt, Members, ShapeHit};
use crate::math::{Affine, Frame};
use crate::medium::Medium;
use accel::{Ray, Tlas};
use glam::{Vec2, Vec3, Vec4};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The inside of a surface that has one.
#[derive(Debug, Clone, Copy)]
pub struct Interior {
    pub boundary: Boundary,
    /// Of refraction, against vacuum; 1 if index-matched.
    pub index: f32,
    pub medium: Medium,
}

/// Values by name and instance; NaN: none.
pub type InstancePrimvars = BTreeMap<String, Vec<Vec4>>;

/// A placement of a geometry.
pub struct Instance {
    pub geometry: Arc<Geometry>,
    /// Centred object space to render space, at the frame.
    pub to_render: Affine,
    /// The same by time of the shutter; `None`: it stays.
    pub moves: Option<Box<Moves>>,
    /// First of its surfaces in `Scene::surfaces`, one per material slot.
    pub surfaces: u32,
    /// Of its medium where bodies overlap: higher wins.
    pub priority: i32,
    pub prim_id: i32,
    /// Light and index of its first triangle there, if the mesh is a light.
    pub light: Option<(u32, u32)>,
    /// In place of the geometry's.
    pub display_color: Option<Vec3>,
    /// Those of its instancer that materials read, and which of their values are its own.
    pub primvars: Option<(Arc<InstancePrimvars>, u32)>,
    /// The set of categories that it is in ([`Scene::members`]).
    pub categories: u32,
    /// The linear part is the identity, all the time: rays need no rotation.
    pub(crate) translated: bool,
}

/// A surface and what it encloses.
pub struct Coating {
    pub surface: Surface,
    pub interior: Option<Interior>,
    /// What differs from point to point; surface and interior are then the typical ones.
    pub driven: Option<Box<Driven>>,
}

/// The coating at a point.
#[allow(clippy::large_enum_variant)] // on the stack, where a box would cost an allocation per vertex
pub enum CoatingAt<'a> {
    Constant(&'a Coating),
    Driven(Coating),
}

impl std::ops::Deref for CoatingAt<'_> {
    type Target = Coating;
    fn deref(&self) -> &Coating {
        match self {
            Self::Constant(coating) => coating,
            Self::Driven(coating) => coating,
        }
    }
}

pub struct Scene {
    pub camera: Camera,
    pub instances: Vec<Instance>,
    tlas: Tlas,
    pub surfaces: Vec<Coating>,
    pub lights: Lights,
    /// What lights may be linked to.
    pub members: Members,
    /// Whether a mesh light has shadow rules.
    pub has_ruled_meshes: bool,
    light_shapes: Vec<u32>,
    light_tlas: Tlas,
    companies: company::Companies,
    /// By instance, the first one whose boundary light reaches alike; empty where no two do.
    pub alike: Vec<u32>,
    /// Bodies that the camera is in, outermost first.
    pub camera_within: Vec<Around>,
    pub needs: Needs,
    /// Instances move or deform: rays have to know the time.
    moves: bool,
    /// The one time of all paths; `None`: anything may move, and each has its own.
    pub frozen: Option<f32>,
}

/// The scene at a time of the shutter, 0 where it opens, 1 where it closes: what one path sees.
#[derive(Clone, Copy)]
pub struct Moment<'a> {
    pub scene: &'a Scene,
    pub time: f32,
}

impl std::ops::Deref for Moment<'_> {
    type Target = Scene;
    #[inline(always)]
    fn deref(&self) -> &Scene {
        self.scene
    }
}

/// Closest surface along a ray.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceHit {
    pub t: f32,
    pub instance: u32,
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

/// A triangle of an instance, to be left out by a ray that starts on it.
pub type Origin = Option<(u32, u32)>;

/// No instance.
pub const NOBODY: u32 = u32::MAX;

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

impl Instance {
    /// Smallest side of its box in render space, stage units.
    pub fn thickness(&self) -> f32 {
        2.0 * self.half_size().min_element()
    }

    /// Half the sides of its box in render space.
    pub fn half_size(&self) -> Vec3 {
        let bounds = self.geometry.bounds();
        self.to_render.linear.abs() * ((bounds.max - bounds.min) * 0.5)
    }
}

impl Scene {
    /// Whether anything emits light.
    pub fn is_lit(&self) -> bool {
        !self.lights.is_empty() || self.surfaces.iter().any(|coating| coating.surface.emission() != Vec3::ZERO)
    }

    /// What else a walk in an instance meets; `None`: its boundary alone.
    fn company(&self, instance: u32) -> Option<&company::Company> {
        self.companies.get(instance as usize)?.as_deref()
    }

    /// Whether a walk in `instance` has its boundary alone to meet, and no light.
    pub fn is_alone(&self, instance: u32) -> bool {
        self.company(instance).is_none_or(|company| matches!(company, company::Company::Set(_)))
    }

    /// An instance of the mesh that wears `surface`, an index of `surfaces`.
    pub fn owner(&self, surface: usize) -> Option<&Instance> {
        // Surfaces of a mesh follow each other; its instances name the first.
        self.instances.iter().filter(|i| i.surfaces as usize <= surface).max_by_key(|i| i.surfaces)
    }

    /// A primvar at a point, its first three numbers; zero where there is none, or materials and AOVs do not ask for it.
    pub fn primvar_at(&self, at: &OnSurface, name: &str) -> Vec3 {
        let instance = &self.instances[at.instance as usize];
        let geometry = &instance.geometry;
        let of_instance = instance.primvars.as_ref().and_then(|(primvars, i)| primvars.get(name)?.get(*i as usize));
        if let Some(value) = of_instance.filter(|value| !value.x.is_nan()) {
            return value.truncate();
        }
        let (triangle, uv) = (at.triangle as usize, at.barycentric);
        let value = |values: &geometry::Values| values.at(triangle, geometry.triangles[triangle], uv.x, uv.y);
        geometry.primvars.get(name).map_or(Vec3::ZERO, |values| value(values).truncate())
    }

    /// Pixels that a point goes on the image from where the shutter opens to where it closes: x right, y up. 0 where it
    /// passes the plane of the eye.
    pub fn motion_vector(&self, of: &OnSurface) -> Vec2 {
        let instance = &self.instances[of.instance as usize];
        let at = |time: f32| {
            let [a, b, c] = instance.geometry.corners(of.triangle, time);
            let (u, v) = (of.barycentric.x, of.barycentric.y);
            self.camera.raster(instance.placed(time).point(a * (1.0 - u - v) + b * u + c * v), time)
        };
        match (at(0.0), at(1.0)) {
            (Some(open), Some(close)) => Vec2::new(close.x - open.x, open.y - close.y),
            _ => Vec2::ZERO,
        }
    }

    /// What a path of that time sees.
    pub fn at(&self, time: f32) -> Moment<'_> {
        Moment { scene: self, time }
    }

    /// A moment that stands for all: the middle of the shutter.
    pub fn middle(&self) -> Moment<'_> {
        self.at(self.frozen.unwrap_or(0.5))
    }
}

impl<'a> Moment<'a> {
    pub fn lights(&self) -> LightsAt<'a> {
        self.scene.lights.at(self.time)
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
        self.tlas.traverse(&mut Ray { o, d, t_max }, |i, ray| {
            let instance = &self.instances[i as usize];
            occluded = if MOVES {
                let placed = instance.placed(self.time);
                let local = instance.local_ray(&placed, o - placed.translation, d, ray.t_max);
                instance.geometry.any(&local, skipped(origin, i), self.time)
            } else {
                let placed = &instance.to_render;
                let local = instance.local_ray(placed, o - placed.translation, d, ray.t_max);
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

    /// The surface point of a hit on a path that travels along `d`.
    pub fn interaction(&self, hit: &SurfaceHit, d: Vec3, side: Side) -> Interaction {
        let instance = &self.instances[hit.instance as usize];
        let geometry = &instance.geometry;
        let [a, b, c] = geometry.corners(hit.triangle, self.time);
        let local = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        let m = &*instance.placed(self.time);
        let at = Vec2::new(hit.u, hit.v);
        let front_normal = m.normal((b - a).cross(c - a)).normalize_or(-d);
        let front = front_normal.dot(d) <= 0.0;
        let outward = matches!(side, Side::Outside) == front;
        let ng = if outward { front_normal } else { -front_normal };
        let wo = -d;
        let corners = geometry.triangles[hit.triangle as usize];
        let ns = geometry.normal(hit.triangle, hit.u, hit.v, self.time).map_or(ng, |normal| {
            let n = m.normal(normal);
            // Inside, the side of wo is -ng: bend there, then turn back.
            match side {
                Side::Outside => shading_normal(n, ng, wo),
                Side::Inside => -shading_normal(n, -ng, wo),
            }
        });
        // Rounding of the barycentric sum and of the affine map: a few ulps of the largest term.
        let extent = (m.linear.abs() * (a.abs().max(b.abs()).max(c.abs()))) + m.translation.abs();
        Interaction {
            p: m.point(local),
            error: 4.0 * f32::EPSILON * extent.max_element(),
            ng,
            frame: match &geometry.strands {
                None => Frame::from_normal(ns),
                Some(strands) => strands.frame(m, hit.triangle as usize, corners, at, wo),
            },
            wo,
            side,
            strand: geometry.strands.is_some(),
            instance: hit.instance,
            triangle: hit.triangle,
            barycentric: at,
            surface: instance.surfaces + geometry.slot(hit.triangle) as u32,
            front,
            display_color: match &geometry.display_color {
                _ if instance.display_color.is_some() => instance.display_color,
                None | Some(Attribute::Constant(_)) => None,
                Some(color) => Some(color.at(hit.triangle as usize, corners, hit.u, hit.v)),
            },
        }
    }

    /// The coating at `si`, whose shading normal it may bend. `width`: of the ray's footprint across the ray.
    pub fn shade(&self, si: &mut Interaction, width: f32) -> CoatingAt<'a> {
        let coating = &self.scene.surfaces[si.surface as usize];
        match &coating.driven {
            None => CoatingAt::Constant(coating),
            Some(driven) => CoatingAt::Driven(self.drive(driven, si, width)),
        }
    }

    /// Bends the shading normal of `si`, if its material does.
    pub fn bend(&self, si: &mut Interaction, width: f32) {
        if let Some(driven) = self.surfaces[si.surface as usize].driven.as_ref().filter(|driven| driven.bends()) {
            self.drive(driven, si, width);
        }
    }

    fn drive(&self, driven: &Driven, si: &mut Interaction, width: f32) -> Coating {
        let instance = &self.instances[si.instance as usize];
        let geometry = &instance.geometry;
        let lookup = network::Lookup {
            primvars: &geometry.primvars,
            instance: instance.primvars.as_ref().map(|(primvars, i)| (&**primvars, *i as usize)),
            triangle: si.triangle as usize,
            corners: geometry.triangles[si.triangle as usize],
            at: si.barycentric,
            across: Some(footprint(instance, si, width, self.time)),
            time: self.time,
        };
        let outward = matches!(si.side, Side::Outside) == si.front;
        let turn = if outward { 1.0 } else { -1.0 };
        let (coating, bent) = driven.at(instance, &lookup, si.display_color, si.frame.n * turn);
        if let Some(n) = bent {
            // As in `interaction`.
            let n = n * turn;
            si.frame = Frame::from_normal(match si.side {
                Side::Outside => shading_normal(n, si.ng, si.wo),
                Side::Inside => -shading_normal(-n, -si.ng, si.wo),
            });
        }
        coating
    }
}

/// Grazing footprints are cut to this many widths: images beyond are averaged by the samples of a pixel.
const LONGEST_FOOTPRINT: f32 = 16.0;

/// Offsets in barycentrics of two points beside `si`: along the ray's projection, and across it.
fn footprint(instance: &Instance, si: &Interaction, width: f32, time: f32) -> [Vec2; 2] {
    let [a, b, c] = instance.geometry.corners(si.triangle, time);
    let placed = instance.placed(time);
    let [e1, e2] = [b - a, c - a].map(|edge| placed.vector(edge));
    let cos = si.wo.dot(si.ng);
    let along = (si.wo - si.ng * cos).try_normalize().unwrap_or_else(|| si.ng.any_orthonormal_vector());
    let stretch = cos.abs().recip().min(LONGEST_FOOTPRINT);
    let (m11, m12, m22) = (e1.length_squared(), e1.dot(e2), e2.length_squared());
    let determinant = m11 * m22 - m12 * m12;
    [along * (width * stretch), si.ng.cross(along) * width].map(|offset| {
        let (x, y) = (offset.dot(e1), offset.dot(e2));
        let barycentric = Vec2::new(m22 * x - m12 * y, m11 * y - m12 * x) / determinant;
        // A needle without area in f32 is seen whole: a point of it.
        if barycentric.is_finite() { barycentric } else { Vec2::ZERO }
    })
}
