//! Nothing that a stage started outlives it: neither what left its process group (`setsid`, a daemon) nor what was started
//! with an empty environment.
//!
//! While stages run, this process is the one that takes over children whose parent died (PR_SET_CHILD_SUBREAPER,
//! prctl(2)). So what is left of a stage, once its own process has ended, is among this process's children, and it stays
//! there, with its number, until it was killed and waited for. Which stage it is of is told by its group, its folder, its
//! open files and its environment. A program that hides all of these is known by when it began: it is of no stage that
//! began later, and where only one stage is left that it can be of, it is of that one. Whoever has children of its own
//! beside stages must not have these guessed at: see [`claim_all_children`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, Once, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, getpid, kill_process, waitid};

use super::processes::{Process, given_children};

/// How long the end of what was killed is waited for: a process that hangs in the system does not die.
const PATIENCE: Duration = Duration::from_secs(5);

/// How often those that have ended are looked after while their stage goes on.
const PAUSE: Duration = Duration::from_millis(200);

static CLAIMED: AtomicBool = AtomicBool::new(false);
static RUNNING: Mutex<Running> = Mutex::new(Running { stages: BTreeMap::new(), swept: None });

#[derive(Debug)]
struct Running {
    /// The folder of each stage, by the number of its own process.
    stages: BTreeMap<i32, PathBuf>,
    swept: Option<Instant>,
}

/// Says that every child that this process is given is of a stage, also one of which nothing else can be told.
pub fn claim_all_children() {
    CLAIMED.store(true, Ordering::Relaxed);
}

/// From now on what loses its parent is given to this process.
pub(super) fn take_orphans() {
    static ONCE: Once = Once::new();
    // Where the system has no such thing, the group is all that can be killed.
    ONCE.call_once(|| {
        let _ = rustix::process::set_child_subreaper(Some(getpid()));
    });
}

/// A stage whose descendants are looked for; until this is dropped.
#[derive(Debug)]
pub(super) struct Followed {
    pid: i32,
}

impl Followed {
    /// Follows the stage whose own process is `pid`, and that works in `folder`, which is named without links in its path.
    pub fn new(pid: Pid, folder: &Path) -> Self {
        let pid = pid.as_raw_nonzero().get();
        lock().stages.insert(pid, folder.to_owned());
        Self { pid }
    }

    /// Takes note of those that have ended while the stage goes on, so that they do not pile up. Cheap enough to be called
    /// often.
    pub fn tidy(&self) {
        let mut running = lock();
        if running.swept.is_some_and(|swept| swept.elapsed() < PAUSE) {
            return;
        }
        running.swept = Some(Instant::now());
        for orphan in orphans(&running).into_iter().filter(|orphan| orphan.is_zombie) {
            if CLAIMED.load(Ordering::Relaxed) || running.stages.contains_key(&orphan.group) {
                has_ended(orphan.pid);
            }
        }
    }

    /// Kills all that is left of the stage, whose own process has ended but was not waited for, and waits until it is gone.
    /// True where something was left.
    pub fn end_all(&self) -> bool {
        let mut found = false;
        let began = Instant::now();
        loop {
            let left = self.left();
            if left.is_empty() || began.elapsed() > PATIENCE {
                return found;
            }
            for orphan in left {
                found |= !orphan.is_zombie;
                if let Some(pid) = Pid::from_raw(orphan.pid) {
                    let _ = kill_process(pid, Signal::KILL);
                }
                while !has_ended(orphan.pid) && began.elapsed() <= PATIENCE {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        }
    }

    /// The orphans that are of this stage.
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

/// The children that this process was given: neither a stage's own process, nor one of this process's group, where those
/// that it started for itself are.
fn orphans(running: &Running) -> Vec<Process> {
    let given = given_children(getpid()).into_iter().filter(|pid| !running.stages.contains_key(pid));
    given.filter_map(Process::of).filter(|process| !is_warden(process)).collect()
}

/// The warden was started by us, too.
fn is_warden(process: &Process) -> bool {
    super::warden::pid() == Some(process.pid)
}

/// True where a child has ended; it is waited for then, and its number is free.
fn has_ended(pid: i32) -> bool {
    let Some(pid) = Pid::from_raw(pid) else { return true };
    // An error says that it is no child any more.
    !matches!(waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOHANG), Ok(None))
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use std::os::unix::process::CommandExt;
    use std::process::{Child, Command};

    use super::*;

    /// A stage of this shell text, whose own process has ended.
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
    fn what_left_the_group_of_its_stage_is_killed_with_it() {
        for text in [
            "setsid sh -c 'echo $$ > pid; exec sleep 300' & while [ ! -s pid ]; do sleep 0.01; done",
            // Its environment is empty, its folder another one; its output is a file of the stage.
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
    fn what_another_stage_started_is_left_alone() {
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
