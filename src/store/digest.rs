//! Digests of contents and keys of stages: 32 bytes of blake3, with two types so that they cannot be confused.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// A text that is not 64 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a digest: expected 64 hexadecimal digits in lower case")]
pub struct NotHex(String);

macro_rules! hex_name {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name([u8; 32]);

        impl $name {
            /// From its bytes.
            pub const fn new(bytes: [u8; 32]) -> Self {
                Self(bytes)
            }

            /// Its bytes.
            pub const fn as_bytes(&self) -> &[u8; 32] {
                &self.0
            }

            /// The 64 hexadecimal digits.
            pub fn hex(&self) -> String {
                blake3::Hash::from_bytes(self.0).to_hex().as_str().to_owned()
            }

            /// The first digits, enough for people to distinguish two.
            pub fn short(&self) -> String {
                self.hex()[..12].to_owned()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(blake3::Hash::from_bytes(self.0).to_hex().as_str())
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}({})", stringify!($name), self.short())
            }
        }

        impl FromStr for $name {
            type Err = NotHex;
            fn from_str(text: &str) -> Result<Self, NotHex> {
                parse(text).map(|hash| Self(*hash.as_bytes()))
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(blake3::Hash::from_bytes(self.0).to_hex().as_str())
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                deserializer.deserialize_str(HexVisitor).map(|hash| Self(*hash.as_bytes()))
            }
        }
    };
}

hex_name! {
    /// The digest of a content: blake3 of its bytes.
    Digest
}
hex_name! {
    /// The key of a stage: blake3 over everything that its result depends on (see [`crate::plan`]).
    Key
}

/// Stricter than blake3's own: one digest has one spelling, so that it also has one file name.
fn parse(text: &str) -> Result<blake3::Hash, NotHex> {
    let lower = !text.bytes().any(|byte| byte.is_ascii_uppercase());
    match blake3::Hash::from_hex(text) {
        Ok(hash) if lower => Ok(hash),
        _ => Err(NotHex(text.to_owned())),
    }
}

struct HexVisitor;

impl de::Visitor<'_> for HexVisitor {
    type Value = blake3::Hash;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("64 hexadecimal digits in lower case")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<blake3::Hash, E> {
        parse(text).map_err(E::custom)
    }
}

impl Digest {
    /// The name of these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_is_read_back_and_anything_else_is_refused() {
        let digest = Digest::of(b"abc");
        assert_eq!(digest.hex().parse(), Ok(digest));
        assert_eq!(digest.to_string(), "6437b3ac38465133ffb63b75273a8db548c558465d79db03fd359c6cd5bd9d85");
        for wrong in ["", "6437", &digest.hex().to_uppercase(), &format!("{digest}0"), "../../etc/passwd"] {
            assert!(wrong.parse::<Digest>().is_err(), "{wrong}");
        }
    }
}
