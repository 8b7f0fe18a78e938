//! Light inside a medium: random walks from boundary to boundary, and the albedo that a colour means.
//!
//! `steps` moves through the geometry, `kernel` draws directions and distances along a slab normal, `walk` weights a
//! walk by the normal it followed, `mixture` by all the techniques of `technique` that could have drawn it.

mod dwivedi;
mod eigenfunction;
pub mod inversion;
pub mod kernel;
pub mod mixture;
pub mod steps;
pub mod technique;
pub mod walk;
