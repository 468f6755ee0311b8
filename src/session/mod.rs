//! Runs a pipeline from Rust: everything that `dril-pipe run` does, without printing.
//!
//! [`Session`] is the entry point. `source` reads pipeline files, `run` has the steps of a run, `about` what its manifest says,
//! `lockfile` and `locking` the lock file, `results` the results folder, `noticed` the warnings, and `unchanged` recognises a run with
//! nothing to do.

mod about;
mod lockfile;
mod locking;
mod noticed;
mod program;
mod results;
mod run;
mod source;
mod unchanged;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use dril_stage_api::Registry;

use crate::error::Error;
use crate::exec::{Event, Options, Runner};
use crate::resolve::{Choices, Selection};
use crate::store::Store;
pub use lockfile::LockFile;
pub use locking::{LockMode, Rewritten};
pub use results::{Published, cut_names, default_folder, file_names};
pub use run::{Finished, Loaded, Prepared, Remaining};
pub use source::{PipelineSource, Reading};
use unchanged::RunFingerprint;
pub use unchanged::UpToDate;

/// A pipeline file, a store, and how to run one on the other.
///
/// ```
/// use dril_pipe::{Session, exec::InlineRunner, kinds};
/// use dril_stage_api::Registry;
/// # use std::sync::atomic::AtomicBool;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let folder = tempfile::tempdir()?;
/// # let file = folder.path().join("hello.yaml");
/// # let cache = folder.path().join("cache");
/// # let results = folder.path().join("results");
/// # std::fs::write(&file, "name: hello\nstages:\n  greet:\n    kind: command\n    with: { shell: 'echo Hello > {outputs.text}', outputs: { text: table } }\n")?;
/// let registry = Registry::new(kinds::KINDS)?;
/// let session = Session::new(&file, &cache, &registry)?.results_folder(&results);
/// let runner = InlineRunner { registry: registry.clone() };
/// let stop = AtomicBool::new(false);
/// let run = session.run(&runner, &stop, &mut |event| println!("{event:?}"))?;
/// assert!(run.is_complete());
/// assert_eq!(run.executed.outcome.ran, 1);
/// # Ok(())
/// # }
/// ```
///
/// `InlineRunner` runs stages inside this process. [`crate::exec::ChildRunner`] runs each stage in a child process, as the
/// command line does; the program must then answer `__stage JOB` ([`crate::exec::run_stage`]) and `__warden`
/// ([`crate::exec::watch_over`]).
pub struct Session<'r> {
    registry: &'r Registry,
    source: PipelineSource,
    store: Store,
    selection: Selection,
    out: Option<PathBuf>,
    lock: LockMode,
    options: Options,
}

impl<'r> Session<'r> {
    /// A session for a pipeline file and the store in folder `cache`, with the file's first profile. Reads nothing yet.
    ///
    /// # Errors
    /// The store's path is not a folder.
    pub fn new(file: &Path, cache: &Path, registry: &'r Registry) -> Result<Self, Error> {
        let source = PipelineSource::new(file, Choices::default());
        Ok(Self::with(source, Store::open(cache)?, registry))
    }

    /// A session for a pipeline with these choices on a store that is open.
    pub fn with(source: PipelineSource, store: Store, registry: &'r Registry) -> Self {
        Self {
            registry,
            source,
            store,
            selection: Selection::default(),
            out: None,
            lock: LockMode::default(),
            options: Options::default(),
        }
    }

    /// Sets the profile, overrides, and the environment that `command` stages may read.
    #[must_use]
    pub fn choices(mut self, choices: Choices) -> Self {
        self.source.choices = choices;
        self
    }

    /// Restricts the run to these stages; without it, all run.
    #[must_use]
    pub fn selection(mut self, selection: Selection) -> Self {
        self.selection = selection;
        self
    }

    /// Sets the folder for tables and figures; without it, `results/<pipeline>-<profile>` in the current folder.
    #[must_use]
    pub fn results_folder(mut self, folder: impl Into<PathBuf>) -> Self {
        self.out = Some(folder.into());
        self
    }

    /// Sets what the run does with the lock file.
    #[must_use]
    pub fn lock(mut self, lock: LockMode) -> Self {
        self.lock = lock;
        self
    }

    /// Sets threads, deadline, resources and what to do after a failure.
    #[must_use]
    pub fn options(mut self, options: Options) -> Self {
        self.options = options;
        self
    }

    /// The pipeline file and the choices.
    pub fn source(&self) -> &PipelineSource {
        &self.source
    }

    /// The store.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Recognises a run with nothing to do without reading the pipeline: `Some` if everything that decides about the last
    /// complete run is unchanged. `None` does not mean that a stage is stale.
    ///
    /// # Errors
    /// The store or the results folder cannot be read.
    pub fn up_to_date(&self) -> Result<Option<UpToDate>, Error> {
        match self.fingerprint() {
            Some(fingerprint) => fingerprint.look_up(&self.source, &self.store),
            None => Ok(None),
        }
    }

    /// Reads and resolves the pipeline.
    ///
    /// # Errors
    /// All problems of the pipeline file, each with its place.
    pub fn load(&self) -> Result<Loaded<'_>, Error> {
        Loaded::new(self)
    }

    /// Brings every selected stage up to date and copies the results: [`Session::load`], [`Loaded::plan`],
    /// [`Loaded::prepare`] and [`Prepared::execute`] in one.
    ///
    /// # Errors
    /// The pipeline file is wrong, a precondition does not hold, or the run could not start or continue. Failed stages are
    /// no error: they are events and are counted in the result.
    pub fn run(
        &self,
        runner: &dyn Runner,
        stop: &AtomicBool,
        sink: &mut dyn FnMut(&Event),
    ) -> Result<Finished, Error> {
        let loaded = self.load()?;
        let plan = loaded.plan()?;
        loaded.prepare(plan)?.execute(runner, stop, sink)
    }

    fn fingerprint(&self) -> Option<RunFingerprint> {
        // Without `..`: who adds a setting must decide here whether it can make a difference.
        let Self { registry: _, source, store: _, selection, out, lock, options: _ } = self;
        RunFingerprint::of(source, selection, *lock, out.as_deref())
    }
}
