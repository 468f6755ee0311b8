//! The context of a running stage: its only access to the outside.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::{Job, Labels, Message, Progress, Seed, StageError, StreamRng};

/// Minimum time between two progress messages.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);

/// One artifact at an input, with the labels of the stage instance that it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputItem<'a> {
    /// The file; read-only.
    pub path: &'a Path,
    /// Axis = value; empty for inputs that accept a single artifact.
    pub labels: &'a Labels,
}

/// Everything a stage may use while it runs: it has no access to environment variables, the clock or the store.
pub struct Ctx<'a> {
    job: &'a Job,
    cancel: &'a AtomicBool,
    messages: &'a mut dyn Write,
    said: Option<Instant>,
    checkpointed: Instant,
}

impl<'a> Ctx<'a> {
    /// The context of `job`. Setting `cancel` asks the stage to stop; messages to the engine are written to `messages`.
    pub fn new(job: &'a Job, cancel: &'a AtomicBool, messages: &'a mut dyn Write) -> Self {
        Self { job, cancel, messages, said: None, checkpointed: Instant::now() }
    }

    /// The job that the stage was started with.
    pub fn job(&self) -> &'a Job {
        self.job
    }

    /// The stage's seed.
    pub fn seed(&self) -> Seed {
        self.job.seed
    }

    /// The random stream of that name. Two calls return the same numbers, so create a stream once and keep it.
    pub fn stream(&self, name: &str) -> StreamRng {
        self.job.seed.stream(name)
    }

    /// The artifact at an input that accepts exactly one.
    ///
    /// # Errors
    /// The input is not connected, or has several artifacts.
    pub fn input(&self, port: &str) -> Result<&'a Path, StageError> {
        match self.job.inputs.get(port).map(Vec::as_slice) {
            Some([one]) => Ok(&one.path),
            Some(more) => {
                Err(StageError::Port(format!("input `{port}` has {} artifacts, expected one", more.len())))
            }
            None => Err(StageError::Port(format!("input `{port}` is not connected"))),
        }
    }

    /// The artifact at an optional input.
    pub fn optional_input(&self, port: &str) -> Option<&'a Path> {
        match self.job.inputs.get(port).map(Vec::as_slice) {
            Some([one]) => Some(&one.path),
            _ => None,
        }
    }

    /// The artifacts at a fan-in input, in matrix order.
    pub fn inputs(&self, port: &str) -> Vec<InputItem<'a>> {
        let items = self.job.inputs.get(port).map_or(&[] as &[_], Vec::as_slice);
        items.iter().map(|item| InputItem { path: &item.path, labels: &item.labels }).collect()
    }

    /// The path at which to write an output.
    ///
    /// # Errors
    /// The kind declares no such output.
    pub fn output(&self, port: &str) -> Result<&'a Path, StageError> {
        match self.job.outputs.get(port) {
            Some(output) => Ok(&output.path),
            None => Err(StageError::Port(format!("there is no output `{port}`"))),
        }
    }

    /// Reports progress. Cheap enough to call at every step: messages are rate-limited.
    pub fn progress(&mut self, step: u64, total: u64, unit: &str, note: impl FnOnce() -> String) {
        let due = self.said.is_none_or(|at| at.elapsed() >= PROGRESS_EVERY) || step == total;
        if due {
            self.said = Some(Instant::now());
            let progress = Progress { step, total, unit: unit.to_owned(), note: note() };
            // A closed pipe does not stop the stage: if the engine died, its stages are killed in another way.
            let _ = writeln!(self.messages, "{}", Message::Progress(progress).to_line());
            let _ = self.messages.flush();
        }
    }

    /// True once the stage should save a checkpoint (if it supports them) and return [`StageError::Cancelled`].
    pub fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Returns an error once the stage should stop; for stages without checkpoints.
    ///
    /// # Errors
    /// [`StageError::Cancelled`].
    pub fn stop_if_cancelled(&self) -> Result<(), StageError> {
        if self.cancelled() { Err(StageError::Cancelled) } else { Ok(()) }
    }

    /// A working folder for temporary files. The stage creates it if needed; it is removed when the stage ends.
    pub fn scratch(&self) -> &'a Path {
        &self.job.scratch
    }

    /// A folder for checkpoints, which survives a kill. Files here are found again when the same work (equal key) is
    /// restarted; the folder is emptied once the stage is done.
    pub fn checkpoints(&self) -> &'a Path {
        &self.job.checkpoints
    }

    /// A folder for live training curves (`run --tensorboard`), to be created if needed; none if not requested. Files here
    /// are not results and may contain wall-clock times.
    pub fn curves(&self) -> Option<&'a Path> {
        self.job.curves.as_deref()
    }

    /// Records what the result was made with, as in `("libtorch", "2.13.0")`. It is stored with the result and is not part
    /// of the key.
    pub fn made_with(&mut self, what: &[(&str, &str)]) {
        let what = what.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
        let _ = writeln!(self.messages, "{}", Message::MadeWith(what.collect()).to_line());
    }

    /// True if a checkpoint is due: the checkpoint interval has passed, or the stage is being stopped. Restarts the
    /// interval.
    pub fn checkpoint_due(&mut self) -> bool {
        let due = self.cancelled()
            || self.checkpointed.elapsed() >= Duration::from_secs_f64(self.job.checkpoint_seconds.max(0.0));
        if due {
            self.checkpointed = Instant::now();
        }
        due
    }

    /// Writes `bytes` to an output.
    ///
    /// # Errors
    /// No such output, or the write fails.
    pub fn write_output(&self, port: &str, bytes: impl AsRef<[u8]>) -> Result<(), StageError> {
        let path: PathBuf = self.output(port)?.to_owned();
        std::fs::write(&path, bytes).map_err(StageError::io("cannot write", &path))
    }
}
