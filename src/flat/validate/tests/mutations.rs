//! Meshes that are broken at random come out usable.

use super::*;

/// A generator for the mutations: Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators".
struct SplitMix(u64);

impl SplitMix {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % end as u64) as usize
    }

    fn float(&mut self) -> f32 {
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e29, 0.0, -0.0, 1e-45, 0.5, 3.0][self.below(10)]
    }

    fn int(&mut self) -> i32 {
        [i32::MIN, -1, 0, 1, 2, 3, 4, 5, 7, 8, 23, 24, i32::MAX][self.below(13)]
    }

    /// Overwrites, removes or adds one value.
    fn mutate<T: Element>(&mut self, array: &mut Array<T>, value: fn(&mut Self) -> T) {
        let (at, kind, value) = (self.below(array.len().max(1)), self.below(4), value(self));
        edit(array, |values| match kind {
            0 if !values.is_empty() => drop(values.remove(at)),
            1 => values.push(value),
            2 if self.below(8) == 0 => values.clear(),
            _ => values.iter_mut().skip(at).take(1).for_each(|old| *old = value),
        });
    }

    fn mutate_primvar<T: Element>(&mut self, primvar: &mut Option<Primvar<T>>, value: fn(&mut Self) -> T) {
        use Interpolation::{Constant, FaceVarying, Uniform, Varying, Vertex};
        let Some(primvar) = primvar else { return };
        match (self.below(4), &mut primvar.indices) {
            (0, _) => primvar.interpolation = [Constant, Uniform, Varying, Vertex, FaceVarying][self.below(5)],
            (1, Some(indices)) => self.mutate(indices, Self::int),
            (2, indices) => *indices = None,
            _ => self.mutate(&mut primvar.values, value),
        }
    }

    fn mutate_mesh(&mut self, mesh: &mut Mesh) {
        match self.below(11) {
            0 => self.mutate(&mut mesh.points, |random| [random.float(), random.float(), random.float()]),
            1 | 2 => self.mutate(&mut mesh.face_vertex_counts, Self::int),
            3 | 4 => self.mutate(&mut mesh.face_vertex_indices, Self::int),
            5 => self.mutate(&mut mesh.hole_indices, Self::int),
            6 => self.mutate(&mut mesh.geom_subsets[0].indices, Self::int),
            7 => self.mutate_primvar(&mut mesh.display_color, |random| [random.float(); 3]),
            8 => self.mutate_primvar(&mut mesh.display_opacity, Self::float),
            9 => {
                let mut st = st(mesh);
                self.mutate_primvar(&mut st, |random| [random.float(); 2]);
                mesh.primvars = st.map(|st| ("st".into(), AnyPrimvar::Float2(st))).into_iter().collect();
            }
            _ if self.below(8) == 0 => mesh.transform[self.below(4)][self.below(4)] = f64::from(self.float()),
            _ => self.mutate_primvar(&mut mesh.normals, |random| [random.float(); 3]),
        }
    }
}

#[test]
fn randomly_broken_meshes_come_out_usable() {
    let mut random = SplitMix(7);
    let mut shaded = 0;
    for _ in 0..20_000 {
        let mut mesh = sample::cube();
        for _ in 0..=random.below(6) {
            random.mutate_mesh(&mut mesh);
        }
        let broken = mesh.clone();
        let changed = !check_mesh(&mut mesh).is_empty();
        assert_usable(&mesh);
        let same = format!("{mesh:?}") == format!("{broken:?}");
        assert!(changed || same, "changed without a word: {broken:?}");
        assert!(check_mesh(&mut mesh).is_empty(), "a second time finds nothing: {broken:?}");
        shaded += usize::from(!mesh.face_vertex_counts.is_empty());
    }
    assert!(shaded > 10_000, "only {shaded} meshes kept a face: the mutations are too coarse to test much");
}
