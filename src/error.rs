//! What can go wrong, in words a user can act on.

use serde::{Deserialize, Serialize};

/// An error that stops a load, a commit or a write.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A prim that cannot be used; `message` names the attribute and what to do.
    #[error("{prim}: {message}")]
    Prim { prim: String, message: String },
    /// A `.dermis` file that cannot be read; `field` is the part that is damaged.
    #[error("{file}: {field}: {message}")]
    File { file: String, field: String, message: String },
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error("{0}")]
    Other(String),
}

pub type Result<T> = std::result::Result<T, Error>;

/// Something dropped, clamped or replaced; the render went on. Ends in `--stats` under `warnings`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    pub prim: String,
    pub message: String,
}

impl Warning {
    pub fn new(prim: impl Into<String>, message: impl Into<String>) -> Self {
        Self { prim: prim.into(), message: message.into() }
    }
}
