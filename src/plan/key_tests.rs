//! The law of keys: the same work has the same key for ever, and different work never has.

use std::collections::HashMap;

use proptest::prelude::*;
use serde_json::json;

use super::*;

fn work(params: &Value) -> KeyInputs<'_> {
    KeyInputs { kind: "sample", revision: 3, params, seed: Some(66), inputs: Vec::new() }
}

fn key(params: &Value) -> Key {
    work(params).key().unwrap()
}

fn labels(pairs: &[(&str, &str)]) -> Labels {
    pairs.iter().map(|(axis, value)| ((*axis).to_owned(), (*value).to_owned())).collect()
}

/// A failure here means that every cached result of every user becomes stale. If that is meant, raise the version in
/// `CONTEXT` and in the name of the records' folder; otherwise undo the change.
#[test]
fn the_canonical_bytes_and_the_key_never_change() {
    let params =
        json!({"steps": 5, "rate": 2.5e-4, "below": -7, "name": "é", "list": [true, false, null], "map": {}});
    let labels = labels(&[("expert", "clipped")]);
    let none = Labels::new();
    let one = KeyInput { port: "policy", many: false, items: vec![(Digest::of(b"weights"), &none)] };
    let many = KeyInput { port: "extra", many: true, items: vec![(Digest::of(b""), &labels)] };
    let work =
        KeyInputs { kind: "sample", revision: 3, params: &params, seed: Some(66), inputs: vec![one, many] };
    let bytes = work.canonical_bytes().unwrap();
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(hex, GOLDEN_BYTES.replace(char::is_whitespace, ""));
    assert_eq!(work.key().unwrap().hex(), GOLDEN_KEY);
    let unseeded = KeyInputs { seed: None, inputs: Vec::new(), ..work };
    assert_eq!(unseeded.key().unwrap().hex(), GOLDEN_UNSEEDED);
}

const GOLDEN_BYTES: &str = "
    060000000000000073616d706c650300000000000000080600000000000000050000000000000062656c6f7704f9ffff
    ffffffffff04000000000000006c69737407030000000000000002010003000000000000006d61700800000000000000
    0004000000000000006e616d65060200000000000000c3a904000000000000007261746505fca9f1d24d62303f050000
    000000000073746570730305000000000000000342000000000000000200000000000000050000000000000065787472
    61020100000000000000af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262010000000000
    000006000000000000006578706572740700000000000000636c69707065640600000000000000706f6c696379010100
    0000000000003edc5c4a5df8c79ef4f8dbdc373cd21ca041ccf39fe5693250d004092094dc4a";
const GOLDEN_KEY: &str = "7749fb024548a6ce3a23420f869fffa76d398a6949a98bdb6e33220ec6de3193";
const GOLDEN_UNSEEDED: &str = "1edc7375c5e0ba6a6c1fc5443689986f4fbb444f2f068ceabd037e4c0f3689d9";

#[test]
fn values_that_look_alike_have_different_keys() {
    let alike = [
        json!("a"),
        json!("a\0"),
        json!("\0a"),
        json!(["a"]),
        json!(["ab"]),
        json!(["a", "b"]),
        json!(["a", ["b"]]),
        json!(1),
        json!(1.0),
        json!("1"),
        json!(true),
        json!(-1),
        json!(-1.0),
        json!(u64::MAX),
        json!(i64::MIN),
        json!(u64::MAX as f64),
        json!([1]),
        json!([[1]]),
        json!(0),
        json!(0.0),
        json!(-0.0),
        json!(false),
        json!(null),
        json!(""),
        json!([]),
        json!({}),
        json!([[]]),
        json!([{}]),
        json!({"": null}),
        json!({"a": {}}),
        json!({"a": []}),
        json!({"a": null}),
        json!({"a": 1, "b": 2}),
        json!({"a": {"b": 2}}),
        json!({"a1": "b2"}),
        json!([null]),
        json!({"ab": "c"}),
        json!({"a": "bc"}),
        json!([["a", 1], ["b", 2]]),
    ];
    let mut seen = HashMap::new();
    for value in &alike {
        if let Some(other) = seen.insert(key(value), value) {
            panic!("{value} and {other} have the same key");
        }
    }
}

#[test]
fn whatever_a_result_depends_on_changes_the_key() {
    let params = json!({"a": 1});
    let (none, north, south) = (Labels::new(), labels(&[("side", "north")]), labels(&[("side", "south")]));
    let (x, y) = (Digest::of(b"x"), Digest::of(b"y"));
    let base = work(&params);
    let wired =
        |port, many, items| KeyInputs { inputs: vec![KeyInput { port, many, items }], ..base.clone() };
    let mut keys: Vec<Key> = [
        base.clone(),
        KeyInputs { kind: "sampl", ..base.clone() },
        KeyInputs { revision: 4, ..base.clone() },
        KeyInputs { seed: None, ..base.clone() },
        KeyInputs { seed: Some(0), ..base.clone() },
        wired("in", false, vec![(x, &none)]),
        wired("in", false, vec![(y, &none)]),
        wired("on", false, vec![(x, &none)]),
        wired("in", true, vec![(x, &none)]),
        wired("in", true, vec![(x, &north)]),
        wired("in", true, vec![(x, &south)]),
        wired("in", true, vec![(x, &north), (y, &south)]),
        wired("in", true, vec![(y, &south), (x, &north)]),
        wired("in", true, vec![(x, &south), (y, &north)]),
        wired("in", true, vec![(x, &north), (x, &south)]),
    ]
    .iter()
    .map(|work| work.key().unwrap())
    .collect();
    let count = keys.len();
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), count);
}

#[test]
fn neither_the_order_of_ports_nor_the_labels_of_a_single_input_change_the_key() {
    let params = json!({});
    let (none, some) = (Labels::new(), labels(&[("side", "north")]));
    let input = |port, labels| KeyInput { port, many: false, items: vec![(Digest::of(b"x"), labels)] };
    let key = |inputs| KeyInputs { inputs, ..work(&params) }.key().unwrap();
    assert_eq!(
        key(vec![input("a", &none), input("b", &none)]),
        key(vec![input("b", &some), input("a", &none)])
    );
}

#[test]
fn a_number_that_is_not_finite_is_refused_with_its_path() {
    // JSON itself cannot hold one; a number of a wider type can become one.
    for text in ["1e999", "-1e999"] {
        assert!(serde_json::from_str::<Value>(text).is_err(), "{text}");
    }
    let error = NoKey { path: String::new(), value: "inf".into() }.below("rate").below("adam");
    assert_eq!(error.to_string(), "`adam.rate` is inf, expected a finite number of at most 64 bits");
}

fn any_value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        any::<f64>().prop_filter("finite", |float| float.is_finite()).prop_map(Value::from),
        "[a-c\0]{0,3}".prop_map(Value::from),
    ];
    leaf.prop_recursive(3, 16, 4, |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            proptest::collection::btree_map("[a-c]{0,2}", inner, 0..4)
                .prop_map(|map| Value::from(map.into_iter().collect::<Map<_, _>>())),
        ]
    })
}

proptest! {
    #[test]
    fn two_values_have_one_key_only_if_they_are_the_same(a in any_value(), b in any_value()) {
        // `0.0 == -0.0`, but they are two numbers: the text tells them apart.
        let (same_key, same_text) = (key(&a) == key(&b), serde_json::to_vec(&a).ok() == serde_json::to_vec(&b).ok());
        prop_assert_eq!(same_key, same_text);
    }

    #[test]
    fn a_key_survives_the_way_through_a_file(value in any_value()) {
        let read: Value = serde_json::from_str(&value.to_string()).unwrap();
        prop_assert_eq!(key(&read), key(&value));
    }
}
