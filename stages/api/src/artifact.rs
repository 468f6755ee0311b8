//! The types of the artifacts that flow between stages. A port names one; wiring two different ones is an error of the
//! pipeline file.
//!
//! The types that the engine needs, and those that several packages exchange, are constants of [`Artifact`]. A stage package
//! defines its own with [`Artifact::new`], and `main` registers them ([`register`]) so that pipeline files can name them.

use std::borrow::Cow;
use std::sync::{PoisonError, RwLock};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// The type of what a port carries. Every artifact is one file, except [`Artifact::FOLDER`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Artifact {
    name: &'static str,
    extension: &'static str,
    is_result: bool,
}

/// Types that stage packages have registered.
static REGISTERED: RwLock<Vec<Artifact>> = RwLock::new(Vec::new());

/// Two different artifact types with one name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("two artifact types are called `{}`", .0.name)]
pub struct ArtifactConflict(pub Artifact);

/// Makes artifact types known to pipeline files. Registering a type again changes nothing.
///
/// # Errors
/// Another type has the same name.
pub fn register(types: &[Artifact]) -> Result<(), ArtifactConflict> {
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    for &artifact in types {
        let same_name =
            Artifact::BUILT_IN.iter().chain(&*registered).find(|known| known.name == artifact.name);
        match same_name {
            Some(known) if *known != artifact => return Err(ArtifactConflict(artifact)),
            Some(_) => {}
            None => registered.push(artifact),
        }
    }
    Ok(())
}

impl Artifact {
    /// One row per evaluated episode (see [`crate::scores`]).
    pub const SCORES: Self = Self::new("scores", "csv");
    /// The log of a training run: one row per logged step, update, epoch or episode (CSV).
    pub const TRAINING_LOG: Self = Self::new("training-log", "csv");
    /// A table of results (CSV or Markdown).
    pub const TABLE: Self = Self::new("table", "csv").result();
    /// A figure of results.
    pub const FIGURE: Self = Self::new("figure", "svg").result();
    /// Any file, including files that the pipeline file brings in from outside.
    pub const FILE: Self = Self::new("file", "bin");
    /// A folder with everything in it.
    pub const FOLDER: Self = Self::new("folder", "");
    /// For inputs only: any artifact, including folders.
    pub const ANY: Self = Self::new("any", "bin");

    const BUILT_IN: [Self; 7] =
        [Self::SCORES, Self::TRAINING_LOG, Self::TABLE, Self::FIGURE, Self::FILE, Self::FOLDER, Self::ANY];

    /// A type with this name, in kebab-case, and this default file extension, without the dot.
    pub const fn new(name: &'static str, extension: &'static str) -> Self {
        Self { name, extension, is_result: false }
    }

    /// The same type as a result that people read: `run` copies it to the results folder.
    #[must_use]
    pub const fn result(self) -> Self {
        Self { is_result: true, ..self }
    }

    /// The type with this name, if it is built in or registered.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|artifact| artifact.name == name)
    }

    /// All types that are built in or registered.
    pub fn all() -> Vec<Self> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
        registered.iter().copied().chain(Self::BUILT_IN).collect()
    }

    /// The name in pipeline files, messages and `dril-pipe kinds`.
    pub const fn name(self) -> &'static str {
        self.name
    }

    /// True for a result that people read.
    pub const fn is_result(self) -> bool {
        self.is_result
    }

    /// True where an output of this type may be wired to an input that takes `wanted`. A `file` input takes any file; a
    /// `file` output is trusted to be what the input says (the stage that reads it checks). A folder is never taken for a
    /// file.
    pub fn fits(self, wanted: Self) -> bool {
        let files = self != Self::FOLDER && wanted != Self::FOLDER;
        wanted == Self::ANY || self == wanted || files && (wanted == Self::FILE || self == Self::FILE)
    }

    /// The default file extension, without the dot; empty for a folder.
    pub const fn extension(self) -> &'static str {
        self.extension
    }
}

impl std::fmt::Display for Artifact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl Serialize for Artifact {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name)
    }
}

impl<'de> Deserialize<'de> for Artifact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = Cow::<'_, str>::deserialize(deserializer)?;
        // In serde's words, so that the place and the nearest name are shown as for any enum.
        Self::named(&name).ok_or_else(|| {
            let known: Vec<String> = Self::all().iter().map(|known| format!("`{known}`")).collect();
            de::Error::custom(format_args!("unknown variant `{name}`, expected one of {}", known.join(", ")))
        })
    }
}

impl JsonSchema for Artifact {
    fn schema_name() -> Cow<'static, str> {
        "Artifact".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let names: Vec<&str> = Self::all().into_iter().map(Self::name).collect();
        json_schema!({
            "description": "The type of what a port carries. Every artifact is one file, except `folder`.",
            "type": "string",
            "enum": names,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: Artifact = Artifact::new("weights-of-a-test", "bin");

    #[test]
    fn a_folder_is_taken_for_no_file_and_a_file_for_no_folder() {
        assert!(Artifact::FOLDER.fits(Artifact::FOLDER) && Artifact::FOLDER.fits(Artifact::ANY));
        assert!(!Artifact::FOLDER.fits(Artifact::FILE) && !Artifact::FILE.fits(Artifact::FOLDER));
        assert!(Artifact::FILE.fits(WEIGHTS) && WEIGHTS.fits(Artifact::FILE));
        assert!(!WEIGHTS.fits(Artifact::SCORES) && Artifact::SCORES.fits(Artifact::ANY));
    }

    #[test]
    fn a_pipeline_file_can_name_a_type_once_it_is_registered() {
        let read = || serde_json::from_str::<Artifact>("\"weights-of-a-test\"");
        let error = read().unwrap_err().to_string();
        assert!(error.contains("`weights-of-a-test`") && error.contains("`scores`"), "{error}");
        register(&[WEIGHTS, Artifact::SCORES]).unwrap();
        register(&[WEIGHTS]).unwrap();
        assert_eq!(read().unwrap(), WEIGHTS);
        let other = Artifact::new("table", "csv");
        assert_eq!(register(&[other]), Err(ArtifactConflict(other)));
    }
}
