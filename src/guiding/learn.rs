//! Shares of the techniques, learned from the walks by the second-moment rule.
//!
//! The variance of f / sum_t P_t p_t is least where E[estimate^2 p_t / p] is the same for every technique that is drawn:
//! each pass multiplies shares by it (mixture_3d.md section 5: better than the KL rule of guiding.md 8.3).

use super::statistics::Sums;
use crate::subsurface::technique::{LANES, TECHNIQUES, Techniques};

/// Walks' worth of belief in the shares as they are.
const PRIOR_WALKS: f64 = 32.0;

/// Least classical share of all walks: it bounds the weight where no slab normal fits.
pub const CLASSICAL_FLOOR: f64 = 0.1;

/// Least classical share of each channel: the bound is per channel.
const CHANNEL_FLOOR: f64 = CLASSICAL_FLOOR / 6.0;

/// Least share of a slab normal in a channel: what is never drawn is never learned.
const FLOOR: f64 = 0.001;

/// Dim channels count relative to their own mean, but not below this share of the brightest channel's.
const DIM: f64 = 0.1;

/// Moves the shares of a region by what its walks say. `classical`: least classical share.
pub fn learn(techniques: &mut Techniques, sums: &Sums, classical: f64) {
    let credit = credits(sums);
    let shares = techniques.shares.as_list();
    let seen: f64 = (0..TECHNIQUES).map(|t| f64::from(shares[t]) * credit[t]).sum();
    if !(seen > 0.0 && seen.is_finite()) {
        return;
    }
    // Both sums are 1 after normalisation; walks weigh against the prior.
    let trust = sums.walks / (sums.walks + PRIOR_WALKS);
    let mut learned = [0.0; TECHNIQUES];
    for t in 0..TECHNIQUES {
        let share = f64::from(shares[t]);
        learned[t] = share * ((1.0 - trust) + trust * credit[t] / seen);
    }
    techniques.shares = crate::subsurface::technique::PerTechnique::from_list(&floored(learned, &shares, classical));
}

/// E[estimate^2 r_t], each channel relative to its squared mean.
fn credits(sums: &Sums) -> [f64; TECHNIQUES] {
    let mean = sums.estimate.map(|x| (x / sums.walks).abs());
    let brightest = mean.iter().copied().fold(0.0, f64::max);
    let mut credit = [0.0; TECHNIQUES];
    for (mean, moments) in mean.into_iter().zip(&sums.second_moment) {
        let scale = mean * mean + DIM * DIM * brightest * brightest;
        if scale > 0.0 {
            credit.iter_mut().zip(moments).for_each(|(credit, moment)| *credit += moment / (sums.walks * scale));
        }
    }
    credit
}

/// Shares that sum to 1, none of those drawn before below its floor.
fn floored(learned: [f64; TECHNIQUES], before: &[f32; TECHNIQUES], classical: f64) -> [f32; TECHNIQUES] {
    let is_classical = |t: usize| t.is_multiple_of(LANES + 1);
    let floor = |t: usize| match before[t] > 0.0 {
        true if is_classical(t) => CHANNEL_FLOOR.min(classical / 3.0),
        true => FLOOR,
        false => 0.0,
    };
    let total: f64 = learned.iter().sum();
    let mut shares: [f64; TECHNIQUES] = std::array::from_fn(|t| (learned[t] / total).max(floor(t)));
    let sum_where = |shares: &[f64; TECHNIQUES], wanted: bool| -> f64 {
        (0..TECHNIQUES).filter(|&t| is_classical(t) == wanted).map(|t| shares[t]).sum()
    };
    let (plain, guided) = (sum_where(&shares, true), sum_where(&shares, false));
    let plain_share = (plain / (plain + guided)).max(classical);
    for (t, share) in shares.iter_mut().enumerate() {
        *share *= match (is_classical(t), guided > 0.0) {
            (true, true) => plain_share / plain.max(1e-30),
            (true, false) => 1.0 / plain,
            (false, _) => (1.0 - plain_share) / guided.max(1e-30),
        };
    }
    shares.map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;
    use crate::subsurface::technique::PerTechnique;

    fn uniform() -> Techniques {
        let mut techniques = Techniques::default();
        techniques.shares.classical = [0.1 / 3.0; 3];
        for c in 0..3 {
            techniques.shares.guided[c][..2].fill(0.15);
        }
        techniques
    }

    /// One technique of two is where the light comes from: it gets the walks, the others keep their floors.
    #[test]
    fn credit_moves_shares() {
        let mut techniques = uniform();
        for _ in 0..20 {
            let mut sums = Sums::default();
            let den = techniques.shares.guided[0][0];
            for _ in 0..1000 {
                let mut ratios = PerTechnique::default();
                ratios.guided[0][0] = 1.0 / den;
                sums.add(&ratios, Rgb::ONE, Rgb::ONE);
            }
            learn(&mut techniques, &sums, CLASSICAL_FLOOR);
        }
        let shares = techniques.shares;
        assert!((shares.sum() - 1.0).abs() < 1e-5, "{shares:?}");
        assert!(shares.guided[0][0] > 0.85, "{shares:?}");
        assert!(shares.classical.iter().sum::<f32>() > 0.0999 && shares.classical[2] > 0.016);
        assert!(shares.guided[2][1] > 0.5 * FLOOR as f32 && shares.guided[1][5] == 0.0);
    }

    #[test]
    fn nothing_seen_changes_nothing() {
        let mut techniques = uniform();
        learn(&mut techniques, &Sums::default(), CLASSICAL_FLOOR);
        let mut dark = Sums::default();
        dark.add(&PerTechnique::default(), Rgb::ZERO, Rgb::ZERO);
        learn(&mut techniques, &dark, CLASSICAL_FLOOR);
        assert_eq!(techniques, uniform());
    }
}
