//! From a stage to a job: its paths, its script, and the resources that it requests.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::time::Duration;

use dril_stage_api::Job;

use super::gpus;
use super::handoff::Home;
use super::scheduler::{Scheduler, Submission};
use super::site::Site;
use crate::exec::{Launch, quoted};
use crate::settings::JobSettings;

/// How long before the end of its time a job gets the signal to stop, unless it is set.
pub(super) const SIGNAL: Duration = Duration::from_secs(60);

/// The environment variable with the ID of a job, where that is not `SLURM_JOB_ID`.
pub const JOB: &str = "DRIL_PIPE_JOB";

/// The name of the file with the output of a job's script, in the job's folder.
pub(super) const OUTPUT: &str = "job.out";

/// The script of a job: `program argument folder` after the user's own lines. `job` is how the shell finds the job's ID.
///
/// A job finds programs where the run does, whether its scheduler passes the environment or not.
pub(super) fn script(
    site: &Site,
    argument: &str,
    folder: &Path,
    settings: &JobSettings,
    job: Option<String>,
) -> String {
    let setup = settings.setup.iter().flatten().fold(String::new(), |text, line| text + line + "\n");
    // Commands that list jobs may shorten `12.server`.
    let job =
        job.map_or_else(String::new, |job| format!("{JOB}=\"{job}\"\nexport {JOB}=\"${{{JOB}%%.*}}\"\n"));
    let path = site.environment.get(OsStr::new("PATH")).and_then(|path| path.to_str());
    let path =
        path.map_or_else(String::new, |path| format!("export PATH={}\"${{PATH:+:$PATH}}\"\n", quoted(path)));
    // The scheduler signals the script's process, so the program must replace it.
    let (program, folder) = (quoted(&site.program.to_string_lossy()), quoted(&folder.to_string_lossy()));
    format!("#!/bin/bash\n{path}{setup}{job}exec {program} {argument} {folder}\n")
}

/// The variables of the run that the stage's program gets besides those in its key. One that is not set there has the value
/// that it has in the job.
pub(super) fn passed(launch: &Launch<'_>, site: &Site) -> BTreeMap<String, OsString> {
    let names = launch.kind.passed(&launch.job.params);
    names
        .filter_map(|name| Some((name.to_owned(), site.environment.get(OsStr::new(name))?.clone())))
        .collect()
}

/// The name of a stage, without what it is an instance of: `dril` of `dril[policy=beta]`.
pub(super) fn name_of(stage: &str) -> &str {
    stage.split('[').next().unwrap_or(stage)
}

/// How long a job may run until it stops by itself, where the scheduler sends no signal before the end of its time.
pub(super) fn stop_after(
    scheduler: &dyn Scheduler,
    submission_time: Option<Duration>,
    settings: &JobSettings,
) -> Option<f64> {
    let time = submission_time.filter(|_| !scheduler.signals_before_the_end())?;
    Some(time.saturating_sub(settings.signal.unwrap_or(SIGNAL)).as_secs_f64())
}

/// The resources that a job requests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Wanted {
    pub threads: usize,
    /// In bytes; `None` for the partition's default.
    pub memory: Option<u64>,
    /// `None` for the partition's default.
    pub time: Option<Duration>,
    pub gpus: usize,
}

impl Wanted {
    pub fn of(launch: &Launch<'_>, settings: &JobSettings) -> Self {
        let signal = settings.signal.unwrap_or(SIGNAL);
        Self {
            threads: settings.threads.map_or(launch.threads, usize::from),
            memory: launch.limits.memory.or(settings.memory),
            // A stage that has a limit of its own needs that, and time to begin and to save.
            time: settings.time.or_else(|| launch.limits.timeout.map(|limit| limit + signal + SIGNAL)),
            gpus: launch.units.get(gpus::NAME).map_or(0, Vec::len),
        }
    }
}

/// The job for a folder with a script.
pub(super) fn submission(name: String, home: &Home, settings: &JobSettings, wanted: &Wanted) -> Submission {
    let Wanted { threads, memory, time, gpus } = *wanted;
    Submission {
        name,
        script: home.path("job.sh"),
        folder: home.folder.clone(),
        threads,
        memory,
        time,
        signal: settings.signal.unwrap_or(SIGNAL),
        gpus,
        partition: settings.partition.clone(),
        account: settings.account.clone(),
        qos: settings.qos.clone(),
        extra: settings.extra.clone().unwrap_or_default(),
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
