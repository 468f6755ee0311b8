//! The agent: a network with the head of a policy family, and the distribution over actions that it gives.
//!
//! Two scales are told apart throughout. A *sample* lies in the family's own support (the real line for the Gaussian,
//! the open unit interval for the Beta) and is what log-probabilities are taken of; an *action* lies in the
//! environment's units, where [-1, 1] is the range of every dimension. [`to_action`] maps one to the
//! other; actions are clipped only where they are handed to the environment.

mod beta;
mod categorical;
pub mod distribution;
mod file;
mod gaussian;
mod head;
pub mod oracle;
mod rows;
mod way;

use dril_kinds::Precision;
use dril_stage_api::{StageError, StreamRng};
use serde::{Deserialize, Serialize};
use tch::Tensor;

use crate::imitation::action_loss;
use crate::net::{Builder, Gradients, Network, Observation, ParamId, Parameters, Trunk, Wants, takes};
use crate::normalize::ObservationStatistics;
use crate::spaces::Actions;

use head::Head;
use way::{Way, column};

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
    way: Way,
}

impl Forward {
    /// The gradients of a scalar that was made of this answer, for the parameters asked for, in that order.
    pub fn gradients(self, policy: &Policy, loss: &Tensor, ids: &[ParamId]) -> Gradients {
        policy.gradients(self.way, loss, ids)
    }
}

/// The actor's part of it.
#[derive(Debug)]
pub struct Answer {
    /// The distribution over actions.
    pub distribution: Distribution,
    way: Way,
}

impl Answer {
    /// As [`Forward::gradients`].
    pub fn gradients(self, policy: &Policy, loss: &Tensor, ids: &[ParamId]) -> Gradients {
        policy.gradients(self.way, loss, ids)
    }
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
            Self::Gaussian { mean, log_std } => oracle::gaussian_log_prob(mean, log_std, samples),
            Self::Beta { alpha, beta } => oracle::beta_log_prob(alpha, beta, samples),
            Self::Categorical { logits } => oracle::categorical_log_prob(logits, samples),
        }
    }

    /// The differential entropy, summed over dimensions: [batch].
    pub fn entropy(&self) -> Tensor {
        match self {
            Self::Gaussian { mean, log_std } => oracle::gaussian_entropy(mean, log_std),
            Self::Beta { alpha, beta } => oracle::beta_entropy(alpha, beta),
            Self::Categorical { logits } => oracle::categorical_entropy(logits),
        }
    }

    /// What behaviour cloning lowers: the mean squared error of the mean action (see [`action_loss`]), or the cross
    /// entropy of the choice; a scalar. `demonstrated` is [batch, numbers in an action].
    pub fn cloning_loss(&self, demonstrated: &Tensor) -> Tensor {
        match self {
            Self::Gaussian { .. } | Self::Beta { .. } => action_loss(&self.mean_action(), demonstrated),
            Self::Categorical { logits } => oracle::categorical_cross_entropy(logits, demonstrated),
        }
    }

    /// The mean action [batch, actions], not clipped: what deterministic acting does and behaviour cloning fits. Of
    /// choices the likeliest, [batch, 1].
    pub fn mean_action(&self) -> Tensor {
        match self {
            Self::Gaussian { mean, .. } => mean.shallow_clone(),
            Self::Beta { alpha, beta } => oracle::beta_mean(alpha, beta) * 2.0 - 1.0,
            Self::Categorical { logits } => oracle::categorical_likeliest(logits),
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
        let (distribution, values, way) = self.answer(observations, Wants { actor: true, critic: true });
        Forward { distribution, values, way }
    }

    /// The distribution only.
    pub fn act(&self, observations: &Tensor) -> Answer {
        let (distribution, _, way) = self.answer(observations, Wants { actor: true, critic: false });
        Answer { distribution, way }
    }

    /// The state values only, [batch].
    pub fn values(&self, observations: &Tensor) -> Tensor {
        let wants = Wants { actor: false, critic: true };
        match self.params.precision() {
            Precision::Fp32 => column(self.trunk.pass(&self.params, observations, wants).critic.as_ref()),
            Precision::Bf16 => self.trunk.torch_forward(&self.params, observations, wants).1,
        }
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

#[cfg(test)]
mod tests;
