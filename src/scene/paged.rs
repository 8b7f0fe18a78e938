//! Texels beyond the memory that images may have: in a scratch file that is mapped. The system reads pages that are looked
//! at; those not looked at for longest are given back (a clock over chunks of pages, second chance).
//!
//! The map stays valid whatever is given back: a reader whose page went away in the same moment waits for the disk, and
//! reads the same texels. So no picture depends on the bound, and a chunk that is in costs one relaxed load: no lock,
//! nothing written.

use memmap2::Mmap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// What Linux maps around a page that is asked for (fault-around), aligned in the address space.
const CHUNK: usize = 1 << 16;

/// States of a chunk.
const ABSENT: u8 = 0;
const OLD: u8 = 1;
const RECENT: u8 = 2;

/// The memory that all scratch files share.
#[derive(Default)]
pub struct Residency {
    /// Chunks; 0: no bound.
    bound: AtomicUsize,
    resident: AtomicUsize,
    clock: Mutex<Clock>,
}

#[derive(Default)]
struct Clock {
    files: Vec<Weak<Scratch>>,
    /// Next chunk to be looked at: file, and chunk in it.
    hand: (usize, usize),
}

/// A scratch file without a name.
pub struct Scratch {
    map: Arc<Mmap>,
    chunks: Vec<AtomicU8>,
    residency: Arc<Residency>,
}

impl Residency {
    /// 0: no bound.
    pub fn set_bound(&self, bytes: usize) {
        // At least a chunk, where there is a bound at all.
        self.bound.store(if bytes == 0 { 0 } else { (bytes / CHUNK).max(1) }, Relaxed);
    }

    /// Bytes that are in memory.
    #[cfg(test)]
    fn resident(&self) -> usize {
        self.resident.load(Relaxed) * CHUNK
    }

    /// A chunk came in.
    #[cold]
    fn add(&self) {
        let (resident, bound) = (self.resident.fetch_add(1, Relaxed) + 1, self.bound.load(Relaxed));
        if bound > 0 && resident > bound {
            self.make_room(bound);
        }
    }

    fn make_room(&self, bound: usize) {
        let mut clock = self.clock.lock().unwrap_or_else(PoisonError::into_inner);
        // An eighth at once, so that the next misses need not come here; others may have made room meanwhile.
        let wanted = bound - bound / 8;
        if self.resident.load(Relaxed) <= bound {
            return;
        }
        clock.files.retain(|file| file.strong_count() > 0);
        let files: Vec<Arc<Scratch>> = clock.files.iter().filter_map(Weak::upgrade).collect();
        let chunks: usize = files.iter().map(|file| file.chunks.len()).sum();
        // Two rounds take the mark off every chunk, and then the chunk.
        for _ in 0..2 * chunks {
            if self.resident.load(Relaxed) <= wanted {
                break;
            }
            let (file, chunk) = clock.advance(&files);
            self.resident.fetch_sub(usize::from(files[file].age(chunk)), Relaxed);
        }
    }
}

impl Clock {
    /// The chunk under the hand, which moves on.
    fn advance(&mut self, files: &[Arc<Scratch>]) -> (usize, usize) {
        let (mut file, mut chunk) = self.hand;
        while file >= files.len() || chunk >= files[file].chunks.len() {
            (file, chunk) = (if file + 1 < files.len() { file + 1 } else { 0 }, 0);
        }
        self.hand = (file, chunk + 1);
        (file, chunk)
    }
}

impl Scratch {
    /// A file in the directory for temporary files (`$TMPDIR`) with what `write` writes.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(
        residency: &Arc<Residency>,
        write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> io::Result<Arc<Self>> {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("dermis-texels-{}-{}", std::process::id(), NEXT.fetch_add(1, Relaxed));
        let path = std::env::temp_dir().join(name);
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
        let filled = fill(file, write);
        // Where the system cannot remove a file that is open, it stays behind.
        let _ = fs::remove_file(&path);
        let map = filled?;
        let chunks = (0..chunk_of(&map, map.len().saturating_sub(1)) + 1).map(|_| AtomicU8::new(ABSENT)).collect();
        let scratch = Arc::new(Self { map: Arc::new(map), chunks, residency: residency.clone() });
        let mut clock = residency.clock.lock().unwrap_or_else(PoisonError::into_inner);
        clock.files.push(Arc::downgrade(&scratch));
        Ok(scratch)
    }

    pub fn map(&self) -> &Arc<Mmap> {
        &self.map
    }

    /// Says that the byte at `offset` is about to be read.
    pub fn touch(&self, offset: usize) {
        let state = &self.chunks[chunk_of(&self.map, offset)];
        if state.load(Relaxed) != RECENT && state.swap(RECENT, Relaxed) == ABSENT {
            self.residency.add();
        }
    }

    /// The hand passes a chunk: a recent one gets old, an old one is given back (true).
    fn age(&self, chunk: usize) -> bool {
        match self.chunks[chunk].compare_exchange(RECENT, OLD, Relaxed, Relaxed) {
            Ok(_) | Err(ABSENT) => false,
            Err(_) => {
                let gone = self.chunks[chunk].compare_exchange(OLD, ABSENT, Relaxed, Relaxed).is_ok();
                if gone {
                    let start = (chunk * CHUNK).saturating_sub(misalignment(&self.map));
                    let end = ((chunk + 1) * CHUNK - misalignment(&self.map)).min(self.map.len());
                    release(&self.map, start, end - start);
                }
                gone
            }
        }
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let resident = self.chunks.iter().filter(|chunk| chunk.load(Relaxed) != ABSENT).count();
        self.residency.resident.fetch_sub(resident, Relaxed);
    }
}

fn fill(file: File, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<Mmap> {
    let mut writer = BufWriter::new(file);
    write(&mut writer)?;
    writer.flush()?;
    let file = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
    // SAFETY: nobody else knows the file: it was created new, and its name is taken away before anything is read.
    unsafe { Mmap::map(&file) }
}

/// Bytes from the start of the map's first chunk to the map.
fn misalignment(map: &Mmap) -> usize {
    map.as_ptr().addr() % CHUNK
}

fn chunk_of(map: &Mmap, offset: usize) -> usize {
    (misalignment(map) + offset) / CHUNK
}

/// Gives back the pages that lie in a range of a map wholly; they are read again when they are asked for.
pub fn release(map: &Mmap, offset: usize, len: usize) {
    #[cfg(unix)]
    {
        const PAGE: usize = 4096;
        let start = offset.next_multiple_of(PAGE);
        // What lies behind the end of a file belongs to its last page.
        let end = if offset + len == map.len() { map.len() } else { (offset + len) / PAGE * PAGE };
        if start < end {
            // SAFETY: the map is one of a file and read-only, so that its pages hold nothing that the file does not.
            // An error leaves them where they are.
            let _ = unsafe { map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, start, end - start) };
        }
    }
    #[cfg(not(unix))]
    let _ = (map, offset, len);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    fn numbers(residency: &Arc<Residency>, from: u32, count: u32) -> Arc<Scratch> {
        let write =
            |file: &mut BufWriter<File>| (from..from + count).try_for_each(|i| file.write_all(&i.to_le_bytes()));
        Scratch::create(residency, write).expect("a temporary file")
    }

    fn read(scratch: &Scratch, i: usize) -> u32 {
        scratch.touch(4 * i);
        u32::from_le_bytes(scratch.map()[4 * i..4 * i + 4].try_into().expect("four bytes"))
    }

    #[test]
    fn what_is_read_does_not_depend_on_the_bound() {
        let residency = Arc::new(Residency::default());
        residency.set_bound(4 * CHUNK);
        let files = [0, 500_000].map(|from| numbers(&residency, from, 500_000));
        for round in 0..3 {
            (0..1_000_000_usize).into_par_iter().for_each(|i| {
                // Strides that jump from chunk to chunk.
                let i = i.wrapping_mul(7919 + round) % 1_000_000;
                assert_eq!(read(&files[i / 500_000], i % 500_000) as usize, i);
            });
            // Each thread may be about to make room for one.
            assert!(residency.resident() <= (4 + rayon::current_num_threads()) * CHUNK);
        }
        drop(files);
        assert_eq!(residency.resident(), 0);
    }

    #[test]
    fn chunks_in_use_stay() {
        let residency = Arc::new(Residency::default());
        residency.set_bound(8 * CHUNK);
        let file = numbers(&residency, 0, 1_000_000);
        let per_chunk = CHUNK / 4;
        read(&file, 0);
        let mut lost = 0;
        for i in 0..60 * per_chunk {
            if i % 64 == 0 {
                lost += usize::from(file.chunks[chunk_of(file.map(), 0)].load(Relaxed) == ABSENT);
                read(&file, 0);
            }
            read(&file, i % 1_000_000);
        }
        // Once, the first time that room is made: everything is recent then.
        assert!(lost <= 1, "the chunk that is asked for all the time was away {lost} times");
    }

    #[test]
    fn without_a_bound_all_stays() {
        let residency = Arc::new(Residency::default());
        let file = numbers(&residency, 0, 100_000);
        (0..100_000).for_each(|i| assert_eq!(read(&file, i), i as u32));
        assert_eq!(residency.resident(), file.chunks.len() * CHUNK);
    }
}
