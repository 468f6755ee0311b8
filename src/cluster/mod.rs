//! Runs stages as jobs of a cluster.
//!
//! The engine stays where it was started, as on a login node. Each stage becomes a job that reads one file, runs
//! `dril-pipe __node FOLDER`, and writes one file with the result; the engine publishes the outputs. Small stages can share
//! long-lived jobs, the pilots, which run `dril-pipe __pilot FOLDER`. The store lies on a file system that engine and nodes
//! share. Jobs outlive their engine: the next one finds them and waits for them.

mod build;
mod ending;
mod gpus;
mod handoff;
mod node;
mod pilot;
mod pilots;
mod prepare;
mod queue;
mod runner;
mod scheduler;
mod site;
mod slurm;
mod submit;
mod template;
mod threads;
mod watch;

pub use node::{Assigned, NODE, run_on_node};
pub use pilot::{PILOT, run_pilot};
pub use prepare::JOB;
pub use runner::ClusterRunner;
pub use scheduler::{JobId, Scheduler, Seen, State, Submission, SubmitError};
pub use site::{Pace, Site};
pub use slurm::Slurm;
pub use template::Template;
