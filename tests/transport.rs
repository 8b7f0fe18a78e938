//! Light transport of whole renders against closed forms.

mod support;

use dermis::delegate::{DirtyBits, RenderDelegate};
use dermis::flat::{Light, LightShape, Material, Mesh, PreviewSurface, Prim};
use dermis::sampling::sampler::Sampler;
use dermis::scene::InstanceEnclosure;
use dermis::subsurface::steps::{Start, WalkEnd, WalkStats};
use dermis::subsurface::walk::{Along, walk};
use glam::{DVec3, Vec3};
use support::{camera, channel, cuboid, furnace, mean_and_error, mesh, plane, render, scene, settings, sphere};

fn medium(boundary: &str, albedo: [f32; 3], radius: [f32; 3]) -> Material {
    Material::UsdPreviewSurface(PreviewSurface {
        subsurface: 1.0,
        subsurface_albedo: Some(albedo),
        subsurface_radius: radius,
        subsurface_boundary: boundary.to_owned().into(),
        ior: if boundary == "indexMatched" { 1.0 } else { 1.4 },
        roughness: 0.3,
        ..PreviewSurface::default()
    })
}

/// A plate that only absorbs, before a background of radiance 1: Beer and Lambert per channel.
#[test]
fn beer_lambert() {
    let material = medium("indexMatched", [0.0; 3], [0.25, 0.5, 2.0]);
    let eye = camera(DVec3::new(0.0, 0.0, 200.0), 0.1);
    let mut delegate = scene(cuboid(Vec3::new(2.0, 2.0, 0.5)), material, vec![furnace()], eye);
    let planes = render(&mut delegate, settings(8, 64));
    for (c, radius) in [0.25_f64, 0.5, 2.0].into_iter().enumerate() {
        let (mean, _) = mean_and_error(&channel(plane(&planes, "color"), c));
        let expected = (-1.0 / radius).exp();
        assert!((mean / expected - 1.0).abs() < 1e-3, "channel {c}: {mean} against {expected}");
    }
}

/// A dense half-space in diffuse light, seen straight on, against 1 - H(1) sqrt(1 - albedo): reciprocity
/// turns the directional-hemispherical albedo of Chandrasekhar into radiance under a dome.
#[test]
fn half_space_shows_chandrasekhar() {
    // (albedo, H(1)) from reference_H.csv, isotropic scattering.
    for (albedo, h) in [(0.5_f32, 1.251_259_56), (0.8, 1.598_219_52), (0.95, 2.077_123_84), (0.99, 2.472_792_83)] {
        let material = medium("indexMatched", [albedo; 3], [1e-3; 3]);
        let eye = camera(DVec3::new(0.0, 0.0, 200.0), 0.1);
        let mut delegate = scene(cuboid(Vec3::ONE), material, vec![furnace()], eye);
        let planes = render(&mut delegate, settings(16, 256));
        let (mean, error) = mean_and_error(&channel(plane(&planes, "color"), 0));
        let expected = 1.0 - h * f64::from(1.0 - albedo).sqrt();
        assert!((mean - expected).abs() < 4.5 * error, "albedo {albedo}: {mean} +- {error}, expected {expected}");
    }
}

/// The path length of light through a body that does not absorb is 4 V / S on average in uniform light,
/// whatever it scatters (Blanco and Fournier 2003): scattering by any g, any mean free path.
#[test]
fn mean_path_length_is_four_volumes_over_surface() {
    for (radius, g) in [([0.05; 3], 0.0), ([0.3; 3], 0.8), ([2.0; 3], -0.4)] {
        let mut material = medium("diffuse", [1.0; 3], radius);
        let Material::UsdPreviewSurface(surface) = &mut material else { unreachable!() };
        surface.subsurface_anisotropy = g;
        let half = Vec3::new(0.5, 0.3, 0.8);
        let mut delegate = scene(cuboid(half), material, vec![], camera(DVec3::new(0.0, 0.0, 9.0), 20.0));
        delegate.set_settings(settings(8, 1)).expect("settings");
        delegate.commit().expect("commit");
        let compiled = delegate.scene().expect("scene").clone();
        let medium = compiled.surfaces[0].interior.expect("a medium").medium;
        let enclosure = InstanceEnclosure::new(compiled.at(0.0), 0);
        let lengths: Vec<f64> = (0..40_000).map(|i| path_length(&compiled, &enclosure, &medium, &half, i)).collect();
        let (mean, error) = mean_and_error(&lengths);
        let (volume, surface) =
            (8.0 * half.x * half.y * half.z, 8.0 * (half.x * half.y + half.y * half.z + half.z * half.x));
        let expected = f64::from(4.0 * volume / surface);
        assert!((mean - expected).abs() < 4.5 * error, "mfp {} g {g}: {mean} +- {error} of {expected}", radius[0]);
    }
}

/// Length of one walk from a uniform point of a box's surface, cosine-distributed inward.
fn path_length(
    scene: &dermis::scene::Scene,
    enclosure: &InstanceEnclosure,
    medium: &dermis::medium::Medium,
    half: &Vec3,
    i: u32,
) -> f64 {
    let mut sampler = Sampler::new(3, i, 0);
    let areas = [half.y * half.z, half.x * half.z, half.x * half.y];
    let u = sampler.random() * (areas[0] + areas[1] + areas[2]);
    let axis = if u < areas[0] {
        0
    } else if u < areas[0] + areas[1] {
        1
    } else {
        2
    };
    let mut normal = Vec3::ZERO;
    normal[axis] = if sampler.random() < 0.5 { -1.0 } else { 1.0 };
    let mut p = Vec3::new(sampler.random(), sampler.random(), sampler.random()) * 2.0 - 1.0;
    p[axis] = normal[axis];
    let inward = dermis::sampling::cosine_hemisphere(glam::Vec2::new(sampler.random(), sampler.random()));
    let d = dermis::math::Frame::from_normal(-normal).to_world(inward);
    // The boundary point as the scene sees it: the first surface on the way in from outside.
    let centre = scene.instances[0].to_render.translation;
    let hit = scene.at(0.0).closest(centre + p * *half + normal, -normal, 10.0, None).expect("the box is there");
    let hit = dermis::scene::BoundaryHit::of(&hit);
    let start = Start { p: enclosure.point(&hit), d, normal, hit, weight: Vec3::ONE };
    let (mut stats, mut length, mut last) = (WalkStats::default(), 0.0_f64, start.p);
    let end = walk(
        enclosure,
        medium,
        Along::None,
        start,
        false,
        &mut sampler,
        &mut stats,
        |_, _| None,
        |collision, _| {
            length += f64::from((collision.p - last).length());
            last = collision.p;
        },
    );
    let WalkEnd::Boundary { p, .. } = end else { panic!("a walk in a closed box without absorption ended {end:?}") };
    length + f64::from((p - last).length())
}

fn lit_sphere() -> RenderDelegate {
    let material = medium("diffuse", [0.95, 0.8, 0.6], [0.2, 0.1, 0.05]);
    let light = Light { shape: LightShape::Sphere { radius: 0.5 }, intensity: 40.0, ..translated([2.0, 3.0, 3.0]) };
    scene(sphere(16, 1.0), material, vec![light], camera(DVec3::new(0.0, 0.0, 6.0), 26.0))
}

fn translated([x, y, z]: [f64; 3]) -> Light {
    let mut light = Light::default();
    light.transform[3] = [x, y, z, 1.0];
    light
}

/// One seed, one image: for any number of threads, bit for bit, in every AOV.
#[test]
fn same_image_for_any_number_of_threads() {
    let image = |threads| {
        let mut delegate = lit_sphere();
        render(&mut delegate, dermis::flat::RenderSettings { threads, ..settings(40, 5) })
    };
    let one = image(1);
    assert_eq!(one, image(2));
    assert_eq!(one, image(5));
    assert!(plane(&one, "subsurface").iter().sum::<f32>() > 0.0);
}

/// Sample ranges of classical walks, merged by their weights, are the single run, up to the rounding of the sums.
/// Guided walks learn from the range they are in: theirs have the same mean, not the same pixels.
#[test]
fn sample_ranges_merge() {
    let mut delegate = lit_sphere();
    let classical = |samples| dermis::flat::RenderSettings { walk: "classical".into(), ..settings(24, samples) };
    let whole = render(&mut delegate, classical(12));
    let first = render(&mut delegate, classical(4));
    let rest = render(&mut delegate, dermis::flat::RenderSettings { sample_offset: 4, ..classical(8) });
    let merged = plane(&first, "color").iter().zip(plane(&rest, "color")).map(|(a, b)| (4.0 * a + 8.0 * b) / 12.0);
    for (merged, whole) in merged.zip(plane(&whole, "color")) {
        assert!((merged - whole).abs() <= 1e-5 * whole.abs(), "{merged} against {whole}");
    }
}

/// direct + indirect + subsurface is the beauty.
#[test]
fn light_aovs_add_up() {
    let mut delegate = lit_sphere();
    let planes = render(&mut delegate, settings(24, 16));
    let rgb = |name: &str| plane(&planes, name).to_vec();
    let (direct, indirect, subsurface) = (rgb("direct"), rgb("indirect"), rgb("subsurface"));
    for (i, color) in plane(&planes, "color").chunks(4).enumerate() {
        for c in 0..3 {
            let sum = direct[3 * i + c] + indirect[3 * i + c] + subsurface[3 * i + c];
            assert!((sum - color[c]).abs() <= 1e-4 * color[c].abs() + 1e-6, "{sum} against {}", color[c]);
        }
    }
}

/// The variance AOV is the variance of independent renders of the pixel (within what 24 renders can tell).
#[test]
fn variance_is_estimated() {
    let mut delegate = lit_sphere();
    let mut runs = Vec::new();
    for seed in 0..24 {
        let planes = render(&mut delegate, dermis::flat::RenderSettings { seed, ..settings(12, 8) });
        runs.push((channel(plane(&planes, "color"), 0), plane(&planes, "variance").to_vec()));
    }
    let pixels = runs[0].0.len();
    let (mut measured, mut estimated) = (0.0, 0.0);
    for i in 0..pixels {
        let values: Vec<f64> = runs.iter().map(|r| r.0[i]).collect();
        let (_, error) = mean_and_error(&values);
        measured += error * error * values.len() as f64;
        estimated += runs.iter().map(|r| f64::from(r.1[3 * i])).sum::<f64>() / runs.len() as f64;
    }
    // Sobol stratification makes the truth smaller than the estimate, never larger.
    let ratio = estimated / measured;
    assert!((0.85..2.5).contains(&ratio), "estimated / measured variance {ratio}");
}

/// An edit through dirty bits rebuilds only what it must and gives the image of a fresh load.
#[test]
fn edits_equal_fresh_loads() {
    let rendered = |delegate: &mut RenderDelegate| plane(&render(delegate, settings(24, 4)), "color").to_vec();
    let mut edited = lit_sphere();
    let before = rendered(&mut edited);

    let moved = |mesh: Mesh| {
        let mut moved = mesh;
        moved.transform[3] = [0.3, -0.2, 0.1, 1.0];
        moved
    };
    edited.sync("/O", Prim::Mesh(moved(Mesh::default())), DirtyBits::TRANSFORM);
    assert_eq!(edited.commit().expect("commit").blas_built, 0, "a move rebuilds no geometry");
    let green = medium("diffuse", [0.1, 0.9, 0.1], [0.1; 3]);
    edited.sync("/M", Prim::Material(green.clone()), DirtyBits::PARAMS);
    assert_eq!(edited.commit().expect("commit").blas_built, 0, "a material rebuilds no geometry");
    let coarse = sphere(5, 1.0);
    let points = Mesh { points: coarse.points.clone(), ..Mesh::default() };
    let mut topology = coarse.clone();
    topology.points = Default::default();
    edited.sync("/O", Prim::Mesh(points), DirtyBits::POINTS);
    edited.sync("/O", Prim::Mesh(topology), DirtyBits::TOPOLOGY);
    assert_eq!(edited.commit().expect("commit").blas_built, 1);
    let after = rendered(&mut edited);

    let mut fresh = lit_sphere();
    fresh.sync("/O", Prim::Mesh(moved(coarse)), DirtyBits::ALL);
    fresh.sync("/M", Prim::Material(green), DirtyBits::ALL);
    assert_eq!(after, rendered(&mut fresh));
    assert_ne!(before, after);

    edited.remove("/L0");
    assert!(rendered(&mut edited).chunks(4).all(|p| p[..3] == [0.0; 3]), "without its light the scene is black");
}

/// Rays miss nothing of a scene 1e6 units away from the world's origin: render space is the camera's.
#[test]
fn far_from_the_origin_is_the_same_picture() {
    let image = |offset: f64| {
        let mut eye = camera(DVec3::new(0.0, 0.0, 6.0), 26.0);
        eye.transform[3][0] += offset;
        let mut light = translated([2.0 + offset, 3.0, 3.0]);
        (light.shape, light.intensity) = (LightShape::Sphere { radius: 0.5 }, 40.0);
        let mut body = sphere(16, 1.0);
        body.transform[3][0] = offset;
        let material = medium("diffuse", [0.95, 0.8, 0.6], [0.2, 0.1, 0.05]);
        plane(&render(&mut scene(body, material, vec![light], eye), settings(24, 4)), "color").to_vec()
    };
    assert_eq!(image(0.0), image(1048576.0));
}

/// Walks in an open mesh end; they are counted, and the mesh is named.
#[test]
fn open_meshes_leak_and_say_so() {
    let half = Vec3::ONE;
    let closed = cuboid(half);
    let open = mesh(closed.points.to_vec(), vec![4; 5], closed.face_vertex_indices[..20].to_vec());
    let material = medium("diffuse", [0.99; 3], [0.3; 3]);
    let mut delegate = scene(open, material, vec![furnace()], camera(DVec3::new(0.0, 0.0, 8.0), 20.0));
    let planes = render(&mut delegate, settings(16, 16));
    assert!(plane(&planes, "color").iter().all(|v| v.is_finite()));
    assert!(delegate.stats()["walks_leaked"].as_u64().expect("a count") > 0);
    assert!(delegate.warnings().iter().any(|w| w.prim == "/O" && w.message.contains("4 edges")));
}
