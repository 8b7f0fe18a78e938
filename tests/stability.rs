//! The stability rows below the scene: walks against an f64 evaluation of the same walks, thick slabs, and deliberate
//! mistakes that the judges have to catch. `make stability` collects the lines that begin with `row:`.

mod support;

use dermis::math::Rgb;
use dermis::medium::{Medium, phase_eval, phase_sample};
use dermis::sampling::sampler::Sampler;
use dermis::subsurface::mixture::{Visitor, walk_mixture};
use dermis::subsurface::steps::{Enclosure, Start, WalkEnd, WalkStats};
use dermis::subsurface::technique::{GuidedMedium, TECHNIQUES, Techniques};
use dermis::subsurface::walk::{Along, walk};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::cell::RefCell;
use support::chi_square;
use support::in_f64::{Eigenfunction, Product, complement};
use support::slab::{Beam, Estimate, Row, Slab, failures, judge, stability_rows};
use support::ways::{Way, mixture, pass};

/// A line for the report: `measured` is to be within `tolerance` and noise of `expected`.
fn report(stressed: &str, walk: &str, source: &str, expected: f64, measured: f64, error: f64, tolerance: f64) {
    let row = serde_json::json!({
        "stressed": stressed, "walk": walk, "source": source, "expected": expected, "measured": measured,
        "error": error, "tolerance": tolerance,
    });
    println!("row: {row}");
}

/// A slab that notes the segments that it is asked about. Without rounding errors to care for, the walk asks about every
/// segment with its length as drawn.
struct Recorder {
    slab: Slab,
    segments: RefCell<Vec<Segment>>,
}

/// Direction, the distance drawn, that of the boundary if it came first.
#[derive(Clone, Copy)]
struct Segment {
    d: Vec3,
    drawn: f32,
    boundary: Option<f32>,
}

impl Recorder {
    fn new(thickness: f32) -> Self {
        Self { slab: Slab { thickness }, segments: RefCell::default() }
    }
}

impl Enclosure for Recorder {
    type Hit = bool;

    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<bool>) -> Option<(f32, bool)> {
        let hit = self.slab.cast(p, d, t_max, from);
        self.segments.borrow_mut().push(Segment { d, drawn: t_max, boundary: hit.map(|(t, _)| t) });
        hit
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        self.slab.bounds_contain(p)
    }

    fn position_error(&self) -> f32 {
        0.0
    }
}

/// Eigenfunctions of a medium's kernels; kernels that are classical have none.
fn eigenfunctions(medium: &GuidedMedium) -> [Eigenfunction; 3] {
    [0, 1, 2].map(|c| {
        let kernel = &medium.kernels[c];
        let g = if kernel.kappa == 0.0 { 0.0 } else { f64::from(medium.medium.g) };
        Eigenfunction::new(f64::from(kernel.kappa), f64::from(kernel.alpha_hat), g)
    })
}

/// Channel choice of a walk with conditional weights: guiding.md 1.2, with the floor of `walk::MIN_CHOICE`.
fn choice(weight: DVec3, albedo: DVec3) -> DVec3 {
    let q = weight * albedo.max(DVec3::splat(f64::from(0.05_f32)));
    q / (q.x + q.y + q.z)
}

fn exp(v: DVec3) -> DVec3 {
    v.map(f64::exp)
}

/// Weight of a walk with conditional weights in f64, vertex by vertex, of roulette that it survived.
fn conditional_in_f64(medium: &GuidedMedium, normal: Option<Vec3>, segments: &[Segment]) -> DVec3 {
    let (sigma, albedo) = (medium.medium.sigma_t.as_dvec3(), medium.medium.albedo.as_dvec3());
    let functions = eigenfunctions(medium);
    let stretches = |w: Vec3| {
        normal.map_or(DVec3::ONE, |n| DVec3::from_array([0, 1, 2].map(|c| functions[c].stretch(complement(n, w)))))
    };
    let turned = |n: Vec3, d: Vec3, wi: Vec3| {
        DVec3::from_array([0, 1, 2].map(|c| {
            let (function, next) = (&functions[c], complement(n, wi));
            let phi = function.source(next) / function.stretch(next);
            f64::from(medium.kernels[c].alpha_hat) * phi / function.source(complement(n, d))
        }))
    };
    let threshold = if normal.is_some() { f64::from(1e-6_f32) } else { 1.0 };
    let mut weight = DVec3::ONE;
    let (mut choices, mut directions) = (choice(weight, albedo), DVec3::ONE);
    for (i, segment) in segments.iter().enumerate() {
        let rate = sigma * stretches(segment.d);
        if let Some(t) = segment.boundary.map(f64::from) {
            return weight * exp(-sigma * t) / choices.dot(directions * exp(-rate * t));
        }
        let t = f64::from(segment.drawn);
        weight *= albedo * sigma * exp(-sigma * t) / choices.dot(directions * rate * exp(-rate * t));
        weight /= (weight.max_element() / threshold).min(1.0);
        choices = choice(weight, albedo);
        let next = segments[i + 1].d;
        directions = normal.map_or(DVec3::ONE, |n| turned(n, segment.d, next));
    }
    panic!("a walk that ends at a boundary has it as its last segment");
}

/// Weight of a walk of the exact mixture in f64: densities multiplied up over vertices, roulette every 16 collisions.
fn exact_in_f64(medium: &GuidedMedium, techniques: &Techniques, segments: &[Segment]) -> DVec3 {
    let functions = eigenfunctions(medium);
    let techniques = techniques.tilted(Rgb::ONE);
    let mut product = Product {
        medium,
        techniques: &techniques,
        functions: &functions,
        p: [0.0; TECHNIQUES],
        f: DVec3::ZERO,
        collisions: 0,
    };
    let mut survived = 1.0;
    for (i, segment) in segments.iter().enumerate() {
        if let Some(t) = segment.boundary {
            product.pass(segment.d, f64::from(t));
            return product.weight() / survived;
        }
        product.pass(segment.d, f64::from(segment.drawn));
        product.collide(segment.d);
        if product.collisions.is_multiple_of(16) {
            let survival = product.weight().max_element() / survived / f64::from(0.1_f32);
            survived *= survival.min(1.0);
        }
        product.turn(segment.d, segments[i + 1].d);
    }
    panic!("a walk that ends at a boundary has it as its last segment");
}

/// How a recorded walk goes.
#[derive(Debug, Clone, Copy)]
enum Guide {
    Classical,
    /// Along the far face's normal.
    Far,
    Exact,
}

/// What is hard about a walk, its medium and slab, the worst relative error that its weights may have.
type Hard = (&'static str, Medium, f32, [f64; 3]);

/// Largest relative error of a displacement: a sum of up to a million steps, in f32.
const DISPLACEMENT: f64 = 1e-3;

fn hard_media() -> Vec<Hard> {
    let gray = |albedo: f32, g: f32| Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(albedo), g };
    let rgb = |sigma: [f32; 3], albedo: [f32; 3]| Medium { sigma_t: sigma.into(), albedo: albedo.into(), g: 0.0 };
    vec![
        ("albedo 1e-4", gray(1e-4, 0.0), 1.0, [1e-5; 3]),
        ("kappa at 1 - 2^-24 (albedo 0.05)", gray(0.05, 0.0), 10.0, [1e-5; 3]),
        ("kappa at 0.001 (albedo 1), thickness 100", gray(1.0, 0.0), 100.0, [1e-5, 1e-3, 1e-5]),
        ("albedo 0.99999, thickness 1000", gray(0.99999, 0.0), 1000.0, [1e-5, 1e-2, 1e-5]),
        ("g 0.95, albedo 0.99", gray(0.99, 0.95), 50.0, [1e-5, 1e-4, 1e-5]),
        ("g -0.9, albedo 0.9", gray(0.9, -0.9), 20.0, [1e-5; 3]),
        ("sigma_t 1:1000, albedo (0.9, 0.99, 0.5)", rgb([1000.0, 1.0, 10.0], [0.9, 0.99, 0.5]), 1.0, [1e-5; 3]),
        ("albedo (1, 0.5, 0)", rgb([1.0; 3], [1.0, 0.5, 0.0]), 20.0, [1e-5, 1e-4, 1e-5]),
    ]
}

/// Relative errors of the weight of one walk, and of its displacement; `None`: it did not arrive.
fn errors(medium: &GuidedMedium, thickness: f32, guide: Guide, seed: u32) -> Option<[f64; 2]> {
    struct Blind;
    impl Visitor for Blind {
        const AT_COLLISIONS: bool = false;
    }
    let recorder = Recorder::new(thickness);
    let mut sampler = Sampler::new(17, seed, 0);
    let d = Beam::Diffuse.direction(&mut sampler);
    let start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: Rgb::ONE };
    let stats = &mut WalkStats::default();
    let fixed = Along::Fixed { kernels: &medium.kernels, normal: Vec3::Z, first_distance: true };
    let techniques = mixture(4, 0.1, true);
    let end = match guide {
        Guide::Exact => {
            walk_mixture(&recorder, medium, techniques, start, sampler.next_1d(), &mut sampler, stats, &mut Blind).end
        }
        _ => {
            let along = if matches!(guide, Guide::Far) { fixed } else { Along::None };
            walk(&recorder, &medium.medium, along, start, false, &mut sampler, stats, |_, _| None, |_, _| ())
        }
    };
    let WalkEnd::Boundary { p, weight, .. } = end else { return None };
    let segments = recorder.segments.into_inner();
    let expected = match guide {
        Guide::Classical => conditional_in_f64(medium, None, &segments),
        Guide::Far => conditional_in_f64(medium, Some(Vec3::Z), &segments),
        Guide::Exact => exact_in_f64(medium, &techniques, &segments),
    };
    // Channels that carry less than f32 can hold beside the first are rounding by nature.
    let carried = (0..3).filter(|c| expected[*c] > 1e-30 * expected.max_element().max(1e-8));
    let off = carried.map(|c| (f64::from(weight[c]) / expected[c] - 1.0).abs()).fold(0.0, f64::max);
    let place = |s: &Segment| s.d.as_dvec3() * f64::from(s.boundary.unwrap_or(s.drawn));
    let exact: DVec3 = segments.iter().map(place).sum();
    Some([off, (p.as_dvec3() - exact).length() / exact.length()])
}

/// The weights of hard walks hold their digits: the same segments in f64, by products over vertices.
#[test]
fn walks_are_those_of_f64() {
    let mut failed = Vec::new();
    for (name, medium, thickness, allowed) in hard_media() {
        let guided = GuidedMedium::new(medium);
        for (guide, allowed) in [Guide::Classical, Guide::Far, Guide::Exact].into_iter().zip(allowed) {
            let walks = (0..2000).into_par_iter().filter_map(|i| errors(&guided, thickness, guide, i));
            let found: Vec<[f64; 2]> = walks.collect();
            assert!(!found.is_empty(), "{name} {guide:?}: no walk arrives");
            let [weight, place] = [0, 1].map(|k| found.iter().map(|e| e[k]).fold(0.0, f64::max));
            let way = format!("{guide:?}").to_lowercase();
            report(
                &format!("f32 weight of {} walks, worst relative error: {name}", found.len()),
                &way,
                "f64, product over the vertices of the same walk",
                0.0,
                weight,
                0.0,
                allowed,
            );
            report(
                &format!("f32 displacement, worst relative error: {name}"),
                &way,
                "f64 sum of the same segments",
                0.0,
                place,
                0.0,
                DISPLACEMENT,
            );
            // Also where the number is not one.
            if !(weight <= allowed && place <= DISPLACEMENT) {
                failed.push(format!("{name} {guide:?}: weight {weight:.1e}, place {place:.1e}"));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

fn fluxes(way: Way, row: &Row, medium: &GuidedMedium, walks: u32, seed: u32) -> [Estimate; 2] {
    let slab = Slab { thickness: row.tau };
    let of_block = |block: u32| {
        let mut fluxes = [Estimate::default(); 2];
        for i in 0..4096.min(walks) {
            let mut sampler = Sampler::new(seed, block, i);
            let d = row.beam.direction(&mut sampler);
            let (at_top, weight) = pass(way, &slab, medium, row.eta, d, Rgb::ONE, &mut sampler);
            fluxes[0].add(if at_top { weight } else { Rgb::ZERO });
            fluxes[1].add(if at_top { Rgb::ZERO } else { weight });
        }
        fluxes
    };
    let blocks: Vec<[Estimate; 2]> = (0..walks.div_ceil(4096)).into_par_iter().map(of_block).collect();
    let sum = |face: usize| {
        blocks.iter().fold(Estimate::default(), |a, b| Estimate {
            sum: a.sum + b[face].sum,
            squares: a.squares + b[face].squares,
            n: a.n + b[face].n,
        })
    };
    [sum(0), sum(1)]
}

fn gray(row: &Row) -> GuidedMedium {
    GuidedMedium::new(Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(row.alpha), g: row.g })
}

/// Both faces as z-tests.
fn tests_of(way: Way, row: &Row, found: [Estimate; 2]) -> Vec<(String, f64)> {
    let z = |(name, estimate, expected): (&str, Estimate, f64)| {
        (format!("{way:?} {} {name} {} of {expected}", row.label(), estimate.mean().x), estimate.z_of(0, expected, 0.0))
    };
    [("R", found[0], row.r), ("T", found[1], row.t)].map(z).into()
}

const FAR: Way = Way::Exact { normals: 2, classical: 0.1, guided_first: true };
/// Weighted as a mixture, of the classical technique alone: others take part of a wrong distance back.
const UNGUIDED: Way = Way::Exact { normals: 0, classical: 1.0, guided_first: true };
const CLASSICAL: Way = Way::Conditional { normal: Vec3::Z, first_distance: true, classical: 1.0 };

/// Slabs that no picture sees through: reflected and transmitted, and white ones a thousand mean free paths thick.
#[test]
#[ignore = "a minute; make stability runs it"]
fn thick_slabs() {
    let mut tests = Vec::new();
    for row in stability_rows().iter().filter(|row| row.eta == 1.0 && row.g == 0.0 && row.tau >= 100.0 && row.tau < 2e3)
    {
        let medium = gray(row);
        for (name, way) in [("exact", FAR), ("classical", CLASSICAL)] {
            let deep = row.t < if name == "exact" { 1e-6 } else { 1e-4 };
            let walks = if row.tau > 500.0 && row.alpha > 0.99 { 1 << 15 } else { 1 << 17 };
            let found = fluxes(way, row, &medium, walks, 5);
            for (face, expected) in [("reflected", row.r), ("transmitted", row.t)] {
                if face == "transmitted" && deep {
                    continue;
                }
                let of = &found[usize::from(face == "transmitted")];
                let (mean, n) = (of.mean().x, of.n);
                let error = ((of.squares.x / n - mean * mean).max(0.0) / n).sqrt();
                let stressed = format!("slab of optical thickness {}, albedo {}, {face}", row.tau, row.alpha);
                report(
                    &stressed,
                    name,
                    "slab by adding-doubling (reference.csv)",
                    expected,
                    mean,
                    error,
                    1e-4 * expected,
                );
                let beyond = ((mean - expected).abs() - 1e-4 * expected).max(0.0);
                tests.push((stressed, if beyond > 0.0 { beyond / error } else { 0.0 }));
            }
        }
    }
    judge("thick slabs", tests);
}

/// A medium with a mistake in it, made through public fields: sampling stays, the pdf that goes with it moves.
fn mistaken(mistake: &str, mut medium: GuidedMedium) -> GuidedMedium {
    match mistake {
        "none" => {}
        // The pdf of guided directions, by a factor.
        "direction pdf x 1.02" => medium.kernels.iter_mut().for_each(|kernel| kernel.alpha_hat *= 1.02),
        // Distances are drawn as for a medium a little denser than the one whose densities are multiplied up.
        "distance pdf x 1.02" => medium.medium.sigma_t *= 1.02,
        "albedo x 0.98" => {
            let Medium { sigma_t, albedo, g } = medium.medium;
            medium = GuidedMedium::new(Medium { sigma_t, albedo: albedo * 0.98, g });
        }
        other => panic!("no mistake called {other}"),
    }
    medium
}

/// The judge of the slabs passes walks as they are, and does not pass any of the mistakes.
#[test]
fn deliberate_mistakes_are_caught() {
    let rows: Vec<Row> = stability_rows()
        .into_iter()
        .filter(|row| row.eta == 1.0 && row.g == 0.0 && row.tau == 1.0 && [0.5, 0.9, 0.99].contains(&row.alpha))
        .collect();
    assert_eq!(rows.len(), 3);
    let conditional = Way::Conditional { normal: Vec3::Z, first_distance: true, classical: 0.0 };
    for (mistake, way) in [
        ("none", conditional),
        ("none", FAR),
        ("none", CLASSICAL),
        ("none", UNGUIDED),
        ("direction pdf x 1.02", conditional),
        ("distance pdf x 1.02", UNGUIDED),
        ("albedo x 0.98", conditional),
        ("albedo x 0.98", FAR),
        ("albedo x 0.98", CLASSICAL),
    ] {
        let of_row = |row: &Row| tests_of(way, row, fluxes(way, row, &mistaken(mistake, gray(row)), 1 << 19, 3));
        let tests: Vec<(String, f64)> = rows.iter().flat_map(of_row).collect();
        let (failed, total) = (failures(&tests), tests.len());
        report(
            &format!("deliberate mistake: {mistake}"),
            &format!("{way:?}").split(' ').next().unwrap_or_default().to_lowercase(),
            "1: the judge of the slabs says so, 0: it has nothing to say",
            f64::from(mistake != "none"),
            f64::from(!failed.is_empty()),
            0.0,
            0.0,
        );
        assert_eq!(
            failed.is_empty(),
            mistake == "none",
            "{mistake} {way:?}: {} of {total} fail: {failed:?}",
            failed.len()
        );
    }
}

/// Chi-square of directions drawn by `sample` against `pdf`, both about z, over bins of the cosine: a z-score, and how far
/// the pdf is from integrating to 1.
fn chi_square_and_integral(sample: impl Fn(&mut Sampler) -> Vec3, pdf: impl Fn(Vec3) -> f32) -> [f64; 2] {
    const BINS: usize = 40;
    const STEPS: usize = 2000;
    const COUNT: u32 = 400_000;
    let width = 2.0 / (BINS * STEPS) as f64;
    let share = |bin: usize| -> f64 {
        let cos = |i: usize| -1.0 + ((bin * STEPS + i) as f64 + 0.5) * width;
        let at = |c: f64| f64::from(pdf(Vec3::new((1.0 - c * c).sqrt() as f32, 0.0, c as f32)));
        (0..STEPS).map(|i| at(cos(i)) * std::f64::consts::TAU * width).sum()
    };
    let shares: Vec<f64> = (0..BINS).map(share).collect();
    let (mut counts, mut sampler) = ([0.0; BINS], Sampler::new(23, 0, 0));
    for _ in 0..COUNT {
        let bin = (0.5 * (sample(&mut sampler).z + 1.0) * BINS as f32) as usize;
        counts[bin.min(BINS - 1)] += 1.0;
    }
    let z = chi_square::z(&counts, &shares);
    [z, (shares.iter().sum::<f64>() - 1.0).abs()]
}

/// A pdf that is off by 2 %, in size or in shape, does not pass the chi-square.
#[test]
fn chi_square_catches_a_wrong_pdf() {
    let passes = |[z, integral]: [f64; 2]| z < 4.5 && integral < 1e-3;
    for g in [-0.9_f32, 0.5, 0.8] {
        let sample = |s: &mut Sampler| phase_sample(g, Vec3::Z, Vec2::new(s.random(), s.random()));
        let right = chi_square_and_integral(sample, |w| phase_eval(g, w.z));
        let scaled = chi_square_and_integral(sample, |w| 1.02 * phase_eval(g, w.z));
        let bent = chi_square_and_integral(sample, |w| phase_eval(1.02 * g, w.z));
        assert!(passes(right), "g {g}: {right:?}");
        assert!(!passes(scaled) && scaled[0] > 4.5, "g {g}, pdf x 1.02: {scaled:?}");
        assert!(!passes(bent), "g {g}, g x 1.02: {bent:?}");
        for (mistake, found) in [("none", right), ("pdf x 1.02", scaled), ("g x 1.02", bent)] {
            report(
                &format!("deliberate mistake of the phase function, g {g}: {mistake}"),
                "none",
                "1: chi-square of 40 bins says so, 0: it has nothing to say",
                f64::from(mistake != "none"),
                f64::from(!passes(found)),
                0.0,
                0.0,
            );
        }
    }
}
