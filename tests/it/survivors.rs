//! Nothing that a stage started outlives it: however it left, however the stage and the engine end.

use std::process::{Command, Stdio};
use std::time::Duration;

use crate::group::Group;
use crate::programs::run;
use crate::sealed::{Sealed, signal, until};

/// Ways in which a program starts another one that is not in its process group; each notes its number in `PIDS`.
const WAYS: [&str; 4] = [
    "setsid sh -c 'echo $$$$ >> PIDS; exec sleep 300' &",
    "setsid env -i sh -c 'echo $$$$ >> PIDS; exec sleep 300' < /dev/null > /dev/null 2>&1 &",
    // A daemon as it should be: its own session, its parent gone, no open files, another folder, an empty environment.
    "python3 -c \"import os, sys
    if os.fork(): sys.exit()
    os.setsid()
    if os.fork(): sys.exit()
    os.chdir('/'); os.closerange(0, 64)
    f = os.open('PIDS', os.O_CREAT | os.O_WRONLY | os.O_APPEND); os.write(f, b'%d\\\\n' % os.getpid()); os.close(f)
    os.execve('/bin/sleep', ['sleep', '300'], {})\"",
    // One that keeps starting others.
    "setsid sh -c 'while :; do sh -c \"echo \\$$$$ >> PIDS; exec sleep 300\" & sleep 0.02; done' &",
];

fn sealed(way: &str, then: &str, more: &str) -> Sealed {
    let sealed = Sealed::new();
    let pids = sealed.path("pids").display().to_string();
    let way = way.replace("\n    ", "\n          ");
    sealed.write(
        "p.yaml",
        &format!(
            "name: p\nstages:\n  s:\n    kind: command\n{more}    with:\n      outputs: {{ t: {{ type: table, path: t.csv }} }}\n      shell: |\n          {}\n          while [ ! -s {pids} ]; do sleep 0.01; done\n          {then}\n",
            way.replace("PIDS", &pids)
        ),
    );
    sealed
}

fn pids(sealed: &Sealed) -> Vec<String> {
    let text = std::fs::read_to_string(sealed.path("pids")).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

fn is_alive(pid: &String) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.contains("sleep") && !stat.contains(") Z ")
}

#[test]
fn what_a_stage_started_is_gone_with_it_whether_it_succeeds_fails_or_takes_too_long() {
    for way in WAYS {
        for (then, more, code) in [
            ("echo x > {outputs.t}", "", 0),
            ("exit 3", "", 1),
            ("sleep 60; : {outputs.t}", "    timeout: 2s\n", 1),
        ] {
            let sealed = sealed(way, then, more);
            let ended = run(&sealed, &["run", "p.yaml"]);
            assert_eq!(ended.code, code, "{way}, {then}: {ended:?}");
            let pids = pids(&sealed);
            assert!(!pids.is_empty());
            assert!(!pids.iter().any(is_alive), "{way}, {then}: it is alive");
        }
    }
}

#[test]
fn what_a_stage_started_is_gone_soon_after_its_engine_was_interrupted_twice_or_killed() {
    for (way, signals) in [(WAYS[0], ["INT", "INT"]), (WAYS[0], ["KILL", ""]), (WAYS[3], ["KILL", ""])] {
        let sealed = sealed(way, "trap '' TERM; while :; do sleep 1; done; : {outputs.t}", "");
        let mut command = sealed.command("run p.yaml");
        command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null());
        let mut engine = command.spawn().unwrap();
        until("it runs", || !pids(&sealed).is_empty());
        for name in signals.into_iter().filter(|name| !name.is_empty()) {
            signal(&engine, name);
            std::thread::sleep(Duration::from_millis(300));
        }
        engine.wait().unwrap();
        until("what it started is gone", || !pids(&sealed).iter().any(is_alive));
        std::thread::sleep(Duration::from_millis(200));
        assert!(!pids(&sealed).iter().any(is_alive), "{signals:?}");
    }
}

#[test]
fn leftovers_of_one_stage_are_distinguished_from_what_another_needs() {
    let sealed = Sealed::new();
    let pids = sealed.path("pids").display().to_string();
    sealed.write(
        "p.yaml",
        &format!(
            "name: p
stages:
  needs:
    kind: command
    with:
      shell: |
          setsid sh -c 'sleep 1.5; echo served > served' < /dev/null > /dev/null 2>&1 &
          for i in 1 2 3 4 5 6 7 8 9 10; do [ -e served ] || sleep 0.3; done
          cp served {{outputs.t}}
      outputs: {{ t: {{ type: table, path: t.csv }} }}
  leaves:
    kind: command
    with: {{ shell: \"setsid sh -c 'echo $$$$ > {pids}; exec sleep 300' & sleep 0.5; : > {{outputs.t}}\", outputs: {{ t: t }} }}
"
        ),
    );
    let ended = run(&sealed, &["run", "p.yaml", "-j2"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    assert_eq!(sealed.read("results/p-default/needs.csv"), "served\n");
    assert!(!self::pids(&sealed).iter().any(is_alive));
}

#[test]
fn an_output_that_is_held_open_or_has_another_name_cannot_be_changed_in_the_store() {
    let sealed = Sealed::new();
    let elsewhere = sealed.path("elsewhere").display().to_string();
    sealed.write(
        "p.yaml",
        &format!(
            "name: p
stages:
  held:
    kind: command
    with:
      shell: \"echo whole > {{outputs.t}}; echo part > {{outputs.u}}; ln {{outputs.u}} {elsewhere}; setsid sh -c 'sleep 1; echo late; sleep 300' >> {{outputs.t}} &\"
      outputs: {{ t: t, u: u }}
  reads:
    kind: command
    with: {{ shell: \"sleep 1.5; cat {{inputs.t}} {{inputs.u}} > {{outputs.t}}\", outputs: {{ t: {{ type: table, path: t.csv }} }} }}
    inputs: {{ t: held.t, u: held.u }}
"
        ),
    );
    let ended = run(&sealed, &["run", "p.yaml"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    assert_eq!(sealed.read("results/p-default/reads.csv"), "whole\npart\n");
    std::fs::set_permissions(&elsewhere, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    sealed.write("elsewhere", "overwritten");
    assert_eq!(sealed.run("cache verify").code, 0);
}

#[test]
fn a_line_that_is_dropped_saves_a_checkpoint_and_a_run_under_nohup_goes_on() {
    let text = "\
name: p
stages:
  s:
    kind: command
    with:
      shell: |
        if [ -e {checkpoints}/saved ]; then cp {checkpoints}/saved {outputs.t}; exit 0; fi
        trap 'echo saved > {checkpoints}/saved; exit 75' TERM
        : > {checkpoints}/runs; for i in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do sleep 0.1; done
        echo undisturbed > {outputs.t}
      outputs: { t: { type: table, path: t.csv } }
";
    for (before, expected) in [("", "saved\n"), ("trap '' HUP; ", "undisturbed\n")] {
        let sealed = Sealed::with(text);
        let program = crate::sealed::program().display().to_string();
        let mut command = Command::new("sh");
        command.args(["-c", &format!("{before}exec {program} run p.yaml")]).current_dir(sealed.path("."));
        command.stdout(Stdio::null()).stderr(Stdio::null()).stdin(Stdio::null());
        let mut engine = command.spawn().unwrap();
        let runs = || {
            sealed.path("cache").exists()
                && crate::lab::files_below(&sealed.path("cache"))
                    .iter()
                    .any(|file| file.ends_with("files/runs"))
        };
        until("it runs", runs);
        // A terminal that goes away says so more than once.
        signal(&engine, "HUP");
        std::thread::sleep(Duration::from_millis(50));
        signal(&engine, "HUP");
        let status = engine.wait().unwrap();
        if before.is_empty() {
            assert_eq!(status.code(), Some(130));
            assert_eq!(run(&sealed, &["run", "p.yaml"]).code, 0);
        }
        assert_eq!(sealed.read("results/p-default/s.csv"), expected);
    }
}

#[test]
fn two_users_of_a_group_share_a_store() {
    let pipeline = "name: p\nparams: { x: 1 }\nstages:\n  s: { kind: command, with: { shell: \"mkdir -p {outputs.d}/sub; echo ${x} > {outputs.d}/sub/x\", outputs: { d: d/ } } }\n  t: { kind: command, with: { shell: \"cat {inputs.d}/sub/x > {outputs.t}\", outputs: { t: { type: table, path: t.csv } } }, inputs: { d: s } }\n";
    let Some(group) = Group::with(pipeline) else { return };
    assert_eq!(group.run(1001, "002", "run p.yaml").code, 0);
    assert!(group.run(1002, "002", "run p.yaml").stdout.contains("0 stages executed"));
    assert_eq!(group.run(1002, "002", "run p.yaml --set params.x=2").code, 0);
    assert!(group.run(1001, "002", "run p.yaml --set params.x=2").stdout.contains("0 stages executed"));
    assert_eq!(group.run(1002, "002", "cache gc --max-size 0K").code, 0);
    assert_eq!(group.run(1001, "002", "cache verify").code, 0);
    // Without the group's rights what is there is served, and new work is an error with path and reason.
    std::fs::remove_dir_all(group.cache()).unwrap();
    assert_eq!(group.run(1001, "022", "run p.yaml").code, 0);
    assert!(group.run(1002, "022", "run p.yaml").stdout.contains("0 stages executed"));
    let refused = group.run(1002, "022", "run p.yaml --set params.x=2");
    assert_eq!(refused.code, 4, "{refused:?}");
    assert!(
        refused.stderr.contains("group/cache") && refused.stderr.contains("Permission denied"),
        "{}",
        refused.stderr
    );
}
