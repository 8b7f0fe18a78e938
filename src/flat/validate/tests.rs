//! Broken prims: what is kept, what is said, and that nothing out of range is left.

use super::*;
use crate::flat::{
    AnyPrimvar, Array, Camera, IDENTITY, Instancer, Interpolation, Light, Material, Matrix4d, OpenPbrSurface,
    PreviewSurface, Primvar, RenderSettings, Shaping, StandardSurface, Texture, TransformKeys, array::Element, sample,
};

mod mutations;

fn check_mesh(mesh: &mut Mesh) -> Vec<String> {
    messages(|warnings| validate_mesh("/mesh", mesh, warnings))
}

fn messages(check: impl FnOnce(&mut Vec<Warning>)) -> Vec<String> {
    let mut warnings = Vec::new();
    check(&mut warnings);
    warnings.into_iter().map(|warning| warning.message).collect()
}

fn edit<T: Element>(array: &mut Array<T>, edit: impl FnOnce(&mut Vec<T>)) {
    let mut values = array.to_vec();
    edit(&mut values);
    *array = values.into();
}

fn st(mesh: &Mesh) -> Option<Primvar<[f32; 2]>> {
    match mesh.primvars.get("st")? {
        AnyPrimvar::Float2(st) => Some(st.clone()),
        other => panic!("two components, not {other:?}"),
    }
}

fn edit_st(mesh: &mut Mesh, edit: impl FnOnce(&mut Primvar<[f32; 2]>)) {
    let mut st = st(mesh).unwrap();
    edit(&mut st);
    mesh.primvars.insert("st".into(), AnyPrimvar::Float2(st));
}

/// What the compiler relies on.
fn assert_usable(mesh: &Mesh) {
    let points = mesh.points.len();
    let faces = mesh.face_vertex_counts.len();
    let corners: usize = mesh.face_vertex_counts.iter().map(|&count| count as usize).sum();
    let within = |indices: &[i32], end: usize| indices.iter().all(|&index| index >= 0 && (index as usize) < end);
    assert!(mesh.face_vertex_counts.iter().all(|&count| count >= 3));
    assert_eq!(corners, mesh.face_vertex_indices.len());
    assert!(within(&mesh.face_vertex_indices, points));
    assert!(within(&mesh.hole_indices, faces));
    assert!(mesh.geom_subsets.iter().all(|subset| within(&subset.indices, faces)));
    assert!(mesh.points.as_flattened().iter().all(|number| number.abs() <= 1e30));
    assert_eq!(report::placement_fault(&mesh.transform), None);
    assert!(faces > 0 || !mesh.visible);
    assert_fits(&mesh.normals, [points, faces, corners]);
    assert_fits(&st(mesh), [points, faces, corners]);
    assert_fits(&mesh.display_color, [points, faces, corners]);
    assert_fits(&mesh.display_opacity, [points, faces, corners]);
}

fn assert_fits<T: Element>(primvar: &Option<Primvar<T>>, [points, faces, corners]: [usize; 3]) {
    let Some(Primvar { interpolation, values, indices }) = primvar else { return };
    let length = indices.as_ref().map_or(values.len(), |indices| indices.len());
    let expected = match interpolation {
        Interpolation::Constant => 1,
        Interpolation::Uniform => faces,
        Interpolation::Varying | Interpolation::Vertex => points,
        Interpolation::FaceVarying => corners,
    };
    assert_eq!(length, expected);
    let in_range = |&index: &i32| index >= 0 && (index as usize) < values.len();
    assert!(indices.as_ref().is_none_or(|indices| indices.iter().all(in_range)));
    assert!(bytemuck::cast_slice::<T, f32>(values).iter().all(|number| number.abs() <= 1e30));
}

#[test]
fn a_sound_scene_is_left_as_it_is() {
    let mut scene = sample::scene();
    assert_eq!(scene.validate(), []);
    assert_eq!(scene, sample::scene());
    scene.meshes.values().for_each(assert_usable);
}

#[test]
fn a_dropped_face_takes_its_primvars_along() {
    let mut mesh = sample::cube();
    edit(&mut mesh.face_vertex_indices, |indices| indices[5] = 99);
    let warnings = check_mesh(&mut mesh);
    assert_eq!(warnings, ["1 of 6 faces dropped: faceVertexIndices outside the 8 points; export the mesh again"]);
    assert_usable(&mesh);
    let cube = sample::cube();
    let without_face_1: Vec<i32> = [&cube.face_vertex_indices[..4], &cube.face_vertex_indices[8..]].concat();
    assert_eq!(mesh.face_vertex_indices[..], without_face_1);
    assert_eq!(mesh.display_opacity.as_ref().unwrap().values[..], [0.0, 0.2, 0.3, 0.4, 0.5]);
    let colors = &mesh.display_color.as_ref().unwrap().values;
    assert_eq!(colors[4], [8.0 / 24.0; 3], "face 2 follows face 0");
    assert_eq!(st(&mesh).unwrap().indices.unwrap().len(), 20);
    assert_eq!(mesh.hole_indices[..], [4]);
    assert_eq!(mesh.geom_subsets[0].indices[..], [2, 3]);
}

#[test]
fn counts_that_do_not_add_up_keep_the_faces_that_fit() {
    let cases: [(&[i32], usize, &str); 5] = [
        (&[4, 4, 4, 4, 4, 5], 5, "1 of 6 faces dropped: the sum of faceVertexCounts exceeds"),
        (&[4, 4, 4, 4, 4, 3], 6, "1 faceVertexIndices dropped: beyond the sum of faceVertexCounts"),
        (&[4, -7, 4, 4, 4, 8], 5, "1 of 6 faces dropped: faceVertexCounts below 3"),
        (&[4, 4, 2, 4, 4, 4], 5, "1 of 6 faces dropped: faceVertexCounts below 3"),
        (&[i32::MAX, i32::MAX, i32::MAX, 4, 0, 4], 0, "6 of 6 faces dropped: the sum of faceVertexCounts exceeds"),
    ];
    for (counts, kept, message) in cases {
        let mut mesh = sample::cube();
        mesh.face_vertex_counts = counts.to_vec().into();
        let warnings = check_mesh(&mut mesh);
        assert!(warnings[0].starts_with(message), "{counts:?}: {warnings:?}");
        assert_eq!(mesh.face_vertex_counts.len(), kept, "{counts:?}");
        assert_usable(&mesh);
        assert!(check_mesh(&mut mesh).is_empty(), "a second time finds nothing");
    }
}

#[test]
fn points_that_are_nowhere_take_their_faces() {
    for bad in [f32::NAN, f32::INFINITY, -1e31] {
        let mut mesh = sample::cube();
        edit(&mut mesh.points, |points| points[7][1] = bad);
        let warnings = check_mesh(&mut mesh);
        assert_eq!(warnings.len(), 1, "one cause, one warning");
        assert!(warnings[0].starts_with("3 of 6 faces dropped: points not finite"), "{warnings:?}");
        assert_eq!(mesh.points[7], mesh.points[0], "bounds do not grow");
        assert_usable(&mesh);
    }
}

#[test]
fn only_faces_without_any_area_go() {
    let triangle = |points: [[f32; 3]; 4], indices: Vec<i32>| Mesh {
        points: points.to_vec().into(),
        face_vertex_counts: vec![indices.len() as i32].into(),
        face_vertex_indices: indices.into(),
        ..Mesh::default()
    };
    let line = [[0.0; 3], [0.1; 3], [0.3; 3], [0.7; 3]];
    let square = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let tiny = square.map(|point| point.map(|number| number * 1e-18));
    let huge = square.map(|point| point.map(|number| number * 1e29));
    let sliver = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1e-6, 0.0], [0.5, 0.0, 0.0]];
    for (points, indices, faces) in [
        (line, vec![0, 1, 2, 3], 0),
        (square, vec![0, 1, 1], 0),
        (square, vec![2, 2, 2, 2], 0),
        (square, vec![0, 2, 1, 3], 1), // bow tie
        (square, vec![0, 0, 1, 2], 1),
        (tiny, vec![0, 1, 2, 3], 1),
        (huge, vec![0, 1, 2, 3], 1),
        (sliver, vec![0, 1, 2], 1),
    ] {
        let mut mesh = triangle(points, indices.clone());
        let warnings = check_mesh(&mut mesh);
        assert_eq!(mesh.face_vertex_counts.len(), faces, "{points:?} {indices:?}");
        assert_eq!(warnings.len(), if faces == 1 { 0 } else { 1 }, "{warnings:?}");
    }
}

#[test]
fn primvars_that_do_not_fit_are_dropped() {
    let mut mesh = sample::cube();
    mesh.normals.as_mut().unwrap().values = vec![[0.0, 0.0, 1.0]; 7].into();
    edit_st(&mut mesh, |st| st.indices = Some(vec![4; 24].into()));
    edit(&mut mesh.display_color.as_mut().unwrap().values, |colors| colors[3][2] = f32::NAN);
    edit(&mut mesh.display_opacity.as_mut().unwrap().values, |opacities| opacities[3] = 7.0);
    let warnings = check_mesh(&mut mesh);
    assert_eq!(
        warnings,
        [
            "normals dropped: 7 elements do not fit vertex interpolation, which has 8",
            "primvars:displayColor dropped: 1 numbers are not finite or beyond 1e30; author finite values",
            "primvars:st dropped: its indices are outside its 4 values; author indices from 0",
            "primvars:displayOpacity: 1 numbers clamped; author 0 to 1"
        ]
    );
    assert_eq!((&mesh.normals, &st(&mesh), &mesh.display_color), (&None, &None, &None));
    assert_eq!(mesh.display_opacity.unwrap().values[3], 1.0);
}

#[test]
fn face_lists_and_placements() {
    let mut mesh = sample::cube();
    mesh.hole_indices = vec![6, 5, -1].into();
    mesh.geom_subsets[0].indices = vec![0, 1000].into();
    mesh.subdivision_scheme = "catmulClark".into();
    let mut warnings = Vec::new();
    validate_mesh("/mesh", &mut mesh, &mut warnings);
    let prims: Vec<_> = warnings.iter().map(|warning| warning.prim.as_str()).collect();
    assert_eq!(prims, ["/mesh", "/mesh", "/cube/top"], "{warnings:?}");
    assert_eq!((&mesh.hole_indices[..], &mesh.geom_subsets[0].indices[..]), (&[5][..], &[0][..]));

    let mut flat = Mesh { transform: [IDENTITY[0], IDENTITY[1], [0.0; 4], IDENTITY[3]], ..sample::cube() };
    assert!(check_mesh(&mut flat)[0].contains("zero scale"));
    assert!(!flat.visible);
    assert_usable(&flat);

    let mut empty = Mesh::default();
    assert!(check_mesh(&mut empty)[0].contains("no faces"));
    assert!(!empty.visible && check_mesh(&mut empty).is_empty());

    let mut broken = IDENTITY;
    broken[3][0] = f64::NAN;
    let values = vec![0.1, 0.2, 0.3].into();
    let wear = AnyPrimvar::Float(Primvar { interpolation: Interpolation::Vertex, values, indices: None });
    let far: Matrix4d = [IDENTITY[0], IDENTITY[1], IDENTITY[2], [9.0, 0.0, 0.0, 1.0]];
    let moved: Array<Matrix4d> = vec![IDENTITY, far, IDENTITY].into();
    let mut instancer = Instancer {
        visible: true,
        transforms: vec![broken, IDENTITY, [[0.0; 4]; 4]].into(),
        display_color: vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].into(),
        primvars: [("wear".to_owned(), wear)].into(),
        transform_keys: Some(TransformKeys { times: vec![0.0, 1.0], transforms: vec![moved.clone(), moved] }),
    };
    let warnings = messages(|warnings| validate_instancer("/tree", &mut instancer, warnings));
    assert!(warnings[0].starts_with("2 of 3 instances dropped"), "{warnings:?}");
    assert_eq!(instancer.transforms[..], [IDENTITY]);
    assert_eq!(instancer.display_color[..], [[0.0, 1.0, 0.0]]);
    assert!(
        instancer.transform_keys.as_ref().unwrap().transforms.iter().all(|at| at[..] == [far]),
        "those that stay keep theirs"
    );
    assert!(matches!(&instancer.primvars["wear"], AnyPrimvar::Float(wear) if wear.values[..] == [0.2]));
    // NaN is none; what is in part a number was to be one.
    for (color, count) in [([f32::NAN; 3], 0), ([f32::INFINITY, 0.0, 1.0], 1), ([0.0, f32::NAN, 0.0], 1)] {
        instancer.display_color = vec![color].into();
        let warnings = messages(|warnings| validate_instancer("/tree", &mut instancer, warnings));
        assert_eq!(warnings.iter().filter(|text| text.contains("1 values are not finite")).count(), count);
        assert!(instancer.display_color[0].iter().all(|x| x.is_nan()));
    }
    instancer.display_color = vec![[0.5; 3]; 2].into();
    assert!(messages(|warnings| validate_instancer("/tree", &mut instancer, warnings))[0].contains("2 values for 1"));
    assert!(instancer.display_color.is_empty());
}

#[test]
fn names_that_lead_nowhere_are_cleared() {
    let mut scene = sample::scene();
    scene.materials.remove("/looks/wax");
    scene.instancers.clear();
    scene.textures.get_mut("/sky.exr").unwrap().width = 4;
    scene.settings.camera = "/other".into();
    scene.lights.get_mut("/lamp").unwrap().shape = LightShape::Mesh { mesh: "/gone".into() };
    scene.stage.meters_per_unit = 0.0;
    scene.stage.time_code = f64::NAN;
    let warnings = scene.validate();
    let prims: Vec<_> = warnings.iter().map(|warning| warning.prim.as_str()).collect();
    let twice_subset = ["/cube/top", "/cube/top", "/leaf"];
    let lights = ["/lamp", "/lamp", "/sky", "/window"];
    let expected = [&["/sky.exr", "/", "/"][..], &twice_subset, &lights, &["render settings"]].concat();
    assert_eq!(prims, expected, "{warnings:?}");
    assert!(!scene.meshes["/leaf"].visible && scene.meshes["/leaf"].instancer.is_empty());
    assert!(scene.meshes["/cube"].geom_subsets[0].material.is_empty());
    assert!(!scene.lights["/lamp"].visible);
    let LightShape::Dome { texture, .. } = &scene.lights["/sky"].shape else { panic!("no dome") };
    assert!(texture.is_empty() && scene.settings.camera.is_empty());
    assert_eq!(scene.validate(), []);
}

#[test]
fn lights_and_cameras() {
    let mut light = Light {
        intensity: -3.0,
        exposure: f32::NAN,
        color: [0.5, -1.0, f32::INFINITY],
        shaping: Some(Shaping { cone_angle: 270.0, ..Shaping::default() }),
        shape: LightShape::Rect { width: -1.0, height: 1.0, texture: String::new() },
        ..Light::default()
    };
    let warnings = messages(|warnings| validate_light("/light", &mut light, warnings));
    let attributes: Vec<_> = warnings.iter().map(|message| message.split(' ').next().unwrap()).collect();
    let expected = ["intensity", "exposure", "color", "shaping:cone:angle", "width"];
    assert_eq!(attributes, expected.map(|name| format!("inputs:{name}")), "{warnings:?}");
    assert_eq!((light.intensity, light.exposure, light.visible), (0.0, 0.0, false));
    assert_eq!(light.color, [0.5, 0.0, 1e30]);

    let mut bright = Light { intensity: 1e20, exposure: 90.0, ..Light::default() };
    assert_eq!(messages(|warnings| validate_light("/light", &mut bright, warnings)).len(), 1);
    assert!(!bright.visible);

    let mut camera = Camera {
        focal_length: 0.0,
        horizontal_aperture: f32::NAN,
        clipping_range: [5.0, 1.0],
        f_stop: -1.0,
        transform: [[0.0; 4]; 4],
        ..Camera::default()
    };
    let warnings = messages(|warnings| validate_camera("/camera", &mut camera, warnings));
    assert_eq!(warnings.len(), 5, "{warnings:?}");
    assert_eq!(camera, Camera::default());
}

#[test]
fn materials_name_their_own_inputs() {
    let mut preview = Material::UsdPreviewSurface(PreviewSurface {
        subsurface_radius: [1.0, -2.0, f32::NAN],
        subsurface_anisotropy: 1.0,
        subsurface_boundary: "glass".into(),
        ior: 0.0,
        ..PreviewSurface::default()
    });
    // What scatters in a depth may do so more than once.
    let transmission_scatter = [1.6, 0.5, 0.0];
    let mut open_pbr = Material::OpenPbr(OpenPbrSurface {
        subsurface_radius: -1.0,
        transmission_scatter,
        ..OpenPbrSurface::default()
    });
    let mut standard = Material::StandardSurface(StandardSurface {
        specular_ior: -1.5,
        coat_ior: 1e9,
        transmission_scatter,
        ..StandardSurface::default()
    });
    let check = |material: &mut Material| messages(|warnings| validate_material("/look", material, warnings));
    assert_eq!(
        check(&mut preview),
        [
            "inputs:subsurfaceRadius is [1.0, -2.0, NaN], [1.0, 0.0, 1.0] is used; author a finite number, not below 0",
            "inputs:subsurfaceAnisotropy is 1.0, 0.99 is used; author -0.99 to 0.99",
            "inputs:ior is 0.0, 1.5 is used; author a number above 0",
            "inputs:subsurfaceBoundary is \"glass\", \"diffuse\" is used; \
             author one of diffuse, dielectric, indexMatched",
        ]
    );
    assert_eq!(
        check(&mut open_pbr),
        ["inputs:subsurface_radius is -1.0, 0.0 is used; author a finite number, not below 0"]
    );
    assert_eq!(
        check(&mut standard),
        [
            "inputs:specular_IOR is -1.5, 1.5 is used; author a number above 0",
            "inputs:coat_IOR is 1000000000.0, 100.0 is used; author 0.01 to 100"
        ]
    );
    for material in [&mut preview, &mut open_pbr, &mut standard] {
        assert!(check(material).is_empty(), "a second time finds nothing");
    }
}

#[test]
fn textures() {
    let mut texture = sample::scene().textures.remove("/sky.exr").unwrap();
    edit(&mut texture.pixels, |pixels| pixels[2] = [f32::NAN, -1.0, f32::INFINITY]);
    let warnings = messages(|warnings| validate_texture("/sky", &mut texture, warnings));
    assert!(warnings[0].starts_with("sky.exr: 3 values are NaN, negative or infinite"), "{warnings:?}");
    assert_eq!(texture.pixels[2], [0.0, 0.0, 65504.0]);
    for (width, height) in [(2, 2), (0, 6), (u32::MAX, u32::MAX)] {
        let mut wrong = Texture { width, height, ..texture.clone() };
        assert_eq!(messages(|warnings| validate_texture("/sky", &mut wrong, warnings)).len(), 1);
        assert_eq!(wrong, Texture { file: "sky.exr".into(), ..Texture::default() });
    }
}

#[test]
fn settings_are_refused_not_guessed() {
    type Edit = fn(&mut RenderSettings);
    let cases: [(&str, Edit); 14] = [
        ("resolution is 0 x 540", |s| s.resolution[0] = 0),
        ("resolution is 960 x 100000", |s| s.resolution[1] = 100_000),
        ("samples is 0", |s| s.samples = 0),
        ("samples is 4294967295", |s| (s.samples, s.sample_offset) = (u32::MAX, 1)),
        ("dataWindowNDC is [0.5, 0.0, 0.5, 1.0]", |s| s.data_window_ndc = [0.5, 0.0, 0.5, 1.0]),
        ("dataWindowNDC is [0.0, 1.0, 1.0, 0.0]", |s| s.data_window_ndc = [0.0, 1.0, 1.0, 0.0]),
        ("dataWindowNDC is [NaN", |s| s.data_window_ndc[0] = f32::NAN),
        ("dataWindowNDC is [0.0, 0.0, 1000.0", |s| s.data_window_ndc[2] = 1000.0),
        ("pixelAspectRatio is 0", |s| s.pixel_aspect_ratio = 0.0),
        ("timeLimit is NaN", |s| s.time_limit = f32::NAN),
        ("timeLimit is 1000000000000000000000000000000", |s| s.time_limit = 1e30),
        ("threads is 100000", |s| s.threads = 100_000),
        ("noiseThreshold is -1", |s| s.noise_threshold = -1.0),
        ("aovs is \"Z\"; give alpha, depth", |s| s.aovs.push("Z".into())),
    ];
    RenderSettings::default().check().unwrap();
    let overscan = RenderSettings { data_window_ndc: [-0.1, -0.1, 1.1, 1.1], ..RenderSettings::default() };
    overscan.check().unwrap();
    for (message, edit) in cases {
        let mut settings = RenderSettings::default();
        edit(&mut settings);
        let error = settings.check().unwrap_err().to_string();
        assert!(error.starts_with(&format!("render settings: {message}")), "{error}");
    }
}
