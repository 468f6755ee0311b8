//! Runs each stage as a job of its own or in a pilot. Light stages run beside the engine.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use dril_stage_api::{Message, Progress};

use super::build;
use super::ending::Endings;
use super::gpus;
use super::handoff::{Ended, Handoff, Home, How, Submitted, notices};
use super::node::NODE;
use super::pilots::{Offer, Pilots, Tending};
use super::prepare::{SIGNAL, Wanted, moved, name_of, passed, script, stop_after, submission};
use super::scheduler::{JobId, Scheduler};
use super::site::Site;
use super::submit::{Submitter, WAIT};
use super::threads::Threads;
use super::watch::{News, Place, Watch};
use crate::exec::{self, ChildRunner, Exit, Failure, Launch, Runner};
use crate::fsx;
use crate::settings::{ClusterSettings, JobSettings};
use crate::store::StoreError;

/// How often the progress of a running job is read.
const PROGRESS: Duration = Duration::from_secs(5);

/// Runs stages on a cluster.
pub struct ClusterRunner {
    settings: ClusterSettings,
    site: Site,
    /// For stages that run beside the engine.
    local: ChildRunner,
    local_threads: Threads,
    submitter: Arc<Submitter>,
    endings: Endings,
    cluster: Cluster,
}

/// What watches jobs and keeps pilots. Dropped in this order: pilots end once nothing is watched any more.
struct Cluster {
    watch: Watch,
    pilots: Option<Arc<Pilots>>,
    _tending: Option<Tending>,
}

/// How waiting for a stage ended.
enum Waited {
    Ended(Ended),
    Gone {
        job: JobId,
        end_state: String,
        node: String,
    },
    /// No pilot will take it.
    Withdrawn,
    /// The run was stopped, and the stage was left to continue.
    Left,
}

/// Where a stage is run; an offer to pilots is open as long as this exists.
enum Running {
    Job(JobId),
    Pilots(Offer),
}

impl Running {
    /// The job of its own.
    fn job(&self) -> Option<JobId> {
        match self {
            Self::Job(job) => Some(job.clone()),
            Self::Pilots(_) => None,
        }
    }
}

/// What is known of a stage while jobs come and go.
#[derive(Default)]
struct History {
    /// Its jobs that were lost.
    lost: u32,
    /// Its checkpoint when it was stopped last.
    saved: Option<Vec<String>>,
    /// It gets a job of its own: a pilot that ran it was lost or had too little time for it.
    alone: bool,
}

impl ClusterRunner {
    /// A runner for the jobs of a site.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn new(
        scheduler: Arc<dyn Scheduler>,
        settings: ClusterSettings,
        site: Site,
    ) -> Result<Self, Failure> {
        let jobs = site.jobs();
        fsx::create_dir_all(&notices(&jobs))?;
        let endings = Endings { scheduler: scheduler.name().to_owned(), jobs };
        let submitter = Arc::new(Submitter::new(scheduler));
        Ok(Self {
            cluster: Cluster::start(&submitter, &settings, &site)?,
            settings,
            local: ChildRunner::new(site.program.clone(), ["__stage".into()]),
            site,
            local_threads: Threads::of_this_machine(),
            submitter,
            endings,
        })
    }

    /// The job's folder: for work with a key one that the next engine finds, otherwise the stage's private folder.
    fn home(&self, launch: &Launch<'_>) -> Home {
        let checkpoints = launch.job.checkpoints.parent();
        let key = checkpoints.and_then(Path::file_name).filter(|_| {
            let above = checkpoints.and_then(Path::parent).and_then(Path::file_name);
            above.is_some_and(|name| name == "checkpoints-v1")
        });
        Home::new(key.map_or_else(|| launch.folder.to_owned(), |key| self.endings.jobs.join(key)))
    }

    fn run_job(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        let home = self.home(launch);
        let settings = self.settings.of(name_of(&launch.job.stage), launch.kind.name());
        let mut running = self.adopt(&home)?;
        let is_new = running.is_none() && !matches!(home.ended()?, Some(Ended { how: How::Done, .. }));
        if is_new && !self.prepare(&home, launch, &settings)? {
            return self.stopped(&home);
        }
        // What happened to a job of an earlier engine is not counted.
        let mut of_another = running.as_ref().and_then(Running::job);
        let mut history = History::default();
        loop {
            let ended = match home.ended()? {
                Some(ended) => ended,
                None => {
                    let now = match running.take() {
                        Some(now) => now,
                        None => match self.start(&home, launch, &settings, &history)? {
                            Some(now) => now,
                            None => return self.stopped(&home),
                        },
                    };
                    match self.wait(&home, now, launch, on_message)? {
                        Waited::Ended(ended) => ended,
                        Waited::Left => return Ok(Exit::Stopped),
                        Waited::Withdrawn | Waited::Gone { .. } if stopping(launch) => {
                            return self.stopped(&home);
                        }
                        Waited::Withdrawn => {
                            history.alone = true;
                            continue;
                        }
                        Waited::Gone { job, end_state, node } => {
                            // A job that saved a newer checkpoint made progress.
                            if self.endings.saved_more(launch, &mut history.saved)? {
                                history.lost = 0;
                            }
                            if of_another.take().is_none_or(|other| other != job) {
                                running = self
                                    .endings
                                    .after_gone(&home, &job, &end_state, &node, &mut history.lost)
                                    .inspect_err(|_| drop(self.endings.remove(&home)))?
                                    .map(Running::Job);
                            }
                            continue;
                        }
                    }
                }
            };
            if launch.lock.is_some_and(|lock| !lock.is_ours().unwrap_or(true)) {
                // The job is another engine's now, with all that it made.
                return Err(StoreError::TakenForDead.into());
            }
            match ended.how {
                How::Done => return self.endings.finish(&home, launch, ended, on_message),
                How::Stopped | How::Lost(_) if stopping(launch) => return self.stopped(&home),
                How::Stopped | How::Lost(_) => {
                    self.go_on(&home, launch, &ended, &settings, &mut history)?;
                }
                _ => return Err(self.endings.failed(&home, launch, ended)),
            }
        }
    }

    /// Prepares another start of a stage that was stopped by the time limit of its job, or lost with its pilot.
    fn go_on(
        &self,
        home: &Home,
        launch: &Launch<'_>,
        ended: &Ended,
        settings: &JobSettings,
        history: &mut History,
    ) -> Result<(), Failure> {
        // Only a job of its own is submitted.
        let in_pilot = home.read::<Submitted>("submitted.json")?.is_none();
        let more = self.endings.saved_more(launch, &mut history.saved)?;
        match &ended.how {
            How::Lost(_) => history.alone = true,
            _ if more => {}
            // The pilot may have taken it shortly before its own end.
            _ if in_pilot => history.alone = true,
            _ => return Err(self.endings.no_checkpoint(ended, settings)),
        }
        Ok(home.clear_results()?)
    }

    /// What runs the stage since an earlier engine, where there is something.
    fn adopt(&self, home: &Home) -> Result<Option<Running>, Failure> {
        if home.ended()?.is_some() || home.handoff()?.is_none() {
            return Ok(None);
        }
        if let Some(pilots) = &self.cluster.pilots
            && let Some(key) = home.folder.file_name().and_then(|name| name.to_str())
            && let Some(offer) = pilots.find(key)?
        {
            return Ok(Some(Running::Pilots(offer)));
        }
        if let Some(job) = home.claimed_by()? {
            // Where it is gone, the watch reports it.
            return Ok(Some(Running::Job(job)));
        }
        match home.read::<Submitted>("submitted.json")? {
            None => Ok(None),
            Some(Submitted { job: Some(job), .. }) => Ok(Some(Running::Job(job))),
            // The engine died between the submission and its answer.
            Some(Submitted { name, .. }) => Ok(self.submitter.find(&name)?.map(Running::Job)),
        }
    }

    /// Makes the job's folder from the stage's: the inputs there move, and paths with them. False where the run was stopped meanwhile.
    fn prepare(&self, home: &Home, launch: &Launch<'_>, settings: &JobSettings) -> Result<bool, Failure> {
        if !exec::discard(launch)? {
            return Ok(false);
        }
        if home.folder != launch.folder {
            fsx::remove_dir_all(&home.folder)?;
            fsx::create_dir_all(&home.folder)?;
            let inputs = launch.folder.join("inputs");
            if fsx::entry(&inputs)?.is_some() {
                // The files themselves stay untouched, so that a stage that changes them is noticed.
                fsx::rename(&inputs, &home.path("inputs"))?;
            }
        }
        let job = moved(launch.job, launch.folder, &home.folder);
        let threads = settings.threads.map_or(launch.threads, usize::from);
        let mut handoff = Handoff::new(job, launch.log, threads, launch.units, &launch.limits, launch.grace);
        let time = Wanted::of(launch, settings).time;
        handoff.build = build::of(&self.site.program, launch.kind.worker());
        handoff.stop_after = stop_after(&*self.submitter.scheduler, time, settings);
        let variables = passed(launch, &self.site);
        if !variables.is_empty() {
            home.keep_environment(&variables)?;
        }
        home.write("handoff.json", &handoff)?;
        Ok(true)
    }

    /// Offers the stage to the pilots or submits a job; `None` where the run was stopped meanwhile.
    fn start(
        &self,
        home: &Home,
        launch: &Launch<'_>,
        settings: &JobSettings,
        history: &History,
    ) -> Result<Option<Running>, Failure> {
        home.clear_results()?;
        let wanted = Wanted::of(launch, settings);
        let key = home.folder.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if let Some(pilots) = &self.cluster.pilots
            && !history.alone
            && home.folder != launch.folder
            && !pilots.have_failed()
            && pilots.fits(settings, &wanted)
        {
            fsx::remove_file(&home.path("submitted.json"))?;
            return Ok(Some(Running::Pilots(pilots.offer(key)?)));
        }
        let job = self.submitter.scheduler.job_in_shell();
        let text = script(&self.site, NODE, &home.folder, settings, job);
        fsx::write_atomic(&home.path("job.sh"), text.as_bytes())?;
        let submission = submission(self.submitter.name(key), home, settings, &wanted);
        Ok(self.submitter.submit(home, &submission, &|| stopping(launch))?.map(Running::Job))
    }

    /// Waits until a stage has ended or its job is gone.
    fn wait(
        &self,
        home: &Home,
        running: Running,
        launch: &Launch<'_>,
        on_message: &mut dyn FnMut(Message),
    ) -> Result<Waited, Failure> {
        let place = match &running {
            Running::Job(job) => Place::Job(job.clone()),
            Running::Pilots(offer) => Place::Pilots(offer.entry.clone()),
        };
        let news: Receiver<News> = self.cluster.watch.watch(place, home.clone());
        let (mut asked, mut read) = (false, Instant::now());
        let mut last = Progress::default();
        loop {
            match (news.recv_timeout(WAIT), &running) {
                (Ok(News::Ended), _) => {
                    if let Some(ended) = home.ended()? {
                        if let (Running::Pilots(_), Some(pilots)) = (&running, &self.cluster.pilots) {
                            pilots.succeeded();
                        }
                        return Ok(Waited::Ended(ended));
                    }
                }
                (Ok(News::Gone(end_state, node)), Running::Job(job)) => {
                    return Ok(Waited::Gone { job: job.clone(), end_state, node });
                }
                (Ok(News::Withdrawn | News::Gone(..)), _) => return Ok(Waited::Withdrawn),
                (Err(RecvTimeoutError::Timeout), _) => {}
                (Err(RecvTimeoutError::Disconnected), _) => {
                    return Err(Failure::Stage("the thread that watches jobs has ended".to_owned()));
                }
            }
            if stopping(launch) && !asked {
                if self.site.detach {
                    return Ok(Waited::Left);
                }
                asked = true;
                self.cluster.watch.stop(home, launch.grace + SIGNAL / 4);
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

    fn stopped(&self, home: &Home) -> Result<Exit, Failure> {
        self.endings.remove(home)?;
        Ok(Exit::Stopped)
    }
}

impl Cluster {
    fn start(submitter: &Arc<Submitter>, settings: &ClusterSettings, site: &Site) -> Result<Self, Failure> {
        let pilots = Pilots::new(submitter, settings, site)?;
        let scheduler = Arc::clone(&submitter.scheduler);
        let watch = Watch::start(scheduler, notices(&site.jobs()), pilots.clone(), site.pace)?;
        let tending = pilots.clone().map(|pilots| Tending::start(pilots, site.detach)).transpose()?;
        Ok(Self { watch, pilots, _tending: tending })
    }
}

impl Runner for ClusterRunner {
    fn check(&self, worker: Option<&'static str>) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        self.submitter.scheduler.check()?;
        self.local.check(worker)
    }

    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        if self.settings.is_local(launch.kind) {
            let _threads = self.local_threads.take(launch.threads);
            // Those that were counted are the cluster's.
            let mut units = launch.units.clone();
            units.remove(gpus::NAME);
            return self.local.run(&Launch { units: &units, ..*launch }, on_message);
        }
        self.run_job(launch, on_message)
    }
}

fn stopping(launch: &Launch<'_>) -> bool {
    launch.stop.load(Ordering::Relaxed)
}
