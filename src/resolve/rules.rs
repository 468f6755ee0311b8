//! What the rules of a matrix have in common: `include`, `exclude` and `when` are maps of values, or lists of such maps.

use super::scope::Filler;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::suggest;

/// The maps of a rule: one, or a list of them.
pub(super) fn maps<'n>(
    node: &'n Node,
    what: &str,
    filler: &mut Filler<'_>,
) -> Option<Vec<&'n [(Key, Node)]>> {
    let items =
        if let Value::List(items) = &node.value { items.as_slice() } else { std::slice::from_ref(node) };
    let mut maps = Vec::new();
    for item in items {
        let Value::Map(entries) = &item.value else {
            filler.problems.add(|| {
                Problem::new(
                    item.span,
                    format!("found {} in `{what}`, expected a map of axes and values", item.describe()),
                )
                .hint(format!("as in `{what}: [{{ expert: clipped, seed: [1, 2] }}]`"))
            });
            return None;
        };
        maps.push(entries.as_slice());
    }
    Some(maps)
}

/// A value, or each of a list.
pub(super) fn one_or_more(node: &Node) -> &[Node] {
    if let Value::List(items) = &node.value { items } else { std::slice::from_ref(node) }
}

/// "did you mean" for a value that is none of these. Values are compared as they are written, so a number in another notation is
/// another value.
pub(super) fn value_hint(seen: &str, what: &str, known: &[&str]) -> String {
    let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite());
    let equal = number(seen).and_then(|seen| known.iter().find(|text| number(text) == Some(seen)));
    match equal {
        Some(equal) => {
            let list = suggest::list(known);
            format!("did you mean `{equal}`? a value is named as it is written; {what} are {list}")
        }
        None => suggest::hint(seen, what, known.iter().copied()),
    }
}
