//! Whole files or none: what is written gets its final name only when it is complete.

use std::{
    ffi::OsString,
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU32, Ordering},
};

/// Replaces `file` by what `write` writes: a temporary name in the same folder (a rename must not cross
/// file systems), then a rename. On an error nothing is left behind and `file` is as it was.
pub(crate) fn replace_file(file: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let temporary = temporary_name(file)?;
    let result = write_whole(&temporary, write).and_then(|()| fs::rename(&temporary, file));
    if result.is_err() {
        // The first error is the one to report; the file may not even exist.
        let _ = fs::remove_file(&temporary);
    }
    result
}

fn write_whole(file: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::new(OpenOptions::new().write(true).create_new(true).open(file)?);
    write(&mut writer)?;
    writer.flush()
}

/// `.NAME.PROCESS.COUNT.tmp` beside `file`: no two writers share it, and no `*.exr` pattern matches it.
fn temporary_name(file: &Path) -> io::Result<PathBuf> {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = file.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "not the name of a file"))?;
    let mut temporary = OsString::from(".");
    temporary.push(name);
    temporary.push(format!(".{}.{}.tmp", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    Ok(file.with_file_name(temporary))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn replaces_whole_files_only() {
        let folder = std::env::temp_dir().join(format!("dermis_replace_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let file = folder.join("image.exr");
        replace_file(&file, |writer| writer.write_all(b"first")).unwrap();
        let error = replace_file(&file, |writer| {
            writer.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert_eq!(error.unwrap_err().to_string(), "disk full");
        assert_eq!(fs::read(&file).unwrap(), b"first");
        replace_file(&file, |writer| writer.write_all(b"second")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"second");
        assert_eq!(names(&folder), ["image.exr"]);
        assert!(replace_file(&folder.join("none/image.exr"), |_| Ok(())).is_err());
        assert!(replace_file(Path::new("/"), |_| Ok(())).is_err());
        fs::remove_dir_all(folder).unwrap();
    }
}
