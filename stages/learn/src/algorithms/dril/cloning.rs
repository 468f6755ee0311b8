//! The steps of behaviour cloning between those of PPO.

use dril_kinds::DrilParams;
use dril_stage_api::{Seed, StageError, StreamRng};
use serde::{Deserialize, Serialize};

use crate::algorithms::imitation::Imitator;
use crate::algorithms::ppo::{LearnError, finite, stepped};
use crate::data::split::random_batch;
use crate::data::transitions::Transitions;
use crate::nn::{Gradients, Optimizer, OptimizerSettings};
use crate::policy::Policy;
use crate::training::checkpoint::Arrays;

/// Behaviour cloning on one random batch at a time, with its own optimizer. Parameters that do not affect the mean action
/// (a Gaussian's standard deviations, the critic's own layers) are not changed.
pub(super) struct Cloning<'a> {
    transitions: &'a Transitions,
    train: Vec<usize>,
    batch_size: usize,
    learning_rate: f64,
    optimizer: Optimizer,
    gradients: Gradients,
    stream: StreamRng,
    /// Sum and number of the losses since the last [`Cloning::mean_loss`].
    losses: (f64, u64),
}

/// The part of a checkpoint besides arrays.
#[derive(Serialize, Deserialize)]
pub(super) struct CloningState {
    stream: StreamRng,
    optimizer_steps: u64,
    losses: (f64, u64),
}

impl<'a> Cloning<'a> {
    /// Behaviour cloning of the transitions `train`, at its start.
    pub(super) fn new(
        policy: &Policy,
        transitions: &'a Transitions,
        train: Vec<usize>,
        params: &DrilParams,
        seed: Seed,
    ) -> Self {
        Self {
            transitions,
            train,
            batch_size: params.bc_batch_size as usize,
            learning_rate: params.bc_learning_rate,
            optimizer: Optimizer::new(policy.params(), policy.trained(), OptimizerSettings::default()),
            gradients: Gradients::new(policy.params()),
            stream: seed.stream("cloning"),
            losses: (0.0, 0),
        }
    }

    /// One step on a random batch.
    ///
    /// # Errors
    /// The loss or a gradient is not finite; the weights stay as they were.
    pub(super) fn step(&mut self, policy: &mut Policy) -> Result<(), LearnError> {
        let batch = random_batch(&self.train, self.batch_size, &mut self.stream);
        self.gradients.clear();
        let (seen, actions) = (self.transitions.observations(&batch), self.transitions.actions(&batch));
        let loss = policy.learn(&seen, &actions, &mut self.gradients);
        finite("loss of behaviour cloning", loss)?;
        finite("norm of behaviour cloning's gradients", self.optimizer.norm(&self.gradients))?;
        let done = self.optimizer.step(policy.params_mut(), &self.gradients, self.learning_rate, None);
        stepped(done, self.learning_rate)?;
        self.losses.0 += loss;
        self.losses.1 += 1;
        Ok(())
    }

    /// The mean loss since the last call; NaN if there was no step.
    pub(super) fn mean_loss(&mut self) -> f64 {
        let (sum, count) = std::mem::take(&mut self.losses);
        sum / count as f64
    }

    /// Saves the state to a checkpoint.
    pub(super) fn save(&self, arrays: &mut Arrays) -> CloningState {
        self.optimizer.save("cloning", arrays);
        CloningState {
            stream: self.stream.clone(),
            optimizer_steps: self.optimizer.steps(),
            losses: self.losses,
        }
    }

    /// Restores the state of a checkpoint.
    ///
    /// # Errors
    /// The checkpoint is from another training.
    pub(super) fn restore(&mut self, state: CloningState, arrays: &mut Arrays) -> Result<(), StageError> {
        self.optimizer.restore("cloning", state.optimizer_steps, arrays)?;
        (self.stream, self.losses) = (state.stream, state.losses);
        Ok(())
    }
}
