//! Retries, timeouts and memory limits: what they do, what is reported about them, and that no key knows them.

use std::time::{Duration, Instant};

use serde_json::Value;

use crate::sealed::{Ended, Sealed, lines};

/// One stage that counts, with these limits, and its parameters.
fn sealed(limits: &str, with: &str) -> Sealed {
    Sealed::with(&format!("name: x\nstages:\n  a:\n    kind: count\n{limits}    with: {{ {with} }}\n"))
}

fn failed(ended: &Ended) -> Value {
    lines(&ended.stdout)
        .into_iter()
        .find(|event| event["event"] == "failed")
        .unwrap_or_else(|| panic!("{ended:?}"))
}

#[test]
fn a_stage_that_fails_is_tried_again_as_often_as_it_may() {
    let sealed = sealed("    retries: { times: 2, pause: 0.05s }\n", "mishap: flaky, times: 2");
    let events = sealed.events("--jobs 1");
    let again: Vec<&Value> = events.iter().filter(|event| event["event"] == "retrying").collect();
    assert_eq!(again.len(), 2, "{events:?}");
    assert_eq!((&again[0]["retry"], &again[0]["of"]), (&1.into(), &2.into()));
    assert_eq!(again[0]["error"], "try 1 is none of the good ones");
    assert!(again[1]["seconds"].as_f64() > again[0]["seconds"].as_f64(), "pauses grow");
    assert_eq!(events.last().unwrap()["ran"], 1);
}

#[test]
fn after_the_last_retry_the_last_error_is_reported() {
    let sealed = sealed("    retries: { times: 1, pause: 0.01s }\n", "mishap: flaky, times: 7");
    let ended = sealed.run("run p.yaml");
    assert_eq!(ended.code, 1, "{ended:?}");
    assert!(ended.stdout.contains("retry   a in 0.01 s (1 of 1): try 1 is none"), "{}", ended.stdout);
    assert!(ended.stderr.contains("`a` failed: try 2 is none of the good ones"), "{}", ended.stderr);
}

#[test]
fn a_stage_that_takes_too_long_may_save_its_state_and_goes_on_from_there() {
    let sealed =
        sealed("    timeout: 0.4s\n    retries: { times: 40, pause: 0.01s }\n", "to: 30, step_millis: 40");
    let began = Instant::now();
    let events = sealed.events("--jobs 1");
    assert_eq!(events.last().unwrap()["ran"], 1, "{events:?}");
    assert!(events.iter().any(|event| event["event"] == "retrying"), "1.2 s of work, 0.4 s a try");
    assert!(began.elapsed() < Duration::from_secs(60));
}

#[test]
fn a_timeout_is_distinguished_from_a_failure() {
    let sealed = sealed("    timeout: 0.2s\n", "to: 1000, step_millis: 20");
    let ended = sealed.run("run p.yaml --json");
    assert_eq!(ended.code, 1, "{ended:?}");
    let event = failed(&ended);
    assert_eq!(event["cause"], "timeout");
    assert_eq!(event["error"], "it ran longer than its `timeout` of 0.2 s");
}

#[test]
#[cfg(target_os = "linux")]
fn a_stage_over_its_memory_limit_is_killed_with_a_cause_of_its_own() {
    let sealed = sealed("    memory: 150M\n", "mishap: eat");
    let began = Instant::now();
    let ended = sealed.run("run p.yaml --json");
    assert_eq!(ended.code, 1, "{ended:?}");
    assert!(began.elapsed() < Duration::from_secs(15), "it is killed, not waited for");
    let event = failed(&ended);
    assert_eq!(event["cause"], "memory", "{event}");
    let error = event["error"].as_str().unwrap();
    assert!(error.contains("more than its limit of 150 MiB (`memory`)"), "{error}");
}

#[test]
fn limits_enter_no_key() {
    let sealed = sealed("", "to: 2");
    sealed.run_ok("run p.yaml");
    sealed.write(
        "p.yaml",
        "name: x\nstages:\n  a:\n    kind: count\n    retries: 3\n    timeout: 2h\n    memory: 8G\n    with: { to: 2 }\n",
    );
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"));
}

#[test]
fn mistakes_in_limits_are_reported_all_at_once_with_their_place() {
    let text = "    retries: many\n    timeout: soon\n    memory: 0\n";
    let ended = sealed(text, "to: 2").run("plan p.yaml");
    assert_eq!(ended.code, 3, "{ended:?}");
    for part in [
        "p.yaml:5:14",
        "p.yaml:6:14",
        "p.yaml:7:13",
        "expected a time with its unit",
        "expected a size with its unit",
    ] {
        assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
    }
    let text = "    retries: { times: 1, pause: 2 }\n    timeout: 30\n    memory: 500\n";
    let ended = sealed(text, "to: 2").run("plan p.yaml");
    assert_eq!(ended.code, 3, "{ended:?}");
    for part in [
        "`pause` is the number 2, expected",
        "`timeout` is the number 30, expected",
        "`memory` is the number 500, expected",
    ] {
        assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
    }
}

#[test]
fn a_resource_that_no_stage_uses_is_warned_of_with_those_that_there_are() {
    let sealed = Sealed::with(
        "name: p\nstages: { a: { kind: emit, with: { text: a }, resources: { gpu: 1, licence: 1 } } }\n",
    );
    let expected = "warning: `--resources license=2`: no stage uses this resource\n  \
                    = hint: did you mean `licence`? the resources of the stages are `gpu`, `licence`\n";
    let ended = sealed.run("run p.yaml --resources gpu=1,license=2");
    assert_eq!((ended.code, &*ended.stderr), (0, expected));
}
