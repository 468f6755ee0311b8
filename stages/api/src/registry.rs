//! The stage kinds that a program offers, by name.

use std::collections::BTreeMap;

use crate::Kind;

/// A set of stage kinds with unique names.
#[derive(Clone, Debug, Default)]
pub struct Registry {
    kinds: BTreeMap<&'static str, Kind>,
}

/// Two kinds have the same name.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("two stage kinds are called `{name}`")]
pub struct RegistryError {
    /// The name.
    pub name: &'static str,
}

impl Registry {
    /// The registry of these kinds.
    ///
    /// # Errors
    /// Two kinds have the same name.
    pub fn new(kinds: impl IntoIterator<Item = Kind>) -> Result<Self, RegistryError> {
        let mut map = BTreeMap::new();
        for kind in kinds {
            if map.insert(kind.name(), kind).is_some() {
                return Err(RegistryError { name: kind.name() });
            }
        }
        Ok(Self { kinds: map })
    }

    /// The kind of that name.
    pub fn get(&self, name: &str) -> Option<&Kind> {
        self.kinds.get(name)
    }

    /// All kinds, by name.
    pub fn iter(&self) -> impl Iterator<Item = &Kind> {
        self.kinds.values()
    }
}
