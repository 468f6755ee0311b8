//! Merges values: maps are merged entry by entry, anything else is replaced.

use std::collections::HashMap;
use std::sync::Arc;

use crate::spec::node::{Key, Node, Value};

/// Merges `overlay` over `base`. A merged map keeps the place of `base`; every value in it keeps its own place.
pub(super) fn merge(base: Node, overlay: Node) -> Node {
    if overlay.replace {
        return overlay;
    }
    let Node { value, span, via, replace } = base;
    match (value, overlay.value) {
        (Value::Map(below), Value::Map(over)) => {
            Node { value: Value::Map(merge_entries(below, over)), span, via, replace }
        }
        (_, value) => Node { value, ..Node { value: Value::Null, ..overlay } },
    }
}

fn merge_entries(below: Vec<(Key, Node)>, over: Vec<(Key, Node)>) -> Vec<(Key, Node)> {
    let mut places: HashMap<Arc<str>, usize> =
        below.iter().enumerate().map(|(at, (key, _))| (key.text.clone(), at)).collect();
    let mut entries: Vec<Option<(Key, Node)>> = below.into_iter().map(Some).collect();
    for (key, node) in over {
        let at = *places.entry(key.text.clone()).or_insert(entries.len());
        match entries.get_mut(at) {
            Some(entry) => {
                let merged = match entry.take() {
                    Some((_, below)) => merge(below, node),
                    None => node,
                };
                *entry = Some((key, merged));
            }
            None => entries.push(Some((key, node))),
        }
    }
    entries.into_iter().flatten().collect()
}

/// The layers that matter: from the last one that replaces everything below it.
pub(super) fn effective<'n>(layers: &[&'n Node]) -> Vec<&'n Node> {
    let merges = |node: &Node| match &node.value {
        Value::Map(_) => !node.replace,
        // It may be a reference to a map, which is merged.
        Value::Text(text) => text.starts_with('$'),
        _ => false,
    };
    let from = layers.iter().rposition(|node| !merges(node)).unwrap_or(0);
    layers[from..].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resolve::params::to_json;
    use crate::spec::problem::ProblemList;
    use crate::spec::yaml;
    use serde_json::{Value as Json, json};

    fn node(text: &str) -> Node {
        yaml::read(text, 0, 0, &mut ProblemList::default()).unwrap()
    }

    fn merged(base: &str, overlay: &str) -> Json {
        to_json(&merge(node(base), node(overlay)))
    }

    #[test]
    fn maps_merge_and_scalars_and_lists_replace() {
        assert_eq!(
            merged("{a: {b: 1, c: 2}, d: [1, 2]}", "{a: {c: 3, e: 4}, d: [5]}"),
            json!({"a": {"b": 1, "c": 3, "e": 4}, "d": [5]})
        );
        assert_eq!(merged("{a: {b: 1}}", "{a: 5}"), json!({"a": 5}));
        assert_eq!(merged("{a: 5}", "{a: {b: 1}}"), json!({"a": {"b": 1}}));
        assert_eq!(merged("{a: 5}", "{a: null}"), json!({"a": null}));
    }

    #[test]
    fn a_map_tagged_replace_is_not_merged() {
        assert_eq!(
            merged("{env: {car: {v: 1}}}", "{env: !replace {lander: {}}}"),
            json!({"env": {"lander": {}}})
        );
    }

    #[test]
    fn only_the_layers_from_the_last_replacement_on_matter() {
        let layers = [node("{a: 1}"), node("5"), node("{b: 1}"), node("$c")];
        let layers: Vec<&Node> = layers.iter().collect();
        assert_eq!(effective(&layers).len(), 3);
        assert_eq!(effective(&layers[2..]).len(), 2);
        assert!(effective(&[]).is_empty());
    }
}
