//! The seam for executors: a [`Runner`] takes one job and runs it to its end, in a child process or on another machine.
//!
//! The dispatcher knows the graph and decides what starts when; a worker thread prepares the job, calls the runner, and
//! publishes the outputs to the store once the runner reports success. A runner knows nothing of graphs, keys or records.

use std::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use dril_stage_api::{Job, Kind, Message};

use super::failure::Failure;
use super::inputs::LaidOut;
use super::resources::Units;
use crate::fsx::Lock;
use crate::spec::Limits;

/// A job to start, and what it may use.
#[derive(Clone, Copy, Debug)]
pub struct Launch<'a> {
    /// What to do, with the paths of all inputs and outputs.
    pub job: &'a Job,
    /// The stage's kind.
    pub kind: Kind,
    /// The exclusive right to build the stage's key. A process that inherits it keeps the right until it ends. `None` for
    /// work that no other process could do at the same time.
    pub lock: Option<&'a Lock>,
    /// The log file for everything that the stage prints.
    pub log: &'a Path,
    /// The stage's private folder; removed afterwards.
    pub folder: &'a Path,
    /// Threads that it may keep busy.
    pub threads: usize,
    /// The units of counted resources that it holds.
    pub units: &'a Units,
    /// Set when the stage must stop: it is asked to first and killed after `grace`.
    pub stop: &'a AtomicBool,
    /// See [`super::Options::grace`].
    pub grace: Duration,
    /// How long it may run, and how much memory it may use with all processes that it starts.
    pub limits: Limits,
    /// True for a stage that must start without its checkpoint: the runner removes it, unless the job runs already.
    pub fresh: bool,
    /// The private copies of the inputs of an external program. `None` where nobody checks whether they were changed.
    pub inputs: Option<&'a LaidOut>,
}

/// How a job ended, where it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// It ended with success. Its outputs are checked by the caller.
    Done,
    /// It was asked to stop, and did.
    Stopped,
}

/// Runs one job, here or elsewhere.
pub trait Runner: Sync {
    /// Checks, before anything runs, that it can run the kinds of a worker ([`dril_stage_api::Kind::worker`]).
    ///
    /// # Errors
    /// What is missing, and how to fix it.
    fn check(&self, worker: Option<&'static str>) -> Result<(), Box<dyn Error + Send + Sync>> {
        let _ = worker;
        Ok(())
    }

    /// Runs the job to its end and passes every message of the stage to `on_message`. It polls `launch.stop` at least every
    /// [`super::POLL_INTERVAL`]. After it returns, no process of the job writes any more.
    ///
    /// # Errors
    /// The stage failed or passed a limit, or the job could not be started or observed.
    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure>;
}
