//! What the public face cannot show: agreement with brute force and between instruction sets, stacks, trees.

use super::blas::{Both, crossings};
use super::lanes::{Isa, Portable};
use super::triangle::{Leaf, Shear};
use super::*;
use crate::math::Affine;
use crate::sampling::sampler::Sampler;
use glam::{DVec3, Mat3};

fn cube(random: &mut Sampler) -> Vec3 {
    Vec3::new(random.random(), random.random(), random.random()) * 2.0 - 1.0
}

/// `n` triangles of about `size` in the cube [-1, 1]^3; every fifth repeats its predecessor.
fn soup(n: usize, size: f32, random: &mut Sampler) -> Vec<[Vec3; 3]> {
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    for i in 0..n {
        let centre = cube(random);
        let new = std::array::from_fn(|_| centre + cube(random) * size);
        triangles.push(if i % 5 == 4 { triangles[i - 1] } else { new });
    }
    triangles
}

/// A height field over n x n unit cells: shared edges, and axis-aligned boxes that touch.
fn terrain(n: usize, random: &mut Sampler) -> Vec<[Vec3; 3]> {
    let height: Vec<f32> = (0..(n + 1) * (n + 1)).map(|_| (4.0_f32 * random.random()).floor() * 0.25).collect();
    let at = |i: usize, j: usize| Vec3::new(i as f32, j as f32, height[i * (n + 1) + j]) * (2.0 / n as f32) - 1.0;
    let quad = |k: usize| {
        let (i, j) = (k / n, k % n);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    (0..n * n).flat_map(quad).collect()
}

fn blas(triangles: &[[Vec3; 3]]) -> Blas {
    let indices: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Blas::build(triangles.as_flattened(), &indices)
}

/// The same triangle test without a tree.
fn brute(triangles: &[[Vec3; 3]], ray: &Ray, skip: u32) -> Option<TriHit> {
    let shear = Shear::new(ray);
    let mut best: Option<TriHit> = None;
    for (id, &p) in triangles.iter().enumerate().filter(|&(id, _)| id as u32 != skip) {
        let mut leaf = Leaf::EMPTY;
        leaf.set(id % 8, id as u32, p);
        crossings::<Portable>(&leaf, &shear, &Both, |triangle, c| {
            if c.t > 0.0 && c.t < best.map_or(ray.t_max, |b| b.t) {
                best = Some(TriHit { t: c.t, triangle, u: c.u, v: c.v });
            }
            false
        });
    }
    best
}

/// Rays of all lengths, some axis-aligned, some from and to vertices.
fn rays(triangles: &[[Vec3; 3]], n: usize, random: &mut Sampler) -> Vec<Ray> {
    let pick = |random: &mut Sampler, n: usize| ((random.random() * n as f32) as usize).min(n - 1);
    let one = |_| {
        let o = cube(random) * 1.5;
        let vertex = triangles[pick(random, triangles.len())][pick(random, 3)];
        let (o, d) = match pick(random, 5) {
            0 => (o, vertex - o),
            1 => (vertex, cube(random)),
            2 => (o, Vec3::AXES[pick(random, 3)] * [1.0, -1.0][pick(random, 2)]),
            3 => (vertex - Vec3::Z * 0.3, Vec3::new(-0.0, 0.0, 1.0)),
            _ => (o, cube(random)),
        };
        Ray::new(o, d, [f32::INFINITY, 1.0, 0.1, 1e-3][pick(random, 4)])
    };
    (0..n).map(one).collect()
}

fn scenes() -> Vec<Vec<[Vec3; 3]>> {
    let random = &mut Sampler::new(1, 2, 3);
    let mut scenes: Vec<_> = [1, 2, 7, 8, 9, 17, 64, 300].iter().map(|&n| soup(n, 0.5, random)).collect();
    scenes.extend([soup(1000, 0.05, random), soup(300, 2.0, random), terrain(16, random)]);
    scenes
}

#[test]
fn tree_agrees_with_brute_force() {
    let random = &mut Sampler::new(4, 5, 6);
    let mut hits = 0;
    for triangles in scenes() {
        let blas = blas(&triangles);
        for ray in rays(&triangles, 1000, random) {
            let expected = brute(&triangles, &ray, u32::MAX);
            assert_eq!(blas.closest(&ray), expected, "{} triangles, {ray:?}", triangles.len());
            assert_eq!(blas.any(&ray), expected.is_some());
            let Some(hit) = expected else { continue };
            hits += 1;
            let next = brute(&triangles, &ray, hit.triangle);
            assert_eq!(blas.closest_skip(&ray, hit.triangle), next);
            assert_eq!(blas.any_skip(&ray, hit.triangle), next.is_some());
            assert!(!blas.any(&Ray { t_max: hit.t, ..ray }), "t_max is exclusive");
        }
    }
    assert!(hits > 2000);
}

/// t, u, v against Moeller and Trumbore 1997 in f64, with rays that stay clear of edges.
#[test]
fn crossing_agrees_with_moeller_trumbore() {
    let random = &mut Sampler::new(7, 8, 9);
    for _ in 0..20_000 {
        let p = [cube(random), cube(random), cube(random)];
        let [o, d] = [cube(random) * 3.0, cube(random)];
        let [a, b, c] = p.map(|p| p.as_dvec3());
        let (od, dd) = (o.as_dvec3(), d.as_dvec3());
        let (ab, ac, ao) = (b - a, c - a, od - a);
        let det = dd.cross(ac).dot(ab);
        let [t, u, v] = [ao.cross(ab).dot(ac), dd.cross(ac).dot(ao), ao.cross(ab).dot(dd)].map(|x| x / det);
        let margin = u.min(v).min(1.0 - u - v).min(t);
        let hit = blas(&[p]).closest(&Ray::new(o, d, f32::INFINITY));
        if det.abs() < 1e-2 || margin.abs() < 1e-3 {
            continue;
        }
        assert_eq!(hit.is_some(), margin > 0.0);
        if let Some(hit) = hit {
            assert_eq!(hit.triangle, 0);
            let error = (f64::from(hit.u) - u).abs().max((f64::from(hit.v) - v).abs());
            assert!(error < 1e-4 && (f64::from(hit.t) - t).abs() < 1e-4 * t.max(1.0), "{hit:?} is not {t} {u} {v}");
        }
    }
}

/// Says nothing of those that the machine does not have.
#[test]
fn instruction_sets_agree_bit_for_bit() {
    let random = &mut Sampler::new(10, 11, 12);
    for triangles in scenes() {
        let mut portable = blas(&triangles);
        portable.tree.isa = Isa::Portable;
        let rays = rays(&triangles, 5000, random);
        for isa in Isa::ALL.into_iter().filter(Isa::is_here) {
            let mut blas = portable.clone();
            blas.tree.isa = isa;
            for ray in &rays {
                assert_eq!(blas.closest(ray), portable.closest(ray), "{isa:?} {ray:?}");
                assert_eq!(blas.any(ray), portable.any(ray), "{isa:?} {ray:?}");
            }
        }
    }
}

/// Boxes that grow geometrically around one corner make a chain. The walk indexes a slice of exactly
/// `tree.stack` entries there and would panic if the bound did not hold.
#[test]
fn deep_trees_fall_back_to_the_heap() {
    let growth = |i: i32| 1.01_f32.powi(i);
    let boxes: Vec<Aabb> =
        (0..2000).map(|i| Aabb { min: Vec3::splat(-growth(i)) * 1e-4, max: Vec3::splat(growth(i)) }).collect();
    let mut tlas = Tlas::build(&boxes);
    assert!(tlas.tree.stack > 128, "the chain needs only {}", tlas.tree.stack);
    for isa in Isa::ALL.into_iter().filter(Isa::is_here) {
        tlas.tree.isa = isa;
        let mut seen = vec![0; boxes.len()];
        tlas.traverse(&mut Ray::new(Vec3::ZERO, Vec3::ONE, f32::INFINITY), |i, _| {
            seen[i as usize] += 1;
            false
        });
        assert!(seen.iter().all(|&n| n == 1));
    }
}

#[test]
fn builds_are_equal() {
    let triangles = soup(3000, 0.1, &mut Sampler::new(1, 1, 1));
    let [a, b] = [blas(&triangles), blas(&triangles)];
    assert_eq!(format!("{:?}", a.tree), format!("{:?}", b.tree));
    assert!(a.leaves.iter().map(|l| l.id).eq(b.leaves.iter().map(|l| l.id)));
}

#[test]
fn a_tree_stays_below_a_hundred_bytes_per_triangle() {
    let blas = blas(&terrain(100, &mut Sampler::new(1, 1, 1)));
    assert!(blas.memory() < 100 * 20_000, "{} bytes", blas.memory());
}

/// Points near, on and far from the triangles.
fn points(triangles: &[[Vec3; 3]], n: usize, random: &mut Sampler) -> Vec<Vec3> {
    let one = |i| {
        let [a, b, c] = triangles[((random.random() * triangles.len() as f32) as usize).min(triangles.len() - 1)];
        match i % 5 {
            0 => a,
            1 => (b + c) * 0.5,
            2 => cube(random) * 100.0,
            3 => (a + b + c) / 3.0 + cube(random) * 1e-3,
            _ => cube(random) * 1.5,
        }
    };
    (0..n).map(one).collect()
}

/// Squared distance to a triangle after `metric`, by Voronoi regions (Ericson 2005, section 5.1.5) in f64, another
/// formulation than the tree's. A triangle without area is its longest edge.
fn distance_squared(metric: &Mat3, triangle: &[Vec3; 3], p: Vec3) -> f64 {
    let [a, b, c] = triangle.map(|q| metric.as_dmat3() * (q.as_dvec3() - p.as_dvec3()));
    let segment = |a: DVec3, b: DVec3| {
        let t = (-a.dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        if a == b { a.length_squared() } else { a.lerp(b, t).length_squared() }
    };
    let n = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| n.dot((b - a).cross(-a)) >= 0.0);
    if n.length_squared() > 1e-28 && inside {
        return n.dot(a).powi(2) / n.length_squared();
    }
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}

#[test]
fn closest_point_agrees_with_brute_force() {
    let random = &mut Sampler::new(13, 14, 15);
    let mut scenes = scenes();
    // Points, segments and slivers among the triangles.
    let mut thin = soup(200, 0.3, random);
    thin.iter_mut().step_by(3).for_each(|t| t[2] = t[1]);
    thin.iter_mut().step_by(7).for_each(|t| *t = [t[0]; 3]);
    thin.iter_mut().step_by(5).for_each(|t| t[2] = (t[0] + t[1]) * 0.5 + cube(random) * 1e-6);
    scenes.push(thin);
    let stretched =
        Mat3::from_rotation_x(0.7) * Mat3::from_diagonal(Vec3::new(3.0, 0.2, 1.0)) * Mat3::from_rotation_z(1.0);
    for triangles in scenes {
        let blas = blas(&triangles);
        for p in points(&triangles, 300, random) {
            for (metric, least) in [(Mat3::IDENTITY, 1.0), (stretched, 0.2)] {
                let distances: Vec<f64> = triangles.iter().map(|t| distance_squared(&metric, t, p)).collect();
                let expected = distances.iter().copied().fold(f64::INFINITY, f64::min);
                let got = blas.closest_point_under(&metric, least, p).expect("triangles are finite");
                // Slivers 1e-6 thin cost both formulations some digits, far below an f32's of the positions.
                let tolerance = |distance: f64| 1e-9 + 1e-6 * distance;
                let error = (f64::from(got.distance_squared).sqrt() - expected.sqrt()).abs();
                assert!(error < tolerance(expected.sqrt()), "{got:?} from {p}, expected {expected}");
                // It is the point it says, and of the triangle it says.
                let [a, b, c] = triangles[got.triangle as usize];
                assert!((a + got.u * (b - a) + got.v * (c - a)).distance(got.point) < 1e-6);
                let of_triangle = distances[got.triangle as usize].sqrt();
                assert!(of_triangle <= expected.sqrt() + tolerance(expected.sqrt()));
                let offset = (metric * (got.point - p)).length();
                assert!((offset - got.distance_squared.sqrt()).abs() < 1e-6 * (1.0 + p.length()), "{got:?} from {p}");
                if least == 1.0 {
                    assert_eq!(blas.closest_point(p), Some(got));
                }
            }
        }
    }
}

#[test]
fn closest_point_takes_the_lowest_index_and_skips_what_is_not_finite() {
    let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let bad = [[Vec3::NAN; 3], [Vec3::ZERO, Vec3::X, Vec3::splat(f32::INFINITY)]];
    let mut triangles = bad.to_vec();
    triangles.extend([triangle; 20]);
    let got = blas(&triangles).closest_point(Vec3::new(0.25, 0.25, 2.0)).expect("a triangle");
    assert_eq!((got.triangle, got.point, got.distance_squared), (2, Vec3::new(0.25, 0.25, 0.0), 4.0));
    assert_eq!(blas(&triangles).closest_point(Vec3::NAN), None);
    assert_eq!(blas(&bad).closest_point(Vec3::ZERO), None);
    assert_eq!(blas(&[]).closest_point(Vec3::ZERO), None);
}

/// Where points move, the hit is that of the mesh as it is at that time, and no edge leaks: 400 rays at each of five times.
#[test]
fn moving_triangles_are_those_of_their_time() {
    let mut random = Sampler::new(11, 0, 0);
    let mut point = || cube(&mut random);
    let (a, mut b): (Vec<Vec3>, Vec<Vec3>) = (0..300).map(|_| (point(), point())).unzip();
    b[..30].copy_from_slice(&a[..30]);
    let triangles: Vec<[u32; 3]> = (0..298).map(|i| [i, i + 1, i + 2]).collect();
    let moving = MovingBlas::build([&a, &b], &triangles);
    for f in [0.0, 0.2, 0.5, 0.77, 0.999] {
        let points: Vec<Vec3> = a.iter().zip(&b).map(|(a, b)| between(*a, *b, f)).collect();
        let still = Blas::build(&points, &triangles);
        let mut hits = 0;
        for _ in 0..400 {
            let (o, to) = (point() * 2.0, point());
            let ray = Ray::new(o, to - o, f32::INFINITY);
            let expected = still.closest_skip(&ray, 7);
            assert_eq!(moving.closest_skip(&ray, 7, f), expected, "{ray:?} at {f}");
            assert_eq!(moving.any_skip(&ray, 7, f), expected.is_some());
            hits += usize::from(expected.is_some());
            let p = point();
            let (near, own) = (still.closest_point(p), moving.closest_point_under(&Mat3::IDENTITY, 1.0, p, f));
            assert_eq!(near.map(|at| at.distance_squared), own.map(|at| at.distance_squared));
        }
        assert!(hits > 100);
    }
}

/// More than are clustered together, some of them in one place, where no plane parts them.
#[test]
fn trees_of_many_chunks_agree_with_brute_force() {
    let random = &mut Sampler::new(3, 1, 4);
    let mut triangles = soup(1_000_000, 0.005, random);
    triangles.extend(vec![triangles[7]; 70_000]);
    triangles.extend(vec![[Vec3::NAN; 3]; 10_000]);
    let many = blas(&triangles);
    for ray in rays(&triangles, 20, random) {
        let hit = many.closest(&ray);
        assert_eq!(hit, brute(&triangles, &ray, u32::MAX), "{ray:?}");
        assert_eq!(many.any(&ray), hit.is_some(), "{ray:?}");
    }
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = alone.install(|| blas(&triangles));
    assert_eq!(format!("{:?}", many.tree), format!("{:?}", again.tree), "another tree by one thread");
}

/// Turned one by one, the boxes of the tree are closer than that of the whole, and still hold every point.
#[test]
fn turned_bounds_hold_all_points() {
    let random = &mut Sampler::new(9, 0, 0);
    let turn = Mat3::from_rotation_x(0.6) * Mat3::from_rotation_z(0.7) * 3.0;
    let m = Affine { linear: turn, inverse: turn.inverse(), translation: Vec3::new(1e3, -20.0, 0.3) };
    for triangles in scenes().into_iter().chain([soup(4000, 0.02, random)]) {
        let blas = blas(&triangles);
        let whole = blas.bounds().transform(&m);
        for levels in [1, 2] {
            let bounds = blas.bounds_under(&m, levels);
            assert!(bounds.half_area() <= whole.half_area() * (1.0 + 1e-5));
            let finite = triangles.as_flattened().iter().filter(|p| p.is_finite());
            finite.for_each(|&p| assert!(bounds.contains(m.point(p)), "{p}"));
        }
    }
    assert!(Blas::build(&[], &[]).bounds_under(&m, 2).is_empty());
}
