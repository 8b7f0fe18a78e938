//! The image as one EXR file: layers of AOVs, the main statistics in its header.

use super::RenderDelegate;
use crate::error::{Error, Result};
use crate::film::{Plane, cryptomatte};
use crate::flat::PRIMVAR_AOV;
use crate::output::{Attribute, Frame, Layer, Samples, write_exr};
use exr::prelude::f16;
use serde::Deserialize;
use serde_json::{Map, Value};
use std::path::Path;

/// A layer of the file: which AOV, under which name.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct LayerSpec {
    /// Empty: the beauty's place, channels without a prefix.
    pub name: String,
    pub aov: String,
    /// Half floats; ids and Cryptomatte stay what they are.
    #[serde(default)]
    pub half: bool,
    /// Letters of the channels of a primvar, at most three; empty: `RGB`.
    #[serde(default)]
    pub channels: String,
}

impl RenderDelegate {
    /// Writes AOVs as one EXR, with the statistics in the header beside `attributes`; without `layers` all of them
    /// under their own names.
    pub fn write_exr(&self, file: &Path, attributes: Map<String, Value>, layers: Option<&[LayerSpec]>) -> Result<()> {
        let (Some(scene), Some(pass)) = (&self.scene, &self.pass) else {
            return Err(Error::Other("nothing was rendered yet".into()));
        };
        let window = scene.camera.data_window;
        let frame = Frame {
            resolution: scene.camera.size,
            data_origin: [window.x0, window.y0],
            data_size: [window.width(), window.height()],
            pixel_aspect_ratio: scene.camera.pixel_aspect_ratio,
        };
        let planes = pass.film.resolve();
        let mut header = self.header(attributes);
        let wanted: Vec<Layer> = match layers {
            // Alpha is the beauty's fourth channel already.
            // Each plane goes when its layer is there: together they are the most memory of a render.
            None => planes.into_iter().filter(|plane| plane.name != "alpha").map(|plane| layer(&plane, None)).collect(),
            Some(layers) => layers.iter().flat_map(|spec| named(spec, &planes)).collect(),
        };
        self.say_who(&wanted, &mut header);
        let aovs: Map<String, Value> = match layers {
            None => wanted.iter().map(|layer| (layer.name.clone(), Value::from(layer.name.clone()))).collect(),
            Some(layers) => layers.iter().map(|spec| (spec.name.clone(), Value::from(spec.aov.clone()))).collect(),
        };
        header.push(("dermis:layers".into(), Attribute::Text(Value::Object(aovs).to_string())));
        write_exr(file, &frame, wanted, &header)
    }

    /// Names of the prims behind ids.
    fn say_who(&self, layers: &[Layer], header: &mut Vec<(String, Attribute)>) {
        let names = || self.flat.meshes.keys().map(String::as_str);
        if layers
            .iter()
            .any(|layer| layer.channels.iter().any(|(channel, _)| *channel == "id") && layer.name != "region")
        {
            let names = Value::from(names().collect::<Vec<_>>()).to_string();
            header.push(("dermis:primIds".into(), Attribute::Text(names)));
        }
        if layers.iter().any(|layer| layer.name.starts_with("cryptoObject")) {
            let metadata = cryptomatte::metadata(names());
            header.extend(metadata.into_iter().map(|(name, value)| (name, Attribute::Text(value))));
        }
    }

    fn header(&self, attributes: Map<String, Value>) -> Vec<(String, Attribute)> {
        let text = |value: Value| match value {
            Value::String(text) => text,
            other => other.to_string(),
        };
        let given = attributes.into_iter().map(|(name, value)| match xy(&name, &value) {
            Some(xy) => (name, Attribute::Chromaticities(xy)),
            None => (name, Attribute::Text(text(value))),
        });
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
        let measured = measured.iter().map(|(name, at)| ((*name).to_owned(), Attribute::Float(number(at))));
        given.chain(measured).chain(self.parts()).collect()
    }

    /// Which part of which image this is, for `dermis merge`.
    fn parts(&self) -> Vec<(String, Attribute)> {
        let settings = &self.flat.settings;
        let uniform = self.pass.as_ref().and_then(|pass| pass.film.uniform_samples());
        let int = |name: &str, value: u32| (format!("dermis:{name}"), Attribute::Int(value as i32));
        let fingerprint = format!("{:016x}", self.fingerprint_of_image());
        let mut parts = vec![
            ("dermis:fingerprint".to_owned(), Attribute::Text(fingerprint)),
            int("seed", settings.seed),
            int("sampleOffset", settings.sample_offset),
        ];
        // Where pixels have different numbers of them, the AOV `sampleCount` tells.
        parts.extend(uniform.map(|samples| int("samples", samples)));
        parts
    }
}

/// The value of `chromaticities`: eight numbers.
pub fn xy(name: &str, value: &Value) -> Option<[f32; 8]> {
    let numbers = value.as_array().filter(|_| name == "chromaticities")?;
    let numbers: Vec<f32> = numbers.iter().filter_map(|x| Some(x.as_f64()? as f32)).collect();
    numbers.try_into().ok()
}

/// The planes of a layer; Cryptomatte keeps its names, by which readers know it.
fn named(spec: &LayerSpec, planes: &[Plane]) -> Vec<Layer<'static>> {
    if spec.aov == "cryptoObject" {
        return planes.iter().filter(|plane| plane.name.starts_with("cryptoObject")).map(|p| layer(p, None)).collect();
    }
    planes.iter().filter(|plane| plane.name == spec.aov).map(|plane| layer(plane, Some(spec))).collect()
}

/// A plane as EXR channels: names as compositors expect them, ids as integers.
fn layer(plane: &Plane, spec: Option<&LayerSpec>) -> Layer<'static> {
    let letters = spec.map_or("", |spec| spec.channels.as_str());
    let names: &[&'static str] = match &*plane.name {
        name if name.starts_with(PRIMVAR_AOV) => match letters {
            "Y" => &["Y"],
            "XY" => &["X", "Y"],
            "XYZ" => &["X", "Y", "Z"],
            _ => &["R", "G", "B"],
        },
        "color" => &["R", "G", "B", "A"],
        "depth" | "distance" | "deviceDepth" => &["Z"],
        "primId" | "region" => &["id"],
        "sampleCount" => &["count"],
        "motionVector" => &["X", "Y"],
        "normal" | "position" | "slabNormal" | "Peye" | "Neye" => &["X", "Y", "Z"],
        name if name.starts_with("cryptoObject") => &["R", "G", "B", "A"],
        // OpenEXR's name of a lone channel.
        _ if plane.channels == 1 => &["Y"],
        _ => &["R", "G", "B"],
    };
    let channel = |c: usize| plane.values.iter().skip(c).step_by(plane.channels);
    let half = spec.is_some_and(|spec| spec.half) && !plane.name.starts_with("cryptoObject");
    let samples = |c: usize| match &*plane.name {
        // -1 (nothing hit, no region) becomes the largest id.
        "primId" | "region" => Samples::U32(channel(c).map(|&id| id as i32 as u32).collect()),
        "sampleCount" => Samples::U32(channel(c).map(|&count| count as u32).collect()),
        _ if half => Samples::F16(channel(c).map(|&value| f16::from_f32(value)).collect()),
        _ => Samples::F32(channel(c).copied().collect()),
    };
    let own = if plane.name == "color" { "" } else { &*plane.name };
    let name = spec.map_or(own.to_owned(), |spec| spec.name.clone());
    Layer { name, channels: names.iter().enumerate().map(|(c, n)| (*n, samples(c))).collect() }
}
