//! Settings of a place rather than of a pipeline: which shared cache to use, and how jobs reach a cluster. They are in
//! `dril-pipe.toml` beside the pipeline file and in the user's configuration folder. No setting enters a key, so none of
//! them changes a result.

mod cluster;
mod executors;
mod kinds;

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub use cluster::{ClusterSettings, JobSettings};
pub use executors::{ExecutorSettings, StateNames};
pub(crate) use executors::{Part, parts, placeholders};
use serde::{Deserialize, Deserializer, de};

use crate::fsx::{self, FsError};
use crate::spec::limits::parse_time;

/// The name of a settings file.
pub const FILE: &str = "dril-pipe.toml";

/// All settings. A value that is not set has its default.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The shared cache.
    pub remote: RemoteSettings,
    /// Slurm.
    pub slurm: ClusterSettings,
    /// Other schedulers, by name.
    #[serde(deserialize_with = "executors::executors")]
    pub executors: BTreeMap<String, ExecutorSettings>,
}

/// A shared cache.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RemoteSettings {
    /// Where it is: `s3://bucket/prefix`, `file:///folder`, `https://host/path`.
    pub url: Option<String>,
    /// What runs do with it.
    pub mode: Option<Mode>,
    /// Requests that may be under way at the same time.
    pub parallel: Option<NonZeroUsize>,
    /// A connection on which nothing moves for so long is given up.
    #[serde(deserialize_with = "time")]
    pub timeout: Option<Duration>,
    /// A file with a secret that signs records; a relative path begins at the folder of the settings file.
    pub secret_file: Option<PathBuf>,
    /// The server's address, where it is not AWS.
    pub endpoint: Option<String>,
    /// The bucket's region.
    pub region: Option<String>,
}

/// What runs do with a shared cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Take results from it.
    #[default]
    Read,
    /// Give results to it.
    Write,
    /// Both.
    ReadWrite,
}

impl Mode {
    /// True where a run takes results.
    pub fn reads(self) -> bool {
        self != Self::Write
    }

    /// True where a run gives results.
    pub fn writes(self) -> bool {
        self != Self::Read
    }
}

/// Why settings cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file is there and cannot be read.
    #[error(transparent)]
    Fs(#[from] FsError),
    /// The file is not what it should be.
    #[error("{file}:{line}:{column}: {message}", file = file.display())]
    Wrong {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The column, from 1.
        column: usize,
        /// What was seen and what was expected.
        message: String,
    },
}

impl SettingsError {
    /// A mistake in a file with these bytes, at the one of number `at`.
    fn at(file: &Path, bytes: &[u8], at: usize, message: String) -> Self {
        let before = &bytes[..at.min(bytes.len())];
        let line_start = before.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let line = before.iter().filter(|byte| **byte == b'\n').count() + 1;
        let column = String::from_utf8_lossy(&before[line_start..]).chars().count() + 1;
        Self::Wrong { file: file.to_owned(), line, column, message }
    }
}

impl Settings {
    /// The settings in these files, of which each may be missing. A value of an earlier file counts more.
    ///
    /// # Errors
    /// A file that is there cannot be read, or has an unknown field or a wrong value.
    pub fn read(files: &[PathBuf]) -> Result<Self, SettingsError> {
        let mut all = Self::default();
        for file in files {
            if let Some(bytes) = fsx::read_if_there(file)? {
                all.fill_from(Self::parse(&bytes, file)?);
            }
        }
        Ok(all)
    }

    /// Checks that these files, which each may be missing, name no other kinds than the known ones.
    ///
    /// # Errors
    /// A file cannot be read or names another one; all of a file at once, at the place of the first.
    pub fn check_kinds(files: &[PathBuf], known: &[&str]) -> Result<(), SettingsError> {
        for file in files {
            let bytes = fsx::read_if_there(file)?.unwrap_or_default();
            let mistakes = std::str::from_utf8(&bytes).ok().and_then(|text| kinds::mistakes(text, known));
            if let Some((at, message)) = mistakes {
                return Err(SettingsError::at(file, &bytes, at, message));
            }
        }
        Ok(())
    }

    /// The settings in a text; `file` names it in errors, and relative paths begin at its folder.
    ///
    /// # Errors
    /// It is no TOML, or has an unknown field or a wrong value.
    pub fn parse(bytes: &[u8], file: &Path) -> Result<Self, SettingsError> {
        let wrong = |at, message| SettingsError::at(file, bytes, at, message);
        let text = std::str::from_utf8(bytes)
            .map_err(|error| wrong(error.valid_up_to(), "this is no UTF-8 text".to_owned()))?;
        let mut settings: Self = toml::from_str(text).map_err(|error| {
            wrong(error.span().map_or(0, |span| span.start), error.message().trim_end().to_owned())
        })?;
        if let (Some(secret), Some(folder)) = (&mut settings.remote.secret_file, file.parent()) {
            *secret = folder.join(&*secret);
        }
        Ok(settings)
    }

    /// Takes over what is not set yet.
    fn fill_from(&mut self, other: Self) {
        self.slurm.fill_from(other.slurm);
        // The commands of an executor belong together.
        for (name, executor) in other.executors {
            self.executors.entry(name).or_insert(executor);
        }
        let (mine, theirs) = (&mut self.remote, other.remote);
        // How to reach a cache belongs to its URL: an endpoint for another bucket would be a wrong one.
        if mine.url.is_none() {
            mine.url = theirs.url;
            mine.endpoint = mine.endpoint.take().or(theirs.endpoint);
            mine.region = mine.region.take().or(theirs.region);
            mine.secret_file = mine.secret_file.take().or(theirs.secret_file);
            mine.mode = mine.mode.or(theirs.mode);
        }
        mine.parallel = mine.parallel.or(theirs.parallel);
        mine.timeout = mine.timeout.or(theirs.timeout);
    }
}

/// A time as `20s` or `1h30m`.
pub(crate) fn time<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Duration>, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse_time(&text).map(Some).map_err(de::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Settings, String> {
        Settings::parse(text.as_bytes(), Path::new("a/dril-pipe.toml")).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_set_is_read_and_the_rest_has_its_default() {
        let text =
            "[remote]\nurl = \"s3://b/p\"\nmode = \"read-write\"\ntimeout = \"1m\"\nsecret_file = \"s\"\n";
        let remote = parse(text).unwrap().remote;
        assert_eq!(remote.url.as_deref(), Some("s3://b/p"));
        assert_eq!((remote.mode, remote.timeout), (Some(Mode::ReadWrite), Some(Duration::from_secs(60))));
        assert_eq!(remote.secret_file, Some(PathBuf::from("a/s")));
        assert_eq!(remote.parallel, None);
        assert_eq!(parse("").unwrap(), Settings::default());
        assert!(Mode::default().reads() && !Mode::default().writes());
    }

    #[test]
    fn a_mistake_is_named_with_its_place() {
        for (text, expected) in [
            ("[remote]\nurk = 1\n", "a/dril-pipe.toml:2:1: unknown field `urk`, expected one of `url`"),
            (
                "[remote]\nmode = \"both\"\n",
                "a/dril-pipe.toml:2:8: unknown variant `both`, expected one of `read`",
            ),
            ("[remote]\ntimeout = \"fast\"\n", "a/dril-pipe.toml:2:11: "),
            (
                "[remote]\nparallel = 0\n",
                "a/dril-pipe.toml:2:12: invalid value: integer `0`, expected a nonzero",
            ),
            ("[remote\n", "a/dril-pipe.toml:1:"),
            ("[romete]\n", "a/dril-pipe.toml:1:2: unknown field `romete`"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.starts_with(expected), "{text}: {error}");
        }
    }

    #[test]
    fn the_file_beside_the_pipeline_counts_more_than_that_of_the_user() {
        let folder = tempfile::tempdir().unwrap();
        let [near, far, missing] = ["near", "far", "missing"].map(|name| folder.path().join(name));
        fsx::write(&near, b"[remote]\nurl = \"s3://near\"\n").unwrap();
        fsx::write(&far, b"[remote]\nurl = \"s3://far\"\nendpoint = \"http://far\"\nparallel = 3\n").unwrap();
        let both = Settings::read(&[near, missing, far.clone()]).unwrap().remote;
        assert_eq!(both.url.as_deref(), Some("s3://near"));
        assert_eq!((both.endpoint, both.parallel), (None, NonZeroUsize::new(3)));
        assert_eq!(Settings::read(&[far]).unwrap().remote.endpoint.as_deref(), Some("http://far"));
    }
}
