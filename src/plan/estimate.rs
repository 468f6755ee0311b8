//! Estimates the duration of stale stages: the time of the nearest earlier record of the same stage, scaled by the kind's cost;
//! otherwise the median time per cost of stages of the same kind.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::time::Duration;

use super::{Plan, Verdict, lookup};
use crate::resolve::{StageIndex, StageInstance};
use crate::store::{Record, Store, StoreError};

/// The number of records that are read per kind; more would not improve the estimate.
const SAMPLES: usize = 16;

/// Estimated seconds by stage.
#[derive(Clone, Debug)]
pub struct Estimates {
    seconds: Vec<Option<f64>>,
}

impl Estimates {
    /// Estimates the stages of a plan that are not cached.
    pub fn of(plan: &Plan<'_>, store: &Store) -> Result<Self, StoreError> {
        let mut seconds = vec![None; plan.graph.stages.node_count()];
        let mut rates: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        let mut unknown = Vec::new();
        for (index, verdict) in &plan.steps {
            if matches!(verdict, Verdict::Cached { .. }) {
                continue;
            }
            let node = &plan.graph.stages[*index];
            match lookup::earlier_record(store, &plan.history, &node.id)?.and_then(|then| rate(node, &then)) {
                Some(rate) => {
                    seconds[index.index()] = Some(rate * cost(node));
                    rates.entry(node.kind.name()).or_default().push(rate);
                }
                None => unknown.push(*index),
            }
        }
        for index in unknown {
            let node = &plan.graph.stages[index];
            let rates = rates.entry(node.kind.name()).or_default();
            if rates.is_empty() {
                *rates = of_kind(plan, store, node)?;
            }
            seconds[index.index()] = median(rates).map(|rate| rate * cost(node));
        }
        Ok(Self { seconds })
    }

    /// The estimate for a stage; `None` where it is cached or nothing is known.
    pub fn stage(&self, stage: StageIndex) -> Option<Duration> {
        let seconds = (*self.seconds.get(stage.index())?)?;
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// The time that the stages for which `stale` is true take together on this many threads, and the number of these stages
    /// without an estimate. Stages start as in a run: the longest path first, none before its inputs.
    pub fn together(
        &self,
        plan: &Plan<'_>,
        threads: usize,
        stale: impl Fn(StageIndex) -> bool,
    ) -> (Duration, usize) {
        let stages: Vec<StageIndex> =
            plan.steps.iter().map(|(index, _)| *index).filter(|index| stale(*index)).collect();
        let unknown = stages.iter().filter(|stage| self.seconds[stage.index()].is_none()).count();
        let own = |stage: StageIndex| self.seconds[stage.index()].unwrap_or_default();
        let mut chain = vec![0.0_f64; plan.graph.stages.node_count()];
        let mut left = vec![0_usize; chain.len()];
        for &stage in stages.iter().rev() {
            let readers = plan.order.readers(stage).iter().filter(|reader| stale(**reader));
            let behind = readers.map(|reader| {
                left[reader.index()] += 1;
                chain[reader.index()]
            });
            let behind = behind.fold(0.0, f64::max);
            chain[stage.index()] = behind + own(stage);
        }
        let nanos = |seconds: f64| (seconds * 1e9) as u64;
        let mut ready: BinaryHeap<(u64, Reverse<StageIndex>)> = BinaryHeap::new();
        for &stage in stages.iter().filter(|stage| left[stage.index()] == 0) {
            ready.push((nanos(chain[stage.index()]), Reverse(stage)));
        }
        let (mut now, mut free) = (0_u64, threads.max(1));
        let mut running: BinaryHeap<Reverse<(u64, StageIndex, usize)>> = BinaryHeap::new();
        loop {
            while let Some((_, Reverse(stage))) = ready.peek() {
                let needs = plan.graph.stages[*stage].needs.threads.clamp(1, threads.max(1));
                if needs > free {
                    break;
                }
                free -= needs;
                running.push(Reverse((now + nanos(own(*stage)), *stage, needs)));
                ready.pop();
            }
            let Some(Reverse((end, stage, needs))) = running.pop() else { break };
            (now, free) = (end, free + needs);
            for &reader in plan.order.readers(stage).iter().filter(|reader| stale(**reader)) {
                left[reader.index()] -= 1;
                if left[reader.index()] == 0 {
                    ready.push((nanos(chain[reader.index()]), Reverse(reader)));
                }
            }
        }
        (Duration::from_nanos(now), unknown)
    }
}

/// Seconds per unit of cost, from a record.
fn rate(node: &StageInstance, then: &Record) -> Option<f64> {
    if then.kind != node.kind.name() {
        return None;
    }
    let cost = node.kind.needs(&then.params).ok()?.cost;
    let rate = then.seconds / cost;
    (cost > 0.0 && rate.is_finite() && rate >= 0.0).then_some(rate)
}

fn cost(node: &StageInstance) -> f64 {
    if node.needs.cost.is_finite() { node.needs.cost.max(0.0) } else { 0.0 }
}

/// Seconds per unit of cost of cached stages of the same kind.
fn of_kind(plan: &Plan<'_>, store: &Store, node: &StageInstance) -> Result<Vec<f64>, StoreError> {
    let mut rates = Vec::new();
    for (index, verdict) in &plan.steps {
        let Verdict::Cached { key, .. } = verdict else { continue };
        let other = &plan.graph.stages[*index];
        if other.kind.name() != node.kind.name() || rates.len() >= SAMPLES {
            continue;
        }
        rates.extend(store.record(key)?.and_then(|then| rate(other, &then)));
    }
    Ok(rates)
}

fn median(rates: &mut [f64]) -> Option<f64> {
    rates.sort_unstable_by(f64::total_cmp);
    rates.get(rates.len() / 2).copied()
}
