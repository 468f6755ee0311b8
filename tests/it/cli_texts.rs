//! The texts that people read, as snapshots: help, plans, graphs, kinds.

use insta::assert_snapshot;

use crate::cli::WORDS;
use crate::sealed::Sealed;

fn shown(sealed: &Sealed, args: &str) -> String {
    let ended = sealed.run(args);
    sealed.normal(&format!("$ dril-pipe {args}\n{}{}= {}\n", ended.stdout, ended.stderr, ended.code))
}

#[test]
fn help_of_the_program_and_of_every_command() {
    let sealed = Sealed::new();
    let pages = [
        "--help",
        "run --help",
        "plan --help",
        "explain --help",
        "graph --help",
        "kinds --help",
        "peek --help",
    ];
    assert_snapshot!(pages.map(|args| shown(&sealed, args)).join("\n"));
}

#[test]
fn mistakes_on_the_command_line() {
    let sealed = Sealed::with(WORDS);
    let mistakes = [
        "rnu p.yaml",
        "run",
        "run p.yaml --job 3",
        "run p.yaml --jobs 0",
        "run p.yaml --json --quiet",
        "run p.yaml --checkpoint-every soon",
        "kinds emti",
        "kinds something",
    ];
    assert_snapshot!(mistakes.map(|args| shown(&sealed, args)).join("\n"));
}

/// Twelve instances of `say`, each read by one of `join`.
const MANY: &str = "\
name: many
axes: { x: [a, b, c, d], n: [1, 2, 3] }
params: { to: 1 }
stages:
  say: { kind: emit, matrix: [x, n], with: { text: \"${x} ${n} ${to}\" } }
  join: { kind: concat, matrix: [x, n], inputs: { parts: say } }
";

#[test]
fn a_plan_groups_instances_by_what_happens_and_why_whatever_differs_between_them() {
    let sealed = Sealed::with(MANY);
    sealed.run_ok("run p.yaml");
    let plan = |args: &str| {
        let text = sealed.run_ok(format!("plan p.yaml --set params.to=2 {args}").trim());
        text.lines().filter(|line| line.starts_with("  ")).map(|line| format!("{line}\n")).collect::<String>()
    };
    // Every value is another one.
    assert_eq!(
        plan(""),
        "  say × 12   run         text: \"a 1 1\" -> \"a 1 2\" (and 11 more such changes)\n  \
           join × 12  depends on  say × 12\n"
    );
    let causes = sealed.run_ok("explain p.yaml --set params.to=2");
    let cause =
        "\n  say × 12  text: \"a 1 1\" -> \"a 1 2\" (and 11 more such changes); 12 stages downstream\n";
    assert!(causes.contains(cause) && causes.contains("24 stages not up to date, 1 cause\n"), "{causes}");
    // Up to four different changes are listed.
    assert_eq!(
        plan("--set axes.n=1"),
        "  say[x=a, n=1]  run         text: \"a 1 1\" -> \"a 1 2\"\n  \
           say[x=b, n=1]  run         text: \"b 1 1\" -> \"b 1 2\"\n  \
           say[x=c, n=1]  run         text: \"c 1 1\" -> \"c 1 2\"\n  \
           say[x=d, n=1]  run         text: \"d 1 1\" -> \"d 1 2\"\n  \
           join × 4       depends on  say × 4\n"
    );
    // After a part of a run, every input is another one.
    sealed.run_ok("run p.yaml --set params.to=2 say[x=a] say[x=b] join[x=b,n=1]");
    assert_eq!(
        plan(""),
        "  say × 6   run         text: \"c 1 1\" -> \"c 1 2\" (and 5 more such changes)\n  \
           join × 5  run         input `parts` differs (say.text)\n  \
           join × 6  depends on  say × 6\n"
    );
    let all = plan("--all");
    assert!(
        all.contains("  join[x=a, n=2]  run         input `parts` differs (say[x=a, n=2].text)\n"),
        "{all}"
    );
    assert_eq!(all.lines().count(), 24);
}

#[test]
fn what_a_run_says_of_many_instances_stays_short() {
    let sealed = Sealed::new();
    let odd = sealed.path("odd").display().to_string();
    let fail = format!("test ! -e {odd}-$$X || echo $$X is odd; exit 3");
    let pipeline = |shell: &str| {
        format!(
            "name: many\naxes: {{ x: [a, b, c, d, e, f, g, h, i, j, k, l, m, n] }}\nstages:\n  \
             c: {{ kind: command, matrix: [x], with: {{ shell: \"{shell}; echo 1 > {{outputs.t}}\", env: {{ X: $x }}, outputs: {{ t: {{ type: table, path: t.csv }} }} }} }}\n"
        )
    };
    sealed.write("p.yaml", &pipeline("true"));
    sealed.run_ok("run p.yaml");
    sealed.write("odd-c", "");
    sealed.write("p.yaml", &pipeline(&fail));
    let ended = sealed.run("run p.yaml --jobs 1");
    let errors: Vec<&str> = ended.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    let with = |text: &str| errors.iter().filter(|line| line.contains(text)).count();
    let whole = "` failed: the shell ended with exit code 3; see its log";
    assert_eq!((with(whole), with("` failed like `c[x=")), (2, 12), "{errors:?}");
    assert_eq!(ended.stderr.matches("    | c is odd\n").count(), 1, "{}", ended.stderr);
    assert_eq!(ended.stderr.matches("\n  log: cache/runs-v1/").count(), 14, "each names its log");
    assert!(ended.stdout.contains("\n  failed: c × 14\nresults: "), "{}", ended.stdout);
    assert!(
        ended.stdout.contains(": c-a.csv, c-b.csv, ") && ended.stdout.ends_with("c-l.csv and 2 more\n"),
        "{}",
        ended.stdout
    );
}

#[test]
fn plans_before_and_after_a_run() {
    let sealed = Sealed::with(WORDS);
    let mut pages = vec![shown(&sealed, "plan p.yaml"), shown(&sealed, "plan p.yaml --all")];
    sealed.run_ok("run p.yaml");
    for args in [
        "plan p.yaml",
        "plan p.yaml --profile quick",
        "plan p.yaml --set count.to=7 --set gather.separator=x --set seed=4",
        "plan p.yaml --set axes.word=[one,four]",
        "plan p.yaml --all --set say.times=2",
    ] {
        pages.push(shown(&sealed, args));
    }
    assert_snapshot!(pages.join("\n"));
}

#[test]
fn a_plan_as_json_has_every_stage_with_its_reasons() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let text = sealed.run_ok("plan p.yaml --json --set count.to=7");
    let plan: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(plan["counts"], serde_json::json!({ "cached": 4, "run": 3, "depends_on": 1 }));
    let stages = plan["stages"].as_array().unwrap();
    let find = |id: &str| stages.iter().find(|stage| stage["stage"] == id).unwrap();
    let expected = serde_json::json!([{ "because": "param", "path": "to", "old": 2, "new": 7 }]);
    assert_eq!(find("count[word=two]")["why"], expected);
    assert_eq!(find("gather")["depends_on"].as_array().unwrap().len(), 3);
    assert_eq!(find("apart")["verdict"], "cached");
    assert_eq!(find("apart")["key"].as_str().unwrap().len(), 64);
}

#[test]
fn graphs_in_all_languages() {
    let sealed = Sealed::with(WORDS);
    let pages = [
        "graph p.yaml",
        "graph p.yaml --format mermaid",
        "graph p.yaml --format json",
        "graph p.yaml --instances",
        "graph p.yaml -f mermaid --instances --set axes.word=[one]",
    ];
    assert_snapshot!(pages.map(|args| shown(&sealed, args)).join("\n"));
}

#[test]
fn kinds_are_listed_and_described() {
    let sealed = Sealed::new();
    assert_snapshot!(["kinds", "kinds count", "kinds concat"].map(|args| shown(&sealed, args)).join("\n"));
}

#[test]
fn kinds_as_json_carry_the_schema_of_their_parameters() {
    let text = Sealed::new().run_ok("kinds count --json");
    let kind: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(kind["params"]["properties"]["to"]["default"], 3);
    assert_eq!(kind["inputs"][0]["arity"], "optional");
    assert_eq!(kind["outputs"][1]["extension"], "csv");
}

#[test]
fn the_manual_names_every_option_event_and_exit_code() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let manual = std::fs::read_to_string(root.join("docs/command-line.md")).unwrap();
    let sealed = Sealed::new();
    for command in
        ["run", "plan", "explain", "status", "show", "log", "runs", "diff", "cache", "graph", "kinds"]
    {
        assert!(manual.contains(&format!("## `{command}`")), "{command}");
        let help = sealed.run_ok(&format!("{command} --help"));
        let options = help.split_whitespace().filter(|word| word.starts_with("--") && word.len() > 2);
        for option in options.map(|word| word.trim_end_matches([',', '`'])).filter(|word| *word != "--help") {
            assert!(manual.contains(&format!("`{option}")), "{command} {option}");
        }
    }
    let source = std::fs::read_to_string(root.join("src/cli/report/json.rs")).unwrap();
    let said = source.split("self.say(\"").chain(source.split("self.stage(\"")).skip(1);
    let events: Vec<&str> = said.filter_map(|after| after.split('"').next()).collect();
    assert!(events.len() > 8);
    for event in events.into_iter().filter(|event| event.chars().all(|c| c.is_ascii_lowercase())) {
        assert!(manual.contains(&format!("| `{event}` |")), "event {event}");
    }
    let source = std::fs::read_to_string(root.join("src/plan/mod.rs")).unwrap();
    let (_, reasons) = source.split_once("pub enum Reason {").unwrap();
    let (reasons, _) = reasons.split_once("\n}").unwrap();
    let reasons: Vec<String> = reasons
        .lines()
        .filter_map(|line| line.strip_prefix("    "))
        .filter(|line| line.starts_with(|c: char| c.is_ascii_uppercase()))
        .map(|line| line.trim_end_matches([',', '{', ' ']).to_ascii_lowercase())
        .collect();
    assert!(reasons.len() > 8);
    let (_, manual_of_reasons) = manual.split_once("A reason has the field `because`").unwrap();
    let manual_of_reasons = manual_of_reasons.lines().next().unwrap();
    for reason in reasons {
        assert!(manual_of_reasons.contains(&format!("`{reason}`")), "reason {reason}");
    }
    let codes = sealed.run_ok("--help");
    let (_, codes) = codes.split_once("Exit codes:").unwrap();
    for code in codes.lines().filter_map(|line| line.split_whitespace().next()?.parse::<u8>().ok()) {
        assert!(manual.contains(&format!("| {code} |")), "exit code {code}");
    }
}
