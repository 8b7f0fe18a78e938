//! Faces, edges and their sharpness at one level; the level below it by index arithmetic alone.

use super::creases::{INFINITE, decay};

/// A mesh whose edges join vertices. Corners run face after face; corner i of a face is at its i-th vertex,
/// and the edge of a corner leads from there to the next.
#[derive(Debug, Clone, Default)]
pub(super) struct Topology {
    /// Used by a face or not.
    pub vertices: usize,
    /// First corner of each face, and the end; empty where every face has `arity` corners.
    starts: Vec<u32>,
    arity: usize,
    pub corner_vertex: Vec<u32>,
    pub corner_edge: Vec<u32>,
    pub edges: Vec<[u32; 2]>,
    /// 0: smooth; [`INFINITE`] and more: never decays.
    pub edge_sharpness: Vec<f32>,
    pub vertex_sharpness: Vec<f32>,
}

/// Corners by directed edge: `[0]` starts at `edges[e][0]`, `[1]` at `edges[e][1]`.
pub(super) struct HalfEdges(Vec<[u32; 2]>);

/// No corner.
pub(super) const NONE: u32 = u32::MAX;

impl Topology {
    /// Smooth everywhere. `starts` as in the field.
    pub fn new(vertices: usize, starts: Vec<u32>, corner_vertex: Vec<u32>) -> Self {
        let mut topology = Self { vertices, starts, corner_vertex, ..Self::default() };
        topology.find_edges();
        topology.edge_sharpness = vec![0.0; topology.edges.len()];
        topology.vertex_sharpness = vec![0.0; vertices];
        topology
    }

    /// Edges in the order of their vertices.
    fn find_edges(&mut self) {
        let mut sides: Vec<(u32, u32, u32)> = Vec::with_capacity(self.corner_vertex.len());
        for face in 0..self.faces() {
            let corners = self.corners(face);
            let mut a = self.corner_vertex[corners.end - 1];
            let mut from = corners.end - 1;
            for corner in corners {
                let b = self.corner_vertex[corner];
                sides.push((a.min(b), a.max(b), from as u32));
                (a, from) = (b, corner);
            }
        }
        sides.sort_unstable();
        self.corner_edge = vec![0; self.corner_vertex.len()];
        for &(a, b, corner) in &sides {
            if self.edges.last() != Some(&[a, b]) {
                self.edges.push([a, b]);
            }
            self.corner_edge[corner as usize] = self.edges.len() as u32 - 1;
        }
    }

    pub fn faces(&self) -> usize {
        if self.starts.is_empty() { self.corner_vertex.len() / self.arity } else { self.starts.len() - 1 }
    }

    pub fn corners(&self, face: usize) -> std::ops::Range<usize> {
        match self.starts.get(face..face + 2) {
            Some(ends) => ends[0] as usize..ends[1] as usize,
            None => face * self.arity..(face + 1) * self.arity,
        }
    }

    /// As [`Topology::new`] takes it.
    pub fn starts_of_faces(&self) -> Vec<u32> {
        self.starts.clone()
    }

    /// Faces at each edge.
    pub fn edge_faces(&self) -> Vec<u32> {
        let mut count = vec![0; self.edges.len()];
        self.corner_edge.iter().for_each(|&edge| count[edge as usize] += 1);
        count
    }

    /// Edges at each vertex.
    pub fn valences(&self) -> Vec<u32> {
        let mut valences = vec![0; self.vertices];
        self.edges.iter().flatten().for_each(|&v| valences[v as usize] += 1);
        valences
    }

    /// A quad per corner. Vertices: the old ones, then one per edge, then one per face.
    pub fn split_into_quads(&self) -> Self {
        let (v, e) = (self.vertices as u32, self.edges.len() as u32);
        let mut fine = self.halved(v as usize + e as usize + self.faces(), 4, 4 * self.corner_vertex.len());
        let mut spokes = Vec::with_capacity(self.corner_vertex.len());
        for face in 0..self.faces() {
            let corners = self.corners(face);
            let mut before = corners.end - 1;
            let centre = v + e + face as u32;
            for corner in corners {
                let (a, b) = (self.corner_edge[corner], self.corner_edge[before]);
                fine.corner_vertex.extend([self.corner_vertex[corner], v + a, centre, v + b]);
                // From the vertex to the middle of its edge, along the spokes to the centre and back, home.
                let spoke = |corner: usize| 2 * e + corner as u32;
                fine.corner_edge.extend([self.half(corner, a), spoke(corner), spoke(before), self.half(corner, b)]);
                spokes.push([v + a, centre]);
                before = corner;
            }
        }
        fine.edges.extend(spokes);
        fine.smooth_rest();
        fine
    }

    /// Four triangles for each: three at the corners, then the middle. Vertices: the old ones, then one per edge.
    pub fn split_triangles(&self) -> Self {
        let (v, e) = (self.vertices as u32, self.edges.len() as u32);
        let mut fine = self.halved(v as usize + e as usize, 3, 4 * self.corner_vertex.len());
        for face in 0..self.faces() {
            let first = self.corners(face).start;
            let edges: [u32; 3] = std::array::from_fn(|i| self.corner_edge[first + i]);
            // The edge of the middle triangle that cuts off corner i.
            let cut = |i: usize| 2 * e + (first + i) as u32;
            for i in 0..3 {
                let (out, back) = (edges[i], edges[(i + 2) % 3]);
                fine.corner_vertex.extend([self.corner_vertex[first + i], v + out, v + back]);
                fine.corner_edge.extend([self.half(first + i, out), cut(i), self.half(first + i, back)]);
            }
            fine.corner_vertex.extend([v + edges[1], v + edges[2], v + edges[0]]);
            fine.corner_edge.extend([cut(2), cut(0), cut(1)]);
        }
        for face in 0..self.faces() {
            let first = self.corners(face).start;
            let middle = |i: usize| v + self.corner_edge[first + i % 3];
            fine.edges.extend((0..3).map(|i| [middle(i), middle(i + 2)]));
        }
        fine.smooth_rest();
        fine
    }

    /// The halves of all edges, with their sharpness; no faces yet.
    fn halved(&self, vertices: usize, arity: usize, corners: usize) -> Self {
        let v = self.vertices as u32;
        let mut fine = Self { vertices, arity, ..Self::default() };
        fine.corner_vertex.reserve_exact(corners);
        fine.corner_edge.reserve_exact(corners);
        for (edge, [a, b]) in self.edges.iter().enumerate() {
            fine.edges.extend([[*a, v + edge as u32], [*b, v + edge as u32]]);
            fine.edge_sharpness.extend([decay(self.edge_sharpness[edge]); 2]);
        }
        fine.vertex_sharpness = self.vertex_sharpness.iter().map(|s| decay(*s)).collect();
        fine
    }

    /// The half of `edge` at the vertex of `corner`.
    fn half(&self, corner: usize, edge: u32) -> u32 {
        2 * edge + u32::from(self.edges[edge as usize][0] != self.corner_vertex[corner])
    }

    fn smooth_rest(&mut self) {
        self.edge_sharpness.resize(self.edges.len(), 0.0);
        self.vertex_sharpness.resize(self.vertices, 0.0);
    }

    /// Directed edges, and the edges that more than one face runs along in one direction or more than two in all:
    /// those are not manifold.
    pub fn half_edges(&self) -> (HalfEdges, Vec<u32>) {
        let mut halves = vec![[NONE; 2]; self.edges.len()];
        let mut bad = Vec::new();
        for (corner, &edge) in self.corner_edge.iter().enumerate() {
            let side = usize::from(self.edges[edge as usize][0] != self.corner_vertex[corner]);
            let half = &mut halves[edge as usize][side];
            if *half != NONE {
                bad.push(edge);
            }
            *half = corner as u32;
        }
        bad.sort_unstable();
        bad.dedup();
        (HalfEdges(halves), bad)
    }

    /// The corner before in the same face; `face` holds it.
    fn before(&self, corner: usize, face: usize) -> usize {
        let corners = self.corners(face);
        if corner == corners.start { corners.end - 1 } else { corner - 1 }
    }

    fn face_of(&self, corner: usize) -> usize {
        if self.starts.is_empty() {
            corner / self.arity
        } else {
            self.starts.partition_point(|start| *start as usize <= corner) - 1
        }
    }

    /// The edge that ends at the vertex of `corner`, in its face.
    pub fn edge_before(&self, corner: usize) -> u32 {
        self.corner_edge[self.before(corner, self.face_of(corner))]
    }

    /// The vertex `steps` further in the face.
    pub fn vertex_after(&self, corner: usize, steps: usize) -> u32 {
        let corners = self.corners(self.face_of(corner));
        self.corner_vertex[corners.start + (corner - corners.start + steps) % corners.len()]
    }

    /// The corner at the same vertex across the edge that ends there: the next counter-clockwise.
    pub fn turn_left(&self, corner: usize, halves: &HalfEdges) -> Option<usize> {
        halves.from(self, self.edge_before(corner), self.corner_vertex[corner])
    }

    /// The corner at the same vertex across the edge of `corner`: the next clockwise.
    pub fn turn_right(&self, corner: usize, halves: &HalfEdges) -> Option<usize> {
        let edge = self.corner_edge[corner];
        let [a, b] = self.edges[edge as usize];
        let other = if self.corner_vertex[corner] == a { b } else { a };
        let across = halves.from(self, edge, other)?;
        let corners = self.corners(self.face_of(across));
        Some(if across + 1 == corners.end { corners.start } else { across + 1 })
    }

    /// Edges with one face, and those in `bad`, never smooth out.
    pub fn sharpen_boundary(&mut self, bad: &[u32]) {
        let faces = self.edge_faces();
        for (sharpness, faces) in self.edge_sharpness.iter_mut().zip(faces) {
            if faces == 1 {
                *sharpness = INFINITE;
            }
        }
        bad.iter().for_each(|edge| self.edge_sharpness[*edge as usize] = INFINITE);
    }
}

impl HalfEdges {
    /// The corner whose edge is `edge` and starts at `vertex`.
    fn from(&self, topology: &Topology, edge: u32, vertex: u32) -> Option<usize> {
        let side = usize::from(topology.edges[edge as usize][0] != vertex);
        Some(self.0[edge as usize][side] as usize).filter(|corner| *corner != NONE as usize)
    }
}
