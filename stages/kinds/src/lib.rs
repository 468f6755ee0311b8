//! The learning kinds as the engine plans with them: parameters, ports and needs, without libtorch.
//!
//! Each module describes one kind; `dril-learn` implements them. Defaults are the values that produced the thesis's
//! tables; where text and code of the original differ, the field says which is which.

mod bc;
mod choices;
mod collect;
mod dataset;
mod default;
mod dril;
mod ensemble;
mod evaluate;
mod ppo;
mod update;

pub use bc::{Bc, BcParams, Split};
pub use choices::{Algorithm, Mode, Network, PolicyFamily, Precision};
pub use collect::{Collect, CollectParams};
pub use dataset::{ActionRange, Dataset, DatasetParams};
pub use dril::{Dril, DrilParams, PeakWeights, RewardScheme, Thresholds};
pub use ensemble::{Bootstrap, Ensemble, EnsembleParams};
pub use evaluate::{Counted, Evaluate, EvaluateParams};
pub use ppo::{Ppo, PpoParams};
pub use update::UpdateSettings;

use dril_stage_api::Kind;

/// The executable that runs these kinds; it stands beside `dril-pipe`.
pub const WORKER: &str = "dril-pipe-learn";

/// All of them, to plan with.
pub const KINDS: [Kind; 7] = [
    Kind::run_by::<Ppo>(WORKER),
    Kind::run_by::<Evaluate>(WORKER),
    Kind::run_by::<Collect>(WORKER),
    Kind::run_by::<Dataset>(WORKER),
    Kind::run_by::<Bc>(WORKER),
    Kind::run_by::<Ensemble>(WORKER),
    Kind::run_by::<Dril>(WORKER),
];

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_kind_takes_its_own_defaults() {
        let env = json!({ "car-racing": {} });
        let required = [
            ("ppo", json!({ "env": env, "policy": "beta" })),
            ("evaluate", json!({ "env": env, "mode": "stochastic", "first_track_seed": 1 })),
            ("collect", json!({ "env": env, "first_track_seed": 1 })),
            ("dataset", json!({ "actions": "clipped", "trajectories": 1 })),
            ("bc", json!({ "policy": "beta" })),
            ("ensemble", json!({})),
            ("dril", json!({ "env": env })),
        ];
        for (kind, (name, params)) in KINDS.iter().zip(required) {
            assert_eq!(kind.name(), name);
            let full = kind.normalize(&params).unwrap_or_else(|problems| panic!("{name}: {problems:?}"));
            assert_eq!(kind.normalize(&full), Ok(full.clone()), "{name}: normalising twice changes nothing");
            assert!(!kind.ports(&full).unwrap().outputs.is_empty());
            assert!(kind.needs(&full).unwrap().cost > 0.0, "{name}");
        }
    }

    #[test]
    fn parameters_that_came_later_stay_out_of_keys_where_they_change_nothing() {
        let env = json!({ "car-racing": {} });
        let later =
            ["normalize_observations", "normalize_reward", "precision", "counted", "algorithm", "thresholds"];
        let normal = |kind: &str, params: &serde_json::Value| {
            let kind = KINDS.iter().find(|other| other.name() == kind).unwrap();
            kind.normalize(params).unwrap()
        };
        for (kind, params) in [
            ("ppo", json!({ "env": env, "policy": "beta" })),
            ("evaluate", json!({ "env": env, "mode": "stochastic", "first_track_seed": 1 })),
            ("bc", json!({ "policy": "beta" })),
            ("ensemble", json!({})),
            ("dril", json!({ "env": env })),
        ] {
            let full = normal(kind, &params);
            // `dril` has had its `normalize_reward` from the beginning.
            let came_later = |field: &&&str| (kind, **field) != ("dril", "normalize_reward");
            assert!(later.iter().filter(came_later).all(|field| full.get(field).is_none()), "{kind}: {full}");
        }
        let said = json!({ "env": env, "policy": "beta", "precision": "fp32", "normalize_reward": false });
        assert_eq!(normal("ppo", &said), normal("ppo", &json!({ "env": env, "policy": "beta" })));
        let other = json!({ "env": env, "policy": "beta", "precision": "bf16", "normalize_reward": true });
        assert_eq!(normal("ppo", &other)["precision"], "bf16");
        assert_eq!(normal("ppo", &other)["normalize_reward"], true);
    }

    #[test]
    fn values_out_of_range_are_all_reported_at_once() {
        let params = json!({
            "env": { "car-racing": {} }, "policy": "beta", "gamma": 1.5, "envs": 0, "learning_rate": -1.0
        });
        let problems = KINDS[0].normalize(&params).unwrap_err();
        let mut paths: Vec<String> = problems.iter().map(|problem| problem.path.join(".")).collect();
        paths.sort();
        assert_eq!(paths, ["envs", "gamma", "learning_rate"]);
    }

    #[test]
    fn a_rollout_that_does_not_fill_its_minibatches_is_refused() {
        let params = json!({
            "env": { "car-racing": {} }, "policy": "beta", "envs": 1, "rollout_steps": 8, "minibatches": 32
        });
        let problems = KINDS[0].normalize(&params).unwrap_err();
        assert_eq!(problems[0].path, ["minibatches"]);
    }
}
