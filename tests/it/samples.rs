//! Stage kinds with the ports and parameters of a small imitation-learning experiment, for tests of pipeline files.
//! They are described only: nothing here runs.
#![allow(dead_code)]

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, Kind, Ports, Problems, Registry, Stage, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Artifact types, as a stage package would define them.
const POLICY: Artifact = Artifact::new("policy", "safetensors");
const DEMONSTRATIONS: Artifact = Artifact::new("demonstrations", "bin");

/// The kinds.
pub const KINDS: [Kind; 5] = [
    Kind::of::<Train>(),
    Kind::of::<Record>(),
    Kind::of::<Imitate>(),
    Kind::of::<Score>(),
    Kind::of::<Tabulate>(),
];

/// The registry of the kinds.
pub fn registry() -> Registry {
    dril_stage_api::artifact::register(&[POLICY, DEMONSTRATIONS]).unwrap();
    Registry::new([&KINDS[..], &dril_pipe::kinds::KINDS].concat()).unwrap()
}

/// Trains an expert.
pub struct Train;

/// Parameters of `train`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainParams {
    steps: u64,
    #[serde(default = "small")]
    learning_rate: f64,
    #[serde(default)]
    policy: Policy,
    #[serde(default)]
    env: Env,
    #[serde(default)]
    layers: Vec<u32>,
    #[serde(default)]
    anneal: bool,
}

fn small() -> f64 {
    3e-4
}

/// A policy's form.
#[derive(Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Policy {
    #[default]
    Gaussian,
    Beta,
}

/// An environment with its settings.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Env {
    Track(Track),
    Maze(Maze),
}

impl Default for Env {
    fn default() -> Self {
        Self::Track(Track { laps: 1 })
    }
}

/// Settings of a track.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Track {
    #[serde(default = "one")]
    laps: u32,
}

/// Settings of a maze.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Maze {
    size: u32,
}

fn one() -> u32 {
    1
}

impl Describe for Train {
    const KIND: &'static str = "train";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "trains an expert";
    const RENAMED: &'static [(&'static str, &'static str)] = &[("rate", "learning_rate")];
    const REMOVED: &'static [(&'static str, &'static str)] =
        &[("momentum", "leave it out: Adam has its own")];
    type Params = TrainParams;

    fn check(params: &TrainParams, problems: &mut Problems) {
        problems.positive("steps", params.steps);
        problems.positive_number("learning_rate", params.learning_rate);
        if let Env::Track(track) = &params.env {
            problems.positive("env.track.laps", track.laps.into());
        }
    }

    fn ports(_: &TrainParams) -> Ports {
        Ports::new().output("policy", POLICY, "safetensors", "the expert").output(
            "log",
            Artifact::TRAINING_LOG,
            "csv",
            "how it went",
        )
    }
}

/// Records an expert.
pub struct Record;

/// Parameters of `record`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordParams {
    #[serde(default = "one")]
    episodes: u32,
}

impl Describe for Record {
    const KIND: &'static str = "record";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "records an expert";
    type Params = RecordParams;

    fn check(params: &RecordParams, problems: &mut Problems) {
        problems.positive("episodes", params.episodes.into());
    }

    fn ports(_: &RecordParams) -> Ports {
        Ports::new().input("policy", POLICY, "who acts").output(
            "demonstrations",
            DEMONSTRATIONS,
            "zst",
            "what it did",
        )
    }
}

/// Imitates an expert.
pub struct Imitate;

/// Parameters of `imitate`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImitateParams {
    #[serde(default = "one")]
    epochs: u32,
    #[serde(default)]
    policy: Policy,
}

impl Describe for Imitate {
    const KIND: &'static str = "imitate";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "imitates an expert";
    type Params = ImitateParams;

    fn ports(_: &ImitateParams) -> Ports {
        Ports::new()
            .input("demonstrations", DEMONSTRATIONS, "whom to imitate")
            .output("best", POLICY, "safetensors", "the best weights")
            .output("last", POLICY, "safetensors", "the last weights")
    }
}

/// Scores a policy.
pub struct Score;

/// Parameters of `score`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreParams {
    #[serde(default = "one")]
    episodes: u32,
    #[serde(default)]
    mode: String,
}

impl Describe for Score {
    const KIND: &'static str = "score";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "scores a policy";
    type Params = ScoreParams;

    fn ports(_: &ScoreParams) -> Ports {
        Ports::new().input("policy", POLICY, "who acts").output(
            "scores",
            Artifact::SCORES,
            "csv",
            "one row an episode",
        )
    }
}

/// Makes a table.
pub struct Tabulate;

/// Parameters of `tabulate`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TabulateParams {
    #[serde(default)]
    title: String,
    #[serde(default)]
    columns: Vec<String>,
}

impl Describe for Tabulate {
    const KIND: &'static str = "tabulate";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "makes a table";
    const SEEDED: bool = false;
    type Params = TabulateParams;

    fn check_labels(params: &TabulateParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        for (n, column) in params.columns.iter().enumerate() {
            inputs.require("scores", column, &format!("columns.{n}"), problems);
        }
    }

    fn ports(_: &TabulateParams) -> Ports {
        Ports::new()
            .many("scores", Artifact::SCORES, "the cells")
            .optional("reference", Artifact::FILE, "numbers to compare with")
            .output("table", Artifact::TABLE, "csv", "the table")
    }
}

macro_rules! never_runs {
    ($($kind:ty),*) => {$(
        impl Stage for $kind {
            type Kind = Self;
            fn run(_: &<Self as Describe>::Params, _: &mut Ctx<'_>) -> Result<(), StageError> {
                Err(StageError::failed("this kind is for tests of pipeline files only"))
            }
        }
    )*};
}

never_runs!(Train, Record, Imitate, Score, Tabulate);
