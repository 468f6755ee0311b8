//! The types of what flows between stages. A port names one; wiring two different ones is an error of the pipeline file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The type of what a port carries. Every artifact is one file, but for [`Artifact::Folder`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
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
    /// How a training run went, one row per logged step, update, epoch or episode (CSV).
    TrainingLog,
    /// A table of results (CSV or Markdown).
    Table,
    /// A figure of results.
    Figure,
    /// Any file; also what the pipeline file brings in from outside.
    File,
    /// A folder with all that is in it.
    Folder,
    /// For inputs only: whatever is wired there, a folder too.
    Any,
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
            Self::Folder => "folder",
            Self::Any => "any",
        }
    }

    /// True where an output of this type is a result that people read: `run` copies it to the results folder.
    pub fn is_result(self) -> bool {
        matches!(self, Self::Table | Self::Figure)
    }

    /// True where an output of this type may be wired to an input that takes `wanted`. A `File` input takes any file; a
    /// `File` output is trusted to be what the input says (the stage that reads it checks). A folder fits no file.
    pub fn fits(self, wanted: Artifact) -> bool {
        let files = self != Self::Folder && wanted != Self::Folder;
        wanted == Self::Any || self == wanted || files && (wanted == Self::File || self == Self::File)
    }

    /// The ending of a file of this type where nothing else is said, without the dot; empty for a folder.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Policy | Self::Ensemble => "safetensors",
            Self::Scores | Self::TrainingLog | Self::Table => "csv",
            Self::Figure => "svg",
            Self::Demonstrations | Self::File | Self::Any => "bin",
            Self::Folder => "",
        }
    }
}

impl std::fmt::Display for Artifact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_taken_for_no_file_and_a_file_for_no_folder() {
        assert!(Artifact::Folder.fits(Artifact::Folder) && Artifact::Folder.fits(Artifact::Any));
        assert!(!Artifact::Folder.fits(Artifact::File) && !Artifact::File.fits(Artifact::Folder));
        assert!(Artifact::File.fits(Artifact::Policy) && Artifact::Policy.fits(Artifact::File));
        assert!(!Artifact::Policy.fits(Artifact::Scores) && Artifact::Scores.fits(Artifact::Any));
    }
}
