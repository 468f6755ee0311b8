//! Folders of this machine in messages of failures. A report may be passed on, so it must not name them.

use std::path::{Path, PathBuf};

use crate::cli::shared::home;
use crate::fsx;

/// The folders that messages mention most, and what a report has in their place.
pub(super) struct Folders {
    /// The longest first, since one may lie within another.
    known: Vec<(String, &'static str)>,
}

impl Folders {
    /// The store's folder, that of the pipeline file (whose paths become relative, as the file has them) and the user's
    /// home.
    pub(super) fn new(store: &Path, base: &Path) -> Self {
        let base = if base.as_os_str().is_empty() { Path::new(".") } else { base };
        let all = [(Some(store.to_owned()), "<cache>"), (Some(base.to_owned()), ""), (home(), "~")];
        let mut known: Vec<(String, &str)> = Vec::new();
        for (folder, name) in all.into_iter().filter_map(|(folder, name)| Some((folder?, name))) {
            let forms: [Option<PathBuf>; 2] = [std::path::absolute(&folder).ok(), fsx::real(&folder)];
            let texts = forms.iter().flatten().filter_map(|form| form.to_str());
            known.extend(texts.map(|text| text.trim_end_matches('/').to_owned()).map(|text| (text, name)));
        }
        known.retain(|(folder, _)| !folder.is_empty());
        known.sort_by_key(|(folder, _)| std::cmp::Reverse(folder.len()));
        Self { known }
    }

    /// The message without absolute paths: of those in other folders only the file name stays.
    pub(super) fn hide(&self, message: &str) -> String {
        let mut shown = String::with_capacity(message.len());
        let mut rest = message;
        while let Some(at) = rest.find('/') {
            let (before, path) = rest.split_at(at);
            shown.push_str(before);
            let (text, bytes) = self.path(path, shown.chars().next_back());
            shown.push_str(&text);
            rest = &path[bytes..];
        }
        shown + rest
    }

    /// What is shown of the path at the beginning of `text`, which follows the character `before`, and its length.
    fn path(&self, text: &str, before: Option<char>) -> (String, usize) {
        // A relative path, or two words with a slash between them.
        if before.is_some_and(is_part) {
            return (text[..length(text)].to_owned(), length(text));
        }
        if before == Some(':') && text.starts_with("//") {
            // `file:///users/me` has a path after its two slashes, `https://host/path` has none.
            if !text.starts_with("///") {
                return (text[..length(text)].to_owned(), length(text));
            }
            let (shown, bytes) = self.path(&text[2..], None);
            return (format!("//{shown}"), bytes + 2);
        }
        for (folder, name) in &self.known {
            if let Some(inside) = text.strip_prefix(folder.as_str())
                && !inside.starts_with(|c: char| is_part(c) && c != '/')
            {
                let tail = &inside[..length(inside)];
                let shown = match (*name, tail.trim_start_matches('/')) {
                    ("", "") => ".".to_owned(),
                    ("", relative) => relative.to_owned(),
                    (name, _) => format!("{name}{tail}"),
                };
                return (shown, folder.len() + tail.len());
            }
        }
        let path = &text[..length(text)];
        match path.trim_end_matches('/').rsplit_once('/') {
            Some((_, file)) => (format!("…/{file}"), path.len()),
            None => (path.to_owned(), path.len()),
        }
    }
}

/// The length of the path, in bytes, at the beginning of a text.
fn length(text: &str) -> usize {
    text.find(|c: char| !is_part(c)).unwrap_or(text.len())
}

/// True for characters that paths mostly consist of, and thus do not begin after.
fn is_part(c: char) -> bool {
    c.is_alphanumeric() || "/._-+~%@#…".contains(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folders() -> Folders {
        let known = [("/users/me/work/cache", "<cache>"), ("/users/me/work", ""), ("/users/me", "~")];
        Folders { known: known.map(|(folder, name)| (folder.to_owned(), name)).to_vec() }
    }

    #[test]
    fn paths_begin_at_the_cache_the_pipeline_or_the_home_and_others_are_file_names() {
        for (message, expected) in [
            ("(/users/me/work/cache/blobs-v1/ab/cd): no", "(<cache>/blobs-v1/ab/cd): no"),
            ("`/users/me/work/data/a b.csv` is", "`data/a b.csv` is"),
            ("in /users/me/work", "in ."),
            ("in /users/me, /users/me/", "in ~, ~/"),
            ("/users/me/workshop/x and /users/men/y", "~/workshop/x and …/y"),
            ("File \"/usr/lib/python3/json.py\", line 3", "File \"…/json.py\", line 3"),
            ("PATH=/opt/one/bin:/opt/two/bin/", "PATH=…/bin:…/bin"),
            ("see file:///srv/data/x", "see file://…/x"),
            ("/data/users/me/work/x", "…/x"),
        ] {
            assert_eq!(folders().hide(message), expected, "{message}");
        }
    }

    #[test]
    fn what_only_looks_like_a_path_stays() {
        for message in ["12 / 7", "and/or ./a ../b x/y", "https://host/a/b?c=/", "", "//", "no path"] {
            assert_eq!(folders().hide(message), message);
        }
    }
}
