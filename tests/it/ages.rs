//! What `cache gc` takes for old: the last use counts, in whatever way something was used.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::cli::WORDS;
use crate::group::Group;
use crate::programs::run;
use crate::sealed::Sealed;

/// Sets the times of everything at a path, and below it, back by 40 days.
fn age(path: &Path) {
    let mut find = Command::new("find");
    find.arg(path).args(["-depth", "-exec", "touch", "-h", "-d", "40 days ago", "{}", "+"]);
    assert!(find.status().unwrap().success());
}

fn swept(sealed: &Sealed) -> Value {
    serde_json::from_str(&sealed.run_ok("cache gc --older-than 30d --json")).unwrap()
}

#[test]
fn a_checkpoint_that_is_overwritten_in_place_is_as_old_as_its_last_save() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  s: { kind: command, with: { shell: \"echo state > {checkpoints}/state; exit 1; : {outputs.o}\", outputs: { o: o } } }\n",
    );
    assert_eq!(run(&sealed, &["run", "p.yaml"]).code, 1);
    let checkpoint = format!("cache/checkpoints-v1/{}", sealed.list("cache/checkpoints-v1")[0]);
    age(&sealed.path("cache"));
    sealed.write(&format!("{checkpoint}/files/state"), "newer");
    assert_eq!(swept(&sealed)["checkpoints"], 0);
    assert_eq!(sealed.read(&format!("{checkpoint}/files/state")), "newer");
    age(&sealed.path("cache"));
    assert_eq!(swept(&sealed)["checkpoints"], 1);
}

#[test]
fn a_run_is_as_old_as_its_last_event() {
    let sealed = Sealed::new();
    let log = "cache/runs-v1/20200102-030405-000000000-1/logs/s.log";
    sealed.write(log, "a week-long run\n");
    assert_eq!(swept(&sealed)["runs"], 0);
    age(&sealed.path("cache"));
    assert_eq!(swept(&sealed)["runs"], 1);
}

#[test]
fn a_quarantined_file_is_as_old_as_its_quarantine() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let blob =
        sealed.path("cache/blobs-v1").join(&crate::lab::files_below(&sealed.path("cache/blobs-v1"))[0]);
    std::fs::remove_file(&blob).unwrap();
    std::fs::write(&blob, "damaged long ago").unwrap();
    age(&blob);
    sealed.run_ok("cache verify --repair");
    let kept = sealed.list("cache/quarantine-v1");
    assert!(!kept.is_empty());
    swept(&sealed);
    assert_eq!(sealed.list("cache/quarantine-v1"), kept);
    age(&sealed.path("cache/quarantine-v1"));
    swept(&sealed);
    assert!(sealed.list("cache/quarantine-v1").is_empty());
}

#[test]
fn results_that_a_run_with_nothing_to_do_found_are_in_use() {
    let sealed = Sealed::with(WORDS);
    for more in [" --set count.to=11", "", " --set count.to=9"] {
        sealed.run_ok(&format!("run p.yaml{more}"));
    }
    age(&sealed.path("cache"));
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"));
    let removed = swept(&sealed)["results"].as_array().unwrap().len();
    assert_eq!(removed, 4, "those of `count.to=11`");
    // What a `gc` removes does not make it forget what the rest was used for.
    assert_eq!(swept(&sealed)["results"], json!([]));
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"));
}

#[test]
fn what_another_user_of_a_shared_cache_uses_is_in_use() {
    let Some(group) = Group::with(WORDS) else { return };
    assert_eq!(group.run(1001, "002", "run p.yaml").code, 0);
    for way in ["as a whole plan", "as a run in which nothing changed"] {
        age(&group.cache());
        assert!(group.run(1002, "002", "run p.yaml").stdout.contains("0 stages executed"), "{way}");
        let swept: Value =
            serde_json::from_str(&group.run(1002, "002", "cache gc --older-than 30d --json").stdout).unwrap();
        assert_eq!(swept["results"], json!([]), "{way}");
    }
}
