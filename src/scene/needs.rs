//! What a scene uses, hence which code paths and tables exist at all; `dermis explain` prints it.

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
    pub lights: u32,
    /// Lights that rays can hit (shapes and meshes) and those at infinity.
    pub mesh_lights: u32,
    pub infinite_lights: u32,
    pub textures: u32,
    /// Media by boundary.
    pub diffuse_media: u32,
    pub dielectric_media: u32,
    pub index_matched_media: u32,
    /// Dielectric interiors without scattering: Beer-Lambert only, no walk.
    pub clear_media: u32,
    pub rgb_media: bool,
    pub anisotropic_media: bool,
    /// Surfaces that shadow rays pass, wholly or in part.
    pub transparency: bool,
    pub depth_of_field: bool,
    pub aovs: Vec<String>,
}

/// One line of `dermis explain`: a capability, whether it is on, and why.
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

    fn subdivision(&self) -> String {
        let Self { refined_meshes, refined_triangles, cages, .. } = self;
        format!("{refined_meshes} surfaces refined to {refined_triangles} triangles, {cages} left as cages")
    }

    pub fn explain(&self) -> Vec<Explanation> {
        let line = |capability, on, why: String| Explanation { capability, on, why };
        let count = |n: u32, what: &str| format!("{n} {what}");
        vec![
            line(
                "subsurface walk",
                self.walks(),
                format!(
                    "media with diffuse {}, dielectric {}, index-matched {} boundary",
                    self.diffuse_media, self.dielectric_media, self.index_matched_media
                ),
            ),
            line("spectral MIS", self.rgb_media, "mean free path or albedo differs between channels".into()),
            line("anisotropic phase function", self.anisotropic_media, "a medium with g other than 0".into()),
            line(
                "Beer-Lambert interiors",
                self.clear_media > 0,
                count(self.clear_media, "transmissive interiors without scattering"),
            ),
            line(
                "light at collisions",
                self.index_matched_media > 0,
                "index-matched boundaries let light straight in".into(),
            ),
            line(
                "transparent shadows",
                self.transparency,
                "surfaces with opacity below 1, or index-matched media".into(),
            ),
            line("instancing", self.instanced > 0, count(self.instanced, "placements share geometry")),
            line("subdivision", self.refined_meshes > 0, self.subdivision()),
            line("mesh lights", self.mesh_lights > 0, count(self.mesh_lights, "meshes emit as lights")),
            line(
                "environment sampling",
                self.infinite_lights > 0,
                count(self.infinite_lights, "dome or distant lights"),
            ),
            line("textures", self.textures > 0, count(self.textures, "images")),
            line("depth of field", self.depth_of_field, "fStop and focusDistance of the camera above 0".into()),
            line("AOVs", !self.aovs.is_empty(), self.aovs.join(", ")),
        ]
    }
}
