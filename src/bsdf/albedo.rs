//! Directional albedos of microfacet lobes, by quadrature, tabulated over the cosine for one roughness and index.
//!
//! A surface computes its few curves once when it is compiled (2 ms for a reflection, 10 ms for an interface), so nothing is
//! interpolated over roughness or index, unless these are driven (`curves`).

use super::fresnel::{dielectric, reflect, refract};
use super::ggx::{Ggx, Masking};
use crate::math::TAU;
use glam::{Vec2, Vec3};

/// Nodes of a curve, equidistant in cos^(1 / POWER): dense at grazing, where albedos turn quickly. With cubic
/// interpolation the error is below 1.2e-3 (tested; 1.5e-3 for alpha < 0.01). Only the reflection of a layer with
/// eta < 1 is worse, next to its critical angle and for alpha < 0.1 (0.05 at alpha 0.02).
const NODES: usize = 48;
const POWER: f32 = 2.5;

/// Points of the quadrature over visible normals; refraction has the rougher integrand.
const REFLECTION_POINTS: u32 = 1000;
const INTERFACE_POINTS: u32 = 4000;

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

    /// Between this (x = 0) and another.
    pub fn lerp(&self, other: &Self, x: f32) -> Self {
        Self { nodes: std::array::from_fn(|i| self.nodes[i] + (other.nodes[i] - self.nodes[i]) * x) }
    }

    pub fn tabulate(f: impl Fn(f32) -> f32) -> Self {
        let nodes = std::array::from_fn(|i| {
            let x = i as f32 / (NODES - 1) as f32;
            f(x.powf(POWER).max(MIN_COS))
        });
        Self { nodes }
    }

    /// Catmull-Rom through the nodes, end slopes by linear extension.
    pub fn at(&self, cos: f32) -> f32 {
        let x = cos.clamp(0.0, 1.0).powf(1.0 / POWER) * (NODES - 1) as f32;
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
        let share = |wo: Vec3, h: Vec3| fresnel(wo.dot(h)) * reflection_share(ggx, masking, wo, h);
        Self::tabulate(|mu| visible_normals(ggx, mu, REFLECTION_POINTS, share))
    }

    /// Share of power a rough dielectric interface reflects and transmits by single scattering; the rest would
    /// need a second facet.
    pub fn interface(ggx: Ggx, eta: f32) -> Self {
        Self::tabulate(|mu| visible_normals(ggx, mu, INTERFACE_POINTS, |wo, h| interface_share(ggx, eta, wo, h)))
    }
}

/// What leaves after reflection at a visible facet `h`: G2 / G1.
fn reflection_share(ggx: Ggx, masking: Masking, wo: Vec3, h: Vec3) -> f32 {
    let wi = reflect(wo, h);
    if wi.z > 0.0 { masking.g2(ggx, wo, wi) / ggx.g1(wo) } else { 0.0 }
}

/// What leaves on either side.
fn interface_share(ggx: Ggx, eta: f32, wo: Vec3, h: Vec3) -> f32 {
    let fresnel = dielectric(wo.dot(h), eta);
    let transmitted = refract(wo, h, eta).filter(|wi| wi.z < 0.0);
    let transmitted = transmitted.map_or(0.0, |wi| ggx.g2(wo, wi) / ggx.g1(wo));
    fresnel * reflection_share(ggx, Masking::Smith, wo, h) + (1.0 - fresnel) * transmitted
}

/// Mean of `f(wo, h)` over the normals visible from the cosine `mu`, with `n` points of the sampler's unit square:
/// a lattice of the golden ratio, because at grazing sight the integrand jumps along a curve, where a product rule
/// converges slowly. The lobes are symmetric: the tent makes half a turn periodic.
fn visible_normals(ggx: Ggx, mu: f32, n: u32, f: impl Fn(Vec3, Vec3) -> f32) -> f32 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let lattice = |i: u32| {
        let tent = 1.0 - (2.0 * (f64::from(i) * GOLDEN).fract() - 1.0).abs();
        Vec2::new((i as f32 + 0.5) / n as f32, 0.5 * tent as f32)
    };
    let sum: f64 = (0..n).map(|i| f64::from(f(wo, ggx.sample(wo, lattice(i))))).sum();
    (sum / f64::from(n)) as f32
}

/// Mean of `f(wo . h)` over a cosine-weighted hemisphere of `wi`, for a lobe that depends on the half vector.
pub fn cosine_mean(mu: f32, f: impl Fn(f32) -> f32) -> f32 {
    let wo = Vec3::new((1.0 - mu * mu).max(0.0).sqrt(), 0.0, mu);
    let (radial, angular) = (40, 20);
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

#[cfg(test)]
mod tests {
    use super::*;

    const FINE: u32 = 60_000;

    /// Stated in [`NODES`]: curves are within 1e-3 of a 15 times finer quadrature between their nodes.
    #[test]
    fn curves_are_accurate() {
        for (alpha, bound) in [(0.002, 1.5e-3), (0.02, 1e-3), (0.1, 1e-3), (0.3, 1e-3), (0.6, 1.2e-3), (1.0, 1.2e-3)] {
            let ggx = Ggx { alpha };
            for eta in [1.0 / 2.4, 1.0 / 1.5, 1.0 / 1.33, 0.8, 1.05, 1.33, 1.5, 2.4] {
                let interface = Curve::interface(ggx, eta);
                let reflection = Curve::reflection(ggx, Masking::Smith, |cos| dielectric(cos, eta));
                for mu in [0.003, 0.02, 0.07, 0.13, 0.3, 0.55, 0.7, 0.76, 0.9, 0.995] {
                    let exact = visible_normals(ggx, mu, FINE, |wo, h| interface_share(ggx, eta, wo, h));
                    let got = interface.at(mu);
                    assert!((got / exact - 1.0).abs() < bound, "interface {alpha} {eta} {mu}: {got} {exact}");
                    if eta < 1.0 {
                        continue; // see NODES
                    }
                    let exact = visible_normals(ggx, mu, FINE, |wo, h| {
                        reflection_share(ggx, Masking::Smith, wo, h) * dielectric(wo.dot(h), eta)
                    });
                    let got = reflection.at(mu);
                    assert!((got - exact).abs() < bound, "layer {alpha} {eta} {mu}: {got} {exact}");
                }
            }
        }
    }
}
