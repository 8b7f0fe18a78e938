//! Lights that move: a light of the frame, seen from a receiver that moved the other way.
//!
//! A light is turned about its own origin and shifted, nothing else, so that distances, solid angles and densities are
//! those of the light of the frame. Between keys the origin goes straight, and the turn is the shortest at constant speed.

use super::{Light, Lights, bound::Bound, linking::Linked};
use crate::math::{Affine, PI};
use crate::scene::Keys;
use glam::{DMat3, DQuat, Mat3, Quat, Vec3};
use std::ops::Deref;

/// Entries of a matrix beyond which it is no turn: rounding of xformOps is far below, a change of scale far above.
const TURN: f64 = 1e-3;

/// From the frame to a time: x goes to turn (x - origin) + origin + shift.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key {
    turn: Quat,
    shift: Vec3,
}

/// The motion of one light over the shutter.
#[derive(Debug, Clone)]
pub struct Motion {
    keys: Keys<Key>,
    /// What it turns about: its place at the frame, render space.
    origin: Vec3,
    turns: bool,
    /// Its size changes, too, which it does not follow.
    stretched: bool,
}

impl Motion {
    /// From its places by time and the one at the frame; `None` where it stays.
    pub fn new(times: &[f32], places: &[Affine], frame: &Affine) -> Option<Self> {
        let mut stretched = false;
        let mut last = Quat::IDENTITY;
        let keys = places.iter().map(|place| {
            let by = place.linear.as_dmat3() * frame.inverse.as_dmat3();
            let turn = orthogonal(by);
            stretched |= (turn - by).to_cols_array().iter().any(|x| x.abs() > TURN);
            let turn = if place.linear == frame.linear { Quat::IDENTITY } else { quaternion(turn).as_quat() };
            // Of the two quaternions of a turn the one nearer to the last key's.
            last = if turn.dot(last) < 0.0 { -turn } else { turn };
            Key { turn: last, shift: place.translation - frame.translation }
        });
        let keys: Vec<Key> = keys.collect();
        let moves = keys.windows(2).any(|pair| pair[0] != pair[1]);
        let turns = keys.iter().any(|key| key.turn != Quat::IDENTITY);
        moves.then(|| Self { keys: Keys::new(times.to_vec(), keys), origin: frame.translation, turns, stretched })
    }

    pub fn is_stretched(&self) -> bool {
        self.stretched
    }

    pub fn at(&self, time: f32) -> Pose {
        let (a, b, f) = self.keys.about(time);
        let turn = if self.turns { Some(Mat3::from_quat(a.turn.slerp(b.turn, f))) } else { None };
        Pose { turn, origin: self.origin, shift: a.shift + (b.shift - a.shift) * f }
    }

    /// A box around all that the box (min, max) of the frame becomes.
    pub fn swept(&self, (min, max): (Vec3, Vec3)) -> (Vec3, Vec3) {
        let (mut low, mut high) = (min, max);
        if self.turns {
            // The ball about the origin, however it turns.
            let reach = (min - self.origin).abs().max((max - self.origin).abs()).length() * (1.0 + 4.0 * f32::EPSILON);
            (low, high) = (self.origin - reach, self.origin + reach);
        }
        let shifts = || self.keys.values().iter().map(|key| key.shift);
        let (least, most) = shifts().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), s| (a.min(s), b.max(s)));
        // The rounding of a point that is turned, shifted and met again.
        let slack = 16.0 * f32::EPSILON * (low.abs().max(high.abs()) + least.abs().max(most.abs()) + self.origin.abs());
        (low + least - slack, high + most + slack)
    }

    /// For a cluster of lights; what turns may look anywhere.
    pub fn bound(&self, still: Bound) -> Bound {
        let (min, max) = self.swept((still.min, still.max));
        if self.turns {
            return Bound { min, max, spread: PI, plane: f32::NEG_INFINITY, ..still };
        }
        let least = self.keys.values().iter().map(|key| still.axis.dot(key.shift)).fold(f32::INFINITY, f32::min);
        // The rounding of the sum.
        let slack = 4.0 * f32::EPSILON * (still.plane.abs() + least.abs());
        Bound { min, max, plane: still.plane + least - slack, ..still }
    }
}

/// The turn next to a matrix: Newton's iteration for the orthogonal factor (Higham 1986). A mirrored one stays so.
fn orthogonal(m: DMat3) -> DMat3 {
    (0..20).fold(m, |x, _| (x + x.inverse().transpose()) * 0.5)
}

fn quaternion(turn: DMat3) -> DQuat {
    DQuat::from_mat3(&turn)
}

/// Where a light is at a time: a turn about its origin, and a shift.
#[derive(Debug, Clone, Copy)]
pub struct Pose {
    turn: Option<Mat3>,
    origin: Vec3,
    shift: Vec3,
}

impl Pose {
    /// A point of the time, where it would be if the light had stayed.
    pub fn point_to_frame(&self, p: Vec3) -> Vec3 {
        match &self.turn {
            None => p - self.shift,
            Some(turn) => turn.transpose() * (p - self.shift - self.origin) + self.origin,
        }
    }

    pub fn vector_to_frame(&self, v: Vec3) -> Vec3 {
        self.turn.as_ref().map_or(v, |turn| turn.transpose() * v)
    }

    /// Where something of the frame is that goes with the light.
    fn placed(&self, at: &Affine) -> Affine {
        let translation = self.point(at.translation);
        match &self.turn {
            None => Affine { translation, ..*at },
            Some(turn) => Affine { linear: *turn * at.linear, inverse: at.inverse * turn.transpose(), translation },
        }
    }

    pub fn point(&self, p: Vec3) -> Vec3 {
        match &self.turn {
            None => p + self.shift,
            Some(turn) => *turn * (p - self.origin) + self.origin + self.shift,
        }
    }

    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.turn.as_ref().map_or(v, |turn| *turn * v)
    }
}

/// All lights at a time of the shutter, or those of them that are for one receiver.
#[derive(Debug, Clone, Copy)]
pub struct LightsAt<'a> {
    pub(super) all: &'a Lights,
    time: f32,
    /// The set of categories that the receiver is in. With a number the whole is two registers.
    set: u32,
}

/// No set: all lights.
const EVERYTHING: u32 = u32::MAX;

impl Deref for LightsAt<'_> {
    type Target = Lights;
    fn deref(&self) -> &Lights {
        self.all
    }
}

impl<'a> LightsAt<'a> {
    /// Those that are for the things of a set of categories: no other one is drawn.
    pub fn linked_to(self, set: u32) -> Self {
        Self { set, ..self }
    }

    /// The lights that may be drawn; `None`: all.
    #[inline]
    pub(super) fn allowed(&self) -> Option<&'a Linked> {
        self.all.linked_to.get(self.set as usize)
    }

    /// A light of the frame, and where it is now; `None`: there.
    #[inline]
    pub(super) fn light(&self, light: u32) -> (&'a Light, Option<Pose>) {
        let motion = self.all.motions.get(light as usize).and_then(Option::as_ref);
        (&self.all.lights[light as usize], motion.map(|motion| motion.at(self.time)))
    }

    /// The same with a receiver, which moves the other way.
    #[inline]
    pub(super) fn seen(&self, light: u32, p: Vec3, n: Option<Vec3>) -> (&'a Light, Option<Pose>, Vec3, Option<Vec3>) {
        match self.light(light) {
            (light, None) => (light, None, p, n),
            (light, Some(pose)) => (light, Some(pose), pose.point_to_frame(p), n.map(|n| pose.vector_to_frame(n))),
        }
    }
}

/// A direction of the time for a light of the frame.
#[inline]
pub(super) fn to_frame(pose: Option<&Pose>, v: Vec3) -> Vec3 {
    pose.map_or(v, |pose| pose.vector_to_frame(v))
}

/// A direction of the frame at the time.
#[inline]
pub(super) fn to_time(pose: Option<&Pose>, v: Vec3) -> Vec3 {
    pose.map_or(v, |pose| pose.vector(v))
}

impl Lights {
    /// What a path of that time of the shutter sees.
    pub fn at(&self, time: f32) -> LightsAt<'_> {
        LightsAt { all: self, time, set: EVERYTHING }
    }

    pub fn is_moving(&self) -> bool {
        !self.motions.is_empty()
    }

    /// How many move.
    pub fn moving(&self) -> usize {
        self.motions.iter().flatten().count()
    }

    /// Placements of a mesh that is a light whose size changes, from that of the frame: it keeps its size as the light does,
    /// or it would be in the way of its own light. `None`: its own are those of the light.
    pub fn kept_size(&self, light: u32, frame: &Affine) -> Option<Keys<Affine>> {
        let motion = self.motions.get(light as usize)?.as_ref().filter(|motion| motion.stretched)?;
        let times = motion.keys.times().to_vec();
        let places = times.iter().map(|&time| motion.at(time).placed(frame)).collect();
        Some(Keys::new(times, places))
    }

    pub fn moves(&self, light: u32) -> bool {
        self.motions.get(light as usize).is_some_and(Option::is_some)
    }
}
