//! Render settings: typed by a user, so a wrong one is an error and never a guess.

use crate::{
    error::{Error, Result},
    flat::{AOVS, EXTRA_AOVS, GUIDE_AOVS, LIGHT_AOV, MAX_NORMALS, PRIMVAR_AOV, RenderSettings, WALKS, parts_of},
    subdivision::MAX_LEVEL,
};

/// Pixels per side: above it the AOVs of one image fill the memory of any machine.
const LARGEST_RESOLUTION: u32 = 1 << 16;

/// Above it no machine has the cores, and starting the threads alone takes minutes.
const MOST_THREADS: u32 = 4096;

/// Seconds, a thousand years: far below what `Duration` holds.
const LONGEST_TIME_LIMIT: f32 = 3e10;

/// Cells per side: more than an object has triangles across.
const FINEST_CACHE: u32 = 1024;

const POLICIES: [&str; 5] =
    ["expandAperture", "cropAperture", "adjustApertureWidth", "adjustApertureHeight", "adjustPixelAspectRatio"];
const BOUNDARIES: [&str; 4] = ["auto", "diffuse", "dielectric", "indexMatched"];

impl RenderSettings {
    /// Refuses what no image can be rendered with.
    ///
    /// # Errors
    /// [`Error::Prim`] of `render settings`, naming the setting, its value and what it takes.
    pub fn check(&self) -> Result<()> {
        let sides = 1..=LARGEST_RESOLUTION;
        let [width, height] = self.resolution;
        if !(sides.contains(&width) && sides.contains(&height)) {
            return refuse("resolution", format!("{width} x {height}"), "1 to 65536 pixels per side");
        }
        // Bounds of the EXR attribute.
        if !(1e-6..=1e6).contains(&self.pixel_aspect_ratio) {
            return refuse("pixelAspectRatio", self.pixel_aspect_ratio, "a number from 1e-6 to 1e6");
        }
        self.check_data_window()?;
        if self.samples == 0 || self.sample_offset.checked_add(self.samples).is_none() {
            return refuse("samples", self.samples, "1 or more, which with sampleOffset stay below 2^32");
        }
        if self.threads > MOST_THREADS {
            return refuse("threads", self.threads, "0 for all cores, at most 4096");
        }
        // A range, which NaN is not in.
        if !(0.0..=LONGEST_TIME_LIMIT).contains(&self.time_limit) {
            return refuse("timeLimit", self.time_limit, "seconds up to 3e10, 0 for no limit");
        }
        if !(self.noise_threshold >= 0.0 && self.noise_threshold.is_finite()) {
            return refuse("noiseThreshold", self.noise_threshold, "a relative error, 0 for none");
        }
        if self.refine_level > MAX_LEVEL {
            return refuse("refineLevel", self.refine_level, "0 to 8");
        }
        self.check_guiding()?;
        self.check_tokens()
    }

    fn check_guiding(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.classical_fraction) {
            return refuse("classicalFraction", self.classical_fraction, "a share from 0 to 1");
        }
        if self.normals > MAX_NORMALS {
            return refuse("normals", self.normals, "0 to 7");
        }
        if self.cache_resolution > FINEST_CACHE {
            return refuse("cacheResolution", self.cache_resolution, "0 for automatic, at most 1024");
        }
        if self.walk == "ii" && self.walk_pdf == "exact" {
            let wanted = "conditional or auto: the normals of ii are continuous and have no closed marginal";
            return refuse("walkPdf", "\"exact\"", wanted);
        }
        Ok(())
    }

    /// USD lets the window reach beyond the image (overscan), but not by any amount of memory.
    fn check_data_window(&self) -> Result<()> {
        let window @ [x0, y0, x1, y1] = self.data_window_ndc;
        let [width, height] = self.resolution.map(|side| side as f32);
        let fits = |size: f32| size > 0.0 && size <= LARGEST_RESOLUTION as f32;
        let near = window.iter().all(|edge| edge.abs() <= LARGEST_RESOLUTION as f32);
        if !(near && fits((x1 - x0) * width) && fits((y1 - y0) * height)) {
            return refuse("dataWindowNDC", format!("{window:?}"), "x0 y0 x1 y1 with x0 < x1 and y0 < y1");
        }
        Ok(())
    }

    fn check_tokens(&self) -> Result<()> {
        check_token("aspectRatioConformPolicy", &self.aspect_ratio_conform_policy, &POLICIES)?;
        check_token("walk", &self.walk, &WALKS)?;
        check_token("walkPdf", &self.walk_pdf, &["auto", "conditional", "exact"])?;
        check_token("firstDistance", &self.first_distance, &["dwivedi", "classical"])?;
        check_token("exitLights", &self.exit_lights, &["auto", "one", "all", "learned"])?;
        check_token("refractedLight", &self.refracted_light, &["auto", "on", "off"])?;
        check_token("sharedPaths", &self.shared_paths, &["auto", "on", "off"])?;
        check_token("pixelFilterMode", &self.pixel_filter_mode, &["importance", "weighted"])?;
        check_token("cacheFill", &self.cache_fill, &["surface", "camera"])?;
        check_token("subsurfaceBoundary", &self.subsurface_boundary, &BOUNDARIES)?;
        let known = [&AOVS[..], &EXTRA_AOVS[..], &GUIDE_AOVS[..]].concat();
        let named = |aov: &str| {
            let prefixed = |prefix| aov.strip_prefix(prefix).is_some_and(|name: &str| !name.is_empty());
            prefixed(PRIMVAR_AOV) || prefixed(LIGHT_AOV) || parts_of(aov).is_some()
        };
        self.aovs.iter().filter(|aov| !named(aov)).try_for_each(|aov| check_token("aovs", aov, &known))
    }
}

fn check_token(name: &str, value: &str, allowed: &[&str]) -> Result<()> {
    if allowed.contains(&value) { Ok(()) } else { refuse(name, format!("{value:?}"), &allowed.join(", ")) }
}

fn refuse(name: &str, value: impl std::fmt::Display, wanted: &str) -> Result<()> {
    Err(Error::Prim { prim: "render settings".into(), message: format!("{name} is {value}; give {wanted}") })
}
