//! dermis: a path tracer for USD shots whose heart is subsurface scattering.

pub mod error;
pub mod flat;
pub mod light;
pub mod math;
pub mod sampling;
