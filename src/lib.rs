//! dril-pipe: a declarative experiment-pipeline engine.
//!
//! A pipeline file passes through one type per phase, so a later phase cannot be called with an earlier type:
//!
//! | phase | from | to | does |
//! |---|---|---|---|
//! | [`spec`] | YAML text | [`spec::Spec`] | parses, keeps the place of every value; no I/O |
//! | [`resolve`] | `Spec` + choices + registry | [`resolve::Graph`] | profiles, overrides, matrices, wiring, type check; no I/O |
//! | [`plan`] | `Graph` + store | [`plan::Plan`] | keys, what would run and why; reads records only |
//! | [`exec`] | `Plan` + store | [`exec::Executed`] | runs stages in child processes, publishes their outputs |
//! | [`session`] | pipeline file + store | [`session::Finished`] | all of the above, results folder and lock file |
//! | [`store`] | | | content-addressed blobs, records, locks |
//! | [`remote`] | | | a cache that several machines share |
//! | [`cluster`] | | | runs stages as jobs of a cluster |
//! | [`cli`] | arguments | exit code | the only module that prints, reads the environment or exits |
//!
//! [`settings`] reads `dril-pipe.toml`, which changes where and how stages run, and no result.
//!
//! [`kinds`] has the built-in stage kinds: any program, and files from outside.
//!
//! The engine knows nothing about learning: stage kinds, artifact types and tools are registered by `main`. To run a pipeline from
//! Rust, see [`Session`].

pub mod cli;
pub mod cluster;
pub mod error;
pub mod exec;
pub mod fsx;
pub mod kinds;
pub mod plan;
pub mod remote;
pub mod resolve;
pub mod session;
pub mod settings;
pub mod spec;
pub mod store;

pub use session::Session;
