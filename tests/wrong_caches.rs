//! Guides that believe in other light than there is: their walks are noisier, and their picture is the same.

mod support;

use dermis::flat::{Light, LightShape, Material, PreviewSurface, RenderSettings};
use dermis::guiding::Guide;
use dermis::guiding::cache::{Incident, LightRecord, Record};
use dermis::guiding::field::{Field, FieldSettings};
use dermis::guiding::plan::Walk;
use dermis::guiding::statistics::Statistics;
use dermis::integrator::{PathSettings, PathStats, WalkLog, trace};
use dermis::math::Rgb;
use dermis::sampling::sampler::Sampler;
use dermis::scene::Scene;
use dermis::subsurface::technique::{PerTechnique, Techniques};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use support::difference::Difference;
use support::slab::{failures, judge};
use support::{camera, scene, settings, sphere};

const SIZE: u32 = 16;
const RADIUS: f32 = 0.7;

/// Two lamps, before the body and behind, and a third that it does not see.
fn lamp(z: f64, intensity: f32, turned: bool) -> Light {
    let shape = LightShape::Rect { width: 1.5, height: 1.5, texture: String::new() };
    let mut light = Light { shape, intensity, ..Light::default() };
    let side = if turned { -1.0 } else { 1.0 };
    (light.transform[0][0], light.transform[2][2]) = (side, side);
    light.transform[3] = [0.3, 0.4, z, 1.0];
    light
}

fn asked(walk: &str, pdf: &str) -> RenderSettings {
    let (walk, walk_pdf) = (walk.into(), pdf.into());
    RenderSettings { walk, walk_pdf, exit_lights: "learned".into(), ..settings(SIZE, 1) }
}

fn lit_sphere() -> Arc<Scene> {
    let medium = PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some([0.99, 0.9, 0.8]),
        subsurface_radius: [0.5, 0.35, 0.25],
        ior: 1.4,
        ..PreviewSurface::default()
    };
    let lights = vec![lamp(3.0, 2.0, false), lamp(-3.0, 6.0, true), lamp(4.0, 100.0, true)];
    let eye = camera(DVec3::new(1.0, 1.5, 6.0), 13.0);
    let mut delegate = scene(sphere(12, RADIUS), Material::UsdPreviewSurface(medium), lights, eye);
    delegate.set_settings(asked("classical", "auto")).expect("settings");
    delegate.commit().expect("commit");
    Arc::clone(delegate.scene().expect("a scene"))
}

/// What a cache is told.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Belief {
    /// All light comes from -x, where there is none, and from the lamp that nothing sees.
    Elsewhere,
    /// The same, of one point alone.
    OnePoint,
    /// Every point has seen something else, by a factor of 1e24.
    Noise,
}

const BELIEFS: [Belief; 3] = [Belief::Elsewhere, Belief::OnePoint, Belief::Noise];

/// Point `i` of `count` on the unit sphere, on a spiral.
fn spiral(i: u32, count: u32) -> Vec3 {
    let z = 1.0 - (2 * i + 1) as f32 / count as f32;
    let (sin, cos) = (2.399_963_2 * i as f32).sin_cos(); // the golden angle
    let r = (1.0 - z * z).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

fn records(belief: Belief) -> Vec<Record> {
    let count = if belief == Belief::OnePoint { 1 } else { 4000 };
    let area = 4.0 * std::f32::consts::PI * RADIUS * RADIUS / count as f32;
    let record = |i: u32| {
        let n = if belief == Belief::OnePoint { Vec3::NEG_X } else { spiral(i, count) };
        let mut sampler = Sampler::new(5, i, 0);
        let (wi, irradiance) = match belief {
            Belief::Noise => {
                (spiral((sampler.random() * count as f32) as u32, count), 10.0_f32.powf(24.0 * sampler.random() - 12.0))
            }
            _ => (Vec3::NEG_X, 10.0 * n.dot(Vec3::NEG_X).max(0.0)),
        };
        let light = |light: u32| LightRecord { light, visible: if light == 2 { 1.0 } else { 0.0 }, unshadowed: 1.0 };
        let incident = Incident { wi, irradiance };
        Record {
            p: RADIUS * n,
            n,
            area,
            irradiance: Rgb::new(1.0, 0.1, 0.01) * irradiance,
            lights: (0..3).map(light).collect(),
            directions: vec![incident],
            indirect: (irradiance > 0.0).then_some(incident),
        }
    };
    (0..count).map(record).collect()
}

/// A guide of the sphere that believes it.
fn misled(scene: &Scene, settings: &RenderSettings, belief: Belief) -> Guide {
    let mut guide = Guide::new(scene, settings);
    let surface = scene.instances[0].surfaces;
    let (plan, medium) = guide.plan(surface).expect("a medium");
    let of_field = FieldSettings {
        walk: plan.walk,
        exact: plan.exact,
        cell: 0.5 * RADIUS,
        least_lit: 1,
        uniform_area: false,
        normals: 7,
        classical: guide.start_fraction(plan.walk == Walk::Mixture),
        guided_first: true,
        guide_exits: plan.walk == Walk::Mixture,
    };
    let field = Field::build(&records(belief), &medium.medium, &scene.lights.parts(), of_field);
    guide.fields[0] = Some(Box::new(field));
    guide
}

/// Mean of all samples of passes that learn from each other.
fn picture(scene: &Scene, guide: &mut Guide, passes: &[u32], seed: u32) -> Vec<[f64; 3]> {
    let mut sums = vec![DVec3::ZERO; (SIZE * SIZE) as usize];
    let mut done = 0;
    for &count in passes {
        let of_pixel = |pixel: u32| samples(scene, guide, pixel, done..done + count, seed);
        let seen: Vec<(DVec3, Statistics)> = (0..SIZE * SIZE).into_par_iter().map(of_pixel).collect();
        let mut learned = Statistics::default();
        for (sum, (light, statistics)) in sums.iter_mut().zip(seen) {
            *sum += light;
            learned.merge(statistics);
        }
        guide.learn(&learned);
        done += count;
    }
    sums.into_iter().map(|sum| (sum / f64::from(done)).to_array()).collect()
}

fn samples(scene: &Scene, guide: &Guide, pixel: u32, samples: std::ops::Range<u32>, seed: u32) -> (DVec3, Statistics) {
    let path = PathSettings { max_depth: 8, lights_visible_to_camera: false };
    let (mut sum, mut stats, mut log) = (DVec3::ZERO, PathStats::default(), WalkLog::default());
    for sample in samples {
        let mut sampler = Sampler::new(seed, pixel, sample);
        let raster = Vec2::new((pixel % SIZE) as f32, (pixel / SIZE) as f32) + sampler.next_2d();
        let ray = scene.camera.ray(raster, Vec2::splat(0.5), 0.5);
        let found = trace(scene.middle(), guide, path, ray, &mut sampler, &mut stats, &mut log, &mut [], &mut []);
        sum += found.color().as_dvec3();
    }
    assert_eq!((stats.non_finite, stats.walk.too_long), (0, 0));
    (sum, log.statistics)
}

fn difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> Difference {
    Difference::new(a.iter().zip(b).map(|(a, b)| [0, 1, 2].map(|c| a[c] - b[c])).collect())
}

fn classical(scene: &Scene) -> Vec<[f64; 3]> {
    let mut guide = Guide::new(scene, &asked("classical", "auto"));
    picture(scene, &mut guide, &[2048], 1000)
}

const PASSES: [u32; 4] = [4, 28, 96, 256];

#[test]
fn wrong_caches_render_the_classical_image() {
    let scene = lit_sphere();
    let (reference, mut tests) = (classical(&scene), Vec::new());
    let ways =
        [("mixture", "exact"), ("bono", "exact"), ("bill", "exact"), ("bono", "conditional"), ("bill", "conditional")];
    for (i, belief) in BELIEFS.into_iter().enumerate() {
        for (j, (walk, pdf)) in ways.into_iter().enumerate() {
            let mut guide = misled(&scene, &asked(walk, pdf), belief);
            let [regions, lit] = guide.counts();
            assert!(regions > 0 && lit > 0, "{belief:?}");
            let image = picture(&scene, &mut guide, &PASSES, (10 * i + j) as u32);
            if pdf == "exact" {
                let started = guide.fields[0].as_ref().map_or(0, |field| field.started().count());
                assert!(started > 0 || belief == Belief::OnePoint, "{belief:?}: no walk asks the cache");
            }
            tests.extend(difference(&image, &reference).tests(&format!("{belief:?}, {walk} {pdf}")));
        }
    }
    judge("wrong caches", tests);
}

/// A normal that is not unit makes densities wrong, not just unwise: the judge sees a tenth.
#[test]
fn wrong_densities_do_not() {
    let scene = lit_sphere();
    let mut guide = misled(&scene, &asked("mixture", "exact"), Belief::OnePoint);
    let mut wrong = Techniques { guided_first: true, ..Techniques::default() };
    wrong.set_normal(1, Vec3::new(0.0, 0.0, -1.1));
    let guided = [0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    wrong.shares = PerTechnique { guided: [guided; 3], classical: [0.1 / 3.0; 3] };
    wrong.shares = wrong.shares.scaled(1.0 / wrong.shares.sum());
    guide.fields[0].as_mut().expect("a field").elsewhere = wrong;
    let image = picture(&scene, &mut guide, &PASSES, 7);
    let failed = failures(&difference(&image, &classical(&scene)).tests("wrong densities"));
    eprintln!("{failed:?}");
    assert!(!failed.is_empty());
}
