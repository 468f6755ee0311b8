//! The node's side of a job: reads what is to be done, runs the stage as the engine would here, and writes how it ended.

use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dril_stage_api::{Message, Registry};
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

use super::build;
use super::gpus;
use super::handoff::{Ended, Handoff, Home, How};
use crate::exec::{self, ChildRunner, EXIT_STOPPED, Exit, Failure, Launch, Runner};
use crate::fsx::{self, FsError};

/// The argument that makes this program run a job's stage: `dril-pipe __node FOLDER`.
pub const NODE: &str = "__node";

/// A scheduler that stops a job signals all its processes, and the stage may end before this one is signalled.
const SIGNALLED: Duration = Duration::from_millis(500);

/// How often a node writes how far its stage is.
const PROGRESS: Duration = Duration::from_secs(5);

/// What the environment of a job says about it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Assigned {
    /// The scheduler's ID of it; empty where that is unknown.
    pub job: String,
    /// The GPUs that it may use, as in `CUDA_VISIBLE_DEVICES`; `None` where that is not set.
    pub gpus: Option<String>,
}

/// Runs the stage of a job.
///
/// The answer to the engine is a file; the exit code is for the scheduler: 0 unless the stage was stopped from outside and
/// should run again.
///
/// # Errors
/// The answer cannot be written. The text is for the output of the job, whose last lines the engine shows.
pub fn run_on_node(folder: &Path, assigned: &Assigned, registry: &Registry) -> Result<ExitCode, String> {
    let home = Home::new(folder.to_owned());
    let node = Node::new(assigned, registry);
    if let Ok(Some(Handoff { stop_after: Some(seconds), .. })) = home.handoff() {
        node.stop_after(seconds);
    }
    match node.run(&home) {
        Ok(Some(ended)) => match report(&home, &ended) {
            Ok(()) => Ok(ExitCode::SUCCESS),
            Err(error) => Err(node.cannot_report(&ended, &error)),
        },
        Ok(None) => Ok(ExitCode::SUCCESS),
        Err(Interrupted) => Ok(ExitCode::from(EXIT_STOPPED)),
    }
}

/// The scheduler stopped the job: it decides whether the job runs again.
pub(super) struct Interrupted;

/// A job on its node: runs one stage, or one after the other.
pub(super) struct Node<'a> {
    job: &'a str,
    gpus: Option<&'a str>,
    name: String,
    registry: &'a Registry,
    runner: io::Result<ChildRunner>,
    /// The stage must save a checkpoint and stop.
    stop: Arc<AtomicBool>,
    /// The reason is the time limit of the job, or the end of the run.
    late: Arc<AtomicBool>,
}

impl<'a> Node<'a> {
    pub fn new(assigned: &'a Assigned, registry: &'a Registry) -> Self {
        let (stop, late) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        // Without a handler a signal kills the stage, which then resumes from its last checkpoint.
        for signal in [SIGTERM, SIGINT, SIGUSR1] {
            let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
        }
        let _ = signal_hook::flag::register(SIGUSR1, Arc::clone(&late));
        // This program starts nothing but stages.
        exec::claim_all_children();
        exec::raise_open_files();
        let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
        let Assigned { job, gpus } = assigned;
        let runner = ChildRunner::this_program();
        Self { job, gpus: gpus.as_deref(), name, registry, runner, stop, late }
    }

    /// Stops by itself after some seconds, as if the scheduler had signalled the end of its time.
    pub fn stop_after(&self, seconds: f64) {
        let (stop, late) = (Arc::clone(&self.stop), Arc::clone(&self.late));
        std::thread::spawn(move || {
            std::thread::sleep(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX));
            late.store(true, Ordering::SeqCst);
            stop.store(true, Ordering::SeqCst);
        });
    }

    /// True once the job was asked to stop.
    pub fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// As [`Self::is_stopping`], after a moment for the signal to arrive.
    fn is_about_to_stop(&self) -> bool {
        let began = Instant::now();
        while !self.is_stopping() && began.elapsed() < SIGNALLED {
            std::thread::sleep(SIGNALLED / 10);
        }
        self.is_stopping()
    }

    /// What to print where the engine cannot be notified how a stage ended. The engine shows the beginning of a long line.
    fn cannot_report(&self, ended: &Ended, error: &FsError) -> String {
        let before = match &ended.how {
            How::Failed(before) | How::OutOfMemory(before) => format!("; before that: {before}"),
            _ => String::new(),
        };
        let name = &self.name;
        format!(
            "on node `{name}`: every node must be able to write to the store, which needs free space: {error}{before}"
        )
    }

    /// How a stage ended that was stopped; `None` where the scheduler decides whether its job runs again.
    fn stopped(&self) -> Option<How> {
        self.late.load(Ordering::SeqCst).then_some(How::Stopped)
    }

    /// Runs the stage and returns how it ended; `None` where another job runs it, or it has ended before.
    pub fn run(&self, home: &Home) -> Result<Option<Ended>, Interrupted> {
        let ended =
            |how, messages| Ok(Some(Ended::new(self.job.to_owned(), self.name.clone(), how, messages)));
        let failed = |error: &dyn std::fmt::Display| ended(How::Failed(error.to_string()), Vec::new());
        match home.ended() {
            Ok(None) => {}
            // The job was started again after its end.
            Ok(Some(_)) => return Ok(None),
            Err(error) => return failed(&error),
        }
        if self.job.is_empty() {
            return failed(
                &"its job does not know its ID: set `job_variable` of its executor in `dril-pipe.toml`",
            );
        }
        match claim(home, self.job) {
            Ok(true) => {}
            Ok(false) => return Ok(None),
            Err(error) => return failed(&error),
        }
        let handoff = match home.handoff() {
            Ok(Some(handoff)) => handoff,
            Ok(None) => {
                let path = home.path("handoff.json");
                return failed(&format!("`{}` is not a job of this version", path.display()));
            }
            Err(error) => return failed(&error),
        };
        if let Err(error) = self.check_build(&handoff) {
            return failed(&error);
        }
        if let Err(error) = clear(home) {
            return failed(&error);
        }
        let (result, messages) = self.execute(home, &handoff);
        match result {
            Ok(Exit::Done) => ended(How::Done, messages),
            Ok(Exit::Stopped) => self.stopped().map_or(Err(Interrupted), |how| ended(how, messages)),
            Err(Failure::Stage(_)) if self.is_about_to_stop() => {
                self.stopped().map_or(Err(Interrupted), |how| ended(how, messages))
            }
            Err(Failure::OutOfMemory(error)) => ended(How::OutOfMemory(error), messages),
            Err(Failure::TimedOut(_)) => ended(How::TimedOut, messages),
            Err(failure) => ended(How::Failed(failure.to_string()), messages),
        }
    }

    /// Checks that engine and node run the same programs.
    fn check_build(&self, handoff: &Handoff) -> Result<(), String> {
        const REMEDY: &str = "use the same files everywhere, and run again";
        let (here, there) = (env!("CARGO_PKG_VERSION"), &handoff.tool);
        if here != there {
            return Err(format!(
                "`dril-pipe` is {here} on this node and {there} where the run was started: {REMEDY}"
            ));
        }
        let Ok(program) = std::env::current_exe() else { return Ok(()) };
        let worker = self.registry.get(&handoff.job.kind).and_then(|kind| kind.worker());
        match build::differing(&handoff.build, &build::of(&program, worker)) {
            Some(name) => Err(format!(
                "`{}` is not the build of `{name}` with which the run was started: it was built again while the job \
                 waited, or the node has a copy of its own: {REMEDY}",
                program.with_file_name(name).display()
            )),
            None => Ok(()),
        }
    }

    fn execute(&self, home: &Home, handoff: &Handoff) -> (Result<Exit, Failure>, Vec<Message>) {
        let mut messages = Vec::new();
        let Some(kind) = self.registry.get(&handoff.job.kind) else {
            let error = format!("this program has no kind `{}`", handoff.job.kind);
            return (Err(Failure::Stage(error)), messages);
        };
        let runner = match &self.runner {
            Ok(runner) => runner,
            Err(error) => return (Err(Failure::Stage(error.to_string())), messages),
        };
        if let Err(error) = runner.check(kind.worker()) {
            return (Err(Failure::Stage(error.to_string())), messages);
        }
        let (units, passed) = match (gpus::here(&handoff.units, self.gpus), home.environment()) {
            (Ok(units), Ok(passed)) => (units, passed),
            (Err(error), _) => return (Err(Failure::Stage(error)), messages),
            (_, Err(error)) => return (Err(Failure::Stage(error.to_string())), messages),
        };
        let launch = Launch {
            job: &handoff.job,
            kind: *kind,
            lock: None,
            log: &handoff.log,
            folder: &home.folder,
            threads: handoff.threads,
            units: &units,
            stop: &self.stop,
            grace: handoff.grace(),
            limits: handoff.limits(),
            // The engine has removed the checkpoint where the stage must start without it.
            fresh: false,
            inputs: None,
        };
        let mut next: Option<Instant> = None;
        let result = runner.passing(passed).run(&launch, &mut |message| match message {
            Message::Progress(progress) => {
                if next.is_none_or(|next| Instant::now() >= next) {
                    next = Some(Instant::now() + PROGRESS);
                    // Nothing depends on it.
                    let _ = home.write("progress", &progress);
                }
            }
            other => messages.push(other),
        });
        (result, messages)
    }
}

/// True where this job runs the stage, and no other one does: a submission may have been made twice.
fn claim(home: &Home, job: &str) -> fsx::Result<bool> {
    if fsx::create_exclusive(&home.path("claim"), job.as_bytes())? {
        return Ok(true);
    }
    // One that was started again is the same job.
    Ok(home.claimed_by()?.as_deref() == Some(job))
}

/// Removes what an earlier start of the job left, so that none of it is mistaken for an output.
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

/// Writes how a stage ended, and then the notice that the engine looks for.
pub(super) fn report(home: &Home, ended: &Ended) -> fsx::Result<()> {
    if let Err(error) = home.write("ended.json", ended) {
        if ended.how == How::Done {
            return Err(error);
        }
        // The outputs of a stage that failed may be what filled the disk.
        clear(home)?;
        home.write("ended.json", ended)?;
    }
    match home.notice() {
        // Where this fails, the engine finds out when the job is gone.
        Some(notice) => fsx::write(&notice, ended.job.as_bytes()),
        None => Ok(()),
    }
}
