//! Filling the volumes behind smooth dielectrics with beams of light before the first pass.

use super::bodies::{Aim, Body, share_records};
use super::training::{BoundaryOf, Training, probed};
use crate::guiding::Guide;
use crate::guiding::beams::{Beam, Beams};
use crate::integrator::{PROBED_LIGHTS, PathStats};
use crate::medium::Medium;

/// Points at which beams of light are looked for, over records of a boundary cache: they follow no path.
const PER_RECORD: u32 = 2;

/// Beams that are shared among all bodies: some 32 in each of the cells that a light sees of the largest grid. While they are
/// sorted into cells, each takes about a kilobyte. A small body gets more than its share, `LEAST_RECORDS` where it is worth
/// `WORTH`: many of them have up to four times as many in all.
const MOST: u32 = 80_000;

impl<Over: Fn() -> bool> Training<'_, Over> {
    /// Gives `guide` the beams that its plans need, by as many points as go with `records`. What is left out is found by
    /// chance.
    pub(super) fn add_beams(&mut self, guide: &mut Guide, records: u32) -> PathStats {
        let mut stats = PathStats::default();
        let lights = self.scene.lights.count_met().min(PROBED_LIGHTS) as u32;
        if lights == 0 {
            return stats;
        }
        let most = records.min(MOST / (PER_RECORD * lights));
        let (bodies, _) = share_records(self.scene, guide, Aim::Beams, most);
        for body in bodies {
            let Some((found, medium, seen)) = self.beams(guide, &body) else { break };
            stats.add(&seen);
            if let Some(beams) = medium.and_then(|medium| Beams::build(&found, &medium)) {
                guide.set_beams(self.scene.instances.len(), &body.members, beams);
            }
        }
        stats
    }

    /// Light that enters a body, seen from as many of those that share it as are worth a look; `None`: it is over.
    fn beams(&mut self, guide: &Guide, body: &Body) -> Option<(Vec<Beam>, Option<Medium>, PathStats)> {
        let probed = probed(body);
        let count = (PER_RECORD * body.records).div_ceil(probed.len() as u32);
        let (mut all, mut medium, mut stats) = (Vec::new(), None, PathStats::default());
        let (scene, seed) = (self.scene.middle(), self.settings.seed);
        for boundary in probed.into_iter().filter_map(|instance| BoundaryOf::new(scene, guide, instance, Aim::Beams)) {
            let by_area = |points| boundary.beams_by_area(seed, points, count);
            let (mut found, seen) = self.journal.gather(count, &self.is_over, by_area)?;
            all.append(&mut found);
            stats.add(&seen);
            medium.get_or_insert(boundary.medium);
        }
        Some((all, medium, stats))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::delegate::{DirtyBits, RenderDelegate};
    use crate::flat::RenderSettings;
    use crate::flat::{Camera, GeomSubset, Light, LightShape, Material, Mesh, PreviewSurface, Prim};
    use crate::guiding::plan::Looks;
    use crate::render::journal::Journal;
    use crate::scene::Scene;
    use std::sync::Arc;

    /// A cube of side 2 at (`x`, 0, -5): faces of `first` wear `/First`, the others `/Second`.
    fn cube(x: f64, first: std::ops::Range<i32>) -> Mesh {
        let point = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|side| 2.0 * side as f32 - 1.0);
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let subset = |name: &str, indices: Vec<i32>| GeomSubset {
            path: format!("/O{name}"),
            indices: indices.into(),
            material: name.into(),
        };
        let others = (0..6).filter(|face| !first.contains(face)).collect();
        let mut mesh = Mesh {
            points: (0..8).map(point).collect::<Vec<_>>().into(),
            face_vertex_counts: vec![4; 6].into(),
            face_vertex_indices: faces.concat().into(),
            geom_subsets: vec![subset("/First", first.collect()), subset("/Second", others)],
            ..Mesh::default()
        };
        (mesh.transform[3][0], mesh.transform[3][2]) = (x, -5.0);
        mesh
    }

    /// Walks in clear glass are classical and look for light, those in dense glass follow the mixture.
    fn glass(radius: f32) -> Prim {
        Prim::Material(Material::UsdPreviewSurface(PreviewSurface {
            subsurface: 1.0,
            subsurface_radius: [radius; 3],
            subsurface_boundary: "dielectric".into(),
            roughness: 0.0,
            ..PreviewSurface::default()
        }))
    }

    fn scene(meshes: Vec<Mesh>, radii: [f32; 2], light: LightShape) -> Arc<Scene> {
        let mut light = Light { shape: light, ..Light::default() };
        light.transform[3] = [4.0, 4.0, -1.0, 1.0];
        let mut delegate = RenderDelegate::new();
        for (i, mesh) in meshes.into_iter().enumerate() {
            delegate.sync(&format!("/O{i}"), Prim::Mesh(mesh), DirtyBits::ALL);
        }
        delegate.sync("/First", glass(radii[0]), DirtyBits::ALL);
        delegate.sync("/Second", glass(radii[1]), DirtyBits::ALL);
        delegate.sync("/C", Prim::Camera(Camera::default()), DirtyBits::ALL);
        delegate.sync("/L", Prim::Light(light), DirtyBits::ALL);
        delegate.set_settings(settings()).expect("settings");
        delegate.commit().expect("commit");
        delegate.scene().expect("scene").clone()
    }

    fn settings() -> RenderSettings {
        RenderSettings { camera: "/C".into(), resolution: [8, 8], samples: 1, ..RenderSettings::default() }
    }

    fn trained(scene: &Scene, is_over: bool) -> (Guide, u64) {
        let mut guide = Guide::new(scene, &settings());
        let (settings, journal) = (settings(), Journal::default());
        let trained = Training { scene, settings: &settings, journal, limit: None, points: None, is_over: || is_over }
            .train(&mut guide);
        (guide, trained.records)
    }

    const BALL: LightShape = LightShape::Sphere { radius: 0.3 };
    const CLEAR_AND_DENSE: [f32; 2] = [0.5, 0.01];

    /// Whichever comes first, and without taking away from each other.
    #[test]
    fn parts_of_a_mesh_have_what_they_need() {
        let [clear, dense] = CLEAR_AND_DENSE;
        for radii in [[clear, dense], [dense, clear]] {
            let scene = scene(vec![cube(0.0, 0..3)], radii, BALL);
            let (guide, _) = trained(&scene, false);
            assert!(guide.fields[0].is_some(), "{radii:?}: no field");
            assert!(guide.beams_in(0).is_some(), "{radii:?}: no beams");
            let (guide, records) = trained(&scene, true);
            assert!(guide.fields[0].is_none() && guide.beams_in(0).is_none() && records == 0, "it was over");
        }
    }

    #[test]
    fn bodies_without_a_cache_take_no_records() {
        let (dense, clear) = (cube(-1.5, 0..0), cube(1.5, 0..6));
        let (_, of_one) = trained(&scene(vec![dense.clone()], CLEAR_AND_DENSE, BALL), false);
        let (guide, of_both) = trained(&scene(vec![dense, clear], CLEAR_AND_DENSE, BALL), false);
        assert_eq!(of_one, of_both);
        assert!(guide.fields[0].is_some() && guide.fields[1].is_none());
        assert!(guide.beams_in(0).is_none() && guide.beams_in(1).is_some());
    }

    /// A mesh light is met by chance alone, and no plan says otherwise.
    #[test]
    fn mesh_lights_are_not_looked_for() {
        let lamp = triangle(1.0, 3.0);
        let looks = |light: LightShape| {
            let scene = scene(vec![cube(0.0, 0..6), lamp.clone()], CLEAR_AND_DENSE, light);
            assert_eq!(scene.lights.len(), 1);
            ["auto", "on"].map(|refracted_light| {
                let settings = RenderSettings { refracted_light: refracted_light.into(), ..settings() };
                Guide::new(&scene, &settings).plans.iter().flatten().any(|plan| plan.looks != Looks::Not)
            })
        };
        assert_eq!(looks(LightShape::Mesh { mesh: "/O1".into() }), [false; 2]);
        assert_eq!(looks(BALL), [true; 2]);
    }

    /// Of a side of two `size`s, at the height `y`.
    fn triangle(size: f32, y: f32) -> Mesh {
        Mesh {
            points: vec![[-size, y, -5.0], [size, y, -5.0], [0.0, y, size - 5.0]].into(),
            face_vertex_counts: vec![3].into(),
            face_vertex_indices: vec![0, 1, 2].into(),
            material: String::new(),
            ..Mesh::default()
        }
    }

    #[test]
    fn bodies_with_something_within_are_not_looked_at() {
        let scene = scene(vec![cube(0.0, 0..6), triangle(0.1, 0.0)], CLEAR_AND_DENSE, BALL);
        let (guide, _) = trained(&scene, false);
        assert!(guide.beams_in(0).is_none() && !guide.plans.iter().flatten().any(|plan| plan.looks != Looks::Not));
    }
}
