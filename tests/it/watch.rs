//! `watch` runs a pipeline again whenever it, or a file that it reads, changes.

use std::process::Stdio;

use crate::sealed::{Sealed, lines, signal, until};

#[test]
fn an_edit_of_the_pipeline_or_of_a_file_that_it_reads_runs_it_again() {
    let sealed =
        Sealed::with("name: x\nstages:\n  a: { kind: concat, inputs: { parts: { file: d.txt } } }\n");
    sealed.write("d.txt", "one");
    let mut child =
        sealed.command("watch p.yaml --quiet").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let result = || std::fs::read_to_string(sealed.path("results/x-default/a.md")).unwrap_or_default();
    until("it ran", || result() == "one");
    sealed.write("d.txt", "two");
    until("the file was seen", || result() == "two");
    sealed.write("p.yaml", "name: x\nstages: nonsense\n");
    std::thread::sleep(std::time::Duration::from_millis(600));
    assert!(child.try_wait().unwrap().is_none(), "a mistake does not end it");
    sealed.write("d.txt", "three");
    let text = "name: x\nstages:\n  a: { kind: concat, with: { separator: s }, inputs: { parts: { file: d.txt } } }\n";
    sealed.write("p.yaml", text);
    until("the corrected pipeline was seen", || result() == "three");
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

#[test]
fn an_edit_of_a_file_that_the_pipeline_includes_runs_it_again() {
    let sealed = Sealed::with("name: x\ninclude: part.yaml\n");
    let part = |text: &str| {
        format!(
            "stages:\n  a: {{ kind: concat, with: {{ separator: {text} }}, inputs: {{ parts: {{ file: d.txt }} }} }}\n"
        )
    };
    sealed.write("d.txt", "one");
    sealed.write("part.yaml", &part("s"));
    let mut child =
        sealed.command("watch p.yaml").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let result = || std::fs::read_to_string(sealed.path("results/x-default/a.md")).unwrap_or_default();
    until("it ran", || result() == "one");
    sealed.write("part.yaml", "stages: [\n");
    std::thread::sleep(std::time::Duration::from_millis(600));
    sealed.write("part.yaml", "stages:\n  b: { kind: concat, inputs: { parts: { file: d.txt } } }\n");
    until("the included file was seen", || sealed.path("results/x-default/b.md").exists());
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

#[test]
fn an_edit_of_a_file_in_a_folder_from_outside_runs_it_again() {
    let text = "name: x\nstages:\n  d: { kind: import, with: { path: d/ } }\n  a:\n    kind: command\n    with: { shell: \"cat {inputs.d}/sub/* > {outputs.t}\", outputs: { t: { type: table } } }\n    inputs: { d: d }\n";
    let sealed = Sealed::with(text);
    std::fs::create_dir_all(sealed.path("d/sub")).unwrap();
    sealed.write("d/sub/one.txt", "one");
    let mut child =
        sealed.command("watch p.yaml").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let result = || std::fs::read_to_string(sealed.path("results/x-default/a.csv")).unwrap_or_default();
    until("it ran", || result() == "one");
    sealed.write("d/sub/one.txt", "other");
    until("the edit was seen", || result() == "other");
    sealed.write("d/sub/two.txt", " and two");
    until("the new file was seen", || result() == "other and two");
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

#[test]
fn as_json_lines_a_mistake_is_an_event_too() {
    let sealed = Sealed::with("name: x\nstages: nonsense\n");
    let out = std::fs::File::create(sealed.path("out")).unwrap();
    let mut child = sealed.command("watch p.yaml --json").stdout(out).stderr(Stdio::null()).spawn().unwrap();
    let events = || lines(&sealed.read("out"));
    until("the mistake is an event", || !events().is_empty());
    assert_eq!((&events()[0]["event"], &events()[0]["kind"]), (&"error".into(), &"pipeline".into()));
    sealed.write("p.yaml", "name: x\nstages:\n  a: { kind: emit, with: { text: a } }\n");
    until("it ran", || events().last().unwrap()["event"] == "ended");
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
}
