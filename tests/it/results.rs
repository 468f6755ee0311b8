//! The results folder: what is copied there, what is taken away, and what is left alone.

use crate::sealed::Sealed;

const TWO: &str = "\
name: two
stages:
  a: { kind: emit, with: { text: \"a\" } }
  first: { kind: concat, inputs: { parts: a } }
  second: { kind: concat, with: { labels: true }, inputs: { parts: a } }
";
const ONE: &str = "\
name: two
stages:
  a: { kind: emit, with: { text: \"a\" } }
  first: { kind: concat, inputs: { parts: a } }
";
const FOLDER: &str = "results/two-default";

#[test]
fn a_table_that_nothing_makes_any_more_is_removed() {
    let sealed = Sealed::with(TWO);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.list(FOLDER), [".dril-pipe.json", "first.md", "second.md"]);
    sealed.write("p.yaml", ONE);
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("removed, because no stage makes them any more: second.md\n"), "{said}");
    assert_eq!(sealed.list(FOLDER), [".dril-pipe.json", "first.md"]);
}

#[test]
fn files_of_other_people_are_left_alone() {
    let sealed = Sealed::with(TWO);
    sealed.run_ok("run p.yaml");
    sealed.write("results/two-default/notes.txt", "mine");
    sealed.write("results/two-default/second.md", "changed by hand");
    sealed.write("p.yaml", ONE);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/two-default/notes.txt"), "mine");
    assert_eq!(sealed.read("results/two-default/second.md"), "changed by hand");
}

#[test]
fn a_table_that_was_lost_or_changed_comes_back_without_running_anything() {
    let sealed = Sealed::with(TWO);
    sealed.run_ok("run p.yaml");
    let table = sealed.read("results/two-default/first.md");
    sealed.write("results/two-default/first.md", "changed by hand");
    std::fs::remove_file(sealed.path("results/two-default/second.md")).unwrap();
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("0 stages executed"), "{said}");
    assert_eq!(sealed.read("results/two-default/first.md"), table);
    assert_eq!(sealed.list(FOLDER), [".dril-pipe.json", "first.md", "second.md"]);
}

#[test]
fn a_table_of_an_earlier_run_stays_and_is_called_that() {
    let chain = "\
name: two
stages:
  a: { kind: count, with: { mishap: none } }
  first: { kind: concat, inputs: { parts: a.count } }
";
    let sealed = Sealed::with(chain);
    sealed.run_ok("run p.yaml");
    let ended = sealed.run("run p.yaml --set a.mishap=fail");
    assert_eq!(ended.code, 1);
    let expected = "results: results/two-default (1 file)\n  from an earlier run, because their stages were not selected or did not finish: first.md\n";
    assert!(ended.stdout.contains(expected), "{}", ended.stdout);
    assert_eq!(sealed.list(FOLDER), [".dril-pipe.json", "first.md"]);
}

#[test]
fn results_go_where_they_are_asked_to_go_and_can_be_read_by_others() {
    use std::os::unix::fs::PermissionsExt;
    let sealed = Sealed::with(TWO);
    let said = sealed.run_ok("run p.yaml --out there/else");
    assert!(said.contains("results: there/else (2 files)\n"), "{said}");
    assert_eq!(sealed.list("there/else"), [".dril-pipe.json", "first.md", "second.md"]);
    assert!(!sealed.path("results").exists());
    let mode = std::fs::metadata(sealed.path("there/else/first.md")).unwrap().permissions().mode();
    assert_eq!(mode & 0o600, 0o600, "the owner can read and write it");
    let umask = mode_of_a_new_file(&sealed);
    assert_eq!(mode & 0o777, umask, "as any file that a program makes here");
}

fn mode_of_a_new_file(sealed: &Sealed) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    sealed.write("new", "");
    std::fs::metadata(sealed.path("new")).unwrap().permissions().mode() & 0o777
}

#[test]
fn a_manifest_that_points_outside_its_folder_removes_nothing() {
    let sealed = Sealed::with(TWO);
    sealed.run_ok("run p.yaml");
    sealed.write("results/precious.md", &sealed.read("results/two-default/first.md"));
    let note = sealed.read("results/two-default/.dril-pipe.json");
    sealed.write("results/two-default/.dril-pipe.json", &note.replace("\"second.md\"", "\"../precious.md\""));
    sealed.write("results/two-default/second.md", "");
    sealed.run_ok("run p.yaml");
    assert!(sealed.path("results/precious.md").is_file());
}

#[test]
fn an_unreadable_manifest_of_results_is_written_again() {
    let sealed = Sealed::with(TWO);
    sealed.run_ok("run p.yaml");
    let note = sealed.read("results/two-default/.dril-pipe.json");
    sealed.write("results/two-default/.dril-pipe.json", "{ half");
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/two-default/.dril-pipe.json"), note);
}

#[test]
fn if_results_cannot_be_copied_the_run_still_reports_what_it_did() {
    let sealed = Sealed::with(TWO);
    sealed.write("taken", "a file");
    let ended = sealed.run("run p.yaml --out taken/folder");
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(ended.stdout.contains("done: 3 ran, in "), "{}", ended.stdout);
    assert!(ended.stderr.starts_with("error: cannot ") && ended.stderr.contains("taken"), "{}", ended.stderr);
    let events = sealed.events("--out taken/folder");
    let last = events.last().unwrap();
    assert_eq!((&last["event"], &last["exit_code"]), (&"ended".into(), &4.into()));
    assert!(last["error"].as_str().unwrap().contains("taken"), "{last}");
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"), "the work is in the store");
}

/// A command `t` with these outputs, each a table that contains its own name.
fn tables(names: &[&str]) -> String {
    let outputs: Vec<String> =
        names.iter().map(|name| format!("{name}: {{ type: table, path: {name}.csv }}")).collect();
    let shell = format!("for t in {}; do echo $$t > $$t.csv; done", names.join(" "));
    format!(
        "name: two\nstages:\n  t: {{ kind: command, with: {{ shell: \"{shell}\", outputs: {{ {} }} }} }}\n",
        outputs.join(", ")
    )
}

#[test]
fn another_output_leaves_every_result_under_its_name() {
    let sealed = Sealed::new();
    let files = |names: &[&str]| {
        sealed.write("p.yaml", &tables(names));
        let mut command = sealed.command("run p.yaml");
        let ended = crate::sealed::ended({
            command.env("PATH", "/usr/bin:/bin");
            command
        });
        assert_eq!(ended.code, 0, "{ended:?}");
        let found = sealed.list(FOLDER).into_iter().filter(|name| name.ends_with(".csv"));
        found.map(|name| format!("{name}: {}", sealed.read(&format!("{FOLDER}/{name}")))).collect::<String>()
    };
    assert_eq!(files(&["main"]), "t.csv: main\n");
    let two = "t-main.csv: main\nt-zloss.csv: zloss\n";
    assert_eq!(files(&["main", "zloss"]), two);
    assert_eq!(files(&["main", "zloss", "confusion"]), format!("t-confusion.csv: confusion\n{two}"));
    // The one that is named like its extension is the stage's main one.
    assert_eq!(files(&["csv", "main"]), "t-main.csv: main\nt.csv: csv\n");
}

#[test]
fn files_of_two_stages_that_would_have_one_name_are_reported_before_anything_runs() {
    let other = "  t-zloss: { kind: command, with: { shell: \": > u.csv\", outputs: { u: { type: table, path: u.csv } } } }\n";
    let sealed = Sealed::with(&(tables(&["main", "zloss"]) + other));
    let planned = sealed.run("plan p.yaml");
    assert_eq!(planned.code, 3, "{planned:?}");
    let expected = "the results of `t` and `t-zloss` would have the same file name `t-zloss.csv`";
    assert!(planned.stderr.contains(expected), "{}", planned.stderr);
    // One table is `t.csv`, which is in nobody's way.
    sealed.write("p.yaml", &(tables(&["zloss"]) + other));
    sealed.run_ok("plan p.yaml");
}
