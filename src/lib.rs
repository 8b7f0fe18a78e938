//! dermis: a path tracer for USD shots whose heart is subsurface scattering.

pub mod bsdf;
pub mod camera;
pub mod delegate;
pub mod error;
pub mod film;
pub mod flat;
pub mod integrator;
pub mod interaction;
pub mod light;
pub mod math;
pub mod medium;
pub mod output;
pub mod render;
mod replace;
pub mod sampling;
pub mod scene;
pub mod subsurface;
