//! By which lobes a path has come: layers of the image by those of the first vertex, lights that shine on some lobes
//! more than on others by those of the last.

use super::{Bucket, Path};
use crate::bsdf::{Bsdf, Response};
use crate::film::Lobe;
use crate::math::Rgb;
use crate::scene::Scene;
use glam::Vec3;

/// Of the path under way; `None` as long as nothing has turned it.
#[derive(Debug, Clone, Copy)]
pub(super) struct By {
    /// Whether anyone asks; nothing is kept otherwise.
    pub told: bool,
    first: Option<Response>,
    pub last: Option<Response>,
}

impl By {
    pub fn nothing(told: bool) -> Self {
        Self { told, first: None, last: None }
    }

    /// What of `light`, met by `by`, is there, added to the sums that show it.
    pub fn sorted(
        &self,
        scene: &Scene,
        bucket: Bucket,
        by: Option<Response>,
        source: u32,
        light: Rgb,
        sums: &mut [Rgb],
    ) -> Rgb {
        let (light, by) = match by {
            None => (light, None),
            Some(by) => {
                let (taken, by) = by.to(scene.lights.response(source));
                (light * taken, Some(by))
            }
        };
        self.lay(bucket, by, light, sums);
        light
    }

    /// Adds `light`, met by `by`, to the sums that show it.
    pub fn lay(&self, bucket: Bucket, by: Option<Response>, light: Rgb, sums: &mut [Rgb]) {
        if sums.is_empty() {
            return;
        }
        // After a single vertex the first is the last one, with the share that this light has.
        let (first, straight) = match bucket {
            Bucket::Subsurface => return,
            Bucket::Direct => (by, true),
            Bucket::Indirect => (self.first, false),
        };
        match first {
            None => {}
            Some(Response::Reflected { diffuse }) => {
                Lobe::Diffuse.add(sums, straight, diffuse * light);
                Lobe::Specular.add(sums, straight, (Rgb::ONE - diffuse) * light);
            }
            // Out of a medium that has not scattered what goes into the bucket above.
            Some(Response::Transmitted | Response::Scattered) => Lobe::Transmission.add(sums, straight, light),
        }
    }
}

impl Path<'_> {
    /// By what `bsdf` gives `f` from `wi`; `None` where nobody asks.
    pub(super) fn response(&self, bsdf: &Bsdf, wi: Vec3, f: Rgb, delta: bool) -> Option<Response> {
        self.by.told.then(|| bsdf.response(wi, f, delta))
    }

    /// The path goes on by `by`.
    pub(super) fn turned(&mut self, by: Option<Response>) {
        if self.by.told {
            // The surface that the bucket of direct light names, too.
            if self.bucket == Bucket::Direct {
                self.by.first = by;
            }
            self.by.last = by;
        }
    }
}
