//! The types of what flows between stages. A port names one; wiring two different ones is an error of the pipeline file.

use serde::{Deserialize, Serialize};

/// The type of what a port carries. Every artifact is one file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Artifact {
    /// The weights of an agent that can act (safetensors with its architecture in the metadata).
    Policy,
    /// Recorded episodes: observations and the actions an expert took.
    Demonstrations,
    /// The weights of an ensemble of policies (safetensors).
    Ensemble,
    /// One row per evaluated episode (see [`crate::scores`]).
    Scores,
    /// How a training run went, one row per logged step (CSV).
    TrainingLog,
    /// A table of results (CSV or Markdown).
    Table,
    /// A figure of results.
    Figure,
    /// Any file; also what the pipeline file brings in from outside.
    File,
}

impl Artifact {
    /// The name used in messages and in `dril-pipe kinds`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Policy => "policy",
            Self::Demonstrations => "demonstrations",
            Self::Ensemble => "ensemble",
            Self::Scores => "scores",
            Self::TrainingLog => "training-log",
            Self::Table => "table",
            Self::Figure => "figure",
            Self::File => "file",
        }
    }

    /// True where an output of this type is a result that people read: `run` copies it to the results folder.
    pub fn is_result(self) -> bool {
        matches!(self, Self::Table | Self::Figure)
    }

    /// True where an output of this type may be wired to an input that takes `wanted`. A `File` input takes anything;
    /// a `File` output is trusted to be what the input says (the stage that reads it checks).
    pub fn fits(self, wanted: Artifact) -> bool {
        self == wanted || wanted == Self::File || self == Self::File
    }
}

impl std::fmt::Display for Artifact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
