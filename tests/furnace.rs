//! White furnace: a body that absorbs nothing, in light of radiance 1 from everywhere, is invisible.

mod support;

use dermis::delegate::DirtyBits;
use dermis::flat::{Material, OpenPbrSurface, PreviewSurface, Prim, RenderSettings};
use glam::DVec3;
use support::slab::judge;
use support::{camera, channel, furnace, mean_and_error, plane, render, scene, settings, sphere};

fn white(boundary: &str, roughness: f32, g: f32, radius: [f32; 3]) -> Material {
    Material::UsdPreviewSurface(PreviewSurface {
        subsurface: 1.0,
        subsurface_color: [1.0; 3],
        subsurface_radius: radius,
        subsurface_anisotropy: g,
        subsurface_boundary: boundary.to_owned().into(),
        roughness,
        ior: 1.4,
        ..PreviewSurface::default()
    })
}

/// The camera sees only the body; every pixel estimates 1.
fn furnace_radiance(boundary: &str, roughness: f32, g: f32) -> Vec<(f64, f64)> {
    let material = white(boundary, roughness, g, [0.01, 0.1, 1.0]);
    let mut delegate = scene(sphere(24, 1.0), material, vec![furnace()], camera(DVec3::new(0.0, 0.0, 8.0), 7.0));
    let planes = render(&mut delegate, settings(16, 64));
    let stats = delegate.stats();
    assert_eq!((&stats["non_finite_samples"], &stats["walks_too_long"]), (&0.into(), &0.into()));
    (0..3).map(|c| mean_and_error(&channel(plane(&planes, "color"), c))).collect()
}

#[test]
fn white_bodies_vanish() {
    for boundary in ["diffuse", "indexMatched", "dielectric"] {
        for g in [-0.4, 0.0, 0.5, 0.8] {
            for roughness in [0.0, 0.3] {
                for (c, (mean, error)) in furnace_radiance(boundary, roughness, g).into_iter().enumerate() {
                    // 72 numbers: 4.5 standard errors; 1e-4 for leaked walks.
                    eprintln!("{boundary} roughness {roughness} g {g} channel {c}: {mean:.5} +- {error:.5}");
                    assert!(
                        (mean - 1.0).abs() < 4.5 * error + 1e-4,
                        "{boundary} {roughness} g {g} {c}: {mean} +- {error}"
                    );
                }
            }
        }
    }
}

/// Whatever a walk follows and however it is weighted.
#[test]
fn white_bodies_vanish_in_every_walk() {
    let (eye, mut numbers) = (|| camera(DVec3::new(0.0, 0.0, 8.0), 7.0), Vec::new());
    for boundary in ["diffuse", "dielectric"] {
        let material = white(boundary, 0.0, 0.0, [0.4, 0.5, 0.6]);
        let mut delegate = scene(sphere(24, 1.0), material, vec![furnace()], eye());
        for walk in ["poe", "cp", "ii", "bono", "bill", "mixture"] {
            for pdf in ["conditional", "exact"] {
                if (walk, pdf) == ("ii", "exact") {
                    continue; // its normals are not known beforehand
                }
                let seed = numbers.len() as u32;
                let asked = RenderSettings { walk: walk.into(), walk_pdf: pdf.into(), seed, ..settings(16, 64) };
                let planes = render(&mut delegate, asked);
                let stats = delegate.stats();
                assert_eq!((&stats["non_finite_samples"], &stats["walks_too_long"]), (&0.into(), &0.into()));
                assert_eq!(stats["guide"]["media"][0]["walk"], walk);
                for c in 0..3 {
                    let (mean, error) = mean_and_error(&channel(plane(&planes, "color"), c));
                    eprintln!("{boundary} {walk} {pdf} channel {c}: {mean:.5} +- {error:.5}");
                    assert!(error < 0.02, "{boundary} {walk} {pdf} {c}: {mean} +- {error}");
                    numbers.push((format!("{boundary} {walk} {pdf} {c}: {mean} +- {error}"), (mean - 1.0) / error));
                }
            }
        }
    }
    judge("furnace", numbers);
}

/// Clear glass in clear glass, off centre: every path leaves what it entered, whatever order.
#[test]
fn nested_glass_vanishes() {
    let glass = |ior| {
        Material::OpenPbr(OpenPbrSurface { transmission_weight: 1.0, specular_ior: ior, ..OpenPbrSurface::default() })
    };
    for inner_ior in [1.0001, 1.5] {
        let eye = camera(DVec3::new(0.0, 0.0, 8.0), 7.0);
        let mut delegate = scene(sphere(24, 1.0), glass(1.5), vec![furnace()], eye);
        let mut inner = sphere(16, 0.5);
        inner.material = "/Inner".into();
        inner.transform[3] = [0.1, 0.2, 0.3, 1.0];
        delegate.sync("/I", Prim::Mesh(inner), DirtyBits::ALL);
        delegate.sync("/Inner", Prim::Material(glass(inner_ior)), DirtyBits::ALL);
        let planes = render(&mut delegate, settings(24, 64));
        let (mean, error) = mean_and_error(&channel(plane(&planes, "color"), 1));
        // Beyond the noise: faces tilt at the silhouettes of flat triangles, and depth is limited.
        assert!((mean - 1.0).abs() < 4.5 * error + 5e-3, "inner ior {inner_ior}: {mean} +- {error}");
    }
}
