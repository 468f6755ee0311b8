//! How a policy came to an answer, and the way back from a loss to the gradients of its weights.

use dril_kinds::Precision;
use tch::Tensor;

use super::{Distribution, Policy};
use crate::net::{ByParameter, Gradients, ParamId, Pass, TrunkPass, Wants};

/// What an answer was computed with.
#[derive(Debug)]
pub(super) enum Way {
    /// libtorch's graph reaches down to the weights.
    Torch,
    /// Kernels of our own; libtorch's graph begins at their outputs.
    Own(Box<Passes>),
}

#[derive(Debug)]
pub(super) struct Passes {
    trunk: TrunkPass,
    heads: Vec<Pass>,
    /// The outputs of the heads as leaves of libtorch's graph.
    leaves: Vec<Tensor>,
    /// The same of the critic, [batch], where it was wanted.
    values: Option<Tensor>,
}

/// The output of a critic as [batch].
pub(super) fn column(pass: Option<&Pass>) -> Tensor {
    pass.map_or_else(Tensor::new, |pass| pass.output().squeeze_dim(1))
}

/// The beginning of a graph.
fn leaf(output: &Tensor) -> Tensor {
    output.detach().set_requires_grad(true)
}

impl Policy {
    /// The distribution and the values (undefined where they are not wanted), with the way there.
    pub(super) fn answer(&self, observations: &Tensor, wants: Wants) -> (Distribution, Tensor, Way) {
        let params = &self.params;
        if params.precision() == Precision::Bf16 {
            let (features, values) = self.trunk.torch_forward(params, observations, wants);
            let layers = self.head.layers();
            let outputs: Vec<Tensor> =
                layers.iter().map(|layers| layers.torch_forward(params, &features)).collect();
            return (self.head.distribution(params, &outputs), values, Way::Torch);
        }
        let trunk = self.trunk.pass(params, observations, wants);
        let features = trunk.actor.as_ref().map(Pass::output);
        let heads = self.head.layers().into_iter().zip(features.into_iter().cycle());
        let heads: Vec<Pass> = heads.map(|(layers, features)| layers.pass(params, features)).collect();
        let leaves: Vec<Tensor> = heads.iter().map(|pass| leaf(pass.output())).collect();
        let values = wants.critic.then(|| leaf(&column(trunk.critic.as_ref())));
        let shown = values.as_ref().map_or_else(Tensor::new, Tensor::shallow_clone);
        let distribution = self.head.distribution(params, &leaves);
        (distribution, shown, Way::Own(Box::new(Passes { trunk, heads, leaves, values })))
    }

    /// The gradients of a scalar that was made of an answer.
    pub(super) fn gradients(&self, way: Way, loss: &Tensor, ids: &[ParamId]) -> Gradients {
        let passes = match way {
            Way::Torch => return self.params.torch_gradients(loss, ids),
            Way::Own(passes) => *passes,
        };
        let params = &self.params;
        let mut inputs: Vec<&Tensor> = passes.leaves.iter().collect();
        inputs.extend(&passes.values);
        let free = self.head.free();
        inputs.extend(free.map(|id| params.tensor(id)));
        let mut arrived = Tensor::run_backward(&[loss], &inputs, false, false)
            .into_iter()
            // Copied, since the way back writes to them.
            .map(|gradient| gradient.defined().then(|| gradient.contiguous().copy()));
        let mut gradients = ByParameter::new(params);
        let mut features: Option<Tensor> = None;
        for (layers, pass) in self.head.layers().into_iter().zip(&passes.heads) {
            let Some(gradient) = arrived.next().flatten() else { continue };
            let back = layers.back(params, pass, gradient, &mut gradients, true);
            features = match (features, back) {
                (Some(sum), Some(back)) => Some(sum + back),
                (one, other) => one.or(other),
            };
        }
        let values = passes.values.as_ref().and_then(|_| arrived.next().flatten());
        if let (Some(id), Some(gradient)) = (free, arrived.next().flatten()) {
            gradients.add(id, gradient);
        }
        let values = values.map(|gradient| gradient.unsqueeze(1).contiguous());
        self.trunk.back(params, &passes.trunk, (features, values), &mut gradients);
        gradients.pick(ids)
    }
}
