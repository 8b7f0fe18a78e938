//! Strands of hair against rays through a glass cylinder, and the energy that leaves them.

use dermis::bsdf::{Bsdf, Event, Side, Surface};
use dermis::flat::{ChiangHair, Material};
use dermis::math::Rgb;
use dermis::sampling::sampler::Sampler;
use glam::{DVec3, Vec3};

fn hair(m: ChiangHair) -> Surface {
    let mut warnings = Vec::new();
    let surface = Surface::compile(&Material::Hair(m), None, 1.0, None, "/M", &mut warnings);
    assert!(warnings.is_empty(), "{warnings:?}");
    surface
}

/// Lobes so narrow that they are rays.
fn glass_fibre(ior: f32, absorption: [f32; 3]) -> Surface {
    hair(ChiangHair {
        ior,
        absorption_coefficient: absorption,
        roughness_r: [1e-5, 1e-3],
        roughness_tt: [1e-5, 1e-3],
        roughness_trt: [1e-5, 1e-3],
        ..Default::default()
    })
}

/// Refraction into the side that `n` does not point to, and the reflectance (Fresnel's amplitudes, unpolarised).
fn refract(d: DVec3, n: DVec3, eta: f64) -> (DVec3, f64) {
    let cos = -d.dot(n);
    let cos_t = (1.0 - (1.0 - cos * cos) / (eta * eta)).sqrt();
    let s = (cos - eta * cos_t) / (cos + eta * cos_t);
    let p = (eta * cos - cos_t) / (eta * cos + cos_t);
    ((d + n * cos) / eta - n * cos_t, 0.5 * (s * s + p * p))
}

/// Directions and powers of light that comes from `wo` onto the cylinder about x at the point with normal z: R, TT, TRT.
fn rays(wo: DVec3, eta: f64, absorption: DVec3) -> [(DVec3, DVec3); 3] {
    let across = |v: DVec3| DVec3::new(0.0, v.y, v.z);
    // The other end of a chord from `p` along `d` of the unit cylinder.
    let chord = |p: DVec3, d: DVec3| -2.0 * across(p).dot(d) / across(d).length_squared();
    let p0 = DVec3::Z;
    let (inside, f) = refract(-wo, p0, eta);
    let reflected = -wo + 2.0 * wo.dot(p0) * p0;
    let length = chord(p0, inside);
    let p1 = p0 + inside * length;
    let n1 = across(p1);
    // Out: towards n1, seen from inside.
    let (out, _) = refract(inside, -n1, 1.0 / eta);
    let passed = (-absorption * length).exp();
    let back = inside - 2.0 * inside.dot(n1) * n1;
    let p2 = p1 + back * chord(p1, back);
    let (out2, _) = refract(back, -across(p2), 1.0 / eta);
    let through = passed * (1.0 - f) * (1.0 - f);
    [(reflected, DVec3::splat(f)), (out, through), (out2, through * passed * f)]
}

/// Power of `bsdf` within a cone about `axis`.
fn power(bsdf: &Bsdf, axis: DVec3) -> DVec3 {
    const N: u32 = 40_000;
    let mut sum = DVec3::ZERO;
    for i in 0..N {
        let mut sampler = Sampler::new(5, 0, i);
        let u = sampler.next_1d();
        let Some(s) = bsdf.sample(u, sampler.next_2d()) else { continue };
        assert!(s.event == Event::Scatter && !s.delta);
        if s.wi.as_dvec3().dot(axis) > 0.08_f64.cos() {
            sum += (s.f / s.pdf).as_dvec3();
        }
    }
    sum / f64::from(N)
}

/// Where each lobe is, and how much light it carries, is what Snell, Fresnel and Beer say of a smooth cylinder. The model
/// takes two liberties: attenuation at the exit is that of the entry (exact for a cylinder), and Fresnel's is that of the
/// true angle.
#[test]
fn narrow_lobes_are_the_rays_through_a_cylinder() {
    let absorption = [0.1, 0.4, 1.0];
    for ior in [1.55_f32, 1.3] {
        let surface = glass_fibre(ior, absorption);
        for wo in [Vec3::new(0.0, 0.3, 0.8), Vec3::new(0.5, -0.6, 0.5), Vec3::new(-0.3, 0.7, 0.2)] {
            let wo = wo.normalize();
            let bsdf = surface.bsdf(wo, Side::Outside);
            let absorption = Vec3::from(absorption).as_dvec3();
            for (i, (axis, expected)) in rays(wo.as_dvec3(), f64::from(ior), absorption).into_iter().enumerate() {
                let found = power(&bsdf, axis);
                // 5 standard errors of a share of 40000 samples, and what the uniform lobe throws into the cone.
                let error = (found - expected).abs() - DVec3::splat(2e-4);
                let bound = 5.0 * (expected.max_element() / 40_000.0).sqrt();
                assert!(error.max_element() < bound, "ior {ior}, wo {wo}, lobe {i}: {found} for {expected}");
            }
        }
    }
}

/// What is neither absorbed nor tinted leaves: the white furnace of one strand, from everywhere, with tilted scales.
#[test]
fn clear_strands_lose_nothing() {
    for roughness in [[1e-4, 0.01], [0.006, 0.1], [0.1, 0.4], [2.0, 2.0]] {
        for cuticle_angle in [0.5, 0.52, 0.45, 0.9] {
            let m = ChiangHair {
                roughness_r: roughness,
                roughness_tt: roughness,
                roughness_trt: roughness,
                cuticle_angle,
                ..Default::default()
            };
            let surface = hair(m);
            for wo in [Vec3::new(0.0, 0.0, 1.0), Vec3::new(0.6, 0.7, 0.4), Vec3::new(-0.95, 0.1, 0.1)] {
                let bsdf = surface.bsdf(wo.normalize(), Side::Outside);
                for i in 0..400 {
                    let mut sampler = Sampler::new(7, 0, i);
                    let u = sampler.next_1d();
                    let s = bsdf.sample(u, sampler.next_2d()).expect("a direction");
                    assert!((s.f / s.pdf - Rgb::ONE).abs().max_element() < 1e-4, "{roughness:?} {wo}: {s:?}");
                }
            }
        }
    }
}

/// Scales that are tilted to the root send the reflection there: theta_i = -theta_o - 2 alpha (x is the tip).
#[test]
fn tilted_scales_shift_the_highlight_to_the_root() {
    let degrees = 3.0_f32;
    let surface = hair(ChiangHair {
        cuticle_angle: 0.5 + degrees / 180.0,
        absorption_coefficient: [1e4; 3],
        roughness_r: [1e-5, 0.1],
        ..Default::default()
    });
    let theta = 0.3_f32;
    let bsdf = surface.bsdf(Vec3::new(theta.sin(), 0.0, theta.cos()), Side::Outside);
    let mean = (0..2000)
        .map(|i| {
            let mut sampler = Sampler::new(9, 0, i);
            let u = sampler.next_1d();
            bsdf.sample(u, sampler.next_2d()).expect("a direction").wi.x.asin()
        })
        .sum::<f32>()
        / 2000.0;
    assert!((mean + theta + 2.0 * degrees.to_radians()).abs() < 1e-3, "{mean}");
}
