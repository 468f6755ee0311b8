//! What a program of a stage does not share with the engine: its terminal, and the engine's limit of open files.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command};
use std::sync::OnceLock;

use rustix::process::{Pid, Resource, Rlimit, getrlimit, prlimit, setrlimit, setsid};

/// The limit of open files that this process was started with.
static USUAL: OnceLock<Rlimit> = OnceLock::new();

/// Raises this process's limit of open files as far as it may: every running stage needs some. Stages still get the limit that this
/// process was started with, since programs that use `select` need it to be low. Call it before anything runs.
pub fn raise_open_files() {
    let usual = USUAL.get_or_init(|| getrlimit(Resource::Nofile));
    // Otherwise fewer stages can run at the same time.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: usual.maximum, maximum: usual.maximum });
}

/// How many files this process may have open.
pub(super) fn open_files() -> u64 {
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

/// Gives a child that was just started the usual limit of open files.
pub(super) fn lower_open_files(child: &Child) {
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    if let (Some(pid), Some(usual)) = (pid, USUAL.get()) {
        let _ = prlimit(Some(pid), Resource::Nofile, *usual);
    }
}

/// Makes a program begin in a session of its own, as the first of its process group, without a terminal: one that asks for a
/// password there gets an error at once. In the engine's session the system would stop it instead, without a word.
#[allow(unsafe_code)]
pub(super) fn put_apart(process: &mut Command) {
    let usual = USUAL.get().cloned();
    let begin = move || -> io::Result<()> {
        setsid()?;
        if let Some(usual) = &usual {
            let _ = setrlimit(Resource::Nofile, *usual);
        }
        Ok(())
    };
    // SAFETY: between fork and exec only system calls are made; nothing is allocated and no lock is taken.
    unsafe { process.pre_exec(begin) };
}
