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
    let sealed = Sealed::new();
    let taken = sealed.path("taken").display().to_string();
    let shell = format!("echo 1 > {{outputs.t}}; echo a file > {taken}");
    sealed.write(
        "p.yaml",
        &format!("name: two\nstages:\n  t: {{ kind: command, with: {{ shell: '{shell}', outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"),
    );
    let ended = sealed.run("run p.yaml --out taken/folder");
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(ended.stdout.contains("done: 1 ran, in "), "{}", ended.stdout);
    assert!(ended.stderr.starts_with("error: cannot ") && ended.stderr.contains("taken"), "{}", ended.stderr);
    std::fs::remove_file(sealed.path("taken")).unwrap();
    let events = sealed.events("--out taken/folder --force t");
    let last = events.last().unwrap();
    assert_eq!((&last["event"], &last["exit_code"]), (&"ended".into(), &4.into()));
    assert!(last["error"].as_str().unwrap().contains("taken"), "{last}");
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"), "the work is in the store");
}

#[test]
fn a_results_folder_that_cannot_be_written_is_an_error_before_anything_runs() {
    let sealed = Sealed::with(TWO);
    sealed.write("taken", "a file");
    std::os::unix::fs::symlink("nowhere", sealed.path("loose")).unwrap();
    std::fs::create_dir_all(sealed.path("there/first.md")).unwrap();
    for (out, seen) in [
        ("taken", "cannot write to the results folder `taken`: it is a file, expected a folder\n"),
        (
            "taken/a/b",
            "cannot write to the results folder `taken/a/b`: `taken` is a file, expected a folder\n",
        ),
        ("loose/a", "cannot write to the results folder `loose/a`: `loose` is a link that leads nowhere\n"),
        (
            "there",
            "cannot write to the results folder `there`: `there/first.md` is a folder, expected a file\n",
        ),
        ("/proc/dril/a", "cannot write to the results folder `/proc/dril/a`: cannot write in `/proc`: "),
    ] {
        let ended = sealed.run(&format!("run p.yaml --out {out}"));
        assert_eq!(ended.code, 4, "{out}: {ended:?}");
        assert!(ended.stderr.starts_with(&format!("error: {seen}")), "{out}: {}", ended.stderr);
        assert!(ended.stderr.contains("hint: nothing was run; ") && ended.stderr.contains("`--out DIR`"));
        assert_eq!(sealed.list("cache/runs-v1"), [""; 0], "{out}: a stage ran");
        let events = sealed.events(&format!("--out {out}"));
        assert_eq!(events.len(), 1, "{out}: {events:?}");
        assert_eq!((&events[0]["event"], &events[0]["exit_code"]), (&"error".into(), &4.into()));
    }
    sealed.write("results", "a file");
    let ended = sealed.run("run p.yaml");
    assert!(ended.code == 4 && ended.stderr.contains("`results` is a file, expected a folder"), "{ended:?}");
    let ended = sealed.run("run p.yaml --out there/else --tensorboard taken/curves");
    let expected = format!("`{}` is a file, expected a folder\n", sealed.path("taken").display());
    assert!(
        ended.code == 4 && ended.stderr.starts_with("error: cannot write learning curves to `"),
        "{ended:?}"
    );
    assert!(ended.stderr.contains(&expected) && ended.stderr.contains("`--tensorboard DIR`"), "{ended:?}");
    assert_eq!(sealed.list("cache/runs-v1"), [""; 0]);
    // Without results, nothing has to be written.
    sealed.write("p.yaml", "name: two\nstages:\n  a: { kind: emit, with: { text: a } }\n");
    sealed.run_ok("run p.yaml");
}

#[test]
fn a_results_folder_or_a_lock_file_without_permission_is_an_error_before_anything_runs() {
    let sealed = Sealed::with(TWO);
    sealed.write("closed/p.yaml", TWO);
    let Some(ended) = crate::rough::as_user(&sealed, "chmod a-w closed", "run p.yaml --out closed/a") else {
        return;
    };
    let expected =
        "error: cannot write to the results folder `closed/a`: cannot write in `closed`: Permission denied";
    assert!(ended.code == 4 && ended.stderr.starts_with(expected), "{ended:?}");
    let ended = crate::rough::as_user(&sealed, ":", "run closed/p.yaml --lock").unwrap();
    let expected =
        "error: cannot write the lock file `closed/p.lock`: cannot write in `closed`: Permission denied";
    assert!(ended.code == 4 && ended.stderr.starts_with(expected), "{ended:?}");
    assert_eq!(sealed.list("cache/runs-v1"), [""; 0]);
    // An existing lock file is only written where a result differs.
    assert_eq!(crate::rough::as_user(&sealed, ":", "run closed/p.yaml").unwrap().code, 0);
    let whole = crate::rough::as_user(&sealed, "chmod a-w results/*", "run closed/p.yaml").unwrap();
    assert_eq!(whole.code, 0, "what is in place need not be written: {whole:?}");
}

#[test]
fn no_results_folder_is_made_before_there_are_results() {
    let sealed = Sealed::with(TWO);
    let is_there = || sealed.path("results").exists() || sealed.path("out").exists();
    for args in
        ["plan p.yaml", "run p.yaml --dry-run", "run p.yaml --dry-run --out out/a", "run p.yaml nobody"]
    {
        sealed.run(args);
        assert!(!is_there(), "{args}");
    }
    for pipeline in [
        TWO.replace("text: ", "txt: "),
        "name: two\nstages:\n  a: { kind: count, with: { mishap: fail } }\n  first: { kind: concat, inputs: { parts: a.count } }\n".to_owned(),
        "name: two\nstages:\n  first: { kind: concat, inputs: { parts: { file: missing.txt } } }\n".to_owned(),
        TWO.to_owned() + "  b: { kind: elsewhere }\n",
    ] {
        sealed.write("p.yaml", &pipeline);
        for args in ["run p.yaml", "run p.yaml --out out/a"] {
            assert_ne!(sealed.run(args).code, 0, "{pipeline}");
            assert!(!is_there(), "{args}: {pipeline}");
        }
    }
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
