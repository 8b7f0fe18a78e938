//! Surfaces against statistics and closed forms: sampling, pdfs, energy, reciprocity, and agreement of shaders.

mod support;

use dermis::bsdf::{Boundary, Bsdf, Event, InteriorAlbedo, Side, Surface};
use dermis::flat::{ChiangHair, Material, OpenPbrSurface, PreviewSurface, StandardSurface};
use dermis::math::{Rgb, TAU};
use dermis::sampling::sampler::Sampler;
use glam::{Vec2, Vec3};
use support::chi_square;

fn compile(material: Material, boundary: Option<Boundary>) -> Surface {
    let mut warnings = Vec::new();
    let surface = Surface::compile(&material, None, 1.0, boundary, "/M", &mut warnings);
    assert!(warnings.is_empty(), "{warnings:?}");
    surface
}

fn preview(m: PreviewSurface) -> Surface {
    compile(Material::UsdPreviewSurface(m), None)
}

fn openpbr(m: OpenPbrSurface) -> Surface {
    compile(Material::OpenPbr(m), None)
}

fn standard(m: StandardSurface) -> Surface {
    compile(Material::StandardSurface(m), None)
}

/// A clear dielectric.
fn glass(ior: f32, roughness: f32) -> Surface {
    openpbr(OpenPbrSurface {
        transmission_weight: 1.0,
        specular_ior: ior,
        specular_roughness: roughness,
        ..Default::default()
    })
}

/// A direction with cosine `mu`, off the axes.
fn direction(mu: f32) -> Vec3 {
    let sin = (1.0 - mu * mu).max(0.0).sqrt();
    Vec3::new(sin * 0.8, sin * 0.6, mu)
}

/// Opaque and layered surfaces of every lobe.
fn opaque_surfaces() -> Vec<(&'static str, Surface)> {
    let color = [0.9, 0.5, 0.2];
    vec![
        ("storm", preview(PreviewSurface { diffuse_color: Some(color), ..Default::default() })),
        (
            "storm metal, glossy, coated",
            preview(PreviewSurface {
                diffuse_color: Some(color),
                metallic: 0.7,
                roughness: 0.25,
                clearcoat: 0.6,
                clearcoat_roughness: 0.4,
                ..Default::default()
            }),
        ),
        (
            "storm specular workflow, half transparent",
            preview(PreviewSurface {
                diffuse_color: Some(color),
                use_specular_workflow: 1,
                specular_color: [0.2, 0.3, 0.4],
                roughness: 1.0,
                opacity: 0.5,
                ..Default::default()
            }),
        ),
        (
            "openpbr rough diffuse and coat",
            openpbr(OpenPbrSurface {
                base_color: color,
                base_diffuse_roughness: 0.8,
                specular_roughness: 0.6,
                coat_weight: 0.7,
                coat_roughness: 0.3,
                ..Default::default()
            }),
        ),
        (
            "openpbr metal",
            openpbr(OpenPbrSurface {
                base_color: color,
                base_metalness: 1.0,
                specular_color: [0.5, 0.6, 0.7],
                specular_roughness: 0.7,
                ..Default::default()
            }),
        ),
        (
            "standard metal mixed, subsurface",
            standard(StandardSurface {
                base_color: color,
                metalness: 0.4,
                specular_roughness: 0.45,
                subsurface: 0.5,
                ..Default::default()
            }),
        ),
        (
            "openpbr half glass over diffuse",
            openpbr(OpenPbrSurface {
                transmission_weight: 0.5,
                specular_roughness: 0.5,
                geometry_opacity: 0.8,
                ..Default::default()
            }),
        ),
    ]
}

// ---- chi-square -----------------------------------------------------------------------------------------------

const Z_BINS: usize = 20;
const PHI_BINS: usize = 24;
const SAMPLES: usize = 300_000;
const TURN: f64 = std::f64::consts::TAU;

/// Per bin of (z, phi): integral of pdf, and over the sphere that of eval. Bins that matter get a fine grid: pdfs of
/// rough refraction jump along curves (facets seen on edge), where adaptive rules stop too early.
fn integrate(bsdf: &Bsdf) -> (Vec<f64>, glam::DVec3) {
    let mut f = glam::DVec3::ZERO;
    let mut cell = |i: usize| {
        let coarse = midpoint(bsdf, i, 16);
        let integral = match coarse.w {
            heavy if heavy > 5e-3 => midpoint(bsdf, i, 128),
            medium if medium > 5e-4 => midpoint(bsdf, i, 64),
            _ => coarse,
        };
        f += integral.truncate();
        integral.w
    };
    let bins = (0..Z_BINS * PHI_BINS).map(&mut cell).collect();
    (bins, f)
}

/// (f, pdf) over a bin by n x n points.
fn midpoint(bsdf: &Bsdf, bin: usize, n: usize) -> glam::DVec4 {
    let (dz, dphi) = (2.0 / (Z_BINS * n) as f64, TURN / (PHI_BINS * n) as f64);
    let at = |i: usize| {
        let z = -1.0 + dz * ((bin / PHI_BINS * n + i / n) as f64 + 0.5);
        let phi = dphi * ((bin % PHI_BINS * n + i % n) as f64 + 0.5);
        let r = (1.0 - z * z).sqrt();
        let wi = glam::DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3();
        bsdf.eval(wi).as_dvec3().extend(f64::from(bsdf.pdf(wi)))
    };
    (0..n * n).map(at).sum::<glam::DVec4>() * (dz * dphi)
}

fn bin(wi: Vec3) -> usize {
    let z = ((wi.z + 1.0) * 0.5 * Z_BINS as f32) as usize;
    let phi = wi.y.atan2(wi.x).rem_euclid(TAU) / TAU;
    z.min(Z_BINS - 1) * PHI_BINS + ((phi * PHI_BINS as f32) as usize).min(PHI_BINS - 1)
}

/// Counts against expectation; sparse bins and what is not sampled (delta, absorbed) are pooled.
fn against(counts: &[f64], expected: &[f64], total: f64) -> f64 {
    let (mut chi2, mut dof) = (0.0, 0.0);
    let (mut rest_n, mut rest_e) = (total, total);
    for (&n, &e) in counts.iter().zip(expected) {
        if e > 10.0 {
            (chi2, dof) = (chi2 + (n - e) * (n - e) / e, dof + 1.0);
            (rest_n, rest_e) = (rest_n - n, rest_e - e);
        }
    }
    // Quadrature error of a pdf that should integrate to 1 can leave the rest below 1 sample.
    chi2 += (rest_n - rest_e) * (rest_n - rest_e) / rest_e.abs().max(10.0);
    chi_square::score(chi2, dof)
}

/// The sampler draws from its pdf, f / pdf has the mean of eval, and both are what eval and pdf say.
fn check_sampling(name: &str, bsdf: &Bsdf) {
    let (mut pdf, f) = integrate(bsdf);
    let share: f64 = pdf.iter().sum();
    assert!(share < 1.0 + 2e-3, "{name}: pdf integrates to {share}");
    pdf.iter_mut().for_each(|p| *p *= SAMPLES as f64);
    let mut counts = vec![0.0; pdf.len()];
    let (mut sum, mut sum2) = (glam::DVec3::ZERO, glam::DVec3::ZERO);
    for i in 0..SAMPLES {
        let mut sampler = Sampler::new(1, 0, i as u32);
        let (u, u2) = (sampler.random(), Vec2::new(sampler.random(), sampler.random()));
        let Some(s) = bsdf.sample(u, u2) else { continue };
        assert!((s.wi.length() - 1.0).abs() < 1e-4 && s.f.is_finite() && s.f.min_element() >= 0.0, "{name}: {s:?}");
        if s.delta {
            continue;
        }
        assert_eq!((s.f, s.pdf), (bsdf.eval(s.wi), bsdf.pdf(s.wi)), "{name}");
        counts[bin(s.wi)] += 1.0;
        let weight = (s.f / s.pdf).as_dvec3();
        (sum, sum2) = (sum + weight, sum2 + weight * weight);
    }
    let n = SAMPLES as f64;
    let z = against(&counts, &pdf, n);
    let sigma = ((sum2 / n - (sum / n) * (sum / n)) / n).max(glam::DVec3::splat(1e-10));
    let error = (sum / n - f).abs() / (5.0 * glam::DVec3::new(sigma.x.sqrt(), sigma.y.sqrt(), sigma.z.sqrt()) + 2e-4);
    println!("{name}: chi-square score {z:.2}, share {share:.5}, f {f:.4}");
    assert!(z < 4.5, "{name}: chi-square score {z}");
    assert!(error.max_element() < 1.0, "{name}: mean of f / pdf {} against integral of f {f}", sum / n);
}

#[test]
fn opaque_mixtures_sample_their_pdf() {
    for (name, surface) in opaque_surfaces() {
        for mu in [0.97, 0.4, 0.06] {
            check_sampling(&format!("{name} {mu}"), &surface.bsdf(direction(mu), Side::Outside));
        }
    }
}

#[test]
fn strands_sample_their_pdf() {
    let rough = ChiangHair {
        tint_trt: [0.9, 1.2, 0.4],
        cuticle_angle: 0.53,
        absorption_coefficient: [0.1, 0.3, 0.9],
        // Wide enough for the quadrature of this test.
        roughness_r: [0.02, 0.3],
        roughness_tt: [0.02, 0.15],
        ..Default::default()
    };
    let fur =
        ChiangHair { roughness_tt: [0.4, 0.8], roughness_trt: [2.0, 0.15], ior: 1.3, opacity: 0.7, ..rough.clone() };
    for (name, m) in [("hair", rough), ("fur", fur)] {
        let surface = compile(Material::Hair(m), None);
        for mu in [0.97, 0.4, 0.06] {
            check_sampling(&format!("{name} {mu}"), &surface.bsdf(direction(mu), Side::Outside));
        }
    }
}

#[test]
fn rough_dielectrics_sample_their_pdf() {
    for (ior, roughness) in [(1.5, 0.35), (1.33, 0.6), (2.4, 1.0), (0.8, 0.5), (1.15, 0.9)] {
        let surface = glass(ior, roughness);
        for (side, mu) in [
            (Side::Outside, 0.9),
            (Side::Outside, 0.15),
            (Side::Inside, -0.95),
            (Side::Inside, -0.5),
            (Side::Inside, -0.08),
        ] {
            check_sampling(&format!("glass {ior} {roughness} {mu}"), &surface.bsdf(direction(mu), side));
        }
    }
}

#[test]
fn lambert_exit_is_a_cosine_hemisphere() {
    check_sampling("exit", &Bsdf::lambert_exit());
    let exit = Bsdf::lambert_exit();
    assert!((exit.eval(Vec3::Z).x - 1.0 / std::f32::consts::PI).abs() < 1e-6);
    assert_eq!(exit.eval(-Vec3::Z), Rgb::ZERO);
    let s = exit.sample(0.5, Vec2::new(0.3, 0.8)).unwrap();
    assert!(s.event == Event::Transmit && !s.delta && s.wi.z > 0.0);
}

/// The chi-square of this file notices a pdf that is wrong by 2 %, as a whole or in its shape.
#[test]
fn chi_square_notices_two_percent() {
    let bsdf = glass(1.5, 0.35).bsdf(direction(0.9), Side::Outside);
    let (pdf, _) = integrate(&bsdf);
    let mut counts = vec![0.0; pdf.len()];
    for i in 0..SAMPLES {
        let mut sampler = Sampler::new(2, 0, i as u32);
        let u = sampler.random();
        if let Some(s) = bsdf.sample(u, Vec2::new(sampler.random(), sampler.random())) {
            counts[bin(s.wi)] += 1.0;
        }
    }
    let n = SAMPLES as f64;
    let expected =
        |scale: &dyn Fn(usize) -> f64| -> Vec<f64> { pdf.iter().enumerate().map(|(i, p)| p * n * scale(i)).collect() };
    assert!(against(&counts, &expected(&|_| 1.0), n) < 4.5);
    assert!(against(&counts, &expected(&|_| 1.02), n) > 6.0);
    assert!(against(&counts, &expected(&|_| 0.98), n) > 6.0);
    assert!(against(&counts, &expected(&|i| 1.0 + 0.04 * (i % 2) as f64 - 0.02), n) > 6.0);
}

// ---- energy ---------------------------------------------------------------------------------------------------

/// Power that leaves for unit power from `wo`: radiance scaling taken out by eta^2 of what is crossed.
fn albedo(bsdf: &Bsdf, transmit: f32) -> Rgb {
    const N: u32 = 1 << 15;
    let mut sum = glam::DVec3::ZERO;
    for i in 0..N {
        let mut sampler = Sampler::new(3, 0, i);
        let u = sampler.next_1d();
        if let Some(s) = bsdf.sample(u, sampler.next_2d()) {
            let scale = if s.event == Event::Transmit { transmit } else { 1.0 };
            sum += (s.f * (scale / s.pdf)).as_dvec3();
        }
    }
    (sum / f64::from(N)).as_vec3()
}

const COSINES: [f32; 6] = [1.0, 0.8, 0.5, 0.25, 0.1, 0.02];

#[test]
fn dielectrics_conserve_energy() {
    for ior in [1.0001, 1.05, 1.33, 1.5, 2.4, 0.8] {
        for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
            let surface = glass(ior, roughness);
            for mu in COSINES {
                let outside = albedo(&surface.bsdf(direction(mu), Side::Outside), ior * ior);
                let inside = albedo(&surface.bsdf(direction(-mu), Side::Inside), 1.0 / (ior * ior));
                for (side, e) in [("outside", outside), ("inside", inside)] {
                    assert!((e - 1.0).abs().max_element() < 3e-3, "{ior} {roughness} {mu} {side}: {e}");
                }
            }
        }
    }
}

#[test]
fn white_layers_reflect_everything() {
    let white = [1.0; 3];
    for roughness in [0.0, 0.2, 0.5, 1.0] {
        let surfaces = [
            openpbr(OpenPbrSurface {
                base_color: white,
                specular_roughness: roughness,
                base_diffuse_roughness: roughness,
                coat_weight: 0.5,
                coat_roughness: 0.3,
                ..Default::default()
            }),
            openpbr(OpenPbrSurface {
                base_color: white,
                base_metalness: 1.0,
                specular_roughness: roughness,
                ..Default::default()
            }),
            openpbr(OpenPbrSurface {
                subsurface_weight: 0.6,
                base_color: white,
                specular_roughness: roughness,
                geometry_opacity: 0.7,
                ..Default::default()
            }),
            standard(StandardSurface {
                subsurface: 1.0,
                specular: 0.6,
                specular_roughness: roughness,
                specular_ior: 1.8,
                ..Default::default()
            }),
            preview(PreviewSurface { subsurface: 1.0, roughness, clearcoat: 0.5, opacity: 0.6, ..Default::default() }),
        ];
        for (i, surface) in surfaces.iter().enumerate() {
            for mu in COSINES {
                let e = albedo(&surface.bsdf(direction(mu), Side::Outside), 1.0);
                assert!((e - 1.0).abs().max_element() < 3e-3, "surface {i}, roughness {roughness}, {mu}: {e}");
            }
        }
    }
}

#[test]
fn nothing_reflects_more_than_it_gets() {
    for (name, surface) in opaque_surfaces() {
        for mu in COSINES {
            let e = albedo(&surface.bsdf(direction(mu), Side::Outside), 2.25);
            assert!(e.max_element() < 1.0 + 3e-3, "{name} {mu}: {e}");
        }
    }
    for (roughness, metallic, specular_workflow) in [(0.001, 0.0, 0), (0.3, 0.0, 0), (0.6, 1.0, 0), (1.0, 0.3, 1)] {
        let surface = preview(PreviewSurface {
            diffuse_color: Some([1.0; 3]),
            use_specular_workflow: specular_workflow,
            specular_color: [0.5; 3],
            roughness,
            metallic,
            clearcoat: 1.0,
            clearcoat_roughness: 0.3,
            ..Default::default()
        });
        for mu in COSINES {
            let e = albedo(&surface.bsdf(direction(mu), Side::Outside), 1.0);
            assert!(e.max_element() < 1.0 + 3e-3, "white storm {roughness} {mu}: {e}");
        }
    }
}

/// Storm's formula, written down again, to the digit where it conserves energy.
#[test]
fn preview_surface_is_storms() {
    let (color, metallic, roughness, ior) = (Rgb::new(0.6, 0.3, 0.1), 0.25_f32, 0.5_f32, 1.5_f32);
    let surface = preview(PreviewSurface {
        diffuse_color: Some(color.to_array()),
        metallic,
        roughness,
        ior,
        ..Default::default()
    });
    let r = (1.0 - ior) / (1.0 + ior);
    for (wo, wi) in [(0.9, 0.7), (0.6, 0.95), (0.8, 0.3)].map(|(o, i)| {
        let sin = (1.0_f32 - i * i).sqrt();
        (direction(o), Vec3::new(-sin, 0.0, i))
    }) {
        let h = (wo + wi).normalize();
        let fresnel = (1.0 - wo.dot(h)).powi(5);
        let specular = Rgb::ONE.lerp(color, metallic);
        let f = (r * r * specular).lerp(specular, metallic).lerp(specular, fresnel);
        let a2 = roughness.powi(4);
        let d = a2 / (std::f32::consts::PI * (h.z * h.z * (a2 - 1.0) + 1.0).powi(2));
        let k = 0.5 * roughness * roughness;
        let g = |c: f32| c / (c * (1.0 - k) + k);
        let glossy = f * (d * g(wo.z) * g(wi.z) / (4.0 * wo.z * wi.z));
        let diffuse = color * (1.0 - metallic) / std::f32::consts::PI * (Rgb::ONE - f);
        let expected = (glossy + diffuse) * wi.z;
        let got = surface.bsdf(wo, Side::Outside).eval(wi);
        assert!((got - expected).abs().max_element() < 1e-4 * expected.max_element(), "{got} {expected}");
    }
}

/// A diffuse base with nothing above it is reciprocal.
#[test]
fn diffuse_is_reciprocal() {
    let surface = standard(StandardSurface { specular: 0.0, diffuse_roughness: 0.7, ..Default::default() });
    for (a, b) in [(0.9, 0.2), (0.5, 0.4), (0.05, 0.99)] {
        let (a, b) = (direction(a), direction(b) * Vec3::new(1.0, -1.0, 1.0));
        let forth = surface.bsdf(a, Side::Outside).eval(b) / b.z;
        let back = surface.bsdf(b, Side::Outside).eval(a) / a.z;
        assert!((forth - back).abs().max_element() < 1e-5, "{forth} {back}");
    }
}

// ---- events, opacity, media -----------------------------------------------------------------------------------

#[test]
fn smooth_glass_refracts_by_snell_and_fresnel() {
    let bsdf = glass(1.5, 0.0).bsdf(Vec3::Z, Side::Outside);
    assert!(bsdf.is_delta_only());
    let reflected = bsdf.sample(0.01, Vec2::splat(0.5)).unwrap();
    assert!(reflected.event == Event::Reflect && (reflected.pdf - 0.04).abs() < 1e-6);
    let transmitted = bsdf.sample(0.5, Vec2::splat(0.5)).unwrap();
    assert_eq!(transmitted.event, Event::Transmit);
    assert!((transmitted.f / transmitted.pdf - 1.0 / 2.25).abs().max_element() < 1e-5);
    // From inside beyond the critical angle: reflection only.
    let total = glass(1.5, 0.0).bsdf(direction(-0.5), Side::Inside).sample(0.999, Vec2::splat(0.5)).unwrap();
    assert!(total.event == Event::Reflect && total.wi.z < 0.0 && total.f / total.pdf == Rgb::ONE);
}

#[test]
fn index_matched_goes_straight() {
    let material = Material::UsdPreviewSurface(PreviewSurface { subsurface: 1.0, ..Default::default() });
    let surface = compile(material, Some(Boundary::IndexMatched));
    assert_eq!(surface.interior().unwrap().eta, 1.0);
    for (wo, side) in [(direction(0.3), Side::Outside), (direction(-0.3), Side::Inside)] {
        let s = surface.bsdf(wo, side).sample(0.7, Vec2::splat(0.2)).unwrap();
        assert!((s.wi + wo).length() < 1e-6 && s.f / s.pdf == Rgb::ONE && s.event == Event::Transmit && s.delta);
    }
}

#[test]
fn entry_is_a_cosine_below_the_specular_lobe() {
    let surface = openpbr(OpenPbrSurface { subsurface_weight: 1.0, ..Default::default() });
    let bsdf = surface.bsdf(direction(0.7), Side::Outside);
    let (mut entered, mut sum, mut mean_z) = (0, 0.0, 0.0);
    for i in 0..10_000 {
        let mut sampler = Sampler::new(4, 0, i);
        let u = sampler.next_1d();
        let Some(s) = bsdf.sample(u, sampler.next_2d()) else { continue };
        if s.event == Event::EnterSubsurface {
            assert!(s.delta && s.wi.z <= 0.0);
            (entered, sum, mean_z) = (entered + 1, sum + f64::from((s.f / s.pdf).x), mean_z + f64::from(s.wi.z));
        }
    }
    assert!((mean_z / f64::from(entered) + 2.0 / 3.0).abs() < 5e-3);
    let weight = sum / 10_000.0;
    assert!(weight > 0.93 && weight < 0.97, "1 - E(0.7) of ior 1.5: {weight}");
    // From below it is the Lambertian exit.
    let exit = surface.bsdf(direction(-0.7), Side::Inside);
    assert_eq!(exit.eval(Vec3::Z), Bsdf::lambert_exit().eval(Vec3::Z));
}

/// What leaves per unit that arrives, by whether it enters, over all samples.
fn shares(bsdf: &Bsdf) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for i in 0..40_000 {
        let mut sampler = Sampler::new(6, 0, i);
        let u = sampler.next_1d();
        let Some(s) = bsdf.sample(u, sampler.next_2d()) else { continue };
        sums[usize::from(s.event == Event::EnterSubsurface)] += f64::from((s.f / s.pdf).x);
    }
    sums.map(|sum| sum / 40_000.0)
}

#[test]
fn what_is_reflected_and_what_enters_are_the_whole() {
    let skin = |roughness, coat| {
        openpbr(OpenPbrSurface {
            subsurface_weight: 0.7,
            specular_roughness: roughness,
            coat_weight: coat,
            ..Default::default()
        })
    };
    for (surface, mu) in [(skin(0.3, 0.0), 0.9), (skin(0.3, 0.0), 0.15), (skin(0.0, 0.0), 0.5), (skin(0.4, 0.8), 0.4)] {
        let whole = surface.bsdf(direction(mu), Side::Outside);
        let (reflecting, chance, entering) = whole.parted().expect("it reflects, and is entered");
        assert!(chance > 0.0 && chance < 1.0);
        check_sampling("reflecting", &reflecting);
        for wi in [direction(0.2), direction(0.6), direction(0.99)] {
            assert_eq!(reflecting.eval(wi), whole.eval(wi));
        }
        let ([reflected, entered], [alone, _], [_, below]) = (shares(&whole), shares(&reflecting), shares(&entering));
        assert!(
            (reflected - alone).abs() < 2e-3 && (entered - below).abs() < 2e-3,
            "{reflected} {entered}: {alone} {below}"
        );
    }
    let see_through = preview(PreviewSurface { opacity: 0.5, subsurface: 1.0, ..Default::default() });
    assert!(see_through.bsdf(direction(0.5), Side::Outside).parted().is_none());
    assert!(glass(1.5, 0.2).bsdf(direction(0.5), Side::Outside).parted().is_none());
}

#[test]
fn opacity_follows_its_mode() {
    let with = |mode: &str, threshold: f32, opacity: f32| {
        preview(PreviewSurface {
            opacity,
            opacity_mode: mode.to_owned().into(),
            opacity_threshold: threshold,
            ..Default::default()
        })
    };
    assert_eq!(with("presence", 0.0, 0.25).transparency(0.5), Rgb::splat(0.75));
    assert_eq!(with("transparent", 0.5, 0.4).transparency(0.5), Rgb::ONE);
    assert!(with("transparent", 0.5, 0.5).is_opaque());
    let kept = with("transparent", 0.0, 0.0).transparency(1.0);
    assert!(kept.max_element() < 0.97 && kept.min_element() > 0.9, "specular is kept: {kept}");
    // The weight of PassThrough is the transparency, whichever lobes there are.
    for surface in [with("transparent", 0.0, 0.3), with("presence", 0.0, 0.3)] {
        let bsdf = surface.bsdf(direction(0.4), Side::Outside);
        let pass = |i: u32| {
            let mut sampler = Sampler::new(5, 0, i);
            let u = sampler.next_1d();
            let s = bsdf.sample(u, sampler.next_2d())?;
            (s.event == Event::PassThrough).then_some(f64::from((s.f / s.pdf).x))
        };
        let mean = (0..20_000).filter_map(pass).sum::<f64>() / 20_000.0;
        assert!((mean - f64::from(surface.transparency(0.4).x)).abs() < 2e-3, "{mean}");
    }
}

/// The looks of one stage: same medium, same boundary, same reflection.
#[test]
fn shaders_agree_on_one_medium() {
    let (color, roughness, ior) = ([0.8, 0.46, 0.34], 0.42, 1.4);
    let looks = [
        preview(PreviewSurface {
            diffuse_color: Some(color),
            ior,
            roughness,
            subsurface: 1.0,
            subsurface_color: color,
            subsurface_radius: [0.367, 0.137, 0.068],
            subsurface_scale: 0.25,
            ..Default::default()
        }),
        openpbr(OpenPbrSurface {
            specular_ior: ior,
            specular_roughness: roughness,
            subsurface_color: color,
            subsurface_radius: 0.09175,
            subsurface_radius_scale: [1.0, 0.373_297, 0.185_286_1],
            subsurface_weight: 1.0,
            ..Default::default()
        }),
        standard(StandardSurface {
            specular_ior: ior,
            specular_roughness: roughness,
            subsurface: 1.0,
            subsurface_color: color,
            subsurface_radius: [0.367, 0.137, 0.068],
            subsurface_scale: 0.25,
            ..Default::default()
        }),
    ];
    let [a, b, c] = looks.map(|l| l.interior().unwrap());
    assert_eq!(a.albedo, InteriorAlbedo::Color(Rgb::from(color)));
    for other in [b, c] {
        assert!((a.radius - other.radius).abs().max_element() < 1e-6);
        assert_eq!(
            (a.boundary, a.eta, a.alpha, a.albedo, a.g),
            (other.boundary, other.eta, other.alpha, other.albedo, other.g)
        );
    }
    for mu in COSINES {
        let [a, b, c] = looks.map(|l| l.bsdf(direction(mu), Side::Outside));
        for wi in [direction(0.9), direction(0.3) * Vec3::new(-1.0, -1.0, 1.0)] {
            assert_eq!((a.eval(wi), a.pdf(wi)), (b.eval(wi), b.pdf(wi)));
            assert_eq!((a.eval(wi), a.pdf(wi)), (c.eval(wi), c.pdf(wi)));
        }
    }
}

/// backlit_bunny: its transmission look describes the mean free path of its subsurface looks.
#[test]
fn transmission_gives_mean_free_path_and_albedo() {
    let surface = openpbr(OpenPbrSurface {
        specular_ior: 1.4,
        specular_roughness: 0.0,
        transmission_weight: 1.0,
        transmission_color: [0.188_875_6, 0.286_504_8, 0.367_879_45],
        transmission_depth: 0.2,
        transmission_scatter: [1.616_666_7, 1.23125, 0.99],
        ..Default::default()
    });
    let interior = surface.interior().unwrap();
    assert!((interior.radius - Rgb::new(0.12, 0.16, 0.2)).abs().max_element() < 1e-5, "{}", interior.radius);
    let InteriorAlbedo::Single(albedo) = interior.albedo else { panic!("{:?}", interior.albedo) };
    assert!((albedo - Rgb::new(0.97, 0.985, 0.99)).abs().max_element() < 1e-5, "{albedo}");
    assert_eq!((interior.boundary, interior.eta), (Boundary::Dielectric, 1.4));
}

// ---- bad numbers ----------------------------------------------------------------------------------------------

/// Every combination of extremes, at normal, oblique and exactly grazing sight: finite, unit, not negative.
#[test]
fn extremes_stay_finite() {
    for ior in [0.02, 0.8, 1.0, 1.0001, 1.001, 1.5, 2.4, 50.0] {
        for roughness in [0.0, 0.03, 0.04, 0.5, 1.0] {
            let surfaces = [
                glass(ior, roughness),
                preview(PreviewSurface { ior, roughness, clearcoat: 1.0, metallic: 0.5, ..Default::default() }),
                openpbr(OpenPbrSurface {
                    specular_ior: ior,
                    specular_roughness: roughness,
                    base_metalness: 0.5,
                    coat_weight: 1.0,
                    subsurface_weight: 0.5,
                    ..Default::default()
                }),
                standard(StandardSurface {
                    specular_ior: ior,
                    specular_roughness: roughness,
                    base_color: [1.0, 0.0, 0.5],
                    metalness: 0.5,
                    ..Default::default()
                }),
            ];
            surfaces.iter().for_each(check_finite);
        }
    }
}

fn check_finite(surface: &Surface) {
    for mu in [1.0, 0.3, 1e-4, 1e-7, 0.0] {
        for (wo, side) in [(direction(mu), Side::Outside), (direction(-mu), Side::Inside)] {
            let bsdf = surface.bsdf(wo, side);
            for i in 0..200 {
                let mut sampler = Sampler::new(6, 0, i);
                let u = sampler.next_1d();
                let Some(s) = bsdf.sample(u, sampler.next_2d()) else { continue };
                let weight = s.f / s.pdf;
                assert!(weight.is_finite() && weight.min_element() >= 0.0 && s.pdf > 0.0, "{surface:?} {wo}: {s:?}");
                assert!((s.wi.length() - 1.0).abs() < 1e-4, "{s:?}");
            }
            for wi in [Vec3::Z, -Vec3::Z, Vec3::X, wo, -wo, Vec3::new(-wo.x, -wo.y, wo.z)] {
                let (f, pdf) = (bsdf.eval(wi), bsdf.pdf(wi));
                assert!(f.is_finite() && pdf.is_finite() && pdf >= 0.0, "{surface:?} {wo} {wi}: {f} {pdf}");
            }
        }
    }
}

#[test]
fn bad_inputs_are_clamped_and_named() {
    let bad = PreviewSurface {
        diffuse_color: Some([f32::NAN, 2.0, -1.0]),
        roughness: -0.5,
        ior: f32::INFINITY,
        subsurface: 3.0,
        subsurface_color: [1.5, 0.5, f32::NAN],
        subsurface_radius: [-1.0, f32::NAN, 2.0],
        subsurface_anisotropy: 1.0,
        subsurface_boundary: "glas".into(),
        opacity_mode: "".into(),
        ..Default::default()
    };
    let mut warnings = Vec::new();
    let material = Material::UsdPreviewSurface(bad);
    let surface = Surface::compile(&material, None, 1.0, None, "/World/Looks/Bad", &mut warnings);
    for name in [
        "inputs:diffuseColor",
        "inputs:roughness",
        "inputs:ior",
        "inputs:subsurface ",
        "inputs:subsurfaceColor",
        "inputs:subsurfaceRadius",
        "inputs:subsurfaceAnisotropy",
        "inputs:subsurfaceBoundary",
        "inputs:opacityMode",
    ] {
        assert!(
            warnings.iter().any(|w| w.message.contains(name) && w.prim == "/World/Looks/Bad"),
            "{name}: {warnings:?}"
        );
    }
    let interior = surface.interior().unwrap();
    assert!(interior.radius.min_element() > 0.0 && interior.radius.is_finite() && interior.g.abs() < 1.0);
    check_finite(&surface);
}

#[test]
fn a_medium_without_length_is_a_diffuse_surface() {
    let material = Material::UsdPreviewSurface(PreviewSurface {
        subsurface: 1.0,
        subsurface_color: [0.5; 3],
        subsurface_radius: [0.0; 3],
        ior: 1.0,
        ..Default::default()
    });
    let mut warnings = Vec::new();
    let surface = Surface::compile(&material, None, 1.0, None, "/M", &mut warnings);
    assert!(surface.interior().is_none() && warnings.len() == 1, "{warnings:?}");
    let f = surface.bsdf(Vec3::Z, Side::Outside).eval(Vec3::Z);
    assert!((f - 0.5 / std::f32::consts::PI).abs().max_element() < 1e-6, "{f}");
}
