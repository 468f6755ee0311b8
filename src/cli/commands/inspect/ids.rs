//! Names of stage instances where there is no graph: those of past runs, whose pipeline may have changed since.

use crate::cli::names::word;

/// The stage's name and the coordinates of `dril[expert=clipped, policy=beta]`.
pub(super) fn parts(id: &str) -> (&str, Vec<(&str, &str)>) {
    let (name, rest) = id.strip_suffix(']').and_then(|id| id.split_once('[')).unwrap_or((id, ""));
    let pairs = rest.split(',').filter_map(|pair| pair.split_once('='));
    (name, pairs.map(|(axis, value)| (axis.trim(), value.trim())).collect())
}

/// The stage's name and its axes.
pub(super) fn axes(id: &str) -> (&str, Vec<&str>) {
    let (name, coordinates) = parts(id);
    (name, coordinates.into_iter().map(|(axis, _)| axis).collect())
}

/// One word for instances of one stage: its id where it is one, else the name with the coordinates that they share, and their number.
pub(super) fn group(ids: &[&str]) -> String {
    let Some((first, others)) = ids.split_first() else { return String::new() };
    if others.is_empty() {
        return (*first).to_owned();
    }
    let (name, mut shared) = parts(first);
    for id in others {
        let (_, coordinates) = parts(id);
        shared.retain(|coordinate| coordinates.contains(coordinate));
    }
    let shared: Vec<String> = shared.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
    word(name, &shared, ids.len())
}

/// Words for instances of any stages, one a stage.
pub(super) fn groups(ids: &[&str]) -> String {
    let mut stages: Vec<Vec<&str>> = Vec::new();
    for id in ids {
        match stages.iter_mut().find(|group| parts(group[0]).0 == parts(id).0) {
            Some(group) => group.push(id),
            None => stages.push(vec![id]),
        }
    }
    stages.iter().map(|ids| group(ids)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_are_named_by_what_they_share() {
        assert_eq!(group(&["a[x=1, y=2]"]), "a[x=1, y=2]");
        assert_eq!(group(&["a[x=1, y=2]", "a[x=1, y=3]"]), "a[x=1] × 2");
        assert_eq!(groups(&["a[x=1]", "b", "a[x=2]"]), "a × 2, b");
        assert_eq!(axes("a[x=1, y=2]"), ("a", vec!["x", "y"]));
        assert_eq!(parts("a"), ("a", vec![]));
    }
}
