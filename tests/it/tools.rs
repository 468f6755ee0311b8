//! Tools: subcommands that work on one artifact.

use serde_json::{Value, json};

use crate::cli::WORDS;
use crate::sealed::Sealed;

fn request(sealed: &Sealed, args: &str) -> Value {
    serde_json::from_str(&sealed.run_ok(args)).unwrap()
}

#[test]
fn a_tool_gets_the_artifact_of_a_stage_and_a_parameter_of_the_nearest_stage_upstream() {
    let sealed = Sealed::with(WORDS);
    let early = sealed.run("peek p.yaml:count[word=one] --out x.txt");
    assert_eq!(early.code, 3);
    assert!(early.stderr.contains("has not been run"), "{}", early.stderr);
    sealed.run_ok("run p.yaml");
    let request = request(&sealed, "peek p.yaml:count[word=one] --out x.txt --mode fast");
    let path = request["policy"].as_str().unwrap();
    assert!(path.contains("blobs-v1"), "{path}");
    let rest = json!({
        "policy": path, "seed": 7, "out": "x.txt", "text": "one: ", "mode": "fast", "speed": 0.5,
    });
    assert_eq!(request, rest);
}

#[test]
fn a_tool_works_on_a_file_and_its_options_are_checked_first() {
    let sealed = Sealed::new();
    sealed.write("w.bin", "weights");
    let request = request(&sealed, "peek w.bin --out x.txt --text [1] --seed 3");
    assert_eq!(request["policy"], "w.bin");
    assert_eq!((&request["text"], &request["seed"]), (&json!([1]), &json!(3)));
    assert_eq!(sealed.run("peek w.bin --out x.csv").code, 2);
    assert_eq!(sealed.run("peek w.bin --out no/such/x.txt").code, 4);
    assert_eq!(sealed.run("peek w.bin --out x.txt --mode other").code, 2);
    let missing = sealed.run("peek nothing --out x.txt");
    assert!(
        missing.stderr.contains("name a policy file, or a stage as in `p.yaml:count`"),
        "{}",
        missing.stderr
    );
}

#[test]
fn the_help_of_a_tool_begins_with_its_own_description() {
    let help = Sealed::new().run_ok("peek --help");
    assert!(help.starts_with("Print what a tool is asked for\n"), "{help}");
}
