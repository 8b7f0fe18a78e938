//! Guided walks through slabs: every weight has the mean of the adding-doubling tables, whatever normals guide it.

mod support;

use dermis::math::Rgb;
use dermis::medium::Medium;
use dermis::sampling::{power_heuristic, sampler::Sampler, uniform_sphere};
use dermis::subsurface::kernel::Kernel;
use dermis::subsurface::steps::{Enclosure, Start, WalkEnd};
use dermis::subsurface::technique::GuidedMedium;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use support::slab::{Beam, Estimate, Row, Slab, SlabFluxes, guided_rows, judge};
use support::ways::{NEARER_CLASSICAL, WAYS, Way, go, pass};

fn gray(row: &Row) -> GuidedMedium {
    GuidedMedium::new(Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(row.alpha), g: row.g })
}

/// The two faces: lit, and far.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Face {
    Lit,
    Far,
}

/// Weights above it are a tail that a few thousand walks do not see: the mean is left to other ways of testing.
const LARGEST_WEIGHT: f64 = 20.0;

/// Walks of an analog game that must arrive for a mean to be worth testing.
const LEAST_ARRIVALS: f64 = 25.0;

/// Bound of the weight of walks out of `face`, from the closed form of their density: over one walk f / p is
/// (alpha / alpha_hat)^N exp(-kappa n.Delta) phi(first) / phi(last), and alpha_hat is never less than alpha.
/// `None` where there is no bound, or none of use.
fn weight_bound(way: Way, row: &Row, face: Face, kernel: &Kernel) -> Option<f64> {
    let tau = f64::from(row.tau);
    // exp(-kappa n.Delta) phi(first) / phi(last) along +z or -z; first into the slab, last out of `face`.
    let along = |normal: Vec3, delta: f64| {
        let last = if face == Face::Lit { -1.0 } else { 1.0 };
        (-f64::from(kernel.kappa) * f64::from(normal.z) * delta).exp() * largest_phi(kernel, normal, 1.0)
            / least_phi(kernel, normal, last)
    };
    let delta = if face == Face::Lit { 0.0 } else { tau };
    let bound = match way {
        // Mirrors may chain walks: each may grow by the slab's depth.
        Way::Conditional { .. } | Way::Anywhere | Way::Nearer { exact: false } if row.eta > 1.0 => {
            (2.0 * f64::from(kernel.kappa) * tau).exp()
        }
        // A classical walk in between has weight 1.
        Way::Conditional { normal, first_distance: true, classical } => {
            along(normal, delta).max(if classical > 0.0 { 1.0 } else { 0.0 })
        }
        // Along directions of the slab's plane there is no bound, only a decay: thin slabs are tame.
        Way::Conditional { .. } | Way::Anywhere if tau <= 1.0 => LARGEST_WEIGHT,
        Way::Conditional { .. } | Way::Anywhere => f64::INFINITY,
        // Towards the nearer face from the first collision, but out of the other one. Up to
        // stretch phi (first) / phi(last) of the kernel.
        Way::Nearer { exact: false } => {
            let n = Vec3::Z;
            let turn = 2.0 * largest_phi(kernel, n, 1.0).min(1.0) / least_phi(kernel, n, 1.0).min(1.0);
            (f64::from(kernel.kappa) * tau).exp() * turn
        }
        Way::Nearer { exact: true } => 1.0 / f64::from(NEARER_CLASSICAL),
        // By the classical share, or by the far face's normal where that is tighter.
        Way::Exact { normals, classical, guided_first } => {
            let share = f64::from(1.0 - classical) / normals.max(1) as f64;
            let far = if normals > 1 && guided_first { along(Vec3::Z, delta) / share } else { f64::INFINITY };
            return Some(far.min(1.0 / f64::from(classical)));
        }
    };
    (bound <= LARGEST_WEIGHT).then_some(bound)
}

/// Extremes of phi over directions of the hemisphere about `side` z.
fn phis(kernel: &Kernel, normal: Vec3, side: f32) -> impl Iterator<Item = f64> {
    (0..=100).map(move |i| {
        let z = side * i as f32 / 100.0;
        f64::from(kernel.phi(normal, Vec3::new((1.0 - z * z).sqrt(), 0.0, z)))
    })
}

fn largest_phi(kernel: &Kernel, normal: Vec3, side: f32) -> f64 {
    phis(kernel, normal, side).fold(0.0, f64::max)
}

fn least_phi(kernel: &Kernel, normal: Vec3, side: f32) -> f64 {
    phis(kernel, normal, side).fold(f64::INFINITY, f64::min)
}

/// A mean that a way can estimate with `walks` walks, and the weight that its variance is reckoned with: what survives
/// roulette carries its threshold, however little a deep walk would carry without.
fn judged(way: Way, row: &Row, face: Face, kernel: &Kernel, walks: u32) -> Option<f64> {
    let expected = if face == Face::Lit { row.r } else { row.t };
    let roulette = match way {
        _ if row.tau <= 1.0 => 0.0,
        _ if way.is_exact() => 0.1,
        _ => 1e-6,
    };
    let weight = weight_bound(way, row, face, kernel)?.clamp(roulette, 1.0);
    (expected * f64::from(walks) > LEAST_ARRIVALS * weight).then_some(weight)
}

fn fluxes(way: Way, row: &Row, medium: &GuidedMedium, walks: u32, seed: u32) -> SlabFluxes {
    let slab = Slab { thickness: row.tau };
    let (mut reflected, mut transmitted) = (Estimate::default(), Estimate::default());
    for i in 0..walks {
        let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
        let d = row.beam.direction(&mut sampler);
        let (at_top, weight) = pass(way, &slab, medium, row.eta, d, Rgb::ONE, &mut sampler);
        reflected.add(if at_top { weight } else { Rgb::ZERO });
        transmitted.add(if at_top { Rgb::ZERO } else { weight });
    }
    SlabFluxes { reflected, transmitted }
}

#[test]
fn every_way_matches_adding_doubling() {
    const WALKS: u32 = 10_000;
    let rows: Vec<Row> = guided_rows()
        .into_iter()
        .filter(|row| row.alpha > 0.0)
        .filter(|row| matches!(row.beam, Beam::Diffuse) || (row.eta == 1.0 && [0.0, 0.8].contains(&row.g)))
        .collect();
    let of_row = |(i, row): (usize, &Row)| {
        let medium = gray(row);
        let kernel = &medium.kernels[0];
        let of_way = |(j, way): (usize, &Way)| {
            let faces = [Face::Lit, Face::Far].map(|face| judged(*way, row, face, kernel, WALKS));
            if faces == [None, None] {
                return Vec::new();
            }
            let fluxes = fluxes(*way, row, &medium, WALKS, (i * WAYS.len() + j) as u32);
            let found = [(fluxes.reflected, row.r), (fluxes.transmitted, row.t)];
            let z = |(weight, (estimate, expected)): (Option<f64>, (Estimate, f64))| {
                let label = format!("{way:?} {} {} of {expected}", row.label(), estimate.mean().x);
                Some((label, estimate.z_of(0, expected, weight?)))
            };
            faces.into_iter().zip(found).filter_map(z).collect()
        };
        WAYS.iter().enumerate().flat_map(of_way).collect::<Vec<_>>()
    };
    let tests: Vec<(String, f64)> = rows.par_iter().enumerate().map(|(i, row)| of_row((i, row))).flatten().collect();
    // Of 700 faces; what is skipped are weights without a bound and what is too rare.
    for (way, least) in WAYS.into_iter().zip([530, 480, 420, 420, 480, 600, 600, 600, 600, 600]) {
        let judged = tests.iter().filter(|(label, _)| label.starts_with(&format!("{way:?} g "))).count();
        assert!(judged >= least, "{way:?}: {judged} of {} faces are judged", 2 * rows.len());
    }
    judge("slabs", tests);
}

/// Light out of a matched slab by the power heuristic of next-event estimation at collisions, here towards uniform
/// directions, and of walks that leave: needs the weights at collisions and the pdf of directions.
fn fluxes_by_collisions(way: Way, row: &Row, medium: &GuidedMedium, walks: u32, seed: u32) -> [Estimate; 2] {
    const UNIFORM: f32 = dermis::sampling::UNIFORM_SPHERE_PDF;
    let slab = Slab { thickness: row.tau };
    let mut estimates = [Estimate::default(); 2];
    for i in 0..walks {
        let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
        let d = row.beam.direction(&mut sampler);
        let start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: Rgb::ONE };
        let mut light = [Rgb::ZERO; 2];
        let end = go::<true>(way, &slab, medium, start, &mut sampler, &mut |collision, sampler| {
            let wi = uniform_sphere(Vec2::new(sampler.random(), sampler.random()));
            let (phase, pdf) = (collision.scatter)(wi);
            // Nothing along the slab.
            let Some((t, top)) = slab.cast(collision.p, wi, f32::INFINITY, None) else { return };
            let weight = phase * power_heuristic(UNIFORM, pdf) / UNIFORM;
            light[usize::from(!top)] += collision.weight * weight * medium.medium.transmittance(t);
        });
        if let WalkEnd::Boundary { hit, weight, scattered, .. } = end {
            light[usize::from(!hit)] += weight * scattered.map_or(1.0, |(_, pdf)| power_heuristic(pdf, UNIFORM));
        }
        (0..2).for_each(|face| estimates[face].add(light[face]));
    }
    estimates
}

#[test]
fn light_at_collisions_matches_adding_doubling() {
    const WALKS: u32 = 10_000;
    let rows: Vec<Row> = guided_rows()
        .into_iter()
        .filter(|row| row.eta == 1.0 && [0.5, 0.95, 1.0].contains(&row.alpha) && [0.1, 1.0, 10.0].contains(&row.tau))
        .filter(|row| matches!(row.beam, Beam::Diffuse))
        .collect();
    let of_row = |(i, row): (usize, &Row)| {
        let medium = gray(row);
        let kernel = &medium.kernels[0];
        let of_way = |(j, way): (usize, &Way)| {
            let faces = [(Face::Lit, row.r), (Face::Far, row.t)];
            let bounds = faces.map(|(face, _)| judged(*way, row, face, kernel, WALKS));
            // Collisions before the walk turns out heavy are as heavy.
            let [Some(_), Some(_)] = bounds else { return Vec::new() };
            let found = fluxes_by_collisions(*way, row, &medium, WALKS, (i * WAYS.len() + j) as u32);
            let z = |face: usize| {
                let expected = faces[face].1;
                let label = format!("{way:?} {} {} of {expected}", row.label(), found[face].mean().x);
                (label, found[face].z_of(0, expected, 0.0))
            };
            vec![z(0), z(1)]
        };
        WAYS.iter().enumerate().flat_map(of_way).collect::<Vec<_>>()
    };
    let tests: Vec<(String, f64)> = rows.par_iter().enumerate().map(|(i, row)| of_row((i, row))).flatten().collect();
    assert!(tests.len() >= 570, "{} of {} faces are judged", tests.len(), 2 * rows.len() * WAYS.len());
    judge("collisions", tests);
}

/// Channels of one walk have the fluxes that each has alone, though mean free paths differ by 1:100, albedos by 0 to
/// 1, and what they carry in by 1:50.
#[test]
fn channels_match_adding_doubling() {
    const WALKS: u32 = 60_000;
    let rows = guided_rows();
    let cases = [
        ([0.1, 1.0, 10.0], [0.0, 0.8, 1.0], [1.0, 1.0, 1.0]),
        ([10.0, 1.0, 0.1], [0.95, 0.05, 0.999], [1.0, 0.3, 0.02]),
        ([1.0, 0.01, 0.1], [1.0, 0.5, 0.0], [0.02, 1.0, 0.3]),
        ([0.1, 10.0, 10.0], [0.99, 0.99, 0.0], [1.0, 0.05, 1.0]),
    ];
    let mut tests = Vec::new();
    for (i, (tau, albedo, carried)) in cases.into_iter().enumerate() {
        for (j, (g, eta)) in [(0.0, 1.0), (0.0, 1.4), (0.5, 1.0), (-0.4, 1.4)].into_iter().enumerate() {
            for (k, way) in WAYS.into_iter().enumerate() {
                tests.push((tau, albedo, carried, g, eta, way, ((i * 4 + j) * WAYS.len() + k) as u32));
            }
        }
    }
    let row = |g: f32, eta: f32, albedo: f32, tau: f32| {
        let phase = if albedo == 0.0 { 0.0 } else { g };
        let found = rows.iter().find(|row| {
            (row.g, row.eta, row.alpha, row.tau) == (phase, eta, albedo, tau) && matches!(row.beam, Beam::Diffuse)
        });
        *found.expect("a row of the table")
    };
    let test = |&(tau, albedo, carried, g, eta, way, seed): &([f32; 3], [f32; 3], [f32; 3], f32, f32, Way, u32)| {
        let medium = GuidedMedium::new(Medium { sigma_t: Rgb::from(tau), albedo: Rgb::from(albedo), g });
        let rows = [0, 1, 2].map(|c| row(g, eta, albedo[c], tau[c]));
        // Weights are those of the channel that suits a technique least: only thin slabs are tame, one by one.
        if !way.is_exact() && tau.iter().any(|tau| *tau > 1.0) {
            return Vec::new();
        }
        let (mut reflected, mut transmitted) = (Estimate::default(), Estimate::default());
        for i in 0..WALKS {
            let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
            let d = Beam::Diffuse.direction(&mut sampler);
            let (at_top, weight) =
                pass(way, &Slab { thickness: 1.0 }, &medium, eta, d, Rgb::from(carried), &mut sampler);
            reflected.add(if at_top { weight / Rgb::from(carried) } else { Rgb::ZERO });
            transmitted.add(if at_top { Rgb::ZERO } else { weight / Rgb::from(carried) });
        }
        let mut z = Vec::new();
        for (c, row) in rows.iter().enumerate() {
            for (estimate, expected) in [(reflected, row.r), (transmitted, row.t)] {
                if expected * f64::from(WALKS) > LEAST_ARRIVALS {
                    let label = format!(
                        "{way:?} channel {c} of {tau:?} {albedo:?} {carried:?} g {g} eta {eta}: {} of {expected}",
                        estimate.mean()[c]
                    );
                    z.push((label, estimate.z_of(c, expected, 1.0)));
                }
            }
        }
        z
    };
    let judged: Vec<(String, f64)> = tests.par_iter().map(test).flatten().collect();
    assert!(judged.len() >= 530, "{} of {} channels and faces are judged", judged.len(), 6 * tests.len());
    judge("channels", judged);
}
