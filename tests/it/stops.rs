//! How a program is asked to stop, and what counts as its result then.

use std::process::Stdio;

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

#[test]
fn what_a_program_wrote_until_it_was_interrupted_is_no_result_even_if_it_exits_with_0() {
    let sealed = polite("");
    let mut command = sealed.command("run p.yaml");
    command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null());
    let mut engine = command.spawn().unwrap();
    until("it runs", || {
        let cache = sealed.path("cache");
        cache.exists() && crate::lab::files_below(&cache).iter().any(|file| file.ends_with("files/began"))
    });
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
