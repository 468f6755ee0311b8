//! The checkpoints of a stage as the engine sees them: it removes them where a stage must start without, and mentions them where
//! a stage failed after it had resumed. A checkpoint that was saved half, or by a faulty program, would block its stage for ever.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};

use dril_stage_api::Job;

use super::failure::Failure;
use super::options::POLL_INTERVAL;
use super::quote::quoted;
use super::runner::Launch;
use crate::fsx::{self, Lock};

/// How long before now the stage saved its checkpoint; `None` where there is none.
pub(super) fn saved(job: &Job) -> fsx::Result<Option<Duration>> {
    if fsx::list(&job.checkpoints)?.is_empty() {
        return Ok(None);
    }
    let saved = fsx::newest(&job.checkpoints)?;
    Ok(saved.map(|saved| SystemTime::now().duration_since(saved).unwrap_or_default()))
}

/// The file beside the checkpoints with the seconds that the stage computed until the last of them was saved.
fn spent_file(job: &Job) -> PathBuf {
    job.checkpoints.with_file_name("spent")
}

/// How long the stage computed before it resumed from its checkpoint: where an engine was killed, the time of its attempt is
/// unknown and not counted.
pub(super) fn spent(job: &Job) -> Duration {
    let text =
        fsx::read_if_there(&spent_file(job)).ok().flatten().and_then(|bytes| String::from_utf8(bytes).ok());
    let seconds = text.and_then(|text| text.trim().parse().ok());
    seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).unwrap_or_default()
}

/// Notes how long a stage that did not end computed for the checkpoint that it leaves: `before` in earlier attempts, and this one
/// up to the time when it saved. Only records are less exact without it, so it need not succeed.
pub(super) fn note_spent(job: &Job, before: Duration, began: SystemTime) {
    if let Ok(true) = fsx::list(&job.checkpoints).map(|files| !files.is_empty())
        && let Ok(Some(saved)) = fsx::newest(&job.checkpoints)
        && let Ok(now) = saved.duration_since(began)
    {
        let seconds = (before + now).as_secs_f64();
        let _ = fsx::write(&spent_file(job), format!("{seconds:.3}\n").as_bytes());
    }
}

/// Removes the checkpoints of a stage that must start without them. False where the run was stopped meanwhile.
///
/// # Errors
/// They can be neither moved nor removed.
pub(crate) fn discard(launch: &Launch<'_>) -> Result<bool, Failure> {
    let files = &launch.job.checkpoints;
    if !launch.fresh || fsx::entry(files)?.is_none() {
        return Ok(true);
    }
    // A built-in stage of a killed engine holds it, and may save once more before it is dead.
    let lock = files.with_file_name("lock");
    let _lock = loop {
        match Lock::try_acquire(&lock)? {
            Some(lock) => break lock,
            None if launch.stop.load(Ordering::Relaxed) => return Ok(false),
            None => std::thread::sleep(POLL_INTERVAL),
        }
    };
    match fsx::rename(files, &launch.folder.join("checkpoints")) {
        Err(error) if !error.is_not_found() => fsx::remove_dir_all(files)?,
        _ => {}
    }
    Ok(true)
}

/// Adds to the failure of a stage that resumed from a checkpoint how to start it without. Other failures stay: one that ran out of
/// time or memory made progress.
pub(super) fn mention(failure: Failure, stage: &str, saved: Option<Duration>) -> Failure {
    let (Some(saved), Failure::Stage(_) | Failure::MissingOutput(_) | Failure::WrongOutput { .. }) =
        (saved, &failure)
    else {
        return failure;
    };
    Failure::Stage(format!(
        "{failure}; it had resumed from the checkpoint that was saved {} before it started: if that is broken, `run --force {}` \
         starts without it",
        rough(saved),
        word(stage)
    ))
}

/// A duration in its largest unit that it has at least two of.
fn rough(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..120 => format!("{seconds} s"),
        seconds @ 120..7_200 => format!("{} min", seconds / 60),
        seconds @ 7_200..172_800 => format!("{} h", seconds / 3_600),
        seconds => format!("{} d", seconds / 86_400),
    }
}

/// A stage as one word of a shell.
fn word(stage: &str) -> String {
    let is_plain = stage.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    if is_plain { stage.to_owned() } else { quoted(stage) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_failure_of_a_stage_that_resumed_mentions_the_checkpoint() {
        let failed = || Failure::Stage("exit code 1".to_owned());
        let hour = Some(Duration::from_secs(3_600));
        assert_eq!(mention(failed(), "a", None).to_string(), "exit code 1");
        assert_eq!(
            mention(failed(), "a[x=1, y=it's]", hour).to_string(),
            "exit code 1; it had resumed from the checkpoint that was saved 60 min before it started: if that is broken, \
             `run --force 'a[x=1, y=it'\\''s]'` starts without it"
        );
        let missing = mention(Failure::MissingOutput("o".to_owned()), "a-b", hour).to_string();
        assert!(missing.ends_with("`run --force a-b` starts without it"), "{missing}");
        let late = mention(Failure::TimedOut(Duration::from_secs(1)), "a", hour);
        assert!(matches!(late, Failure::TimedOut(_)), "{late}");
    }
}
