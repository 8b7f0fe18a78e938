//! What the checks of every prim share: one warning per attribute, and the repairs themselves.

use crate::{error::Warning, flat::Matrix4d};
use std::{fmt::Debug, ops::RangeInclusive};

/// Beyond this a number is a mistake of its exporter, not a length or a radiance.
pub(super) const LARGEST: f32 = 1e30;

pub(super) const UNIT: RangeInclusive<f32> = 0.0..=1.0;
pub(super) const NOT_NEGATIVE: RangeInclusive<f32> = 0.0..=LARGEST;
pub(super) const ANY: RangeInclusive<f32> = -LARGEST..=LARGEST;

/// One number or a few: what an attribute holds.
pub(super) trait Numbers: Copy + Debug {
    fn numbers(&mut self) -> &mut [f32];
}

impl Numbers for f32 {
    fn numbers(&mut self) -> &mut [f32] {
        std::slice::from_mut(self)
    }
}

impl<const N: usize> Numbers for [f32; N] {
    fn numbers(&mut self) -> &mut [f32] {
        self
    }
}

/// Collects the warnings of one prim.
pub(super) struct Report<'a> {
    prim: &'a str,
    warnings: &'a mut Vec<Warning>,
}

impl<'a> Report<'a> {
    pub(super) fn new(prim: &'a str, warnings: &'a mut Vec<Warning>) -> Self {
        Self { prim, warnings }
    }

    pub(super) fn warn(&mut self, message: impl Into<String>) {
        self.warnings.push(Warning::new(self.prim, message));
    }

    /// As [`Report::warn`], with a prim of its own: a subset inside a mesh.
    pub(super) fn warn_at(&mut self, prim: &str, message: impl Into<String>) {
        self.warnings.push(Warning::new(if prim.is_empty() { self.prim } else { prim }, message));
    }

    /// Brings each number into `range`; NaN becomes the number of `default`.
    pub(super) fn clamp<T: Numbers>(
        &mut self,
        attribute: &str,
        value: &mut T,
        range: RangeInclusive<f32>,
        mut default: T,
    ) {
        let authored = *value;
        let mut changed = false;
        for (number, &default) in value.numbers().iter_mut().zip(default.numbers().iter()) {
            if !range.contains(number) {
                *number = if number.is_nan() { default } else { number.clamp(*range.start(), *range.end()) };
                changed = true;
            }
        }
        if changed {
            let allowed = range_words(&range);
            self.warn(format!("{attribute} is {authored:?}, {value:?} is used; author {allowed}"));
        }
    }

    /// A number that has to be above zero: `default` where it is not.
    pub(super) fn positive(&mut self, attribute: &str, value: &mut f32, default: f32) {
        if !(*value > 0.0 && *value <= LARGEST) {
            self.warn(format!("{attribute} is {value:?}, {default:?} is used; author a number above 0"));
            *value = default;
        }
    }

    /// A token outside `allowed` becomes `default`.
    pub(super) fn token<T>(&mut self, attribute: &str, value: &mut T, allowed: &[&str], default: &str)
    where
        T: AsRef<str> + Debug + From<String>,
    {
        if !allowed.contains(&value.as_ref()) {
            let choices = allowed.join(", ");
            self.warn(format!("{attribute} is {value:?}, {default:?} is used; author one of {choices}"));
            *value = default.to_owned().into();
        }
    }
}

fn range_words(range: &RangeInclusive<f32>) -> String {
    match (*range.start(), *range.end()) {
        (low, LARGEST) if low == -LARGEST => "a finite number".into(),
        (0.0, LARGEST) => "a finite number, not below 0".into(),
        (low, high) => format!("{low} to {high}"),
    }
}

pub(super) fn is_sane(numbers: &[f32]) -> bool {
    // False for NaN, too.
    numbers.iter().all(|number| number.abs() <= LARGEST)
}

/// Why nothing can be placed by a matrix; `None`: it can.
pub(super) fn placement_fault(matrix: &Matrix4d) -> Option<&'static str> {
    let largest = f64::from(LARGEST);
    if !matrix.iter().flatten().all(|number| number.abs() <= largest) {
        return Some("is not finite");
    }
    // Row vectors: an affine matrix ends in the column 0 0 0 1, up to the rounding of matrices kept as floats.
    let column = [matrix[0][3], matrix[1][3], matrix[2][3], matrix[3][3] - 1.0];
    if column.iter().any(|number| number.abs() > 1e-5) {
        return Some("is a projection");
    }
    let [x, y, z] = [0, 1, 2].map(|row| glam::DVec3::from_slice(&matrix[row][..3]));
    // The reciprocal of the largest number: no scene has a smaller scale, and f32 could not invert it.
    if [x, y, z].iter().any(|axis| axis.length() < 1.0 / largest) {
        return Some("has a zero scale");
    }
    // The sine of the angle between the axes, so that uneven scales pass. A chain of some ten xformOps leaves
    // rounding of 1e-15; below a thousand times that, an axis is nothing else.
    let volume = x.normalize().dot(y.normalize().cross(z.normalize()));
    (volume.abs() < 1e-12).then_some("is singular")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::IDENTITY;

    #[test]
    fn placements() {
        let with = |row: usize, column: usize, value: f64| {
            let mut matrix = IDENTITY;
            matrix[row][column] = value;
            placement_fault(&matrix)
        };
        assert_eq!(placement_fault(&IDENTITY), None);
        assert_eq!(with(0, 0, -1e-9), None, "uneven and mirrored");
        assert_eq!(with(3, 3, 1.0 + 1e-7), None, "rounded to float");
        assert_eq!(with(3, 1, 1e7), None);
        assert_eq!(with(1, 1, 0.0), Some("has a zero scale"));
        assert_eq!(with(1, 1, f64::NAN), Some("is not finite"));
        assert_eq!(with(3, 0, f64::INFINITY), Some("is not finite"));
        assert_eq!(with(2, 3, 0.5), Some("is a projection"));
        let mut flat = IDENTITY;
        flat[2] = [1.0, 1.0, 0.0, 0.0];
        assert_eq!(placement_fault(&flat), Some("is singular"));
    }

    #[test]
    fn numbers_are_brought_into_range_with_one_warning() {
        let mut warnings = Vec::new();
        let mut report = Report::new("/m", &mut warnings);
        let mut color = [2.0, f32::NAN, 0.5];
        report.clamp("inputs:color", &mut color, UNIT, [0.1, 0.2, 0.3]);
        assert_eq!(color, [1.0, 0.2, 0.5]);
        let mut fine = 1.0;
        report.clamp("inputs:fine", &mut fine, UNIT, 0.0);
        let mut ior = -1.0;
        report.positive("inputs:ior", &mut ior, 1.5);
        assert_eq!(ior, 1.5);
        let messages: Vec<_> = warnings.iter().map(|warning| warning.message.as_str()).collect();
        assert_eq!(
            messages,
            [
                "inputs:color is [2.0, NaN, 0.5], [1.0, 0.2, 0.5] is used; author 0 to 1",
                "inputs:ior is -1.0, 1.5 is used; author a number above 0"
            ]
        );
    }
}
