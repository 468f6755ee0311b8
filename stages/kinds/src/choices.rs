//! Enumerations that several kinds share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Action distribution of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyFamily {
    /// Diagonal Gaussian: the network outputs the mean; the log standard deviation of each dimension is a learnt parameter
    /// that does not depend on the state.
    Gaussian,
    /// Independent Beta distributions with α, β > 1, rescaled from [0, 1] to [-1, 1] (Petrazzini & Antonelo 2021).
    Beta,
    /// Categorical distribution. For environments with discrete actions, and only those.
    Categorical,
}

/// Network architecture of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Network {
    /// For images: convolutions 32-64-32 and a layer of 512, shared by actor and critic; orthogonal initialisation. The
    /// experts of the thesis's annex.
    ExpertCnn,
    /// For images: convolutions 32-64-64, shared by an actor (512-512) and a critic (512). The thesis's imitators.
    DrilCnn,
    /// For images: convolutions 32-64-64 and a layer of 512, shared by actor and critic. The original DRIL's policies for
    /// Atari games.
    AtariCnn,
    /// For vectors: two hidden layers of 64 tanh units, separate for actor and critic.
    Mlp,
}

/// Algorithm that updates the policy from a rollout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// Proximal policy optimisation (Schulman et al. 2017): several epochs of minibatches, with Adam.
    #[default]
    Ppo,
    /// Advantage actor-critic (Mnih et al. 2016): one gradient step on the whole rollout, with RMSprop (decay 0.99).
    /// `n_epochs`, `n_minibatches` and `clip_range` are ignored.
    A2c,
}

/// How a policy chooses its actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// The mean of the distribution (also for Beta: the mean, not the mode).
    Deterministic,
    /// A sample from the distribution.
    Stochastic,
}

/// Device that computes the networks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// CPU: the same bits on every x86-64 processor with AVX2 and FMA.
    #[default]
    Cpu,
    /// The first CUDA device, by a libtorch built with CUDA. Its bits depend on the GPU and on the versions of CUDA and
    /// libtorch.
    Cuda,
}

/// What happens when an update diverges, that is, when a loss, a gradient or a weight is no longer finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnDivergence {
    /// Training stops there with the last finite weights, and the pipeline continues. The training log, the policy file,
    /// its scores and the tables made of them mark it as diverged.
    KeepLastFinite,
    /// The stage fails.
    Error,
}
