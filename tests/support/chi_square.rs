//! Whether counts are those of a density.

/// Least expectation of a bin that counts by itself.
const LEAST: f64 = 20.0;

/// Chi-square of `counts` against the `probabilities` of their bins as a z-score. Bins where little is expected
/// count as one. Probabilities that do not add up to 1 are a mistake too, and seen as such.
pub fn z(counts: &[f64], probabilities: &[f64]) -> f64 {
    assert_eq!(counts.len(), probabilities.len());
    let n: f64 = counts.iter().sum();
    let bins: Vec<(f64, f64)> = counts.iter().zip(probabilities).map(|(count, p)| (*count, p * n)).collect();
    let (few, many): (Vec<_>, Vec<_>) = bins.into_iter().partition(|(_, expected)| *expected < LEAST);
    let rest = few.iter().fold((0.0, 0.0), |sum, bin| (sum.0 + bin.0, sum.1 + bin.1));
    let bins = many.into_iter().chain((rest != (0.0, 0.0)).then_some(rest));
    let of_bin = |(count, expected): (f64, f64)| (count - expected) * (count - expected) / expected;
    let (chi2, bins) = bins.fold((0.0, 0), |(chi2, bins), bin| (chi2 + of_bin(bin), bins + 1));
    score(chi2, f64::from(bins - 1))
}

/// Standard normal score of a chi-square of so many degrees of `freedom` (Wilson and Hilferty 1931).
pub fn score(chi2: f64, freedom: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    ((chi2 / freedom).cbrt() - (1.0 - spread)) / spread.sqrt()
}
