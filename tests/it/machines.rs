//! Several machines on one store: processes that do not see each other's kernel locks, and have only what shared file systems give.
//! Stages are built by one at a time, and a process that is killed or suspended costs only time.

use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use dril_pipe::exec::{Exit, Failure, InlineRunner, Launch, Options, Runner};
use dril_pipe::plan::key_of_record;
use dril_pipe::store::{Digest, Record};
use dril_stage_api::Message;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;

use crate::lab::{Lab, fakes_program, files_below};
use crate::scenario::StageLine;

/// Until a lease without a sign of life is dead. Long enough for a machine that is busy with other tests.
const PATIENCE: Duration = Duration::from_millis(2_000);

/// Pairs of a slow stage with checkpoints and a quick one that reads it, and one that reads all.
fn pipeline(pairs: u64, step_millis: u64) -> Vec<StageLine> {
    let mut stages = Vec::new();
    for pair in 0..pairs {
        let with = json!({"to": 8 + pair % 3, "step_millis": step_millis});
        let mut slow = StageLine::new(&format!("slow{pair}"), "count", with);
        slow.seed = pair;
        stages.push(slow);
        let quick = StageLine::new(&format!("quick{pair}"), "concat", json!({}));
        stages.push(quick.reads("parts", &[&format!("slow{pair}")]));
    }
    let names: Vec<String> = (0..pairs).map(|pair| format!("quick{pair}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    stages.push(StageLine::new("all", "concat", json!({})).reads("parts", &names));
    stages
}

/// A store that several machines share.
struct Shared {
    lab: Lab,
    stages: Vec<StageLine>,
    expected: Digest,
}

impl Shared {
    fn new(stages: Vec<StageLine>) -> Self {
        let undisturbed = Lab::new().run_children(&stages, &Options::default());
        let expected = undisturbed.outputs("all")["joined"].digest;
        Self { lab: Lab::new(), stages, expected }
    }

    /// A process on a machine of that name; machines whose names begin with "bare" have no kernel locks at all.
    fn on(&self, machine: &str, mut command: Command) -> Command {
        let folder = self.lab.folder.path().join(machine);
        if !machine.starts_with("bare") {
            std::fs::create_dir_all(&folder).unwrap();
        }
        command.env("DRIL_FAKES_MACHINE", folder);
        command.env("DRIL_FAKES_PATIENCE", PATIENCE.as_millis().to_string());
        command
    }

    fn engine(&self, machine: &str) -> Child {
        let output = std::fs::File::options().append(true).create(true).open(self.output()).unwrap();
        self.on(machine, self.lab.engine(&self.stages, 2)).stdout(output).spawn().unwrap()
    }

    /// What the engines print.
    fn output(&self) -> PathBuf {
        self.lab.folder.path().join("output")
    }

    fn gc(&self, machine: &str) -> bool {
        let mut command = Command::new(fakes_program());
        command.args(["cache", "gc", "--older-than", "0s", "--cache"]).arg(self.lab.store.root());
        let output = self.on(machine, command).output().unwrap();
        output.status.success()
    }

    /// The store is sound, the result is the expected one, and each key was built by one process at a time.
    fn check(&self) {
        self.check_turns();
        self.check_result();
    }

    fn check_result(&self) {
        let root = self.lab.store.root();
        for path in files_below(&root.join("blobs-v1")) {
            let bytes = std::fs::read(root.join("blobs-v1").join(&path)).unwrap();
            assert_eq!(path.replace('/', ""), Digest::of(&bytes).hex(), "a blob is not its name");
        }
        for path in files_below(&root.join("records-v1")) {
            let bytes = std::fs::read(root.join("records-v1").join(&path)).unwrap();
            let record: Record = serde_json::from_slice(&bytes).unwrap();
            let key = key_of_record(&record).unwrap();
            assert_eq!(self.lab.store.record_path(&key), root.join("records-v1").join(&path));
            assert_eq!(self.lab.store.lost(&record.outputs).unwrap(), None, "{path}");
        }
        let ran = self.lab.run_children(&self.stages, &Options::default());
        assert!(ran.executed.outcome.is_complete(), "{}", ran.error());
        assert_eq!(ran.outputs("all")["joined"].digest, self.expected);
    }

    /// Once a second process has begun a stage, the first one does nothing more.
    fn check_turns(&self) {
        let mut turns = std::collections::BTreeMap::<String, Vec<String>>::new();
        for line in self.lab.trace() {
            let words: Vec<&str> = line.split(' ').collect();
            let [_, _, key, process] = words[..] else { continue };
            let turns = turns.entry(key.to_owned()).or_default();
            if turns.last().is_none_or(|last| last != process) {
                assert!(!turns.contains(&process.to_owned()), "two processes built {key} side by side");
                turns.push(process.to_owned());
            }
        }
    }

    fn begun(&self) -> usize {
        self.lab.trace().iter().filter(|line| line.starts_with("begin ")).count()
    }

    /// Stages with distinct keys.
    fn distinct(&self) -> usize {
        self.stages.len()
    }
}

/// A number that varies from test to test and from one call to the next.
fn random(below: u64) -> u64 {
    use std::hash::{BuildHasher, Hasher};
    std::collections::hash_map::RandomState::new().build_hasher().finish() % below
}

fn signal(process: u32, signal: Signal) {
    let _ = kill_process(Pid::from_raw(i32::try_from(process).unwrap()).unwrap(), signal);
}

fn wait_until(what: &str, mut happened: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while !happened() {
        assert!(Instant::now() < deadline, "waited too long until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The processes that run stages, by the trace.
fn stage_processes(shared: &Shared) -> Vec<u32> {
    let mut open = Vec::new();
    for line in shared.lab.trace() {
        let words: Vec<&str> = line.split(' ').collect();
        let process: u32 = words[3].parse().unwrap();
        match words[0] {
            "begin" => open.push(process),
            "end" => open.retain(|other| *other != process),
            _ => {}
        }
    }
    open
}

#[test]
fn engines_on_machines_that_do_not_see_each_others_locks_run_every_stage_once() {
    for machines in [["one", "one", "two", "three"], ["bare-one", "bare-one", "bare-two", "bare-three"]] {
        let shared = Shared::new(pipeline(6, 5));
        let engines: Vec<Child> = machines.map(|machine| shared.engine(machine)).into();
        for mut engine in engines {
            assert!(engine.wait().unwrap().success());
        }
        assert_eq!(shared.begun(), shared.distinct());
        shared.check();
    }
}

#[test]
fn engines_killed_at_random_moments_on_two_machines_end_with_the_same_results() {
    let shared = Shared::new(pipeline(4, 60));
    let mut kills = 0;
    let mut engines: [Option<Child>; 2] = [None, None];
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let mut complete = false;
        for (machine, engine) in ["one", "two"].iter().zip(&mut engines) {
            let running = engine.get_or_insert_with(|| shared.engine(machine));
            match running.try_wait().unwrap() {
                Some(status) => {
                    assert!(
                        status.success(),
                        "{status}: {}",
                        std::fs::read_to_string(shared.output()).unwrap()
                    );
                    complete = true;
                }
                None if random(2) == 0 && kills < 8 => {
                    running.kill().unwrap();
                    running.wait().unwrap();
                    kills += 1;
                    *engine = None;
                }
                None => {}
            }
        }
        if complete {
            break;
        }
        assert!(Instant::now() < deadline, "no end after {kills} kills");
        std::thread::sleep(Duration::from_millis(20 + random(200)));
    }
    for mut engine in engines.into_iter().flatten() {
        assert!(engine.wait().unwrap().success());
    }
    assert!(kills >= 4, "only {kills}");
    shared.check();
}

#[test]
fn a_stage_of_an_engine_that_stands_still_goes_on_and_nobody_builds_it_beside_it() {
    let shared = Shared::new(pipeline(1, 700));
    let mut stopped = shared.engine("one");
    wait_until("the stage runs", || shared.begun() > 0);
    signal(stopped.id(), Signal::STOP);
    // The stage takes longer than the engine's lease lives.
    let mut other = shared.engine("two");
    assert!(other.wait().unwrap().success());
    signal(stopped.id(), Signal::CONT);
    assert!(stopped.wait().unwrap().success(), "it uses what the other one made");
    shared.check();
}

#[test]
fn an_engine_that_stood_still_with_its_stages_gives_way_to_the_one_that_took_over() {
    let shared = Shared::new(pipeline(2, 300));
    let mut stopped = shared.engine("one");
    wait_until("both stages have a checkpoint", || {
        shared.lab.trace().iter().filter(|line| line.starts_with("step ")).count() > 3
    });
    signal(stopped.id(), Signal::STOP);
    let stages = stage_processes(&shared);
    stages.iter().for_each(|stage| signal(*stage, Signal::STOP));
    let mut other = shared.engine("two");
    wait_until("the other one has taken over", || stage_processes(&shared).len() > stages.len());
    stages.iter().for_each(|stage| signal(*stage, Signal::CONT));
    signal(stopped.id(), Signal::CONT);
    assert!(other.wait().unwrap().success());
    assert!(stopped.wait().unwrap().success());
    // The first two processes were killed as soon as they noticed, or ended without a result.
    shared.check_result();
}

#[test]
fn gc_on_another_machine_takes_nothing_from_runs_and_removes_what_dead_ones_left() {
    let shared = Shared::new(pipeline(5, 20));
    let mut engines: Vec<Option<Child>> = vec![Some(shared.engine("one")), Some(shared.engine("two"))];
    let mut sweeps = 0;
    while engines.iter().any(Option::is_some) {
        assert!(shared.gc("three"));
        sweeps += 1;
        for engine in &mut engines {
            if let Some(status) = engine.as_mut().and_then(|engine| engine.try_wait().unwrap()) {
                assert!(status.success(), "{status}: {}", std::fs::read_to_string(shared.output()).unwrap());
                *engine = None;
            }
        }
    }
    assert!(sweeps > 2, "only {sweeps}");
    shared.check_result();

    // Everything is to be built again.
    assert!(shared.gc("three"));
    let before = shared.begun();
    let mut killed = shared.engine("one");
    wait_until("a stage runs", || shared.begun() > before);
    killed.kill().unwrap();
    killed.wait().unwrap();
    let tmp: PathBuf = shared.lab.store.root().join("tmp");
    std::thread::sleep(PATIENCE + Duration::from_millis(100));
    assert!(shared.gc("three"));
    let mut left = files_below(&tmp);
    left.retain(|file| file != "gate");
    assert_eq!(left, [""; 0]);
    assert_eq!(files_below(&shared.lab.store.root().join("locks-v1")), [""; 0]);
}

/// Runs stages, and finds that somebody else has stored a record meanwhile.
struct TooLate<'a> {
    inline: InlineRunner,
    shared: &'a Lab,
    record: &'a Record,
}

impl Runner for TooLate<'_> {
    fn check(&self, worker: Option<&'static str>) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        self.inline.check(worker)
    }

    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        let exit = self.inline.run(launch, on_message)?;
        let path = self.shared.store.record_path(&key_of_record(self.record).unwrap());
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, serde_json::to_vec(self.record).unwrap()).unwrap();
        Ok(exit)
    }
}

#[test]
fn of_two_records_of_one_key_the_first_stays_and_a_difference_is_an_error() {
    let stages = [StageLine::new("a", "emit", json!({"text": "start\n"}))];
    let first = Lab::new();
    first.run(&stages);
    let (key, same) = first.store.records().unwrap().remove(0);
    let mut other = same.clone();
    other.outputs.get_mut("text").unwrap().digest = Digest::of(b"something else");
    for (record, expected) in [(same, ""), (other, "output `text`")] {
        let lab = Lab::new();
        let inline = InlineRunner { registry: crate::fakes::registry() };
        let runner = TooLate { inline, shared: &lab, record: &record };
        let ran = lab.run_with(&stages, &runner, &Options::default(), &AtomicBool::new(false));
        assert!(ran.error().contains(expected), "{}", ran.error());
        assert_eq!(ran.executed.outcome.is_complete(), expected.is_empty());
        assert_eq!(lab.store.record(&key).unwrap().unwrap().outputs, record.outputs);
    }
}
