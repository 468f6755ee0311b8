//! The thesis's networks, without the head that the policy family adds.

use dril_envs::ObservationSpace;
use dril_kinds::Network;

use super::{Activation, Builder, LayerInit, NodeId, Sequential};

/// The nodes of a policy's network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trunk {
    /// The node with the actor's features.
    pub actor: NodeId,
    /// The node with the state value, [rows, 1].
    pub critic: NodeId,
    /// Number of features of the actor.
    pub features: usize,
}

/// True if the network supports these observations.
pub fn takes(network: Network, observation: ObservationSpace) -> bool {
    matches!(observation, ObservationSpace::Image { .. }) == (network != Network::Mlp)
}

impl Trunk {
    /// Adds the layers of `network` to the builder.
    pub fn build(build: &mut Builder, network: Network, observation: ObservationSpace) -> Self {
        match (network, observation) {
            (Network::ExpertCnn, ObservationSpace::Image { height, width, stack }) => {
                expert_cnn(build, (stack, height, width))
            }
            (Network::AtariCnn, ObservationSpace::Image { height, width, stack }) => {
                atari_cnn(build, (stack, height, width))
            }
            (_, ObservationSpace::Image { height, width, stack }) => dril_cnn(build, (stack, height, width)),
            (_, ObservationSpace::Vector { len }) => mlp(build, len),
        }
    }
}

fn expert_cnn(build: &mut Builder, image: (usize, usize, usize)) -> Trunk {
    use Activation::{Linear, Relu};
    let init = LayerInit::Orthogonal(std::f32::consts::SQRT_2);
    // The reference's initialiser is defined again, with gain 1, between the shared layers and these.
    let head = LayerInit::Orthogonal(1.0);
    let (mut shared, pixels) = build.convolutions("conv", image, [32, 64, 32], init);
    build.linear(&mut shared, "shared", (pixels, 512), init, Relu);
    let (mut actor, mut critic) = (Sequential::default(), Sequential::default());
    build.linear(&mut actor, "actor.0", (512, 512), head, Relu);
    // The reference has no activation here, so the head's matrix is a product of two.
    build.linear(&mut actor, "actor.1", (512, 512), head, Linear);
    build.linear(&mut critic, "critic.0", (512, 512), head, Relu);
    build.linear(&mut critic, "critic.1", (512, 1), head, Linear);
    let shared = build.node(None, shared);
    let actor = build.node(Some(shared), actor);
    let critic = build.node(Some(shared), critic);
    Trunk { actor, critic, features: 512 }
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
    let shared = build.node(None, shared);
    let actor = build.node(Some(shared), actor);
    let critic = build.node(Some(shared), critic);
    Trunk { actor, critic, features: 512 }
}

fn atari_cnn(build: &mut Builder, image: (usize, usize, usize)) -> Trunk {
    use Activation::{Linear, Relu};
    let init = LayerInit::Default;
    let (mut shared, pixels) = build.convolutions("conv", image, [32, 64, 64], init);
    build.linear(&mut shared, "shared", (pixels, 512), init, Relu);
    let mut critic = Sequential::default();
    build.linear(&mut critic, "critic.0", (512, 1), init, Linear);
    let shared = build.node(None, shared);
    let critic = build.node(Some(shared), critic);
    Trunk { actor: shared, critic, features: 512 }
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
    let actor = build.node(None, actor);
    let critic = build.node(None, critic);
    Trunk { actor, critic, features: 64 }
}
