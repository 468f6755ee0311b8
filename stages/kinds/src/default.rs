//! Literal default values of fields, for structs in which other fields are required: serde needs a function for each.

/// Writes a module `default` with one function a line: `defaults! { patience: u64 = 20; }` is
/// `#[serde(default = "default::patience")]`.
macro_rules! defaults {
    ($($name:ident: $type:ty = $value:expr;)+) => {
        mod default {
            #[allow(unused_imports)]
            use super::*;
            $(pub(super) fn $name() -> $type { $value })+
        }
    };
}

pub(crate) use defaults;
