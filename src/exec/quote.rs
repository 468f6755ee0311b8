//! Text for a shell: in the scripts of jobs, and in commands that an error suggests.

/// The text in single quotes, as one word.
pub(crate) fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}
