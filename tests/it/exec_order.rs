//! In which order stages run, how many at once, and what becomes of a run when a stage fails or the user stops it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dril_pipe::exec::{self, ChildRunner, Event, ExecError, Exit, Failure, Launch, Options, Runner};
use dril_stage_api::Message;
use serde_json::json;

use crate::lab::{Lab, Ran, fakes_program};
use crate::scenario::{self, StageLine};

fn emit(name: &str, cost: f64) -> StageLine {
    StageLine::new(name, "emit", json!({"text": name, "cost": cost}))
}

fn concat(name: &str, cost: f64, parts: &[&str]) -> StageLine {
    StageLine::new(name, "concat", json!({"separator": name, "cost": cost})).reads("parts", parts)
}

fn count(name: &str, with: serde_json::Value) -> StageLine {
    StageLine::new(name, "count", with)
}

fn options(threads: usize) -> Options {
    Options { threads, checkpoint_seconds: 0.0, ..Options::default() }
}

/// For each stage, in the order in which they began, how many others were at work when it began. From the trace: an event
/// tells the end of a stage only when its result is safe on the disk, and others start before that.
fn company(lab: &Lab, ran: &Ran) -> Vec<(String, usize)> {
    let names: BTreeMap<String, String> = ran
        .events
        .iter()
        .filter_map(|event| match event {
            Event::StageStarted { stage, key, .. } => {
                Some((key.hex(), ran.graph.stages[*stage].name.to_string()))
            }
            _ => None,
        })
        .collect();
    let mut working = BTreeSet::new();
    let mut found = Vec::new();
    for line in lab.trace() {
        let mut words = line.split(' ');
        match (words.next(), words.nth(1)) {
            (Some("begin"), Some(key)) => {
                found.push((names[key].clone(), working.len()));
                working.insert(key.to_owned());
            }
            (Some("end"), Some(key)) => drop(working.remove(key)),
            _ => {}
        }
    }
    found
}

#[test]
fn the_longest_chain_of_work_starts_first() {
    let lab = Lab::new();
    let stages = [
        emit("short", 1.0),
        emit("head", 1.0),
        emit("middle", 3.0),
        concat("body", 10.0, &["head"]),
        concat("tail", 5.0, &["body"]),
        concat("end", 1.0, &["tail", "middle", "short"]),
    ];
    assert_eq!(lab.run(&stages).started(), ["head", "body", "tail", "middle", "short", "end"]);
}

#[test]
fn stages_of_equal_cost_start_in_the_order_of_the_file() {
    let lab = Lab::new();
    let names = ["e", "d", "c", "b", "a"];
    let stages: Vec<StageLine> = names.iter().map(|name| emit(name, 2.0)).collect();
    assert_eq!(lab.run(&stages).started(), names);
}

#[test]
fn as_many_stages_run_at_once_as_there_are_threads() {
    let lab = Lab::new();
    let stages: Vec<StageLine> = (0..6)
        .map(|number| count(&format!("s{number}"), json!({"to": 3 + number, "step_millis": 5, "meet": 3})))
        .collect();
    let ran = lab.run_children(&stages, &options(3));
    assert_eq!(ran.counts(), [6, 0, 0, 0, 0]);
    assert_eq!(company(&lab, &ran).iter().map(|(_, others)| *others).max(), Some(2));
}

#[test]
fn a_stage_counts_with_the_threads_it_needs_and_one_that_needs_too_many_runs_alone() {
    let lab = Lab::new();
    let stage = |name: &str, threads: usize, cost: f64| {
        count(name, json!({"step_millis": 5, "meet": 2, "threads": threads, "cost": cost}))
    };
    let stages = [stage("two", 2, 9.0), stage("one", 1, 8.0), stage("nine", 9, 7.0), stage("last", 1, 6.0)];
    let ran = lab.run_children(&stages, &options(3));
    assert_eq!(ran.started()[..2], ["two", "one"]);
    let company: BTreeMap<String, usize> = company(&lab, &ran).into_iter().collect();
    assert!(company["two"] + company["one"] == 1, "both fit at once: {company:?}");
    assert_eq!(company["nine"], 0);
}

#[test]
fn a_stage_that_finds_no_room_keeps_no_thread_idle() {
    let wide = || count("wide", json!({"to": 1, "threads": 2, "cost": 50.0}));
    let lab = Lab::new();
    let stages = [
        count("long", json!({"to": 30, "step_millis": 10, "cost": 100.0})),
        wide(),
        count("small", json!({"to": 2, "cost": 1.0})),
    ];
    assert_eq!(lab.run_children(&stages, &options(2)).started(), ["long", "small", "wide"]);
}

#[test]
fn a_stage_that_needs_many_threads_is_not_kept_waiting_by_ever_more_small_ones() {
    // The costs are lies: the small ones take as long as the one that is said to take a hundred times as long.
    let small = |at: usize| count(&format!("small{at}"), json!({"to": 4, "step_millis": 10, "cost": 1.0}));
    let first = [
        count("long", json!({"to": 6, "step_millis": 10, "cost": 100.0})),
        count("wide", json!({"to": 1, "threads": 2, "cost": 50.0})),
    ];
    let lab = Lab::new();
    let stages: Vec<StageLine> = first.into_iter().chain((0..12).map(small)).collect();
    let ran = lab.run_children(&stages, &options(2));
    let started = ran.started();
    let at = started.iter().position(|name| name == "wide").unwrap();
    assert!((1..=4).contains(&at), "the long one, and those that began while it ran: {started:?}");
}

#[test]
fn the_thread_count_changes_no_result() {
    let stages = [
        count("a", json!({"to": 4})),
        count("b", json!({"to": 5})),
        emit("c", 1.0),
        concat("d", 1.0, &["a", "b", "c"]),
        concat("e", 1.0, &["c", "b"]),
    ];
    let outputs =
        [1, 2, 5].map(|threads| Lab::new().run_children(&stages, &options(threads)).executed.outputs);
    assert!(outputs[0].iter().all(Option::is_some));
    assert_eq!(outputs[0], outputs[1]);
    assert_eq!(outputs[0], outputs[2]);
}

#[test]
fn after_a_failure_independent_stages_go_on_and_dependent_ones_are_skipped() {
    let lab = Lab::new();
    let stages = [
        count("bad", json!({"mishap": "fail", "at": 1, "cost": 50.0})),
        emit("good", 1.0),
        concat("behind", 1.0, &["bad", "good"]),
        concat("far", 1.0, &["behind"]),
        concat("beside", 1.0, &["good"]),
    ];
    let ran = lab.run_children(&stages, &options(1));
    assert_eq!(ran.counts(), [2, 0, 1, 2, 0]);
    assert_eq!(ran.error(), "fails as configured at 1");
    let skipped = ran.names(|event| match event {
        Event::Skipped { stage, because } => {
            assert_eq!(*because, dril_pipe::resolve::StageIndex::new(0));
            Some(*stage)
        }
        _ => None,
    });
    assert_eq!(skipped, ["behind", "far"]);
    assert!(!ran.executed.outcome.is_complete());
}

#[test]
fn without_keep_going_nothing_starts_after_a_failure() {
    let lab = Lab::new();
    let stages = [count("bad", json!({"mishap": "fail", "cost": 50.0})), emit("good", 1.0)];
    let ran = lab.run_children(&stages, &Options { keep_going: false, ..options(1) });
    assert_eq!(ran.counts(), [0, 0, 1, 1, 0]);
    assert_eq!(ran.started(), ["bad"]);
}

#[test]
fn every_way_to_fail_has_its_own_error() {
    for (mishap, expected) in [
        ("fail", "fails as configured at 1"),
        ("panic", "it panicked: panics as configured at 1; see the log"),
        ("crash", "it was killed by SIGABRT"),
        ("exit", "it ended with exit code 9 and reported no error"),
        ("no-output", "output `count` was not written"),
        ("folder", "output `count` is a folder, expected a file"),
        ("link", "output `count` is a link or not a regular file, expected a file"),
    ] {
        let lab = Lab::new();
        let ran = lab.run_children(&[count("bad", json!({"mishap": mishap, "at": 1}))], &options(1));
        assert!(ran.error().starts_with(expected), "{mishap}: {}", ran.error());
        assert_eq!(ran.counts(), [0, 0, 1, 0, 0], "{mishap}");
        // Nothing of it is taken for done.
        assert!(!lab.store.root().join("records-v1").exists(), "{mishap}");
    }
}

#[test]
fn a_failed_stage_shows_the_end_of_its_log_and_where_the_rest_is() {
    let lab = Lab::new();
    let ran = lab.run_children(&[count("bad", json!({"mishap": "panic", "at": 1}))], &options(1));
    let Some(Event::StageFailed { log_tail, log, .. }) =
        ran.events.iter().find(|event| matches!(event, Event::StageFailed { .. }))
    else {
        panic!("nothing failed")
    };
    let text = std::fs::read_to_string(log).unwrap();
    assert!(text.contains("panics as configured at 1"));
    assert!(
        !log_tail.is_empty() && text.trim_end().ends_with(log_tail.join("\n").trim_end()),
        "{log_tail:?}"
    );
}

#[test]
fn progress_is_heard_and_other_output_goes_to_the_log() {
    let lab = Lab::new();
    let ran = lab.run_children(&[count("loud", json!({"mishap": "chatter", "at": 1, "to": 3}))], &options(1));
    assert_eq!(ran.counts(), [1, 0, 0, 0, 0]);
    let last = ran.events.iter().rev().find_map(|event| match event {
        Event::Progressed { progress, .. } => Some((progress.step, progress.total, progress.note.as_str())),
        _ => None,
    });
    assert_eq!(last, Some((3, 3, "at 3")));
    let logs = ran.executed.folder.unwrap().join("logs");
    let log = std::fs::read_dir(logs).unwrap().next().unwrap().unwrap().path();
    let text = std::fs::read_to_string(log).unwrap();
    assert_eq!(text.lines().count(), 20_000);
    assert!(text.lines().enumerate().all(|(number, line)| line == format!("chatter {number}")));
}

#[test]
fn what_a_stage_leaves_running_ends_with_it() {
    let lab = Lab::new();
    let ran = lab.run_children(
        &[count("a", json!({"mishap": "orphan", "at": 1, "to": 8, "step_millis": 20}))],
        &options(1),
    );
    assert_eq!(ran.counts(), [1, 0, 0, 0, 0]);
    assert!(lab.trace().iter().any(|line| line.starts_with("left ")), "the orphan never ran");
    let after = lab.trace().len();
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(lab.trace().len(), after, "the orphan still writes");
}

#[test]
fn a_stopped_run_goes_on_from_the_checkpoints_to_the_same_result() {
    let stages = [count("a", json!({"to": 60, "step_millis": 10})), concat("b", 1.0, &["a"])];
    let undisturbed = Lab::new().run_children(&stages, &options(1));
    let (lab, stop) = (Lab::new(), AtomicBool::new(false));
    let stopped = lab.run_watched(&stages, &lab.children(), &options(1), &stop, &mut |event| {
        if matches!(event, Event::Progressed { .. }) {
            stop.store(true, Ordering::Relaxed);
        }
    });
    assert_eq!(stopped.counts(), [0, 0, 0, 0, 2]);
    let order: Vec<&str> = stopped
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Stopping { .. } => Some("stopping"),
            Event::Stopped { .. } => Some("stopped"),
            Event::Finished { .. } => Some("finished"),
            _ => None,
        })
        .collect();
    assert_eq!(order, ["stopping", "stopped", "finished"]);
    let again = lab.run_children(&stages, &options(1));
    assert_eq!(again.counts(), [2, 0, 0, 0, 0]);
    assert_eq!(again.executed.outputs, undisturbed.executed.outputs);
    let steps = lab.trace().iter().filter(|line| line.starts_with("step ")).count();
    assert!(steps <= 61, "{steps} steps for a count to 60 that was stopped once");
    assert!(
        !lab.store.root().join("checkpoints-v1").read_dir().unwrap().any(|_| true),
        "checkpoints are left"
    );
}

#[test]
fn a_stage_that_does_not_listen_is_killed_after_its_time() {
    let (lab, stop) = (Lab::new(), AtomicBool::new(false));
    let stages = [count("deaf", json!({"mishap": "hang", "at": 1}))];
    let grace = Duration::from_millis(50);
    let ran =
        lab.run_watched(&stages, &lab.children(), &Options { grace, ..options(1) }, &stop, &mut |event| {
            if matches!(event, Event::Progressed { .. }) {
                stop.store(true, Ordering::Relaxed);
            }
        });
    assert_eq!(ran.counts(), [0, 0, 0, 0, 1]);
    let after = lab.trace().len();
    std::thread::sleep(Duration::from_millis(150));
    assert_eq!(lab.trace().len(), after, "the stage still runs");
}

#[test]
fn a_missing_worker_is_reported_before_anything_runs() {
    let lab = Lab::new();
    let stages = [emit("first", 1.0), StageLine::new("second", "elsewhere", json!({"text": "x"}))];
    let graph = scenario::graph(&stages);
    let runner = ChildRunner::new(fakes_program(), ["__stage".into()]);
    let mut events = Vec::new();
    let error = exec::execute(
        lab.plan(&graph),
        &lab.store,
        &runner,
        &options(1),
        &AtomicBool::new(false),
        &mut |event| events.push(event.clone()),
    );
    let Err(ExecError::Worker { kind: "elsewhere", source }) = error else { panic!("{error:?}") };
    let message = source.to_string();
    assert!(message.contains("dril-pipe-nowhere` does not exist"), "{message}");
    assert!(events.is_empty() && !lab.store.root().exists());
}

#[test]
fn a_program_that_cannot_start_fails_its_stages_with_the_reason() {
    let lab = Lab::new();
    let runner = ChildRunner::new("/dev/null", []);
    let ran = lab.run_with(&[emit("a", 1.0)], &runner, &options(1), &AtomicBool::new(false));
    assert!(ran.error().starts_with("cannot start `/dev/null`: "), "{}", ran.error());
}

/// A runner with a fault of its own.
struct Broken;

impl Runner for Broken {
    fn run(&self, _: &Launch<'_>, _: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        panic!("a fault in the runner")
    }
}

#[test]
fn a_fault_in_a_runner_fails_the_stage_and_not_the_run() {
    let lab = Lab::new();
    let ran = lab.run_with(&[emit("a", 1.0), emit("b", 1.0)], &Broken, &options(2), &AtomicBool::new(false));
    assert_eq!(ran.counts(), [0, 0, 2, 0, 0]);
}

#[test]
fn a_store_that_cannot_be_written_ends_the_run_with_an_error() {
    let lab = Lab::new();
    std::fs::create_dir_all(lab.store.root()).unwrap();
    std::fs::write(lab.store.root().join("runs-v1"), b"a file where a folder belongs").unwrap();
    let graph = scenario::graph(&[emit("a", 1.0)]);
    let error = exec::execute(
        lab.plan(&graph),
        &lab.store,
        &lab.children(),
        &options(1),
        &AtomicBool::new(false),
        &mut |_| {},
    );
    assert!(error.unwrap_err().to_string().starts_with("cannot create the folder `"));
}
