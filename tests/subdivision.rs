//! Subdivision surfaces against OpenSubdiv's values (`tests/reference/make_subdivision.py`), and what must hold for any.

use dermis::flat::{AnyPrimvar, Array, Interpolation, Mesh, Orientation, Primvar, SubdivTags, array::Element};
use dermis::subdivision::{Refined, refine};
use glam::Vec3;
use serde_json::Value;
use std::collections::HashMap;

/// OpenSubdiv computes in f32, as dermis does; values reach 4.
const TOLERANCE: f32 = 1e-5;

fn numbers<T: serde::de::DeserializeOwned>(value: &Value) -> Vec<T> {
    if value.is_null() { Vec::new() } else { serde_json::from_value(value.clone()).expect("numbers") }
}

fn array<T: Element + serde::de::DeserializeOwned>(value: &Value) -> Array<T> {
    numbers(value).into()
}

fn token(value: &Value, default: &str) -> String {
    value.as_str().unwrap_or(default).into()
}

fn mesh_of(cage: &Value) -> Mesh {
    let uv = numbers::<[f32; 2]>(&cage["uv"]);
    let st = Primvar {
        interpolation: Interpolation::FaceVarying,
        values: uv.clone().into(),
        indices: Some(array(&cage["uvIndices"])),
    };
    Mesh {
        points: array(&cage["points"]),
        face_vertex_counts: array(&cage["faceVertexCounts"]),
        face_vertex_indices: array(&cage["faceVertexIndices"]),
        hole_indices: array(&cage["holeIndices"]),
        subdivision_scheme: token(&cage["subdivisionScheme"], "catmullClark"),
        subdiv_tags: SubdivTags {
            interpolate_boundary: token(&cage["interpolateBoundary"], "edgeAndCorner"),
            face_varying_linear_interpolation: token(&cage["faceVaryingLinearInterpolation"], "cornersPlus1"),
            triangle_subdivision_rule: token(&cage["triangleSubdivisionRule"], "catmullClark"),
            crease_indices: array(&cage["creaseIndices"]),
            crease_lengths: array(&cage["creaseLengths"]),
            crease_sharpnesses: array(&cage["creaseSharpnesses"]),
            corner_indices: array(&cage["cornerIndices"]),
            corner_sharpnesses: array(&cage["cornerSharpnesses"]),
        },
        primvars: (!uv.is_empty()).then(|| ("st".into(), AnyPrimvar::Float2(st))).into_iter().collect(),
        ..Mesh::default()
    }
}

fn st_of(mesh: &Mesh) -> Option<&Primvar<[f32; 2]>> {
    match mesh.primvars.get("st")? {
        AnyPrimvar::Float2(st) => Some(st),
        other => panic!("{other:?}"),
    }
}

fn refined(mesh: &Mesh, level: u32) -> Refined {
    let points: Vec<Vec3> = mesh.points.iter().map(|p| Vec3::from(*p)).collect();
    refine(mesh, &points, level)
}

fn normal_at(mesh: &Mesh, corner: usize) -> Vec3 {
    let normals = mesh.normals.as_ref().expect("normals");
    let at = match &normals.indices {
        Some(indices) => indices[corner],
        None => mesh.face_vertex_indices[corner],
    };
    normals.values[at as usize].into()
}

/// The face of ours with these corners, and which of its corners is the first of theirs: faces come in another order.
fn place_of(ours: &[Vec3], theirs: &[Vec3]) -> Option<(usize, usize)> {
    let n = theirs.len();
    let same = |face: &[Vec3], turn: usize| (0..n).all(|i| face[(i + turn) % n].abs_diff_eq(theirs[i], TOLERANCE));
    ours.chunks(n).enumerate().find_map(|(at, face)| (0..n).find(|turn| same(face, *turn)).map(|turn| (at, turn)))
}

/// Compares one entry of the reference; every way in which it differs.
fn differences(entry: &Value) -> Vec<String> {
    let name = entry["name"].as_str().expect("name");
    let made = refined(&mesh_of(&entry["cage"]), entry["level"].as_u64().expect("level") as u32);
    let vectors = |key: &str| -> Vec<Vec3> { numbers::<[f32; 3]>(&entry[key]).into_iter().map(Vec3::from).collect() };
    let (limit, normals, faces) = (vectors("limit"), vectors("normals"), numbers::<usize>(&entry["faces"]));
    let (uv, uv_faces) = (numbers::<[f32; 2]>(&entry["uv"]), numbers::<usize>(&entry["uvFaces"]));
    let holes = numbers::<usize>(&entry["holes"]);
    let ours: Vec<Vec3> = made.mesh.face_vertex_indices.iter().map(|v| made.points[*v as usize]).collect();
    let arity = made.mesh.face_vertex_counts[0] as usize;
    let mut wrong = Vec::new();
    if (ours.len(), made.mesh.hole_indices.len()) != (faces.len(), holes.len()) {
        wrong.push(format!("{name}: {} corners for {}, holes {:?}", ours.len(), faces.len(), made.mesh.hole_indices));
    }
    for (face, corners) in faces.chunks(arity).enumerate() {
        let theirs: Vec<Vec3> = corners.iter().map(|v| limit[*v]).collect();
        let Some((at, turn)) = place_of(&ours, &theirs) else {
            wrong.push(format!("{name}: no face at {theirs:?}"));
            continue;
        };
        if holes.contains(&face) != made.mesh.hole_indices.contains(&(at as i32)) {
            wrong.push(format!("{name}: face at {theirs:?} is a hole of one"));
        }
        for i in 0..arity {
            let (corner, reference) = (arity * at + (i + turn) % arity, arity * face + i);
            let normal = normals[corners[i]];
            if normal != Vec3::ZERO && made.mesh.normals.is_some() {
                let got = normal_at(&made.mesh, corner);
                if !got.abs_diff_eq(normal, TOLERANCE) {
                    wrong.push(format!("{name}: normal {got} at {}, not {normal}", theirs[i]));
                }
            }
            if let Some(st) = st_of(&made.mesh) {
                let got = st.values[st.indices.as_ref().expect("indices")[corner] as usize];
                let want = uv[uv_faces[reference]];
                if (0..2).any(|k| (got[k] - want[k]).abs() > TOLERANCE) {
                    wrong.push(format!("{name}: st {got:?} at {}, not {want:?}", theirs[i]));
                }
            }
        }
    }
    wrong
}

#[test]
fn limits_are_those_of_opensubdiv() {
    let text = std::fs::read_to_string("tests/reference/subdivision.json").expect("reference");
    let entries: Vec<Value> = serde_json::from_str(&text).expect("json");
    let wrong: Vec<(usize, String)> =
        entries.iter().map(differences).filter_map(|wrong| Some((wrong.len(), wrong.first()?.clone()))).collect();
    assert!(entries.len() > 60);
    assert!(wrong.is_empty(), "{} cages differ, the first each: {wrong:#?}", wrong.len());
}

fn cube() -> Mesh {
    Mesh {
        points: (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|x| 2.0 * x as f32 - 1.0)).collect::<Vec<_>>().into(),
        face_vertex_counts: vec![4; 6].into(),
        face_vertex_indices: vec![0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5].into(),
        subdivision_scheme: "catmullClark".into(),
        ..Mesh::default()
    }
}

/// A bumpy 4 x 4 grid in the plane z = 0 bent by `height`.
fn grid(height: impl Fn(f32, f32) -> f32) -> Mesh {
    let points = (0..25).map(|i| ((i % 5) as f32, (i / 5) as f32)).map(|(x, y)| [x, y, height(x, y)]);
    let faces = (0..16).flat_map(|f| {
        let v = f / 4 * 5 + f % 4;
        [v, v + 1, v + 6, v + 5]
    });
    Mesh {
        points: points.collect::<Vec<_>>().into(),
        face_vertex_counts: vec![4; 16].into(),
        face_vertex_indices: faces.collect::<Vec<_>>().into(),
        subdivision_scheme: "catmullClark".into(),
        ..Mesh::default()
    }
}

fn creased(mut mesh: Mesh, points: Vec<i32>, sharpness: f32) -> Mesh {
    mesh.subdiv_tags.crease_lengths = vec![points.len() as i32].into();
    mesh.subdiv_tags.crease_indices = points.into();
    mesh.subdiv_tags.crease_sharpnesses = vec![sharpness].into();
    mesh
}

/// How often each directed edge is used.
fn sides(mesh: &Mesh) -> HashMap<(i32, i32), u32> {
    let mut sides = HashMap::new();
    let arity = mesh.face_vertex_counts[0] as usize;
    for face in mesh.face_vertex_indices.chunks(arity) {
        (0..arity).for_each(|i| *sides.entry((face[i], face[(i + 1) % arity])).or_default() += 1);
    }
    sides
}

#[test]
fn a_closed_mesh_stays_closed() {
    for mesh in [cube(), creased(cube(), vec![0, 1, 3, 2, 0], 1.5)] {
        let sides = sides(&refined(&mesh, 3).mesh);
        assert_eq!(sides.len(), 4 * 6 * 64);
        assert!(sides.iter().all(|(&(a, b), n)| *n == 1 && sides.contains_key(&(b, a))));
    }
}

#[test]
fn a_plane_stays_a_plane() {
    let made = refined(&creased(grid(|_, _| 0.5), vec![6, 7, 8], 2.5), 2);
    assert!(made.points.iter().all(|p| (p.z - 0.5).abs() < 1e-6));
    let corners = made.mesh.face_vertex_indices.len();
    assert!((0..corners).all(|c| normal_at(&made.mesh, c).abs_diff_eq(Vec3::Z, 1e-5)));
}

/// The limit does not depend on the level that shows it: points of a coarse level are points of a finer one.
#[test]
fn levels_agree_on_the_limit() {
    let mesh = grid(|x, y| 0.3 * (x * 1.3).sin() * y);
    let (coarse, fine) = (refined(&mesh, 1), refined(&mesh, 3));
    for (a, b) in coarse.points.iter().zip(&fine.points) {
        assert!(a.abs_diff_eq(*b, 1e-5), "{a} {b}");
    }
}

/// An infinitely sharp crease is the boundary of both its sides: points and both normals are theirs.
#[test]
fn a_sharp_crease_parts_the_surface_like_a_boundary() {
    let whole = creased(grid(|x, y| (x - 2.0).abs() + 0.1 * y * y * x), vec![2, 7, 12, 17, 22], 10.0);
    let half = |right: bool| {
        let faces: Vec<usize> = (0..16).filter(|f| (f % 4 >= 2) == right).collect();
        let indices = faces.iter().flat_map(|f| whole.face_vertex_indices[4 * f..4 * f + 4].to_vec());
        let mut half = whole.clone();
        half.face_vertex_indices = indices.collect::<Vec<_>>().into();
        half.face_vertex_counts = vec![4; 8].into();
        half.subdiv_tags = SubdivTags::default();
        (faces, refined(&half, 2))
    };
    let both = refined(&whole, 2);
    assert_eq!(both.mesh.normals.as_ref().map(|n| n.interpolation), Some(Interpolation::FaceVarying));
    for (faces, side) in [half(false), half(true)] {
        for (i, face) in faces.iter().enumerate() {
            for corner in 0..64 {
                let (a, b) = (64 * face + corner, 64 * i + corner);
                let point = |made: &Refined, c: usize| made.points[made.mesh.face_vertex_indices[c] as usize];
                assert!(point(&both, a).abs_diff_eq(point(&side, b), 1e-5));
                // The two ends of the crease are corners of the whole, but of one face on either side as well.
                assert!(normal_at(&both.mesh, a).abs_diff_eq(normal_at(&side.mesh, b), 1e-4), "{}", point(&both, a));
            }
        }
    }
}

/// Quads or triangles around a vertex on the boundary.
fn fan(k: usize, scheme: &str) -> Mesh {
    let spoke = |i: usize| 2.4 * i as f32 / k as f32;
    let ring = (0..=k).map(|i| [spoke(i).cos(), spoke(i).sin(), 0.5 * (i % 2) as f32]);
    let middle = |i: usize| 0.5 * (spoke(i) + spoke(i + 1));
    let outer = (0..k).map(|i| [1.5 * middle(i).cos(), 1.5 * middle(i).sin(), -0.4]);
    let quads = scheme == "catmullClark";
    let points: Vec<[f32; 3]> = std::iter::once([0.0, 0.0, 0.3]).chain(ring).chain(outer).collect();
    let face = |i: usize| match quads {
        true => vec![0, i + 1, k + 2 + i, i + 2],
        false => vec![0, i + 1, i + 2],
    };
    Mesh {
        points: points.into(),
        face_vertex_counts: vec![if quads { 4 } else { 3 }; k].into(),
        face_vertex_indices: (0..k).flat_map(face).map(|v| v as i32).collect::<Vec<_>>().into(),
        subdivision_scheme: scheme.into(),
        ..Mesh::default()
    }
}

/// Of the facets of a fine level at vertex 0.
fn facet_normal(made: &Refined) -> Vec3 {
    let arity = made.mesh.face_vertex_counts[0] as usize;
    let mut sum = Vec3::ZERO;
    for face in made.mesh.face_vertex_indices.chunks(arity) {
        if let Some(at) = face.iter().position(|v| *v == 0) {
            let [a, b, c] = [0, 1, arity - 1].map(|i| made.points[face[(at + i) % arity] as usize]);
            sum += (b - a).cross(c - a).normalize();
        }
    }
    sum.normalize()
}

/// Tangents come from eigenvectors: the facets around a vertex turn towards its limit normal as levels go on, for any
/// number of faces on a boundary that has a tangent plane.
#[test]
fn facets_turn_towards_the_limit_normal() {
    for (scheme, k) in (1..=4).map(|k| ("catmullClark", k)).chain((1..=5).map(|k| ("loop", k))) {
        let mut mesh = fan(k, scheme);
        mesh.subdiv_tags.interpolate_boundary = "edgeOnly".into();
        let angle = |level| {
            let made = refined(&mesh, level);
            let corner = made.mesh.face_vertex_indices.iter().position(|v| *v == 0).expect("vertex 0");
            facet_normal(&made).angle_between(normal_at(&made.mesh, corner))
        };
        let angles = [2, 4, 6].map(angle);
        // The next eigenvalue is at most 0.82 of that of the tangents, a level; two levels are 0.67.
        let turned = |i: usize| angles[i + 1] < 0.75 * angles[i] + 1e-3;
        assert!(turned(0) && turned(1), "{scheme} {k}: {angles:?}");
    }
}

#[test]
fn left_handed_meshes_have_their_normals_turned() {
    let left = refined(&Mesh { orientation: Orientation::LeftHanded, ..cube() }, 1);
    let right = refined(&cube(), 1);
    (0..96).for_each(|c| assert_eq!(normal_at(&left.mesh, c), -normal_at(&right.mesh, c)));
}

#[test]
fn primvars_and_subsets_follow_their_faces() {
    let mut mesh = grid(|_, _| 0.0);
    let along = |x: fn(&[f32; 3]) -> f32, mesh: &Mesh| mesh.points.iter().map(|p| [x(p), 0.0, 1.0]).collect::<Vec<_>>();
    let color =
        |interpolation, values: Vec<[f32; 3]>| Some(Primvar { interpolation, values: values.into(), indices: None });
    mesh.geom_subsets = vec![dermis::flat::GeomSubset { indices: vec![3, 5].into(), ..Default::default() }];
    mesh.display_color = color(Interpolation::Uniform, (0..16).map(|i| [i as f32, 0.0, 0.0]).collect());
    let made = refined(&mesh, 2).mesh;
    let subset: Vec<i32> = (48..64).chain(80..96).collect();
    assert_eq!(made.geom_subsets[0].indices[..], subset[..]);
    let uniform = made.display_color.expect("color");
    let parents = uniform.indices.expect("indices");
    assert!((0..256).all(|face| uniform.values[parents[face] as usize][0] == (face / 16) as f32));
    // Vertex values follow the surface: x as colour is x of the point. Varying ones are linear in between.
    for interpolation in [Interpolation::Vertex, Interpolation::Varying] {
        mesh.display_color = color(interpolation, along(|p| p[0] * p[0], &mesh));
        let made = refined(&mesh, 1);
        let values = made.mesh.display_color.expect("color").values;
        for (p, value) in made.points.iter().zip(values.iter()) {
            let (below, above) = (p.x.floor(), p.x.ceil());
            let linear = below * below + (above * above - below * below) * (p.x - below);
            let smooth = interpolation == Interpolation::Vertex;
            // The cubic B-spline of x^2 at the integers is x^2 + 1/3; a quarter of that excess between them is linear's.
            let inner = p.x > 1.0 && p.x < 3.0;
            if smooth && inner {
                assert!((value[0] - (p.x * p.x + 1.0 / 3.0)).abs() < 1e-5, "{p} {value:?}");
            } else if !smooth && inner {
                assert!((value[0] - linear).abs() < 1e-5, "{p} {value:?}");
            }
        }
    }
}

/// Without indices, equal values at one vertex are one value: the map is smooth within a chart as with indices.
#[test]
fn face_varying_values_without_indices_are_joined_where_equal() {
    let mut mesh = grid(|x, y| 0.2 * x * y);
    let corner = |i: &i32| [mesh.points[*i as usize][0], mesh.points[*i as usize][1]];
    let values: Vec<[f32; 2]> = mesh.face_vertex_indices.iter().map(corner).collect();
    let indexed = mesh.points.iter().map(|p| [p[0], p[1]]).collect::<Vec<_>>();
    let (face_varying, indices) = (Interpolation::FaceVarying, mesh.face_vertex_indices.clone());
    let mut with = |values: Vec<[f32; 2]>, indices| {
        let st = Primvar { interpolation: face_varying, values: values.into(), indices };
        mesh.primvars.insert("st".into(), AnyPrimvar::Float2(st));
        st_of(&refined(&mesh, 2).mesh).expect("st").clone()
    };
    let plain = with(values, None);
    assert_eq!(plain, with(indexed, Some(indices)));
}

/// Of tags that cannot be used each is named, and the surface is there without them.
#[test]
fn bad_tags_and_topology_are_named() {
    let mut mesh = cube();
    mesh.subdiv_tags.crease_indices = vec![0, 7].into();
    mesh.subdiv_tags.crease_lengths = vec![2].into();
    mesh.subdiv_tags.crease_sharpnesses = vec![1.0].into();
    mesh.subdiv_tags.corner_indices = vec![0, 99].into();
    mesh.subdiv_tags.corner_sharpnesses = vec![f32::NAN, 1.0].into();
    let faults = |mesh: &Mesh| refined(mesh, 1).refinement.faults.join("; ");
    let said = faults(&mesh);
    assert!(said.contains("creaseIndices: 1 of 1") && said.contains("cornerIndices: 2 of 2"), "{said}");
    mesh.subdiv_tags.crease_lengths = vec![1, 1].into();
    mesh.subdiv_tags.corner_sharpnesses = vec![].into();
    let said = faults(&mesh);
    assert!(said.contains("creaseLengths: ") && said.contains("cornerSharpnesses: 0 values for 2"), "{said}");
    assert_eq!(refined(&mesh, 1).points, refined(&cube(), 1).points);
    let mut alone = cube();
    alone.face_vertex_counts = vec![4].into();
    alone.face_vertex_indices = vec![0, 2, 3, 1].into();
    alone.subdiv_tags.interpolate_boundary = "none".into();
    assert!(faults(&alone).contains("interpolateBoundary: none leaves no face"));
    let looped = Mesh { subdivision_scheme: "loop".into(), ..cube() };
    assert!(faults(&looped).contains("loop needs triangles, 6 faces"));
    let mut turned = cube();
    let mut indices = turned.face_vertex_indices.to_vec();
    indices[..4].reverse();
    turned.face_vertex_indices = indices.into();
    assert!(faults(&turned).contains("4 edges have more than two faces, or two of opposite winding"));
}

/// Repeated vertices make a quad a triangle, and no triangle of less.
#[test]
fn repeated_vertices_count_once() {
    let mut mesh = cube();
    let mut indices = mesh.face_vertex_indices.to_vec();
    indices.extend([0, 0, 1, 1, 2, 2, 2, 2]);
    mesh.face_vertex_indices = indices.into();
    mesh.face_vertex_counts = vec![4, 4, 4, 4, 4, 4, 4, 4].into();
    assert_eq!(refined(&mesh, 1).mesh.face_vertex_counts.len(), 24);
}

#[test]
fn a_level_that_no_memory_holds_is_lowered() {
    let made = refined(&cube(), 9);
    assert_eq!((made.refinement.asked, made.refinement.level), (9, 8));
    assert!(made.refinement.faults[0].contains("refineLevel: 9"));
}
