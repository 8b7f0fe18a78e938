//! Multi-layer OpenEXR: scene-linear float32, one part, every AOV a group of channels.
//!
//! Channel names are those of production: the beauty is `R`, `G`, `B`, `A`, an AOV is `layer.channel`
//! (`depth.Z`, `normal.X`, `albedo.R`, `primId.id`). One part with all channels in it is what every
//! viewer and library reads; channels are sorted by name, as the format demands.

use crate::{
    error::{Error, Result},
    replace::replace_file,
};
use exr::{
    image::Blocks,
    meta::{
        attribute::{AttributeValue, Chromaticities, IntegerBounds, LineOrder, Text},
        header::{ImageAttributes, LayerAttributes},
    },
    prelude::{AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Vec2, WritableImage, f16},
};
use std::{collections::BTreeSet, io, path::Path};

/// Rows from the top, `width * height` values.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    F32(Vec<f32>),
    F16(Vec<f16>),
    /// Ids: no float holds all of them.
    U32(Vec<u32>),
}

impl Samples {
    fn len(&self) -> usize {
        match self {
            Samples::F32(values) => values.len(),
            Samples::F16(values) => values.len(),
            Samples::U32(values) => values.len(),
        }
    }
}

/// The channels of one AOV; `name` is empty for the beauty.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer<'a> {
    pub name: String,
    pub channels: Vec<(&'a str, Samples)>,
}

/// Where the pixels lie, in pixels, y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Size of the display window, whose origin is 0, 0.
    pub resolution: [u32; 2],
    /// Top left pixel of the data window; may be negative (overscan).
    pub data_origin: [i32; 2],
    /// Size of the data window: that of every channel.
    pub data_size: [u32; 2],
    /// Width of a pixel over its height.
    pub pixel_aspect_ratio: f32,
}

impl Frame {
    /// A frame whose data window is its display window.
    pub fn full(resolution: [u32; 2]) -> Self {
        Self { resolution, data_origin: [0, 0], data_size: resolution, pixel_aspect_ratio: 1.0 }
    }

    fn pixels(&self) -> u64 {
        u64::from(self.data_size[0]) * u64::from(self.data_size[1])
    }
}

/// A value of metadata.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    Text(String),
    Float(f32),
    Int(i32),
    /// xy of red, green, blue, white: of the header itself, in place of Rec.709's; under no name of its own.
    Chromaticities([f32; 8]),
}

/// ITU-R BT.709-6, table 1: primaries and the D65 white, CIE xy.
const REC709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

const SOFTWARE: &str = concat!("dermis ", env!("CARGO_PKG_VERSION"));

/// Length in bytes that every reader takes for names of channels and attributes ("long names" of the format).
const LONGEST_NAME: usize = 255;

/// Writes the layers as one ZIP-compressed, scene-linear Rec.709 part; `attributes` are metadata under
/// their own names, which must not be names that OpenEXR defines: give them a prefix, `dermis/seed`.
/// The file appears under its name only when it is whole.
///
/// # Errors
/// Each names the file: an empty window, a channel whose length is not that of the data window, a name
/// given twice or not allowed, or what the file system says.
pub fn write_exr(file: &Path, frame: &Frame, layers: Vec<Layer>, attributes: &[(String, Attribute)]) -> Result<()> {
    let fault = |field: &str, message: String| Error::File {
        file: file.display().to_string(),
        field: field.to_owned(),
        message,
    };
    check_frame(frame).map_err(|message| fault("window", message))?;
    let channels = channels(frame, layers).map_err(|message| fault("channels", message))?;
    let metadata = metadata(attributes).map_err(|message| fault("attributes", message))?;
    let image = image(frame, channels, metadata, chromaticities(attributes));
    replace_file(file, |writer| image.write().to_buffered(writer).map_err(into_io))
        .map_err(|error| fault("file", error.to_string()))
}

fn check_frame(frame: &Frame) -> std::result::Result<(), String> {
    let ([width, height], [x, y]) = (frame.resolution, frame.data_size);
    if [width, height, x, y].contains(&0) {
        return Err(format!("display window {width} x {height} or data window {x} x {y} is empty"));
    }
    // The format's windows are i32 corners.
    let ends = [0, 1].map(|i| i64::from(frame.data_origin[i]) + i64::from(frame.data_size[i]));
    if ends.into_iter().chain([width.into(), height.into(), x.into(), y.into()]).any(|end| end > i32::MAX.into()) {
        return Err(format!("display window {width} x {height} or data window {x} x {y} is too large"));
    }
    // Bounds of the exr crate, which OpenEXR shares.
    if !(1e-6..=1e6).contains(&frame.pixel_aspect_ratio) {
        return Err(format!("pixelAspectRatio {} is not between 1e-6 and 1e6", frame.pixel_aspect_ratio));
    }
    Ok(())
}

fn channels(frame: &Frame, layers: Vec<Layer>) -> std::result::Result<AnyChannels<FlatSamples>, String> {
    let mut names = BTreeSet::new();
    let mut list = exr::prelude::SmallVec::new();
    for Layer { name: layer, channels } in layers {
        for (channel, samples) in channels {
            let name = if layer.is_empty() { channel.to_owned() } else { format!("{layer}.{channel}") };
            if samples.len() as u64 != frame.pixels() {
                return Err(format!("{name} has {} samples, the data window {}", samples.len(), frame.pixels()));
            }
            list.push(channel_of(checked_name(&name)?, samples));
            if !names.insert(name.clone()) {
                return Err(format!("{name} is there twice"));
            }
        }
    }
    if names.is_empty() { Err("none to write".into()) } else { Ok(AnyChannels::sort(list)) }
}

fn channel_of(name: Text, samples: Samples) -> AnyChannel<FlatSamples> {
    match samples {
        Samples::F32(values) => AnyChannel::new(name, FlatSamples::F32(values)),
        Samples::F16(values) => AnyChannel::new(name, FlatSamples::F16(values)),
        Samples::U32(values) => AnyChannel::new(name, FlatSamples::U32(values)),
    }
}

fn metadata(attributes: &[(String, Attribute)]) -> std::result::Result<Vec<(Text, AttributeValue)>, String> {
    let mut names = BTreeSet::new();
    let mut list = Vec::with_capacity(attributes.len());
    for (name, value) in attributes {
        if !names.insert(name) {
            return Err(format!("{name} is there twice"));
        }
        let Some(value) = attribute_value(value) else { continue };
        list.push((checked_name(name)?, value));
    }
    Ok(list)
}

fn attribute_value(value: &Attribute) -> Option<AttributeValue> {
    Some(match value {
        // UTF-8 as it is, which is what today's readers expect of strings.
        Attribute::Text(text) => AttributeValue::Text(Text::from_slice_unchecked(text.as_bytes())),
        Attribute::Float(value) => AttributeValue::F32(*value),
        Attribute::Int(value) => AttributeValue::I32(*value),
        Attribute::Chromaticities(_) => return None,
    })
}

/// Of the attributes, else Rec.709's.
fn chromaticities(attributes: &[(String, Attribute)]) -> Chromaticities {
    let given = attributes.iter().find_map(|(_, value)| match value {
        Attribute::Chromaticities(xy) => Some(*xy),
        _ => None,
    });
    let Some([rx, ry, gx, gy, bx, by, wx, wy]) = given else { return REC709 };
    Chromaticities { red: Vec2(rx, ry), green: Vec2(gx, gy), blue: Vec2(bx, by), white: Vec2(wx, wy) }
}

/// A name as the format stores it: terminated by a zero byte, hence none inside.
fn checked_name(name: &str) -> std::result::Result<Text, String> {
    if name.is_empty() || name.len() > LONGEST_NAME || name.contains('\0') {
        return Err(format!("{name:?} is no name: 1 to {LONGEST_NAME} bytes without zeros"));
    }
    Ok(Text::from_slice_unchecked(name.as_bytes()))
}

fn image(
    frame: &Frame,
    channels: AnyChannels<FlatSamples>,
    metadata: Vec<(Text, AttributeValue)>,
    chromaticities: Chromaticities,
) -> Image<exr::image::Layer<AnyChannels<FlatSamples>>> {
    let size = |[x, y]: [u32; 2]| Vec2(x as usize, y as usize);
    let layer_attributes = LayerAttributes {
        layer_position: Vec2(frame.data_origin[0], frame.data_origin[1]),
        software_name: Some(Text::from_slice_unchecked(SOFTWARE.as_bytes())),
        other: metadata.into_iter().collect(),
        ..LayerAttributes::default()
    };
    // Scan lines from the top: no reader has trouble with them. Lossless; ids must survive.
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let image_attributes = ImageAttributes {
        pixel_aspect: frame.pixel_aspect_ratio,
        chromaticities: Some(chromaticities),
        ..ImageAttributes::new(IntegerBounds::from_dimensions(size(frame.resolution)))
    };
    let layer = exr::image::Layer::new(size(frame.data_size), layer_attributes, encoding, channels);
    Image { attributes: image_attributes, layer_data: layer }
}

fn into_io(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{ReadChannels, ReadLayers, read};
    use std::{fs, path::PathBuf};

    fn file(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("dermis_output_{}_{name}.exr", std::process::id()))
    }

    fn ramp(count: u32, scale: f32) -> Samples {
        Samples::F32((0..count).map(|i| scale * i as f32 - 1.0).collect())
    }

    fn layers(count: u32) -> Vec<Layer<'static>> {
        let group = |name: &str, channels: &[&'static str], scale: f32| Layer {
            name: name.to_owned(),
            channels: channels.iter().map(|&channel| (channel, ramp(count, scale))).collect(),
        };
        let ids = Samples::U32((0..count).map(|i| u32::MAX - i).collect());
        vec![
            group("", &["R", "G", "B", "A"], 1e5),
            group("depth", &["Z"], 2.0),
            group("normal", &["X", "Y", "Z"], 0.25),
            Layer { name: "primId".into(), channels: vec![("id", ids)] },
        ]
    }

    type Read = Image<exr::image::Layer<AnyChannels<FlatSamples>>>;

    fn read_back(file: &Path) -> Read {
        let image =
            read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
        image.from_file(file).unwrap()
    }

    #[test]
    fn reads_back_what_was_written() {
        let file = file("round");
        let frame =
            Frame { resolution: [640, 480], data_origin: [-3, 100], data_size: [21, 33], pixel_aspect_ratio: 2.0 };
        let attributes = [
            ("dermis/stage".to_owned(), Attribute::Text("/shots/müller.usda".into())),
            ("dermis/seconds".to_owned(), Attribute::Float(1.5)),
            ("dermis/seed".to_owned(), Attribute::Int(-7)),
        ];
        write_exr(&file, &frame, layers(21 * 33), &attributes).unwrap();
        let image = read_back(&file);
        fs::remove_file(&file).unwrap();

        let layer = &image.layer_data;
        let names: Vec<_> = layer.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
        assert_eq!(names, ["A", "B", "G", "R", "depth.Z", "normal.X", "normal.Y", "normal.Z", "primId.id"]);
        for channel in &layer.channel_data.list {
            let (group, name) = channel
                .name
                .to_string()
                .split_once('.')
                .map_or((String::new(), channel.name.to_string()), |(group, name)| (group.to_owned(), name.to_owned()));
            let expected = layers(21 * 33);
            let expected = expected.iter().find(|layer| layer.name == group).unwrap();
            let (_, expected) = expected.channels.iter().find(|(channel, _)| *channel == name).unwrap();
            match (&channel.sample_data, expected) {
                (FlatSamples::F32(read), Samples::F32(written)) => assert_eq!(read, written),
                (FlatSamples::U32(read), Samples::U32(written)) => assert_eq!(read, written),
                _ => panic!("{group}.{name} has another sample type"),
            }
        }
        assert_eq!(image.attributes.display_window, IntegerBounds::from_dimensions(Vec2(640, 480)));
        assert_eq!((layer.attributes.layer_position, layer.size), (Vec2(-3, 100), Vec2(21, 33)));
        assert_eq!(image.attributes.pixel_aspect, 2.0);
        assert_eq!(image.attributes.chromaticities, Some(REC709));
        assert_eq!(layer.encoding.compression, Compression::ZIP16);
        let read = |name: &str| layer.attributes.other.get(&Text::from(name)).cloned().unwrap();
        assert_eq!(read("dermis/seconds"), AttributeValue::F32(1.5));
        assert_eq!(read("dermis/seed"), AttributeValue::I32(-7));
        let AttributeValue::Text(stage) = read("dermis/stage") else { panic!("not text") };
        assert_eq!(stage.as_slice(), "/shots/müller.usda".as_bytes());
    }

    #[test]
    fn errors_name_file_and_fault() {
        let file = file("fault");
        let frame = Frame::full([4, 4]);
        let message = |frame: &Frame, layers, attributes: &[(String, Attribute)]| {
            write_exr(&file, frame, layers, attributes).unwrap_err().to_string()
        };
        let cases = [
            (message(&frame, layers(15), &[]), "R has 15 samples, the data window 16"),
            (message(&frame, [layers(16), layers(16)].concat(), &[]), "R is there twice"),
            (message(&frame, Vec::new(), &[]), "channels: none to write"),
            (message(&Frame::full([0, 4]), Vec::new(), &[]), "is empty"),
            (message(&Frame::full([u32::MAX, 4]), Vec::new(), &[]), "is too large"),
            (message(&Frame { data_origin: [i32::MAX, 0], ..frame }, layers(16), &[]), "is too large"),
            (message(&Frame { pixel_aspect_ratio: f32::NAN, ..frame }, layers(16), &[]), "pixelAspectRatio NaN"),
            (message(&frame, layers(16), &[("dataWindow".into(), Attribute::Int(1))]), "`dataWindow` is reserved"),
            (message(&frame, layers(16), &[("a\0b".into(), Attribute::Int(1))]), "is no name"),
        ];
        for (message, part) in cases {
            assert!(message.contains(part) && message.contains("dermis_output"), "{message}");
        }
        assert!(!file.exists());
        let folder = std::env::temp_dir().join("dermis_no_such_folder/a.exr");
        let message = write_exr(&folder, &frame, layers(16), &[]).unwrap_err().to_string();
        assert!(message.contains("dermis_no_such_folder"), "{message}");
    }
}
