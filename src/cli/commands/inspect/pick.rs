//! Stages and runs as named on the command line.

use crate::error::{Error, ErrorKind};
use crate::resolve::{Graph, Pattern, StageIndex};
use crate::store::Store;

/// The stages that these patterns match, in node order; all without patterns.
///
/// # Errors
/// A pattern matches no stage.
pub(in crate::cli) fn pick_stages(graph: &Graph, words: &[String]) -> Result<Vec<StageIndex>, Error> {
    let mut picked = vec![words.is_empty(); graph.stages.node_count()];
    for pattern in patterns(words)? {
        for stage in pattern.stages(graph)? {
            picked[stage.index()] = true;
        }
    }
    Ok(graph.stages.node_indices().filter(|index| picked[index.index()]).collect())
}

/// Parses patterns.
///
/// # Errors
/// A word is not a valid pattern.
pub(super) fn patterns(words: &[String]) -> Result<Vec<Pattern<'_>>, Error> {
    words.iter().map(|word| Pattern::parse(word).map_err(Error::from)).collect()
}

/// The run that a word names: its name, a unique prefix, `last`, or `last~2`.
///
/// # Errors
/// No run matches, or several do.
pub(in crate::cli) fn pick_run(store: &Store, word: &str) -> Result<String, Error> {
    let ids = store.run_ids()?;
    let wrong = |text: String| Error::new(ErrorKind::Usage, text).hint("`dril-pipe runs` lists the runs");
    if ids.is_empty() {
        let text = format!("there are no runs in `{}`", store.root().display());
        let hint = "`--cache DIR` or DRIL_PIPE_CACHE names another cache";
        return Err(Error::new(ErrorKind::Usage, text).hint(hint));
    }
    let back = match word.strip_prefix("last") {
        Some("") => Some(0),
        Some(rest) => rest.strip_prefix('~').and_then(|number| number.parse::<usize>().ok()),
        None => None,
    };
    if let Some(back) = back {
        let there =
            if ids.len() == 1 { "is only 1 run".to_owned() } else { format!("are only {} runs", ids.len()) };
        return ids.into_iter().nth(back).ok_or_else(|| wrong(format!("`{word}`: there {there}")));
    }
    let mut fitting = ids.iter().filter(|id| id.starts_with(word) && !word.is_empty());
    match (fitting.next(), fitting.count()) {
        (Some(id), 0) => Ok(id.clone()),
        (Some(_), more) => Err(wrong(format!("{} runs start with `{word}`", more + 1))),
        (None, _) => Err(wrong(format!("there is no run `{word}`"))),
    }
}
