//! A small scene with one of everything, for tests.

use super::*;

/// A cube of six quads with every kind of primvar.
pub(crate) fn cube() -> Mesh {
    let points: Vec<[f32; 3]> = (0..8).map(|i| [0, 1, 2].map(|axis| ((i >> axis) & 1) as f32)).collect();
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let st = Primvar {
        interpolation: Interpolation::FaceVarying,
        values: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].into(),
        indices: Some([0, 1, 2, 3].repeat(6).into()),
    };
    let primvar = |interpolation, values: Vec<f32>| Primvar { interpolation, values: values.into(), indices: None };
    Mesh {
        points: points.clone().into(),
        face_vertex_counts: vec![4; 6].into(),
        face_vertex_indices: faces.as_flattened().to_vec().into(),
        hole_indices: vec![5].into(),
        normals: Some(Primvar { interpolation: Interpolation::Vertex, values: points.clone().into(), indices: None }),
        primvars: [("st".into(), AnyPrimvar::Float2(st))].into(),
        display_color: Some(Primvar {
            interpolation: Interpolation::FaceVarying,
            values: (0..24).map(|i| [i as f32 / 24.0; 3]).collect::<Vec<_>>().into(),
            indices: None,
        }),
        display_opacity: Some(primvar(Interpolation::Uniform, vec![0.0, 0.1, 0.2, 0.3, 0.4, 0.5])),
        subdiv_tags: SubdivTags {
            interpolate_boundary: "edgeOnly".into(),
            crease_indices: vec![0, 1].into(),
            crease_lengths: vec![2].into(),
            crease_sharpnesses: vec![2.5].into(),
            ..SubdivTags::default()
        },
        refine_level: Some(2),
        medium_priority: Some(3),
        subsurface_set: "head".into(),
        material: "/looks/skin".into(),
        geom_subsets: vec![GeomSubset {
            path: "/cube/top".into(),
            indices: vec![1, 3, 4].into(),
            material: "/looks/wax".into(),
        }],
        point_keys: Some(PointKeys {
            times: vec![0.0, 1.0],
            points: vec![points.clone().into(), points.iter().map(|p| p.map(|x| 2.0 * x)).collect::<Vec<_>>().into()],
            normals: vec![points.clone().into(), points.into()],
        }),
        ..Mesh::default()
    }
}

fn light(shape: LightShape) -> Light {
    Light { shape, ..Light::default() }
}

pub(crate) fn scene() -> FlatScene {
    let mut scene = FlatScene::default();
    scene.stage.file = "/shots/müller \"quoted\".usda".into();
    scene.meshes.insert("/cube".into(), cube());
    scene.meshes.insert("/leaf".into(), Mesh { instancer: "/tree".into(), ..cube() });
    let transforms = vec![IDENTITY, [[2.0, 0.0, 0.0, 0.0], IDENTITY[1], IDENTITY[2], [3.0, 4.0, 5.0, 1.0]]];
    let display_color = vec![[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]].into();
    let at = |matrices: &[Matrix4d]| Array::from(matrices.to_vec());
    let keys =
        TransformKeys { times: vec![0.0, 0.75, 1.0], transforms: [0, 1, 0].map(|i| at(&[transforms[i]; 2])).to_vec() };
    scene.instancers.insert(
        "/tree".into(),
        Instancer {
            visible: true,
            transforms: transforms.into(),
            display_color,
            transform_keys: Some(keys),
            ..Instancer::default()
        },
    );
    scene.materials.insert("/looks/skin".into(), Material::default());
    scene.materials.insert("/looks/wax".into(), Material::OpenPbr(OpenPbrSurface::default()));
    scene.materials.insert("/looks/jade".into(), Material::StandardSurface(StandardSurface::default()));
    scene.lights.insert(
        "/key".into(),
        Light { shaping: Some(Shaping::default()), ..light(LightShape::Sphere { radius: 0.5 }) },
    );
    let sky = light(LightShape::Dome { texture: "/sky.exr".into(), pole_axis: "Y".into() });
    let portals = vec![Portal { path: "/portal".into(), height: 2.0, ..Portal::default() }];
    scene.lights.insert("/sky".into(), Light { portals, ..sky });
    scene
        .lights
        .insert("/window".into(), light(LightShape::Rect { width: 1.0, height: 2.0, texture: "/sky.exr".into() }));
    scene.lights.insert("/tube".into(), light(LightShape::Cylinder { length: 1.0, radius: 0.1 }));
    scene.lights.insert("/sun".into(), light(LightShape::Distant { angle: 0.53 }));
    scene.lights.insert("/lamp".into(), light(LightShape::Mesh { mesh: "/cube".into() }));
    scene.cameras.insert("/camera".into(), Camera::default());
    let pixels = vec![[0.25, 0.5, 1.0], [0.1, 0.0, 3e4], [1.0; 3], [0.0; 3], [2.0; 3], [4.0; 3]];
    scene
        .textures
        .insert("/sky.exr".into(), Texture { file: "sky.exr".into(), width: 3, height: 2, pixels: pixels.into() });
    let pores = Image {
        file: "pores.png".into(),
        width: 2,
        height: 1,
        channels: 3,
        srgb: true,
        texels: Texels::U8(vec![7; 6].into()),
        ..Image::default()
    };
    scene.images.insert("@pores.png@".into(), pores);
    scene.images.insert(
        "@depth.exr@".into(),
        Image { width: 1, height: 2, texels: Texels::Half(vec![0x3c00, 0].into()), ..Image::default() },
    );
    *scene.materials.get_mut("/looks/wax").expect("there").networks_mut()[0] = network();
    scene.settings.camera = "/camera".into();
    scene.settings.aovs = vec!["depth".into(), "albedo".into()];
    scene.warnings.push(crate::error::Warning::new("/curves", "BasisCurves are not rendered"));
    scene
}

/// A colour from an image, doubled.
fn network() -> Network {
    let image = ImageNode {
        tiles: vec![Tile { udim: 0, image: "@pores.png@".into() }],
        st: 0,
        wrap_s: Wrap::Repeat,
        wrap_t: Wrap::Mirror,
        border: [0.0; 4],
        fallback: [0.0, 0.0, 0.0, 1.0],
        closest: false,
    };
    let nodes = vec![
        Node::Primvar { varname: "st".into(), fallback: [0.0; 4] },
        Node::Image(image),
        Node::Constant { value: [2.0; 4] },
        Node::Math { op: Op::Multiply, args: vec![1, 2] },
    ];
    Network { nodes, inputs: [("base_color".into(), 3)].into(), tangents: "st".into() }
}
