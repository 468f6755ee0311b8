//! Files beside the pipeline file that a command names, but does not declare. A stage runs in a folder of its own, so a relative
//! name leads nowhere there; an absolute one works, but an edit of the file runs nothing again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::warning::Warning;
use crate::fsx::{self, Entry};
use crate::resolve::{Graph, Origin, StageInstance};

/// Ends words in the line of a shell.
const BETWEEN: [char; 12] = ['"', '\'', '`', ';', '|', '&', '<', '>', '(', ')', '=', ','];

/// One warning for each file and stage, of the stages for which `is_shown` is true. `base` is the folder of the pipeline file.
pub(super) fn warnings(graph: &Graph, base: &Path, is_shown: &dyn Fn(&str) -> bool) -> Vec<Warning> {
    let base = &fsx::absolute(base);
    let mut found = Vec::new();
    for stage in programs(graph).filter(|stage| is_shown(&stage.name)) {
        let named = words(stage).into_iter();
        let files: BTreeSet<&str> =
            named.filter(|word| beside(base, word).is_some_and(|path| is_file(&path))).collect();
        found.extend(files.into_iter().filter_map(|file| warning(stage, base, file)));
    }
    found
}

/// The paths beside the pipeline file that commands may mean, and whether there is a file: what the warnings depend on beside the
/// graph.
pub fn named_files(graph: &Graph, base: &Path) -> BTreeMap<PathBuf, bool> {
    let base = &fsx::absolute(base);
    let paths =
        programs(graph).flat_map(|stage| words(stage).into_iter().filter_map(|word| beside(base, word)));
    paths.map(|path| (path.clone(), is_file(&path))).collect()
}

/// The stages that run programs, with one instance each: instances share their command but for values of axes.
fn programs(graph: &Graph) -> impl Iterator<Item = &StageInstance> {
    let mut known = BTreeSet::new();
    let programs = graph.stages.node_weights().filter(|stage| stage.kind.is_program());
    programs.filter(move |stage| known.insert(&*stage.name))
}

/// The words in the command line of a stage, a text or list, that look like the name of a file. Maps declare: the path of an
/// output or input that such a word is as a whole.
fn words(stage: &StageInstance) -> Vec<&str> {
    let Value::Object(fields) = &stage.params else { return Vec::new() };
    let (mut lines, mut declared) = (Vec::new(), Vec::new());
    for value in fields.values() {
        texts(value, if value.is_object() { &mut declared } else { &mut lines });
    }
    let all = lines.iter().flat_map(|line| line.split(|c: char| c.is_whitespace() || BETWEEN.contains(&c)));
    all.filter(|word| word.contains(['.', '/']) && !word.contains(['{', '$']) && !declared.contains(word))
        .collect()
}

/// All texts in a value.
fn texts<'v>(value: &'v Value, found: &mut Vec<&'v str>) {
    match value {
        Value::String(text) => found.push(text),
        Value::Array(items) => items.iter().for_each(|item| texts(item, found)),
        Value::Object(fields) => fields.values().for_each(|value| texts(value, found)),
        _ => {}
    }
}

/// The path of a word, beside the pipeline file or below it; programs elsewhere are part of the machine.
fn beside(base: &Path, word: &str) -> Option<PathBuf> {
    Some(base.join(word)).filter(|path| path.starts_with(base))
}

/// True where there is a file.
pub fn is_file(path: &Path) -> bool {
    matches!(fsx::entry(path), Ok(Some(Entry::File(_))))
}

/// `None` for an input that the command names by its absolute path: that works, and an edit runs the stage again.
fn warning(stage: &StageInstance, base: &Path, file: &str) -> Option<Warning> {
    let port = stage.inputs.iter().find(|wire| {
        let is_it =
            |from: &Origin| matches!(from, Origin::File { path, .. } if base.join(path) == base.join(file));
        wire.sources.iter().any(|source| is_it(&source.from))
    });
    if port.is_some() && Path::new(file).is_absolute() {
        return None;
    }
    let name = port.map_or_else(|| identifier(file), |wire| wire.port.to_owned());
    let effect = match Path::new(file).is_absolute() {
        true => "an edit of it does not run the stage again",
        false => "the stage runs in another folder and does not find it",
    };
    let (what, declare) = match port {
        Some(_) => {
            (format!("is its input `{name}`, but the command names it by its own path"), String::new())
        }
        None => {
            let short = Path::new(file).strip_prefix(base).unwrap_or(Path::new(file)).display();
            let declare = format!("declare `inputs: {{ {name}: {{ file: {short} }} }}` and ");
            ("is not one of its inputs".to_owned(), declare)
        }
    };
    Some(Warning {
        message: format!("stage `{}`: `{file}` {what}: {effect}", stage.name),
        hint: format!("{declare}write `{{inputs.{name}}}` in the command"),
    })
}

/// A name for an input, from that of the file.
fn identifier(file: &str) -> String {
    let stem = Path::new(file).file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let kept: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if kept.starts_with(|c: char| c.is_ascii_alphabetic()) { kept } else { "script".to_owned() }
}
