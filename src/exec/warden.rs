//! Sees to it that programs die with the engine that started them, with all that they started.
//!
//! A stage of our own watches its standard input, whose other end the engine holds; a foreign program does not, and a
//! death signal of the kernel would take only the program and leave what it started. So an engine has one more process,
//! `dril-pipe __warden`, which is told of every group that begins and ends, and kills those that are left once the engine
//! is gone. A group that began in the very moment in which the engine was killed may be missed: it then works on in the
//! folder of a run that is over, where nothing comes of it, and holds the lock of its key as long as it lives
//! (`Lock::as_input`), so nobody works beside it.

use std::collections::BTreeSet;
use std::io::{self, BufRead, Write};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::{Mutex, PoisonError};

use rustix::process::{Pid, Signal, kill_process_group};

/// The argument that makes this program a warden.
pub const WARDEN: &str = "__warden";

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

    /// Starts the process where it is not there yet, so that no time passes between the start of a group and
    /// [`Warden::guard`].
    pub fn be_there(&self) -> io::Result<()> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).be_there(&self.program)
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
        let all: String = self.groups.iter().map(|group| format!("+{group}\n")).collect();
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

/// The warden's side: listens until the engine is gone, then kills what is left.
pub fn watch_over() -> ExitCode {
    let mut groups = BTreeSet::new();
    for line in io::stdin().lock().lines() {
        let Ok(line) = line else { break };
        match (line.strip_prefix('+'), line.strip_prefix('-')) {
            (Some(group), _) => drop(group.parse::<i32>().map(|group| groups.insert(group))),
            (_, Some(group)) => drop(group.parse::<i32>().map(|group| groups.remove(&group))),
            _ => {}
        }
    }
    for group in groups.into_iter().filter(|group| *group > 1).filter_map(Pid::from_raw) {
        let _ = kill_process_group(group, Signal::KILL);
    }
    ExitCode::SUCCESS
}
