//! Watches all jobs of a run from one thread: one folder is looked into for those that ended, and the scheduler is asked
//! about all of them in one question, at most every ten seconds.
//!
//! A job's end is what its node wrote. The scheduler is asked only whether a job that wrote nothing is still there.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::handoff::Home;
use super::scheduler::{JobId, Scheduler, Seen, State};
use crate::fsx;

/// How the watch goes about it; the tests are quicker.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// How often the folder of notices is looked into.
    pub look: Duration,
    /// How often the scheduler is asked, at most.
    pub ask: Duration,
    /// How long after a job's end its files may need to become visible here.
    pub settle: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            look: Duration::from_millis(100),
            ask: Duration::from_secs(10),
            // A network file system may show a folder as it was half a minute ago.
            settle: Duration::from_secs(60),
        }
    }
}

/// What became of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum News {
    /// It wrote how it ended.
    Ended,
    /// It is over by the scheduler's word, which this is, and wrote nothing; the node where that is known.
    Gone(String, String),
}

enum Order {
    Watch(JobId, Home, Sender<News>),
    /// Asks it to stop, and cancels it after that time.
    Stop(JobId, Duration),
}

/// A thread that watches. It ends when this is dropped.
pub(super) struct Watch {
    orders: Mutex<Option<Sender<Order>>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// `notices` is the folder in which jobs say that they ended.
    pub fn start(scheduler: Arc<dyn Scheduler>, notices: PathBuf, pace: Pace) -> std::io::Result<Self> {
        let (orders, receiver) = channel();
        let mut state =
            Watching { scheduler, notices, pace, jobs: BTreeMap::new(), asked: None, soon: false };
        let thread =
            std::thread::Builder::new().name("slurm".to_owned()).spawn(move || state.run(&receiver))?;
        Ok(Self { orders: Mutex::new(Some(orders)), thread: Some(thread) })
    }

    fn order(&self, order: Order) {
        if let Some(orders) = &*self.orders.lock().unwrap_or_else(PoisonError::into_inner) {
            let _ = orders.send(order);
        }
    }

    /// Begins to watch a job; what becomes of it comes through the channel.
    pub fn watch(&self, job: JobId, home: Home) -> Receiver<News> {
        let (sender, receiver) = channel();
        self.order(Order::Watch(job, home, sender));
        receiver
    }

    /// Asks a job to stop, and cancels it where it has not after `grace`.
    pub fn stop(&self, job: JobId, grace: Duration) {
        self.order(Order::Stop(job, grace));
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

/// A job that is watched.
struct Job {
    home: Home,
    news: Sender<News>,
    /// When the scheduler first said that it is over, its word, and the node.
    over: Option<(Instant, String, String)>,
    /// When it is cancelled.
    cancel: Option<Instant>,
    to_stop: bool,
}

struct Watching {
    scheduler: Arc<dyn Scheduler>,
    notices: PathBuf,
    pace: Pace,
    jobs: BTreeMap<JobId, Job>,
    /// When the scheduler was asked last.
    asked: Option<Instant>,
    /// It is asked at once: jobs were stopped, and those that waited say nothing of their end.
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
            self.ask();
            self.settle();
        }
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Watch(job, home, news) => {
                self.asked.get_or_insert_with(Instant::now);
                self.jobs.insert(job, Job { home, news, over: None, cancel: None, to_stop: false });
            }
            Order::Stop(job, grace) => {
                if let Some(job) = self.jobs.get_mut(&job) {
                    job.to_stop = true;
                    job.cancel = Some(Instant::now() + grace);
                }
            }
        }
    }

    /// Those that say that they ended.
    fn look(&mut self) {
        let Ok(notices) = fsx::list(&self.notices) else { return };
        if notices.is_empty() {
            return;
        }
        let said: Vec<&std::ffi::OsStr> = notices.iter().filter_map(|path| path.file_name()).collect();
        self.jobs.retain(|_, job| {
            let Some(name) = job.home.folder.file_name() else { return false };
            if said.binary_search(&name).is_err() || !matches!(job.home.ended(), Ok(Some(_))) {
                return true;
            }
            let _ = job.news.send(News::Ended);
            false
        });
    }

    /// Asks those to stop that shall, and cancels those that took too long.
    fn stop(&mut self) {
        let stop: Vec<JobId> = ids(&self.jobs, |job| job.to_stop);
        if !stop.is_empty() && self.scheduler.stop(&stop).is_ok() {
            self.jobs.values_mut().for_each(|job| job.to_stop = false);
            self.soon = true;
        }
        let late = ids(&self.jobs, |job| job.cancel.is_some_and(|cancel| cancel <= Instant::now()));
        if !late.is_empty() && self.scheduler.cancel(&late).is_ok() {
            self.jobs.values_mut().for_each(|job| job.cancel = job.cancel.filter(|at| *at > Instant::now()));
            self.soon = true;
        }
    }

    fn ask(&mut self) {
        let due = self.soon || self.asked.is_some_and(|asked| asked.elapsed() >= self.pace.ask);
        if self.jobs.is_empty() || !due {
            return;
        }
        self.soon = false;
        // Where the scheduler does not answer, jobs may go on: their files say what becomes of them.
        let answer = self.scheduler.list();
        self.asked = Some(Instant::now());
        let Ok(all) = answer else { return };
        for (id, job) in &mut self.jobs {
            let seen = match all.get(id) {
                Some(seen) => Some(seen.clone()),
                None => match self.scheduler.look(id) {
                    Ok(seen) => seen,
                    Err(_) => continue,
                },
            };
            let gone = || Seen { state: State::Over("unknown to Slurm".to_owned()), node: String::new() };
            match seen.unwrap_or_else(gone) {
                Seen { state: State::Over(word), node } => {
                    job.over.get_or_insert_with(|| (Instant::now(), word, node));
                }
                // It was started again.
                Seen { .. } => job.over = None,
            }
        }
    }

    /// Those that are over and whose files had the time to become visible.
    fn settle(&mut self) {
        let settle = self.pace.settle;
        let ask = self.pace.ask;
        self.jobs.retain(|_, job| {
            let Some((since, word, node)) = &job.over else { return true };
            if matches!(job.home.ended(), Ok(Some(_))) {
                let _ = job.news.send(News::Ended);
                return false;
            }
            // One that was cancelled has nothing more to say; one that may be started again is looked at once more.
            let wait = match &**word {
                "CANCELLED" => Duration::ZERO,
                "PREEMPTED" | "NODE_FAIL" | "BOOT_FAIL" => settle.max(ask * 2),
                _ => settle,
            };
            if since.elapsed() < wait {
                return true;
            }
            let _ = job.news.send(News::Gone(word.clone(), node.clone()));
            false
        });
    }
}

fn ids(jobs: &BTreeMap<JobId, Job>, which: impl Fn(&Job) -> bool) -> Vec<JobId> {
    jobs.iter().filter(|(_, job)| which(job)).map(|(id, _)| id.clone()).collect()
}
