//! The child's side of a stage: reads the job, runs the kind, says how it went. Dies with the engine that started it.

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

/// The exit code of a stage that was asked to stop and did (`EX_TEMPFAIL`: worth another try).
pub const EXIT_STOPPED: u8 = 75;

/// The child's side of [`super::ChildRunner`]: runs the job of a file. Stops at SIGTERM, SIGINT and SIGHUP, dies with the engine.
pub fn run_stage(job_file: &Path, registry: &Registry) -> ExitCode {
    die_with_the_engine();
    let cancel = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        // Without the handler the signal kills the stage: it goes on from its last checkpoint instead of a fresh one.
        let _ = signal_hook::flag::register(signal, Arc::clone(&cancel));
    }
    let mut messages = std::io::stdout();
    // A panic is on its way to the log already; what it said goes to the engine as well.
    let work = AssertUnwindSafe(|| perform(&read(job_file)?, registry, &cancel, &mut messages));
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
    let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("it does not say why");
    StageError::failed(format!("it panicked: {text}; the log says where"))
}

fn read(job_file: &Path) -> Result<Job, StageError> {
    let bytes = fsx::read(job_file).map_err(StageError::failed)?;
    serde_json::from_slice(&bytes)
        .map_err(|error| StageError::failed(format!("`{}` is no job: {error}", job_file.display())))
}

/// Runs a job in this thread.
///
/// # Errors
/// The job is not for this registry, or the stage fails.
pub(super) fn perform(
    job: &Job,
    registry: &Registry,
    cancel: &AtomicBool,
    messages: &mut dyn Write,
) -> Result<(), StageError> {
    let Some(kind) = registry.get(&job.kind) else {
        return Err(StageError::failed(format!("this program has no kind `{}`", job.kind)));
    };
    if kind.revision() != job.revision {
        return Err(StageError::failed(format!(
            "kind `{}` has revision {} here, but the run was planned with {}: build all executables anew",
            job.kind,
            kind.revision(),
            job.revision
        )));
    }
    let _alone = alone_in(&job.checkpoints).map_err(StageError::failed)?;
    kind.run(&job.params, &mut Ctx::new(job, cancel, messages))
}

/// Makes the folder for checkpoints and locks it: a stage of an engine that was killed may still be about to die.
fn alone_in(checkpoints: &Path) -> fsx::Result<Lock> {
    fsx::create_dir_all(checkpoints)?;
    Lock::acquire(&checkpoints.with_file_name("lock"))
}

/// Kills this process and all it started as soon as the engine is gone. The engine holds the other end of the standard
/// input and never writes to it, so its end is the engine's. A death signal of the kernel would not do: it takes only
/// this process, and leaves what it started.
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
            let _ = kill_current_process_group(Signal::KILL);
            std::process::abort();
        });
    }
}
