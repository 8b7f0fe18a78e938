//! What each phase of a render takes: `phases FILE.dermis SAMPLES SAMPLES` loads a flattened scene, compiles it, renders
//! it twice, all in this thread, and prints seconds of CPU time and bytes of each phase as JSON.
//!
//! `make needs` runs it, also under callgrind, which counts instructions up to each call of [`phase_ends`].

use cpu_time::ThreadTime;
use dermis::delegate::RenderDelegate;
use dermis::film::Plane;
use dermis::flat::{self, RenderSettings};
use dermis::render::{Progress, film_for, render};
use dermis::scene::Scene;
use peak_alloc::PeakAlloc;
use serde_json::{Value, json};
use std::error::Error;
use std::hash::Hasher;
use std::path::PathBuf;

#[global_allocator]
static HEAP: PeakAlloc = PeakAlloc;

/// A name for callgrind's `--dump-before`.
#[inline(never)]
fn phase_ends() {
    std::hint::black_box(());
}

/// Does `work`; what it took, and what came of it.
fn phase<T>(name: &str, work: impl FnOnce() -> T) -> (Value, T) {
    let before = HEAP.current_usage();
    HEAP.reset_peak_usage();
    let start = ThreadTime::now();
    let done = work();
    let seconds = start.elapsed().as_secs_f64();
    phase_ends();
    let kept = HEAP.current_usage() as i64 - before as i64;
    let peak = HEAP.peak_usage() as i64 - before as i64;
    (json!({ "name": name, "seconds": seconds, "kept_bytes": kept, "peak_bytes": peak }), done)
}

/// All values of all planes, bit for bit.
fn fingerprint(planes: &[Plane]) -> u64 {
    let mut hasher = rustc_hash::FxHasher::default();
    planes.iter().flat_map(|plane| &plane.values).for_each(|value| hasher.write_u32(value.to_bits()));
    hasher.finish()
}

/// The image of `scene`, in planes that are dropped with all else at the end of the phase.
fn picture(scene: &Scene, settings: &RenderSettings) -> dermis::error::Result<u64> {
    let film = film_for(scene, settings)?;
    render(scene, settings, &film, &Progress::default(), None)?;
    let planes = film.resolve();
    Ok(fingerprint(&planes[..1]))
}

fn measure(file: PathBuf, samples: [u32; 2]) -> Result<Value, Box<dyn Error>> {
    let (loading, flat) = phase("load", || flat::file::load(&file));
    let flat = flat?;
    let mut delegate = RenderDelegate::new();
    let (compiling, compiled) = phase("compile", || {
        delegate = RenderDelegate::from_flat(flat);
        delegate.commit()
    });
    compiled?;
    let scene = delegate.scene().ok_or("nothing was compiled")?;
    let settings = samples.map(|samples| RenderSettings { samples, ..delegate.settings().clone() });
    let (short, first) = phase("short render", || picture(scene, &settings[0]));
    let (long, second) = phase("long render", || picture(scene, &settings[1]));
    let window = scene.camera.data_window;
    Ok(json!({
        "phases": [loading, compiling, short, long],
        "pixels": u64::from(window.width()) * u64::from(window.height()),
        "samples": samples,
        "images": [first?, second?],
        "needs": scene.needs,
        "avx2": avx2(),
    }))
}

/// Which path the boxes of the ray accelerator take.
fn avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    return false;
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, short, long] = &arguments[..] else { return Err("phases FILE.dermis SAMPLES SAMPLES".into()) };
    let samples = [short.parse()?, long.parse()?];
    // The pool is this thread alone: no other one idles, and spins, in the counts.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build()?;
    let found = pool.install(|| measure(file.into(), samples).map_err(|error| error.to_string()))?;
    println!("{found}");
    Ok(())
}
