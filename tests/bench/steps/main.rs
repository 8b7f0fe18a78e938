//! `make bench-steps`: what a step of a walk costs in the bodies of scenes, one thread, interleaved.
//!
//! Each body is scaled to a diagonal of 1 and filled with grey media (albedo 0.99, isotropic) of several mean free paths.
//! Classical walks, walks along the normal of their entry (guided) and walks of the exact mixture of both, one in ten of them
//! classical, start all over it. The same walks are timed twice: as a
//! render takes them, and with the answers of the geometry read from a list, which leaves sampling and weights. The time of
//! a chunk is the least processor time of all passes. Walks must end alike to the bit.

#[allow(dead_code)] // bench-rays has more use for it
#[path = "../rays/subject.rs"]
mod subject;

use dermis::math::Frame;
use dermis::sampling::cosine_hemisphere;
use dermis::sampling::sampler::Sampler;
use dermis::scene::{BoundaryHit, InstanceEnclosure};
use dermis::subsurface::mixture::{Visitor, walk_mixture};
use dermis::subsurface::steps::{Enclosure, Start, WalkEnd, WalkStats};
use dermis::subsurface::technique::{GuidedMedium, PerTechnique, Techniques};
use dermis::subsurface::walk::{Along, walk};
use glam::{Vec2, Vec3};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use subject::{Random, Subject, TriangleMesh};

/// Of the diagonal.
const MEAN_FREE_PATHS: [u32; 6] = [20, 50, 100, 200, 400, 1000];
const ALBEDO: f32 = 0.99;
const WALKS: usize = 8192;
const CHUNK: usize = 64;

type Hit = Option<(f32, BoundaryHit)>;

fn main() -> ExitCode {
    let mut passes = 5;
    let mut scenes: Vec<PathBuf> = Vec::new();
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench"); // cargo bench says so
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), argument.starts_with('-')) {
            ("--passes", _) => match arguments.next().and_then(|value| value.parse().ok()) {
                Some(value) => passes = value,
                None => return usage("--passes: a number is missing"),
            },
            (_, true) => return usage(&format!("{argument}: no such flag")),
            _ => scenes.push(argument.into()),
        }
    }
    if scenes.is_empty() {
        return usage("no scene");
    }
    println!(
        "{:<16} {:>6} {:<9} {:>6} {:>8} {:>9} {:>6}",
        "body", "path", "walk", "steps", "ns/step", "sampling", "casts"
    );
    match scenes.iter().try_for_each(|file| body(file, passes)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => usage(&message),
    }
}

fn usage(message: &str) -> ExitCode {
    eprintln!("bench-steps: {message}; usage: steps [--passes N] SCENE.dermis...");
    ExitCode::FAILURE
}

/// All rows of one body.
fn body(file: &Path, passes: usize) -> Result<(), String> {
    let name = file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let mesh = TriangleMesh::load(file)?;
    for paths in MEAN_FREE_PATHS {
        let subject = Subject::filled(&name, mesh.clone(), 1.0 / paths as f32, ALBEDO);
        let enclosure = InstanceEnclosure::new(subject.scene.at(0.0), 0);
        let medium = GuidedMedium::new(subject.scene.surfaces[0].interior.ok_or("no medium")?.medium);
        let starts = starts(&enclosure, mesh.triangles.len());
        for kind in [Kind::Classical, Kind::Guided, Kind::Mixture] {
            let row = Row::measure(&enclosure, &medium, kind, &starts, passes);
            let [all, sampling] = row.nanoseconds;
            println!(
                "{name:<16} {:>6} {:<9} {:>6.1} {all:>8.1} {sampling:>9.1} {:>6.1}",
                format!("1/{paths}"),
                format!("{kind:?}").to_lowercase(),
                row.steps,
                all - sampling,
            );
        }
    }
    Ok(())
}

/// Inward by the cosine, in the order of the triangles, neighbours of which are neighbours.
fn starts(enclosure: &InstanceEnclosure, triangles: usize) -> Vec<Start<BoundaryHit>> {
    let mut random = Random(5);
    let start = |i: usize| {
        let triangle = (i * triangles / WALKS) as u32;
        let hit = BoundaryHit { instance: 0, triangle, u: random.unit() * 0.5, v: random.unit() * 0.5 };
        let (p, normal) = (enclosure.point(&hit), enclosure.normal(&hit));
        let up = cosine_hemisphere(Vec2::new(random.unit(), random.unit()));
        Start { p, d: -Frame::from_normal(normal).to_world(up), normal, hit, weight: Vec3::ONE }
    };
    (0..WALKS).map(start).collect()
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Classical,
    Guided,
    Mixture,
}

struct Row {
    /// Per walk.
    steps: f64,
    /// Per step: as in a render, and without geometry.
    nanoseconds: [f64; 2],
}

impl Row {
    fn measure(
        enclosure: &InstanceEnclosure,
        medium: &GuidedMedium,
        kind: Kind,
        starts: &[Start<BoundaryHit>],
        passes: usize,
    ) -> Self {
        let (mut steps, mut best) = (0, [0.0; 2]);
        for (chunk, starts) in starts.chunks(CHUNK).enumerate() {
            let seed = chunk as u32;
            let recorder = Recorder { of: enclosure, seen: RefCell::default() };
            let expected = walks(&recorder, medium, kind, starts, seed);
            let seen = recorder.seen.into_inner();
            steps += expected.0;
            let mut least = [f64::INFINITY; 2];
            for pass in 0..passes {
                for turn in 0..2 {
                    let who = (turn + pass) % 2;
                    let begin = thread_seconds();
                    let got = match who {
                        0 => walks(enclosure, medium, kind, starts, seed),
                        _ => walks(
                            &Replay { of: enclosure, seen: &seen, next: Cell::new(0) },
                            medium,
                            kind,
                            starts,
                            seed,
                        ),
                    };
                    least[who] = least[who].min(thread_seconds() - begin);
                    assert_eq!(got, expected, "walks differ");
                }
            }
            (0..2).for_each(|who| best[who] += least[who]);
        }
        Self { steps: steps as f64 / starts.len() as f64, nanoseconds: best.map(|s| s * 1e9 / steps as f64) }
    }
}

/// Steps of these walks, and the bits of where they end.
fn walks<E: Enclosure<Hit = BoundaryHit>>(
    enclosure: &E,
    medium: &GuidedMedium,
    kind: Kind,
    starts: &[Start<BoundaryHit>],
    seed: u32,
) -> (u64, u64) {
    let (mut stats, mut bits) = (WalkStats::default(), 0_u64);
    let mut sampler = Sampler::new(seed, 0, 0);
    for &start in starts {
        let along = |along, sampler: &mut Sampler, stats: &mut WalkStats| {
            walk(enclosure, &medium.medium, along, start, false, sampler, stats, |_, _| None, |_, _| ())
        };
        let end = match kind {
            Kind::Classical => along(Along::None, &mut sampler, &mut stats),
            Kind::Guided => {
                let (kernels, normal) = (&medium.kernels, start.normal);
                along(Along::Fixed { kernels, normal, first_distance: true }, &mut sampler, &mut stats)
            }
            Kind::Mixture => {
                let (techniques, u) = (mixture(start.normal), sampler.random());
                let visitor = &mut Unlit;
                walk_mixture(enclosure, medium, techniques, start, u, &mut sampler, &mut stats, visitor).end
            }
        };
        if let WalkEnd::Boundary { hit, p, weight, .. } = end {
            for value in [p.x, p.y, p.z, weight.x, hit.u, hit.v] {
                bits = bits.rotate_left(7) ^ u64::from(value.to_bits());
            }
            bits ^= u64::from(hit.triangle) << 32;
        }
    }
    (stats.steps, bits)
}

/// Along the normal of the entry, one in ten classical.
fn mixture(normal: Vec3) -> Techniques {
    let mut techniques = Techniques { guided_first: true, ..Techniques::default() };
    techniques.set_normal(0, normal);
    let mut shares = PerTechnique { classical: [0.1 / 3.0; 3], ..PerTechnique::default() };
    shares.guided.iter_mut().for_each(|channel| channel[0] = 0.9 / 3.0);
    Techniques { shares, ..techniques }
}

/// No light at collisions.
struct Unlit;

impl Visitor for Unlit {
    const AT_COLLISIONS: bool = false;
}

/// Notes what the geometry answers.
struct Recorder<'a> {
    of: &'a InstanceEnclosure<'a>,
    seen: RefCell<Vec<Hit>>,
}

/// Answers as noted.
struct Replay<'a> {
    of: &'a InstanceEnclosure<'a>,
    seen: &'a [Hit],
    next: Cell<usize>,
}

impl Enclosure for Recorder<'_> {
    type Hit = BoundaryHit;

    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<BoundaryHit>) -> Hit {
        let hit = self.of.cast(p, d, t_max, from);
        self.seen.borrow_mut().push(hit);
        hit
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        self.of.bounds_contain(p)
    }

    fn position_error(&self) -> f32 {
        self.of.position_error()
    }
}

impl Enclosure for Replay<'_> {
    type Hit = BoundaryHit;

    fn cast(&self, _: Vec3, _: Vec3, _: f32, _: Option<BoundaryHit>) -> Hit {
        let i = self.next.get();
        self.next.set(i + 1);
        self.seen[i]
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        self.of.bounds_contain(p)
    }

    fn position_error(&self) -> f32 {
        self.of.position_error()
    }
}

/// Processor time of this thread: others that use the machine do not count, but for the caches they empty.
fn thread_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the clock exists and writes one timespec.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
