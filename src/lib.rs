//! dermis: a path tracer for USD shots whose heart is subsurface scattering.
//!
//! # The way of the data
//!
//! ```text
//! bridge (Python, usd-core)            knows USD, no light transport
//!    |  RenderDelegate::sync(path, prim, dirty bits)
//!    v
//! flat::FlatScene                      USD's words and units; validated once; one .dermis file
//!    |  RenderDelegate::commit() -> scene::compile (subdivision: from cages to limit surfaces)
//!    v
//! scene::Scene                         immutable: BVHs, instances, images, surfaces, media, lights, Needs
//!    |  render::render: passes over tiles
//!    |     integrator::trace: surfaces, next-event estimation, passage of media
//!    |        subsurface::walk: from boundary to boundary
//!    v
//! film::Film -> output                 sums per pixel -> AOV planes -> EXR
//! ```
//!
//! # Conventions
//!
//! - Lengths in stage units, sigma in 1 / stage unit, angles in radians where USD's words end.
//! - Render space is world translated to the camera. A mesh is kept about its own centre, a walk runs about
//!   its object's origin: f32 resolves both wherever they stand in the world.
//! - `wo` points to the eye, `wi` to the light, both unit and away from the vertex; `eval` includes |cos|;
//!   pdfs are per solid angle unless their name says otherwise; a Monte Carlo weight is `f / pdf`.
//! - Colours are linear Rec.709. Media sample distances for one channel, weighted by all three.
//! - Random numbers are a function of (seed, pixel, sample, dimension), sums run in sample order: one seed,
//!   one image, for any number of threads.
//! - A safety net that ends a path is counted and reported.

pub mod bsdf;
pub mod camera;
pub mod delegate;
pub mod error;
pub mod film;
pub mod flat;
pub mod guiding;
pub mod integrator;
pub mod interaction;
pub mod light;
pub mod math;
pub mod medium;
pub mod output;
pub mod render;
mod replace;
pub mod sampling;
mod saved;
pub mod scene;
pub mod subdivision;
pub mod subsurface;
