//! The learning stages: PPO, behaviour cloning, the ensemble, DRIL, collecting and evaluating.
//!
//! Where things are:
//!
//! - [`algorithms`]: one file for each algorithm; [`training`]: rollouts, statistics, logs and checkpoints around them;
//!   [`data`]: demonstrations and frames; [`play`]: acting, and the stages that only act.
//! - [`policy`]: agents, Gaussian, Beta or categorical; [`nn`]: networks with their two backends; [`kernels`]: the inner
//!   loops of the native one.
//! - [`spaces`]: from environments to networks; [`worker`] and [`fingerprint`]: what every stage does first.
//!
//! This is the only crate that links libtorch, which computes networks where `device: cuda` asks for it and is the oracle
//! of the tests. Without it nothing that enters a result depends on the processor: equal inputs, parameters and seeds
//! give equal bytes on every x86-64 processor with AVX2 and FMA.

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

use worker::Prepared;

/// The stage kinds of this crate, as [`dril_kinds::KINDS`] describes them.
pub const KINDS: [Kind; 9] = [
    Kind::of::<Prepared<algorithms::ppo_stage::PpoStage>>(),
    Kind::of::<Prepared<play::evaluate::EvaluateStage>>(),
    Kind::of::<Prepared<play::collect::CollectStage>>(),
    Kind::of::<Prepared<data::dataset::DatasetStage>>(),
    Kind::of::<Prepared<algorithms::bc::BcStage>>(),
    Kind::of::<Prepared<algorithms::ensemble::EnsembleStage>>(),
    Kind::of::<Prepared<algorithms::dril::DrilStage>>(),
    Kind::of::<Prepared<play::trace::TraceStage>>(),
    Kind::of::<Prepared<play::probe::ProbeStage>>(),
];
