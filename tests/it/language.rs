//! What goes beyond the plain product of a matrix, files that include others, sweeps, and parts of a pipeline.

use crate::sealed::Sealed;

/// The instances of a pipeline, in order.
fn instances(sealed: &Sealed, args: &str) -> Vec<String> {
    let text = sealed.run_ok(&format!("plan p.yaml --json{args}"));
    let plan: serde_json::Value = serde_json::from_str(&text).unwrap();
    let stages = plan["stages"].as_array().unwrap();
    stages.iter().map(|stage| stage["stage"].as_str().unwrap().to_owned()).collect()
}

/// A pipeline of one stage `s` whose matrix is this, and a table of all of it.
fn matrix(text: &str) -> Sealed {
    Sealed::with(&format!(
        "name: p\naxes: {{ a: [1, 2], b: [x, y], e: {{ f: {{ n: 1 }}, g: {{ n: 2 }} }} }}\n\
         stages:\n  s: {{ kind: emit, {text}, with: {{ text: t }} }}\n  t: {{ kind: concat, inputs: {{ parts: s }} }}\n\
         profiles: {{ full: {{}}, small: {{ axes: {{ a: [1] }} }} }}\n"
    ))
}

#[test]
fn a_zip_takes_the_first_of_each_then_the_second() {
    let sealed = matrix("matrix: [e, { zip: [a, { k: [7, 8] }] }]");
    let expected = ["s[e=f, a=1, k=7]", "s[e=f, a=2, k=8]", "s[e=g, a=1, k=7]", "s[e=g, a=2, k=8]", "t"];
    assert_eq!(instances(&sealed, ""), expected);
}

#[test]
fn exclude_takes_away_and_include_adds_whole_combinations() {
    let sealed = matrix(
        "matrix: [a, b, { exclude: [{ a: 1, b: x }, { a: 2, b: [y, y] }] }, { include: { a: 3, b: x } }]",
    );
    assert_eq!(instances(&sealed, ""), ["s[a=1, b=y]", "s[a=2, b=x]", "s[a=3, b=x]", "t"]);
    // A value that a profile leaves out may still be spoken of.
    assert_eq!(instances(&sealed, " --profile small"), ["s[a=1, b=y]", "s[a=3, b=x]", "t"]);
}

#[test]
fn include_skips_a_value_that_a_profile_or_set_removed() {
    let sealed = matrix("matrix: [e, a, { include: [{ e: g, a: 7 }] }]");
    assert_eq!(instances(&sealed, " --set axes.e=f"), ["s[e=f, a=1]", "s[e=f, a=2]", "t"]);
    let sealed = matrix("matrix: [a, b, { include: [{ a: 2, b: z }, { a: 3, b: z }] }]");
    let expected = ["s[a=1, b=x]", "s[a=1, b=y]", "s[a=3, b=z]", "t"];
    assert_eq!(instances(&sealed, " --profile small"), expected);
    // Values that only the stage's own list leaves out can be included.
    let sealed = matrix("matrix: [{ e: [f], a: [1] }, { include: [{ e: g, a: 2 }] }]");
    assert_eq!(instances(&sealed, ""), ["s[e=f, a=1]", "s[e=g, a=2]", "t"]);
}

#[test]
fn a_combination_of_include_that_the_product_has_under_one_profile_counts_once() {
    let sealed = matrix("matrix: [a, b, { include: [{ a: 1, b: x }, { a: 2, b: z }] }]");
    let small = ["s[a=1, b=x]", "s[a=1, b=y]", "t"];
    assert_eq!(instances(&sealed, " --profile small"), small);
    let sealed = matrix("matrix: [a, { include: { a: 7 } }]");
    assert_eq!(instances(&sealed, " --set axes.a=7,8"), ["s[a=7]", "s[a=8]", "t"]);
    assert_eq!(instances(&sealed, ""), ["s[a=1]", "s[a=2]", "s[a=7]", "t"]);
}

#[test]
fn when_lets_through_by_axis_field_and_profile() {
    let sealed = matrix("matrix: [e, a], when: [{ e.n: 2, a: { not: 1 } }, { profile: small }]");
    assert_eq!(instances(&sealed, ""), ["s[e=g, a=2]", "t"]);
    assert_eq!(instances(&sealed, " --profile small"), ["s[e=f, a=1]", "s[e=g, a=1]", "t"]);
}

#[test]
fn when_takes_a_value_that_its_axis_has_without_a_profile_or_in_any() {
    let file = "name: p\nparams: { many: [1, 2] }\naxes: { a: [1, 2], e: { f: { n: 1 } }, p: $many }\n\
         stages:\n  s: { kind: emit, matrix: [a], when: { a: [2, 5, 7] }, with: { text: t } }\n  \
         u: { kind: emit, matrix: [e], when: { e: [f, g], e.n: { not: 9 } }, with: { text: t } }\n  \
         v: { kind: emit, matrix: [p, { exclude: { p: 2 }, include: { p: 4 } }], when: { p: { not: [3, 4] } }, with: { text: t } }\n  \
         w: { kind: emit, matrix: { k: [1, 2] }, when: { k: 2 }, with: { text: t } }\n\
         profiles:\n  full: {}\n  small: { axes: { a: [1] } }\n  wide: { axes: { a: [1, 5], e: { g: { n: 9 } } }, params: { many: [2, 3] } }\n";
    let sealed = Sealed::with(&file.replace(", 7]", "]"));
    assert_eq!(instances(&sealed, ""), ["s[a=2]", "u[e=f]", "v[p=1]", "w[k=2]"]);
    assert_eq!(instances(&sealed, " --profile small"), ["u[e=f]", "v[p=1]", "w[k=2]"]);
    assert_eq!(instances(&sealed, " --profile wide"), ["s[a=5]", "u[e=f]", "w[k=2]"]);
    // Set values count, too, and so do those that they replace.
    assert_eq!(instances(&sealed, " --set axes.a=8"), ["u[e=f]", "v[p=1]", "w[k=2]"]);
    let sealed = Sealed::with(file);
    assert_eq!(instances(&sealed, " --set axes.a=1,7"), ["s[a=7]", "u[e=f]", "v[p=1]", "w[k=2]"]);
    let ended = sealed.run("plan p.yaml");
    assert!(
        ended.code == 3 && ended.stderr.contains("axis `a` has no value that is the number 7"),
        "{ended:?}"
    );
    assert!(ended.stderr.contains("its values are `1`, `2`, `5`"), "{}", ended.stderr);
}

#[test]
fn a_target_that_its_when_leaves_out_is_distinguished_from_one_that_does_not_exist() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  full-a: { kind: emit, when: { profile: full }, with: { text: a } }\n  \
         full-b: { kind: emit, when: { profile: full }, with: { text: a } }\n  \
         c: { kind: emit, with: { text: a } }\nprofiles: { full: {}, small: {} }\n",
    );
    let said = |args: &str| {
        let ended = sealed.run(&format!("plan p.yaml --profile small {args}"));
        assert_eq!(ended.code, 2, "{ended:?}");
        ended.stderr
    };
    assert!(said("full-a").contains("stage `full-a` is left out by its `when` in profile `small`"));
    assert!(said("--from full-b").contains("stage `full-b` is left out by its `when` in profile `small`"));
    let both = "the stages `full-a`, `full-b` are left out by their `when` in profile `small`";
    assert!(said("full-*").contains(both));
    assert!(said("ful-a").contains("there is no stage `ful-a`"));
}

#[test]
fn a_stage_that_is_switched_off_takes_its_optional_readers_inputs_with_it() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  a: { kind: emit, when: { profile: full }, with: { text: a } }\n  \
         b: { kind: count, inputs: { start: a } }\n  c: { kind: concat, inputs: { parts: [a, b.count] } }\n\
         profiles: { full: {}, small: {} }\n",
    );
    assert_eq!(instances(&sealed, ""), ["a", "b", "c"]);
    assert_eq!(instances(&sealed, " --profile small"), ["b", "c"]);
    sealed.run_ok("run p.yaml --profile small");
}

#[test]
fn a_profile_without_any_stage_says_that_every_when_is_false() {
    let sealed = Sealed::with(
        "name: p\nstages: { a: { kind: emit, when: { profile: full }, with: { text: a } } }\nprofiles: { full: {}, small: {} }\n",
    );
    for args in ["", " a", " --from a", " --force a"] {
        let ended = sealed.run(&format!("plan p.yaml --profile small{args}"));
        let said = "no stage exists under profile `small`: every `when` is false";
        assert!(ended.code == 2 && ended.stderr.contains(said), "{args}: {}", ended.stderr);
    }
    let empty = Sealed::with("name: p\ninclude: q.yaml\n");
    empty.write("q.yaml", "params: { a: 1 }\n");
    let ended = empty.run("plan p.yaml");
    assert!(ended.code == 3 && ended.stderr.contains("the pipeline has no stages"), "{}", ended.stderr);
}

#[test]
fn files_share_stages_and_what_is_cached_of_them() {
    let shared = "params: { word: hello }\nstages:\n  say: { kind: emit, with: { text: $word } }\n  \
                  read: { kind: concat, inputs: { parts: { file: data.txt } } }\n";
    let sealed = Sealed::with(
        "name: p\ninclude: sub/shared.yaml\nstages: { t: { kind: concat, inputs: { parts: [say, read] } } }\n",
    );
    sealed.write("sub/shared.yaml", shared);
    sealed.write("sub/data.txt", "data");
    assert_eq!(instances(&sealed, ""), ["say", "read", "t"]);
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/p-default/t.md"), "hello\ndata");
    sealed.write(
        "p.yaml",
        "name: q\ninclude: [sub/shared.yaml, ./sub/../sub/shared.yaml]\nparams: { word: bye }\n\
         stages: { u: { kind: concat, inputs: { parts: read } } }\n",
    );
    let planned = sealed.run_ok("plan p.yaml --all");
    assert!(planned.contains("read  cached"), "{planned}");
    sealed.write("sub/data.txt", "other");
    let planned = sealed.run_ok("plan p.yaml");
    assert!(planned.contains("read  run"), "an included file's data is looked at: {planned}");
    sealed.run_ok("run p.yaml");
    sealed.write(
        "sub/shared.yaml",
        &shared.replace("kind: emit,", "kind: emit, about: greets,").replace("$word", "$word, times: 2"),
    );
    assert!(sealed.run_ok("run p.yaml").contains("1 ran"), "an edit of an included file is seen");
}

#[test]
fn several_values_make_an_axis_of_the_stage_and_of_what_reads_one_artifact_of_it() {
    let sealed = Sealed::with(
        "name: p\naxes: { k: [1, 2] }\nstages:\n  say: { kind: emit, matrix: [k], with: { text: t } }\n  \
         count: { kind: count, matrix: [k], inputs: { start: say } }\n  all: { kind: concat, inputs: { parts: count.count } }\n",
    );
    let expected = [
        "say[k=1, times=1]",
        "say[k=1, times=3]",
        "say[k=2, times=1]",
        "say[k=2, times=3]",
        "count[k=1, times=1]",
        "count[k=1, times=3]",
        "count[k=2, times=1]",
        "count[k=2, times=3]",
        "all",
    ];
    assert_eq!(instances(&sealed, " --set say.times=1,3"), expected);
    assert_eq!(instances(&sealed, " --set axes.k=5,6 --set say.text='a,b'").len(), 5);
    sealed.run_ok("run p.yaml --set say.times=1,3");
}

#[test]
fn a_sweep_multiplies_the_combinations_of_include() {
    let sealed = matrix("matrix: [a, { include: [{ a: 3 }] }]");
    let expected = [
        "s[a=1, times=1]",
        "s[a=1, times=3]",
        "s[a=2, times=1]",
        "s[a=2, times=3]",
        "s[a=3, times=1]",
        "s[a=3, times=3]",
        "t",
    ];
    assert_eq!(instances(&sealed, " --set s.times=1,3"), expected);
    let sealed = Sealed::with(
        "name: p\naxes: { k: [1, 2] }\nstages:\n  say: { kind: emit, with: { text: t } }\n  \
         count: { kind: count, matrix: [k, { exclude: { k: 1 }, include: { k: 3 } }], inputs: { start: say } }\n",
    );
    let expected = [
        "say[times=1]",
        "say[times=3]",
        "count[k=2, times=1]",
        "count[k=2, times=3]",
        "count[k=3, times=1]",
        "count[k=3, times=3]",
    ];
    assert_eq!(instances(&sealed, " --set say.times=1,3"), expected);
}

const CHAIN: &str = "\
name: p
axes: { k: [1, 2] }
stages:
  a: { kind: emit, matrix: [k], with: { text: \"v${k}\" } }
  b: { kind: count, matrix: [k], inputs: { start: a } }
  c: { kind: concat, inputs: { parts: b.count } }
  d: { kind: concat, inputs: { parts: a } }
";

#[test]
fn targets_bring_what_they_need_and_nothing_else() {
    let sealed = Sealed::with(CHAIN);
    assert_eq!(instances(&sealed, " d"), ["a[k=1]", "a[k=2]", "d"]);
    assert_eq!(instances(&sealed, " b[k=2]"), ["a[k=2]", "b[k=2]"]);
    assert_eq!(instances(&sealed, " ?[k=1]"), ["a[k=1]", "b[k=1]"]);
    assert_eq!(instances(&sealed, " * --from b").len(), 5);
    assert_eq!(instances(&sealed, " --from b[k=2]").len(), 5, "with what `c` needs");
    let said = sealed.run_ok("run p.yaml d");
    assert!(said.contains("3 ran"), "{said}");
    assert_eq!(sealed.list("results/p-default"), [".dril-pipe.json", "d.md"]);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("run p.yaml c");
    assert_eq!(
        sealed.list("results/p-default"),
        [".dril-pipe.json", "c.md", "d.md"],
        "what was not asked for stays"
    );
}

#[test]
fn only_refuses_what_is_not_cached_and_force_runs_what_is() {
    let sealed = Sealed::with(CHAIN);
    let ended = sealed.run("run p.yaml d --only");
    assert_eq!(ended.code, 2);
    assert!(ended.stderr.contains("`--only` excludes `a[k=1]` and 1 more"), "{}", ended.stderr);
    sealed.run_ok("run p.yaml");
    let planned = sealed.run_ok("plan p.yaml --force a[k=2]");
    assert!(planned.contains("forced by `--force`") && planned.contains("1 stage to run"), "{planned}");
    let said = sealed.run_ok("run p.yaml --force a[k=2]");
    assert!(said.contains("1 ran, 5 cached"), "it ran, and with the same result nothing behind it: {said}");
    assert!(sealed.run_ok("run p.yaml c --only --force c").contains("1 ran"));
    assert!(sealed.run_ok("run p.yaml -n").contains("nothing to run"));
}

#[test]
fn a_target_that_means_nothing_is_explained() {
    let sealed = Sealed::with(CHAIN);
    for (target, expected) in [
        ("e", "there is no stage `e`"),
        ("a[j=1]", "the stage has no axis `j`"),
        ("a[k=3]", "no instance has `k=3`"),
        ("a[k]", "is not a valid stage pattern"),
        ("a --from c", "none of the target stages is downstream of `--from`"),
        ("a --force c", "the stages of `--force` are not selected"),
    ] {
        let ended = sealed.run(&format!("plan p.yaml {target}"));
        assert!(ended.code == 2 && ended.stderr.contains(expected), "{target}: {}", ended.stderr);
    }
}
