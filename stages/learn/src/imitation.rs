//! Fitting actions to demonstrated ones, pass by pass: what behaviour cloning and the ensemble share.
//!
//! The whole state between two batches is small (a place, the weights and Adam's moments), so training stops and goes on
//! after any batch, bit-identically.

use dril_stage_api::{Ctx, Seed, StageError};
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use crate::checkpoint::{self, Arrays, foreign};
use crate::log::{Speed, TrainingLog};
use crate::net::{Gradients, ParamId, Parameters};
use crate::optim::{Adam, AdamSettings};
use crate::pairs::Pairs;
use crate::split::{Parts, batching, shuffled};
use crate::tensorboard::Curves;

/// The mean squared error between actions, both clamped to [-1, 1] as the environment does it; a scalar.
///
/// A prediction beyond the range has no gradient, as in the reference. The two spread to a common shape.
pub fn action_loss(predicted: &Tensor, demonstrated: &Tensor) -> Tensor {
    (predicted.clamp(-1.0, 1.0) - demonstrated.clamp(-1.0, 1.0)).square().mean(Kind::Float)
}

/// What learns to act as demonstrated.
pub trait Imitator {
    /// Its weights.
    fn params(&self) -> &Parameters;
    /// Its weights, to be changed.
    fn params_mut(&mut self) -> &mut Parameters;
    /// The weights that the loss depends on.
    fn trained(&self) -> Vec<ParamId>;
    /// The training loss of a batch, and its gradients for the parameters asked for, in that order.
    fn loss_and_gradients(
        &self,
        observations: &Tensor,
        actions: &Tensor,
        ids: &[ParamId],
    ) -> (f64, Gradients);
    /// The mean loss over a batch in validation, a scalar.
    fn validation_loss(&self, observations: &Tensor, actions: &Tensor) -> Tensor;
}

/// How training goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// Passes at most.
    pub epochs: u64,
    /// Passes without a better validation loss after which training ends with the best weights; without it all passes
    /// are made and the last weights stay.
    pub patience: Option<u64>,
    /// Pairs in a batch.
    pub batch_size: usize,
    /// Batches are cut to a multiple of this.
    pub slices: usize,
    /// Adam's step size.
    pub learning_rate: f64,
    /// True where each pass has an order of its own (from the stream `order/<epoch>` of the stage's seed), false where
    /// all have that of the list.
    pub shuffle: bool,
}

/// Pairs in one go through the network in validation. A constant: other widths give other last bits.
const VALIDATION_BATCH: usize = 250;

/// The log's columns: losses are mean squared errors of clamped actions, over the pass's batches as they were learnt from
/// and over all held-out pairs after it.
const COLUMNS: [&str; 6] = ["epoch", "step", "train_loss", "val_loss", "best_val_loss", "learning_rate"];

/// Trains `model` on the pairs of `parts` and gives the log; the model then has the best or the last weights (see
/// [`Schedule::patience`]).
///
/// # Errors
/// The loss stops being a number, a checkpoint cannot be written or belongs to something else, or
/// [`StageError::Cancelled`] after a checkpoint.
pub fn train(
    model: &mut impl Imitator,
    pairs: &Pairs,
    parts: &Parts,
    schedule: Schedule,
    ctx: &mut Ctx<'_>,
) -> Result<TrainingLog, StageError> {
    let batches = batching(parts.train.len(), schedule.batch_size, schedule.slices);
    if batches.0 == 0 {
        return Err(StageError::failed(format!(
            "there are {} pairs to train on, expected at least {}; give more or longer trajectories",
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
            training.batch(pairs, &order)?;
            training.tell(ctx, &speed);
            if training.at.batch < batches.0 {
                training.pause(ctx)?;
            }
        }
        training.end_epoch(pairs, &parts.validation);
        curves.last_row(training.at.steps, &training.at.log)?;
        training.pause(ctx)?;
    }
    Ok(training.finish())
}

/// Where training stands between two batches.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Place {
    epoch: u64,
    /// Batches done in this epoch.
    batch: usize,
    /// The sum of their losses.
    loss: f64,
    /// Adam's steps.
    steps: u64,
    best: Option<Best>,
    log: TrainingLog,
}

/// The best validation so far.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Best {
    loss: f64,
    /// Epochs since.
    age: u64,
}

struct Training<'m, M> {
    model: &'m mut M,
    schedule: Schedule,
    /// Batches in an epoch, pairs in a batch.
    batches: (usize, usize),
    adam: Adam,
    at: Place,
    best_weights: Vec<f32>,
}

impl<'m, M: Imitator> Training<'m, M> {
    fn new(model: &'m mut M, schedule: Schedule, batches: (usize, usize)) -> Self {
        let adam = Adam::new(model.params(), model.trained(), AdamSettings::default());
        let log = TrainingLog::new(&COLUMNS);
        let at = Place { epoch: 0, batch: 0, loss: 0.0, steps: 0, best: None, log };
        Self { model, schedule, batches, adam, at, best_weights: Vec::new() }
    }

    fn ended(&self) -> bool {
        let patient = match (self.schedule.patience, self.at.best) {
            (Some(patience), Some(best)) => best.age < patience,
            _ => true,
        };
        self.at.epoch >= self.schedule.epochs || !patient
    }

    /// The order of pairs in this epoch.
    fn order(&self, train: &[usize], seed: Seed) -> Vec<usize> {
        match self.schedule.shuffle {
            true => shuffled(train, &mut seed.stream(&format!("order/{}", self.at.epoch))),
            false => train.to_vec(),
        }
    }

    /// Learns from the next batch.
    fn batch(&mut self, pairs: &Pairs, order: &[usize]) -> Result<(), StageError> {
        let batch = &order[self.at.batch * self.batches.1..][..self.batches.1];
        let seen = pairs.observations_for(batch, self.model.params().precision());
        let (value, gradients) = self.model.loss_and_gradients(&seen, &pairs.actions(batch), self.adam.ids());
        if !value.is_finite() {
            return Err(StageError::failed(format!(
                "the loss became {value} in epoch {}; lower `learning_rate` ({})",
                self.at.epoch, self.schedule.learning_rate
            )));
        }
        self.adam.step(self.model.params_mut(), &gradients, self.schedule.learning_rate, None);
        self.at.batch += 1;
        self.at.loss += value;
        self.at.steps += 1;
        Ok(())
    }

    /// Validates, keeps the weights if they are the best, writes the epoch's row and goes on to the next.
    fn end_epoch(&mut self, pairs: &Pairs, validation: &[usize]) {
        let val_loss = self.validate(pairs, validation);
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

    /// The mean loss over all held-out pairs; nothing where none are held out.
    fn validate(&self, pairs: &Pairs, validation: &[usize]) -> Option<f64> {
        let sum: f64 = validation
            .chunks(VALIDATION_BATCH)
            .map(|batch| {
                let (observations, actions) = (pairs.observations(batch), pairs.actions(batch));
                let loss = tch::no_grad(|| self.model.validation_loss(&observations, &actions));
                loss.double_value(&[]) * batch.len() as f64
            })
            .sum();
        (!validation.is_empty()).then(|| sum / validation.len() as f64)
    }

    fn tell(&self, ctx: &mut Ctx<'_>, speed: &Speed) {
        let last = |column| self.at.log.last(column).map_or_else(|| "-".to_owned(), |x| format!("{x:.5}"));
        ctx.progress(self.at.epoch, self.schedule.epochs, "epochs", || {
            let pairs = speed.at(self.at.steps) * self.batches.1 as f64;
            format!("loss {}, validation {}, {pairs:.0} pairs/s", last("train_loss"), last("val_loss"))
        });
    }

    /// Saves where that is due; stops where that is asked for.
    fn pause(&self, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        if !ctx.checkpoint_due() || self.ended() {
            return Ok(());
        }
        let mut arrays = Arrays::new();
        arrays.put_f32("weights", self.model.params().values());
        arrays.put_f32("best", &self.best_weights);
        self.adam.save("adam", &mut arrays);
        checkpoint::save(ctx.checkpoints(), &self.at, &arrays)?;
        ctx.stop_if_cancelled()
    }

    fn resume(&mut self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        let Some((at, mut arrays)) = checkpoint::load::<Place>(ctx.checkpoints())? else { return Ok(()) };
        let all = self.model.params().values().len();
        self.adam.restore("adam", at.steps, &mut arrays)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prediction_beyond_the_range_costs_its_clamped_distance_and_has_no_gradient() {
        crate::fast::prepare();
        let predicted = Tensor::from_slice(&[3.0_f32, 0.5]).set_requires_grad(true);
        let loss = action_loss(&predicted, &Tensor::from_slice(&[0.0_f32, -2.0]));
        // ((1 - 0)² + (0.5 - (-1))²) / 2
        assert!((loss.double_value(&[]) - 1.625).abs() < 1e-6);
        let gradient = Tensor::run_backward(&[&loss], &[&predicted], false, false).remove(0);
        assert_eq!(gradient.double_value(&[0]), 0.0);
        assert!((gradient.double_value(&[1]) - 1.5).abs() < 1e-6);
    }
}
