//! Checkpoints: the state of a render in a file, from which another process goes on to the same image, bit for bit.
//!
//! What follows from scene and settings is made again (slab normals, caches of what training found: see the journal); what
//! samples brought is kept: the film's sums, what the guide has learned, and what the tiles of the pass under way have taught. The numbers are those
//! of this machine's memory; a file of another machine kind, version, scene or settings is refused by its header.

use super::adaptive::Adaptive;
use super::journal::JOURNAL;
use super::pass::{Merger, Passes, Phase, Schedule};
use super::{Run, locked};
use crate::error::{Error, Result};
use crate::film::Film;
use crate::guiding::statistics::Statistics;
use crate::saved::{Loader, Saver, damaged};
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Raised when an older file could be misread.
const VERSION: u32 = 8;
/// As a number of this machine: another byte order does not match.
const MAGIC: u64 = u64::from_le_bytes(*b"DERMISCP");
/// Bytes of the first three numbers.
const HEADER: u64 = 20;
const END: u64 = u64::from_le_bytes(*b"PCSIMRED");

/// Where a render keeps its state.
#[derive(Debug, Clone, PartialEq)]
pub struct Keep {
    pub file: PathBuf,
    /// Between two checkpoints; none is written before this has passed.
    pub every: Duration,
    /// Go on from the file if it is there.
    pub resume: bool,
    /// Digest of scene and settings.
    pub fingerprint: u64,
}

impl Keep {
    /// The file to go on from: that of the samples, or while there are none that of what training found.
    ///
    /// # Errors
    /// One of another scene, of other settings, or none that can be read.
    pub fn resumed(&self) -> Result<Option<PathBuf>> {
        // Killed before it wrote as much as a header, it found nothing.
        let has_finds = || fs::metadata(self.journal()).is_ok_and(|journal| journal.len() > HEADER);
        let (file, magic) = match self.resume {
            true if self.has_samples() => (self.file.clone(), MAGIC),
            true if has_finds() => (self.journal(), JOURNAL),
            _ => return Ok(None),
        };
        let header = || self.header(magic, &mut Loader(&mut BufReader::new(File::open(&file)?)));
        header().map_err(|error| self.fault(&file, &error))?;
        Ok(Some(file))
    }

    /// The number of records that kept samples were made with, if they are gone on from.
    ///
    /// # Errors
    /// As [`Self::resumed`].
    pub(super) fn points(&self) -> Result<Option<u32>> {
        if !self.has_samples() {
            return Ok(None);
        }
        let read = || {
            let mut file = BufReader::new(File::open(&self.file)?);
            let mut from = Loader(&mut file);
            self.header(MAGIC, &mut from)?;
            from.value::<u32>()
        };
        read().map(Some).map_err(|error| self.fault(&self.file, &error))
    }

    /// Whether samples were kept that are gone on from.
    pub(super) fn has_samples(&self) -> bool {
        self.resume && self.file.exists()
    }

    /// A render that is not gone on from leaves nothing that a later one would take for its own.
    pub(super) fn begin(&self) {
        if !self.resume {
            // Where nothing was left, there is nothing to remove; where that fails, so will writing, which says so.
            let _ = fs::remove_file(&self.file);
            let _ = fs::remove_file(self.journal());
        }
    }

    /// Where training keeps what it finds.
    pub fn journal(&self) -> PathBuf {
        let mut name = self.file.clone().into_os_string();
        name.push(".training");
        name.into()
    }

    pub(super) fn header(&self, magic: u64, from: &mut Loader) -> io::Result<()> {
        if from.value::<u64>()? != magic || from.value::<u32>()? != VERSION {
            return Err(damaged("it is no checkpoint of this version, or it"));
        }
        if from.value::<u64>()? != self.fingerprint {
            let text = "it is of another scene or other settings: render with those, or delete it";
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        Ok(())
    }

    pub(super) fn save_header(&self, magic: u64, to: &mut Saver) -> io::Result<()> {
        to.value(&magic)?;
        to.value(&VERSION)?;
        to.value(&self.fingerprint)
    }

    pub(super) fn fault(&self, file: &Path, error: &io::Error) -> Error {
        Error::File { file: file.display().to_string(), field: "checkpoint".into(), message: error.to_string() }
    }
}

/// A [`Keep`] in use.
pub(super) struct Keeper<'a> {
    keep: &'a Keep,
    last: Mutex<Instant>,
}

impl<'a> Keeper<'a> {
    pub fn keep(&self) -> &'a Keep {
        self.keep
    }

    pub fn new(keep: &'a Keep) -> Self {
        keep.begin();
        Self { keep, last: Mutex::new(Instant::now()) }
    }
}

impl Run<'_> {
    /// Whether it is time for a checkpoint.
    pub(super) fn is_due(&self) -> bool {
        self.keeper.as_ref().is_some_and(|keeper| locked(&keeper.last).elapsed() >= keeper.keep.every)
    }

    /// A stop is a reason to come back, a time limit is not.
    pub(super) fn keep_if_stopped(&self, film: &Film, schedule: &Schedule, at: &Passes) {
        if self.progress.stopped() {
            self.keep(film, schedule, at);
        }
    }

    /// Writes a checkpoint, if they are asked for; no tile may be under way. A failure costs the checkpoint, not the
    /// render.
    pub(super) fn keep(&self, film: &Film, schedule: &Schedule, at: &Passes) {
        let Some(keeper) = &self.keeper else { return };
        let written = replace(&keeper.keep.file, |writer| self.save(writer, keeper.keep, film, schedule, at));
        let mut report = locked(&self.progress.report);
        match written {
            Ok(()) => report.checkpoints.push(self.start.elapsed().as_secs_f64()),
            Err(error) => report.warnings.push(keeper.keep.fault(&keeper.keep.file, &error).to_string()),
        }
        *locked(&keeper.last) = Instant::now();
    }

    fn save(
        &self,
        writer: &mut dyn Write,
        keep: &Keep,
        film: &Film,
        schedule: &Schedule,
        at: &Passes,
    ) -> io::Result<()> {
        let mut to = Saver(writer);
        keep.save_header(MAGIC, &mut to)?;
        to.value(&self.points)?;
        to.value(&u32::from(schedule.phase == Phase::Pilot))?;
        to.array(&schedule.budget)?;
        to.value(&at.done)?;
        to.value(&self.progress.stats())?;
        to.value(&self.learned.learned_passes)?;
        to.value(&self.finished.load(Ordering::Relaxed))?;
        let adaptive = serde_json::to_vec(&locked(&self.progress.report).adaptive)?;
        to.array(&adaptive)?;
        self.guide.save(&mut to)?;
        locked(&at.merger).save(&mut to)?;
        film.save(&mut to)?;
        to.value(&END)
    }

    /// Goes on from the checkpoint, if one is asked for and there; `film` is that of a phase.
    pub(super) fn resume<'f>(
        &mut self,
        film: impl FnOnce(Phase) -> &'f Film,
        at: &mut (Passes, Schedule),
    ) -> Result<()> {
        let Some(keep) = self.keeper.as_ref().map(|keeper| keeper.keep) else { return Ok(()) };
        if !keep.has_samples() {
            return Ok(());
        }
        let load = || self.load(&mut Loader(&mut BufReader::new(File::open(&keep.file)?)), keep, film, at);
        load().map_err(|error| keep.fault(&keep.file, &error))
    }

    fn load<'f>(
        &mut self,
        from: &mut Loader,
        keep: &Keep,
        film: impl FnOnce(Phase) -> &'f Film,
        (passes, schedule): &mut (Passes, Schedule),
    ) -> io::Result<()> {
        keep.header(MAGIC, from)?;
        from.value::<u32>()?; // training has asked for it
        let phase = if from.value::<u32>()? == 1 { Phase::Pilot } else { Phase::Image };
        if phase != schedule.phase {
            *schedule = Schedule::image(self.settings, schedule.budget.clone());
        }
        from.array(&mut schedule.budget)?;
        passes.done = from.value()?;
        // Training was counted when it was done first.
        *locked(&self.progress.stats) = from.value()?;
        self.learned.learned_passes = from.value()?;
        self.finished.store(from.value()?, Ordering::Relaxed);
        let adaptive: Option<Adaptive> = serde_json::from_slice(&from.bytes(1 << 16)?)?;
        self.guide.load(from)?;
        *locked(&passes.merger) = Merger::load(from)?;
        let film = film(phase);
        film.load(from)?;
        if from.value::<u64>()? != END {
            return Err(damaged("its end"));
        }
        let mut report = locked(&self.progress.report);
        report.adaptive = adaptive;
        report.resumed = Some(film.samples_per_pixel());
        Ok(())
    }
}

impl Merger {
    fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.count(self.next)?;
        self.merged.save(to)?;
        to.count(self.waiting.len())?;
        for (tile, seen) in &self.waiting {
            to.count(*tile)?;
            seen.save(to)?;
        }
        Ok(())
    }

    fn load(from: &mut Loader) -> io::Result<Self> {
        let (next, merged) = (from.count()?, Statistics::load(from)?);
        let waiting =
            (0..from.count()?).map(|_| Ok((from.count()?, Statistics::load(from)?))).collect::<io::Result<_>>()?;
        Ok(Self { merged, next, waiting })
    }
}

/// Writes beside `file`, then renames. The temporary name is always the same: what a killed process left of it is
/// written over.
fn replace(file: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".tmp");
    let temporary = file.with_file_name(name);
    let mut writer = BufWriter::with_capacity(1 << 20, File::create(&temporary)?);
    let written = write(&mut writer).and_then(|()| writer.flush()).and_then(|()| fs::rename(&temporary, file));
    if written.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    written
}
