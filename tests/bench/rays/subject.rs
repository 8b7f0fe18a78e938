//! What is traced: meshes of flattened scenes, one of them subdivided, a soup, and a cloud of instances.

use dermis::flat::{self, Array, FlatScene, Instancer, Material, Mesh, PreviewSurface};
use dermis::scene::{self, Kept, Scene};
use glam::{Mat3, Mat4, Quat, Vec3};
use std::collections::HashMap;
use std::path::Path;

/// Random numbers, as `tests/accel.rs`: SplitMix64 (Steele et al. 2014).
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in [-1, 1]^3.
    pub fn cube(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }
}

#[derive(Clone)]
pub struct TriangleMesh {
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
}

/// One row of the table: a mesh, compiled as a render compiles it, and where it stands.
pub struct Subject {
    pub name: String,
    pub mesh: TriangleMesh,
    pub scene: Scene,
}

impl Subject {
    /// The mesh placed once, as it is.
    pub fn single(name: &str, mesh: TriangleMesh) -> Self {
        Self::placed(name, mesh, Vec::new())
    }

    /// The mesh placed by `transforms`, once as it is if there are none. The camera stands at the origin, so that
    /// render space is the world's.
    pub fn placed(name: &str, mesh: TriangleMesh, transforms: Vec<Mat4>) -> Self {
        Self::compiled(name, mesh, transforms, None)
    }

    /// The mesh with a grey medium behind a diffuse boundary.
    pub fn filled(name: &str, mesh: TriangleMesh, mean_free_path: f32, albedo: f32) -> Self {
        let material = PreviewSurface {
            subsurface: 1.0,
            subsurface_radius: [mean_free_path; 3],
            subsurface_albedo: Some([albedo; 3]),
            ..PreviewSurface::default()
        };
        Self::compiled(name, mesh, Vec::new(), Some(material))
    }

    fn compiled(name: &str, mesh: TriangleMesh, transforms: Vec<Mat4>, material: Option<PreviewSurface>) -> Self {
        let mut flat = FlatScene::default();
        let mut prim = Mesh {
            points: Vec::from_iter(mesh.points.iter().map(|p| p.to_array())).into(),
            face_vertex_counts: vec![3; mesh.triangles.len()].into(),
            face_vertex_indices: Vec::from_iter(mesh.triangles.as_flattened().iter().map(|&i| i as i32)).into(),
            subdivision_scheme: "catmullClark".into(), // smooth normals, as scanned meshes have
            ..Mesh::default()
        };
        if !transforms.is_empty() {
            prim.instancer = "/instancer".into();
            let rows = |m: &Mat4| m.to_cols_array_2d().map(|row| row.map(f64::from));
            let transforms = Vec::from_iter(transforms.iter().map(rows)).into();
            flat.instancers
                .insert("/instancer".into(), Instancer { transforms, visible: true, ..Instancer::default() });
        }
        if let Some(material) = material {
            prim.material = "/material".into();
            flat.materials.insert("/material".into(), Material::UsdPreviewSurface(material));
        }
        flat.meshes.insert("/mesh".into(), prim);
        flat.cameras.insert("/camera".into(), flat::Camera::default());
        flat.settings.camera = "/camera".into();
        let compiled = scene::compile(&flat, &mut Kept::default(), &mut Vec::new());
        let (scene, _) = compiled.unwrap_or_else(|e| panic!("{name}: {e}"));
        Self { name: name.into(), mesh, scene }
    }
}

impl TriangleMesh {
    /// The largest mesh of a flattened scene, triangles only, its bounding box scaled to a diagonal of 1 about 0.
    ///
    /// # Errors
    /// What reading the file says, or that there is no mesh.
    pub fn load(file: &Path) -> Result<Self, String> {
        let flat = flat::file::load(file).map_err(|e| e.to_string())?;
        let largest = flat.meshes.values().max_by_key(|m| m.face_vertex_indices.len());
        let mesh = largest.ok_or_else(|| format!("{}: no mesh", file.display()))?;
        let mut triangles = Vec::new();
        let mut first = 0;
        for &count in mesh.face_vertex_counts.iter() {
            let corner = |k: usize| mesh.face_vertex_indices[first + k] as u32;
            triangles.extend((2..count as usize).map(|k| [corner(0), corner(k - 1), corner(k)]));
            first += count as usize;
        }
        let points: &Array<[f32; 3]> = &mesh.points;
        Ok(Self { points: points.iter().map(|&p| Vec3::from(p)).collect(), triangles }.normalized())
    }

    /// `n` triangles with corners within `size` of uniform centres in a cube of diagonal 1.
    pub fn soup(n: usize, size: f32) -> Self {
        let mut random = Random(1);
        let mut points = Vec::with_capacity(3 * n);
        for _ in 0..n {
            let centre = random.cube();
            points.extend((0..3).map(|_| centre + random.cube() * size));
        }
        Self { points, triangles: (0..n as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }.normalized()
    }

    fn normalized(mut self) -> Self {
        let (low, high) =
            self.points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
        let (centre, scale) = ((low + high) * 0.5, 1.0 / low.distance(high));
        self.points.iter_mut().for_each(|p| *p = (*p - centre) * scale);
        self
    }

    /// One step of Loop 1987 with the weights of Warren 1995; borders are split at their middles.
    pub fn subdivide(&self) -> Self {
        let mut edges: HashMap<(u32, u32), (u32, Vec3, u32)> = HashMap::new();
        let mut around = vec![(Vec3::ZERO, 0); self.points.len()];
        let mut next = self.points.len() as u32;
        for &[a, b, c] in &self.triangles {
            for (i, j, opposite) in [(a, b, c), (b, c, a), (c, a, b)] {
                let edge = edges.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    next += 1;
                    (next - 1, Vec3::ZERO, 0)
                });
                edge.1 += self.points[opposite as usize];
                edge.2 += 1;
                around[i as usize].0 += self.points[j as usize];
                around[i as usize].1 += 1;
            }
        }
        let moved = self.points.iter().zip(&around).map(|(&p, &(sum, n))| {
            let beta = if n == 3 { 3.0 / 16.0 } else { 3.0 / (8.0 * n.max(1) as f32) };
            p * (1.0 - n as f32 * beta) + sum * beta
        });
        let mut points: Vec<Vec3> = moved.collect();
        points.resize(next as usize, Vec3::ZERO);
        for (&(i, j), &(index, opposite, faces)) in &edges {
            let ends = self.points[i as usize] + self.points[j as usize];
            points[index as usize] = if faces == 2 { ends * 0.375 + opposite * 0.125 } else { ends * 0.5 };
        }
        let middle = |i: u32, j: u32| edges[&(i.min(j), i.max(j))].0;
        let split = |&[a, b, c]: &[u32; 3]| {
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
        };
        Self { triangles: self.triangles.iter().flat_map(split).collect(), points }
    }
}

/// Turned and scaled copies in a cube, dense enough to overlap.
pub fn cloud(n: usize) -> Vec<Mat4> {
    let mut random = Random(2);
    let side = (n as f32).cbrt() * 0.4;
    let place = |_| {
        let turn = Quat::from_axis_angle(random.cube().normalize_or(Vec3::X), 6.0 * random.unit());
        let scale = Mat3::from_quat(turn) * (0.5 + random.unit());
        Mat4::from_translation(random.cube() * side) * Mat4::from_mat3(scale)
    };
    (0..n).map(place).collect()
}
