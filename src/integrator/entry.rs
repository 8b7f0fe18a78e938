//! What a camera path notes of its first walk, so that other pixels may have a part of what it brings.

use super::Path;
use crate::interaction::Interaction;
use crate::math::Rgb;
use crate::medium::Medium;
use crate::scene::BoundaryHit;
use crate::subsurface::steps::Start;
use crate::subsurface::technique::{GuidedMedium, PerTechnique, TECHNIQUES};
use glam::Vec3;

/// Most vertices behind the entry that are noted.
pub(super) const MOST: usize = 6;

/// A vertex of a walk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    /// Walk space.
    pub p: Vec3,
    /// Outward normal, unit, where the walk comes out; else it collides.
    pub exit: Option<Vec3>,
    /// f / pdf of what leads there from the entry, without the albedo of a collision.
    pub weight: Rgb,
}

/// Where a camera path entered a medium through a diffuse boundary, and what it brought from inside.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    pub(super) instance: u32,
    pub(super) start: Start<BoundaryHit>,
    /// Shading normal, outward: directions that enter have its cosine.
    pub(super) normal: Vec3,
    pub(super) medium: Medium,
    /// Width of a pixel.
    pub(super) footprint: f32,
    /// What the path carried in.
    pub(super) throughput: Rgb,
    /// Vertices behind the entry, of which `count` are noted.
    vertices: [Vertex; MOST],
    count: usize,
    /// To be noted.
    pub(super) most: u32,
    /// Density ratios of what leads to the last of them.
    pub(super) ratios: PerTechnique,
    /// Control variates of what is behind it, to be subtracted per throughput.
    pub(super) correction: Rgb,
    /// What a walk is expected to bring per throughput; 0: not known.
    pub(super) expected: Rgb,
    /// What the path had brought before it entered; then, what it brought since.
    pub(super) brought: Rgb,
}

impl Entry {
    /// Mean free path in pixels.
    pub(super) fn across(&self) -> f32 {
        (self.medium.sigma_t.min_element() * self.footprint).recip()
    }

    /// What walks from here bring is known to vary by `noise`, variance over squared mean.
    pub(super) fn know(&mut self, noise: Option<f32>) {
        use super::reuse::env;
        let across = self.across();
        let worth = noise.is_none_or(|noise| noise > env("CT", 2.0) * (env("CA", 1.5) / across).powi(2).min(1.0)) && across > env("CF", 0.3);
        self.most = if !worth { 0 } else if across > env("CM", 8.0) { 1 } else { self.most };
    }

    /// The vertices behind the entry.
    pub(super) fn vertices(&self) -> &[Vertex] {
        &self.vertices[..self.count]
    }

    /// A collision at `p`, walk space.
    pub(super) fn collision(&mut self, p: Vec3, weight: Rgb, ratios: PerTechnique) {
        self.note(Vertex { p, exit: None, weight }, ratios);
    }

    /// The end of the walk, walk space, with the normal there.
    pub(super) fn exit(&mut self, (p, n): (Vec3, Vec3), weight: Rgb, ratios: PerTechnique) {
        self.note(Vertex { p, exit: Some(n), weight }, ratios);
    }

    fn note(&mut self, vertex: Vertex, ratios: PerTechnique) {
        if self.count < self.most as usize {
            self.vertices[self.count] = vertex;
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

    /// Notes where the path enters a medium first.
    pub(super) fn note_entry(&mut self, si: &Interaction, start: Start<BoundaryHit>, medium: &GuidedMedium) {
        let Some(log) = self.log.as_mut().filter(|log| log.shares) else { return };
        log.layers.clear();
        log.layers.extend(self.groups.iter().chain(&*self.lobes));
        let nowhere = Vertex { p: start.p, exit: None, weight: Rgb::ZERO };
        log.entry = Some(Entry {
            instance: si.instance,
            start,
            normal: si.frame.n,
            medium: medium.medium,
            footprint: self.cone.width,
            throughput: self.throughput,
            vertices: [nowhere; MOST],
            count: 0,
            most: log.most,
            ratios: PerTechnique::from_list(&[1.0; TECHNIQUES]),
            correction: Rgb::ZERO,
            expected: Rgb::ZERO,
            brought: self.sample.subsurface,
        });
    }

    /// Once the path is over: what it brought since it entered is the entry's, no longer its own.
    pub(super) fn set_apart(&mut self) {
        let Some(log) = self.log.as_mut() else { return };
        let Some(entry) = &mut log.entry else { return };
        let before = entry.brought;
        entry.brought = self.sample.subsurface - before;
        self.sample.subsurface = before;
        for (own, apart) in self.groups.iter_mut().chain(&mut *self.lobes).zip(&mut log.layers) {
            let before = *apart;
            *apart = *own - before;
            *own = before;
        }
    }
}
