//! `bc`: behaviour cloning with early stopping.
//!
//! Only the mean action is fitted. A Gaussian's standard deviations stay at their initial values; a Beta's concentration
//! changes as a side effect (thesis sections 5.5 and 7.2).

use dril_envs::ObservationSpace;
use dril_kinds::{BcParams, Network};
use dril_stage_api::{Ctx, Stage, StageError};

use super::imitation::{self, Imitator, Schedule};
use crate::data::split::divide;
use crate::data::transitions::Transitions;
use crate::nn::{Batch, Gradients, ParamId, Parameters};
use crate::policy::{Architecture, OutputGradients, Parts, Policy, check_family};

/// The stage `bc`.
#[derive(Clone, Copy, Debug)]
pub struct BcStage;

impl Stage for BcStage {
    type Kind = dril_kinds::Bc;

    fn run(params: &BcParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let transitions = Transitions::load("demonstrations", ctx.input("demonstrations")?)?;
        check_family(transitions.action_space(), params.policy)?;
        let mut policy = Policy::new(architecture(params, &transitions), &mut ctx.stream("init"))?;
        policy.network_mut().set_device(params.device)?;
        let parts =
            divide(transitions.lengths(), params.validation_fraction, params.split, &mut ctx.stream("split"));
        let schedule = Schedule {
            epochs: params.n_epochs,
            patience: Some(params.patience),
            batch_size: params.batch_size as usize,
            slices: 1,
            learning_rate: params.learning_rate,
            shuffle: true,
            validation: params.validation,
        };
        let log = imitation::train(&mut policy, &transitions, &parts, schedule, ctx)?;
        ctx.write_output("policy", policy.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

fn architecture(params: &BcParams, transitions: &Transitions) -> Architecture {
    let observation = transitions.observation();
    let fitting = match observation {
        ObservationSpace::Image { .. } => Network::DrilCnn,
        ObservationSpace::Vector { .. } => Network::Mlp,
    };
    let network = params.network.unwrap_or(fitting);
    Architecture { network, family: params.policy, observation, actions: transitions.action_space() }
}

/// A policy is fitted by its mean action (see [`crate::policy::Row::cloning_loss`]).
impl Imitator for Policy {
    fn params(&self) -> &Parameters {
        Policy::params(self)
    }

    fn params_mut(&mut self) -> &mut Parameters {
        Policy::params_mut(self)
    }

    fn trained(&self) -> Vec<ParamId> {
        self.actor_ids()
    }

    fn learn(&self, observations: &Batch, actions: &[f32], gradients: &mut Gradients) -> f64 {
        let rows = observations.rows();
        let (answers, tape) = self.forward(observations, Parts::Actor);
        let mut by_output = OutputGradients::of_mean(self, rows);
        let (share, len) = (1.0 / rows as f64, self.architecture().action_len());
        let losses = actions.chunks_exact(len).enumerate().map(|(at, demonstrated)| {
            by_output.add_cloning_row(&self.row(&answers, at), at, demonstrated, share)
        });
        let loss = losses.sum::<f64>() * share;
        self.backward(observations, tape, by_output, gradients);
        loss
    }

    fn validation_loss(&self, observations: &Batch, actions: &[f32]) -> f64 {
        let answers = self.infer(observations, Parts::Actor);
        let len = self.architecture().action_len();
        let losses = actions
            .chunks_exact(len)
            .enumerate()
            .map(|(at, demonstrated)| self.row(&answers, at).cloning_loss(demonstrated));
        losses.sum::<f64>() / observations.rows() as f64
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::data::transitions::tests::{image_demos, vector_demos};
    use dril_stage_api::testing::Bench;
    use dril_stage_api::{Seed, StageError};
    use serde_json::{Value, json};
    use std::sync::atomic::Ordering::Relaxed;

    /// A stage that learns from five episodes of 30 steps each.
    pub(crate) fn bench<S: Stage>(params: Value, seed: u64) -> Bench {
        let bench = Bench::new::<S>(&params, seed).unwrap();
        let demos = bench.folder().join("in.demos");
        vector_demos(&[30; 5]).write(&demos).unwrap();
        bench.input("demonstrations", &demos, &[])
    }

    /// The same with images, in which the grey says what to do.
    pub(crate) fn image_bench<S: Stage>(params: Value, seed: u64) -> Bench {
        let bench = Bench::new::<S>(&params, seed).unwrap();
        let demos = bench.folder().join("in.demos");
        let mut shown = image_demos(20, 0.0);
        for episode in &mut shown.episodes {
            episode.frames.iter_mut().for_each(|pixel| *pixel *= 6);
            let grey = episode.frames.chunks(36 * 36).map(|frame| f32::from(frame[0]) / 255.0);
            episode.actions = grey.flat_map(|grey| [grey, 1.0 - 2.0 * grey]).collect();
        }
        shown.write(&demos).unwrap();
        bench.input("demonstrations", &demos, &[])
    }

    /// Runs the stage and gives its outputs.
    pub(crate) fn outputs(bench: &Bench, ports: &[&str]) -> Vec<Vec<u8>> {
        bench.run().unwrap();
        ports.iter().map(|port| std::fs::read(bench.output(port).unwrap()).unwrap()).collect()
    }

    /// Stops the stage so many times, each time after its next step, before it runs to its end.
    pub(crate) fn stop_often(bench: &Bench, times: usize) {
        bench.cancel.store(true, Relaxed);
        for _ in 0..times {
            assert!(matches!(bench.run(), Err(StageError::Cancelled)));
        }
        bench.cancel.store(false, Relaxed);
    }

    fn params(policy: &str, epochs: u64) -> Value {
        json!({ "policy": policy, "n_epochs": epochs, "patience": 3, "batch_size": 25, "learning_rate": 3e-3 })
    }

    pub(crate) fn column(log: &[u8], name: &str) -> Vec<f64> {
        let mut reader = csv::Reader::from_reader(log);
        let at = reader.headers().unwrap().iter().position(|header| header == name).unwrap();
        reader.records().map(|row| row.unwrap()[at].parse().unwrap()).collect()
    }

    #[test]
    fn the_mean_action_of_either_family_comes_near_to_what_was_demonstrated() {
        for policy in ["gaussian", "beta"] {
            let params = json!({
                "policy": policy, "n_epochs": 80, "patience": 80, "batch_size": 25, "learning_rate": 5e-3
            });
            let outputs = outputs(&bench::<BcStage>(params, 1), &["log"]);
            let losses = column(&outputs[0], "best_val_loss");
            assert!(losses[79] < 0.1 * losses[0], "{policy}: {losses:?}");
        }
    }

    #[test]
    fn what_images_show_is_learnt() {
        let params = json!({ "policy": "beta", "n_epochs": 60, "batch_size": 16, "learning_rate": 1e-3 });
        let losses = column(&outputs(&image_bench::<BcStage>(params, 1), &["log"])[0], "best_val_loss");
        let last = losses[losses.len() - 1];
        assert!(last < 0.1 * losses[0], "{losses:?}");
    }

    #[test]
    fn the_weights_of_the_best_validation_are_kept_and_training_ends_when_patience_does() {
        let params = json!({
            "policy": "gaussian", "n_epochs": 300, "patience": 2, "batch_size": 25, "learning_rate": 3e-2
        });
        let bench = bench::<BcStage>(params, 1);
        let outputs = outputs(&bench, &["log"]);
        let losses = column(&outputs[0], "val_loss");
        assert!(losses.len() < 300, "a large step size makes the validation loss rise at some point");
        let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
        let since = losses.iter().rev().position(|loss| *loss == best).unwrap();
        assert_eq!(since, 2);
        let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
        let transitions = Transitions::load("demonstrations", &bench.folder().join("in.demos")).unwrap();
        let split = dril_kinds::Split::Pairs;
        let held_out = divide(transitions.lengths(), 0.2, split, &mut Seed(1).stream("split")).validation;
        let loss =
            policy.validation_loss(&transitions.observations(&held_out), &transitions.actions(&held_out));
        assert!((loss - best).abs() <= 1e-12 * best, "{loss} is not {best}");
    }

    #[test]
    fn only_what_the_mean_action_depends_on_is_moved() {
        let bench = bench::<BcStage>(params("gaussian", 3), 1);
        bench.run().unwrap();
        let after = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
        let before = Policy::new(after.architecture(), &mut Seed(1).stream("init")).unwrap();
        for id in after.params().ids() {
            let name = &after.params().spec(id).name;
            let moved = after.params().slice(id) != before.params().slice(id);
            let idle = name.starts_with("critic.") || name.ends_with("log_std");
            assert_eq!(moved, !idle, "{name}");
        }
    }

    #[test]
    fn equal_seeds_give_equal_bytes_and_another_seed_gives_others() {
        let of = |seed| outputs(&bench::<BcStage>(params("beta", 4), seed), &["policy", "log"]);
        let first = of(1);
        assert_eq!(first, of(1));
        assert_ne!(first[0], of(2)[0]);
    }

    #[test]
    fn a_training_that_was_stopped_again_and_again_ends_with_the_same_bytes() {
        let whole = outputs(&bench::<BcStage>(params("beta", 4), 1), &["policy", "log"]);
        let stopped = bench::<BcStage>(params("beta", 4), 1);
        // 120 transitions make 4 batches, so some stops are within an epoch and some between two.
        stop_often(&stopped, 7);
        assert_eq!(outputs(&stopped, &["policy", "log"]), whole);
        let saving = bench::<BcStage>(params("beta", 4), 1).checkpoint_seconds(0.0);
        assert_eq!(outputs(&saving, &["policy", "log"]), whole);
    }

    #[test]
    fn a_checkpoint_that_is_cut_off_means_a_new_start_with_the_same_end() {
        let whole = outputs(&bench::<BcStage>(params("beta", 2), 1), &["policy", "log"]);
        let stopped = bench::<BcStage>(params("beta", 2), 1);
        stop_often(&stopped, 3);
        let files: Vec<_> = std::fs::read_dir(stopped.folder().join("checkpoints")).unwrap().collect();
        assert_eq!(files.len(), 1);
        let file = std::fs::OpenOptions::new().write(true).open(files[0].as_ref().unwrap().path()).unwrap();
        file.set_len(file.metadata().unwrap().len() / 2).unwrap();
        assert_eq!(outputs(&stopped, &["policy", "log"]), whole);
    }

    #[test]
    fn too_high_a_learning_rate_is_an_error_that_names_it() {
        let params = json!({ "policy": "gaussian", "n_epochs": 50, "learning_rate": 1e39 });
        let message = bench::<BcStage>(params, 1).run().unwrap_err().to_string();
        assert!(message.contains("lower `learning_rate`"), "{message}");
    }
}
