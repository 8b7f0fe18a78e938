//! What a camera path notes of its first walk, so that the pixels around it may have a part of what it brings.

use super::Path;
use crate::guiding::onward::Onward;
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::medium::Medium;
use crate::scene::BoundaryHit;
use crate::subsurface::steps::Start;
use crate::subsurface::technique::{GuidedMedium, PerTechnique, TECHNIQUES};
use glam::{BVec3, Vec3};

/// Most vertices behind the entry that are noted: each is a mean free path farther from the entry, and costs a sum over techniques.
const MOST: usize = 4;

/// Mean free paths in pixels above which the first vertex is enough, and collisions too far apart to be of use to each other.
pub(super) const WIDE: f32 = 8.0;

/// Mean free paths in pixels below which pixels have nothing to share.
const NARROW: f32 = 0.7;

/// Variance of a walk over its squared mean above which sharing pays where a mean free path is [`FEW`] pixels: what pixels
/// get from each other varies by itself. Where it is longer there is more to share.
const NOISY: f32 = 2.0;
const FEW: f32 = 1.0;

/// The same below which what is expected is subtracted from what is shared: of more noise it is no great part, and walks that bring
/// nothing need not be handed out then.
const QUIET: f32 = 3.0;

/// What a walk does at a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Collides,
    /// Comes out: unit normal, on its way.
    Leaves(Vec3),
    /// Ends without light, outside of a boundary that it has not crossed.
    Leaks,
}

/// A vertex of a walk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Walk space.
    pub p: Vec3,
    pub kind: Kind,
    /// f / pdf of what leads there from the entry, the albedo of a collision included.
    pub weight: Rgb,
}

/// Where a camera path entered a medium through a diffuse boundary, and what it brought from inside.
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
    /// Density ratios of what leads to the last of them.
    pub(super) ratios: PerTechnique,
    /// Control variates of what is behind it, to be subtracted per throughput.
    pub(super) correction: Rgb,
    /// What a walk is expected to bring per throughput; 0: not known, or of no use.
    pub(super) expected: Rgb,
    /// What the path had brought before it entered; then, what it brought since.
    pub(super) brought: Rgb,
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

    /// A collision at `p`, walk space.
    pub(super) fn collision(&mut self, p: Vec3, weight: Rgb, ratios: PerTechnique) {
        self.note(Vertex { p, kind: Kind::Collides, weight }, ratios);
    }

    /// The end of the walk along `d`, walk space, with a normal there: noted unless collisions before it were not.
    pub(super) fn exit(&mut self, (p, n): (Vec3, Vec3), d: Vec3, weight: Rgb, ratios: PerTechnique) {
        let n = if d.dot(n) < 0.0 { -n } else { n };
        self.note(Vertex { p, kind: Kind::Leaves(n), weight }, ratios);
    }

    /// The end of a walk that was never at the boundary: others might have ended there too.
    pub(super) fn leak(&mut self, p: Vec3, weight: Rgb, ratios: PerTechnique) {
        self.note(Vertex { p, kind: Kind::Leaks, weight }, ratios);
    }

    fn note(&mut self, vertex: Vertex, ratios: PerTechnique) {
        if self.count < self.most {
            let weight = Rgb::select(self.carried(), vertex.weight, Rgb::ZERO);
            self.vertices[self.count] = Vertex { weight, ..vertex };
            self.count += 1;
            self.ratios = ratios;
        }
    }
}

impl Path<'_> {
    /// The entry of the path's first walk, if that is the one under way and is noted.
    pub(super) fn entry(&mut self, first: bool) -> Option<&mut Entry> {
        self.log.as_mut()?.entry.as_mut().filter(|_| first)
    }

    /// Notes where the path enters a medium first: one that came straight through air, as those around it did.
    pub(super) fn note_entry(&mut self, si: &Interaction, start: Start<BoundaryHit>, medium: &GuidedMedium) {
        let plain = self.inside.is_empty();
        let Some(log) = self.log.as_mut().filter(|log| plain && log.shares && log.is_empty()) else { return };
        log.layers.clear();
        log.layers.extend(self.groups.iter().chain(&*self.lobes));
        let nowhere = Vertex { p: start.p, kind: Kind::Collides, weight: Rgb::ZERO };
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
            // The expectation of each: until a vertex is noted, control variates are for the whole walk.
            ratios: PerTechnique::from_list(&[1.0; TECHNIQUES]),
            correction: Rgb::ZERO,
            expected: Rgb::ZERO,
            brought: self.sample.subsurface,
            apart: false,
        };
        entry.most = match entry.across() {
            across if across > WIDE => 1,
            across if across > NARROW => MOST,
            _ => 0,
        };
        log.entry = Some(entry);
    }

    /// Once the path behind the entry is over: what it brought since is the entry's, no longer its own.
    pub(super) fn set_apart(&mut self) {
        let Some(log) = self.log.as_mut() else { return };
        let Some(entry) = log.entry.as_mut().filter(|entry| !entry.apart) else { return };
        entry.apart = true;
        let before = entry.brought;
        entry.brought = self.sample.subsurface - before;
        self.sample.subsurface = before;
        for (own, apart) in self.groups.iter_mut().chain(&mut *self.lobes).zip(&mut log.layers) {
            let before = *apart;
            *apart = *own - before;
            *own = before;
        }
    }

    /// Whether all that the path brought is.
    pub(super) fn is_finite(&self) -> bool {
        let entry = self.log.as_ref().and_then(|log| log.entry.as_ref());
        self.sample.color().is_finite() && entry.is_none_or(|entry| entry.brought.is_finite())
    }

    /// Nothing can be said of what the path brought.
    pub(super) fn set_nothing_apart(&mut self) {
        let Some(log) = self.log.as_mut() else { return };
        log.layers.fill(Rgb::ZERO);
        if let Some(entry) = &mut log.entry {
            (entry.brought, entry.correction) = (Rgb::ZERO, Rgb::ZERO);
        }
    }
}
