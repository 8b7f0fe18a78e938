//! Validated once: what broken files bring is dropped or clamped here, with a warning, so that the compiler
//! may index and divide without checks.
//!
//! A prim by itself is checked by the function of its kind ([`validate_prim`]); names of other prims need the
//! whole scene ([`FlatScene::validate_names`]). All of it repairs in place and a second time finds nothing.
//! Faces that are dropped renumber the others: who edits a scene keeps what was authored and validates a
//! clone, which shares every array that needs no repair.
//!
//! One pass over each array, and no allocation where all is fine: a mapped array stays mapped.

mod light;
mod material;
mod mesh;
mod motion;
mod network;
mod primvar;
mod report;
mod settings;
#[cfg(test)]
mod tests;
mod topology;

pub use light::{validate_camera, validate_light, validate_texture};
pub use material::validate_material;
pub use mesh::{validate_instancer, validate_mesh};
pub use network::validate_image;

use super::{FlatScene, LightShape, Mesh, Prim, Prims};
use crate::error::Warning;
use report::Report;

/// Checks one prim by itself.
pub fn validate_prim(path: &str, prim: &mut Prim, warnings: &mut Vec<Warning>) {
    match prim {
        Prim::Mesh(mesh) => validate_mesh(path, mesh, warnings),
        Prim::Instancer(instancer) => validate_instancer(path, instancer, warnings),
        Prim::Material(material) => validate_material(path, material, warnings),
        Prim::Light(light) => validate_light(path, light, warnings),
        Prim::Camera(camera) => validate_camera(path, camera, warnings),
        Prim::Texture(texture) => validate_texture(path, texture, warnings),
        Prim::Image(image) => validate_image(path, image, warnings),
    }
}

impl FlatScene {
    /// Checks every prim and then the names between them. Returns the new warnings (`self.warnings`, the
    /// bridge's, stay as they are), in the order of the prims' paths within each kind. The settings are not
    /// repaired: see [`super::RenderSettings::check`].
    pub fn validate(&mut self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        validate_all(&mut self.meshes, validate_mesh, &mut warnings);
        validate_all(&mut self.instancers, validate_instancer, &mut warnings);
        validate_all(&mut self.materials, validate_material, &mut warnings);
        validate_all(&mut self.lights, validate_light, &mut warnings);
        validate_all(&mut self.cameras, validate_camera, &mut warnings);
        validate_all(&mut self.textures, validate_texture, &mut warnings);
        validate_all(&mut self.images, validate_image, &mut warnings);
        self.validate_stage(&mut warnings);
        self.validate_names(&mut warnings);
        warnings
    }

    /// Clears the names of prims that are not there, after which each name that is not empty can be looked up;
    /// a mesh without its instancer and a light without its mesh are switched off.
    pub fn validate_names(&mut self, warnings: &mut Vec<Warning>) {
        let Self { meshes, instancers, materials, lights, cameras, textures, settings, .. } = self;
        for (path, mesh) in meshes.iter_mut() {
            let report = &mut Report::new(path, warnings);
            clear_materials(mesh, |name| materials.contains_key(name), report);
            if !mesh.instancer.is_empty() && !instancers.contains_key(&mesh.instancer) {
                let name = std::mem::take(&mut mesh.instancer);
                report.warn(format!("its instancer {name} is not there, the mesh is not rendered; restore prototypes"));
                mesh.visible = false;
            }
        }
        for (path, light) in lights.iter_mut() {
            let report = &mut Report::new(path, warnings);
            match &mut light.shape {
                LightShape::Rect { texture, .. } | LightShape::Dome { texture, .. } => {
                    let there = textures.get(texture.as_str()).is_some_and(|texture| !texture.pixels.is_empty());
                    clear(texture, there, "inputs:texture:file", "the light is plain; mend the asset path", report);
                }
                LightShape::Mesh { mesh } => {
                    clear(mesh, meshes.contains_key(mesh.as_str()), "its mesh", "nothing emits; restore it", report);
                    if light.visible && meshes.get(mesh.as_str()).is_none_or(|mesh| mesh.face_vertex_counts.is_empty())
                    {
                        report.warn("its mesh has no faces, the light is off; mend the mesh");
                        light.visible = false;
                    }
                }
                _ => {}
            }
        }
        let there = cameras.contains_key(&settings.camera);
        let report = &mut Report::new("render settings", warnings);
        clear(&mut settings.camera, there, "camera", "no camera is chosen; give the path of one", report);
    }

    fn validate_stage(&mut self, warnings: &mut Vec<Warning>) {
        let mut report = Report::new("/", warnings);
        report.token("upAxis", &mut self.stage.up_axis, &["Y", "Z"], "Y");
        let scale = &mut self.stage.meters_per_unit;
        if !(*scale > 0.0 && scale.is_finite()) {
            report.warn(format!("metersPerUnit is {scale:?}, 0.01 is used; author a number above 0"));
            *scale = 0.01;
        }
        if !self.stage.time_code.is_finite() {
            report.warn(format!("the time code is {}, 0 is used; give a frame", self.stage.time_code));
            self.stage.time_code = 0.0;
        }
    }
}

fn validate_all<T>(prims: &mut Prims<T>, check: fn(&str, &mut T, &mut Vec<Warning>), warnings: &mut Vec<Warning>) {
    prims.iter_mut().for_each(|(path, prim)| check(path, prim, warnings));
}

fn clear_materials(mesh: &mut Mesh, is_there: impl Fn(&str) -> bool, report: &mut Report) {
    let instead = "displayColor is used; bind a material that exists";
    let there = is_there(&mesh.material);
    clear(&mut mesh.material, there, "material:binding", instead, report);
    for subset in &mut mesh.geom_subsets {
        if !subset.material.is_empty() && !is_there(&subset.material) {
            let name = std::mem::take(&mut subset.material);
            let message = format!("material:binding {name} is not there, that of the mesh is used; bind another");
            report.warn_at(&subset.path, message);
        }
    }
}

fn clear(name: &mut String, there: bool, attribute: &str, instead: &str, report: &mut Report) {
    if !name.is_empty() && !there {
        report.warn(format!("{attribute} {name} is not there, {instead}"));
        name.clear();
    }
}
