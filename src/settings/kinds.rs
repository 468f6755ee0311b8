//! The names of kinds in settings, with their places. They are checked apart from the rest, since only a program knows its
//! kinds.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;
use toml::Spanned;

use crate::spec::suggest::nearest;

/// The parts of settings that name kinds.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Named {
    slurm: Jobs,
    executors: BTreeMap<String, Executor>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Executor {
    jobs: Jobs,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Jobs {
    local: Vec<Spanned<String>>,
    kinds: BTreeMap<Spanned<String>, IgnoredAny>,
}

/// What is wrong with the kinds in a text that is valid otherwise: the place of the first mistake, and all of them.
pub(super) fn mistakes(text: &str, known: &[&str]) -> Option<(usize, String)> {
    let Named { slurm, executors } = toml::from_str(text).ok()?;
    let jobs = executors.into_values().map(|executor| executor.jobs).chain([slurm]);
    let names = jobs.flat_map(|jobs| jobs.local.into_iter().chain(jobs.kinds.into_keys()));
    let mut wrong: Vec<Spanned<String>> = names.filter(|name| !known.contains(&&**name.get_ref())).collect();
    wrong.sort_by_key(|name| name.span().start);
    let message = |name: &Spanned<String>| {
        let near = nearest(name.get_ref(), known.iter().copied());
        let near = near.map_or_else(String::new, |near| format!(", did you mean `{near}`?"));
        format!("there is no kind `{}`{near}", name.get_ref())
    };
    let first = wrong.first()?.span().start;
    Some((first, wrong.iter().map(message).collect::<Vec<_>>().join("; ")))
}
