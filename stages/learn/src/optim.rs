//! Adam (Kingma & Ba 2015) over the flat parameters of a network.

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Arrays;
use crate::fast::{adam, memory};
use crate::net::{Gradients, ParamId, Parameters};

/// The constants of Adam; the defaults are PyTorch's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdamSettings {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the denominator.
    pub epsilon: f64,
}

impl Default for AdamSettings {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// The optimizer's state for some of the parameters of one network. Two losses on one network take two of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    settings: AdamSettings,
    ids: Vec<ParamId>,
    /// First moments, one parameter after the other in the order of `ids`.
    m: Vec<f32>,
    /// Second moments.
    v: Vec<f32>,
    steps: u64,
}

impl Adam {
    /// An optimizer for the parameters `ids`, before its first step.
    pub fn new(params: &Parameters, ids: Vec<ParamId>, settings: AdamSettings) -> Self {
        let count = ids.iter().map(|id| params.slice(*id).len()).sum();
        Self { settings, ids, m: vec![0.0; count], v: vec![0.0; count], steps: 0 }
    }

    /// The parameters that it moves, in the order in which [`Adam::step`] takes their gradients.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// One step against the gradients (in the order of [`Adam::ids`]). With `max_norm` the gradients are scaled so that
    /// their common Euclidean norm is at most that. Gives the norm before scaling. A parameter without a gradient stays.
    pub fn step(
        &mut self,
        params: &mut Parameters,
        gradients: &Gradients,
        learning_rate: f64,
        max_norm: Option<f64>,
    ) -> f64 {
        let norm = norm(gradients);
        // The small number is PyTorch's, in `clip_grad_norm_`.
        let scale = max_norm.map_or(1.0, |max| (max / (norm + 1e-6)).min(1.0));
        self.steps += 1;
        let AdamSettings { beta1, beta2, epsilon } = self.settings;
        let power = self.steps as i32;
        let with = adam::Step {
            scale: scale as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (learning_rate / (1.0 - beta1.powi(power))) as f32,
            root: (1.0 / (1.0 - beta2.powi(power)).sqrt()) as f32,
            epsilon: epsilon as f32,
        };
        let mut at = 0;
        for (id, gradient) in self.ids.iter().zip(gradients) {
            let value = params.slice_mut(*id);
            let range = at..at + value.len();
            at = range.end;
            if let Some(gradient) = gradient {
                let (m, v) = (&mut self.m[range.clone()], &mut self.v[range]);
                adam::step(value, m, v, memory::values(gradient), with);
            }
        }
        norm
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Adds the moments to a checkpoint, under names that begin with `name`; [`Adam::steps`] belongs to them.
    pub fn save(&self, name: &str, arrays: &mut Arrays) {
        arrays.put_f32(&format!("{name}.m"), &self.m);
        arrays.put_f32(&format!("{name}.v"), &self.v);
    }

    /// Takes up moments from a checkpoint again.
    ///
    /// # Errors
    /// They belong to other parameters.
    pub fn restore(&mut self, name: &str, steps: u64, arrays: &mut Arrays) -> Result<(), StageError> {
        self.m = arrays.take_f32(&format!("{name}.m"), self.m.len())?;
        self.v = arrays.take_f32(&format!("{name}.v"), self.v.len())?;
        self.steps = steps;
        Ok(())
    }
}

/// The Euclidean norm of all gradients together.
pub fn norm(gradients: &Gradients) -> f64 {
    gradients.iter().flatten().map(|g| adam::sum_of_squares(memory::values(g))).sum::<f64>().sqrt()
}
