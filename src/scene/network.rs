//! The network of a material as a program: one pass over its nodes per surface point.
//!
//! What leads to texture coordinates is computed at three points, the hit and two beside it across the ray's
//! footprint, so that an image knows how much of it is seen whatever transforms its coordinates.

use super::InstancePrimvars;
use super::attribute::Values;
use super::image::{Image, ImageCache, Sampling};
use crate::flat::{Network, Node, Op, Wrap};
use glam::{Vec2, Vec4};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A surface point as the nodes see it.
#[derive(Clone, Copy)]
pub struct Lookup<'a> {
    pub primvars: &'a BTreeMap<String, Values>,
    /// Those of the instance, in place of the others, and which of their values are its own.
    pub instance: Option<(&'a InstancePrimvars, usize)>,
    pub triangle: usize,
    /// Points of the triangle.
    pub corners: [u32; 3],
    /// Barycentrics of the point.
    pub at: Vec2,
    /// Their offsets across the footprint; `None`: all of every image is seen.
    pub across: Option<[Vec2; 2]>,
    /// Of the shutter.
    pub time: f32,
}

/// Value at the point and at the two beside it.
type Register = [Vec4; 3];

enum Step {
    Constant(Vec4),
    /// Name, and what stands in where a mesh has no such primvar.
    Primvar(String, Vec4),
    Image(ImageStep),
    Math(Op, [usize; 4]),
    Gather([usize; 4], [usize; 4]),
}

struct ImageStep {
    /// UDIM (0: everywhere), ascending.
    tiles: Vec<(u32, Arc<Image>)>,
    st: usize,
    sampling: Sampling,
    fallback: Vec4,
}

/// A compiled network.
pub struct Program {
    steps: Vec<Step>,
    /// Whether coordinates depend on the step.
    beside: Vec<bool>,
    /// Input and the step that drives it.
    pub inputs: Vec<(String, usize)>,
}

thread_local! {
    static REGISTERS: RefCell<Vec<Register>> = const { RefCell::new(Vec::new()) };
}

impl Program {
    /// From a validated network; images that could not be read are not in the cache.
    pub fn compile(network: &Network, images: &ImageCache) -> Self {
        let mut beside = vec![false; network.nodes.len()];
        for (i, node) in network.nodes.iter().enumerate().rev() {
            match node {
                Node::Image(image) => beside[image.st] = true,
                Node::Math { args, .. } if beside[i] => args.iter().for_each(|&arg| beside[arg] = true),
                Node::Gather { args, .. } if beside[i] => args.iter().for_each(|&arg| beside[arg] = true),
                _ => {}
            }
        }
        let steps = network.nodes.iter().map(|node| step(node, images)).collect();
        Self { steps, beside, inputs: network.inputs.iter().map(|(name, node)| (name.clone(), *node)).collect() }
    }

    /// Calls `take` with the values of all steps.
    pub fn run<R>(&self, at: &Lookup, take: impl FnOnce(&dyn Fn(usize) -> Vec4) -> R) -> R {
        REGISTERS.with_borrow_mut(|registers| {
            registers.clear();
            for (step, &beside) in self.steps.iter().zip(&self.beside) {
                let value = step.value(at, registers, beside && at.across.is_some());
                registers.push(value);
            }
            take(&|i| registers[i][0])
        })
    }
}

fn step(node: &Node, images: &ImageCache) -> Step {
    match node {
        Node::Constant { value } => Step::Constant(Vec4::from(*value)),
        Node::Primvar { varname, fallback } => Step::Primvar(varname.clone(), Vec4::from(*fallback)),
        Node::Math { op, args } => Step::Math(*op, std::array::from_fn(|i| args.get(i).copied().unwrap_or(0))),
        Node::Gather { args, lanes } => Step::Gather(*args, *lanes),
        Node::Image(image) => {
            let found = image.tiles.iter().filter_map(|tile| Some((tile.udim, images.get(&tile.image)?.clone())));
            let mut tiles: Vec<(u32, Arc<Image>)> = found.collect();
            tiles.sort_by_key(|tile| tile.0);
            let (border, fallback) = (Vec4::from(image.border), Vec4::from(image.fallback));
            // A tile ends where the next one begins: nothing wraps.
            let udim = image.tiles.iter().any(|tile| tile.udim > 0);
            let [wrap_s, wrap_t] = [image.wrap_s, image.wrap_t].map(|wrap| if udim { Wrap::Clamp } else { wrap });
            let sampling = Sampling { wrap_s, wrap_t, border, closest: image.closest };
            Step::Image(ImageStep { tiles, st: image.st, sampling, fallback })
        }
    }
}

impl Step {
    fn value(&self, at: &Lookup, before: &[Register], beside: bool) -> Register {
        let points = |f: &dyn Fn(usize) -> Vec4| {
            let here = f(0);
            if beside { [here, f(1), f(2)] } else { [here; 3] }
        };
        match self {
            Self::Constant(value) => [*value; 3],
            Self::Primvar(name, fallback) => match (at.of_instance(name), at.primvars.get(name)) {
                (Some(value), _) => [value; 3],
                (None, Some(values)) => points(&|k| at.primvar(values, k)),
                (None, None) => [*fallback; 3],
            },
            Self::Image(image) => [image.value(at, &before[image.st]); 3],
            Self::Math(op, args) => points(&|k| math(*op, args.map(|arg| before[arg][k]))),
            Self::Gather(args, lanes) => {
                points(&|k| Vec4::from_array(std::array::from_fn(|i| before[args[i]][k][lanes[i]])))
            }
        }
    }
}

impl Lookup<'_> {
    fn of_instance(&self, name: &str) -> Option<Vec4> {
        let (primvars, i) = self.instance?;
        primvars.get(name).map(|values| values[i]).filter(|value| !value.x.is_nan())
    }

    /// At the point (0) or beside it (1, 2).
    fn primvar(&self, values: &Values, k: usize) -> Vec4 {
        let offset = match (k.checked_sub(1), self.across) {
            (Some(i), Some(across)) => across[i],
            _ => Vec2::ZERO,
        };
        let p = self.at + offset;
        values.at(self.triangle, self.corners, p.x, p.y)
    }
}

impl ImageStep {
    fn value(&self, at: &Lookup, [here, a, b]: &Register) -> Vec4 {
        let st = Vec2::new(here.x, here.y);
        if !st.is_finite() {
            return self.fallback;
        }
        let across = at.across.map(|_| [a, b].map(|p| Vec2::new(p.x - here.x, p.y - here.y)));
        match self.tiles.as_slice() {
            [(0, image)] => image.at(st, across, &self.sampling),
            tiles => {
                let (u, v) = (st.x.floor(), st.y.floor());
                // Ten tiles to a row (UsdUVTexture).
                let inside = (0.0..10.0).contains(&u) && (0.0..10.0).contains(&v);
                let udim = 1001 + u as u32 + 10 * v as u32;
                let tile = tiles.binary_search_by_key(&udim, |tile| tile.0).ok().filter(|_| inside);
                tile.map_or(self.fallback, |i| tiles[i].1.at(st - Vec2::new(u, v), across, &self.sampling))
            }
        }
    }
}

fn math(op: Op, [a, b, c, d]: [Vec4; 4]) -> Vec4 {
    let each = |f: fn(f32) -> f32| Vec4::from_array(a.to_array().map(f));
    match op {
        Op::Add => a + b,
        Op::Subtract => a - b,
        Op::Multiply => a * b,
        Op::Divide => a / b,
        // MaterialX: x - y floor(x / y), as in GLSL and OSL.
        Op::Modulo => a - b * (a / b).floor(),
        Op::Power => Vec4::from_array(std::array::from_fn(|i| a[i].powf(b[i]))),
        Op::Min => a.min(b),
        Op::Max => a.max(b),
        Op::Atan2 => Vec4::from_array(std::array::from_fn(|i| a[i].atan2(b[i]))),
        Op::Absval => a.abs(),
        Op::Sign => each(|x| if x == 0.0 { 0.0 } else { x.signum() }),
        Op::Floor => a.floor(),
        Op::Ceil => a.ceil(),
        Op::Round => (a + 0.5).floor(),
        Op::Sqrt => each(f32::sqrt),
        Op::Exp => each(f32::exp),
        Op::Ln => each(f32::ln),
        Op::Sin => each(f32::sin),
        Op::Cos => each(f32::cos),
        Op::Tan => each(f32::tan),
        Op::Asin => each(f32::asin),
        Op::Acos => each(f32::acos),
        Op::IfGreater => Vec4::select(a.cmpgt(b), c, d),
        Op::IfEqual => Vec4::select(a.cmpeq(b), c, d),
        Op::RgbToHsv => rgb_to_hsv(a),
        Op::HsvToRgb => hsv_to_rgb(a),
    }
}

/// Foley and van Dam; hue in 0..1, alpha as it is.
fn rgb_to_hsv(c: Vec4) -> Vec4 {
    let rgb = c.truncate();
    let (max, min) = (rgb.max_element(), rgb.min_element());
    let chroma = max - min;
    if chroma <= 0.0 || max <= 0.0 {
        return Vec4::new(0.0, 0.0, max, c.w);
    }
    let sector = if c.x >= max {
        (c.y - c.z) / chroma
    } else if c.y >= max {
        2.0 + (c.z - c.x) / chroma
    } else {
        4.0 + (c.x - c.y) / chroma
    };
    Vec4::new((sector / 6.0).rem_euclid(1.0), chroma / max, max, c.w)
}

/// Inverse of [`rgb_to_hsv`].
fn hsv_to_rgb(c: Vec4) -> Vec4 {
    let channel = |n: f32| {
        let k = (n + 6.0 * c.x).rem_euclid(6.0);
        c.z * (1.0 - c.y * k.min(4.0 - k).clamp(0.0, 1.0))
    };
    Vec4::new(channel(5.0), channel(3.0), channel(1.0), c.w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hue_comes_back() {
        for c in [[0.2, 0.7, 0.4], [1.0, 0.0, 0.0], [0.1, 0.2, 0.9], [0.9, 0.9, 0.1], [0.3, 0.3, 0.3], [0.0; 3]] {
            let c = Vec4::new(c[0], c[1], c[2], 0.5);
            assert!((hsv_to_rgb(rgb_to_hsv(c)) - c).abs().max_element() < 1e-6, "{c}");
        }
        assert_eq!(rgb_to_hsv(Vec4::new(0.0, 1.0, 0.0, 1.0)).x, 1.0 / 3.0);
    }

    #[test]
    fn operations() {
        let v = Vec4::splat;
        assert_eq!(math(Op::Modulo, [v(-0.25), v(1.0), v(0.0), v(0.0)]), v(0.75));
        assert_eq!(
            math(Op::Sign, [Vec4::new(-2.0, 0.0, 3.0, -0.0), v(0.0), v(0.0), v(0.0)]).to_array()[..3],
            [-1.0, 0.0, 1.0]
        );
        let chosen = math(Op::IfGreater, [Vec4::new(1.0, 2.0, 3.0, 4.0), v(2.0), v(5.0), v(7.0)]);
        assert_eq!(chosen, Vec4::new(7.0, 7.0, 5.0, 5.0));
    }
}
