//! Supervised learning of demonstrated actions: the training loop of behaviour cloning and the ensemble.
//!
//! The state between two batches is small (counters, weights and Adam's moments), so training can stop after any batch
//! and continue bit-identically.

use dril_kinds::{EPOCH_COLUMNS, Validation};
use dril_stage_api::{Ctx, Seed, StageError, StreamRng};
use serde::{Deserialize, Serialize};

use crate::data::split::{Partition, batching, random_batch, shuffled};
use crate::data::transitions::Transitions;
use crate::nn::{Batch, Gradients, Optimizer, OptimizerSettings, ParamId, Parameters};
use crate::training::checkpoint::{self, Arrays, foreign};
use crate::training::log::{Speed, TrainingLog};
use crate::training::tensorboard::Curves;

/// A network that is fitted to demonstrated actions.
pub trait Imitator {
    /// The weights.
    fn params(&self) -> &Parameters;
    /// The weights, mutable.
    fn params_mut(&mut self) -> &mut Parameters;
    /// The weights that the loss depends on.
    fn trained(&self) -> Vec<ParamId>;
    /// The training loss of a batch with these demonstrated actions, [rows, action values]; writes its gradients.
    fn learn(&self, observations: &Batch, actions: &[f32], gradients: &mut Gradients) -> f64;
    /// The mean validation loss of a batch.
    fn validation_loss(&self, observations: &Batch, actions: &[f32]) -> f64;
}

/// The schedule of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// Maximum number of epochs.
    pub epochs: u64,
    /// Epochs without a lower validation loss after which training ends with the best weights. None: all epochs are run
    /// and the last weights are kept.
    pub patience: Option<u64>,
    /// Transitions in a batch.
    pub batch_size: usize,
    /// Batch sizes are rounded down to a multiple of this.
    pub slices: usize,
    /// Learning rate of Adam.
    pub learning_rate: f64,
    /// True to shuffle each epoch (by the stream `order/<epoch>` of the stage's seed); false to keep the order of the list.
    pub shuffle: bool,
    /// Which held-out transitions are used for validation.
    pub validation: Validation,
}

/// Transitions in one forward pass of validation.
const VALIDATION_BATCH: usize = 250;

/// Trains `model` on the transitions of `parts` and returns the log; the model then has the best or the last weights (see
/// [`Schedule::patience`]).
///
/// # Errors
/// The loss is no longer finite, a checkpoint cannot be written or is from another training, or
/// [`StageError::Cancelled`] after a checkpoint.
pub fn train(
    model: &mut impl Imitator,
    transitions: &Transitions,
    parts: &Partition,
    schedule: Schedule,
    ctx: &mut Ctx<'_>,
) -> Result<TrainingLog, StageError> {
    let batches = batching(parts.train.len(), schedule.batch_size, schedule.slices);
    if batches.0 == 0 {
        return Err(StageError::failed(format!(
            "there are {} transitions to train on, expected at least {}; use more or longer trajectories",
            parts.train.len(),
            schedule.slices
        )));
    }
    let mut training = Training::new(model, schedule, batches);
    training.resume(ctx)?;
    let mut curves = Curves::open(ctx)?;
    let speed = Speed::from(training.at.steps);
    while !training.ended() {
        let order = training.order(&parts.train, ctx.seed());
        while training.at.batch < batches.0 {
            training.batch(transitions, &order)?;
            training.report(ctx, &speed);
            if training.at.batch < batches.0 {
                training.save_if_due(ctx)?;
            }
        }
        training.end_epoch(transitions, &parts.validation, ctx.seed());
        curves.last_row(training.at.steps, &training.at.log)?;
        training.save_if_due(ctx)?;
    }
    Ok(training.finish())
}

/// The position of a training between two batches.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Position {
    epoch: u64,
    /// Batches done in this epoch.
    batch: usize,
    /// Sum of their losses.
    loss: f64,
    /// Optimizer steps.
    steps: u64,
    best: Option<Best>,
    log: TrainingLog,
}

/// The best validation loss so far.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Best {
    loss: f64,
    /// Epochs since then.
    age: u64,
}

struct Training<'m, M> {
    model: &'m mut M,
    schedule: Schedule,
    /// Batches in an epoch, transitions in a batch.
    batches: (usize, usize),
    optimizer: Optimizer,
    gradients: Gradients,
    at: Position,
    best_weights: Vec<f32>,
}

impl<'m, M: Imitator> Training<'m, M> {
    fn new(model: &'m mut M, schedule: Schedule, batches: (usize, usize)) -> Self {
        let optimizer = Optimizer::new(model.params(), model.trained(), OptimizerSettings::default());
        let gradients = Gradients::new(model.params());
        let log = TrainingLog::new(&EPOCH_COLUMNS);
        let at = Position { epoch: 0, batch: 0, loss: 0.0, steps: 0, best: None, log };
        Self { model, schedule, batches, optimizer, gradients, at, best_weights: Vec::new() }
    }

    fn ended(&self) -> bool {
        let patient = match (self.schedule.patience, self.at.best) {
            (Some(patience), Some(best)) => best.age < patience,
            _ => true,
        };
        self.at.epoch >= self.schedule.epochs || !patient
    }

    /// The order of transitions in this epoch.
    fn order(&self, train: &[usize], seed: Seed) -> Vec<usize> {
        match self.schedule.shuffle {
            true => shuffled(train, &mut seed.stream(&format!("order/{}", self.at.epoch))),
            false => train.to_vec(),
        }
    }

    /// Trains on the next batch.
    fn batch(&mut self, transitions: &Transitions, order: &[usize]) -> Result<(), StageError> {
        let batch = &order[self.at.batch * self.batches.1..][..self.batches.1];
        self.gradients.clear();
        let seen = transitions.observations(batch);
        let value = self.model.learn(&seen, &transitions.actions(batch), &mut self.gradients);
        let rate = self.schedule.learning_rate;
        let done = value.is_finite()
            && self.optimizer.norm(&self.gradients).is_finite()
            && self.optimizer.step(self.model.params_mut(), &self.gradients, rate, None);
        if !done {
            return Err(StageError::failed(format!(
                "training diverged in epoch {}: the loss is {value}, or its gradients or the step are not finite; lower \
                 `learning_rate` ({rate})",
                self.at.epoch
            )));
        }
        self.at.batch += 1;
        self.at.loss += value;
        self.at.steps += 1;
        Ok(())
    }

    /// Validates, keeps the weights if they are the best so far, and logs the epoch.
    fn end_epoch(&mut self, transitions: &Transitions, validation: &[usize], seed: Seed) {
        let val_loss = self.validate(transitions, validation, seed);
        if val_loss.is_some_and(|loss| self.at.best.is_none_or(|best| loss < best.loss)) {
            self.at.best = val_loss.map(|loss| Best { loss, age: 0 });
            if self.schedule.patience.is_some() {
                self.best_weights = self.model.params().values().to_vec();
            }
        } else if let Some(best) = &mut self.at.best {
            best.age += 1;
        }
        self.at.log.push(&[
            self.at.epoch as f64,
            self.at.steps as f64,
            self.at.loss / self.batches.0 as f64,
            val_loss.unwrap_or(f64::NAN),
            self.at.best.map_or(f64::NAN, |best| best.loss),
            self.schedule.learning_rate,
        ]);
        self.at.epoch += 1;
        (self.at.batch, self.at.loss) = (0, 0.0);
    }

    /// The mean loss over the held-out transitions; none if there are none.
    fn validate(&self, transitions: &Transitions, validation: &[usize], seed: Seed) -> Option<f64> {
        let counted = match self.schedule.validation {
            Validation::All => validation.to_vec(),
            Validation::AsReference => {
                let stream = &mut seed.stream(&format!("validation/{}", self.at.epoch));
                whole_batches(validation, self.schedule.batch_size, stream)
            }
        };
        let sum: f64 = counted
            .chunks(VALIDATION_BATCH)
            .map(|batch| {
                let loss =
                    self.model.validation_loss(&transitions.observations(batch), &transitions.actions(batch));
                loss * batch.len() as f64
            })
            .sum();
        (!counted.is_empty()).then(|| sum / counted.len() as f64)
    }

    fn report(&self, ctx: &mut Ctx<'_>, speed: &Speed) {
        let last = |column| self.at.log.last(column).map_or_else(|| "-".to_owned(), |x| format!("{x:.5}"));
        ctx.progress(self.at.epoch, self.schedule.epochs, "epochs", || {
            let transitions = speed.at(self.at.steps) * self.batches.1 as f64;
            format!(
                "loss {}, validation {}, {transitions:.0} transitions/s",
                last("train_loss"),
                last("val_loss")
            )
        });
    }

    /// Saves a checkpoint if one is due; stops after it if the stage was cancelled.
    fn save_if_due(&self, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        if !ctx.checkpoint_due() || self.ended() {
            return Ok(());
        }
        let mut arrays = Arrays::new();
        arrays.put_f32("weights", self.model.params().values());
        arrays.put_f32("best", &self.best_weights);
        self.optimizer.save("optimizer", &mut arrays);
        checkpoint::save(ctx.checkpoints(), &self.at, &arrays)?;
        ctx.stop_if_cancelled()
    }

    fn resume(&mut self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        let Some((at, mut arrays)) = checkpoint::load::<Position>(ctx.checkpoints())? else { return Ok(()) };
        let all = self.model.params().values().len();
        self.optimizer.restore("optimizer", at.steps, &mut arrays)?;
        if at.batch >= self.batches.0 {
            return Err(foreign("it is of another training"));
        }
        self.model.params_mut().set_values(&arrays.take_f32("weights", all)?);
        let kept = self.schedule.patience.is_some() && at.best.is_some();
        self.best_weights = arrays.take_f32("best", if kept { all } else { 0 })?;
        self.at = at;
        Ok(())
    }

    fn finish(self) -> TrainingLog {
        if !self.best_weights.is_empty() {
            self.model.params_mut().set_values(&self.best_weights);
        }
        self.at.log
    }
}

/// The transitions that the reference code validates on after an epoch: full batches of the shuffled set, or one batch if
/// there are fewer.
fn whole_batches(validation: &[usize], batch_size: usize, stream: &mut StreamRng) -> Vec<usize> {
    let whole = validation.len() / batch_size.max(1) * batch_size;
    random_batch(validation, whole.max(batch_size), stream)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_validates_on_whole_batches_of_a_shuffled_set() {
        let held_out: Vec<usize> = (100..350).collect();
        let mut stream = Seed(1).stream("validation/0");
        let counted = whole_batches(&held_out, 100, &mut stream);
        assert_eq!(counted.len(), 200);
        assert_ne!(counted, held_out[..200]);
        assert_ne!(whole_batches(&held_out, 100, &mut stream), counted, "each pass shuffles");
        let mut few = whole_batches(&held_out[..40], 100, &mut stream);
        few.sort_unstable();
        assert_eq!(few, held_out[..40]);
        assert!(whole_batches(&[], 100, &mut stream).is_empty());
    }
}
