//! dril-pipe: a declarative experiment-pipeline engine.
//!
//! A pipeline file passes through one type per phase, so a later phase cannot be called with an earlier type:
//!
//! | phase | from | to | does |
//! |---|---|---|---|
//! | [`spec`] | YAML text | [`spec::Spec`] | reads, keeps where everything stands; no I/O |
//! | [`resolve`] | `Spec` + choices + registry | [`resolve::Graph`] | profiles, overrides, matrices, wiring, type check; no I/O |
//! | [`plan`] | `Graph` + store | [`plan::Plan`] | keys, what would run and why; reads records only |
//! | [`exec`] | `Plan` + store | [`exec::Outcome`] | runs stages in child processes, publishes their outputs |
//! | [`store`] | | | content-addressed blobs, records, locks |
//! | [`cli`] | arguments | exit code | the only one that prints, reads the environment or exits |
//!
//! [`kinds`] has the stage kinds that serve every experiment: any program, and files from outside.
//!
//! The engine knows nothing about learning: stage kinds come in through [`dril_stage_api::Registry`].

pub mod cli;
pub mod error;
pub mod exec;
pub mod fsx;
pub mod kinds;
pub mod plan;
pub mod resolve;
pub mod session;
pub mod spec;
pub mod store;

pub use session::Session;
