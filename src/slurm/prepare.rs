//! From a stage to a job: its paths, its script, and what it asks of the scheduler.

use std::path::Path;
use std::time::Duration;

use dril_stage_api::Job;

use super::handoff::Home;
use super::node::NODE;
use super::scheduler::Submission;
use crate::exec::Launch;
use crate::settings::JobSettings;

/// How long before the end of its time a job is asked to stop, unless it is set.
pub(super) const SIGNAL: Duration = Duration::from_secs(60);

/// What Slurm starts.
pub(super) fn script(program: &Path, home: &Home, settings: &JobSettings) -> String {
    let setup = settings.setup.iter().flatten().fold(String::new(), |text, line| text + line + "\n");
    // Slurm signals the script's process: the program takes its place.
    let (program, folder) = (quoted(program), quoted(&home.folder));
    format!("#!/bin/bash\n{setup}exec {program} {NODE} {folder}\n")
}

/// The name of a stage, without what it is an instance of: `dril` of `dril[policy=beta]`.
pub(super) fn name_of(stage: &str) -> &str {
    stage.split('[').next().unwrap_or(stage)
}

/// What is asked of the scheduler for a stage.
pub(super) fn submission(
    name: String,
    home: &Home,
    launch: &Launch<'_>,
    settings: &JobSettings,
) -> Submission {
    let word =
        |option: &str, value: &Option<String>| value.as_ref().map(|value| format!("--{option}={value}"));
    let mut words: Vec<String> = [
        word("partition", &settings.partition),
        word("account", &settings.account),
        word("qos", &settings.qos),
    ]
    .into_iter()
    .flatten()
    .collect();
    words.extend(settings.extra.iter().flatten().cloned());
    let signal = settings.signal.unwrap_or(SIGNAL);
    // A stage that has a limit of its own needs that, and time to begin and to save.
    let time = settings.time.or_else(|| launch.limits.timeout.map(|limit| limit + signal + SIGNAL));
    Submission {
        name,
        script: home.path("job.sh"),
        folder: home.folder.clone(),
        threads: settings.threads.map_or(launch.threads, usize::from),
        memory: launch.limits.memory.or(settings.memory),
        time,
        signal,
        gpus: launch.units.get("gpu").map_or(0, Vec::len),
        words,
    }
}

/// The job with all paths below `from` moved below `to`.
pub(super) fn moved(job: &Job, from: &Path, to: &Path) -> Job {
    let mut job = job.clone();
    let paths = job.inputs.values_mut().flatten().map(|input| &mut input.path);
    let paths = paths.chain(job.outputs.values_mut().map(|output| &mut output.path));
    for path in paths.chain([&mut job.scratch]) {
        if let Ok(inside) = path.strip_prefix(from) {
            *path = to.join(inside);
        }
    }
    job
}

/// In single quotes, for a shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.to_string_lossy().replace('\'', "'\\''"))
}
