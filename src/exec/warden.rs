//! The warden kills external programs, and all processes that they started, when their engine dies.
//!
//! A built-in stage watches its stdin, whose other end the engine holds. An external program does not, and the kernel's
//! parent-death signal would kill only the program and leave its children. So an engine has one more process, `dril-pipe
//! __warden`. It receives the folder of every program before the program starts, and then its process group. When the engine is
//! gone it kills the groups, and then every other process that uses one of the folders (`Process::belongs_to`). A program's
//! stdin is the lock on its key (`Lock::as_input`), so no other engine starts the same work while any of these processes lives.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{self, BufRead, Write};
use std::os::unix::ffi::OsStringExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, PidfdFlags, Signal, getppid, kill_process_group, pidfd_open, pidfd_send_signal};

use super::processes::{self, Process};

/// The argument that makes this executable a warden.
pub const WARDEN: &str = "__warden";

/// How long to search for a program that was being started when the engine died.
const SEARCH: Duration = Duration::from_secs(3);
/// How long to kill programs that keep starting others.
const LONGEST: Duration = Duration::from_secs(60);

/// Process ID of the last warden that was started.
static PID: AtomicI32 = AtomicI32::new(0);

/// The process ID of this process's warden.
pub(super) fn pid() -> Option<i32> {
    Some(PID.load(Ordering::Relaxed)).filter(|pid| *pid > 0)
}

/// The engine's handle of its warden.
#[derive(Debug)]
pub(super) struct Warden {
    program: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    process: Option<Child>,
    /// The folders of the programs, with their process groups once known.
    guarded: BTreeMap<PathBuf, Option<i32>>,
}

/// While this exists, the program dies with the engine. Drop it before the program's first process is reaped, as long as the
/// group's ID cannot be reused.
#[derive(Debug)]
pub(super) struct Guarded<'a> {
    warden: &'a Warden,
    folder: PathBuf,
}

impl Warden {
    pub fn new(program: PathBuf) -> Self {
        Self { program, state: Mutex::default() }
    }

    /// From now on, processes that use this folder die with this process. It is the private folder of a program that is about to
    /// start, as a path without symbolic links.
    pub fn guard(&self, folder: &Path) -> io::Result<Guarded<'_>> {
        let folder = folder.to_owned();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.guarded.insert(folder.clone(), None);
        let line = line('?', None, &folder);
        state.send(&self.program, &line)?;
        Ok(Guarded { warden: self, folder })
    }
}

impl State {
    fn ensure_running(&mut self, program: &PathBuf) -> io::Result<()> {
        if self.process.is_none() {
            let mut command = Command::new(program);
            // In a group of its own, so that Ctrl-C in the terminal does not reach it.
            command.arg(WARDEN).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
            let process = command.process_group(0).spawn().map_err(|error| {
                io::Error::new(error.kind(), format!("cannot start `{}`: {error}", program.display()))
            })?;
            PID.store(i32::try_from(process.id()).unwrap_or(0), Ordering::Relaxed);
            self.process = Some(process);
        }
        Ok(())
    }

    fn send(&mut self, program: &PathBuf, line: &str) -> io::Result<()> {
        self.ensure_running(program)?;
        if self.write(line).is_ok() { Ok(()) } else { self.restart(program) }
    }

    /// Starts a new warden after the last one was killed, and sends it everything there is to guard.
    fn restart(&mut self, program: &PathBuf) -> io::Result<()> {
        if let Some(mut dead) = self.process.take() {
            let _ = dead.kill();
            let _ = dead.wait();
        }
        self.ensure_running(program)?;
        let all: String = self
            .guarded
            .iter()
            .map(|(folder, group)| line(group.map_or('?', |_| '+'), *group, folder))
            .collect();
        self.write(&all)
    }

    fn write(&mut self, text: &str) -> io::Result<()> {
        match self.process.as_mut().and_then(|process| process.stdin.as_mut()) {
            Some(pipe) => pipe.write_all(text.as_bytes()),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }
}

impl Guarded<'_> {
    /// Reports the process group of the program after it has started.
    pub fn has_group(&self, group: Pid) -> io::Result<()> {
        let group = group.as_raw_nonzero().get();
        let mut state = self.warden.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.guarded.insert(self.folder.clone(), Some(group));
        state.send(&self.warden.program, &line('+', Some(group), &self.folder))
    }

    /// Restarts the warden if it was killed; call this from time to time.
    pub fn renew(&self) -> io::Result<()> {
        let mut state = self.warden.state.lock().unwrap_or_else(PoisonError::into_inner);
        match state.process.as_mut().map(Child::try_wait) {
            Some(Ok(None)) => Ok(()),
            _ => state.restart(&self.warden.program),
        }
    }
}

impl Drop for Guarded<'_> {
    fn drop(&mut self) {
        let mut state = self.warden.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.guarded.remove(&self.folder);
        // A warden that cannot be reached is dead, and its successor will not hear of this program.
        let _ = state.write(&line('-', None, &self.folder));
    }
}

impl Drop for Warden {
    fn drop(&mut self) {
        let state = self.state.get_mut().unwrap_or_else(PoisonError::into_inner);
        if let Some(mut process) = state.process.take() {
            drop(process.stdin.take());
            let _ = process.wait();
        }
    }
}

/// `?<folder>` before a program starts, `+<group> <folder>` afterwards, `-<folder>` when it has ended. The folder is written in
/// hexadecimal, so that it is one line whatever its name.
fn line(word: char, group: Option<i32>, folder: &Path) -> String {
    let group = group.map(|group| format!("{group} ")).unwrap_or_default();
    let bytes = folder.as_os_str().as_encoded_bytes();
    let folder: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("{word}{group}{folder}\n")
}

fn folder_of(text: &str) -> Option<PathBuf> {
    let digits = text.as_bytes().chunks(2);
    let bytes: Option<Vec<u8>> =
        digits.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()).collect();
    Some(OsString::from_vec(bytes?).into()).filter(|folder: &PathBuf| folder.is_absolute())
}

/// The warden process: listens until the engine is gone, then kills what is left.
pub fn watch_over() -> ExitCode {
    let mut guarded: BTreeMap<PathBuf, Option<i32>> = BTreeMap::new();
    for line in io::stdin().lock().lines() {
        let Ok(line) = line else { break };
        let Some((word, rest)) = line.split_at_checked(1) else { continue };
        let (group, folder) = rest.split_once(' ').unwrap_or(("", rest));
        let Some(folder) = folder_of(folder) else { continue };
        match word {
            "?" | "+" => drop(guarded.insert(folder, group.parse().ok())),
            "-" => drop(guarded.remove(&folder)),
            _ => {}
        }
    }
    guarded.values().flatten().for_each(|group| kill_group(*group));
    let began = Instant::now();
    let being_started = guarded.values().any(Option::is_none);
    // Children of killed processes are left for the next round; on a busy machine a round can take long.
    let mut rounds_without = 0;
    while !guarded.is_empty() && began.elapsed() < LONGEST {
        // The process that adopted this one has adopted the engine's other children, too.
        let parent = getppid().map_or(1, |parent| parent.as_raw_nonzero().get());
        let found = kill_users(guarded.keys().map(PathBuf::as_path), parent);
        rounds_without = if found { 0 } else { rounds_without + 1 };
        if rounds_without >= 2 && (!being_started || began.elapsed() > SEARCH) {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    ExitCode::SUCCESS
}

/// Kills every child of `parent` that uses one of the folders; true where there was one.
fn kill_users<'f>(folders: impl Iterator<Item = &'f Path> + Clone, parent: i32) -> bool {
    let own = rustix::process::getpid().as_raw_nonzero().get();
    let mut found = false;
    let is_one = |process: &Process| process.parent == parent && process.pid != own && !process.is_zombie;
    for process in processes::all().into_iter().filter(is_one) {
        // While a pidfd is open, the process ID cannot be reused.
        let Some(held) = Pid::from_raw(process.pid).and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok())
        else {
            continue;
        };
        // The next engine has these folders open while it removes them.
        let is_engine = process.is_this_program();
        let uses = |folder| process.works_in(folder) || !is_engine && process.has_open(folder);
        if folders.clone().any(uses) {
            found |= pidfd_send_signal(&held, Signal::KILL).is_ok();
        }
    }
    found
}

fn kill_group(group: i32) {
    if let Some(group) = Pid::from_raw(group).filter(|_| group > 1) {
        let _ = kill_process_group(group, Signal::KILL);
    }
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_found_by_its_working_folder_and_killed() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().canonicalize().unwrap().join("a\nname");
        std::fs::create_dir(&folder).unwrap();
        let mut child = Command::new("sleep").arg("60").env_clear().current_dir(&folder).spawn().unwrap();
        let sent = line('+', Some(7), &folder);
        let sent = sent.trim_end().split_once(' ').unwrap().1;
        assert_eq!(folder_of(sent), Some(folder.clone()));
        let own = i32::try_from(std::process::id()).unwrap();
        assert!(!kill_users(std::iter::once(Path::new("/else/where")), own));
        assert!(!kill_users(std::iter::once(folder.as_path()), 1));
        assert!(kill_users(std::iter::once(folder.as_path()), own));
        assert!(!child.wait().unwrap().success());
    }

    #[test]
    #[ignore = "the process of the next test"]
    fn waits() {
        std::thread::sleep(Duration::from_secs(5));
    }

    #[test]
    fn an_engine_that_removes_the_folder_is_not_killed() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().canonicalize().unwrap();
        let open = || std::fs::File::create(folder.join("file")).unwrap();
        let mut engine = Command::new(std::env::current_exe().unwrap());
        engine.args(["--ignored", "--exact", "exec::warden::tests::waits"]).stdout(Stdio::null());
        let mut engine = engine.current_dir("/").stdin(open()).spawn().unwrap();
        let own = i32::try_from(std::process::id()).unwrap();
        let is_up =
            || Process::of(i32::try_from(engine.id()).unwrap()).is_some_and(|it| it.is_this_program());
        while !is_up() {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(!kill_users(std::iter::once(folder.as_path()), own));
        engine.kill().unwrap();
        engine.wait().unwrap();
        let mut program = Command::new("sleep").arg("60").current_dir("/").stdin(open()).spawn().unwrap();
        assert!(kill_users(std::iter::once(folder.as_path()), own));
        program.wait().unwrap();
    }
}
