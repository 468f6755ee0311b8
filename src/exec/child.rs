//! Runs a job in a child process: a group of its own, which goes with the engine and leaves nothing behind.
//!
//! A stage of our own kinds is `dril-pipe __stage JOB`, or a worker beside it. A kind whose work is another program's
//! costs no process of ours: the program is started as it is.

use std::ffi::OsString;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use dril_stage_api::{Message, Prepared, StageError};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use super::listen::Listener;
use super::memory;
use super::resources;
use super::runner::{Exit, Launch, Runner};
use super::stage::EXIT_STOPPED;
use super::survivors::{self, Followed};
use super::unstarted;
use super::warden::{Guarded, Warden};
use crate::fsx::{self, Entry, File};

/// How soon a wish to stop is noticed.
const GLANCE: Duration = Duration::from_millis(100);

/// How often the memory of a stage with a limit is measured.
const MEASURE: Duration = Duration::from_millis(200);

/// What caps the threads of libraries that stages use. Results do not depend on it; the neighbours' speed does.
const THREAD_LIMITS: [&str; 5] = [
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "RAYON_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
];

/// Runs a job in a child process of its own group: `dril-pipe __stage JOB`, or a worker beside it in the same way.
#[derive(Clone, Debug)]
pub struct ChildRunner {
    /// The program for the kinds that have no worker; workers are looked for in its folder.
    program: PathBuf,
    /// Arguments before the job file.
    args: Vec<OsString>,
    warden: Arc<Warden>,
    /// The last folder of stages' folders that was asked for, and its path without links.
    real: Arc<Mutex<(PathBuf, PathBuf)>>,
}

impl ChildRunner {
    /// `program` for the kinds that have no worker, with `args` before the job file; workers are looked for in its folder.
    pub fn new(program: impl Into<PathBuf>, args: impl IntoIterator<Item = OsString>) -> Self {
        let program = program.into();
        let warden = Arc::new(Warden::new(program.clone()));
        Self { args: args.into_iter().collect(), warden, program, real: Arc::default() }
    }

    /// This program and the workers beside it, as `__stage JOB`.
    ///
    /// # Errors
    /// The system does not say which file this program is.
    pub fn this_program() -> io::Result<Self> {
        Ok(Self::new(std::env::current_exe()?, ["__stage".into()]))
    }

    fn program(&self, worker: Option<&str>) -> PathBuf {
        match worker {
            None => self.program.clone(),
            Some(worker) => self.program.with_file_name(format!("{worker}{}", std::env::consts::EXE_SUFFIX)),
        }
    }

    /// The path of a stage's folder without links in it: as the system names it.
    fn real(&self, folder: &Path) -> PathBuf {
        let (Some(above), Some(name)) = (folder.parent(), folder.file_name()) else {
            return folder.to_owned();
        };
        let mut known = self.real.lock().unwrap_or_else(PoisonError::into_inner);
        if known.0 != above {
            *known = (above.to_owned(), fsx::real(above).unwrap_or_else(|| above.to_owned()));
        }
        known.1.join(name)
    }

    /// A stage of our own kinds.
    fn spawn(&self, program: &Path, launch: &Launch<'_>, log: &File) -> io::Result<Child> {
        let threads = launch.threads.max(1).to_string();
        let job = launch.folder.join("job.json");
        fsx::write(&job, &serde_json::to_vec(launch.job)?).map_err(io::Error::other)?;
        Command::new(program)
            .args(&self.args)
            .arg(job)
            .env("DRIL_STAGE_FOLDER", launch.folder)
            .envs(resources::variables(launch.units))
            .envs(THREAD_LIMITS.map(|name| (name, &threads)))
            .current_dir(launch.folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log.try_clone()?)
            .process_group(0)
            .spawn()
            .map_err(|error| {
                io::Error::new(error.kind(), format!("cannot start `{}`: {error}", program.display()))
            })
    }

    /// A program that is nothing of ours.
    fn run_program(
        &self,
        prepared: Result<Prepared, StageError>,
        launch: &Launch<'_>,
        hear: &mut dyn FnMut(Message),
    ) -> io::Result<Exit> {
        let mut prepared = match prepared {
            Ok(prepared) => prepared,
            Err(error) => return Ok(Exit::Failed(error.to_string())),
        };
        let log = fsx::open_append(launch.log).map_err(io::Error::other)?;
        let process = &mut prepared.process;
        cap_threads(process, launch.threads);
        process.envs(resources::variables(launch.units));
        process
            .stdin(launch.lock.map_or_else(|| Ok(Stdio::null()), |lock| lock.as_input().map(Stdio::from))?);
        process.stdout(Stdio::piped()).stderr(log.try_clone()?).process_group(0);
        let folder = self.real(launch.folder);
        survivors::take_orphans();
        let guarded = self.warden.guard(&folder)?;
        let child = match start(process) {
            Ok(child) => child,
            Err(error) => return Ok(Exit::Failed(unstarted::reason(process, &error))),
        };
        let mut watched = Watched::new(child, Listener::new(log), launch, &folder)?;
        guarded.has_group(watched.group)?;
        watched.guarded = Some(guarded);
        let status = watched.watch(hear)?;
        // Whatever its end: what it did to its inputs has to be known.
        let finished = (prepared.finish)(status);
        Ok(match finished {
            Ok(()) if status.success() => Exit::Done,
            Err(error) if status.success() => Exit::Failed(error.to_string()),
            finished => watched.unsuccessful(status, || match finished {
                _ if watched.asked.is_some() => Exit::Stopped,
                Err(error) => Exit::Failed(error.to_string()),
                Ok(()) => exit(status, false, None),
            }),
        })
    }
}

/// Starts a program. One that was just copied may be "busy" for a moment: a process that another thread is starting has all
/// that is open here, until it becomes its own program.
fn start(process: &mut Command) -> io::Result<Child> {
    let began = Instant::now();
    loop {
        match process.spawn() {
            Err(error) if error.kind() == io::ErrorKind::ExecutableFileBusy && began.elapsed() < GLANCE => {
                std::thread::sleep(Duration::from_millis(2));
            }
            result => return result,
        }
    }
}

/// Caps the threads of libraries, where the program is not told otherwise.
fn cap_threads(process: &mut Command, threads: usize) {
    let threads = threads.max(1).to_string();
    let given: Vec<OsString> = process.get_envs().map(|(name, _)| name.to_owned()).collect();
    let left = THREAD_LIMITS.iter().filter(|name| !given.iter().any(|given| given == **name));
    process.envs(left.map(|name| (name, &threads)));
}

impl Runner for ChildRunner {
    fn check(&self, worker: Option<&'static str>) -> Result<(), String> {
        let program = self.program(worker);
        match fsx::entry(&program) {
            Ok(Some(Entry::File(_) | Entry::Other)) => Ok(()),
            Ok(_) => Err(format!("the executable `{}` is not there, which runs them", program.display())),
            Err(error) => Err(error.to_string()),
        }
    }

    fn run(&self, launch: &Launch<'_>, hear: &mut dyn FnMut(Message)) -> io::Result<Exit> {
        if let Some(prepared) = launch.kind.prepare(launch.job) {
            return self.run_program(prepared, launch, hear);
        }
        let log = fsx::open_append(launch.log).map_err(io::Error::other)?;
        survivors::take_orphans();
        let child = self.spawn(&self.program(launch.kind.worker()), launch, &log)?;
        let mut watched = Watched::new(child, Listener::new(log), launch, &self.real(launch.folder))?;
        let status = watched.watch(hear)?;
        if status.success() {
            return Ok(Exit::Done);
        }
        Ok(watched.unsuccessful(status, || exit(status, watched.asked.is_some(), watched.listener.failure())))
    }
}

/// Which limit a stage has passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Over {
    Time,
    /// With so many bytes.
    Memory(u64),
}

fn too_much(bytes: u64, launch: &Launch<'_>) -> String {
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    let limit = launch.limits.memory.unwrap_or_default();
    format!("it kept {} MiB of memory, more than the {} MiB that its `memory` allows", mib(bytes), mib(limit))
}

/// A child that runs. Dropped early, it is killed with all it started.
struct Watched<'a> {
    child: Child,
    group: Pid,
    /// Ready once the child has ended; `None` where the system has no such thing.
    ended: Option<rustix::fd::OwnedFd>,
    listener: Listener,
    launch: &'a Launch<'a>,
    /// All that it started.
    followed: Followed,
    /// Where it does not see to it itself: that it dies with the engine.
    guarded: Option<Guarded<'a>>,
    asked: Option<Instant>,
    over: Option<Over>,
    began: Instant,
    measured: Instant,
    /// Kills for want of memory before it was started, or in the second before that.
    kills: Option<u64>,
    reaped: bool,
}

impl<'a> Watched<'a> {
    fn new(child: Child, listener: Listener, launch: &'a Launch<'a>, folder: &Path) -> io::Result<Self> {
        let group = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let group = group.ok_or_else(|| io::Error::other("the system gave no process number"))?;
        let now = Instant::now();
        let ended = pidfd(group);
        let kills = memory::kills_lately();
        Ok(Self {
            child,
            group,
            ended,
            listener,
            launch,
            followed: Followed::new(group, folder),
            guarded: None,
            asked: None,
            over: None,
            began: now,
            measured: now,
            kills,
            reaped: false,
        })
    }

    fn watch(&mut self, hear: &mut dyn FnMut(Message)) -> io::Result<ExitStatus> {
        let mut open = true;
        while !self.has_ended()? {
            self.stop_if_wished();
            self.stop_if_over();
            if self.wait_for_news(open)? {
                open = self.listener.read(self.child.stdout.as_mut(), hear)?;
            } else if let Some(guarded) = &self.guarded {
                guarded.renew()?;
            }
            self.followed.tidy();
        }
        // The child is dead but not yet reaped, so its number still names its group, and nobody else's.
        self.kill(Signal::KILL);
        self.followed.end_all();
        while open && self.ready(Duration::ZERO, true)? {
            open = self.listener.read(self.child.stdout.as_mut(), hear)?;
        }
        self.listener.finish(hear)?;
        self.guarded = None;
        self.reaped = true;
        self.child.wait()
    }

    fn has_ended(&self) -> io::Result<bool> {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        Ok(waitid(WaitId::Pid(self.group), options)?.is_some())
    }

    /// Asks the stage to stop, and kills it once it has had its time.
    fn stop_if_wished(&mut self) {
        match self.asked {
            None if self.launch.stop.load(Ordering::Relaxed) => {
                self.asked = Some(Instant::now());
                self.kill(Signal::TERM);
            }
            Some(asked) if asked.elapsed() >= self.launch.grace => self.kill(Signal::KILL),
            _ => {}
        }
    }

    /// Stops a stage that has passed a limit: one that takes too long may save its state, one that takes too much memory
    /// has no time for that.
    fn stop_if_over(&mut self) {
        let limits = &self.launch.limits;
        if self.over.is_some() || self.asked.is_some() {
            return;
        }
        if limits.timeout.is_some_and(|limit| self.began.elapsed() >= limit) {
            self.over = Some(Over::Time);
            self.asked = Some(Instant::now());
            self.kill(Signal::TERM);
        } else if let Some(limit) = limits.memory
            && self.measured.elapsed() >= MEASURE
        {
            self.measured = Instant::now();
            if let Some(bytes) = memory::resident(self.group).filter(|bytes| *bytes > limit) {
                self.over = Some(Over::Memory(bytes));
                self.kill(Signal::KILL);
            }
        }
    }

    /// How it ended without success; `otherwise` where no limit was the cause. Where its log is not whole, that is said: it
    /// may be just what one looks for.
    fn unsuccessful(&self, status: ExitStatus, otherwise: impl FnOnce() -> Exit) -> Exit {
        match (self.cause(status, otherwise), self.listener.lost()) {
            (Exit::Failed(text), Some(lost)) => Exit::Failed(format!(
                "{text}; a part of its log is lost: `{}`: {lost}",
                self.launch.log.display()
            )),
            (exit, _) => exit,
        }
    }

    fn cause(&self, status: ExitStatus, otherwise: impl FnOnce() -> Exit) -> Exit {
        match self.over {
            Some(Over::Time) => Exit::TimedOut,
            Some(Over::Memory(bytes)) => Exit::OutOfMemory(too_much(bytes, self.launch)),
            None if self.killed_for_memory(status) => Exit::OutOfMemory(
                "it was killed by the system, whose memory ran out; give it fewer neighbours (`--jobs`)"
                    .to_owned(),
            ),
            None => otherwise(),
        }
    }

    /// True where the system has killed something since the stage began, and the stage was killed, but not by us.
    fn killed_for_memory(&self, status: ExitStatus) -> bool {
        let killed = status.signal() == Some(Signal::KILL.as_raw()) && self.asked.is_none();
        killed && self.kills.is_some() && memory::kills() > self.kills
    }

    /// Waits until the child says something or ends, but not for long. True where there is something to read.
    fn wait_for_news(&self, open: bool) -> io::Result<bool> {
        // Without a notice of the end, a child that closed its output has to be looked after.
        let blind = self.ended.is_none() && !open;
        self.ready(if blind { Duration::from_millis(1) } else { GLANCE }, open)
    }

    fn ready(&self, timeout: Duration, open: bool) -> io::Result<bool> {
        let stdout = self.child.stdout.as_ref().filter(|_| open).map(AsFd::as_fd);
        let ended = self.ended.as_ref().map(AsFd::as_fd);
        let fds = stdout.into_iter().chain(ended);
        let mut fds: Vec<PollFd<'_>> = fds.map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)).collect();
        let timeout = Timespec::try_from(timeout).map_err(io::Error::other)?;
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) => Ok(open && fds.first().is_some_and(|fd| !fd.revents().is_empty())),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn kill(&self, signal: Signal) {
        // A group that is gone already is what was wanted.
        let _ = kill_process_group(self.group, signal);
    }
}

impl Drop for Watched<'_> {
    fn drop(&mut self) {
        if !self.reaped {
            self.kill(Signal::KILL);
            // It has to be dead before its orphans can be known.
            let _ = waitid(WaitId::Pid(self.group), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
            self.followed.end_all();
            self.guarded = None;
            let _ = self.child.wait();
        }
    }
}

#[cfg(target_os = "linux")]
fn pidfd(process: Pid) -> Option<rustix::fd::OwnedFd> {
    rustix::process::pidfd_open(process, rustix::process::PidfdFlags::empty()).ok()
}

#[cfg(not(target_os = "linux"))]
fn pidfd(_: Pid) -> Option<rustix::fd::OwnedFd> {
    None
}

/// How it ended, in words.
fn exit(status: ExitStatus, asked: bool, failure: Option<String>) -> Exit {
    match (status.code(), status.signal()) {
        (Some(0), _) => Exit::Done,
        (Some(code), _) if asked && code == i32::from(EXIT_STOPPED) => Exit::Stopped,
        (None, Some(_)) if asked => Exit::Stopped,
        (Some(code), _) if code == i32::from(EXIT_STOPPED) => {
            Exit::Failed("it was asked to stop, but not by this run".to_owned())
        }
        (_, Some(signal)) => Exit::Failed(format!("it was killed by {}", signal_name(signal))),
        (Some(101), _) if failure.is_none() => Exit::Failed("it panicked; the log says where".to_owned()),
        (Some(code), _) => Exit::Failed(
            failure.unwrap_or_else(|| format!("it ended with exit code {code} without saying why")),
        ),
        (None, None) => Exit::Failed(format!("it ended with {status}")),
    }
}

fn signal_name(signal: i32) -> String {
    let name = match signal {
        1 => "SIGHUP",
        2 => "SIGINT",
        3 => "SIGQUIT",
        4 => "SIGILL (an instruction that this processor does not have)",
        6 => "SIGABRT (it gave itself up; the log says why)",
        7 => "SIGBUS",
        8 => "SIGFPE",
        9 => "SIGKILL (by somebody, or by the system because memory ran out)",
        11 => "SIGSEGV (a wrong access to memory)",
        15 => "SIGTERM",
        24 => "SIGXCPU (its limit of processor time)",
        25 => "SIGXFSZ (its limit of file size)",
        _ => return format!("signal {signal}"),
    };
    name.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_told_in_words() {
        let status = ExitStatus::from_raw;
        let failed = |text: &str| Exit::Failed(text.to_owned());
        assert_eq!(exit(status(0), false, None), Exit::Done);
        assert_eq!(exit(status(0), true, None), Exit::Done);
        assert_eq!(exit(status(75 << 8), true, None), Exit::Stopped);
        assert_eq!(exit(status(9), true, None), Exit::Stopped);
        assert_eq!(exit(status(1 << 8), true, Some("no".into())), failed("no"));
        assert_eq!(exit(status(7 << 8), false, None), failed("it ended with exit code 7 without saying why"));
        let Exit::Failed(text) = exit(status(9), false, None) else { panic!() };
        assert!(text.contains("SIGKILL") && text.contains("memory"), "{text}");
        assert!(matches!(exit(status(75 << 8), false, None), Exit::Failed(_)));
    }

    #[test]
    fn a_worker_is_looked_for_beside_the_program() {
        let runner = ChildRunner::new("/opt/bin/dril-pipe", []);
        assert_eq!(runner.program(Some("dril-pipe-learn")), Path::new("/opt/bin/dril-pipe-learn"));
        let error = runner.check(Some("dril-pipe-learn")).unwrap_err();
        assert!(error.contains("`/opt/bin/dril-pipe-learn` is not there"), "{error}");
    }
}
