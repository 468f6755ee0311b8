//! Where an engine and its jobs meet.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

/// The intervals of the watch; tests use shorter ones.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// How often the folder of notices is polled; more often where there are pilots.
    pub look: Duration,
    /// How often the scheduler lists the jobs, at most.
    pub ask: Duration,
    /// How long after a job's end its files may take to become visible here.
    pub settle: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            look: Duration::from_millis(100),
            ask: Duration::from_secs(10),
            // A network file system may show a folder as it was half a minute ago.
            settle: Duration::from_secs(60),
        }
    }
}

/// Where an engine and its jobs meet, and how they are watched.
#[derive(Clone, Debug)]
pub struct Site {
    /// The folder of the store, which engine and nodes see under the same path.
    pub store: PathBuf,
    /// This program, as nodes see it.
    pub program: PathBuf,
    /// The environment variables of the run. Jobs get its `PATH` and the variables that their stages name.
    pub environment: BTreeMap<OsString, OsString>,
    /// Jobs stay when the run is stopped.
    pub detach: bool,
    /// How often files and jobs are looked at.
    pub pace: Pace,
}

impl Site {
    /// A site for this program, whose jobs end with the run and get no variables of it.
    ///
    /// # Errors
    /// The path of this program is unknown.
    pub fn new(store: impl Into<PathBuf>) -> std::io::Result<Self> {
        let program = std::env::current_exe()?;
        let (environment, pace) = Default::default();
        Ok(Self { store: store.into(), program, environment, detach: false, pace })
    }

    /// The folder of all jobs.
    pub(super) fn jobs(&self) -> PathBuf {
        self.store.join("slurm-v1")
    }
}
