//! The node's side of a job: reads what is to be done, runs the stage as the engine would here, and says how it ended.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dril_stage_api::{Message, Registry};
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

use super::handoff::{Ended, Handoff, Home, How};
use crate::exec::{self, ChildRunner, EXIT_STOPPED, Exit, Failure, Launch, Runner};
use crate::fsx;

/// The argument that makes this program run a job's stage: `dril-pipe __node FOLDER`.
pub const NODE: &str = "__node";

/// How often a node writes how far its stage is.
const PROGRESS: Duration = Duration::from_secs(5);

/// Runs the stage of a job. `job` is the scheduler's number of it.
///
/// The answer to the engine is a file; the exit code is for the scheduler: 0 unless the stage was stopped from outside and
/// should run again, or nothing could be written.
pub fn run_on_node(folder: &Path, job: &str, registry: &Registry) -> ExitCode {
    let home = Home::new(folder.to_owned());
    match run(&home, job, registry) {
        Ok(Some(ended)) => match say(&home, &ended) {
            Ok(()) => ExitCode::SUCCESS,
            // Nothing can be said but to the scheduler and to the job's output.
            Err(_) => ExitCode::FAILURE,
        },
        Ok(None) => ExitCode::SUCCESS,
        Err(Interrupted) => ExitCode::from(EXIT_STOPPED),
    }
}

/// The scheduler stopped the job: it decides whether the job runs again.
struct Interrupted;

/// How the stage ended; `None` where another job has it, or had it.
fn run(home: &Home, job: &str, registry: &Registry) -> Result<Option<Ended>, Interrupted> {
    let node = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let ended = |how, said| Ok(Some(Ended::new(job.to_owned(), node.clone(), how, said)));
    let failed = |error: &dyn std::fmt::Display| ended(How::Failed(error.to_string()), Vec::new());
    match home.ended() {
        Ok(None) => {}
        // It was started again after its end.
        Ok(Some(_)) => return Ok(None),
        Err(error) => return failed(&error),
    }
    match claim(home, job) {
        Ok(true) => {}
        Ok(false) => return Ok(None),
        Err(error) => return failed(&error),
    }
    let handoff = match home.handoff() {
        Ok(Some(handoff)) => handoff,
        Ok(None) => {
            return failed(&format!("`{}` is no job of this version", home.path("handoff.json").display()));
        }
        Err(error) => return failed(&error),
    };
    if handoff.tool != env!("CARGO_PKG_VERSION") {
        let (here, there) = (env!("CARGO_PKG_VERSION"), &handoff.tool);
        return failed(&format!("`dril-pipe` is {here} on this node and {there} where the run was started"));
    }
    if let Err(error) = clear(home) {
        return failed(&error);
    }
    let (stop, late) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    // Without a handler a signal kills the stage, which then goes on from its last checkpoint.
    for signal in [SIGTERM, SIGINT, SIGUSR1] {
        let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
    }
    let _ = signal_hook::flag::register(SIGUSR1, Arc::clone(&late));
    let (result, said) = execute(home, &handoff, registry, &stop);
    match result {
        Ok(Exit::Done) => ended(How::Done, said),
        Ok(Exit::Stopped) if late.load(Ordering::SeqCst) => ended(How::Stopped, said),
        Ok(Exit::Stopped) => Err(Interrupted),
        Err(Failure::OutOfMemory(error)) => ended(How::OutOfMemory(error), said),
        Err(Failure::TimedOut(_)) => ended(How::TimedOut, said),
        Err(failure) => ended(How::Failed(failure.to_string()), said),
    }
}

fn execute(
    home: &Home,
    handoff: &Handoff,
    registry: &Registry,
    stop: &AtomicBool,
) -> (Result<Exit, Failure>, Vec<Message>) {
    let mut said = Vec::new();
    let Some(kind) = registry.get(&handoff.job.kind) else {
        return (Err(Failure::Stage(format!("this program has no kind `{}`", handoff.job.kind))), said);
    };
    // This program starts nothing but the stage.
    exec::claim_all_children();
    let runner = match ChildRunner::this_program() {
        Ok(runner) => runner,
        Err(error) => return (Err(error.into()), said),
    };
    if let Err(error) = runner.check(kind.worker()) {
        return (Err(Failure::Stage(error.to_string())), said);
    }
    let launch = Launch {
        job: &handoff.job,
        kind: *kind,
        lock: None,
        log: &handoff.log,
        folder: &home.folder,
        threads: handoff.threads,
        units: &handoff.units,
        stop,
        grace: handoff.grace(),
        limits: handoff.limits(),
    };
    let mut next: Option<Instant> = None;
    let result = runner.run(&launch, &mut |message| match message {
        Message::Progress(progress) => {
            if next.is_none_or(|next| Instant::now() >= next) {
                next = Some(Instant::now() + PROGRESS);
                // Nothing depends on it.
                let _ = home.write("progress", &progress);
            }
        }
        other => said.push(other),
    });
    (result, said)
}

/// True where this job runs the stage, and no other one does: a submission may have been made twice.
fn claim(home: &Home, job: &str) -> fsx::Result<bool> {
    if fsx::create_exclusive(&home.path("claim"), job.as_bytes())? {
        return Ok(true);
    }
    // One that was started again is the same job.
    Ok(home.claimed_by()?.as_deref() == Some(job))
}

/// Removes what an earlier start of the job left: none of it may be taken for an output.
fn clear(home: &Home) -> fsx::Result<()> {
    for path in fsx::list(&home.folder)? {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if name.starts_with("output-") || name == "work" {
            match fsx::entry(&path)? {
                Some(fsx::Entry::Folder) => fsx::remove_dir_all(&path)?,
                _ => drop(fsx::remove_file(&path)?),
            }
        }
    }
    Ok(())
}

fn say(home: &Home, ended: &Ended) -> fsx::Result<()> {
    home.write("ended.json", ended)?;
    match home.notice() {
        // Where this fails, the engine finds out when the job is gone.
        Some(notice) => fsx::write(&notice, ended.job.as_bytes()),
        None => Ok(()),
    }
}
