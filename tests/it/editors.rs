//! What editors, shells and `man` receive: the schema fits every pipeline that resolves and refuses what is wrong by its
//! shape, completions and pages know every command.

use std::path::{Path, PathBuf};

use jsonschema::Validator;
use serde_json::Value;

use crate::sealed::{Sealed, ended};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The schema as the program prints it.
fn schema(kinds: &str) -> Validator {
    let mut command = Sealed::new().command("schema");
    command.current_dir(root()).env("DRIL_FAKES_KINDS", kinds);
    let printed = ended(command);
    assert_eq!(printed.code, 0, "{printed:?}");
    let schema: Value = serde_json::from_str(&printed.stdout).unwrap();
    jsonschema::meta::validate(&schema).unwrap();
    jsonschema::validator_for(&schema).unwrap()
}

/// A file as JSON; `None` where YAML itself refuses it.
fn read(path: &Path) -> Option<Value> {
    serde_saphyr::from_str(&String::from_utf8(std::fs::read(path).ok()?).ok()?).ok()
}

fn yaml_below(folder: &str) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = Vec::new();
    let mut open = vec![root().join(folder)];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.extension() {
                _ if path.is_dir() => open.push(path),
                Some(ending) if ending == "yaml" => found.push(path),
                _ => {}
            }
        }
    }
    found.sort();
    found
}

#[test]
fn the_schema_fits_the_examples() {
    let schema = schema("samples");
    let files = yaml_below("pipelines/examples");
    assert!(files.len() >= 3);
    for file in files {
        let value = read(&file).unwrap_or_else(|| panic!("{}", file.display()));
        let errors: Vec<String> =
            schema.iter_errors(&value).map(|error| format!("{}: {error}", error.instance_path())).collect();
        assert!(errors.is_empty(), "{}: {errors:#?}", file.display());
    }
}

/// Valid files in notations that a schema could take for mistakes.
const VALID: [&str; 4] = [
    "name: a\nparams: { all: { steps: 5 } }\nstages: { t: { kind: train, with: $all } }\n",
    "name: a\nparams: { all: { steps: 5 } }\ndefaults: { train: { with: $all } }\nstages: { t: { kind: train } }\n",
    "name: a\nparams: { all: { steps: 5 } }\nstages: { t: { kind: train, with: ~ } }\nprofiles: { p: { t: $all } }\n",
    "name: a\ninclude: [{ file }]\nstages: { t: { kind: train, with: { steps: $n } } }\n",
];

/// A file that may be included.
const INCLUDED: &str = "name: only-params\nparams: { n: 5 }\n";

#[test]
fn the_schema_accepts_whatever_resolves() {
    let schema = schema("samples");
    let sealed = Sealed::new();
    sealed.write("included.yaml", INCLUDED);
    for text in VALID
        .map(|text| text.replace("{ file }", "included.yaml"))
        .iter()
        .map(String::as_str)
        .chain([INCLUDED])
    {
        if text != INCLUDED {
            sealed.write("p.yaml", text);
            let mut command = sealed.command("graph p.yaml");
            command.env("DRIL_FAKES_KINDS", "samples");
            let resolved = ended(command);
            assert_eq!(resolved.code, 0, "{text}{}", resolved.stderr);
        }
        let value: Value = serde_saphyr::from_str(text).unwrap();
        let errors: Vec<String> = schema.iter_errors(&value).map(|error| error.to_string()).collect();
        assert!(errors.is_empty(), "{text}{errors:?}");
    }
}

/// What is wrong by its shape alone. The rest of `tests/bad` needs the whole file: names, wiring, ranges.
const WRONG_BY_SHAPE: [&str; 22] = [
    "a_list",
    "a_text",
    "bad_name",
    "bad_seed",
    "bad_stage_name",
    "command_with_slips",
    "empty_kind",
    "input_is_a_number",
    "misspelt_field",
    "misspelt_nested_field",
    "misspelt_stage_key",
    "misspelt_top_key",
    "misspelt_value",
    "no_kind",
    "reserved_stage_name",
    "several_at_once",
    "stage_as_text",
    "stages_as_list",
    "unknown_kind",
    "unknown_kind_in_defaults",
    "with_as_list",
    "wrong_type",
];

#[test]
fn the_schema_refuses_what_is_wrong_by_its_shape() {
    let schema = schema("samples");
    let accepted: Vec<&str> = WRONG_BY_SHAPE
        .into_iter()
        .filter(|name| {
            read(&root().join(format!("tests/bad/{name}.yaml"))).is_some_and(|file| schema.is_valid(&file))
        })
        .collect();
    assert!(accepted.is_empty(), "{accepted:?}");
}

#[test]
fn completions_and_pages_know_every_command() {
    let sealed = Sealed::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = sealed.run_ok(&format!("completions {shell}"));
        assert!(script.contains("check-determinism") && script.contains("explain"), "{shell}");
    }
    assert!(sealed.run_ok("man").contains(".TH dril-pipe 1"));
    sealed.run_ok("man --out pages");
    let pages = sealed.list("pages");
    for page in ["dril-pipe.1", "dril-pipe-run.1", "dril-pipe-cache-gc.1"] {
        assert!(pages.iter().any(|name| name == page), "{page}: {pages:?}");
    }
    assert!(sealed.read("pages/dril-pipe-run.1").contains("check\\-determinism"));
}

/// What bash offers for the last of these words, by the completion script.
fn offered(script: &Path, words: &[&str]) -> Vec<String> {
    // As bash calls the function: with the program, the word, and the word before it.
    let call = "source \"$0\"; function=$(complete -p dril-pipe | sed 's/.*-F \\([^ ]*\\).*/\\1/'); \
                COMP_WORDS=(\"$@\"); COMP_CWORD=$(($# - 1)); \
                $function dril-pipe \"${COMP_WORDS[COMP_CWORD]}\" \"${COMP_WORDS[COMP_CWORD - 1]}\"; \
                printf '%s\\n' \"${COMPREPLY[@]}\"";
    let mut bash = std::process::Command::new("bash");
    bash.args(["--norc", "-c", call]).arg(script).args(words);
    let ended = ended(bash);
    assert_eq!(ended.code, 0, "{ended:?}");
    ended.stdout.lines().map(str::to_owned).collect()
}

#[test]
fn bash_completes_every_word_and_not_only_the_first() {
    let sealed = Sealed::new();
    sealed.write("script", &sealed.run_ok("completions bash"));
    let script = sealed.path("script");
    for (words, expected) in [
        (&["dril-pipe", "ca"][..], &["cache"][..]),
        (&["dril-pipe", "cache", ""], &["verify", "gc", "remote-status"]),
        (&["dril-pipe", "cache", "remote-status", "--"], &["--remote", "--profile"]),
        (&["dril-pipe", "run", "--che"], &["--check-determinism", "--checkpoint-every"]),
        (&["dril-pipe", "completions", ""], &["bash", "zsh"]),
    ] {
        let offered = offered(&script, words);
        for expected in expected {
            assert!(offered.iter().any(|word| word == expected), "{words:?}: {offered:?}");
        }
    }
}
