//! A run in which nothing changed does not read the pipeline again; a run in which anything did, does.

use crate::cli::WORDS;
use crate::sealed::{Sealed, ended};

const NOTHING: &str = "nothing to do: 0 stages executed, all 8 cached";

/// A pipeline whose second run finds the note of the first one.
fn noted() -> Sealed {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.list("cache/settled-v1").len(), 1);
    sealed
}

#[test]
fn the_short_way_says_what_the_long_way_says() {
    let sealed = noted();
    let short = sealed.normal(&sealed.run_ok("run p.yaml"));
    std::fs::remove_dir_all(sealed.path("cache/settled-v1")).unwrap();
    assert_eq!(sealed.normal(&sealed.run_ok("run p.yaml")), short);
    assert_eq!(sealed.run_ok("run p.yaml --quiet"), "");
}

#[test]
fn anything_that_makes_a_difference_is_noticed() {
    let sealed = noted();
    let long = |what: &str, args: &str, expected: &str| {
        let said = sealed.run_ok(args);
        assert!(said.contains(expected), "{what}: {said}");
    };
    long("an edit", "run p.yaml", NOTHING);
    sealed.write("p.yaml", &WORDS.replace("{ to: 2 }", "{ to: 3 }"));
    long("an edit", "run p.yaml", "done: 4 ran, 4 cached");
    long("another profile", "run p.yaml --profile quick", "done: 4 ran");
    long("--set", "run p.yaml --set apart.text=x", "done: 1 ran");
    long("an older note", "run p.yaml", NOTHING);
    std::fs::remove_dir_all(sealed.path("cache/records-v1")).unwrap();
    long("lost records", "run p.yaml", "done: 8 ran");
    let blobs = sealed.path("cache/blobs-v1");
    std::fs::remove_file(blobs.join(&crate::lab::files_below(&blobs)[0])).unwrap();
    let said = sealed.run_ok("run p.yaml");
    assert!(!said.contains(NOTHING) || said.contains("8 cached"), "a lost content: {said}");
    sealed.run_ok("cache verify");
    sealed.write("results/words-full/gather.md", "edited");
    sealed.run_ok("run p.yaml");
    assert_ne!(sealed.read("results/words-full/gather.md"), "edited", "an edited result comes back");
    std::fs::remove_dir_all(sealed.path("results")).unwrap();
    sealed.run_ok("run p.yaml");
    assert!(sealed.path("results/words-full/gather.md").is_file(), "a lost result comes back");
}

#[test]
fn a_file_from_outside_that_changed_is_noticed_whenever_it_changed() {
    let sealed =
        Sealed::with("name: x\nstages:\n  a: { kind: concat, inputs: { parts: { file: d.txt } } }\n");
    for text in ["one", "two", "one"] {
        sealed.write("d.txt", text);
        sealed.run_ok("run p.yaml");
        assert_eq!(sealed.read("results/x-default/a.md"), text);
        sealed.run_ok("run p.yaml");
        assert_eq!(sealed.read("results/x-default/a.md"), text);
    }
}

#[test]
fn a_variable_that_a_stage_sees_is_noticed_and_no_other() {
    let sealed = Sealed::with(
        "name: x\nstages:\n  a: { kind: command, with: { shell: 'echo $${SEEN-none} > {outputs.t}', env: [SEEN], outputs: { t: { type: table } } } }\n",
    );
    let run = |value: Option<&str>, other: &str| {
        let mut command = sealed.command("run p.yaml");
        command.env("OTHER", other).env_remove("SEEN");
        if let Some(value) = value {
            command.env("SEEN", value);
        }
        let said = ended(command).stdout;
        (said.contains("0 stages executed"), sealed.read("results/x-default/a.csv"))
    };
    for (value, other, nothing) in [
        (None, "a", false),
        (None, "b", true),
        (Some("1"), "b", false),
        (Some("1"), "c", true),
        (Some("2"), "c", false),
        (None, "c", true),
    ] {
        let expected = (nothing, format!("{}\n", value.unwrap_or("none")));
        assert_eq!(run(value, other), expected, "{value:?} {other}");
    }
    // The short way does not read what it knows: a history that cannot be read would end the long way.
    let history = sealed.path("cache/history-v1/x-default.jsonl");
    std::fs::remove_file(&history).unwrap();
    std::fs::create_dir(&history).unwrap();
    assert!(run(None, "d").0, "the other variable makes no difference");
}

#[test]
fn another_folder_takes_the_long_way() {
    let sealed = noted();
    std::fs::create_dir(sealed.path("below")).unwrap();
    let mut command = sealed.command("run ../p.yaml --cache ../cache");
    command.current_dir(sealed.path("below"));
    assert!(ended(command).stdout.contains(NOTHING));
    assert!(sealed.path("below/results/words-full/gather.md").is_file());
}

#[test]
fn an_unchanged_run_of_several_files_is_recognised_until_one_of_them_changes() {
    let stage = "name: x\nstages:\n  a: { kind: emit, with: { text: one } }\n";
    let sealed = Sealed::with("name: x\ninclude: parts/more.yaml\n");
    sealed.write("parts/more.yaml", "include: a.yaml\n");
    sealed.write("parts/a.yaml", stage);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.list("cache/settled-v1").len(), 1);
    let runs = || sealed.list("cache/runs-v1").len();
    let before = runs();
    // What the long way would stumble over, the short one does not see.
    let history = sealed.path("cache/history-v1");
    std::fs::remove_dir_all(&history).unwrap();
    assert!(sealed.run_ok("run p.yaml").contains("nothing to do: 0 stages executed, all 1 cached"));
    assert!(!history.join("x-default.jsonl").exists() && runs() == before);
    sealed.write("parts/a.yaml", &stage.replace("one", "two"));
    assert!(sealed.run_ok("run p.yaml").contains("done: 1 ran"));
}
