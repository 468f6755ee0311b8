//! Pipeline files as text: what is read, and that nothing, however broken, makes the reader panic or hang.

use dril_pipe::resolve::{Choices, resolve};
use dril_pipe::spec::{Diagnostics, SourceName, parse, parse_bytes};
use proptest::prelude::*;

use crate::samples;

const SAMPLE: &str = include_str!("sample.yaml");

fn name() -> SourceName {
    SourceName("sample.yaml".to_owned())
}

/// All the way, with everything that is said put into words.
fn read(bytes: &[u8], set: &[String]) -> Result<usize, Diagnostics> {
    let spec = parse_bytes(bytes, &name())?;
    let choices = Choices { set: set.to_vec(), ..Choices::default() };
    resolve(&spec, &choices, &samples::registry()).map(|graph| graph.stages.node_count())
}

/// Whatever comes out must be fit to print: a place inside the text, no control characters.
fn sound(said: &Diagnostics) {
    assert!(!said.is_empty());
    for problem in said.iter() {
        for place in &problem.places {
            let length = place.text.chars().count();
            assert!(place.indent <= length + 1 && place.width >= 1, "{place:?}");
        }
    }
    let text = said.to_string();
    assert!(!text.contains(|c: char| c.is_control() && c != '\n'), "{text:?}");
}

#[test]
fn a_spec_tells_its_name_profiles_and_stages_in_the_order_of_the_file() {
    let spec = parse(SAMPLE, &name()).unwrap();
    assert_eq!(spec.pipeline(), "sample");
    assert_eq!(spec.profiles().collect::<Vec<_>>(), ["full", "smoke"]);
    assert_eq!(spec.stages().next(), Some("train"));
}

#[test]
fn a_byte_order_mark_and_windows_line_ends_change_nothing() {
    let windows = format!("\u{feff}{}", SAMPLE.replace('\n', "\r\n"));
    let count = read(SAMPLE.as_bytes(), &[]).unwrap();
    assert_eq!(read(windows.as_bytes(), &[]).unwrap(), count);
}

#[test]
fn a_huge_file_is_refused_before_it_is_read() {
    let text = "#".repeat((64 << 20) + 1);
    assert!(parse(&text, &name()).unwrap_err().to_string().contains("expected at most"));
}

#[test]
fn ten_thousand_problems_are_cut_short() {
    let stages: String = (0..10_000).map(|n| format!("  s{n}: {{ kind: trian }}\n")).collect();
    let said = read(format!("name: sample\nstages:\n{stages}").as_bytes(), &[]).unwrap_err();
    assert_eq!(said.iter().count(), 100);
    assert!(said.to_string().ends_with("more problems; fix these first\n"));
}

/// Words of the language, so that random texts get past the first line.
#[rustfmt::skip]
const WORDS: &[&str] = &[
    "name: sample\n", "seed: 3\n", "params:\n", "axes:\n", "stages:\n", "defaults:\n", "profiles:\n",
    "  a: ", "  b:\n", "    kind: train\n", "    with: ", "    inputs: ", "    matrix: ", "    seed: ",
    "{ ", " }", "[", "]", ", ", ": ", "$a", "${a}", "$$", "$", "a", "train", "train.policy",
    "\"train[a=*]\"", "a|b", "[a=1].b", "{ file: x }", "steps: 5", "5", "-1", ".nan", "1e3", "true", "~",
    "&x ", "*x", "!replace ", "!!str ", "<<: ", "- ", "? ", "|\n", ">-\n", "'", "\"", "#", "\n", "\n  ",
    "\n    ", "\t", "---\n", "...\n", "%YAML 1.2\n", "ä", "\u{1f600}", "\u{0}", "\u{202e}", "\r",
];

fn fragment() -> impl Strategy<Value = String> {
    proptest::sample::select(WORDS).prop_map(str::to_owned)
}

/// The sample with a few stretches cut out, doubled, or replaced.
fn mutated() -> impl Strategy<Value = String> {
    let edit =
        (any::<proptest::sample::Index>(), 0..30_usize, proptest::option::of(fragment()), any::<bool>());
    proptest::collection::vec(edit, 1..6).prop_map(|edits| {
        let mut text: Vec<char> = SAMPLE.chars().collect();
        for (at, length, insert, double) in edits {
            let at = at.index(text.len() + 1);
            let end = (at + length).min(text.len());
            let cut: Vec<char> = text.splice(at..end, insert.unwrap_or_default().chars()).collect();
            if double {
                text.splice(at..at, cut.iter().chain(&cut).copied());
            }
        }
        text.into_iter().collect()
    })
}

proptest! {
    #[test]
    fn random_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        if let Err(said) = read(&bytes, &[]) {
            sound(&said);
        }
    }

    #[test]
    fn random_words_of_the_language_are_read_or_refused(words in proptest::collection::vec(fragment(), 0..60)) {
        if let Err(said) = read(words.concat().as_bytes(), &[]) {
            sound(&said);
        }
    }

    #[test]
    fn a_pipeline_with_random_edits_is_read_or_refused(text in mutated()) {
        if let Err(said) = read(text.as_bytes(), &[]) {
            sound(&said);
        }
    }

    #[test]
    fn random_set_arguments_are_taken_or_refused(words in proptest::collection::vec(fragment(), 0..6), path in "[a-z.]{0,12}=?") {
        let set = format!("{path}{}", words.concat());
        if let Err(said) = read(SAMPLE.as_bytes(), &[set]) {
            sound(&said);
        }
    }
}
