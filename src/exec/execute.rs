//! Executes a plan: checks what can be checked before anything runs, then lets the dispatcher work.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Instant;

use super::context::RunContext;
use super::dispatch::Dispatcher;
use super::event::Event;
use super::executed::{ExecError, Executed};
use super::options::Options;
use super::resources::{InsufficientResource, Pool, Units};
use super::runner::Runner;
use super::task::Task;
use super::workers::Workers;
use crate::plan::{Plan, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::store::Store;

/// Executes the stages of the plan, and those that turn out to be stale after them. Stops cleanly soon after `stop`
/// becomes true.
///
/// # Errors
/// The store cannot be used, an executable is missing, or a stage asks for more of a resource than there is. Failures of
/// stages are events and are counted in the outcome.
pub fn execute(
    plan: Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(&Event),
) -> Result<Executed, ExecError> {
    let began = Instant::now();
    check_workers(&plan, runner)?;
    let is_cached = |verdict: &Verdict| matches!(verdict, Verdict::Cached { .. });
    let rest = plan.steps.iter().filter(|(_, verdict)| !is_cached(verdict)).map(|(stage, _)| *stage);
    check_resources(plan.graph, rest, &options.resources)?;
    let Plan { graph, steps, files, order, history, held, stats, forced, .. } = plan;
    // This only saves time in the next run. A store that cannot be written is reported where it matters.
    let _ = store.keep_stats(&stats);
    let halt = AtomicBool::new(false);
    let context = RunContext {
        graph,
        files: &files,
        order: &order,
        forced: &forced,
        store,
        runner,
        options,
        halt: &halt,
    };
    let mut dispatcher = Dispatcher::new(context, (history, held), began, sink);
    std::thread::scope(|scope| {
        let (sender, receiver) = mpsc::sync_channel(256);
        let workers = Workers::new(scope, move |task: Task<'_>| task.work(context, &sender));
        let result = dispatcher.run(steps, &receiver, stop, &mut |task| workers.start(task));
        // If the dispatcher gave up, running stages must stop: nothing listens to them any more.
        halt.store(true, Ordering::Relaxed);
        result
    })?;
    Ok(dispatcher.finish()?)
}

/// Reports a stage that can never start before anything runs.
pub(super) fn check_resources(
    graph: &Graph,
    stages: impl IntoIterator<Item = StageIndex>,
    units: &Units,
) -> Result<(), InsufficientResource> {
    for stage in stages {
        let node = &graph.stages[stage];
        for (name, wanted) in node.resources.iter() {
            let available = Pool::count(units, name);
            if *wanted as usize > available {
                let (stage, name) = (node.id.to_string(), name.clone());
                return Err(InsufficientResource { stage, name, wanted: *wanted, available });
            }
        }
    }
    Ok(())
}

/// Reports a missing executable before anything runs, and not hours later.
fn check_workers(plan: &Plan<'_>, runner: &dyn Runner) -> Result<(), ExecError> {
    let mut checked: Vec<Option<&'static str>> = Vec::new();
    for (stage, verdict) in &plan.steps {
        let kind = &plan.graph.stages[*stage].kind;
        if !matches!(verdict, Verdict::Cached { .. }) && !checked.contains(&kind.worker()) {
            runner.check(kind.worker()).map_err(|source| ExecError::Worker { kind: kind.name(), source })?;
            checked.push(kind.worker());
        }
    }
    Ok(())
}
