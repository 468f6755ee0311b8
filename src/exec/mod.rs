//! Executes a plan: one dispatcher owns the state of the run, stages run in child processes, and their outputs are published
//! to the store. Another executor implements [`Runner`].

mod apart;
mod child;
mod context;
mod dispatch;
mod ending;
mod event;
mod execute;
mod executed;
mod failure;
mod in_order;
mod inline;
mod inputs;
mod job;
mod journal;
mod listen;
mod memory;
mod options;
mod origins;
mod processes;
mod publish;
mod ready;
mod recheck;
mod resources;
mod runner;
mod stage;
mod survivors;
mod task;
mod unstarted;
mod warden;
mod workers;

pub use apart::raise_open_files;
pub use child::ChildRunner;
pub use event::{Event, RunOutcome};
pub use execute::execute;
pub use executed::{ExecError, Executed};
pub use failure::{Failure, FailureKind};
pub use inline::InlineRunner;
pub use inputs::LaidOut;
pub use options::{Options, POLL_INTERVAL};
pub use recheck::{RecheckOutcome, recheck};
pub use resources::{InsufficientResource, Units};
pub use runner::{Exit, Launch, Runner};
pub use stage::{EXIT_STOPPED, run_stage};
pub use survivors::claim_all_children;
pub use warden::{WARDEN, watch_over};
