//! A stage kind with its types erased: what the engine holds and calls.

use serde_json::Value;

use crate::params;
use crate::{Ctx, Needs, ParamProblem, Ports, Problems, Stage, StageError};

/// A stage kind as the engine sees it: names, and functions over parameters as JSON values.
#[derive(Clone, Copy)]
pub struct Kind {
    name: &'static str,
    revision: u32,
    about: &'static str,
    seeded: bool,
    schema: fn() -> schemars::Schema,
    normalize: fn(&Value) -> Result<Value, Vec<ParamProblem>>,
    ports: fn(&Value) -> Result<Ports, Vec<ParamProblem>>,
    needs: fn(&Value) -> Result<Needs, Vec<ParamProblem>>,
    run: fn(&Value, &mut Ctx<'_>) -> Result<(), StageError>,
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
    /// The erased form of `S`.
    pub const fn of<S: Stage>() -> Self {
        Self {
            name: S::KIND,
            revision: S::REVISION,
            about: S::ABOUT,
            seeded: S::SEEDED,
            schema: schemars_of::<S>,
            normalize: normalize::<S>,
            ports: ports::<S>,
            needs: needs::<S>,
            run: run::<S>,
        }
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

    /// False where the seed stays out of the key.
    pub fn seeded(&self) -> bool {
        self.seeded
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

    /// Runs a stage with these parameters.
    ///
    /// # Errors
    /// The stage's own; parameters that do not fit are [`StageError::Params`].
    pub fn run(&self, params: &Value, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        (self.run)(params, ctx)
    }
}

fn schemars_of<S: Stage>() -> schemars::Schema {
    schemars::schema_for!(S::Params)
}

fn read<S: Stage>(value: &Value) -> Result<S::Params, Vec<ParamProblem>> {
    params::read::<S::Params>(value)
}

fn normalize<S: Stage>(value: &Value) -> Result<Value, Vec<ParamProblem>> {
    let params = read::<S>(value)?;
    let mut problems = Problems::default();
    S::check(&params, &mut problems);
    let found = problems.into_vec();
    if !found.is_empty() {
        return Err(found);
    }
    serde_json::to_value(&params).map_err(|error| {
        vec![ParamProblem {
            path: Vec::new(),
            message: format!("cannot be written back: {error}"),
            hint: None,
        }]
    })
}

fn ports<S: Stage>(value: &Value) -> Result<Ports, Vec<ParamProblem>> {
    Ok(S::ports(&read::<S>(value)?))
}

fn needs<S: Stage>(value: &Value) -> Result<Needs, Vec<ParamProblem>> {
    Ok(S::needs(&read::<S>(value)?))
}

fn run<S: Stage>(value: &Value, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
    let params = read::<S>(value).map_err(StageError::params)?;
    S::run(&params, ctx)
}
