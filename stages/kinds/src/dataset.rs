//! `dataset`: packs recorded episodes into what the imitators learn from.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Takes the first episodes of a recording and brings their actions into [-1, 1].
#[derive(Clone, Copy, Debug)]
pub struct Dataset;

/// What is done with actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ActionRange {
    /// Actions of an unbounded policy are clipped to [-1, 1].
    Clipped,
    /// Actions must lie in [-1, 1] already, as a Beta policy's do; others are an error.
    Bounded,
    /// Actions stay as they are.
    Raw,
}

/// What stands under `with:` of a `dataset` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetParams {
    /// What is done with actions.
    pub actions: ActionRange,
    /// How many episodes, from the first on: smaller sets are part of larger ones, as in the thesis.
    pub trajectories: u64,
}

impl Describe for Dataset {
    const KIND: &'static str = "dataset";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "takes the first episodes of a recording, with actions in [-1, 1]";
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
            "the set to learn from",
        )
    }

    fn needs(params: &DatasetParams) -> Needs {
        Needs::seconds(1.0 + 0.1 * params.trajectories as f64)
    }
}
