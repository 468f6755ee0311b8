//! The engine's side of pilots: keeps as many as there is work for, notices those that died, and ends those that are idle
//! when the run ends. Pilots outlive their engine; the next one, and every other engine on the same store, uses them too.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::handoff::{Ended, Home, How};
use super::pilot::PILOT;
use super::prepare::{self, Wanted};
use super::queue::{Entry, Orders, PILOTS, PilotFolder, Queue};
use super::scheduler::{JobId, Seen, State as JobState};
use super::site::Site;
use super::submit::Submitter;
use crate::exec::Failure;
use crate::fsx;
use crate::settings::{ClusterSettings, JobSettings};
use crate::store::Digest;

/// How often the pilots are counted.
const TEND: Duration = Duration::from_millis(500);
/// Seconds without work after which a pilot ends, unless it is set.
const IDLE: Duration = Duration::from_secs(30);
/// So many pilots in a row that die without finishing a stage are enough: then every stage has a job of its own.
const FAILURES: u32 = 3;

/// The pilots of a run.
pub(super) struct Pilots {
    submitter: Arc<Submitter>,
    queue: Queue,
    /// The folder of all pilots.
    root: PathBuf,
    /// The folder of all jobs.
    jobs: PathBuf,
    orders: Orders,
    settings: JobSettings,
    site: Site,
    count: usize,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Pilots of every class whose job is known.
    known: BTreeMap<JobId, Known>,
    /// Stages of this run that wait for a pilot or are run by one.
    outstanding: usize,
    /// Pilots that died since the last stage that one finished.
    failures: u32,
    closing: bool,
}

struct Known {
    folder: PilotFolder,
    is_of_our_class: bool,
    /// This engine submitted it.
    is_ours: bool,
    /// When the scheduler first listed its job as over, and the state.
    over: Option<(Instant, String, String)>,
}

impl Known {
    /// True where it needs no replacement. One of ours that died is replaced once its end is certain, so that pilots that
    /// cannot begin are not submitted again and again.
    fn counts(&self) -> bool {
        self.is_of_our_class && (self.is_ours || self.over.is_none())
    }
}

/// A stage that pilots have been offered, until it has ended.
pub(super) struct Offer {
    pub entry: Entry,
    pilots: Arc<Pilots>,
}

impl Drop for Offer {
    fn drop(&mut self) {
        self.pilots.lock().outstanding -= 1;
    }
}

impl Pilots {
    /// `None` where the settings have no pilots.
    pub fn new(
        submitter: &Arc<Submitter>,
        settings: &ClusterSettings,
        site: &Site,
    ) -> fsx::Result<Option<Arc<Self>>> {
        let Some(count) = settings.pilots.filter(|count| *count > 0) else { return Ok(None) };
        let root = site.store.join(PILOTS);
        let stop_after = prepare::stop_after(&*submitter.scheduler, settings.all.time, &settings.all);
        let idle = settings.pilot_idle.unwrap_or(IDLE).as_secs_f64();
        // A pilot of another user could not read the variables of a stage.
        let user = rustix::process::getuid().as_raw();
        let (program, version) = (site.program.display(), env!("CARGO_PKG_VERSION"));
        let what = format!("{:?} {program} {version} {user}", settings.all);
        let class = Digest::of(what.as_bytes()).short();
        let queue = Queue::new(&root, &class);
        queue.create()?;
        let pilots = Self {
            submitter: Arc::clone(submitter),
            orders: Orders::new(class, site.jobs(), idle, stop_after),
            queue,
            root,
            jobs: site.jobs(),
            settings: settings.all.clone(),
            site: site.clone(),
            count,
            state: Mutex::default(),
            changed: Condvar::new(),
        };
        pilots.discover();
        Ok(Some(Arc::new(pilots)))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Threads, memory and time of each pilot.
    pub fn resources(&self) -> Wanted {
        let settings = &self.settings;
        let threads = settings.threads.map_or(1, usize::from);
        Wanted { threads, memory: settings.memory, time: settings.time, gpus: 0 }
    }

    /// True where a stage with these settings and needs can run in a pilot.
    pub fn fits(&self, settings: &JobSettings, wanted: &Wanted) -> bool {
        let (mine, own) = (&self.settings, self.resources());
        let same = settings.partition == mine.partition
            && settings.account == mine.account
            && settings.qos == mine.qos
            && settings.extra == mine.extra
            && settings.setup == mine.setup;
        // What a pilot has by the defaults of its partition is unknown.
        let memory = wanted.memory.is_none_or(|memory| own.memory.is_some_and(|most| memory <= most));
        let time = wanted.time.is_none_or(|time| own.time.is_some_and(|most| time <= most));
        settings.pilot != Some(false)
            && same
            && memory
            && time
            && wanted.gpus == 0
            && wanted.threads <= own.threads
    }

    /// Offers a stage to the pilots.
    pub fn offer(self: &Arc<Self>, key: &str) -> fsx::Result<Offer> {
        let entry = self.queue.put(key)?;
        Ok(self.offered(entry))
    }

    fn offered(self: &Arc<Self>, entry: Entry) -> Offer {
        self.lock().outstanding += 1;
        self.changed.notify_all();
        Offer { entry, pilots: Arc::clone(self) }
    }

    /// The offer that an earlier engine made for this stage, where it waits or a pilot has it.
    pub fn find(self: &Arc<Self>, key: &str) -> fsx::Result<Option<Offer>> {
        let all = PilotFolder::all(&self.root)?;
        // The queue last: a pilot that is interrupted returns its stage.
        let taken = all.iter().map(PilotFolder::taken).chain(std::iter::once_with(|| self.queue.list()));
        for entries in taken {
            if let Some(entry) = entries?.into_iter().find(|entry| entry.key() == key) {
                return Ok(Some(self.offered(entry)));
            }
        }
        Ok(None)
    }

    /// Takes an offer back; false where a pilot has taken it.
    pub fn withdraw(&self, entry: &Entry) -> bool {
        self.queue.withdraw(entry).unwrap_or(false)
    }

    /// The job of the pilot that runs a stage.
    pub fn holder(&self, entry: &Entry) -> Option<JobId> {
        self.discover();
        let state = self.lock();
        let has = |known: &Known| known.folder.taken().is_ok_and(|taken| taken.contains(entry));
        state.known.iter().find(|(_, known)| has(known)).map(|(job, _)| job.clone())
    }

    /// True where pilots die without finishing anything, so that there will be no more of them.
    pub fn have_failed(&self) -> bool {
        self.lock().failures >= FAILURES
    }

    /// A pilot has finished a stage.
    pub fn succeeded(&self) {
        self.lock().failures = 0;
    }

    /// The jobs of all pilots.
    pub fn known(&self) -> Vec<JobId> {
        self.discover();
        self.lock().known.keys().cloned().collect()
    }

    /// Adds pilots of other engines, and of those before this one. One that cannot be read is left for the next time.
    fn discover(&self) {
        for folder in PilotFolder::all(&self.root).unwrap_or_default() {
            if self.lock().known.values().any(|known| known.folder == folder) {
                continue;
            }
            if let (Ok(Some(job)), Ok(Some(orders))) = (folder.job(), folder.orders()) {
                let is_of_our_class = orders.class == self.orders.class;
                self.lock().known.insert(job, Known { folder, is_of_our_class, is_ours: false, over: None });
            }
        }
    }

    /// Notes how the scheduler sees a pilot's job. One that has been over for `settle` is removed, and its stage is reported
    /// as lost.
    pub fn judge(&self, job: &JobId, seen: Seen, settle: Duration) {
        let mut state = self.lock();
        let Some(known) = state.known.get_mut(job) else { return };
        let Seen { state: JobState::Over(end_state), node } = seen else {
            // It was started again.
            known.over = None;
            return;
        };
        let (since, end_state, node) =
            known.over.get_or_insert_with(|| (Instant::now(), end_state, node)).clone();
        if since.elapsed() < settle && !known.folder.has_ended().unwrap_or(false) {
            return;
        }
        let folder = known.folder.clone();
        let has_ended = folder.has_ended().unwrap_or(false);
        // Where the folder cannot be moved, the next look tries it again.
        if let Ok(aside) = folder.retire() {
            state.known.remove(job);
            if !has_ended {
                // One that could not even begin will not begin on another node.
                let has_begun = aside.as_ref().is_none_or(PilotFolder::has_begun);
                state.failures += if end_state == "FAILED" && !has_begun { FAILURES } else { 1 };
            }
            drop(state);
            self.changed.notify_all();
            if let Some(aside) = aside {
                self.report_lost(&aside, job, &end_state, &node);
            }
        }
    }

    /// Tells the engines whose stages a pilot had that they are lost.
    fn report_lost(&self, pilot: &PilotFolder, job: &JobId, end_state: &str, node: &str) {
        for entry in pilot.taken().unwrap_or_default() {
            let home = Home::new(self.jobs.join(entry.key()));
            if matches!(home.ended(), Ok(None)) {
                let how = How::Lost(end_state.to_owned());
                let ended = Ended::new(job.clone(), node.to_owned(), how, Vec::new());
                let written = home.write("ended.json", &ended);
                if let (Ok(()), Some(notice)) = (written, home.notice()) {
                    let _ = fsx::write(&notice, job.as_bytes());
                }
            }
        }
        let _ = fsx::remove_dir_all(&pilot.0);
    }

    /// Removes pilots that ended by themselves.
    fn remove_ended(&self) {
        let mut state = self.lock();
        state.known.retain(|_, known| match known.folder.has_ended() {
            Ok(true) => known.folder.remove().is_err(),
            _ => true,
        });
    }

    /// Starts pilots while there is more work than pilots, until the run ends.
    fn tend(&self) {
        loop {
            let state = self.lock();
            if state.closing {
                return;
            }
            let (state, _) = self.changed.wait_timeout(state, TEND).unwrap_or_else(PoisonError::into_inner);
            let (outstanding, closing) = (state.outstanding, state.closing);
            drop(state);
            if closing {
                return;
            }
            if outstanding == 0 || self.have_failed() {
                continue;
            }
            self.remove_ended();
            self.discover();
            let live = self.lock().known.values().filter(|known| known.counts()).count();
            if live < self.count.min(outstanding) && self.start_one().is_err() {
                // Each stage then has a job of its own, and reports the reason.
                self.lock().failures = FAILURES;
            }
        }
    }

    fn start_one(&self) -> Result<(), Failure> {
        let folder = PilotFolder::new(&self.root);
        folder.create(&self.orders)?;
        let home = folder.home();
        let unique = home.folder.file_name().unwrap_or_default().to_string_lossy();
        let name = format!("dril-{unique}");
        let submission = prepare::submission(name, &home, &self.settings, &self.resources());
        let job = self.submitter.scheduler.job_in_shell();
        let script = prepare::script(&self.site, PILOT, &folder.0, &self.settings, job);
        fsx::write(&submission.script, script.as_bytes())?;
        let job = self.submitter.submit(&home, &submission, &|| self.lock().closing)?;
        match job {
            Some(job) => {
                self.lock()
                    .known
                    .insert(job, Known { folder, is_of_our_class: true, is_ours: true, over: None });
            }
            // One that was accepted all the same finds no folder and ends.
            None => fsx::remove_dir_all(&folder.0)?,
        }
        Ok(())
    }

    /// Ends pilots that are idle, and cancels those that wait, unless another engine has work for them.
    fn close(&self) {
        self.discover();
        if !self.queue.list().is_ok_and(|entries| entries.is_empty()) {
            return;
        }
        let listed = self.submitter.scheduler.list().unwrap_or_default();
        let mut waiting = Vec::new();
        for (job, known) in self.lock().known.iter().filter(|(_, known)| known.is_of_our_class) {
            let _ = known.folder.ask_to_end();
            if matches!(listed.get(job), Some(Seen { state: JobState::Waiting, .. })) {
                waiting.push(job.clone());
            }
        }
        let _ = self.submitter.scheduler.cancel(&waiting);
    }
}

/// The thread that keeps the number of pilots; ends them when it is dropped, unless they are to stay.
pub(super) struct Tending {
    pilots: Arc<Pilots>,
    stay: bool,
    thread: Option<JoinHandle<()>>,
}

impl Tending {
    pub fn start(pilots: Arc<Pilots>, stay: bool) -> std::io::Result<Self> {
        let own = Arc::clone(&pilots);
        let thread = std::thread::Builder::new().name("pilots".to_owned()).spawn(move || own.tend())?;
        Ok(Self { pilots, stay, thread: Some(thread) })
    }
}

impl Drop for Tending {
    fn drop(&mut self) {
        self.pilots.lock().closing = true;
        self.pilots.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if !self.stay {
            self.pilots.close();
        }
    }
}
