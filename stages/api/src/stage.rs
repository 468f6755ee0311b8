//! The two traits of a stage kind: its declaration ([`Describe`]), and its work ([`Stage`]).
//!
//! They are separate so that a program can plan with a kind without linking the libraries it runs on. `dril-pipe`
//! describes the learning kinds (package `dril-kinds`) and starts another executable to run them: merely loading libtorch
//! takes a quarter of a second and 120 MB, which would slow down every `plan`, cached `run` and table.

use std::process::{Command, ExitStatus};

use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::{Ctx, FanIns, Job, Needs, Part, Ports, Problems, StageError};

/// The declaration of a stage kind: name, parameters, ports.
pub trait Describe: 'static {
    /// The name after `kind:` in the pipeline file, in kebab-case.
    const KIND: &'static str;
    /// Raised when equal inputs give other outputs than before, which makes all cached results of the kind stale.
    const REVISION: u32;
    /// One-line description, shown by `dril-pipe kinds`.
    const ABOUT: &'static str;
    /// False if the stage draws no random numbers; the seed is then not part of its key.
    const SEEDED: bool = true;

    /// The parameter whose empty values are filled in from environment variables: a map of variables. Their values are part
    /// of the key.
    const ENVIRONMENT: Option<&'static str> = None;

    /// The parameter with the names of further environment variables that the stage's program gets, whose values are not part
    /// of the key: a list of names. On another machine the program gets the values of the run.
    const PASSED: Option<&'static str> = None;

    /// Structs that are flattened into the parameters (`#[serde(flatten)]`), so that their invalid fields are reported by
    /// name. A flattened struct must not contain another one.
    const FLATTENED: &'static [Part] = &[];
    /// Renamed parameters, (old, new): using the old name is an error that names the new one.
    const RENAMED: &'static [(&'static str, &'static str)] = &[];
    /// Removed parameters, with a hint what to do instead.
    const REMOVED: &'static [(&'static str, &'static str)] = &[];
    /// Parameters whose numbers, at any depth, are kept as text exactly as written: 3.10 stays 3.10.
    const TEXTS: &'static [&'static str] = &[];

    /// The parameters (`with:`). They must deny unknown fields (`#[serde(deny_unknown_fields)]`) and mark defaults with
    /// `#[serde(default)]`; `dril-pipe kinds` shows their doc comments.
    type Params: DeserializeOwned + Serialize + JsonSchema;

    /// Reports every value of the right type that is out of range.
    fn check(params: &Self::Params, problems: &mut Problems) {
        let _ = (params, problems);
    }

    /// Brings notations with the same meaning to one form, so that equal stages have equal keys. Called after
    /// [`Describe::check`].
    fn unify(params: &mut Self::Params) {
        let _ = params;
    }

    /// Reports labels, and columns of CSV files, in the parameters that the artifacts at the inputs do not have. Called once the
    /// stage is connected, before anything runs, so it must report only what is certain to fail: a name that may be a column of
    /// a file is not.
    fn check_labels(params: &Self::Params, inputs: &FanIns<'_>, problems: &mut Problems) {
        let _ = (params, inputs, problems);
    }

    /// A text as the parameters of the kind have to write it, so that it stays as it is: for a kind that replaces placeholders
    /// in texts. The values of [`Describe::ENVIRONMENT`] are written in this way.
    fn literal(text: &str) -> String {
        text.to_owned()
    }

    /// The inputs and outputs.
    fn ports(params: &Self::Params) -> Ports;

    /// True if a stage with these parameters draws random numbers.
    fn seeded(params: &Self::Params) -> bool {
        let _ = params;
        Self::SEEDED
    }

    /// Resource needs.
    fn needs(params: &Self::Params) -> Needs {
        let _ = params;
        Needs::default()
    }
}

/// The work of a stage kind: a function from parameters, seed and inputs to outputs, without state.
///
/// Its result may depend only on the parameters, the seed, and the contents and labels of its inputs: not on time, host,
/// thread count or the order of other stages. The engine's cache relies on this.
///
/// A kind without heavy dependencies implements both traits on one type (`type Kind = Self`).
pub trait Stage: 'static {
    /// The declaration of the kind.
    type Kind: Describe;

    /// Runs the stage: reads `ctx.input(..)`, writes every `ctx.output(..)`.
    ///
    /// # Errors
    /// [`StageError::Cancelled`] after a clean stop on `ctx.cancelled()`; any other error is a failure of the stage.
    fn run(params: &<Self::Kind as Describe>::Params, ctx: &mut Ctx<'_>) -> Result<(), StageError>;
}

/// A stage kind whose work is done by another program, which the engine starts directly and ends with itself.
pub trait Program: Stage {
    /// Prepares the program's files and its command line.
    ///
    /// # Errors
    /// The program cannot be started.
    fn prepare(params: &<Self::Kind as Describe>::Params, job: &Job) -> Result<Prepared, StageError>;
}

/// A program that is ready to start.
pub struct Prepared {
    /// The program with arguments, environment and working folder. The engine sets its standard streams, its process group,
    /// and the variables that limit the threads of libraries.
    pub process: Command,
    /// Called after the program and all processes that it started have ended: moves the outputs to their paths, or returns
    /// the failure.
    pub finish: Finish,
}

/// See [`Prepared::finish`].
pub type Finish = Box<dyn FnOnce(ExitStatus) -> Result<(), StageError> + Send>;

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Prepared").field("process", &self.process).finish_non_exhaustive()
    }
}
