//! `command`: any program as a stage. It runs in a private folder that contains its inputs by name, and the files that it writes
//! under the names of its outputs are its result.
//!
//! Everything that the program gets enters the key: the command line, the names of its files, its environment variables with their
//! values, and the contents of its inputs. So the paths that it sees are short, relative, and the same on every machine.

mod fields;
mod run;
mod shell;
mod template;

use std::collections::{BTreeMap, BTreeSet};

use dril_stage_api::{
    Arity, Artifact, Ctx, Describe, Input, Job, Ports, Prepared, Problems, Program, Stage, StageError,
    port_name,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use fields::{CommandInput, CommandOutput, Variables, Word};
use fields::{default_input, is_inside, normal};
use template::Piece;

/// Runs a program.
pub struct Command;

/// Parameters of `command`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CommandParams {
    /// The program and its arguments, without a shell. `{inputs.name}`, `{outputs.name}`, `{checkpoints}` and `{seed}` are replaced
    /// by paths and the seed.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "fields::words")]
    run: Option<Vec<Word>>,
    /// A shell script instead, with the same placeholders; write `$$` for a `$` of the shell. The stage fails if any command fails,
    /// also inside a pipe: the shell is `sh -eu`, or `bash -euo pipefail` if the script contains a pipe.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shell: Option<String>,
    /// Inputs that need more than their name in the command: a path in the working folder (`raw: data/raw.csv`; a folder ends with
    /// `/`), or a map of `path`, `type`, `many` and `optional`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    inputs: BTreeMap<String, CommandInput>,
    /// The outputs: a path in the working folder (`clean: clean.csv`; a folder ends with `/`), or a map of `path` and `type`.
    outputs: BTreeMap<String, CommandOutput>,
    /// Environment variables: a list of names, taken from the environment of the run, or a map with values. Names and values
    /// enter the key.
    #[serde(default, skip_serializing_if = "Variables::is_empty")]
    env: Variables,
    /// Names of environment variables whose values do not enter the key: tokens, proxies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pass_env: Vec<String>,
}

impl CommandParams {
    /// The command line as templates.
    fn words(&self) -> Vec<&str> {
        let run = self.run.iter().flatten().map(|word| &*word.0);
        run.chain(self.shell.as_deref()).collect()
    }

    /// Every text in which placeholders are replaced.
    fn templates(&self) -> impl Iterator<Item = &str> {
        self.words().into_iter().chain(self.env.values())
    }

    /// The names of the inputs that the command uses.
    fn used_inputs(&self) -> impl Iterator<Item = &str> {
        let pieces = self.templates().filter_map(|text| template::pieces(text).ok()).flatten();
        pieces.filter_map(|piece| if let Piece::Input(name) = piece { Some(name) } else { None })
    }

    /// The names of all inputs: declared ones, and those that the command uses.
    fn input_names(&self) -> BTreeSet<&str> {
        self.used_inputs().chain(self.inputs.keys().map(String::as_str)).collect()
    }

    fn input(&self, name: &str) -> CommandInput {
        self.inputs.get(name).cloned().unwrap_or_default()
    }

    /// The path of an input in the working folder.
    fn input_path(&self, name: &str) -> String {
        let declared = self.inputs.get(name).and_then(|input| input.path.as_deref());
        declared.map_or_else(|| default_input(name), normal)
    }

    /// Where an output is expected in the working folder.
    fn output_path(&self, name: &str) -> String {
        match self.outputs.get(name) {
            Some(output) => output.path.as_deref().map_or_else(|| output.default_path(name), normal),
            None => format!("outputs/{name}"),
        }
    }
}

impl Describe for Command {
    const KIND: &'static str = "command";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "runs any program with declared inputs and outputs";
    const SEEDED: bool = false;
    const ENVIRONMENT: Option<&'static str> = Some("env");
    const PASSED: Option<&'static str> = Some("pass_env");
    const TEXTS: &'static [&'static str] = &["run", "env"];
    type Params = CommandParams;

    fn check(params: &CommandParams, problems: &mut Problems) {
        check_command(params, problems);
        check_names(params, problems);
        check_paths(params, problems);
    }

    fn unify(params: &mut CommandParams) {
        params.outputs.iter_mut().for_each(|(name, output)| output.unify(name));
        params.inputs.iter_mut().for_each(|(name, input)| input.unify(name));
        // An input that the command uses needs no entry of its own.
        let used: BTreeSet<String> = params.used_inputs().map(str::to_owned).collect();
        params.inputs.retain(|name, input| !used.contains(name) || *input != CommandInput::default());
        params.pass_env.sort_unstable();
        params.pass_env.dedup();
    }

    fn literal(text: &str) -> String {
        template::literal(text)
    }

    fn ports(params: &CommandParams) -> Ports {
        let mut ports = Ports::new();
        for name in params.input_names() {
            let input = params.input(name);
            let arity = match (input.many, input.optional) {
                (true, _) => Arity::Many,
                (false, true) => Arity::Optional,
                (false, false) => Arity::One,
            };
            let (name, about) = (port_name(name), "an input of the command");
            ports = ports.with_input(Input { name, artifact: input.artifact(), arity, about });
        }
        for (name, output) in &params.outputs {
            let extension = port_name(output.extension());
            ports = ports.output(port_name(name), output.artifact(), extension, "an output of the command");
        }
        ports.hint = Some(
            "a command has the inputs that it uses, as `{inputs.name}`, or that `with: { inputs: ... }` declares",
        );
        ports
    }

    fn seeded(params: &CommandParams) -> bool {
        params.templates().any(|text| template::pieces(text).is_ok_and(|found| found.contains(&Piece::Seed)))
    }
}

impl Stage for Command {
    type Kind = Self;

    fn run(params: &CommandParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        run::run(params, ctx)
    }
}

impl Program for Command {
    fn prepare(params: &CommandParams, job: &Job) -> Result<Prepared, StageError> {
        run::prepare(params, job)
    }
}

fn check_command(params: &CommandParams, problems: &mut Problems) {
    match (&params.run, &params.shell) {
        (Some(_), Some(_)) => problems.add("shell", "`run` and `shell` are both given, expected one of them"),
        (None, None) => problems.add("", "neither `run` nor `shell` is given, expected one of them"),
        (Some(words), None) if words.first().is_none_or(|word| word.0.is_empty()) => {
            problems.add("run", "`run` is empty, expected a program and its arguments");
        }
        (None, Some(text)) if text.trim().is_empty() => {
            problems.add("shell", "`shell` is empty, expected a script for `sh`");
        }
        _ => {}
    }
    if params.outputs.is_empty() {
        problems.add("outputs", "`outputs` is empty, expected at least one: only outputs are kept");
    }
    let words = params.run.iter().flatten().enumerate().map(|(at, word)| (format!("run.{at}"), &*word.0));
    let shell = params.shell.iter().map(|text| ("shell".to_owned(), text.as_str()));
    let env =
        params.env.0.iter().filter_map(|(name, value)| Some((format!("env.{name}"), value.as_deref()?)));
    for (path, text) in words.chain(shell).chain(env) {
        match template::pieces(text) {
            Err(message) => problems.add(&path, message),
            Ok(_) if text.contains('\0') => {
                problems.add(&path, "it contains a zero byte, which a command cannot")
            }
            Ok(pieces) => check_pieces(&pieces, &path, params, problems),
        }
    }
}

fn check_pieces(pieces: &[Piece<'_>], path: &str, params: &CommandParams, problems: &mut Problems) {
    for (at, piece) in pieces.iter().enumerate() {
        match piece {
            Piece::Output(name) if !params.outputs.contains_key(*name) => {
                problems.add(path, format!("`{{outputs.{name}}}` is not declared under `outputs`"));
            }
            Piece::Input(name) if params.input(name).many && !template::is_word(pieces, at) => {
                problems.add(
                    path,
                    format!(
                        "`{{inputs.{name}}}` stands for several paths and is part of a longer word, expected a word of its \
                         own; `{}/` is the folder with all of them, and `inputs.json` lists them",
                        params.input_path(name)
                    ),
                );
            }
            _ => {}
        }
    }
}

fn check_names(params: &CommandParams, problems: &mut Problems) {
    let names = params.inputs.keys().map(|name| ("inputs", name));
    for (map, name) in names.chain(params.outputs.keys().map(|name| ("outputs", name))) {
        if !template::is_name(name) {
            problems.add(
                &format!("{map}.{name}"),
                format!("`{name}` cannot be a name, expected a letter, then letters, digits, `-` or `_`"),
            );
        }
    }
    for name in params
        .env
        .0
        .keys()
        .map(|name| ("env", name))
        .chain(params.pass_env.iter().map(|name| ("pass_env", name)))
    {
        let (field, name) = name;
        if name.is_empty() || name.contains(['=', '\0']) || name.starts_with("DRIL_") {
            problems.add(field, format!("`{}` is not allowed as a variable here", name.escape_debug()));
        } else if field == "pass_env" && params.env.0.contains_key(name) {
            problems.add(field, format!("`{name}` is also in `env`, expected it in only one of them"));
        }
    }
    for (name, input) in &params.inputs {
        if input.many && input.optional {
            problems
                .add(&format!("inputs.{name}"), "`many` and `optional` are both given, expected one of them");
        }
    }
    for (name, output) in &params.outputs {
        if output.artifact == Some(Artifact::ANY) {
            problems.add(
                &format!("outputs.{name}"),
                "an output is `any`, expected a specific type such as `file` or `table`",
            );
        }
    }
    check_folders(params, problems);
}

/// A `/` at the end of a path says that it is a folder, and its type must not say otherwise.
fn check_folders(params: &CommandParams, problems: &mut Problems) {
    let inputs = params.inputs.iter().filter(|(_, input)| !input.many);
    let inputs = inputs.map(|(name, input)| ("inputs", name, input.artifact, &input.path));
    let outputs = params.outputs.iter();
    let outputs = outputs.map(|(name, output)| ("outputs", name, output.artifact, &output.path));
    for (map, name, artifact, path) in inputs.chain(outputs) {
        let file = artifact.filter(|artifact| ![Artifact::FOLDER, Artifact::ANY].contains(artifact));
        if let (Some(artifact), Some(path)) = (file, path.as_ref().filter(|path| path.ends_with('/'))) {
            let message = format!(
                "`{path}` ends with `/`, which is a folder, but its type is `{artifact}`, expected the path of one file"
            );
            problems.add(&format!("{map}.{name}"), message);
        }
    }
}

/// Paths must stay inside the working folder and must not overlap.
fn check_paths(params: &CommandParams, problems: &mut Problems) {
    let inputs = params.input_names().into_iter().map(|name| ("inputs", name, params.input_path(name)));
    let outputs = params.outputs.keys().map(|name| ("outputs", name.as_str(), params.output_path(name)));
    let mut taken: Vec<(String, String)> =
        [("checkpoints", "checkpoints"), ("inputs.json", "the list of inputs")]
            .map(|(path, what)| (path.to_owned(), what.to_owned()))
            .into();
    for (map, name, path) in inputs.chain(outputs) {
        let at = format!("{map}.{name}");
        if !is_inside(&path) {
            let message =
                format!("`{path}` leaves the working folder, expected a relative path without `..`");
            problems.add(&at, message);
            continue;
        }
        if map == "inputs" && (path == "outputs" || path.starts_with("outputs/")) {
            problems.add(&at, format!("`{path}` is in `outputs/`, which is only for outputs"));
        }
        let meets =
            taken.iter().find(|(other, _)| is_same_or_below(other, &path) || is_same_or_below(&path, other));
        if let Some((other, what)) = meets {
            problems.add(&at, format!("`{path}` overlaps with `{other}` ({what}), expected separate paths"));
        }
        taken.push((path, at));
    }
}

fn is_same_or_below(path: &str, above: &str) -> bool {
    path.strip_prefix(above).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}
