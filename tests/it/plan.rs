//! What a plan says would run, and why.

use dril_pipe::plan::{self, Estimates, Forecast, Place, PlanError};
use dril_pipe::store::Key;
use serde_json::json;

use crate::lab::Lab;
use crate::scenario::{self, StageLine};

/// Two texts, each counted from, and both joined.
fn pipeline() -> Vec<StageLine> {
    vec![
        StageLine::new("north", "emit", json!({"text": "n"})),
        StageLine::new("south", "emit", json!({"text": "s"})),
        StageLine::new("count", "count", json!({"to": 2})).reads("start", &["north"]),
        StageLine::new("join", "concat", json!({})).reads("parts", &["count", "south"]),
    ]
}

#[test]
fn in_an_empty_store_everything_is_new_and_nothing_is_written() {
    let lab = Lab::new();
    assert_eq!(
        lab.verdicts(&pipeline()),
        ["north: run [new]", "south: run [new]", "count: after north [new]", "join: after north south [new]"]
    );
    assert!(!lab.store.root().exists());
}

#[test]
fn after_a_run_everything_is_cached() {
    let lab = Lab::new();
    lab.run(&pipeline());
    assert_eq!(
        lab.verdicts(&pipeline()),
        ["north: cached", "south: cached", "count: cached", "join: cached"]
    );
}

#[test]
fn a_changed_parameter_is_named_with_its_old_and_new_value() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[2].with = json!({"to": 5, "mishap": "no-output"});
    assert_eq!(
        lab.verdicts(&stages),
        [
            "north: cached",
            "south: cached",
            r#"count: run [mishap: "none" -> "no-output", to: 2 -> 5]"#,
            "join: after count []"
        ]
    );
}

#[test]
fn a_parameter_that_came_or_went_is_named_with_one_value() {
    let lab = Lab::new();
    let stage = |keep| {
        vec![
            StageLine::new("a", "emit", json!({"text": "x"})),
            StageLine::new("b", "concat", json!({"keep": keep})).reads("parts", &["a"]),
        ]
    };
    lab.run(&stage(json!(null)));
    assert_eq!(lab.verdicts(&stage(json!(3)))[1], "b: run [keep: null -> 3]");
}

#[test]
fn a_changed_seed_is_named() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[2].seed = 9;
    assert_eq!(lab.verdicts(&stages)[2], "count: run [seed Some(1) -> Some(9)]");
    stages[0].seed = 9;
    assert_eq!(lab.verdicts(&stages)[0], "north: cached", "an unseeded kind has no seed in its key");
}

#[test]
fn another_kind_under_the_same_name_is_named() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[1] = StageLine::new("south", "count", json!({}));
    assert_eq!(lab.verdicts(&stages)[1], "south: run [kind emit -> count]");
}

#[test]
fn a_rewired_input_is_named_with_where_it_comes_from_now() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[2].inputs.clear();
    stages[2] = stages[2].clone().reads("start", &["south"]);
    assert_eq!(lab.verdicts(&stages)[2], "count: run [start from south.text]");
    stages[2].inputs.clear();
    assert_eq!(lab.verdicts(&stages)[2], "count: run [start from north.text]", "what went is named too");
}

#[test]
fn one_more_artifact_in_a_fan_in_is_named_alone() {
    let lab = Lab::new();
    let stages = |count: usize| {
        let names: Vec<String> = (0..count).map(|number| format!("e{number}")).collect();
        let mut stages: Vec<StageLine> =
            names.iter().map(|name| StageLine::new(name, "emit", json!({"text": name}))).collect();
        // The new one comes first, so that every other one has another position.
        let parts: Vec<&str> = names.iter().rev().map(String::as_str).collect();
        stages.push(StageLine::new("join", "concat", json!({})).reads("parts", &parts));
        stages
    };
    lab.run(&stages(3));
    let mut later = stages(4);
    lab.run(&later[3..4]);
    assert_eq!(lab.verdicts(&later)[4], "join: run [parts from e3.text]");
    later[4].inputs.clear();
    later[4] = later[4].clone().reads("parts", &["e0", "e1", "e2"]);
    assert_eq!(lab.verdicts(&later)[4], "join: run [parts from the order or number of its 3 artifacts]");
}

#[test]
fn a_changed_file_from_outside_is_named() {
    let lab = Lab::new();
    lab.file("data.txt", "one");
    let stages = [StageLine::new("join", "concat", json!({})).reads_file("parts", "data.txt")];
    lab.run(&stages);
    assert_eq!(lab.verdicts(&stages), ["join: cached"]);
    lab.file("data.txt", "two");
    assert_eq!(lab.verdicts(&stages), ["join: run [parts from file data.txt]"]);
    lab.file("data.txt", "one");
    assert_eq!(lab.verdicts(&stages), ["join: cached"]);
}

#[test]
fn missing_and_wrong_files_are_all_reported_with_their_place() {
    let lab = Lab::new();
    std::fs::create_dir(lab.folder.path().join("folder")).unwrap();
    let stages = [StageLine::new("join", "concat", json!({}))
        .reads_file("parts", "missing.txt")
        .reads_file("parts", "folder")];
    let graph = scenario::graph(&stages);
    let error = plan::plan(&graph, &lab.store, lab.folder.path()).unwrap_err();
    assert!(matches!(&error, PlanError::Files(files) if files.len() == 2));
    let text = error.to_string();
    assert!(text.starts_with("scenario:1:1: cannot read `"), "{text}");
    assert!(text.contains("missing.txt") && text.ends_with("it is a folder, expected a file"), "{text}");
}

#[test]
fn explanations_compare_with_the_latest_run_not_the_first() {
    let lab = Lab::new();
    let stages = |to: u64| [StageLine::new("a", "count", json!({"to": to}))];
    for to in [1, 2, 1] {
        lab.run(&stages(to));
    }
    assert_eq!(lab.verdicts(&stages(3)), ["a: run [to: 1 -> 3]"]);
}

#[test]
fn a_stage_behind_several_that_run_names_each_of_them_once() {
    let lab = Lab::new();
    let mut stages = vec![];
    for name in ["a", "b"] {
        stages.push(StageLine::new(name, "emit", json!({"text": name})));
    }
    for name in ["c", "d"] {
        stages.push(StageLine::new(name, "concat", json!({"separator": name})).reads("parts", &["a", "b"]));
    }
    stages.push(StageLine::new("e", "concat", json!({})).reads("parts", &["d", "c", "a"]));
    assert_eq!(lab.verdicts(&stages)[4], "e: after a b [new]");
}

#[test]
fn known_differences_are_reported_before_the_inputs_are_known() {
    let lab = Lab::new();
    lab.run(&pipeline());
    let mut stages = pipeline();
    stages[0].with = json!({"text": "other"});
    stages[2].with = json!({"to": 7});
    assert_eq!(lab.verdicts(&stages)[2], "count: after north [to: 2 -> 7]");
}

#[test]
fn a_revised_kind_is_named_as_the_reason() {
    let lab = Lab::new();
    lab.run(&pipeline()[..1]);
    let history = lab.store.root().join("history-v1/scenario-default.jsonl");
    let line = std::fs::read_to_string(&history).unwrap();
    let key: Key =
        serde_json::from_str::<serde_json::Value>(&line).unwrap()["key"].as_str().unwrap().parse().unwrap();
    // What a program with an earlier revision of the kind would have left.
    let mut record = lab.store.record(&key).unwrap().unwrap();
    std::fs::remove_file(lab.store.record_path(&key)).unwrap();
    record.revision = 0;
    let old = plan::key_of_record(&record).unwrap();
    let path = lab.store.record_path(&old);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, serde_json::to_vec(&record).unwrap()).unwrap();
    std::fs::write(&history, line.replace(&key.hex(), &old.hex())).unwrap();
    assert_eq!(lab.verdicts(&pipeline())[0], "north: run [revision 0 -> 1]");
}

#[test]
fn the_forecast_for_a_cluster_counts_jobs_and_finds_the_longest_chain() {
    let lab = Lab::new();
    let stages = |to: u64| {
        vec![
            StageLine::new("long", "count", json!({"to": to, "cost": to, "step_millis": 20})),
            StageLine::new("short", "count", json!({"to": 1, "cost": to, "mishap": "chatter", "at": 9})),
            StageLine::new("join", "concat", json!({"cost": to})).reads("parts", &["long", "short"]),
        ]
    };
    lab.run(&stages(3));
    let graph = scenario::graph(&stages(30));
    let plan = lab.plan(&graph);
    let estimates = Estimates::of(&plan, &lab.store).unwrap();
    let long = plan.steps[0].0;
    // Half of what the long stage takes, so that it takes three jobs.
    let limit = estimates.stage(long).unwrap().mul_f64(0.4);
    let forecast = Forecast::of(&plan, &estimates, 64, |stage| match &*stage.name {
        "join" => Place::Beside,
        "long" => Place::Job(Some(limit)),
        _ => Place::Job(None),
    });
    assert_eq!((forecast.jobs, forecast.beside, forecast.stale, forecast.unknown), (4, 1, 3, 0));
    let chain: Vec<&str> = forecast.critical.iter().map(|stage| &*graph.stages[*stage].name).collect();
    assert_eq!(chain, ["long", "join"]);
    let threads: Vec<usize> = forecast.times.iter().map(|(threads, _)| *threads).collect();
    assert_eq!(threads, [1, 8, 32, 64]);
    let times: Vec<_> = forecast.times.iter().map(|(_, time)| *time).collect();
    // One thread takes all stages one after the other, many as long as the chain.
    assert!(times[0] > times[1] && times[1] == times[3], "{times:?}");
    assert!(times[3].abs_diff(forecast.shortest).as_millis() < 1, "{times:?} {:?}", forecast.shortest);
    let others = estimates.stage(plan.steps[1].0).unwrap();
    assert!(times[0].abs_diff(forecast.shortest + others).as_millis() < 1, "{times:?} {others:?}");
}

#[test]
fn a_forecast_says_how_much_it_does_not_know() {
    let lab = Lab::new();
    let graph = scenario::graph(&pipeline());
    let plan = lab.plan(&graph);
    let estimates = Estimates::of(&plan, &lab.store).unwrap();
    let forecast = Forecast::of(&plan, &estimates, 8, |_| Place::Job(None));
    assert_eq!((forecast.jobs, forecast.unknown, forecast.stale), (4, 4, 4));
    assert_eq!(forecast.shortest, std::time::Duration::ZERO);
}
