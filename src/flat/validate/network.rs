//! Networks and the images they read: nodes name nodes before them, texels fit their image.

use super::report::Report;
use crate::error::Warning;
use crate::flat::{Image, Network, Node, Texels};

/// An image whose size is not that of its texels is emptied; values that are not finite become 0.
pub fn validate_image(path: &str, image: &mut Image, warnings: &mut Vec<Warning>) {
    let mut report = Report::new(path, warnings);
    if !image.fault.is_empty() {
        report.warn(format!("{}: {}; the fallback is used", image.file, image.fault));
        *image = Image { file: std::mem::take(&mut image.file), ..Image::default() };
        return;
    }
    let wanted = u64::from(image.width) * u64::from(image.height) * u64::from(image.channels);
    let (found, file) = (image.texels.len() as u64, &image.file);
    if wanted != found || !(1..=4).contains(&image.channels) {
        let size = format!("{} x {} with {} channels", image.width, image.height, image.channels);
        report.warn(format!("{file}: {size} has {found} values, it is not used; write the image again"));
        *image = Image { file: std::mem::take(&mut image.file), ..Image::default() };
        return;
    }
    let bad = match &mut image.texels {
        Texels::Float(values) => {
            let bad = values.iter().filter(|value| !value.is_finite()).count();
            if bad > 0 {
                let mended = values.iter().map(|value| if value.is_finite() { *value } else { 0.0 });
                *values = mended.collect::<Vec<_>>().into();
            }
            bad
        }
        Texels::Half(values) => {
            // All exponent bits set: infinite or NaN.
            let is_bad = |bits: &u16| bits & 0x7c00 == 0x7c00;
            let bad = values.iter().filter(|bits| is_bad(bits)).count();
            if bad > 0 {
                let mended = values.iter().map(|bits| if is_bad(bits) { 0 } else { *bits });
                *values = mended.collect::<Vec<_>>().into();
            }
            bad
        }
        Texels::U8(_) | Texels::U16(_) => 0,
    };
    if bad > 0 {
        report.warn(format!("{}: {bad} values are not finite, 0 is used; mend the image", image.file));
    }
}

/// A network that names what is not there is dropped: its inputs have their constants.
pub(super) fn check_network(network: &mut Network, report: &mut Report) {
    let sound = network.nodes.iter().enumerate().all(|(i, node)| is_sound(node, i));
    if sound && network.inputs.values().all(|&node| node < network.nodes.len()) {
        return;
    }
    report.warn("its network has nodes that read what is not before them; nothing drives its inputs");
    *network = Network::default();
}

fn is_sound(node: &Node, at: usize) -> bool {
    match node {
        Node::Constant { value } | Node::Primvar { fallback: value, .. } => value.iter().all(|x| x.is_finite()),
        Node::Image(image) => {
            let finite = |value: [f32; 4]| value.iter().all(|x| x.is_finite());
            image.st < at && finite(image.border) && finite(image.fallback)
        }
        Node::Math { op, args } => args.len() == op.arity() && args.iter().all(|&arg| arg < at),
        Node::Gather { args, lanes } => args.iter().all(|&arg| arg < at) && lanes.iter().all(|&lane| lane < 4),
    }
}
