//! Watches all stages of a run from one thread: it polls one folder for those that ended, and lists all jobs with one command
//! at most every ten seconds.
//!
//! A stage has ended when its node has written so. The scheduler only shows whether the job of a stage that has not is alive.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::handoff::Home;
use super::pilots::Pilots;
use super::queue::Entry;
use super::scheduler::{JobId, Scheduler, Seen, State};
use super::site::Pace;
use crate::fsx;

/// How often the folder of notices is polled where stages may take milliseconds.
const WITH_PILOTS: Duration = Duration::from_millis(20);

/// How often a network file system has to look again for what is in a folder.
const REFRESH: Duration = Duration::from_secs(1);

/// What happened to a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum News {
    /// Its node wrote how it ended.
    Ended,
    /// Its job is over, in this state of the scheduler's, and nothing was written; the node where that is known.
    Gone(String, String),
    /// No pilot took it, and none will: the run is stopped, or pilots fail.
    Withdrawn,
}

/// What runs a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// A job of its own.
    Job(JobId),
    /// A pilot, now or later.
    Pilots(Entry),
}

enum Order {
    Watch(Place, Home, Sender<News>),
    /// Makes it stop, and cancels it after that time.
    Stop(PathBuf, Duration),
}

/// A thread that watches. It ends when this is dropped.
pub(super) struct Watch {
    orders: Mutex<Option<Sender<Order>>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// `notices` is the folder in which nodes report the end of stages.
    pub fn start(
        scheduler: Arc<dyn Scheduler>,
        notices: PathBuf,
        pilots: Option<Arc<Pilots>>,
        pace: Pace,
    ) -> std::io::Result<Self> {
        let (orders, receiver) = channel();
        // Pilots of an earlier engine may be dead by now.
        let soon = pilots.as_ref().is_some_and(|pilots| !pilots.known().is_empty());
        let mut pace = pace;
        if pilots.is_some() {
            pace.look = pace.look.min(WITH_PILOTS);
        }
        let (stages, refreshed) = (BTreeMap::new(), Instant::now());
        let mut state = Watching { scheduler, notices, pilots, pace, stages, refreshed, asked: None, soon };
        let thread =
            std::thread::Builder::new().name("watch".to_owned()).spawn(move || state.run(&receiver))?;
        Ok(Self { orders: Mutex::new(Some(orders)), thread: Some(thread) })
    }

    fn order(&self, order: Order) {
        if let Some(orders) = &*self.orders.lock().unwrap_or_else(PoisonError::into_inner) {
            let _ = orders.send(order);
        }
    }

    /// Begins to watch a stage; what happens to it comes through the channel.
    pub fn watch(&self, place: Place, home: Home) -> Receiver<News> {
        let (sender, receiver) = channel();
        self.order(Order::Watch(place, home, sender));
        receiver
    }

    /// Makes a stage stop, and cancels its job where it has not after `grace`.
    pub fn stop(&self, home: &Home, grace: Duration) {
        self.order(Order::Stop(home.folder.clone(), grace));
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        drop(self.orders.lock().unwrap_or_else(PoisonError::into_inner).take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A stage that is watched.
struct Stage {
    place: Place,
    home: Home,
    news: Sender<News>,
    /// When it was submitted or found.
    since: Instant,
    /// When the scheduler first listed its job as over, the state, and the node.
    over: Option<(Instant, String, String)>,
    /// When its job is cancelled.
    cancel: Option<Instant>,
    to_stop: bool,
    /// It was asked to stop.
    stopping: bool,
}

struct Watching {
    scheduler: Arc<dyn Scheduler>,
    notices: PathBuf,
    pilots: Option<Arc<Pilots>>,
    pace: Pace,
    /// By the folder of the job.
    stages: BTreeMap<PathBuf, Stage>,
    /// When the folder of notices was refreshed last.
    refreshed: Instant,
    /// When the scheduler listed the jobs last.
    asked: Option<Instant>,
    /// It lists them at once: jobs were stopped, and those that waited report no end.
    soon: bool,
}

impl Watching {
    fn run(&mut self, orders: &Receiver<Order>) {
        loop {
            match orders.recv_timeout(self.pace.look) {
                Ok(first) => {
                    std::iter::once(first).chain(orders.try_iter()).for_each(|order| self.obey(order))
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.look();
            self.stop();
            self.withdraw();
            self.ask();
            self.settle();
        }
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Watch(place, home, news) => {
                self.asked.get_or_insert_with(Instant::now);
                let folder = home.folder.clone();
                let stage = Stage {
                    place,
                    home,
                    news,
                    since: Instant::now(),
                    over: None,
                    cancel: None,
                    to_stop: false,
                    stopping: false,
                };
                self.stages.insert(folder, stage);
            }
            Order::Stop(folder, grace) => {
                if let Some(stage) = self.stages.get_mut(&folder) {
                    stage.to_stop = true;
                    stage.stopping = true;
                    stage.cancel = Some(Instant::now() + grace);
                }
            }
        }
    }

    /// Finds those that have ended.
    fn look(&mut self) {
        let Some(jobs) = self.notices.parent() else { return };
        if !self.stages.is_empty() && self.refreshed.elapsed() >= REFRESH {
            self.refreshed = Instant::now();
            // It only saves time.
            let _ = fsx::refresh(&self.notices);
        }
        for notice in fsx::list(&self.notices).unwrap_or_default() {
            let Some(name) = notice.file_name() else { continue };
            let folder = jobs.join(name);
            let Some(stage) = self.stages.get(&folder) else { continue };
            if matches!(stage.home.ended(), Ok(Some(_))) {
                let _ = stage.news.send(News::Ended);
                self.stages.remove(&folder);
            } else {
                // The notice is the later one of both files.
                let _ = fsx::refresh(&folder);
            }
        }
    }

    /// Sends stop requests that are due, and cancels jobs that took too long to stop.
    fn stop(&mut self) {
        let now = Instant::now();
        let (mut stop, mut stopped, mut withdrawn) = (BTreeSet::new(), Vec::new(), Vec::new());
        for (folder, stage) in self.stages.iter().filter(|(_, stage)| stage.to_stop) {
            if let (Place::Pilots(entry), Some(pilots)) = (&stage.place, &self.pilots)
                && pilots.withdraw(entry)
            {
                withdrawn.push(folder.clone());
            } else if let Some(job) = self.job(stage) {
                stop.insert(job);
                stopped.push(folder.clone());
            }
        }
        self.send_withdrawn(&withdrawn);
        let stop: Vec<JobId> = stop.into_iter().collect();
        if self.scheduler_did(&stop, |scheduler, jobs| scheduler.stop(jobs)) {
            for folder in stopped {
                self.stages.entry(folder).and_modify(|stage| stage.to_stop = false);
            }
        }
        let late = self.stages.values().filter(|stage| stage.cancel.is_some_and(|cancel| cancel <= now));
        let late: BTreeSet<JobId> = late.filter_map(|stage| self.job(stage)).collect();
        let late: Vec<JobId> = late.into_iter().collect();
        if self.scheduler_did(&late, |scheduler, jobs| scheduler.cancel(jobs)) {
            self.stages.values_mut().for_each(|stage| stage.cancel = stage.cancel.filter(|at| *at > now));
        }
    }

    /// True where there was something to do and the scheduler did it.
    fn scheduler_did(
        &mut self,
        jobs: &[JobId],
        act: impl Fn(&dyn Scheduler, &[JobId]) -> Result<(), String>,
    ) -> bool {
        let done = !jobs.is_empty() && act(&*self.scheduler, jobs).is_ok();
        self.soon |= done;
        done
    }

    /// The job that runs a stage now.
    fn job(&self, stage: &Stage) -> Option<JobId> {
        match &stage.place {
            Place::Job(job) => Some(job.clone()),
            Place::Pilots(entry) => self.pilots.as_ref()?.holder(entry),
        }
    }

    fn send_withdrawn(&mut self, folders: &[PathBuf]) {
        for stage in folders.iter().filter_map(|folder| self.stages.remove(folder)) {
            let _ = stage.news.send(News::Withdrawn);
        }
    }

    /// Takes all stages back from the queue once pilots have failed.
    fn withdraw(&mut self) {
        let Some(pilots) = self.pilots.as_ref().filter(|pilots| pilots.have_failed()) else { return };
        let waits = |stage: &Stage| matches!(&stage.place, Place::Pilots(entry) if pilots.withdraw(entry));
        let folders = self.stages.iter().filter(|(_, stage)| waits(stage));
        let folders: Vec<PathBuf> = folders.map(|(folder, _)| folder.clone()).collect();
        self.send_withdrawn(&folders);
    }

    /// Lists the jobs, and notes those that are over.
    fn ask(&mut self) {
        // A run that is stopped waits for the end of its jobs.
        let stopping = self.stages.values().any(|stage| stage.stopping);
        let pause = if stopping { self.pace.ask / 10 } else { self.pace.ask };
        let due = self.soon || self.asked.is_some_and(|asked| asked.elapsed() >= pause);
        if self.stages.is_empty() || !due {
            return;
        }
        self.soon = false;
        // Pilots first: one that was submitted after the list is not missing in it.
        let known = self.pilots.as_ref().map(|pilots| pilots.known()).unwrap_or_default();
        // Where the scheduler does not answer, jobs may still run: their files tell what happens to them.
        let answer = self.scheduler.list();
        self.asked = Some(Instant::now());
        let Ok(all) = answer else { return };
        for job in known {
            if let (Some(seen), Some(pilots)) = (self.seen(&all, &job), &self.pilots) {
                let settle = settle(&seen, &self.pace);
                pilots.judge(&job, seen, settle);
            }
        }
        let mut over = Vec::new();
        for (folder, stage) in &self.stages {
            let Place::Job(job) = &stage.place else { continue };
            // The list may be older than the job.
            if stage.since.elapsed() < self.pace.ask && !stage.stopping && !all.contains_key(job) {
                continue;
            }
            if let Some(seen) = self.seen(&all, job) {
                over.push((folder.clone(), seen));
            }
        }
        for (folder, seen) in over {
            let Some(stage) = self.stages.get_mut(&folder) else { continue };
            match seen {
                Seen { state: State::Over(end_state), node } => {
                    stage.over.get_or_insert_with(|| (Instant::now(), end_state, node));
                }
                // It was started again.
                Seen { .. } => stage.over = None,
            }
        }
    }

    /// The state of a job; `None` where the scheduler does not answer.
    fn seen(&self, all: &BTreeMap<JobId, Seen>, job: &JobId) -> Option<Seen> {
        if let Some(seen) = all.get(job) {
            return Some(seen.clone());
        }
        let end_state = format!("unknown to {}", self.scheduler.name());
        let gone = || Seen { state: State::Over(end_state), node: String::new() };
        self.scheduler.look(job).ok().map(|seen| seen.unwrap_or_else(gone))
    }

    /// Reports those whose job is over and whose files had the time to become visible.
    fn settle(&mut self) {
        let pace = self.pace;
        self.stages.retain(|_, stage| {
            let Some((since, end_state, node)) = &stage.over else { return true };
            if matches!(stage.home.ended(), Ok(Some(_))) {
                let _ = stage.news.send(News::Ended);
                return false;
            }
            let seen = Seen { state: State::Over(end_state.clone()), node: node.clone() };
            // At worst, the next run does again what a stage finished while it was stopped.
            let wait = if stage.stopping { pace.settle / 20 } else { settle(&seen, &pace) };
            if since.elapsed() < wait {
                return true;
            }
            let _ = stage.news.send(News::Gone(end_state.clone(), node.clone()));
            false
        });
    }
}

/// How long to wait for the files of a job that is over.
fn settle(seen: &Seen, pace: &Pace) -> Duration {
    let State::Over(end_state) = &seen.state else { return pace.settle };
    match &**end_state {
        // It was stopped from outside, and writes nothing more.
        "CANCELLED" => Duration::ZERO,
        // It may be started again, which the list shows a little later.
        "PREEMPTED" | "NODE_FAIL" | "BOOT_FAIL" => pace.settle.max(pace.ask * 2),
        _ => pace.settle,
    }
}
