//! Type-erased stage kinds: what the engine holds and calls.

use serde_json::Value;

use crate::params::{self, Names};
use crate::{
    Ctx, Describe, FanIns, Job, Needs, ParamProblem, Ports, Prepared, Problems, Program, Stage, StageError,
};

/// A stage kind as the engine sees it: its name and revision, and functions on parameters as JSON values.
#[derive(Clone, Copy)]
pub struct Kind {
    name: &'static str,
    revision: u32,
    about: &'static str,
    seeded: bool,
    environment: Option<&'static str>,
    passed: Option<&'static str>,
    texts: &'static [&'static str],
    literal: fn(&str) -> String,
    seeded_by: fn(&Value) -> Result<bool, Vec<ParamProblem>>,
    schema: fn() -> schemars::Schema,
    normalize: fn(&Value) -> Result<Value, Vec<ParamProblem>>,
    look: fn(&Value) -> Result<Look, Vec<ParamProblem>>,
    check_labels: fn(&Value, &FanIns<'_>) -> Vec<ParamProblem>,
    ports: fn(&Value) -> Result<Ports, Vec<ParamProblem>>,
    needs: fn(&Value) -> Result<Needs, Vec<ParamProblem>>,
    run: Run,
}

/// Everything a kind states about a stage with given parameters.
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

/// Which process runs a kind.
#[derive(Clone, Copy)]
enum Run {
    Here(fn(&Value, &mut Ctx<'_>) -> Result<(), StageError>),
    In(&'static str),
    /// Another program; the first function starts it from this process and waits for it.
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
    /// The kind of stage `S`, which this program can plan with and run.
    pub const fn of<S: Stage>() -> Self {
        Self::new::<S::Kind>(Run::Here(run::<S>))
    }

    /// A kind that this program plans with, and that the executable `worker` (in the same folder) runs.
    pub const fn run_by<D: Describe>(worker: &'static str) -> Self {
        Self::new::<D>(Run::In(worker))
    }

    /// A kind whose work is done by another program.
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
            passed: D::PASSED,
            texts: D::TEXTS,
            literal: D::literal,
            seeded_by: seeded_by::<D>,
            schema: schema_of::<D>,
            normalize: normalize::<D>,
            look: look::<D>,
            check_labels: check_labels::<D>,
            ports: ports::<D>,
            needs: needs::<D>,
            run,
        }
    }

    /// The executable, in the same folder as this one, that runs the kind; `None` if this one does.
    pub fn worker(&self) -> Option<&'static str> {
        match self.run {
            Run::Here(_) | Run::Outside(..) => None,
            Run::In(worker) => Some(worker),
        }
    }

    /// True if the engine starts another program for the work. Such a program is not trusted with the files it is given.
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

    /// One-line description.
    pub fn about(&self) -> &'static str {
        self.about
    }

    /// False if the seed is not part of the key (see [`Kind::seeded_by`] for the parameters' influence).
    pub fn seeded(&self) -> bool {
        self.seeded
    }

    /// False if the seed is not part of the key of a stage with these parameters.
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

    /// The names of the variables that [`Describe::PASSED`] lists in these parameters.
    pub fn passed<'p>(&self, params: &'p Value) -> impl Iterator<Item = &'p str> {
        let names = self.passed.and_then(|field| params.get(field)).and_then(Value::as_array);
        names.into_iter().flatten().filter_map(Value::as_str)
    }

    /// See [`Describe::TEXTS`].
    pub fn texts(&self) -> &'static [&'static str] {
        self.texts
    }

    /// See [`Describe::literal`].
    pub fn literal(&self, text: &str) -> String {
        (self.literal)(text)
    }

    /// The JSON Schema of the parameters.
    pub fn schema(&self) -> schemars::Schema {
        (self.schema)()
    }

    /// The complete parameters: defaults filled in, numbers converted to the type of their field, ranges checked, notations
    /// unified.
    ///
    /// # Errors
    /// All invalid fields at once.
    pub fn normalize(&self, params: &Value) -> Result<Value, Vec<ParamProblem>> {
        (self.normalize)(params)
    }

    /// As [`Kind::normalize`], with ports and resource needs: the parameters are read only once.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn look(&self, params: &Value) -> Result<Look, Vec<ParamProblem>> {
        (self.look)(params)
    }

    /// The labels in the parameters that the artifacts at the inputs do not have; see [`Describe::check_labels`].
    pub fn check_labels(&self, params: &Value, inputs: &FanIns<'_>) -> Vec<ParamProblem> {
        (self.check_labels)(params, inputs)
    }

    /// The inputs and outputs under these parameters.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn ports(&self, params: &Value) -> Result<Ports, Vec<ParamProblem>> {
        (self.ports)(params)
    }

    /// The resource needs of a stage with these parameters.
    ///
    /// # Errors
    /// As [`Kind::normalize`].
    pub fn needs(&self, params: &Value) -> Result<Needs, Vec<ParamProblem>> {
        (self.needs)(params)
    }

    /// The program that does the work of a job, ready to start; `None` if the kind does the work itself.
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
    /// The stage's own errors; [`StageError::Params`] for parameters that do not match; a kind that another executable
    /// runs.
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
    checked::<D>(&mut read::<D>(value)?)
}

fn look<D: Describe>(value: &Value) -> Result<Look, Vec<ParamProblem>> {
    let mut params = read::<D>(value)?;
    // Ports may rely on checked parameters.
    let full = checked::<D>(&mut params)?;
    let (ports, needs, seeded) = (D::ports(&params), D::needs(&params), D::seeded(&params));
    Ok(Look { params: full, ports, needs, seeded })
}

/// The complete parameters as a JSON value.
fn checked<D: Describe>(params: &mut D::Params) -> Result<Value, Vec<ParamProblem>> {
    let mut problems = Problems::default();
    D::check(params, &mut problems);
    let found = problems.into_vec();
    if !found.is_empty() {
        return Err(found);
    }
    D::unify(params);
    serde_json::to_value(params).map_err(|error| {
        vec![ParamProblem {
            path: Vec::new(),
            message: format!("cannot be written back: {error}"),
            hint: None,
        }]
    })
}

fn check_labels<D: Describe>(value: &Value, inputs: &FanIns<'_>) -> Vec<ParamProblem> {
    let params = match read::<D>(value) {
        Ok(params) => params,
        Err(found) => return found,
    };
    let mut problems = Problems::default();
    D::check_labels(&params, inputs, &mut problems);
    problems.into_vec()
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
