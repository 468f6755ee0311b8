//! The head of a policy family: from the actor's features to the parameters of a distribution.

use tch::Tensor;

use super::{Distribution, PolicyFamily, oracle};
use crate::net::{Activation, Builder, Init, LayerInit, ParamId, Parameters, Sequential};

/// The layers of a head, each of which gives one parameter of the distribution.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Head {
    Gaussian { mean: Sequential, log_std: ParamId },
    Beta { alpha: Sequential, beta: Sequential },
    Categorical { logits: Sequential },
}

impl Head {
    pub(super) fn build(build: &mut Builder, family: PolicyFamily, features: usize, actions: usize) -> Self {
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

    /// The layers, in the order in which [`Head::distribution`] takes their outputs.
    pub(super) fn layers(&self) -> Vec<&Sequential> {
        match self {
            Self::Gaussian { mean, .. } => vec![mean],
            Self::Beta { alpha, beta } => vec![alpha, beta],
            Self::Categorical { logits } => vec![logits],
        }
    }

    /// The parameter that no layer gives, where there is one.
    pub(super) fn free(&self) -> Option<ParamId> {
        match self {
            Self::Gaussian { log_std, .. } => Some(*log_std),
            Self::Beta { .. } | Self::Categorical { .. } => None,
        }
    }

    /// The distribution from what the layers gave, each [batch, actions].
    pub(super) fn distribution(&self, params: &Parameters, outputs: &[Tensor]) -> Distribution {
        let output = |at: usize| outputs[at].shallow_clone();
        match self {
            Self::Gaussian { log_std, .. } => {
                Distribution::Gaussian { mean: output(0), log_std: params.tensor(*log_std).shallow_clone() }
            }
            Self::Beta { .. } => Distribution::Beta {
                alpha: oracle::beta_shape(&output(0)),
                beta: oracle::beta_shape(&output(1)),
            },
            Self::Categorical { .. } => Distribution::Categorical { logits: output(0) },
        }
    }
}
