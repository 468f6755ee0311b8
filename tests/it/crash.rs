//! Kills: whatever dies and whenever, nothing half is ever taken for a result, and the next run ends as if nothing had
//! happened.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

use dril_pipe::fsx::Lock;
use dril_pipe::plan::{Verdict, key_of_record};
use dril_pipe::store::{Digest, Record};
use serde_json::json;

use crate::lab::{Lab, files_below};
use crate::scenario::StageLine;

/// A chain with a fan-in, of stages that keep checkpoints. The file from outside is `data.txt`.
fn pipeline(step_millis: u64) -> Vec<StageLine> {
    let count =
        |name: &str, to: u64| StageLine::new(name, "count", json!({"to": to, "step_millis": step_millis}));
    vec![
        StageLine::new("a", "emit", json!({"text": "start\n"})),
        count("b", 4).reads("start", &["a"]),
        count("c", 6),
        StageLine::new("d", "concat", json!({})).reads("parts", &["b", "c"]).reads_file("parts", "data.txt"),
        count("e", 3),
    ]
}

fn lab() -> Lab {
    let lab = Lab::new();
    lab.file("data.txt", "from outside");
    lab
}

/// Digests by stage, of a run that nobody disturbed.
fn undisturbed(stages: &[StageLine]) -> BTreeMap<String, Vec<Digest>> {
    digests(&lab(), stages)
}

/// Runs to the end and gives the digests by stage.
fn digests(lab: &Lab, stages: &[StageLine]) -> BTreeMap<String, Vec<Digest>> {
    let ran = lab.run(stages);
    assert!(ran.executed.outcome.is_complete(), "{}", ran.error());
    let of = |name: &str| ran.outputs(name).values().map(|stored| stored.digest).collect();
    stages.iter().map(|stage| (stage.name.clone(), of(&stage.name))).collect()
}

/// Every blob has the content of its name, and every record belongs to its key and has all its blobs. Looks at nothing
/// else: the stages of a killed engine may still be dying.
fn check_store(lab: &Lab) {
    let root = lab.store.root();
    for (path, bytes) in contents(&root.join("blobs-v1")) {
        assert_eq!(path.replace('/', ""), Digest::of(&bytes).hex(), "a blob is not its name");
    }
    for (path, bytes) in contents(&root.join("records-v1")) {
        let record: Record = serde_json::from_slice(&bytes).unwrap_or_else(|error| panic!("{path}: {error}"));
        assert_eq!(
            lab.store.record_path(&key_of_record(&record).unwrap()),
            root.join("records-v1").join(&path)
        );
        assert_eq!(lab.store.lost(&record.outputs).unwrap(), None, "{path}");
    }
}

fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let files = if folder.exists() { files_below(folder) } else { Vec::new() };
    let read = |path: String| (path.clone(), std::fs::read(folder.join(path)).unwrap());
    files.into_iter().map(read).collect()
}

/// Keys of the stages that began and of those that came to their end, from the trace.
fn traced(lab: &Lab, event: &str) -> Vec<String> {
    let prefix = format!("{event} ");
    let lines = lab.trace().into_iter().filter(|line| line.starts_with(&prefix));
    lines.map(|line| line.split(' ').nth(2).unwrap().to_owned()).collect()
}

/// Processes of this lab that are still alive: those that the trace names, and those that were started for it and have
/// not come to trace anything.
fn alive(lab: &Lab) -> Vec<i32> {
    let traced = lab.trace();
    let traced = traced.iter().filter_map(|line| line.split(' ').nth(3)?.parse().ok());
    let folder = lab.folder.path().to_str().unwrap().as_bytes().to_vec();
    let listed = std::fs::read_dir("/proc").unwrap().filter_map(|entry| {
        let process: i32 = entry.ok()?.file_name().to_str()?.parse().ok()?;
        let command = std::fs::read(format!("/proc/{process}/cmdline")).ok()?;
        command.windows(folder.len()).any(|part| part == folder).then_some(process)
    });
    let mut processes: Vec<i32> = traced.chain(listed).collect();
    processes.sort_unstable();
    processes.dedup();
    processes.retain(|process| {
        let state = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        // A zombie writes no more; nobody is left here who would collect it.
        state.rsplit(')').next().is_some_and(|rest| !rest.is_empty() && !rest.trim_start().starts_with('Z'))
    });
    processes
}

fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !happened() {
        assert!(Instant::now() < deadline, "waited too long until {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn kill(mut engine: Child) {
    engine.kill().unwrap();
    engine.wait().unwrap();
}

#[test]
fn killed_at_any_step_that_touches_the_disk_the_store_stays_sound_and_the_next_run_ends_the_same() {
    let stages = [
        StageLine::new("a", "emit", json!({"text": "start\n"})),
        StageLine::new("b", "count", json!({"to": 2})).reads("start", &["a"]),
        StageLine::new("c", "concat", json!({})).reads("parts", &["b"]).reads_file("parts", "data.txt"),
    ];
    let expected = undisturbed(&stages);
    let mut steps = 0;
    for nth in 1.. {
        let lab = lab();
        let status = lab.engine(&stages, 2).env("DRIL_FAKES_CRASH_AT", nth.to_string()).status().unwrap();
        check_store(&lab);
        assert_eq!(digests(&lab, &stages), expected, "killed at step {nth}");
        check_store(&lab);
        if status.success() {
            break;
        }
        assert_eq!(status.signal(), Some(9), "at step {nth}");
        steps = nth;
    }
    assert!(steps > 50, "only {steps} steps were tried");
}

#[test]
fn a_killed_engine_takes_its_stages_with_it() {
    let lab = lab();
    let stages = [
        StageLine::new("a", "count", json!({"to": 100_000, "step_millis": 5})),
        StageLine::new("b", "count", json!({"mishap": "hang"})),
        StageLine::new("c", "count", json!({"to": 100_000, "step_millis": 5, "mishap": "orphan"})),
    ];
    let engine = lab.engine(&stages, 3).spawn().unwrap();
    wait_until("all run", || {
        let trace = lab.trace();
        ["step ", "hang ", "left "].iter().all(|event| trace.iter().any(|line| line.starts_with(event)))
    });
    kill(engine);
    let killed = Instant::now();
    wait_until("the stages are gone", || alive(&lab).is_empty());
    let took = killed.elapsed();
    assert!(took < Duration::from_secs(1), "it took {took:?}");
    let after = lab.trace().len();
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(lab.trace().len(), after, "something still writes");
}

#[test]
fn after_kills_at_random_moments_finished_stages_are_not_repeated_and_the_result_is_the_same() {
    let stages = pipeline(4);
    let expected = undisturbed(&stages);
    let lab = lab();
    // No clock and no seed from outside: pauses that differ enough to hit different moments.
    for pause in [25, 60, 90, 40, 75] {
        let engine = lab.engine(&stages, 2).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(pause));
        kill(engine);
        check_store(&lab);
    }
    wait_until("the last engine's stages are gone", || alive(&lab).is_empty());
    let recorded_before = records(&lab);
    let begun_before = traced(&lab, "begin");
    assert!(lab.engine(&stages, 2).status().unwrap().success());
    let begun: Vec<String> = traced(&lab, "begin").split_off(begun_before.len());
    assert!(begun.iter().all(|key| !recorded_before.contains(key)), "a finished stage was repeated");
    assert_eq!(begun.len() + recorded_before.len(), stages.len());
    assert_eq!(digests(&lab, &stages), expected);
}

#[test]
fn a_stage_goes_on_from_its_checkpoint_after_a_kill() {
    let lab = lab();
    let stages = [StageLine::new("a", "count", json!({"to": 40, "step_millis": 5}))];
    let expected = undisturbed(&stages);
    for steps in [10, 25] {
        let engine = lab.engine(&stages, 1).spawn().unwrap();
        wait_until("it has counted", || traced(&lab, "step").len() >= steps);
        kill(engine);
        wait_until("it is gone", || alive(&lab).is_empty());
    }
    assert!(lab.engine(&stages, 1).status().unwrap().success());
    let steps = traced(&lab, "step").len();
    assert!(steps <= 42, "{steps} steps for a count to 40 with two kills");
    assert_eq!(digests(&lab, &stages), expected);
}

#[test]
fn a_new_engine_may_start_while_the_stages_of_a_killed_one_still_die() {
    let stages = pipeline(3);
    let expected = undisturbed(&stages);
    let lab = lab();
    for _ in 0..4 {
        let engine = lab.engine(&stages, 2).spawn().unwrap();
        let before = traced(&lab, "step").len();
        wait_until("a step or the end", || {
            traced(&lab, "step").len() > before || records(&lab).len() == stages.len()
        });
        kill(engine);
    }
    assert!(lab.engine(&stages, 2).status().unwrap().success());
    check_store(&lab);
    assert_eq!(digests(&lab, &stages), expected);
}

#[test]
fn a_stage_waits_until_the_one_that_held_its_checkpoints_before_is_dead() {
    let lab = lab();
    let stages = [StageLine::new("a", "count", json!({}))];
    let graph = crate::scenario::graph(&stages);
    let Some((_, Verdict::Run { key, .. })) = lab.plan(&graph).steps.pop() else { panic!("nothing to run") };
    let checkpoints = lab.store.checkpoints(&key);
    std::fs::create_dir_all(&checkpoints).unwrap();
    let dying = Lock::acquire(&checkpoints.join("lock")).unwrap();
    let inode = format!(":{} ", std::fs::metadata(dying.path()).unwrap().ino());
    let mut engine = lab.engine(&stages, 1).spawn().unwrap();
    wait_until("the stage waits", || {
        let locks = std::fs::read_to_string("/proc/locks").unwrap();
        locks.lines().any(|line| line.contains("->") && line.contains(&inode))
    });
    assert!(traced(&lab, "begin").is_empty());
    drop(dying);
    assert!(engine.wait().unwrap().success());
    assert_eq!(traced(&lab, "begin"), [key.hex()]);
}

/// Keys that have a record.
fn records(lab: &Lab) -> Vec<String> {
    let files = contents(&lab.store.root().join("records-v1"));
    files.iter().map(|(path, _)| path.trim_end_matches(".json").replace('/', "")).collect()
}
