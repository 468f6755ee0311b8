//! Whatever is read stage by stage is what is read as a whole; with a memo, without, and with a damaged one.

use proptest::prelude::*;

use super::*;

fn whole(text: &str) -> Option<Node> {
    yaml::read(text, 0, 0, &mut ProblemList::default())
}

/// True where a text can be read in pieces; then it is the same.
fn compare(text: &str) -> bool {
    assert!(pieces_agree(text), "{text}");
    let mut memo = Memo::default();
    let can = read(text, 0, &mut memo).is_some();
    assert_eq!(can, memo.bytes().is_some(), "{text}");
    let known = memo.bytes().map(Memo::read);
    if let Some(mut memo) = known {
        assert!(read(text, 0, &mut memo).is_some() && memo.bytes().is_none(), "nothing is new: {text}");
    }
    can
}

const PLAIN: &str = "# a file\nname: x\nparams: { a: 1 }\nstages: # here\n\n  # first\n  a: { kind: k, with: { x: 1.5, y: [a, 'b'] } }\n  b:\n    kind: k\n    with:\n      text: |\n        one\n\n        two\n    # a comment\n\n  c: { kind: k,\n    with: !replace { n: null, t: true, s: \"q\\n\" },\n    inputs: { in: a } }\n  d:\nprofiles:\n  p: {}\n# end\n";

#[test]
fn a_plain_file_is_read_stage_by_stage_and_is_the_same() {
    assert!(compare(PLAIN));
    assert!(compare(PLAIN.trim_end_matches('\n')));
    assert!(compare(PLAIN.split("profiles").next().unwrap()));
    assert!(compare(&PLAIN.replace("  d:\n", "  d: |+\n    x\n\n\n")));
    assert!(compare("stages:\n a: 1\n b: x\n  y\n c: &here [1]\n"));
    assert!(compare("stages:\n  a: 1\n  a1: 1\n  ba:\n   - x\n"));
}

#[test]
fn what_cannot_be_cut_is_read_as_a_whole() {
    for (from, to) in [
        ("name: x", "name: x\r"),
        ("  b:\n", "  a:\n"),
        ("  b:\n", " b:\n"),
        ("  b:\n", "  \"b\n  c:\n"),
        ("x: 1.5", "x: &one 1.5, z: *one"),
        ("name: x\n", "--- \nname: x\n"),
        ("name: x\n", "name: x\nstages: {}\n"),
        ("profiles:", "name:"),
        ("profiles:", "..."),
        ("# end", "stages:\n  z: {}"),
        ("n: null", "n: .nan"),
        ("n: null", "n: ]"),
        ("  b:\n", "  _:\n"),
        ("  b:\n", "  &b\n"),
        ("  b:\n", "  b\n"),
        ("profiles:", "!x\nprofiles:"),
        ("stages: # here", "stages: !replace"),
        ("stages: # here", "stages: {}\nx:"),
        ("params: { a: 1 }", "params: \"{ a: 1 }"),
        ("kind: k, with", "kind: k, kind: k, with"),
    ] {
        let text = PLAIN.replacen(from, to, 1);
        assert_ne!(text, PLAIN);
        assert!(!compare(&text), "{text}");
    }
    // A key without a value takes what follows for it.
    assert!(!compare("stages:\n  a: 1\n  b:\n  - c\n"));
    assert!(!compare("stages:\n  a: 1\n  b:\n  &c\n    d: 1\n"));
    assert!(!compare("name: x\n") && !compare("") && !compare("stages:\n"));
}

#[test]
fn after_an_edit_only_the_stage_that_it_touched_is_new() {
    let mut memo = Memo::default();
    read(PLAIN, 0, &mut memo).unwrap();
    let kept = memo.bytes().unwrap();
    let edited = PLAIN.replace("x: 1.5", "x: 250").replace("name: x", "name: longer");
    let mut memo = Memo::read(kept.clone());
    let root = read(&edited, 0, &mut memo).unwrap();
    assert_eq!(format!("{:?}", Some(root)), format!("{:?}", whole(&edited)));
    let after = memo.bytes().unwrap();
    assert_eq!(memo.known.len(), 4);
    let same = Memo::read(after).known.into_keys().filter(|text| memo.known.contains_key(text)).count();
    assert_eq!(same, 3);
    // The places are those of this file and of this source.
    let mut memo = Memo::read(kept);
    let root = read(&format!("# longer\n{PLAIN}"), 7, &mut memo).unwrap();
    assert_eq!(root.get("stages").unwrap().0.span.source, 7);
}

#[test]
fn a_damaged_memo_is_none() {
    let mut memo = Memo::default();
    read(PLAIN, 0, &mut memo).unwrap();
    let bytes = memo.bytes().unwrap();
    assert_eq!(Memo::read(bytes.clone()).known.len(), 4);
    for at in 0..bytes.len() {
        let mut bent = bytes.clone();
        bent[at] ^= 1;
        assert!(Memo::read(bent).known.is_empty() && Memo::read(bytes[..at].to_vec()).known.is_empty());
    }
    // One that was made so: its digests are right, its values are not.
    for at in 0..bytes.len() - 32 {
        let mut body = bytes[32..].to_vec();
        body[at] ^= 0x15;
        let mut memo = Memo::read([blake3::hash(&body).as_bytes(), &*body].concat());
        let _ = read(PLAIN, 0, &mut memo);
    }
}

proptest! {
    #[test]
    fn pieces_are_what_the_whole_is(lines in proptest::collection::vec(line(), 1..24)) {
        let text = format!("name: x\nstages:\n  first: 1\n{}", lines.concat());
        compare(&text);
        compare(&lines.concat());
        compare(text.trim_end());
    }
}

fn line() -> impl Strategy<Value = String> {
    let start = prop_oneof![
        Just(""),
        Just("  "),
        Just("  "),
        Just("    "),
        Just("   "),
        Just(" "),
        Just("      "),
        Just("\t")
    ];
    let middle = prop_oneof![
        "[a-e]: [a-e0-9]{0,3}",
        "[a-e]:",
        "[a-e]: [|>][+-]?",
        "[a-e]: \\{ [a-c]: 1, [a-c]: [0-9.]{1,3}( \\})?",
        "[a-e]: \"[a-c]\"?",
        "[a-e]: '[a-c]{0,2}'",
        "(\\]|\\}|\"|'|#|- [a-c]|\\? [a-c]|[a-c]|stages:|profiles:|---|&a|\\*a|a: &a b|b: \\*a|!replace)",
        "",
    ];
    (start, middle, prop_oneof![Just(""), Just(" # x"), Just(" "), Just(",")])
        .prop_map(|(start, middle, end)| format!("{start}{middle}{end}\n"))
}
