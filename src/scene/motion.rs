//! Where moving things are at a time of the shutter: 0 where it opens, 1 where it closes.

use super::Instance;
use super::accel::{Aabb, MovingBlas, Ray, TriHit, between};
use super::attribute::Attribute;
use crate::flat::{Matrix4d, TransformKeys};
use crate::math::Affine;
use glam::Vec3;
use std::ops::Deref;

/// Values at ascending times, two or more.
#[derive(Debug, Clone)]
pub struct Keys<T> {
    times: Vec<f32>,
    values: Vec<T>,
}

impl<T> Keys<T> {
    pub fn new(times: Vec<f32>, values: Vec<T>) -> Self {
        debug_assert!(times.len() == values.len() && times.len() > 1);
        Self { times, values }
    }

    /// The key that `time` is behind, and how far on the way to the next; the ends go on.
    pub fn segment(&self, time: f32) -> (usize, f32) {
        let last = self.times.len() - 2;
        let i = self.times[1..=last].partition_point(|&t| t <= time);
        let (from, to) = (self.times[i], self.times[i + 1]);
        (i, ((time - from) / (to - from)).clamp(0.0, 1.0))
    }

    /// The values about `time`, and the share of the second.
    pub fn about(&self, time: f32) -> (&T, &T, f32) {
        let (i, f) = self.segment(time);
        (&self.values[i], &self.values[i + 1], f)
    }

    pub fn times(&self) -> &[f32] {
        &self.times
    }

    pub fn values(&self) -> &[T] {
        &self.values
    }
}

/// Placements in render space.
pub type Moves = Keys<Affine>;

impl Moves {
    /// `place` gives the placement by a matrix; `None` where one of them has none.
    pub fn new_by(keys: Vec<(f32, Matrix4d)>, place: impl Fn(&Matrix4d) -> Option<Affine>) -> Option<Self> {
        let (times, matrices): (Vec<f32>, Vec<Matrix4d>) = keys.into_iter().unzip();
        Some(Self::new(times, matrices.iter().map(place).collect::<Option<_>>()?))
    }

    pub fn at(&self, time: f32) -> Affine {
        let (a, b, f) = self.about(time);
        Affine::between(a, b, f)
    }
}

/// Where something is at a time.
pub enum Placed<'a> {
    Still(&'a Affine),
    Moving(Affine),
}

impl Deref for Placed<'_> {
    type Target = Affine;
    #[inline(always)]
    fn deref(&self) -> &Affine {
        match self {
            Self::Still(place) => place,
            Self::Moving(place) => place,
        }
    }
}

impl Instance {
    #[inline]
    pub fn placed(&self, time: f32) -> Placed<'_> {
        match &self.moves {
            None => Placed::Still(&self.to_render),
            Some(moves) => Placed::Moving(moves.at(time)),
        }
    }

    /// Whether rays have to know the time.
    pub fn is_moving(&self) -> bool {
        self.moves.is_some() || self.geometry.deformation.is_some()
    }
}

/// A mesh whose points move: a tree for each stretch between keys.
pub struct Deformation {
    /// Centred object space, by time.
    pub points: Keys<Vec<Vec3>>,
    /// By time; `None`: flat.
    pub normals: Option<Vec<Attribute<Vec3>>>,
    stretches: Vec<MovingBlas>,
}

impl Deformation {
    /// `one_sided`: triangles are met from the front only.
    pub fn new(
        points: Keys<Vec<Vec3>>,
        normals: Option<Vec<Attribute<Vec3>>>,
        triangles: &[[u32; 3]],
        one_sided: bool,
    ) -> Self {
        let stretch = |pair: &[Vec<Vec3>]| MovingBlas::build([&pair[0], &pair[1]], triangles).one_sided(one_sided);
        let stretches = points.values.windows(2).map(stretch).collect();
        Self { points, normals, stretches }
    }

    pub fn closest(&self, ray: &Ray, skip: u32, time: f32) -> Option<TriHit> {
        let (i, f) = self.points.segment(time);
        self.stretches[i].closest_skip(ray, skip, f)
    }

    pub fn any(&self, ray: &Ray, skip: u32, time: f32) -> bool {
        let (i, f) = self.points.segment(time);
        self.stretches[i].any_skip(ray, skip, f)
    }

    /// The tree of a time, and how far its points are.
    pub fn stretch(&self, time: f32) -> (&MovingBlas, f32) {
        let (i, f) = self.points.segment(time);
        (&self.stretches[i], f)
    }

    pub fn corners(&self, triangle: [u32; 3], time: f32) -> [Vec3; 3] {
        let (a, b, f) = self.points.about(time);
        triangle.map(|i| between(a[i as usize], b[i as usize], f))
    }

    pub fn bounds(&self) -> Aabb {
        self.stretches.iter().fold(Aabb::EMPTY, |all, stretch| all.union(&stretch.bounds()))
    }

    /// Bytes.
    pub fn memory(&self) -> usize {
        let points = self.points.values.iter().map(|points| size_of_val(points.as_slice())).sum::<usize>();
        let normals = self.normals.iter().flatten().map(Attribute::memory).sum::<usize>();
        points + normals + self.stretches.iter().map(MovingBlas::memory).sum::<usize>()
    }
}

/// Matrices of one placement by time: `first`, then what `second` does with instance `i`. `None`: it stays.
pub fn combined(
    (first, first_keys): (&Matrix4d, Option<&TransformKeys>),
    (second, second_keys, i): (&Matrix4d, Option<&TransformKeys>, usize),
) -> Option<Vec<(f32, Matrix4d)>> {
    let mut times: Vec<f32> = [first_keys, second_keys].into_iter().flatten().flat_map(|k| k.times.clone()).collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    let at = |time| multiply(&matrix_at(first, first_keys, 0, time), &matrix_at(second, second_keys, i, time));
    let keys: Vec<(f32, Matrix4d)> = times.into_iter().map(|time| (time, at(time))).collect();
    keys.windows(2).any(|pair| pair[0].1 != pair[1].1).then_some(keys)
}

/// Row-vector product: first `a`, then `b`.
pub fn multiply(a: &Matrix4d, b: &Matrix4d) -> Matrix4d {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn matrix_at(still: &Matrix4d, keys: Option<&TransformKeys>, instance: usize, time: f32) -> Matrix4d {
    let Some(keys) = keys else { return *still };
    let i = keys.times.partition_point(|&t| t <= time).clamp(1, keys.times.len() - 1);
    let [from, to] = [i - 1, i].map(|k| (keys.times[k], keys.transforms[k][instance]));
    let f = f64::from(((time - from.0) / (to.0 - from.0)).clamp(0.0, 1.0));
    std::array::from_fn(|row| std::array::from_fn(|k| from.1[row][k] + (to.1[row][k] - from.1[row][k]) * f))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flat::IDENTITY;

    #[test]
    fn keys_are_found_and_the_ends_go_on() {
        let keys = Keys::new(vec![0.0, 0.25, 1.0], vec![(); 3]);
        let found: Vec<_> = [-1.0, 0.0, 0.125, 0.25, 0.625, 1.0, 2.0].map(|t| keys.segment(t)).to_vec();
        assert_eq!(found, [(0, 0.0), (0, 0.0), (0, 0.5), (1, 0.0), (1, 0.5), (1, 1.0), (1, 1.0)]);
    }

    /// Times of both are kept, and what stays is no motion.
    #[test]
    fn placements_within_placements_have_the_keys_of_both() {
        let moved = |x: f64| {
            let mut matrix = IDENTITY;
            matrix[3][0] = x;
            matrix
        };
        let keys = |times: &[f32], x: &[f64]| TransformKeys {
            times: times.to_vec(),
            transforms: x.iter().map(|&x| vec![moved(x)].into()).collect(),
        };
        let (a, b) = (keys(&[0.0, 1.0], &[0.0, 4.0]), keys(&[0.0, 0.5, 1.0], &[0.0, 0.0, 10.0]));
        let both = combined((&IDENTITY, Some(&a)), (&IDENTITY, Some(&b), 0)).expect("moves");
        assert_eq!(both.iter().map(|(t, m)| (*t, m[3][0])).collect::<Vec<_>>(), [(0.0, 0.0), (0.5, 2.0), (1.0, 14.0)]);
        let stays = keys(&[0.0, 1.0], &[3.0, 3.0]);
        assert!(combined((&IDENTITY, Some(&stays)), (&IDENTITY, None, 0)).is_none());
    }
}
