//! Lights, their textures and the camera: numbers that cannot make an image black or NaN by accident.

use super::motion::check_keys;
use super::report::{ANY, LARGEST, NOT_NEGATIVE, Report, UNIT, placement_fault};
use crate::{
    error::Warning,
    flat::{Camera, IDENTITY, Ies, Light, LightShape, Portal, Shadow, Shaping, Texture},
};

/// UsdLux gives light to a negative intensity, too; a path tracer has none to take away, so it counts as 0.
/// A light that cannot be placed, has no area or is brighter than a float holds, is switched off.
pub fn validate_light(path: &str, light: &mut Light, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    let default = Light::default();
    if let Some(fault) = placement_fault(&light.transform) {
        report.warn(format!("xformOpOrder: the transform {fault}, the light is off; author a scale above 0"));
        light.transform = IDENTITY;
        light.visible = false;
    }
    check_keys(&mut light.transform_keys, 1, "the light", &mut report);
    report.clamp("inputs:intensity", &mut light.intensity, NOT_NEGATIVE, default.intensity);
    // 2^100 is as bright as LARGEST.
    report.clamp("inputs:exposure", &mut light.exposure, -100.0..=100.0, default.exposure);
    report.clamp("inputs:color", &mut light.color, NOT_NEGATIVE, default.color);
    report.positive("inputs:colorTemperature", &mut light.color_temperature, default.color_temperature);
    report.clamp("inputs:colorTemperature (as colour)", &mut light.blackbody, NOT_NEGATIVE, default.blackbody);
    report.clamp("inputs:diffuse", &mut light.diffuse, NOT_NEGATIVE, default.diffuse);
    report.clamp("inputs:specular", &mut light.specular, NOT_NEGATIVE, default.specular);
    if let Some(shaping) = &mut light.shaping {
        check_shaping(shaping, &mut report);
    }
    if let Some(shadow) = &mut light.shadow {
        check_shadow(shadow, &mut report);
    }
    light.portals.retain(|portal| is_portal(portal, &mut report));
    check_shape(light, &mut report);
    check_power(light, &mut report);
}

fn check_shaping(shaping: &mut Shaping, report: &mut Report) {
    let default = Shaping::default();
    report.clamp("inputs:shaping:focus", &mut shaping.focus, NOT_NEGATIVE, default.focus);
    report.clamp("inputs:shaping:focusTint", &mut shaping.focus_tint, NOT_NEGATIVE, default.focus_tint);
    report.clamp("inputs:shaping:cone:angle", &mut shaping.cone_angle, 0.0..=180.0, default.cone_angle);
    report.clamp("inputs:shaping:cone:softness", &mut shaping.cone_softness, UNIT, default.cone_softness);
    if let Some(ies) = &mut shaping.ies {
        report.clamp("inputs:shaping:ies:angleScale", &mut ies.angle_scale, ANY, 0.0);
        if !is_profile(ies) {
            report.warn("inputs:shaping:ies:file: its angles or candela are damaged, the light shines without it");
            shaping.ies = None;
        }
    }
}

fn is_profile(ies: &Ies) -> bool {
    let ascends = |angles: &[f32], top: f32| {
        angles.first().is_some_and(|&first| first >= 0.0)
            && angles.windows(2).all(|pair| pair[0] < pair[1])
            && angles.last().is_some_and(|&last| last <= top)
    };
    ascends(&ies.vertical, 180.0)
        && ascends(&ies.horizontal, 360.0)
        && ies.candela.len() == ies.vertical.len() * ies.horizontal.len()
        && ies.candela.iter().all(|c| (0.0..=LARGEST).contains(c))
}

fn is_portal(portal: &Portal, report: &mut Report) -> bool {
    let sizes = [("inputs:width", portal.width), ("inputs:height", portal.height)];
    let size = sizes.into_iter().find(|(_, size)| !(*size > 0.0 && *size <= LARGEST));
    let fault = placement_fault(&portal.transform).map(|fault| format!("xformOpOrder: the transform {fault}"));
    let fault = fault.or(size.map(|(name, size)| format!("{name} is {size}")));
    if let Some(fault) = &fault {
        report.warn_at(&portal.path, format!("{fault}, the portal guides nothing; author sizes and scales above 0"));
    }
    fault.is_none()
}

fn check_shadow(shadow: &mut Shadow, report: &mut Report) {
    let default = Shadow::default();
    report.clamp("inputs:shadow:color", &mut shadow.color, NOT_NEGATIVE, default.color);
    report.clamp("inputs:shadow:distance", &mut shadow.distance, ANY, default.distance);
    report.clamp("inputs:shadow:falloff", &mut shadow.falloff, ANY, default.falloff);
    report.positive("inputs:shadow:falloffGamma", &mut shadow.falloff_gamma, default.falloff_gamma);
}

/// Defaults in place of NaN are those of UsdLux.
fn check_shape(light: &mut Light, report: &mut Report) {
    let mut size = |name: &str, value: &mut f32, default: f32| {
        let authored = *value;
        // Below 0 there is as little area as at 0; one warning says both.
        *value = if authored < 0.0 { 0.0 } else { authored };
        report.clamp(name, value, NOT_NEGATIVE, default);
        if *value > 0.0 { None } else { Some(format!("{name} is {authored}")) }
    };
    let empty = match &mut light.shape {
        LightShape::Rect { width, height, .. } => {
            size("inputs:width", width, 1.0).or(size("inputs:height", height, 1.0))
        }
        LightShape::Disk { radius } | LightShape::Sphere { radius } => size("inputs:radius", radius, 0.5),
        LightShape::Cylinder { length, radius } => {
            size("inputs:length", length, 1.0).or(size("inputs:radius", radius, 0.5))
        }
        LightShape::Distant { angle } => {
            report.clamp("inputs:angle", angle, 0.0..=360.0, 0.53);
            None
        }
        LightShape::Dome { pole_axis, .. } => {
            report.token("poleAxis", pole_axis, &["Y", "Z"], "Y");
            None
        }
        LightShape::Mesh { .. } => None,
    };
    if let (Some(name), true) = (empty, light.visible) {
        report.warn(format!("{name}, so there is no area to emit: the light is off; author a size above 0"));
        light.visible = false;
    }
}

/// The product of numbers that are each in range.
fn check_power(light: &mut Light, report: &mut Report) {
    let color = light.color.into_iter().zip(light.blackbody).map(|(color, white)| color.max(1.0) * white.max(1.0));
    let power = light.intensity * light.exposure.exp2() * color.fold(1.0, f32::max);
    if light.visible && power > LARGEST {
        report.warn("inputs:intensity, inputs:exposure and inputs:color multiply beyond 1e30: the light is off");
        light.visible = false;
    }
}

/// What a camera cannot have is replaced by the default of `UsdGeomCamera`.
pub fn validate_camera(path: &str, camera: &mut Camera, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    let default = Camera::default();
    if let Some(fault) = placement_fault(&camera.transform) {
        report.warn(format!("xformOpOrder: the transform {fault}, the camera stands at the origin; mend its xformOps"));
        camera.transform = IDENTITY;
    }
    check_keys(&mut camera.transform_keys, 1, "the camera", &mut report);
    let [open, close] = camera.shutter;
    if !(open.is_finite() && close.is_finite() && open <= close) {
        report.warn(format!("shutter:open is {open:?}, shutter:close {close:?}: not a span of time; nothing moves"));
        camera.shutter = [0.0; 2];
    }
    report.positive("horizontalAperture", &mut camera.horizontal_aperture, default.horizontal_aperture);
    report.positive("verticalAperture", &mut camera.vertical_aperture, default.vertical_aperture);
    report.clamp("horizontalApertureOffset", &mut camera.horizontal_aperture_offset, ANY, 0.0);
    report.clamp("verticalApertureOffset", &mut camera.vertical_aperture_offset, ANY, 0.0);
    report.positive("focalLength", &mut camera.focal_length, default.focal_length);
    report.clamp("fStop", &mut camera.f_stop, NOT_NEGATIVE, default.f_stop);
    report.clamp("focusDistance", &mut camera.focus_distance, NOT_NEGATIVE, default.focus_distance);
    report.clamp("exposure (as scale)", &mut camera.exposure_scale, NOT_NEGATIVE, default.exposure_scale);
    let [near, far] = camera.clipping_range;
    if !(near >= 0.0 && near < far && far <= f32::MAX) {
        let used = default.clipping_range;
        report.warn(format!("clippingRange is [{near:?}, {far:?}], {used:?} is used; author 0 <= near < far"));
        camera.clipping_range = used;
    }
}

/// Largest half float: what an infinite pixel was before some writer stored it as a half.
const BRIGHTEST: f32 = 65504.0;

/// A texture whose size is not that of its pixels is emptied; NaN and negative radiance become 0, infinite
/// radiance the largest half.
pub fn validate_texture(path: &str, texture: &mut Texture, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    let (width, height, pixels) = (texture.width, texture.height, texture.pixels.len());
    if u64::from(width) * u64::from(height) != pixels as u64 {
        let file = &texture.file;
        report.warn(format!("{file}: {width} x {height} with {pixels} pixels is not used; write the image again"));
        *texture = Texture { file: std::mem::take(&mut texture.file), ..Texture::default() };
        return;
    }
    let bad = texture.pixels.as_flattened().iter().filter(|value| !NOT_NEGATIVE.contains(value)).count();
    if bad == 0 {
        return;
    }
    let mended = texture.pixels.iter().map(|pixel| pixel.map(mended_radiance));
    texture.pixels = mended.collect::<Vec<_>>().into();
    let file = &texture.file;
    report
        .warn(format!("{file}: {bad} values are NaN, negative or infinite; 0 or {BRIGHTEST} is used; mend the image"));
}

fn mended_radiance(value: f32) -> f32 {
    if value > LARGEST { BRIGHTEST } else { value.max(0.0) }
}
