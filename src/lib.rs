//! dermis: a path tracer for USD shots whose heart is subsurface scattering.

pub mod bsdf;
pub mod error;
pub mod flat;
pub mod math;
pub mod sampling;
