//! To a light of a single direction through a boundary that bends: the point of a smooth interface where the way from a
//! point inside refracts exactly into that direction.
//!
//! Newton's method on the half vector (Jakob and Marschner 2012, "Manifold Exploration"; Hanika et al. 2015, "Manifold
//! Next Event Estimation"): with w from the point inside to the boundary and v from there to the light, both unit,
//! Snell's law says that g = eta w - v is parallel to the normal. Every iterate is brought back to the boundary by a ray
//! from the point inside, so that what is found can be seen from there.

use crate::bsdf::{Side, fresnel};
use crate::interaction::Interaction;
use crate::math::{Frame, Rgb, TAU};
use crate::scene::{Moment, SurfaceHit};
use glam::Vec3;

/// Rays that one search may cast after its first. Those that succeed take three to five.
const MAX_CASTS: u32 = 12;

/// Tangent of the angle between the straight way to the light and other starts.
const BESIDE: f32 = 0.2;

/// Steps between rays, in the plane of the last triangle.
const PLANE_STEPS: u32 = 4;

/// A step of Newton's method this short, in units of the way inside, ends it: convergence is quadratic, so what is left
/// is at the rounding of f32.
const CONVERGED: f32 = 2e-5;

/// Solutions closer than this, in units of the way inside, are one: far above the errors of the search, far below what
/// tells solutions apart except where two of them meet, a set of measure zero.
const SAME: f32 = 2e-3;

/// Cosine inside below which interpolated normals are bent (`interaction::shading_normal`), and their derivative is not
/// that of the mesh.
const GRAZING: f32 = 0.0101;

/// The smooth interface around an object, seen from within.
#[derive(Clone, Copy)]
pub(super) struct Window<'a> {
    scene: Moment<'a>,
    instance: u32,
    /// Index of the inside / index of the outside.
    eta: f32,
    tint: Rgb,
    /// Bound of the absolute rounding error of positions.
    error: f32,
}

/// A boundary point on the way from x to the light, and its neighbourhood: a plane whose normal varies linearly.
#[derive(Clone, Copy)]
pub(super) struct Crossing {
    pub hit: SurfaceHit,
    /// Walk space.
    pub p: Vec3,
    /// Unit, from x to p, and its length.
    pub d: Vec3,
    pub t: f32,
    /// Unit, to the light.
    pub v: Vec3,
    /// Of the triangle; its normal, outward, is not unit.
    edges: [Vec3; 2],
    ng: Vec3,
    /// Shading normal, outward, not unit, and its derivatives along the edges.
    normal: Vec3,
    slopes: [Vec3; 2],
    /// Unit shading normal.
    pub frame: Frame,
}

impl Crossing {
    /// The point `s` and `t` edges away, as if the triangle went on; `None` where it cannot be seen from x.
    fn moved(&self, x: Vec3, s: f32, t: f32) -> Option<Self> {
        let p = self.p + s * self.edges[0] + t * self.edges[1];
        let normal = self.normal + s * self.slopes[0] + t * self.slopes[1];
        let way = p - x;
        let (d, frame) = (way.try_normalize()?, Frame::from_normal(normal.try_normalize()?));
        Some(Self { p, d, t: way.length(), normal, frame, ..*self })
    }
}

impl<'a> Window<'a> {
    /// `None` unless the boundary that `surface` makes of `instance` is a smooth dielectric.
    pub fn new(scene: Moment<'a>, instance: u32, surface: u32, error: f32) -> Option<Self> {
        let (eta, tint) = scene.surfaces[surface as usize].surface.smooth_interface()?;
        Some(Self { scene, instance, eta, tint, error })
    }

    /// Where the search begins: the boundary on the straight way from `x`, walk space.
    pub fn start(&self, x: Vec3, v: Vec3) -> Option<Crossing> {
        self.cast(x, v, v)
    }

    /// The same, if it is within `reach`.
    pub fn start_within(&self, x: Vec3, v: Vec3, reach: f32) -> Option<Crossing> {
        self.cast_within(x, v, v, reach)
    }

    /// The boundary in the direction `corner` of three that lie about that of `straight`: on bumps another start may find
    /// another way.
    pub fn start_beside(&self, x: Vec3, straight: &Crossing, corner: usize) -> Option<Crossing> {
        let (frame, (sin, cos)) = (Frame::from_normal(straight.d), (TAU * corner as f32 / 3.0).sin_cos());
        self.cast(x, (frame.n + BESIDE * (cos * frame.t + sin * frame.b)).normalize(), straight.v)
    }

    /// The point that refracts; `None` where the search fails.
    pub fn solve(&self, x: Vec3, start: Crossing) -> Option<Crossing> {
        let (mut at, mut scale) = (start, 1.0);
        let mut step = self.step(&at)?;
        let mut residual = self.residual(&at);
        for _ in 0..MAX_CASTS {
            if self.is_end(&at, step) {
                return self.transmits(&at).then_some(at);
            }
            let towards = self.ahead(x, &at, step, scale)?;
            let next = self.cast(x, (towards - x).try_normalize()?, at.v)?;
            let remaining = self.residual(&next);
            if remaining < residual {
                (at, residual, scale) = (next, remaining, 1.0);
                step = self.step(&at)?;
            } else {
                scale *= 0.5;
            }
        }
        None
    }

    fn is_end(&self, at: &Crossing, step: (f32, f32)) -> bool {
        (step.0 * at.edges[0] + step.1 * at.edges[1]).length() <= (CONVERGED * at.t).max(self.error)
    }

    /// Where to look next: the solution in the neighbourhood of `at`, or, where that did not help before (`scale` below 1),
    /// a part of the way of the first step.
    fn ahead(&self, x: Vec3, at: &Crossing, step: (f32, f32), scale: f32) -> Option<Vec3> {
        let mut near = self.moved_by(x, at, step, scale)?;
        if scale < 1.0 {
            return Some(near.p);
        }
        for _ in 0..PLANE_STEPS {
            let Some(step) = self.step(&near).filter(|step| !self.is_end(&near, *step)) else { break };
            let Some(next) = self.moved_by(x, &near, step, 1.0) else { break };
            if self.residual(&next) >= self.residual(&near) {
                break;
            }
            near = next;
        }
        Some(near.p)
    }

    /// A step longer than the way inside says nothing of where it leads: it is cut to that.
    fn moved_by(&self, x: Vec3, at: &Crossing, (s, t): (f32, f32), scale: f32) -> Option<Crossing> {
        let length = (s * at.edges[0] + t * at.edges[1]).length();
        let scale = scale * at.t / length.max(at.t);
        at.moved(x, scale * s, scale * t)
    }

    /// Whether `p`, walk space, is the point found.
    pub fn is_at(&self, found: &Crossing, p: Vec3) -> bool {
        (found.p - p).length() <= (SAME * found.t).max(64.0 * self.error)
    }

    fn cast(&self, x: Vec3, d: Vec3, v: Vec3) -> Option<Crossing> {
        self.cast_within(x, d, v, f32::INFINITY)
    }

    fn cast_within(&self, x: Vec3, d: Vec3, v: Vec3, reach: f32) -> Option<Crossing> {
        let hit = self.scene.boundary_from_within(self.instance, x, d, reach)?;
        let instance = &self.scene.instances[self.instance as usize];
        let (geometry, m) = (&instance.geometry, &*self.scene.placed(self.instance));
        let at = |corners: [Vec3; 3]| corners[0] * (1.0 - hit.u - hit.v) + corners[1] * hit.u + corners[2] * hit.v;
        let [a, b, c] = geometry.corners(hit.triangle, self.scene.time);
        let edges = [m.vector(b - a), m.vector(c - a)];
        let p = m.vector(at([a, b, c]));
        // Outward is where the way from inside leads, as `Scene::interaction` has it.
        let outward = |n: Vec3, way: Vec3| if n.dot(way) < 0.0 { -1.0 } else { 1.0 };
        let flat = m.normal((b - a).cross(c - a));
        let ng = outward(flat, d) * flat;
        let (normal, slopes) = match geometry.corner_normals(hit.triangle, self.scene.time) {
            None => (ng, [Vec3::ZERO; 2]),
            Some(corners) => {
                let n = m.normal(at(corners));
                let side = outward(n, ng);
                (side * n, [1, 2].map(|k| side * m.normal(corners[k] - corners[0])))
            }
        };
        let frame = Frame::from_normal(normal.try_normalize()?);
        Some(Crossing { hit, p, d, t: hit.t, v, edges, ng, normal, slopes, frame })
    }

    /// g = eta w - v, which a solution has along its normal.
    fn bend(&self, at: &Crossing) -> Vec3 {
        self.eta * at.d - at.v
    }

    fn residual(&self, at: &Crossing) -> f32 {
        self.bend(at).reject_from_normalized(at.frame.n).length_squared()
    }

    /// Derivatives of the part of g across the normal, along the edges, in the frame of the crossing.
    fn derivative(&self, at: &Crossing) -> [[f32; 2]; 2] {
        let frame = &at.frame;
        // d n = the part of d normal across n, over the length of the normal.
        let along_n = self.bend(at).dot(frame.n) / at.normal.dot(frame.n);
        [0, 1].map(|k| {
            let edge = at.edges[k];
            let inside = edge.reject_from_normalized(at.d) / at.t;
            let change = self.eta * inside - along_n * at.slopes[k];
            [change.dot(frame.t), change.dot(frame.b)]
        })
    }

    /// Newton's step, in edges.
    fn step(&self, at: &Crossing) -> Option<(f32, f32)> {
        let [[a, b], [c, d]] = self.derivative(at);
        let g = self.bend(at);
        let (x, y) = (g.dot(at.frame.t), g.dot(at.frame.b));
        let det = a * d - b * c;
        let step = ((c * y - d * x) / det, (b * x - a * y) / det);
        (step.0.is_finite() && step.1.is_finite()).then_some(step)
    }

    /// Whether the light really goes through: shading and geometric normal agree about the sides, as the BSDF asks.
    fn transmits(&self, at: &Crossing) -> bool {
        let (inside, outside) = (at.d.dot(at.frame.n), at.v.dot(at.frame.n));
        inside > GRAZING && outside > 0.0 && at.v.dot(at.ng) > 0.0 && at.d.dot(at.ng) > 0.0
    }

    /// d omega at x / d omega at the crossing, of directions to the light: implicit differentiation of g parallel to n.
    pub fn spread(&self, at: &Crossing) -> f32 {
        let [[a, b], [c, d]] = self.derivative(at);
        let area = at.edges[0].cross(at.edges[1]);
        let across = at.frame.n.dot(at.v) * area.dot(at.d);
        (across / (at.t * at.t * (a * d - b * c))).abs()
    }

    /// The crossing as paths meet it.
    pub fn interaction(&self, at: &Crossing) -> Interaction {
        self.scene.interaction(&at.hit, at.d, Side::Inside)
    }

    /// Share of the radiance that crosses; the rest is reflected.
    pub fn transmitted(&self, at: &Crossing) -> f32 {
        1.0 - fresnel::dielectric(at.d.dot(at.frame.n), 1.0 / self.eta)
    }

    /// What arrives inside of radiance 1 outside, as `Dielectric::sample_smooth` has it.
    pub fn radiance(&self, at: &Crossing) -> Rgb {
        self.radiance_of(self.transmitted(at))
    }

    /// The same where the share `transmitted` crosses.
    pub fn radiance_of(&self, transmitted: f32) -> Rgb {
        self.tint * (transmitted * self.eta * self.eta)
    }

    /// Where a path that comes to `exit` from within goes on outside, and the share that does.
    pub fn refracted(&self, exit: &Interaction) -> Option<(Vec3, f32)> {
        let n = -exit.frame.n;
        let cos = exit.wo.dot(n);
        let v = (cos > 0.0).then(|| fresnel::refract(exit.wo, n, 1.0 / self.eta)).flatten()?;
        Some((v, 1.0 - fresnel::dielectric(cos, 1.0 / self.eta)))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::bsdf::fresnel::refract;
    use crate::delegate::{DirtyBits, RenderDelegate};
    use crate::flat::{Camera, Light, Material, Mesh, PreviewSurface, Prim, RenderSettings};
    use crate::sampling::sampler::Sampler;
    use crate::sampling::uniform_sphere;
    use crate::scene::Scene;
    use std::sync::Arc;

    /// [`ball_of`] glass with hardly any medium.
    pub fn ball(waves: f32, ior: f32, lights: Vec<Light>) -> Arc<Scene> {
        let glass = PreviewSurface { ior, roughness: 0.0, subsurface_radius: [1e6; 3], ..PreviewSurface::default() };
        ball_of(waves, glass, lights)
    }

    /// A ball with waves of the given height, interpolated normals, scaled by (1, 1, 2), with a medium behind a dielectric.
    pub fn ball_of(waves: f32, surface: PreviewSurface, lights: Vec<Light>) -> Arc<Scene> {
        const N: usize = 24;
        let point = |i: usize| {
            let (ring, segment) = (i / (2 * N), i % (2 * N));
            let (theta, phi) = (ring as f32 / N as f32, segment as f32 / N as f32);
            let (theta, phi) = (theta * std::f32::consts::PI, phi * std::f32::consts::PI);
            let p = Vec3::new(theta.sin() * phi.cos(), theta.cos(), -theta.sin() * phi.sin());
            (p * (1.0 + waves * (5.0 * p.x).sin() * (4.0 * p.y + 1.0).sin() * (4.0 * p.z + 2.0).sin())).to_array()
        };
        let points: Vec<[f32; 3]> = (0..(N + 1) * 2 * N).map(point).collect();
        let at = |ring: usize, segment: usize| (ring * 2 * N + segment % (2 * N)) as i32;
        let quad = |i: usize| {
            let (r, s) = (i / (2 * N), i % (2 * N));
            [at(r, s), at(r + 1, s), at(r + 1, s + 1), at(r, s + 1)]
        };
        let indices: Vec<i32> = (0..N * 2 * N).flat_map(quad).collect();
        let mut mesh = Mesh {
            points: points.into(),
            face_vertex_counts: vec![4; N * 2 * N].into(),
            face_vertex_indices: indices.into(),
            material: "/M".into(),
            subdivision_scheme: "loop".into(),
            ..Mesh::default()
        };
        mesh.transform[2][2] = 2.0;
        let material = Material::UsdPreviewSurface(PreviewSurface {
            subsurface: 1.0,
            subsurface_boundary: "dielectric".into(),
            ..surface
        });
        let mut delegate = RenderDelegate::new();
        delegate.sync("/O", Prim::Mesh(mesh), DirtyBits::ALL);
        delegate.sync("/M", Prim::Material(material), DirtyBits::ALL);
        delegate.sync("/C", Prim::Camera(Camera::default()), DirtyBits::ALL);
        for (i, light) in lights.into_iter().enumerate() {
            delegate.sync(&format!("/L{i}"), Prim::Light(light), DirtyBits::ALL);
        }
        delegate.set_settings(RenderSettings { camera: "/C".into(), ..RenderSettings::default() }).expect("settings");
        delegate.commit().expect("commit");
        delegate.scene().expect("scene").clone()
    }

    fn window(scene: &Scene) -> Window<'_> {
        Window::new(scene.at(0.0), 0, 0, 1e-6).expect("a smooth dielectric")
    }

    fn uniform(sampler: &mut Sampler) -> Vec3 {
        uniform_sphere(glam::Vec2::new(sampler.random(), sampler.random()))
    }

    fn find(window: &Window, x: Vec3, v: Vec3) -> Option<Crossing> {
        window.solve(x, window.start(x, v)?)
    }

    /// The Jacobian is that of the search itself, by central differences within a triangle.
    #[test]
    fn spread_is_the_ratio_of_solid_angles() {
        let mut sampler = Sampler::new(5, 0, 0);
        for (waves, ior) in [(0.0, 1.2), (0.0, 1.5), (0.1, 1.4), (0.1, 2.0), (0.1, 0.75)] {
            let scene = ball(waves, ior, Vec::new());
            let window = window(&scene);
            let mut errors = Vec::new();
            while errors.len() < 500 {
                let x = 0.6 * sampler.random() * uniform(&mut sampler);
                let v = uniform(&mut sampler);
                let Some(at) = find(&window, x, v) else { continue };
                let (frame, h) = (Frame::from_normal(at.v), 2e-3);
                let moved = |axis: Vec3| {
                    let ends = [h, -h].map(|h| find(&window, x, (v + h * axis).normalize()));
                    let [Some(a), Some(b)] = ends else { return None };
                    let within = a.hit.triangle == at.hit.triangle && b.hit.triangle == at.hit.triangle;
                    within.then(|| (a.d - b.d) / (2.0 * h))
                };
                let (Some(s), Some(t)) = (moved(frame.t), moved(frame.b)) else { continue };
                errors.push((s.cross(t).length() / window.spread(&at) - 1.0).abs());
            }
            errors.sort_by(f32::total_cmp);
            let (median, most) = (errors[250], errors[475]);
            eprintln!("waves {waves} ior {ior}: median {median:.1e}, 95 % below {most:.1e}");
            assert!(median < 3e-3 && most < 3e-2, "waves {waves} ior {ior}: {median} {most}");
        }
    }

    /// A way out by chance, seen from its ends: what is found refracts as the BSDF does, and is found again.
    #[test]
    fn paths_find_themselves_again() {
        let mut sampler = Sampler::new(6, 0, 0);
        for (waves, ior, least) in [(0.0, 1.2, 0.9), (0.0, 1.5, 0.85), (0.1, 1.4, 0.5), (0.1, 2.0, 0.3)] {
            let scene = ball(waves, ior, Vec::new());
            let window = window(&scene);
            let (mut ways, mut same) = (0, 0);
            while ways < 4000 {
                let x = 0.6 * sampler.random() * uniform(&mut sampler);
                let d = uniform(&mut sampler);
                let by_chance = window.cast(x, d, d).expect("closed");
                let Some(v) = refract(-d, -by_chance.frame.n, 1.0 / ior) else { continue };
                ways += 1;
                let Some(found) = find(&window, x, v) else { continue };
                let bent = refract(-found.d, -found.frame.n, 1.0 / ior).expect("a solution transmits");
                assert!((bent - found.v).length() < 1e-3, "waves {waves} ior {ior}: {bent} {}", found.v);
                if window.is_at(&found, by_chance.p) {
                    same += 1;
                }
            }
            let rate = same as f32 / ways as f32;
            eprintln!("waves {waves} ior {ior}: {rate:.3} of the ways are found");
            assert!(rate > least, "waves {waves} ior {ior}: {rate}");
        }
    }
}
