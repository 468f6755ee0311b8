//! Messages of a running stage to the engine: JSON lines on its standard output.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Progress of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Steps done, in units of `unit`.
    pub step: u64,
    /// Total number of steps; 0 if unknown.
    pub total: u64,
    /// The unit: "steps", "epochs", "episodes".
    pub unit: String,
    /// A short status, such as "score 812".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A message from a stage to the engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Message {
    /// Progress.
    Progress(Progress),
    /// Provenance of the result, by name: libraries, instruction sets.
    MadeWith(BTreeMap<String, String>),
    /// The stage failed; the last message.
    Failed {
        /// The error's text.
        error: String,
    },
}

impl Message {
    /// The message as a line, without line break.
    pub fn to_line(&self) -> String {
        // Strings and numbers always serialise.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Parses a line; `None` for any other output of the stage or its libraries.
    pub fn from_line(line: &str) -> Option<Self> {
        if line.starts_with('{') { serde_json::from_str(line).ok() } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_survives_its_line_and_other_text_is_no_message() {
        let message =
            Message::Progress(Progress { step: 3, total: 9, unit: "epochs".into(), note: "a\nb".into() });
        assert!(!message.to_line().contains('\n'));
        assert_eq!(Message::from_line(&message.to_line()), Some(message));
        let with = Message::MadeWith(BTreeMap::from([("libtorch".to_owned(), "2.13.0".to_owned())]));
        assert_eq!(Message::from_line(&with.to_line()), Some(with));
        assert_eq!(Message::from_line("[W] a library said something"), None);
        assert_eq!(Message::from_line("{\"else\": 1}"), None);
    }
}
