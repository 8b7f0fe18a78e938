//! `make bench-rays`: dermis beside Embree on the same rays, one thread, interleaved.
//!
//! Every set of rays is cut into chunks; each chunk goes through dermis, Embree's robust and Embree's default mode
//! in turn, in rotating order, pass after pass. The time of a chunk is the least of all passes, which leaves out
//! what else the machine did meanwhile. Primary, diffuse and shadow rays of dermis take the way of a render
//! (`Scene::closest`, `Scene::occluded`: two levels even for a single mesh, which Embree has as one), walk segments
//! that of a walk (`Scene::boundary_from_within`; among instances `Scene::closest` on both sides).
//!
//! Hits are compared first: a row with more than one mismatch in 10,000 rays fails the run.

mod embree;
mod rays;
#[allow(dead_code)] // bench-steps has use for the rest
mod subject;

use dermis::scene::accel::{Blas, Ray};
use embree::{Embree, EmbreeScene, Mode};
use rays::RaySets;
use std::path::PathBuf;
use std::process::ExitCode;
use subject::{Subject, TriangleMesh, cloud};

const USAGE: &str = "usage: rays [--embree libembree4.so] [--passes N] [--only NAME] SCENE.dermis...";

/// Rays between two looks at the clock: a millisecond, about.
const CHUNK: usize = 1024;

/// Hits agree where dt is below this share of the distance, or below `ROUNDING` of the scene's size: the error of t
/// at grazing angles is that of a position over the cosine.
const TOLERANCE: f32 = 1e-3;
const ROUNDING: f32 = 4e-6;

/// Share of rays that may disagree: those that pass an open edge within rounding. A soup is open edges only.
const MISMATCHES: f64 = 1e-4;

struct Arguments {
    embree: Option<PathBuf>,
    passes: usize,
    only: Option<String>,
    scenes: Vec<PathBuf>,
}

impl Arguments {
    fn parse() -> Result<Self, String> {
        let mut parsed = Self { embree: None, passes: 20, only: None, scenes: Vec::new() };
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument}: a value is missing"));
            match argument.as_str() {
                "--bench" => {} // cargo bench says so
                "--embree" => parsed.embree = Some(value()?.into()).filter(|p: &PathBuf| !p.as_os_str().is_empty()),
                "--passes" => parsed.passes = value()?.parse().map_err(|e| format!("--passes: {e}"))?,
                "--only" => parsed.only = Some(value()?),
                name if name.starts_with('-') => return Err(format!("{name}: no such flag; {USAGE}")),
                file => parsed.scenes.push(file.into()),
            }
        }
        if parsed.scenes.is_empty() { Err(USAGE.into()) } else { Ok(parsed) }
    }
}

fn main() -> ExitCode {
    match Arguments::parse().and_then(|arguments| run(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("bench-rays: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let path = arguments.embree.as_ref().ok_or(
        "no Embree to compare with: PyPI's embreex could not be installed here (pip install embreex), or --embree \
         does not name its libembree4.so",
    )?;
    let embree = Embree::load(path)?;
    println!(
        "Embree {}, one thread; Mrays/s of processor time, best of {} interleaved passes per chunk of {CHUNK} rays",
        embree.version(),
        arguments.passes
    );
    println!(
        "{:<16} {:>9} {:>8} {:>8} {:>8} {:>8} {:>9} {:>12}",
        "mesh", "rays", "count", "dermis", "robust", "default", "mismatch", "ratio spread"
    );
    let mut ratios = Vec::new();
    let mut builds = Vec::new();
    let mut wrong = Vec::new();
    for (name, make) in subjects(&arguments.scenes) {
        if arguments.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let subject = make()?;
        let row = Row::measure(&subject, &embree, arguments.passes);
        row.sets.iter().filter(|set| set.mismatches as f64 > (set.rays as f64 * MISMATCHES).max(1.0)).for_each(|set| {
            wrong.push(format!("{name} {}: {} of {} rays", set.name, set.mismatches, set.rays));
        });
        ratios.push(row.ratio(&name));
        builds.push(row.build);
    }
    println!(
        "\n{:<16} {:>9} | build, s: {:>6} {:>6} {:>6} | bytes/triangle: {:>5} {:>5} {:>6} {:>7}",
        "mesh", "triangles", "dermis", "robust", "default", "BVH", "in all", "robust", "default"
    );
    builds.iter().for_each(|line| println!("{line}"));
    println!();
    ratios.iter().for_each(|line| println!("{line}"));
    if wrong.is_empty() { Ok(()) } else { Err(format!("hits differ from Embree's: {}", wrong.join("; "))) }
}

type Make<'a> = Box<dyn FnOnce() -> Result<Subject, String> + 'a>;

/// The rows; the smooth mesh is the first scene's, subdivided.
fn subjects(scenes: &[PathBuf]) -> Vec<(String, Make<'_>)> {
    let mut all: Vec<(String, Make)> = Vec::new();
    for file in scenes {
        let name = file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        all.push((name.clone(), Box::new(move || Ok(Subject::single(&name, TriangleMesh::load(file)?)))));
    }
    all.push((
        "smooth_1m".into(),
        Box::new(|| {
            let mut mesh = TriangleMesh::load(&scenes[0])?;
            while mesh.triangles.len() < 500_000 {
                mesh = mesh.subdivide();
            }
            Ok(Subject::single("smooth_1m", mesh))
        }),
    ));
    all.push(("soup_1m".into(), Box::new(|| Ok(Subject::single("soup_1m", TriangleMesh::soup(1_000_000, 0.02))))));
    all.push((
        "instances_1k".into(),
        Box::new(|| Ok(Subject::placed("instances_1k", TriangleMesh::load(&scenes[0])?, cloud(1000)))),
    ));
    all
}

/// One set of rays through all three.
struct Set {
    name: &'static str,
    rays: usize,
    mismatches: usize,
    /// Rays per microsecond: dermis, robust, default.
    speed: [f64; 3],
}

struct Row {
    sets: Vec<Set>,
    build: String,
}

impl Row {
    fn measure(subject: &Subject, embree: &Embree, passes: usize) -> Self {
        let (robust, default) = (Built::new(embree, Mode::Robust, subject), Built::new(embree, Mode::Default, subject));
        let build = build_line(subject, &robust, &default);
        let rays = RaySets::new(subject, 1.0);
        let (scene, size) = (subject.scene.at(0.0), rays.size);
        let closest = |r: &Ray| scene.closest(r.o, r.d, r.t_max, None).map_or(f32::INFINITY, |hit| hit.t);
        let within = |r: &Ray| {
            scene
                .boundary_from_within(0, r.o - scene.instances[0].to_render.translation, r.d, r.t_max)
                .map_or(f32::INFINITY, |hit| hit.t)
        };
        let any = |r: &Ray| if scene.occluded(r.o, r.d, r.t_max, None) { 0.0 } else { f32::INFINITY };
        let hit = |s: &EmbreeScene, r: &Ray| s.closest(r);
        let peers = [robust.scene(), default.scene()];
        let mut sets = vec![
            Set::measure("primary", &rays.primary, passes, size, closest, peers, hit),
            Set::measure("diffuse", &rays.diffuse, passes, size, closest, peers, hit),
        ];
        sets.push(if scene.instances.len() == 1 {
            Set::measure("walk", &rays.walk, passes, size, within, peers, hit)
        } else {
            Set::measure("walk", &rays.walk, passes, size, closest, peers, hit)
        });
        let shadow = |s: &EmbreeScene, r: &Ray| if s.occluded(r) { 0.0 } else { f32::INFINITY };
        sets.push(Set::measure("shadow", &rays.diffuse, passes, size, any, peers, shadow));
        sets.iter().for_each(|set| set.print(&subject.name));
        Self { sets, build }
    }

    fn ratio(&self, name: &str) -> String {
        let [primary, diffuse, walk] = [0, 1, 2].map(|i| self.sets[i].speed[0] / self.sets[i].speed[1]);
        format!("ratio {name} primary={primary:.2} diffuse={diffuse:.2} walk={walk:.2}")
    }
}

impl Set {
    /// `dermis` and `peer` give t, infinite for a miss.
    fn measure(
        name: &'static str,
        rays: &[Ray],
        passes: usize,
        size: f32,
        dermis: impl Fn(&Ray) -> f32,
        [robust, default]: [&EmbreeScene; 2],
        peer: impl Fn(&EmbreeScene, &Ray) -> f32,
    ) -> Self {
        let mismatches = rays.iter().filter(|ray| !agree(dermis(ray), peer(robust, ray), ray.t_max, size)).count();
        let mut best = vec![[f64::INFINITY; 3]; rays.len().div_ceil(CHUNK)];
        for pass in 0..passes {
            for (i, (chunk, best)) in rays.chunks(CHUNK).zip(&mut best).enumerate() {
                for turn in 0..3 {
                    let who = (turn + pass + i) % 3;
                    let seconds = match who {
                        0 => time(chunk, &dermis),
                        1 => time(chunk, |ray| peer(robust, ray)),
                        _ => time(chunk, |ray| peer(default, ray)),
                    };
                    best[who] = best[who].min(seconds);
                }
            }
        }
        let speed = [0, 1, 2].map(|who| rays.len() as f64 / best.iter().map(|b| b[who]).sum::<f64>() * 1e-6);
        Self { name, rays: rays.len(), mismatches, speed }
    }

    fn print(&self, mesh: &str) {
        let [dermis, robust, default] = self.speed;
        println!(
            "{mesh:<16} {:>9} {:>8} {dermis:>8.2} {robust:>8.2} {default:>8.2} {:>9} {:>5.2} {:>5.2}",
            self.name,
            self.rays,
            self.mismatches,
            dermis / robust,
            dermis / default
        );
    }
}

/// Seconds of this thread's processor time for a chunk.
fn time(rays: &[Ray], cast: impl Fn(&Ray) -> f32) -> f64 {
    let start = thread_seconds();
    let hits = rays.iter().filter(|ray| cast(ray) < f32::INFINITY).count();
    std::hint::black_box(hits);
    thread_seconds() - start
}

/// Processor time of this thread: others that use the machine do not count, but for the caches they empty.
fn thread_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the clock exists and writes one timespec.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Whether two distances name the same hit in a scene of that size. One that is that near the end may be missed.
fn agree(a: f32, b: f32, t_max: f32, size: f32) -> bool {
    let (a, b) = (a.min(t_max), b.min(t_max));
    a == b || (a - b).abs() <= (TOLERANCE * a.min(b)).max(ROUNDING * size)
}

/// Embree's scene: a mesh, and its instances where there are several.
struct Built<'a> {
    mesh: EmbreeScene<'a>,
    top: Option<EmbreeScene<'a>>,
    /// Of the mesh.
    seconds: f64,
}

impl<'a> Built<'a> {
    fn new(embree: &'a Embree, mode: Mode, subject: &Subject) -> Self {
        let build = || embree.triangles(mode, &subject.mesh.points, &subject.mesh.triangles);
        let (mesh, seconds) = best_of_three(build);
        let places = Vec::from_iter(subject.scene.instances.iter().map(|i| i.to_render));
        let top = (places.len() > 1).then(|| embree.instances(mode, &mesh, &places));
        Self { mesh, top, seconds }
    }

    fn scene(&self) -> &EmbreeScene<'a> {
        self.top.as_ref().unwrap_or(&self.mesh)
    }
}

fn best_of_three<T>(build: impl Fn() -> T) -> (T, f64) {
    let mut best = f64::INFINITY;
    let mut built = None;
    for _ in 0..3 {
        drop(built.take());
        let start = thread_seconds();
        built = Some(build());
        best = best.min(thread_seconds() - start);
    }
    (built.expect("built three times"), best)
}

fn build_line(subject: &Subject, robust: &Built, default: &Built) -> String {
    let mesh = &subject.mesh;
    let (blas, seconds) = best_of_three(|| Blas::build(&mesh.points, &mesh.triangles));
    let per_triangle = |bytes: usize| bytes as f64 / mesh.triangles.len() as f64;
    format!(
        "{:<16} {:>9} |           {seconds:>6.3} {:>6.3} {:>6.3} |                 {:>5.1} {:>5.1} {:>6.1} {:>7.1}",
        subject.name,
        mesh.triangles.len(),
        robust.seconds,
        default.seconds,
        per_triangle(blas.memory()),
        per_triangle(subject.scene.instances[0].geometry.memory()),
        per_triangle(robust.mesh.bytes),
        per_triangle(default.mesh.bytes),
    )
}
