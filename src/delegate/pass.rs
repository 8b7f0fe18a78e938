//! The render that runs in the background.

use crate::error::{Error, Result, Warning};
use crate::film::Film;
use crate::render::Progress;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Instant;

/// A render under way or finished.
pub(super) struct Pass {
    pub film: Arc<Film>,
    pub progress: Arc<Progress>,
    pub thread: Option<JoinHandle<Result<f64>>>,
    /// Seconds of rendering, once finished.
    pub seconds: Option<f64>,
    pub started: Instant,
}

impl Pass {
    pub fn join(&mut self) -> Result<()> {
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let seconds = thread.join().map_err(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Error::Other(format!("the render failed: {}", text.unwrap_or("no message")))
        })??;
        self.seconds = Some(seconds);
        Ok(())
    }

    /// A render that is over but left pixels black.
    pub fn unfinished(&self) -> Option<Warning> {
        let pixels = if self.thread.is_none() { self.film.unsampled_pixels() } else { 0 };
        let message = format!("timeLimit: it ended the first pass, {pixels} pixels have no sample and are black");
        (pixels > 0).then(|| Warning::new("render settings", message))
    }

    pub fn render_seconds(&self) -> f64 {
        self.seconds.unwrap_or_else(|| self.started.elapsed().as_secs_f64())
    }
}
