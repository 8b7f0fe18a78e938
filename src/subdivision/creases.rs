//! Semi-sharp creases and corners: DeRose, Kass and Truong 1998, with OpenSubdiv's rules for what lies between.

use super::{Value, topology::Topology};

/// OpenSubdiv's infinite sharpness: from here on nothing decays.
pub(super) const INFINITE: f32 = 10.0;

/// How a vertex follows its neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Rule {
    /// No sharp edge, or one (a dart).
    Smooth,
    /// Two sharp edges: the vertices at their other ends.
    Crease([u32; 2]),
    Corner,
}

/// A vertex with sharp edges, or sharp itself.
#[derive(Debug, Clone, Copy)]
struct Special {
    vertex: u32,
    /// At this level, and at the next where all sharpness has decayed by one.
    now: Rule,
    next: Rule,
    /// Share of `now` where the two differ.
    weight: f32,
}

/// The rules of all vertices of one level; those not listed are smooth.
#[derive(Debug, Clone, Default)]
pub(super) struct Rules {
    pub valences: Vec<u32>,
    /// By vertex.
    special: Vec<Special>,
}

/// Sharpness one level down.
pub(super) fn decay(sharpness: f32) -> f32 {
    if sharpness >= INFINITE { sharpness } else { (sharpness - 1.0).max(0.0) }
}

/// A sharp edge seen from one of its ends.
struct Spoke {
    vertex: u32,
    far: u32,
    sharpness: f32,
}

impl Rules {
    pub fn of(topology: &Topology) -> Self {
        let mut spokes = Vec::new();
        for (&[a, b], &sharpness) in topology.edges.iter().zip(&topology.edge_sharpness) {
            if sharpness > 0.0 {
                spokes.push(Spoke { vertex: a, far: b, sharpness });
                spokes.push(Spoke { vertex: b, far: a, sharpness });
            }
        }
        spokes.sort_by_key(|spoke| (spoke.vertex, spoke.far));
        let mut sharp: Vec<u32> = spokes.iter().map(|spoke| spoke.vertex).collect();
        let corners = topology.vertex_sharpness.iter().enumerate().filter(|(_, s)| **s > 0.0);
        sharp.extend(corners.map(|(vertex, _)| vertex as u32));
        sharp.sort_unstable();
        sharp.dedup();
        let mut rest = spokes.as_slice();
        let mut special = Vec::with_capacity(sharp.len());
        for vertex in sharp {
            let (own, others) = rest.split_at(rest.partition_point(|spoke| spoke.vertex <= vertex));
            rest = others;
            special.push(Special::of(vertex, topology.vertex_sharpness[vertex as usize], own));
        }
        Self { valences: topology.valences(), special }
    }

    /// Vertices of the next level at the old ones: `smooth` holds what the smooth rule makes of them, and is replaced
    /// where another rule holds.
    pub fn refine<T: Value>(&self, values: &[T], smooth: &mut [T]) {
        for special in &self.special {
            let v = special.vertex as usize;
            let by = |rule| match rule {
                Rule::Smooth => smooth[v],
                Rule::Crease([a, b]) => values[v] * 0.75 + (values[a as usize] + values[b as usize]) * 0.125,
                Rule::Corner => values[v],
            };
            // A smooth or dart vertex stays one.
            smooth[v] = if special.now == special.next || special.now == Rule::Smooth {
                by(special.now)
            } else {
                by(special.now) * special.weight + by(special.next) * (1.0 - special.weight)
            };
        }
        self.keep_isolated(values, smooth);
    }

    /// As [`Rules::refine`], for limits: what is sharp at the last level is taken as sharp for ever, as OpenSubdiv does.
    pub fn limit<T: Value>(&self, values: &[T], smooth: &mut [T]) {
        for special in &self.special {
            let v = special.vertex as usize;
            match special.now {
                Rule::Smooth => {}
                Rule::Crease([a, b]) => {
                    smooth[v] = (values[v] * 4.0 + values[a as usize] + values[b as usize]) * (1.0 / 6.0);
                }
                Rule::Corner => smooth[v] = values[v],
            }
        }
        self.keep_isolated(values, smooth);
    }

    /// Points of no face have no neighbours to follow.
    fn keep_isolated<T: Value>(&self, values: &[T], smooth: &mut [T]) {
        for (v, valence) in self.valences.iter().enumerate() {
            if *valence == 0 {
                smooth[v] = values[v];
            }
        }
    }

    pub fn rule(&self, vertex: u32) -> Rule {
        let at = self.special.binary_search_by_key(&vertex, |special| special.vertex);
        at.map_or(Rule::Smooth, |i| self.special[i].now)
    }
}

impl Special {
    fn of(vertex: u32, sharpness: f32, spokes: &[Spoke]) -> Self {
        let now = rule(sharpness, spokes, |s| s);
        let next = rule(decay(sharpness), spokes, decay);
        Self { vertex, now, next, weight: weight(sharpness, spokes) }
    }
}

fn rule(corner: f32, spokes: &[Spoke], sharpness: impl Fn(f32) -> f32) -> Rule {
    let mut sharp = spokes.iter().filter(|spoke| sharpness(spoke.sharpness) > 0.0).map(|spoke| spoke.far);
    if corner > 0.0 {
        return Rule::Corner;
    }
    match (sharp.next(), sharp.next(), sharp.next()) {
        (_, None, _) => Rule::Smooth,
        (Some(a), Some(b), None) => Rule::Crease([a, b]),
        _ => Rule::Corner,
    }
}

/// Mean sharpness of what becomes smooth in this step, at most 1.
fn weight(corner: f32, spokes: &[Spoke]) -> f32 {
    let fading = |s: &f32| *s > 0.0 && decay(*s) <= 0.0;
    let all = || std::iter::once(corner).chain(spokes.iter().map(|spoke| spoke.sharpness)).filter(fading);
    let count = all().count();
    if count == 0 { 0.0 } else { (all().sum::<f32>() / count as f32).min(1.0) }
}
