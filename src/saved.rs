//! State as bytes, for checkpoints: what is written is what is read back, bit for bit, on the same machine.

use bytemuck::{Pod, Zeroable};
use std::io::{self, Read, Write};

/// Longest array of a checkpoint, in bytes: above it a length is damage.
const LONGEST: u64 = 1 << 40;

/// Writes values one after the other.
pub(crate) struct Saver<'a>(pub &'a mut dyn Write);

impl Saver<'_> {
    pub fn value<T: Pod>(&mut self, value: &T) -> io::Result<()> {
        self.0.write_all(bytemuck::bytes_of(value))
    }

    pub fn count(&mut self, count: usize) -> io::Result<()> {
        self.value(&(count as u64))
    }

    /// An array with its length.
    pub fn array<T: Pod>(&mut self, values: &[T]) -> io::Result<()> {
        self.count(values.len())?;
        self.0.write_all(bytemuck::cast_slice(values))
    }
}

/// Reads them back in the same order.
pub(crate) struct Loader<'a>(pub &'a mut dyn Read);

impl Loader<'_> {
    pub fn value<T: Pod>(&mut self) -> io::Result<T> {
        let mut value = T::zeroed();
        self.0.read_exact(bytemuck::bytes_of_mut(&mut value))?;
        Ok(value)
    }

    pub fn count(&mut self) -> io::Result<usize> {
        let count: u64 = self.value()?;
        if count > LONGEST { Err(damaged("a length")) } else { Ok(count as usize) }
    }

    /// An array that must have as many elements as `into`.
    pub fn array<T: Pod>(&mut self, into: &mut [T]) -> io::Result<()> {
        if self.count()? != into.len() {
            return Err(damaged("the length of an array"));
        }
        self.0.read_exact(bytemuck::cast_slice_mut(into))
    }

    /// An array of any length.
    pub fn vec<T: Pod>(&mut self) -> io::Result<Vec<T>> {
        let mut values = vec![T::zeroed(); self.count()?];
        self.0.read_exact(bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }

    /// Text or bytes of any length up to `most`.
    pub fn bytes(&mut self, most: usize) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; Some(self.count()?).filter(|&n| n <= most).ok_or_else(|| damaged("a text"))?];
        self.0.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

pub(crate) fn damaged(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("{what} is damaged"))
}

/// A 64-bit digest of what is written to it, eight bytes at a time: tells inputs apart, resists nobody.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Digest {
    state: u64,
    /// Bytes that wait for their word to fill, and how many there were in all.
    pending: u64,
    length: u64,
}

impl Digest {
    pub fn new() -> Self {
        Self { state: 0xcbf2_9ce4_8422_2325, pending: 0, length: 0 }
    }

    pub fn finish(self) -> u64 {
        let mut end = self;
        end.word(self.pending);
        end.word(self.length);
        end.state ^ end.state >> 32
    }

    fn word(&mut self, word: u64) {
        self.state = (self.state ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
    }

    fn byte(&mut self, byte: u8) {
        self.pending = self.pending << 8 | u64::from(byte);
        self.length += 1;
        if self.length.is_multiple_of(8) {
            let word = std::mem::take(&mut self.pending);
            self.word(word);
        }
    }
}

impl Write for Digest {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let aligned = bytes.len().min((8 - self.length as usize % 8) % 8);
        let (head, rest) = bytes.split_at(aligned);
        head.iter().for_each(|&byte| self.byte(byte));
        let words = rest.chunks_exact(8);
        let tail = words.remainder();
        for word in words {
            self.word(u64::from_be_bytes(word.try_into().expect("chunks of eight")));
            self.length += 8;
        }
        tail.iter().for_each(|&byte| self.byte(byte));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back() {
        let mut bytes = Vec::new();
        let mut saver = Saver(&mut bytes);
        saver.value(&f32::from_bits(0x7fc0_1234)).unwrap();
        saver.array(&[1.5_f64, -0.0]).unwrap();
        let mut source = bytes.as_slice();
        let mut loader = Loader(&mut source);
        assert_eq!(loader.value::<u32>().unwrap(), 0x7fc0_1234);
        let mut array = [0.0_f64; 2];
        loader.array(&mut array).unwrap();
        assert_eq!(array.map(f64::to_bits), [1.5_f64, -0.0].map(f64::to_bits));
        assert!(Loader(&mut &bytes[4..10]).array(&mut array).is_err());
        assert!(Loader(&mut &bytes[4..]).array(&mut [0.0_f64; 3]).is_err());
    }

    #[test]
    fn digests_do_not_depend_on_how_it_was_written() {
        let bytes: Vec<u8> = (0..100).map(|i| (i * 37) as u8).collect();
        let digest = |parts: &[usize]| {
            let (mut digest, mut rest) = (Digest::new(), bytes.as_slice());
            for &n in parts {
                digest.write_all(&rest[..n]).unwrap();
                rest = &rest[n..];
            }
            digest.write_all(rest).unwrap();
            digest.finish()
        };
        assert!([&[][..], &[1, 2, 3], &[8, 9], &[50, 49]].iter().all(|parts| digest(parts) == digest(&[100])));
        let mut seen: Vec<u64> = (0..100)
            .map(|n| {
                let mut digest = Digest::new();
                digest.write_all(&vec![0; n]).unwrap();
                digest.finish()
            })
            .collect();
        seen.dedup();
        assert_eq!(seen.len(), 100);
    }
}
