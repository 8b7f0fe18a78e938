//! Light sampled through dielectrics: the same image as by chance alone, and exact geometry.

mod support;

use dermis::delegate::{DirtyBits, RenderDelegate};
use dermis::flat::{
    AnyPrimvar, GeomSubset, Interpolation, Light, LightShape, Material, Mesh, Network, Node, PreviewSurface, Prim,
    Primvar, RenderSettings, Texture,
};
use glam::{DMat3, DVec3, Vec3};
use support::slab::judge;
use support::{camera, channel, cuboid, mean_and_error, plane, render, scene, settings, sphere};

const SIZE: u32 = 16;

struct Case {
    name: &'static str,
    body: Mesh,
    medium: PreviewSurface,
    lights: Vec<Light>,
    walk: &'static str,
    samples: u32,
}

fn medium(albedo: [f32; 3], radius: [f32; 3], g: f32, ior: f32) -> PreviewSurface {
    PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some(albedo),
        subsurface_radius: radius,
        subsurface_anisotropy: g,
        subsurface_boundary: "dielectric".into(),
        ior,
        roughness: 0.0,
        ..PreviewSurface::default()
    }
}

/// With interpolated normals.
fn smooth(mesh: Mesh) -> Mesh {
    Mesh { subdivision_scheme: "loop".into(), ..mesh }
}

/// A ball with waves of a fifth of its radius, interpolated normals.
fn bumpy() -> Mesh {
    let mut ball = smooth(sphere(24, 0.7));
    let waves = |p: &[f32; 3]| {
        let p = Vec3::from(*p);
        let height = (7.0 * p.x).sin() * (6.0 * p.y + 1.0).sin() * (5.0 * p.z + 2.0).sin();
        (p * (1.0 + 0.2 * height)).to_array()
    };
    ball.points = ball.points.iter().map(waves).collect::<Vec<_>>().into();
    ball
}

/// A cube that stands on no axis.
fn cube() -> Mesh {
    let mut cube = cuboid(Vec3::splat(0.5));
    let turn = DMat3::from_rotation_x(0.4) * DMat3::from_rotation_y(0.6);
    for (row, axis) in cube.transform.iter_mut().zip(turn.to_cols_array_2d()) {
        row[..3].copy_from_slice(&axis);
    }
    cube
}

/// A light behind the body, above and to the right, whose -Z looks at the origin.
fn behind(shape: LightShape, intensity: f32) -> Light {
    let mut light = Light { shape, intensity, ..Light::default() };
    let at = DVec3::new(0.8, 1.0, -1.6);
    let z = at.normalize();
    let x = DVec3::Y.cross(z).normalize();
    for (row, axis) in light.transform.iter_mut().zip([x, z.cross(x), z, at]) {
        row[..3].copy_from_slice(&axis.to_array());
    }
    light
}

fn rect(intensity: f32) -> Light {
    behind(LightShape::Rect { width: 1.0, height: 0.8, texture: String::new() }, intensity)
}

/// A light above the body whose plane cuts it: a half of the body is behind it.
fn across(side: f64) -> Light {
    let mut light = rect(20.0);
    light.shape = LightShape::Rect { width: 0.5, height: 0.5, texture: String::new() };
    for (row, axis) in light.transform.iter_mut().zip([DVec3::Z * side, DVec3::Y, DVec3::X * -side, DVec3::Y * 1.1]) {
        row[..3].copy_from_slice(&axis.to_array());
    }
    light
}

fn sky(texture: &str, intensity: f32) -> Light {
    Light { shape: LightShape::Dome { texture: texture.into(), pole_axis: "Y".into() }, intensity, ..Light::default() }
}

fn cases() -> Vec<Case> {
    let of = |name, body, medium, lights| Case { name, body, medium, lights, walk: "classical", samples: 128 };
    let gray = |radius, g, ior| medium([0.9; 3], [radius; 3], g, ior);
    vec![
        of("sphere, rect", smooth(sphere(16, 0.7)), gray(0.5, 0.0, 1.4), vec![rect(20.0)]),
        of("sphere, rect, thin, forward", smooth(sphere(16, 0.7)), gray(2.0, 0.8, 1.2), vec![rect(20.0)]),
        of(
            "sphere, ball, rgb",
            smooth(sphere(16, 0.7)),
            medium([0.99, 0.8, 0.5], [0.7, 0.4, 0.2], 0.0, 1.5),
            vec![behind(LightShape::Sphere { radius: 0.4 }, 20.0)],
        ),
        of(
            "bumpy, rect and distant",
            bumpy(),
            medium([0.99, 0.95, 0.8], [0.5, 0.4, 0.3], 0.0, 1.4),
            vec![rect(10.0), behind(LightShape::Distant { angle: 25.0 }, 10.0)],
        ),
        of("bumpy, dense glass", bumpy(), gray(0.4, 0.8, 2.0), vec![rect(30.0)]),
        of(
            "bumpy, cylinder, disk, sky",
            bumpy(),
            gray(0.6, 0.0, 1.3),
            vec![
                behind(LightShape::Cylinder { length: 1.0, radius: 0.2 }, 20.0),
                behind(LightShape::Disk { radius: 0.3 }, 10.0),
                sky("", 0.3),
            ],
        ),
        of("cube, rect", cube(), gray(0.4, 0.0, 1.4), vec![rect(20.0)]),
        of("cube, sun in a sky", cube(), medium([0.99, 0.9, 0.7], [0.6, 0.5, 0.4], 0.0, 1.6), vec![sky("/Sky", 1.0)]),
        of("cube of air in water", cube(), gray(0.4, 0.0, 1.0 / 1.33), vec![rect(20.0)]),
        Case { walk: "mixture", ..of("bumpy, mixture", bumpy(), gray(0.3, 0.0, 1.4), vec![rect(20.0)]) },
        Case { walk: "poe", ..of("sphere, poe", smooth(sphere(16, 0.7)), gray(0.3, 0.0, 1.4), vec![rect(20.0)]) },
    ]
}

/// A sky of so many rows with a sun two pixels high.
fn sun(height: usize, brightness: f32) -> Texture {
    let width = 2 * height;
    let row = height / 4;
    let bright =
        |i: usize| if i % width == height / 2 && (row..row + 2).contains(&(i / width)) { brightness } else { 0.2 };
    let pixels: Vec<[f32; 3]> = (0..width * height).map(|i| [bright(i); 3]).collect();
    Texture { file: "sun".into(), width: width as u32, height: height as u32, pixels: pixels.into() }
}

impl Case {
    fn delegate(&self) -> RenderDelegate {
        let material = Material::UsdPreviewSurface(self.medium.clone());
        let eye = camera(DVec3::new(1.0, 1.5, 6.0), 13.0);
        let mut delegate = scene(self.body.clone(), material, self.lights.clone(), eye);
        delegate.sync("/Sky", Prim::Texture(sun(16, 150.0)), DirtyBits::ALL);
        delegate.sync("/Sun", Prim::Texture(sun(48, 1300.0)), DirtyBits::ALL);
        delegate
    }

    fn color(&self, refracted_light: &str, samples: u32, seed: u32) -> Vec<f32> {
        let settings = RenderSettings {
            walk: self.walk.into(),
            refracted_light: refracted_light.into(),
            seed,
            ..settings(SIZE, samples)
        };
        let mut delegate = self.delegate();
        let planes = render(&mut delegate, settings);
        assert_eq!(delegate.stats()["non_finite_samples"], 0);
        plane(&planes, "color").to_vec()
    }
}

/// A sun of no size, which the search for the refracting point finds, and one of two degrees, which collisions look for. The
/// index is low: what is reflected inside is not searched for.
#[test]
fn single_directions_are_small_suns() {
    let sun = |angle, intensity| vec![behind(LightShape::Distant { angle }, intensity)];
    let case = |lights| Case {
        name: "sphere, sun",
        body: smooth(sphere(16, 0.7)),
        medium: medium([0.9; 3], [0.5; 3], 0.0, 1.1),
        lights,
        walk: "classical",
        samples: 2048,
    };
    let solid_angle = std::f32::consts::TAU * (1.0 - 1_f32.to_radians().cos());
    let single = case(sun(0.0, 10.0)).color("on", 2048, 1);
    let wide = case(sun(2.0, 10.0 / solid_angle)).color("on", 2048, 2);
    let mut tests = Vec::new();
    for c in 0..3 {
        let (single, wide) = (channel(&single, c), channel(&wide, c));
        let mut differences: Vec<f64> = single.iter().zip(&wide).map(|(a, b)| a - b).collect();
        // Where the boundary mirrors it, only the sun of some size is seen.
        differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        differences.truncate(differences.len() - 4);
        let ((mean, error), (all, _)) = (mean_and_error(&differences), mean_and_error(&single));
        eprintln!("channel {c}: {:+.4} +- {:.4} of {all:.4}", mean / all, error / all);
        assert!(error < 0.02 * all, "+- {error} of {all} sees little");
        tests.push((format!("channel {c}"), mean / error));
    }
    judge("single directions", tests);
}

/// Quarters and the whole, channel by channel: means of the pixels' differences over their spread.
fn compare(name: &str, with: &[f32], without: &[f32], tests: &mut Vec<(String, f64)>) {
    for c in 0..3 {
        let (with, without) = (channel(with, c), channel(without, c));
        let differences: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a - b).collect();
        let (all, _) = mean_and_error(&without);
        let mut test = |label: &str, values: &[f64]| {
            let (mean, error) = mean_and_error(values);
            eprintln!("{name}, {label} channel {c}: {:+.4} +- {:.4}", mean / all, error / all);
            tests.push((format!("{name}, {label} channel {c}"), mean / error.max(f64::MIN_POSITIVE)));
        };
        test("all", &differences);
        for quarter in 0..4 {
            let values = differences.chunks(differences.len() / 4).nth(quarter).expect("four");
            test(&format!("band {quarter}"), values);
        }
    }
}

#[test]
fn light_is_neither_lost_nor_counted_twice() {
    let mut tests = Vec::new();
    for case in cases() {
        let with = case.color("on", case.samples, 1);
        let without = case.color("off", 8 * case.samples, 2);
        compare(case.name, &with, &without, &mut tests);
    }
    judge("refracted light", tests);
}

/// Suns of six degrees and less, which are searched for: as large as can be, so that chance finds them, too.
fn sun_cases() -> Vec<Case> {
    let sun = |angle| vec![behind(LightShape::Distant { angle }, 300.0)];
    let of = |name, body, medium, lights, walk| Case { name, body, medium, lights, walk, samples: 256 };
    let gray = |radius, g, ior| medium([0.9; 3], [radius; 3], g, ior);
    let skin = |radius: f32| medium([0.99, 0.9, 0.7], [radius, 0.7 * radius, 0.4 * radius], 0.0, 1.5);
    let ball = || smooth(sphere(16, 0.7));
    let sky_and_rect = vec![sky("/Sun", 0.5), rect(5.0)];
    vec![
        of("sun, sphere", ball(), gray(0.3, 0.0, 1.3), sun(6.0), "classical"),
        of("sun, sphere, forward, poe", ball(), gray(0.2, 0.7, 1.4), sun(6.0), "poe"),
        of("sun, bumps, mixture", bumpy(), skin(0.1), sun(5.0), "mixture"),
        of("sun, bumps, bono", bumpy(), skin(0.2), sun(5.0), "bono"),
        of("sun in a sky, cube, mixture", cube(), skin(0.15), sky_and_rect.clone(), "mixture"),
        of("sun in a sky, bumps", bumpy(), gray(0.4, 0.0, 1.2), sky_and_rect, "classical"),
        of("sun, air in water", cube(), gray(0.3, 0.0, 1.0 / 1.33), sun(6.0), "mixture"),
    ]
}

#[test]
fn suns_are_neither_lost_nor_counted_twice() {
    let (mut tests, mut noise) = (Vec::new(), Vec::new());
    for case in sun_cases() {
        let chance = [3, 4].map(|seed| case.color("off", 8 * case.samples, seed));
        // Walks of the mixture look for other light only where they are told to.
        let ways: &[&str] = if case.walk == "mixture" { &["auto", "on"] } else { &["auto"] };
        for how in ways {
            let images = [1, 2].map(|seed| case.color(how, case.samples, seed));
            let name = format!("{}, {how}", case.name);
            compare(&name, &images[0], &chance[0], &mut tests);
            let squares = |[a, b]: &[Vec<f32>; 2]| a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            // By chance it has eight times the samples.
            noise.push((name, squares(&images) / (8.0 * squares(&chance))));
        }
    }
    eprintln!("{noise:?}");
    judge("suns", tests);
    for (name, ratio) in noise.iter().filter(|(name, _)| !name.contains("sky")) {
        assert!(*ratio < 0.5, "{name}: {ratio} of the noise of chance");
    }
}

/// Walks of the mixture search for a single direction as classical ones do.
#[test]
fn guided_walks_see_single_directions() {
    let lights = vec![behind(LightShape::Distant { angle: 0.0 }, 10.0)];
    let [classical, guided] = ["classical", "mixture"].map(|walk| {
        let medium = medium([0.99, 0.9, 0.7], [0.1, 0.07, 0.05], 0.0, 1.3);
        Case { name: "single", body: bumpy(), medium, lights: lights.clone(), walk, samples: 2048 }
    });
    let mut tests = Vec::new();
    compare("single direction", &guided.color("auto", 2048, 1), &classical.color("on", 2048, 2), &mut tests);
    judge("single directions in guided walks", tests);
}

/// Behind rough boundaries every light with a size or none is looked for by facets.
fn rough_cases() -> Vec<Case> {
    let of = |name, body, roughness, albedo, radius: [f32; 3], (g, ior), lights, walk| {
        let medium = PreviewSurface { roughness, ..medium(albedo, radius, g, ior) };
        Case { name, body, medium, lights, walk, samples: 256 }
    };
    let sun = |angle| vec![behind(LightShape::Distant { angle }, if angle > 0.0 { 1000.0 } else { 10.0 })];
    let (gray, skin) = ([0.9; 3], [0.99, 0.9, 0.7]);
    let ball = || smooth(sphere(16, 0.7));
    vec![
        of("rough sphere, sun", ball(), 0.35, gray, [0.2; 3], (0.0, 1.5), sun(2.0), "classical"),
        of("rough sphere, a single direction", ball(), 0.5, gray, [0.5; 3], (0.0, 1.3), sun(0.0), "classical"),
        of("rough sphere, rect, thin, forward", ball(), 0.2, gray, [2.0; 3], (0.8, 1.2), vec![rect(20.0)], "classical"),
        of("rough bumps, sun, mixture", bumpy(), 0.35, skin, [0.1, 0.07, 0.03], (0.0, 1.5), sun(2.0), "mixture"),
        of("rough bumps, forward, mixture", bumpy(), 0.6, skin, [0.2, 0.15, 0.1], (0.5, 1.4), sun(5.0), "mixture"),
        of("rough bumps, rect, poe", bumpy(), 0.3, skin, [0.3, 0.2, 0.1], (0.0, 1.4), vec![rect(20.0)], "poe"),
        of(
            "rough cube, sun in a sky",
            cube(),
            0.35,
            skin,
            [0.2, 0.15, 0.1],
            (0.0, 1.5),
            vec![sky("/Sky", 1.0)],
            "mixture",
        ),
        of("rough cube of air in water", cube(), 0.35, gray, [0.3; 3], (0.0, 1.0 / 1.33), sun(3.0), "classical"),
        of(
            "rough sphere, back to back",
            ball(),
            0.5,
            gray,
            [0.4; 3],
            (0.0, 1.4),
            vec![across(1.0), across(-1.0)],
            "classical",
        ),
        of(
            "rough cube, ball, cylinder, disk",
            cube(),
            0.4,
            gray,
            [0.2; 3],
            (0.0, 1.4),
            vec![
                behind(LightShape::Sphere { radius: 0.2 }, 20.0),
                behind(LightShape::Cylinder { length: 0.6, radius: 0.05 }, 40.0),
                behind(LightShape::Disk { radius: 0.15 }, 20.0),
            ],
            "bono",
        ),
    ]
}

/// The same image as by chance; and less noise by far, where the sun is small.
#[test]
fn rough_boundaries_let_in_what_chance_finds() {
    let (mut tests, mut noise) = (Vec::new(), Vec::new());
    for case in rough_cases() {
        let images = [1, 2].map(|seed| case.color("on", case.samples, seed));
        let chance = [3, 4].map(|seed| case.color("off", 8 * case.samples, seed));
        compare(case.name, &images[0], &chance[0], &mut tests);
        let squares = |[a, b]: &[Vec<f32>; 2]| a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        // By chance it has eight times the samples.
        noise.push((case.name, squares(&images) / (8.0 * squares(&chance))));
    }
    eprintln!("{noise:?}");
    judge("rough boundaries", tests);
    for (name, ratio) in noise.iter().filter(|(name, _)| name.contains("sun")) {
        assert!(*ratio < 0.7, "{name}: {ratio} of the noise of chance");
    }
}

/// Every other face has a normal map: light that enters by a plain one leaves as the map says.
#[test]
fn parts_with_bent_normals_are_left_as_they_say() {
    let mut body = smooth(sphere(16, 0.7));
    let st = |p: &[f32; 3]| [p[0] + 0.7 * p[2], p[1] + 0.4 * p[2]];
    let values = body.points.iter().map(st).collect::<Vec<_>>().into();
    let st = Primvar { interpolation: Interpolation::Vertex, values, indices: None };
    body.primvars.insert("st".into(), AnyPrimvar::Float2(st));
    let odd = (0..body.face_vertex_counts.len() as i32).filter(|face| face % 2 == 1).collect::<Vec<_>>();
    body.geom_subsets = vec![GeomSubset { path: "/O/Odd".into(), indices: odd.into(), material: "/Bent".into() }];
    let glass = medium([0.9; 3], [0.5; 3], 0.0, 1.4);
    let network = Network {
        nodes: vec![Node::Constant { value: [0.6, 0.3, 0.74, 0.0] }],
        inputs: [("normal".into(), 0)].into(),
        tangents: "st".into(),
    };
    let bent = Material::UsdPreviewSurface(PreviewSurface { network, ..glass.clone() });
    let color = |refracted_light: &str, samples, seed| {
        let (eye, plain) = (camera(DVec3::new(1.0, 1.5, 6.0), 13.0), Material::UsdPreviewSurface(glass.clone()));
        let mut delegate = scene(body.clone(), plain, vec![behind(LightShape::Sphere { radius: 0.7 }, 10.0)], eye);
        delegate.sync("/Bent", Prim::Material(bent.clone()), DirtyBits::ALL);
        let set = RenderSettings {
            walk: "classical".into(),
            refracted_light: refracted_light.into(),
            seed,
            ..settings(SIZE, samples)
        };
        plane(&render(&mut delegate, set), "color").to_vec()
    };
    let mut tests = Vec::new();
    compare("patches", &color("on", 1024, 1), &color("off", 4096, 2), &mut tests);
    judge("bent normals", tests);
}
