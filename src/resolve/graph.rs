//! The resolved pipeline: connected stage instances with checked parameters. All later phases work on it.

use std::sync::Arc;

use dril_stage_api::{Kind, Labels, Needs, Output, Ports, Seed};
use petgraph::graph::{DiGraph, NodeIndex};
use serde_json::Value;

use crate::spec::{Limits, Resources};

/// The index of a stage instance in its graph.
pub type StageIndex = NodeIndex<u32>;

/// A resolved pipeline. Acyclic; node order is file order, then matrix order, and never depends on maps or threads.
#[derive(Clone, Debug)]
pub struct Graph {
    /// The pipeline's name.
    pub pipeline: String,
    /// The profile that it was resolved with.
    pub profile: String,
    /// Stages without any instance, because their `when` is false, in the order of the file.
    pub left_out: Vec<Arc<str>>,
    /// Axes that `--set` added to stages, as in `--set dril.quantile=0.95,0.98`.
    pub sweeps: Vec<Arc<str>>,
    /// Stage instances; an edge runs from a stage to one that reads its outputs.
    pub stages: DiGraph<StageInstance, (), u32>,
}

/// One stage instance.
#[derive(Clone, Debug)]
pub struct StageInstance {
    /// The stage's name in the file.
    pub name: Arc<str>,
    /// Name and coordinates: `dril[expert=clipped, policy=beta, demonstrations=1]`; unique in the graph.
    pub id: Arc<str>,
    /// Axis = value, in the order of the stage's matrix.
    pub coordinates: Vec<(String, String)>,
    /// The kind.
    pub kind: Kind,
    /// Normalised parameters: defaults filled in, checked.
    pub params: Value,
    /// The seed; `None` where the kind is not seeded.
    pub seed: Option<Seed>,
    /// The threads and the cost that it needs.
    pub needs: Needs,
    /// Timeout, memory limit and retries; never part of the key.
    pub limits: Limits,
    /// The units of counted resources that it needs, as `gpu: 1`; never part of the key.
    pub resources: Resources,
    /// Its ports under these parameters.
    pub ports: Ports,
    /// The sources of each input, in the order of the ports. Unconnected optional inputs are absent.
    pub inputs: Vec<Wire>,
}

/// The sources of one input.
#[derive(Clone, Debug)]
pub struct Wire {
    /// The input's name.
    pub port: &'static str,
    /// True where the input takes many: then labels are part of the key.
    pub many: bool,
    /// The artifacts, in the order of the matrix.
    pub sources: Vec<Source>,
}

/// A source of an input.
#[derive(Clone, Debug)]
pub struct Source {
    /// The stage output or file.
    pub from: Origin,
    /// Axis = value of the instance it comes from, plus `name` in a named fan-in. Empty for inputs that take one.
    pub labels: Labels,
}

/// The origin of an artifact.
#[derive(Clone, Debug)]
pub enum Origin {
    /// An output of a stage instance.
    Stage {
        /// Which instance.
        stage: StageIndex,
        /// Which output.
        output: &'static str,
    },
    /// A file or folder from outside, relative to the pipeline file's folder unless absolute.
    File {
        /// As written in the pipeline file.
        path: String,
        /// `thesis.yaml:14:9`, for messages.
        place: String,
        /// True for a folder.
        folder: bool,
        /// The digest that it must have, in hexadecimal digits.
        blake3: Option<String>,
        /// Globs that are excluded from a folder.
        exclude: Vec<String>,
        /// Identifies it: the path, whether it is a folder, and the exclude globs.
        key: String,
    },
}

impl Origin {
    /// Identifies it: the instance's number and the output, or the path.
    pub(super) fn identity(&self) -> (usize, &str) {
        match self {
            Self::Stage { stage, output } => (stage.index(), output),
            Self::File { path, .. } => (usize::MAX, path),
        }
    }
}

impl StageInstance {
    /// The coordinates as labels.
    pub fn labels(&self) -> Labels {
        self.coordinates.iter().cloned().collect()
    }

    /// A file name for its results: `table22`, or `curve-clipped-1` for an instance of a matrix.
    pub fn file_stem(&self) -> String {
        file_stem(&self.name, self.coordinates.iter().map(|(_, value)| value.as_str()))
    }

    /// The outputs that go to the results folder, and their file names there.
    pub fn result_files(&self) -> Vec<(&Output, String)> {
        result_files(&self.file_stem(), &self.ports.outputs).collect()
    }
}

/// The file name of an instance of stage `name` with these values; characters that file names cannot have become `_`.
pub(super) fn file_stem<'v>(name: &str, values: impl Iterator<Item = &'v str>) -> String {
    let mut stem = name.to_owned();
    for value in values {
        stem.push('-');
        stem.extend(value.chars().map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' }));
    }
    stem
}

/// The file names of the results among `outputs`, for an instance with this stem. Where several have one extension, each has its
/// own name in it, so that another output renames none of them. One that is named like its extension (`csv`) is the main one.
pub(super) fn result_files<'o>(
    stem: &str,
    outputs: &'o [Output],
) -> impl Iterator<Item = (&'o Output, String)> {
    let results = || outputs.iter().filter(|output| output.artifact.is_result());
    results().map(move |output| {
        let alike = results().filter(|other| other.extension == output.extension).count();
        let name = if alike == 1 || output.name == output.extension {
            String::new()
        } else {
            format!("-{}", output.name)
        };
        (output, file_name(stem, &format!("{name}.{}", output.extension)))
    })
}

/// The maximum length of a file name in bytes on nearly every file system.
const LONGEST_NAME: usize = 255;

/// A file name from a stem and an ending. If it is too long, the stem is cut between two characters, and a digest of the whole
/// keeps it unique.
pub fn file_name(stem: &str, rest: &str) -> String {
    if stem.len() + rest.len() <= LONGEST_NAME {
        return format!("{stem}{rest}");
    }
    let digits = &blake3::hash(stem.as_bytes()).to_hex()[..12];
    let room = LONGEST_NAME.saturating_sub(rest.len() + digits.len() + 1);
    let end = (0..=room).rev().find(|at| stem.is_char_boundary(*at)).unwrap_or(0);
    format!("{}-{digits}{rest}", &stem[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_too_long_for_a_file_is_cut_between_characters_and_stays_apart_from_others() {
        assert_eq!(file_name("table", "-t.csv"), "table-t.csv");
        let long = "語".repeat(100);
        let (one, other) = (file_name(&long, ".csv"), file_name(&format!("{long}x"), ".csv"));
        for name in [&one, &other] {
            assert!((250..=255).contains(&name.len()) && name.ends_with(".csv"), "{name}");
        }
        assert_ne!(one, other);
        assert_eq!(file_name(&"a".repeat(251), ".csv").len(), 255);
    }
}
