//! The agent: a network with the head of a policy family, and the distribution over actions that it gives.
//!
//! Two scales are told apart throughout. A *sample* lies in the family's own support (the real line for the Gaussian,
//! the open unit interval for the Beta) and is what log-probabilities are taken of; an *action* lies in the
//! environment's units, where [-1, 1] is the range of every dimension. [`to_action`] maps one to the
//! other; actions are clipped only where they are handed to the environment.

pub mod beta;
pub mod categorical;
mod file;
pub mod gaussian;
mod rows;

use dril_stage_api::{StageError, StreamRng};
use serde::{Deserialize, Serialize};
use tch::Tensor;

use crate::imitation::action_loss;
use crate::net::{Builder, Init, Network, Observation, ParamId, Parameters, Trunk, takes};
use crate::normalize::ObservationStatistics;
use crate::spaces::Actions;

pub use dril_kinds::PolicyFamily;
pub use rows::Rows;

/// The action of a sample, not clipped: the Gaussian's sample itself, 2x − 1 for the Beta, a choice's number.
pub fn to_action(family: PolicyFamily, sample: f32) -> f32 {
    match family {
        PolicyFamily::Gaussian | PolicyFamily::Categorical => sample,
        PolicyFamily::Beta => 2.0 * sample - 1.0,
    }
}

/// The action as an environment takes it: numbers within [-1, 1], or a choice as it is.
pub fn to_environment(family: PolicyFamily, action: f32) -> f32 {
    match family {
        PolicyFamily::Gaussian | PolicyFamily::Beta => action.clamp(-1.0, 1.0),
        PolicyFamily::Categorical => action,
    }
}

/// All that determines the layout of an agent's parameters; stands in the metadata of its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// The layers.
    pub network: Network,
    /// The head.
    pub family: PolicyFamily,
    /// The input.
    pub observation: Observation,
    /// How many action dimensions there are, or choices.
    pub actions: usize,
}

impl Architecture {
    /// What its actions are.
    pub fn gives(&self) -> Actions {
        match self.family {
            PolicyFamily::Gaussian | PolicyFamily::Beta => Actions::Numbers(self.actions),
            PolicyFamily::Categorical => Actions::Choices(self.actions),
        }
    }

    /// How many numbers an action has: one for a choice.
    pub fn action_len(&self) -> usize {
        match self.gives() {
            Actions::Numbers(count) => count,
            Actions::Choices(_) => 1,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Head {
    Gaussian { mean: crate::net::Sequential, log_std: ParamId },
    Beta { alpha: crate::net::Sequential, beta: crate::net::Sequential },
    Categorical { logits: crate::net::Sequential },
}

/// An agent that can act and learn.
#[derive(Debug)]
pub struct Policy {
    architecture: Architecture,
    trunk: Trunk,
    head: Head,
    /// The weights of actor and critic.
    pub params: Parameters,
    /// What observation vectors are scaled by before the network sees them; none where they are shown as they are.
    pub statistics: Option<ObservationStatistics>,
}

/// What a policy says about a batch of observations.
#[derive(Debug)]
pub struct Forward {
    /// The distribution over actions.
    pub distribution: Distribution,
    /// The state values, [batch].
    pub values: Tensor,
}

/// A batch of distributions over actions; every tensor is [batch, actions] or spreads to it.
#[derive(Debug)]
pub enum Distribution {
    /// Independent normal distributions.
    Gaussian {
        /// Means.
        mean: Tensor,
        /// Logarithms of the standard deviations.
        log_std: Tensor,
    },
    /// Independent Beta distributions over [0, 1].
    Beta {
        /// First shape parameters, more than 1.
        alpha: Tensor,
        /// Second shape parameters, more than 1.
        beta: Tensor,
    },
    /// One of several choices.
    Categorical {
        /// Logarithms of the probabilities, up to a constant, [batch, choices].
        logits: Tensor,
    },
}

impl Distribution {
    /// The log-density of samples [batch, actions], summed over dimensions: [batch]. In the sample's own scale: the
    /// Beta's stretch to [-1, 1] is a constant that no ratio sees.
    pub fn log_prob(&self, samples: &Tensor) -> Tensor {
        match self {
            Self::Gaussian { mean, log_std } => gaussian::log_prob(mean, log_std, samples),
            Self::Beta { alpha, beta } => beta::log_prob(alpha, beta, samples),
            Self::Categorical { logits } => categorical::log_prob(logits, samples),
        }
    }

    /// The differential entropy, summed over dimensions: [batch].
    pub fn entropy(&self) -> Tensor {
        match self {
            Self::Gaussian { mean, log_std } => gaussian::entropy(mean, log_std),
            Self::Beta { alpha, beta } => beta::entropy(alpha, beta),
            Self::Categorical { logits } => categorical::entropy(logits),
        }
    }

    /// What behaviour cloning lowers: the mean squared error of the mean action (see [`action_loss`]), or the cross
    /// entropy of the choice; a scalar. `demonstrated` is [batch, numbers in an action].
    pub fn cloning_loss(&self, demonstrated: &Tensor) -> Tensor {
        match self {
            Self::Gaussian { .. } | Self::Beta { .. } => action_loss(&self.mean_action(), demonstrated),
            Self::Categorical { logits } => categorical::cross_entropy(logits, demonstrated),
        }
    }

    /// The mean action [batch, actions], not clipped: what deterministic acting does and behaviour cloning fits. Of
    /// choices the likeliest, [batch, 1].
    pub fn mean_action(&self) -> Tensor {
        match self {
            Self::Gaussian { mean, .. } => mean.shallow_clone(),
            Self::Beta { alpha, beta } => beta::mean(alpha, beta) * 2.0 - 1.0,
            Self::Categorical { logits } => categorical::likeliest(logits),
        }
    }

    /// The parameters as plain numbers, to draw samples from.
    pub fn rows(&self) -> Rows {
        match self {
            Self::Gaussian { mean, log_std } => Rows::gaussian(mean, log_std),
            Self::Beta { alpha, beta } => Rows::beta(alpha, beta),
            Self::Categorical { logits } => Rows::categorical(logits),
        }
    }
}

impl Policy {
    /// A new agent with weights drawn from the stream.
    ///
    /// # Errors
    /// The network does not take such observations, or there is no action.
    pub fn new(architecture: Architecture, stream: &mut StreamRng) -> Result<Self, StageError> {
        Self::build(architecture, Some(stream))
    }

    /// With weights from the stream, or zeros.
    fn build(architecture: Architecture, stream: Option<&mut StreamRng>) -> Result<Self, StageError> {
        check(architecture)?;
        let Architecture { network, family, observation, actions } = architecture;
        let mut build = Builder::new();
        let trunk = Trunk::build(&mut build, network, observation);
        let head = Head::build(&mut build, family, trunk.features, actions);
        let params = match stream {
            Some(stream) => build.finish(stream),
            None => build.finish_blank(),
        };
        Ok(Self { architecture, trunk, head, params, statistics: None })
    }

    /// What determines the layout of its parameters.
    pub fn architecture(&self) -> Architecture {
        self.architecture
    }

    /// The distribution and the value for a batch of observations (see [`crate::frames::FrameStore::gather`]).
    pub fn forward(&self, observations: &Tensor) -> Forward {
        let (features, values) = self.trunk.both(&self.params, observations);
        Forward { distribution: self.head.forward(&self.params, &features), values }
    }

    /// The distribution only.
    pub fn distribution(&self, observations: &Tensor) -> Distribution {
        self.head.forward(&self.params, &self.trunk.actor(&self.params, observations))
    }

    /// The state values only, [batch].
    pub fn values(&self, observations: &Tensor) -> Tensor {
        self.trunk.critic(&self.params, observations)
    }

    /// The parameters that the mean action depends on or may: all but the critic's own.
    pub fn actor_ids(&self) -> Vec<ParamId> {
        self.params.ids().filter(|id| !self.params.spec(*id).name.starts_with("critic.")).collect()
    }
}

fn check(architecture: Architecture) -> Result<(), StageError> {
    let Architecture { network, observation, actions, .. } = architecture;
    if !takes(network, observation) {
        let (seen, mend) = match observation {
            Observation::Images { .. } => ("images", "`expert-cnn`, `dril-cnn` or `atari-cnn`"),
            Observation::Vector { .. } => ("a vector", "`mlp`"),
        };
        let message = format!(
            "the network `{}` does not fit an environment that shows {seen}; set `network` to {mend}",
            name(network)
        );
        return Err(StageError::failed(message));
    }
    if let Observation::Images { height, width, stack } = observation
        && (height < 36 || width < 36 || height % 4 != 0 || width % 4 != 0 || stack == 0)
    {
        return Err(StageError::failed(format!(
            "frames are {height}x{width} in stacks of {stack}, expected multiples of 4 from 36 on and a stack"
        )));
    }
    if actions == 0 {
        return Err(StageError::failed("the environment has no action dimension, expected at least one"));
    }
    Ok(())
}

fn name(network: Network) -> &'static str {
    match network {
        Network::ExpertCnn => "expert-cnn",
        Network::DrilCnn => "dril-cnn",
        Network::AtariCnn => "atari-cnn",
        Network::Mlp => "mlp",
    }
}

impl Head {
    fn build(build: &mut Builder, family: PolicyFamily, features: usize, actions: usize) -> Self {
        use crate::net::{Activation, LayerInit, Sequential};
        let mut linear = |name: &str, gain: f32| {
            let mut layers = Sequential::default();
            let init = LayerInit::Orthogonal(gain);
            build.linear(&mut layers, name, (features, actions), init, Activation::Linear);
            layers
        };
        match family {
            PolicyFamily::Gaussian => {
                let mean = linear("head.mean", 1.0);
                Self::Gaussian {
                    mean,
                    log_std: build.param("head.log_std", &[actions as i64], Init::Constant(0.0)),
                }
            }
            PolicyFamily::Beta => {
                Self::Beta { alpha: linear("head.alpha", 1.0), beta: linear("head.beta", 1.0) }
            }
            // Almost equal probabilities at the start.
            PolicyFamily::Categorical => Self::Categorical { logits: linear("head.logits", 0.01) },
        }
    }

    fn forward(&self, params: &Parameters, features: &Tensor) -> Distribution {
        match self {
            Self::Gaussian { mean, log_std } => Distribution::Gaussian {
                mean: mean.forward(params, features),
                log_std: params.tensor(*log_std).shallow_clone(),
            },
            Self::Beta { alpha, beta } => Distribution::Beta {
                alpha: beta::shape(&alpha.forward(params, features)),
                beta: beta::shape(&beta.forward(params, features)),
            },
            Self::Categorical { logits } => {
                Distribution::Categorical { logits: logits.forward(params, features) }
            }
        }
    }
}

#[cfg(test)]
mod tests;
