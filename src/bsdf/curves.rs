//! Where a surface gets its directional albedos from: quadrature once for what is constant, a grid for what is driven.
//!
//! A curve takes milliseconds, a textured roughness has another one at every point. Those are interpolated between
//! the nodes of a grid over roughness and index of refraction, each of which is computed when it is first asked for,
//! and is a function of its place alone: whoever asks first, all get the same number.

use super::albedo::Curve;
use super::fresnel::{dielectric, schlick_weight};
use super::ggx::{Ggx, Masking, SMOOTH_ALPHA};
use std::sync::{LazyLock, OnceLock};

/// What is averaged over the facets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    /// F = 1.
    Full,
    /// F = (1 - cos)^5.
    Grazing,
    /// The exact Fresnel reflectance of a dielectric.
    Dielectric,
    /// Reflection and refraction by a rough interface, whatever the masking.
    Interface,
}

/// A curve by what it depends on; `eta` is 1 where it depends on none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key {
    pub of: Of,
    pub masking: Masking,
    pub alpha: f32,
    pub eta: f32,
}

impl Key {
    fn tabulate(&self) -> Curve {
        let ggx = Ggx { alpha: self.alpha };
        match self.of {
            Of::Full => Curve::reflection(ggx, self.masking, |_| 1.0),
            Of::Grazing => Curve::reflection(ggx, self.masking, schlick_weight),
            Of::Dielectric => Curve::reflection(ggx, self.masking, |cos| dielectric(cos, self.eta)),
            Of::Interface => Curve::interface(ggx, self.eta),
        }
    }
}

/// Gives the curves of one surface.
pub enum Curves<'a> {
    /// By quadrature; each is noted down.
    Exact(&'a mut Vec<(Key, Curve)>),
    /// Those noted down, else by the grid.
    Known(&'a [(Key, Curve)]),
}

impl Curves<'_> {
    pub fn get(&mut self, key: Key) -> Curve {
        let noted = |list: &[(Key, Curve)]| list.iter().find(|(known, _)| *known == key).map(|(_, curve)| *curve);
        match self {
            Self::Exact(list) => noted(list).unwrap_or_else(|| {
                let curve = key.tabulate();
                list.push((key, curve));
                curve
            }),
            Self::Known(list) => noted(list).unwrap_or_else(|| interpolate(key)),
        }
    }
}

/// Nodes over sqrt(alpha), the authored roughness, from that of a mirror to 1.
const ROUGHNESSES: usize = 49;

/// Nodes over (eta - 1) / (eta + 1), the square root of the reflectance at normal incidence, from -1 to 1; an even
/// number of steps, so that eta 1 is one of them.
const INDICES: usize = 81;

/// Limits of the index at the ends, where nothing is refracted any more.
const LARGEST_ETA: f32 = 50.0;

type Grid = Vec<OnceLock<Box<Curve>>>;

static GRIDS: LazyLock<Vec<Grid>> = LazyLock::new(|| {
    let nodes = |of: usize| if of < 2 { ROUGHNESSES } else { ROUGHNESSES * INDICES };
    let grid = |i: usize| (0..nodes(i / 2)).map(|_| OnceLock::new()).collect();
    (0..8).map(grid).collect()
});

fn interpolate(key: Key) -> Curve {
    let has_eta = matches!(key.of, Of::Dielectric | Of::Interface);
    let of = match key.of {
        Of::Full => 0,
        Of::Grazing => 1,
        Of::Dielectric => 2,
        Of::Interface => 3,
    };
    let grid = &GRIDS[2 * of + usize::from(key.masking == Masking::Storm && key.of != Of::Interface)];
    let node = |i: usize, j: usize| -> &Curve {
        let at = if has_eta { j * ROUGHNESSES + i } else { i };
        grid[at].get_or_init(|| Box::new(Key { alpha: alpha_at(i), eta: eta_at(j), ..key }.tabulate()))
    };
    let smoothest = SMOOTH_ALPHA.sqrt();
    let x = ((key.alpha.sqrt() - smoothest) / (1.0 - smoothest)).clamp(0.0, 1.0) * (ROUGHNESSES - 1) as f32;
    let i = (x as usize).min(ROUGHNESSES - 2);
    let row = |j: usize| node(i, j).lerp(node(i + 1, j), x - i as f32);
    if !has_eta {
        return row(0);
    }
    let y = 0.5 * ((key.eta - 1.0) / (key.eta + 1.0) + 1.0).clamp(0.0, 2.0) * (INDICES - 1) as f32;
    let j = (y as usize).min(INDICES - 2);
    // Constant indices in between are the rule where only roughness is driven: they get both neighbours.
    row(j).lerp(&row(j + 1), y - j as f32)
}

fn alpha_at(i: usize) -> f32 {
    let smoothest = SMOOTH_ALPHA.sqrt();
    let roughness = smoothest + (1.0 - smoothest) * i as f32 / (ROUGHNESSES - 1) as f32;
    roughness * roughness
}

fn eta_at(j: usize) -> f32 {
    let r = 2.0 * j as f32 / (INDICES - 1) as f32 - 1.0;
    ((1.0 + r) / (1.0 - r)).clamp(1.0 / LARGEST_ETA, LARGEST_ETA)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the quadrature between the nodes, the worst of roughness, index and cosine.
    fn worst(of: Of, eta: f32) -> f32 {
        let mut worst = 0.0_f32;
        for roughness in [0.06, 0.1, 0.214, 0.37, 0.55, 0.77, 0.96_f32] {
            let key = Key { of, masking: Masking::Smith, alpha: roughness * roughness, eta };
            let (got, exact) = (interpolate(key), key.tabulate());
            for mu in [0.02, 0.1, 0.3, 0.6, 1.0] {
                worst = worst.max((got.at(mu) - exact.at(mu)).abs());
            }
        }
        worst
    }

    #[test]
    fn the_grid_is_close_to_the_quadrature() {
        for (of, eta) in [(Of::Full, 1.0), (Of::Grazing, 1.0), (Of::Dielectric, 1.46), (Of::Dielectric, 2.03)] {
            let worst = worst(of, eta);
            assert!(worst < 4e-3, "{of:?} {eta}: {worst}");
        }
    }

    #[test]
    fn interfaces_of_the_grid_are_close_to_the_quadrature() {
        for eta in [1.46, 1.0 / 1.46] {
            let worst = worst(Of::Interface, eta);
            assert!(worst < 1e-2, "{eta}: {worst}");
        }
    }

    #[test]
    fn what_was_noted_is_exact() {
        let key = Key { of: Of::Full, masking: Masking::Smith, alpha: 0.0917, eta: 1.0 };
        let mut noted = Vec::new();
        let exact = Curves::Exact(&mut noted).get(key);
        assert_eq!(Curves::Known(&noted).get(key), exact);
        assert_eq!(exact, key.tabulate());
    }
}
