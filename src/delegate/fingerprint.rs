//! Digests of what an image depends on: they tell whether a checkpoint may go on, and images may be merged.

use super::RenderDelegate;
use crate::flat::{
    self, FlatScene, LightShape, Material, RenderSettings, StageInfo, Texels, Texture, array::collect_arrays,
};
use crate::saved::Digest;
use crate::scene::release;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write;

/// Settings that decide about time and memory, not about the image.
const OF_THE_RUN: [&str; 3] = ["threads", "timeLimit", "textureMemory"];

/// Settings in which parts of one image may differ.
const OF_THE_PART: [&str; 6] = ["dataWindowNDC", "samples", "sampleOffset", "seed", "noiseThreshold", "aovs"];

impl RenderDelegate {
    /// Of scene and settings: the same state of a render can come of these alone.
    pub(super) fn fingerprint_of_render(&self) -> u64 {
        self.fingerprint(&settings_without(self.settings(), &OF_THE_RUN))
    }

    /// Of what tiles and sample ranges of one image share.
    pub(super) fn fingerprint_of_image(&self) -> u64 {
        self.fingerprint(&settings_without(self.settings(), &[&OF_THE_RUN[..], &OF_THE_PART].concat()))
    }

    fn fingerprint(&self, settings: &Value) -> u64 {
        let scene = self.last.as_ref().map_or_else(|| of_scene(self.flat()), |last| last.digest);
        let mut digest = Digest::new();
        let mut take = |bytes: &[u8]| digest.write_all(bytes).expect("a digest takes everything");
        take(env!("CARGO_PKG_VERSION").as_bytes());
        take(settings.to_string().as_bytes());
        take(&scene.to_le_bytes());
        digest.finish()
    }
}

fn settings_without(settings: &RenderSettings, left_out: &[&str]) -> Value {
    let mut settings = serde_json::to_value(settings).unwrap_or_default();
    if let Value::Object(named) = &mut settings {
        left_out.iter().for_each(|name| drop(named.remove(*name)));
    }
    settings
}

/// Without its settings. Arrays are shared by the copy. Where the stage and its images lie is no part of it: farms mount
/// them elsewhere. Keys of images have their paths, so that what names one counts by what is in it.
pub(super) fn of_scene(flat: &FlatScene) -> u64 {
    let stage = StageInfo { file: String::new(), ..flat.stage.clone() };
    let (images, textures, warnings) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    let settings = RenderSettings::default();
    let mut scene = FlatScene { stage, images, textures, warnings, settings, ..flat.clone() };
    name_by_content(&mut scene, flat);
    let (text, arrays) = collect_arrays(|| serde_json::to_vec(&scene).unwrap_or_default());
    let mut digest = Digest::new();
    let mut take = |bytes: &[u8]| digest.write_all(bytes).expect("a digest takes everything");
    take(&text);
    arrays.iter().for_each(|array| take(array.bytes()));
    digest.finish()
}

/// Digests of images in place of their keys; what names none that is there names nothing.
fn name_by_content(scene: &mut FlatScene, flat: &FlatScene) {
    // One by one, since they may be more than fits into memory.
    let images: BTreeMap<_, _> = flat.images.iter().map(|(key, image)| (key, of_image(image))).collect();
    for network in scene.materials.values_mut().flat_map(Material::networks_mut) {
        for key in network.images_mut() {
            *key = images.get(key).cloned().unwrap_or_default();
        }
    }
    let textures: BTreeMap<_, _> = flat.textures.iter().map(|(key, texture)| (key, of_texture(texture))).collect();
    for light in scene.lights.values_mut() {
        if let LightShape::Rect { texture: key, .. } | LightShape::Dome { texture: key, .. } = &mut light.shape {
            *key = textures.get(key).cloned().unwrap_or_default();
        }
    }
}

fn of_image(image: &flat::Image) -> String {
    let flat::Image { file: _, width, height, channels, srgb, texels, fault: _ } = image;
    let format = match texels {
        Texels::U8(_) => "u8",
        Texels::U16(_) => "u16",
        Texels::Half(_) => "half",
        Texels::Float(_) => "float",
    };
    let found = of_pixels(&format!("{width} {height} {channels} {srgb} {format}"), texels.bytes());
    if let Some((map, offset, len)) = texels.map() {
        release(map, offset, len);
    }
    found
}

fn of_texture(texture: &Texture) -> String {
    let Texture { file: _, width, height, pixels } = texture;
    of_pixels(&format!("{width} {height}"), bytemuck::cast_slice(pixels))
}

fn of_pixels(shape: &str, bytes: &[u8]) -> String {
    let mut digest = Digest::new();
    let mut take = |bytes: &[u8]| digest.write_all(bytes).expect("a digest takes everything");
    take(shape.as_bytes());
    take(bytes);
    format!("{shape} {:016x}", digest.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::sample;

    /// The sample scene with its images at other places, by what their keys and files begin with.
    fn moved(to: &str) -> FlatScene {
        let mut scene = sample::scene();
        for network in scene.materials.values_mut().flat_map(Material::networks_mut) {
            network.images_mut().for_each(|key| key.insert_str(0, to));
        }
        let images = std::mem::take(&mut scene.images);
        let elsewhere = |file: &str| format!("{to}{file}");
        scene.images = images
            .into_iter()
            .map(|(key, image)| (elsewhere(&key), flat::Image { file: elsewhere(&image.file), ..image }))
            .collect();
        let textures = std::mem::take(&mut scene.textures);
        scene.textures = textures
            .into_iter()
            .map(|(key, texture)| (elsewhere(&key), Texture { file: elsewhere(&texture.file), ..texture }))
            .collect();
        for light in scene.lights.values_mut() {
            if let LightShape::Rect { texture, .. } | LightShape::Dome { texture, .. } = &mut light.shape {
                texture.insert_str(0, to);
            }
        }
        scene
    }

    #[test]
    fn where_images_lie_is_no_part_of_it() {
        assert!(!sample::scene().images.is_empty() && !sample::scene().textures.is_empty());
        assert_eq!(of_scene(&moved("/mnt/a")), of_scene(&moved("/z/b")));
        assert_eq!(of_scene(&moved("")), of_scene(&moved("/z/b")));
    }

    #[test]
    fn what_is_in_them_is() {
        let changed = |change: fn(&mut FlatScene)| {
            let mut scene = sample::scene();
            change(&mut scene);
            of_scene(&scene)
        };
        let edits: [fn(&mut FlatScene); 6] = [
            |_| (),
            |scene| scene.images.values_mut().for_each(|image| image.srgb = !image.srgb),
            |scene| scene.images.values_mut().for_each(other_texel),
            |scene| scene.images.clear(),
            |scene| scene.textures.values_mut().for_each(|texture| brighten(&mut texture.pixels)),
            |scene| scene.textures.clear(),
        ];
        let found: std::collections::BTreeSet<u64> = edits.into_iter().map(changed).collect();
        assert_eq!(found.len(), 6);
    }

    fn other_texel(image: &mut flat::Image) {
        let mut bytes = image.texels.bytes().to_vec();
        bytes[0] ^= 1;
        image.texels = Texels::U8(bytes.into());
    }

    fn brighten(pixels: &mut flat::array::Array<[f32; 3]>) {
        *pixels = pixels.iter().map(|pixel| pixel.map(|value| value + 0.25)).collect::<Vec<_>>().into();
    }
}
