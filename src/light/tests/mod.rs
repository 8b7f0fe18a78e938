//! The lights against quadratures and closed forms that share no code with them.

mod choice;
mod directions;
mod dropped;
mod infinite;
mod linking;
mod many;
mod motion;
mod portals;
mod quadrature;
mod shapes;

use super::{LightSample, Lights, LightsAt};
use crate::light::Choice;
use crate::{
    flat::{self, IDENTITY, LightShape, Matrix4d, Prims},
    sampling::sampler::Sampler,
};
use glam::{DVec3, Vec2, Vec3};

/// Row-vector matrix from the images of the axes and the origin.
fn matrix(x: [f64; 3], y: [f64; 3], z: [f64; 3], t: [f64; 3]) -> Matrix4d {
    let row = |v: [f64; 3], w| [v[0], v[1], v[2], w];
    [row(x, 0.0), row(y, 0.0), row(z, 0.0), row(t, 1.0)]
}

/// Named placements at `t`: plain, turned with different scales, sheared, mirrored.
fn placements(t: [f64; 3]) -> [(&'static str, Matrix4d); 4] {
    [
        ("plain", matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], t)),
        // Orthogonal axes of lengths 2, 0.5 and 1.5.
        ("scaled", matrix([1.6, 1.2, 0.0], [-0.3, 0.4, 0.0], [0.0, 0.0, 1.5], t)),
        ("sheared", matrix([1.0, 0.2, 0.1], [0.7, 1.1, -0.2], [0.1, -0.3, 0.8], t)),
        ("mirrored", matrix([-1.2, 0.0, 0.1], [0.0, 0.8, 0.0], [0.1, 0.0, 1.2], t)),
    ]
}

fn area_shapes() -> [LightShape; 4] {
    [
        LightShape::Rect { width: 1.4, height: 0.6, texture: String::new() },
        LightShape::Disk { radius: 0.5 },
        LightShape::Sphere { radius: 0.4 },
        LightShape::Cylinder { length: 1.7, radius: 0.2 },
    ]
}

fn light(shape: LightShape, transform: Matrix4d) -> flat::Light {
    flat::Light { shape, transform, ..Default::default() }
}

fn distant(angle: f32) -> flat::Light {
    light(LightShape::Distant { angle }, IDENTITY)
}

fn compile(lights: &[flat::Light]) -> Lights {
    compile_with(lights, &Prims::new())
}

/// Compiles and insists that nothing was dropped.
fn compile_with(lights: &[flat::Light], textures: &Prims<flat::Texture>) -> Lights {
    let prims = lights.iter().enumerate().map(|(i, l)| (format!("/light{i:04}"), l.clone())).collect();
    let mut warnings = Vec::new();
    let compiled = Lights::compile(&prims, textures, &|_| None, DVec3::ZERO, true, &mut warnings);
    assert!(warnings.is_empty(), "{warnings:?}");
    compiled
}

/// Random numbers of one test.
struct Random(Sampler);

impl Random {
    fn new(seed: u32) -> Self {
        Self(Sampler::new(seed, 0, 0))
    }

    fn next(&mut self) -> f32 {
        self.0.random()
    }

    fn next_2d(&mut self) -> Vec2 {
        Vec2::new(self.next(), self.next())
    }

    fn sample(&mut self, lights: &Lights, p: Vec3, n: Option<Vec3>) -> Option<LightSample> {
        let (choice, u) = (self.next(), self.next_2d());
        lights.at(0.0).sample(p, n, Choice::ONE, choice, u)
    }
}

/// Mean and its standard error.
#[derive(Debug, Clone, Copy)]
struct Estimate {
    mean: f64,
    error: f64,
}

fn estimate(n: u32, mut f: impl FnMut() -> f64) -> Estimate {
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..n {
        let x = f();
        sum += x;
        squares += x * x;
    }
    let n = f64::from(n);
    let mean = sum / n;
    Estimate { mean, error: ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt() }
}

/// Irradiance (red channel) by the sampler under test.
fn irradiance(lights: &Lights, p: Vec3, n: Vec3, samples: u32, seed: u32) -> Estimate {
    let mut random = Random::new(seed);
    estimate(samples, || {
        let sample = random.sample(lights, p, Some(n));
        sample.map_or(0.0, |s| f64::from(s.radiance.x * n.dot(s.wi).max(0.0) / s.pdf))
    })
}

/// Within 4 standard errors, and within 1 %; `slack`: relative error of the truth itself.
fn assert_agrees(estimate: Estimate, truth: f64, slack: f64, what: &str) {
    let difference = (estimate.mean - truth).abs();
    assert!(difference <= 4.0 * estimate.error + slack * truth, "{what}: {estimate:?}, true {truth}");
    assert!(difference <= 0.01 * truth, "{what}: {estimate:?}, true {truth}");
}
