//! The rays of a row, the same for everyone: made by dermis, in the order a tile of a picture makes them.

use crate::subject::{Random, Subject};
use dermis::math::Frame;
use dermis::sampling::{cosine_hemisphere, uniform_sphere};
use dermis::scene::accel::{Aabb, Ray};
use glam::{Vec2, Vec3};

/// Side of the picture, and of its tiles, in pixels.
const SIDE: usize = 512;
const TILE: usize = 16;

/// Mean free paths to the diagonal of a mesh: skin on a head, about.
const MEAN_FREE_PATHS: f32 = 400.0;
/// Segments of a walk, at most; without a surface around it, it would go on for ever.
const SEGMENTS: usize = 32;

pub struct RaySets {
    pub primary: Vec<Ray>,
    /// From the hits of those, by the cosine.
    pub diffuse: Vec<Ray>,
    /// From there inward: exponential segments in random directions, up to the surface.
    pub walk: Vec<Ray>,
    /// Diagonal of all there is.
    pub size: f32,
}

impl RaySets {
    pub fn new(subject: &Subject, diagonal: f32) -> Self {
        let random = &mut Random(3);
        let primary = primary(subject, random);
        let (mut diffuse, mut walk) = (Vec::new(), Vec::new());
        for ray in &primary {
            let Some((p, n)) = surface(subject, ray) else { continue };
            let frame = Frame::from_normal(n);
            let up = frame.to_world(cosine_hemisphere(Vec2::new(random.unit(), random.unit())));
            let offset = n * diagonal * 1e-5;
            diffuse.push(Ray::new(p + offset, up, f32::INFINITY));
            let down = -frame.to_world(cosine_hemisphere(Vec2::new(random.unit(), random.unit())));
            if walk.len() < primary.len() {
                segments(subject, p - offset, down, diagonal / MEAN_FREE_PATHS, random, &mut walk);
            }
        }
        Self { primary, diffuse, walk, size: bounds(subject).extent().length() }
    }
}

/// A perspective camera that sees the whole of it, jittered, tile by tile.
fn primary(subject: &Subject, random: &mut Random) -> Vec<Ray> {
    let bounds = bounds(subject);
    let (centre, radius) = (bounds.centre(), bounds.extent().length() * 0.5);
    let to_eye = Vec3::new(0.5, 0.4, 0.77).normalize();
    let (right, eye) = (Vec3::Y.cross(to_eye).normalize(), centre + to_eye * radius * 3.0);
    let up = to_eye.cross(right);
    let mut rays = Vec::with_capacity(SIDE * SIDE);
    for tile in 0..(SIDE / TILE).pow(2) {
        for pixel in 0..TILE * TILE {
            let x = tile % (SIDE / TILE) * TILE + pixel % TILE;
            let y = tile / (SIDE / TILE) * TILE + pixel / TILE;
            let film =
                (Vec2::new(x as f32 + random.unit(), y as f32 + random.unit()) / SIDE as f32 * 2.0 - 1.0) * radius;
            let target = centre + (right * film.x + up * film.y) * 0.9;
            rays.push(Ray::new(eye, (target - eye).normalize(), f32::INFINITY));
        }
    }
    rays
}

fn bounds(subject: &Subject) -> Aabb {
    let places = subject.scene.instances.iter();
    places.fold(Aabb::EMPTY, |all, i| all.union(&i.geometry.bounds().transform(&i.to_render)))
}

/// The point that a ray meets, and the normal there on the ray's side.
fn surface(subject: &Subject, ray: &Ray) -> Option<(Vec3, Vec3)> {
    let hit = subject.scene.at(0.0).closest(ray.o, ray.d, ray.t_max, None)?;
    let instance = &subject.scene.instances[hit.instance as usize];
    let [a, b, c] = instance.geometry.corners(hit.triangle, 0.0);
    let n = instance.to_render.normal((b - a).cross(c - a)).normalize_or(-ray.d);
    let p = instance.to_render.point(a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v);
    Some((p, if n.dot(ray.d) < 0.0 { n } else { -n }))
}

fn segments(subject: &Subject, mut p: Vec3, mut d: Vec3, mean: f32, random: &mut Random, walk: &mut Vec<Ray>) {
    for _ in 0..SEGMENTS {
        let ray = Ray::new(p, d, -(1.0 - random.unit()).ln() * mean);
        walk.push(ray);
        if subject.scene.at(0.0).occluded(ray.o, ray.d, ray.t_max, None) {
            return;
        }
        p = ray.at(ray.t_max);
        d = uniform_sphere(Vec2::new(random.unit(), random.unit()));
    }
}
