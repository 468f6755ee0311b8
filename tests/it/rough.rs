//! Programs that are rough with their folders, and limits of the system that stages run into.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::sealed::{Ended, Sealed, ended, signal, until};

/// A command of one stage.
fn with(shell: &str, more: &str) -> Sealed {
    let shell = shell.replace('\n', "\n        ");
    Sealed::with(&format!(
        "name: p\nstages:\n  s:\n    kind: command\n{more}    with:\n      shell: |\n        {shell}\n      outputs: {{ t: {{ type: table, path: t.csv }} }}\n"
    ))
}

/// The program with these arguments, started by a shell that first does something, and as a user whom permissions bind.
pub fn as_user(sealed: &Sealed, first: &str, args: &str) -> Option<Ended> {
    let mut line = String::new();
    if rustix::process::geteuid().is_root() {
        Command::new("setpriv").arg("--version").output().ok()?;
        let program = sealed.path("program");
        if !program.exists() {
            std::fs::copy(crate::sealed::program(), &program).unwrap();
            let mode = std::os::unix::fs::PermissionsExt::from_mode(0o777);
            std::fs::set_permissions(sealed.path("."), mode).unwrap();
        }
        line = "setpriv --reuid=1001 --regid=1001 --clear-groups ./".to_owned();
    } else {
        std::os::unix::fs::symlink(crate::sealed::program(), sealed.path("program")).unwrap_or(());
        line.push_str("./");
    }
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{first}; exec {line}program {args}")]).current_dir(sealed.path("."));
    command.env_clear().env("PATH", "/usr/bin:/bin").stdin(Stdio::null());
    Some(ended(command))
}

/// The short links to the folders of this cache's stages.
fn links(sealed: &Sealed) -> Vec<PathBuf> {
    let folder = sealed.path(".").canonicalize().unwrap();
    let entries = std::fs::read_dir("/tmp").unwrap().filter_map(|entry| Some(entry.ok()?.path()));
    entries.filter(|path| std::fs::read_link(path).is_ok_and(|to| to.starts_with(&folder))).collect()
}

#[test]
fn a_socket_has_room_in_the_folder_for_temporary_files_of_a_program() {
    let sealed = with(
        "python3 -c 'import multiprocessing as m; print(m.Manager().list([7])[0])' > {outputs.t}\nmktemp >&2",
        "",
    );
    let ended = crate::programs::run(&sealed, &["run", "p.yaml"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    assert_eq!(sealed.read("results/p-default/s.csv"), "7\n");
    assert!(links(&sealed).is_empty(), "the link is gone with its stage");
}

#[test]
fn temporary_files_of_a_program_are_in_its_own_folder_and_gone_after_a_kill() {
    let sealed =
        with("touch \"$$TMPDIR/mine\"; test -e mine; : > {checkpoints}/began; sleep 60; : {outputs.t}", "");
    let mut engine = crate::stops::started(&sealed);
    assert_eq!(links(&sealed).len(), 1);
    signal(&engine, "KILL");
    engine.wait().unwrap();
    let text = sealed.read("p.yaml").replace("sleep 60", "sleep 0; echo done > {outputs.t}");
    sealed.write("p.yaml", &text);
    let ended = crate::programs::run(&sealed, &["run", "p.yaml"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    assert!(links(&sealed).is_empty());
}

#[test]
fn an_output_folder_without_write_permission_is_stored_like_any_other() {
    let sealed = Sealed::with(
        "name: p
stages:
  s: { kind: command, with: { shell: \"mkdir -p {outputs.d}/a/b; echo 1 > {outputs.d}/a/b/f; chmod -R a-w outputs\", outputs: { d: outputs/d/ } } }
  r: { kind: command, with: { shell: \"cat {inputs.d}/a/b/f > {outputs.t}\", outputs: { t: { type: table, path: t.csv } } }, inputs: { d: s } }
",
    );
    let Some(ended) = as_user(&sealed, ":", "run p.yaml") else { return };
    assert_eq!(ended.code, 0, "{ended:?}");
    assert_eq!(sealed.read("results/p-default/r.csv"), "1\n");
    assert_eq!(sealed.list("cache/tmp"), ["gate"]);
}

#[test]
fn a_folder_that_its_program_left_without_permissions_or_very_deep_is_removed() {
    for leave in [
        "mkdir -p mod/x/y; touch mod/x/y/f; chmod -R a-w mod",
        "mkdir -p mod/x/y; touch mod/x/y/f; chmod 0 mod/x/y; chmod 0 mod",
        "python3 -c 'import os\nfor i in range(3000): os.mkdir(\"d\"); os.chdir(\"d\")\nopen(\"f\", \"w\")'",
    ] {
        let sealed = with(&format!("{leave}\necho 1 > {{outputs.t}}"), "");
        let Some(ended) = as_user(&sealed, ":", "run p.yaml") else { return };
        assert_eq!(ended.code, 0, "{leave}: {ended:?}");
        assert_eq!(sealed.list("cache/tmp"), ["gate"], "{leave}");
    }
}

#[test]
fn the_links_of_a_killed_engine_are_removed_by_the_next_run_and_by_gc_and_those_of_others_stay() {
    let sealed = with(": > {checkpoints}/began; sleep 60; : > {outputs.t}", "");
    sealed.write("q.yaml", "name: q\nstages:\n  a: { kind: emit, with: { text: a } }\n");
    let start = || {
        let child =
            sealed.command("run p.yaml").env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).spawn().unwrap();
        until("it has a link", || !links(&sealed).is_empty());
        child
    };
    let end = |mut child: std::process::Child| {
        signal(&child, "KILL");
        child.wait().unwrap();
        assert_eq!(links(&sealed).len(), 1, "a killed engine leaves its link");
    };
    for next in ["run q.yaml", "cache gc"] {
        let living = start();
        sealed.run_ok(next);
        assert_eq!(links(&sealed).len(), 1, "{next}: the link of a living engine is gone");
        end(living);
        // The link is kept as long as a dying stage may use it.
        until("the link is gone", || {
            sealed.run_ok(&format!("{next}{}", if next == "run q.yaml" { " --force a" } else { "" }));
            links(&sealed).is_empty()
        });
    }
}

#[test]
fn gc_names_what_it_cannot_remove() {
    let sealed = with("echo 1 > {outputs.t}", "");
    let Some(ended) = as_user(&sealed, ":", "run p.yaml") else { return };
    assert_eq!(ended.code, 0, "{ended:?}");
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let dead = "cache/tmp/20200101-000000-000000000-1";
    sealed.write(&format!("{dead}/of/another/user"), "x");
    sealed.write(&format!("{dead}.lock"), "");
    std::fs::set_permissions(
        sealed.path(&format!("{dead}.lock")),
        std::os::unix::fs::PermissionsExt::from_mode(0o666),
    )
    .unwrap();
    let checkpoint = format!("cache/checkpoints-v1/{}", "ab".repeat(32));
    sealed.write(&format!("{checkpoint}/files/of-another-user"), "x");
    let ended = as_user(&sealed, ":", "cache gc --older-than 0s").unwrap();
    assert_eq!(ended.code, 0, "{ended:?}");
    for left in [dead, &checkpoint] {
        let named = ended.stdout.lines().any(|line| line.contains("could not remove") && line.contains(left));
        assert!(named && sealed.path(left).exists(), "{left}: {}", ended.stdout);
    }
    assert!(ended.stdout.contains("0 folders of checkpoints"), "{}", ended.stdout);
    let json = as_user(&sealed, ":", "cache gc --json").unwrap().stdout;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(json["not_removed"][0]["path"].as_str().unwrap().ends_with(dead), "{json}");
}

#[test]
#[cfg(target_os = "linux")]
fn memory_that_processes_share_counts_once() {
    let fork = |megabytes: &str| {
        with(
            &format!(
                "python3 -c 'import os, time\nb = os.urandom({megabytes} << 20)\nfor _ in range(5):\n    if not os.fork(): time.sleep(2); os._exit(0)\ntime.sleep(2)'\necho 1 > {{outputs.t}}"
            ),
            "    memory: 250M\n",
        )
    };
    let ended = crate::programs::run(&fork("120"), &["run", "p.yaml"]);
    assert_eq!(ended.code, 0, "120 MiB in six processes: {ended:?}");
    let ended = crate::programs::run(&fork("300"), &["run", "p.yaml"]);
    assert!(ended.code == 1 && ended.stderr.contains("more than its limit of 250 MiB"), "{ended:?}");
}

#[test]
fn stages_run_side_by_side_whatever_the_limit_of_open_files_and_have_the_usual_one() {
    let text = "\
name: p
axes: { n: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12] }
stages:
  src: { kind: import, with: { path: src/ } }
  s:
    kind: command
    matrix: [n]
    with: { shell: \": {inputs.src} ${n}; ulimit -Sn > {outputs.t}; sleep 2\", outputs: { t: { type: table, path: t.csv } } }
    inputs: { src: src }
";
    for limit in ["ulimit -Sn 100", "ulimit -n 200"] {
        let sealed = Sealed::with(text);
        for number in 0..40 {
            sealed.write(&format!("src/{number}"), &number.to_string());
        }
        let Some(ended) = as_user(&sealed, limit, "run p.yaml -j 12") else { return };
        assert_eq!(ended.code, 0, "{limit}: {ended:?}");
        let seen = sealed.read("results/p-default/s-7.csv");
        assert!(limit.ends_with(seen.trim()), "{limit}: {seen}");
    }
}
