//! The classical walk against closed forms and adding-doubling tables.

mod support;

use dermis::bsdf::fresnel;
use dermis::math::Rgb;
use dermis::medium::Medium;
use dermis::sampling::sampler::Sampler;
use dermis::subsurface::steps::{Start, WalkEnd, WalkStats};
use dermis::subsurface::walk::{Along, walk};
use glam::Vec3;
use std::path::Path;
use support::slab::{Beam, Estimate, Row, Slab, SlabFluxes, reference_rows, z_limit};

fn run_slab(medium: &Medium, thickness: f32, beam: Beam, walks: u32, seed: u32) -> SlabFluxes {
    let slab = Slab { thickness };
    let (mut reflected, mut transmitted) = (Estimate::default(), Estimate::default());
    let mut stats = WalkStats::default();
    for i in 0..walks {
        let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
        let d = beam.direction(&mut sampler);
        let start = Start { p: Vec3::ZERO, d, normal: -Vec3::Z, hit: true, weight: Rgb::ONE };
        let end = walk(&slab, medium, Along::None, start, false, &mut sampler, &mut stats, |_, _| None, |_, _| ());
        let (r, t) = match end {
            WalkEnd::Boundary { hit: true, weight, .. } => (weight, Rgb::ZERO),
            WalkEnd::Boundary { hit: false, weight, .. } => (Rgb::ZERO, weight),
            _ => (Rgb::ZERO, Rgb::ZERO),
        };
        reflected.add(r);
        transmitted.add(t);
    }
    assert_eq!((stats.leaked, stats.too_long), (0, 0));
    SlabFluxes { reflected, transmitted }
}

/// Light through a slab whose faces are smooth dielectrics: a walk starts anew at every internal reflection,
/// as in the integrator. Fluxes per unit incident flux, R with the first reflection.
fn run_dielectric_slab(medium: &Medium, row: &Row, walks: u32, seed: u32) -> SlabFluxes {
    let slab = Slab { thickness: row.tau };
    let (mut reflected, mut transmitted) = (Estimate::default(), Estimate::default());
    let mut stats = WalkStats::default();
    for i in 0..walks {
        let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
        let d = row.beam.direction(&mut sampler);
        let (at_top, weight) = pass_dielectric(&slab, medium, row.eta, d, &mut sampler, &mut stats);
        reflected.add(if at_top { weight } else { Rgb::ZERO });
        transmitted.add(if at_top { Rgb::ZERO } else { weight });
    }
    SlabFluxes { reflected, transmitted }
}

/// One path: which face it leaves by (true: the lit one), and what it carries.
fn pass_dielectric(
    slab: &Slab,
    medium: &Medium,
    eta: f32,
    d: Vec3,
    sampler: &mut Sampler,
    stats: &mut WalkStats,
) -> (bool, Rgb) {
    if sampler.random() < fresnel::dielectric(d.z, eta) {
        return (true, Rgb::ONE);
    }
    let inside = fresnel::refract(-d, -Vec3::Z, eta).expect("light always gets into the denser medium");
    let mut start = Start { p: Vec3::ZERO, d: inside, normal: -Vec3::Z, hit: true, weight: Rgb::ONE };
    loop {
        let WalkEnd::Boundary { hit, p, d, weight, .. } =
            walk(slab, medium, Along::None, start, false, sampler, stats, |_, _| None, |_, _| ())
        else {
            return (true, Rgb::ZERO);
        };
        if sampler.random() >= fresnel::dielectric(d.z.abs(), 1.0 / eta) {
            return (hit, weight);
        }
        let normal = if hit { -Vec3::Z } else { Vec3::Z };
        start = Start { p, d: Vec3::new(d.x, d.y, -d.z), normal, hit, weight };
    }
}

#[test]
fn dielectric_slabs_match_adding_doubling() {
    let Some(rows) = reference_rows() else { return };
    let rows: Vec<Row> = rows.into_iter().filter(|r| r.eta > 1.0 && r.tau <= 5.0 && r.alpha >= 0.5).collect();
    assert!(rows.len() > 300);
    let limit = z_limit(2 * rows.len());
    for (i, row) in rows.iter().enumerate() {
        let medium = Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(row.alpha), g: row.g };
        let fluxes = run_dielectric_slab(&medium, row, 20_000, i as u32);
        for (estimate, expected) in [(fluxes.reflected, row.r), (fluxes.transmitted, row.t)] {
            let z = estimate.z(expected);
            let (g, eta, alpha, tau) = (row.g, row.eta, row.alpha, row.tau);
            assert!(z.abs() < limit, "g {g} eta {eta} alpha {alpha} tau {tau}: {} z {z:.2}", estimate.mean().x);
        }
    }
}

/// Directional-hemispherical albedo of a half-space is 1 - H(mu) sqrt(1 - albedo) (Chandrasekhar 1960).
#[test]
fn half_spaces_match_chandrasekhar() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/reference_H.csv");
    let Ok(text) = std::fs::read_to_string(&file) else {
        eprintln!("skipped: {} is absent", file.display());
        return;
    };
    let numbers = |line: &str| -> Vec<f64> { line.split(',').filter_map(|cell| cell.parse().ok()).collect() };
    let table: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let albedos = numbers(table[0]);
    let rows: Vec<Vec<f64>> = table[1..].iter().map(|line| numbers(line)).filter(|row| row[0] > 0.0).collect();
    let limit = z_limit(rows.len() * albedos.len());
    for (i, row) in rows.iter().enumerate() {
        // 60 mean free paths are a half-space up to albedo .99, whose diffusion length is 5.8.
        for (albedo, h) in albedos.iter().zip(&row[1..]).filter(|(albedo, _)| **albedo <= 0.99) {
            let medium = Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(*albedo as f32), g: 0.0 };
            let fluxes = run_slab(&medium, 60.0, Beam::Cosine(row[0] as f32), 20_000, i as u32);
            let expected = 1.0 - h * (1.0 - albedo).sqrt();
            let z = fluxes.reflected.z(expected);
            assert!(z.abs() < limit, "albedo {albedo} mu {}: {} of {expected}", row[0], fluxes.reflected.mean().x);
        }
    }
}

#[test]
fn index_matched_slabs_match_adding_doubling() {
    let Some(rows) = reference_rows() else { return };
    let rows: Vec<Row> = rows.into_iter().filter(|r| r.eta == 1.0 && r.tau <= 10.0).collect();
    assert!(rows.len() > 300);
    let limit = z_limit(2 * rows.len());
    let mut worst = 0.0_f64;
    for (i, row) in rows.iter().enumerate() {
        let medium = Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(row.alpha), g: row.g };
        let fluxes = run_slab(&medium, row.tau, row.beam, 40_000, i as u32);
        for (estimate, expected) in [(fluxes.reflected, row.r), (fluxes.transmitted, row.t)] {
            let z = estimate.z(expected);
            worst = worst.max(z.abs());
            let (g, alpha, tau) = (row.g, row.alpha, row.tau);
            assert!(z.abs() < limit, "g {g} alpha {alpha} tau {tau} {expected}: {} z {z:.2}", estimate.mean().x);
        }
    }
    eprintln!("worst |z| {worst:.2} of {} (limit {limit:.2})", 2 * rows.len());
}

/// Channels with their own albedo and mean free path in one walk give what each gives alone.
#[test]
fn spectral_mixture_has_the_means_of_its_channels() {
    let rgb = Medium { sigma_t: Rgb::new(0.5, 5.0, 50.0), albedo: Rgb::new(0.99, 0.8, 0.0), g: 0.0 };
    let together = run_slab(&rgb, 1.0, Beam::Diffuse, 400_000, 7);
    for channel in 0..3 {
        let alone =
            Medium { sigma_t: Rgb::splat(rgb.sigma_t[channel]), albedo: Rgb::splat(rgb.albedo[channel]), g: 0.0 };
        let alone = run_slab(&alone, 1.0, Beam::Diffuse, 400_000, 8);
        for (a, b) in [(together.reflected, alone.reflected), (together.transmitted, alone.transmitted)] {
            let variance = |e: Estimate| ((e.squares / e.n - e.mean() * e.mean()) / e.n)[channel];
            let sigma = (variance(a) + variance(b) + 1e-18).sqrt();
            let z = (a.mean()[channel] - b.mean()[0]) / sigma;
            assert!(z.abs() < z_limit(6), "channel {channel}: {} against {} z {z:.2}", a.mean()[channel], b.mean()[0]);
        }
    }
}
