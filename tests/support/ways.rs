//! Ways of walking through a slab, by slab normal and by weight.

use super::slab::Slab;
use dermis::bsdf::fresnel;
use dermis::math::Rgb;
use dermis::sampling::{sampler::Sampler, uniform_sphere};
use dermis::subsurface::mixture::{MixtureEnd, Visitor, walk_mixture};
use dermis::subsurface::steps::{Start, WalkEnd, WalkStats};
use dermis::subsurface::technique::{GuidedMedium, LANES, PerTechnique, Techniques};
use dermis::subsurface::walk::{Along, Collision, walk};
use glam::{Vec2, Vec3};

/// The slab's lit face is at z = 0, its outward normal -z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Way {
    /// One normal, weighted by itself.
    Conditional { normal: Vec3, first_distance: bool, classical: f32 },
    /// A normal for each walk from anywhere, known at the first collision, weighted by itself.
    Anywhere,
    /// The normal is known at the first collision: towards the nearer face.
    Nearer { exact: bool },
    /// Several normals, point of entry in lane 0, and classical, weighted by all of them.
    Exact { normals: usize, classical: f32, guided_first: bool },
}

pub const WAYS: [Way; 10] = [
    Way::Conditional { normal: Vec3::NEG_Z, first_distance: true, classical: 0.5 },
    Way::Conditional { normal: Vec3::Z, first_distance: true, classical: 0.0 },
    Way::Conditional { normal: Vec3::new(0.6, 0.0, 0.8), first_distance: false, classical: 0.0 },
    Way::Anywhere,
    Way::Nearer { exact: false },
    Way::Nearer { exact: true },
    Way::Exact { normals: 0, classical: 1.0, guided_first: true },
    Way::Exact { normals: 2, classical: 0.1, guided_first: true },
    Way::Exact { normals: 8, classical: 0.05, guided_first: true },
    Way::Exact { normals: 2, classical: 0.1, guided_first: false },
];

/// Share of the classical technique beside the nearer face's normal.
pub const NEARER_CLASSICAL: f32 = 0.2;

/// Normals of the mixtures; the last ones are deliberately wrong.
const NORMALS: [Vec3; LANES] = [
    Vec3::NEG_Z,
    Vec3::Z,
    Vec3::X,
    Vec3::new(0.6, 0.0, 0.8),
    Vec3::new(0.0, 0.6, -0.8),
    Vec3::new(-1.0, 0.0, 0.0),
    Vec3::new(0.0, -0.28, 0.96),
    Vec3::Y,
];

pub fn mixture(normals: usize, classical: f32, guided_first: bool) -> Techniques {
    let mut techniques = Techniques { guided_first, ..Techniques::default() };
    let mut shares = PerTechnique { classical: [classical / 3.0; 3], ..PerTechnique::default() };
    for (lane, normal) in NORMALS.into_iter().take(normals).enumerate() {
        techniques.set_normal(lane, normal);
        (0..3).for_each(|c| shares.guided[c][lane] = (1.0 - classical) / (3 * normals) as f32);
    }
    techniques.shares = shares.scaled(1.0 / shares.sum());
    techniques
}

impl Way {
    /// The techniques of an exact way.
    pub fn techniques(self) -> Techniques {
        match self {
            Way::Exact { normals, classical, guided_first } => mixture(normals, classical, guided_first),
            _ => mixture(1, NEARER_CLASSICAL, false),
        }
    }

    pub fn is_exact(self) -> bool {
        matches!(self, Way::Exact { .. } | Way::Nearer { exact: true })
    }
}

/// What a walk reports at its collisions.
pub type Collide<'a> = dyn FnMut(&Collision, &mut Sampler) + 'a;

/// The late normal of `Way::Nearer`, and collisions where `LIT`.
pub struct Seen<'a, 'b, const LIT: bool> {
    thickness: f32,
    nearer: bool,
    collide: &'a mut Collide<'b>,
}

fn nearer(p: Vec3, thickness: f32) -> Vec3 {
    if p.z < 0.5 * thickness { Vec3::NEG_Z } else { Vec3::Z }
}

impl<const LIT: bool> Visitor for Seen<'_, '_, LIT> {
    const AT_COLLISIONS: bool = LIT;

    fn late_normal(&mut self, p: Vec3) -> Option<Vec3> {
        self.nearer.then(|| nearer(p, self.thickness))
    }

    fn collide(&mut self, collision: &Collision, sampler: &mut Sampler) {
        (self.collide)(collision, sampler);
    }
}

/// A walk of an exact way; `LIT`: `collide` is called.
pub fn exact_walk<const LIT: bool>(
    way: Way,
    slab: &Slab,
    medium: &GuidedMedium,
    start: Start<bool>,
    sampler: &mut Sampler,
    stats: &mut WalkStats,
    collide: &mut Collide,
) -> MixtureEnd<bool> {
    let u = sampler.next_1d();
    let nearer = matches!(way, Way::Nearer { .. });
    let mut visitor = Seen::<LIT> { thickness: slab.thickness, nearer, collide };
    walk_mixture(slab, medium, way.techniques(), start, u, sampler, stats, &mut visitor)
}

/// A walk of any way; `LIT`: `collide` is called.
pub fn go<const LIT: bool>(
    way: Way,
    slab: &Slab,
    medium: &GuidedMedium,
    start: Start<bool>,
    sampler: &mut Sampler,
    collide: &mut Collide,
) -> WalkEnd<bool> {
    let mut stats = WalkStats::default();
    let kernels = &medium.kernels;
    let along = match way {
        Way::Exact { .. } | Way::Nearer { exact: true } => {
            return exact_walk::<LIT>(way, slab, medium, start, sampler, &mut stats, collide).end;
        }
        Way::Conditional { classical, .. } if sampler.random() < classical => Along::None,
        Way::Conditional { normal, first_distance, .. } => Along::Fixed { kernels, normal, first_distance },
        Way::Nearer { exact: false } | Way::Anywhere => Along::Late { kernels },
    };
    let late = |p: Vec3, sampler: &mut Sampler| match way {
        Way::Anywhere => Some(uniform_sphere(Vec2::new(sampler.random(), sampler.random()))),
        _ => Some(nearer(p, slab.thickness)),
    };
    walk(slab, &medium.medium, along, start, false, sampler, &mut stats, late, |c, s| {
        if LIT {
            collide(c, s)
        }
    })
}

/// One path through smooth faces of index `eta` that carries `carried`: whether it leaves by the lit face, and what
/// with. A walk starts anew at every internal reflection.
pub fn pass(
    way: Way,
    slab: &Slab,
    medium: &GuidedMedium,
    eta: f32,
    d: Vec3,
    mut carried: Rgb,
    sampler: &mut Sampler,
) -> (bool, Rgb) {
    let mut start = Start { p: Vec3::ZERO, d, normal: Vec3::NEG_Z, hit: true, weight: Rgb::ONE };
    if eta > 1.0 {
        if sampler.random() < fresnel::dielectric(d.z, eta) {
            return (true, carried);
        }
        start.d = fresnel::refract(-d, -Vec3::Z, eta).expect("light always gets into the denser medium");
    }
    loop {
        // As in the integrator: the walk knows what it carries, up to a common factor.
        let scale = carried.max_element();
        start.weight = carried / scale;
        let WalkEnd::Boundary { hit, p, d, weight, .. } =
            go::<false>(way, slab, medium, start, sampler, &mut |_, _| ())
        else {
            return (true, Rgb::ZERO);
        };
        carried = scale * weight;
        if eta == 1.0 || sampler.random() >= fresnel::dielectric(d.z.abs(), 1.0 / eta) {
            return (hit, carried);
        }
        // Roulette on what is carried, or reflections multiply without end.
        let survival = carried.max_element().min(1.0);
        if sampler.random() >= survival {
            return (hit, Rgb::ZERO);
        }
        carried /= survival;
        let normal = if hit { Vec3::NEG_Z } else { Vec3::Z };
        start = Start { p, d: Vec3::new(d.x, d.y, -d.z), normal, hit, weight: Rgb::ONE };
    }
}
