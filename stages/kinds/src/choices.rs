//! Choices that several kinds share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which distribution an agent's actions follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyFamily {
    /// Independent normal distributions: the mean comes from the network, the logarithm of the standard deviation is a
    /// free parameter for each dimension.
    Gaussian,
    /// Independent Beta distributions with α, β > 1, stretched from [0, 1] to [-1, 1] (Petrazzini & Antonelo 2021).
    Beta,
    /// One of several choices, each with a probability of its own: for environments that take choices, and only those.
    Categorical,
}

/// The layers of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Network {
    /// For images: convolutions 32-64-32, then 512, shared by actor and critic; orthogonal weights. The annex's experts.
    ExpertCnn,
    /// For images: convolutions 32-64-64 shared by actor (512-512) and critic (512). The thesis's imitators.
    DrilCnn,
    /// For images: convolutions 32-64-64 and one layer of 512, all shared by actor and critic. The original DRIL's agents
    /// for Atari games.
    AtariCnn,
    /// For vectors: two layers of 64 tanh units each for actor and critic.
    Mlp,
}

/// How an agent learns from a rollout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// Proximal policy optimisation: several passes in minibatches, by Adam.
    #[default]
    Ppo,
    /// Advantage actor-critic (Mnih et al. 2016): one step on the whole rollout, by RMSprop with a decay of 0.99.
    /// `n_epochs`, `n_minibatches` and `clip_range` are not used.
    A2c,
}

/// How an agent acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// The mean of the distribution (for the Beta too: the mean, not the mode).
    Deterministic,
    /// A draw from the distribution.
    Stochastic,
}

/// Where networks are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// On the processor: the same bits on every x86-64 processor with AVX2 and FMA.
    #[default]
    Cpu,
    /// On the first CUDA device, through a libtorch that was built with CUDA. Its bits depend on the device and on the
    /// versions of CUDA and libtorch.
    Cuda,
}

/// What happens when an update diverges: when a loss, a gradient or a weight is no longer a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnDivergence {
    /// Training ends there with the last finite weights, and the pipeline goes on. The log, the agents' files, their
    /// scores and the tables made of them say so.
    KeepLastFinite,
    /// The stage fails.
    Error,
}
