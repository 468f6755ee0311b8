//! Reads a pipeline file and the files that it includes. Files are identified by their paths; the function that reads them is
//! passed in.

use std::sync::Arc;

use super::decode::{self, File};
use super::memo::Memo;
use super::model::Spec;
use super::node::{Key, Value, shorten};
use super::pieces;
use super::problem::{Problem, ProblemList};
use super::source::{SourceText, Sources, Span};
use super::yaml;
use super::{Diagnostics, Load, MAX_BYTES, SourceName, not_a_map};

/// The maximum number of files.
const MAX_FILES: usize = 1_000;
/// The maximum depth of includes.
const MAX_CHAIN: usize = 100;

/// Reads files.
pub(super) struct Reader<'r, 'l> {
    name: &'r SourceName,
    load: &'r mut Load<'l>,
    memo: Option<&'r mut Memo>,
    sources: Vec<Arc<SourceText>>,
    problems: ProblemList,
    /// Those that are read, an included one before the file that includes it.
    files: Vec<File>,
    /// The paths of all that were begun; those that are being read, outermost first.
    begun: Vec<String>,
    open: Vec<String>,
    /// True where a file is not there in full: what others say of its parts could not be judged.
    broken: bool,
}

impl<'r, 'l> Reader<'r, 'l> {
    /// For the pipeline file of that name. With a memo, files are read by pieces.
    pub fn new(name: &'r SourceName, load: &'r mut Load<'l>, memo: Option<&'r mut Memo>) -> Self {
        let (sources, problems) = (Vec::new(), ProblemList::default());
        let (files, begun, open) = (Vec::new(), Vec::new(), Vec::new());
        Self { name, load, memo, sources, problems, files, begun, open, broken: false }
    }

    /// Reads the pipeline file and all that it includes.
    pub fn read(mut self, bytes: &[u8]) -> Result<Spec, Diagnostics> {
        let own = self.name.0.rsplit('/').next().unwrap_or_default().to_owned();
        let main = self.name.0.clone();
        let fine = self.file(bytes, &own, |text| SourceText::file(&main, text));
        if fine.is_none() || self.broken {
            // Without its tree there is nothing to continue with.
            return Err(self.problems.into_diagnostics(&Sources::of(&self.sources)));
        }
        Ok(decode::spec(self.files, self.name.clone(), self.sources, self.problems))
    }

    /// Reads one file, whose path is `path`; `None` where there is no tree, which was reported.
    fn file(&mut self, bytes: &[u8], path: &str, source: impl Fn(&str) -> SourceText) -> Option<()> {
        let number = u16::try_from(self.sources.len()).unwrap_or(u16::MAX);
        let text = match std::str::from_utf8(bytes) {
            // Some editors put this mark in front; it means nothing in UTF-8.
            Ok(text) => text.strip_prefix('\u{feff}').unwrap_or(text),
            Err(error) => {
                let (shown, problem) = not_utf8(bytes, error.valid_up_to(), number);
                self.sources.push(Arc::new(source(&shown)));
                self.problems.add(|| problem);
                return None;
            }
        };
        let start = Span::new(number, 0..0);
        if text.len() > MAX_BYTES {
            self.sources.push(Arc::new(source("")));
            self.problems.add(|| {
                Problem::new(
                    start,
                    format!("the file has {} bytes, expected at most {MAX_BYTES}", text.len()),
                )
                .hint("is this a pipeline file? use `{ file: path }` for data")
            });
            return None;
        }
        self.sources.push(Arc::new(source(text)));
        let before = self.problems.reports();
        let pieces = self.memo.as_mut().and_then(|memo| pieces::read(text, number, memo));
        let root = pieces.or_else(|| yaml::read(text, number, 0, &mut self.problems));
        let root = match root {
            Some(root) if matches!(root.value, Value::Map(_)) => root,
            found => {
                // Without a message of its own the reader found no document, or one that is not a map.
                if self.problems.reports() == before {
                    self.problems.add(|| not_a_map(found.as_ref(), start));
                }
                return None;
            }
        };
        let file = decode::file(root, number > 0, &mut self.problems);
        self.begun.push(path.to_owned());
        self.open.push(path.to_owned());
        for include in &file.include {
            self.include(include, path);
        }
        self.open.pop();
        self.files.push(file);
        Some(())
    }

    /// Reads what the file `from` includes.
    fn include(&mut self, wanted: &Key, from: &str) {
        let folder = from.rfind('/').map_or("", |slash| &from[..=slash]);
        let path = joined(folder, &wanted.text);
        if let Some(at) = self.open.iter().position(|open| *open == path) {
            let circle: Vec<&str> =
                self.open[at..].iter().map(String::as_str).chain([path.as_str()]).collect();
            let circle = circle.join(" -> ");
            return self.problems.add(|| {
                Problem::new(wanted.span, format!("files include each other in a cycle: `{circle}`"))
                    .hint("remove one of these includes; move what both need to a third file")
            });
        }
        if self.begun.contains(&path) {
            return;
        }
        if self.open.len() >= MAX_CHAIN || self.begun.len() >= MAX_FILES {
            return self.problems.add(|| {
                Problem::new(
                    wanted.span,
                    format!("more than {MAX_FILES} files are included, or {MAX_CHAIN} one by another"),
                )
                .hint("does a link make a file include itself under new names?")
            });
        }
        match (self.load)(&path) {
            Ok(bytes) => {
                let main = self.name.0.clone();
                let named = path.clone();
                let read = self.file(&bytes, &path, |text| SourceText::included(&main, &named, text));
                self.broken |= read.is_none();
            }
            Err(error) => {
                self.broken = true;
                self.problems.add(|| {
                    let shown = shorten(&wanted.text);
                    Problem::new(wanted.span, format!("cannot read the file `{shown}`: {error}"))
                        .hint("paths are relative to the folder of the including file")
                });
            }
        }
    }
}

/// `path`, which is relative to `folder`, without `.` and `..` where they can be resolved by their names.
pub(crate) fn joined(folder: &str, path: &str) -> String {
    let whole = if path.starts_with('/') { path.to_owned() } else { format!("{folder}{path}") };
    let mut parts: Vec<&str> = Vec::new();
    for part in whole.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    if whole.starts_with('/') { format!("/{}", parts.join("/")) } else { parts.join("/") }
}

fn not_utf8(bytes: &[u8], at: usize, source: u16) -> (String, Problem) {
    let end = bytes.len().min(at + 200);
    let start = bytes[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
    // The place is found in the text as far as it is one; what follows is shown as replacement characters.
    let text =
        format!("{}{}", String::from_utf8_lossy(&bytes[..at]), String::from_utf8_lossy(&bytes[at..end]));
    let seen = if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        "the file looks like UTF-16".to_owned()
    } else if bytes[start..end].contains(&0) {
        format!("the file looks binary: byte {} is not text", at + 1)
    } else {
        format!("byte {} (0x{:02x}) is not valid UTF-8", at + 1, bytes.get(at).copied().unwrap_or_default())
    };
    let at = Span::new(source, at..at + 1);
    let problem = Problem::new(at, format!("{seen}, expected a text file in UTF-8"));
    (text, problem.hint("save the file as UTF-8 in your editor"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_file_that_names_them() {
        for (folder, path, expected) in [
            ("", "a.yaml", "a.yaml"),
            ("sub/", "a.yaml", "sub/a.yaml"),
            ("sub/", "../a.yaml", "a.yaml"),
            ("", "../up/./a.yaml", "../up/a.yaml"),
            ("../up/", "../a.yaml", "../a.yaml"),
            ("sub/", "/top/a.yaml", "/top/a.yaml"),
        ] {
            assert_eq!(joined(folder, path), expected);
        }
    }
}
