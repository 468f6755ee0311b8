//! The learning stages: PPO, behaviour cloning, the ensemble, DRIL, collecting and evaluating.
//!
//! Where things are:
//!
//! - [`net`]: networks and their weights; [`policy`]: agents, Gaussian or Beta; [`frames`]: what they saw;
//!   [`optim`]: Adam; [`fast`]: every trick for speed, with its reason and gain.
//! - [`act`]: acting, and playing lists of episodes; [`rollout`]: gathering experience, advantages;
//!   [`update`]: the loss of proximal policy optimisation; [`loss`]: the same without libtorch; [`learner`]: the state of a training.
//! - [`ppo`], [`bc`], [`ensemble`], [`dril`]: one file for each algorithm, with settings and loop;
//!   [`disagreement`]: the cost that DRIL learns from.
//! - [`imitation`]: what cloning and the ensemble share; [`pairs`]: demonstrations as they learn from them;
//!   [`split`]: which pairs train, validate, and in which order.
//! - [`collect`], [`dataset`], [`evaluate`]: what stands between them.
//! - [`replay`]: an episode as a film.
//! - [`normalize`]: running statistics that observations and rewards are scaled by.
//! - [`checkpoint`], [`log`]: what a long training keeps and writes; [`spaces`]: from environments to networks;
//!   [`tensorboard`]: the same for people who watch; [`made_with`]: what else a result depends on.
//!
//! This is the only crate that links libtorch. Randomness comes from the stage's streams alone, and torch computes on
//! one thread ([`fast::prepare`]), so equal inputs, parameters and seeds give equal bytes.

pub mod act;
pub mod bc;
pub mod checkpoint;
pub mod collect;
pub mod dataset;
pub mod disagreement;
pub mod dril;
pub mod ensemble;
pub mod evaluate;
pub mod fast;
pub mod frames;
pub mod imitation;
pub mod learner;
pub mod log;
pub mod loss;
pub mod made_with;
pub mod net;
pub mod normalize;
pub mod optim;
pub mod pairs;
pub mod policy;
pub mod ppo;
pub mod replay;
pub mod rollout;
pub mod spaces;
pub mod split;
pub mod tensorboard;
#[cfg(test)]
mod test_env;
pub mod update;

use dril_stage_api::Kind;

/// The stage kinds of this crate, as [`dril_kinds::KINDS`] describes them.
pub const KINDS: [Kind; 7] = [
    Kind::of::<ppo::PpoStage>(),
    Kind::of::<evaluate::EvaluateStage>(),
    Kind::of::<collect::CollectStage>(),
    Kind::of::<dataset::DatasetStage>(),
    Kind::of::<bc::BcStage>(),
    Kind::of::<ensemble::EnsembleStage>(),
    Kind::of::<dril::DrilStage>(),
];
