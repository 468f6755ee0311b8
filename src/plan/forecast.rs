//! What a cluster would make of a plan: jobs, the time for several numbers of threads, and the chain of stages that no number of
//! threads makes shorter.

use std::time::Duration;

use super::{Estimates, Plan, Verdict};
use crate::resolve::{StageIndex, StageInstance};

/// Numbers of threads to forecast, besides that of the settings.
const THREADS: [usize; 4] = [1, 8, 32, 128];

/// Where a stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Beside the engine.
    Beside,
    /// In a job, which may run this long; a stage that takes longer resumes in another one.
    Job(Option<Duration>),
}

/// A forecast, from the times of earlier runs. Waiting in the queue of a scheduler is not part of it.
#[derive(Clone, Debug)]
pub struct Forecast {
    /// Jobs, where every stage has its own. A stage that takes longer than the time of a job has several.
    pub jobs: u64,
    /// Stages that run beside the engine.
    pub beside: usize,
    /// Threads of all jobs together, and the time of the whole.
    pub times: Vec<(usize, Duration)>,
    /// The longest chain of stages, in order; only those that would run.
    pub critical: Vec<StageIndex>,
    /// How long it takes.
    pub shortest: Duration,
    /// Stages that would run.
    pub stale: usize,
    /// Stages among them without an estimate, which count as nothing.
    pub unknown: usize,
}

impl Forecast {
    /// The forecast for the stages of a plan that are not cached, with at most `threads` for all jobs. `place` is where a stage runs.
    pub fn of(
        plan: &Plan<'_>,
        estimates: &Estimates,
        threads: usize,
        place: impl Fn(&StageInstance) -> Place,
    ) -> Self {
        let stale = |stage| !matches!(plan.verdict(stage), Some(Verdict::Cached { .. }));
        let stages: Vec<StageIndex> =
            plan.steps.iter().map(|(stage, _)| *stage).filter(|stage| stale(*stage)).collect();
        let (mut jobs, mut beside) = (0, 0);
        for stage in &stages {
            let Place::Job(limit) = place(&plan.graph.stages[*stage]) else {
                beside += 1;
                continue;
            };
            jobs += match (limit.filter(|limit| !limit.is_zero()), estimates.stage(*stage)) {
                (Some(limit), Some(takes)) => {
                    (takes.as_secs_f64() / limit.as_secs_f64()).ceil().max(1.0) as u64
                }
                _ => 1,
            };
        }
        let counts = THREADS.into_iter().filter(|count| *count < threads).chain([threads]);
        let times = counts.map(|count| (count, estimates.together(plan, count, stale).0)).collect();
        let unknown = stages.iter().filter(|stage| estimates.stage(**stage).is_none()).count();
        let (critical, shortest) = longest_chain(plan, estimates, &stages, stale);
        Self { jobs, beside, times, critical, shortest, stale: stages.len(), unknown }
    }
}

/// The chain of stages, each of which reads from the one before, that takes longest. `stages` are in topological order.
fn longest_chain(
    plan: &Plan<'_>,
    estimates: &Estimates,
    stages: &[StageIndex],
    stale: impl Fn(StageIndex) -> bool,
) -> (Vec<StageIndex>, Duration) {
    let mut behind = vec![(Duration::ZERO, None); plan.graph.stages.node_count()];
    for &stage in stages.iter().rev() {
        let readers = plan.order.readers(stage).iter().copied().filter(|reader| stale(*reader));
        // Of equal ones the first in node order, so that equal plans have equal forecasts.
        let next = readers.rev().max_by_key(|reader| behind[reader.index()].0);
        let rest = next.map_or(Duration::ZERO, |next| behind[next.index()].0);
        behind[stage.index()] = (estimates.stage(stage).unwrap_or_default() + rest, next);
    }
    let first = stages.iter().copied().rev().max_by_key(|stage| behind[stage.index()].0);
    let chain = std::iter::successors(first, |stage| behind[stage.index()].1).collect();
    (chain, first.map_or(Duration::ZERO, |first| behind[first.index()].0))
}
