//! Where the Python of the stages is: two environment variables, and a folder of the user's own where neither is set.
//! It changes no result: stages refuse packages of other versions than theirs.

use std::ffi::OsString;
use std::path::PathBuf;

/// The folder in which virtual environments are made.
const FOLDER: &str = "DRIL_PIPE_VENVS";
/// A Python that has the packages already.
const PYTHON: &str = "DRIL_PIPE_PYTHON";

/// The folder for virtual environments, and the Python that makes one needless, where the user names it.
pub fn python_folders() -> (PathBuf, Option<PathBuf>) {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    (folder(variable), variable(PYTHON).map(PathBuf::from))
}

/// The user's cache folder, as the XDG base directory specification has it, unless another is named.
fn folder(variable: impl Fn(&str) -> Option<OsString>) -> PathBuf {
    if let Some(folder) = variable(FOLDER) {
        return PathBuf::from(folder);
    }
    let cache = variable("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| variable("HOME").map(|home| PathBuf::from(home).join(".cache")));
    cache.unwrap_or_else(std::env::temp_dir).join("dril-pipe")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_named_folder_wins_then_the_cache_then_home() {
        let with = |names: &[(&str, &str)]| {
            let names: Vec<(String, String)> =
                names.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
            folder(|name| names.iter().find(|(other, _)| other == name).map(|(_, value)| value.into()))
        };
        let all = [(FOLDER, "/v"), ("XDG_CACHE_HOME", "/c"), ("HOME", "/h")];
        assert_eq!(with(&all), PathBuf::from("/v"));
        assert_eq!(with(&all[1..]), PathBuf::from("/c/dril-pipe"));
        assert_eq!(with(&all[2..]), PathBuf::from("/h/.cache/dril-pipe"));
        assert!(with(&[]).ends_with("dril-pipe"));
    }
}
