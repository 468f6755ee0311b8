//! The contract between the engine and stages: what the author of a stage implements, and what the engine provides.
//!
//! - [`Describe`] declares a stage kind (name, parameters, ports), [`Stage`] runs it, [`Program`] delegates it to another
//!   program. [`Kind`] is the type-erased form, and [`Registry`] the set of kinds that a program offers.
//! - [`Ports`] declares typed inputs and outputs ([`Artifact`]); [`Needs`] declares resource needs.
//! - [`Ctx`] is the context of a running stage: seed, inputs, outputs, progress, checkpoint folder, cancellation.
//! - [`Job`] is the file that the engine writes for the process that runs a stage.
//! - [`Tool`] declares a subcommand of a stage package that works on one artifact, and [`Reply`] is the result of a
//!   subcommand.
//! - [`math`] and [`draw`] are functions and random draws whose bits do not depend on the processor. Code that affects a
//!   result uses them instead of `std` or other libraries.
//! - [`outcome`] is a pipeline with its results, the input of the HTML report.
//! - [`scores`] is the artifact format that several stage crates share, and [`lines`] names the lines of CSV files in messages.
//! - [`suggest`] finds the name that was meant.
//!
//! This crate does not know YAML, keys or the cache, and depends on no other package of the workspace.

pub mod artifact;
mod ctx;
pub mod draw;
mod error;
mod incoming;
mod job;
mod kind;
pub mod lines;
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
pub mod suggest;
pub mod testing;
mod tool;

pub use artifact::Artifact;
pub use ctx::{Ctx, InputItem};
pub use error::StageError;
pub use incoming::{FanIns, Incoming};
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
