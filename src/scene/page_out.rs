//! Images out of memory: where all together are more than may be in memory, their levels go to a scratch file, in tiles.

use super::image::{Image, ImageCache, Level, TILE};
use super::paged::{Residency, Scratch, release};
use super::pyramid::coarser;
use crate::error::Warning;
use crate::flat::{self, Prims, Texels};
use std::io::{self, Write};
use std::sync::Arc;

/// Of arrays in a map.
const ALIGNMENT: usize = 64;

impl Image {
    /// In tiles, in a scratch file; of an image with texels.
    ///
    /// # Errors
    /// What the file system says.
    fn paged(image: &flat::Image, residency: &Arc<Residency>) -> io::Result<Self> {
        let channels = image.channels as usize;
        let mut levels = Vec::new();
        let mut end = 0;
        let scratch = Scratch::create(residency, |file| {
            // Level 0 of the description, rows as they are: what is saved or compiled again comes from there.
            file.write_all(image.texels.bytes())?;
            end = image.texels.bytes().len();
            let mut put = |width: usize, height: usize, texels: &Texels| {
                let tiles = if width.max(height) > TILE { width.div_ceil(TILE) } else { 0 };
                let start = end.next_multiple_of(ALIGNMENT);
                file.write_all(&[0; ALIGNMENT][..start - end])?;
                end = start + write_level(file, texels, [width, height], channels * texels.size(), tiles)?;
                levels.push((width, height, tiles, start, (end - start) / texels.size()));
                Ok(())
            };
            let mut written = put(image.width as usize, image.height as usize, &image.texels);
            coarser(image, |width, height, texels| {
                if written.is_ok() {
                    written = put(width, height, &texels);
                }
            });
            written
        })?;
        if let Some((map, offset, len)) = image.texels.map() {
            release(map, offset, len);
        }
        let level = |(width, height, tiles, start, len)| Level {
            width,
            height,
            texels: image.texels.mapped(scratch.map(), start, len),
            tiles,
            start,
        };
        let levels = levels.into_iter().map(level).collect();
        Ok(Self { channels, srgb: image.srgb, levels, scratch: Some(scratch) })
    }

    /// The texels of a paged image as they were described.
    fn finest(&self) -> Texels {
        let level = &self.levels[0];
        match &self.scratch {
            Some(scratch) => level.texels.mapped(scratch.map(), 0, level.width * level.height * self.channels),
            None => level.texels.clone(),
        }
    }
}

/// Writes texels of `size` bytes in rows, or in `tiles` per row of tiles; how many bytes.
fn write_level(
    file: &mut impl Write,
    texels: &Texels,
    [width, height]: [usize; 2],
    size: usize,
    tiles: usize,
) -> io::Result<usize> {
    let bytes = texels.bytes();
    if tiles == 0 {
        file.write_all(bytes)?;
        return Ok(bytes.len());
    }
    let mut tile = vec![0; TILE * TILE * size];
    let rows = height.div_ceil(TILE);
    for (ty, tx) in (0..rows).flat_map(|ty| (0..tiles).map(move |tx| (ty, tx))) {
        let across = TILE.min(width - tx * TILE) * size;
        for y in 0..TILE.min(height - ty * TILE) {
            let from = ((ty * TILE + y) * width + tx * TILE) * size;
            tile[y * TILE * size..][..across].copy_from_slice(&bytes[from..from + across]);
        }
        // What is beyond the image is not looked at.
        file.write_all(&tile)?;
    }
    Ok(rows * tiles * tile.len())
}

/// Bytes with all levels: a third more than the finest.
fn bytes(image: &flat::Image) -> usize {
    image.texels.len() * image.texels.size() / 3 * 4
}

/// Where all images together exceed `bound` bytes (0: none), moves those that are not there yet into scratch files, the
/// described texels included, and bounds what of the files is in memory.
///
/// An image that no file can be written for stays in memory, which is said.
pub fn page_out(
    images: &mut Prims<flat::Image>,
    cache: &mut ImageCache,
    residency: &Arc<Residency>,
    bound: usize,
) -> Vec<Warning> {
    residency.set_bound(bound);
    let mut warnings = Vec::new();
    if bound == 0 || images.values().map(bytes).sum::<usize>() <= bound {
        return warnings;
    }
    for (key, image) in images.iter_mut() {
        if image.texels.is_empty() || cache.get(key).is_some_and(|compiled| compiled.scratch.is_some()) {
            continue;
        }
        match Image::paged(image, residency) {
            Ok(compiled) => {
                image.texels = compiled.finest();
                cache.insert(key.clone(), Arc::new(compiled));
            }
            Err(error) => {
                let place = std::env::temp_dir();
                let message = format!(
                    "{}: textureMemory: no scratch file in {} ({error}); it is kept in memory: set TMPDIR",
                    image.file,
                    place.display()
                );
                warnings.push(Warning::new(key, message));
            }
        }
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::super::image::tests::{how, image};
    use super::*;
    use crate::flat::Wrap;
    use glam::Vec2;
    use half::f16;

    #[test]
    fn paged_images_are_the_same_bit_for_bit() {
        let noise = |n: usize| (0..n).map(move |i| (i.wrapping_mul(2_654_435_761) >> 7) as u8);
        let half = |v: u8| f16::from_f32(f32::from(v) / 7.0).to_bits();
        let formats: [(u32, Texels); 4] = [
            (3, Texels::U8(noise(3 * 201 * 133).collect::<Vec<_>>().into())),
            (1, Texels::U16(noise(201 * 133).map(|v| 257 * u16::from(v)).collect::<Vec<_>>().into())),
            (2, Texels::Half(noise(2 * 201 * 133).map(half).collect::<Vec<_>>().into())),
            (4, Texels::Float(noise(4 * 201 * 133).map(f32::from).collect::<Vec<_>>().into())),
        ];
        for (channels, texels) in formats {
            let flat = image(201, channels, channels == 3, texels);
            let residency = Arc::new(Residency::default());
            let mut images: Prims<flat::Image> = [("a".into(), flat.clone())].into();
            let mut cache = ImageCache::new();
            // The smallest bound: a chunk.
            assert!(page_out(&mut images, &mut cache, &residency, 1).is_empty());
            assert_eq!(images["a"], flat);
            let (plain, paged) = (Image::compile(&flat).unwrap(), &cache["a"]);
            assert!(paged.is_paged() && paged.levels.len() == plain.levels.len());
            for i in 0..4000 {
                let st = Vec2::new(i as f32 * 0.618, i as f32 * 0.414);
                let across = Some([Vec2::splat(0.5_f32.powi(i % 9)), Vec2::Y]);
                for wrap in [Wrap::Repeat, Wrap::Mirror] {
                    assert_eq!(plain.at(st, across, &how(wrap)), paged.at(st, across, &how(wrap)));
                }
            }
        }
    }

    #[test]
    fn images_that_fit_stay_in_memory() {
        let small = image(10, 1, false, Texels::U8(vec![9; 100].into()));
        let mut images: Prims<flat::Image> = [("small".into(), small)].into();
        let (mut cache, residency) = (ImageCache::new(), Arc::new(Residency::default()));
        for bound in [0, 1_000_000] {
            assert!(page_out(&mut images, &mut cache, &residency, bound).is_empty() && cache.is_empty());
        }
    }
}
