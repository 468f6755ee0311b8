//! A stage kind with its types erased: what the engine holds and calls.

use serde_json::Value;

use crate::params::{self, Names};
use crate::{Ctx, Describe, Job, Needs, ParamProblem, Ports, Prepared, Problems, Program, Stage, StageError};

/// A stage kind as the engine sees it: names, and functions over parameters as JSON values.
#[derive(Clone, Copy)]
pub struct Kind {
    name: &'static str,
    revision: u32,
    about: &'static str,
    seeded: bool,
    environment: Option<&'static str>,
    texts: &'static [&'static str],
    seeded_by: fn(&Value) -> Result<bool, Vec<ParamProblem>>,
    schema: fn() -> schemars::Schema,
    normalize: fn(&Value) -> Result<Value, Vec<ParamProblem>>,
    look: fn(&Value) -> Result<Look, Vec<ParamProblem>>,
    ports: fn(&Value) -> Result<Ports, Vec<ParamProblem>>,
    needs: fn(&Value) -> Result<Needs, Vec<ParamProblem>>,
    run: Run,
}

/// All that a kind says of a stage with certain parameters.
#[derive(Clone, Debug)]
pub struct Look {
    /// See [`Kind::normalize`].
    pub params: Value,
    /// See [`Kind::ports`].
    pub ports: Ports,
    /// See [`Kind::needs`].
    pub needs: Needs,
    /// See [`Kind::seeded_by`].
    pub seeded: bool,
}

/// Where a kind's work is done.
#[derive(Clone, Copy)]
enum Run {
    Here(fn(&Value, &mut Ctx<'_>) -> Result<(), StageError>),
    In(&'static str),
    /// By another program; the first function does all of it from this process.
    Outside(
        fn(&Value, &mut Ctx<'_>) -> Result<(), StageError>,
        fn(&Value, &Job) -> Result<Prepared, StageError>,
    ),
}

impl std::fmt::Debug for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Kind")
            .field("name", &self.name)
            .field("revision", &self.revision)
            .finish_non_exhaustive()
    }
}

impl Kind {
    /// The erased form of `S`: this program can plan with it and run it.
    pub const fn of<S: Stage>() -> Self {
        Self::new::<S::Kind>(Run::Here(run::<S>))
    }

    /// A kind that this program plans with and the executable `worker` (beside this one) runs.
    pub const fn run_by<D: Describe>(worker: &'static str) -> Self {
        Self::new::<D>(Run::In(worker))
    }

    /// The erased form of `P`, whose work is another program's.
    pub const fn of_program<P: Program>() -> Self {
        Self::new::<P::Kind>(Run::Outside(run::<P>, prepare::<P>))
    }

    const fn new<D: Describe>(run: Run) -> Self {
        Self {
            name: D::KIND,
            revision: D::REVISION,
            about: D::ABOUT,
            seeded: D::SEEDED,
            environment: D::ENVIRONMENT,
            texts: D::TEXTS,
            seeded_by: seeded_by::<D>,
            schema: schema_of::<D>,
            normalize: normalize::<D>,
            look: look::<D>,
            ports: ports::<D>,
            needs: needs::<D>,
            run,
        }
    }

    /// The executable, beside this one, that runs the kind; `None` where this one does.
    pub fn worker(&self) -> Option<&'static str> {
        match self.run {
            Run::Here(_) | Run::Outside(..) => None,
            Run::In(worker) => Some(worker),
        }
    }

    /// True where the work is another program's, started by the engine: what such a program does to the files that it
    /// is given is in nobody's hands.
    pub fn is_program(&self) -> bool {
        matches!(self.run, Run::Outside(..))
    }

    /// The name after `kind:`.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// See [`Stage::REVISION`].
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// One line for people.
    pub fn about(&self) -> &'static str {
        self.about
    }

    /// False where the seed stays out of the key, unless the parameters say otherwise.
    pub fn seeded(&self) -> bool {
        self.seeded
    }

    /// False where the seed stays out of the key of a stage with these parameters.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn seeded_by(&self, params: &Value) -> Result<bool, Vec<ParamProblem>> {
        (self.seeded_by)(params)
    }

    /// See [`Describe::ENVIRONMENT`].
    pub fn environment(&self) -> Option<&'static str> {
        self.environment
    }

    /// See [`Describe::TEXTS`].
    pub fn texts(&self) -> &'static [&'static str] {
        self.texts
    }

    /// The JSON Schema of its parameters.
    pub fn schema(&self) -> schemars::Schema {
        (self.schema)()
    }

    /// The parameters in full: defaults filled in, numbers in the type of their field, ranges checked.
    ///
    /// # Errors
    /// Every wrong field at once.
    pub fn normalize(&self, params: &Value) -> Result<Value, Vec<ParamProblem>> {
        (self.normalize)(params)
    }

    /// As [`Kind::normalize`], and all else that the kind says of such a stage, for the price of reading the parameters
    /// once.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn look(&self, params: &Value) -> Result<Look, Vec<ParamProblem>> {
        (self.look)(params)
    }

    /// The inputs and outputs under these parameters.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn ports(&self, params: &Value) -> Result<Ports, Vec<ParamProblem>> {
        (self.ports)(params)
    }

    /// What a stage with these parameters takes of the machine.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn needs(&self, params: &Value) -> Result<Needs, Vec<ParamProblem>> {
        (self.needs)(params)
    }

    /// The program that does the work of a job, ready to start; `None` where the kind does its work itself.
    ///
    /// # Errors
    /// See [`Program::prepare`].
    pub fn prepare(&self, job: &Job) -> Option<Result<Prepared, StageError>> {
        match self.run {
            Run::Outside(_, prepare) => Some(prepare(&job.params, job)),
            Run::Here(_) | Run::In(_) => None,
        }
    }

    /// Runs a stage with these parameters.
    ///
    /// # Errors
    /// The stage's own; parameters that do not fit are [`StageError::Params`]; a kind of another executable fails.
    pub fn run(&self, params: &Value, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        match self.run {
            Run::Here(run) | Run::Outside(run, _) => run(params, ctx),
            Run::In(worker) => Err(StageError::failed(format!("kind `{}` is run by `{worker}`", self.name))),
        }
    }
}

fn prepare<P: Program>(value: &Value, job: &Job) -> Result<Prepared, StageError> {
    let params = read::<P::Kind>(value).map_err(StageError::params)?;
    P::prepare(&params, job)
}

fn schema_of<D: Describe>() -> schemars::Schema {
    schemars::schema_for!(D::Params)
}

fn read<D: Describe>(value: &Value) -> Result<D::Params, Vec<ParamProblem>> {
    let names = Names { parts: D::FLATTENED, renamed: D::RENAMED, removed: D::REMOVED };
    params::read::<D::Params>(value, &names)
}

fn normalize<D: Describe>(value: &Value) -> Result<Value, Vec<ParamProblem>> {
    checked::<D>(&read::<D>(value)?)
}

fn look<D: Describe>(value: &Value) -> Result<Look, Vec<ParamProblem>> {
    let params = read::<D>(value)?;
    // What a kind says of its ports may rely on what it has checked.
    let full = checked::<D>(&params)?;
    let (ports, needs, seeded) = (D::ports(&params), D::needs(&params), D::seeded(&params));
    Ok(Look { params: full, ports, needs, seeded })
}

/// The parameters in full, written back.
fn checked<D: Describe>(params: &D::Params) -> Result<Value, Vec<ParamProblem>> {
    let mut problems = Problems::default();
    D::check(params, &mut problems);
    let found = problems.into_vec();
    if !found.is_empty() {
        return Err(found);
    }
    serde_json::to_value(params).map_err(|error| {
        vec![ParamProblem {
            path: Vec::new(),
            message: format!("cannot be written back: {error}"),
            hint: None,
        }]
    })
}

fn ports<D: Describe>(value: &Value) -> Result<Ports, Vec<ParamProblem>> {
    Ok(D::ports(&read::<D>(value)?))
}

fn seeded_by<D: Describe>(value: &Value) -> Result<bool, Vec<ParamProblem>> {
    Ok(D::seeded(&read::<D>(value)?))
}

fn needs<D: Describe>(value: &Value) -> Result<Needs, Vec<ParamProblem>> {
    Ok(D::needs(&read::<D>(value)?))
}

fn run<S: Stage>(value: &Value, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
    let params = read::<S::Kind>(value).map_err(StageError::params)?;
    S::run(&params, ctx)
}
