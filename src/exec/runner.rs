//! What runs one job: the seam between the dispatcher, which knows the graph, and processes here or elsewhere.

use std::io;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use dril_stage_api::{Job, Kind, Message};

use super::resources::Units;
use crate::fsx::Lock;
use crate::spec::Limits;

/// What a runner is to start.
#[derive(Clone, Copy, Debug)]
pub struct Launch<'a> {
    /// What is to be done.
    pub job: &'a Job,
    /// The kind that does it.
    pub kind: Kind,
    /// The right to do the work, which a process may hold on to longer than this one lives; none for work that nobody else
    /// could do at the same time.
    pub lock: Option<&'a Lock>,
    /// The file for all that the stage prints.
    pub log: &'a Path,
    /// The folder that it may work in; removed afterwards.
    pub folder: &'a Path,
    /// Threads that it may keep busy.
    pub threads: usize,
    /// What it holds of counted resources.
    pub units: &'a Units,
    /// Raised when the stage shall stop: first asked to, then, after `grace`, killed.
    pub stop: &'a AtomicBool,
    /// See [`super::Options::grace`].
    pub grace: Duration,
    /// How long it may take, and how much memory it may keep with all that it starts.
    pub limits: Limits,
}

/// How a stage's process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Exit {
    /// It says that it is done.
    Done,
    /// It was asked to stop, and did.
    Stopped,
    /// It failed, for this reason.
    Failed(String),
    /// It was killed because it took more memory than it may, or than there is: the text says which.
    OutOfMemory(String),
    /// It took longer than it may.
    TimedOut,
}

/// Runs one job, here or elsewhere.
pub trait Runner: Sync {
    /// Says whether it can run the kinds of that worker ([`dril_stage_api::Kind::worker`]); asked before anything runs.
    ///
    /// # Errors
    /// What is missing, and how to mend it.
    fn check(&self, worker: Option<&'static str>) -> Result<(), String> {
        let _ = worker;
        Ok(())
    }

    /// Runs the job to its end; `hear` is told what it says. When it returns, nothing of the job writes any more.
    ///
    /// # Errors
    /// It could not be started or watched.
    fn run(&self, launch: &Launch<'_>, hear: &mut dyn FnMut(Message)) -> io::Result<Exit>;
}
