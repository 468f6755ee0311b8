//! Runs a tool that a stage package brings along: finds the artifact and starts the tool's executable.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use dril_stage_api::{Artifact, Registry, Tool, ToolOption, ToolValue};
use serde_json::Value;

use super::inspect::pick_stages;
use crate::cli::args::ToolArgs;
use crate::cli::pipeline;
use crate::error::{Error, ErrorKind, exit_codes};
use crate::fsx::{self, Entry};
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::store::Store;

/// An artifact, and where it comes from if a pipeline made it.
struct Found {
    path: PathBuf,
    stage: Option<(Graph, StageIndex)>,
}

pub(in crate::cli) fn main(tool: &Tool, args: &ToolArgs, registry: &Registry) -> Result<ExitCode, Error> {
    for option in tool.options {
        if let (ToolValue::NewFile(extensions, hint), Some(path)) =
            (option.value, args.options.get(option.name).and_then(Value::as_str))
        {
            check_new_file(option.name, Path::new(path), extensions, hint)?;
        }
    }
    let found = match fsx::entry(Path::new(&args.artifact)) {
        Ok(Some(Entry::File(_))) => Found { path: PathBuf::from(&args.artifact), stage: None },
        _ => from_pipeline(tool, args, registry)?,
    };
    let mut request = serde_json::Map::new();
    request.insert(tool.artifact.name().to_owned(), Value::from(found.path.to_string_lossy()));
    for option in tool.options {
        let given = args.options.get(option.name).cloned().unwrap_or_default();
        request.insert(option.name.to_owned(), option_value(option, given, &found)?);
    }
    start(tool, &Value::Object(request).to_string())
}

/// The value of an option in the request.
fn option_value(option: &ToolOption, given: Value, found: &Found) -> Result<Value, Error> {
    match (option.value, given) {
        (ToolValue::Yaml(example), Value::String(text)) => read_yaml(option.name, &text, example),
        (_, Value::Null) if option.from_stage => {
            let stage = found.stage.as_ref();
            Ok(stage.and_then(|(graph, stage)| param_of(option.name, graph, *stage)).unwrap_or_default())
        }
        (_, given) => Ok(given),
    }
}

fn start(tool: &Tool, request: &str) -> Result<ExitCode, Error> {
    let program = std::env::current_exe()
        .map_err(|error| {
            Error::new(ErrorKind::Io, format!("cannot find the path of this executable: {error}"))
        })?
        .with_file_name(format!("{}{}", tool.worker, std::env::consts::EXE_SUFFIX));
    let status = Command::new(&program).args([tool.service, request]).stdin(Stdio::null()).status().map_err(
        |error| {
            let message = format!("cannot start `{}`: {error}", program.display());
            Error::new(ErrorKind::Io, message).hint("it is built together with this program")
        },
    )?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(exit_codes::STAGE_FAILED)))
}

/// Fails early if the file cannot be written, and not after the work is done.
fn check_new_file(option: &str, path: &Path, extensions: &[&str], hint: &str) -> Result<(), Error> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    if !extensions.contains(&extension) {
        let expected: Vec<String> = extensions.iter().map(|extension| format!("`.{extension}`")).collect();
        let message = format!("`--{option} {}` must end with one of {}", path.display(), expected.join(", "));
        return Err(Error::new(ErrorKind::Usage, message).hint(hint));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match fsx::outside(folder) {
        Ok(fsx::Outside::Folder) => Ok(()),
        _ => Err(Error::new(
            ErrorKind::Io,
            format!("the folder `{}` of `--{option}` does not exist", folder.display()),
        )),
    }
}

fn read_yaml(option: &str, text: &str, example: &str) -> Result<Value, Error> {
    serde_saphyr::from_str(text).map_err(|error| {
        let message = format!("cannot parse `--{option} {text}`: {error}");
        Error::new(ErrorKind::Usage, message).hint(format!("write it as in a pipeline file: `{example}`"))
    })
}

/// The artifact of `FILE:STAGE.OUTPUT`.
fn from_pipeline(tool: &Tool, args: &ToolArgs, registry: &Registry) -> Result<Found, Error> {
    let Some((file, wanted)) = split(&args.artifact) else {
        let error = Error::new(ErrorKind::Usage, format!("there is no file `{}`", args.artifact));
        let (artifact, example) = (tool.artifact, tool.artifact_example);
        return Err(error.hint(format!("name a {artifact} file, or a stage as in `{example}`")));
    };
    let source = pipeline::source(&args.pipeline(file));
    let graph = source.load(registry)?;
    let (word, output) = parts(wanted);
    let (index, output) = output_of(&graph, tool.artifact, &word, output)?;
    let store = pipeline::store(&args.store)?;
    let plan = plan::plan(&graph, &store, &source.base())?;
    let Some(path) = finished(&plan, index, output, &store) else {
        let (id, profile) = (&graph.stages[index].id, &graph.profile);
        let message = format!("`{id}` has not been run with profile `{profile}` as the pipeline is now");
        return Err(Error::new(ErrorKind::Pipeline, message)
            .hint(format!("run it first: `dril-pipe run {file} --profile {profile}`")));
    };
    Ok(Found { path, stage: Some((graph, index)) })
}

/// The stage that `word` names, and its output of this type (with this name, if any).
fn output_of(
    graph: &Graph,
    artifact: Artifact,
    word: &str,
    output: Option<&str>,
) -> Result<(StageIndex, &'static str), Error> {
    let usage = |message: String| Error::new(ErrorKind::Usage, message);
    let found = pick_stages(graph, &[word.to_owned()])?;
    let [index] = found[..] else {
        let ids: Vec<&str> = found.iter().map(|index| &*graph.stages[*index].id).collect();
        return Err(usage(format!("`{word}` matches {} stages, expected one", found.len()))
            .hint(format!("name one of: {}", ids.join("; "))));
    };
    let stage = &graph.stages[index];
    let fitting = stage.ports.outputs.iter().filter(|port| port.artifact == artifact);
    let fitting: Vec<&'static str> = fitting.map(|port| port.name).collect();
    let named: Vec<_> = fitting.iter().filter(|name| output.is_none_or(|output| output == **name)).collect();
    match named[..] {
        [name] => Ok((index, name)),
        _ if fitting.is_empty() => Err(usage(format!("`{}` has no output of type `{artifact}`", stage.id))),
        _ => Err(usage(format!("`{}` has several outputs of type `{artifact}`", stage.id)).hint(format!(
            "name one of them: `{}.{}`",
            stage.id,
            fitting.join(&format!("` or `{}.", stage.id))
        ))),
    }
}

/// Splits `FILE:STAGE`; `None` where there is no such file. Paths may contain colons.
fn split(text: &str) -> Option<(&str, &str)> {
    text.match_indices(':')
        .map(|(at, _)| (&text[..at], &text[at + 1..]))
        .find(|(file, _)| matches!(fsx::entry(Path::new(file)), Ok(Some(Entry::File(_)))))
}

/// Splits off the output: both `dril.peak[policy=beta]` and `dril[policy=beta].peak` are valid.
fn parts(stage: &str) -> (String, Option<&str>) {
    match (stage.find('['), stage.rfind(']')) {
        (Some(open), Some(close)) if open < close => {
            let (name, coordinates, rest) = (&stage[..open], &stage[open..=close], &stage[close + 1..]);
            match (name.split_once('.'), rest.strip_prefix('.')) {
                (Some((name, output)), _) => (format!("{name}{coordinates}{rest}"), Some(output)),
                (None, output) => (format!("{name}{coordinates}"), output),
            }
        }
        _ => match stage.split_once('.') {
            Some((name, output)) => (name.to_owned(), Some(output)),
            None => (stage.to_owned(), None),
        },
    }
}

fn finished(plan: &Plan<'_>, stage: StageIndex, output: &str, store: &Store) -> Option<PathBuf> {
    let (_, verdict) = plan.steps.iter().find(|(index, _)| *index == stage)?;
    let Verdict::Cached { outputs, .. } = verdict else { return None };
    Some(store.blob_path(&outputs.get(output)?.digest))
}

/// A parameter of the stage, or of the nearest stage upstream that has it.
fn param_of(name: &str, graph: &Graph, stage: StageIndex) -> Option<Value> {
    let mut near = vec![stage];
    let mut at = 0;
    while let Some(index) = near.get(at).copied() {
        if let Some(value) = graph.stages[index].params.get(name) {
            return Some(value.clone());
        }
        for feeding in plan::feeding(graph, index) {
            if !near.contains(&feeding) {
                near.push(feeding);
            }
        }
        at += 1;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_may_stand_before_or_after_the_brackets() {
        let of = |stage, output| (String::from(stage), output);
        assert_eq!(parts("dril.peak[policy=beta]"), of("dril[policy=beta]", Some("peak")));
        assert_eq!(parts("dril[rate=0.5].peak"), of("dril[rate=0.5]", Some("peak")));
        assert_eq!(parts("dril.peak"), of("dril", Some("peak")));
        assert_eq!(parts("train[seed=1]"), of("train[seed=1]", None));
        assert_eq!(parts("train"), of("train", None));
    }

    #[test]
    fn a_file_that_cannot_be_written_is_reported_before_any_work_is_done() {
        let code = |out: &str| {
            let checked = check_new_file("out", Path::new(out), &["gif", "png"], "a hint");
            checked.map_err(|error| error.kind()).err()
        };
        assert_eq!(code("x.gif"), None);
        assert_eq!(code("x.mp4"), Some(ErrorKind::Usage));
        assert_eq!(code("x"), Some(ErrorKind::Usage));
        assert_eq!(code("no/such/folder/x.png"), Some(ErrorKind::Io));
    }

    #[test]
    fn a_value_is_parsed_as_in_a_pipeline_file() {
        let read = |text| read_yaml("env", text, "{ a: 1 }");
        let value = serde_json::json!({ "gymnasium": "ALE/Breakout-v5" });
        assert_eq!(read("{ gymnasium: ALE/Breakout-v5 }").unwrap(), value);
        let error = read("{ car-racing").unwrap_err().to_string();
        assert!(error.contains("--env") && error.contains("as in a pipeline file"), "{error}");
    }
}
