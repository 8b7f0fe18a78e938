//! What is learned from walks: sums per region, gathered by tile and merged in the order of tiles.

use super::directions::DirectionSums;
use super::onward::Effort;
use crate::math::Rgb;
use crate::saved::{Loader, Saver};
use crate::subsurface::technique::{PerTechnique, TECHNIQUES};
use bytemuck::{Pod, Zeroable};
use std::collections::btree_map::{BTreeMap, Entry};
use std::io;

/// A region of the boundary cache of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub struct RegionId {
    pub instance: u32,
    pub region: u32,
}

/// Products of two controls, the lower triangle.
pub const PRODUCTS: usize = TECHNIQUES * (TECHNIQUES + 1) / 2;

/// Sums over the walks that started in a region.
#[derive(Debug, Clone)]
pub struct Sums {
    pub walks: f64,
    /// Of estimates, relative to what the path carried in.
    pub estimate: [f64; 3],
    pub squares: [f64; 3],
    /// Squared estimate times density ratio, per channel of the estimate.
    pub second_moment: [[f64; TECHNIQUES]; 3],
    pub effort: Effort,
    /// Sums for control variates.
    pub controls: Option<Box<ControlSums>>,
}

/// Sums for the regression of estimates on density ratios.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct ControlSums {
    pub walks: f64,
    pub estimate: [f64; 3],
    pub squares: [f64; 3],
    pub ratio: [f64; TECHNIQUES],
    pub products: [f64; PRODUCTS],
    pub cross: [[f64; TECHNIQUES]; 3],
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            walks: 0.0,
            estimate: [0.0; 3],
            squares: [0.0; 3],
            second_moment: [[0.0; TECHNIQUES]; 3],
            effort: Effort::default(),
            controls: None,
        }
    }
}

impl Default for ControlSums {
    fn default() -> Self {
        Self {
            walks: 0.0,
            estimate: [0.0; 3],
            squares: [0.0; 3],
            ratio: [0.0; TECHNIQUES],
            products: [0.0; PRODUCTS],
            cross: [[0.0; TECHNIQUES]; 3],
        }
    }
}

impl Sums {
    /// A walk with the density ratios `ratios` whose path brought `estimate`; `residual` is that less the controls.
    pub fn add(&mut self, ratios: &PerTechnique, estimate: Rgb, residual: Rgb) {
        let r = ratios.as_list().map(f64::from);
        self.walks += 1.0;
        for c in 0..3 {
            let (x, y) = (f64::from(estimate[c]), f64::from(residual[c]));
            self.estimate[c] += x;
            self.squares[c] += x * x;
            self.second_moment[c].iter_mut().zip(&r).for_each(|(sum, r)| *sum += y * y * r);
        }
    }

    /// Weights down what older shares have seen.
    pub fn fade(&mut self, by: f64) {
        self.walks *= by;
        self.estimate.iter_mut().chain(&mut self.squares).for_each(|x| *x *= by);
        self.second_moment.as_flattened_mut().iter_mut().for_each(|x| *x *= by);
    }

    pub fn merge(&mut self, other: &Sums) {
        self.walks += other.walks;
        add(&mut self.estimate, &other.estimate);
        add(&mut self.squares, &other.squares);
        add(self.second_moment.as_flattened_mut(), other.second_moment.as_flattened());
        self.effort.merge(&other.effort);
        if let Some(controls) = &other.controls {
            self.controls.get_or_insert_default().merge(controls);
        }
    }

    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.value(&self.walks)?;
        to.value(&[self.estimate, self.squares])?;
        to.value(&self.second_moment)?;
        to.value(&self.effort)?;
        to.value(&u8::from(self.controls.is_some()))?;
        self.controls.as_deref().map_or(Ok(()), |controls| to.value(controls))
    }

    pub(crate) fn load(from: &mut Loader) -> io::Result<Self> {
        let walks = from.value()?;
        let [estimate, squares] = from.value()?;
        let second_moment = from.value()?;
        let effort = from.value()?;
        let controls = if from.value::<u8>()? == 1 { Some(Box::new(from.value()?)) } else { None };
        Ok(Self { walks, estimate, squares, second_moment, effort, controls })
    }
}

impl ControlSums {
    pub fn add(&mut self, ratios: &PerTechnique, estimate: Rgb) {
        let r = ratios.as_list().map(f64::from);
        self.walks += 1.0;
        let mut products = &mut self.products[..];
        for i in 0..TECHNIQUES {
            self.ratio[i] += r[i];
            let (row, below) = products.split_at_mut(i + 1);
            row.iter_mut().zip(&r).for_each(|(sum, other)| *sum += r[i] * other);
            products = below;
        }
        for c in 0..3 {
            let x = f64::from(estimate[c]);
            self.estimate[c] += x;
            self.squares[c] += x * x;
            self.cross[c].iter_mut().zip(&r).for_each(|(sum, r)| *sum += x * r);
        }
    }

    pub fn merge(&mut self, other: &ControlSums) {
        self.walks += other.walks;
        add(&mut self.estimate, &other.estimate);
        add(&mut self.squares, &other.squares);
        add(&mut self.ratio, &other.ratio);
        add(&mut self.products, &other.products);
        add(self.cross.as_flattened_mut(), other.cross.as_flattened());
    }

    pub fn fade(&mut self, by: f64) {
        self.walks *= by;
        let sums = self.estimate.iter_mut().chain(&mut self.squares).chain(&mut self.ratio).chain(&mut self.products);
        sums.chain(self.cross.as_flattened_mut()).for_each(|x| *x *= by);
    }
}

fn add(sums: &mut [f64], other: &[f64]) {
    sums.iter_mut().zip(other).for_each(|(a, b)| *a += b);
}

/// Statistics of one tile, or of all: ordered, so that merging is the same for any number of threads.
#[derive(Debug, Default)]
pub struct Statistics {
    /// Of walks, by the region that they start in.
    pub walks: BTreeMap<RegionId, Sums>,
    /// Of the directions of light that comes out; the region is a coarse cell ([`super::exit::Exits`]).
    pub exits: BTreeMap<RegionId, Box<DirectionSums>>,
}

impl Statistics {
    pub fn merge(&mut self, other: Self) {
        for (region, sums) in other.walks {
            self.walks.entry(region).or_default().merge(&sums);
        }
        for (at, sums) in other.exits {
            match self.exits.entry(at) {
                Entry::Vacant(place) => drop(place.insert(sums)),
                Entry::Occupied(mut place) => place.get_mut().merge(&sums),
            }
        }
    }

    pub(crate) fn save(&self, to: &mut Saver) -> io::Result<()> {
        to.count(self.walks.len())?;
        for (region, sums) in &self.walks {
            to.value(region)?;
            sums.save(to)?;
        }
        to.count(self.exits.len())?;
        for (cell, sums) in &self.exits {
            to.value(cell)?;
            to.value(sums.as_ref())?;
        }
        Ok(())
    }

    pub(crate) fn load(from: &mut Loader) -> io::Result<Self> {
        let walks = (0..from.count()?).map(|_| Ok((from.value()?, Sums::load(from)?))).collect::<io::Result<_>>()?;
        let exits =
            (0..from.count()?).map(|_| Ok((from.value()?, Box::new(from.value()?)))).collect::<io::Result<_>>()?;
        Ok(Self { walks, exits })
    }
}
