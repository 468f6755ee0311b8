//! Checkpoints that block a stage: an error that follows a resumption says so, and `--force` starts without them.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use dril_pipe::fsx::Lock;

use crate::executors::{pbs, submitted};
use crate::sealed::{Ended, Sealed, ended, lines, signal, until};

/// A command that leaves garbage where it keeps its state if it is configured to die, and stumbles over it afterwards.
const GARBAGE: &str = "\
name: p
axes: { k: [1, 2] }
stages:
  train:
    kind: command
    matrix: [k]
    with:
      shell: \": ${k}; if test $$MODE = die; then echo garbage > {checkpoints}/state; exit 9; fi; test ! -e {checkpoints}/state; echo done > {outputs.o}\"
      pass_env: [MODE]
      outputs: { o: o.txt }
";

fn run(sealed: &Sealed, mode: &str, args: &[&str]) -> Ended {
    let mut command = sealed.command("run p.yaml");
    command.args(args).env("PATH", "/usr/bin:/bin").env("MODE", mode);
    ended(command)
}

#[test]
fn forced_stages_start_without_their_checkpoints_and_a_failure_after_a_resumption_says_how() {
    let sealed = Sealed::with(GARBAGE);
    let died = run(&sealed, "die", &[]);
    assert_eq!(died.code, 1, "{died:?}");
    assert!(died.stderr.contains("exit code 9") && !died.stderr.contains("resumed"), "{}", died.stderr);
    let stuck = run(&sealed, "go", &[]);
    assert_eq!(stuck.code, 1, "{stuck:?}");
    for stage in ["train[k=1]", "train[k=2]"] {
        let expected = format!("`run --force '{stage}'` starts without it");
        assert!(stuck.stderr.contains("; it had resumed from the checkpoint that was saved "), "{stuck:?}");
        assert!(stuck.stderr.contains(&expected), "{expected}: {}", stuck.stderr);
    }
    // The other instance keeps its own.
    let forced = run(&sealed, "go", &["--force", "train[k=1]"]);
    assert_eq!(forced.code, 1, "{forced:?}");
    assert!(forced.stderr.contains("--force 'train[k=2]'"), "{}", forced.stderr);
    assert!(!forced.stderr.contains("--force 'train[k=1]'"), "{}", forced.stderr);
    let forced = run(&sealed, "go", &["--force", "train"]);
    assert_eq!(forced.code, 0, "{forced:?}");
    assert!(forced.stdout.contains("2 ran"), "{}", forced.stdout);
}

#[test]
fn the_duration_of_a_stage_includes_what_it_computed_before_it_resumed() {
    let sealed = Sealed::with(
        "\
name: p
stages:
  train:
    kind: command
    with:
      shell: \"if test $$MODE = die; then sleep 0.1; echo half > {checkpoints}/state; exit 9; fi; echo done > {outputs.o}\"
      pass_env: [MODE]
      outputs: { o: o.txt }
",
    );
    assert_eq!(run(&sealed, "die", &[]).code, 1);
    let folder = sealed.list("cache/checkpoints-v1").remove(0);
    let spent = format!("cache/checkpoints-v1/{folder}/spent");
    let first: f64 = sealed.read(&spent).trim().parse().unwrap();
    assert!(first > 0.05, "{first}");
    // A second attempt adds to it, and the result has the sum.
    sealed.write(&spent, "1000\n");
    assert_eq!(run(&sealed, "die", &[]).code, 1);
    let second: f64 = sealed.read(&spent).trim().parse().unwrap();
    assert!(second > 1000.05, "{second}");
    assert_eq!(run(&sealed, "go", &[]).code, 0);
    let shown: serde_json::Value = serde_json::from_str(&sealed.run_ok("show p.yaml train --json")).unwrap();
    assert!(shown[0]["seconds"].as_f64().unwrap() > second, "{shown}");
    // Without the checkpoint, nothing of it counts.
    assert_eq!(run(&sealed, "go", &["--force", "train"]).code, 0);
    let shown: serde_json::Value = serde_json::from_str(&sealed.run_ok("show p.yaml train --json")).unwrap();
    assert!(shown[0]["seconds"].as_f64().unwrap() < 1000.0, "{shown}");
}

#[test]
fn a_forced_stage_that_fails_did_not_resume_unless_it_is_tried_again() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  a: { kind: count, with: { to: 5, at: 3, mishap: fail } }\n  b: { kind: count, retries: { times: 1, pause: 1s }, with: { to: 6, at: 3, mishap: fail } }\n",
    );
    let failures = |args: &str| -> Vec<bool> {
        let events = sealed.events(&format!("--checkpoint-every 0.000001{args}"));
        let of = |stage: &str| {
            events.iter().find(|event| event["event"] == "failed" && event["stage"] == stage).unwrap()
        };
        ["a", "b"].map(|stage| of(stage)["error"].as_str().unwrap().contains("`run --force ")).into()
    };
    assert_eq!(failures(""), [false, true], "the first try leaves a checkpoint");
    assert_eq!(failures(""), [true, true]);
    assert_eq!(failures(" --force a --force b"), [false, true]);
}

#[test]
fn a_checkpoint_is_not_removed_while_a_dying_stage_may_write_it() {
    let sealed =
        Sealed::with("name: p\nstages:\n  a: { kind: count, with: { to: 5, at: 3, mishap: fail } }\n");
    sealed.run("run p.yaml --checkpoint-every 0.000001");
    let folder = sealed.path("cache/checkpoints-v1");
    let folder = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path();
    let state = folder.join("files/state.json");
    std::fs::write(&state, "garbage").unwrap();
    let dying = Lock::acquire(&folder.join("lock")).unwrap();
    let mut engine = sealed.command("run p.yaml --json --force a");
    let mut engine = engine.stdout(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(engine.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(said.any(|line| line.contains("\"started\"")));
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(std::fs::read_to_string(&state).unwrap(), "garbage");
    drop(dying);
    let events = lines(&said.collect::<Vec<_>>().join("\n"));
    let failed = events.iter().find(|event| event["event"] == "failed").unwrap();
    assert_eq!(failed["error"], "fails as configured at 3", "it started without the garbage");
    engine.wait().unwrap();
}

/// The checkpoints in the cache, by their file name.
fn states(sealed: &Sealed, name: &str) -> Vec<std::path::PathBuf> {
    let folder = sealed.path("cache/checkpoints-v1");
    let files = if folder.exists() { crate::lab::files_below(&folder) } else { Vec::new() };
    files.iter().filter(|file| file.ends_with(name)).map(|file| folder.join(file)).collect()
}

#[test]
fn a_job_that_is_under_way_keeps_its_checkpoint_and_another_starts_without() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  a: { kind: command, with: { shell: \"touch {checkpoints}/here; sleep 5; test -e {checkpoints}/here; echo > {outputs.o}\", outputs: { o: o } } }\n  b: { kind: count, with: { to: 5, at: 3, mishap: fail } }\n",
    );
    let queue = sealed.path("queue");
    sealed.write("dril-pipe.toml", &pbs(&queue, ""));
    let engine = |args: &str| {
        let args = format!("run p.yaml --executor pbs --checkpoint-every 0.000001 --json {args}");
        let mut command = sealed.command(&args);
        command.env("PATH", "/usr/bin:/bin");
        command
    };
    assert_eq!(ended(engine("b")).code, 1);
    let [broken] = states(&sealed, "state.json").try_into().unwrap();
    std::fs::write(&broken, "garbage").unwrap();
    let mut left = engine("--detach a").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    until("the job has saved a checkpoint", || !states(&sealed, "here").is_empty());
    signal(&left, "INT");
    left.wait().unwrap();
    assert_eq!(submitted(&queue), 2);
    let events = lines(&ended(engine("--force a --force b")).stdout);
    let of = |name: &str| events.iter().find(|event| event["event"] == name).unwrap();
    let error = of("failed")["error"].as_str().unwrap();
    assert!(of("failed")["stage"] == "b" && error.ends_with("fails as configured at 3"), "{events:?}");
    assert_eq!(of("ran")["stage"], "a", "{events:?}");
    assert_eq!(submitted(&queue), 3, "only `b` has another job");
}
