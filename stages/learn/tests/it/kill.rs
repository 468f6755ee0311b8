//! What a long training has done survives a kill: the four algorithms are killed at random moments, ten times each, and
//! end with the same bytes as if nobody had.
//!
//! The stage runs in a child process, this program running one job; SIGKILL gives it no chance to save.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use dril_stage_api::testing::Bench;
use dril_stage_api::{Ctx, Job, Registry, Seed};
use rand::RngExt;

use crate::worlds::{self, World, digests};

/// Names the job file to the child.
pub const JOB: &str = "DRIL_KILL_TEST_JOB";
const KILLS: usize = 10;

/// Not a test: what the child runs.
#[test]
#[ignore = "the child of the tests below"]
fn run_the_job_that_the_parent_names() {
    let Some(path) = std::env::var_os(JOB) else { return };
    let job: Job = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let registry = Registry::new(dril_learn::KINDS).unwrap();
    let kind = registry.get(&job.kind).unwrap();
    kind.run(&job.params, &mut Ctx::new(&job, &AtomicBool::new(false), &mut std::io::stderr())).unwrap();
}

fn start(job: &Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "kill::run_the_job_that_the_parent_names", "--ignored", "--nocapture"])
        .env(JOB, job)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until the child says how far it is for the first time, or ends: one that has only an update left says nothing.
/// Gives the rest of what it says.
fn wait_for_progress(child: &mut Child) -> impl BufRead + use<> {
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("\"progress\"") {
        line.clear();
        if said.read_line(&mut line).unwrap() == 0 {
            break;
        }
    }
    said
}

/// Runs the job undisturbed; gives its outputs, and how long it took from its first word on.
fn undisturbed(bench: &Bench) -> (Vec<blake3::Hash>, Duration) {
    let job = write_job(bench);
    let mut child = start(&job);
    let mut said = wait_for_progress(&mut child);
    let began = Instant::now();
    std::io::copy(&mut said, &mut std::io::sink()).unwrap();
    assert!(child.wait().unwrap().success());
    (digests(bench), began.elapsed())
}

pub fn write_job(bench: &Bench) -> std::path::PathBuf {
    let path = bench.folder().join("job.json");
    std::fs::write(&path, serde_json::to_vec(bench.job()).unwrap()).unwrap();
    path
}

/// Kills the stage again and again, then lets it end.
fn survives(make: impl Fn() -> Bench, seed: u64) {
    // Often, but not all the time.
    let make = || make().checkpoint_seconds(0.05);
    let (whole, took) = undisturbed(&make());
    let bench = make();
    let job = write_job(&bench);
    let mut moments = Seed(seed).stream("kill");
    let mut killed = 0;
    for _ in 0..KILLS {
        let mut child = start(&job);
        let _said = wait_for_progress(&mut child);
        std::thread::sleep(took.mul_f64(moments.random_range(0.0..0.15)));
        child.kill().unwrap();
        killed += usize::from(!child.wait().unwrap().success());
    }
    assert!(killed >= KILLS / 2, "only {killed} of {KILLS} were killed before their end");
    assert!(bench.folder().join("checkpoints/state").is_file(), "something was saved");
    assert!(start(&job).wait_with_output().unwrap().status.success());
    assert_eq!(digests(&bench), whole);
}

#[test]
fn ppo_killed_at_random_moments_ends_with_the_same_bytes() {
    survives(|| worlds::ppo(4), 1);
}

#[test]
fn behaviour_cloning_killed_at_random_moments_ends_with_the_same_bytes() {
    survives(|| worlds::bc(2000), 2);
}

#[test]
fn an_ensemble_killed_at_random_moments_ends_with_the_same_bytes() {
    survives(|| worlds::ensemble(400), 3);
}

#[test]
fn dril_killed_at_random_moments_ends_with_the_same_bytes() {
    let made = World::make();
    survives(|| made.dril(4), 4);
}
