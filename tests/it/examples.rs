//! The pipelines that come as examples run, from nothing, with a shell and python3 alone; a second run runs nothing.

use std::path::Path;

use crate::sealed::{Sealed, ended};

fn run(sealed: &Sealed, example: &str, more: &str) -> String {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("pipelines/examples/{example}/{example}.yaml"));
    let mut command = sealed.command(&format!("run {} --out results{more}", file.display()));
    command.env("PATH", std::env::var_os("PATH").unwrap());
    let ended = ended(command);
    assert_eq!(ended.code, 0, "{example}: {ended:?}");
    ended.stdout
}

#[test]
fn the_examples_run_from_nothing_and_then_not_again() {
    for (example, more, result, line) in [
        ("words", "", "shared.csv", "the,4,12"),
        ("pi", " --profile quick", "error.csv", "1000,2,"),
        ("fit", " --profile quick", "choose.csv", "3,5,"),
    ] {
        let sealed = Sealed::new();
        run(&sealed, example, more);
        let table = sealed.read(&format!("results/{result}"));
        assert!(table.lines().any(|row| row.starts_with(line)), "{example}: {table}");
        assert!(run(&sealed, example, more).contains("0 stages executed"), "{example}");
    }
}
