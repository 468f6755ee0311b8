//! Sees to it that programs die with the engine that started them, with all that they started.
//!
//! A stage of our own watches its standard input, whose other end the engine holds; a foreign program does not, and a
//! death signal of the kernel would take only the program and leave what it started. So an engine has one more process,
//! `dril-pipe __warden`, which is told of every group that begins and ends, and kills those that are left once the engine
//! is gone. It is told before a program is started, too, by the lock that the program gets as its standard input
//! (`Lock::as_input`): where the engine was killed before it could tell the group, the process with that input is looked
//! for. The same lock keeps everybody else from the work while any of these processes lives.

use std::collections::BTreeSet;
use std::io::{self, BufRead, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, getppid, kill_process_group};

use super::memory::{group_of, parent_of};
use crate::fsx;

/// The argument that makes this program a warden.
pub const WARDEN: &str = "__warden";

/// How long a program that was being started when the engine died is looked for.
const SEARCH: Duration = Duration::from_secs(3);

/// The engine's side.
#[derive(Debug)]
pub(super) struct Warden {
    program: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    process: Option<Child>,
    groups: BTreeSet<i32>,
    expected: BTreeSet<PathBuf>,
}

/// A group that dies with the engine, until this is dropped. To be dropped while the group's number cannot be another's
/// yet: before its first process is reaped.
#[derive(Debug)]
pub(super) struct Guarded<'a> {
    warden: &'a Warden,
    group: i32,
}

impl Warden {
    pub fn new(program: PathBuf) -> Self {
        Self { program, state: Mutex::default() }
    }

    /// A program is about to be started, with this file as its standard input.
    pub fn expect(&self, input: &Path) -> io::Result<()> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.expected.insert(input.to_owned());
        state.tell(&self.program, &expects(input))
    }

    /// What was expected has its group, or never began.
    pub fn settle(&self, input: &Path) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.expected.remove(input);
        let _ = state.write(&format!("!{}\n", named(input)));
    }

    /// From now on the group dies with this process.
    pub fn guard(&self, group: Pid) -> io::Result<Guarded<'_>> {
        let group = group.as_raw_nonzero().get();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.groups.insert(group);
        state.tell(&self.program, &format!("+{group}\n"))?;
        Ok(Guarded { warden: self, group })
    }
}

impl State {
    fn be_there(&mut self, program: &PathBuf) -> io::Result<()> {
        if self.process.is_none() {
            let mut command = Command::new(program);
            // A group of its own: an interrupt at the terminal is not for it.
            command.arg(WARDEN).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
            let process = command.process_group(0).spawn();
            self.process = Some(process.map_err(|error| {
                io::Error::new(error.kind(), format!("cannot start `{}`: {error}", program.display()))
            })?);
        }
        Ok(())
    }

    fn tell(&mut self, program: &PathBuf, line: &str) -> io::Result<()> {
        self.be_there(program)?;
        if self.write(line).is_ok() { Ok(()) } else { self.begin_anew(program) }
    }

    /// Somebody has killed it: the next one is told of all that there is.
    fn begin_anew(&mut self, program: &PathBuf) -> io::Result<()> {
        if let Some(mut dead) = self.process.take() {
            let _ = dead.kill();
            let _ = dead.wait();
        }
        self.be_there(program)?;
        let groups = self.groups.iter().map(|group| format!("+{group}\n"));
        let all: String = groups.chain(self.expected.iter().map(|input| expects(input))).collect();
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
    /// Sees to it that there is a warden still; to be called now and then.
    pub fn renew(&self) -> io::Result<()> {
        let mut state = self.warden.state.lock().unwrap_or_else(PoisonError::into_inner);
        match state.process.as_mut().map(Child::try_wait) {
            Some(Ok(None)) => Ok(()),
            _ => state.begin_anew(&self.warden.program),
        }
    }
}

impl Drop for Guarded<'_> {
    fn drop(&mut self) {
        let mut state = self.warden.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.groups.remove(&self.group);
        // One that cannot be told is dead, and its successor is not told of this group.
        let _ = state.write(&format!("-{}\n", self.group));
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

/// A path in one line, whatever is in it.
fn named(input: &Path) -> String {
    input.as_os_str().as_encoded_bytes().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn expects(input: &Path) -> String {
    format!("?{}\n", named(input))
}

/// The warden's side: listens until the engine is gone, then kills what is left.
pub fn watch_over() -> ExitCode {
    let mut groups = BTreeSet::new();
    let mut expected = BTreeSet::new();
    for line in io::stdin().lock().lines() {
        let Ok(line) = line else { break };
        let Some((word, rest)) = line.split_at_checked(1) else { continue };
        match (word, rest.parse::<i32>()) {
            ("+", Ok(group)) => drop(groups.insert(group)),
            ("-", Ok(group)) => drop(groups.remove(&group)),
            ("?", _) => drop(expected.insert(rest.to_owned())),
            ("!", _) => drop(expected.remove(rest)),
            _ => {}
        }
    }
    groups.into_iter().for_each(kill);
    let began = Instant::now();
    while !expected.is_empty() && began.elapsed() < SEARCH {
        for (input, process) in inputs() {
            // Whoever took the warden over has taken our program over too; that of the next engine has its engine.
            let ours = parent_of(&process) == getppid().map(|parent| parent.as_raw_nonzero().get());
            if ours && expected.remove(&named(&input)) {
                group_of(&process).into_iter().for_each(kill);
            }
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    ExitCode::SUCCESS
}

fn kill(group: i32) {
    if let Some(group) = Pid::from_raw(group).filter(|_| group > 1) {
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// The standard input of every process that can be looked at, with the process's folder in `/proc`.
fn inputs() -> Vec<(PathBuf, PathBuf)> {
    let processes = fsx::list(Path::new("/proc")).unwrap_or_default().into_iter();
    processes.filter_map(|process| Some((fsx::link_target(&process.join("fd/0"))?, process))).collect()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use crate::fsx::Lock;

    #[test]
    fn a_process_is_found_by_the_lock_that_is_its_input() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().canonicalize().unwrap().join("lock\nname");
        let lock = Lock::try_acquire(&path).unwrap().unwrap();
        let mut sleep = Command::new("sleep");
        let mut child = sleep.arg("60").stdin(lock.as_input().unwrap()).process_group(0).spawn().unwrap();
        drop(lock.as_input());
        let own = |process: &Path| group_of(process) == i32::try_from(child.id()).ok();
        let found = inputs().into_iter().find(|(input, process)| *input == path && own(process));
        kill(group_of(&found.unwrap().1).unwrap());
        assert!(!child.wait().unwrap().success());
    }
}
