//! What a running stage says: one JSON object a line on its standard output, which the engine reads.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// How far a stage is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Steps done, in `unit`s.
    pub step: u64,
    /// Steps in all; 0 where that is not known.
    pub total: u64,
    /// What a step is: "steps", "epochs", "episodes".
    pub unit: String,
    /// A short reading for people, as in "score 812".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A line from a stage to the engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Message {
    /// How far it is.
    Progress(Progress),
    /// What its result depends on besides inputs, parameters and seed: libraries, instruction sets; by name.
    MadeWith(BTreeMap<String, String>),
    /// It failed, and why; the last message.
    Failed {
        /// The error's text.
        error: String,
    },
}

impl Message {
    /// The line, without its end.
    pub fn to_line(&self) -> String {
        // Both variants hold strings and numbers only; there is nothing in them that JSON cannot say.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The message of a line; `None` for any other text that a stage (or a library in it) printed.
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
