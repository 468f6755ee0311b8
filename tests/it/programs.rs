//! Programs as they are: they write into their inputs, leave links, fail inside pipes, print without end. None of it poisons
//! the store, loses work or is cut in silence.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;

use crate::sealed::{Ended, Sealed, ended};

/// Runs the program with the usual PATH.
pub fn run(sealed: &Sealed, args: &[&str]) -> Ended {
    let mut command = sealed.command(args[0]);
    command.args(&args[1..]).env("PATH", "/usr/local/bin:/usr/bin:/bin");
    ended(command)
}

fn run_file(sealed: &Sealed, file: &str) -> Ended {
    run(sealed, &["run", file])
}

fn ok(sealed: &Sealed) -> String {
    let ended = run_file(sealed, "p.yaml");
    assert_eq!(ended.code, 0, "{ended:?}");
    ended.stdout
}

/// Every stage that is called `spoil` does something to its inputs, and `look` reads the same ones after it.
const SPOILED: &str = "\
name: p
stages:
  made: { kind: command, with: { shell: \"mkdir -p {outputs.d}/sub; echo first > {outputs.d}/a; echo other > {outputs.d}/sub/b\", outputs: { d: d/ } } }
  one: { kind: command, with: { shell: \"echo first > {outputs.f}\", outputs: { f: f.txt } } }
  spoil:
    kind: command
    with: { shell: \"HOW; echo done > {outputs.t}\", inputs: { d: ~, f: ~ }, outputs: { t: { type: table, path: t.csv } } }
    inputs: { d: made, f: one }
  look:
    kind: command
    with:
      shell: \": {inputs.after}; cat {inputs.d}/a {inputs.d}/sub/b {inputs.f} > {outputs.t}\"
      inputs: { after: { optional: true } }
      outputs: { t: { type: table, path: t.csv } }
    inputs: { d: made, f: one }
";

#[test]
fn what_a_program_does_to_its_inputs_reaches_no_other_stage_and_no_result() {
    for (how, spoilt) in [
        ("chmod u+w {inputs.d}/a; echo more >> {inputs.d}/a", Some("`d/a`")),
        ("chmod -R u+w {inputs.d}/; echo more >> {inputs.d}/sub/b", Some("`d/sub/b`")),
        ("chmod u+w {inputs.f}; echo FIRST > {inputs.f}", Some("`f`")),
        // As many bytes as before, with the time put back.
        (
            "touch -r {inputs.d}/a t; chmod u+w {inputs.d}/a; printf FIRST | dd of={inputs.d}/a conv=notrunc; touch -r t {inputs.d}/a",
            Some("`d/a`"),
        ),
        ("chmod u+w {inputs.f}; : > {inputs.f}", Some("`f`")),
        ("ln {inputs.d}/a mine; chmod u+w mine; echo more >> mine", Some("`d/a`")),
        // Its own files it may replace, remove and add to.
        ("rm {inputs.d}/a; echo new > {inputs.d}/a", None),
        ("sed -i s/first/FIRST/ {inputs.d}/a", None),
        (
            "chmod u+w {inputs.d}/a; touch {inputs.d}/a; mkdir {inputs.d}/__pycache__; echo x > {inputs.d}/__pycache__/x",
            None,
        ),
        ("rm -rf {inputs.d}/ {inputs.f}", None),
    ] {
        let sealed = Sealed::with(&SPOILED.replace("HOW", &how.replace('"', "\\\"")));
        let spoiling = run(&sealed, &["run", "p.yaml", "spoil"]);
        match spoilt {
            Some(name) => {
                assert_eq!(spoiling.code, 1, "{how}: {spoiling:?}");
                assert!(
                    spoiling.stderr.contains("changed its input") && spoiling.stderr.contains(name),
                    "{how}: {}",
                    spoiling.stderr
                );
            }
            None => assert_eq!(spoiling.code, 0, "{how}: {spoiling:?}"),
        }
        let looked = run(&sealed, &["run", "p.yaml", "look"]);
        assert_eq!(looked.code, 0, "{how}: {looked:?}");
        assert!(looked.stdout.contains("1 ran, 2 cached"), "{how}: {}", looked.stdout);
        assert_eq!(sealed.read("results/p-default/look.csv"), "first\nother\nfirst\n", "{how}");
        assert_eq!(sealed.run("cache verify").code, 0, "{how}");
    }
}

#[test]
fn a_damaged_blob_is_given_to_no_program_and_rebuilt() {
    let sealed = Sealed::with(&SPOILED.replace("HOW", ":"));
    assert_eq!(run(&sealed, &["run", "p.yaml", "one", "made"]).code, 0);
    let blobs = sealed.path("cache/blobs-v1");
    let damaged = crate::lab::files_below(&blobs).into_iter().map(|name| blobs.join(name));
    let damaged: PathBuf =
        damaged.into_iter().find(|path| std::fs::read(path).unwrap() == b"other\n").unwrap();
    std::fs::set_permissions(&damaged, std::fs::Permissions::from_mode(0o644)).unwrap();
    std::fs::write(&damaged, "OTHER\n").unwrap();
    let said = run_file(&sealed, "p.yaml");
    assert_eq!(said.code, 1, "{said:?}");
    assert!(
        said.stderr.contains("input `d` cannot be read") && said.stderr.contains("is damaged"),
        "{}",
        said.stderr
    );
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/look.csv"), "first\nother\nfirst\n");
    assert_eq!(sealed.run("cache verify").code, 0);
}

#[test]
fn links_within_an_output_folder_are_kept_and_read_like_what_they_lead_to() {
    let sealed = Sealed::with(
        "name: p
stages:
  train:
    kind: command
    with:
      shell: |
        mkdir -p {outputs.d}/runs/3; echo 3 > {outputs.d}/epoch-3.ckpt; echo log > {outputs.d}/runs/3/log
        ln -s epoch-3.ckpt {outputs.d}/last.ckpt; ln -s runs/3 {outputs.d}/latest
        ln -s \"$$PWD/{outputs.d}/epoch-3.ckpt\" {outputs.d}/runs/best; ln -s ../../{inputs.raw} {outputs.d}/raw
        echo best > best-3; ln -s ../best-3 {outputs.best}
      inputs: { raw: data/raw }
      outputs: { d: outputs/d/, best: outputs/best }
    inputs: { raw: { file: raw } }
  use:
    kind: command
    with:
      shell: \"d={inputs.d}; cat $$d/last.ckpt $$d/latest/log $$d/runs/best $$d/raw {inputs.best} > t; for l in last.ckpt latest runs/best; do readlink $$d/$$l; done >> t; test ! -L $$d/raw\"
      inputs: { d: inputs/d/ }
      outputs: { t: { type: table, path: t } }
    inputs: { d: train.d, best: train.best }
",
    );
    sealed.write("raw", "raw\n");
    let text =
        sealed.read("p.yaml").replace("shell: \"cd {inputs.d}/", "shell: \": {inputs.best}; cd {inputs.d}/");
    sealed.write("p.yaml", &text);
    ok(&sealed);
    assert_eq!(
        sealed.read("results/p-default/use.csv"),
        "3\nlog\n3\nraw\nbest\nepoch-3.ckpt\nruns/3\n../epoch-3.ckpt\n"
    );
    assert!(ok(&sealed).contains("0 stages executed"));
    sealed.run_ok("cache export last -o a.zip");
    std::fs::remove_dir_all(sealed.path("cache")).unwrap();
    sealed.run_ok("cache import a.zip");
    assert!(ok(&sealed).contains("all 2 cached"));
    assert_eq!(run(&sealed, &["run", "p.yaml", "--force", "use"]).code, 0);
    assert_eq!(sealed.run("cache verify").code, 0);
}

#[test]
fn a_link_that_leads_nowhere_is_named_in_outputs_and_imports() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  s: { kind: command, with: { shell: \"mkdir {outputs.d}; ln -s gone {outputs.d}/last; ln -s away {outputs.f}\", outputs: { d: d/, f: f } } }\n",
    );
    let said = run_file(&sealed, "p.yaml");
    assert_eq!(said.code, 1, "{said:?}");
    assert!(
        said.stderr.contains("d/last`: it is a link to `gone`")
            && said.stderr.contains("is a link to `away`"),
        "{}",
        said.stderr
    );
    let sealed = Sealed::with("name: p\nstages:\n  d: { kind: import, with: { path: data/ } }\n");
    sealed.write("data/a", "a");
    symlink("gone", sealed.path("data/broken")).unwrap();
    let said = run_file(&sealed, "p.yaml");
    assert_eq!(said.code, 3, "{said:?}");
    assert!(
        said.stderr.contains("data/broken") && said.stderr.contains("the link is broken"),
        "{}",
        said.stderr
    );
}

#[test]
fn the_right_to_execute_belongs_to_a_file_and_its_change_is_noticed() {
    let sealed = Sealed::with(
        "name: p
stages:
  compile: { kind: command, with: { shell: \"cp -L /bin/true {outputs.prog}; chmod 755 {outputs.prog}\", outputs: { prog: prog } } }
  use:
    kind: command
    with: { run: [sh, -c, '\"$$0\" && ./\"$$1\" > \"$$2\"', \"{inputs.prog}\", \"{inputs.tool}\", \"{outputs.t}\"], outputs: { t: { type: table, path: t.csv } } }
    inputs: { prog: compile, tool: { file: tool } }
",
    );
    sealed.write("tool", "#!/bin/sh\necho ran\n");
    let rights =
        |mode| std::fs::set_permissions(sealed.path("tool"), std::fs::Permissions::from_mode(mode)).unwrap();
    rights(0o755);
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/use.csv"), "ran\n");
    assert!(ok(&sealed).contains("0 stages executed"));
    rights(0o644);
    assert!(run(&sealed, &["plan", "p.yaml"]).stdout.contains("may not be executed any more"));
    assert_eq!(run_file(&sealed, "p.yaml").code, 1);
    rights(0o700);
    assert!(ok(&sealed).contains("0 stages executed"));
}

#[test]
fn a_result_whose_name_is_too_long_for_a_file_is_announced_and_written_under_a_shorter_one() {
    let value = "値".repeat(90);
    let sealed = Sealed::with(&format!(
        "name: p\naxes: {{ a: [{value}, {value}x] }}\nstages:\n  s: {{ kind: command, matrix: [a], with: {{ run: [sh, -c, 'echo \"$$1\" > \"$$0\"', \"{{outputs.t}}\", $a], outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"
    ));
    let planned = run(&sealed, &["plan", "p.yaml"]);
    assert!(planned.stdout.contains("is too long for a file; it is written to `s-値"), "{planned:?}");
    let said = ok(&sealed);
    assert!(said.contains("note: the name of the result of `s[a="), "{said}");
    let names: Vec<String> =
        sealed.list("results/p-default").into_iter().filter(|name| name.ends_with(".csv")).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    assert!(ok(&sealed).contains("0 stages executed"));
}

#[test]
fn a_number_goes_into_a_text_as_it_was_written() {
    let sealed = Sealed::with(
        "name: p
axes: { v: [3.9, 3.10] }
params: { hex: 0x1F }
stages:
  show:
    kind: command
    matrix: [v]
    with:
      run: [sh, -c, 'echo \"$$1 $$2 $$3 $$4 $$V $$W\" > \"$$0\"', \"{outputs.t}\", $v, \"py${v}\", 1.0, $hex]
      env: { V: $v, W: 12.10 }
      outputs: { t: { type: table, path: t.csv } }
",
    );
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/show-3.10.csv"), "3.10 py3.10 1.0 31 3.10 12.10\n");
    assert_eq!(sealed.read("results/p-default/show-3.9.csv"), "3.9 py3.9 1.0 31 3.9 12.10\n");
}

#[test]
fn a_value_on_the_command_line_is_taken_whole_or_refused_with_its_place() {
    let sealed = Sealed::with(
        "name: p\nparams: { s: x }\nstages:\n  s: { kind: command, with: { run: [sh, -c, 'printf %s \"$$1\" > \"$$0\"', \"{outputs.t}\", $s], outputs: { t: { type: table, path: t.csv } } } }\n",
    );
    for text in ["#12", "fix #12", "it's #1", "two\nlines", " blanks  around "] {
        let ended = run(&sealed, &["run", "p.yaml", "--set", &format!("params.s={text}")]);
        assert_eq!(ended.code, 0, "{ended:?}");
        assert_eq!(sealed.read("results/p-default/s.csv"), text);
    }
    let ended = run(&sealed, &["run", "p.yaml", "--set", "params.s=\"fix\" #12"]);
    assert_eq!(ended.code, 3, "{ended:?}");
    assert!(
        ended.stderr.contains("`#`") && ended.stderr.contains("\n  |                ^^^\n"),
        "{}",
        ended.stderr
    );
}

#[test]
fn two_files_of_one_name_do_not_remove_each_others_results() {
    let sealed = Sealed::new();
    let file = |stage: &str| {
        format!(
            "name: study\nstages:\n  {stage}: {{ kind: command, with: {{ shell: \"echo {stage} > {{outputs.t}}\", outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"
        )
    };
    sealed.write("one.yaml", &file("first"));
    sealed.write("sub/two.yaml", &file("second"));
    assert_eq!(run_file(&sealed, "one.yaml").code, 0);
    let refused = run_file(&sealed, "sub/two.yaml");
    assert_eq!(refused.code, 3, "{refused:?}");
    assert!(
        refused.stderr.contains("`one.yaml`") && refused.stderr.contains("--out DIR"),
        "{}",
        refused.stderr
    );
    assert_eq!(sealed.list("cache/runs-v1").len(), 1, "nothing ran");
    assert_eq!(run(&sealed, &["run", "sub/two.yaml", "--out", "mine"]).code, 0);
    assert_eq!(sealed.read("results/study-default/first.csv"), "first\n");
    // The same file under another name, and one whose file is gone, are no others.
    std::fs::rename(sealed.path("one.yaml"), sealed.path("moved.yaml")).unwrap();
    assert_eq!(run_file(&sealed, "moved.yaml").code, 0);
    symlink("moved.yaml", sealed.path("link.yaml")).unwrap();
    assert_eq!(run_file(&sealed, "link.yaml").code, 0);
    sealed.write("moved.yaml", &file("third"));
    assert!(
        run_file(&sealed, "moved.yaml")
            .stdout
            .contains("removed, because no stage makes them any more: first.csv")
    );
}

#[test]
fn a_failure_inside_a_pipe_fails_the_stage() {
    let with = |text: &str| {
        Sealed::with(&format!(
            "name: p\nstages:\n  s: {{ kind: command, with: {{ shell: \"{text}\", outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"
        ))
    };
    let failed = run_file(&with("(echo half; exit 9) | cat > {outputs.t}"), "p.yaml");
    assert_eq!(failed.code, 1, "{failed:?}");
    assert!(failed.stderr.contains("exit code 9"), "{}", failed.stderr);
    let sealed = with("(exit 9) | cat > {outputs.t} || echo fixed > {outputs.t}");
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/s.csv"), "fixed\n");
}

#[test]
fn what_a_failure_shows_of_a_noisy_log_fits_a_screen() {
    let sealed = Sealed::with(
        "name: p\naxes: { how: [line, bars] }\nstages:\n  s: { kind: command, matrix: [how], with: { run: [python3, \"{inputs.noise}\", $how], outputs: { t: t } }, inputs: { noise: { file: noise.py } } }\n",
    );
    sealed.write(
        "noise.py",
        "import sys\nw = sys.stdout.buffer\nif sys.argv[1] == 'line':\n    for _ in range(30): w.write(b'x' * 1_000_000)\nelse:\n    for i in range(100_001): w.write(b'\\rtraining %6.2f%%' % (i / 1000))\nw.write(b'\\nthe very last words\\n'); w.flush(); sys.exit(3)\n",
    );
    let ended = run(&sealed, &["run", "p.yaml", "-j1"]);
    assert_eq!(ended.code, 1);
    assert!(ended.stderr.len() < 16_384, "{} bytes", ended.stderr.len());
    assert_eq!(ended.stderr.matches("the very last words").count(), 2, "{}", ended.stderr);
    assert!(
        ended.stderr.contains("| training 100.00%\n") && !ended.stderr.contains(" 99.99%"),
        "{}",
        ended.stderr
    );
    assert!(ended.stderr.contains("more characters)"), "{}", ended.stderr);
}

#[test]
fn what_programs_and_editors_leave_beside_the_code_runs_nothing_again() {
    let import = |more: &str| {
        format!(
            "name: p\nstages:\n  src: {{ kind: import, with: {{ path: src/{more} }} }}\n  s: {{ kind: command, with: {{ shell: \"(cd {{inputs.src}}/; find . | sort) > t\", outputs: {{ t: {{ type: table, path: t }} }} }}, inputs: {{ src: src }} }}\n"
        )
    };
    let sealed = Sealed::with(&import(""));
    sealed.write("src/main.py", "print()");
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/s.csv"), ".\n./main.py\n");
    for file in [
        "src/__pycache__/main.pyc",
        "src/.git/HEAD",
        "src/main.py~",
        "src/.main.py.swp",
        "src/sub/__pycache__/x",
    ] {
        sealed.write(file, "x");
    }
    symlink("nobody@nowhere.1", sealed.path("src/.#main.py")).unwrap();
    std::fs::remove_dir_all(sealed.path("src/sub")).unwrap();
    assert!(ok(&sealed).contains("0 stages executed"));
    sealed.write("src/notes/log.txt", "x");
    sealed.write("src/log.txt", "x");
    sealed.write("p.yaml", &import(", exclude: [/notes, \"*.swp\", \".*\", __pycache__]"));
    ok(&sealed);
    assert_eq!(sealed.read("results/p-default/s.csv"), ".\n./log.txt\n./main.py\n./main.py~\n");
    sealed.write("p.yaml", &import(", exclude: [\"[\"]"));
    let refused = run_file(&sealed, "p.yaml");
    assert_eq!(refused.code, 3, "{refused:?}");
    assert!(refused.stderr.contains("is not a valid glob"), "{}", refused.stderr);
}

#[test]
fn a_stage_is_reported_to_start_after_its_inputs_have_finished() {
    let chain: String = (0..20)
        .map(|n| {
            let (read, input) = if n == 0 { (String::new(), String::new()) } else { (" {inputs.i}".to_owned(), format!(", inputs: {{ i: s{} }}", n - 1)) };
            format!("  s{n}: {{ kind: command, with: {{ shell: \"cat{read} < /dev/null > {{outputs.o}}; echo {n} >> {{outputs.o}}\", outputs: {{ o: o }} }}{input} }}\n")
        })
        .collect();
    let sealed = Sealed::with(&format!("name: p\nstages:\n{chain}"));
    let mut done = std::collections::BTreeSet::new();
    for event in sealed.events("--jobs 2") {
        let stage = event["stage"].as_str().unwrap_or_default().to_owned();
        match event["event"].as_str() {
            Some("started") if stage != "s0" => {
                let number: usize = stage[1..].parse().unwrap();
                assert!(done.contains(&format!("s{}", number - 1)), "{stage} started too early");
            }
            Some("ran") => drop(done.insert(stage)),
            _ => {}
        }
    }
    assert_eq!(done.len(), 20);
}

#[test]
fn counted_resources_are_never_shared_and_a_stage_knows_its_units() {
    let sealed = Sealed::new();
    let log = sealed.path("log").display().to_string();
    let stage = |name: &str, wants: &str, text: &str| {
        format!(
            "  {name}:\n    kind: command\n    matrix: [n]\n    resources: {wants}\n    with: {{ shell: \"{text} : > {{outputs.o}}; : ${{n}}\", outputs: {{ o: o }} }}\n"
        )
    };
    let noted = |name: &str, variable: &str| {
        format!("echo begin {name} $${variable} >> {log}; sleep 0.2; echo end {name} $${variable} >> {log};")
    };
    sealed.write(
        "p.yaml",
        &format!(
            "name: p\naxes: {{ n: [1, 2, 3, 4] }}\nstages:\n{}{}",
            stage("card", "{ gpu: 1 }", &noted("gpu", "CUDA_VISIBLE_DEVICES")),
            stage("paid", "{ licence: 1 }", &noted("licence", "DRIL_RESOURCE_LICENCE")),
        ),
    );
    let ended = run(&sealed, &["run", "p.yaml", "-j8", "--resources", "gpu=2"]);
    assert_eq!(ended.code, 0, "{ended:?}");
    let (mut held, mut most) = (std::collections::BTreeSet::new(), std::collections::BTreeMap::new());
    for line in sealed.read("log").lines() {
        let (what, unit) = line.split_once(' ').unwrap();
        if what == "begin" {
            assert!(held.insert(unit.to_owned()), "{unit} is held twice");
        } else {
            assert!(held.remove(unit));
        }
        for name in ["gpu", "licence"] {
            let now = held.iter().filter(|unit| unit.starts_with(name)).count();
            let most = most.entry(name).or_insert(0);
            *most = now.max(*most);
        }
    }
    assert_eq!(most, std::collections::BTreeMap::from([("gpu", 2), ("licence", 1)]));
    let refused = run(&sealed, &["run", "p.yaml", "--resources", "gpu=0", "--force", "card"]);
    assert_eq!(refused.code, 2, "{refused:?}");
    assert!(refused.stderr.contains("needs 1 of resource `gpu`, and the run has 0"), "{}", refused.stderr);
    assert!(run(&sealed, &["run", "p.yaml", "--resources", "gpu=4"]).stdout.contains("0 stages executed"));
}

#[test]
fn a_variable_that_is_no_text_is_named_and_may_be_passed_on() {
    use std::os::unix::ffi::OsStrExt;
    let with = |field: &str| {
        Sealed::with(&format!(
            "name: p\nstages:\n  s: {{ kind: command, with: {{ shell: 'printf %s \"$$WHO\" | od -An -tx1 > {{outputs.t}}', {field}: [WHO], outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"
        ))
    };
    let run = |sealed: &Sealed| {
        let mut command = sealed.command("run p.yaml");
        command.env("PATH", "/usr/bin:/bin").env("WHO", std::ffi::OsStr::from_bytes(b"J\xfcrgen"));
        ended(command)
    };
    let refused = run(&with("env"));
    assert_eq!(refused.code, 3, "{refused:?}");
    assert!(refused.stderr.contains("`WHO`, whose value is not UTF-8"), "{}", refused.stderr);
    let sealed = with("pass_env");
    assert_eq!(run(&sealed).code, 0);
    assert_eq!(sealed.read("results/p-default/s.csv").trim(), "4a fc 72 67 65 6e");
}
