//! What a camera path notes of its first walks, so that the pixels around it may have a part of what it brings.

use super::collision::Into;
use super::{Path, WalkLog};
use crate::bsdf::Boundary;
use crate::film::Sample;
use crate::guiding::onward::Onward;
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::medium::Medium;
use crate::scene::BoundaryHit;
use crate::subsurface::steps::Start;
use crate::subsurface::technique::{GuidedMedium, PerTechnique, TECHNIQUES};
use glam::{BVec3, Vec3};

/// Most vertices behind the entry that are noted: each costs a sum over techniques, and the ways to it.
const MOST: usize = 8;

/// The same behind a diffuse boundary, where what is behind the entry is shared first.
const MOST_DIFFUSE: usize = 4;

/// Mean free paths in pixels above which all collisions of a group of pixels are near each other; behind a diffuse boundary the first
/// vertex is enough there.
pub(super) const WIDE: f32 = 8.0;

/// Mean free paths in pixels below which pixels have nothing to share.
const NARROW: f32 = 0.7;

/// Variance of a walk over its squared mean above which sharing pays where a mean free path is [`FEW`] pixels: what pixels
/// get from each other varies by itself. Where it is longer there is more to share.
const NOISY: f32 = 0.2;
const FEW: f32 = 1.0;

/// The same below which what is expected is subtracted from what is shared: of more noise it is no great part, and walks that bring
/// nothing need not be handed out then.
const QUIET: f32 = 3.0;

/// What a walk does at a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Collides,
    /// The same after the boundary has reflected it: the way there is its own.
    Returns,
    /// Comes out of a diffuse boundary: unit normal, on its way.
    Leaves(Vec3),
    /// Meets a boundary that asks where it came from: what is behind it is its own.
    Meets,
    /// Ends without light, outside of a boundary that it has not crossed.
    Leaks,
}

impl Kind {
    /// Whether it is scattered there.
    pub fn scatters(self) -> bool {
        matches!(self, Self::Collides | Self::Returns)
    }

    /// Whether no other walk could have made the step to it.
    pub fn is_own(self) -> bool {
        matches!(self, Self::Returns | Self::Meets)
    }
}

/// A vertex of a walk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Walk space.
    pub p: Vec3,
    pub kind: Kind,
    /// f / pdf of what leads there from the entry, the albedo of a collision included.
    pub weight: Rgb,
    /// The same of the step to it, however that ended: of a collision before its albedo, at the boundary before it reflects.
    pub arrived: Rgb,
}

/// Where a camera path entered a medium, and the first vertices of its walks there.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    pub(super) instance: u32,
    pub(super) surface: u32,
    pub(super) start: Start<BoundaryHit>,
    /// Shading normal, outward: directions that enter have its cosine.
    pub(super) normal: Vec3,
    pub(super) medium: Medium,
    /// Width of a pixel there, stage units.
    pub(super) footprint: f32,
    /// What the path carried in.
    pub(super) throughput: Rgb,
    /// Vertices behind the entry, of which `count` are noted.
    vertices: [Vertex; MOST],
    count: usize,
    /// That are to be noted; 0: the path is its pixel's alone.
    pub(super) most: usize,
    /// The first vertex that what is behind is shared of, 0 being the entry.
    pub(super) from: usize,
    /// With which the walk has met the boundary since the last of them; `None`: it has not.
    met: Option<Rgb>,
    /// Density ratios of what leads to the last of them that the first walk has, or to its end where there was room for more: which
    /// of these is last must not depend on what follows.
    pub(super) ratios: PerTechnique,
    /// Control variates of what is behind that, to be subtracted per throughput.
    pub(super) correction: Rgb,
    /// What a walk is expected to bring per throughput; 0: not known, or of no use.
    pub(super) expected: Rgb,
    /// Whether what it brought is no longer the path's own.
    apart: bool,
}

impl Entry {
    /// The vertices behind the entry.
    pub(super) fn vertices(&self) -> &[Vertex] {
        &self.vertices[..self.count]
    }

    /// Mean free path in pixels: the geometric mean of the channels, since all are judged alike.
    pub(super) fn across(&self) -> f32 {
        let sigma_t = self.medium.sigma_t;
        (sigma_t.x * sigma_t.y * sigma_t.z).cbrt().recip() / self.footprint
    }

    /// Channels that the path carried in: of others it brings nothing, wherever it goes.
    pub(super) fn carried(&self) -> BVec3 {
        self.throughput.cmpgt(Rgb::ZERO)
    }

    /// Takes in what is known of the walks that start here.
    pub(super) fn know(&mut self, onward: Option<&Onward>) {
        let Some(onward) = onward else { return };
        let noisy = NOISY * (FEW / self.across()).powi(2).min(1.0);
        if onward.noise < noisy {
            self.most = 0;
        } else if onward.noise < QUIET {
            // A channel that is absorbed at once has no weight to compare with, nor has one that is not carried.
            let known = self.medium.albedo.cmpgt(Rgb::ZERO) & self.carried();
            // Nor have walks that a clear channel may lead to no end.
            let ends = self.medium.sigma_t.min_element() > 0.0;
            self.expected = if ends { Rgb::select(known, onward.expected, Rgb::ZERO) } else { Rgb::ZERO };
        }
    }

    /// Weight with which a walk arrives at a collision that it leaves with `weight`.
    fn before_albedo(&self, weight: Rgb) -> Rgb {
        let albedo = self.medium.albedo;
        Rgb::select(albedo.cmpgt(Rgb::ZERO), weight / albedo, Rgb::ZERO)
    }

    fn note(&mut self, vertex: Vertex) -> bool {
        let room = self.count < self.most;
        if room {
            self.vertices[self.count] = vertex;
            self.count += 1;
        }
        room
    }
}

/// Where the walks of a path from its entry to its exit note their vertices.
pub(super) struct Notes<'a> {
    entry: &'a mut Entry,
    rows: &'a mut Vec<Rgb>,
    /// Weight since the entry over that since the walk's start; 0 in channels that the path did not carry in.
    scale: Rgb,
    /// Whether the walk is the first.
    first: bool,
}

impl WalkLog {
    /// Where a walk that starts with the path throughput `throughput` notes its vertices; `first`: of those since the entry.
    pub(super) fn notes(&mut self, throughput: Rgb, first: bool) -> Option<Notes<'_>> {
        let (entry, rows) = (self.entry.as_mut()?, &mut self.rows);
        let scale = Rgb::select(entry.carried(), throughput / entry.throughput, Rgb::ZERO);
        Some(Notes { entry, rows, scale, first })
    }
}

impl Notes<'_> {
    /// Whether there are vertices to be noted.
    pub fn has_room(&self) -> bool {
        self.entry.count < self.entry.most
    }

    /// A collision at `p`, walk space, before it looks for light `into` what is given.
    pub fn collision(&mut self, p: Vec3, weight: Rgb, ratios: PerTechnique, into: &Into) {
        let weight = self.since_entry(weight);
        let (kind, arrived) = match self.entry.met.take() {
            Some(arrived) => (Kind::Returns, arrived),
            None => (Kind::Collides, self.entry.before_albedo(weight)),
        };
        self.note(Vertex { p, kind, weight, arrived }, ratios, into);
    }

    /// The end of a walk that was never at the boundary: others might have ended there too.
    pub fn leak(&mut self, p: Vec3, weight: Rgb, ratios: PerTechnique, into: &Into) {
        let weight = self.since_entry(weight);
        if self.entry.met.is_none() {
            let arrived = self.entry.before_albedo(weight);
            self.note(Vertex { p, kind: Kind::Leaks, weight, arrived }, ratios, into);
        }
    }

    /// The end of the walk along `d`, walk space, with a normal there: noted unless collisions before it were not, or where the boundary
    /// may reflect it, once it is known what comes of that.
    pub fn exit(&mut self, (p, n): (Vec3, Vec3), d: Vec3, weight: Rgb, ratios: PerTechnique, into: &Into) {
        let weight = self.since_entry(weight);
        if self.entry.from > 0 {
            self.entry.met.get_or_insert(weight);
            if self.has_room() {
                self.control(ratios);
            }
            return;
        }
        let kind = Kind::Leaves(if d.dot(n) < 0.0 { -n } else { n });
        self.note(Vertex { p, kind, weight, arrived: weight }, ratios, into);
    }

    /// A channel that is no longer carried has no weight.
    fn since_entry(&self, weight: Rgb) -> Rgb {
        Rgb::select(self.scale.cmpgt(Rgb::ZERO), self.scale * weight, Rgb::ZERO)
    }

    fn control(&mut self, ratios: PerTechnique) {
        if self.first {
            self.entry.ratios = ratios;
        }
    }

    fn note(&mut self, vertex: Vertex, ratios: PerTechnique, into: &Into) {
        if self.entry.note(vertex) {
            self.rows.extend(brought(into.sample, into.groups, into.lobes));
            self.control(ratios);
        }
    }
}

impl Path<'_> {
    /// The entry of the path's first walk, if that is the one under way and is noted.
    pub(super) fn entry(&mut self, first: bool) -> Option<&mut Entry> {
        self.log.as_mut()?.entry.as_mut().filter(|_| first)
    }

    /// Notes where the path enters a medium first: one that came straight through air, as those around it did.
    pub(super) fn note_entry(
        &mut self,
        si: &Interaction,
        start: Start<BoundaryHit>,
        medium: &GuidedMedium,
        boundary: Boundary,
    ) -> bool {
        let plain = self.inside.is_empty();
        let Some(log) = self.log.as_mut().filter(|log| plain && log.shares && log.is_empty()) else { return false };
        log.rows.clear();
        log.rows.extend(brought(&self.sample, self.groups, self.lobes));
        let nowhere = Vertex { p: start.p, kind: Kind::Collides, weight: Rgb::ZERO, arrived: Rgb::ZERO };
        let mut entry = Entry {
            instance: si.instance,
            surface: si.surface,
            start,
            normal: si.frame.n,
            medium: medium.medium,
            footprint: self.cone.width,
            throughput: self.throughput,
            vertices: [nowhere; MOST],
            count: 0,
            most: 0,
            met: None,
            // The expectation of each: until a vertex is noted, control variates are for the whole walk.
            ratios: PerTechnique::from_list(&[1.0; TECHNIQUES]),
            correction: Rgb::ZERO,
            expected: Rgb::ZERO,
            from: usize::from(boundary != Boundary::Diffuse),
            apart: false,
        };
        entry.most = match entry.across() {
            across if across <= NARROW => 0,
            _ if boundary != Boundary::Diffuse => MOST,
            across if across > WIDE => 1,
            _ => MOST_DIFFUSE,
        };
        log.entry = Some(entry);
        true
    }

    /// Once the path behind the entry is over: what it brought since is the entry's, no longer its own.
    pub(super) fn set_apart(&mut self) {
        let Some(log) = self.log.as_mut() else { return };
        let Some(entry) = log.entry.as_mut().filter(|entry| !entry.apart) else { return };
        entry.apart = true;
        if let Some(arrived) = entry.met {
            let end = Vertex { p: entry.start.p, kind: Kind::Meets, weight: Rgb::ZERO, arrived };
            if entry.note(end) {
                log.rows.extend(brought(&self.sample, self.groups, self.lobes));
            }
        }
        let (rows, width) = (&mut log.rows, 1 + self.groups.len() + self.lobes.len());
        rows.extend(brought(&self.sample, self.groups, self.lobes));
        self.sample.subsurface = rows[0];
        self.groups.iter_mut().chain(&mut *self.lobes).zip(&rows[1..]).for_each(|(own, before)| *own = *before);
        for i in width..rows.len() {
            rows[i - width] = rows[i] - rows[i - width];
        }
        rows.truncate(rows.len() - width);
    }

    /// Whether all that the path brought is.
    pub(super) fn is_finite(&self) -> bool {
        let apart = self.log.as_ref().filter(|log| log.entry.is_some());
        let width = 1 + self.groups.len() + self.lobes.len();
        self.sample.color().is_finite()
            && apart.is_none_or(|log| log.rows.iter().step_by(width).all(|brought| brought.is_finite()))
    }

    /// Nothing can be said of what the path brought.
    pub(super) fn set_nothing_apart(&mut self) {
        let Some(log) = self.log.as_mut() else { return };
        log.rows.fill(Rgb::ZERO);
        if let Some(entry) = &mut log.entry {
            entry.correction = Rgb::ZERO;
        }
    }
}

/// What a path has brought from inside media, then by layer.
fn brought<'a>(sample: &Sample, groups: &'a [Rgb], lobes: &'a [Rgb]) -> impl Iterator<Item = Rgb> + use<'a> {
    std::iter::once(sample.subsurface).chain(groups.iter().chain(lobes).copied())
}
