//! Stages and runs as they are named on the command line.

use crate::error::{Error, ErrorKind};
use crate::resolve::{Graph, StageIndex};
use crate::spec::suggest;
use crate::store::Store;

/// The stages that these words name, in node order; all for no word.
///
/// # Errors
/// A word names none.
pub(in crate::cli) fn pick_stages(graph: &Graph, words: &[String]) -> Result<Vec<StageIndex>, Error> {
    let all = || graph.stages.node_indices();
    let mut picked = vec![words.is_empty(); graph.stages.node_count()];
    for word in words {
        let mut found = false;
        for index in all() {
            let stage = &graph.stages[index];
            if names(word, &stage.id) {
                picked[index.index()] = true;
                found = true;
            }
        }
        if !found {
            let ids = graph.stages.node_weights().map(|stage| &*stage.name).chain(
                graph
                    .stages
                    .node_weights()
                    .filter(|stage| !stage.coordinates.is_empty())
                    .map(|stage| &*stage.id),
            );
            let mut known: Vec<&str> = Vec::new();
            ids.for_each(|id| {
                if !known.contains(&id) && known.len() < 10_000 {
                    known.push(id);
                }
            });
            return Err(Error::new(ErrorKind::Usage, format!("no stage is called `{word}`"))
                .hint(suggest::hint(word, "its stages", known)));
        }
    }
    Ok(all().filter(|index| picked[index.index()]).collect())
}

/// True where a word names the stage with that id: the id itself, its name, some of its coordinates in any order
/// (`dril[policy=beta]`), or a pattern that fits one of these.
pub(super) fn names(word: &str, id: &str) -> bool {
    let (name, coordinates) = taken_apart(id);
    if word == id || fits(word, id) {
        return true;
    }
    let (wanted, of) = taken_apart(word);
    fits(wanted, name)
        && of.iter().all(|part| coordinates.iter().any(|coordinate| fits(part.trim(), coordinate.trim())))
}

fn taken_apart(id: &str) -> (&str, Vec<&str>) {
    match id.strip_suffix(']').and_then(|id| id.split_once('[')) {
        Some((name, coordinates)) => (name, coordinates.split(',').map(str::trim).collect()),
        None => (id, Vec::new()),
    }
}

/// A pattern with `*` (any text) and `?` (any letter).
fn fits(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) = (pattern.chars().collect(), text.chars().collect());
    let (mut at, mut seen) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while seen < text.len() {
        match pattern.get(at) {
            Some('*') => {
                star = Some((at, seen));
                at += 1;
            }
            Some(letter) if *letter == '?' || *letter == text[seen] => {
                at += 1;
                seen += 1;
            }
            _ => {
                let Some((behind, from)) = star else { return false };
                star = Some((behind, from + 1));
                at = behind + 1;
                seen = from + 1;
            }
        }
    }
    pattern[at..].iter().all(|letter| *letter == '*')
}

/// The run that a word names: its name, the only one that begins so, `last`, or `last~2`.
///
/// # Errors
/// There is no such run, or more than one.
pub(in crate::cli) fn pick_run(store: &Store, word: &str) -> Result<String, Error> {
    let ids = store.run_ids()?;
    let wrong = |text: String| {
        Error::new(ErrorKind::Usage, text).hint("`dril-pipe runs` lists the runs of the store")
    };
    if ids.is_empty() {
        return Err(wrong(format!("there are no runs in `{}`", store.root().display())));
    }
    let back = match word.strip_prefix("last") {
        Some("") => Some(0),
        Some(rest) => rest.strip_prefix('~').and_then(|number| number.parse::<usize>().ok()),
        None => None,
    };
    if let Some(back) = back {
        let count = ids.len();
        return ids
            .into_iter()
            .nth(back)
            .ok_or_else(|| wrong(format!("`{word}`: there are only {count} runs")));
    }
    let mut fitting = ids.iter().filter(|id| id.starts_with(word) && !word.is_empty());
    match (fitting.next(), fitting.count()) {
        (Some(id), 0) => Ok(id.clone()),
        (Some(_), more) => Err(wrong(format!("{} runs have names that begin with `{word}`", more + 1))),
        (None, _) => Err(wrong(format!("no run is called `{word}`"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_is_named_by_id_name_coordinates_or_pattern() {
        let id = "dril[expert=clipped, policy=beta]";
        for word in [
            "dril",
            id,
            "dril[policy=beta]",
            "dril[policy=beta,expert=clipped]",
            "d*",
            "dr?l",
            "*[policy=b*]",
        ] {
            assert!(names(word, id), "{word}");
        }
        for word in ["dri", "dril[policy=gaussian]", "dril[seed=1]", "", "e*", "dril[policy=bet?a]"] {
            assert!(!names(word, id), "{word}");
        }
    }

    #[test]
    fn a_pattern_of_many_stars_ends() {
        assert!(!fits(&"*a".repeat(200), &"a".repeat(150)));
        assert!(fits(&"*".repeat(200), "x"));
    }
}
