//! What a running stage sees of the world.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::{Job, Labels, Message, Progress, Seed, StageError, StreamRng};

/// At most this often a progress line is written.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);

/// One artifact at an input, with the labels of where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputItem<'a> {
    /// The file; read-only.
    pub path: &'a Path,
    /// Axis = value; empty for inputs that take one artifact.
    pub labels: &'a Labels,
}

/// All that a stage may use while it runs. There is no other way to the outside: no environment, no clock, no store.
pub struct Ctx<'a> {
    job: &'a Job,
    cancel: &'a AtomicBool,
    messages: &'a mut dyn Write,
    said: Option<Instant>,
    checkpointed: Instant,
}

impl<'a> Ctx<'a> {
    /// The context of `job`: stops when `cancel` becomes true, writes its messages to `messages`.
    pub fn new(job: &'a Job, cancel: &'a AtomicBool, messages: &'a mut dyn Write) -> Self {
        Self { job, cancel, messages, said: None, checkpointed: Instant::now() }
    }

    /// All that the stage was started with.
    pub fn job(&self) -> &'a Job {
        self.job
    }

    /// The stage's seed.
    pub fn seed(&self) -> Seed {
        self.job.seed
    }

    /// The random stream of that name. Two calls give the same numbers: draw from one, keep it.
    pub fn stream(&self, name: &str) -> StreamRng {
        self.job.seed.stream(name)
    }

    /// The one artifact at an input.
    ///
    /// # Errors
    /// There is none, or more than one.
    pub fn input(&self, port: &str) -> Result<&'a Path, StageError> {
        match self.job.inputs.get(port).map(Vec::as_slice) {
            Some([one]) => Ok(&one.path),
            Some(more) => {
                Err(StageError::Port(format!("input `{port}` has {} artifacts, expected one", more.len())))
            }
            None => Err(StageError::Port(format!("input `{port}` is not connected"))),
        }
    }

    /// The artifact at an input that may be left out.
    pub fn optional_input(&self, port: &str) -> Option<&'a Path> {
        match self.job.inputs.get(port).map(Vec::as_slice) {
            Some([one]) => Some(&one.path),
            _ => None,
        }
    }

    /// The artifacts at a fan-in, in the order of the matrix.
    pub fn inputs(&self, port: &str) -> Vec<InputItem<'a>> {
        let items = self.job.inputs.get(port).map_or(&[] as &[_], Vec::as_slice);
        items.iter().map(|item| InputItem { path: &item.path, labels: &item.labels }).collect()
    }

    /// The file to write for an output.
    ///
    /// # Errors
    /// The kind declares no such output.
    pub fn output(&self, port: &str) -> Result<&'a Path, StageError> {
        match self.job.outputs.get(port) {
            Some(output) => Ok(&output.path),
            None => Err(StageError::Port(format!("there is no output `{port}`"))),
        }
    }

    /// Says how far the stage is. Cheap to call at every step: most calls write nothing.
    pub fn progress(&mut self, step: u64, total: u64, unit: &str, note: impl FnOnce() -> String) {
        let due = self.said.is_none_or(|at| at.elapsed() >= PROGRESS_EVERY) || step == total;
        if due {
            self.said = Some(Instant::now());
            let progress = Progress { step, total, unit: unit.to_owned(), note: note() };
            // Nobody listening is no reason to stop working; a dead engine takes its stages with it in another way.
            let _ = writeln!(self.messages, "{}", Message::Progress(progress).to_line());
            let _ = self.messages.flush();
        }
    }

    /// True once the stage should save a checkpoint (where it keeps them) and return [`StageError::Cancelled`].
    pub fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// For stages without checkpoints: an error once the stage should stop.
    ///
    /// # Errors
    /// [`StageError::Cancelled`].
    pub fn stop_if_cancelled(&self) -> Result<(), StageError> {
        if self.cancelled() { Err(StageError::Cancelled) } else { Ok(()) }
    }

    /// A folder for this stage to work in. Made by whoever needs it, and removed once the stage has ended.
    pub fn scratch(&self) -> &'a Path {
        &self.job.scratch
    }

    /// A folder of this stage's own that outlives a kill. What the stage leaves here it finds again when the same work
    /// (equal key) is started anew; it is emptied once the stage is done.
    pub fn checkpoints(&self) -> &'a Path {
        &self.job.checkpoints
    }

    /// A folder for curves that people watch while the stage runs (`run --tensorboard`), to be made if need be; none
    /// where nobody does. What is written there is no result and may carry clock times.
    pub fn curves(&self) -> Option<&'a Path> {
        self.job.curves.as_deref()
    }

    /// Says what the result depends on besides inputs, parameters and seed, as in `("libtorch", "2.13.0")`: it is
    /// recorded with the result and enters no key.
    pub fn made_with(&mut self, what: &[(&str, &str)]) {
        let what = what.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned()));
        let _ = writeln!(self.messages, "{}", Message::MadeWith(what.collect()).to_line());
    }

    /// True when the last checkpoint is long enough ago, or the stage is being stopped. Starts the interval anew.
    pub fn checkpoint_due(&mut self) -> bool {
        let due = self.cancelled()
            || self.checkpointed.elapsed() >= Duration::from_secs_f64(self.job.checkpoint_seconds.max(0.0));
        if due {
            self.checkpointed = Instant::now();
        }
        due
    }

    /// Writes `bytes` to the output by one call.
    ///
    /// # Errors
    /// No such output, or the write fails.
    pub fn write_output(&self, port: &str, bytes: impl AsRef<[u8]>) -> Result<(), StageError> {
        let path: PathBuf = self.output(port)?.to_owned();
        std::fs::write(&path, bytes).map_err(StageError::io("cannot write", &path))
    }
}
