//! What `plan` and `run` warn of: axes that change nothing, sweeps that a table pools, and files that a command does not declare.

use crate::sealed::{Sealed, ended};

/// What `plan p.yaml` with these arguments says on standard error, with the kinds of `samples`.
fn said(sealed: &Sealed, args: &str) -> String {
    let mut command = sealed.command(&format!("plan p.yaml{args}"));
    command.env("DRIL_FAKES_KINDS", "samples");
    let ended = ended(command);
    assert_eq!(ended.code, 0, "{ended:?}");
    ended.stderr
}

#[test]
fn an_axis_that_a_stage_does_not_use_is_named_by_plan_and_run_whatever_is_cached() {
    let sealed = Sealed::with(
        "name: p\naxes: { rate: [1, 2], seed: [1, 2, 3, 4, 5] }\nstages:\n  \
         train: { kind: command, matrix: [rate, seed], with: { run: [cp, \"{inputs.x}\", \"{outputs.o}\"], env: { R: $rate }, outputs: { o: o.txt } }, inputs: { x: { file: x.txt } } }\n  \
         count: { kind: count, matrix: [rate, seed], with: { to: 1 }, inputs: { start: train } }\n  \
         all: { kind: concat, inputs: { parts: count.count } }\n",
    );
    sealed.write("x.txt", "0");
    let expected = "warning: stage `train`: `seed` changes nothing, so its 10 instances have 2 results\n  \
                    = hint: use `$seed` in its `with`, `seed` or `inputs`, as in `seed: $seed` with `{seed}` in the command, or remove it from its `matrix`\n";
    assert_eq!(sealed.run("plan p.yaml").stderr, expected);
    for args in
        ["run p.yaml --dry-run", "run p.yaml all", "run p.yaml all", "run p.yaml --quiet", "run p.yaml"]
    {
        assert_eq!(sealed.run(args).stderr, expected, "{args}");
    }
    let plan: serde_json::Value = serde_json::from_str(&sealed.run_ok("plan p.yaml --json")).unwrap();
    let message = "stage `train`: `seed` changes nothing, so its 10 instances have 2 results";
    assert_eq!(plan["warnings"][0]["message"], message);
    assert_eq!(plan["warnings"].as_array().map(Vec::len), Some(1));
}

#[test]
fn a_run_in_which_nothing_changed_repeats_the_warnings_and_notices_the_files_that_they_depend_on() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  \
         a: { kind: command, resources: { gpu: 1 }, with: { shell: \"echo run-it.sh settings/x.json > {outputs.o}\", outputs: { o: o } } }\n",
    );
    sealed.write("run-it.sh", "");
    let expected = "warning: stage `a`: `run-it.sh` is not one of its inputs: the stage runs in another folder and does not find it\n  \
                    = hint: declare `inputs: { run_it: { file: run-it.sh } }` and write `{inputs.run_it}` in the command\n";
    for args in ["run p.yaml", "run p.yaml", "run p.yaml --quiet"] {
        assert_eq!(sealed.run(args).stderr, expected, "{args}");
    }
    let unused = "warning: `--resources gpus=2`: no stage uses this resource\n  = hint: did you mean `gpu`? the resources of the stages are `gpu`\n";
    assert_eq!(sealed.run("run p.yaml --resources gpus=2,gpu=1").stderr, format!("{unused}{expected}"));
    // The short way was taken: it does not look at the history.
    std::fs::remove_dir_all(sealed.path("cache/history-v1")).unwrap();
    assert_eq!(sealed.run("run p.yaml").stderr, expected);
    assert!(!sealed.path("cache/history-v1/p-default.jsonl").exists());
    sealed.write("settings/x.json", "");
    let both = sealed.run("run p.yaml").stderr;
    assert!(both.contains("`run-it.sh`") && both.contains("`settings/x.json`"), "{both}");
    assert_eq!(sealed.run("run p.yaml").stderr, both);
    std::fs::remove_file(sealed.path("run-it.sh")).unwrap();
    std::fs::remove_dir_all(sealed.path("settings")).unwrap();
    for _ in 0..2 {
        let ended = sealed.run("run p.yaml");
        assert!(ended.stderr.is_empty() && ended.stdout.contains("nothing to do"), "{ended:?}");
    }
}

#[test]
fn an_axis_that_matters_to_some_instances_or_comes_from_an_input_is_no_mistake() {
    let sealed = Sealed::with(
        "name: p\naxes: { place: [here], rate: [1, 2], label: [a, b], steps: [3, 4], method: { plain: { weights: clone.best }, long: { weights: longer.last } } }\n\
         stages:\n  \
         train: { kind: train, with: { steps: 5 } }\n  \
         record: { kind: record, inputs: { policy: train } }\n  \
         clone: { kind: imitate, inputs: { demonstrations: record } }\n  \
         longer: { kind: imitate, matrix: [rate], seed: $rate, inputs: { demonstrations: record } }\n  \
         score: { kind: score, matrix: [place, method, rate], inputs: { policy: $method.weights } }\n  \
         again: { kind: score, matrix: [rate], inputs: { policy: longer.best } }\n  \
         zipped: { kind: train, matrix: [{ zip: [label, steps] }], with: { steps: $steps } }\n",
    );
    assert_eq!(said(&sealed, ""), "");
    // Here the rate matters to no selected instance, but to others of the stage.
    assert_eq!(said(&sealed, " score[method=plain]"), "");
}

#[test]
fn axes_that_change_nothing_together_are_named_together() {
    let sealed = Sealed::with(
        "name: p\naxes: { a: [1, 2], b: [1, 2, 3], c: [1, 2] }\nstages:\n  \
         t: { kind: train, matrix: [a, b, c], with: { steps: $c } }\n  \
         u: { kind: train, matrix: [a], with: { steps: 9 } }\n",
    );
    let first = "stage `t`: `a` and `b` change nothing, so its 12 instances have 2 results";
    let second = "stage `u`: `a` changes nothing, so its 2 instances have 1 result";
    let all = said(&sealed, "");
    assert!(all.contains(first) && all.contains(second), "{all}");
    let one = said(&sealed, " u");
    assert!(!one.contains(first) && one.contains(second), "{one}");
    assert_eq!(said(&sealed, " --set axes.a=1 --set axes.b=1"), "");
}

#[test]
fn a_sweep_whose_axis_a_table_does_not_name_is_warned_of_with_how_to_name_it() {
    let sealed = Sealed::with(
        "name: p\naxes: { rate: [0.1, 0.2], mode: [x, y] }\nstages:\n  \
         train: { kind: train, matrix: [rate], with: { steps: 5, learning_rate: $rate } }\n  \
         score: { kind: score, matrix: [rate, mode], with: { mode: $mode }, inputs: { policy: train } }\n  \
         t1: { kind: tabulate, with: { columns: [rate, mode] }, inputs: { scores: score } }\n  \
         t2: { kind: tabulate, with: { title: any }, inputs: { scores: score } }\n  \
         t3: { kind: tabulate, matrix: [mode], with: { columns: [rate] }, inputs: { scores: score } }\n",
    );
    assert_eq!(said(&sealed, ""), "");
    let one = "warning: stage `t1` reads all values of the sweep `steps`, and its parameters do not name this axis, so it treats them alike\n  \
               = hint: name the axis where it names the others: `--set 't1.columns=[rate, mode, steps]'`\n";
    assert_eq!(said(&sealed, " --set train.steps=6,7 t1 t2"), one);
    let two = said(&sealed, " --set train.steps=6,7");
    assert!(two.contains("the stages `t1`, `t3` read all values of the sweep `steps`"), "{two}");
    let mut named = sealed.command("plan p.yaml --set train.steps=6,7 t1 --set");
    named.arg("t1.columns=[rate, mode, steps]").env("DRIL_FAKES_KINDS", "samples");
    assert_eq!(ended(named).stderr, "");
}

#[test]
fn a_program_reads_the_labels_of_a_sweep_itself() {
    let sealed = Sealed::with(
        "name: p\naxes: { a: [1, 2] }\nstages:\n  \
         s: { kind: command, matrix: [a], with: { env: { Z: 0, A: $a }, run: [cp, \"{inputs.x}\", \"{outputs.o}\"], outputs: { o: o.txt } }, inputs: { x: { file: x.txt } } }\n  \
         t: { kind: command, with: { run: [cat, a], inputs: { s: { many: true } }, outputs: { o: o.txt } }, inputs: { s: s } }\n",
    );
    sealed.write("x.txt", "7");
    assert_eq!(sealed.run("plan p.yaml --set s.env.Z=1,100").stderr, "");
}

#[test]
fn the_examples_give_no_warning() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    for (example, profiles) in
        [("pi", &["full", "quick"][..]), ("fit", &["full", "quick"]), ("words", &["default"])]
    {
        for profile in profiles {
            let sealed = Sealed::new();
            let file = root.join(format!("pipelines/examples/{example}/{example}.yaml"));
            let mut command = sealed.command(&format!("plan --profile {profile}"));
            command.arg(file);
            let ended = ended(command);
            assert_eq!((ended.code, &*ended.stderr), (0, ""), "{example} {profile}");
        }
    }
}

#[test]
fn a_file_beside_the_pipeline_that_a_command_names_and_does_not_declare_is_named() {
    let sealed = Sealed::with("");
    let absolute = sealed.path("abs.py").display().to_string();
    sealed.write(
        "p.yaml",
        &format!(
            "name: p\nstages:\n  \
             a: {{ kind: command, with: {{ run: [python3, my-script.py, \"{{outputs.o}}\"], outputs: {{ o: o.txt }} }} }}\n  \
             b: {{ kind: command, with: {{ shell: \"python3 '{absolute}' > {{outputs.o}}\", outputs: {{ o: o.txt }} }} }}\n  \
             c: {{ kind: command, with: {{ shell: \"python3 main.py --x=1; cp {{inputs.s}} o.txt\", inputs: {{ m: main.py }}, outputs: {{ o: o.txt }} }}, inputs: {{ s: {{ file: abs.py }}, m: {{ file: main.py }} }} }}\n  \
             d: {{ kind: command, with: {{ shell: \"python3 main.py; cat {{inputs.m}}\", outputs: {{ o: o.txt }} }}, inputs: {{ m: {{ file: main.py }} }} }}\n  \
             e: {{ kind: command, with: {{ shell: \"cat {absolute} {{inputs.s}} > {{outputs.o}}\", outputs: {{ o: o.txt }} }}, inputs: {{ s: {{ file: abs.py }} }} }}\n"
        ),
    );
    for file in ["my-script.py", "abs.py", "main.py", "o.txt"] {
        sealed.write(file, "");
    }
    let expected = format!(
        "warning: stage `a`: `my-script.py` is not one of its inputs: the stage runs in another folder and does not find it\n  \
         = hint: declare `inputs: {{ my_script: {{ file: my-script.py }} }}` and write `{{inputs.my_script}}` in the command\n\
         warning: stage `b`: `{absolute}` is not one of its inputs: an edit of it does not run the stage again\n  \
         = hint: declare `inputs: {{ abs: {{ file: abs.py }} }}` and write `{{inputs.abs}}` in the command\n\
         warning: stage `d`: `main.py` is its input `m`, but the command names it by its own path: the stage runs in another folder and does not find it\n  \
         = hint: write `{{inputs.m}}` in the command\n"
    );
    let plan = sealed.run("plan p.yaml");
    assert_eq!(plan.code, 0, "{plan:?}");
    assert_eq!(plan.stderr, expected);
}
