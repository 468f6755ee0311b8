//! Counted resources (GPUs, licences): how many units of each exist, and which stage holds which.
//!
//! Every unit has a name, so that two stages that run at the same time do not use the same GPU. A resource that `--resources`
//! does not list has one unit: stages that ask for it run one after the other.

use std::collections::BTreeMap;

use crate::resolve::StageIndex;
use crate::spec::Resources;

/// The units of each resource, by its name.
pub type Units = BTreeMap<String, Vec<String>>;

/// A stage asks for more units of a resource than the run has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("stage `{stage}` needs {wanted} of resource `{name}`, and the run has {available}")]
pub struct InsufficientResource {
    /// The stage.
    pub stage: String,
    /// The resource.
    pub name: String,
    /// How many it asks for.
    pub wanted: u32,
    /// How many the run has.
    pub available: usize,
}

/// Units that are free, and those that stages hold.
#[derive(Debug, Default)]
pub(super) struct Pool {
    free: Units,
    held: BTreeMap<StageIndex, Units>,
}

impl Pool {
    /// A pool in which all these units are free.
    pub fn new(units: &Units) -> Self {
        let mut free = units.clone();
        // So that the first one is given out first.
        free.values_mut().for_each(|units| units.reverse());
        Self { free, held: BTreeMap::new() }
    }

    /// How many units of a resource exist: one, unless listed.
    pub fn count(units: &Units, name: &str) -> usize {
        units.get(name).map_or(1, Vec::len)
    }

    fn free(&self, name: &str) -> usize {
        self.free.get(name).map_or(1, Vec::len)
    }

    /// True where enough units are free.
    pub fn has(&self, wanted: &Resources) -> bool {
        wanted.iter().all(|(name, count)| self.free(name) >= *count as usize)
    }

    /// Gives a stage the units that it asks for, which must be free.
    pub fn take(&mut self, stage: StageIndex, wanted: &Resources) -> Units {
        let mut taken = Units::new();
        for (name, count) in wanted.iter() {
            let free = self.free.entry(name.clone()).or_insert_with(|| vec!["0".to_owned()]);
            let from = free.len().saturating_sub(*count as usize);
            let mut units = free.split_off(from);
            units.reverse();
            taken.insert(name.clone(), units);
        }
        if !taken.is_empty() {
            self.held.insert(stage, taken.clone());
        }
        taken
    }

    /// Takes back the units of a stage.
    pub fn give_back(&mut self, stage: StageIndex) {
        for (name, units) in self.held.remove(&stage).unwrap_or_default() {
            let free = self.free.entry(name).or_default();
            free.extend(units);
            free.sort_unstable_by(|a, b| (b.len(), b).cmp(&(a.len(), a)));
        }
    }
}

/// The environment variables that tell a stage which units it holds: `CUDA_VISIBLE_DEVICES` for `gpu`, and for each resource
/// `DRIL_RESOURCE_<NAME>`.
pub(super) fn variables(units: &Units) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for (name, units) in units {
        let list = units.join(",");
        if name == "gpu" {
            all.push(("CUDA_VISIBLE_DEVICES".to_owned(), list.clone()));
        }
        all.push((format!("DRIL_RESOURCE_{}", name.to_ascii_uppercase().replace('-', "_")), list));
    }
    all
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn no_two_stages_hold_the_same_unit_and_a_resource_that_is_not_listed_has_one() {
        let units = Units::from([("gpu".to_owned(), vec!["0".to_owned(), "1".to_owned(), "10".to_owned()])]);
        let wants = |name: &str, count| Arc::new(BTreeMap::from([(name.to_owned(), count)]));
        let (a, b, c) = (StageIndex::new(0), StageIndex::new(1), StageIndex::new(2));
        let mut pool = Pool::new(&units);
        assert_eq!(pool.take(a, &wants("gpu", 2))["gpu"], ["0", "1"]);
        assert!(pool.has(&wants("gpu", 1)) && !pool.has(&wants("gpu", 2)));
        assert_eq!(pool.take(b, &wants("gpu", 1))["gpu"], ["10"]);
        pool.give_back(a);
        assert_eq!(pool.take(a, &wants("gpu", 1))["gpu"], ["0"]);
        assert!(pool.has(&wants("licence", 1)) && !pool.has(&wants("licence", 2)));
        pool.take(c, &wants("licence", 1));
        assert!(!pool.has(&wants("licence", 1)));
        pool.give_back(c);
        assert!(pool.has(&wants("licence", 1)) && pool.has(&Resources::default()));
    }

    #[test]
    fn environment_variables_tell_a_stage_its_units() {
        let units = Units::from([
            ("gpu".to_owned(), vec!["1".to_owned(), "3".to_owned()]),
            ("my-licence".to_owned(), vec!["0".to_owned()]),
        ]);
        let pairs: Vec<String> =
            variables(&units).into_iter().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(
            pairs,
            ["CUDA_VISIBLE_DEVICES=1,3", "DRIL_RESOURCE_GPU=1,3", "DRIL_RESOURCE_MY_LICENCE=0"]
        );
    }
}
