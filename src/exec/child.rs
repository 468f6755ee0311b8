//! Runs a job in a child process, in a process group of its own that dies with the engine and leaves nothing behind.
//!
//! A built-in stage runs as `dril-pipe __stage JOB`, or in a worker executable beside it. For a kind that runs a foreign
//! program, that program is started directly, without a process of ours around it.

use std::collections::BTreeMap;
use std::error::Error;
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

use super::apart;
use super::checkpoints;
use super::ending::exit;
use super::failure::Failure;
use super::inputs::LaidOut;
use super::listen::Listener;
use super::memory;
use super::options::POLL_INTERVAL;
use super::resources;
use super::runner::{Exit, Launch, Runner};
use super::survivors::{self, Followed};
use super::unstarted;
use super::warden::{Guarded, Warden};
use crate::fsx::{self, Entry, File};

/// The shortest interval at which the memory of a stage with a limit is measured.
const MEASURE_INTERVAL: Duration = Duration::from_millis(200);

/// Variables that cap the threads of numerical libraries. Results do not depend on it; the speed of other stages does.
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
    /// Environment variables for external programs, where their values do not come from this process.
    passed: Arc<BTreeMap<String, OsString>>,
    /// The last parent of stage folders that was resolved, and its path without symbolic links.
    real: Arc<Mutex<(PathBuf, PathBuf)>>,
}

impl ChildRunner {
    /// `program` for the kinds that have no worker, with `args` before the job file; workers are looked for in its folder.
    pub fn new(program: impl Into<PathBuf>, args: impl IntoIterator<Item = OsString>) -> Self {
        let program = program.into();
        let warden = Arc::new(Warden::new(program.clone()));
        let (passed, real) = Default::default();
        Self { args: args.into_iter().collect(), warden, program, passed, real }
    }

    /// The same, whose external programs get these environment variables.
    #[must_use]
    pub fn passing(&self, variables: BTreeMap<String, OsString>) -> Self {
        Self { passed: variables.into(), ..self.clone() }
    }

    /// This program and the workers beside it, called as `__stage JOB`.
    ///
    /// # Errors
    /// The path of this executable cannot be determined.
    pub fn this_program() -> io::Result<Self> {
        Ok(Self::new(std::env::current_exe()?, ["__stage".into()]))
    }

    fn program(&self, worker: Option<&str>) -> PathBuf {
        match worker {
            None => self.program.clone(),
            Some(worker) => self.program.with_file_name(format!("{worker}{}", std::env::consts::EXE_SUFFIX)),
        }
    }

    /// The path of a stage's folder without symbolic links, as `/proc` shows it.
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

    /// Starts a built-in stage.
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
            .inspect(apart::lower_open_files)
            .map_err(|error| {
                io::Error::new(error.kind(), format!("cannot start `{}`: {error}", program.display()))
            })
    }

    /// Runs an external program.
    fn run_program(
        &self,
        prepared: Result<Prepared, StageError>,
        launch: &Launch<'_>,
        on_message: &mut dyn FnMut(Message),
    ) -> Result<Exit, Failure> {
        let mut prepared = prepared.map_err(|error| Failure::Stage(error.to_string()))?;
        // Their names in the working folder are new.
        launch.inputs.map_or(Ok(()), LaidOut::were_linked)?;
        let log = fsx::open_append(launch.log).map_err(io::Error::other)?;
        let process = &mut prepared.process;
        process.envs(&*self.passed);
        cap_threads(process, launch.threads);
        process.envs(resources::variables(launch.units));
        // Tells which stage a process belongs to, wherever it works.
        process.env("DRIL_STAGE_FOLDER", launch.folder);
        process
            .stdin(launch.lock.map_or_else(|| Ok(Stdio::null()), |lock| lock.as_input().map(Stdio::from))?);
        process.stdout(Stdio::piped()).stderr(log.try_clone()?);
        apart::put_apart(process);
        let folder = self.real(launch.folder);
        survivors::take_orphans();
        let guarded = self.warden.guard(&folder)?;
        let child = match start(process) {
            Ok(child) => child,
            Err(error) => return Err(Failure::Stage(unstarted::reason(process, &error))),
        };
        let mut watched = Watched::new(child, Listener::new(log), launch, &folder)?;
        guarded.has_group(watched.group)?;
        watched.guarded = Some(guarded);
        let status = watched.watch(on_message)?;
        // Many programs exit with 0 when they are asked to stop, however much they have done. Where all processes of a job get
        // the signal, the program may end before this process has passed it on.
        if watched.asked.is_some() || watched.over.is_some() || launch.stop.load(Ordering::Relaxed) {
            return watched.unsuccessful(status, || Ok(Exit::Stopped));
        }
        let finished = (prepared.finish)(status).map_err(|error| Failure::Stage(error.to_string()));
        if status.success() {
            return finished.map(|()| Exit::Done);
        }
        watched.unsuccessful(status, || finished.and_then(|()| exit(status, false, None)))
    }
}

/// Starts a program. One that was just copied can be "busy" for a moment: a process that another thread has forked holds all
/// our open files until its exec.
fn start(process: &mut Command) -> io::Result<Child> {
    let began = Instant::now();
    loop {
        match process.spawn() {
            Err(error)
                if error.kind() == io::ErrorKind::ExecutableFileBusy && began.elapsed() < POLL_INTERVAL =>
            {
                std::thread::sleep(Duration::from_millis(2));
            }
            result => return result,
        }
    }
}

/// Caps the threads of libraries, unless the stage sets these variables itself.
fn cap_threads(process: &mut Command, threads: usize) {
    let threads = threads.max(1).to_string();
    let given: Vec<OsString> = process.get_envs().map(|(name, _)| name.to_owned()).collect();
    let left = THREAD_LIMITS.iter().filter(|name| !given.iter().any(|given| given == **name));
    process.envs(left.map(|name| (name, &threads)));
}

impl Runner for ChildRunner {
    fn check(&self, worker: Option<&'static str>) -> Result<(), Box<dyn Error + Send + Sync>> {
        let program = self.program(worker);
        match fsx::entry(&program) {
            Ok(Some(Entry::File(_) | Entry::Other)) => Ok(()),
            Ok(_) => Err(format!("their executable `{}` does not exist", program.display()).into()),
            Err(error) => Err(error.into()),
        }
    }

    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        if !checkpoints::discard(launch)? {
            return Ok(Exit::Stopped);
        }
        if let Some(prepared) = launch.kind.prepare(launch.job) {
            return self.run_program(prepared, launch, on_message);
        }
        let log = fsx::open_append(launch.log).map_err(io::Error::other)?;
        survivors::take_orphans();
        let child = self.spawn(&self.program(launch.kind.worker()), launch, &log)?;
        let mut watched = Watched::new(child, Listener::new(log), launch, &self.real(launch.folder))?;
        let status = watched.watch(on_message)?;
        if status.success() {
            return Ok(Exit::Done);
        }
        watched.unsuccessful(status, || exit(status, watched.asked.is_some(), watched.listener.failure()))
    }
}

/// The limit that a stage has exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Over {
    Time,
    /// With this many bytes.
    Memory(u64),
}

fn too_much(bytes: u64, launch: &Launch<'_>) -> String {
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    let limit = launch.limits.memory.unwrap_or_default();
    format!("it used {} MiB of memory, more than its limit of {} MiB (`memory`)", mib(bytes), mib(limit))
}

/// A running child process. If it is dropped early, it is killed with all processes that it started.
struct Watched<'a> {
    child: Child,
    group: Pid,
    /// Readable once the child has ended; `None` on systems without pidfd.
    ended: Option<rustix::fd::OwnedFd>,
    listener: Listener,
    launch: &'a Launch<'a>,
    /// The processes that it started.
    followed: Followed,
    /// Kills it if the engine dies; for external programs, which do not watch the engine themselves.
    guarded: Option<Guarded<'a>>,
    asked: Option<Instant>,
    over: Option<Over>,
    began: Instant,
    /// When its memory is measured next.
    measure: Instant,
    /// The system's count of out-of-memory kills when it was started, at most a second old.
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
            measure: now + MEASURE_INTERVAL,
            kills,
            reaped: false,
        })
    }

    fn watch(&mut self, on_message: &mut dyn FnMut(Message)) -> io::Result<ExitStatus> {
        let mut open = true;
        while !self.has_ended()? {
            self.stop_if_asked();
            self.stop_at_limits();
            if self.wait_for_output(open)? {
                open = self.listener.read(self.child.stdout.as_mut(), on_message)?;
            } else if let Some(guarded) = &self.guarded {
                guarded.renew()?;
            }
            self.followed.reap();
        }
        // The child is dead but not reaped, so its process ID still names its group and no other.
        self.kill(Signal::KILL);
        self.followed.end_all();
        while open && self.ready(Duration::ZERO, true)? {
            open = self.listener.read(self.child.stdout.as_mut(), on_message)?;
        }
        self.listener.finish(on_message)?;
        self.guarded = None;
        self.reaped = true;
        self.child.wait()
    }

    fn has_ended(&self) -> io::Result<bool> {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        Ok(waitid(WaitId::Pid(self.group), options)?.is_some())
    }

    /// Asks the stage to stop, and kills it after the grace period.
    fn stop_if_asked(&mut self) {
        match self.asked {
            None if self.launch.stop.load(Ordering::Relaxed) => self.ask(),
            Some(asked) if asked.elapsed() >= self.launch.grace => self.kill(Signal::KILL),
            _ => {}
        }
    }

    /// Stops a stage that exceeds a limit. One that runs too long may still write a checkpoint; one that uses too much memory
    /// is killed at once.
    fn stop_at_limits(&mut self) {
        let limits = &self.launch.limits;
        if self.over.is_some() || self.asked.is_some() {
            return;
        }
        if limits.timeout.is_some_and(|limit| self.began.elapsed() >= limit) {
            self.over = Some(Over::Time);
            self.ask();
        } else if let Some(limit) = limits.memory
            && Instant::now() >= self.measure
        {
            let began = Instant::now();
            if let Some(bytes) = memory::used_above(self.group, limit) {
                self.over = Some(Over::Memory(bytes));
                self.kill(Signal::KILL);
            }
            // Measuring large processes takes a while, and they are stopped meanwhile.
            self.measure = Instant::now() + MEASURE_INTERVAL.max(began.elapsed() * 10);
        }
    }

    /// Asks the stage to stop. A suspended one is continued, so that it can.
    fn ask(&mut self) {
        self.asked = Some(Instant::now());
        self.kill(Signal::TERM);
        self.kill(Signal::CONT);
    }

    /// How it ended without success; `otherwise` where no limit was the cause. The failure mentions an incomplete log, since the
    /// missing part may be the one that explains it.
    fn unsuccessful(
        &self,
        status: ExitStatus,
        otherwise: impl FnOnce() -> Result<Exit, Failure>,
    ) -> Result<Exit, Failure> {
        match (self.cause(status, otherwise), self.listener.lost()) {
            (Err(Failure::Stage(text)), Some(lost)) => Err(Failure::Stage(format!(
                "{text}; a part of its log is lost: `{}`: {lost}",
                self.launch.log.display()
            ))),
            (exit, _) => exit,
        }
    }

    fn cause(
        &self,
        status: ExitStatus,
        otherwise: impl FnOnce() -> Result<Exit, Failure>,
    ) -> Result<Exit, Failure> {
        match self.over {
            Some(Over::Time) => Err(Failure::TimedOut(self.launch.limits.timeout.unwrap_or_default())),
            Some(Over::Memory(bytes)) => Err(Failure::OutOfMemory(too_much(bytes, self.launch))),
            None if self.killed_for_memory(status) => Err(Failure::OutOfMemory(
                "the system ran out of memory and killed it; run fewer stages at the same time (`--jobs`)"
                    .to_owned(),
            )),
            None => otherwise(),
        }
    }

    /// True where the stage was killed, not by us, and the system has killed some process for memory since the stage began.
    fn killed_for_memory(&self, status: ExitStatus) -> bool {
        let killed = status.signal() == Some(Signal::KILL.as_raw()) && self.asked.is_none();
        killed && self.kills.is_some() && memory::kills() > self.kills
    }

    /// Waits for output or the end of the child, at most one polling interval. True where there is output to read.
    fn wait_for_output(&self, open: bool) -> io::Result<bool> {
        // Without pidfd, the end of a child that closed its output can only be polled.
        let blind = self.ended.is_none() && !open;
        self.ready(if blind { Duration::from_millis(1) } else { POLL_INTERVAL }, open)
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
        // A group that no longer exists is as good as killed.
        let _ = kill_process_group(self.group, signal);
    }
}

impl Drop for Watched<'_> {
    fn drop(&mut self) {
        if !self.reaped {
            self.kill(Signal::KILL);
            // Its orphans are known only once it is dead.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_is_expected_beside_the_program() {
        let runner = ChildRunner::new("/opt/bin/dril-pipe", []);
        assert_eq!(runner.program(Some("dril-pipe-learn")), Path::new("/opt/bin/dril-pipe-learn"));
        let error = runner.check(Some("dril-pipe-learn")).unwrap_err().to_string();
        assert!(error.contains("`/opt/bin/dril-pipe-learn` does not exist"), "{error}");
    }
}
