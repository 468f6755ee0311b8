//! `ensemble`: policies that learn from different draws of the demonstrations, so that they agree where there is data
//! and are apart where there is none.

mod net;

use dril_kinds::{Bootstrap, EnsembleParams};
use dril_stage_api::{Ctx, Stage, StageError, StreamRng};
use tch::Tensor;

pub use net::{Architecture, Ensemble};

use crate::fast;
use crate::imitation::{self, Imitator, Schedule, action_loss};
use crate::made_with;
use crate::net::{Gradients, ParamId, Parameters};
use crate::pairs::Pairs;
use crate::policy::oracle;
use crate::spaces::Actions;
use crate::split::{Parts, divide, with_replacement};

/// Runs `ensemble` stages.
#[derive(Clone, Copy, Debug)]
pub struct EnsembleStage;

impl Stage for EnsembleStage {
    type Kind = dril_kinds::Ensemble;

    fn run(params: &EnsembleParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        fast::prepare();
        made_with::tell(ctx);
        let pairs = Pairs::load("demonstrations", ctx.input("demonstrations")?)?;
        let members = params.members as usize;
        let architecture = Architecture::new(pairs.observation(), pairs.kind(), members);
        let mut ensemble = Ensemble::new(architecture, &mut ctx.stream("init"))?;
        ensemble.params.set_precision(params.precision);
        let Parts { train, validation } =
            divide(pairs.lengths(), params.validation_fraction, params.split, &mut ctx.stream("split"));
        let train = bootstrap(&train, members, params.bootstrap, &mut ctx.stream("bootstrap"));
        let schedule = Schedule {
            epochs: params.epochs,
            patience: None,
            batch_size: params.batch_size as usize,
            slices: members,
            learning_rate: params.learning_rate,
            shuffle: false,
        };
        let parts = Parts { train, validation };
        let log = imitation::train(&mut ensemble, &pairs, &parts, schedule, ctx)?;
        ctx.write_output("ensemble", ensemble.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

/// The pairs that the ensemble learns from, drawn with replacement, once: every pass has the same order.
///
/// Each batch is cut into `members` consecutive slices, and member k sees the k-th slice of each batch only; so a full
/// bootstrap takes `members` times as many draws as there are training pairs, and the code behind the thesis, which
/// takes as many draws as pairs, leaves each member a `members`-th of them.
fn bootstrap(train: &[usize], members: usize, size: Bootstrap, rng: &mut StreamRng) -> Vec<usize> {
    let draws = match size {
        Bootstrap::Full => train.len() * members,
        Bootstrap::Shrunk => train.len(),
    };
    with_replacement(train, draws, rng)
}

impl Imitator for Ensemble {
    fn params(&self) -> &Parameters {
        &self.params
    }

    fn params_mut(&mut self) -> &mut Parameters {
        &mut self.params
    }

    fn trained(&self) -> Vec<ParamId> {
        self.params.ids().collect()
    }

    /// Each member learns from its own slice.
    fn loss_and_gradients(
        &self,
        observations: &Tensor,
        actions: &Tensor,
        ids: &[ParamId],
    ) -> (f64, Gradients) {
        let slices = self.forward_slices(observations);
        let loss = self.answers_loss(&slices.answers, actions);
        (loss.double_value(&[]), self.gradients(slices, &loss, ids))
    }

    /// All members are tried on all pairs.
    fn validation_loss(&self, observations: &Tensor, actions: &Tensor) -> Tensor {
        self.answers_loss(&self.forward(observations), actions)
    }
}

impl Ensemble {
    /// The loss of answers [.., batch, count] to the batch's actions: as that of behaviour cloning.
    fn answers_loss(&self, answers: &Tensor, actions: &Tensor) -> Tensor {
        match self.architecture().kind() {
            Actions::Numbers(_) => action_loss(answers, actions),
            Actions::Choices(count) => {
                let answers = answers.view([-1, count as i64]);
                let times = answers.size()[0] / actions.size()[0];
                oracle::categorical_cross_entropy(&answers, &actions.repeat([times, 1]))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bc::tests::{bench, column, outputs, picture_bench, stop_often};
    use dril_stage_api::Seed;
    use serde_json::{Value, json};

    fn params(epochs: u64) -> Value {
        json!({ "members": 3, "epochs": epochs, "batch_size": 30, "learning_rate": 1e-3 })
    }

    #[test]
    fn a_full_bootstrap_draws_for_each_member_as_many_pairs_as_there_are() {
        let train: Vec<usize> = (100..150).collect();
        let draws = |size| bootstrap(&train, 5, size, &mut Seed(1).stream("bootstrap")).len();
        assert_eq!((draws(Bootstrap::Full), draws(Bootstrap::Shrunk)), (250, 50));
    }

    #[test]
    fn members_learn_the_demonstrations_and_stay_apart_elsewhere() {
        let params = json!({ "members": 3, "epochs": 50, "batch_size": 30, "learning_rate": 2e-3 });
        let bench = bench::<EnsembleStage>(params, 1);
        bench.run().unwrap();
        let ensemble = Ensemble::load("ensemble", &bench.output("ensemble").unwrap()).unwrap();
        let pairs = Pairs::load("demonstrations", &bench.folder().join("in.demos")).unwrap();
        let all: Vec<usize> = (0..pairs.len()).collect();
        let known = pairs.observations(&all);
        let loss = ensemble.validation_loss(&known, &pairs.actions(&all)).double_value(&[]);
        assert!(loss < 0.01, "{loss}");
        let apart = |seen: &Tensor| {
            let answers = ensemble.forward(seen).clamp(-1.0, 1.0);
            answers.var_dim(0, true, false).mean(tch::Kind::Float).double_value(&[])
        };
        // Everything demonstrated lies in a square of side 2 around 0.
        let unknown: Tensor = &known * 3.0 + 2.0;
        assert!(apart(&unknown) > 10.0 * apart(&known), "{} {}", apart(&unknown), apart(&known));
    }

    #[test]
    fn what_pictures_show_is_learnt_through_the_shared_encoder() {
        let params = json!({ "members": 3, "epochs": 40, "batch_size": 15, "learning_rate": 1e-3 });
        let losses = column(&outputs(&picture_bench::<EnsembleStage>(params, 1), &["log"])[0], "val_loss");
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
        // A header and five epochs of four batches: 120 pairs in batches of 30.
        let rows: Vec<&str> = std::str::from_utf8(&log).unwrap().lines().collect();
        assert_eq!(rows.len(), 6);
        assert!(rows[5].starts_with("4,20,"), "{}", rows[5]);
    }
}
