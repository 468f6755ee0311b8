//! Adam (Kingma & Ba 2015) and RMSprop (Tieleman & Hinton 2012) over the flat parameters of a network.

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::{Gradients, ParamId, Parameters};
use crate::kernels::{Buffer, optimizer};
use crate::training::checkpoint::Arrays;

/// Hyperparameters of an optimizer; by default PyTorch's for Adam.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OptimizerSettings {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the denominator.
    pub epsilon: f64,
    /// True to correct the moments' bias towards 0 in the first steps.
    pub correct_bias: bool,
}

impl Default for OptimizerSettings {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, correct_bias: true }
    }
}

impl OptimizerSettings {
    /// RMSprop as in PyTorch: Adam without first moment and without bias correction.
    pub fn rmsprop(decay: f64, epsilon: f64) -> Self {
        Self { beta1: 0.0, beta2: decay, epsilon, correct_bias: false }
    }
}

/// The optimizer's state for some of the parameters of a network. Two losses on one network use two optimizers.
#[derive(Debug)]
pub struct Optimizer {
    settings: OptimizerSettings,
    ids: Vec<ParamId>,
    /// First moments, one parameter after the other in the order of `ids`.
    m: Buffer,
    /// Second moments.
    v: Buffer,
    steps: u64,
    /// β₁ and β₂ to the power of `steps`, by repeated multiplication: the bits of `powi` depend on the compiler.
    powers: [f64; 2],
}

impl Optimizer {
    /// An optimizer for the parameters `ids`, before its first step.
    pub fn new(params: &Parameters, ids: Vec<ParamId>, settings: OptimizerSettings) -> Self {
        let count = ids.iter().map(|id| params.slice(*id).len()).sum();
        Self { settings, ids, m: Buffer::zeros(count), v: Buffer::zeros(count), steps: 0, powers: [1.0; 2] }
    }

    /// The parameters that it updates.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// The global Euclidean norm of the gradients of its parameters.
    pub fn norm(&self, gradients: &Gradients) -> f64 {
        norm(gradients, &self.ids)
    }

    /// One gradient descent step. With `limit`, (the gradients' [`Optimizer::norm`], the maximum norm), the gradients are
    /// scaled down to the maximum norm. A parameter without a gradient is not changed.
    ///
    /// Returns false, and changes nothing, if the step is too large for single precision.
    #[must_use]
    pub fn step(
        &mut self,
        params: &mut Parameters,
        gradients: &Gradients,
        learning_rate: f64,
        limit: Option<(f64, f64)>,
    ) -> bool {
        // The small number is PyTorch's, in `clip_grad_norm_`.
        let scale = limit.map_or(1.0, |(norm, max_norm)| (max_norm / (norm + 1e-6)).min(1.0));
        let OptimizerSettings { beta1, beta2, epsilon, correct_bias } = self.settings;
        let powers = [self.powers[0] * beta1, self.powers[1] * beta2];
        let [correction1, correction2] = powers.map(|power| if correct_bias { 1.0 - power } else { 1.0 });
        // A weight moves by less than 1/√(1 − β₂) < 100 step sizes.
        if !(100.0 * (learning_rate / correction1) as f32).is_finite() {
            return false;
        }
        (self.steps, self.powers) = (self.steps + 1, powers);
        let with = optimizer::Step {
            scale: scale as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (learning_rate / correction1) as f32,
            root: (1.0 / correction2.sqrt()) as f32,
            epsilon: epsilon as f32,
        };
        let mut at = 0;
        for id in &self.ids {
            let value = params.slice_mut(*id);
            let range = at..at + value.len();
            at = range.end;
            if let Some(gradient) = gradients.get(*id) {
                let (m, v) = (&mut self.m[range.clone()], &mut self.v[range]);
                optimizer::step(value, m, v, gradient, with);
            }
        }
        true
    }

    /// Number of steps.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Saves the moments to a checkpoint, under names that start with `name`; [`Optimizer::steps`] has to be saved with them.
    pub fn save(&self, name: &str, arrays: &mut Arrays) {
        arrays.put_f32(&format!("{name}.m"), &self.m);
        arrays.put_f32(&format!("{name}.v"), &self.v);
    }

    /// Restores the moments of a checkpoint.
    ///
    /// # Errors
    /// They are for other parameters.
    pub fn restore(&mut self, name: &str, steps: u64, arrays: &mut Arrays) -> Result<(), StageError> {
        let len = self.m.len();
        self.m.copy_from_slice(&arrays.take_f32(&format!("{name}.m"), len)?);
        self.v.copy_from_slice(&arrays.take_f32(&format!("{name}.v"), len)?);
        self.steps = steps;
        self.powers = [1.0; 2];
        for _ in 0..steps {
            self.powers = [self.powers[0] * self.settings.beta1, self.powers[1] * self.settings.beta2];
        }
        Ok(())
    }
}

/// The global Euclidean norm of the gradients of these parameters; parameters without a gradient are ignored.
pub fn norm(gradients: &Gradients, ids: &[ParamId]) -> f64 {
    ids.iter().filter_map(|id| gradients.get(*id)).map(optimizer::sum_of_squares).sum::<f64>().sqrt()
}
