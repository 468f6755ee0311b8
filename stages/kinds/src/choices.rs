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
}

/// The layers of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Network {
    /// For images: convolutions 32-64-32, then 512, shared by actor and critic; orthogonal weights. The annex's experts.
    ExpertCnn,
    /// For images: convolutions 32-64-64 shared by actor (512-512) and critic (512). The thesis's imitators.
    DrilCnn,
    /// For vectors: two layers of 64 tanh units each for actor and critic.
    Mlp,
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
