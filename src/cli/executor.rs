//! The runner that a run uses: child processes of this machine, or jobs of a cluster.

use std::path::Path;
use std::sync::Arc;

use super::args::{Executor, RunArgs};
use crate::cluster::{ClusterRunner, Scheduler, Site, Slurm, Template};
use crate::error::{Error, ErrorKind};
use crate::exec::{self, ChildRunner, Failure, Options, Runner};
use crate::settings::{ClusterSettings, Settings};

/// Threads that jobs may request together, unless it is set.
const MAX_THREADS: usize = 1000;

/// A cluster: its scheduler, and what jobs request.
pub(super) type Cluster = (Arc<dyn Scheduler>, ClusterSettings);

/// The cluster that `executor` names; `None` for this machine.
///
/// # Errors
/// The settings have no executor of that name.
pub(super) fn cluster(executor: &Executor, settings: Settings) -> Result<Option<Cluster>, Error> {
    let mut settings = settings;
    match executor {
        Executor::Local => Ok(None),
        Executor::Slurm => Ok(Some((Arc::new(Slurm), settings.slurm))),
        Executor::Named(name) => {
            let Some(executor) = settings.executors.remove(name) else {
                let known =
                    ["local", "slurm"].into_iter().chain(settings.executors.keys().map(|name| &**name));
                let known: Vec<String> = known.map(|name| format!("`{name}`")).collect();
                let message = format!(
                    "`--executor {name}`: there is no such executor, expected one of {}",
                    known.join(", ")
                );
                return Err(Error::new(ErrorKind::Usage, message)
                    .hint(format!("describe it under `[executors.{name}]` in `dril-pipe.toml`")));
            };
            let jobs = executor.jobs.clone();
            Ok(Some((Arc::new(Template::new(name, executor)), jobs)))
        }
    }
}

/// Changes options to those of the cluster, which has more threads than this machine.
pub(super) fn adapt(options: &mut Options, args: &RunArgs, cluster: Option<&Cluster>) {
    if let (Some((_, settings)), None) = (cluster, args.jobs) {
        options.threads = max_threads(settings);
    }
}

/// The threads that all jobs together may request.
pub(super) fn max_threads(settings: &ClusterSettings) -> usize {
    settings.max_threads.map_or(MAX_THREADS, usize::from)
}

/// The runner for a cluster or this machine; `store` is the folder of the store.
///
/// # Errors
/// This program's file is unknown, or the store cannot be written.
pub(super) fn runner(
    args: &RunArgs,
    cluster: Option<Cluster>,
    store: &Path,
) -> Result<Box<dyn Runner>, Error> {
    let unknown = |error: std::io::Error| {
        Error::new(ErrorKind::Io, format!("cannot find the path of this executable: {error}"))
    };
    if let Some((scheduler, settings)) = cluster {
        let mut site = Site::new(store).map_err(unknown)?;
        site.detach = args.executor.detach;
        site.environment = std::env::vars_os().collect();
        let runner = ClusterRunner::new(scheduler, settings, site).map_err(|error| match error {
            Failure::Store(error) => error.into(),
            error => Error::new(ErrorKind::Io, error),
        })?;
        return Ok(Box::new(runner));
    }
    // While it runs stages, this program starts no other processes.
    exec::claim_all_children();
    exec::raise_open_files();
    Ok(Box::new(ChildRunner::this_program().map_err(unknown)?))
}
