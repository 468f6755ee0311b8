//! The commands that look and change nothing: `explain`, `status`, `show`, `log`, `runs`, `diff`.

use serde_json::{Value, json};

use crate::cli::WORDS;
use crate::sealed::{Sealed, ended, signal, until};

fn parsed(sealed: &Sealed, args: &str) -> Value {
    let text = sealed.run_ok(args);
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{args}: {error}: {text}"))
}

fn stage<'a>(all: &'a Value, id: &str) -> &'a Value {
    all.as_array().unwrap().iter().find(|stage| stage["stage"] == id).unwrap_or_else(|| panic!("no {id}"))
}

#[test]
fn explain_names_the_field_that_made_a_stage_stale_back_to_the_first_cause() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let said = sealed.run_ok("explain p.yaml gather --set say.times=2");
    for part in [
        "gather: runs after the stages upstream",
        "from count[word=one]",
        "say[word=one]: will run",
        "times: 1 -> 2",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let json = parsed(&sealed, "explain p.yaml gather --json --set say.times=2");
    let first = &json[0]["causes"][0];
    assert_eq!((&first["stage"], &first["port"]), (&json!("count[word=one]"), &json!("parts")));
    let root = &first["causes"][0];
    assert_eq!(root["stage"], "say[word=one]");
    assert_eq!(root["why"], json!([{ "because": "param", "path": "times", "old": 1, "new": 2 }]));
}

#[test]
fn explain_still_shows_after_the_run_why_a_stage_ran() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    assert!(sealed.run_ok("explain p.yaml").contains("every stage is up to date"));
    sealed.run_ok("run p.yaml --set count.to=5");
    let said = sealed.run_ok("explain p.yaml gather --set count.to=5");
    assert!(said.contains("gather: up to date since "), "{said}");
    assert!(said.contains("input `parts` differs (count[word=one].count): "), "{said}");
    assert!(said.contains("    to: 2 -> 5\n"), "{said}");
    let json = parsed(&sealed, "explain p.yaml gather --json --set count.to=5");
    assert_eq!(json[0]["verdict"], "cached");
    let why = json[0]["why"].as_array().unwrap();
    assert_eq!(why.len(), 3);
    assert!(why.iter().all(|reason| reason["old"] != reason["new"] && reason["old"].is_string()));
}

#[test]
fn an_unknown_stage_gets_a_hint_with_the_nearest_name() {
    let sealed = Sealed::with(WORDS);
    for command in ["explain p.yaml gathr", "show p.yaml gathr", "status p.yaml gathr"] {
        let ended = sealed.run(command);
        assert_eq!(ended.code, 2, "{ended:?}");
        assert!(ended.stderr.contains("did you mean `gather`?"), "{}", ended.stderr);
    }
}

#[test]
fn status_distinguishes_fresh_stale_and_failed_stages() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let fresh = parsed(&sealed, "status p.yaml --json");
    assert!(fresh.as_array().unwrap().iter().all(|stage| stage["state"] == "fresh"));
    assert!(stage(&fresh, "gather")["since"].as_f64().unwrap() > 1.7e9);
    let bad = "--set count.mishap=fail --set count.to=3";
    assert_eq!(sealed.run(&format!("run p.yaml {bad}")).code, 1);
    let after = parsed(&sealed, &format!("status p.yaml --json {bad}"));
    assert_eq!(stage(&after, "count[word=two]")["state"], "failed");
    assert_eq!(stage(&after, "count[word=two]")["error"], "fails as configured at 0");
    assert_eq!(stage(&after, "gather")["state"], "behind");
    assert_eq!(stage(&after, "apart")["state"], "fresh");
    let stale = sealed.run_ok("status p.yaml --set apart.text=x");
    assert!(stale.contains("  apart      stale"), "{stale}");
    assert!(stale.contains("count × 3  fresh  made "), "{stale}");
    assert!(stale.lines().last().unwrap().starts_with("7 fresh ("), "{stale}");
}

#[test]
fn status_names_a_stage_that_another_process_runs() {
    let sealed = Sealed::with(WORDS);
    let slow = "--set count.mishap=hang --set count.at=1";
    let mut command = sealed.command(&format!("run p.yaml --jobs 1 {slow}"));
    let mut child = command.stdout(std::process::Stdio::null()).spawn().unwrap();
    until("a stage runs", || sealed.run(&format!("status p.yaml {slow}")).stdout.contains("running"));
    let runs = parsed(&sealed, "runs --json");
    assert_eq!(runs[0]["state"], "running");
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(parsed(&sealed, "runs --json")[0]["state"], "died");
}

#[test]
fn show_gives_digests_and_provenance_up_to_the_roots() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let json = parsed(&sealed, "show p.yaml gather --json");
    let shown = stage(&json, "gather");
    let path = shown["outputs"][0]["path"].as_str().unwrap();
    assert_eq!(std::fs::read_to_string(path).unwrap(), sealed.read("results/words-full/gather.md"));
    let before: Vec<&str> = shown["provenance"]
        .as_array()
        .unwrap()
        .iter()
        .map(|stage| stage["stage"].as_str().unwrap())
        .collect();
    assert_eq!(before.len(), 6);
    let position = |id: &str| before.iter().position(|other| *other == id).unwrap();
    assert!(position("say[word=one]") < position("count[word=one]"), "roots come first: {before:?}");
    let text = sealed.run_ok("show p.yaml gather");
    assert!(text.contains("upstream, roots first") && text.contains("joined"), "{text}");
    assert!(text.contains(shown["key"].as_str().unwrap()));
}

#[test]
fn a_log_is_found_by_the_name_of_its_stage() {
    let sealed = Sealed::with(WORDS);
    sealed.run("run p.yaml --set count.mishap=crash");
    let said = sealed.run_ok("log count[word=one]");
    assert!(said.contains("about to crash\n") && said.contains("==> failed: "), "{said}");
    let paths = sealed.run_ok("log count --path");
    assert_eq!(paths.lines().count(), 3);
    assert!(paths.lines().all(|path| sealed.path(path).is_file()), "{paths}");
    let ended = sealed.run("log nobody");
    assert_eq!(ended.code, 2);
    assert!(ended.stderr.contains("no run in "), "{}", ended.stderr);
}

/// Three instances of a command that prints its name, and fails where there is a file of that name.
fn three(sealed: &Sealed, axis: &str) -> String {
    let at = sealed.path("fail").display().to_string();
    format!(
        "name: p\naxes: {{ {axis}: [one, two, three] }}\nstages:\n  \
         c: {{ kind: command, matrix: [{axis}], with: {{ shell: \"echo I am ${{{axis}}}; test ! -e {at}-${{{axis}}}; : > {{outputs.o}}\", outputs: {{ o: o.txt }} }} }}\n  \
         t: {{ kind: concat, matrix: [{axis}], inputs: {{ parts: c }} }}\n"
    )
}

#[test]
fn the_newest_log_of_every_instance_is_found_whichever_run_it_is_from() {
    let sealed = Sealed::new();
    sealed.write("p.yaml", &three(&sealed, "x"));
    sealed.write("fail-two", "");
    assert_eq!(sealed.run("run p.yaml").code, 1);
    std::fs::remove_file(sealed.path("fail-two")).unwrap();
    sealed.run_ok("run p.yaml");
    let all = sealed.run_ok("log c");
    for name in ["one", "two", "three"] {
        assert!(
            all.contains(&format!("==> c[x={name}]: ran in run ")) && all.contains(&format!("I am {name}\n")),
            "{all}"
        );
    }
    let runs = parsed(&sealed, "runs --json");
    let (latest, first) = (runs[0]["run"].as_str().unwrap(), runs[1]["run"].as_str().unwrap());
    let json = parsed(&sealed, "log c --json");
    let of = |id: &str| stage(&json, id)["run"].as_str().unwrap().to_owned();
    assert_eq!([of("c[x=one]"), of("c[x=two]"), of("c[x=three]")], [first, latest, first]);
    assert_eq!(sealed.run_ok("log c --path").lines().count(), 3);
    assert_eq!(sealed.run_ok(&format!("log c --path --run {latest}")).lines().count(), 1);
    // Another pipeline has stages of its own.
    sealed.write("q.yaml", &three(&sealed, "x").replace("name: p", "name: q").replace("I am", "This is"));
    sealed.run_ok("run q.yaml c[x=one]");
    let other = sealed.run_ok("log c");
    assert_eq!(other, "This is one\n");
}

#[test]
fn an_instance_that_never_ran_is_named_and_one_with_a_new_name_has_the_log_of_its_result() {
    let sealed = Sealed::new();
    sealed.write("p.yaml", &three(&sealed, "x"));
    sealed.write("fail-two", "");
    sealed.run("run p.yaml");
    let ended = sealed.run("log t --path");
    assert_eq!((ended.code, ended.stdout.lines().count()), (0, 2), "{ended:?}");
    assert_eq!(ended.stderr, "note: no run started t[x=two]\n");
    std::fs::remove_file(sealed.path("fail-two")).unwrap();
    sealed.run_ok("run p.yaml");
    // The same results under new names; one of them runs again.
    sealed.write("p.yaml", &three(&sealed, "y"));
    sealed.run_ok("run p.yaml --force c[y=three]");
    let json = parsed(&sealed, "log c --json");
    let ids: Vec<_> =
        json.as_array().unwrap().iter().map(|log| (&log["stage"], &log["started_as"])).collect();
    let (one, three, two) = (json!("c[y=one]"), json!("c[y=three]"), json!("c[y=two]"));
    assert_eq!(ids, [(&one, &json!("c[x=one]")), (&three, &three), (&two, &json!("c[x=two]"))]);
    let text = sealed.run_ok("log c");
    assert!(text.contains("==> c[y=one]: ran as c[x=one] in run ") && text.contains("I am one\n"), "{text}");
}

#[test]
fn a_stage_or_run_that_is_not_there_gets_a_hint_that_helps() {
    let sealed = Sealed::with(WORDS);
    let hint = |args: &str| {
        let ended = sealed.run(args);
        assert_eq!(ended.code, 2, "{ended:?}");
        ended.stderr.split_once("hint: ").unwrap().1.trim_end().to_owned()
    };
    let other = "`--cache DIR` or DRIL_PIPE_CACHE names another cache";
    assert_eq!(hint("log count"), format!("there are no runs; {other}"));
    assert_eq!(hint("diff last"), other);
    sealed.run_ok("run p.yaml");
    assert!(hint("log cuont").starts_with("did you mean `count`? the stages of runs are `apart`, `count`, "));
    let instances = "its instances in runs are `count[word=one]`, `count[word=three]`, `count[word=two]`";
    assert_eq!(hint("log count[word=four]"), instances);
    assert_eq!(hint("log count[word=four] --run last"), instances);
    assert!(sealed.run("diff last~1").stderr.starts_with("error: `last~1`: there is only 1 run\n"));
}

#[test]
fn runs_are_listed_latest_first_with_how_they_ended() {
    let sealed = Sealed::with(WORDS);
    assert!(sealed.run_ok("runs").starts_with("no runs in "));
    sealed.run_ok("run p.yaml");
    sealed.run("run p.yaml --set count.mishap=fail");
    let runs = parsed(&sealed, "runs --json");
    assert_eq!((&runs[0]["state"], &runs[0]["failed"]), (&json!("failed"), &json!(3)));
    assert_eq!((&runs[1]["state"], &runs[1]["ran"]), (&json!("done"), &json!(8)));
    let text = sealed.run_ok("runs");
    assert!(text.lines().count() == 2 && text.contains("done: 8 ran, in "), "{text}");
    assert_eq!(sealed.run_ok("runs -n 1").lines().count(), 1);
    assert!(sealed.run_ok("runs --pipeline other").starts_with("no runs"));
}

#[test]
fn diff_shows_parameters_and_results_of_two_runs_side_by_side() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("run p.yaml --set apart.text=other");
    let json = parsed(&sealed, "diff last~1 last --json");
    assert_eq!(json["same"], 7);
    let apart = stage(&json["stages"], "apart");
    assert_eq!(apart["why"][0]["path"], "text");
    assert_eq!(apart["results"][0]["lines"], json!([{ "line": 1, "then": "apart", "now": "other" }]));
    let text = sealed.run_ok("diff last~1");
    assert!(text.contains("text: \"apart\" -> \"other\"") && text.contains("apart  |  other"), "{text}");
    let ended = sealed.run("diff 1999");
    assert_eq!(ended.code, 2, "{ended:?}");
}

#[test]
fn diff_names_renamed_stages_once_and_groups_what_only_one_run_has() {
    let sealed = Sealed::new();
    sealed.write("p.yaml", &three(&sealed, "x"));
    sealed.run_ok("run p.yaml");
    sealed.write("p.yaml", &(three(&sealed, "y") + "  z: { kind: emit, with: { text: z } }\n"));
    sealed.run_ok("run p.yaml");
    let body = |args: &str| {
        let text = sealed.run_ok(args);
        text.split_once("\n\n").unwrap().1.to_owned()
    };
    // The label of an artifact is in the key of a stage that reads many.
    assert_eq!(
        body("diff last~1"),
        "c × 3: renamed, c[x=one] -> c[y=one] and so on; the results are the same\n\n\
         t × 3: renamed, t[x=one] -> t[y=one] and so on; other keys, but the results are the same\n\n\
         z: missing, then done\n\n\
         0 stages the same, 6 renamed, 1 different\n"
    );
    let json = parsed(&sealed, "diff last~1 --json");
    assert_eq!(json["renamed"][0], json!({ "then": "c[x=one]", "now": "c[y=one]", "same_key": true }));
    assert_eq!((json["renamed"].as_array().unwrap().len(), json["stages"].as_array().unwrap().len()), (6, 1));
    assert_eq!(
        body("diff last~1 --stage c[y=two]"),
        "c[x=two] -> c[y=two]: renamed; the results are the same\n\n0 stages the same, 1 renamed, 0 different\n"
    );
    // Stages with another name, and stages that are gone.
    let other = three(&sealed, "y").split_once("  t:").unwrap().0.replace("  c:", "  d:");
    sealed.write("p.yaml", &other);
    sealed.run_ok("run p.yaml --force d[y=two]");
    assert_eq!(
        body("diff last~1"),
        "c × 3 -> d × 3: renamed, c[y=one] -> d[y=one] and so on; the results are the same\n\n\
         t × 3: done, then missing\n\n\
         z: done, then missing\n\n\
         0 stages the same, 3 renamed, 4 different\n"
    );
}

#[test]
fn looking_changes_nothing_in_the_store() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let before = crate::lab::files_below(&sealed.path("cache"));
    for command in [
        "explain p.yaml gather",
        "status p.yaml",
        "show p.yaml gather",
        "log gather",
        "runs",
        "diff last last",
    ] {
        sealed.run_ok(command);
        assert_eq!(crate::lab::files_below(&sealed.path("cache")), before, "{command}");
    }
}

#[test]
fn a_log_is_printed_whole_however_long_it_is() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  c: { kind: command, with: { shell: 'seq 1 30000; : > {outputs.o}', outputs: { o: o } } }\n",
    );
    sealed.run_ok("run p.yaml");
    let whole: String = (1..=30_000).map(|line| format!("{line}\n")).collect();
    assert!(sealed.run_ok("log c") == whole, "a line is missing");
    let tail: String = (5001..=30_000).map(|line| format!("{line}\n")).collect();
    assert!(sealed.run_ok("log c --tail 25000") == tail, "these are not the last lines");
    assert_eq!(parsed(&sealed, "log c --json")[0]["lines"].as_array().unwrap().len(), 30_000);
    assert_eq!(parsed(&sealed, "log c --json --tail 2")[0]["lines"], json!(["29999", "30000"]));
}

#[test]
fn a_stage_that_was_stopped_after_it_failed_is_stale_and_not_failed() {
    let sealed = Sealed::new();
    let fail = sealed.path("fail");
    let shell = format!("if test -e {}; then exit 3; fi; sleep 60", fail.display());
    sealed.write(
        "p.yaml",
        &format!(
            "name: p\nstages:\n  c: {{ kind: command, with: {{ shell: '{shell}', outputs: {{ o: o }} }} }}\n"
        ),
    );
    let state = || parsed(&sealed, "status p.yaml --json")[0]["state"].as_str().unwrap().to_owned();
    sealed.write("fail", "");
    assert_eq!(sealed.run("run p.yaml").code, 1);
    assert_eq!(state(), "failed");
    std::fs::remove_file(&fail).unwrap();
    let mut child = sealed.command("run p.yaml --quiet").spawn().unwrap();
    until("it runs", || {
        let now = parsed(&sealed, "status p.yaml --json")[0].clone();
        now["state"] == "running" && now["since"].is_number()
    });
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(state(), "stale");
    assert!(parsed(&sealed, "status p.yaml --json")[0]["error"].is_null());
    let mut report = sealed.command("report p.yaml --out report.html");
    report.env("DRIL_FAKES_PAGE", "1");
    assert_eq!(ended(report).code, 0);
    let page = sealed.read("report.html");
    assert!(page.contains("c: Stale") && !page.contains("Failed("), "{page}");
    sealed.write("fail", "");
    assert_eq!(sealed.run("run p.yaml").code, 1);
    assert_eq!(state(), "failed");
}
