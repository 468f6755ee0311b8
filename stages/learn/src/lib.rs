//! The learning stages: PPO, behaviour cloning, the ensemble, DRIL, collecting and evaluating.
//!
//! Map:
//!
//! - [`algorithms`]: one file for each algorithm; [`training`]: the rollouts, statistics, logs and checkpoints that they
//!   share; [`data`]: demonstrations and frames; [`play`]: acting, and the stages that only act.
//! - [`policy`]: Gaussian, Beta and categorical policies; [`nn`]: networks and their two backends; [`kernels`]: the inner
//!   loops of the native backend.
//! - [`spaces`]: matches policies with environments; [`worker`] and [`fingerprint`]: set-up of the worker process.
//!
//! This is the only crate that links libtorch, which computes networks for `device: cuda` and serves as the oracle of the
//! tests. On the CPU, nothing that enters a result depends on the processor: equal inputs, parameters and seeds give equal
//! bytes on every x86-64 processor with AVX2 and FMA.

pub mod algorithms;
pub mod data;
pub mod fingerprint;
pub mod kernels;
pub mod nn;
pub mod play;
pub mod policy;
pub mod spaces;
#[cfg(test)]
mod test_env;
pub mod training;
pub mod worker;

use dril_stage_api::Kind;

use worker::InWorker;

/// The stage kinds that this crate runs; [`dril_kinds::KINDS`] describes them.
pub const KINDS: [Kind; 9] = [
    Kind::of::<InWorker<algorithms::ppo_stage::PpoStage>>(),
    Kind::of::<InWorker<play::evaluate::EvaluateStage>>(),
    Kind::of::<InWorker<play::collect::CollectStage>>(),
    Kind::of::<InWorker<data::dataset::DatasetStage>>(),
    Kind::of::<InWorker<algorithms::bc::BcStage>>(),
    Kind::of::<InWorker<algorithms::ensemble::EnsembleStage>>(),
    Kind::of::<InWorker<algorithms::dril::DrilStage>>(),
    Kind::of::<InWorker<play::trace::TraceStage>>(),
    Kind::of::<InWorker<play::probe::ProbeStage>>(),
];
