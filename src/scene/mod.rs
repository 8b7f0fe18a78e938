//! The compiled scene: immutable, in render space (world translated to the camera), ready for rays.

pub mod accel;
mod alike;
mod attribute;
mod coats;
mod company;
mod compile;
mod displace;
mod driven;
mod edges;
mod enclosure;
mod geometry;
mod image;
mod instances;
mod mesh_lights;
mod motion;
mod needs;
mod nesting;
mod network;
mod overlap;
mod page_out;
mod paged;
mod pyramid;
mod rays;
mod shading;
mod strands;
mod tracks;
mod triangulation;

pub use attribute::Attribute;
pub use company::Around;
pub use compile::{CompileStats, Kept, compile, compile_last, eye_of};
pub use driven::Driven;
pub use enclosure::{BoundaryHit, InstanceEnclosure};
pub use geometry::Geometry;
pub use motion::{Deformation, Keys, Moves, Placed};
pub use needs::{Explanation, Needs};
pub use page_out::page_out;
pub use paged::{Residency, release};

use crate::bsdf::{Boundary, Surface};
use crate::camera::Camera;
use crate::film::OnSurface;
use crate::light::{Lights, Members};
use crate::math::Affine;
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
    /// `None`: the scene knows itself how things move, or nobody asks.
    tracks: Option<Box<tracks::Tracks>>,
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
        let value = |values: &attribute::Values| values.at(triangle, geometry.triangles[triangle], uv.x, uv.y);
        geometry.primvars.get(name).map_or(Vec3::ZERO, |values| value(values).truncate())
    }

    /// Pixels that a point goes on the image from where the shutter opens to where it closes: x right, y up. 0 where it
    /// passes the plane of the eye.
    pub fn motion_vector(&self, of: &OnSurface) -> Vec2 {
        let instance = &self.instances[of.instance as usize];
        let at = |time: f32| {
            if let Some(tracks) = &self.tracks {
                return tracks.raster(instance, of, time);
            }
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
