//! Light inside a medium: the random walk from boundary to boundary, and the albedo that a colour means.

pub mod inversion;
pub mod walk;
