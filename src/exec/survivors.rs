//! Kills every process that a stage started and left behind, including processes that left its process group (`setsid`,
//! daemons) and processes with an empty environment.
//!
//! While stages run, this process is a child subreaper (PR_SET_CHILD_SUBREAPER, prctl(2)): it adopts processes whose parent
//! died. So whatever a stage leaves behind becomes a child of this process and keeps its process ID until it is killed and
//! reaped. Its process group, working folder, open files and environment tell which stage it belongs to. A process that hides
//! all of these is attributed by its start time: it belongs to no stage that started later, and if only one stage is left, to
//! that one. A program that has children of its own beside stages must not rely on that guess: see [`claim_all_children`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, Once, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, getpid, kill_process, waitid};

use super::processes::{Process, given_children};

/// How long to wait for killed processes to end: one that hangs in the kernel does not die.
const KILL_TIMEOUT: Duration = Duration::from_secs(5);

/// How often ended orphans are reaped while their stage runs.
const REAP_INTERVAL: Duration = Duration::from_millis(200);

static CLAIMED: AtomicBool = AtomicBool::new(false);
static RUNNING: Mutex<Running> = Mutex::new(Running { stages: BTreeMap::new(), swept: None });

#[derive(Debug)]
struct Running {
    /// The folder of each stage, by the number of its own process.
    stages: BTreeMap<i32, PathBuf>,
    swept: Option<Instant>,
}

/// Declares that every process that this one adopts belongs to a stage, even if nothing else shows which.
pub fn claim_all_children() {
    CLAIMED.store(true, Ordering::Relaxed);
}

/// From now on, this process adopts descendants whose parent died.
pub(super) fn take_orphans() {
    static ONCE: Once = Once::new();
    // On systems without subreapers only the process group can be killed.
    ONCE.call_once(|| {
        let _ = rustix::process::set_child_subreaper(Some(getpid()));
    });
}

/// Tracks the descendants of a stage until it is dropped.
#[derive(Debug)]
pub(super) struct Followed {
    pid: i32,
}

impl Followed {
    /// Tracks the stage with process ID `pid` and working folder `folder`, a path without symbolic links.
    pub fn new(pid: Pid, folder: &Path) -> Self {
        let pid = pid.as_raw_nonzero().get();
        lock().stages.insert(pid, folder.to_owned());
        Self { pid }
    }

    /// Reaps orphans that have ended while the stage runs, so that zombies do not pile up. Cheap enough to call often.
    pub fn reap(&self) {
        let mut running = lock();
        if running.swept.is_some_and(|swept| swept.elapsed() < REAP_INTERVAL) {
            return;
        }
        running.swept = Some(Instant::now());
        for orphan in orphans(&running).into_iter().filter(|orphan| orphan.is_zombie) {
            if CLAIMED.load(Ordering::Relaxed) || running.stages.contains_key(&orphan.group) {
                has_ended(orphan.pid);
            }
        }
    }

    /// Kills whatever the stage left behind and waits until it is gone. The stage's own process has ended and is not reaped
    /// yet. True where something was left.
    pub fn end_all(&self) -> bool {
        let mut found = false;
        let began = Instant::now();
        loop {
            let left = self.left();
            if left.is_empty() || began.elapsed() > KILL_TIMEOUT {
                return found;
            }
            for orphan in left {
                found |= !orphan.is_zombie;
                if let Some(pid) = Pid::from_raw(orphan.pid) {
                    let _ = kill_process(pid, Signal::KILL);
                }
                while !has_ended(orphan.pid) && began.elapsed() <= KILL_TIMEOUT {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        }
    }

    /// The orphans that belong to this stage.
    fn left(&self) -> Vec<Process> {
        let running = lock();
        let orphans = orphans(&running);
        let Some(own) = running.stages.get(&self.pid).filter(|_| !orphans.is_empty()) else {
            return Vec::new();
        };
        let is_of = |process: &Process, pid: i32, folder: &Path| {
            process.group == pid || !process.is_zombie && process.belongs_to(folder)
        };
        let began = |pid: i32| Process::of(pid).map_or(0, |process| process.began);
        let may_be_of_others = |process: &Process| {
            let mut others = running.stages.iter().filter(|(pid, _)| **pid != self.pid);
            others.any(|(pid, folder)| process.began >= began(*pid) || is_of(process, *pid, folder))
        };
        let claimed = CLAIMED.load(Ordering::Relaxed);
        let is_ours = |process: &Process| {
            is_of(process, self.pid, own)
                || claimed && process.began >= began(self.pid) && !may_be_of_others(process)
        };
        orphans.into_iter().filter(is_ours).collect()
    }
}

impl Drop for Followed {
    fn drop(&mut self) {
        lock().stages.remove(&self.pid);
    }
}

fn lock() -> std::sync::MutexGuard<'static, Running> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The processes that this one has adopted: neither the stages' own processes nor the warden.
fn orphans(running: &Running) -> Vec<Process> {
    let given = given_children(getpid()).into_iter().filter(|pid| !running.stages.contains_key(pid));
    given.filter_map(Process::of).filter(|process| !is_warden(process)).collect()
}

/// The warden is a child of this process, too.
fn is_warden(process: &Process) -> bool {
    super::warden::pid() == Some(process.pid)
}

/// Reaps a child if it has ended; true where it is gone.
fn has_ended(pid: i32) -> bool {
    let Some(pid) = Pid::from_raw(pid) else { return true };
    // An error means that it is no longer a child.
    !matches!(waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOHANG), Ok(None))
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use std::os::unix::process::CommandExt;
    use std::process::{Child, Command};

    use super::*;

    /// A stage that runs this shell script, after its own process has ended.
    fn ended(text: &str, place: &Path) -> (Child, Followed) {
        take_orphans();
        let mut shell = Command::new("sh");
        shell.args(["-c", text]).current_dir(place).env("TMPDIR", place).process_group(0);
        let child = shell.spawn().unwrap();
        let pid = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
        let followed = Followed::new(pid, place);
        waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT).unwrap();
        (child, followed)
    }

    fn pid_in(place: &Path) -> i32 {
        std::fs::read_to_string(place.join("pid")).unwrap().trim().parse().unwrap()
    }

    #[test]
    fn processes_that_left_the_group_of_their_stage_are_killed_with_it() {
        for text in [
            "setsid sh -c 'echo $$ > pid; exec sleep 300' & while [ ! -s pid ]; do sleep 0.01; done",
            // Empty environment, another working folder; only its output file belongs to the stage.
            "setsid sh -c 'cd /; env -i sh -c \"exec sleep 300\" & echo $! > '$PWD'/pid' > out 2>&1; sleep 0.1",
        ] {
            let place = tempfile::tempdir().unwrap();
            let (mut child, followed) = ended(text, place.path());
            let pid = pid_in(place.path());
            assert!(Process::of(pid).is_some(), "{text}");
            assert!(followed.end_all(), "{text}");
            assert_eq!(Process::of(pid), None, "{text}");
            assert!(!followed.end_all());
            child.wait().unwrap();
        }
    }

    #[test]
    fn processes_of_another_stage_are_left_alone() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let text = "setsid sh -c 'echo $$ > pid; exec sleep 300' & while [ ! -s pid ]; do sleep 0.01; done";
        let (mut first, followed) = ended(text, one.path());
        let (mut second, next) = ended("exit 0", other.path());
        assert!(!next.end_all());
        assert!(Process::of(pid_in(one.path())).is_some());
        assert!(followed.end_all());
        first.wait().unwrap();
        second.wait().unwrap();
    }
}
