//! Adam (Kingma & Ba 2015) over the flat parameters of a network.

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use crate::checkpoint::Arrays;
use crate::fast::memory;
use crate::kernels::adam;
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
    /// True where moments are scaled up while they are young.
    pub correct_bias: bool,
}

impl Default for AdamSettings {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, correct_bias: true }
    }
}

impl AdamSettings {
    /// RMSprop (Tieleman & Hinton 2012) as PyTorch has it: Adam without a first moment and without corrections.
    pub fn rmsprop(decay: f64, epsilon: f64) -> Self {
        Self { beta1: 0.0, beta2: decay, epsilon, correct_bias: false }
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
        let AdamSettings { beta1, beta2, epsilon, correct_bias } = self.settings;
        let power = self.steps as i32;
        let correction = |beta: f64| if correct_bias { 1.0 - beta.powi(power) } else { 1.0 };
        let with = adam::Step {
            scale: scale as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (learning_rate / correction(beta1)) as f32,
            root: (1.0 / correction(beta2).sqrt()) as f32,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::{Init, ParamSpec};
    use dril_stage_api::Seed;
    use tch::nn::OptimizerConfig;
    use tch::{Device, Kind, Tensor, nn};

    fn params(count: i64) -> Parameters {
        crate::fast::prepare();
        let spec = |name: &str, shape: &[i64]| ParamSpec {
            name: name.into(),
            shape: shape.to_vec(),
            init: Init::FanIn(1),
            may_round: false,
        };
        Parameters::new(vec![spec("a", &[count]), spec("b", &[3, 5])], Some(&mut Seed(1).stream("init")))
    }

    /// A loss with gradients of very different sizes.
    fn loss(a: &Tensor, b: &Tensor) -> Tensor {
        (a - 0.3).pow_tensor_scalar(4).sum(Kind::Float) + (b * 100.0).cos().sum(Kind::Float)
    }

    #[test]
    fn steps_equal_those_of_torchs_own_optimizer() {
        let mut params = params(37);
        let ids: Vec<ParamId> = params.ids().collect();
        let store = nn::VarStore::new(Device::Cpu);
        let copies: Vec<Tensor> = ids
            .iter()
            .map(|id| store.root().var_copy(&params.spec(*id).name, &params.tensor(*id).detach()))
            .collect();
        let mut theirs = nn::Adam::default().eps(1e-5).build(&store, 1e-2).unwrap();
        let settings = AdamSettings { epsilon: 1e-5, ..AdamSettings::default() };
        let mut ours = Adam::new(&params, ids.clone(), settings);
        for _ in 0..30 {
            let gradients = params.torch_gradients(&loss(params.tensor(ids[0]), params.tensor(ids[1])), &ids);
            ours.step(&mut params, &gradients, 1e-2, Some(0.5));
            let loss = loss(&copies[0], &copies[1]);
            theirs.backward_step_clip_norm(&loss, 0.5);
        }
        for (id, copy) in ids.iter().zip(&copies) {
            let apart = (params.tensor(*id) - copy).abs().max().double_value(&[]);
            assert!(apart < 1e-5, "{apart}");
        }
    }

    #[test]
    fn steps_of_rmsprop_are_those_of_torchs_optimizer() {
        let mut params = params(40);
        let ids: Vec<ParamId> = params.ids().collect();
        let store = nn::VarStore::new(Device::Cpu);
        let copies: Vec<Tensor> = ids
            .iter()
            .map(|id| store.root().var_copy(&params.spec(*id).name, &params.tensor(*id).detach()))
            .collect();
        let theirs = nn::RmsProp { alpha: 0.99, eps: 1e-5, wd: 0.0, momentum: 0.0, centered: false };
        let mut theirs = theirs.build(&store, 1e-5).unwrap();
        let mut ours = Adam::new(&params, ids.clone(), AdamSettings::rmsprop(0.99, 1e-5));
        for _ in 0..30 {
            let gradients = params.torch_gradients(&loss(params.tensor(ids[0]), params.tensor(ids[1])), &ids);
            ours.step(&mut params, &gradients, 1e-5, None);
            theirs.backward_step(&loss(&copies[0], &copies[1]));
        }
        for (id, copy) in ids.iter().zip(&copies) {
            let apart = (params.tensor(*id) - copy).abs().max().double_value(&[]);
            assert!(apart < 1e-6, "{apart}");
        }
    }

    #[test]
    fn a_parameter_without_a_gradient_stays_and_moments_are_kept_apart() {
        let mut params = params(4);
        let ids: Vec<ParamId> = params.ids().collect();
        let before = params.values().to_vec();
        let mut adam = Adam::new(&params, ids.clone(), AdamSettings::default());
        let gradients = params.torch_gradients(&params.tensor(ids[0]).sum(Kind::Float), &ids);
        assert!(gradients[1].is_none());
        assert_eq!(adam.step(&mut params, &gradients, 0.1, None), 2.0, "the norm of four ones");
        assert!(
            params.values()[..4]
                .iter()
                .zip(&before)
                .all(|(after, before)| (before - after - 0.1).abs() < 1e-5)
        );
        assert_eq!(params.values()[4..], before[4..]);
    }

    #[test]
    fn an_optimizer_goes_on_from_a_checkpoint_as_if_it_had_not_stopped() {
        let run = |stop: bool| {
            let mut params = params(40);
            let ids: Vec<ParamId> = params.ids().collect();
            let mut adam = Adam::new(&params, ids.clone(), AdamSettings::default());
            for step in 0..6 {
                let gradients =
                    params.torch_gradients(&loss(params.tensor(ids[0]), params.tensor(ids[1])), &ids);
                adam.step(&mut params, &gradients, 1e-2, None);
                if stop && step == 2 {
                    let mut arrays = Arrays::new();
                    adam.save("adam", &mut arrays);
                    let steps = adam.steps();
                    adam = Adam::new(&params, ids.clone(), AdamSettings::default());
                    adam.restore("adam", steps, &mut arrays).unwrap();
                }
            }
            params.values().to_vec()
        };
        assert_eq!(run(true), run(false));
    }
}
