//! Runs a command: lays out its inputs, starts the program, and collects its outputs.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command as Process, ExitStatus, Stdio};

use dril_stage_api::{Arity, Artifact, Ctx, Job, JobOutput, Prepared, StageError, scores};
use serde_json::json;

use super::shell;
use super::template::{self, Piece};
use super::{Command, CommandParams};
use crate::fsx::{self, Entry};
use dril_stage_api::Describe;

/// Environment variables that every command gets; they must not change a result.
const ALWAYS: [&str; 2] = ["PATH", "HOME"];

/// Fixed values, so that the order of `sort` and the format of a date do not depend on the user.
const FIXED: [(&str, &str); 2] = [("LC_ALL", "C.UTF-8"), ("TZ", "UTC")];

/// The folder for checkpoints, in the working folder.
const CHECKPOINTS: &str = "checkpoints";
/// The list of inputs with their labels.
const INPUTS: &str = "inputs.json";

/// Runs the command of `params` from this process.
pub(super) fn run(params: &CommandParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
    let mut prepared = prepare(params, ctx.job())?;
    let started = prepared.process.stdin(Stdio::null()).status();
    let status = started.map_err(|error| {
        let program = prepared.process.get_program().to_string_lossy();
        StageError::failed(format!("cannot start `{program}`: {error}"))
    })?;
    // Whatever its exit code is: see `exec::child`.
    if ctx.cancelled() { Err(StageError::Cancelled) } else { (prepared.finish)(status) }
}

/// Lays out the inputs of a command and prepares its process.
pub(super) fn prepare(params: &CommandParams, job: &Job) -> Result<Prepared, StageError> {
    let work = job.scratch.clone();
    let inputs = lay_out(params, job, &work)?;
    let texts = Texts { params, work: &work, inputs: &inputs, seed: job.seed.0 };
    let mut process = texts.process()?;
    process.current_dir(&work).env_clear();
    // The path of a socket has at most 107 bytes, and the path of the working folder alone has more.
    let short = fsx::temporary_link(&work);
    process.envs(environment(params, &texts, short.as_ref().map_or(&work, |short| short.path()))?);
    let (params, outputs, line) = (params.clone(), job.outputs.clone(), shown(&process));
    let finish = move |status: ExitStatus| {
        // Links in the outputs may lead through it.
        let _short = short;
        if status.success() { collect(&params, &outputs, &work) } else { Err(ended(&params, &line, status)) }
    };
    Ok(Prepared { process, finish: Box::new(finish) })
}

/// The paths of each input, by name, relative to the working folder.
type Paths = BTreeMap<&'static str, Vec<String>>;

/// Creates the working folder, with each artifact at its path. It is no symbolic link: an interpreter that finds its modules
/// beside a script would look beside the file that the link leads to.
fn lay_out(params: &CommandParams, job: &Job, work: &Path) -> Result<Paths, StageError> {
    let mut folders = Folders { work, made: BTreeSet::new() };
    folders.make(Path::new("outputs"))?;
    let ports = Command::ports(params);
    let mut laid = Paths::new();
    let mut list = serde_json::Map::new();
    for input in &ports.inputs {
        let path = params.input_path(input.name);
        let mut paths = Vec::new();
        let mut entries = Vec::new();
        for (number, item) in job.inputs.get(input.name).into_iter().flatten().enumerate() {
            let path = if input.arity == Arity::Many { format!("{path}/{number}") } else { path.clone() };
            folders.place(&item.path, &path)?;
            entries.push(json!({ "path": path, "labels": item.labels }));
            paths.push(path);
        }
        list.insert(input.name.to_owned(), entries.into());
        laid.insert(input.name, paths);
    }
    if ports.inputs.iter().any(|input| input.arity == Arity::Many) {
        let text = format!("{:#}\n", serde_json::Value::Object(list));
        fsx::write(&work.join(INPUTS), text.as_bytes()).map_err(StageError::failed)?;
    }
    for name in params.outputs.keys() {
        folders.above(&params.output_path(name))?;
    }
    fsx::create_dir_all(&job.checkpoints).map_err(StageError::failed)?;
    folders.link(&job.checkpoints, CHECKPOINTS)?;
    Ok(laid)
}

/// Creates the folders in the working folder, each once.
struct Folders<'a> {
    work: &'a Path,
    made: BTreeSet<PathBuf>,
}

impl Folders<'_> {
    fn make(&mut self, folder: &Path) -> Result<(), StageError> {
        if !self.made.contains(folder) {
            fsx::create_dir_all(&self.work.join(folder)).map_err(StageError::failed)?;
            self.made.extend(folder.ancestors().map(Path::to_owned));
        }
        Ok(())
    }

    /// What the file at `path` lies in.
    fn above(&mut self, path: &str) -> Result<(), StageError> {
        Path::new(path).parent().map_or(Ok(()), |folder| self.make(folder))
    }

    /// Puts the private copy `from` at a path. It keeps its own name, by which the engine sees whether it was changed.
    fn place(&mut self, from: &Path, at: &str) -> Result<(), StageError> {
        self.above(at)?;
        fsx::link_tree(from, &self.work.join(at)).map_err(StageError::failed)
    }

    fn link(&mut self, to: &Path, at: &str) -> Result<(), StageError> {
        self.above(at)?;
        fsx::symlink(to, &self.work.join(at)).map_err(StageError::failed)
    }
}

/// Replaces the placeholders of a command.
struct Texts<'a> {
    params: &'a CommandParams,
    /// The working folder.
    work: &'a Path,
    inputs: &'a Paths,
    seed: u64,
}

impl Texts<'_> {
    /// The program with its arguments.
    fn process(&self) -> Result<Process, StageError> {
        if let Some(text) = &self.params.shell {
            let path = self.params.env.value("PATH").map(|path| self.fill(path)).transpose()?;
            let text = self.fill(text)?;
            let script = self.work.with_file_name("shell-text");
            return shell::process(&text, path.as_deref().map(OsStr::new), &script)
                .map_err(StageError::failed);
        }
        let mut words = Vec::new();
        for word in self.params.run.iter().flatten() {
            match template::pieces(&word.0).map_err(StageError::failed)?.as_slice() {
                // Alone, an input with many artifacts becomes as many words, and an omitted one becomes none.
                [Piece::Input(name)] => words.extend(self.paths(name).iter().cloned()),
                _ => words.push(self.fill(&word.0)?),
            }
        }
        let mut words = words.into_iter();
        let Some(program) = words.next() else {
            return Err(StageError::failed("the command has no program"));
        };
        let mut process = Process::new(program);
        process.args(words);
        Ok(process)
    }

    fn fill(&self, text: &str) -> Result<String, StageError> {
        let pieces = template::pieces(text).map_err(StageError::failed)?;
        Ok(pieces
            .into_iter()
            .map(|piece| match piece {
                Piece::Text(text) => text.to_owned(),
                Piece::Input(name) => self.paths(name).join(" "),
                Piece::Output(name) => self.params.output_path(name),
                Piece::Checkpoints => CHECKPOINTS.to_owned(),
                Piece::Seed => self.seed.to_string(),
            })
            .collect())
    }

    fn paths(&self, name: &str) -> &[String] {
        self.inputs.get(name).map(Vec::as_slice).unwrap_or_default()
    }
}

/// The environment of the program, with this folder for temporary files.
fn environment(
    params: &CommandParams,
    texts: &Texts<'_>,
    temporary: &Path,
) -> Result<Vec<(String, OsString)>, StageError> {
    let mut all: Vec<(String, OsString)> = FIXED.map(|(name, value)| (name.to_owned(), value.into())).into();
    let passed = ALWAYS.iter().copied().chain(params.pass_env.iter().map(String::as_str));
    all.extend(passed.filter_map(|name| Some((name.to_owned(), std::env::var_os(name)?))));
    all.push(("TMPDIR".to_owned(), temporary.into()));
    all.push(("DRIL_CHECKPOINTS".to_owned(), CHECKPOINTS.into()));
    all.push(("DRIL_INPUTS".to_owned(), INPUTS.into()));
    for (name, value) in &params.env.0 {
        if let Some(value) = value {
            all.push((name.clone(), texts.fill(value)?.into()));
        }
    }
    Ok(all)
}

/// Why there is no result: the program failed.
fn ended(params: &CommandParams, line: &str, status: ExitStatus) -> StageError {
    let what = if params.shell.is_some() { "the shell" } else { line };
    let how = match (status.code(), status.signal()) {
        (Some(127), _) if params.shell.is_some() => {
            "exit code 127: a program in it, or the interpreter of a script, was not found".to_owned()
        }
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(9)) => {
            "signal 9 (SIGKILL: by a user, or by the system when it ran out of memory)".to_owned()
        }
        (None, Some(11)) => "signal 11 (SIGSEGV: invalid memory access)".to_owned(),
        (None, signal) => format!("signal {}", signal.unwrap_or_default()),
    };
    StageError::failed(format!("{what} ended with {how}; see its log"))
}

/// The command line, shortened.
fn shown(process: &Process) -> String {
    let words = std::iter::once(process.get_program()).chain(process.get_args());
    let line: Vec<String> = words.map(|word| word.to_string_lossy().into_owned()).collect();
    let line = line.join(" ");
    let short: String = line.chars().take(80).collect();
    if short.len() < line.len() { format!("`{short}…`") } else { format!("`{short}`") }
}

/// Moves the outputs to where the engine expects them.
fn collect(
    params: &CommandParams,
    outputs: &BTreeMap<String, JobOutput>,
    work: &Path,
) -> Result<(), StageError> {
    let mut wrong = Vec::new();
    for (name, output) in &params.outputs {
        let path = params.output_path(name);
        fsx::own_above(work, Path::new(&path)).map_err(StageError::failed)?;
        let is_folder = output.artifact() == Artifact::FOLDER;
        let Some(place) = outputs.get(name) else {
            wrong.push(format!("output `{name}` has no place"));
            continue;
        };
        match written(&work.join(&path), is_folder, work) {
            Ok(found) => {
                // Otherwise its readers would fail, perhaps days later.
                if output.artifact() == Artifact::SCORES
                    && let Err(message) = scores::check(&fsx::read(&found).map_err(StageError::failed)?)
                {
                    wrong.push(format!("output `{name}`, whose type is `scores`: {message}"));
                }
                fsx::rename(&found, &place.path).map_err(StageError::failed)?;
            }
            Err(seen) => {
                let expected = if is_folder { "folder" } else { "file" };
                wrong.push(format!("output `{name}` {seen}, expected a {expected} at `{path}`"));
            }
        }
    }
    let mut left = Vec::new();
    leftovers(&work.join("outputs"), "outputs", &mut left).map_err(StageError::failed)?;
    if !left.is_empty() {
        let more = if left.len() > 5 { format!(" and {} more", left.len() - 5) } else { String::new() };
        let names: Vec<String> = left.iter().take(5).map(|name| format!("`{name}`")).collect();
        wrong.push(format!(
            "{}{more} is not a declared output, and `outputs/` is only for these: declare it, or write it elsewhere in the \
             working folder, which is removed",
            names.join(", ")
        ));
    }
    if wrong.is_empty() { Ok(()) } else { Err(StageError::failed(wrong.join("; "))) }
}

/// Checks the file or folder at `path` and makes its links independent of its place; the error is what was found instead.
fn written(path: &Path, is_folder: bool, work: &Path) -> Result<PathBuf, String> {
    let said = |error: fsx::FsError| format!("cannot be used: {error}");
    match (fsx::entry(path).map_err(said)?, is_folder) {
        (Some(Entry::File(_)), false) => Ok(path.to_owned()),
        (Some(Entry::Folder), true) => fsx::settle_links(path).map(|()| path.to_owned()).map_err(said),
        (Some(Entry::File(_)), true) => Err("is a file".to_owned()),
        (Some(Entry::Folder), false) => Err("is a folder".to_owned()),
        (Some(Entry::Other), _) => written_as_link(path, is_folder, work),
        (None, _) => Err("was not written".to_owned()),
    }
}

/// As [`written`], of something that is neither file nor folder. A link is ordinary (`best.ckpt -> epoch-3.ckpt`) where it
/// leads to a file, or to a folder of this stage.
fn written_as_link(path: &Path, is_folder: bool, work: &Path) -> Result<PathBuf, String> {
    let said = |error: fsx::FsError| format!("cannot be used: {error}");
    let Some(target) = fsx::link_target(path) else { return Err("is not a regular file".to_owned()) };
    let target = format!("is a link to `{}`", target.display());
    let Some(real) = fsx::real(path) else {
        return Err(format!("{target}, which does not exist (a broken or circular link)"));
    };
    match (fsx::outside(&real).map_err(said)?, is_folder) {
        (fsx::Outside::File(_), false) => fsx::be_a_file(path).map(|()| path.to_owned()).map_err(said),
        (fsx::Outside::Folder, true) if fsx::real(work).is_some_and(|work| real.starts_with(work)) => {
            fsx::remove_file(path).map_err(said)?;
            fsx::settle_links(&real).map(|()| real).map_err(said)
        }
        (fsx::Outside::Folder, true) => Err(format!("{target}, a folder outside this stage: copy it")),
        (fsx::Outside::File(_), true) => Err(format!("{target}, a file")),
        (fsx::Outside::Folder, false) => Err(format!("{target}, a folder")),
    }
}

/// What is still in `outputs/`; folders alone are nothing.
fn leftovers(folder: &Path, name: &str, found: &mut Vec<String>) -> fsx::Result<()> {
    for path in fsx::list(folder)? {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = format!("{name}/{}", file.escape_debug());
        match fsx::entry(&path)? {
            Some(Entry::Folder) => leftovers(&path, &name, found)?,
            _ => found.push(name),
        }
    }
    Ok(())
}
