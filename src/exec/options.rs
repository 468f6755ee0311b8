//! How a plan is executed. None of these settings changes a result.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::resources::Units;

/// Polling interval for cancellation: a request to stop is noticed this soon, everywhere in `exec`.
pub const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// How a plan is executed. None of it changes a result.
#[derive(Clone, Debug)]
pub struct Options {
    /// Threads that stages may keep busy at the same time, at least 1.
    pub threads: usize,
    /// Seconds between checkpoints of a stage.
    pub checkpoint_seconds: f64,
    /// An absolute folder in which training stages write their learning curves, one folder per stage; `None` for no curves.
    pub curves: Option<PathBuf>,
    /// True: after a failure, stages that do not depend on the failed one still run. False: no further stage starts.
    pub keep_going: bool,
    /// How long a stage may take to stop when asked, before it is killed.
    pub grace: Duration,
    /// When the run stops by itself, as after an interrupt.
    pub deadline: Option<Instant>,
    /// The units of each counted resource; one unit of any resource that is not listed.
    pub resources: Units,
    /// Fields for the run's manifest: the pipeline file and the overrides that the plan was made from.
    pub about: serde_json::Map<String, serde_json::Value>,
}

impl Default for Options {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            threads,
            checkpoint_seconds: 120.0,
            curves: None,
            keep_going: true,
            grace: Duration::from_secs(20),
            deadline: None,
            resources: Units::new(),
            about: serde_json::Map::new(),
        }
    }
}
