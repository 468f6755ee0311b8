//! Runs each stage as a Slurm job of its own. Light stages run beside the engine.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use dril_stage_api::{Kind, Message, Progress};

use super::handoff::{Ended, Handoff, Home, How, Submitted, notices};
use super::prepare::{SIGNAL, moved, name_of, script, submission};
use super::scheduler::{JobId, Scheduler, SubmitError};
use super::threads::Threads;
use super::watch::{News, Pace, Watch};
use crate::exec::{ChildRunner, Exit, Failure, Launch, Runner};
use crate::fsx;
use crate::settings::{JobSettings, SlurmSettings};
use crate::store;

/// How soon a request to stop is noticed by a thread that waits for a job; there may be a thousand of them.
const WAIT: Duration = Duration::from_millis(250);
/// How often the progress of a running job is read.
const PROGRESS: Duration = Duration::from_secs(5);
/// How long a scheduler may be busy or away until a submission fails.
const PATIENCE: Duration = Duration::from_secs(3600);
/// The longest pause between two attempts to submit.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// How often a job that vanished, with its node or by a fault of Slurm, is submitted again.
const LOST: u32 = 5;

/// Runs stages on a Slurm cluster.
pub struct SlurmRunner {
    scheduler: Arc<dyn Scheduler>,
    settings: SlurmSettings,
    /// This program, as nodes see it.
    program: PathBuf,
    /// The folder of all jobs, in the store.
    jobs: PathBuf,
    /// For stages that run beside the engine.
    local: ChildRunner,
    local_threads: Threads,
    watch: Watch,
    /// One submission at a time: schedulers punish storms.
    submitting: Mutex<()>,
    /// Jobs stay when the run is stopped.
    detach: bool,
    number: AtomicUsize,
}

/// How waiting for a job ended.
enum Waited {
    Ended(Ended),
    Gone {
        word: String,
        node: String,
    },
    /// The run was stopped, and the job was left to go on.
    Left,
}

impl SlurmRunner {
    /// A runner for the store in `store`, a folder that nodes see under the same path.
    ///
    /// # Errors
    /// This program's file is unknown, or the store cannot be written.
    pub fn new(
        scheduler: Arc<dyn Scheduler>,
        settings: SlurmSettings,
        store: &Path,
        detach: bool,
        pace: Pace,
    ) -> Result<Self, Failure> {
        let jobs = store.join("slurm-v1");
        fsx::create_dir_all(&notices(&jobs))?;
        let local = ChildRunner::this_program()?;
        Ok(Self {
            watch: Watch::start(Arc::clone(&scheduler), notices(&jobs), pace)?,
            scheduler,
            settings,
            program: std::env::current_exe()?,
            jobs,
            local,
            local_threads: Threads::of_this_machine(),
            submitting: Mutex::new(()),
            detach,
            number: AtomicUsize::new(0),
        })
    }

    /// As it is, with another program on the nodes and for stages beside the engine: `program __node FOLDER`.
    #[must_use]
    pub fn with_program(mut self, program: PathBuf) -> Self {
        self.local = ChildRunner::new(program.clone(), ["__stage".into()]);
        self.program = program;
        self
    }

    /// True for a stage that runs beside the engine: what takes seconds is done before a job begins.
    fn is_local(&self, kind: Kind) -> bool {
        match &self.settings.local {
            Some(kinds) => kinds.iter().any(|name| name == kind.name()),
            None => kind.worker().is_none() && !kind.is_program(),
        }
    }

    /// The job's folder: one that the next engine finds, where the work has a key; else the stage's own.
    fn home(&self, launch: &Launch<'_>) -> Home {
        let checkpoints = launch.job.checkpoints.parent();
        let key = checkpoints.and_then(Path::file_name).filter(|_| {
            let above = checkpoints.and_then(Path::parent).and_then(Path::file_name);
            above.is_some_and(|name| name == "checkpoints-v1")
        });
        Home::new(key.map_or_else(|| launch.folder.to_owned(), |key| self.jobs.join(key)))
    }

    fn run_job(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        let home = self.home(launch);
        let settings = self.settings.of(name_of(&launch.job.stage), launch.kind.name());
        let mut adopted = self.adopt(&home)?;
        if adopted.is_none() && !matches!(home.ended()?, Some(Ended { how: How::Done, .. })) {
            self.prepare(&home, launch, &settings)?;
        }
        // What became of a job of an earlier engine is that engine's matter.
        let mut of_another = adopted.clone();
        let (mut lost, mut saved) = (0, None);
        loop {
            let ended = match home.ended()? {
                Some(ended) => ended,
                None => {
                    let job = match adopted.take() {
                        Some(job) => job,
                        None => match self.submit(&home, launch, &settings)? {
                            Some(job) => job,
                            None => return self.stopped(&home),
                        },
                    };
                    match self.wait(&home, job.clone(), launch, on_message)? {
                        Waited::Ended(ended) => ended,
                        Waited::Left => return Ok(Exit::Stopped),
                        Waited::Gone { word, node } => {
                            if stopping(launch) {
                                return self.stopped(&home);
                            }
                            if of_another.take().is_none_or(|other| other != job) {
                                adopted = self
                                    .after_gone(&home, &job, &word, &node, &mut lost)
                                    .inspect_err(|_| drop(self.remove(&home)))?;
                            }
                            continue;
                        }
                    }
                }
            };
            match ended.how {
                How::Done => return self.finish(&home, launch, ended, on_message),
                How::Stopped if stopping(launch) => return self.stopped(&home),
                How::Stopped => {
                    self.check_progress(launch, &ended, &settings, &mut saved)?;
                    home.clear_results()?;
                }
                _ => return Err(self.failed(&home, launch, ended)),
            }
        }
    }

    /// The job that an engine before this one submitted for this work, where it may still be there.
    fn adopt(&self, home: &Home) -> Result<Option<JobId>, Failure> {
        if home.ended()?.is_some() {
            return Ok(None);
        }
        let Some(submitted) = home.read::<Submitted>("submitted.json")? else { return Ok(None) };
        if let Some(job) = home.claimed_by()?.or(submitted.job) {
            // Where it is not there any more, the watch says so.
            return Ok(Some(job));
        }
        // It died between the submission and its answer.
        let began = Instant::now();
        loop {
            match self.scheduler.find(&submitted.name) {
                Ok(job) => return Ok(job),
                Err(error) if began.elapsed() > PATIENCE => return Err(unreachable(&error)),
                Err(_) => std::thread::sleep(Duration::from_secs(1)),
            }
        }
    }

    /// Makes the job's folder from the stage's: what is laid out there moves, and paths with it.
    fn prepare(&self, home: &Home, launch: &Launch<'_>, settings: &JobSettings) -> Result<(), Failure> {
        if home.folder != launch.folder {
            fsx::remove_dir_all(&home.folder)?;
            fsx::create_dir_all(&home.folder)?;
            let inputs = launch.folder.join("inputs");
            if fsx::entry(&inputs)?.is_some() {
                // The files themselves stay untouched, so that it can be told whether the stage changed them.
                fsx::rename(&inputs, &home.path("inputs"))?;
            }
        }
        let job = moved(launch.job, launch.folder, &home.folder);
        let threads = settings.threads.map_or(launch.threads, usize::from);
        let handoff = Handoff::new(job, launch.log, threads, launch.units, &launch.limits, launch.grace);
        home.write("handoff.json", &handoff)?;
        fsx::write_atomic(&home.path("job.sh"), script(&self.program, home, settings).as_bytes())?;
        Ok(())
    }

    /// Submits the job; `None` where the run was stopped meanwhile. A scheduler that is busy is asked again.
    fn submit(
        &self,
        home: &Home,
        launch: &Launch<'_>,
        settings: &JobSettings,
    ) -> Result<Option<JobId>, Failure> {
        home.clear_results()?;
        let number = self.number.fetch_add(1, Ordering::Relaxed);
        let key = home.folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let key: String = key.chars().take(12).collect();
        let name = format!("dril-{key}-{}-{number}", std::process::id());
        let submission = submission(name.clone(), home, launch, settings);
        home.write("submitted.json", &Submitted { name: name.clone(), job: None })?;
        let (began, mut pause) = (Instant::now(), Duration::from_secs(1));
        let job = loop {
            if stopping(launch) {
                return Ok(None);
            }
            let answer = {
                let _alone = self.submitting.lock().unwrap_or_else(PoisonError::into_inner);
                self.scheduler.submit(&submission)
            };
            match answer {
                Ok(job) => break job,
                Err(SubmitError::Refused(error)) => {
                    return Err(Failure::Stage(format!("Slurm does not take its job: {error}")));
                }
                Err(SubmitError::Busy(error)) if began.elapsed() > PATIENCE => {
                    return Err(unreachable(&error));
                }
                Err(SubmitError::Busy(_)) => {}
            }
            if !sleep(pause, launch) {
                return Ok(None);
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
            // It may have been taken, and only the answer was lost.
            if let Ok(Some(job)) = self.scheduler.find(&name) {
                break job;
            }
        };
        home.write("submitted.json", &Submitted { name, job: Some(job.clone()) })?;
        Ok(Some(job))
    }

    /// Waits until a job has ended or is gone.
    fn wait(
        &self,
        home: &Home,
        job: JobId,
        launch: &Launch<'_>,
        on_message: &mut dyn FnMut(Message),
    ) -> Result<Waited, Failure> {
        let news: Receiver<News> = self.watch.watch(job.clone(), home.clone());
        let (mut asked, mut read) = (false, Instant::now());
        let mut last = Progress::default();
        loop {
            match news.recv_timeout(WAIT) {
                Ok(News::Ended) => {
                    if let Some(ended) = home.ended()? {
                        return Ok(Waited::Ended(ended));
                    }
                }
                Ok(News::Gone(word, node)) => return Ok(Waited::Gone { word, node }),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Failure::Stage("the thread that watches jobs has ended".to_owned()));
                }
            }
            if stopping(launch) && !asked {
                if self.detach {
                    return Ok(Waited::Left);
                }
                asked = true;
                self.watch.stop(job.clone(), launch.grace + SIGNAL / 4);
            }
            if read.elapsed() >= PROGRESS {
                read = Instant::now();
                if let Ok(Some(progress)) = home.read::<Progress>("progress")
                    && progress != last
                {
                    last = progress.clone();
                    on_message(Message::Progress(progress));
                }
            }
        }
    }

    /// What to do about a job that ended without a word: the job that really has the work, or none, to submit again.
    fn after_gone(
        &self,
        home: &Home,
        job: &JobId,
        word: &str,
        node: &str,
        lost: &mut u32,
    ) -> Result<Option<JobId>, Failure> {
        // Two jobs for one work: this one left it to the other.
        if let Some(other) = home.claimed_by()?
            && other != *job
        {
            return Ok(Some(other));
        }
        let place = if node.is_empty() { String::new() } else { format!(" on node `{node}`") };
        let said = last_words(home);
        match word {
            "CANCELLED" => Err(Failure::Stage(format!(
                "its Slurm job {job} was cancelled{place}; the next run goes on from its checkpoint"
            ))),
            "OUT_OF_MEMORY" => Err(Failure::OutOfMemory(format!(
                "Slurm job {job} was killed{place} because it used more memory than it asked for: give the stage more \
                 `memory`"
            ))),
            // The time was over before the stage could be asked to stop; or the node, or Slurm, took the job away.
            _ if *lost < LOST && word != "FAILED" => {
                *lost += 1;
                Ok(None)
            }
            _ => Err(Failure::Stage(format!("Slurm job {job} ended{place} without a result ({word}){said}"))),
        }
    }

    /// A stage that saves no checkpoint would begin again for ever.
    fn check_progress(
        &self,
        launch: &Launch<'_>,
        ended: &Ended,
        settings: &JobSettings,
        saved: &mut Option<Vec<String>>,
    ) -> Result<(), Failure> {
        let mut now = Vec::new();
        for path in fsx::list(&launch.job.checkpoints)? {
            now.push(format!("{} {}", path.display(), fsx::identity(&path)?));
        }
        if now.is_empty() || saved.as_ref() == Some(&now) {
            let time =
                settings.time.map_or_else(String::new, |time| format!(" of {} min", time.as_secs() / 60));
            return Err(Failure::Stage(format!(
                "it did not end within the time{time} of its Slurm job {} on node `{}`, and saved no checkpoint to go on \
                 from: raise `time` under `[slurm]` for it",
                ended.job, ended.node
            )));
        }
        *saved = Some(now);
        Ok(())
    }

    /// Brings what the stage made to where the engine expects it.
    fn finish(
        &self,
        home: &Home,
        launch: &Launch<'_>,
        ended: Ended,
        on_message: &mut dyn FnMut(Message),
    ) -> Result<Exit, Failure> {
        ended.said.into_iter().for_each(&mut *on_message);
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
                // Of an engine before this one, which alone knew when they were last changed.
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

    /// The log of a job that another engine submitted is in that engine's folder.
    fn keep_log(&self, home: &Home, launch: &Launch<'_>) -> Result<(), Failure> {
        if let Some(handoff) = home.handoff()?
            && handoff.log != launch.log
            && let Some(text) = fsx::read_if_there(&handoff.log)?
        {
            fsx::append(launch.log, &text)?;
        }
        Ok(())
    }

    fn failed(&self, home: &Home, launch: &Launch<'_>, ended: Ended) -> Failure {
        let place = format!("on node `{}` (Slurm job {})", ended.node, ended.job);
        // What went wrong already outranks what cannot be tidied up.
        let _ = self.keep_log(home, launch);
        let _ = self.remove(home);
        match ended.how {
            How::OutOfMemory(error) => Failure::OutOfMemory(format!("{place}: {error}")),
            How::TimedOut => Failure::TimedOut(launch.limits.timeout.unwrap_or_default()),
            How::Failed(error) => Failure::Stage(format!("{place}: {error}")),
            How::Done | How::Stopped => Failure::Stage(format!("{place}: it ended unexpectedly")),
        }
    }

    fn stopped(&self, home: &Home) -> Result<Exit, Failure> {
        self.remove(home)?;
        Ok(Exit::Stopped)
    }

    fn remove(&self, home: &Home) -> Result<(), Failure> {
        if let Some(notice) = home.notice() {
            fsx::remove_file(&notice)?;
        }
        // The stage's own folder is its engine's.
        if home.folder.starts_with(&self.jobs) {
            fsx::remove_dir_all(&home.folder)?;
        }
        Ok(())
    }
}

impl Runner for SlurmRunner {
    fn check(&self, worker: Option<&'static str>) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        self.scheduler.check()?;
        self.local.check(worker)
    }

    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        if self.is_local(launch.kind) {
            let _threads = self.local_threads.take(launch.threads);
            return self.local.run(launch, on_message);
        }
        self.run_job(launch, on_message)
    }
}

fn stopping(launch: &Launch<'_>) -> bool {
    launch.stop.load(Ordering::Relaxed)
}

/// False where the run was stopped meanwhile.
fn sleep(time: Duration, launch: &Launch<'_>) -> bool {
    let end = Instant::now() + time;
    while Instant::now() < end {
        if stopping(launch) {
            return false;
        }
        std::thread::sleep(WAIT.min(end.saturating_duration_since(Instant::now())));
    }
    true
}

fn unreachable(error: &str) -> Failure {
    Failure::Stage(format!("Slurm took no job for an hour: {error}"))
}

/// The end of what the job printed, for a job that could not even begin its stage.
fn last_words(home: &Home) -> String {
    match fsx::tail(&home.path("slurm.out"), 5, 300) {
        Ok(lines) if !lines.is_empty() => format!(": {}", lines.join("; ")),
        _ => String::new(),
    }
}
