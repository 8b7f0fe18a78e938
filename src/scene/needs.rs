//! What a scene uses, hence which code paths and tables exist at all; `dermis explain` prints it.

use super::image::ImageCache;
use super::{Coating, Driven, Instance};
use crate::bsdf::Boundary;
use crate::camera::Camera;
use crate::flat::{FlatScene, GUIDE_AOVS};
use crate::light::Lights;
use crate::math::Rgb;
use serde::Serialize;

/// Counted at compile from the scene that was committed.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Needs {
    pub triangles: u64,
    pub meshes: u32,
    /// Placements of meshes beyond the first one of each.
    pub instanced: u32,
    /// Subdivision surfaces that were refined, and their triangles (one placement of each); those left as cages.
    pub refined_meshes: u32,
    pub refined_triangles: u64,
    pub cages: u32,
    /// Meshes whose points materials move, at compile.
    pub displaced_meshes: u32,
    pub lights: u32,
    /// Lights that rays can hit (shapes and meshes) and those at infinity.
    pub mesh_lights: u32,
    pub infinite_lights: u32,
    /// Domes with portals.
    pub guided_domes: u32,
    /// Lights that do not light everything, and those with other shadows than the black ones of everything.
    pub linked_lights: u32,
    pub shadow_rules: u32,
    /// Lights with `inputs:diffuse` or `inputs:specular` other than 1.
    pub scaled_lights: u32,
    pub textures: u32,
    /// Of the images of materials, all levels.
    pub texture_bytes: u64,
    /// Those of them that are in scratch files, of which `texture_memory` megabytes at most are in memory.
    pub paged_images: u32,
    pub texture_memory: u32,
    /// Surfaces with inputs that are driven: compiled anew at every point.
    pub driven_surfaces: u32,
    /// Surfaces of curves that scatter as strands.
    pub hair_surfaces: u32,
    /// Media by boundary.
    pub diffuse_media: u32,
    pub dielectric_media: u32,
    pub index_matched_media: u32,
    /// Dielectric interiors without scattering: Beer-Lambert only, no walk.
    pub clear_media: u32,
    /// Instances with a scattering medium that something else is in, or overlaps.
    pub hosts: u32,
    /// Instances that share an interior with others of their set.
    pub in_sets: u32,
    /// Placements of media that light reaches as an earlier one.
    pub alike: u32,
    /// Bodies that the camera is in.
    pub around_camera: u32,
    pub rgb_media: bool,
    pub anisotropic_media: bool,
    /// Surfaces that shadow rays pass, wholly or in part.
    pub transparency: bool,
    pub depth_of_field: bool,
    /// What moves while the shutter is open.
    pub moving_instances: u32,
    pub deforming_meshes: u32,
    pub moving_lights: u32,
    pub moving_camera: bool,
    pub aovs: Vec<String>,
}

/// One line of `dermis explain`: a capability, whether it is on, and why or why not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanation {
    pub capability: &'static str,
    pub on: bool,
    pub why: String,
}

impl Needs {
    pub fn walks(&self) -> bool {
        self.diffuse_media + self.dielectric_media + self.index_matched_media > 0
    }

    /// Whether bodies that light gets into, or of one set, may be around others.
    pub fn is_nested(&self) -> bool {
        let open = self.clear_media + self.dielectric_media + self.index_matched_media;
        // One medium may be placed twice: its hosts are.
        open > 0 && (open + self.diffuse_media > 1 || self.hosts > 0) || self.in_sets > 0
    }

    fn moves(&self) -> bool {
        self.moving_instances + self.deforming_meshes + self.moving_lights > 0 || self.moving_camera
    }

    fn motion(&self) -> String {
        let Self { moving_instances, deforming_meshes, moving_lights, .. } = self;
        let camera = if self.moving_camera { ", the camera" } else { "" };
        format!("{moving_instances} placements move, {deforming_meshes} deform, {moving_lights} lights{camera}")
    }

    fn subdivision(&self) -> String {
        let Self { refined_meshes, refined_triangles, cages, .. } = self;
        format!("{refined_meshes} surfaces refined to {refined_triangles} triangles, {cages} left as cages")
    }

    fn images(&self) -> String {
        let Self { textures, texture_bytes, paged_images, texture_memory, .. } = self;
        let all = format!("{textures} images, {:.1} MB for materials", *texture_bytes as f64 / 1e6);
        if *paged_images == 0 {
            return all;
        }
        format!("{all}: {paged_images} in scratch files, {texture_memory} MB of them in memory")
    }

    fn not_refined(&self) -> String {
        match self.cages {
            0 => "no subdivision surface".into(),
            n => format!("{n} surfaces are left as cages; --complexity refines them"),
        }
    }

    /// Adds what is counted in what was compiled; meshes are, as they are placed.
    pub(super) fn count(
        &mut self,
        flat: &FlatScene,
        images: &ImageCache,
        camera: &Camera,
        instances: &[Instance],
        surfaces: &[Coating],
        lights: &Lights,
    ) {
        self.linked_lights = lights.linked() as u32;
        self.guided_domes = lights.with_portals() as u32;
        self.shadow_rules = lights.ruled().count() as u32;
        self.scaled_lights = lights.with_responses() as u32;
        self.lights = lights.len() as u32;
        self.infinite_lights = lights.infinite().len() as u32;
        self.mesh_lights = instances.iter().filter(|i| i.light.is_some()).count() as u32;
        self.textures = (flat.textures.len() + images.len()) as u32;
        self.texture_bytes = images.values().map(|image| image.memory() as u64).sum();
        self.paged_images = images.values().filter(|image| image.is_paged()).count() as u32;
        self.texture_memory = flat.settings.texture_memory;
        self.moving_instances = instances.iter().filter(|i| i.moves.is_some()).count() as u32;
        self.deforming_meshes = instances.iter().filter(|i| i.geometry.deformation.is_some()).count() as u32;
        self.moving_lights = lights.moving() as u32;
        self.moving_camera = camera.is_moving();
        self.depth_of_field = camera.has_depth_of_field();
        self.aovs = flat.settings.aovs.clone();
        surfaces.iter().for_each(|coating| self.count_surface(coating));
    }

    fn count_surface(&mut self, coating: &Coating) {
        let driven = coating.driven.as_deref();
        self.hair_surfaces += u32::from(coating.surface.is_hair());
        self.driven_surfaces += u32::from(driven.is_some());
        self.transparency |= !coating.surface.is_opaque() || driven.is_some_and(Driven::opacity);
        let Some(interior) = coating.interior else { return };
        let medium = interior.medium;
        if !medium.scatters() {
            self.clear_media += 1;
        } else {
            match interior.boundary {
                Boundary::Diffuse => self.diffuse_media += 1,
                Boundary::Dielectric => self.dielectric_media += 1,
                Boundary::IndexMatched => self.index_matched_media += 1,
            }
        }
        self.transparency |= interior.boundary == Boundary::IndexMatched;
        let differs = |c: Rgb| c.max_element() != c.min_element();
        self.rgb_media |= differs(medium.sigma_t) || differs(medium.albedo);
        self.anisotropic_media |= medium.g != 0.0;
    }

    /// Each capability with why it is on, or what is missing for it.
    pub fn explain(&self) -> Vec<Explanation> {
        let media = format!(
            "media with diffuse {}, dielectric {}, index-matched {} boundary",
            self.diffuse_media, self.dielectric_media, self.index_matched_media
        );
        let count = |n: u32, what: &str| format!("{n} {what}");
        let names = self.aovs.iter().map(String::as_str);
        let (of_walks, plain): (Vec<&str>, Vec<&str>) = names.partition(|aov| GUIDE_AOVS.contains(aov));
        let line = Explanation::new;
        vec![
            line("subsurface walk", self.walks(), media, "no medium on anything that is rendered"),
            line(
                "spectral MIS",
                self.rgb_media,
                "mean free path or albedo differs between channels".into(),
                "no medium whose channels differ",
            ),
            line("anisotropic phase function", self.anisotropic_media, "a medium with g other than 0".into(), "g is 0"),
            line(
                "dielectric boundaries",
                self.dielectric_media > 0,
                count(self.dielectric_media, "media behind one"),
                "no medium behind one",
            ),
            line(
                "Beer-Lambert interiors",
                self.clear_media > 0,
                count(self.clear_media, "transmissive interiors without scattering"),
                "no transmissive interior without scattering",
            ),
            line(
                "light at collisions",
                self.index_matched_media > 0,
                "index-matched boundaries let light straight in".into(),
                "no index-matched boundary",
            ),
            line(
                "media with objects in them",
                self.hosts > 0,
                count(self.hosts, "scattering media: walks in them meet what is within, too"),
                "nothing reaches into a scattering medium behind a dielectric or index-matched boundary",
            ),
            line(
                "subsurface sets",
                self.in_sets > 0,
                count(self.in_sets, "placements share their interior with others of one subsurfaceSet"),
                "no two meshes with a diffuse boundary are of one subsurfaceSet",
            ),
            line(
                "shared boundary caches",
                self.alike > 0,
                count(self.alike, "placements of a medium have that of an earlier one, unless they fill the frame"),
                "no medium is placed twice, turned and scaled alike, under domes and distant lights alone: near lights, \
                 or another orientation, are another side of the body",
            ),
            line(
                "camera in a medium",
                self.around_camera > 0,
                count(self.around_camera, "bodies around the middle of the near plane"),
                "the camera is in no body",
            ),
            line(
                "transparent shadows",
                self.transparency,
                "surfaces with opacity below 1, or index-matched media".into(),
                "nothing that shadow rays pass",
            ),
            line(
                "instancing",
                self.instanced > 0,
                count(self.instanced, "placements share geometry"),
                "every mesh is placed once",
            ),
            line(
                "mesh lights",
                self.mesh_lights > 0,
                count(self.mesh_lights, "meshes emit as lights"),
                "no mesh is one",
            ),
            line("subdivision", self.refined_meshes > 0, self.subdivision(), &self.not_refined()),
            line(
                "displacement",
                self.displaced_meshes > 0,
                count(self.displaced_meshes, "meshes whose points materials move"),
                "no material that displaces",
            ),
            line(
                "environment sampling",
                self.infinite_lights > 0,
                count(self.infinite_lights, "dome or distant lights"),
                "no dome, no distant light with an angle",
            ),
            line(
                "portals",
                self.guided_domes > 0,
                count(self.guided_domes, "domes are sampled through portals, too"),
                "no dome has portals",
            ),
            line(
                "light linking",
                self.linked_lights > 0,
                count(self.linked_lights, "lights whose lightLink leaves something out"),
                "every light is for everything",
            ),
            line(
                "shadow rules",
                self.shadow_rules > 0,
                count(self.shadow_rules, "lights with a shadowLink that leaves something out, or ShadowAPI"),
                "everything casts black shadows",
            ),
            line(
                "lights by lobe",
                self.scaled_lights > 0,
                count(self.scaled_lights, "lights with inputs:diffuse or inputs:specular other than 1"),
                "every light is the same to all lobes",
            ),
            line("textures", self.textures > 0, self.images(), "no image on anything that is rendered"),
            line(
                "driven surfaces",
                self.driven_surfaces > 0,
                count(self.driven_surfaces, "surfaces with inputs that images, primvars or nodes drive"),
                "every input of every surface is a constant",
            ),
            line(
                "hair",
                self.hair_surfaces > 0,
                count(self.hair_surfaces, "surfaces of curves scatter as strands"),
                "no hair material on curves",
            ),
            line(
                "depth of field",
                self.depth_of_field,
                "fStop and focusDistance of the camera above 0".into(),
                "fStop or focusDistance of the camera is 0, or it is switched off",
            ),
            line(
                "motion blur",
                self.moves(),
                self.motion(),
                "nothing moves while the camera's shutter is open, it does not open (shutter:open, shutter:close), or it is switched off",
            ),
            line("AOVs", !plain.is_empty(), plain.join(", "), "none asked for beside the beauty"),
            line("AOVs of walks", !of_walks.is_empty(), of_walks.join(", "), "none asked for"),
        ]
    }
}

impl Explanation {
    /// A line that says why it is `on`, or what is `missing` for it.
    pub fn new(capability: &'static str, on: bool, why: String, missing: &str) -> Self {
        Self { capability, on, why: if on { why } else { missing.into() } }
    }
}
