//! What follows from the end of a job: results move to where the engine expects them, failures become errors that name the node
//! and the job.

use std::path::PathBuf;

use dril_stage_api::Message;

use super::handoff::{Ended, Home, How};
use super::prepare::OUTPUT;
use super::scheduler::JobId;
use crate::exec::{Exit, Failure, Launch};
use crate::fsx;
use crate::settings::JobSettings;
use crate::store;

/// How often a job that vanished, with its node or by a fault of the scheduler, is submitted again.
const LOST: u32 = 5;

/// Handles the end of jobs.
pub(super) struct Endings {
    /// The name of the scheduler, for errors.
    pub scheduler: String,
    /// The folder of all jobs.
    pub jobs: PathBuf,
}

impl Endings {
    /// Decides about a job that is over without a result: returns the job that really runs the stage, or none, to submit
    /// another.
    pub fn after_gone(
        &self,
        home: &Home,
        job: &JobId,
        end_state: &str,
        node: &str,
        lost: &mut u32,
    ) -> Result<Option<JobId>, Failure> {
        // Two jobs were submitted for the stage, and this one left it to the other.
        if let Some(other) = home.claimed_by()?
            && other != *job
        {
            return Ok(Some(other));
        }
        let place = if node.is_empty() { String::new() } else { format!(" on node `{node}`") };
        let scheduler = &self.scheduler;
        match end_state {
            "CANCELLED" => Err(Failure::Stage(format!(
                "its {scheduler} job {job} was cancelled{place}; the next run resumes from its checkpoint"
            ))),
            "OUT_OF_MEMORY" => Err(Failure::OutOfMemory(format!(
                "{scheduler} job {job} was killed{place} because it used more memory than it requested: give the stage \
                 more `memory`"
            ))),
            // Its time was over before the stage could stop, or it was lost with its node.
            _ if *lost < patience(home, end_state)? && end_state != "FAILED" => {
                *lost += 1;
                Ok(None)
            }
            _ => Err(Failure::Stage(format!(
                "{scheduler} job {job} ended{place} without a result ({end_state}){}",
                last_lines(home)
            ))),
        }
    }

    /// True where a stage that was stopped saved more than before. One that does not would begin again for ever.
    pub fn saved_more(&self, launch: &Launch<'_>, saved: &mut Option<Vec<String>>) -> Result<bool, Failure> {
        let mut now = Vec::new();
        for path in fsx::list(&launch.job.checkpoints)? {
            now.push(format!("{} {}", path.display(), fsx::identity(&path)?));
        }
        let more = !now.is_empty() && saved.as_ref() != Some(&now);
        *saved = Some(now);
        Ok(more)
    }

    /// The error for a stage that did not end within the time of its job and saved nothing.
    pub fn no_checkpoint(&self, ended: &Ended, settings: &JobSettings) -> Failure {
        let time = settings.time.map_or_else(String::new, |time| format!(" of {} min", time.as_secs() / 60));
        Failure::Stage(format!(
            "it did not end within the time{time} of its {} job {} on node `{}`, and saved no checkpoint to resume from: \
             raise `time` for it in `dril-pipe.toml`",
            self.scheduler, ended.job, ended.node
        ))
    }

    /// Moves the outputs of the stage to where the engine expects them.
    pub fn finish(
        &self,
        home: &Home,
        launch: &Launch<'_>,
        ended: Ended,
        on_message: &mut dyn FnMut(Message),
    ) -> Result<Exit, Failure> {
        ended.messages.into_iter().for_each(&mut *on_message);
        self.keep_log(home, launch)?;
        if home.folder == launch.folder {
            return Ok(Exit::Done);
        }
        for path in fsx::list(&home.folder)? {
            let Some(name) = path.file_name() else { continue };
            if name.to_string_lossy().starts_with("output-") {
                fsx::rename(&path, &launch.folder.join(name))?;
            }
        }
        let (inputs, here) = (home.path("inputs"), launch.folder.join("inputs"));
        if fsx::entry(&inputs)?.is_some() {
            if fsx::entry(&here)?.is_some() {
                // They are of an earlier engine, and only that one knew their times of change.
                if store::hash_folder(&inputs)?.digest() != store::hash_folder(&here)?.digest() {
                    return Err(Failure::ChangedInputs("(one of them)".to_owned()));
                }
            } else {
                fsx::rename(&inputs, &here)?;
            }
        }
        self.remove(home)?;
        Ok(Exit::Done)
    }

    /// Copies the log of a job that another engine submitted, which is in that engine's folder.
    pub fn keep_log(&self, home: &Home, launch: &Launch<'_>) -> Result<(), Failure> {
        if let Some(handoff) = home.handoff()?
            && handoff.log != launch.log
            && let Some(text) = fsx::read_if_there(&handoff.log)?
        {
            fsx::append(launch.log, &text)?;
        }
        Ok(())
    }

    pub fn failed(&self, home: &Home, launch: &Launch<'_>, ended: Ended) -> Failure {
        let place = format!("on node `{}` ({} job {})", ended.node, self.scheduler, ended.job);
        // The failure of the stage is the one to report.
        let _ = self.keep_log(home, launch);
        let _ = self.remove(home);
        match ended.how {
            How::OutOfMemory(error) => Failure::OutOfMemory(format!("{place}: {error}")),
            How::TimedOut => Failure::TimedOut(launch.limits.timeout.unwrap_or_default()),
            How::Failed(error) => Failure::Stage(format!("{place}: {error}")),
            How::Done | How::Stopped | How::Lost(_) => {
                Failure::Stage(format!("{place}: it ended unexpectedly"))
            }
        }
    }

    pub fn remove(&self, home: &Home) -> Result<(), Failure> {
        if let Some(notice) = home.notice() {
            fsx::remove_file(&notice)?;
        }
        // The stage's private folder belongs to its engine.
        if home.folder.starts_with(&self.jobs) {
            fsx::remove_dir_all(&home.folder)?;
        }
        Ok(())
    }
}
/// How often a lost job is submitted again. One that did not begin, for no known reason, probably will not the next time.
fn patience(home: &Home, end_state: &str) -> Result<u32, Failure> {
    let is_the_nodes_fault = ["BOOT_FAIL", "NODE_FAIL", "PREEMPTED", "TIMEOUT"].contains(&end_state);
    Ok(if is_the_nodes_fault || home.claimed_by()?.is_some() { LOST } else { 1 })
}

/// The last lines of the job's output, for a job that could not begin its stage.
fn last_lines(home: &Home) -> String {
    match fsx::tail(&home.path(OUTPUT), 5, 300) {
        Ok(lines) if !lines.is_empty() => format!(": {}", lines.join("; ")),
        // What a job prints is written by its node, too.
        _ => format!(
            ", and printed nothing: its node may not be able to write to `{}`, or have no free space there",
            home.folder.display()
        ),
    }
}
