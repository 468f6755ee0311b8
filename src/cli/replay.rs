//! `dril-pipe replay`: finds a policy and the environment that it was made for, and has an episode drawn by the program
//! that can act.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use dril_stage_api::{Artifact, Registry};
use serde_json::{Value, json};

use super::args::ReplayArgs;
use super::inspect::pick_stages;
use super::pipeline;
use crate::error::{Error, ErrorKind, exit_codes};
use crate::fsx::{self, Entry};
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::store::Store;

/// The executable, beside this one, that acts.
const WORKER: &str = "dril-pipe-learn";
/// What it can write.
const ENDINGS: [&str; 3] = ["gif", "apng", "png"];
/// The name of the service that it is asked for.
const SERVICE: &str = "__replay";

pub(super) fn main(args: &ReplayArgs, registry: &Registry) -> Result<ExitCode, Error> {
    check_out(&args.out)?;
    let (policy, env) = match fsx::entry(Path::new(&args.policy)) {
        Ok(Some(Entry::File(_))) => (PathBuf::from(&args.policy), None),
        _ => from_pipeline(args, registry)?,
    };
    let env = match &args.env {
        Some(text) => Some(read_env(text)?),
        None => env,
    };
    let order = json!({
        "policy": policy, "env": env, "seed": args.seed, "mode": args.mode.name(), "out": args.out, "width": args.width,
        "every": args.every, "speed": args.speed
    });
    let program = std::env::current_exe()
        .map_err(|error| Error::new(ErrorKind::Io, format!("cannot find this program's file: {error}")))?
        .with_file_name(format!("{WORKER}{}", std::env::consts::EXE_SUFFIX));
    let status =
        Command::new(&program).args([SERVICE, &order.to_string()]).stdin(Stdio::null()).status().map_err(
            |error| {
                let message = format!("cannot start `{}`: {error}", program.display());
                Error::new(ErrorKind::Io, message).hint("it is built together with this program")
            },
        )?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(exit_codes::STAGE_FAILED)))
}

/// Finds out that the file cannot be written before an episode is played for it.
fn check_out(out: &Path) -> Result<(), Error> {
    let ending = out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    if !ENDINGS.contains(&ending) {
        let message = format!("`--out {}` ends in none of `.gif`, `.apng` and `.png`", out.display());
        return Err(Error::new(ErrorKind::Usage, message)
            .hint("`.gif` and `.apng` are videos, `.png` is six moments side by side"));
    }
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match fsx::outside(folder) {
        Ok(fsx::Outside::Folder) => Ok(()),
        _ => Err(Error::new(
            ErrorKind::Io,
            format!("there is no folder `{}`, into which `--out` leads", folder.display()),
        )),
    }
}

fn read_env(text: &str) -> Result<Value, Error> {
    serde_saphyr::from_str(text).map_err(|error| {
        let message = format!("`--env {text}` cannot be read: {error}");
        Error::new(ErrorKind::Usage, message)
            .hint("it is written as in a pipeline file: `{ car-racing: { version: v3 } }`")
    })
}

/// The finished policy of `FILE:STAGE.OUTPUT`, and the environment of the stages that it comes from.
fn from_pipeline(args: &ReplayArgs, registry: &Registry) -> Result<(PathBuf, Option<Value>), Error> {
    let Some((file, wanted)) = split(&args.policy) else {
        let error = Error::new(ErrorKind::Usage, format!("there is no file `{}`", args.policy));
        return Err(error
            .hint("name a policy's file, or a stage as in `pipelines/thesis.yaml:dril.peak[policy=beta]`"));
    };
    let pipeline = args.pipeline(file);
    let graph = pipeline::load(&pipeline, registry)?;
    let (word, output) = parts(wanted);
    let (index, output) = policy_of(&graph, &word, output)?;
    let store = pipeline::store(&args.store)?;
    let plan = plan::plan(&graph, &store, &pipeline::base(&pipeline))?;
    let policy = finished(&plan, index, output, &store).ok_or_else(|| {
        let (id, profile) = (&graph.stages[index].id, &graph.profile);
        let message = format!("`{id}` has not been run with profile `{profile}` as the file is now");
        Error::new(ErrorKind::Pipeline, message)
            .hint(format!("run it first: `dril-pipe run {file} --profile {profile}`"))
    })?;
    Ok((policy, env_of(&graph, index)))
}

/// The one stage that `word` names, and its one output that is a policy (and is called `output`).
fn policy_of(graph: &Graph, word: &str, output: Option<&str>) -> Result<(StageIndex, &'static str), Error> {
    let usage = |message: String| Error::new(ErrorKind::Usage, message);
    let found = pick_stages(graph, &[word.to_owned()])?;
    let [index] = found[..] else {
        let ids: Vec<&str> = found.iter().map(|index| &*graph.stages[*index].id).collect();
        return Err(usage(format!("`{word}` names {} stages, expected one", found.len()))
            .hint(format!("name one of: {}", ids.join("; "))));
    };
    let stage = &graph.stages[index];
    let policies = stage.ports.outputs.iter().filter(|port| port.artifact == Artifact::Policy);
    let policies: Vec<&'static str> = policies.map(|port| port.name).collect();
    let named: Vec<_> = policies.iter().filter(|name| output.is_none_or(|output| output == **name)).collect();
    match named[..] {
        [name] => Ok((index, name)),
        _ if policies.is_empty() => Err(usage(format!("`{}` makes no policy", stage.id))),
        _ => Err(usage(format!("which policy of `{}`?", stage.id)).hint(format!(
            "name one of its outputs, as in `{}.{}`",
            stage.id,
            policies.join(&format!("` or `{}.", stage.id))
        ))),
    }
}

/// File and stage of `FILE:STAGE`, where there is such a file; a path may have colons itself.
fn split(text: &str) -> Option<(&str, &str)> {
    text.match_indices(':')
        .map(|(at, _)| (&text[..at], &text[at + 1..]))
        .find(|(file, _)| matches!(fsx::entry(Path::new(file)), Ok(Some(Entry::File(_)))))
}

/// The stage and its output: both `dril.peak[policy=beta]` and `dril[policy=beta].peak` are understood.
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

/// The parameter `env` of the stage, or of the nearest one that feeds it and has one.
fn env_of(graph: &Graph, stage: StageIndex) -> Option<Value> {
    let mut near = vec![stage];
    let mut at = 0;
    while let Some(index) = near.get(at).copied() {
        if let Some(env) = graph.stages[index].params.get("env") {
            return Some(env.clone());
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
    fn a_file_that_cannot_be_written_is_told_before_anything_is_played() {
        let code = |out: &str| check_out(Path::new(out)).map_err(|error| error.kind()).err();
        assert_eq!(code("x.gif"), None);
        assert_eq!(code("x.mp4"), Some(ErrorKind::Usage));
        assert_eq!(code("x"), Some(ErrorKind::Usage));
        assert_eq!(code("no/such/folder/x.png"), Some(ErrorKind::Io));
    }

    #[test]
    fn an_environment_is_read_as_in_a_pipeline_file() {
        assert_eq!(
            read_env("{ gymnasium: ALE/Breakout-v5 }").unwrap(),
            json!({ "gymnasium": "ALE/Breakout-v5" })
        );
        let error = read_env("{ car-racing").unwrap_err().to_string();
        assert!(error.contains("--env") && error.contains("as in a pipeline file"), "{error}");
    }
}
