//! Edges of a mesh that do not join faces in pairs: what keeps it from enclosing a volume.

use glam::Vec3;
use rayon::prelude::*;

/// How many there are, between points welded by position; edges without length do not count.
pub(super) fn open_edges(points: &[Vec3], triangles: &[[u32; 3]]) -> usize {
    let welded = &weld(points);
    let edges = || {
        let sides = |[a, b, c]: [u32; 3]| [(a, b), (b, c), (c, a)].map(|(i, j)| (i.min(j) as usize, i.max(j)));
        triangles.iter().flat_map(move |t| sides(t.map(|i| welded[i as usize]))).filter(|&(i, j)| i != j as usize)
    };
    // By their lower end: sorted by counting, which takes a sixth of the room of a hash map.
    let mut ends = vec![0; points.len() + 1];
    edges().for_each(|(i, _)| ends[i + 1] += 1);
    (1..ends.len()).for_each(|i| ends[i] += ends[i - 1]);
    let mut higher = vec![0; ends[points.len()]];
    for (i, j) in edges() {
        higher[ends[i]] = j;
        ends[i] += 1; // from where those of i begin to where they end
    }
    let mut begin = 0;
    let of_point = |&end: &usize| odd(&mut higher[std::mem::replace(&mut begin, end)..end]);
    ends[..points.len()].iter().map(of_point).sum()
}

/// How many different values are there an odd number of times.
fn odd(values: &mut [u32]) -> usize {
    values.sort_unstable();
    values.chunk_by(|a, b| a == b).filter(|same| same.len() % 2 != 0).count()
}

/// By point, one of those at the same position, the same for all of them.
fn weld(points: &[Vec3]) -> Vec<u32> {
    // + 0.0 makes -0 and 0 one key.
    let key = |&i: &u32| (points[i as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut order = Vec::from_iter(0..points.len() as u32);
    order.par_sort_unstable_by_key(key);
    let mut welded = vec![0; points.len()];
    for same in order.chunk_by(|a, b| key(a) == key(b)) {
        same.iter().for_each(|&i| welded[i as usize] = same[0]);
    }
    welded
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a tetrahedron.
    const CLOSED: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn corners() -> Vec<Vec3> {
        vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z]
    }

    #[test]
    fn counts_edges_without_a_partner() {
        assert_eq!(open_edges(&corners(), &CLOSED), 0);
        assert_eq!(open_edges(&corners(), &CLOSED[1..]), 3);
        assert_eq!(open_edges(&corners(), &CLOSED[..1]), 3);
        // Three faces at an edge; a face twice; a triangle without area joins nothing.
        let fin = [&CLOSED[..], &[[0, 1, 4]]].concat();
        assert_eq!(open_edges(&[corners(), vec![-Vec3::Z]].concat(), &fin), 3);
        assert_eq!(open_edges(&corners(), &[CLOSED[0], CLOSED[0]]), 0);
        assert_eq!(open_edges(&corners(), &[[0, 0, 1]]), 0);
    }

    #[test]
    fn welds_points_at_one_place() {
        let apart: Vec<Vec3> = CLOSED.iter().flatten().map(|&i| corners()[i as usize] * -1.0).collect();
        let triangles: Vec<[u32; 3]> = (0..4).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        assert_eq!(open_edges(&apart, &triangles), 0);
        let mut signed = apart.clone();
        signed[0] = Vec3::ZERO; // was -0
        assert_eq!(open_edges(&signed, &triangles), 0);
        signed[0].x = f32::MIN_POSITIVE;
        assert_eq!(open_edges(&signed, &triangles), 4);
    }
}
