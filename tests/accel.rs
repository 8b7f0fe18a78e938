//! The acceleration structures through their public face: leaks, short segments, degenerate input.

use dermis::math::{Affine, TAU};
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

fn object(points: &[Vec3]) -> Blas {
    let n = points.len() as u32 / 3;
    Blas::build(points, &Vec::from_iter((0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2])))
}

/// None of these may panic or hang; where there is something to hit, it is hit.
#[test]
fn degenerate_meshes() {
    let down = Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z, f32::INFINITY);
    let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let hit = |points: &[Vec3]| object(points).closest(&down).map(|h| (h.t, h.triangle));
    assert_eq!(hit(&[]), None);
    assert!(object(&[]).bounds().is_empty());
    assert_eq!(hit(&triangle), Some((1.0, 0)));
    assert_eq!(hit(&[Vec3::ZERO; 3]), None, "a point");
    assert_eq!(hit(&[Vec3::ZERO, Vec3::ONE, Vec3::ONE]), None, "a segment");
    assert_eq!(hit(&triangle.repeat(100_000)), Some((1.0, 0)), "copies: the first");
    assert_eq!(hit(&[[Vec3::splat(0.2); 3].repeat(100_000), triangle.to_vec()].concat()), Some((1.0, 100_000)));
    assert_eq!(hit(&[[Vec3::NAN; 3], [Vec3::INFINITY; 3], triangle].concat()), Some((1.0, 2)));
    assert_eq!(Blas::build(&triangle, &[[0, 1, 7], [0, 1, 2]]).closest(&down).map(|h| h.triangle), Some(1));
    let huge = triangle.map(|p| (p - 0.25) * 1e18);
    assert_eq!(hit(&huge).map(|h| h.1), Some(0));
    let tiny = triangle.map(|p| p * 1e-7);
    let above = Ray::new(Vec3::new(2e-8, 2e-8, 1e-7), Vec3::NEG_Z, f32::INFINITY);
    assert!(object(&tiny).any(&above));
    assert!(object(&[tiny.as_slice(), &huge].concat()).closest(&above).is_some_and(|h| h.triangle == 0));
    let needle = [Vec3::new(-1e6, 0.2, 0.0), Vec3::new(1e6, 0.2 - 1e-7, 0.0), Vec3::new(1e6, 0.2 + 1e-7, 0.0)];
    assert_eq!(hit(&needle).map(|h| h.1), Some(0));
}

#[test]
fn degenerate_rays_hit_nothing() {
    let blas = object(&[Vec3::ZERO, Vec3::X, Vec3::Y]);
    let o = Vec3::new(0.2, 0.2, 1.0);
    for d in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::X, Vec3::Z] {
        assert_eq!(blas.closest(&Ray::new(o, d, f32::INFINITY)), None, "{d}");
    }
    for t_max in [0.0, -1.0, 1.0, f32::NAN] {
        assert_eq!(blas.closest(&Ray::new(o, Vec3::NEG_Z, t_max)), None, "{t_max}");
    }
    assert_eq!(blas.closest(&Ray::new(Vec3::new(0.2, 0.2, 0.0), Vec3::NEG_Z, 1.0)), None, "t = 0");
    assert_eq!(blas.closest(&Ray::new(Vec3::NAN, Vec3::NEG_Z, 1.0)), None);
}

/// Inputs on which a plain PLOC merges one pair per pass.
#[test]
fn objects_on_which_plain_ploc_crawls() {
    let n = 100_000;
    let unit = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
    let at = |x: f32, size: f32| Aabb { min: Vec3::new(x, 0.0, 0.0), max: Vec3::new(x + size, size, size) };
    let everything = Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };
    let sets: [(&str, Vec<Aabb>); 4] = [
        ("copies", vec![unit; n]),
        ("a row", (0..n).map(|i| at(i as f32, 0.5)).collect()),
        ("nested", (0..n).map(|i| at(-(i as f32), 2.0 * i as f32)).collect()),
        (
            "a row and infinite ones",
            (0..n).map(|i| if i % 1000 == 0 { everything } else { at(i as f32, 1e-3) }).collect(),
        ),
    ];
    for (name, boxes) in sets {
        let tlas = Tlas::build(&boxes);
        let o = Vec3::new(500.25, 0.25, -1.0);
        let mut ray = Ray::new(o, Vec3::Z, f32::INFINITY);
        let (mut seen, mut seen_any) = (Vec::new(), Vec::new());
        tlas.traverse_any(&ray, |i| {
            seen_any.push(i);
            false
        });
        tlas.traverse(&mut ray, |i, _| {
            seen.push(i);
            false
        });
        seen.sort_unstable();
        seen_any.sort_unstable();
        assert_eq!(seen, seen_any, "{name}");
        let over = |b: &Aabb| b.min.x <= o.x && o.x <= b.max.x && b.max.y >= o.y && b.max.z >= -1.0;
        let expected: Vec<u32> = (0..n as u32).filter(|&i| over(&boxes[i as usize])).collect();
        assert_eq!(seen, expected, "{name}");
    }
}

fn place(random: &mut Random) -> Affine {
    let linear = Mat3::from_cols(random.cube(), random.cube(), random.cube()) + Mat3::IDENTITY * 0.1;
    Affine { linear, inverse: linear.inverse(), translation: random.cube() * 4.0 }
}

/// The closest hit among placed copies: (t, instance).
fn closest(tlas: &Tlas, blas: &Blas, places: &[Affine], ray: &Ray) -> Option<(f32, u32)> {
    let mut best = None;
    tlas.traverse(&mut ray.clone(), |i, ray| {
        if let Some(hit) = local(blas, &places[i as usize], ray) {
            ray.t_max = hit;
            best = Some((hit, i));
        }
        false
    });
    best
}

fn local(blas: &Blas, place: &Affine, ray: &Ray) -> Option<f32> {
    let ray = Ray::new(place.inverse * (ray.o - place.translation), place.inverse * ray.d, ray.t_max);
    blas.closest(&ray).map(|hit| hit.t)
}

#[test]
fn overlapping_instances_agree_with_brute_force() {
    let (blas, mut random) = (Mesh::torus(20).blas(), Random(5));
    let places: Vec<Affine> = (0..200).map(|_| place(&mut random)).collect();
    let tlas = Tlas::build(&places.iter().map(|p| blas.bounds().transform(p)).collect::<Vec<_>>());
    let mut hits = 0;
    for _ in 0..2000 {
        let ray = Ray::new(random.cube() * 6.0, random.direction(), [f32::INFINITY, 2.0][random.below(2)]);
        let all = (0..places.len()).filter_map(|i| Some((local(&blas, &places[i], &ray)?, i as u32)));
        let expected = all.min_by(|a, b| a.0.total_cmp(&b.0));
        assert_eq!(closest(&tlas, &blas, &places, &ray), expected, "{ray:?}");
        let mut any = false;
        tlas.traverse_any(&ray, |i| {
            any = local(&blas, &places[i as usize], &ray).is_some();
            any
        });
        assert_eq!(any, expected.is_some(), "{ray:?}");
        hits += usize::from(expected.is_some());
    }
    assert!(hits > 500);
}

#[test]
fn traversal_stops_when_told() {
    let boxes = [Aabb { min: Vec3::ZERO, max: Vec3::ONE }; 100];
    let mut visits = 0;
    Tlas::build(&boxes).traverse(&mut Ray::new(Vec3::splat(0.5), Vec3::X, 1.0), |_, _| {
        visits += 1;
        visits == 3
    });
    assert_eq!(visits, 3);
    Tlas::build(&boxes).traverse_any(&Ray::new(Vec3::splat(0.5), Vec3::X, 1.0), |_| {
        visits += 1;
        visits == 5
    });
    assert_eq!(visits, 5);
}

#[test]
fn transformed_boxes_hold_transformed_points() {
    let mut random = Random(6);
    for _ in 0..20_000 {
        let m = place(&mut random);
        let corners = [random.cube() * 10.0, random.cube() * 10.0];
        let b = Aabb::from_points(corners);
        let image = b.transform(&m);
        let p = b.min + b.extent() * Vec3::new(random.unit(), random.unit(), random.unit());
        for p in [p.clamp(b.min, b.max), b.min, b.max, corners[0]] {
            assert!(image.contains(m.point(p)), "{b:?} {m:?} {p}");
        }
        let corner_images = Aabb::from_points(
            (0..8).map(|i| m.point(Vec3::select(glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), b.min, b.max))),
        );
        assert!((image.extent() - corner_images.extent()).max_element() < 1e-3, "not tight");
    }
    assert!(Aabb::EMPTY.transform(&place(&mut random)).is_empty());
    let all = Aabb { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY }.transform(&place(&mut random));
    assert!(all.contains(Vec3::splat(1e30)));
}
