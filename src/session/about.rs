//! What the manifest of a run says about its pipeline: the file, the overrides, and the texts that were read, so that an exported
//! archive has a pipeline file that can be used.

use std::path::{Component, Path};

use serde_json::{Map, Value, json};

use super::Session;
use super::source::Texts;
use crate::fsx;

/// The fields of the manifest.
pub(super) fn about(session: &Session<'_>, texts: &Texts) -> Map<String, Value> {
    let source = &session.source;
    let mut about = session.options.about.clone();
    about.insert("file".to_owned(), json!(source.file.to_string_lossy()));
    about.insert("set".to_owned(), json!(source.choices.set));
    about.insert("source".to_owned(), json!(std::str::from_utf8(&texts.main).ok()));
    if !texts.parts.is_empty() {
        let (main, parts) = side_by_side(&source.file, texts);
        about.insert("source_path".to_owned(), json!(main));
        about.insert("parts".to_owned(), Value::Object(parts));
    }
    about
}

/// The path of the pipeline file and those of the files that it includes, with their texts, such that they find each other in any
/// folder. One that is included by an absolute path is left out: it is not found elsewhere anyway.
fn side_by_side(file: &Path, texts: &Texts) -> (String, Map<String, Value>) {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let up = texts.parts.keys().filter_map(|path| levels_up(path)).max().unwrap_or_default();
    // As many folders above the file as are needed, by their names.
    let folder = fsx::absolute(file);
    let folder =
        folder.parent().map(|folder| inside(&[], &folder.to_string_lossy(), true)).unwrap_or_default();
    let folder = folder.unwrap_or_default();
    let above = &folder[folder.len().saturating_sub(up)..];
    let main = above.iter().chain([&name]).cloned().collect::<Vec<_>>().join("/");
    let place = |(path, bytes): (&String, &Vec<u8>)| {
        Some((inside(above, path, false)?.join("/"), json!(std::str::from_utf8(bytes).ok()?)))
    };
    (main, texts.parts.iter().filter_map(place).collect())
}

/// How many folders above its start a path reaches.
fn levels_up(path: &str) -> Option<usize> {
    let (mut depth, mut up) = (0_usize, 0);
    for component in Path::new(path).components() {
        match component {
            Component::Normal(_) => depth += 1,
            Component::ParentDir if depth > 0 => depth -= 1,
            Component::ParentDir => up += 1,
            Component::CurDir => {}
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(up)
}

/// The names on a path that begins in the folder `start`; `None` where it leaves what is above that.
fn inside(start: &[String], path: &str, from_root: bool) -> Option<Vec<String>> {
    let mut names = start.to_vec();
    for component in Path::new(path).components() {
        match component {
            Component::Normal(name) => names.push(name.to_string_lossy().into_owned()),
            Component::ParentDir => drop(names.pop()?),
            Component::CurDir => {}
            Component::RootDir if from_root => {}
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_include_each_other_stay_where_they_find_each_other() {
        let placed = |file: &str, parts: &[&str]| {
            let parts = parts.iter().map(|part| ((*part).to_owned(), b"x".to_vec())).collect();
            let (main, parts) = side_by_side(Path::new(file), &Texts { main: Vec::new(), parts });
            let mut paths: Vec<String> = parts.into_iter().map(|(path, _)| path).collect();
            paths.sort();
            (main, paths.join(" "))
        };
        let expect = |main: &str, parts: &str| (main.to_owned(), parts.to_owned());
        assert_eq!(placed("/a/b/p.yaml", &["x.yaml", "d/./y.yaml"]), expect("p.yaml", "d/y.yaml x.yaml"));
        assert_eq!(
            placed("/a/b/p.yaml", &["../x.yaml", "d/../y.yaml"]),
            expect("b/p.yaml", "b/y.yaml x.yaml")
        );
        assert_eq!(placed("/a/./c/../b/p.yaml", &["../../e/x.yaml"]), expect("a/b/p.yaml", "e/x.yaml"));
        assert_eq!(
            placed("/a/p.yaml", &["../../../x.yaml", "/etc/y.yaml", "z.yaml"]),
            expect("a/p.yaml", "a/z.yaml")
        );
    }
}
