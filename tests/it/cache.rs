//! What runs again and what does not; and what becomes of a store that somebody damaged.

use dril_pipe::exec::Event;
use dril_pipe::plan::key_of_record;
use dril_pipe::store::{Digest, Record};
use serde_json::json;

use crate::lab::{Lab, Ran};
use crate::scenario::StageLine;

fn pipeline() -> Vec<StageLine> {
    vec![
        StageLine::new("a", "emit", json!({"text": "abc"})),
        StageLine::new("b", "concat", json!({"keep": 2})).reads("parts", &["a"]),
        StageLine::new("c", "count", json!({"to": 2})),
        StageLine::new("d", "concat", json!({})).reads("parts", &["b", "c"]),
    ]
}

#[test]
fn the_second_run_runs_nothing_and_leaves_no_trace() {
    let lab = Lab::new();
    let first = lab.run(&pipeline());
    assert_eq!(first.counts(), [4, 0, 0, 0, 0]);
    assert_eq!(first.text(&lab, "d", "joined"), format!("ab\n{}", first.text(&lab, "c", "count")));
    let before = files(&lab);
    let second = lab.run(&pipeline());
    assert_eq!(second.counts(), [0, 4, 0, 0, 0]);
    assert_eq!(second.executed.folder, None);
    assert_eq!(second.executed.outputs, first.executed.outputs);
    assert_eq!(files(&lab), before);
}

#[test]
fn a_run_leaves_nothing_but_results_records_and_its_own_folder() {
    let lab = Lab::new();
    // The private folder goes with what the run gives back.
    let folder = lab.run(&pipeline()).executed.folder.unwrap();
    let folders = ["blobs-v1", "records-v1", "history-v1", "runs-v1"];
    let stray: Vec<String> = files(&lab)
        .into_iter()
        .filter(|path| {
            path != "tmp/gate" && path != "gc.lock" && !folders.iter().any(|folder| path.starts_with(folder))
        })
        .collect();
    assert_eq!(stray, [""; 0]);
    let events = std::fs::read_to_string(folder.join("events.jsonl")).unwrap();
    assert_eq!(events.lines().filter(|line| line.contains(r#""event":"finished""#)).count(), 4);
    assert!(events.lines().last().unwrap().contains(r#""event":"run-finished""#));
}

#[test]
fn only_the_changed_cone_runs() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[2].with = json!({"to": 3});
    let ran = lab.run(&stages);
    assert_eq!(ran.started(), ["c", "d"]);
    assert_eq!(ran.counts(), [2, 2, 0, 0, 0]);
}

#[test]
fn a_stage_that_ran_again_with_the_same_result_stops_the_wave() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[0].with = json!({"text": "abX"});
    let ran = lab.run(&stages);
    assert_eq!(ran.started(), ["a", "b"], "`b` keeps two letters, so `d` has the same input as before");
    stages[0].with = json!({"text": "abX", "cost": 7.0});
    assert_eq!(lab.run(&stages).started(), ["a"]);
}

#[test]
fn going_back_to_an_earlier_value_runs_nothing() {
    let lab = Lab::new();
    let first = lab.run(&pipeline());
    let mut stages = pipeline();
    stages[2].with = json!({"to": 9});
    lab.run(&stages);
    let back = lab.run(&pipeline());
    assert_eq!(back.counts(), [0, 4, 0, 0, 0]);
    assert_eq!(back.executed.outputs, first.executed.outputs);
}

#[test]
fn a_renamed_stage_runs_nothing() {
    let lab = Lab::new();
    let stages = |name: &str| {
        [
            StageLine::new(name, "emit", json!({"text": "x"})),
            StageLine::new("j", "count", json!({})).reads("start", &[name]),
        ]
    };
    lab.run(&stages("old"));
    assert_eq!(lab.run(&stages("new")).counts(), [0, 2, 0, 0, 0]);
}

#[test]
fn the_label_of_a_fan_in_is_part_of_the_key() {
    let lab = Lab::new();
    let stages = |name: &str| {
        [
            StageLine::new(name, "emit", json!({"text": "x"})),
            StageLine::new("j", "concat", json!({"labels": true})).reads("parts", &[name]),
        ]
    };
    lab.run(&stages("old"));
    let ran = lab.run(&stages("new"));
    assert_eq!(ran.started(), ["j"]);
    assert_eq!(ran.text(&lab, "j", "joined"), "[name=new] x");
}

#[test]
fn two_stages_with_one_key_run_once() {
    let lab = Lab::new();
    let stages = [
        StageLine::new("one", "count", json!({"to": 3})),
        StageLine::new("two", "count", json!({"to": 3})),
        StageLine::new("join", "concat", json!({})).reads("parts", &["one", "two"]),
    ];
    let ran = lab.run_children(&stages, &dril_pipe::exec::Options { threads: 2, ..Default::default() });
    assert_eq!(ran.started(), ["one", "join"]);
    assert_eq!(ran.counts(), [2, 1, 0, 0, 0]);
    assert_eq!(ran.outputs("one"), ran.outputs("two"));
}

#[test]
fn a_lost_blob_is_made_again_and_nothing_behind_it_runs() {
    let lab = Lab::new();
    let first = lab.run(&pipeline());
    std::fs::remove_file(blob(&lab, &first, "c", "log")).unwrap();
    assert_eq!(lab.verdicts(&pipeline())[2], "c: run [lost log]");
    let again = lab.run(&pipeline());
    assert_eq!(again.started(), ["c"]);
    assert_eq!(again.executed.outputs, first.executed.outputs);
}

#[test]
fn a_truncated_blob_is_noticed_and_rebuilt() {
    let lab = Lab::new();
    let first = lab.run(&pipeline());
    let path = blob(&lab, &first, "c", "count");
    let whole = std::fs::read(&path).unwrap();
    overwrite(&path, &whole[..whole.len() / 2]);
    assert_eq!(lab.verdicts(&pipeline())[2], "c: run [lost count]");
    lab.run(&pipeline());
    assert_eq!(std::fs::read(&path).unwrap(), whole);
}

#[test]
fn a_blob_of_the_right_length_but_wrong_content_is_replaced_when_it_is_rebuilt() {
    let lab = Lab::new();
    let first = lab.run(&pipeline());
    let path = blob(&lab, &first, "c", "count");
    let whole = std::fs::read(&path).unwrap();
    overwrite(&path, &vec![0; whole.len()]);
    std::fs::remove_file(blob(&lab, &first, "c", "log")).unwrap();
    assert_eq!(lab.run(&pipeline()).started(), ["c"]);
    assert_eq!(std::fs::read(&path).unwrap(), whole);
}

#[test]
fn a_damaged_record_is_reported_and_rebuilt() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let records = records(&lab);
    // Without the history, which repeats what the records say.
    std::fs::remove_dir_all(lab.store.root().join("history-v1")).unwrap();
    for (position, path) in records.iter().enumerate() {
        let text = std::fs::read_to_string(path).unwrap();
        let damaged = match position % 4 {
            0 => text[..text.len() / 2].to_owned(),
            1 => String::new(),
            2 => text.replace("\"version\":1", "\"version\":99"),
            _ => text.replace("\"revision\":1", "\"revision\":7"),
        };
        overwrite(path, damaged.as_bytes());
    }
    let verdicts = lab.verdicts(&pipeline());
    assert_eq!(verdicts[0], "a: run [damaged]");
    assert_eq!(verdicts[2], "c: run [damaged]");
    assert_eq!(lab.run(&pipeline()).counts(), [4, 0, 0, 0, 0]);
    assert_eq!(lab.run(&pipeline()).counts(), [0, 4, 0, 0, 0]);
}

#[test]
fn without_records_everything_runs_whatever_the_history_says() {
    let lab = Lab::new();
    lab.run(&pipeline());
    std::fs::remove_dir_all(lab.store.root().join("records-v1")).unwrap();
    assert_eq!(lab.run(&pipeline()).counts(), [4, 0, 0, 0, 0]);
}

#[test]
fn without_the_history_everything_is_still_cached() {
    let lab = Lab::new();
    lab.run(&pipeline());
    std::fs::remove_dir_all(lab.store.root().join("history-v1")).unwrap();
    assert_eq!(lab.run(&pipeline()).counts(), [0, 4, 0, 0, 0]);
}

#[test]
fn every_record_lies_under_the_key_of_what_it_says() {
    let lab = Lab::new();
    lab.file("data.txt", "outside");
    let mut stages = pipeline();
    stages[3] = stages[3].clone().reads_file("parts", "data.txt");
    lab.run(&stages);
    let records = records(&lab);
    assert_eq!(records.len(), 4);
    for path in records {
        let record: Record = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(lab.store.record_path(&key_of_record(&record).unwrap()), path);
    }
}

#[test]
fn a_file_that_changes_after_the_plan_does_not_enter_a_result() {
    let lab = Lab::new();
    lab.file("data.txt", "planned");
    let stages = [StageLine::new("j", "concat", json!({})).reads_file("parts", "data.txt")];
    let graph = crate::scenario::graph(&stages);
    let plan = lab.plan(&graph);
    lab.file("data.txt", "changed");
    let runner = dril_pipe::exec::InlineRunner { registry: crate::fakes::registry() };
    let mut errors = Vec::new();
    let executed = dril_pipe::exec::execute(
        plan,
        &lab.store,
        &runner,
        &Default::default(),
        &Default::default(),
        &mut |event| {
            if let Event::StageFailed { failure, .. } = event {
                errors.push(failure.to_string())
            }
        },
    );
    assert_eq!(executed.unwrap().outcome.failed, 1);
    assert!(errors[0].ends_with("data.txt` was changed after the run was planned; run again"), "{errors:?}");
}

#[test]
fn blobs_are_read_only_and_named_after_their_content() {
    let lab = Lab::new();
    let ran = lab.run(&pipeline());
    for outputs in ran.executed.outputs.iter().flatten() {
        for stored in outputs.values() {
            let path = lab.store.blob_path(&stored.digest);
            assert!(std::fs::metadata(&path).unwrap().permissions().readonly());
            let bytes = std::fs::read(&path).unwrap();
            assert_eq!((Digest::of(&bytes), bytes.len() as u64), (stored.digest, stored.bytes));
        }
    }
}

#[test]
fn eight_engines_on_one_store_run_every_stage_once() {
    let lab = Lab::new();
    let mut stages: Vec<StageLine> = (0..12)
        .map(|number| {
            StageLine::new(&format!("s{number}"), "count", json!({"to": 3 + number, "step_millis": 3}))
        })
        .collect();
    for number in 0..6 {
        let (name, first, second) = (format!("j{number}"), format!("s{number}"), format!("s{}", number + 6));
        stages.push(StageLine::new(&name, "concat", json!({})).reads("parts", &[&first, &second]));
    }
    let engines: Vec<_> = (0..8).map(|_| lab.engine(&stages, 2).spawn().unwrap()).collect();
    for mut engine in engines {
        assert!(engine.wait().unwrap().success());
    }
    let mut begun: Vec<String> = lab
        .trace()
        .iter()
        .filter(|line| line.starts_with("begin "))
        .map(|line| line.split(' ').nth(2).unwrap().to_owned())
        .collect();
    assert_eq!(begun.len(), stages.len());
    begun.sort();
    begun.dedup();
    assert_eq!(begun.len(), stages.len());
    assert_eq!(lab.run(&stages).counts(), [0, stages.len(), 0, 0, 0]);
}

fn blob(lab: &Lab, ran: &Ran, stage: &str, output: &str) -> std::path::PathBuf {
    lab.store.blob_path(&ran.outputs(stage)[output].digest)
}

/// Writes over a read-only file, as a fault would.
fn overwrite(path: &std::path::Path, bytes: &[u8]) {
    std::fs::remove_file(path).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn records(lab: &Lab) -> Vec<std::path::PathBuf> {
    let root = lab.store.root();
    files(lab).iter().filter(|path| path.starts_with("records-v1")).map(|path| root.join(path)).collect()
}

/// All files of the store, sorted, relative to its root.
fn files(lab: &Lab) -> Vec<String> {
    crate::lab::files_below(lab.store.root())
}
