//! Test support for stage packages: runs a stage in a temporary folder, without an engine.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use serde_json::Value;

use crate::{Ctx, Job, JobInput, JobOutput, Kind, Labels, Message, Progress, Seed, Stage, StageError};

/// A stage in a temporary folder.
pub struct Bench {
    folder: tempfile::TempDir,
    kind: Kind,
    job: Job,
    /// Set to true to ask the stage to stop.
    pub cancel: AtomicBool,
}

impl Bench {
    /// Sets up `S` with `params` (normalised first) and `seed`.
    ///
    /// # Errors
    /// Invalid parameters, or the temporary folder cannot be created.
    pub fn new<S: Stage>(params: &Value, seed: u64) -> Result<Self, StageError> {
        let kind = Kind::of::<S>();
        let params = kind.normalize(params).map_err(StageError::params)?;
        let ports = kind.ports(&params).map_err(StageError::params)?;
        let folder =
            tempfile::tempdir().map_err(StageError::io("cannot make a folder in", &std::env::temp_dir()))?;
        let checkpoints = folder.path().join("checkpoints");
        std::fs::create_dir(&checkpoints).map_err(StageError::io("cannot make", &checkpoints))?;
        let outputs = ports.outputs.iter().map(|output| {
            let path = folder.path().join(format!("{}.{}", output.name, output.extension));
            (output.name.to_owned(), JobOutput { path })
        });
        let job = Job {
            stage: kind.name().to_owned(),
            kind: kind.name().to_owned(),
            revision: kind.revision(),
            params,
            seed: Seed(seed),
            inputs: BTreeMap::new(),
            outputs: outputs.collect(),
            scratch: folder.path().join("scratch"),
            checkpoints,
            checkpoint_seconds: 120.0,
            curves: None,
        };
        Ok(Self { folder, kind, job, cancel: AtomicBool::new(false) })
    }

    /// Connects a file to an input; several calls make a fan-in.
    #[must_use]
    pub fn input(mut self, port: &str, path: &Path, labels: &[(&str, &str)]) -> Self {
        let labels: Labels =
            labels.iter().map(|(axis, value)| ((*axis).to_owned(), (*value).to_owned())).collect();
        self.job.inputs.entry(port.to_owned()).or_default().push(JobInput { path: path.to_owned(), labels });
        self
    }

    /// Sets the seconds between checkpoints; 0: as often as possible.
    #[must_use]
    pub fn checkpoint_seconds(mut self, seconds: f64) -> Self {
        self.job.checkpoint_seconds = seconds;
        self
    }

    /// Sets the folder for training curves.
    #[must_use]
    pub fn curves(mut self, folder: &Path) -> Self {
        self.job.curves = Some(folder.to_owned());
        self
    }

    /// The job, as the engine would write it.
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Runs the stage and returns its progress messages.
    ///
    /// # Errors
    /// The stage fails, or does not write all its outputs.
    pub fn run(&self) -> Result<Vec<Progress>, StageError> {
        let mut lines = Vec::new();
        self.kind.run(&self.job.params, &mut Ctx::new(&self.job, &self.cancel, &mut lines))?;
        for (name, output) in &self.job.outputs {
            if !output.path.is_file() {
                return Err(StageError::Port(format!("output `{name}` was not written")));
            }
        }
        let text = String::from_utf8_lossy(&lines).into_owned();
        Ok(text
            .lines()
            .filter_map(|line| match Message::from_line(line) {
                Some(Message::Progress(progress)) => Some(progress),
                _ => None,
            })
            .collect())
    }

    /// The file of an output.
    ///
    /// # Errors
    /// The kind declares no such output.
    pub fn output(&self, port: &str) -> Result<PathBuf, StageError> {
        match self.job.outputs.get(port) {
            Some(output) => Ok(output.path.clone()),
            None => Err(StageError::Port(format!("there is no output `{port}`"))),
        }
    }

    /// A folder for files of the test.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }
}
