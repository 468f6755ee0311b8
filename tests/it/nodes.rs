//! What goes wrong on a node of a cluster becomes an error in words that names the node. The jobs are real processes, whose store may
//! be a file system that is full, or read-only to them.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use dril_pipe::cluster::{ClusterRunner, JobId, Pace, Scheduler, Seen, Site, State, Submission, SubmitError};
use dril_pipe::exec::Options;
use dril_pipe::settings::ClusterSettings;
use dril_pipe::store::{Key, Sweep};
use serde_json::{Value, json};

use crate::lab::{Lab, fakes_program};
use crate::scenario::StageLine;

/// Runs jobs at once, as processes of this machine.
struct AtOnce {
    jobs: Mutex<BTreeMap<JobId, Child>>,
    /// What runs the script `$1`.
    shell: &'static str,
    /// Changes the hand-off before the job begins.
    tamper: fn(&mut Value),
}

impl AtOnce {
    fn new(shell: &'static str, tamper: fn(&mut Value)) -> Self {
        Self { jobs: Mutex::default(), shell, tamper }
    }

    fn seen(job: &mut Child) -> Seen {
        let state = match job.try_wait().unwrap() {
            None => State::Running,
            Some(status) if status.success() => State::Over("COMPLETED".to_owned()),
            Some(_) => State::Over("FAILED".to_owned()),
        };
        Seen { state, node: "n7".to_owned() }
    }
}

impl Scheduler for AtOnce {
    fn name(&self) -> &str {
        "Slurm"
    }

    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError> {
        let path = submission.folder.join("handoff.json");
        let mut handoff: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        (self.tamper)(&mut handoff);
        std::fs::write(&path, handoff.to_string()).unwrap();
        let output = std::fs::File::create(submission.folder.join("job.out")).unwrap();
        let mut jobs = self.jobs.lock().unwrap();
        let job = (jobs.len() + 1).to_string();
        let mut command = Command::new("bash");
        command.args(["-c", self.shell, "bash"]).arg(&submission.script).env("SLURM_JOB_ID", &job);
        command.stdin(Stdio::null()).stdout(output.try_clone().unwrap()).stderr(output);
        jobs.insert(job.clone(), command.spawn().unwrap());
        Ok(job)
    }

    fn list(&self) -> Result<BTreeMap<JobId, Seen>, String> {
        Ok(self
            .jobs
            .lock()
            .unwrap()
            .iter_mut()
            .map(|(job, child)| (job.clone(), Self::seen(child)))
            .collect())
    }

    fn look(&self, job: &JobId) -> Result<Option<Seen>, String> {
        Ok(self.jobs.lock().unwrap().get_mut(job).map(Self::seen))
    }

    fn find(&self, _: &str) -> Result<Option<JobId>, String> {
        Ok(None)
    }

    fn stop(&self, _: &[JobId]) -> Result<(), String> {
        Ok(())
    }

    fn cancel(&self, _: &[JobId]) -> Result<(), String> {
        Ok(())
    }
}

/// The name that a node finds out about itself.
fn node() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// The error of a stage that writes `times` texts of 1 KB.
fn error(lab: &Lab, scheduler: AtOnce, times: u32) -> String {
    let pace = Pace {
        look: Duration::from_millis(20),
        ask: Duration::from_millis(100),
        settle: Duration::from_millis(200),
    };
    let site = Site { pace, program: fakes_program(), ..Site::new(lab.store.root()).unwrap() };
    let settings = ClusterSettings { local: Some(Vec::new()), ..ClusterSettings::default() };
    let runner = ClusterRunner::new(Arc::new(scheduler), settings, site).unwrap();
    let stages = [StageLine::new("a", "emit", json!({ "text": "x".repeat(1024), "times": times }))];
    let ran = lab.run_with(&stages, &runner, &Options::default(), &AtomicBool::new(false));
    ran.error()
}

const PLAIN: &str = "exec bash \"$1\"";

#[test]
fn another_version_or_build_of_a_program_on_a_node_is_named() {
    assert_eq!(error(&Lab::new(), AtOnce::new(PLAIN, |_| {}), 1), "");
    let version = |handoff: &mut Value| handoff["tool"] = json!("9.9.9");
    let text = error(&Lab::new(), AtOnce::new(PLAIN, version), 1);
    let expected = format!(
        "on node `{}` (Slurm job 1): `dril-pipe` is {} on this node",
        node(),
        env!("CARGO_PKG_VERSION")
    );
    assert!(text.starts_with(&expected) && text.contains("9.9.9 where the run was started"), "{text}");

    let build = |handoff: &mut Value| handoff["build"]["fakes"] = json!("0123");
    let text = error(&Lab::new(), AtOnce::new(PLAIN, build), 1);
    assert!(text.contains(&node()) && text.contains("not the build of `fakes`"), "{text}");
}

/// Mounts a file system of 2 MB; false where that is not allowed.
fn mount_small(at: &Path) -> bool {
    std::fs::create_dir_all(at).unwrap();
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=2m", "tmpfs"]).arg(at).output();
    let mounted = mount.is_ok_and(|output| output.status.success());
    if !mounted {
        eprintln!("skipped: file systems cannot be mounted here");
    }
    mounted
}

#[test]
fn a_disk_that_a_stage_filled_on_its_node_is_named_with_the_node() {
    let lab = Lab::new();
    // The folder of the jobs alone: the engine can still write what it notes of the run.
    let small = lab.store.root().join("slurm-v1");
    if !mount_small(&small) {
        return;
    }
    let text = error(&lab, AtOnce::new(PLAIN, |_| {}), 4096);
    let unmounted = Command::new("umount").arg("--lazy").arg(&small).status().unwrap();
    assert!(unmounted.success());
    assert!(text.starts_with(&format!("on node `{}` (Slurm job 1): ", node())), "{text}");
    assert!(text.contains("No space left on device"), "{text}");
}

#[test]
fn a_store_that_a_node_cannot_write_to_is_named_with_the_node() {
    let lab = Lab::new();
    // In a mount namespace of its own the job sees the store read-only.
    const READ_ONLY: &str = "store=$(dirname \"$(dirname \"$(dirname \"$1\")\")\"); export store; \
        exec unshare --mount bash -c 'mount --bind \"$store\" \"$store\" && mount -o remount,ro,bind \"$store\" && \
        exec bash \"$1\"' bash \"$1\"";
    let may_unshare = Command::new("unshare").args(["--mount", "true"]).output();
    if !may_unshare.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: there are no mount namespaces here");
        return;
    }
    let text = error(&lab, AtOnce::new(READ_ONLY, |_| {}), 1);
    assert!(text.contains("ended on node `n7` without a result (FAILED)"), "{text}");
    assert!(text.contains(&format!("on node `{}`: every node must be able to write", node())), "{text}");
    assert!(text.contains("Read-only file system"), "{text}");
}

#[test]
fn gc_removes_the_folders_of_jobs_that_nobody_takes_over() {
    let lab = Lab::new();
    lab.run(&[StageLine::new("a", "emit", json!({ "text": "a" }))]);
    let (done, _) = lab.store.records().unwrap().remove(0);
    let other = Key::new([7; 32]);
    let jobs = lab.store.root().join("slurm-v1");
    let make = |key: &Key| {
        std::fs::create_dir_all(jobs.join(key.hex())).unwrap();
        std::fs::write(jobs.join(key.hex()).join("handoff.json"), "{}").unwrap();
        std::fs::create_dir_all(jobs.join("ended")).unwrap();
        std::fs::write(jobs.join("ended").join(key.hex()), "").unwrap();
    };
    let left = || -> Vec<bool> { [&done, &other].map(|key| jobs.join(key.hex()).exists()).into() };
    make(&done);
    make(&other);
    // An engine that waits for the job.
    let lock = lab.store.try_lock(&done).unwrap().unwrap();
    assert_eq!((lab.store.sweep(&Sweep::default()).unwrap().jobs, left()), (0, vec![true, true]));
    drop(lock);
    let look = Sweep { dry_run: true, ..Sweep::default() };
    assert_eq!((lab.store.sweep(&look).unwrap().jobs, left()), (1, vec![true, true]));
    // A new run would take over what the other one made.
    assert_eq!((lab.store.sweep(&Sweep::default()).unwrap().jobs, left()), (1, vec![false, true]));
    let old = Sweep { older_than: Some(Duration::ZERO), ..Sweep::default() };
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!((lab.store.sweep(&old).unwrap().jobs, left()), (1, vec![false, false]));
    assert_eq!(std::fs::read_dir(jobs.join("ended")).unwrap().count(), 0);
}
