//! Runs stages as jobs of a Slurm cluster.
//!
//! The engine stays where it was started, as on a login node. Each stage becomes a job that gets one file, runs
//! `dril-pipe __node FOLDER`, and answers with one file; the engine publishes what it made. The store lies on a file system
//! that engine and nodes share. Jobs outlive their engine: the next one finds them and waits for them.

mod commands;
mod handoff;
mod node;
mod prepare;
mod runner;
mod scheduler;
mod threads;
mod watch;

pub use commands::Slurm;
pub use node::{NODE, run_on_node};
pub use runner::SlurmRunner;
pub use scheduler::{JobId, Scheduler, Seen, State, Submission, SubmitError};
pub use watch::Pace;
