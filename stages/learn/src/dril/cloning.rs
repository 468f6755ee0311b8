//! The steps of behaviour cloning between PPO's.

use dril_stage_api::{Seed, StageError, StreamRng};
use serde::{Deserialize, Serialize};

use crate::checkpoint::Arrays;
use crate::imitation::Imitator;
use crate::optim::{Adam, AdamSettings};
use crate::pairs::Pairs;
use crate::policy::Policy;
use crate::split::random_batch;

/// One random batch at a time, with an Adam of its own. Parameters that the mean action does not depend on (a Gaussian's
/// deviations, the critic's own layers) are not moved.
pub(super) struct Cloning<'a> {
    pairs: &'a Pairs,
    train: Vec<usize>,
    batch_size: usize,
    learning_rate: f64,
    adam: Adam,
    stream: StreamRng,
    /// Sum and number of the losses since the last [`Cloning::mean_loss`].
    losses: (f64, u64),
}

/// The part of a checkpoint that is not in arrays.
#[derive(Serialize, Deserialize)]
pub(super) struct CloningState {
    stream: StreamRng,
    adam_steps: u64,
    losses: (f64, u64),
}

impl<'a> Cloning<'a> {
    /// Cloning of the pairs `train` into the policy, before its first step.
    pub(super) fn new(
        policy: &Policy,
        pairs: &'a Pairs,
        train: Vec<usize>,
        (batch_size, learning_rate): (usize, f64),
        seed: Seed,
    ) -> Self {
        let adam = Adam::new(&policy.params, policy.trained(), AdamSettings::default());
        Self {
            pairs,
            train,
            batch_size,
            learning_rate,
            adam,
            stream: seed.stream("cloning"),
            losses: (0.0, 0),
        }
    }

    /// Learns from one batch.
    ///
    /// # Errors
    /// The loss is not a number.
    pub(super) fn step(&mut self, policy: &mut Policy) -> Result<(), StageError> {
        let batch = random_batch(&self.train, self.batch_size, &mut self.stream);
        let seen = self.pairs.observations_for(&batch, policy.params.precision());
        let actions = self.pairs.actions(&batch);
        let (value, gradients) = policy.loss_and_gradients(&seen, &actions, self.adam.ids());
        if !value.is_finite() {
            return Err(StageError::failed(format!(
                "the loss of behaviour cloning is {value}: the network has diverged; try a lower `learning_rate` or \
                 `bc_learning_rate`"
            )));
        }
        self.adam.step(&mut policy.params, &gradients, self.learning_rate, None);
        self.losses.0 += value;
        self.losses.1 += 1;
        Ok(())
    }

    /// The mean loss of the batches since this was asked last; not a number where there was none.
    pub(super) fn mean_loss(&mut self) -> f64 {
        let (sum, count) = std::mem::take(&mut self.losses);
        sum / count as f64
    }

    /// Adds the state to a checkpoint.
    pub(super) fn save(&self, arrays: &mut Arrays) -> CloningState {
        self.adam.save("cloning", arrays);
        CloningState { stream: self.stream.clone(), adam_steps: self.adam.steps(), losses: self.losses }
    }

    /// Takes up the state of a checkpoint.
    ///
    /// # Errors
    /// The checkpoint is of another training.
    pub(super) fn restore(&mut self, state: CloningState, arrays: &mut Arrays) -> Result<(), StageError> {
        self.adam.restore("cloning", state.adam_steps, arrays)?;
        (self.stream, self.losses) = (state.stream, state.losses);
        Ok(())
    }
}
