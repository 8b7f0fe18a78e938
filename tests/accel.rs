//! The acceleration structures through their public face: leaks, short segments, degenerate input.

use dermis::math::TAU;
use dermis::scene::accel::{Aabb, Blas, Ray, Tlas};
use glam::{Mat3, Vec3};

/// SplitMix64 (Steele et al. 2014).
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    fn cube(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }

    fn direction(&mut self) -> Vec3 {
        let (z, phi) = (2.0 * self.unit() - 1.0, TAU * self.unit());
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    }
}

#[derive(Clone, Default)]
struct Mesh {
    points: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Object to world.
    place: Mat3,
    offset: Vec3,
    /// Radius of the circle around z in object space that lies inside; zero: the origin.
    ring: f32,
}

impl Mesh {
    /// `n` x `n` quads on a closed surface given by corners in a grid; `wrap` joins the grid's borders.
    fn torus(n: usize) -> Self {
        let point = |i: usize, j: usize| {
            let (a, b) = (TAU * i as f32 / n as f32, TAU * j as f32 / n as f32);
            let r = 1.0 + 0.4 * b.cos();
            Vec3::new(r * a.cos(), r * a.sin(), 0.4 * b.sin())
        };
        let points = (0..n * n).map(|k| point(k / n, k % n)).collect();
        let at = |i: usize, j: usize| ((i % n) * n + j % n) as u32;
        let quad = |k: usize| {
            let (i, j) = (k / n, k % n);
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        };
        Self { points, triangles: (0..n * n).flat_map(quad).collect(), ring: 1.0, ..Self::default() }
    }

    /// A cube of six n x n faces with welded corners, radially projected if `round`.
    fn cube(n: usize, round: bool) -> Self {
        let mut index = std::collections::BTreeMap::new();
        let mut points = Vec::new();
        let mut corner = |p: [usize; 3]| {
            *index.entry(p).or_insert_with(|| {
                let p = Vec3::from_array(p.map(|x| 2.0 * x as f32 / n as f32 - 1.0));
                points.push(if round { p.normalize() } else { p });
                points.len() as u32 - 1
            })
        };
        let mut triangles = Vec::new();
        for (axis, side, i, j) in (0..6 * n * n).map(|k| (k / (2 * n * n), k / (n * n) % 2, k / n % n, k % n)) {
            let mut at = |i: usize, j: usize| {
                let mut p = [side * n; 3];
                (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (i, j);
                corner(p)
            };
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
        Self { points, triangles, ..Self::default() }
    }

    /// Of a mesh not yet placed.
    fn placed(&self, place: Mat3, offset: Vec3) -> Self {
        let points = self.points.iter().map(|&p| place * p + offset).collect();
        Self { points, place, offset, ..self.clone() }
    }

    /// A point inside, well away from the surface.
    fn inside(&self, random: &mut Random) -> Vec3 {
        let circle = Mat3::from_rotation_z(TAU * random.unit()) * Vec3::X * self.ring;
        self.place * (circle + random.cube() * 0.15) + self.offset
    }

    fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.points[i as usize])
    }

    fn blas(&self) -> Blas {
        Blas::build(&self.points, &self.triangles)
    }
}

/// A target on the surface: a vertex, a point of an edge, or of a face.
fn target(mesh: &Mesh, random: &mut Random) -> Vec3 {
    let [a, b, c] = mesh.corners(random.below(mesh.triangles.len()));
    match random.below(3) {
        0 => a,
        1 => a.lerp(b, random.unit()),
        _ => a.lerp(b, random.unit()).lerp(c, random.unit()),
    }
}

/// Rays from inside a closed mesh that miss everything.
fn leaks(mesh: &Mesh, rays: usize, seed: u64) -> usize {
    let (blas, mut random) = (mesh.blas(), Random(seed));
    let misses = |_| {
        let o = mesh.inside(&mut random);
        let d = if random.below(4) == 0 { random.direction() } else { target(mesh, &mut random) - o };
        let ray = Ray::new(o, d, f32::INFINITY);
        usize::from(blas.closest(&ray).is_none()) + usize::from(!blas.any(&ray))
    };
    (0..rays).map(misses).sum()
}

fn closed_meshes() -> Vec<(&'static str, Mesh)> {
    vec![
        ("torus", Mesh::torus(60)),
        ("sphere", Mesh::cube(32, true)),
        ("cube", Mesh::cube(16, false)),
        ("coarse cube", Mesh::cube(1, false)),
    ]
}

#[test]
fn closed_meshes_do_not_leak() {
    let shapes = [
        ("plain", Mat3::IDENTITY),
        ("small", Mat3::from_diagonal(Vec3::splat(1e-4))),
        ("large", Mat3::from_diagonal(Vec3::splat(1e5))),
        ("stretched", Mat3::from_diagonal(Vec3::new(1e3, 1.0, 1.0))),
        (
            "needles",
            Mat3::from_rotation_x(0.7) * Mat3::from_rotation_y(0.4) * Mat3::from_diagonal(Vec3::new(1.0, 1e3, 1.0)),
        ),
        ("flat", Mat3::from_rotation_y(1.0) * Mat3::from_diagonal(Vec3::new(1.0, 1.0, 1e-3))),
    ];
    for (name, mesh) in closed_meshes() {
        for (shape, m) in shapes {
            assert_eq!(leaks(&mesh.placed(m, Vec3::ZERO), 100_000, 1), 0, "{name} {shape}");
        }
        let far = mesh.placed(Mat3::IDENTITY, Vec3::new(1e3, -1e3, 1e3));
        assert_eq!(leaks(&far, 100_000, 2), 0, "{name} far from the origin");
    }
}

/// Segments that start a millionth of the scene before the surface and end as far behind it, also
/// right beside shared edges and vertices.
#[test]
fn short_segments_find_their_hit() {
    for (name, mesh) in closed_meshes() {
        let (blas, mut random) = (mesh.blas(), Random(3));
        for _ in 0..100_000 {
            let p = target(&mesh, &mut random);
            let core = Vec3::new(p.x, p.y, 0.0).normalize_or_zero() * mesh.ring;
            let d = (p - core).normalize();
            let ray = Ray::new(p - d * 2e-6, d, 4e-6);
            assert!(blas.any(&ray) && blas.closest(&ray).is_some(), "{name}: {ray:?} leaks");
        }
    }
}
