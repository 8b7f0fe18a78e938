//! Light linking: which light is for whom.
//!
//! Geometry is in categories, as Hydra has them: collections that lights name. Few sets of categories are different, so
//! an instance has the number of its set.

use super::{Lights, Shadow};
use crate::flat::{self, Prims};
use std::collections::BTreeMap;

/// The sets of categories that geometry is in, each as bits.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Members {
    sets: Vec<Vec<u64>>,
}

impl Members {
    /// Whether the things of `set` are in `category`.
    pub fn has(&self, set: u32, category: u32) -> bool {
        self.sets[set as usize][category as usize / 64] >> (category % 64) & 1 == 1
    }
}

/// The lights that are for the things of one set of categories.
#[derive(Debug, Clone)]
pub struct Linked {
    lights: Vec<bool>,
    /// By node of the tree, as bits: children with such a light.
    pub lanes: Vec<u8>,
}

impl Linked {
    pub fn has(&self, light: u32) -> bool {
        self.lights[light as usize]
    }
}

/// Categories that lights name while a scene is compiled.
#[derive(Debug, Default)]
pub struct Categories {
    numbers: BTreeMap<String, u32>,
    sets: BTreeMap<Vec<u64>, u32>,
}

impl Categories {
    /// Those that visible lights name.
    pub fn of(lights: &Prims<flat::Light>) -> Self {
        let visible = lights.values().filter(|light| light.visible);
        let names = visible.flat_map(|light| [&light.light_link, &light.shadow_link]).filter(|name| !name.is_empty());
        let mut numbers: BTreeMap<String, u32> = names.map(|name| (name.clone(), 0)).collect();
        numbers.values_mut().zip(0..).for_each(|(number, i)| *number = i);
        Self { numbers, sets: BTreeMap::new() }
    }

    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Number of the set of `categories`; names that no light has are none.
    pub fn set(&mut self, categories: &[String]) -> u32 {
        let mut bits = vec![0; self.numbers.len().div_ceil(64)];
        for number in categories.iter().filter_map(|name| self.numbers.get(name)) {
            bits[*number as usize / 64] |= 1_u64 << (number % 64);
        }
        let next = self.sets.len() as u32;
        *self.sets.entry(bits).or_insert(next)
    }

    /// The category of that name; `None` where it holds everything.
    pub fn category(&self, name: &str) -> Option<u32> {
        let number = *self.numbers.get(name)?;
        let has = |bits: &Vec<u64>| bits[number as usize / 64] >> (number % 64) & 1 == 1;
        (!self.sets.keys().all(has)).then_some(number)
    }

    pub fn members(&self) -> Members {
        let mut sets = vec![Vec::new(); self.sets.len()];
        self.sets.iter().for_each(|(bits, &i)| sets[i as usize].clone_from(bits));
        Members { sets }
    }
}

impl Lights {
    /// Takes links and shadow rules from the flat lights, once the sets of all geometry are known.
    pub fn link(&mut self, lights: &Prims<flat::Light>, categories: &Categories) {
        let flat = |path: &String| &lights[path];
        self.links = self.paths.iter().map(|path| categories.category(&flat(path).light_link)).collect();
        self.shadows = self.paths.iter().map(|path| Shadow::new(flat(path), categories)).collect();
        if self.links.iter().all(Option::is_none) {
            self.links.clear();
        }
        let members = categories.members();
        let sets = if self.links.is_empty() { 0 } else { members.sets.len() as u32 };
        self.linked_to = (0..sets).map(|set| self.those_for(set, &members)).collect();
        if self.shadows.iter().all(Option::is_none) {
            self.shadows.clear();
        }
    }

    fn those_for(&self, set: u32, members: &Members) -> Linked {
        let is_for = |category: &Option<u32>| category.is_none_or(|category| members.has(set, category));
        let lights: Vec<bool> = self.links.iter().map(is_for).collect();
        let lanes = self.tree.as_ref().map_or(Vec::new(), |tree| tree.lanes_with(|light| lights[light as usize]));
        Linked { lights, lanes }
    }

    /// Category of what a light lights; `None`: everything.
    pub fn category(&self, light: u32) -> Option<u32> {
        self.links.get(light as usize).copied().flatten()
    }

    /// Lights that do not light everything.
    pub fn linked(&self) -> usize {
        self.links.iter().flatten().count()
    }

    /// Whether some light does not light everything.
    pub fn has_links(&self) -> bool {
        !self.links.is_empty()
    }

    /// How the shadows of a light differ from those of everything.
    pub fn shadow(&self, light: u32) -> Option<&Shadow> {
        self.shadows.get(light as usize).and_then(Option::as_ref)
    }

    /// Lights with shadow rules.
    pub fn ruled(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.shadows.len() as u32).filter(|&light| self.shadow(light).is_some())
    }

    pub fn has_shadow_rules(&self) -> bool {
        !self.shadows.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_numbered_and_what_holds_everything_is_no_link() {
        let link = |name: &str| flat::Light { light_link: name.into(), ..flat::Light::default() };
        let lights: Prims<flat::Light> = (0..70).map(|i| (format!("/L{i}"), link(&format!("c{i:02}")))).collect();
        let mut categories = Categories::of(&lights);
        let names = |of: &[u32]| of.iter().map(|i| format!("c{i:02}")).collect::<Vec<_>>();
        let a = categories.set(&names(&[0, 3, 69]));
        let b = categories.set(&names(&[3, 69, 99]));
        assert_eq!(categories.set(&names(&[69, 3, 0])), a);
        assert_eq!((categories.category("c03"), categories.category("c69")), (None, None));
        let (first, empty) = (categories.category("c00").unwrap(), categories.category("c01").unwrap());
        let members = categories.members();
        assert!(members.has(a, first) && !members.has(b, first) && !members.has(a, empty) && members.has(b, 69));
    }
}
