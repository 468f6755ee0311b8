//! Ends of a run other than "done": its time is over, results are not the locked ones, a stage is not deterministic.

use serde_json::{Value, json};

use crate::cli::WORDS;
use crate::sealed::{Sealed, lines};

#[test]
fn when_its_time_is_over_a_run_saves_its_state_and_says_what_is_left() {
    let undisturbed = Sealed::with(WORDS);
    undisturbed.run_ok("run p.yaml --set count.to=60");
    let sealed = Sealed::with(WORDS);
    let slow = "run p.yaml --jobs 3 --set count.to=60 --set count.step_millis=40";
    let ended = sealed.run(&format!("{slow} --for 1s"));
    assert_eq!(ended.code, 6, "{ended:?}");
    assert!(ended.stdout.contains("time is up"), "{}", ended.stdout);
    assert!(ended.stdout.contains("\n  left: count × 3, gather"), "{}", ended.stdout);
    let events = lines(&sealed.run(&format!("{slow} --json")).stdout);
    let first = events.iter().find(|event| event["event"] == "progress").unwrap();
    assert!(first["step"].as_u64().unwrap() > 1, "it went on from its checkpoint: {first}");
    assert_eq!(sealed.read("results/words-full/gather.md"), undisturbed.read("results/words-full/gather.md"));
    let done = sealed.run(&format!("{slow} --for 1h"));
    assert_eq!(done.code, 0, "{done:?}");
}

#[test]
fn what_is_left_is_in_the_json_too() {
    let sealed = Sealed::with(WORDS);
    let ended = sealed.run("run p.yaml --json --for 0.3s --set count.mishap=hang");
    let last = lines(&ended.stdout).pop().unwrap();
    assert_eq!(last["exit_code"], 6, "{last}");
    assert!(last["left"]["stages"].as_array().unwrap().contains(&json!("gather")), "{last}");
}

#[test]
fn a_lock_file_has_one_sorted_line_a_stage_and_runs_of_the_same_file_keep_it() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    assert!(!sealed.path("p.lock").exists(), "nobody asked for one");
    let said = sealed.run_ok("run p.yaml --lock");
    assert!(said.contains("\nlock file: p.lock (8 lines changed)\n"), "{said}");
    let text = sealed.read("p.lock");
    let stages: Vec<&str> = text.lines().skip(1).map(|line| line.split('\t').nth(1).unwrap()).collect();
    assert_eq!(stages.len(), 8);
    assert!(stages.is_sorted());
    sealed.run_ok("run p.yaml --profile quick");
    let both = sealed.read("p.lock");
    assert_eq!(both.lines().count(), 17, "each profile has its lines");
    assert!(both.contains(text.lines().nth(1).unwrap()));
    sealed.run_ok("run p.yaml --set count.to=5");
    assert_eq!(sealed.read("p.lock"), both, "an experiment with --set is not locked");
    let said = sealed.run_ok("run p.yaml");
    assert!(!said.contains("lock file"), "{said}");
    sealed.run_ok("run p.yaml --locked");
    assert_eq!(sealed.read("p.lock"), both);
    sealed
        .write("p.yaml", &WORDS.replace("  apart:", "  other: { kind: emit, with: { text: x } }\n  apart:"));
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("\nlock file: p.lock (1 line changed)\n"), "{said}");
}

#[test]
fn locked_fails_before_anything_runs_where_a_key_differs() {
    let sealed = Sealed::with(WORDS);
    let ended = sealed.run("run p.yaml --locked");
    assert_eq!(ended.code, 5, "{ended:?}");
    assert!(ended.stderr.contains("there is no lock file `p.lock`"), "{}", ended.stderr);
    sealed.run_ok("run p.yaml --lock");
    let ended = sealed.run("run p.yaml --locked --profile quick");
    assert_eq!(ended.code, 5, "{ended:?}");
    let expected = "it has no lines of profile `quick`, only those of `full`";
    assert!(ended.stderr.contains(expected) && !ended.stderr.contains("is not in"), "{}", ended.stderr);
    let ended = sealed.run("run p.yaml --locked --set count.to=5");
    assert_eq!(ended.code, 5, "{ended:?}");
    assert!(ended.stderr.contains("`count[word=one]` has key "), "{}", ended.stderr);
    assert!(!ended.stdout.contains("ran"), "{}", ended.stdout);
    sealed
        .write("p.yaml", &WORDS.replace("  apart:", "  other: { kind: emit, with: { text: x } }\n  apart:"));
    let ended = sealed.run("run p.yaml --locked");
    assert!(ended.stderr.contains("`other` is not in the lock file"), "{}", ended.stderr);
}

#[test]
fn locked_fails_after_the_run_where_a_result_differs() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml --lock");
    let text = sealed.read("p.lock");
    let line = text.lines().find(|line| line.contains("\tapart\t")).unwrap();
    let (before, digest) = line.rsplit_once('=').unwrap();
    let forged = text.replace(line, &format!("{before}={}", digest.chars().rev().collect::<String>()));
    sealed.write("p.lock", &forged);
    let ended = sealed.run("run p.yaml --locked");
    assert_eq!(ended.code, 5, "{ended:?}");
    assert!(ended.stderr.contains("output `text` of `apart` is "), "{}", ended.stderr);
}

#[test]
fn a_stage_that_is_not_deterministic_is_named_with_its_output() {
    let sealed = Sealed::with(WORDS);
    let said = sealed.run_ok("run p.yaml --check-determinism");
    assert!(said.contains("deterministic: 8 stages produced the same bytes twice\n"), "{said}");
    let runs: Value = serde_json::from_str(&sealed.run_ok("runs --json")).unwrap();
    assert_eq!(runs.as_array().unwrap().len(), 1, "a check that holds leaves nothing");
    // A result that somebody forged stands for a stage that came out otherwise the first time.
    let shown: Value = serde_json::from_str(&sealed.run_ok("show p.yaml apart --json")).unwrap();
    let path = shown[0]["outputs"][0]["path"].as_str().unwrap().to_owned();
    std::fs::remove_file(&path).unwrap();
    std::fs::write(&path, "apaXt").unwrap();
    let ended = sealed.run("run p.yaml --check-determinism");
    assert_eq!(ended.code, 0, "the name of the content is what is compared: {ended:?}");
    let forged = dril_pipe::store::Digest::of(b"apaXt");
    let digest = shown[0]["outputs"][0]["digest"].as_str().unwrap();
    sealed.write(&format!("cache/blobs-v1/{}/{}", &forged.hex()[..2], &forged.hex()[2..]), "apaXt");
    let key = shown[0]["key"].as_str().unwrap();
    let record = format!("cache/records-v1/{}/{}.json", &key[..2], &key[2..]);
    sealed.write(&record, &sealed.read(&record).replace(digest, &forged.hex()));
    std::fs::remove_dir_all(sealed.path("cache/history-v1")).unwrap();
    let ended = sealed.run("run p.yaml --check-determinism");
    assert_eq!(ended.code, 5, "{ended:?}");
    let expected =
        "error: stage `apart` produced a different output `text`: the first difference is at byte 3";
    assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    assert!(
        ended.stdout.contains("not deterministic: 1 of 8 stages; the first is `apart`"),
        "{}",
        ended.stdout
    );
}

/// Two stages that each wait, whenever they run, until the other one runs.
fn waiting(more: &str) -> Sealed {
    let sealed = Sealed::new();
    let list = sealed.path("list").display().to_string();
    let stage = |own: &str, other: &str| {
        format!(
            "  {own}:
    kind: command
{more}    with:
      shell: |
        echo {own} $$CUDA_VISIBLE_DEVICES >> {list}
        own=$$(grep -c ^{own} {list})
        for i in $$(seq 100); do test $$(grep -c ^{other} {list}) -ge $$own && break; sleep 0.05; done
        test $$(grep -c ^{other} {list}) -ge $$own
        echo x > {{outputs.t}}
      outputs: {{ t: t }}
"
        )
    };
    sealed.write("p.yaml", &format!("name: p\nstages:\n{}{}", stage("one", "two"), stage("two", "one")));
    sealed
}

#[test]
fn a_check_runs_stages_side_by_side_with_units_of_their_own() {
    let sealed = waiting("    resources: { gpu: 1 }\n");
    let args = ["run", "p.yaml", "-j2", "--resources", "gpu=2", "--check-determinism"];
    let ended = crate::programs::run(&sealed, &args);
    assert!(ended.code == 0 && ended.stdout.contains("2 stages produced the same bytes twice"), "{ended:?}");
    let list = sealed.read("list");
    let mut units: Vec<&str> = list.lines().skip(2).map(|line| &line[4..]).collect();
    units.sort_unstable();
    assert_eq!(units, ["0", "1"], "{list}");
}

#[test]
fn a_check_keeps_to_the_units_of_a_resource() {
    let sealed = Sealed::new();
    let alone = sealed.path("alone").display().to_string();
    let shell = |text: &str| format!("mkdir {alone}; sleep 0.3; rmdir {alone}; echo {text} > {{outputs.t}}");
    let stage = |name: &str| {
        format!(
            "  {name}: {{ kind: command, resources: {{ licence: 1 }}, with: {{ shell: '{}', outputs: {{ t: t }} }} }}\n",
            shell(name)
        )
    };
    sealed.write("p.yaml", &format!("name: p\nstages:\n{}{}{}", stage("a"), stage("b"), stage("c")));
    let ended = crate::programs::run(&sealed, &["run", "p.yaml", "-j3", "--check-determinism"]);
    assert!(ended.code == 0 && ended.stdout.contains("3 stages produced the same bytes twice"), "{ended:?}");
}

#[test]
fn a_check_of_two_stages_with_one_key_runs_each_in_a_folder_of_its_own() {
    let stage = |name: &str| {
        format!(
            "  {name}: {{ kind: command, with: {{ shell: 'sleep 0.5; echo x > {{outputs.t}}', outputs: {{ t: t }} }} }}\n"
        )
    };
    let sealed = Sealed::with(&format!("name: p\nstages:\n{}{}", stage("a"), stage("b")));
    let ended = crate::programs::run(&sealed, &["run", "p.yaml", "-j2", "--check-determinism"]);
    assert!(ended.code == 0 && ended.stdout.contains("2 stages produced the same bytes twice"), "{ended:?}");
}
