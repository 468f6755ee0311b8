//! The networks: what they look at, how they are built, and their parameters.
//!
//! - [`Observation`] and [`Network`]: which of the thesis's networks, for which input.
//! - [`Trunk`]: its layers without the policy's head, which the policy family adds.
//! - [`Parameters`]: the weights, as tensors and as one flat buffer; [`weights`]: the same as a file.

mod convolution;
mod init;
mod layers;
pub mod orthogonal;
mod params;
mod pass;
pub mod weights;

use serde::{Deserialize, Serialize};
use tch::Tensor;

pub use dril_kinds::Network;
pub use init::Init;
pub use layers::{Activation, Builder, LayerInit, Sequential};
pub use params::{Gradients, ParamId, ParamSpec, Parameters};
pub use pass::{ByParameter, Pass};

/// What an agent sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Observation {
    /// The last `stack` grey frames, oldest first, black before the episode's first.
    Images {
        /// Rows of a frame, a multiple of 4.
        height: usize,
        /// Columns of a frame, a multiple of 4.
        width: usize,
        /// Frames in a stack.
        stack: usize,
    },
    /// A list of numbers.
    Vector {
        /// How many.
        len: usize,
    },
}

impl Observation {
    /// Frames that are seen at once; 1 for vectors.
    pub fn stack(self) -> usize {
        match self {
            Self::Images { stack, .. } => stack,
            Self::Vector { .. } => 1,
        }
    }
}

/// True where the network takes such input.
pub fn takes(network: Network, observation: Observation) -> bool {
    matches!(observation, Observation::Images { .. }) == (network != Network::Mlp)
}

/// A network without the policy's head: shared layers, then the actor's and the critic's own.
#[derive(Clone, Debug, PartialEq)]
pub struct Trunk {
    shared: Sequential,
    actor: Sequential,
    critic: Sequential,
    /// How many features the actor's last layer gives to the head.
    pub features: usize,
}

impl Trunk {
    /// Describes the layers of `network`.
    pub fn build(build: &mut Builder, network: Network, observation: Observation) -> Self {
        match (network, observation) {
            (Network::ExpertCnn, Observation::Images { height, width, stack }) => {
                expert_cnn(build, (stack, height, width))
            }
            (Network::AtariCnn, Observation::Images { height, width, stack }) => {
                atari_cnn(build, (stack, height, width))
            }
            (_, Observation::Images { height, width, stack }) => dril_cnn(build, (stack, height, width)),
            (_, Observation::Vector { len }) => mlp(build, len),
        }
    }

    /// What the actor's last layer gives, [batch, features], and the state value, [batch], by libtorch; undefined where
    /// it is not wanted.
    pub fn torch_forward(&self, params: &Parameters, input: &Tensor, wants: Wants) -> (Tensor, Tensor) {
        let shared = self.shared.torch_forward(params, input);
        let part = |part: &Sequential, wanted: bool| {
            if wanted { part.torch_forward(params, &shared) } else { Tensor::new() }
        };
        let value = part(&self.critic, wants.critic);
        let value = if wants.critic { value.squeeze_dim(1) } else { value };
        (part(&self.actor, wants.actor), value)
    }

    /// Sends a batch through the shared layers and through those of the parts that are wanted.
    pub fn pass(&self, params: &Parameters, input: &Tensor, wants: Wants) -> TrunkPass {
        let shared = self.shared.pass(params, input);
        let actor = wants.actor.then(|| self.actor.pass(params, shared.output()));
        let critic = wants.critic.then(|| self.critic.pass(params, shared.output()));
        TrunkPass { shared, actor, critic }
    }

    /// Sends the gradients of the actor's features and of the critic's output back, where there are any, and adds those
    /// of the weights to `gradients`. They are dense and used up.
    pub fn back(
        &self,
        params: &Parameters,
        pass: &TrunkPass,
        (features, value): (Option<Tensor>, Option<Tensor>),
        gradients: &mut ByParameter,
    ) {
        let wants = !self.shared.is_empty();
        let mut back = |part: &Sequential, pass: &Option<Pass>, gradient: Option<Tensor>| {
            part.back(params, pass.as_ref()?, gradient?, gradients, wants)
        };
        let from_actor = back(&self.actor, &pass.actor, features);
        let from_critic = back(&self.critic, &pass.critic, value);
        let shared = match (from_actor, from_critic) {
            (Some(actor), Some(critic)) => Some(actor + critic),
            (one, other) => one.or(other),
        };
        if let Some(gradient) = shared {
            self.shared.back(params, &pass.shared, gradient, gradients, false);
        }
    }
}

/// Which parts of a trunk are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wants {
    /// The actor's features.
    pub actor: bool,
    /// The state value.
    pub critic: bool,
}

/// What a batch left behind in a [`Trunk`].
#[derive(Debug)]
pub struct TrunkPass {
    shared: Pass,
    /// Where it was wanted.
    pub actor: Option<Pass>,
    /// Where it was wanted; its output is [batch, 1].
    pub critic: Option<Pass>,
}

fn expert_cnn(build: &mut Builder, image: (usize, usize, usize)) -> Trunk {
    use Activation::{Linear, Relu};
    let init = LayerInit::Orthogonal(std::f32::consts::SQRT_2);
    let (mut shared, pixels) = build.convolutions("conv", image, [32, 64, 32], init);
    build.linear(&mut shared, "shared", (pixels, 512), init, Relu);
    let (mut actor, mut critic) = (Sequential::default(), Sequential::default());
    build.linear(&mut actor, "actor.0", (512, 512), init, Relu);
    // The reference has no activation here, so the head's matrix is a product of two.
    build.linear(&mut actor, "actor.1", (512, 512), init, Linear);
    build.linear(&mut critic, "critic.0", (512, 512), init, Relu);
    build.linear(&mut critic, "critic.1", (512, 1), LayerInit::Orthogonal(1.0), Linear);
    Trunk { shared, actor, critic, features: 512 }
}

fn dril_cnn(build: &mut Builder, image: (usize, usize, usize)) -> Trunk {
    use Activation::{Linear, Relu};
    let init = LayerInit::Default;
    let (shared, pixels) = build.convolutions("conv", image, [32, 64, 64], init);
    let (mut actor, mut critic) = (Sequential::default(), Sequential::default());
    build.linear(&mut actor, "actor.0", (pixels, 512), init, Relu);
    build.linear(&mut actor, "actor.1", (512, 512), init, Relu);
    build.linear(&mut critic, "critic.0", (pixels, 512), init, Relu);
    build.linear(&mut critic, "critic.1", (512, 1), init, Linear);
    Trunk { shared, actor, critic, features: 512 }
}

fn atari_cnn(build: &mut Builder, image: (usize, usize, usize)) -> Trunk {
    use Activation::{Linear, Relu};
    let init = LayerInit::Default;
    let (mut shared, pixels) = build.convolutions("conv", image, [32, 64, 64], init);
    build.linear(&mut shared, "shared", (pixels, 512), init, Relu);
    let mut critic = Sequential::default();
    build.linear(&mut critic, "critic.0", (512, 1), init, Linear);
    Trunk { shared, actor: Sequential::default(), critic, features: 512 }
}

fn mlp(build: &mut Builder, len: usize) -> Trunk {
    use Activation::{Linear, Tanh};
    let init = LayerInit::Orthogonal(std::f32::consts::SQRT_2);
    let (mut actor, mut critic) = (Sequential::default(), Sequential::default());
    build.linear(&mut actor, "actor.0", (len, 64), init, Tanh);
    build.linear(&mut actor, "actor.1", (64, 64), init, Tanh);
    build.linear(&mut critic, "critic.0", (len, 64), init, Tanh);
    build.linear(&mut critic, "critic.1", (64, 64), init, Tanh);
    build.linear(&mut critic, "critic.2", (64, 1), init, Linear);
    Trunk { shared: Sequential::default(), actor, critic, features: 64 }
}
