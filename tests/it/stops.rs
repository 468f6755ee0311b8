//! How a program is asked to stop, and what counts as its result then.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::programs::run;
use crate::sealed::{Sealed, lines, signal, until};

/// Writes twelve rounds in more than a second, and exits with 0 wherever it is when it is asked to stop.
fn polite(limits: &str) -> Sealed {
    Sealed::with(&format!(
        "name: p
stages:
  s:
    kind: command
{limits}    with:
      shell: |
        trap 'exit 0' TERM
        for i in 1 2 3 4 5 6 7 8 9 10 11 12; do
          echo \"round $$i\" >> {{outputs.t}}; : > {{checkpoints}}/began; sleep 0.15
        done
      outputs: {{ t: {{ type: table, path: t.csv }} }}
"
    ))
}

/// An engine whose stage has noted that it began.
pub fn started(sealed: &Sealed) -> Child {
    let mut command = sealed.command("run p.yaml");
    command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null());
    let engine = command.spawn().unwrap();
    until("it runs", || {
        let cache = sealed.path("cache");
        cache.exists() && crate::lab::files_below(&cache).iter().any(|file| file.ends_with("files/began"))
    });
    engine
}

#[test]
fn what_a_program_wrote_until_it_was_interrupted_is_no_result_even_if_it_exits_with_0() {
    let sealed = polite("");
    let mut engine = started(&sealed);
    signal(&engine, "INT");
    assert_eq!(engine.wait().unwrap().code(), Some(130));
    let ended = run(&sealed, &["run", "p.yaml"]);
    assert!(ended.code == 0 && ended.stdout.contains("done: 1 ran"), "{ended:?}");
    assert_eq!(sealed.read("results/p-default/s.csv").lines().count(), 12);
}

#[test]
fn what_a_program_wrote_until_its_timeout_is_no_result_even_if_it_exits_with_0() {
    let sealed = polite("    timeout: 0.5s\n");
    let ended = run(&sealed, &["run", "p.yaml", "--json"]);
    assert_eq!(ended.code, 1, "{ended:?}");
    let failed = lines(&ended.stdout).into_iter().find(|event| event["event"] == "failed").unwrap();
    assert_eq!(failed["cause"], "timeout", "{failed}");
    let ended = run(&sealed, &["run", "p.yaml", "--json"]);
    assert_eq!(ended.code, 1, "nothing is cached: {ended:?}");
}

#[test]
fn a_program_that_asks_at_the_terminal_fails_at_once() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  s: { kind: command, with: { shell: \"read -r answer < /dev/tty; echo $$answer > {outputs.t}\", outputs: { t: t } } }\n",
    );
    let mut command = Command::new("python3");
    let text = "import os, pty, sys; sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))";
    command.args(["-c", text]).arg(crate::sealed::program()).args(["run", "p.yaml"]);
    command.current_dir(sealed.path(".")).stdin(Stdio::null());
    let mut engine = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    while engine.try_wait().unwrap().is_none() && began.elapsed() < Duration::from_secs(15) {
        std::thread::sleep(Duration::from_millis(20));
    }
    let ended = engine.try_wait().unwrap();
    let _ = engine.kill();
    assert_eq!(engine.wait().unwrap().code().filter(|_| ended.is_some()), Some(1));
    let log = sealed.run("log s").stdout;
    assert!(log.contains("/dev/tty"), "{log}");
}

#[test]
fn a_suspended_program_is_continued_so_that_it_can_stop() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  s: { kind: command, with: { shell: \"trap 'exit 3' TERM; : > {checkpoints}/began; kill -STOP $$$$; : {outputs.t}\", outputs: { t: t } } }\n",
    );
    let mut engine = started(&sealed);
    // It stops a moment after it said that it began.
    std::thread::sleep(Duration::from_millis(300));
    let began = Instant::now();
    signal(&engine, "INT");
    assert_eq!(engine.wait().unwrap().code(), Some(130));
    assert!(began.elapsed() < Duration::from_secs(15), "it is not waited for until it is killed");
}

#[test]
fn while_a_stage_waits_for_its_retry_others_run() {
    let sealed = Sealed::with(
        "name: p
stages:
  a: { kind: command, retries: { times: 1, pause: 3s }, resources: { gpu: 1 }, with: { shell: \"test -e {checkpoints}/again || { : > {checkpoints}/again; exit 1; }; : > {outputs.t}\", outputs: { t: t } } }
  b: { kind: command, resources: { gpu: 1 }, with: { shell: ': > {outputs.t}', outputs: { t: t } } }
",
    );
    let ended = run(&sealed, &["run", "p.yaml", "--json", "-j1", "--resources", "gpu=1"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    let events = lines(&ended.stdout);
    let at = |event: &str, stage: &str| {
        let is_it = |one: &serde_json::Value| one["event"] == event && one["stage"] == stage;
        events.iter().position(is_it).unwrap_or_else(|| panic!("no {event} of {stage}: {events:?}"))
    };
    assert!(at("retrying", "a") < at("started", "b"), "{events:?}");
    assert!(at("ran", "b") < at("ran", "a"), "{events:?}");
    assert_eq!(events.iter().filter(|event| event["event"] == "started" && event["stage"] == "a").count(), 1);
}

#[test]
fn a_pause_before_a_retry_ends_with_the_run() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  s: { kind: command, retries: { times: 1, pause: 60s }, with: { shell: ': > {checkpoints}/began; exit 1; : {outputs.t}', outputs: { t: t } } }\n",
    );
    let mut engine = started(&sealed);
    std::thread::sleep(Duration::from_millis(500));
    let began = Instant::now();
    signal(&engine, "INT");
    assert_eq!(engine.wait().unwrap().code(), Some(130));
    assert!(began.elapsed() < Duration::from_secs(10));
}
