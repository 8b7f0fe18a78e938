//! The parts that walks get of a step, against the walks that made it.
//!
//! Of the steps to x from a group of vertices x_k, walk k has made the share A_k F_k / (sum_i A_i F_i) by weight, if F is right. So for
//! every function e of x_k and x, e of the walk that made the step less the mean of e by parts has the mean 0 over steps.
//! With the logarithm of a factor of F for e this is the score of the factor's exponent: over the mean variance of e by parts it is
//! how far the exponent that walks show is from the one that `reach` has. Pictures tell much less of it: what one pixel loses its
//! neighbours get, whose walks see much the same.

use super::*;
use crate::camera::CameraRay;
use crate::delegate::{DirtyBits, RenderDelegate};
use crate::flat::{Camera, Interpolation, Light, LightShape, Material, Mesh, PreviewSurface, Prim, Primvar};
use crate::flat::{Projection, RenderSettings};
use crate::guiding::Guide;
use crate::integrator::{PathSettings, WalkLog, trace};
use crate::sampling::sampler::Sampler;
use crate::scene::Scene;
use glam::{DVec3, Vec2};
use std::collections::BTreeMap;

/// Pixels along a side of the picture; a pixel is a unit wide.
const SIDE: i32 = 8;
/// Of samples, whose scores are independent: seeds.
const BATCHES: std::ops::Range<u32> = 1000..1064;

/// Logarithms of what F has, or of what it would be mistaken with.
const FACTORS: [&str; 6] = ["geometric cosine", "shading cosine", "cosine at exit", "squared", "depth", "weight"];
type Factors = [Rgb; FACTORS.len()];

/// Whose steps they are.
const STEPS: [&str; 4] = ["entry to collision", "entry to exit", "collision to collision", "collision to exit"];

/// What a step shows of each exponent: scores of the batch under way, of all batches, and the information of all.
#[derive(Default, Clone)]
struct Scores {
    batch: [DVec3; FACTORS.len()],
    batches: Vec<[DVec3; FACTORS.len()]>,
    information: [DVec3; FACTORS.len()],
}

impl Scores {
    /// A step that came with `weight`: by member of the group its part and factors; `own` made it.
    fn add(&mut self, weight: DVec3, parts: &[(DVec3, Factors)], own: usize) {
        for f in 0..FACTORS.len() {
            let e = |n: usize| parts[n].1[f].as_dvec3();
            let mean: DVec3 = (0..parts.len()).map(|n| parts[n].0 * e(n)).sum();
            let square: DVec3 = (0..parts.len()).map(|n| parts[n].0 * (e(n) - mean) * (e(n) - mean)).sum();
            self.batch[f] += weight * (e(own) - mean);
            self.information[f] += weight * square;
        }
    }

    /// Takes in those of as many other batches.
    fn join(&mut self, other: &Self) {
        self.batches.resize(other.batches.len(), Default::default());
        for (batch, other) in self.batches.iter_mut().zip(&other.batches) {
            (0..FACTORS.len()).for_each(|f| batch[f] += other[f]);
        }
        (0..FACTORS.len()).for_each(|f| self.information[f] += other.information[f]);
    }

    /// The difference of the exponent `f` in the channel `c`, and its standard error.
    fn exponent(&self, f: usize, c: usize) -> (f64, f64) {
        let n = self.batches.len() as f64;
        let scores = || self.batches.iter().map(|batch| batch[f][c]);
        let mean = scores().sum::<f64>() / n;
        let variance = scores().map(|score| (score - mean) * (score - mean)).sum::<f64>() / (n - 1.0);
        let information = self.information[f][c] / n;
        (mean / information, (variance / n).sqrt() / information)
    }
}

/// With which the less likely ways are looked along.
const LOOKS: f32 = 0.3;

/// What belongs to the step of `entry` from its vertex `stage` to `to`.
fn factors(entry: &Entry, stage: usize, to: &Vertex) -> Factors {
    let ln = |x: f32| Rgb::splat(x.max(1e-3).ln());
    let from = if stage == 0 { entry.start.p } else { entry.vertices()[stage - 1].p };
    let (d, t) = ((to.p - from).normalize(), from.distance(to.p));
    let [geometric, shading] = [entry.start.normal, entry.normal].map(|n| if stage == 0 { -d.dot(n) } else { 1.0 });
    let exit = if let Kind::Leaves(n) = to.kind { d.dot(n) } else { 1.0 };
    let weight = entry.weight(stage);
    let weight = Rgb::new(weight.x.ln(), weight.y.ln(), weight.z.ln());
    [ln(geometric), ln(shading), ln(exit), -2.0 * ln(t), -entry.medium.sigma_t * t, weight]
}

/// Takes in the steps from the vertices `stage` of all paths.
fn score(shared: &Shared, scene: &Scene, stage: usize, shift: Vec3, scores: &mut [Scores]) {
    let mut groups = BTreeMap::<Group, Vec<&Entry>>::new();
    let mut walks = Walks::default();
    for member in &shared.members {
        if let Some(group) = member.group(stage, shift) {
            groups.entry(group).or_default().push(&member.entry);
        }
    }
    for (of, entries) in groups.iter().filter(|(_, entries)| entries.len() > 1) {
        let enclosure = InstanceEnclosure::new(scene.middle(), of.0[0]);
        walks.gather(entries.iter().copied(), stage, 0);
        for (own, entry) in entries.iter().enumerate() {
            let Some(to) = entry.vertices().get(stage).filter(|to| !to.kind.is_own()) else { continue };
            walks.part(to, own, entry.start.d);
            let sees = |k: usize| entries[k].sees(&enclosure, stage, to);
            let parts = |walks: &Walks| (0..entries.len()).map(|k| walks.part_of(k).as_dvec3()).collect::<Vec<_>>();
            walks.look(own, LARGE, 1.0, sees);
            let seldom = parts(&walks);
            walks.look(own, 0.0, LOOKS, sees);
            // The mean of looking and not.
            let part = |(n, then): (usize, DVec3)| {
                (seldom[n] + f64::from(LOOKS) * (then - seldom[n]), factors(entries[n], stage, to))
            };
            let parts: Vec<_> = parts(&walks).into_iter().enumerate().map(part).collect();
            let step = 2 * usize::from(stage > 0) + usize::from(matches!(to.kind, Kind::Leaves(_)));
            scores[step].add(to.weight.as_dvec3(), &parts, own);
        }
    }
}

/// A body seen from above, `depth` deep below ridges along y of a period of 4 and the height `ridges`, with normals as if there were none.
fn body(depth: f32, ridges: f32) -> Mesh {
    const HALF: usize = 12; // in slopes, each 2 wide
    let n = 2 * HALF;
    let row = |y: f32, z: &dyn Fn(usize) -> f32| -> Vec<[f32; 3]> {
        (0..=n).map(|i| [2.0 * (i as f32 - HALF as f32), y, z(i)]).collect()
    };
    let top = |i: usize| if i % 2 == 1 { ridges } else { 0.0 };
    let points = [row(-24.0, &top), row(24.0, &top), row(-24.0, &|_| -depth), row(24.0, &|_| -depth)].concat();
    let at = |row: usize, i: usize| (row * (n + 1) + i) as i32;
    let mut indices = vec![[at(0, 0), at(1, 0), at(3, 0), at(2, 0)], [at(0, n), at(2, n), at(3, n), at(1, n)]];
    for i in 0..n {
        indices.push([at(0, i), at(0, i + 1), at(1, i + 1), at(1, i)]);
        indices.push([at(2, i), at(3, i), at(3, i + 1), at(2, i + 1)]);
        indices.push([at(0, i + 1), at(0, i), at(2, i), at(2, i + 1)]);
        indices.push([at(1, i), at(1, i + 1), at(3, i + 1), at(3, i)]);
    }
    let normals: Vec<_> = (0..points.len()).map(|i| [0.0, 0.0, if i < 2 * (n + 1) { 1.0 } else { -1.0 }]).collect();
    Mesh {
        points: points.into(),
        face_vertex_counts: vec![4; indices.len()].into(),
        face_vertex_indices: indices.concat().into(),
        normals: Some(Primvar { interpolation: Interpolation::Vertex, values: normals.into(), indices: None }),
        material: "/M".into(),
        ..Mesh::default()
    }
}

fn wax(albedo: f32, radius: f32) -> Prim {
    Prim::Material(Material::UsdPreviewSurface(PreviewSurface {
        subsurface: 1.0,
        ior: 1.0,
        subsurface_albedo: Some([albedo, 0.9 * albedo, 0.5 * albedo]),
        subsurface_radius: [1.2 * radius, radius, radius / 1.2],
        ..PreviewSurface::default()
    }))
}

/// The same behind a dielectric, which is smooth where `roughness` is 0.
fn glass(albedo: f32, radius: f32, roughness: f32) -> Prim {
    let Prim::Material(Material::UsdPreviewSurface(wax)) = wax(albedo, radius) else { unreachable!() };
    let boundary = "dielectric".into();
    let glass = PreviewSurface { ior: 1.4, roughness, subsurface_boundary: boundary, ..wax };
    Prim::Material(Material::UsdPreviewSurface(glass))
}

fn settings([walk, pdf]: [&str; 2]) -> RenderSettings {
    RenderSettings {
        camera: "/C".into(),
        resolution: [SIDE as u32; 2],
        walk: walk.into(),
        walk_pdf: pdf.into(),
        classical_fraction: 0.5,
        shared_paths: "on".into(),
        ..RenderSettings::default()
    }
}

fn delegate(body: Mesh, medium: Prim) -> RenderDelegate {
    let mut camera = Camera {
        projection: Projection::Orthographic,
        horizontal_aperture: 10.0 * SIDE as f32,
        vertical_aperture: 10.0 * SIDE as f32,
        focal_length: 1.0,
        clipping_range: [1.0, 100.0],
        ..Camera::default()
    };
    camera.transform[3][2] = 20.0;
    let shape = LightShape::Dome { texture: String::new(), pole_axis: "Y".into() };
    let mut delegate = RenderDelegate::new();
    delegate.sync("/O", Prim::Mesh(body), DirtyBits::ALL);
    delegate.sync("/M", medium, DirtyBits::ALL);
    delegate.sync("/C", Prim::Camera(camera), DirtyBits::ALL);
    delegate.sync("/L", Prim::Light(Light { shape, ..Light::default() }), DirtyBits::ALL);
    delegate
}

/// By [`STEPS`], of so many samples per pixel and batch.
fn scores(mut delegate: RenderDelegate, walk: [&str; 2], samples: u32) -> Vec<Scores> {
    let settings = settings(walk);
    delegate.set_settings(settings.clone()).expect("settings");
    delegate.commit().expect("commit");
    let scene = delegate.scene().expect("scene").clone();
    let guide = Guide::new(&scene, &settings);
    let mut scores = vec![Scores::default(); STEPS.len()];
    let mut shared = Shared::default();
    for batch in BATCHES {
        for sample in 0..samples {
            paths(&scene, &guide, (batch, sample), &mut shared);
            let mut sampler = Sampler::new(batch, u32::MAX, sample);
            let shift = Vec3::new(sampler.random(), sampler.random(), sampler.random());
            let most = shared.members.iter().map(|member| member.entry.most).max().expect("paths");
            (0..most).for_each(|stage| score(&shared, &scene, stage, shift, &mut scores));
        }
        for scores in &mut scores {
            scores.batches.push(std::mem::take(&mut scores.batch));
        }
    }
    scores
}

/// One path of each pixel.
fn paths(scene: &Scene, guide: &Guide, (seed, sample): (u32, u32), shared: &mut Shared) {
    let path = PathSettings { max_depth: 1, lights_visible_to_camera: true };
    let mut log = WalkLog::default();
    log.shares = true;
    shared.clear(0);
    for pixel in 0..SIDE * SIDE {
        let at = [pixel % SIDE, pixel / SIDE];
        let mut sampler = Sampler::new(seed, pixel as u32, sample);
        let raster = Vec2::new(at[0] as f32, at[1] as f32) + sampler.next_2d();
        let ray: CameraRay = scene.camera.ray(raster, sampler.skip_2d(), 0.0);
        let stats = &mut PathStats::default();
        trace(scene.middle(), guide, path, ray, &mut sampler, stats, &mut log, &mut [], &mut []);
        // Where the surface has not reflected it.
        if let Some(entry) = log.entry.take() {
            shared.push(pixel as usize, at, entry, &log.rows);
        }
    }
}

/// What is to be joined into one estimate: body, medium, walk with its weights, samples of a pixel per batch.
type Case<'a> = (&'a str, Mesh, Prim, [&'a str; 2], u32);

/// Of all cases, and of each; none may be off.
fn judged(cases: Vec<Case>) -> Vec<Scores> {
    let mut all = vec![Scores::default(); STEPS.len()];
    let mut off = Vec::new();
    for (case, body, medium, walk, samples) in cases {
        let scores = scores(delegate(body, medium), walk, samples);
        all.iter_mut().zip(&scores).for_each(|(all, scores)| all.join(scores));
        off.extend(exponents_off(case, &scores));
    }
    off.extend(exponents_off("all", &all));
    assert!(off.is_empty(), "{off:#?}");
    all
}

/// Exponents that differ from those of `reach` by more than chance.
fn exponents_off(case: &str, scores: &[Scores]) -> Vec<String> {
    let mut off = Vec::new();
    for (step, scores) in STEPS.iter().zip(scores) {
        for (f, factor) in FACTORS.iter().enumerate() {
            // What all in a group have alike says nothing.
            for c in (0..3).filter(|c| scores.information[f][*c] > 1e-9) {
                let (exponent, error) = scores.exponent(f, c);
                let z = exponent / error;
                let line = format!("{case}, {step}, {factor}, channel {c}: {exponent:.4} +- {error:.4}, z {z:.1}");
                println!("{line}");
                // Some 600 numbers, hardly a hundred of them independent, with 63 degrees of freedom: once in 300 times.
                off.extend((z.abs() >= 4.5).then_some(line));
            }
        }
    }
    off
}

/// Grouped by 4 pixels, by 7 and all, as mean free paths have it.
#[test]
fn parts_are_those_of_the_walks_that_make_the_steps() {
    let classical = ["classical", "auto"];
    let all = judged(vec![
        ("by 4", body(1.5, 0.0), wax(0.9, 1.45), classical, 40),
        ("by 7", body(1.5, 0.0), wax(0.9, 1.55), classical, 160),
        ("thin by 7", body(0.6, 0.0), wax(0.9, 1.55), classical, 60),
        ("all", body(3.0, 0.0), wax(0.9, 12.0), classical, 16),
    ]);
    for (step, scores) in STEPS.iter().zip(&all) {
        for factor in ["squared", "depth"] {
            let f = FACTORS.iter().position(|name| *name == factor).expect("a factor");
            let (_, error) = scores.exponent(f, 2);
            assert!(error < 0.01, "{step}, {factor}: 5 % would not be seen, {error}");
        }
    }
}

/// Walls are in the way, and normals differ from pixel to pixel and from the shading normals; walks along a slab normal have weights
/// that differ.
#[test]
fn parts_between_ridges_are_those_of_the_walks_that_make_the_steps() {
    judged(vec![
        ("ridges by 4", body(1.0, 2.0), wax(0.9, 1.45), ["poe", "conditional"], 40),
        ("ridges by 7", body(1.0, 2.0), wax(0.9, 1.55), ["poe", "exact"], 40),
        ("ridges, all", body(1.0, 2.0), wax(0.9, 12.0), ["classical", "auto"], 40),
    ]);
}

/// Walks go on where the boundary reflects them, with what its facets left of their weights.
#[test]
fn parts_behind_dielectrics_are_those_of_the_walks_that_make_the_steps() {
    let all = judged(vec![
        ("smooth", body(1.5, 0.0), glass(0.95, 1.55, 0.0), ["classical", "auto"], 40),
        ("rough", body(1.5, 0.0), glass(0.95, 1.55, 0.6), ["poe", "exact"], 40),
        ("rough ridges", body(1.0, 2.0), glass(0.95, 1.55, 0.4), ["classical", "auto"], 40),
        ("wide", body(12.0, 0.0), glass(0.95, 12.0, 0.0), ["classical", "auto"], 16),
    ]);
    let within = STEPS.iter().position(|step| *step == "collision to collision").expect("a step");
    for factor in ["squared", "depth", "weight"] {
        let f = FACTORS.iter().position(|name| *name == factor).expect("a factor");
        let (_, error) = all[within].exponent(f, 2);
        assert!(error < 0.015, "{factor}: 7 % would not be seen, {error}");
    }
}
