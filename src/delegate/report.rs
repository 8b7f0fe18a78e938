//! What a delegate tells of its scene and its render: what is needed, what it took.

use super::RenderDelegate;
use super::pass::Pass;
use crate::guiding::look;
use crate::integrator::PathStats;
use crate::render::GuideStats;
use crate::scene::{Geometry, Scene};
use serde_json::{Value, json};
use std::sync::Arc;

impl RenderDelegate {
    /// What the committed scene needs, what was switched on and why, what was dropped.
    pub fn explain(&self) -> Value {
        let lines = |scene: &Arc<Scene>| [scene.needs.explain(), look::explain(scene, &self.flat.settings)].concat();
        json!({
            "needs": self.scene.as_ref().map(|scene| &scene.needs),
            "capabilities": self.scene.as_ref().map(lines),
            "media": self.media(),
            "subdivision": self.subdivision(),
            "warnings": self.warnings(),
        })
    }

    /// What became of each visible subdivision surface of the committed scene.
    fn subdivision(&self) -> Vec<Value> {
        let line = |(path, geometry): (&String, &Arc<Geometry>)| {
            let (refinement, mesh) = (geometry.refinement.as_ref()?, self.flat.meshes.get(path)?);
            Some(json!({
                "prim": path,
                "scheme": mesh.subdivision_scheme,
                "level": refinement.level,
                "cageFaces": refinement.cage_faces,
                "triangles": geometry.triangles.len(),
            }))
        };
        self.kept.geometry.iter().filter_map(line).collect()
    }

    /// Which walk each medium of the committed scene takes, and why.
    fn media(&self) -> Vec<look::MediumPlan> {
        let scene = self.scene.as_ref().filter(|_| self.clean);
        scene.map_or(Vec::new(), |scene| look::media(scene, &self.flat.settings, &self.flat.meshes))
    }

    /// The statistics of the contract.
    pub fn stats(&self) -> Value {
        let counts = self.pass.as_ref().map_or(PathStats::default(), |pass| pass.progress.stats());
        let seconds = self.pass.as_ref().map_or(0.0, Pass::render_seconds);
        let guide = self.pass.as_ref().map(|pass| pass.progress.guide()).unwrap_or_default();
        let report = self.report();
        json!({
            "settings": self.flat.settings,
            "samples_per_pixel": self.pass.as_ref().map_or(0.0, |pass| pass.film.samples_per_pixel()),
            "seconds": { "compile": self.compiled.seconds, "train": guide.seconds, "render": seconds },
            "rays": { "total": counts.rays + counts.shadow_rays + counts.walk.steps,
                      "path": counts.rays, "shadow": counts.shadow_rays },
            "walks": counts.walk.walks,
            "walk_steps": counts.walk.steps,
            "walks_leaked": counts.walk.leaked,
            "walks_too_long": counts.walk.too_long,
            "paths_trapped": counts.trapped,
            "non_finite_samples": counts.non_finite,
            "compile": self.compiled,
            "guide": self.guide_stats(&guide, seconds),
            "adaptive": report.adaptive,
            "resumed_samples_per_pixel": report.resumed,
            "checkpoints": report.checkpoints.len(),
            "peak_rss_bytes": peak_rss_bytes(),
            "needs": self.scene.as_ref().map(|scene| &scene.needs),
            "warnings": self.warnings(),
        })
    }

    /// What was learned in a render of `seconds`, and for whom.
    fn guide_stats(&self, guide: &GuideStats, seconds: f64) -> Value {
        let mut stats = json!(guide);
        stats["training_share"] = json!(if seconds > 0.0 { guide.seconds / seconds } else { 0.0 });
        stats["media"] = json!(self.media());
        stats
    }
}

/// Largest resident size so far, bytes; `None` where the system does not tell through procfs.
fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}
