//! What is large stays manageable: long chains, very many inputs.

use crate::programs::run;
use crate::sealed::Sealed;

#[test]
fn a_chain_of_thousands_is_explained_in_a_few_lines() {
    let stages: String = (0..3000)
        .map(|n| match n {
            0 => "  s0: { kind: emit, with: { text: $t } }\n".to_owned(),
            n => format!("  s{n}: {{ kind: concat, inputs: {{ parts: s{} }} }}\n", n - 1),
        })
        .collect();
    let sealed = Sealed::with(&format!("name: p\nparams: {{ t: a }}\nstages:\n{stages}"));
    let said = run(&sealed, &["explain", "p.yaml"]);
    assert_eq!(said.code, 0, "{said:?}");
    assert!(
        said.stdout.contains("3000 stages not up to date, 1 cause")
            && said.stdout.contains("new; 2999 stages downstream"),
        "{}",
        said.stdout
    );
    let said = run(&sealed, &["explain", "p.yaml", "s2999"]);
    assert_eq!(said.code, 0, "{}", said.stderr);
    let lines = said.stdout.lines().count();
    assert!(lines < 20, "{lines} lines");
    let said = run(&sealed, &["explain", "p.yaml", "--json"]);
    assert_eq!(said.code, 0);
    assert!(said.stdout.len() < 3000 * 1500, "{} bytes", said.stdout.len());
    let all: serde_json::Value = serde_json::from_str(&said.stdout).unwrap();
    assert_eq!(all.as_array().unwrap().len(), 3000);
    let said = run(&sealed, &["explain", "p.yaml", "s2999", "--json"]);
    let all: serde_json::Value = serde_json::from_str(&said.stdout).unwrap();
    assert!(
        said.stdout.contains("\"s0\"") && all.as_array().unwrap().len() > 100,
        "what is deep stands behind"
    );
}

#[test]
fn very_many_inputs_fit_into_a_shell_text_and_a_command_line_that_is_too_long_says_what_to_do() {
    let path = "frames-of-the-recording/".repeat(10);
    let names: Vec<String> = (0..1000).map(|n| n.to_string()).collect();
    let sealed = Sealed::with(&format!(
        "name: p
axes: {{ n: [{}] }}
stages:
  one: {{ kind: import, matrix: [n], with: {{ path: \"in/${{n}}\" }} }}
  text:
    kind: command
    with: {{ shell: \"cat {{inputs.all}} | wc -l > {{outputs.t}}\", inputs: {{ all: {{ many: true, path: {path}x }} }}, outputs: {{ t: {{ type: table, path: t.csv }} }} }}
    inputs: {{ all: one }}
  word:
    kind: command
    with: {{ run: [sh, -c, \": {{inputs.all}}\"], inputs: {{ all: {{ many: true, path: {path}x }} }}, outputs: {{ t: t }} }}
    inputs: {{ all: one }}
",
        names.join(", ")
    ));
    names.iter().for_each(|name| sealed.write(&format!("in/{name}"), "x\n"));
    let ended = run(&sealed, &["run", "p.yaml"]);
    assert_eq!(ended.code, 1, "{}", ended.stderr);
    assert_eq!(sealed.read("results/p-default/text.csv"), "1000\n");
    assert!(ended.stderr.contains("too long") && ended.stderr.contains("inputs.json"), "{}", ended.stderr);
}
