//! The film's sums in a checkpoint.

use super::{Film, Tile};
use crate::saved::{Loader, Saver};
use std::io;
use std::sync::PoisonError;

impl Film {
    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        self.tiles.iter().try_for_each(|tile| tile.lock().unwrap_or_else(PoisonError::into_inner).save(to))
    }

    /// Takes in what [`Self::save`] wrote of a film with the same window and planes.
    ///
    /// # Errors
    /// Where the data does not fit; the film is then in pieces.
    pub(crate) fn load(&self, from: &mut Loader) -> io::Result<()> {
        self.tiles.iter().try_for_each(|tile| tile.lock().unwrap_or_else(PoisonError::into_inner).load(from))
    }
}

impl Tile {
    fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.array(&self.samples)?;
        to.array(&self.color)?;
        to.array(&self.alpha)?;
        to.array(&self.squares)?;
        to.array(&self.buckets)?;
        to.array(&self.straight)?;
        to.array(&self.albedo)?;
        to.array(&self.first)?;
        to.array(&self.motion)?;
        to.array(&self.walks)?;
        to.array(&self.objects)?;
        to.array(&self.primvars)?;
        to.array(&self.lights)?;
        to.array(&self.lobes)?;
        to.array(self.spread.as_ref().map_or(&[], |spread| &spread.sums))
    }

    fn load(&mut self, from: &mut Loader) -> io::Result<()> {
        from.array(&mut self.samples)?;
        from.array(&mut self.color)?;
        from.array(&mut self.alpha)?;
        from.array(&mut self.squares)?;
        from.array(&mut self.buckets)?;
        from.array(&mut self.straight)?;
        from.array(&mut self.albedo)?;
        from.array(&mut self.first)?;
        from.array(&mut self.motion)?;
        from.array(&mut self.walks)?;
        from.array(&mut self.objects)?;
        from.array(&mut self.primvars)?;
        from.array(&mut self.lights)?;
        from.array(&mut self.lobes)?;
        from.array(self.spread.as_mut().map_or(&mut [], |spread| &mut spread.sums))
    }
}
