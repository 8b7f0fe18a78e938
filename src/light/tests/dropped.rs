//! Lights that cannot shine are dropped, and said to be.

use super::*;

/// Warning of a light that must be dropped.
fn dropped(light: flat::Light) -> String {
    let mut warnings = Vec::new();
    let prims = [("/World/bad".to_owned(), light)].into();
    let lights = Lights::compile(&prims, &Prims::new(), &|_| None, DVec3::ZERO, true, &mut warnings);
    assert!(lights.is_empty());
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert_eq!(warnings[0].prim, "/World/bad");
    warnings.remove(0).message
}

fn dropped_shape(shape: LightShape) -> String {
    dropped(light(shape, IDENTITY))
}

#[test]
fn sizes_that_are_no_sizes() {
    let rect = |width, height| LightShape::Rect { width, height, texture: String::new() };
    assert!(dropped_shape(rect(0.0, 1.0)).contains("inputs:width"));
    assert!(dropped_shape(rect(1.0, -1.0)).contains("inputs:height"));
    assert!(dropped_shape(LightShape::Disk { radius: f32::NAN }).contains("inputs:radius"));
    assert!(dropped_shape(LightShape::Sphere { radius: -1.0 }).contains("inputs:radius"));
    assert!(dropped_shape(LightShape::Sphere { radius: f32::INFINITY }).contains("inputs:radius"));
    assert!(dropped_shape(LightShape::Cylinder { length: 0.0, radius: 1.0 }).contains("inputs:length"));
    assert!(dropped_shape(LightShape::Distant { angle: f32::NAN }).contains("inputs:angle"));
    assert!(dropped_shape(LightShape::Distant { angle: -1.0 }).contains("inputs:angle"));
    assert!(dropped_shape(LightShape::Disk { radius: 1e-30 }).contains("area"));
    assert!(dropped_shape(LightShape::Sphere { radius: 1e30 }).contains("area"));
    assert!(dropped_shape(LightShape::Mesh { mesh: "/gone".into() }).contains("/gone"));
}

#[test]
fn transforms_that_flatten() {
    for shape in area_shapes() {
        let flat = matrix([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
        assert!(dropped(light(shape.clone(), flat)).contains("xformOps"));
        let nan = matrix([f64::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
        assert!(dropped(light(shape, nan)).contains("xformOps"));
    }
}

#[test]
fn brightness_that_is_no_number() {
    assert!(dropped(flat::Light { intensity: f32::INFINITY, ..Default::default() }).contains("inputs:intensity"));
    assert!(dropped(flat::Light { exposure: 1e4, ..Default::default() }).contains("inputs:exposure"));
}

/// Each is in range; their product is not, and would be no number in the weights of a choice among lights.
#[test]
fn profiles_that_are_too_bright() {
    let profile = |candela: f32, normalize| flat::Ies {
        vertical: vec![0.0, 90.0].into(),
        horizontal: vec![0.0].into(),
        candela: vec![candela, candela].into(),
        normalize,
        ..Default::default()
    };
    let lamp = |candela, normalize, intensity| {
        let shaping = flat::Shaping { ies: Some(profile(candela, normalize)), cone_angle: 90.0, ..Default::default() };
        flat::Light { intensity, shaping: Some(shaping), ..light(LightShape::Sphere { radius: 0.5 }, IDENTITY) }
    };
    let message = dropped(lamp(1e38, false, 10.0));
    assert!(message.contains("shaping:ies") && message.contains("1e30"), "{message}");
    assert!(dropped(lamp(f32::MAX, false, 1e-3)).contains("shaping:ies"));
    let sound = [lamp(1e38, true, 10.0), lamp(1e38, false, 1e-10), lamp(1e3, false, 1e20)];
    for rig in [sound.to_vec(), sound.iter().cycle().take(40).cloned().collect()] {
        let lights = compile(&rig);
        let sum: f32 = (0..lights.len() as u32)
            .map(|i| lights.at(0.0).choice_probability(i, Vec3::NEG_Z * 3.0, None, Choice::ONE))
            .sum();
        assert!((sum - 1.0).abs() < 1e-4, "{sum}");
    }
}

#[test]
fn meshes_without_area() {
    let mut warnings = Vec::new();
    let prims = [("/m".to_owned(), light(LightShape::Mesh { mesh: "/m".into() }, IDENTITY))].into();
    let lights =
        Lights::compile(&prims, &Prims::new(), &|_| Some(vec![[Vec3::ONE; 3]]), DVec3::ZERO, true, &mut warnings);
    assert!(lights.is_empty() && warnings.len() == 1);
}

#[test]
fn a_missing_texture_is_said_and_the_light_stays() {
    let mut warnings = Vec::new();
    let dome = LightShape::Dome { texture: "/gone.exr".into(), pole_axis: "Y".into() };
    let prims = [("/d".to_owned(), light(dome, IDENTITY))].into();
    let lights = Lights::compile(&prims, &Prims::new(), &|_| None, DVec3::ZERO, true, &mut warnings);
    assert_eq!(lights.len(), 1);
    assert!(warnings[0].message.contains("/gone.exr"));
}

#[test]
fn the_dark_and_the_invisible_go_without_a_word() {
    let invisible = flat::Light { visible: false, ..Default::default() };
    let dark = flat::Light { intensity: 0.0, ..Default::default() };
    assert!(compile(&[invisible, dark]).is_empty());
}

#[test]
fn the_origin_of_render_space_is_taken_off_in_f64() {
    let far = matrix([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1e8, 0.0, 2.25]);
    let prims = [("/far".to_owned(), light(LightShape::Sphere { radius: 0.25 }, far))].into();
    let origin = DVec3::new(1e8, 0.0, 0.0);
    let lights = Lights::compile(&prims, &Prims::new(), &|_| None, origin, true, &mut Vec::new());
    assert_eq!(lights.path(0), "/far");
    let hit = lights.at(0.0).intersect(0, Vec3::ZERO, Vec3::Z, 9.0).unwrap();
    assert!((hit.t - 2.0).abs() < 1e-5);
}
