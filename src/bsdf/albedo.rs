//! Directional albedos of microfacet lobes, by quadrature, tabulated over the cosine for one roughness and index.
//!
//! A surface computes its few curves once when it is compiled (about a millisecond each), so nothing is
//! interpolated over roughness or index.

use super::fresnel::{dielectric, reflect, refract};
use super::ggx::{Ggx, Masking};
use crate::math::TAU;
use glam::{Vec2, Vec3};

/// Nodes of a curve, equidistant in sqrt(cos): dense at grazing, where albedos turn quickly. With cubic
/// interpolation the error stays below 1e-3 (tested), below 2e-4 for alpha >= 0.05.
const NODES: usize = 32;

/// Strata of the quadrature over visible normals, radially and over half a turn (the lobes are symmetric).
const STRATA: [usize; 2] = [40, 20];

/// The cosine of the first node; the albedo below it is taken as constant.
const MIN_COS: f32 = 1e-4;

/// A function of the cosine in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    nodes: [f32; NODES],
}

impl Curve {
    pub const ONE: Self = Self { nodes: [1.0; NODES] };
    pub const ZERO: Self = Self { nodes: [0.0; NODES] };

    pub fn tabulate(f: impl Fn(f32) -> f32) -> Self {
        let nodes = std::array::from_fn(|i| {
            let x = i as f32 / (NODES - 1) as f32;
            f((x * x).max(MIN_COS))
        });
        Self { nodes }
    }

    /// Catmull-Rom through the nodes, end slopes by linear extension.
    pub fn at(&self, cos: f32) -> f32 {
        let x = cos.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
        let i = (x as usize).min(NODES - 2);
        let t = x - i as f32;
        let n = &self.nodes;
        let (p1, p2) = (n[i], n[i + 1]);
        let p0 = if i == 0 { 2.0 * p1 - p2 } else { n[i - 1] };
        let p3 = if i + 2 == NODES { 2.0 * p2 - p1 } else { n[i + 2] };
        let (a, b, c) = (p2 - p0, 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3, 3.0 * (p1 - p2) + p3 - p0);
        p1 + 0.5 * t * (a + t * (b + t * c))
    }

    /// Share of light a GGX reflection returns when its facets reflect `fresnel(wo . h)`.
    pub fn reflection(ggx: Ggx, masking: Masking, fresnel: impl Fn(f32) -> f32) -> Self {
        Self::tabulate(|mu| {
            visible_normals(ggx, mu, |wo, h| {
                let wi = reflect(wo, h);
                if wi.z <= 0.0 { 0.0 } else { fresnel(wo.dot(h)) * masking.g2(ggx, wo, wi) / ggx.g1(wo) }
            })
        })
    }

    /// Share of power a rough dielectric interface reflects and transmits by single scattering; the rest would
    /// need a second facet.
    pub fn interface(ggx: Ggx, eta: f32) -> Self {
        Self::tabulate(|mu| {
            visible_normals(ggx, mu, |wo, h| {
                let fresnel = dielectric(wo.dot(h), eta);
                let reflected = Some(reflect(wo, h)).filter(|wi| wi.z > 0.0);
                let transmitted = refract(wo, h, eta).filter(|wi| wi.z < 0.0);
                let share = |wi: Option<Vec3>| wi.map_or(0.0, |wi| ggx.g2(wo, wi) / ggx.g1(wo));
                fresnel * share(reflected) + (1.0 - fresnel) * share(transmitted)
            })
        })
    }
}

/// Mean of `f(wo, h)` over the normals visible from the cosine `mu`; midpoint rule in the sampler's unit square.
fn visible_normals(ggx: Ggx, mu: f32, f: impl Fn(Vec3, Vec3) -> f32) -> f32 {
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let [radial, angular] = STRATA;
    let mut sum = 0.0;
    for i in 0..radial {
        for j in 0..angular {
            let u = Vec2::new((i as f32 + 0.5) / radial as f32, (j as f32 + 0.5) / (2 * angular) as f32);
            sum += f(wo, ggx.sample(wo, u));
        }
    }
    sum / (radial * angular) as f32
}

/// Mean of `f(wi, wo . h)` over a cosine-weighted hemisphere of `wi`, for a lobe that depends on the half vector.
pub fn cosine_mean(mu: f32, f: impl Fn(f32) -> f32) -> f32 {
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let [radial, angular] = STRATA;
    let mut sum = 0.0;
    for i in 0..radial {
        for j in 0..angular {
            let r2 = (i as f32 + 0.5) / radial as f32;
            let (sin, cos) = (TAU * 0.5 * (j as f32 + 0.5) / angular as f32).sin_cos();
            let wi = Vec3::new(r2.sqrt() * cos, r2.sqrt() * sin, (1.0 - r2).sqrt());
            sum += f(wo.dot((wo + wi).normalize()));
        }
    }
    sum / (radial * angular) as f32
}
