//! The render delegate: Hydra's contract without Hydra. Prims are synced by path with dirty bits, a commit
//! compiles what changed, a render pass runs in the background and fills AOV buffers.

mod exr;
mod fingerprint;
mod pass;
mod report;

pub use exr::{LayerSpec, xy};

use crate::error::{Error, Result, Warning};
use crate::film::Plane;
use crate::flat::{self, FlatScene, Prim, RenderSettings, StageInfo, validate};
use crate::render::{Keep, Progress, Report, film_for, render};
use crate::scene::{CompileStats, Kept, Residency, Scene, compile, compile_last, eye_of, page_out};
use pass::Pass;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

bitflags::bitflags! {
    /// What of a prim changed; names as in HdChangeTracker.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub struct DirtyBits: u32 {
        const TOPOLOGY = 1;
        const POINTS = 2;
        const TRANSFORM = 4;
        const PRIMVAR = 8;
        const NORMALS = 16;
        const VISIBILITY = 32;
        const MATERIAL_ID = 64;
        const DOUBLE_SIDED = 128;
        const INSTANCER = 256;
        /// Materials, lights, cameras, textures.
        const PARAMS = 512;
        /// Light linking.
        const CATEGORIES = 1024;
        const ALL = 2047;
        /// Bits after which a mesh must be compiled anew.
        const GEOMETRY = Self::TOPOLOGY.bits() | Self::POINTS.bits() | Self::PRIMVAR.bits() | Self::NORMALS.bits();
    }
}

/// World bounds.
type Bounds = ([f64; 3], [f64; 3]);

/// Least and greatest coordinates in the space of a mesh.
type ObjectBox = (glam::Vec3, glam::Vec3);

/// What is asked of a scene whose meshes were let go.
struct Last {
    digest: u64,
    /// Of points, by mesh.
    boxes: BTreeMap<String, ObjectBox>,
}

#[derive(Default)]
pub struct RenderDelegate {
    flat: FlatScene,
    /// Meshes as they were authored, where validation changed them: an edit applies to these.
    authored: BTreeMap<String, flat::Mesh>,
    kept: Kept,
    /// Of the images that are in scratch files.
    residency: Arc<Residency>,
    scene: Option<Arc<Scene>>,
    /// What is compiled is what is described.
    clean: bool,
    /// `None`: edits may follow.
    last: Option<Last>,
    /// By prim, from the validation at its sync: a prim that is synced anew replaces its own.
    prim_warnings: BTreeMap<String, Vec<Warning>>,
    commit_warnings: Vec<Warning>,
    compiled: CompileStats,
    pass: Option<Pass>,
}

impl RenderDelegate {
    pub fn new() -> Self {
        Self::default()
    }

    /// A delegate that holds an already flattened scene, which it validates.
    pub fn from_flat(mut flat: FlatScene) -> Self {
        let warnings = flat.validate();
        let mut delegate = Self::default();
        delegate.flat = flat;
        delegate.prim_warnings.insert(String::new(), warnings);
        delegate
    }

    pub fn flat(&self) -> &FlatScene {
        &self.flat
    }

    /// The description with its arrays.
    ///
    /// # Errors
    /// After the last commit they are gone.
    pub fn whole(&self) -> Result<&FlatScene> {
        let gone = || Error::Other("the last commit let go what meshes are made of; nothing can follow it".into());
        if self.last.is_some() { Err(gone()) } else { Ok(&self.flat) }
    }

    /// Inserts a prim, or replaces the aspects of it that `bits` name. Stops a render under way.
    pub fn sync(&mut self, path: &str, mut prim: Prim, bits: DirtyBits) {
        self.edit();
        if let Prim::Mesh(new) = prim {
            prim = Prim::Mesh(self.merge_mesh(path, new, bits));
        }
        let authored = prim.clone();
        let mut warnings = Vec::new();
        validate::validate_prim(path, &mut prim, &mut warnings);
        let path = path.to_owned();
        if let (Prim::Mesh(mesh), false) = (authored, warnings.is_empty()) {
            self.authored.insert(path.clone(), mesh);
        }
        self.prim_warnings.insert(path.clone(), warnings);
        match prim {
            Prim::Mesh(mesh) => drop(self.flat.meshes.insert(path, mesh)),
            Prim::Instancer(instancer) => drop(self.flat.instancers.insert(path, instancer)),
            Prim::Material(material) => {
                self.kept.forget(&path);
                self.flat.materials.insert(path, material);
            }
            Prim::Light(light) => drop(self.flat.lights.insert(path, light)),
            Prim::Camera(camera) => drop(self.flat.cameras.insert(path, camera)),
            Prim::Texture(texture) => drop(self.flat.textures.insert(path, texture)),
            Prim::Image(image) => {
                self.kept.forget(&path);
                self.flat.images.insert(path, image);
                // Now, so that images that do not fit are in memory one by one.
                self.page_out();
            }
        }
    }

    /// Images beyond `textureMemory` go to scratch files.
    fn page_out(&mut self) {
        let bound = self.flat.settings.texture_memory as usize * 1_000_000;
        let warnings = page_out(&mut self.flat.images, &mut self.kept.images, &self.residency, bound);
        for warning in warnings {
            let of_prim = self.prim_warnings.entry(warning.prim.clone()).or_default();
            // The next try says it again.
            of_prim.retain(|known| *known != warning);
            of_prim.push(warning);
        }
    }

    /// The mesh at `path` with the aspects in `bits` taken from `new`.
    fn merge_mesh(&mut self, path: &str, new: flat::Mesh, bits: DirtyBits) -> flat::Mesh {
        if bits.intersects(DirtyBits::GEOMETRY) {
            self.kept.forget(path);
        }
        let old = self.authored.remove(path).or_else(|| self.flat.meshes.remove(path));
        let Some(old) = old.filter(|_| bits != DirtyBits::ALL) else { return new };
        let has = |bit| bits.contains(bit);
        let mut mesh = old;
        if has(DirtyBits::TOPOLOGY) {
            mesh.face_vertex_counts = new.face_vertex_counts;
            mesh.face_vertex_indices = new.face_vertex_indices;
            mesh.hole_indices = new.hole_indices;
            mesh.orientation = new.orientation;
            mesh.subdivision_scheme = new.subdivision_scheme;
            mesh.subdiv_tags = new.subdiv_tags;
            mesh.refine_level = new.refine_level;
        }
        if has(DirtyBits::TOPOLOGY) || has(DirtyBits::MATERIAL_ID) {
            mesh.geom_subsets = new.geom_subsets;
        }
        if has(DirtyBits::POINTS) {
            mesh.points = new.points;
        }
        if has(DirtyBits::POINTS) || has(DirtyBits::NORMALS) {
            mesh.point_keys = new.point_keys;
        }
        if has(DirtyBits::TRANSFORM) {
            mesh.transform = new.transform;
            mesh.transform_keys = new.transform_keys;
        }
        if has(DirtyBits::PRIMVAR) {
            mesh.primvars = new.primvars;
            (mesh.display_color, mesh.display_opacity) = (new.display_color, new.display_opacity);
        }
        if has(DirtyBits::NORMALS) {
            mesh.normals = new.normals;
        }
        if has(DirtyBits::VISIBILITY) {
            mesh.visible = new.visible;
        }
        if has(DirtyBits::MATERIAL_ID) {
            mesh.material = new.material;
            (mesh.medium_priority, mesh.subsurface_set) = (new.medium_priority, new.subsurface_set);
        }
        if has(DirtyBits::DOUBLE_SIDED) {
            mesh.double_sided = new.double_sided;
        }
        if has(DirtyBits::INSTANCER) {
            mesh.instancer = new.instancer;
        }
        if has(DirtyBits::CATEGORIES) {
            mesh.categories = new.categories;
        }
        mesh
    }

    /// Removes whatever prim is at `path`.
    pub fn remove(&mut self, path: &str) {
        self.edit();
        self.kept.forget(path);
        self.authored.remove(path);
        self.prim_warnings.remove(path);
        let flat = &mut self.flat;
        flat.meshes.remove(path);
        flat.instancers.remove(path);
        flat.materials.remove(path);
        flat.lights.remove(path);
        flat.cameras.remove(path);
        flat.textures.remove(path);
        flat.images.remove(path);
    }

    pub fn set_stage(&mut self, stage: StageInfo) {
        self.edit();
        self.flat.stage = stage;
    }

    pub fn settings(&self) -> &RenderSettings {
        &self.flat.settings
    }

    pub fn set_settings(&mut self, settings: RenderSettings) -> Result<()> {
        settings.check()?;
        self.edit();
        self.flat.settings = settings;
        Ok(())
    }

    /// Lets go the warnings from the bridge, which flattens anew.
    pub fn clear_warnings(&mut self) {
        self.flat.warnings.clear();
    }

    /// Adds a warning from the bridge.
    pub fn warn(&mut self, warning: Warning) {
        self.flat.warnings.push(warning);
    }

    /// Every warning once: of the bridge, of validation, of the last commit, of a render that ended early.
    pub fn warnings(&self) -> Vec<Warning> {
        let mut seen = std::collections::BTreeSet::new();
        let all = self.flat.warnings.iter().chain(self.prim_warnings.values().flatten()).chain(&self.commit_warnings);
        let mut warnings: Vec<Warning> = all.filter(|w| seen.insert((&w.prim, &w.message))).cloned().collect();
        warnings.extend(self.pass.as_ref().and_then(Pass::unfinished));
        warnings.extend(self.report().warnings.into_iter().map(|message| Warning::new("render settings", message)));
        warnings
    }

    /// What the render under way or finished has to say.
    fn report(&self) -> Report {
        self.pass.as_ref().map_or(Report::default(), |pass| pass.progress.report())
    }

    /// Compiles what is dirty. A no-op where nothing is.
    pub fn commit(&mut self) -> Result<CompileStats> {
        if self.clean {
            return Ok(CompileStats { blas_built: 0, seconds: 0.0, ..self.compiled });
        }
        let named = self.checked()?;
        let (scene, stats) = compile(&named, &mut self.kept, &mut self.commit_warnings)?;
        Ok(self.compiled(scene, stats))
    }

    /// The same where no edit follows: what meshes are made of is let go.
    pub fn commit_last(&mut self) -> Result<CompileStats> {
        let named = self.checked()?;
        // Before anything is gone: what fails can be mended.
        eye_of(&named)?;
        let boxes =
            self.flat.meshes.iter().filter_map(|(path, mesh)| Some((path.clone(), object_box(mesh)?))).collect();
        self.last = Some(Last { digest: fingerprint::of_scene(&self.flat), boxes });
        self.authored.clear();
        self.flat.meshes.values_mut().for_each(flat::Mesh::let_go);
        let (scene, stats) = compile_last(named, &mut self.kept, &mut self.commit_warnings)?;
        Ok(self.compiled(scene, stats))
    }

    /// The description to compile: what is named in it is there.
    fn checked(&mut self) -> Result<FlatScene> {
        self.whole()?;
        self.stop();
        self.flat.settings.check()?;
        self.commit_warnings.clear();
        self.page_out();
        // A name that leads nowhere now may lead somewhere after the next edit: clear it in a copy (arrays are shared).
        let mut named = self.flat.clone();
        named.validate_names(&mut self.commit_warnings);
        Ok(named)
    }

    fn compiled(&mut self, scene: Scene, stats: CompileStats) -> CompileStats {
        self.scene = Some(Arc::new(scene));
        self.compiled = stats;
        self.clean = true;
        stats
    }

    pub fn scene(&self) -> Option<&Arc<Scene>> {
        self.scene.as_ref()
    }

    /// Around the visible meshes in the world: around the corners of their own boxes, so wider than their points where
    /// these are turned.
    pub fn bounds(&self) -> Option<Bounds> {
        let mut bounds = None::<(glam::DVec3, glam::DVec3)>;
        for (path, mesh) in self.flat.meshes.iter().filter(|(_, mesh)| mesh.visible) {
            let known = self.last.as_ref().map(|last| last.boxes.get(path).copied());
            let Some(own) = known.unwrap_or_else(|| object_box(mesh)) else { continue };
            for place in self.places(mesh) {
                let ends = corners(own).map(|corner| place.transform_point3(corner.as_dvec3()));
                bounds = ends.iter().fold(bounds, |all, &p| {
                    let (min, max) = all.unwrap_or((p, p));
                    Some((min.min(p), max.max(p)))
                });
            }
        }
        bounds.map(|(min, max)| (min.to_array(), max.to_array()))
    }

    /// Object to world, by instance.
    fn places<'a>(&'a self, mesh: &'a flat::Mesh) -> impl Iterator<Item = glam::DMat4> + 'a {
        let instancer = self.flat.instancers.get(&mesh.instancer);
        let placements = instancer.map_or(&[flat::IDENTITY][..], |instancer| &instancer.transforms);
        let own = glam::DMat4::from_cols_array_2d(&mesh.transform);
        placements.iter().map(move |placement| glam::DMat4::from_cols_array_2d(placement) * own)
    }

    /// Starts the render pass in the background; needs a commit.
    pub fn start(&mut self) -> Result<()> {
        self.start_kept(None).map(drop)
    }

    /// The same with a checkpoint `every` so often in `file`; with `resume` it goes on from that file if it is there,
    /// and says from which file.
    ///
    /// # Errors
    /// As [`Self::start`], or a checkpoint that is not of this scene and these settings.
    pub fn start_with_checkpoints(&mut self, file: PathBuf, every: Duration, resume: bool) -> Result<Option<PathBuf>> {
        self.start_kept(Some(Keep { file, every, resume, fingerprint: self.fingerprint_of_render() }))
    }

    fn start_kept(&mut self, keep: Option<Keep>) -> Result<Option<PathBuf>> {
        let scene = self.scene.clone().filter(|_| self.clean);
        let scene = scene.ok_or_else(|| Error::Other("commit the scene before starting a render".into()))?;
        self.stop();
        let settings = self.flat.settings.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(settings.threads as usize)
            .build()
            .map_err(|e| Error::Other(format!("threads: {e}")))?;
        let film = film_for(&scene, &settings)?.named(self.flat.meshes.keys().map(String::as_str));
        let (film, progress) = (Arc::new(film), Arc::new(Progress::default()));
        let resumed = keep.as_ref().map_or(Ok(None), Keep::resumed)?;
        let (film_of_thread, progress_of_thread) = (film.clone(), progress.clone());
        let thread = std::thread::spawn(move || {
            let start = Instant::now();
            pool.install(|| render(&scene, &settings, &film_of_thread, &progress_of_thread, keep.as_ref()))?;
            Ok(start.elapsed().as_secs_f64())
        });
        self.pass = Some(Pass { film, progress, thread: Some(thread), seconds: None, started: Instant::now() });
        Ok(resumed)
    }

    /// (fraction done, finished).
    pub fn poll(&mut self) -> Result<(f64, bool)> {
        let Some(pass) = &mut self.pass else { return Ok((0.0, true)) };
        if pass.thread.as_ref().is_some_and(|thread| thread.is_finished()) {
            pass.join()?;
        }
        Ok((pass.progress.fraction(), pass.thread.is_none()))
    }

    /// Asks the render to end after the tiles under way, and waits for it.
    pub fn stop(&mut self) {
        if let Some(pass) = &mut self.pass {
            pass.progress.stop();
            // A pass that panicked is reported by poll; here it only has to be over.
            let _ = pass.join();
        }
    }

    /// AOVs so far, over the data window; empty before the first render.
    pub fn snapshot(&self) -> (u32, u32, Vec<Plane>) {
        self.pass.as_ref().map_or((0, 0, Vec::new()), |pass| {
            let window = pass.film.data_window;
            (window.width(), window.height(), pass.film.resolve())
        })
    }

    /// Whether all of the image is finite, and whether any of it is not black.
    pub fn check(&self) -> (bool, bool) {
        self.pass.as_ref().map_or((true, false), |pass| {
            let color = pass.film.color().values;
            let is_lit = color.chunks_exact(4).any(|pixel| pixel[..3].iter().any(|&x| x > 0.0));
            (color.iter().all(|x| x.is_finite()), is_lit)
        })
    }

    /// An edit makes the image stale: the render stops, the scene waits for a commit.
    fn edit(&mut self) {
        self.stop();
        self.clean = false;
    }
}

/// Around the points of a mesh that are finite.
fn object_box(mesh: &flat::Mesh) -> Option<ObjectBox> {
    let points = mesh.points.iter().map(|p| glam::Vec3::from(*p)).filter(|p| p.is_finite());
    points.fold(None, |all, p| {
        let (min, max) = all.unwrap_or((p, p));
        Some((min.min(p), max.max(p)))
    })
}

fn corners((min, max): ObjectBox) -> [glam::Vec3; 8] {
    std::array::from_fn(|i| glam::Vec3::select(glam::BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), max, min))
}

impl Drop for RenderDelegate {
    fn drop(&mut self) {
        self.stop();
    }
}
