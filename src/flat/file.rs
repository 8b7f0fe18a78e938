//! The flattened scene in one file, `.dermis`: JSON text, and arrays that are mapped, not read.
//!
//! All numbers are little-endian; machines of the other kind are refused. In bytes:
//!
//! | from | what |
//! |---|---|
//! | 0 | magic `DERMIS` |
//! | 6 | version, u16 |
//! | 8 | length of the text, u64 |
//! | 16 | number of table entries, u64 |
//! | 24 | length of the file, u64 |
//! | 32 | checksum of the text, u64 |
//! | 40 | zeros |
//! | 56 | checksum of the bytes before, u64 |
//! | 64 | the text: [`FlatScene`] as JSON, where `{"array": n}` stands for entry n of the table |
//! | next multiple of 8 | the table, 32 bytes per array |
//! | multiples of 64 | the arrays |
//!
//! An entry of the table is the scalar (u32: 0 float, 1 double, 2 int, 3 byte, 4 short; both unsigned) and how many make an element (u32), the
//! offset in the file, the number of elements and the checksum of these (u64 each).
//!
//! A damaged header, text or table is found by its checksum. Arrays carry none, since that would read them
//! all; [`FlatScene::validate`] finds what matters of them.

use super::{
    FlatScene,
    array::{AnyArray, Scalar, collect_arrays, with_arrays},
};
use crate::{
    error::{Error, Result},
    replace::replace_file,
};
use memmap2::Mmap;
use std::{
    fs::File,
    io::{self, Write},
    path::Path,
    sync::Arc,
};

const MAGIC: &[u8; 6] = b"DERMIS";
/// Raised when an older program could misread a newer file.
const VERSION: u16 = 3;
const HEADER: usize = 64;
const ENTRY: usize = 32;
/// A cache line: what any vector load of an array may ask for.
const ALIGNMENT: usize = 64;
/// A matrix: the largest element there is.
const LARGEST_COMPONENTS: u32 = 16;

/// What is wrong, and with which part.
#[derive(Debug)]
struct Fault {
    field: String,
    message: String,
}

type Checked<T> = std::result::Result<T, Fault>;

fn fault<T>(field: impl Into<String>, message: impl Into<String>) -> Checked<T> {
    Err(Fault { field: field.into(), message: message.into() })
}

/// Writes the scene as [`FlatScene::validate`] leaves it (text has no NaN), with the warnings of that among
/// its own. The file appears under its name only when it is whole.
///
/// # Errors
/// [`Error::Prim`] for settings that [`super::RenderSettings::check`] refuses, [`Error::File`] for what the
/// file system says.
pub fn save(scene: &FlatScene, file: &Path) -> Result<()> {
    scene.settings.check()?;
    // Shares every array that needs no repair.
    let mut scene = scene.clone();
    let warnings = scene.validate();
    scene.warnings.extend(warnings);
    refuse_big_endian()
        .and_then(|()| replace_file(file, |writer| write(&scene, writer)).or_else(|e| fault("file", e.to_string())))
        .map_err(|fault| named(file, fault))
}

/// Maps a file that [`save`] wrote. Validate the scene before use: arrays are not checked here.
///
/// The file must not be changed in place while the scene lives; replacing it, as [`save`] does, is fine.
///
/// # Errors
/// [`Error::File`] naming the part that is damaged: `file`, `magic`, `version`, `header`, `text`,
/// `table`, `table entry N`, `array N`.
pub fn load(file: &Path) -> Result<FlatScene> {
    refuse_big_endian()
        .and_then(|()| map(file).or_else(|e| fault("file", e.to_string())))
        .and_then(|map| read(&Arc::new(map)))
        .map_err(|fault| named(file, fault))
}

fn named(file: &Path, Fault { field, message }: Fault) -> Error {
    Error::File { file: file.display().to_string(), field, message }
}

fn refuse_big_endian() -> Checked<()> {
    if cfg!(target_endian = "big") {
        return fault("file", "big-endian machines are not supported: arrays are mapped as little-endian");
    }
    Ok(())
}

fn map(file: &Path) -> io::Result<Mmap> {
    let file = File::open(file)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a file"));
    }
    // SAFETY: a map is unsound only while someone writes to the file or cuts it short. dermis never does:
    // `save` writes to another file and renames. `load` asks the same of others.
    unsafe { Mmap::map(&file) }
}

/// FNV-1a, 64 bit (Fowler, Noll, Vo): each step is a bijection, so no single changed byte escapes.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn write(scene: &FlatScene, writer: &mut impl Write) -> io::Result<()> {
    let (text, arrays) = collect_arrays(|| serde_json::to_vec(scene));
    let text = text?;
    let table = (HEADER + text.len()).next_multiple_of(8);
    let (entries, length) = layout(table + arrays.len() * ENTRY, &arrays);
    let mut written = 0;
    let mut put = |at: usize, bytes: &[u8]| {
        // Zeros up to the next part; the parts come in order.
        writer.write_all(&[0; ALIGNMENT][..at - written])?;
        written = at + bytes.len();
        writer.write_all(bytes)
    };
    put(0, &header(&text, arrays.len(), length))?;
    put(HEADER, &text)?;
    put(table, entries.as_flattened())?;
    let mut at = table + entries.len() * ENTRY;
    for array in &arrays {
        at = at.next_multiple_of(ALIGNMENT);
        put(at, array.bytes())?;
        at += array.bytes().len();
    }
    Ok(())
}

fn header(text: &[u8], arrays: usize, length: usize) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    header[..6].copy_from_slice(MAGIC);
    header[6..8].copy_from_slice(&VERSION.to_le_bytes());
    for (field, value) in [text.len() as u64, arrays as u64, length as u64, checksum(text)].into_iter().enumerate() {
        header[8 + field * 8..][..8].copy_from_slice(&value.to_le_bytes());
    }
    let sum = checksum(&header[..56]);
    header[56..].copy_from_slice(&sum.to_le_bytes());
    header
}

/// The table for arrays from `start` on, and where the file ends.
fn layout(start: usize, arrays: &[AnyArray]) -> (Vec<[u8; ENTRY]>, usize) {
    let mut end = start;
    let mut entry_of = |array: &AnyArray| {
        let offset = end.next_multiple_of(ALIGNMENT);
        end = offset + array.bytes().len();
        entry(array, offset)
    };
    (arrays.iter().map(&mut entry_of).collect(), end)
}

fn entry(array: &AnyArray, offset: usize) -> [u8; ENTRY] {
    let code: u32 = match array.scalar() {
        Scalar::F32 => 0,
        Scalar::F64 => 1,
        Scalar::I32 => 2,
        Scalar::U8 => 3,
        Scalar::U16 => 4,
    };
    let mut entry = [0; ENTRY];
    entry[..4].copy_from_slice(&code.to_le_bytes());
    entry[4..8].copy_from_slice(&(array.components() as u32).to_le_bytes());
    entry[8..16].copy_from_slice(&(offset as u64).to_le_bytes());
    entry[16..24].copy_from_slice(&(array.len() as u64).to_le_bytes());
    let sum = checksum(&entry[..24]);
    entry[24..].copy_from_slice(&sum.to_le_bytes());
    entry
}

fn read(map: &Arc<Mmap>) -> Checked<FlatScene> {
    let (text_length, arrays) = read_header(map)?;
    let text_end = HEADER + text_length;
    let text = &map[HEADER..text_end];
    if checksum(text) != u64_at(map, 32) {
        return fault("text", "it is damaged (its checksum differs); write the file again");
    }
    let Some(table) = table_of(map, text_end, arrays) else {
        return fault("table", format!("{arrays} entries do not fit the file of {} bytes", map.len()));
    };
    let entries = table.chunks_exact(ENTRY).enumerate();
    let arrays: Vec<AnyArray> = entries.map(|(n, entry)| read_entry(map, n, entry)).collect::<Checked<_>>()?;
    with_arrays(arrays, || serde_json::from_slice(text)).or_else(|error| fault("text", error.to_string()))
}

/// Lengths of the text and the table; the text is inside the file.
fn read_header(map: &Mmap) -> Checked<(usize, usize)> {
    if !map.starts_with(MAGIC) {
        return fault("magic", "not a .dermis file: it does not begin with DERMIS");
    }
    if map.len() < HEADER {
        return fault("header", format!("cut short: {} of {HEADER} bytes", map.len()));
    }
    let version = u16::from_le_bytes([map[6], map[7]]);
    if version != VERSION {
        let what = format!("version {version}, this program reads {VERSION}; flatten the stage again");
        return fault("version", what);
    }
    if checksum(&map[..56]) != u64_at(map, 56) {
        return fault("header", "it is damaged (its checksum differs); write the file again");
    }
    let [text, arrays, length] = [8, 16, 24].map(|at| u64_at(map, at));
    if length != map.len() as u64 {
        return fault("header", format!("the file has {} of its {length} bytes: cut short or added to", map.len()));
    }
    match (usize::try_from(text), usize::try_from(arrays)) {
        (Ok(text), Ok(arrays)) if text <= map.len() - HEADER => Ok((text, arrays)),
        _ => fault("text", format!("{text} bytes do not fit the file of {length} bytes")),
    }
}

fn table_of(map: &Mmap, text_end: usize, arrays: usize) -> Option<&[u8]> {
    let start = text_end.checked_next_multiple_of(8)?;
    map.get(start..start.checked_add(arrays.checked_mul(ENTRY)?)?)
}

fn read_entry(map: &Arc<Mmap>, n: usize, entry: &[u8]) -> Checked<AnyArray> {
    let damaged = |what: &str| fault(format!("table entry {n}"), format!("{what}; write the file again"));
    if checksum(&entry[..24]) != u64_at(entry, 24) {
        return damaged("it is damaged (its checksum differs)");
    }
    let scalar = match u32_at(entry, 0) {
        0 => Scalar::F32,
        1 => Scalar::F64,
        2 => Scalar::I32,
        3 => Scalar::U8,
        4 => Scalar::U16,
        _ => return damaged("unknown scalar"),
    };
    let components = u32_at(entry, 4);
    if !(1..=LARGEST_COMPONENTS).contains(&components) {
        return damaged("no element has so many components");
    }
    let (Ok(offset), Ok(len)) = (usize::try_from(u64_at(entry, 8)), usize::try_from(u64_at(entry, 16))) else {
        return damaged("larger than this machine's memory");
    };
    if offset % ALIGNMENT != 0 {
        return damaged("its array is not aligned to 64 bytes");
    }
    let components = components as usize;
    let bytes = len.checked_mul(scalar.size() * components).and_then(|bytes| bytes.checked_add(offset));
    if bytes.is_none_or(|end| end > map.len()) {
        return fault(format!("array {n}"), format!("{len} elements from byte {offset} on do not fit the file"));
    }
    Ok(AnyArray::Mapped { map: Arc::clone(map), offset, len, scalar, components })
}

/// `at + 4` is inside `bytes`, a header or an entry.
fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut value = [0; 4];
    value.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(value)
}

/// As [`u32_at`].
fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut value = [0; 8];
    value.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(value)
}

#[cfg(test)]
mod tests;
