//! Any program as a stage: what it sees, what becomes of what it leaves, and what makes it run again.

use std::process::Stdio;

use serde_json::Value;

use crate::sealed::{Sealed, ended, lines, signal, until};

fn of<'a>(events: &'a [Value], name: &str) -> Vec<&'a str> {
    let found = events.iter().filter(|event| event["event"] == name);
    found.map(|event| event["stage"].as_str().unwrap()).collect()
}

/// The error of the only stage that failed.
fn error(sealed: &Sealed, args: &str) -> String {
    let events = sealed.events(&format!("--jobs 2{args}"));
    let errors: Vec<&str> = events.iter().filter_map(|event| event["error"].as_str()).collect();
    let [error] = errors.as_slice() else { panic!("{events:?}") };
    (*error).to_owned()
}

/// A pipeline of one command `c` with these parameters.
fn one(with: &str) -> Sealed {
    Sealed::with(&format!("name: p\nstages:\n  c:\n    kind: command\n    with: {with}\n"))
}

const BETWEEN: &str = "\
name: between
stages:
  say: { kind: emit, with: { text: \"b a \" } }
  sort:
    kind: command
    with:
      run: [python3, \"{inputs.script}\", \"{inputs.words}\", --out, \"{outputs.sorted}\", 3]
      outputs: { sorted: { type: demonstrations, path: sorted.txt } }
    inputs: { script: { file: sort.py }, words: say }
  count: { kind: count, with: { to: 1 }, inputs: { start: sort } }
  gather: { kind: concat, inputs: { parts: [sort, count.count] } }
";

const SORT: &str = "\
import sys
words = sorted(open(sys.argv[1]).read().split())
open(sys.argv[3], 'w').write(' '.join(words * int(sys.argv[4])))
print('sorted', len(words))
";

#[test]
fn a_script_stands_between_two_built_in_stages() {
    let sealed = Sealed::with(BETWEEN);
    sealed.write("sort.py", SORT);
    let mut command = sealed.command("run p.yaml --json");
    command.env("PATH", std::env::var_os("PATH").unwrap());
    let events = lines(&ended(command).stdout);
    assert_eq!(of(&events, "ran").len(), 4, "{events:?}");
    assert!(sealed.read("results/between-default/gather.md").starts_with("a b a b a b"));
    let again = sealed.run_ok("run p.yaml");
    assert!(again.contains("0 stages executed, all 4 cached"), "{again}");
    sealed.write("sort.py", &SORT.replace("sorted(", "sorted( "));
    let planned = sealed.run_ok("plan p.yaml");
    assert!(
        planned.contains("sort") && planned.contains("script") && planned.contains("1 stage to run"),
        "{planned}"
    );
}

#[test]
fn outputs_that_are_missing_or_undeclared_fail_the_stage_all_at_once() {
    let sealed =
        one("{ shell: \"echo x > outputs/c.txt; mkdir d; : > e\", outputs: { a: a.txt, d: d, f: f/ } }");
    let said = error(&sealed, "");
    assert_eq!(
        said,
        "output `a` was not written, expected a file at `a.txt`; output `d` is a folder, expected a file at `d`; \
         output `f` was not written, expected a folder at `f`; `outputs/c.txt` is not a declared output, and `outputs/` \
         is only for these: declare it, or write it elsewhere in the working folder, which is removed"
    );
    assert!(sealed.list("cache/records-v1").is_empty());
}

#[test]
fn scores_that_cannot_be_read_fail_the_stage_that_wrote_them() {
    let with = |rows: &str| {
        format!(
            "{{ shell: \"printf 'episode,seed,score,steps,outcome\\r\\n0,1,0.5,10,finished\\r\\n{rows}' > s.csv\", \
             outputs: {{ s: {{ type: scores, path: s.csv }} }} }}"
        )
    };
    let sealed = one(&with("1,2,high,10,finished"));
    assert_eq!(
        error(&sealed, ""),
        "output `s`, whose type is `scores`: not a table of scores: line 3 in column `score`: invalid float literal"
    );
    assert!(sealed.list("cache/records-v1").is_empty());
    assert!(one(&with("1,2,0.25,10,failed")).run_ok("run p.yaml").contains("1 ran"));
}

#[test]
fn a_failure_names_the_exit_code_and_the_log_has_what_was_printed() {
    let sealed = one("{ shell: \"echo to out; echo to err >&2; exit 3\", outputs: { a: a } }");
    let events = sealed.events("--jobs 2");
    let failed = events.iter().find(|event| event["event"] == "failed").unwrap();
    assert_eq!(failed["error"], "the shell ended with exit code 3; see its log");
    let log = std::fs::read_to_string(sealed.path(failed["log"].as_str().unwrap())).unwrap();
    assert!(log.contains("to out\n") && log.contains("to err\n"), "{log}");
    let sealed = one("{ run: [no-such-program, x], outputs: { a: a } }");
    assert!(error(&sealed, "").starts_with("cannot start `no-such-program`: "), "{}", error(&sealed, ""));
    let sealed = one("{ shell: \"false; echo never > a\", outputs: { a: a } }");
    assert!(error(&sealed, "").contains("exit code 1"), "a shell stops at the first command that fails");
    let sealed = one("{ shell: \"kill -SEGV $$$$\", outputs: { a: a } }");
    assert!(error(&sealed, "").contains("signal 11"));
}

#[test]
fn it_sees_the_variables_that_are_named_and_they_enter_its_key() {
    let with = "{ shell: \"env | cut -d= -f1 | sort > {outputs.names}; echo $${A-unset} $$B $${C-unset} > v\", \
                outputs: { names: {}, v: { type: table, path: v } }, env: { A: ~, B: 2 }, pass_env: [C] }";
    let sealed = one(with);
    let run = |a: Option<&str>, c: &str| {
        let mut command = sealed.command("run p.yaml --json");
        command.env("PATH", "/usr/bin:/bin").env("C", c).env("SECRET", "1");
        a.map(|a| command.env("A", a));
        let events = lines(&ended(command).stdout);
        (of(&events, "ran").len(), sealed.read("results/p-default/c.csv"))
    };
    assert_eq!(run(Some("1"), "x"), (1, "1 2 x\n".to_owned()));
    assert_eq!(
        run(Some("1"), "other"),
        (0, "1 2 x\n".to_owned()),
        "what is only passed does not enter the key"
    );
    assert_eq!(run(Some("5"), "y"), (1, "5 2 y\n".to_owned()));
    assert_eq!(run(None, "z"), (1, "unset 2 z\n".to_owned()));
    let blobs = crate::lab::files_below(&sealed.path("cache/blobs-v1"));
    let texts: Vec<String> =
        blobs.iter().map(|blob| sealed.read(&format!("cache/blobs-v1/{blob}"))).collect();
    assert!(texts.iter().any(|text| text.contains("\nLC_ALL\n") && text.contains("TMPDIR")), "{texts:?}");
    assert!(texts.iter().all(|text| !text.contains("SECRET") && !text.contains("CACHE")), "{texts:?}");
    let mut plan = sealed.command("plan p.yaml");
    plan.env("A", "7");
    assert!(ended(plan).stdout.contains("env.A: "));
}

#[test]
fn a_value_from_the_environment_is_no_template() {
    let with =
        "{ shell: \"printf '%s' \\\"$$A\\\" > v\", outputs: { v: { type: table, path: v } }, env: [A] }";
    let sealed = one(with);
    for value in [
        "{outputs.v}",
        "{seed}",
        "{inputs.x}",
        "{input.x} {speed}",
        "{checkpoints}{seed}",
        "{{seed}}",
        "{{{seed}",
        "${seed}",
        "$x {\"a\": {}}",
    ] {
        let mut command = sealed.command("run p.yaml --json");
        let events = lines(
            &ended({
                command.env("PATH", "/usr/bin:/bin").env("A", value);
                command
            })
            .stdout,
        );
        assert_eq!(of(&events, "ran").len(), 1, "{value}: {events:?}");
        assert_eq!(sealed.read("results/p-default/c.csv"), value);
    }
}

#[test]
fn braces_that_belong_to_a_shell_or_another_program_stay_as_they_are() {
    let script = "for seed in 1 2; do echo \\\"$${seed} {speed} {{input.x}} {{seed}}\\\"; done > v";
    let sealed = one(&format!("{{ shell: \"{script}\", outputs: {{ v: {{ type: table, path: v }} }} }}"));
    sealed.run_ok("run p.yaml --set seed=7");
    assert_eq!(
        sealed.read("results/p-default/c.csv"),
        "1 {speed} {input.x} {seed}\n2 {speed} {input.x} {seed}\n"
    );
    assert!(sealed.run_ok("plan p.yaml --set seed=8").contains("nothing to run"), "it has no seed");
}

const FOLDERS: &str = "\
name: folders
stages:
  make:
    kind: command
    with:
      shell: \"mkdir -p m/sub; echo one > m/sub/a; echo two > 'm/b c'; chmod +x m/sub/a; mkdir m/empty\"
      outputs: { made: m/ }
  list:
    kind: command
    with:
      shell: \"cd {inputs.made}; find . | sort; test -x sub/a; cat sub/a 'b c' > $$OLDPWD/l\"
      outputs: { l: { type: table, path: l } }
    inputs: { made: make }
";

#[test]
fn a_folder_goes_from_stage_to_stage_with_all_that_is_in_it() {
    let sealed = Sealed::with(FOLDERS);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/folders-default/list.csv"), "one\ntwo\n");
    assert!(sealed.run_ok("run p.yaml").contains("all 2 cached"));
    // A file of the folder that is lost is made again, and what reads it is not.
    let blobs = crate::lab::files_below(&sealed.path("cache/blobs-v1"));
    let two = blobs.iter().find(|blob| sealed.read(&format!("cache/blobs-v1/{blob}")) == "two\n").unwrap();
    std::fs::remove_file(sealed.path(&format!("cache/blobs-v1/{two}"))).unwrap();
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("1 ran, 1 cached"), "{said}");
}

#[test]
fn a_checkpoint_outlives_a_failure_and_a_kill() {
    let with = "{ shell: \"if test -e {checkpoints}/half; then cat {checkpoints}/half > a; else echo half > {checkpoints}/new; \
                mv {checkpoints}/new {checkpoints}/half; sleep 60; fi\", outputs: { a: { type: table, path: a } } }";
    let sealed = one(with);
    let mut command = sealed.command("run p.yaml");
    let mut child =
        command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let checkpoint =
        || crate::lab::files_below(&sealed.path("cache")).iter().any(|file| file.ends_with("files/half"));
    until("the checkpoint is there", || sealed.path("cache").exists() && checkpoint());
    signal(&child, "KILL");
    child.wait().unwrap();
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/p-default/c.csv"), "half\n");
    assert!(!checkpoint(), "it is emptied once the stage is done");
}

#[test]
fn a_killed_engine_takes_the_program_and_what_it_started_with_it() {
    let sealed = one("{ shell: \"sleep 300 & echo $$! > {checkpoints}/pid; wait\", outputs: { a: a } }");
    let mut command = sealed.command("run p.yaml");
    let mut child =
        command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut pid = String::new();
    until("the program runs", || {
        let files = if sealed.path("cache").exists() {
            crate::lab::files_below(&sealed.path("cache"))
        } else {
            Vec::new()
        };
        let file = files.into_iter().find(|file| file.ends_with("files/pid"));
        pid = file.map(|file| sealed.read(&format!("cache/{file}")).trim().to_owned()).unwrap_or_default();
        !pid.is_empty()
    });
    signal(&child, "KILL");
    child.wait().unwrap();
    let state = || std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    until("what the program started is gone", || state().is_empty() || state().contains(") Z "));
}

/// Processes of the program under test with this argument whose parent is `parent`.
fn children_with(parent: u32, argument: &str) -> Vec<String> {
    let ids =
        std::fs::read_dir("/proc").unwrap().filter_map(|entry| entry.unwrap().file_name().into_string().ok());
    let is_one = |id: &String| {
        let read = |file: &str| std::fs::read_to_string(format!("/proc/{id}/{file}")).unwrap_or_default();
        let stat = read("stat");
        let above =
            stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1).map(str::to_owned));
        above == Some(parent.to_string()) && read("cmdline").contains(argument)
    };
    ids.filter(|id| id.bytes().all(|byte| byte.is_ascii_digit())).filter(is_one).collect()
}

#[test]
fn a_program_still_dies_with_its_engine_where_the_warden_was_killed_before() {
    let sealed = one("{ shell: \"sleep 300 & echo $$! > {checkpoints}/pid; wait\", outputs: { a: a } }");
    let mut command = sealed.command("run p.yaml");
    command.env("PATH", "/usr/bin:/bin").stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut pid = String::new();
    until("the program runs", || {
        let cache = sealed.path("cache");
        let files = if cache.exists() { crate::lab::files_below(&cache) } else { Vec::new() };
        let file = files.into_iter().find(|file| file.ends_with("files/pid"));
        pid = file.map(|file| sealed.read(&format!("cache/{file}")).trim().to_owned()).unwrap_or_default();
        !pid.is_empty()
    });
    let first = children_with(child.id(), "__warden");
    assert_eq!(first.len(), 1, "{first:?}");
    std::process::Command::new("kill").args(["-KILL", &first[0]]).status().unwrap();
    until("there is another warden", || {
        children_with(child.id(), "__warden").iter().any(|warden| !first.contains(warden))
    });
    // And lists what there is.
    std::thread::sleep(std::time::Duration::from_millis(500));
    signal(&child, "KILL");
    child.wait().unwrap();
    let state = || std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    until("what the program started is gone", || state().is_empty() || state().contains(") Z "));
}

#[test]
fn one_interrupt_stops_it_and_the_next_run_goes_on() {
    let sealed = one("{ shell: \"touch {checkpoints}/here; exec sleep 60\", outputs: { a: a } }");
    let mut command = sealed.command("run p.yaml --json");
    let child =
        command.env("PATH", "/usr/bin:/bin").stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let begun =
        || crate::lab::files_below(&sealed.path("cache")).iter().any(|file| file.ends_with("files/here"));
    until("it runs", || sealed.path("cache").exists() && begun());
    signal(&child, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let events = lines(&String::from_utf8(output.stdout).unwrap());
    assert_eq!(of(&events, "stopped"), ["c"], "{events:?}");
    assert!(begun(), "its checkpoints stay");
}

#[test]
fn the_seed_counts_only_where_the_command_names_it() {
    let sealed = one("{ shell: \"echo {seed} > a\", outputs: { a: { type: table, path: a } } }");
    sealed.run_ok("run p.yaml --set seed=7");
    assert_eq!(sealed.read("results/p-default/c.csv"), "7\n");
    assert!(sealed.run_ok("plan p.yaml --set seed=8").contains("seed: 7 -> 8"));
    let sealed = one("{ shell: \"echo 1 > a\", outputs: { a: a } }");
    sealed.run_ok("run p.yaml --set seed=7");
    assert!(sealed.run_ok("plan p.yaml --set seed=8").contains("nothing to run"));
}

const MANY: &str = "\
name: many
axes: { k: [2, 1] }
stages:
  make: { kind: command, matrix: [k], with: { shell: \"echo ${k} > {outputs.o}\", outputs: { o: {} } } }
  all:
    kind: command
    with:
      shell: \"cat {inputs.parts} inputs.json > {outputs.t}\"
      inputs: { parts: { many: true } }
      outputs: { t: { type: table } }
    inputs: { parts: make }
";

#[test]
fn many_inputs_come_in_the_order_of_the_matrix_with_their_labels() {
    let sealed = Sealed::with(MANY);
    sealed.run_ok("run p.yaml");
    let text = sealed.read("results/many-default/all.csv");
    let listed: Value = serde_json::from_str(text.strip_prefix("2\n1\n").unwrap()).unwrap();
    assert_eq!(listed["parts"][0]["path"], "inputs/parts/0");
    assert_eq!(listed["parts"][1]["labels"]["k"], "1");
}

const SPOILER: &str = "\
name: spoiler
stages:
  say: { kind: emit, with: { text: shared } }
  spoil:
    kind: command
    with: { shell: \"chmod u+w {inputs.i}; echo more >> {inputs.i}; echo x > o\", outputs: { o: o } }
    inputs: { i: say }
";

#[test]
fn an_input_that_was_written_to_fails_the_stage_and_is_whole_in_the_store() {
    let sealed = Sealed::with(SPOILER);
    let said = error(&sealed, "");
    assert!(said.starts_with("the command changed its input `i`"), "{said}");
    let planned = sealed.run_ok("plan p.yaml");
    assert!(planned.contains("1 stage to run, 1 cached"), "{planned}");
    sealed.run_ok("cache verify");
}

#[test]
fn paths_of_a_command_are_short_and_the_same_everywhere() {
    let text = "{ run: [sh, -c, 'echo \"$$*\" > a; pwd -P > b', x, \"{outputs.c}\", \"{checkpoints}\"], \
                outputs: { a: { type: table, path: a }, b: b, c: { path: d/../c } } }";
    assert!(one(text).run("plan p.yaml").stderr.contains("leaves the working folder"));
    let text = text.replace("d/../c", "./d//c.txt").replace("pwd -P > b", "pwd -P > b; echo > d/c.txt");
    let sealed = one(&text);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/p-default/c.csv"), "d/c.txt checkpoints\n");
}
