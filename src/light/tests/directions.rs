//! Sampled directions against the pdf, and rays against samples.

use super::*;
use crate::light::Choice;
use crate::{math::Frame, sampling::UNIFORM_SPHERE_PDF, sampling::uniform_sphere};
use std::f32::consts::TAU;

const POINTS: [Vec3; 4] =
    [Vec3::new(0.0, 0.0, 0.0), Vec3::new(1.3, -0.4, 0.9), Vec3::new(0.2, 0.5, 1.5), Vec3::new(-2.0, 3.0, -2.0)];

fn cases() -> impl Iterator<Item = (String, flat::Light)> {
    placements([0.1, -0.1, 2.0])
        .into_iter()
        .flat_map(|(name, transform)| area_shapes().map(|shape| (format!("{name} {shape:?}"), light(shape, transform))))
}

#[test]
fn a_sampled_direction_hits_with_the_pdf_it_was_sampled_with() {
    for (what, light) in cases() {
        let lights = compile(&[light]);
        for p in POINTS {
            let (mut random, mut missed, mut differing, mut sampled) = (Random::new(7), 0, 0, 0);
            for _ in 0..1000 {
                let Some(s) = random.sample(&lights, p, None) else { continue };
                sampled += 1;
                // Directions along the rim may miss by rounding.
                let Some(hit) = lights.at(0.0).intersect(0, p, s.wi, f32::INFINITY) else {
                    missed += 1;
                    continue;
                };
                let pdf = lights.at(0.0).pdf_hit(0, p, None, Choice::ONE, s.wi, &hit);
                // At grazing angles the distance itself is uncertain.
                differing += u32::from((pdf / s.pdf - 1.0).abs() > 1e-3 || (hit.t / s.distance - 1.0).abs() > 1e-4);
                assert_eq!(lights.at(0.0).radiance_hit(0, s.wi, &hit), s.radiance);
            }
            assert!(missed * 100 <= sampled, "{what} at {p}: {missed} of {sampled} missed");
            assert!(differing * 200 <= sampled, "{what} at {p}: {differing} of {sampled} differ");
        }
    }
}

#[test]
fn rays_find_the_light_that_samples_find() {
    for (what, light) in cases() {
        let lights = compile(&[light]);
        let p = Vec3::new(0.2, 0.5, 1.2);
        let mut random = Random::new(8);
        let by_rays = estimate(200_000, || {
            let wi = uniform_sphere(random.next_2d());
            let hit = lights.at(0.0).intersect(0, p, wi, f32::INFINITY);
            hit.map_or(0.0, |hit| f64::from(lights.at(0.0).radiance_hit(0, wi, &hit).x / UNIFORM_SPHERE_PDF))
        });
        let by_samples =
            estimate(50_000, || random.sample(&lights, p, None).map_or(0.0, |s| f64::from(s.radiance.x / s.pdf)));
        let error = by_rays.error.hypot(by_samples.error);
        assert!((by_rays.mean - by_samples.mean).abs() <= 4.0 * error, "{what}: {by_rays:?} {by_samples:?}");
    }
}

/// Bins about the direction `axis`: cosine from `cos_min` to 1, and azimuth.
struct Bins {
    frame: Frame,
    cos_min: f32,
}

const HEIGHTS: usize = 8;
const AROUND: usize = 12;

impl Bins {
    fn index(&self, wi: Vec3) -> usize {
        let local = self.frame.to_local(wi);
        let a = (local.z - self.cos_min) / (1.0 - self.cos_min);
        let b = local.y.atan2(local.x) / TAU + 0.5;
        let cell = |x: f32, n: usize| ((x * n as f32).max(0.0) as usize).min(n - 1);
        cell(a, HEIGHTS) * AROUND + cell(b, AROUND)
    }

    /// Integral of `pdf` over each bin by a midpoint sum.
    fn integrate(&self, pdf: impl Fn(Vec3) -> f32) -> Vec<f64> {
        let (rows, columns) = (HEIGHTS * 64, AROUND * 64);
        let piece = f64::from(1.0 - self.cos_min) * std::f64::consts::TAU / (rows * columns) as f64;
        let mut sums = vec![0.0; HEIGHTS * AROUND];
        for i in 0..rows * columns {
            let z = self.cos_min + (1.0 - self.cos_min) * ((i % rows) as f32 + 0.5) / rows as f32;
            let (sin, cos) = (TAU * (((i / rows) as f32 + 0.5) / columns as f32 - 0.5)).sin_cos();
            let r = (1.0 - z * z).max(0.0).sqrt();
            let wi = self.frame.to_world(Vec3::new(r * cos, r * sin, z));
            sums[self.index(wi)] += f64::from(pdf(wi)) * piece;
        }
        sums
    }
}

/// Pearson's statistic against its 4 sigma quantile (Wilson and Hilferty 1931); bins below 10 are pooled.
fn assert_chi_square(counts: &[u32], expected: &[f64], what: &str) {
    let (mut statistic, mut dof, mut pool) = (0.0, -1.0, (0.0, 0.0));
    let mut add = |count: f64, expected: f64| {
        statistic += (count - expected).powi(2) / expected;
        dof += 1.0;
    };
    for (&count, &e) in counts.iter().zip(expected) {
        if e >= 10.0 { add(f64::from(count), e) } else { pool = (pool.0 + f64::from(count), pool.1 + e) }
    }
    if pool.1 > 1.0 {
        add(pool.0, pool.1);
    } else {
        assert!(pool.0 <= 8.0, "{what}: {} directions where none belong", pool.0);
    }
    let c = 2.0 / (9.0 * f64::max(dof, 1.0));
    let limit = f64::max(dof, 1.0) * (1.0 - c + 4.0 * c.sqrt()).powi(3);
    assert!(statistic < limit, "{what}: chi square {statistic} of {dof} degrees, limit {limit}");
}

/// Samples `lights` at p and compares with the integral of `pdf`, which must also be 1.
pub fn check_directions(
    lights: &Lights,
    p: Vec3,
    n: Option<Vec3>,
    bins: (Vec3, f32),
    pdf: impl Fn(Vec3) -> f32,
    what: &str,
) {
    const N: u32 = 20_000;
    let bins = Bins { frame: Frame::from_normal(bins.0), cos_min: bins.1 };
    let mut random = Random::new(9);
    let mut counts = vec![0; HEIGHTS * AROUND];
    for _ in 0..N {
        if let Some(s) = random.sample(lights, p, n) {
            counts[bins.index(s.wi)] += 1;
        }
    }
    let probability = bins.integrate(pdf);
    let total: f64 = probability.iter().sum();
    assert!((total - 1.0).abs() < 6e-3, "{what}: pdf integrates to {total}");
    let expected: Vec<f64> = probability.iter().map(|p| p * f64::from(N)).collect();
    assert_chi_square(&counts, &expected, what);
}

#[test]
fn directions_are_distributed_as_the_pdf_says() {
    for (what, light) in cases() {
        let lights = compile(&[light]);
        for p in POINTS {
            if lights.at(0.0).choice_probability(0, p, None, Choice::ONE) == 0.0 {
                continue;
            }
            let (_, (min, max)) = lights.shapes().next().unwrap();
            let (center, radius) = (0.5 * (min + max), 0.5 * (max - min).length());
            let d = center.distance(p);
            let cos_min = if d > radius { (1.0 - (radius / d).powi(2)).sqrt() } else { -1.0 };
            let pdf = |wi: Vec3| {
                let hit = lights.at(0.0).intersect(0, p, wi, f32::INFINITY);
                hit.map_or(0.0, |hit| lights.at(0.0).pdf_hit(0, p, None, Choice::ONE, wi, &hit))
            };
            let axis = (center - p).normalize();
            check_directions(&lights, p, None, (axis, cos_min), pdf, &format!("{what} at {p}"));
        }
    }
}

#[test]
fn boxes_hold_their_shapes() {
    for (what, light) in cases() {
        let lights = compile(std::slice::from_ref(&light));
        let (_, (min, max)) = lights.shapes().next().unwrap();
        let points = || quadrature::pieces(&light, 100).map(|piece| piece.position.as_vec3());
        assert!(points().all(|q| q.cmpge(min - 1e-5).all() && q.cmple(max + 1e-5).all()), "{what}");
        let (lo, hi) = (points().reduce(Vec3::min).unwrap(), points().reduce(Vec3::max).unwrap());
        assert!(lo.abs_diff_eq(min, 0.05) && hi.abs_diff_eq(max, 0.05), "{what}: the box is loose");
    }
}
