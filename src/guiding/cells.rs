//! Cells of a boundary: voxels, split by the axis that the surface faces, so that the two sheets of an ear in
//! one voxel are two cells.

use glam::Vec3;
use rustc_hash::FxHashMap;

/// A sparse grid over one boundary, in its walk space.
#[derive(Debug, Clone, Default)]
pub struct Cells {
    /// Edge of a voxel, stage units.
    pub size: f32,
    index: FxHashMap<[i16; 4], u32>,
}

impl Cells {
    pub fn new(size: f32) -> Self {
        Self { size, index: FxHashMap::default() }
    }

    pub fn len(&self) -> usize {
        self.index.len()
    }

    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// The cell of a boundary point with outward normal `n`, else another one of its voxel; `None` where nothing was
    /// recorded.
    pub fn find(&self, p: Vec3, n: Vec3) -> Option<u32> {
        let key @ [x, y, z, facing] = self.key(p, n);
        let others = || (0..6).filter(|&f| f != facing).find_map(|f| self.index.get(&[x, y, z, f]));
        self.index.get(&key).or_else(others).copied()
    }

    /// The same, made if need be; numbers follow the order of first insertion.
    pub fn find_or_insert(&mut self, p: Vec3, n: Vec3) -> u32 {
        let next = self.index.len() as u32;
        *self.index.entry(self.key(p, n)).or_insert(next)
    }

    fn key(&self, p: Vec3, n: Vec3) -> [i16; 4] {
        // At most 1024 cells per side: i16 holds them; a point beyond is in the outermost.
        let voxel = (p / self.size).floor().clamp(Vec3::splat(-32768.0), Vec3::splat(32767.0));
        let a = n.abs();
        let axis = if a.x >= a.y && a.x >= a.z {
            0
        } else if a.y >= a.z {
            1
        } else {
            2
        };
        [voxel.x as i16, voxel.y as i16, voxel.z as i16, (2 * axis + i16::from(n[axis as usize] < 0.0))]
    }

    /// Bytes, about.
    pub fn memory(&self) -> usize {
        self.index.capacity() * (size_of::<([i16; 4], u32)>() + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sheets_in_one_voxel_are_two_cells() {
        let mut cells = Cells::new(1.0);
        let front = cells.find_or_insert(Vec3::new(0.5, 0.5, 0.4), Vec3::new(0.1, 0.2, 0.97));
        let back = cells.find_or_insert(Vec3::new(0.5, 0.5, 0.3), Vec3::new(0.1, 0.2, -0.97));
        assert_ne!(front, back);
        assert_eq!(cells.find(Vec3::new(0.9, 0.1, 0.9), Vec3::Z), Some(front));
        assert_eq!(cells.find(Vec3::new(-0.1, 0.1, 0.9), Vec3::Z), None);
        assert_eq!(cells.len(), 2);
    }
}
