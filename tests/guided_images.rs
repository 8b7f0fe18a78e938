//! Renders with every guided walk against classical ones: same image, whatever guides the walks.

mod support;

use dermis::flat::{Light, LightShape, Material, Mesh, PreviewSurface, RenderSettings};
use glam::{DVec3, Vec3};
use support::difference::Difference;
use support::slab::judge;
use support::{camera, cuboid, plane, render, scene, settings, sphere};

/// A body and its light.
struct Scene {
    name: &'static str,
    body: Mesh,
    medium: PreviewSurface,
    lights: Vec<Light>,
    eye: DVec3,
    fov: f32,
    /// Dozens of collisions: conditional weights have tails that no test sees the end of.
    thick: bool,
}

impl Scene {
    fn delegate(&self) -> dermis::delegate::RenderDelegate {
        let material = Material::UsdPreviewSurface(self.medium.clone());
        scene(self.body.clone(), material, self.lights.clone(), camera(self.eye, self.fov))
    }
}

fn medium(boundary: &str, albedo: [f32; 3], radius: [f32; 3], g: f32, roughness: f32) -> PreviewSurface {
    PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some(albedo),
        subsurface_radius: radius,
        subsurface_anisotropy: g,
        subsurface_boundary: boundary.to_owned().into(),
        ior: if boundary == "indexMatched" { 1.0 } else { 1.4 },
        roughness,
        ..PreviewSurface::default()
    }
}

fn sky(intensity: f32) -> Light {
    Light { shape: LightShape::Dome { texture: String::new(), pole_axis: "Y".into() }, intensity, ..Light::default() }
}

/// A rectangle at `z` that shines towards -z, or towards +z where `turned`.
fn rect(z: f64, width: f32, intensity: f32, turned: bool) -> Light {
    let mut light = Light {
        shape: LightShape::Rect { width, height: width, texture: String::new() },
        intensity,
        ..Light::default()
    };
    if turned {
        light.transform[0][0] = -1.0;
        light.transform[2][2] = -1.0;
    }
    light.transform[3] = [0.3, 0.4, z, 1.0];
    light
}

fn scenes() -> Vec<Scene> {
    let eye = DVec3::new(1.0, 1.5, 6.0);
    let (front, behind) = (|i| rect(3.0, 1.5, i, false), |i| rect(-3.0, 1.5, i, true));
    // Shines away from everything: never seen.
    let unlit = || rect(4.0, 1.0, 100.0, true);
    let plate = || cuboid(Vec3::new(0.8, 0.8, 0.15));
    let cube = || cuboid(Vec3::splat(0.5));
    let of = |name, body, medium, lights, fov| Scene { name, body, medium, lights, eye, fov, thick: false };
    let thick = |name, body, medium, lights, fov| Scene { name, body, medium, lights, eye, fov, thick: true };
    vec![
        of(
            "plate diffuse gray",
            plate(),
            medium("diffuse", [0.9; 3], [0.12; 3], 0.0, 0.5),
            vec![behind(8.0), sky(0.1)],
            14.0,
        ),
        of(
            "sphere diffuse rgb",
            sphere(12, 0.7),
            medium("diffuse", [0.99, 0.9, 0.8], [0.6, 0.4, 0.3], 0.0, 0.5),
            vec![front(3.0), behind(6.0), unlit()],
            13.0,
        ),
        of(
            "plate diffuse rgb g",
            plate(),
            medium("diffuse", [0.95, 0.9, 0.7], [0.2, 0.1, 0.1], 0.5, 0.5),
            vec![sky(0.3), behind(8.0)],
            14.0,
        ),
        of(
            "cube rough gray g",
            cube(),
            medium("dielectric", [0.95; 3], [0.4; 3], 0.5, 0.3),
            vec![behind(6.0), front(2.0)],
            14.0,
        ),
        of(
            "sphere smooth rgb",
            sphere(12, 0.7),
            medium("dielectric", [0.99, 0.9, 0.8], [0.6, 0.5, 0.4], 0.0, 0.0),
            vec![sky(1.0), behind(5.0)],
            13.0,
        ),
        of(
            "cube matched gray g",
            cube(),
            medium("indexMatched", [0.95; 3], [0.4; 3], 0.5, 0.0),
            vec![behind(6.0), front(3.0)],
            14.0,
        ),
        of(
            "sphere matched rgb",
            sphere(12, 0.7),
            medium("indexMatched", [0.99, 0.9, 0.8], [0.6, 0.4, 0.3], 0.0, 0.0),
            vec![sky(1.0), front(3.0), unlit()],
            13.0,
        ),
        thick(
            "thick sphere diffuse rgb",
            sphere(12, 0.7),
            medium("diffuse", [0.99, 0.95, 0.8], [0.1, 0.05, 0.02], 0.0, 0.5),
            vec![behind(8.0), front(2.0)],
            13.0,
        ),
        thick(
            "thick cube rough rgb g",
            cube(),
            medium("dielectric", [0.999, 0.97, 0.9], [0.1, 0.08, 0.04], 0.5, 0.3),
            vec![sky(0.5), behind(5.0)],
            14.0,
        ),
        thick(
            "thick cube matched gray g",
            cube(),
            medium("indexMatched", [0.98; 3], [0.05; 3], -0.4, 0.0),
            vec![sky(0.5), front(3.0)],
            14.0,
        ),
    ]
}

const SIZE: u32 = 16;

/// Samples of a pixel, of a guided render and of the classical one that all are compared with.
const SAMPLES: u32 = 512;
const REFERENCE_SAMPLES: u32 = 8 * SAMPLES;

/// Settings that differ from the classical walk's.
type Change = fn(&mut RenderSettings);

/// Each walk with each weight and first distance, then what else steers the mixture and the walks it came from.
fn variants() -> Vec<(String, RenderSettings)> {
    let mut variants = Vec::new();
    let mut add = |walk: &str, pdf: &str, what: &str, change: Change| {
        let mut settings = RenderSettings { walk: walk.into(), walk_pdf: pdf.into(), ..settings(SIZE, SAMPLES) };
        change(&mut settings);
        variants.push((format!("{walk} {pdf} {what}"), settings));
    };
    let classical_first: Change = |s| s.first_distance = "classical".into();
    for walk in ["poe", "bono", "bill", "mixture"] {
        for pdf in ["conditional", "exact"] {
            add(walk, pdf, "", |_| ());
            add(walk, pdf, "classical first", classical_first);
        }
    }
    add("cp", "conditional", "", |_| ());
    add("cp", "exact", "", |_| ());
    add("ii", "conditional", "", |_| ());
    add("poe", "conditional", "and classical", |s| s.classical_fraction = 0.3);
    add("bono", "exact", "and classical", |s| s.classical_fraction = 0.3);
    add("bono", "conditional", "camera", |s| s.cache_fill = "camera".into());
    add("bill", "exact", "one cell", |s| s.cache_resolution = 1);
    add("mixture", "exact", "no controls", |s| s.control_variates = false);
    add("mixture", "exact", "classical first, no controls", |s| {
        (s.first_distance, s.control_variates) = ("classical".into(), false);
    });
    add("mixture", "exact", "as it starts", |s| (s.control_variates, s.learn_shares) = (false, false));
    add("mixture", "exact", "camera", |s| s.cache_fill = "camera".into());
    add("mixture", "exact", "one cell", |s| s.cache_resolution = 1);
    add("mixture", "exact", "small cells", |s| s.cache_resolution = 100);
    add("mixture", "exact", "point of entry alone", |s| s.normals = 0);
    add("mixture", "exact", "learned lights", |s| s.exit_lights = "learned".into());
    variants
}

/// A weight that is exact is bounded; the others are judged where bodies are a few mean free paths thick.
fn tame(scene: &Scene, settings: &RenderSettings) -> bool {
    !scene.thick || (settings.walk_pdf == "exact" && settings.walk != "bono" && settings.walk != "bill")
}

#[test]
fn every_guide_renders_the_classical_image() {
    let (variants, mut tests) = (variants(), Vec::new());
    let mut pooled = vec![(0.0, 0.0_f64); variants.len()];
    for scene in scenes() {
        let mut delegate = scene.delegate();
        let classical = RenderSettings { walk: "classical".into(), seed: 1000, ..settings(SIZE, REFERENCE_SAMPLES) };
        let reference = plane(&render(&mut delegate, classical), "color").to_vec();
        for (i, (name, settings)) in variants.iter().enumerate().filter(|(_, v)| tame(&scene, &v.1)) {
            let planes = render(&mut delegate, RenderSettings { seed: i as u32, ..settings.clone() });
            let stats = delegate.stats();
            assert_eq!((&stats["non_finite_samples"], &stats["walks_too_long"]), (&0.into(), &0.into()));
            let difference = Difference::of(plane(&planes, "color"), &reference);
            tests.extend(difference.tests(&format!("{}, {name}", scene.name)));
            pooled[i].0 += difference.z(|_, _| true, |d| d[0] + d[1] + d[2]);
            pooled[i].1 += 1.0;
        }
    }
    judge("images", tests);
    let pooled = variants.into_iter().zip(pooled).map(|((name, _), (sum, n))| (name, sum / n.sqrt()));
    judge("all scenes", pooled.collect());
}

/// One seed, one image for any number of threads, though every pass learns from the one before.
#[test]
fn learned_images_are_the_same_for_any_number_of_threads() {
    let bodies = scenes();
    for (walk, body) in [("mixture", 1), ("mixture", 4), ("bono", 3), ("bill", 6)] {
        let image = |threads| {
            let settings = RenderSettings { threads, walk: walk.into(), ..settings(40, 24) };
            render(&mut bodies[body].delegate(), settings)
        };
        let one = image(1);
        assert!(plane(&one, "subsurface").iter().any(|x| *x != 0.0));
        assert_eq!(one, image(2), "{walk}, two threads");
        assert_eq!(one, image(5), "{walk}, five threads");
    }
}
