//! `dataset`: selects recorded episodes to learn from.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Takes the first episodes of a recording, with actions in [-1, 1].
#[derive(Clone, Copy, Debug)]
pub struct Dataset;

/// How actions are brought into range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ActionRange {
    /// Clips actions to [-1, 1]; for recordings of a policy with unbounded actions.
    Clipped,
    /// Requires that actions are in [-1, 1], as those of a Beta policy; others are an error.
    Bounded,
    /// Leaves actions unchanged.
    Raw,
}

/// Parameters of a `dataset` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetParams {
    /// How actions are brought into range.
    pub actions: ActionRange,
    /// Number of episodes (trajectories), from the first. A smaller dataset is a subset of a larger one, as in the thesis.
    pub trajectories: u64,
}

impl Describe for Dataset {
    const KIND: &'static str = "dataset";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "selects the first episodes of a recording, with actions in [-1, 1]";
    const SEEDED: bool = false;
    type Params = DatasetParams;

    fn check(params: &DatasetParams, problems: &mut Problems) {
        problems.positive("trajectories", params.trajectories);
    }

    fn ports(_: &DatasetParams) -> Ports {
        Ports::new().input("demonstrations", DEMONSTRATIONS, "the recording").output(
            "demonstrations",
            DEMONSTRATIONS,
            "demos",
            "the selected episodes",
        )
    }

    fn needs(params: &DatasetParams) -> Needs {
        Needs::seconds(1.0 + 0.1 * params.trajectories as f64)
    }
}
