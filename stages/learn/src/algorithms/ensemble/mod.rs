//! `ensemble`: policies trained on different bootstrap samples of the demonstrations, so that they agree where there is
//! data and disagree where there is none.

mod net;

use dril_envs::ActionSpace;
use dril_kinds::{Bootstrap, EnsembleParams, Validation};
use dril_stage_api::{Ctx, Stage, StageError, StreamRng};

pub use net::{Ensemble, EnsembleArchitecture};

use super::imitation::{self, Imitator, Schedule};
use crate::data::split::{Partition, divide, with_replacement};
use crate::data::transitions::Transitions;
use crate::nn::{Batch, Gradients, ParamId, Parameters};
use crate::policy::{Row, RowGradient};

/// The stage `ensemble`.
#[derive(Clone, Copy, Debug)]
pub struct EnsembleStage;

impl Stage for EnsembleStage {
    type Kind = dril_kinds::Ensemble;

    fn run(params: &EnsembleParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let transitions = Transitions::load("demonstrations", ctx.input("demonstrations")?)?;
        let members = params.n_members as usize;
        let architecture = EnsembleArchitecture {
            observation: transitions.observation(),
            actions: transitions.action_space(),
            members,
        };
        // Its own streams: `bc` with the same seed uses `init` and `split`.
        let mut ensemble = Ensemble::new(architecture, &mut ctx.stream("ensemble/init"))?;
        ensemble.network_mut().set_device(params.device)?;
        let Partition { train, validation } = divide(
            transitions.lengths(),
            params.validation_fraction,
            params.split,
            &mut ctx.stream("ensemble/split"),
        );
        let train = bootstrap(&train, members, params.bootstrap, &mut ctx.stream("ensemble/bootstrap"));
        let schedule = Schedule {
            epochs: params.n_epochs,
            patience: None,
            batch_size: params.batch_size as usize,
            slices: members,
            learning_rate: params.learning_rate,
            shuffle: false,
            validation: Validation::All,
        };
        let parts = Partition { train, validation };
        let log = imitation::train(&mut ensemble, &transitions, &parts, schedule, ctx)?;
        ctx.write_output("ensemble", ensemble.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

/// The bootstrap samples of all members, drawn once with replacement: every epoch has the same order.
///
/// Each batch is divided into `members` consecutive slices, and member k is trained on the k-th slice only. A full
/// bootstrap therefore takes `members` times as many draws as there are training transitions; the thesis's code takes as
/// many draws as transitions, which leaves each member a `members`-th of them.
fn bootstrap(train: &[usize], members: usize, size: Bootstrap, rng: &mut StreamRng) -> Vec<usize> {
    let draws = match size {
        Bootstrap::Full => train.len() * members,
        Bootstrap::Shrunk => train.len(),
    };
    with_replacement(train, draws, rng)
}

impl Imitator for Ensemble {
    fn params(&self) -> &Parameters {
        Ensemble::params(self)
    }

    fn params_mut(&mut self) -> &mut Parameters {
        Ensemble::params_mut(self)
    }

    fn trained(&self) -> Vec<ParamId> {
        Ensemble::params(self).ids().collect()
    }

    /// Each member is trained on its own slice.
    fn learn(&self, observations: &Batch, actions: &[f32], gradients: &mut Gradients) -> f64 {
        let (slices, tape) = self.forward_slices(observations);
        let share = 1.0 / observations.rows() as f64;
        let (outputs, len) =
            (self.architecture().actions.outputs(), self.architecture().actions.action_len());
        let mut actions = actions.chunks_exact(len);
        let mut loss = 0.0;
        let by_slice = slices.iter().map(|answers| {
            let mut by_answer = vec![0.0; answers.len()];
            let rows = answers.chunks_exact(outputs).zip(by_answer.chunks_exact_mut(outputs));
            for ((answer, first), demonstrated) in rows.zip(&mut actions) {
                let into = RowGradient { first, second: &mut [], shared: &mut [] };
                let row = self.answer(answer);
                row.add_cloning_gradient(demonstrated, share, into);
                loss += row.cloning_loss(demonstrated);
            }
            by_answer
        });
        let by_slice = by_slice.collect();
        self.backward(observations, tape, by_slice, gradients);
        loss * share
    }

    /// All members are evaluated on all transitions.
    fn validation_loss(&self, observations: &Batch, actions: &[f32]) -> f64 {
        let (outputs, len) =
            (self.architecture().actions.outputs(), self.architecture().actions.action_len());
        let answers = self.answers(observations);
        let (mut loss, mut count) = (0.0, 0);
        for (answer, demonstrated) in answers.chunks_exact(outputs).zip(actions.chunks_exact(len).cycle()) {
            loss += self.answer(answer).cloning_loss(demonstrated);
            count += 1;
        }
        loss / f64::from(count)
    }
}

impl Ensemble {
    /// A member's output as a distribution, so that its loss is that of behaviour cloning.
    fn answer<'a>(&self, answer: &'a [f32]) -> Row<'a> {
        match self.architecture().actions {
            ActionSpace::Continuous { .. } => Row::Gaussian { mean: answer, log_std: &[] },
            ActionSpace::Discrete { .. } => Row::Categorical { logits: answer },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algorithms::bc::tests::{bench, column, image_bench, outputs, stop_often};
    use crate::algorithms::dril::disagreement::MemberOutputs;
    use dril_stage_api::Seed;
    use serde_json::{Value, json};

    fn params(epochs: u64) -> Value {
        json!({ "n_members": 3, "n_epochs": epochs, "batch_size": 30, "learning_rate": 1e-3 })
    }

    #[test]
    fn a_full_bootstrap_draws_for_each_member_as_many_pairs_as_there_are() {
        let train: Vec<usize> = (100..150).collect();
        let draws = |size| bootstrap(&train, 5, size, &mut Seed(1).stream("bootstrap")).len();
        assert_eq!((draws(Bootstrap::Full), draws(Bootstrap::Shrunk)), (250, 50));
    }

    #[test]
    fn members_learn_the_demonstrations_and_stay_apart_elsewhere() {
        let params = json!({ "n_members": 3, "n_epochs": 50, "batch_size": 30, "learning_rate": 2e-3 });
        let bench = bench::<EnsembleStage>(params, 1);
        bench.run().unwrap();
        let ensemble = Ensemble::load("ensemble", &bench.output("ensemble").unwrap()).unwrap();
        let transitions = Transitions::load("demonstrations", &bench.folder().join("in.demos")).unwrap();
        let all: Vec<usize> = (0..transitions.len()).collect();
        let known = transitions.observations(&all);
        let loss = ensemble.validation_loss(&known, &transitions.actions(&all));
        assert!(loss < 0.01, "{loss}");
        let apart = |numbers: Vec<f32>| {
            let batch = Batch::Vectors { rows: all.len(), numbers };
            let outputs = MemberOutputs::new(ensemble.answers(&batch), 3, 2).unwrap();
            let (x, y) = ([1.0, 0.0], [0.0, 1.0]);
            (0..all.len())
                .map(|at| outputs.continuous_cost(at, &x) + outputs.continuous_cost(at, &y))
                .sum::<f64>()
        };
        let Batch::Vectors { numbers: known, .. } = known else { panic!("vectors") };
        // Everything demonstrated lies in a square of side 2 around 0.
        let unknown: Vec<f32> = known.iter().map(|number| number * 3.0 + 2.0).collect();
        let (known, unknown) = (apart(known), apart(unknown));
        assert!(unknown > 10.0 * known, "{unknown} {known}");
    }

    #[test]
    fn what_images_show_is_learnt_through_the_shared_encoder() {
        let params = json!({ "n_members": 3, "n_epochs": 40, "batch_size": 15, "learning_rate": 1e-3 });
        let losses = column(&outputs(&image_bench::<EnsembleStage>(params, 1), &["log"])[0], "val_loss");
        assert!(losses[39] < 0.1 * losses[0], "{losses:?}");
    }

    #[test]
    fn equal_seeds_give_equal_bytes_and_another_seed_gives_others() {
        let of = |seed| outputs(&bench::<EnsembleStage>(params(2), seed), &["ensemble", "log"]);
        let first = of(1);
        assert_eq!(first, of(1));
        assert_ne!(first[0], of(2)[0]);
    }

    #[test]
    fn a_training_that_was_stopped_again_and_again_ends_with_the_same_bytes() {
        let whole = outputs(&bench::<EnsembleStage>(params(3), 1), &["ensemble", "log"]);
        let stopped = bench::<EnsembleStage>(params(3), 1);
        stop_often(&stopped, 6);
        assert_eq!(outputs(&stopped, &["ensemble", "log"]), whole);
    }

    #[test]
    fn all_passes_are_made_and_the_last_weights_kept() {
        let log = outputs(&bench::<EnsembleStage>(params(5), 1), &["log"]).remove(0);
        // A header and five epochs of four batches: 120 transitions in batches of 30.
        let rows: Vec<&str> = std::str::from_utf8(&log).unwrap().lines().collect();
        assert_eq!(rows.len(), 6);
        assert!(rows[5].starts_with("4,20,"), "{}", rows[5]);
    }
}
