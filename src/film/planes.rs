//! The film's sums as images: one plane per AOV.

use super::{Film, NO_DEPTH, Tile};
use crate::flat::{LIGHT_AOV, PRIMVAR_AOV};
use crate::math::Rgb;
use glam::{DVec3, Vec3};
use std::borrow::Cow;

/// A resolved AOV: `channels` interleaved, rows top down, over the data window.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    pub name: Cow<'static, str>,
    pub channels: usize,
    pub values: Vec<f32>,
}

/// Of the nearest sample of a pixel.
pub const GEOMETRY: [&str; 9] =
    ["depth", "normal", "position", "primId", "distance", "deviceDepth", "Peye", "Neye", MOTION];

pub const MOTION: &str = "motionVector";

impl Film {
    /// RGBA, premultiplied.
    pub fn color(&self) -> Plane {
        self.gathered().as_ref().unwrap_or(self).own_color()
    }

    /// The image so far: `color` (RGBA, premultiplied) first, then the planes asked for.
    pub fn resolve(&self) -> Vec<Plane> {
        self.gathered().as_ref().unwrap_or(self).resolve_own()
    }

    fn own_color(&self) -> Plane {
        self.plane("color", 4, |t, i| {
            let n = f64::from(t.samples[i].max(1));
            let c = t.color[i] / n * f64::from(self.exposure);
            [c.x as f32, c.y as f32, c.z as f32, t.alpha[i] / n as f32]
        })
    }

    /// Of the sums that each pixel has.
    fn resolve_own(&self) -> Vec<Plane> {
        let mut planes = vec![self.own_color()];
        planes.push(self.plane("alpha", 1, |t, i| [t.alpha[i] / t.samples[i].max(1) as f32, 0.0, 0.0, 0.0]));
        let rgb = |c: Rgb| [c.x, c.y, c.z, 0.0];
        let mean = |t: &Tile, i: usize, c: Rgb| c / t.samples[i].max(1) as f32;
        if self.planes.geometry {
            planes.extend(self.geometry_planes());
        }
        if self.planes.albedo {
            planes.push(self.plane("albedo", 3, |t, i| rgb(mean(t, i, t.albedo[i]))));
        }
        if self.planes.buckets {
            for (b, name) in ["direct", "indirect", "subsurface"].into_iter().enumerate() {
                planes.push(self.plane(name, 3, |t, i| rgb(mean(t, i, t.buckets[i][b]) * self.exposure)));
            }
        }
        if self.planes.straight {
            let straight = |t: &Tile, i: usize| mean(t, i, t.straight[i]) * self.exposure;
            planes.push(self.plane("emission", 3, |t, i| rgb(straight(t, i))));
            if self.planes.buckets {
                let direct = |t: &Tile, i: usize| mean(t, i, t.buckets[i][0]) * self.exposure;
                planes.push(self.plane("firstBounce", 3, |t, i| rgb(direct(t, i) - straight(t, i))));
            }
        }
        if self.planes.variance {
            let scale = f64::from(self.exposure * self.exposure);
            planes.push(self.plane("variance", 3, |t, i| {
                // One sample knows nothing of its variance: 0 rather than an infinity in the file.
                let v = if t.samples[i] < 2 { DVec3::ZERO } else { t.mean_variance(i) * scale };
                // Squares of radiances above 1e19 leave single precision: its largest number, not an infinity.
                rgb(v.min(DVec3::splat(f64::from(f32::MAX))).as_vec3())
            }));
        }
        let of_lights = self.aovs.iter().filter(|aov| aov.starts_with(LIGHT_AOV));
        for (k, aov) in of_lights.enumerate() {
            let at = |i: usize| i * self.planes.lights + k;
            planes.push(self.plane(aov.clone(), 3, |t, i| rgb(mean(t, i, t.lights[at(i)]) * self.exposure)));
        }
        if self.planes.walks {
            planes.extend(self.walk_planes());
        }
        if self.planes.lobes {
            planes.extend(self.lobe_planes());
        }
        planes.extend(self.sums(&planes));
        planes.push(self.plane("sampleCount", 1, |t, i| [t.samples[i] as f32, 0.0, 0.0, 0.0]));
        planes.retain(|plane| plane.name == "color" || self.aovs.iter().any(|aov| *aov == plane.name));
        planes.extend(self.primvar_planes());
        if self.planes.objects {
            planes.extend(self.object_planes());
        }
        planes
    }

    fn primvar_planes(&self) -> Vec<Plane> {
        let names: Vec<&String> = self.aovs.iter().filter(|aov| aov.starts_with(PRIMVAR_AOV)).collect();
        let plane = |(k, name): (usize, &&String)| {
            self.plane((*name).clone(), 3, |t, i| {
                (t.primvars[i * names.len() + k] / t.samples[i].max(1) as f32).extend(0.0).to_array()
            })
        };
        names.iter().enumerate().map(plane).collect()
    }

    fn geometry_planes(&self) -> Vec<Plane> {
        let vector = |v: Vec3| v.extend(0.0).to_array();
        let one = |value: f32| [value, 0.0, 0.0, 0.0];
        let wanted = |name: &str| self.aovs.iter().any(|aov| aov == name);
        let mut planes = vec![
            self.plane("depth", 1, |t, i| one(t.first[i].depth)),
            self.plane("normal", 3, |t, i| vector(t.first[i].normal)),
            self.plane("position", 3, |t, i| vector(t.first[i].position)),
            self.plane("primId", 1, |t, i| one(t.first[i].prim_id as f32)),
        ];
        if self.planes.motion {
            planes.push(self.plane(MOTION, 2, |t, i| [t.motion[i].x, t.motion[i].y, 0.0, 0.0]));
        }
        let Some(view) = self.view.filter(|_| GEOMETRY[4..8].iter().any(|name| wanted(name))) else { return planes };
        let eye = |t: &Tile, i: usize| match t.first[i].prim_id {
            -1 => Vec3::ZERO,
            _ => view.eye_point(t.first[i].position),
        };
        let distance = |t: &Tile, i: usize| if t.first[i].prim_id < 0 { NO_DEPTH } else { eye(t, i).length() };
        planes.push(self.plane("distance", 1, |t, i| one(distance(t, i))));
        planes.push(self.plane("deviceDepth", 1, |t, i| one(view.device_depth(t.first[i].depth))));
        planes.push(self.plane("Peye", 3, |t, i| vector(eye(t, i))));
        planes.push(self.plane("Neye", 3, |t, i| vector(view.eye_vector(t.first[i].normal))));
        planes
    }

    pub(super) fn plane(
        &self,
        name: impl Into<Cow<'static, str>>,
        channels: usize,
        value: impl Fn(&Tile, usize) -> [f32; 4],
    ) -> Plane {
        let width = self.data_window.width() as usize;
        let mut values = vec![0.0; width * self.data_window.height() as usize * channels];
        self.for_each_tile(|tile| {
            for i in 0..tile.samples.len() {
                let x = tile.x0.abs_diff(self.data_window.x0) as usize + i % tile.width as usize;
                let y = tile.y0.abs_diff(self.data_window.y0) as usize + i / tile.width as usize;
                let at = (y * width + x) * channels;
                values[at..at + channels].copy_from_slice(&value(tile, i)[..channels]);
            }
        });
        Plane { name: name.into(), channels, values }
    }
}
