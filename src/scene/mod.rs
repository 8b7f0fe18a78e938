//! The compiled scene.

pub mod accel;
