//! What walks draw - technique, distances, directions - against the densities that they are weighted with, in f64.

mod support;

use dermis::math::Rgb;
use dermis::medium::Medium;
use dermis::sampling::sampler::Sampler;
use dermis::subsurface::mixture::{Visitor, walk_mixture};
use dermis::subsurface::steps::{Enclosure, Start, WalkEnd, WalkStats};
use dermis::subsurface::technique::{GuidedMedium, LANES, TECHNIQUES, Techniques};
use dermis::subsurface::walk::{Along, walk};
use glam::Vec3;
use rayon::prelude::*;
use std::cell::RefCell;
use std::f64::consts::{PI, TAU};
use support::chi_square;
use support::in_f64::{Eigenfunction, complement};
use support::slab::judge;
use support::ways::mixture;

/// No boundary before the second flight, whose length is noted, as is all before.
#[derive(Default)]
struct TwoFlights(RefCell<Vec<(Vec3, f32)>>);

impl Enclosure for TwoFlights {
    type Hit = ();

    fn cast(&self, _p: Vec3, d: Vec3, t_max: f32, _from: Option<()>) -> Option<(f32, ())> {
        let mut flights = self.0.borrow_mut();
        flights.push((d, t_max));
        (flights.len() == 2).then_some((0.0, ()))
    }

    fn bounds_contain(&self, _p: Vec3) -> bool {
        true
    }

    fn position_error(&self) -> f32 {
        0.0
    }
}

/// Asks for the pdf of directions, and nothing else.
struct Watching;

impl Visitor for Watching {
    const AT_COLLISIONS: bool = true;
}

/// What a walk draws until its second flight is over, and its own pdf of the second direction.
struct Drawn {
    technique: usize,
    first: f32,
    direction: Vec3,
    second: f32,
    pdf: f32,
}

const COUNT: u32 = 1 << 18;

/// Where walks start: not along any normal.
const D: Vec3 = Vec3::new(0.36, 0.48, 0.8);

fn start(weight: Rgb) -> Start<()> {
    Start { p: Vec3::ZERO, d: D, normal: Vec3::NEG_Z, hit: (), weight }
}

fn draw(medium: &GuidedMedium, techniques: &Techniques, weight: Rgb, seed: u32, i: u32) -> Drawn {
    let (flights, mut sampler) = (TwoFlights::default(), Sampler::new(seed, i, 0));
    let u = sampler.random();
    let stats = &mut WalkStats::default();
    let end = walk_mixture(&flights, medium, *techniques, start(weight), u, &mut sampler, stats, &mut Watching);
    let WalkEnd::Boundary { scattered: Some((_, pdf)), .. } = end.end else { panic!("the second flight ends it") };
    let [(_, first), (direction, second)] = flights.0.take()[..] else { panic!("two flights") };
    let technique = end.technique.channel * (LANES + 1) + end.technique.lane.map_or(0, |lane| lane + 1);
    Drawn { technique, first, direction, second, pdf }
}

const BANDS: usize = 6;
const SECTORS: usize = 8;
const DIRECTIONS: usize = BANDS * SECTORS;

/// Ends of the bins of distances; mean free paths are from 0.2 to 2.
const FIRST: [f64; 5] = [0.0, 0.3, 0.9, 2.5, f64::INFINITY];
const SECOND: [f64; 4] = [0.0, 0.5, 1.8, f64::INFINITY];
const BINS: usize = DIRECTIONS * (FIRST.len() - 1) * (SECOND.len() - 1);

/// Of equal area.
fn direction_bin(w: Vec3) -> usize {
    let band = ((w.z + 1.0) * 0.5 * BANDS as f32) as usize;
    let sector = ((f64::from(w.y).atan2(f64::from(w.x)) / TAU + 0.5) * SECTORS as f64) as usize;
    band.min(BANDS - 1) * SECTORS + sector.min(SECTORS - 1)
}

fn bin(direction: usize, first: usize, second: usize) -> usize {
    (direction * (FIRST.len() - 1) + first) * (SECOND.len() - 1) + second
}

fn place(ends: &[f64], x: f64) -> usize {
    ends[1..].iter().position(|end| x < *end).expect("the last end is infinite")
}

/// Directions of a bin, evenly spread.
fn directions_of(bin: usize) -> impl Iterator<Item = Vec3> {
    const FINE: usize = 40;
    (0..FINE * FINE).map(move |i| {
        let [u, v] = [i / FINE, i % FINE].map(|x| (x as f64 + 0.5) / FINE as f64);
        let z = ((bin / SECTORS) as f64 + u) * 2.0 / BANDS as f64 - 1.0;
        let angle = (((bin % SECTORS) as f64 + v) / SECTORS as f64 - 0.5) * TAU;
        let r = (1.0 - z * z).sqrt();
        Vec3::new((r * angle.cos()) as f32, (r * angle.sin()) as f32, z as f32)
    })
}

/// Henyey and Greenstein 1941.
fn phase(g: f64, cos: f64) -> f64 {
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * cos).powf(1.5))
}

/// One technique: a channel, and the slab normal along which it draws.
struct Density<'a> {
    medium: &'a GuidedMedium,
    channel: usize,
    normal: Option<Vec3>,
    guided_first: bool,
    function: Eigenfunction,
}

impl<'a> Density<'a> {
    fn new(medium: &'a GuidedMedium, channel: usize, normal: Option<Vec3>, guided_first: bool) -> Self {
        let kernel = &medium.kernels[channel];
        let [kappa, alpha, g] = [kernel.kappa, kernel.alpha_hat, medium.medium.g].map(f64::from);
        Self { medium, channel, normal, guided_first, function: Eigenfunction::new(kappa, alpha, g) }
    }

    fn rate(&self, w: Vec3, first: bool) -> f64 {
        let along = self.normal.filter(|_| self.guided_first || !first);
        let stretch = along.map_or(1.0, |n| self.function.stretch(complement(n, w)));
        f64::from(self.medium.medium.sigma_t[self.channel]) * stretch
    }

    /// Solid-angle pdf of `wi` after `D` (guiding.md 1.2, 8.2).
    fn direction(&self, wi: Vec3) -> f64 {
        let turn = phase(f64::from(self.medium.medium.g), D.as_dvec3().dot(wi.as_dvec3()));
        let Some(n) = self.normal else { return turn };
        let (function, before, after) = (&self.function, complement(n, D), complement(n, wi));
        let alpha_hat = f64::from(self.medium.kernels[self.channel].alpha_hat);
        turn * alpha_hat * function.source(after) / (function.stretch(after) * function.source(before))
    }

    /// Probabilities of all bins, added with the technique's `share`.
    fn add(&self, share: f64, to: &mut [f64]) {
        let within = |rate: f64, ends: &[f64], i: usize| (-rate * ends[i]).exp() - (-rate * ends[i + 1]).exp();
        let firsts: Vec<f64> = (0..FIRST.len() - 1).map(|i| within(self.rate(D, true), &FIRST, i)).collect();
        for direction in 0..DIRECTIONS {
            let mut seconds = [0.0; SECOND.len() - 1];
            let fine: Vec<Vec3> = directions_of(direction).collect();
            for &w in &fine {
                let p = self.direction(w) * 2.0 * TAU / (DIRECTIONS * fine.len()) as f64;
                let rate = self.rate(w, false);
                seconds.iter_mut().enumerate().for_each(|(i, sum)| *sum += p * within(rate, &SECOND, i));
            }
            for (i, first) in firsts.iter().enumerate() {
                seconds.iter().enumerate().for_each(|(j, second)| to[bin(direction, i, j)] += share * first * second);
            }
        }
    }
}

/// Probabilities of all bins under the whole mixture.
fn expected(medium: &GuidedMedium, techniques: &Techniques) -> Vec<f64> {
    let mut sums = vec![0.0; BINS];
    for (t, share) in techniques.shares.as_list().into_iter().enumerate().filter(|(_, share)| *share > 0.0) {
        let normal = (t % (LANES + 1)).checked_sub(1).map(|lane| techniques.normal(lane));
        Density::new(medium, t / (LANES + 1), normal, techniques.guided_first).add(f64::from(share), &mut sums);
    }
    sums
}

fn count(drawn: impl Iterator<Item = (f32, Vec3, f32)>) -> Vec<f64> {
    let mut counts = vec![0.0; BINS];
    for (first, w, second) in drawn {
        let [first, second] = [first, second].map(f64::from);
        counts[bin(direction_bin(w), place(&FIRST, first), place(&SECOND, second))] += 1.0;
    }
    counts
}

/// Media whose channels are alike, differ in albedo, in all; isotropic and not.
fn media() -> [GuidedMedium; 4] {
    let all = |sigma: [f32; 3], albedo: [f32; 3], g: f32| {
        GuidedMedium::new(Medium { sigma_t: sigma.into(), albedo: albedo.into(), g })
    };
    [
        all([1.0; 3], [0.9; 3], 0.0),
        all([1.0; 3], [0.6, 0.9, 1.0], 0.0),
        all([5.0, 2.0, 1.0], [0.6, 0.9, 0.99], 0.0),
        all([2.0, 1.0, 0.5], [0.8, 0.95, 0.99], 0.6),
    ]
}

const CARRIED: Rgb = Rgb::new(1.0, 0.5, 0.2);

/// Shares that differ by channel and lane.
fn uneven(guided_first: bool) -> Techniques {
    let mut techniques = mixture(5, 0.15, guided_first);
    for c in 0..3 {
        for lane in 0..5 {
            techniques.shares.guided[c][lane] *= 1.0 + 0.3 * (c + 2 * lane) as f32;
        }
    }
    techniques.shares = techniques.shares.scaled(1.0 / techniques.shares.sum());
    techniques
}

#[test]
fn draws_of_the_mixture_follow_its_densities() {
    let mut tests = Vec::new();
    for (case, medium) in media().into_iter().enumerate() {
        for guided_first in [true, false] {
            let (techniques, label) = (uneven(guided_first), format!("medium {case}, guided first {guided_first}"));
            let tilted = techniques.tilted(CARRIED);
            let seed = 2 * case as u32 + u32::from(guided_first);
            let all: Vec<Drawn> =
                (0..COUNT).into_par_iter().map(|i| draw(&medium, &techniques, CARRIED, seed, i)).collect();

            let mut chosen = vec![0.0; TECHNIQUES];
            all.iter().for_each(|drawn| chosen[drawn.technique] += 1.0);
            let shares = tilted.shares.as_list().map(f64::from);
            tests.push((format!("techniques, {label}"), chi_square::z(&chosen, &shares)));

            let counts = count(all.iter().map(|drawn| (drawn.first, drawn.direction, drawn.second)));
            let probabilities = expected(&medium, &tilted);
            let sum: f64 = probabilities.iter().sum();
            assert!((sum - 1.0).abs() < 1e-3, "{label}: {sum}");
            tests.push((format!("draws, {label}"), chi_square::z(&counts, &probabilities)));

            // One over the pdf that the walk itself gives is the area of each bin.
            let mut areas = vec![[0.0; 2]; DIRECTIONS];
            for drawn in &all {
                let (area, x) = (&mut areas[direction_bin(drawn.direction)], 1.0 / f64::from(drawn.pdf));
                *area = [area[0] + x, area[1] + x * x];
            }
            for (i, [sum, squares]) in areas.into_iter().enumerate() {
                let [mean, squares] = [sum, squares].map(|x| x / f64::from(COUNT));
                let error = ((squares - mean * mean) / f64::from(COUNT)).sqrt();
                tests.push((format!("pdf, {label}, bin {i}"), (mean - 2.0 * TAU / DIRECTIONS as f64) / error));
            }
        }
    }
    let z = tests.iter().filter(|(what, _)| !what.starts_with("pdf")).map(|(_, z)| format!("{z:.1}"));
    eprintln!("chi-square: {}", z.collect::<Vec<_>>().join(", "));
    judge("draws of the mixture", tests);
}

/// Walks that are weighted by one normal, or by none, of a medium whose channels are alike.
#[test]
fn draws_along_one_normal_follow_its_densities() {
    let mut tests = Vec::new();
    let media = [(0.6, 0.0), (0.9, 0.0), (1.0, 0.0), (0.95, 0.6), (0.8, -0.4)];
    for (case, (albedo, g)) in media.into_iter().enumerate() {
        let medium = GuidedMedium::new(Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(albedo), g });
        for (normal, first_distance) in [(None, false), (Some(Vec3::Z), true), (Some(Vec3::new(0.6, 0.0, -0.8)), false)]
        {
            let kernels = &medium.kernels;
            let along = normal.map_or(Along::None, |normal| Along::Fixed { kernels, normal, first_distance });
            let drawn = |i: u32| {
                let (flights, mut sampler) = (TwoFlights::default(), Sampler::new(100 + case as u32, i, 0));
                let stats = &mut WalkStats::default();
                let late = |_: Vec3, _: &mut Sampler| None;
                walk(&flights, &medium.medium, along, start(Rgb::ONE), false, &mut sampler, stats, late, |_, _| ());
                let [(_, first), (direction, second)] = flights.0.take()[..] else { return None };
                Some((first, direction, second))
            };
            // Roulette of classical walks is on the albedo, and tells nothing of what is drawn; guided ones have none here.
            let all: Vec<(f32, Vec3, f32)> = (0..COUNT).into_par_iter().filter_map(drawn).collect();
            let share = if normal.is_some() { 1.0 } else { f64::from(albedo) };
            assert!((all.len() as f64 / f64::from(COUNT) - share).abs() < 5e-3, "{}", all.len());
            let mut probabilities = vec![0.0; BINS];
            Density::new(&medium, 0, normal, first_distance).add(1.0, &mut probabilities);
            let z = chi_square::z(&count(all.into_iter()), &probabilities);
            tests.push((format!("albedo {albedo} g {g} along {normal:?}"), z));
        }
    }
    judge("draws along one normal", tests);
}

/// A mean free path or an albedo that is off by 5 %, a share that is half another normal's, a channel that carries half.
#[test]
fn the_judge_of_draws_says_no() {
    let [_, _, medium, _] = media();
    let techniques = uneven(true);
    let all = (0..COUNT).into_par_iter().map(|i| draw(&medium, &techniques, CARRIED, 77, i));
    let all: Vec<(f32, Vec3, f32)> = all.map(|drawn| (drawn.first, drawn.direction, drawn.second)).collect();
    let counts = count(all.into_iter());
    let z = |medium: &GuidedMedium, techniques: &Techniques| chi_square::z(&counts, &expected(medium, techniques));
    let tilted = techniques.tilted(CARRIED);
    assert!(z(&medium, &tilted) < 4.5, "{}", z(&medium, &tilted));
    let changed = |sigma: f32, albedo: f32| {
        let Medium { sigma_t, albedo: old, g } = medium.medium;
        GuidedMedium::new(Medium { sigma_t: sigma_t * sigma, albedo: old * albedo, g })
    };
    let mut shifted = tilted;
    let moved = 0.5 * shifted.shares.guided[0][0];
    shifted.shares.guided[0][0] -= moved;
    shifted.shares.guided[0][4] += moved;
    for (mistake, z) in [
        ("a share", z(&medium, &shifted)),
        ("sigma_t", z(&changed(1.05, 1.0), &tilted)),
        ("albedo", z(&changed(1.0, 0.95), &tilted)),
        ("what is carried", z(&medium, &techniques.tilted(Rgb::new(1.0, 0.25, 0.2)))),
    ] {
        eprintln!("{mistake}: z {z:.1}");
        assert!(z > 4.5, "{mistake}: {z}");
    }
}
