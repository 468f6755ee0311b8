//! The protocol over the pipes: a set-up line as JSON, a greeting in response, then requests and replies of fixed sizes.
//! `worker.py` implements the other side.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{ActionSpace, ObservationSpace, Outcome, Step};

/// Raised with every change of the layout.
pub const PROTOCOL: u32 = 1;
/// First bytes of a greeting.
pub const MAGIC: &[u8; 8] = b"DRILGYM1";
/// Maximum length of a greeting.
pub const MOST_GREETING: u32 = 1 << 20;
/// Length of a reply's header, before the observation.
pub const REPLY: usize = 20;
/// First bytes of a reply: `DRYM`, as a number.
const MARK: u32 = 0x4d59_5244;

/// Which environments to create: the first line that a worker reads.
#[derive(Debug, Serialize)]
pub struct Setup<'a> {
    /// The environment's id.
    pub id: &'a str,
    /// Arguments of `gymnasium.make`.
    pub kwargs: &'a BTreeMap<String, serde_json::Value>,
    /// Steps after which an episode is truncated.
    pub time_limit: Option<u32>,
    /// Number of environments.
    pub count: usize,
    /// True to allow rendering.
    pub images: bool,
    /// True if every reset passes the track's random draws.
    pub draws: bool,
    /// Packages whose versions to report.
    pub packages: Vec<&'a str>,
}

/// The first message of a worker.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Greeting {
    /// [`PROTOCOL`].
    pub protocol: u32,
    /// The version of every requested package; none if it is missing.
    #[serde(default)]
    pub versions: BTreeMap<String, Option<String>>,
    /// Raw observations.
    #[serde(default)]
    pub observation: Option<RawObservation>,
    /// Action space.
    #[serde(default)]
    pub action: Option<ActionSpace>,
    /// Height and width of rendered images, if rendering was requested.
    #[serde(default)]
    pub image: Option<[usize; 2]>,
    /// Why the environment cannot be used.
    #[serde(default)]
    pub refused: Option<Refusal>,
}

/// Raw observations of an environment, before preprocessing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum RawObservation {
    /// Bytes, row by row, `channels` (1 or 3) per pixel.
    Image {
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
        /// 1 for greyscale, 3 for RGB.
        channels: usize,
    },
    /// `f32` values.
    Vector {
        /// Length of the vector.
        len: usize,
    },
}

impl RawObservation {
    /// Size of an observation on the pipe, in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::Image { height, width, channels } => height * width * channels,
            Self::Vector { len } => 4 * len,
        }
    }

    /// Observation space after preprocessing.
    pub fn space(self) -> ObservationSpace {
        use crate::wrappers::preprocess::SIDE;
        match self {
            Self::Image { .. } => ObservationSpace::Image { height: SIDE, width: SIDE, stack: 4 },
            Self::Vector { len } => ObservationSpace::Vector { len },
        }
    }
}

/// Why a worker cannot create an environment.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Refusal {
    /// `unknown` id, `missing` package, `settings` or `space`.
    pub kind: String,
    /// Explanation.
    pub message: String,
}

/// An operation of a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Starts an episode.
    Reset,
    /// Takes one step.
    Step,
    /// Renders an image.
    Render,
}

impl Operation {
    fn code(self) -> u8 {
        match self {
            Self::Reset => b'R',
            Self::Step => b'S',
            Self::Render => b'P',
        }
    }

    /// For error messages: "while ...".
    pub fn doing(self) -> &'static str {
        match self {
            Self::Reset => "starting an episode",
            Self::Step => "stepping",
            Self::Render => "rendering",
        }
    }
}

/// A request: operation, environment, seed, and its data (draws or actions).
pub fn request(operation: Operation, env: usize, seed: u64, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![operation.code(), 0, 0, 0];
    bytes.extend((env as u32).to_le_bytes());
    bytes.extend(seed.to_le_bytes());
    bytes.extend(body);
    bytes
}

/// Parses the header of a reply: the environment, and the result of the step.
///
/// # Errors
/// The reply is invalid, or does not belong to `operation`.
pub fn reply(head: &[u8; REPLY], operation: Operation, envs: usize) -> Result<(usize, Step), String> {
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let mut reward = [0; 8];
    reward.copy_from_slice(&head[12..]);
    let (mark, env, reward) = (word(0), word(8) as usize, f64::from_le_bytes(reward));
    if mark != MARK || head[4] != operation.code() {
        let seen = head[..5].escape_ascii();
        let wanted = MARK.to_le_bytes().into_iter().chain([operation.code()]).collect::<Vec<_>>();
        return Err(format!("it begins with `{seen}`, expected `{}`", wanted.escape_ascii()));
    }
    if env >= envs {
        return Err(format!("it is of environment {env}, expected one below {envs}"));
    }
    let outcomes = [Outcome::Running, Outcome::Finished, Outcome::Failed, Outcome::TimeLimit];
    let Some(outcome) = outcomes.get(usize::from(head[5])) else {
        return Err(format!("its outcome is {}, expected 0 to 3", head[5]));
    };
    if !reward.is_finite() {
        return Err(format!("its reward is {reward}, expected a finite number"));
    }
    Ok((env, Step { reward, outcome: *outcome }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(mark: u32, operation: u8, outcome: u8, env: u32, reward: f64) -> [u8; REPLY] {
        let mut head = [0; REPLY];
        head[..4].copy_from_slice(&mark.to_le_bytes());
        head[4..6].copy_from_slice(&[operation, outcome]);
        head[8..12].copy_from_slice(&env.to_le_bytes());
        head[12..].copy_from_slice(&reward.to_le_bytes());
        head
    }

    #[test]
    fn a_reply_is_read_back() {
        let read = reply(&head(MARK, b'S', 3, 1, -0.25), Operation::Step, 2);
        assert_eq!(read, Ok((1, Step { reward: -0.25, outcome: Outcome::TimeLimit })));
    }

    #[test]
    fn a_reply_that_makes_no_sense_says_what_was_seen_and_expected() {
        for (head, words) in [
            (*b"Hello from pygame!!!", "`Hello`, expected `DRYMS`"),
            (head(MARK, b'R', 0, 0, 0.0), "`DRYMR`, expected `DRYMS`"),
            (head(MARK, b'S', 4, 0, 0.0), "outcome is 4"),
            (head(MARK, b'S', 0, 2, 0.0), "environment 2"),
            (head(MARK, b'S', 0, 0, f64::NAN), "NaN"),
        ] {
            let message = reply(&head, Operation::Step, 2).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
    }
}
