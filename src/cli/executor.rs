//! The runner that a run uses: child processes of this machine, or jobs of a cluster.

use std::path::Path;
use std::sync::Arc;

use super::args::{Executor, RunArgs};
use crate::error::{Error, ErrorKind};
use crate::exec::{self, ChildRunner, Failure, Options, Runner};
use crate::settings::SlurmSettings;
use crate::slurm::{Pace, Slurm, SlurmRunner};

/// Threads that jobs may ask for together, unless it is set.
const MAX_THREADS: usize = 1000;

/// Changes options to those of the executor: a cluster has more threads than this machine.
pub(super) fn adapt(options: &mut Options, args: &RunArgs, settings: &SlurmSettings) {
    if args.executor.executor == Executor::Slurm && args.jobs.is_none() {
        options.threads = settings.max_threads.map_or(MAX_THREADS, usize::from);
    }
}

/// The runner that the arguments ask for; `store` is the folder of the store.
///
/// # Errors
/// This program's file is unknown, or the store cannot be written.
pub(super) fn runner(
    args: &RunArgs,
    settings: SlurmSettings,
    store: &Path,
) -> Result<Box<dyn Runner>, Error> {
    if args.executor.executor == Executor::Slurm {
        let made = SlurmRunner::new(Arc::new(Slurm), settings, store, args.executor.detach, Pace::default());
        let runner = made.map_err(|error| match error {
            Failure::Store(error) => error.into(),
            error => Error::new(ErrorKind::Io, error),
        })?;
        return Ok(Box::new(runner));
    }
    // While it runs stages, this program starts no other processes.
    exec::claim_all_children();
    let runner = ChildRunner::this_program().map_err(|error| {
        Error::new(ErrorKind::Io, format!("cannot find the path of this executable: {error}"))
    })?;
    Ok(Box::new(runner))
}
