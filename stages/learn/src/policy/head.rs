//! The head of a policy family: the layers from the actor's features to the parameters of a distribution.

use dril_kinds::PolicyFamily;

use super::Row;
use crate::nn::trunk::Trunk;
use crate::nn::{Activation, Builder, Init, LayerInit, NodeId, ParamId, Parameters, Sequential};

/// Initialisation of a new policy's head.
#[derive(Clone, Debug, PartialEq)]
pub struct HeadInit {
    /// Gain of the orthogonal initialisation of Gaussian and Beta heads.
    pub gain: f64,
    /// Standard deviation of a Gaussian.
    pub deviation: f64,
    /// Mean action of a Gaussian (bias of the last layer), one number per dimension; empty: zeros.
    pub mean: Vec<f64>,
}

impl Default for HeadInit {
    /// As in the reference code: gain 1, standard deviation 1, mean 0.
    fn default() -> Self {
        Self { gain: 1.0, deviation: 1.0, mean: Vec::new() }
    }
}

/// The outputs of a head; each gives one parameter of the distribution, [rows, actions].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Head {
    Gaussian { mean: NodeId, log_std: ParamId },
    Beta { alpha: NodeId, beta: NodeId },
    Categorical { logits: NodeId },
}

impl Head {
    pub(super) fn build(
        build: &mut Builder,
        family: PolicyFamily,
        trunk: &Trunk,
        actions: usize,
        init: &HeadInit,
    ) -> Self {
        let mut linear = |name: &str, gain: f32| {
            let mut layers = Sequential::default();
            let shape = (trunk.features, actions);
            build.linear(&mut layers, name, shape, LayerInit::Orthogonal(gain), Activation::Linear);
            build.node(Some(trunk.actor), layers)
        };
        let gain = init.gain as f32;
        match family {
            PolicyFamily::Gaussian => {
                let mean = linear("head.mean", gain);
                let log_std = Init::Constant(dril_stage_api::math::ln(init.deviation) as f32);
                Self::Gaussian { mean, log_std: build.param("head.log_std", &[actions], log_std) }
            }
            PolicyFamily::Beta => {
                Self::Beta { alpha: linear("head.alpha", gain), beta: linear("head.beta", gain) }
            }
            // Almost equal probabilities at the start.
            PolicyFamily::Categorical => Self::Categorical { logits: linear("head.logits", 0.01) },
        }
    }

    /// The nodes of the network, in the order of the outputs in [`Head::row`].
    pub(super) fn nodes(&self) -> Vec<NodeId> {
        match self {
            Self::Gaussian { mean, .. } => vec![*mean],
            Self::Beta { alpha, beta } => vec![*alpha, *beta],
            Self::Categorical { logits } => vec![*logits],
        }
    }

    /// The parameter that does not belong to a layer, if there is one.
    pub(super) fn log_std(&self) -> Option<ParamId> {
        match self {
            Self::Gaussian { log_std, .. } => Some(*log_std),
            Self::Beta { .. } | Self::Categorical { .. } => None,
        }
    }

    /// The distribution of one row of outputs, of length `len` each.
    pub(super) fn row<'a>(
        &self,
        params: &'a Parameters,
        outputs: &'a [Vec<f32>],
        (row, len): (usize, usize),
    ) -> Row<'a> {
        let part = |at: usize| &outputs[at][row * len..][..len];
        match self {
            Self::Gaussian { log_std, .. } => {
                Row::Gaussian { mean: part(0), log_std: params.slice(*log_std) }
            }
            Self::Beta { .. } => Row::Beta { u: part(0), w: part(1) },
            Self::Categorical { .. } => Row::Categorical { logits: part(0) },
        }
    }
}
