//! The two traits that an author of a stage kind implements: what the kind looks like, and what it does.
//!
//! They are apart so that a program can plan with a kind without linking what the kind runs on. `dril-pipe` describes
//! the learning kinds (package `dril-kinds`) and starts another executable to run them: merely loading libtorch costs a
//! quarter of a second and 120 MB, which every `plan`, every cached `run` and every table would pay otherwise.

use std::process::{Command, ExitStatus};

use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};

use crate::{Ctx, Job, Needs, Part, Ports, Problems, StageError};

/// What a stage kind looks like from outside: name, parameters, ports.
pub trait Describe: 'static {
    /// The name after `kind:` in the pipeline file, in kebab-case.
    const KIND: &'static str;
    /// Raised when equal inputs give other outputs than before; every cached result of the kind is then stale.
    const REVISION: u32;
    /// One line for `dril-pipe kinds`.
    const ABOUT: &'static str;
    /// False where the stage draws no random number: the seed then stays out of its key.
    const SEEDED: bool = true;

    /// The parameter whose empty values are filled in from the environment of the run: a map of variables. With their
    /// values they enter the key.
    const ENVIRONMENT: Option<&'static str> = None;

    /// Structs that are flattened into the parameters (`#[serde(flatten)]`), so that each of their wrong fields is
    /// reported by its name.
    const FLATTENED: &'static [Part] = &[];
    /// Parameters that have another name now, (old, new): whoever uses the old one is told the new one.
    const RENAMED: &'static [(&'static str, &'static str)] = &[];
    /// Parameters that are no more, with a sentence on what to do instead.
    const REMOVED: &'static [(&'static str, &'static str)] = &[];
    /// Parameters in which every number, at any depth, is a text to the kind and is taken as it is written: 3.10 stays 3.10.
    const TEXTS: &'static [&'static str] = &[];

    /// What stands under `with:`. Unknown fields must be denied (`#[serde(deny_unknown_fields)]`); every field that
    /// has a default should say so with `#[serde(default)]`, and doc comments appear in `dril-pipe kinds`.
    type Params: DeserializeOwned + Serialize + JsonSchema;

    /// Reports every value that has the right type but not a sensible range.
    fn check(params: &Self::Params, problems: &mut Problems) {
        let _ = (params, problems);
    }

    /// The inputs and outputs.
    fn ports(params: &Self::Params) -> Ports;

    /// True where a stage with these parameters draws random numbers.
    fn seeded(params: &Self::Params) -> bool {
        let _ = params;
        Self::SEEDED
    }

    /// What it takes of the machine.
    fn needs(params: &Self::Params) -> Needs {
        let _ = params;
        Needs::default()
    }
}

/// A stage kind that can run. A stage is a function from parameters, seed and inputs to outputs; it has no self.
///
/// Its result may depend on the parameters, the seed, the contents of its inputs and their labels, and on nothing
/// else: not on time, host, thread count or the order in which other stages ran. The engine caches by exactly these.
///
/// A kind that links nothing heavy implements both traits on one type (`type Kind = Self`).
pub trait Stage: 'static {
    /// What the kind looks like.
    type Kind: Describe;

    /// Does the work: reads `ctx.input(..)`, writes every `ctx.output(..)`.
    ///
    /// # Errors
    /// [`StageError::Cancelled`] after a clean stop at `ctx.cancelled()`; any other error is the stage's failure.
    fn run(params: &<Self::Kind as Describe>::Params, ctx: &mut Ctx<'_>) -> Result<(), StageError>;
}

/// A stage kind whose work is another program's: the engine starts that program itself, with no process of ours in
/// between, and sees to it that it dies with the engine.
pub trait Program: Stage {
    /// Lays out what the program needs, and says how to start it.
    ///
    /// # Errors
    /// There is nothing to start.
    fn prepare(params: &<Self::Kind as Describe>::Params, job: &Job) -> Result<Prepared, StageError>;
}

/// A program that is ready to start.
pub struct Prepared {
    /// The program: arguments, environment and folder. Its standard streams, its process group and the variables that
    /// cap the threads of libraries are the engine's to set.
    pub process: Command,
    /// Called once it has ended, and all that it started with it: puts the outputs in their places, or says what failed.
    pub finish: Finish,
}

/// See [`Prepared::finish`].
pub type Finish = Box<dyn FnOnce(ExitStatus) -> Result<(), StageError> + Send>;

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Prepared").field("process", &self.process).finish_non_exhaustive()
    }
}
