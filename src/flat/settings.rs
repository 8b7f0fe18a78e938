//! Render settings: what `--set` lists, and what the stage's RenderSettings prim or the flags decide.

use serde::{Deserialize, Serialize};

/// AOVs beside the beauty, in the order of the file.
pub const AOVS: [&str; 10] =
    ["alpha", "depth", "normal", "position", "albedo", "primId", "direct", "indirect", "subsurface", "variance"];

/// AOVs written only where asked for: kinds of depth (along the ray, of a rasteriser), eye space, motion, light without a
/// bounce and after one, samples per pixel, Cryptomatte of the objects, light by the lobe of the first surface.
pub const EXTRA_AOVS: [&str; 18] = [
    "distance",
    "deviceDepth",
    "Peye",
    "Neye",
    "motionVector",
    "emission",
    "firstBounce",
    "sampleCount",
    "cryptoObject",
    "directDiffuse",
    "indirectDiffuse",
    "directSpecular",
    "indirectSpecular",
    "directTransmission",
    "indirectTransmission",
    "diffuse",
    "specular",
    "transmission",
];

/// Light by the lobe of the first surface: with `emission` and `subsurface` the beauty.
pub const LOBE_AOVS: [&str; 6] = [
    "directDiffuse",
    "indirectDiffuse",
    "directSpecular",
    "indirectSpecular",
    "directTransmission",
    "indirectTransmission",
];

/// What an AOV is the sum of, named by itself or as a sum `emission+diffuse`: [`LOBE_AOVS`], `emission` and `subsurface`,
/// or itself alone; `None`: it is no light of the image, or counts some twice.
pub fn parts_of(aov: &str) -> Option<Vec<&str>> {
    if ["direct", "indirect", "firstBounce"].contains(&aov) {
        return Some(vec![aov]);
    }
    let mut parts = Vec::new();
    for name in aov.split('+') {
        let of_name: &[&str] = match name {
            "direct" => &["emission", "directDiffuse", "directSpecular", "directTransmission"],
            "firstBounce" => &["directDiffuse", "directSpecular", "directTransmission"],
            "indirect" => &["indirectDiffuse", "indirectSpecular", "indirectTransmission"],
            "diffuse" => &LOBE_AOVS[..2],
            "specular" => &LOBE_AOVS[2..4],
            "transmission" => &LOBE_AOVS[4..],
            "emission" | "subsurface" => &[name],
            one if LOBE_AOVS.contains(&one) => &[name],
            _ => return None,
        };
        if of_name.iter().any(|part| parts.contains(part)) {
            return None;
        }
        parts.extend(of_name);
    }
    Some(parts)
}

/// AOVs of lights are named this, and a light group, or a light: written only where asked for.
pub const LIGHT_AOV: &str = "light_";

/// AOVs for looking at the guide, of the first walk behind a camera ray: written only where asked for.
pub const GUIDE_AOVS: [&str; 6] =
    ["slabNormal", "entryAgreement", "walkLength", "region", "cacheIrradiance", "techniqueShares"];

/// Prefix of AOVs that show a primvar.
pub const PRIMVAR_AOV: &str = "primvars:";

/// Guided walks of the literature, the mixture of them, and the choice between it and `classical`.
pub const WALKS: [&str; 8] = ["auto", "classical", "poe", "cp", "ii", "bono", "bill", "mixture"];

/// With the point of entry's they fill eight lanes.
pub const MAX_NORMALS: u32 = 7;

/// Settings of one render; `--set NAME=VALUE` takes each of these names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct RenderSettings {
    /// Path of the camera prim in `FlatScene::cameras`.
    pub camera: String,
    /// Pixels.
    pub resolution: [u32; 2],
    pub pixel_aspect_ratio: f32,
    /// `expandAperture`, `cropAperture`, `adjustApertureWidth`, `adjustApertureHeight`, `adjustPixelAspectRatio`.
    pub aspect_ratio_conform_policy: String,
    /// Region to render, NDC x0 y0 x1 y1, y up (USD's); `--crop` arrives here.
    #[serde(rename = "dataWindowNDC")]
    pub data_window_ndc: [f32; 4],
    pub disable_depth_of_field: bool,
    /// All is where it is at the frame itself.
    pub disable_motion_blur: bool,
    /// Samples per pixel.
    pub samples: u32,
    pub sample_offset: u32,
    pub seed: u32,
    /// 0: all.
    pub threads: u32,
    /// Seconds of rendering; 0: no limit.
    pub time_limit: f32,
    /// Relative error of the image from which pilot samples decide how many each tile gets, `samples` at most; 0:
    /// all get `samples`.
    pub noise_threshold: f32,
    /// Refinements of subdivision surfaces, at most [`crate::subdivision::MAX_LEVEL`]; 0 renders their cages.
    pub refine_level: u32,
    /// Surface bounces.
    pub max_depth: u32,
    /// Subsurface walk, one of [`WALKS`].
    pub walk: String,
    /// `conditional`, `exact`, or `auto`: exact where it exists.
    pub walk_pdf: String,
    /// Share of classical walks mixed into guided ones; `mixture` starts from at least its own.
    pub classical_fraction: f32,
    /// `dwivedi` or `classical`: how the first distance of a guided walk is drawn. `cp` and `ii` know their normal
    /// only after it: theirs is classical.
    pub first_distance: String,
    /// Clustered slab normals per region beside the point of entry's, at most [`MAX_NORMALS`].
    pub normals: u32,
    /// Shares of techniques are learned from the walks.
    pub learn_shares: bool,
    /// The technique of a walk is a stratified dimension of its pixel's samples.
    pub stratify_techniques: bool,
    /// Densities of the techniques serve as control variates.
    pub control_variates: bool,
    /// Lights sampled where a walk comes out: `one`, `all`, `learned` (one, by visible contribution), or `auto`.
    pub exit_lights: String,
    /// Light sampled at collisions, through dielectric boundaries: `on`, `off`, or `auto`: where a light is small, and, of
    /// smooth ones, where the walk is not of exact weight.
    pub refracted_light: String,
    /// Where walks of `mixture` come out of a diffuse boundary, half of them go on to where light was seen.
    pub guide_exits: bool,
    /// Pixels have a part in the paths of their neighbours through a medium with a diffuse boundary: `on`, `off`, or `auto`: with
    /// [`Self::walk`] `auto`.
    pub shared_paths: String,
    /// `importance`: a sample is its own pixel's alone; `weighted`: of all pixels under whose filter it lies.
    pub pixel_filter_mode: String,
    /// What fills the boundary cache: `surface` (uniform samples) or `camera` (walks of camera paths).
    pub cache_fill: String,
    /// Cells of the boundary cache along the longest side of an object; 0: by mean free path and pixel size.
    pub cache_resolution: u32,
    /// `auto`, or a boundary for every medium: `diffuse`, `dielectric`, `indexMatched`.
    pub subsurface_boundary: String,
    /// Megabytes for the images of materials: where they are more, they are in scratch files and read as they are looked
    /// at. 0: no bound.
    pub texture_memory: u32,
    /// What all colours are in, lights' and materials' included: usd-core's name of a linear space. The bridge brings them
    /// there; what is rendered does not depend on the name.
    pub rendering_color_space: String,
    /// Camera rays see area lights.
    pub lights_visible_to_camera: bool,
    /// AOVs beside the beauty, each one of [`AOVS`], [`EXTRA_AOVS`] or [`GUIDE_AOVS`], a sum ([`parts_of`]), or a primvar
    /// of the first surface ([`PRIMVAR_AOV`] and its name); all of the first by default.
    pub aovs: Vec<String>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            camera: String::new(),
            resolution: [960, 540],
            pixel_aspect_ratio: 1.0,
            aspect_ratio_conform_policy: "expandAperture".into(),
            data_window_ndc: [0.0, 0.0, 1.0, 1.0],
            disable_depth_of_field: false,
            disable_motion_blur: false,
            samples: 64,
            sample_offset: 0,
            seed: 0,
            threads: 0,
            time_limit: 0.0,
            noise_threshold: 0.0,
            refine_level: 0,
            max_depth: 12,
            walk: "auto".into(),
            walk_pdf: "auto".into(),
            classical_fraction: 0.0,
            first_distance: "dwivedi".into(),
            normals: MAX_NORMALS,
            learn_shares: true,
            stratify_techniques: true,
            control_variates: true,
            exit_lights: "auto".into(),
            refracted_light: "auto".into(),
            guide_exits: true,
            shared_paths: "auto".into(),
            pixel_filter_mode: "importance".into(),
            cache_fill: "surface".into(),
            cache_resolution: 0,
            subsurface_boundary: "auto".into(),
            texture_memory: 4096,
            rendering_color_space: "lin_rec709_scene".into(),
            lights_visible_to_camera: false,
            aovs: AOVS.map(String::from).to_vec(),
        }
    }
}
