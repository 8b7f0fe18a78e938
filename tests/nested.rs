//! Media within media: closed forms of stacks and furnaces, and scenes that two models describe.

mod support;

use dermis::delegate::{DirtyBits, RenderDelegate};
use dermis::flat::{
    Camera, Light, LightShape, Material, Mesh, OpenPbrSurface, PreviewSurface, Prim, Projection, RenderSettings,
};
use glam::{DVec3, Vec3};
use support::{camera, channel, cuboid, furnace, mean_and_error, plane, render, settings, sphere};

/// A mesh of `material`, with the priority of its medium, moved to `at`.
fn body(mesh: Mesh, material: &str, priority: i32, [x, y, z]: [f64; 3]) -> Mesh {
    let mut mesh = Mesh { material: material.into(), medium_priority: Some(priority), ..mesh };
    mesh.transform[3] = [x, y, z, 1.0];
    mesh
}

/// A box from `min` to `max` along z, `width` wide.
fn slab(width: f32, min: f32, max: f32, material: &str, priority: i32) -> Mesh {
    let half = Vec3::new(0.5 * width, 0.5 * width, 0.5 * (max - min));
    body(cuboid(half), material, priority, [0.0, 0.0, f64::from(min + max) * 0.5])
}

fn scene(meshes: Vec<Mesh>, materials: Vec<(&str, Material)>, lights: Vec<Light>, camera: Camera) -> RenderDelegate {
    let mut delegate = RenderDelegate::new();
    for (i, mesh) in meshes.into_iter().enumerate() {
        delegate.sync(&format!("/B{i}"), Prim::Mesh(mesh), DirtyBits::ALL);
    }
    for (path, material) in materials {
        delegate.sync(path, Prim::Material(material), DirtyBits::ALL);
    }
    for (i, light) in lights.into_iter().enumerate() {
        delegate.sync(&format!("/L{i}"), Prim::Light(light), DirtyBits::ALL);
    }
    delegate.sync("/C", Prim::Camera(camera), DirtyBits::ALL);
    delegate
}

fn glass(ior: f32, roughness: f32) -> Material {
    Material::OpenPbr(OpenPbrSurface {
        transmission_weight: 1.0,
        specular_ior: ior,
        specular_roughness: roughness,
        ..OpenPbrSurface::default()
    })
}

fn medium(boundary: &str, albedo: f32, radius: f32, ior: f32) -> Material {
    Material::UsdPreviewSurface(PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some([albedo; 3]),
        subsurface_radius: [radius; 3],
        subsurface_boundary: boundary.to_owned().into(),
        ior,
        roughness: 0.0,
        ..PreviewSurface::default()
    })
}

fn opaque(color: f32) -> Material {
    let color = [color; 3];
    Material::OpenPbr(OpenPbrSurface { base_color: color, specular_weight: 0.0, ..OpenPbrSurface::default() })
}

/// Unlit but for its own radiance 1.
fn glowing() -> Material {
    Material::UsdPreviewSurface(PreviewSurface {
        diffuse_color: Some([0.0; 3]),
        ior: 1.0,
        emissive_color: [1.0; 3],
        ..PreviewSurface::default()
    })
}

fn mean(delegate: &mut RenderDelegate, settings: RenderSettings) -> (f64, f64) {
    let planes = render(delegate, RenderSettings { max_depth: 64, ..settings });
    mean_and_error(&channel(plane(&planes, "color"), 1))
}

fn reflectance(cos: f64, n1: f64, n2: f64) -> f64 {
    let sin = (1.0 - cos * cos).sqrt() * n1 / n2;
    if sin >= 1.0 {
        return 1.0;
    }
    let cos2 = (1.0 - sin * sin).sqrt();
    let s = (n1 * cos - n2 * cos2) / (n1 * cos + n2 * cos2);
    let p = (n2 * cos - n1 * cos2) / (n2 * cos + n1 * cos2);
    0.5 * (s * s + p * p)
}

/// Transmittance of parallel interfaces between `indices`, each reflecting unpolarised light on its own.
fn stack(cos: f64, indices: &[f64]) -> f64 {
    let sin = (1.0 - cos * cos).sqrt() * indices[0];
    let cosine = |n: f64| (1.0 - (sin / n) * (sin / n)).sqrt();
    let (mut t, mut r_back) = (1.0, 0.0);
    for pair in indices.windows(2) {
        let r = reflectance(cosine(pair[0]), pair[0], pair[1]);
        let between = 1.0 - r_back * r;
        (t, r_back) = (t * (1.0 - r) / between, r + (1.0 - r) * (1.0 - r) * r_back / between);
    }
    t
}

/// Two slabs that overlap before a glowing wall: by priority there are three interfaces, each with the indices of what is
/// on its two sides, whichever slab fills the overlap, and none in it.
#[test]
fn slabs_that_overlap_transmit_as_a_stack() {
    for (priorities, tilt) in [([2, 1], 0.0), ([1, 2], 0.0), ([2, 1], 50.0_f64)] {
        let (sin, cos) = tilt.to_radians().sin_cos();
        let meshes = vec![
            slab(200.0, 0.0, 2.0, "/Dense", priorities[0]),
            slab(200.0, 1.0, 3.0, "/Light", priorities[1]),
            slab(800.0, -2.0, -1.0, "/Glow", 0),
        ];
        let materials = vec![("/Dense", glass(2.4, 0.0)), ("/Light", glass(1.2, 0.0)), ("/Glow", glowing())];
        let eye = camera(DVec3::new(20.0 * sin, 0.0, 20.0 * cos), 0.01);
        let (mean, error) = mean(&mut scene(meshes, materials, vec![], eye), settings(64, 64));
        let expected = stack(cos, &[1.0, 1.2, 2.4, 1.0]);
        eprintln!("{priorities:?} {tilt}: {mean:.5} +- {error:.5} of {expected:.5}");
        assert!(error < 1.5e-3 && (mean - expected).abs() < 4.5 * error, "{priorities:?} {tilt}: {mean} of {expected}");
    }
}

/// What fills an overlap absorbs there, alone: Beer and Lambert by priority, with and without interfaces.
#[test]
fn overlaps_absorb_by_priority() {
    for (priorities, lengths) in [([2, 1], [1.5, 0.5]), ([1, 2], [1.0, 1.0])] {
        for (boundary, ior) in [("indexMatched", 1.0), ("dielectric", 1.5)] {
            let meshes = vec![slab(9.0, -1.0, 0.5, "/A", priorities[0]), slab(9.0, 0.0, 1.0, "/B", priorities[1])];
            let (a, b) = (medium(boundary, 0.0, 2.0, ior), medium(boundary, 0.0, 0.8, ior));
            let eye = camera(DVec3::new(0.0, 0.0, 5.0), 0.05);
            let dark = slab(400.0, 30.0, 31.0, "/Dark", 0);
            let delegate = &mut scene(
                [meshes, vec![dark]].concat(),
                vec![("/A", a), ("/B", b), ("/Dark", opaque(0.0))],
                vec![furnace()],
                eye,
            );
            let (mean, error) = mean(delegate, settings(32, 256));
            let inside: f64 = (-lengths[0] / 2.0_f64 - lengths[1] / 0.8).exp();
            let r = reflectance(1.0, 1.0, f64::from(ior));
            // The front half of the furnace is behind the camera, dark: what is reflected there is lost.
            let expected = (1.0 - r) * (1.0 - r) * inside / (1.0 - r * r * inside * inside);
            eprintln!("{boundary} {priorities:?}: {mean:.5} +- {error:.5} of {expected:.5}");
            assert!((mean - expected).abs() < 4.5 * error + 3e-5, "{boundary} {priorities:?}: {mean} of {expected}");
            assert!(error < 0.005 * expected, "+- {error} sees no 2 %");
        }
    }
}

/// White bodies in, around and across each other are invisible in uniform light.
#[test]
fn nested_white_bodies_vanish() {
    let white = |boundary, ior| medium(boundary, 1.0, 0.2, ior);
    let inner = |priority| body(sphere(20, 0.6), "/In", priority, [0.1, -0.1, 0.05]);
    let outer = |priority| body(sphere(24, 1.0), "/Out", priority, [0.0; 3]);
    let across = |priority| body(sphere(20, 0.6), "/In", priority, [0.0, 0.0, 0.8]);
    let cases = [
        ("glass around dielectric wax", outer(0), glass(1.5, 0.0), inner(0), white("dielectric", 1.3)),
        ("glass around matched wax", outer(0), glass(1.5, 0.0), inner(0), white("indexMatched", 1.0)),
        ("glass around diffuse wax", outer(0), glass(1.5, 0.0), inner(0), white("diffuse", 1.4)),
        ("wax around glass", outer(0), white("dielectric", 1.3), inner(0), glass(1.7, 0.0)),
        ("matched wax around glass", outer(0), white("indexMatched", 1.0), inner(0), glass(1.5, 0.0)),
        (
            "matched wax in matched wax",
            outer(0),
            white("indexMatched", 1.0),
            inner(0),
            medium("indexMatched", 1.0, 0.1, 1.0),
        ),
        (
            "matched wax across matched wax",
            outer(0),
            white("indexMatched", 1.0),
            across(1),
            medium("indexMatched", 1.0, 0.1, 1.0),
        ),
        ("matched wax around wax", outer(0), white("indexMatched", 1.0), inner(0), white("dielectric", 1.4)),
        ("wax around plaster", outer(0), white("dielectric", 1.4), inner(0), opaque(1.0)),
        ("matched wax and plaster across", outer(0), white("indexMatched", 1.0), across(0), opaque(1.0)),
        ("milk across glass that wins", outer(2), glass(1.5, 0.0), across(1), white("dielectric", 1.33)),
        ("milk that wins across glass", outer(1), glass(1.5, 0.0), across(2), white("dielectric", 1.33)),
        ("milk across milk", outer(1), white("dielectric", 1.5), across(2), white("dielectric", 1.33)),
        ("fog that wins across glass", outer(1), glass(1.5, 0.0), across(2), white("indexMatched", 1.0)),
    ];
    for (name, a, a_material, b, b_material) in cases {
        let eye = camera(DVec3::new(0.0, 2.0, 8.0), 9.0);
        let materials = vec![("/Out", a_material), ("/In", b_material)];
        let mut delegate = scene(vec![a, b], materials, vec![furnace()], eye);
        let (mean, error) = mean(&mut delegate, settings(24, 64));
        let stats = delegate.stats();
        eprintln!(
            "{name}: {mean:.5} +- {error:.5}, leaked {}, trapped {}",
            stats["walks_leaked"], stats["paths_trapped"]
        );
        // Beyond the noise: what is left of 64 bounces, and faces that tilt at silhouettes.
        assert!(error < 4e-3 && (mean - 1.0).abs() < 4.5 * error + 2e-3, "{name}: {mean} +- {error}");
        assert_eq!(stats["non_finite_samples"], 0, "{name}");
    }
}

/// Rough interfaces between two media have the albedos of the grid, white to a hundredth.
#[test]
fn rough_nested_interfaces_vanish_nearly() {
    let inner = body(sphere(20, 0.6), "/In", 0, [0.1, -0.1, 0.05]);
    let outer = body(sphere(24, 1.0), "/Out", 0, [0.0; 3]);
    let eye = camera(DVec3::new(0.0, 0.0, 8.0), 7.0);
    let materials = vec![("/Out", glass(1.5, 0.3)), ("/In", glass(1.9, 0.4))];
    let (mean, error) = mean(&mut scene(vec![outer, inner], materials, vec![furnace()], eye), settings(24, 64));
    assert!(error < 4e-3 && (mean - 1.0).abs() < 4.5 * error + 1e-2, "{mean} +- {error}");
}

fn lit() -> Light {
    let mut light = Light { shape: LightShape::Sphere { radius: 0.4 }, intensity: 40.0, ..Light::default() };
    light.transform[3] = [1.5, 2.5, 2.5, 1.0];
    light
}

/// Mean of an image over 16 seeds, and its standard error.
fn mean_of_seeds(delegate: &mut RenderDelegate, walk: &str, samples: u32) -> (f64, f64) {
    let of = |seed| RenderSettings { seed, walk: walk.into(), ..settings(24, samples) };
    mean_and_error(&(0..16).map(|seed| mean(delegate, of(seed)).0).collect::<Vec<f64>>())
}

/// How many standard errors two images differ by on average.
fn z(a: &mut RenderDelegate, b: &mut RenderDelegate, walk: [&str; 2], samples: u32) -> f64 {
    let ((a, of_a), (b, of_b)) = (mean_of_seeds(a, walk[0], samples), mean_of_seeds(b, walk[1], samples));
    let error = of_a.hypot(of_b);
    eprintln!("{walk:?}: {a:.5} +- {of_a:.5} and {b:.5} +- {of_b:.5}");
    assert!(error < 0.009 * a.max(b), "+- {error} sees little of {a}");
    (a - b) / error
}

/// A body of the medium that it is in is not there: walks that stop at its surface and go on are the same walks.
#[test]
fn a_body_of_the_same_medium_is_not_there() {
    let wax = || medium("indexMatched", 0.95, 0.15, 1.0);
    let eye = || camera(DVec3::new(0.0, 0.0, 6.0), 20.0);
    let outer = || body(sphere(20, 1.0), "/Wax", 0, [0.0; 3]);
    let inner = body(sphere(12, 0.4), "/Same", 0, [0.2, 0.3, 0.3]);
    for walk in ["classical", "mixture"] {
        let mut alone = scene(vec![outer()], vec![("/Wax", wax())], vec![lit()], eye());
        let with = vec![outer(), inner.clone()];
        let mut with = scene(with, vec![("/Wax", wax()), ("/Same", wax())], vec![lit()], eye());
        let z = z(&mut alone, &mut with, ["classical", walk], 16);
        assert!(z.abs() < 4.0, "{walk}: z {z}");
    }
}

/// An object in wax, guided and not: one picture. Without the object it is another.
#[test]
fn guided_walks_meet_what_is_within() {
    for (boundary, ior) in [("indexMatched", 1.0), ("dielectric", 1.4)] {
        let with = |meshes: Vec<Mesh>| {
            let wax = medium(boundary, 0.98, 0.08, ior);
            let eye = camera(DVec3::new(0.0, 0.0, 6.0), 20.0);
            // Light that is found through a boundary that bends: everywhere.
            let light = if ior == 1.0 { lit() } else { furnace() };
            scene(meshes, vec![("/Wax", wax), ("/Dark", opaque(0.05))], vec![light], eye)
        };
        let outer = || body(sphere(20, 1.0), "/Wax", 0, [0.0; 3]);
        let inner = || body(cuboid(Vec3::new(0.4, 1.5, 0.3)), "/Dark", 0, [0.0, 0.2, 0.55]);
        let both = || with(vec![outer(), inner()]);
        let same = z(&mut both(), &mut both(), ["classical", "mixture"], 16);
        assert!(same.abs() < 4.0, "{boundary}: z {same}");
        let other = z(&mut both(), &mut with(vec![outer()]), ["classical", "classical"], 16);
        assert!(other.abs() > 20.0, "{boundary}: the object makes no difference, z {other}");
    }
}

/// Wax that ends on a dark plate, and wax that goes on within it: one picture.
#[test]
fn what_is_behind_an_object_is_not_there() {
    let with = |bottom: f32, top: f32, ior: f32, boundary: &str| {
        let plate = slab(12.0, -2.0, top, "/Dark", 0);
        let wax = slab(4.0, bottom, 1.0, "/Wax", 0);
        let mut light = lit();
        (light.shape, light.intensity) = (LightShape::Sphere { radius: 1.2 }, 5.0);
        let materials = vec![("/Wax", medium(boundary, 0.97, 0.4, ior)), ("/Dark", opaque(0.3))];
        scene(vec![wax, plate], materials, vec![light], camera(DVec3::new(0.0, -4.0, 6.0), 25.0))
    };
    // Behind a dielectric boundary what ends just above the plate has an interface there: it has to reach in.
    let z = z(
        &mut with(-1.0, 0.0, 1.0, "indexMatched"),
        &mut with(0.0, -1e-3, 1.0, "indexMatched"),
        ["classical", "mixture"],
        24,
    );
    assert!(z.abs() < 4.0, "z {z}");
}

/// Skin does not see the eye in it, bit for bit, and is one with what is in its set.
#[test]
fn diffuse_walks_leave_only_by_their_object_or_set() {
    let skin = || medium("diffuse", 0.97, 0.25, 1.0);
    let eye = || camera(DVec3::new(0.0, 1.0, 6.0), 26.0);
    let with = |meshes| scene(meshes, vec![("/Skin", skin()), ("/Eye", opaque(0.8))], vec![lit()], eye());
    let color = |delegate: &mut RenderDelegate| plane(&render(delegate, settings(24, 8)), "color").to_vec();
    let head = || body(sphere(16, 1.0), "/Skin", 0, [0.0; 3]);
    let ball = body(sphere(12, 0.4), "/Eye", 0, [0.1, 0.2, 0.3]);
    assert_eq!(color(&mut with(vec![head()])), color(&mut with(vec![head(), ball])));

    // A box, and the same in two parts that overlap.
    let part = |half: f32, x: f64, set: &str| {
        let mesh = body(cuboid(Vec3::new(half, 0.5, 0.5)), "/Skin", 0, [x, 0.0, 0.0]);
        Mesh { subsurface_set: set.into(), ..mesh }
    };
    let parts = |set| with(vec![part(0.6, -0.4, set), part(0.6, 0.4, set)]);
    for walk in ["classical", "mixture"] {
        let z = z(&mut with(vec![part(1.0, 0.0, "")]), &mut parts("head"), ["classical", walk], 12);
        assert!(z.abs() < 4.0, "{walk}: z {z}");
    }
    let apart = z(&mut with(vec![part(1.0, 0.0, "")]), &mut parts(""), ["classical", "classical"], 12);
    assert!(apart.abs() > 6.0, "the parts are one without a set, z {apart}");
}

/// Two halves that are open where they touch enclose one interior together.
#[test]
fn halves_of_a_set_close_each_other() {
    let skin = medium("diffuse", 1.0, 0.3, 1.0);
    let half = |x: f32| {
        let mut mesh = cuboid(Vec3::new(0.5, 0.5, 0.5));
        let open = if x < 0.0 { 1 } else { 0 };
        let indices = mesh.face_vertex_indices.to_vec();
        let kept = indices.chunks(4).enumerate().filter(|(i, _)| *i != open).flat_map(|(_, face)| face.to_vec());
        (mesh.face_vertex_indices, mesh.face_vertex_counts) = (kept.collect::<Vec<_>>().into(), vec![4; 5].into());
        Mesh { subsurface_set: "whole".into(), ..body(mesh, "/Skin", 0, [f64::from(x), 0.0, 0.0]) }
    };
    let eye = camera(DVec3::new(1.0, 1.0, 6.0), 6.0);
    let mut delegate = scene(vec![half(-0.5), half(0.5)], vec![("/Skin", skin)], vec![furnace()], eye);
    let (mean, error) = mean(&mut delegate, settings(24, 64));
    assert!(error < 4e-3 && (mean - 1.0).abs() < 4.5 * error + 1e-3, "{mean} +- {error}");
    assert!(delegate.stats()["walks_leaked"].as_u64().expect("a count") < 20, "{}", delegate.stats()["walks_leaked"]);
}

/// A camera within a medium sees the light through it: what is absorbed on the way, and the furnace where nothing is. Behind
/// a dielectric it sees what a housing in it would.
#[test]
fn a_camera_within_sees() {
    let at = |z| {
        let mut camera = camera(DVec3::new(0.0, 0.0, 1.0), 0.2);
        camera.transform[3] = [0.0, 0.0, z, 1.0];
        camera
    };
    let seen = |material, z| {
        let mut delegate =
            scene(vec![body(sphere(24, 1.0), "/M", 0, [0.0; 3])], vec![("/M", material)], vec![furnace()], at(z));
        assert_eq!(delegate.warnings().len(), 0);
        mean(&mut delegate, settings(16, 256))
    };
    let (absorbed, _) = seen(medium("indexMatched", 0.0, 2.0, 1.0), -0.5);
    // From z -0.5 towards -z: half a radius to the surface of a faceted sphere.
    assert!((absorbed / (-0.25_f64).exp() - 1.0).abs() < 2e-3, "{absorbed}");
    for (boundary, ior) in [("indexMatched", 1.0), ("dielectric", 1.4)] {
        let (mean, error) = seen(medium(boundary, 1.0, 0.3, ior), -0.5);
        assert!(error < 4e-3 && (mean - 1.0).abs() < 4.5 * error + 1e-3, "{boundary}: {mean} +- {error}");
    }
    let (mean, error) = seen(glass(1.5, 0.0), -0.5);
    assert!((mean - 1.0).abs() < 4.5 * error + 1e-3, "glass: {mean} +- {error}");
}

/// All the light of a sphere light within a body that absorbs nothing comes out of it.
#[test]
fn lights_within_shine_out() {
    let light = || Light {
        shape: LightShape::Sphere { radius: 0.3 },
        intensity: 5.0,
        camera_visible: true,
        ..Light::default()
    };
    let eye = || {
        let mut eye = camera(DVec3::new(0.0, 0.0, 9.0), 20.0);
        (eye.projection, eye.horizontal_aperture, eye.vertical_aperture) = (Projection::Orthographic, 24.0, 24.0);
        eye
    };
    // Intensity of the light over its radiance, over the window of the camera.
    let expected = 5.0 * std::f64::consts::PI * 0.09 / (2.4 * 2.4);
    for (boundary, ior, radius) in [("indexMatched", 1.0, 0.2), ("dielectric", 1.4, 0.2), ("dielectric", 1.4, 2.0)] {
        let wax = medium(boundary, 1.0, radius, ior);
        let ball = body(sphere(32, 1.0), "/Wax", 0, [0.0; 3]);
        let mut delegate = scene(vec![ball], vec![("/Wax", wax)], vec![light()], eye());
        let (mean, error) = mean_of_seeds(&mut delegate, "auto", 100);
        eprintln!("{boundary} {radius}: {mean:.5} +- {error:.5} of {expected:.5}");
        // Beyond the noise: a faceted body does not shine alike in all directions, a clear one least.
        let facets = if radius > 1.0 { 0.008 } else { 0.002 };
        let off = (mean - expected).abs();
        assert!(error < 0.006 * expected && off < 4.0 * error + facets * expected, "{boundary} {radius}: {mean}");
    }
    let ball = body(sphere(16, 1.0), "/Skin", 0, [0.0; 3]);
    let mut dark = scene(vec![ball], vec![("/Skin", medium("diffuse", 1.0, 0.2, 1.4))], vec![light()], eye());
    assert_eq!(mean(&mut dark, settings(8, 4)).0, 0.0);
    let warnings = dark.warnings();
    assert!(warnings.iter().any(|w| w.prim == "/L0" && w.message.contains("inside /B0")), "{warnings:?}");
}

/// Walls of a glowing mesh within wax: by chance and by next-event estimation, both weighted.
#[test]
fn mesh_lights_within_shine_out() {
    let mesh_light = Light { shape: LightShape::Mesh { mesh: "/B1".into() }, intensity: 5.0, ..Light::default() };
    let mut eye = camera(DVec3::new(0.0, 0.0, 9.0), 20.0);
    (eye.projection, eye.horizontal_aperture, eye.vertical_aperture) = (Projection::Orthographic, 24.0, 24.0);
    for (boundary, ior) in [("indexMatched", 1.0), ("dielectric", 1.4)] {
        let wax = medium(boundary, 1.0, 0.3, ior);
        let bodies = vec![body(sphere(24, 1.0), "/Wax", 0, [0.0; 3]), body(sphere(16, 0.3), "/White", 0, [0.0; 3])];
        let materials = vec![("/Wax", wax), ("/White", opaque(1.0))];
        let mut delegate = scene(bodies, materials, vec![mesh_light.clone()], eye.clone());
        let (mean, error) = mean_of_seeds(&mut delegate, "auto", 100);
        // The area of the faceted sphere over that of the round one.
        let expected = 5.0 * std::f64::consts::PI * 0.09 / (2.4 * 2.4) * area(&sphere(16, 0.3))
            / (4.0 * std::f64::consts::PI * 0.09);
        eprintln!("{boundary}: {mean:.5} +- {error:.5} of {expected:.5}");
        let off = (mean - expected).abs();
        assert!(error < 0.006 * expected && off < 4.0 * error + 0.002 * expected, "{boundary}: {mean} of {expected}");
    }
}

fn area(mesh: &Mesh) -> f64 {
    let corner = |i: usize| Vec3::from(mesh.points[mesh.face_vertex_indices[i] as usize]);
    let triangles = 0..mesh.face_vertex_indices.len() / 3;
    let area = |t: usize| {
        let [a, b, c] = [0, 1, 2].map(|k| corner(3 * t + k));
        f64::from(0.5 * (b - a).cross(c - a).length())
    };
    triangles.map(area).sum()
}

/// A row of bodies under the sky, half of them in the shadow of a roof.
fn row(turned: bool) -> RenderDelegate {
    let transforms = (0..6).map(|i| {
        let angle = if turned { 0.5 * f64::from(i) } else { 0.0 };
        let (sin, cos) = angle.sin_cos();
        [[cos, 0.0, -sin, 0.0], [0.0, 1.0, 0.0, 0.0], [sin, 0.0, cos, 0.0], [f64::from(i) - 2.5, 0.0, 0.0, 1.0]]
    });
    let ball = Mesh { instancer: "/I".into(), ..body(sphere(16, 0.45), "/Wax", 0, [0.0; 3]) };
    let roof = body(cuboid(Vec3::new(1.5, 0.1, 1.0)), "/Dark", 0, [-1.5, 1.2, 0.0]);
    let mut sun = Light { shape: LightShape::Distant { angle: 3.0 }, intensity: 300.0, ..Light::default() };
    // From above: -Z of the light is where it shines.
    (sun.transform[1], sun.transform[2]) = ([0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0]);
    let materials = vec![("/Wax", medium("diffuse", 0.99, 0.05, 1.4)), ("/Dark", opaque(0.2))];
    let mut delegate = scene(vec![ball, roof], materials, vec![sun], camera(DVec3::new(0.0, 1.0, 8.0), 44.0));
    let transforms: Vec<_> = transforms.collect();
    let instancer = dermis::flat::Instancer { visible: true, transforms: transforms.into(), ..Default::default() };
    delegate.sync("/I", Prim::Instancer(instancer), DirtyBits::ALL);
    delegate
}

/// Bodies that the sky lights alike have one boundary cache, and the picture of classical walks, shadows or not; turned
/// ones have their own.
#[test]
fn bodies_alike_share_a_cache() {
    let z = z(&mut row(false), &mut row(false), ["classical", "mixture"], 64);
    assert!(z.abs() < 4.0, "z {z}");
    for (turned, caches) in [(false, 1), (true, 6)] {
        let mut delegate = row(turned);
        mean(&mut delegate, settings(24, 4));
        assert_eq!(delegate.stats()["guide"]["bodies"], caches, "turned: {turned}");
        assert_eq!(delegate.stats()["needs"]["alike"], if turned { 0 } else { 5 });
    }
}
