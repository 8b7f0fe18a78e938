//! Path densities of the mixture against products over vertices in f64, and what rests on them: density ratios that
//! average to one, control variates, weights of thick slabs.

mod support;

use dermis::guiding::control::Controls;
use dermis::guiding::statistics::ControlSums;
use dermis::math::{Frame, Rgb};
use dermis::medium::{Medium, phase_sample};
use dermis::sampling::sampler::Sampler;
use dermis::subsurface::mixture::{Visitor, walk_mixture};
use dermis::subsurface::steps::{Enclosure, Start, WalkEnd, WalkStats};
use dermis::subsurface::technique::{At, GuidedMedium, LANES, PerTechnique, Prefix, TECHNIQUES, Technique, Techniques};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use support::in_f64::{Eigenfunction, Product};
use support::slab::{Beam, Estimate, Slab, guided_rows, judge, z_limit};
use support::ways::{Way, exact_walk, go};

fn random_direction(sampler: &mut Sampler) -> Vec3 {
    dermis::sampling::uniform_sphere(Vec2::new(sampler.random(), sampler.random()))
}

fn techniques(guided_first: bool, sampler: &mut Sampler) -> Techniques {
    let mut techniques = Techniques { guided_first, ..Techniques::default() };
    (0..LANES).for_each(|lane| techniques.set_normal(lane, random_direction(sampler)));
    let share = |sampler: &mut Sampler| 0.05 + sampler.random();
    let mut shares = PerTechnique::default();
    for c in 0..3 {
        shares.classical[c] = share(sampler);
        shares.guided[c].iter_mut().for_each(|s| *s = share(sampler));
    }
    techniques.shares = shares.scaled(1.0 / shares.sum());
    techniques
}

/// Errors along one path of `length` collisions that one of the techniques draws: at boundaries, at collisions, of the
/// pdf of the next direction.
fn errors_along(medium: &GuidedMedium, guided_first: bool, length: u32, seed: u32) -> [f64; 3] {
    let mut sampler = Sampler::new(seed, 0, 0);
    let techniques = techniques(guided_first, &mut sampler);
    let drawn = techniques.choose(sampler.random());
    let functions = [0, 1, 2].map(|c| {
        let kernel = &medium.kernels[c];
        Eigenfunction::new(f64::from(kernel.kappa), f64::from(kernel.alpha_hat), f64::from(medium.medium.g))
    });
    let mut w = random_direction(&mut sampler);
    let mut prefix = Prefix::new(w);
    let mut product = Product {
        medium,
        techniques: &techniques,
        functions: &functions,
        p: [0.0; TECHNIQUES],
        f: DVec3::ZERO,
        collisions: 0,
    };
    let mut worst = [0.0_f64; 3];
    for _ in 0..=length {
        let rate = product.rate(drawn.channel, drawn.lane, w) as f32;
        let t = f64::from(-sampler.random_open().ln() / rate);
        product.pass(w, t);
        prefix.travel(t * f64::from(medium.scale));
        worst[0] = worst[0].max(product.error(&prefix, At::Boundary));
        product.collide(w);
        prefix.collisions += 1;
        worst[1] = worst[1].max(product.error(&prefix, At::Collision));
        let wi = turn(medium, &techniques, drawn, w, &mut sampler);
        let (before, densities) = (product.p, techniques.densities(medium, &prefix, At::Collision));
        product.turn(w, wi);
        let pdf = techniques.direction_pdf(medium, &prefix, &densities, 1.0, wi);
        worst[2] = worst[2].max((f64::from(pdf) / product.direction_pdf(&before) - 1.0).abs());
        (w, prefix.last) = (wi, wi);
    }
    worst
}

fn turn(medium: &GuidedMedium, techniques: &Techniques, drawn: Technique, w: Vec3, sampler: &mut Sampler) -> Vec3 {
    match drawn.lane {
        Some(lane) => medium.kernels[drawn.channel].sample(&Frame::from_normal(techniques.normal(lane)), w, sampler),
        None => phase_sample(medium.medium.g, w, Vec2::new(sampler.random(), sampler.random())),
    }
}

/// sigma_t and albedo of media whose channels are alike, differ in albedo, in sigma_t, in both.
const MEDIA: [(Rgb, Rgb); 4] = [
    (Rgb::ONE, Rgb::splat(0.99)),
    (Rgb::ONE, Rgb::new(0.05, 0.5, 1.0)),
    (Rgb::new(1.0, 10.0, 100.0), Rgb::new(0.8, 0.95, 0.999)),
    (Rgb::new(300.0, 20.0, 3.0), Rgb::new(0.3, 0.9, 0.99)),
];

const GS: [f32; 4] = [0.0, 0.5, 0.8, -0.4];

/// Weights, density ratios and pdfs of directions over a thousand collisions: f32 holds them to 1e-5.
#[test]
fn densities_are_products_over_vertices() {
    for (case, (sigma_t, albedo)) in MEDIA.into_iter().enumerate() {
        for g in GS {
            let medium = GuidedMedium::new(Medium { sigma_t, albedo, g });
            for guided_first in [true, false] {
                let paths =
                    (0..16).into_par_iter().map(|i| errors_along(&medium, guided_first, 1000, case as u32 * 16 + i));
                let errors: Vec<[f64; 3]> = paths.collect();
                let worst = [0, 1, 2].map(|k| errors.iter().map(|e| e[k]).fold(0.0, f64::max));
                let label = format!("{sigma_t} {albedo} g {g} guided_first {guided_first}");
                eprintln!("{label}: boundary {:.1e} collision {:.1e} direction {:.1e}", worst[0], worst[1], worst[2]);
                assert!(worst.iter().all(|e| *e < 1e-5), "{label}: {worst:?}");
            }
        }
    }
}

/// A slab whose far face is missing.
struct Open(Slab);

impl Enclosure for Open {
    type Hit = bool;

    fn cast(&self, p: Vec3, d: Vec3, t_max: f32, from: Option<bool>) -> Option<(f32, bool)> {
        self.0.cast(p, d, t_max, from).filter(|(_, top)| *top)
    }

    fn bounds_contain(&self, p: Vec3) -> bool {
        self.0.bounds_contain(p)
    }

    fn position_error(&self) -> f32 {
        self.0.position_error()
    }
}

/// No light at collisions, or light of no account.
struct Blind<const LIT: bool>;

impl<const LIT: bool> Visitor for Blind<LIT> {
    const AT_COLLISIONS: bool = LIT;
}

/// How walks of a case end.
#[derive(Default)]
struct Ends {
    lit: usize,
    far: usize,
    killed: usize,
    leaked: usize,
}

/// Means of the density ratios over walks into `enclosure` that carry `carried`.
fn ratios<E: Enclosure<Hit = bool>, const LIT: bool>(
    enclosure: &E,
    medium: &GuidedMedium,
    techniques: &Techniques,
    carried: Rgb,
    walks: u32,
    seed: u32,
) -> ([[f64; 2]; TECHNIQUES], Ends) {
    let (mut sums, mut ends) = ([[0.0; 2]; TECHNIQUES], Ends::default());
    for i in 0..walks {
        let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
        let d = Beam::Diffuse.direction(&mut sampler);
        let start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: carried };
        let u = sampler.next_1d();
        let stats = &mut WalkStats::default();
        let end = walk_mixture(enclosure, medium, *techniques, start, u, &mut sampler, stats, &mut Blind::<LIT>);
        match end.end {
            WalkEnd::Boundary { hit, .. } => *(if hit { &mut ends.lit } else { &mut ends.far }) += 1,
            WalkEnd::Absorbed => ends.killed += 1,
            _ => ends.leaked += 1,
        }
        for (sum, r) in sums.iter_mut().zip(end.densities.ratios().as_list().map(f64::from)) {
            sum[0] += r;
            sum[1] += r * r;
        }
    }
    (sums, ends)
}

/// Whatever ends a walk - a boundary, roulette, a leak - the density ratio of every technique averages to one.
#[test]
fn density_ratios_average_to_one() {
    const WALKS: u32 = 20_000;
    let slab = |thickness| Slab { thickness };
    let carried = [Rgb::ONE, Rgb::new(1.0, 0.3, 0.1)];
    let mut cases = Vec::new();
    for (medium, thickness) in [
        // Gray: little, much and no absorption.
        ((Rgb::ONE, Rgb::splat(0.99)), 10.0),
        ((Rgb::ONE, Rgb::splat(0.8)), 50.0),
        ((Rgb::ONE, Rgb::splat(0.3)), 30.0),
        ((Rgb::ONE, Rgb::ONE), 20.0),
        (MEDIA[1], 30.0),
        (MEDIA[2], 2.0),
        (MEDIA[3], 0.5),
    ] {
        for g in [0.0, 0.8, -0.4] {
            for carried in carried {
                for (normals, classical, guided_first) in [(1, 0.2, true), (4, 0.1, true), (8, 0.1, false)] {
                    cases.push((
                        medium,
                        thickness,
                        g,
                        carried,
                        support::ways::mixture(normals, classical, guided_first),
                    ));
                }
            }
        }
    }
    let killed = std::sync::atomic::AtomicUsize::new(0);
    let leaked = std::sync::atomic::AtomicUsize::new(0);
    type Case = ((Rgb, Rgb), f32, f32, Rgb, Techniques);
    let case = |(seed, case): (usize, &Case)| {
        let ((sigma_t, albedo), thickness, g, carried, techniques) = *case;
        let medium = GuidedMedium::new(Medium { sigma_t, albedo, g });
        let seed = seed as u32;
        let (open, lit) = (seed % 4 == 1, seed % 4 == 2);
        let (sums, ends) = match (open, lit) {
            (true, _) => ratios::<_, false>(&Open(slab(thickness)), &medium, &techniques, carried, WALKS, seed),
            (_, true) => ratios::<_, true>(&slab(thickness), &medium, &techniques, carried, WALKS / 4, seed),
            _ => ratios::<_, false>(&slab(thickness), &medium, &techniques, carried, WALKS, seed),
        };
        let n = if lit { WALKS / 4 } else { WALKS };
        killed.fetch_add(usize::from(ends.killed > WALKS as usize / 4), std::sync::atomic::Ordering::Relaxed);
        leaked.fetch_add(usize::from(ends.leaked > WALKS as usize / 4), std::sync::atomic::Ordering::Relaxed);
        let shares = techniques.tilted(carried).shares.as_list();
        // Rarer techniques have ratios in the hundreds a few times in all.
        let z = |t: usize| {
            let [sum, squares] = sums[t].map(|x| x / f64::from(n));
            let error = ((squares - sum * sum).max(0.0) / f64::from(n) + 1e-11).sqrt();
            let label = format!(
                "technique {t} of {sigma_t} {albedo} g {g} thickness {thickness} carried {carried} open {open} lit {lit} seed {seed}: {sum}"
            );
            (label, (sum - 1.0) / error)
        };
        (0..TECHNIQUES).filter(|&t| shares[t] * n as f32 > 100.0).map(z).collect::<Vec<_>>()
    };
    let z: Vec<(String, f64)> = cases.par_iter().enumerate().map(case).flatten().collect();
    judge("density ratios", z);
    let (killed, leaked) = (killed.into_inner(), leaked.into_inner());
    eprintln!("{} cases, more than a quarter of the walks killed in {killed}, leaked in {leaked}", cases.len());
    assert!(killed >= 5 && leaked >= 5, "roulette and leaks are hardly tested: {killed}, {leaked}");
}

/// Control variates fitted to some walks leave the mean of others as it is, and take from their variance.
#[test]
fn controls_keep_the_mean() {
    const WALKS: u32 = 40_000;
    let rows = guided_rows();
    let mut cases = Vec::new();
    for (g, alpha, tau) in [
        (0.0, 0.95, 10.0),
        (0.0, 0.99, 10.0),
        (0.0, 0.8, 50.0),
        (0.5, 0.95, 1.0),
        (-0.4, 0.999, 10.0),
        (0.8, 0.5, 10.0),
        (0.0, 0.05, 1.0),
    ] {
        for way in [
            Way::Exact { normals: 2, classical: 0.1, guided_first: true },
            Way::Exact { normals: 4, classical: 0.2, guided_first: false },
        ] {
            cases.push((g, alpha, tau, way));
        }
    }
    let case = |(seed, &(g, alpha, tau, way)): (usize, &(f32, f32, f32, Way))| {
        let found = rows
            .iter()
            .find(|r| (r.g, r.alpha, r.tau, r.eta) == (g, alpha, tau, 1.0) && matches!(r.beam, Beam::Diffuse));
        let row = found.expect("a row of the table");
        // Light behind the slab twice as strong as before it.
        let expected = row.r + 2.0 * row.t;
        let medium = GuidedMedium::new(Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(alpha), g });
        let walk = |seed: u32, i: u32| {
            let mut sampler = Sampler::new(seed, i >> 12, i & 4095);
            let d = Beam::Diffuse.direction(&mut sampler);
            let start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: Rgb::ONE };
            let stats = &mut WalkStats::default();
            let end =
                exact_walk::<false>(way, &Slab { thickness: tau }, &medium, start, &mut sampler, stats, &mut |_, _| ());
            let estimate = match end.end {
                WalkEnd::Boundary { hit: true, weight, .. } => weight,
                WalkEnd::Boundary { weight, .. } => 2.0 * weight,
                _ => Rgb::ZERO,
            };
            (estimate, end.densities.ratios())
        };
        let mut sums = ControlSums::default();
        for i in 0..4000 {
            let (estimate, ratios) = walk(2 * seed as u32, i);
            sums.add(&ratios, estimate);
        }
        // Where they do not pay there are none.
        let Some(controls) = Controls::fit(&sums, &way.techniques().shares) else { return Vec::new() };
        let (mut plain, mut left, mut taken) = (Estimate::default(), Estimate::default(), Estimate::default());
        for i in 0..WALKS {
            let (estimate, ratios) = walk(2 * seed as u32 + 1, i);
            let correction = controls.correction(&ratios);
            plain.add(estimate);
            left.add(estimate - correction);
            taken.add(correction);
        }
        let variance = |e: Estimate| (e.squares / e.n - e.mean() * e.mean()).x;
        let label = format!("{way:?} g {g} alpha {alpha} tau {tau}");
        eprintln!("{label}: variance {:.2e} with controls {:.2e}", variance(plain), variance(left));
        assert!(variance(left) < 1.02 * variance(plain), "{label}");
        let means = [("plain", plain, expected), ("controls", left, expected), ("correction", taken, 0.0)];
        let z = |(what, e, expected): (&str, Estimate, f64)| {
            (format!("{label} {what}: {} of {expected}", e.mean().x), e.z_of(0, expected, 0.0))
        };
        means.into_iter().map(z).collect()
    };
    let tests: Vec<(String, f64)> = cases.par_iter().enumerate().map(case).flatten().collect();
    assert!(tests.len() >= 3 * cases.len() * 3 / 4, "controls pay in {} of {} cases", tests.len() / 3, cases.len());
    judge("controls", tests);
}

/// Walks of one technique and classical ones agree on everything that both see, through slabs so thick that the mean
/// itself is out of reach of the technique. With p the technique's density and f what a path carries,
/// E_p[min(f / p, c)] = E_f[min(1, c p / f)]: bounded on both sides, for any c.
#[test]
fn thick_slabs_agree_with_classical_walks() {
    const WALKS: u32 = 20_000;
    const CAPS: [f32; 3] = [0.1, 1.0, 10.0];
    let normals = [Vec3::NEG_Z, Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, -0.6)];
    let mut cases = Vec::new();
    for (alpha, g) in
        [(0.5, 0.0), (0.8, 0.0), (0.95, 0.0), (0.99, 0.0), (1.0, 0.0), (0.8, 0.5), (0.99, 0.8), (0.95, -0.4)]
    {
        for tau in [10.0, 50.0] {
            for normal in normals {
                for first_distance in [true, false] {
                    cases.push((alpha, g, tau, normal, first_distance));
                }
            }
        }
    }
    let case = |(seed, &(alpha, g, tau, normal, first_distance)): (usize, &(f32, f32, f32, Vec3, bool))| {
        let medium = GuidedMedium::new(Medium { sigma_t: Rgb::ONE, albedo: Rgb::splat(alpha), g });
        let slab = Slab { thickness: tau };
        // Classical walks only, which know the density along the normal.
        let mut techniques = support::ways::mixture(0, 1.0, first_distance);
        techniques.set_normal(0, normal);
        let way = Way::Conditional { normal, first_distance, classical: 0.0 };
        let mut means = [[[Estimate::default(); CAPS.len()]; 2]; 2];
        for i in 0..WALKS {
            let mut sampler = Sampler::new(seed as u32, i >> 12, i & 4095);
            let d = Beam::Diffuse.direction(&mut sampler);
            let start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: Rgb::ONE };
            let guided = match go::<false>(way, &slab, &medium, start, &mut sampler, &mut |_, _| ()) {
                WalkEnd::Boundary { hit, weight, .. } => Some((hit, weight.x)),
                _ => None,
            };
            let end = walk_mixture(
                &slab,
                &medium,
                techniques,
                start,
                0.5,
                &mut sampler,
                &mut WalkStats::default(),
                &mut Blind::<false>,
            );
            let classical = match end.end {
                WalkEnd::Boundary { hit, weight, .. } => {
                    Some((hit, weight.x, end.densities.p.guided[0][0] / end.densities.f.x))
                }
                _ => None,
            };
            for (k, cap) in CAPS.into_iter().enumerate() {
                for (face, top) in [true, false].into_iter().enumerate() {
                    let x = guided.filter(|g| g.0 == top).map_or(0.0, |(_, weight)| weight.min(cap));
                    let y = classical.filter(|c| c.0 == top).map_or(0.0, |(_, weight, p)| weight * (cap * p).min(1.0));
                    means[0][face][k].add(Rgb::splat(x));
                    means[1][face][k].add(Rgb::splat(y));
                }
            }
        }
        let mut z = Vec::new();
        for face in 0..2 {
            for k in 0..CAPS.len() {
                let [a, b] = [means[0][face][k], means[1][face][k]];
                let variance = |e: Estimate| ((e.squares / e.n - e.mean() * e.mean()) / e.n).x;
                // Both must have met the event: neither mean is that of a handful of walks.
                let met = |e: Estimate| e.sum.x * e.sum.x > 30.0 * e.squares.x;
                if met(a) && met(b) {
                    let label = format!(
                        "alpha {alpha} g {g} tau {tau} {normal} first {first_distance} face {face} cap {}: {} and {}",
                        CAPS[k],
                        a.mean().x,
                        b.mean().x
                    );
                    z.push((label, (a.mean().x - b.mean().x) / (variance(a) + variance(b)).sqrt()));
                }
            }
        }
        z
    };
    let z: Vec<(String, f64)> = cases.par_iter().enumerate().map(case).flatten().collect();
    assert!(z.len() > 400, "{} comparisons", z.len());
    judge("capped weights", z);
    let _ = z_limit;
}
