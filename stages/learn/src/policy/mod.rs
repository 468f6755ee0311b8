//! Policies: a network with the head of a policy family, and its action distribution.
//!
//! Samples and actions are distinguished throughout. A *sample* lies in the support of the distribution (the real line
//! for the Gaussian, the open unit interval for the Beta), and log-probabilities refer to it. An *action* is in the
//! environment's units, where [-1, 1] is the range of every dimension. [`to_action`] converts a sample to an action;
//! actions are clipped only when they are passed to the environment.

mod beta;
mod categorical;
mod distribution;
mod family;
pub(crate) mod file;
mod gaussian;
mod gradients;
mod head;
#[cfg(test)]
mod oracle;
#[cfg(test)]
mod tests;
mod weights;

use dril_envs::{ActionSpace, ObservationSpace};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::{StageError, StreamRng};

use crate::nn::trunk::{Trunk, takes};
use crate::nn::{self, Batch, Builder, Gradients, NodeId, ParamId, Parameters, Tape, Wanted};
use crate::training::normalize::ObservationStatistics;

pub use family::check_family;
use head::Head;

pub use distribution::{Row, RowGradient};
pub use gradients::OutputGradients;
pub use head::HeadInit;
pub use weights::Weights;

/// The action of a sample, not clipped: the sample itself for Gaussian and categorical, 2x − 1 for Beta.
pub fn to_action(family: PolicyFamily, sample: f32) -> f32 {
    match family {
        PolicyFamily::Gaussian | PolicyFamily::Categorical => sample,
        PolicyFamily::Beta => 2.0 * sample - 1.0,
    }
}

/// The action as the environment uses it: continuous actions clipped to [-1, 1], discrete ones unchanged.
pub fn to_environment(family: PolicyFamily, action: f32) -> f32 {
    match family {
        PolicyFamily::Gaussian | PolicyFamily::Beta => action.clamp(-1.0, 1.0),
        PolicyFamily::Categorical => action,
    }
}

/// The architecture of a policy; determines the layout of its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Architecture {
    /// The network.
    pub network: Network,
    /// The policy family.
    pub family: PolicyFamily,
    /// Observation space.
    pub observation: ObservationSpace,
    /// Action space.
    pub actions: ActionSpace,
}

impl Architecture {
    /// Values per action; 1 for discrete actions.
    pub fn action_len(&self) -> usize {
        self.actions.action_len()
    }
}

/// A policy with its value function (actor and critic).
#[derive(Debug)]
pub struct Policy {
    architecture: Architecture,
    network: nn::Network,
    head: Head,
    critic: NodeId,
    /// Statistics that normalise vector observations; none if they are not normalised.
    pub statistics: Option<ObservationStatistics>,
    /// The environment step at which its training diverged; none otherwise.
    pub diverged_at_step: Option<u64>,
}

/// Which outputs are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// The distribution over actions.
    Actor,
    /// The state value.
    Critic,
    /// Both.
    Both,
}

/// The outputs of a policy for a batch of observations.
#[derive(Clone, Debug, PartialEq)]
pub struct Answers {
    /// Outputs of the head, each [rows, outputs]; empty if the actor was not computed.
    heads: Vec<Vec<f32>>,
    /// State values, [rows]; empty if the critic was not computed.
    pub values: Vec<f32>,
}

impl Policy {
    /// A new policy with weights drawn from the stream, initialised as in the reference code.
    ///
    /// # Errors
    /// The network or the family does not match the spaces, or there is no action dimension.
    pub fn new(architecture: Architecture, stream: &mut StreamRng) -> Result<Self, StageError> {
        Self::with_head(architecture, &HeadInit::default(), stream)
    }

    /// As [`Policy::new`], with another initialisation of the head.
    ///
    /// # Errors
    /// As [`Policy::new`], or `init` has another number of dimensions.
    pub fn with_head(
        architecture: Architecture,
        init: &HeadInit,
        stream: &mut StreamRng,
    ) -> Result<Self, StageError> {
        let mut policy = Self::build(architecture, init, Some(stream))?;
        if !init.mean.is_empty() {
            policy.set_mean_bias(&init.mean)?;
        }
        Ok(policy)
    }

    /// With zero weights, to be replaced by those of a file.
    fn blank(architecture: Architecture) -> Result<Self, StageError> {
        Self::build(architecture, &HeadInit::default(), None)
    }

    fn build(
        architecture: Architecture,
        init: &HeadInit,
        stream: Option<&mut StreamRng>,
    ) -> Result<Self, StageError> {
        check(architecture)?;
        let Architecture { network, family, observation, actions } = architecture;
        let mut build = Builder::new();
        let trunk = Trunk::build(&mut build, network, observation);
        let head = Head::build(&mut build, family, &trunk, actions.outputs(), init);
        let network = nn::Network::new(build.finish(stream));
        let critic = trunk.critic;
        Ok(Self { architecture, network, head, critic, statistics: None, diverged_at_step: None })
    }

    fn set_mean_bias(&mut self, mean: &[f64]) -> Result<(), StageError> {
        let dims = self.architecture.actions.outputs();
        if mean.len() != dims {
            let seen = mean.len();
            return Err(StageError::failed(format!(
                "`initial_mean` has {seen} numbers, expected {dims}, one for each dimension of an action"
            )));
        }
        let bias = |id: &ParamId| self.params().spec(*id).name == "head.mean.bias";
        if let Some(id) = self.params().ids().find(bias) {
            let bias = self.params_mut().slice_mut(id);
            bias.iter_mut().zip(mean).for_each(|(bias, mean)| *bias = *mean as f32);
        }
        Ok(())
    }

    /// The architecture.
    pub fn architecture(&self) -> Architecture {
        self.architecture
    }

    /// The weights of actor and critic.
    pub fn params(&self) -> &Parameters {
        &self.network.params
    }

    /// The weights, mutable.
    pub fn params_mut(&mut self) -> &mut Parameters {
        &mut self.network.params
    }

    /// The network.
    pub fn network_mut(&mut self) -> &mut nn::Network {
        &mut self.network
    }

    fn wanted(&self, parts: Parts, rows: usize) -> Vec<Wanted> {
        let heads = self.head.nodes().into_iter().filter(|_| parts != Parts::Critic);
        let critic = (parts != Parts::Actor).then_some(self.critic);
        heads.chain(critic).map(|node| Wanted { node, rows: 0..rows }).collect()
    }

    fn answers(&self, parts: Parts, mut outputs: Vec<Vec<f32>>) -> Answers {
        let values = if parts == Parts::Actor { None } else { outputs.pop() };
        Answers { heads: outputs, values: values.unwrap_or_default() }
    }

    /// The outputs for a batch of observations (see [`crate::data::frames::FrameStore::gather`]), with the tape for the
    /// backward pass.
    pub fn forward(&self, observations: &Batch, parts: Parts) -> (Answers, Tape) {
        let wanted = self.wanted(parts, observations.rows());
        let (outputs, tape) = self.network.forward(observations, &wanted);
        (self.answers(parts, outputs), tape)
    }

    /// The outputs only.
    pub fn infer(&self, observations: &Batch, parts: Parts) -> Answers {
        let wanted = self.wanted(parts, observations.rows());
        self.answers(parts, self.network.infer(observations, &wanted))
    }

    /// The state values only, [rows].
    pub fn values(&self, observations: &Batch) -> Vec<f32> {
        self.infer(observations, Parts::Critic).values
    }

    /// The action distribution of one row of outputs that include the actor's.
    pub fn row<'a>(&'a self, answers: &'a Answers, row: usize) -> Row<'a> {
        self.head.row(self.params(), &answers.heads, (row, self.architecture.actions.outputs()))
    }

    /// Writes the gradients of the parameters, given those of the outputs for the same batch.
    pub fn backward(
        &self,
        observations: &Batch,
        tape: Tape,
        by_output: OutputGradients,
        gradients: &mut Gradients,
    ) {
        let rows = observations.rows();
        let wanted = |node: NodeId| Wanted { node, rows: 0..rows };
        let mut arrived: Vec<(Wanted, Vec<f32>)> =
            self.head.nodes().into_iter().map(wanted).zip(by_output.heads).collect();
        if let Some(values) = by_output.values {
            arrived.push((wanted(self.critic), values));
        }
        if let (Some(id), Some(sums)) = (self.head.log_std(), by_output.log_std) {
            gradients.set(id).iter_mut().zip(sums).for_each(|(to, sum)| *to = sum as f32);
        }
        self.network.backward(observations, tape, arrived, gradients);
    }

    /// All parameters except the critic's own: those that the mean action may depend on.
    pub fn actor_ids(&self) -> Vec<ParamId> {
        let params = self.params();
        params.ids().filter(|id| !params.spec(*id).name.starts_with("critic.")).collect()
    }
}

fn check(architecture: Architecture) -> Result<(), StageError> {
    let Architecture { network, family, observation, actions } = architecture;
    if !takes(network, observation) {
        let (seen, remedy) = match observation {
            ObservationSpace::Image { .. } => ("images", "`expert-cnn`, `dril-cnn` or `atari-cnn`"),
            ObservationSpace::Vector { .. } => ("a vector", "`mlp`"),
        };
        let message = format!(
            "the network `{}` does not match the environment's observations ({seen}); set `network` to {remedy}",
            name(network)
        );
        return Err(StageError::failed(message));
    }
    check_frames(observation)?;
    check_family(actions, family)?;
    if actions.outputs() == 0 {
        return Err(StageError::failed("the environment has no action dimension, expected at least one"));
    }
    Ok(())
}

/// Checks that the convolutions support the size of the frames.
pub(crate) fn check_frames(observation: ObservationSpace) -> Result<(), StageError> {
    match observation {
        ObservationSpace::Image { height, width, stack }
            if height < 36 || width < 36 || height % 4 != 0 || width % 4 != 0 || stack == 0 =>
        {
            Err(StageError::failed(format!(
                "frames are {height}x{width} in stacks of {stack}, expected sides of at least 36 that are multiples of 4, and a \
                 stack of at least 1"
            )))
        }
        _ => Ok(()),
    }
}

fn name(network: Network) -> &'static str {
    match network {
        Network::ExpertCnn => "expert-cnn",
        Network::DrilCnn => "dril-cnn",
        Network::AtariCnn => "atari-cnn",
        Network::Mlp => "mlp",
    }
}
