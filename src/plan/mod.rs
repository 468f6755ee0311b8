//! From a graph and a store to a plan: every stage's key where it can be known, and what would run, and why.
//! Reads records, runs nothing, writes nothing.

use std::collections::BTreeMap;

use crate::resolve::{Graph, StageIndex};
use crate::store::{Digest, Key, Record};

/// What will happen to each stage of a graph.
#[derive(Debug)]
pub struct Plan {
    /// The pipeline.
    pub graph: Graph,
    /// One verdict a stage, in topological order.
    pub steps: Vec<(StageIndex, Verdict)>,
    /// Digests of the files from outside, by path as resolved.
    pub files: BTreeMap<String, Digest>,
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
        /// The stages that will run and feed it directly or through others, nearest first.
        stages: Vec<StageIndex>,
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
    /// The record is there, but a file that it names is not.
    Lost {
        /// The output.
        output: String,
    },
}
