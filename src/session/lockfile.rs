//! The lock file, `thesis.lock` beside `thesis.yaml`: key and output digests of every stage, one sorted line per stage, so that
//! two branches merge line by line. A run can always write it again; it exists to be compared with.
//!
//! A line is profile, stage, key, then `output=digest` for each output, separated by tabs. `#` starts a comment.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::error::{Error, ErrorKind};
use crate::exec::Executed;
use crate::fsx;
use crate::plan::{Plan, Verdict};
use crate::resolve::Graph;
use crate::store::{Digest, Key, Outputs};

const HEAD: &str =
    "# dril-pipe lock 1: what each stage was made as; `dril-pipe run --locked` fails where it differs\n";
/// The number of differences that an error lists.
const MAX_LISTED: usize = 20;

/// Key and outputs of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Line {
    key: Key,
    outputs: BTreeMap<String, Digest>,
}

/// The lines of a lock file, by profile and stage.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LockFile {
    lines: BTreeMap<(String, String), Line>,
}

/// The lock file of a pipeline file: the same name with extension `lock`.
pub(super) fn path_of(pipeline: &Path) -> PathBuf {
    pipeline.with_extension("lock")
}

impl LockFile {
    /// The keys of all stages.
    pub fn keys(&self) -> Vec<Key> {
        self.lines.values().map(|line| line.key).collect()
    }

    /// Reads a lock file; `None` where there is none.
    ///
    /// # Errors
    /// It cannot be read, or is not a lock file.
    pub fn read(path: &Path) -> Result<Option<Self>, Error> {
        match fsx::read_if_there(path)? {
            Some(bytes) => Self::parse(&bytes, path).map(Some),
            None => Ok(None),
        }
    }

    /// Parses the bytes of the file at `path`.
    ///
    /// # Errors
    /// All malformed lines, and all stages with two different lines.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, Error> {
        let text = String::from_utf8_lossy(bytes);
        let mut lock = Self::default();
        let mut wrong = Vec::new();
        for (number, text) in text.lines().enumerate() {
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            let mut problem = |what: String| wrong.push(format!("{}:{}: {what}", path.display(), number + 1));
            if ["<<<<<<<", "=======", ">>>>>>>", "|||||||"].iter().any(|mark| text.starts_with(mark)) {
                problem("an unresolved merge conflict".to_owned());
                continue;
            }
            match line(text) {
                Some((place, line)) => match lock.lines.get(&place) {
                    Some(other) if *other != line => {
                        problem(format!(
                            "stage `{}` has two different lines for profile `{}`",
                            place.1, place.0
                        ));
                    }
                    _ => drop(lock.lines.insert(place, line)),
                },
                None => {
                    problem("expected profile, stage, key and `output=digest`, separated by tabs".to_owned())
                }
            }
        }
        if wrong.is_empty() {
            return Ok(lock);
        }
        let hint =
            "keep the lines of one side, or delete the file and write it again with `dril-pipe run --lock`";
        Err(Error::new(ErrorKind::Pipeline, wrong.join("\n")).hint(hint))
    }

    /// The text of the file.
    pub fn text(&self) -> String {
        let mut text = HEAD.to_owned();
        for ((profile, stage), line) in &self.lines {
            text.extend([&*escaped(profile), "\t", &escaped(stage), "\t", &line.key.hex()]);
            for (output, digest) in &line.outputs {
                text.extend(["\t", &escaped(output), "=", &digest.hex()]);
            }
            text.push('\n');
        }
        text
    }

    /// Updates the lines of the stages of a run. If the run was complete, lines of stages that the pipeline no longer has are
    /// removed.
    pub(super) fn update(&mut self, graph: &Graph, keys: &Keys, executed: &Executed, whole: bool) {
        if whole {
            self.lines.retain(|(profile, _), _| *profile != graph.profile);
        }
        for index in graph.stages.node_indices() {
            let (Some(key), Some(outputs)) = (keys.get(&index), executed.outputs(index)) else { continue };
            let place = (graph.profile.clone(), graph.stages[index].id.to_string());
            self.lines.insert(place, Line { key: *key, outputs: digests(outputs) });
        }
    }

    /// How a plan differs from the lock file, as far as that is known before anything runs.
    pub(super) fn against_plan(&self, plan: &Plan<'_>) -> Vec<String> {
        let profiles: BTreeSet<&str> = self.lines.keys().map(|(profile, _)| profile.as_str()).collect();
        if !profiles.contains(&*plan.graph.profile) {
            let there = profiles.iter().map(|profile| format!("`{profile}`")).collect::<Vec<_>>().join(", ");
            let there = if there.is_empty() { "none".to_owned() } else { format!("those of {there}") };
            return vec![format!("it has no lines of profile `{}`, only {there}", plan.graph.profile)];
        }
        let mut found = Vec::new();
        for (index, verdict) in &plan.steps {
            let id = &plan.graph.stages[*index].id;
            let Some(line) = self.line(&plan.graph.profile, id) else {
                found.push(format!("`{id}` is not in the lock file"));
                continue;
            };
            if let Verdict::Cached { key, .. } | Verdict::Run { key, .. } = verdict
                && *key != line.key
            {
                found.push(format!("`{id}` has key {}, but {} is locked", key.short(), line.key.short()));
            }
        }
        let mut there: Vec<&str> = plan.graph.stages.node_weights().map(|stage| &*stage.id).collect();
        there.sort_unstable();
        for (profile, stage) in self.lines.keys() {
            if *profile == plan.graph.profile && there.binary_search(&stage.as_str()).is_err() {
                found.push(format!("`{stage}` is locked, but the pipeline has no such stage"));
            }
        }
        found
    }

    /// How the results of a run differ from the lock file.
    pub(super) fn against_results(&self, graph: &Graph, keys: &Keys, executed: &Executed) -> Vec<String> {
        let mut found = Vec::new();
        for index in graph.stages.node_indices() {
            let id = &graph.stages[index].id;
            let (Some(line), Some(outputs)) = (self.line(&graph.profile, id), executed.outputs(index)) else {
                continue;
            };
            let (outputs, key) = (digests(outputs), keys.get(&index));
            if key.is_some_and(|key| *key != line.key) {
                found.push(format!("the key of `{id}` is not the locked one: its inputs differ"));
            } else if let Some((name, digest)) =
                outputs.iter().find(|(name, digest)| line.outputs.get(*name) != Some(digest))
            {
                let locked = line.outputs.get(name).map_or("no output".to_owned(), Digest::short);
                found
                    .push(format!("output `{name}` of `{id}` is {}, but {locked} is locked", digest.short()));
            }
        }
        found
    }

    /// The number of lines that are new, different or gone.
    pub(super) fn changed_since(&self, old: Option<&Self>) -> usize {
        let Some(old) = old else { return self.lines.len() };
        let gone = old.lines.keys().filter(|place| !self.lines.contains_key(*place)).count();
        gone + self.lines.iter().filter(|(place, line)| old.lines.get(*place) != Some(line)).count()
    }

    fn line(&self, profile: &str, stage: &str) -> Option<&Line> {
        self.lines.get(&(profile.to_owned(), stage.to_owned()))
    }
}

/// The key of each stage of a run.
pub(super) type Keys = std::collections::HashMap<crate::resolve::StageIndex, Key>;

/// The error of a run that differs from the lock file.
pub(super) fn differs(path: &Path, mut found: Vec<String>) -> Error {
    let more = found.len().saturating_sub(MAX_LISTED);
    found.truncate(MAX_LISTED);
    let more = if more > 0 { format!("\n  and {more} more") } else { String::new() };
    let text = format!("the run differs from `{}`:\n  {}{more}", path.display(), found.join("\n  "));
    Error::new(ErrorKind::Check, text)
        .hint("`dril-pipe explain` shows what changed; `dril-pipe run --lock` updates the lock file")
}

fn digests(outputs: &Outputs) -> BTreeMap<String, Digest> {
    outputs.iter().map(|(name, stored)| (name.clone(), stored.digest)).collect()
}

fn line(text: &str) -> Option<((String, String), Line)> {
    let mut parts = text.trim_end_matches('\r').split('\t');
    let (profile, stage, key) = (parts.next()?, parts.next()?, parts.next()?);
    let mut outputs = BTreeMap::new();
    for part in parts {
        let (name, digest) = part.rsplit_once('=')?;
        outputs.insert(unescaped(name)?, digest.parse().ok()?);
    }
    let place = (unescaped(profile)?, unescaped(stage)?);
    Some((place, Line { key: key.parse().ok()?, outputs }))
}

/// Escapes the characters that have a meaning in the file.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => safe.push_str("\\\\"),
            '\t' => safe.push_str("\\t"),
            '\n' => safe.push_str("\\n"),
            '\r' => safe.push_str("\\r"),
            '#' if safe.is_empty() => safe.push_str("\\#"),
            c => safe.push(c),
        }
    }
    safe
}

fn unescaped(text: &str) -> Option<String> {
    let mut plain = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        plain.push(match c {
            '\\' => match chars.next()? {
                't' => '\t',
                'n' => '\n',
                'r' => '\r',
                other => other,
            },
            c => c,
        });
    }
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lock(stages: &[(&str, u8)]) -> LockFile {
        let line = |number: u8| Line {
            key: Key::new([number; 32]),
            outputs: [("table".to_owned(), Digest::new([number; 32]))].into(),
        };
        let lines =
            stages.iter().map(|(stage, number)| (("full".to_owned(), (*stage).to_owned()), line(*number)));
        LockFile { lines: lines.collect() }
    }

    #[test]
    fn what_is_written_is_read_back_whatever_the_names() {
        let lock = lock(&[("a[b=c, d=e]", 1), ("tab\there", 2), ("line\nend\\t", 3), ("#x", 4)]);
        assert_eq!(LockFile::parse(lock.text().as_bytes(), Path::new("p.lock")).unwrap(), lock);
    }

    #[test]
    fn lines_of_two_branches_merge_and_a_conflict_is_named_with_its_line() {
        let (one, two) = (lock(&[("a", 1), ("b", 2)]), lock(&[("a", 1), ("c", 3)]));
        let merged = format!("{}{}", one.text(), two.text());
        let read = LockFile::parse(merged.as_bytes(), Path::new("p.lock")).unwrap();
        assert_eq!(read, lock(&[("a", 1), ("b", 2), ("c", 3)]));
        let bad = format!("{}<<<<<<< ours\n{}nonsense\n", one.text(), lock(&[("a", 9)]).text());
        let error = LockFile::parse(bad.as_bytes(), Path::new("p.lock")).unwrap_err().to_string();
        for part in [
            "p.lock:4: an unresolved merge conflict",
            "p.lock:6: stage `a` has two",
            "p.lock:7: expected profile",
        ] {
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}
