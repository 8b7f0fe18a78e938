//! Digests of what an image depends on: they tell whether a checkpoint may go on, and images may be merged.

use super::RenderDelegate;
use crate::flat::{self, FlatScene, RenderSettings, StageInfo, array::collect_arrays};
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

/// Without its settings. Arrays are shared by the copy. Where the stage lies is no part of it: farms mount it elsewhere.
pub(super) fn of_scene(flat: &FlatScene) -> u64 {
    let stage = StageInfo { file: String::new(), ..flat.stage.clone() };
    let images = BTreeMap::new();
    let scene = FlatScene { stage, images, warnings: Vec::new(), settings: RenderSettings::default(), ..flat.clone() };
    let (text, arrays) = collect_arrays(|| serde_json::to_vec(&scene).unwrap_or_default());
    let mut digest = Digest::new();
    let mut take = |bytes: &[u8]| digest.write_all(bytes).expect("a digest takes everything");
    take(&text);
    arrays.iter().for_each(|array| take(array.bytes()));
    // One by one, since they may be more than fits into memory.
    for (key, image) in &flat.images {
        let flat::Image { file: _, width, height, channels, srgb, texels, fault: _ } = image;
        take(format!("{key} {width} {height} {channels} {srgb} {}", texels.size()).as_bytes());
        take(texels.bytes());
        if let Some((map, offset, len)) = texels.map() {
            release(map, offset, len);
        }
    }
    digest.finish()
}
