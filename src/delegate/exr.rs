//! The image as one EXR file: layers of AOVs, the main statistics in its header.

use super::RenderDelegate;
use crate::error::{Error, Result};
use crate::film::Plane;
use crate::output::{Attribute, Frame, Layer, Samples, write_exr};
use serde_json::{Map, Value};
use std::path::Path;

impl RenderDelegate {
    /// Writes every AOV as one EXR, with the statistics in the header beside `attributes`.
    pub fn write_exr(&self, file: &Path, attributes: Map<String, Value>) -> Result<()> {
        let (Some(scene), Some(pass)) = (&self.scene, &self.pass) else {
            return Err(Error::Other("nothing was rendered yet".into()));
        };
        let window = scene.camera.data_window;
        let frame = Frame {
            resolution: scene.camera.size,
            data_origin: [window.x0 as i32, window.y0 as i32],
            data_size: [window.width(), window.height()],
            pixel_aspect_ratio: self.flat.settings.pixel_aspect_ratio,
        };
        let planes = pass.film.resolve();
        // Alpha is the beauty's fourth channel already.
        let layers = planes.into_iter().filter(|plane| plane.name != "alpha").map(layer).collect();
        write_exr(file, &frame, layers, &self.header(attributes))
    }

    fn header(&self, attributes: Map<String, Value>) -> Vec<(String, Attribute)> {
        let text = |value: Value| match value {
            Value::String(text) => text,
            other => other.to_string(),
        };
        let given = attributes.into_iter().map(|(name, value)| (name, Attribute::Text(text(value))));
        let stats = self.stats();
        let number = |pointer: &str| stats.pointer(pointer).and_then(Value::as_f64).unwrap_or(0.0) as f32;
        let measured = [
            ("dermis:samplesPerPixel", "/samples_per_pixel"),
            ("dermis:secondsRender", "/seconds/render"),
            ("dermis:walks", "/walks"),
            ("dermis:walkSteps", "/walk_steps"),
            ("dermis:walksLeaked", "/walks_leaked"),
            ("dermis:nonFiniteSamples", "/non_finite_samples"),
        ];
        let seed = ("dermis:seed".to_owned(), Attribute::Int(self.flat.settings.seed as i32));
        let measured = measured.iter().map(|(name, at)| ((*name).to_owned(), Attribute::Float(number(at))));
        given.chain(measured).chain([seed]).collect()
    }
}

/// A plane as EXR channels: names as compositors expect them, ids as integers.
fn layer(plane: Plane) -> Layer<'static> {
    let names: &[&str] = match plane.name {
        "color" => &["R", "G", "B", "A"],
        "depth" => &["Z"],
        "primId" | "region" => &["id"],
        "normal" | "position" | "slabNormal" => &["X", "Y", "Z"],
        // OpenEXR's name of a lone channel.
        _ if plane.channels == 1 => &["Y"],
        _ => &["R", "G", "B"],
    };
    let channel = |c: usize| plane.values.iter().skip(c).step_by(plane.channels);
    let samples = |c: usize| match plane.name {
        // -1 (nothing hit, no region) becomes the largest id.
        "primId" | "region" => Samples::U32(channel(c).map(|&id| id as i32 as u32).collect()),
        _ => Samples::F32(channel(c).copied().collect()),
    };
    let name = if plane.name == "color" { "" } else { plane.name };
    Layer { name, channels: names.iter().enumerate().map(|(c, n)| (*n, samples(c))).collect() }
}
