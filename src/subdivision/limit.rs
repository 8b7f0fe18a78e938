//! Normals of the limit surface. Where a crease or a corner parts the surface around a vertex into sectors, each has
//! its own.

use super::creases::{Rule, Rules};
use super::topology::{HalfEdges, NONE, Topology};
use super::{Scheme, catmull_clark, loop_scheme};
use glam::Vec3;

/// The surface around a vertex, counter-clockwise: all of it, or what lies between two sharp edges.
#[derive(Debug, Default)]
pub(super) struct Sector {
    pub vertex: Vec3,
    /// Other ends of the edges; one more than faces where the sector is open.
    pub edges: Vec<Vec3>,
    /// Opposite vertices of the quads between them; of triangles, their next vertices.
    pub faces: Vec<Vec3>,
    corners: Vec<u32>,
    closed: bool,
}

/// Normals, not unit, and which of them each corner has.
pub(super) struct Normals {
    pub values: Vec<Vec3>,
    pub of_corner: Vec<u32>,
    /// No vertex has two: `values` are by vertex.
    pub by_vertex: bool,
}

/// Normals at the limit of the last level, whose vertices are at `points` (not at their limits).
pub(super) fn normals(scheme: Scheme, t: &Topology, rules: &Rules, points: &[Vec3]) -> Normals {
    let (halves, _) = t.half_edges();
    let mut normals =
        Normals { values: vec![Vec3::ZERO; t.vertices], of_corner: vec![NONE; t.corner_vertex.len()], by_vertex: true };
    let mut taken = vec![false; t.vertices];
    let mut sector = Sector::default();
    for corner in 0..t.corner_vertex.len() {
        if normals.of_corner[corner] != NONE {
            continue;
        }
        let vertex = t.corner_vertex[corner];
        let rule = rules.rule(vertex);
        sector.gather(t, &halves, points, corner, rule != Rule::Smooth);
        let normal = sector.normal(scheme, rule);
        let at = if std::mem::replace(&mut taken[vertex as usize], true) {
            normals.by_vertex = false;
            normals.values.push(normal);
            normals.values.len() - 1
        } else {
            normals.values[vertex as usize] = normal;
            vertex as usize
        };
        sector.corners.iter().for_each(|c| normals.of_corner[*c as usize] = at as u32);
    }
    normals
}

impl Sector {
    /// The sector around the vertex of `corner` that holds it. `parted`: sharp edges end it.
    fn gather(&mut self, t: &Topology, halves: &HalfEdges, points: &[Vec3], corner: usize, parted: bool) {
        let ends = |edge: u32| parted && t.edge_sharpness[edge as usize] > 0.0;
        let at = |vertex: u32| points[vertex as usize];
        // Clockwise to the first corner; round once where nothing ends it.
        let mut first = corner;
        self.closed = false;
        while !ends(t.corner_edge[first]) {
            let Some(right) = t.turn_right(first, halves) else { break };
            first = right;
            if first == corner {
                self.closed = true;
                break;
            }
        }
        self.vertex = at(t.corner_vertex[corner]);
        self.edges.clear();
        self.faces.clear();
        self.corners.clear();
        let mut next = Some(first);
        while let Some(c) = next {
            self.corners.push(c as u32);
            self.edges.push(at(t.vertex_after(c, 1)));
            self.faces.push(at(t.vertex_after(c, 2)));
            let back = t.edge_before(c);
            next = if ends(back) { None } else { t.turn_left(c, halves).filter(|c| *c != first) };
            if next.is_none() && !self.closed {
                let [a, b] = t.edges[back as usize];
                self.edges.push(at(if a == t.corner_vertex[c] { b } else { a }));
            }
        }
    }

    fn normal(&self, scheme: Scheme, rule: Rule) -> Vec3 {
        let tangents = match (scheme, rule) {
            (Scheme::CatmullClark { .. }, Rule::Smooth) if self.closed && self.faces.len() > 2 => {
                catmull_clark::smooth_tangents(self)
            }
            (Scheme::Loop, Rule::Smooth) if self.closed && self.faces.len() > 2 => loop_scheme::smooth_tangents(self),
            (Scheme::CatmullClark { .. }, Rule::Crease(_)) if !self.closed => catmull_clark::crease_tangents(self),
            (Scheme::Loop, Rule::Crease(_)) if !self.closed => loop_scheme::crease_tangents(self),
            _ => return self.facets(),
        };
        let normal = tangents[0].cross(tangents[1]);
        // Tangents of one direction, as where faces fold onto each other, span no plane.
        let flat = normal.length_squared() <= 1e-12 * tangents[0].length_squared() * tangents[1].length_squared();
        if flat { self.facets() } else { normal }
    }

    /// Sum of the faces' normals: at a corner of one face its own, of several no single normal is right.
    fn facets(&self) -> Vec3 {
        let around = |i: usize| self.edges[i % self.edges.len()] - self.vertex;
        let sum: Vec3 = (0..self.faces.len()).map(|i| around(i).cross(around(i + 1))).sum();
        if sum != Vec3::ZERO {
            return sum;
        }
        let across = |i: usize| self.faces[i] - self.vertex;
        (0..self.faces.len()).map(|i| around(i).cross(across(i)) + across(i).cross(around(i + 1))).sum()
    }
}
