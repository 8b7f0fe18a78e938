//! Irradiance of area lights against quadrature and closed forms.

use super::*;
use crate::light::Choice;
use crate::{
    flat::Shaping,
    light::{Light, ShapeHit},
    math::PI,
};

const ORIGIN: Vec3 = Vec3::ZERO;

fn check(light: &flat::Light, p: Vec3, n: Vec3, what: &str) {
    let truth = quadrature::irradiance(light, p.as_dvec3(), n.as_dvec3(), 300);
    let lights = compile(std::slice::from_ref(light));
    if truth == 0.0 {
        assert_eq!(irradiance(&lights, p, n, 200, 1).mean, 0.0, "{what}");
        return;
    }
    assert_agrees(irradiance(&lights, p, n, 60_000, 1), truth, 5e-4, what);
}

/// Points before, beside, close to and behind the lights of `placements`, with normals.
fn receivers() -> [(Vec3, Vec3); 6] {
    [
        (Vec3::new(0.0, 0.0, 0.0), Vec3::Z),
        (Vec3::new(2.0, -1.0, 0.5), Vec3::new(-0.6, 0.0, 0.8)),
        (Vec3::new(0.3, 0.2, 1.2), Vec3::new(0.0, 0.6, 0.8)),
        (Vec3::new(-4.0, 3.0, -6.0), Vec3::Z),
        (Vec3::new(0.2, -1.0, 4.0), Vec3::NEG_Z),
        (Vec3::new(0.0, 3.0, 1.9), Vec3::NEG_Y),
    ]
}

#[test]
fn irradiance_is_the_surface_integral() {
    for (name, transform) in placements([0.1, -0.1, 2.0]) {
        for shape in area_shapes() {
            for (i, (p, n)) in receivers().into_iter().enumerate() {
                let light = light(shape.clone(), transform);
                check(&light, p, n, &format!("{name} {shape:?} at point {i}"));
            }
        }
    }
}

#[test]
fn shaped_irradiance_is_the_surface_integral() {
    let cone = Shaping { cone_angle: 35.0, cone_softness: 0.6, ..Default::default() };
    let focus = Shaping { focus: 8.0, focus_tint: [0.2, 0.0, 0.0], cone_angle: 180.0, ..Shaping::default() };
    for (name, transform) in placements([0.1, -0.1, 2.0]) {
        for shape in area_shapes() {
            for shaping in [&cone, &focus] {
                let light = flat::Light { shaping: Some(shaping.clone()), ..light(shape.clone(), transform) };
                check(&light, Vec3::new(0.4, 0.3, 0.0), Vec3::Z, &format!("{name} {shape:?} {shaping:?}"));
            }
        }
    }
}

#[test]
fn far_small_lights_keep_their_digits() {
    // The quadrature is then intensity times projected area over distance squared.
    for shape in area_shapes() {
        let light = light(shape.clone(), matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 3e4]));
        check(&light, ORIGIN, Vec3::Z, &format!("far {shape:?}"));
    }
}

#[test]
fn closed_forms() {
    let at = |z: f64| matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, z]);
    let e = |l: flat::Light| irradiance(&compile(&[l]), ORIGIN, Vec3::Z, 60_000, 3);
    let pi = f64::from(PI);
    // Disk on its axis: pi L r^2 / (r^2 + d^2).
    let disk = flat::Light { intensity: 3.0, ..light(LightShape::Disk { radius: 2.0 }, at(3.0)) };
    assert_agrees(e(disk), 3.0 * pi * 4.0 / 13.0, 1e-6, "disk");
    // Sphere: pi L (r / d)^2.
    let sphere = light(LightShape::Sphere { radius: 1.5 }, at(2.0));
    assert_agrees(e(sphere), pi * 0.5625, 1e-6, "sphere");
    // Square above its centre (Howell's catalogue C-11 for a quarter, four times).
    let square = light(LightShape::Rect { width: 2.0, height: 2.0, texture: String::new() }, at(1.0));
    assert_agrees(e(square), 4.0 * 0.5_f64.sqrt() * 0.5_f64.sqrt().atan(), 1e-6, "square");
}

#[test]
fn normalize_divides_by_the_area() {
    for (name, transform) in placements([0.0, 0.0, 2.0]) {
        for shape in area_shapes() {
            let plain = light(shape.clone(), transform);
            let normalized = flat::Light { normalize: true, ..plain.clone() };
            let e = |l: &flat::Light| irradiance(&compile(std::slice::from_ref(l)), ORIGIN, Vec3::Z, 100, 3).mean;
            let area = quadrature::area(&plain, 400);
            // The girth of the cylinder is the one approximation.
            assert!((e(&plain) / e(&normalized) / area - 1.0).abs() < 0.002, "{name} {shape:?}");
        }
    }
}

#[test]
fn size_factors_of_scaled_lights() {
    let transform = placements([0.0; 3])[1].1;
    let area = |shape| match &compile(&[light(shape, transform)]).lights[0] {
        Light::Area(area) => area.shape.area(),
        _ => 0.0,
    };
    let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
    near(area(LightShape::Rect { width: 3.0, height: 4.0, texture: String::new() }), 6.0 * 2.0);
    near(area(LightShape::Disk { radius: 2.0 }), std::f64::consts::PI * 4.0 * 1.0);
    let ramanujan = std::f64::consts::PI * (6.0 - (3.0_f64 * 5.0).sqrt());
    near(area(LightShape::Cylinder { length: 1.0, radius: 1.0 }), 2.0 * ramanujan);
}

#[test]
fn areas_of_spheroids() {
    let area = |x: f64, z: f64| {
        let transform = matrix([x, 0.0, 0.0], [0.0, x, 0.0], [0.0, 0.0, z], [0.0; 3]);
        match &compile(&[light(LightShape::Sphere { radius: 1.0 }, transform)]).lights[0] {
            Light::Area(area) => area.shape.area(),
            _ => 0.0,
        }
    };
    let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 2e-4, "{a} {b}");
    near(area(1.5, 1.5), 4.0 * std::f64::consts::PI * 2.25);
    for z in [1.01_f64, 3.0, 100.0] {
        let e = (1.0 - 1.0 / (z * z)).sqrt();
        near(area(1.0, z), std::f64::consts::TAU * (1.0 + z / e * e.asin()));
        near(area(z, 1.0), std::f64::consts::TAU * (z * z + e.atanh() / e));
    }
}

#[test]
fn mirroring_leaves_the_emitting_side() {
    let rect = LightShape::Rect { width: 1.0, height: 1.0, texture: String::new() };
    let mirrored = matrix([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]);
    let lights = compile(&[light(rect.clone(), mirrored)]);
    assert!(lights.at(0.0).sample(ORIGIN, None, Choice::ONE, 0.5, Vec2::splat(0.5)).is_some());
    assert!(lights.at(0.0).sample(Vec3::Z * 4.0, None, Choice::ONE, 0.5, Vec2::splat(0.5)).is_none());
    assert!(lights.at(0.0).intersect(0, ORIGIN, Vec3::Z, 9.0).is_some());
    assert!(lights.at(0.0).intersect(0, Vec3::Z * 4.0, Vec3::NEG_Z, 9.0).is_none());
    // Mirrored along Z it does turn around.
    let turned = matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 2.0]);
    let lights = compile(&[light(rect, turned)]);
    assert!(lights.at(0.0).intersect(0, ORIGIN, Vec3::Z, 9.0).is_none());
    assert!(lights.at(0.0).intersect(0, Vec3::Z * 4.0, Vec3::NEG_Z, 9.0).is_some());
}

#[test]
fn nothing_shines_inside() {
    for shape in [LightShape::Sphere { radius: 1.0 }, LightShape::Cylinder { length: 2.0, radius: 1.0 }] {
        let lights = compile(&[light(shape, IDENTITY)]);
        let p = Vec3::new(0.2, 0.3, -0.1);
        assert!(lights.at(0.0).sample(p, None, Choice::ONE, 0.5, Vec2::splat(0.3)).is_none());
        assert!(lights.at(0.0).intersect(0, p, Vec3::Y, 9.0).is_none());
        assert!(lights.at(0.0).intersect(0, Vec3::new(5.0, 0.0, 0.0), Vec3::NEG_X, 1.0).is_none());
    }
}

#[test]
fn the_first_pixel_of_a_rect_is_at_plus_x_plus_y() {
    let texture = "/t".to_owned();
    let rect = LightShape::Rect { width: 2.0, height: 2.0, texture: texture.clone() };
    let pixels = vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0; 3]].into();
    let textures = [(texture, flat::Texture { width: 2, height: 2, pixels, ..Default::default() })].into();
    let lights = compile_with(&[light(rect, IDENTITY)], &textures);
    let colour = |x: f32, y: f32| {
        let hit = lights.at(0.0).intersect(0, Vec3::new(x, y, -1.0), Vec3::Z, 9.0).unwrap();
        lights.at(0.0).radiance_hit(0, Vec3::Z, &hit)
    };
    assert_eq!(colour(0.9, 0.9), Vec3::X);
    assert_eq!(colour(-0.9, 0.9), Vec3::Y);
    assert_eq!(colour(0.9, -0.9), Vec3::Z);
    assert_eq!(colour(-0.9, -0.9), Vec3::ONE);
}

/// Two triangles that make the rectangle of 1.4 x 0.6 at height 2, looking down, and one without area.
fn mesh_lights(extra: &flat::Light) -> Lights {
    let [a, b, c, d] = [(-0.7, -0.3), (0.7, -0.3), (0.7, 0.3), (-0.7, 0.3)].map(|(x, y)| Vec3::new(x, y, 2.0));
    let triangles = vec![[a, c, b], [a, a, b], [a, d, c]];
    let mesh = flat::Light { shape: LightShape::Mesh { mesh: "/mesh".into() }, ..extra.clone() };
    let prims = [("/mesh".to_owned(), mesh)].into();
    Lights::compile(&prims, &Prims::new(), &|_| Some(triangles.clone()), DVec3::ZERO, true, &mut Vec::new())
}

#[test]
fn a_mesh_shines_like_the_rect_it_makes() {
    let transform = matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]);
    for normalize in [false, true] {
        let rect = light(LightShape::Rect { width: 1.4, height: 0.6, texture: String::new() }, transform);
        let lights = mesh_lights(&flat::Light { normalize, ..rect.clone() });
        let (p, n) = (Vec3::new(0.5, -0.2, 0.3), Vec3::new(0.0, 0.6, 0.8));
        let area = if normalize { 1.4 * 0.6 } else { 1.0 };
        let truth = quadrature::irradiance(&rect, p.as_dvec3(), n.as_dvec3(), 400) / area;
        assert_agrees(irradiance(&lights, p, n, 100_000, 5), truth, 1e-4, "mesh");
    }
}

#[test]
fn mesh_hits_have_the_pdf_they_were_sampled_with() {
    let lights = mesh_lights(&flat::Light::default());
    assert_eq!((lights.mesh_light("/mesh"), lights.mesh_light("/other")), (Some(0), None));
    assert_eq!(lights.shapes().count(), 0);
    let mut random = Random::new(2);
    for _ in 0..500 {
        let p = Vec3::new(random.next(), random.next(), random.next());
        let s = random.sample(&lights, p, None).unwrap();
        let q = p + s.wi * s.distance;
        // The diagonal from (-0.7, -0.3) to (0.7, 0.3) parts triangle 0 from triangle 2.
        let hit = ShapeHit::on_mesh(s.distance, if q.y * 0.7 < q.x * 0.3 { 0 } else { 2 });
        assert!((lights.at(0.0).pdf_hit(0, p, None, Choice::ONE, s.wi, &hit) / s.pdf - 1.0).abs() < 1e-4);
        assert_eq!(lights.at(0.0).radiance_hit(0, s.wi, &hit), s.radiance);
    }
    let behind = ShapeHit::on_mesh(1.0, 0);
    assert_eq!(lights.at(0.0).radiance_hit(0, Vec3::NEG_Z, &behind), Vec3::ZERO);
    assert_eq!(lights.at(0.0).pdf_hit(0, Vec3::Z * 3.0, None, Choice::ONE, Vec3::NEG_Z, &behind), 0.0);
    assert!(random.sample(&lights, Vec3::Z * 5.0, None).is_none());
}
