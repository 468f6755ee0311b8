//! The command line from the outside: what `run` does, says, leaves behind and ends in.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use serde_json::Value;

use crate::sealed::{Sealed, ended, lines, signal, until};

/// Eight stages: three texts, three counts behind them, one table of the counts, and one text apart from all.
pub const WORDS: &str = "\
name: words
axes:
  word: [one, two, three]
stages:
  say:
    kind: emit
    matrix: [word]
    with: { text: \"${word}: \" }
  count:
    kind: count
    matrix: [word]
    with: { to: 2 }
    inputs: { start: say }
  gather:
    kind: concat
    inputs: { parts: count.count }
  apart:
    kind: emit
    with: { text: apart }
profiles:
  full: {}
  quick:
    count: { to: 1 }
";

/// A table whose middle stage does what `--set b.…` sets.
const CHAIN: &str = "\
name: chain
stages:
  a: { kind: emit, with: { text: \"a \" } }
  b: { kind: count, with: { to: 3 }, inputs: { start: a } }
  c: { kind: concat, inputs: { parts: b.count } }
  d: { kind: emit, with: { text: apart } }
";

fn of<'a>(events: &'a [Value], name: &str) -> Vec<&'a Value> {
    events.iter().filter(|event| event["event"] == name).collect()
}

/// The stages of these events.
fn stages(events: &[Value], name: &str) -> Vec<String> {
    let mut names: Vec<String> =
        of(events, name).iter().map(|event| event["stage"].as_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_run_says_what_it_did_and_copies_its_tables() {
    let sealed = Sealed::with(WORDS);
    let said = sealed.normal(&sealed.run_ok("run p.yaml --jobs 2"));
    assert!(
        said.starts_with("words, profile full: 8 stages, 0 cached, 4 to run, 4 downstream; [n] threads\n"),
        "{said}"
    );
    assert!(said.contains(" ran     gather in [time] s\n"), "{said}");
    assert!(said.ends_with("done: 8 ran, in [time] s\nresults: results/words-full (1 file)\n"), "{said}");
    assert_eq!(sealed.list("results/words-full"), [".dril-pipe.json", "gather.md"]);
    let table = sealed.read("results/words-full/gather.md");
    assert!(table.starts_with("one: 0,") && table.contains("\ntwo: 0,"), "{table}");
}

#[test]
fn a_second_run_executes_nothing_and_says_so() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let said = sealed.normal(&sealed.run_ok("run p.yaml"));
    let expected = "words, profile full: 8 stages, 8 cached\n\
                    nothing to do: 0 stages executed, all 8 cached, in [time] s\n\
                    results: results/words-full (1 file)\n";
    assert_eq!(said, expected);
}

#[test]
fn a_changed_parameter_reruns_what_plan_showed_and_nothing_else() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let planned = sealed.run_ok("plan p.yaml --set count.to=5");
    assert!(planned.contains("count × 3  run         to: 2 -> 5\n"), "{planned}");
    assert!(planned.contains("gather     depends on  count × 3\n"), "{planned}");
    let events = sealed.events("--set count.to=5");
    assert_eq!(stages(&events, "ran"), ["count[word=one]", "count[word=three]", "count[word=two]", "gather"]);
    assert_eq!(stages(&events, "cached"), ["apart", "say[word=one]", "say[word=three]", "say[word=two]"]);
    let why = &of(&events, "started")[0]["why"][0];
    assert_eq!((&why["path"], &why["old"], &why["new"]), (&"to".into(), &2.into(), &5.into()));
}

#[test]
fn an_edit_that_changes_no_output_stops_where_it_stands() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let said = sealed.run_ok("run p.yaml --set gather.keep=1000000");
    assert!(said.contains("done: 1 ran, 7 cached"), "{said}");
}

#[test]
fn json_lines_report_the_whole_run() {
    let sealed = Sealed::with(WORDS);
    let events = sealed.events("--jobs 1");
    let first = &events[0];
    assert_eq!(
        (&first["event"], &first["stages"], &first["threads"]),
        (&"planned".into(), &8.into(), &1.into())
    );
    let last = events.last().unwrap();
    assert_eq!((&last["event"], &last["ran"], &last["exit_code"]), (&"ended".into(), &8.into(), &0.into()));
    assert_eq!(last["results"]["folder"], "results/words-full");
    assert_eq!(of(&events, "started").len(), 8);
    let progress = of(&events, "progress");
    assert!(
        progress.iter().any(|event| event["step"] == 2 && event["total"] == 2 && event["unit"] == "numbers")
    );
    for event in &events {
        assert!(event["at"].as_f64().is_some(), "{event}");
    }
}

#[test]
fn a_failed_stage_shows_its_error_its_log_and_lets_others_finish() {
    let sealed = Sealed::with(CHAIN);
    let ended = sealed.run("run p.yaml --set b.mishap=fail --set b.at=1");
    assert_eq!(ended.code, 1, "{ended:?}");
    assert!(ended.stderr.contains("error: stage `b` failed: fails as configured at 1\n"), "{}", ended.stderr);
    assert!(ended.stdout.contains(" ran     d in "), "{}", ended.stdout);
    assert!(ended.stdout.contains("failed: 2 ran, 1 failed, 1 skipped, in "), "{}", ended.stdout);
    assert!(ended.stdout.contains("\n  failed: b\n  skipped: c\n"), "{}", ended.stdout);
    let log = ended.stderr.lines().find_map(|line| line.strip_prefix("  log: ")).unwrap();
    assert!(log.starts_with("cache/runs-v1/") && sealed.path(log).is_file(), "{log}");
}

#[test]
fn a_crash_shows_the_last_lines_of_the_log() {
    let sealed = Sealed::with(CHAIN);
    let ended = sealed.run("run p.yaml --set b.mishap=crash");
    assert_eq!(ended.code, 1);
    assert!(ended.stderr.contains("SIGABRT"), "{}", ended.stderr);
    assert!(ended.stderr.contains("  last lines of its log:\n    | about to crash\n"), "{}", ended.stderr);
}

#[test]
fn quiet_says_nothing_but_errors() {
    let sealed = Sealed::with(CHAIN);
    let failed = sealed.run("run p.yaml --quiet --set b.mishap=fail");
    assert_eq!((failed.code, &*failed.stdout), (1, ""));
    assert!(
        failed.stderr.starts_with("error: stage `b` failed: fails as configured at 0\n"),
        "{}",
        failed.stderr
    );
    let done = sealed.run("run p.yaml -q");
    assert_eq!((done.code, &*done.stdout, &*done.stderr), (0, "", ""));
}

#[test]
fn after_the_first_interrupt_the_run_stops_and_the_next_one_goes_on() {
    let undisturbed = Sealed::with(CHAIN);
    undisturbed.run_ok("run p.yaml --set b.to=100");
    let sealed = Sealed::with(CHAIN);
    let slow = "run p.yaml --json --set b.to=100 --set b.step_millis=20";
    let mut child = sealed.command(slow).stdout(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(said.any(|line| line.contains("\"progress\"")));
    signal(&child, "INT");
    let rest: Vec<Value> = said.map(|line| serde_json::from_str(&line).unwrap()).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(stages(&rest, "stopped"), ["b"]);
    assert_eq!(rest.last().unwrap()["exit_code"], 130);
    let again = sealed.events("--set b.to=100 --set b.step_millis=20");
    let first = of(&again, "progress")[0];
    assert!(first["step"].as_u64().unwrap() > 1, "it went on from its checkpoint: {first}");
    assert_eq!(sealed.read("results/chain-default/c.md"), undisturbed.read("results/chain-default/c.md"));
}

#[test]
fn the_second_interrupt_ends_the_program_at_once_and_its_stages_with_it() {
    let sealed = Sealed::with(CHAIN);
    let mut command = sealed.command("run p.yaml --json --set b.mishap=hang");
    command.env("DRIL_FAKES_TRACE", sealed.path("trace")).stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    let trace = || std::fs::read_to_string(sealed.path("trace")).unwrap_or_default();
    until("the stage hangs", || trace().contains("hang count"));
    signal(&child, "TERM");
    std::thread::sleep(std::time::Duration::from_millis(100));
    assert!(child.try_wait().unwrap().is_none(), "one signal waits for the stage to stop");
    signal(&child, "TERM");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let mut before = String::new();
    until("the stage is gone", || {
        std::thread::sleep(std::time::Duration::from_millis(100));
        let same = before == trace();
        before = trace();
        same
    });
}

#[test]
fn colours_are_for_terminals_and_no_color_wins() {
    let sealed = Sealed::with(WORDS);
    let escapes = |variables: &[(&str, &str)]| {
        let mut command = sealed.command("plan p.yaml");
        command.envs(variables.iter().copied());
        ended(command).stdout.contains('\x1b')
    };
    assert!(!escapes(&[("TERM", "xterm")]), "a pipe gets no colours");
    assert!(escapes(&[("CLICOLOR_FORCE", "1")]));
    assert!(!escapes(&[("CLICOLOR_FORCE", "1"), ("NO_COLOR", "1")]));
    assert!(escapes(&[("CLICOLOR_FORCE", "1"), ("NO_COLOR", "")]), "an empty NO_COLOR is none");
}

#[test]
fn the_store_is_where_the_argument_says_then_the_environment_then_the_folder() {
    let sealed = Sealed::with(CHAIN);
    let mut command = sealed.command("run p.yaml --cache given");
    command.env("DRIL_PIPE_CACHE", sealed.path("named"));
    assert_eq!(ended(command).code, 0);
    assert!(sealed.path("given").is_dir() && !sealed.path("named").exists());
    let mut command = sealed.command("run p.yaml");
    command.env("DRIL_PIPE_CACHE", sealed.path("named"));
    assert_eq!(ended(command).code, 0);
    assert!(sealed.path("named").is_dir() && !sealed.path("cache").exists());
    sealed.run_ok("run p.yaml");
    assert!(sealed.path("cache").is_dir());
}

#[test]
fn planning_leaves_no_trace() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("plan p.yaml");
    sealed.run_ok("graph p.yaml");
    assert_eq!(sealed.list("."), ["p.yaml"]);
}

#[test]
fn a_wrong_pipeline_ends_in_3_before_anything_runs() {
    let sealed = Sealed::with("name: x\nstages:\n  a: { kind: emti, with: { text: x } }\n");
    for (args, expected) in [
        ("run p.yaml", "did you mean `emit`?"),
        ("run missing.yaml", "there is no file `missing.yaml`"),
        ("run .", "`.` is a folder"),
    ] {
        let ended = sealed.run(args);
        assert_eq!((ended.code, &*ended.stdout), (3, ""), "{args}");
        assert!(ended.stderr.starts_with("error: ") && ended.stderr.contains(expected), "{}", ended.stderr);
    }
    assert_eq!(sealed.list("."), ["p.yaml"]);
}

#[test]
fn a_missing_file_from_outside_is_named_with_its_place() {
    let sealed =
        Sealed::with("name: x\nstages:\n  a: { kind: concat, inputs: { parts: { file: no.txt } } }\n");
    let ended = sealed.run("run p.yaml");
    assert_eq!(ended.code, 3, "{ended:?}");
    assert!(ended.stderr.contains("p.yaml:3:") && ended.stderr.contains("no.txt"), "{}", ended.stderr);
}

#[test]
fn errors_before_a_json_run_are_a_line_of_json_too() {
    let sealed = Sealed::with("name: x\nstages: 3\n");
    let ended = sealed.run("run p.yaml --json");
    let said = lines(&ended.stdout);
    assert_eq!(said.len(), 1);
    assert_eq!((&said[0]["event"], &said[0]["kind"]), (&"error".into(), &"pipeline".into()));
    assert_eq!(said[0]["exit_code"], ended.code);
    assert!(ended.stderr.starts_with("error: "));
}

#[test]
fn a_store_that_is_a_file_ends_in_4_and_names_it() {
    let sealed = Sealed::with(CHAIN);
    sealed.write("taken", "");
    let ended = sealed.run("run p.yaml --cache taken");
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(ended.stderr.contains("taken") && ended.stderr.contains("--cache DIR"), "{}", ended.stderr);
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let sealed = Sealed::with(WORDS);
    for args in ["kinds", "plan p.yaml", "graph p.yaml", "run p.yaml"] {
        let mut child = sealed.command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let ended = child.wait_with_output().unwrap();
        let errors = String::from_utf8(ended.stderr).unwrap();
        assert_eq!((ended.status.code(), &*errors), (Some(0), ""), "{args}");
    }
}

#[test]
fn equal_stages_are_made_once_and_none_of_them_waits_for_its_own_engine() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  a: { kind: emit, with: { text: x } }\n  b: { kind: emit, with: { text: x } }\n",
    );
    let events = sealed.events("--jobs 1");
    let named = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert_eq!((named("ran"), named("cached"), named("waiting")), (1, 1, 0), "{events:?}");
    let sealed = Sealed::with(&sealed.read("p.yaml"));
    let said = sealed.run_ok("run p.yaml --jobs 1");
    assert!(
        said.contains("cached  b: same key as a\n") || said.contains("cached  a: same key as b\n"),
        "{said}"
    );
}

#[test]
fn a_plan_for_a_cluster_forecasts_jobs_time_and_the_critical_path() {
    let sealed = Sealed::with(WORDS);
    sealed.write("dril-pipe.toml", "[slurm]\nlocal = []\nmax_threads = 16\n");
    let text = sealed.run_ok("plan p.yaml --executor slurm");
    assert!(text.contains("on Slurm: ") && text.contains(" jobs, 0 stages beside the engine"), "{text}");
    assert!(text.contains("no stage has an estimate"), "{text}");
    let value: Value = serde_json::from_str(&sealed.run_ok("plan p.yaml --executor slurm --json")).unwrap();
    let forecast = &value["forecast"];
    assert_eq!(forecast["jobs"], forecast["stages"]);
    assert_eq!(forecast["times"].as_array().unwrap().last().unwrap()["threads"], 16);
    assert!(!sealed.run_ok("plan p.yaml").contains("Slurm"));
    let ended = sealed.run("plan p.yaml --executor nowhere");
    assert!(ended.code == 2 && ended.stderr.contains("there is no such executor"), "{ended:?}");
    sealed.run_ok("run p.yaml");
    assert!(!sealed.run_ok("plan p.yaml --executor slurm").contains("on Slurm"), "nothing is to run");
}

#[test]
fn every_event_has_its_time() {
    let sealed = Sealed::with(WORDS);
    let events = sealed.events("--check-determinism");
    assert_eq!(of(&events, "checked").len(), 8);
    sealed.write("p.yaml", "name: x\n");
    let times: Vec<f64> = events.iter().map(|event| event["at"].as_f64().unwrap_or(f64::NAN)).collect();
    assert!(times.is_sorted(), "{times:?}");
    let refused = sealed.events("");
    assert_eq!(refused[0]["event"], "error");
    assert!(refused[0]["at"].as_f64().is_some(), "{refused:?}");
}
