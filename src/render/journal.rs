//! What training finds, in a file beside the checkpoint: a render that was killed while it trained takes it from there.
//!
//! Finds are appended chunk by chunk, in the order in which they are looked for. A journal that ends early, or none, costs
//! time, never the image: what is missing is looked for again.

use super::checkpoint::Keep;
use crate::error::Error;
use crate::guiding::beams::Beam;
use crate::guiding::cache::Record;
use crate::integrator::PathStats;
use crate::saved::{Digest, Loader, Saver, damaged};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::ops::Range;

/// First number of the file, as [`super::checkpoint::MAGIC`].
pub(super) const JOURNAL: u64 = u64::from_le_bytes(*b"DERMISTR");

/// Points that are looked at for one chunk: a fraction of a second.
const CHUNK: u32 = 4096;

/// Longest chunk, in bytes: above it a length is damage.
const LONGEST: u64 = 1 << 30;

/// What can be found at points of a boundary.
pub(super) trait Find: Sized {
    fn save(&self, to: &mut Saver) -> io::Result<()>;
    fn load(from: &mut Loader) -> io::Result<Self>;
}

/// The finds of one training.
#[derive(Default)]
pub(super) struct Journal<'a> {
    keep: Option<&'a Keep>,
    file: Option<File>,
    /// There may be finds of a former process ahead.
    reads: bool,
    /// Finds that came from there.
    pub resumed: u64,
    /// Why what is found is no longer kept.
    pub fault: Option<Error>,
}

impl<'a> Journal<'a> {
    /// Without `keep` nothing is kept.
    pub fn new(keep: Option<&'a Keep>) -> Self {
        Self { keep, ..Self::default() }
    }

    /// Goes on from the file if that is asked for and it fits, else begins it anew.
    fn open(&mut self, keep: &Keep) -> io::Result<File> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(keep.journal())?;
        self.reads = keep.resume && keep.header(JOURNAL, &mut Loader(&mut file)).is_ok();
        if !self.reads {
            file.set_len(0)?;
            file.rewind()?;
            let mut header = Vec::new();
            keep.save_header(JOURNAL, &mut Saver(&mut header))?;
            file.write_all(&header)?;
        }
        Ok(file)
    }

    /// What `look` finds at `count` points, in their order; `None`: it `is_over` before all were looked at.
    pub fn gather<T: Find>(
        &mut self,
        count: u32,
        is_over: impl Fn() -> bool,
        look: impl Fn(Range<u32>) -> (Vec<T>, PathStats),
    ) -> Option<(Vec<T>, PathStats)> {
        let (mut all, mut stats) = (Vec::new(), PathStats::default());
        for begin in (0..count).step_by(CHUNK as usize) {
            if is_over() {
                return None;
            }
            let (mut found, seen) = self.next(|| look(begin..count.min(begin + CHUNK)));
            all.append(&mut found);
            stats.add(&seen);
        }
        Some((all, stats))
    }

    /// Begins a training that looks at `points`, or goes on with one that looks at a number which `suits`; that number.
    pub fn begin(&mut self, points: u32, suits: impl Fn(u32) -> bool) -> u32 {
        let Some(keep) = self.keep else { return points };
        match self.open(keep) {
            Ok(file) => self.file = Some(file),
            Err(error) => self.give_up(&error),
        }
        let begin = self.file.as_mut().and_then(|file| file.stream_position().ok());
        let kept = self.kept::<u32>().and_then(|(kept, _)| kept.first().copied());
        self.resumed = 0; // the number is no find
        if let Some(kept) = kept.filter(|&kept| suits(kept)) {
            return kept;
        }
        if let (Some(_), Some(begin)) = (kept, begin) {
            self.forget_from(begin);
        }
        self.append(&[points], &PathStats::default());
        points
    }

    fn next<T: Find>(&mut self, look: impl FnOnce() -> (Vec<T>, PathStats)) -> (Vec<T>, PathStats) {
        self.kept().unwrap_or_else(|| {
            let found = look();
            self.append(&found.0, &found.1);
            found
        })
    }

    /// The next chunk of a former process. From the first that is not whole on everything is looked for.
    fn kept<T: Find>(&mut self) -> Option<(Vec<T>, PathStats)> {
        let file = self.file.as_mut().filter(|_| self.reads)?;
        let begin = file.stream_position().ok()?;
        let chunk = read_chunk(file).and_then(|bytes| decode(&bytes));
        match chunk {
            Ok((found, stats)) => {
                self.resumed += found.len() as u64;
                Some((found, stats))
            }
            Err(_) => {
                self.forget_from(begin);
                None
            }
        }
    }

    fn forget_from(&mut self, begin: u64) {
        self.reads = false;
        if let Some(file) = &mut self.file {
            // Where that fails, so will the next write, which says so.
            let _ = file.set_len(begin).and_then(|()| file.seek(io::SeekFrom::Start(begin)));
        }
    }

    fn append<T: Find>(&mut self, found: &[T], stats: &PathStats) {
        let Some(file) = &mut self.file else { return };
        if let Err(error) = encode(found, stats).and_then(|bytes| write_chunk(file, &bytes)) {
            self.give_up(&error);
        }
    }

    /// What cannot be kept costs time if the render is killed, not the render.
    fn give_up(&mut self, error: &io::Error) {
        self.fault = self.keep.take().map(|keep| keep.fault(&keep.journal(), error));
        self.file = None;
    }
}

fn write_chunk(file: &mut File, bytes: &[u8]) -> io::Result<()> {
    let mut to = Saver(file);
    to.value(&digest(bytes)?)?;
    to.array(bytes)
}

fn read_chunk(file: &mut File) -> io::Result<Vec<u8>> {
    let mut from = Loader(file);
    let wanted: u64 = from.value()?;
    let length = Some(from.count()? as u64).filter(|&length| length <= LONGEST).ok_or_else(|| damaged("a chunk"))?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes)?;
    if bytes.len() as u64 == length && digest(&bytes)? == wanted { Ok(bytes) } else { Err(damaged("a chunk")) }
}

fn digest(bytes: &[u8]) -> io::Result<u64> {
    let mut digest = Digest::new();
    digest.write_all(bytes)?;
    Ok(digest.finish())
}

fn encode<T: Find>(found: &[T], stats: &PathStats) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut to = Saver(&mut bytes);
    to.value(stats)?;
    to.count(found.len())?;
    found.iter().try_for_each(|find| find.save(&mut to))?;
    Ok(bytes)
}

fn decode<T: Find>(mut bytes: &[u8]) -> io::Result<(Vec<T>, PathStats)> {
    let mut from = Loader(&mut bytes);
    let stats = from.value()?;
    let found = (0..from.count()?).map(|_| T::load(&mut from)).collect::<io::Result<_>>()?;
    Ok((found, stats))
}

/// How many points are looked at.
impl Find for u32 {
    fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.value(self)
    }

    fn load(from: &mut Loader) -> io::Result<Self> {
        from.value()
    }
}

impl Find for Beam {
    fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.value(self)
    }

    fn load(from: &mut Loader) -> io::Result<Self> {
        from.value()
    }
}

impl Find for Record {
    fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.value(&self.p)?;
        to.value(&self.n)?;
        to.value(&self.area)?;
        to.value(&self.irradiance)?;
        to.array(&self.lights)?;
        to.array(&self.directions)?;
        to.array(self.indirect.as_slice())
    }

    fn load(from: &mut Loader) -> io::Result<Self> {
        Ok(Self {
            p: from.value()?,
            n: from.value()?,
            area: from.value()?,
            irradiance: from.value()?,
            lights: from.vec()?,
            directions: from.vec()?,
            indirect: from.vec()?.pop(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use std::cell::Cell;
    use std::fs;
    use std::time::Duration;

    fn keep(resume: bool, fingerprint: u64) -> Keep {
        let name = format!("dermis_journal_{}_{:?}", std::process::id(), std::thread::current().id());
        Keep { file: std::env::temp_dir().join(name), every: Duration::ZERO, resume, fingerprint }
    }

    const POINTS: u32 = 2 * CHUNK + 100;

    /// What training finds with `keep`, and how many points it looked at.
    fn train(keep: Option<&Keep>) -> (Vec<Beam>, PathStats, u32, u64) {
        let looked = Cell::new(0);
        let mut journal = Journal::new(keep);
        assert_eq!(journal.begin(POINTS, |points| points == POINTS), POINTS);
        let look = |points: Range<u32>| {
            looked.set(looked.get() + points.len() as u32);
            let stats = PathStats { rays: points.len() as u64, ..PathStats::default() };
            let beam = |i: u32| Beam { p: Vec3::X, towards: Vec3::Y, length: i as f32, power: (i as f32).sqrt() };
            (points.map(beam).collect(), stats)
        };
        let (found, stats) = journal.gather(POINTS, || false, look).expect("all of it");
        assert!(journal.fault.is_none(), "{:?}", journal.fault);
        (found, stats, looked.get(), journal.resumed)
    }

    fn bits(found: &[Beam]) -> &[u8] {
        bytemuck::cast_slice(found)
    }

    #[test]
    fn killed_at_any_byte() {
        let (found, stats, ..) = train(None);
        let first = keep(false, 1);
        assert_eq!(train(Some(&first)).2, POINTS);
        let whole = fs::read(first.journal()).unwrap();
        let number = whole.len() / 200; // more than the number of points takes, less than a chunk
        let chunk = (whole.len() - 20) / 2; // a little more than one of them
        for (length, missing) in [
            (0, POINTS),
            (13, POINTS),
            (20, POINTS),
            (number, POINTS),
            (chunk / 2, POINTS),
            (chunk + 20, POINTS - CHUNK),
            (whole.len() - 1, 100),
            (whole.len(), 0),
        ] {
            fs::write(first.journal(), &whole[..length]).unwrap();
            let (again, counts, looked, resumed) = train(Some(&keep(true, 1)));
            assert_eq!(bits(&again), bits(&found), "{length} bytes");
            assert_eq!((counts, looked, resumed), (stats, missing, u64::from(POINTS - missing)), "{length} bytes");
            assert!(fs::read(first.journal()).unwrap() == whole, "{length} bytes: what was missing is there now");
        }
        fs::remove_file(first.journal()).unwrap();
    }

    #[test]
    fn others_and_damaged_ones_are_not_gone_on_from() {
        let first = keep(false, 1);
        train(Some(&first));
        assert_eq!(keep(true, 1).resumed().unwrap(), Some(first.journal()));
        assert!(keep(true, 2).resumed().unwrap_err().to_string().contains("another scene"));
        let mut bytes = fs::read(first.journal()).unwrap();
        bytes[1000] ^= 1;
        fs::write(first.journal(), &bytes).unwrap();
        let (found, _, looked, _) = train(Some(&keep(true, 1)));
        assert_eq!((bits(&found), looked), (bits(&train(None).0), POINTS));
        assert_eq!(train(Some(&keep(true, 2))).2, POINTS, "of another scene");
        assert_eq!(train(Some(&keep(false, 2))).2, POINTS, "not asked to go on");
        assert_eq!(train(Some(&keep(true, 2))).2, 0);
        fs::remove_file(first.journal()).unwrap();
        assert_eq!(keep(true, 2).resumed().unwrap(), None);
    }

    #[test]
    fn numbers_that_do_not_suit_begin_anew() {
        let first = keep(false, 3);
        train(Some(&first));
        let again = keep(true, 3);
        let number = |points, most| Journal::new(Some(&again)).begin(points, |kept| kept <= most);
        assert_eq!(number(100, POINTS), POINTS, "what is kept suits");
        assert_eq!(train(Some(&again)).2, 0);
        assert_eq!(number(100, 100), 100, "too many");
        assert_eq!(number(50, 100), 100);
        assert_eq!(train(Some(&again)).2, POINTS, "another number");
        fs::remove_file(first.journal()).unwrap();
    }

    #[test]
    fn what_cannot_be_kept_is_said() {
        let nowhere = Keep { file: "/nowhere/at/all".into(), ..keep(false, 1) };
        let mut journal = Journal::new(Some(&nowhere));
        let look = |points: Range<u32>| {
            let beam = |_| Beam { p: Vec3::X, towards: Vec3::Y, length: 1.0, power: 1.0 };
            (points.map(beam).collect(), PathStats::default())
        };
        assert_eq!(journal.begin(3, |_| false), 3);
        assert_eq!(journal.gather(3, || false, look).expect("all of it").0.len(), 3);
        assert!(journal.gather(3, || true, look).is_none());
        assert!(journal.fault.expect("a fault").to_string().starts_with("/nowhere/at/all.training: checkpoint: "));
    }
}
