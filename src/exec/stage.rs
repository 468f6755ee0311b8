//! The child process of a stage: reads the job file, runs the kind, reports the result. Dies with the engine that started it.

use std::any::Any;
use std::io::{Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use dril_stage_api::{Ctx, Job, Message, Registry, StageError};
use rustix::process::{Signal, getpgrp, getpid, kill_current_process_group};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::fsx::{self, Lock};

/// The exit code of a stage that stopped on request (`EX_TEMPFAIL`: try again later).
pub const EXIT_STOPPED: u8 = 75;

/// The child process of [`super::ChildRunner`]: runs the job in a job file. Stops at SIGTERM, SIGINT and SIGHUP; dies with the
/// engine.
pub fn run_stage(job_file: &Path, registry: &Registry) -> ExitCode {
    die_with_the_engine();
    let cancel = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        // Without the handler the signal just kills the stage, which then resumes from an older checkpoint.
        let _ = signal_hook::flag::register(signal, Arc::clone(&cancel));
    }
    let mut messages = std::io::stdout();
    // The panic message is in the log already; this sends it to the engine, too.
    let work =
        AssertUnwindSafe(|| perform(&read(job_file)?, registry, &cancel, &mut messages, Some(end_group)));
    let result = catch_unwind(work).unwrap_or_else(|payload| Err(panicked(payload.as_ref())));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(StageError::Cancelled) => ExitCode::from(EXIT_STOPPED),
        Err(error) => {
            let message = Message::Failed { error: error.to_string() };
            let _ = writeln!(messages, "{}", message.to_line()).and_then(|()| messages.flush());
            ExitCode::FAILURE
        }
    }
}

fn panicked(payload: &dyn Any) -> StageError {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
    StageError::failed(format!("it panicked: {text}; see the log"))
}

fn read(job_file: &Path) -> Result<Job, StageError> {
    let bytes = fsx::read(job_file).map_err(StageError::failed)?;
    serde_json::from_slice(&bytes)
        .map_err(|error| StageError::failed(format!("`{}` is not a job file: {error}", job_file.display())))
}

/// Runs a job in this thread. `on_loss` is called in another one once another machine, which saw no sign of life of this one for
/// long, has taken the checkpoint over: this process must not write it any more.
///
/// # Errors
/// The job is not for this registry, or the stage fails.
pub(super) fn perform(
    job: &Job,
    registry: &Registry,
    cancel: &AtomicBool,
    messages: &mut dyn Write,
    on_loss: Option<fn()>,
) -> Result<(), StageError> {
    let Some(kind) = registry.get(&job.kind) else {
        return Err(StageError::failed(format!("this executable has no stage kind `{}`", job.kind)));
    };
    if kind.revision() != job.revision {
        return Err(StageError::failed(format!(
            "kind `{}` has revision {} in this executable, but the run was planned with revision {}: rebuild all executables",
            job.kind,
            kind.revision(),
            job.revision
        )));
    }
    let lock = lock_checkpoints(&job.checkpoints).map_err(StageError::failed)?;
    if let Some(end) = on_loss {
        lock.on_loss(end);
    }
    kind.run(&job.params, &mut Ctx::new(job, cancel, messages))
}

/// Creates the folder for checkpoints and locks it: the same stage of a killed engine may still be alive for a moment.
fn lock_checkpoints(checkpoints: &Path) -> fsx::Result<Lock> {
    fsx::create_dir_all(checkpoints)?;
    Lock::acquire(&checkpoints.with_file_name("lock"))
}

/// Kills this process and all processes that it started as soon as the engine is gone. The engine holds the other end of
/// stdin and never writes to it, so end of file means that the engine has died. The kernel's parent-death signal would kill
/// only this process and leave its children.
fn die_with_the_engine() {
    let started_by_an_engine = getpgrp() == getpid() && fsx::is_pipe(&std::io::stdin());
    if started_by_an_engine {
        std::thread::spawn(|| {
            let mut byte = [0];
            loop {
                match std::io::stdin().read(&mut byte) {
                    Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                    Ok(1..) => {}
                    Ok(0) | Err(_) => break,
                }
            }
            end_group();
        });
    }
}

/// Ends this process and all that it started.
fn end_group() {
    if getpgrp() == getpid() {
        let _ = kill_current_process_group(Signal::KILL);
    }
    std::process::abort();
}
