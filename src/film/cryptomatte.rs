//! Cryptomatte: which objects cover a pixel, and how much (Friedman and Jones 2015; specification 1.2.0).
//!
//! Ids are hashes of prim paths, read as floats; ranks of (id, coverage) are packed two by two into layers
//! `cryptoObject00`, `01`, `02`. The filter is sampled, so that coverage is the share of a pixel's samples.

use super::{Film, Plane};
use bytemuck::{Pod, Zeroable};
use serde_json::{Map, Value};

/// Name of the layer.
const NAME: &str = "cryptoObject";

const LAYERS: [&str; 3] = ["cryptoObject00", "cryptoObject01", "cryptoObject02"];

/// Objects that are kept per pixel, two more than there are ranks; of further ones the coverage is lost.
const KEPT: usize = 8;

/// Samples per object of one pixel.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct ObjectSums {
    prims: [i32; KEPT],
    samples: [u32; KEPT],
}

impl ObjectSums {
    pub const NONE: Self = Self { prims: [-1; KEPT], samples: [0; KEPT] };

    pub fn add(&mut self, prim: i32) {
        if prim < 0 {
            return;
        }
        let slot = (0..KEPT).find(|&k| self.samples[k] == 0 || self.prims[k] == prim);
        if let Some(k) = slot {
            self.prims[k] = prim;
            self.samples[k] += 1;
        }
    }

    /// (id, samples), most first; equal ones in the order of ids, as `dermis merge` ranks them.
    fn ranks(&self, id: impl Fn(i32) -> f32) -> Vec<(f32, u32)> {
        let seen = self.prims.into_iter().zip(self.samples).filter(|(_, n)| *n > 0);
        let mut ranks: Vec<_> = seen.map(|(prim, n)| (id(prim), n)).collect();
        ranks.sort_by_key(|&(id, n)| (std::cmp::Reverse(n), id.to_bits()));
        ranks
    }
}

impl Film {
    /// Layers of two ranks each: id, coverage, id, coverage.
    pub(super) fn object_planes(&self) -> Vec<Plane> {
        let id = |prim: i32| self.object_ids.get(prim as usize).copied().unwrap_or(0.0);
        let layer = |(l, name): (usize, &&'static str)| {
            self.plane(*name, 4, |tile, i| {
                let ranks = tile.objects[i].ranks(id);
                let share = |n: u32| n as f32 / tile.samples[i].max(1) as f32;
                let rank = |k: usize| ranks.get(k).map_or([0.0; 2], |&(id, n)| [id, share(n)]);
                let [a, b] = [rank(2 * l), rank(2 * l + 1)];
                [a[0], a[1], b[0], b[1]]
            })
        };
        LAYERS.iter().enumerate().map(layer).collect()
    }
}

/// Header attributes of an image with Cryptomatte layers: who the ids are.
pub fn metadata<'a>(objects: impl Iterator<Item = &'a str>) -> Vec<(String, String)> {
    let manifest: Map<String, Value> =
        objects.map(|name| (name.to_owned(), format!("{:08x}", id(name).to_bits()).into())).collect();
    let key = format!("cryptomatte/{:.7}", format!("{:08x}", murmur3(NAME.as_bytes())));
    [
        ("name", NAME.to_owned()),
        ("hash", "MurmurHash3_32".to_owned()),
        ("conversion", "uint32_to_float32".to_owned()),
        ("manifest", Value::Object(manifest).to_string()),
    ]
    .map(|(name, value)| (format!("{key}/{name}"), value))
    .to_vec()
}

/// Id of an object: its hash as a float, kept from being zero, subnormal, infinite or not a number.
pub fn id(name: &str) -> f32 {
    let hash = murmur3(name.as_bytes());
    let exponent = hash >> 23 & 255;
    f32::from_bits(if exponent == 0 || exponent == 255 { hash ^ 1 << 23 } else { hash })
}

/// MurmurHash3_x86_32 with seed 0 (Appleby 2011).
fn murmur3(bytes: &[u8]) -> u32 {
    let scramble = |k: u32| k.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |k, &byte| k << 8 | u32::from(byte));
    let blocks = bytes.chunks_exact(4);
    let tail = blocks.remainder();
    let mut h = blocks
        .fold(0_u32, |h, block| (h ^ scramble(word(block))).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64));
    h ^= scramble(word(tail));
    h ^= bytes.len() as u32;
    h = (h ^ h >> 16).wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
    h ^ h >> 16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::DataWindow;
    use crate::film::{FirstHit, Sample};

    /// Published vectors of MurmurHash3_x86_32 with seed 0.
    #[test]
    fn hashes_are_murmurs() {
        let cases = [("", 0), ("test", 0xba6b_d213), ("Hello, world!", 0xc036_3e43), ("hello", 0x248b_fa47)];
        for (text, hash) in cases {
            assert_eq!(murmur3(text.as_bytes()), hash, "{text}");
        }
    }

    #[test]
    fn ids_are_usual_floats() {
        assert!((0..100_000).all(|i| id(&format!("/World/Object{i}")).is_normal()));
    }

    #[test]
    fn coverage_is_the_share_of_samples() {
        let window = DataWindow { x0: 0, y0: 0, x1: 1, y1: 1 };
        let film = Film::new(window, &["cryptoObject".into()], false, 1.0).expect("memory");
        let film = film.named(["/A", "/B", "/C"].into_iter());
        for prim_id in [-1, 2, 0, 2] {
            let first = FirstHit { prim_id, depth: 1.0, ..FirstHit::NONE };
            film.tiles[0].lock().unwrap().add(0, &Sample { first, ..Sample::BLACK });
        }
        let planes = film.resolve();
        let names: Vec<_> = planes.iter().map(|plane| plane.name.clone()).collect();
        assert_eq!(names, ["color", "cryptoObject00", "cryptoObject01", "cryptoObject02"]);
        assert_eq!(planes[1].values, [id("/C"), 0.5, id("/A"), 0.25]);
        assert_eq!(planes[2].values, [0.0; 4]);
        let metadata = metadata(["/A", "/C"].into_iter());
        assert!(metadata.iter().all(|(name, _)| name.starts_with("cryptomatte/") && name.split('/').count() == 3));
        assert!(metadata[3].1.contains(&format!("\"/C\":\"{:08x}\"", id("/C").to_bits())));
    }
}
