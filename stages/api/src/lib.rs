//! The contract between the engine and a stage: what an author of a stage writes, and what the engine hands to it.
//!
//! - [`Describe`] says what a stage kind looks like, [`Stage`] what it does, [`Program`] which program does it instead;
//!   [`Kind`] is their erased form, [`Registry`] the set that a program offers.
//! - [`Ports`] declare typed inputs and outputs ([`Artifact`]); [`Needs`] what the stage takes of the machine.
//! - [`Ctx`] is all that a running stage sees: seed, inputs, outputs, progress, checkpoint folder, cancellation.
//! - [`Job`] is the same as a file, as the engine writes it for the child process that runs the stage.
//! - [`Tool`] is a subcommand that a stage package brings along, and [`Reply`] how one ends.
//! - [`math`] and [`draw`] are functions and random draws whose bits do not depend on the processor: what reaches a
//!   result uses them instead of those of `std` or of a library.
//! - [`outcome`] is a pipeline with its results, for whoever writes a page about them.
//! - [`scores`] is the one artifact format that several stage crates share.
//!
//! This crate knows nothing of YAML, keys or the cache, and depends on no other package of the workspace.

pub mod artifact;
mod ctx;
pub mod draw;
mod error;
mod job;
mod kind;
pub mod math;
mod needs;
pub mod outcome;
mod params;
mod ports;
mod progress;
mod registry;
mod reply;
pub mod scores;
mod seed;
mod stage;
pub mod testing;
mod tool;

pub use artifact::Artifact;
pub use ctx::{Ctx, InputItem};
pub use error::StageError;
pub use job::{Job, JobInput, JobOutput, Labels};
pub use kind::{Kind, Look};
pub use needs::Needs;
pub use params::{ParamProblem, Part, Problems};
pub use ports::{Arity, Input, Output, Outside, Ports, port_name};
pub use progress::{Message, Progress};
pub use registry::{Registry, RegistryError};
pub use reply::Reply;
pub use seed::{Seed, StreamRng};
pub use stage::{Describe, Finish, Prepared, Program, Stage};
pub use tool::{Tool, ToolOption, ToolValue};
