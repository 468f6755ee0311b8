//! Signatures of records: with a secret that a team shares, only records written with the secret are accepted.
//!
//! An object is the record in JSON, which has no line break, and where it is signed a second line
//! `dril-signature-1 <hex>`: the keyed blake3 hash of the stage key and the record.

use crate::store::Key;

const HEAD: &str = "\ndril-signature-1 ";
/// What the secret is stretched for; another use of the same secret gives another key.
const CONTEXT: &str = "dril-pipe 2026-11-25 records of a shared cache";

/// A secret that a team shares. It is never printed.
#[derive(Clone)]
pub struct Secret([u8; 32]);

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret(…)")
    }
}

impl Secret {
    /// From the text of a secret; white space around it does not count. `None` where it is shorter than 16 bytes.
    pub fn new(text: &str) -> Option<Self> {
        let text = text.trim();
        (text.len() >= 16).then(|| Self(blake3::derive_key(CONTEXT, text.as_bytes())))
    }

    fn signature(&self, key: &Key, record: &[u8]) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(key.as_bytes()).update(record);
        hasher.finalize()
    }
}

/// The object for a record.
pub fn seal(key: &Key, mut record: Vec<u8>, secret: Option<&Secret>) -> Vec<u8> {
    if let Some(secret) = secret {
        let signature = secret.signature(key, &record);
        record.extend_from_slice(HEAD.as_bytes());
        record.extend_from_slice(signature.to_hex().as_bytes());
        record.push(b'\n');
    }
    record
}

/// The record in an object.
///
/// # Errors
/// There is a secret, and the object is not signed with it.
pub fn open<'o>(key: &Key, object: &'o [u8], secret: Option<&Secret>) -> Result<&'o [u8], &'static str> {
    let end = object.iter().position(|byte| *byte == b'\n').unwrap_or(object.len());
    let (record, rest) = object.split_at(end);
    let Some(secret) = secret else { return Ok(record) };
    let Some(hex) = std::str::from_utf8(rest).ok().and_then(|rest| rest.strip_prefix(HEAD)) else {
        return Err("it is not signed, but a secret is set");
    };
    // The comparison of two hashes takes the same time wherever they differ.
    match blake3::Hash::from_hex(hex.trim_end()) {
        Ok(signature) if signature == secret.signature(key, record) => Ok(record),
        _ => Err("its signature does not match the secret"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_taken_only_with_the_signature_of_the_secret_and_under_its_key() {
        let (key, other) = (Key::new([1; 32]), Key::new([2; 32]));
        let secret = Secret::new("  correct horse battery\n").unwrap();
        let wrong = Secret::new("correct horse batterz").unwrap();
        let object = seal(&key, b"{\"a\":1}".to_vec(), Some(&secret));
        assert_eq!(open(&key, &object, Some(&secret)), Ok(&b"{\"a\":1}"[..]));
        assert_eq!(open(&key, &object, None), Ok(&b"{\"a\":1}"[..]));
        assert!(open(&key, &object, Some(&wrong)).is_err());
        assert!(open(&other, &object, Some(&secret)).is_err(), "moved to another key");
        assert!(open(&key, &object[..object.len() - 9], Some(&secret)).is_err(), "cut");
        let mut changed = object.clone();
        changed[5] = b'2';
        assert!(open(&key, &changed, Some(&secret)).is_err());
        assert!(open(&key, b"{\"a\":1}", Some(&secret)).is_err(), "unsigned");
        assert_eq!(open(&key, &seal(&key, b"{}".to_vec(), None), None), Ok(&b"{}"[..]));
    }

    #[test]
    fn a_secret_is_not_printed_and_short_ones_are_refused() {
        let secret = Secret::new("0123456789abcdef").unwrap();
        assert!(!format!("{secret:?}").contains("0123"));
        assert!(Secret::new("   short   ").is_none());
    }
}
