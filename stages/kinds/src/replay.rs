//! The subcommand `replay`: a video of an episode that a policy plays. `dril-learn` does the work.

use dril_stage_api::{Tool, ToolOption, ToolValue};

use crate::WORKER;
use crate::artifacts::POLICY;

/// `dril-pipe replay`.
pub const REPLAY: Tool = Tool {
    name: "replay",
    about: "Write a video of an episode that a policy plays",
    examples: &[
        "dril-pipe replay pipelines/thesis.yaml:dril.peak[policy=beta] --profile desk --seed 7 --out lap.gif",
        "dril-pipe replay policy.safetensors --env '{ gymnasium: CarRacing-v3 }' --out lap.apng",
    ],
    artifact: POLICY,
    value_name: "POLICY",
    artifact_about: "A policy file, or a finished stage of a pipeline, as in `pipelines/thesis.yaml:dril.peak[policy=beta]`",
    artifact_example: "pipelines/thesis.yaml:dril.peak[policy=beta]",
    options: &[
        ToolOption::new(
            "seed",
            ToolValue::Count,
            "2000000",
            "Seed of the track or level, and of a stochastic policy",
        ),
        ToolOption::required(
            "out",
            ToolValue::NewFile(
                &["gif", "apng", "png"],
                "`.gif` and `.apng` are videos, `.png` is six moments side by side",
            ),
            "The file to write: a video (`.gif`, `.apng`), or six moments side by side (`.png`)",
        ),
        ToolOption::from_stage(
            "env",
            ToolValue::Yaml("{ car-racing: { version: v3 } }"),
            "The environment, as in a pipeline file [default: that of the stage, or the one that fits the policy]",
        ),
        ToolOption::new(
            "mode",
            ToolValue::Choice(&["deterministic", "stochastic"]),
            "stochastic",
            "Whether actions are the mean of the policy's distribution or samples from it",
        ),
        ToolOption::new("width", ToolValue::Count, "480", "Width of a frame in pixels"),
        ToolOption::new("every", ToolValue::Count, "2", "Draw every Nth step"),
        ToolOption::new("speed", ToolValue::Number, "1", "Playback speed, relative to real time"),
    ],
    worker: WORKER,
    service: "__replay",
};
