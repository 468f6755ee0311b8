//! Timeout, memory limit, retries and resources of a stage; never part of a key.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use super::node::{Key, Node, Value};
use super::problem::{Problem, ProblemList};

/// The maximum number of retries.
const MOST_RETRIES: u64 = 1000;
/// What is expected of a time, for errors.
const TIME: &str = "a time with its unit (s, m, h or d), as 90s, 2h, 1h30m or 30d";
/// What is expected of a size, for errors.
const SIZE: &str = "a size with its unit (B, K, M, G or T), as 500M or 20G";
/// The default pause before the first retry.
const PAUSE: Duration = Duration::from_secs(1);

/// The limits of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The number of retries after a failure.
    pub retries: u32,
    /// The pause before the first retry; it doubles with each retry, up to an hour.
    pub pause: Duration,
    /// The time limit of one try.
    pub timeout: Option<Duration>,
    /// The memory limit in bytes, for the stage and all processes that it starts.
    pub memory: Option<u64>,
}

/// The units of counted resources that a stage holds while it runs: `gpu: 1`, `licence: 2`. Shared, since most stages hold none.
pub type Resources = Arc<BTreeMap<String, u32>>;

/// The maximum number of units of one resource that a stage may ask for.
pub(crate) const MOST_OF_ONE: u64 = 10_000;

impl Default for Limits {
    fn default() -> Self {
        Self { retries: 0, pause: PAUSE, timeout: None, memory: None }
    }
}

impl Limits {
    /// The pause before a retry, numbered from 1.
    pub fn pause_before(&self, retry: u32) -> Duration {
        let longer =
            self.pause.saturating_mul(1_u32.checked_shl(retry.saturating_sub(1)).unwrap_or(u32::MAX));
        longer.min(Duration::from_secs(3600).max(self.pause))
    }
}

/// Reads the fields `retries`, `timeout` and `memory` of a stage.
pub(super) fn limits(
    retries: Option<(Key, Node)>,
    timeout: Option<(Key, Node)>,
    memory: Option<(Key, Node)>,
    problems: &mut ProblemList,
) -> Limits {
    let mut limits = Limits::default();
    if let Some((key, node)) = retries {
        tries(key, node, &mut limits, problems);
    }
    limits.timeout = timeout.and_then(|(key, node)| time(&key, &node, problems));
    limits.memory = memory.and_then(|(key, node)| {
        let text = plain(&node);
        let bytes = text.as_deref().map(parse_size);
        match bytes {
            Some(Ok(bytes)) if bytes > 0 => Some(bytes),
            _ => {
                wrong(&key, &node, SIZE, problems);
                None
            }
        }
    });
    limits
}

/// Reads the field `resources` of a stage: `{ gpu: 1, licence: 2 }`.
pub(super) fn resources(field: Option<(Key, Node)>, problems: &mut ProblemList) -> Resources {
    let mut all = BTreeMap::new();
    let Some((key, node)) = field else { return Resources::default() };
    let Value::Map(entries) = node.value else {
        wrong(&key, &node, "a map of names and whole numbers, as `{ gpu: 1 }`", problems);
        return Resources::default();
    };
    for (name, value) in entries {
        let count = match &value.value {
            Value::Number(number, _) => number.as_u64().filter(|count| (1..=MOST_OF_ONE).contains(count)),
            _ => None,
        };
        match count.and_then(|count| u32::try_from(count).ok()) {
            Some(count) if super::names::is_identifier(&name.text) => {
                all.insert(name.text.to_string(), count);
            }
            Some(_) => problems.add(|| {
                let text = format!("`{}` cannot be the name of a resource", super::node::shorten(&name.text));
                Problem::new(name.span, text).hint("use a letter, then letters, digits, `-` or `_`")
            }),
            None => wrong(&name, &value, "a whole number of at least 1", problems),
        }
    }
    all.into()
}

/// `3`, or `{ times: 3, pause: 30s }`.
fn tries(key: Key, node: Node, limits: &mut Limits, problems: &mut ProblemList) {
    let expected = "a whole number up to 1000, or `{ times: 3, pause: 30s }`";
    match node.value {
        Value::Map(entries) => {
            for (name, value) in entries {
                match &*name.text {
                    "times" => tries(name, value, limits, problems),
                    "pause" => limits.pause = time(&name, &value, problems).unwrap_or(PAUSE),
                    _ => problems.add(|| {
                        let text =
                            format!("`retries` has the unknown key `{}`", super::node::shorten(&name.text));
                        Problem::new(name.span, text).hint("its keys are `times` and `pause`")
                    }),
                }
            }
        }
        Value::Number(ref number, _) => match number.as_u64().filter(|times| *times <= MOST_RETRIES) {
            Some(times) => limits.retries = u32::try_from(times).unwrap_or(u32::MAX),
            None => wrong(&key, &node, expected, problems),
        },
        _ => wrong(&key, &node, expected, problems),
    }
}

fn time(key: &Key, node: &Node, problems: &mut ProblemList) -> Option<Duration> {
    match plain(node).as_deref().map(parse_time) {
        Some(Ok(time)) if !time.is_zero() => Some(time),
        _ => {
            wrong(key, node, TIME, problems);
            None
        }
    }
}

/// The text of a scalar as it was written.
fn plain(node: &Node) -> Option<String> {
    match &node.value {
        Value::Text(text) => Some(text.to_string()),
        Value::Number(_, written) => Some(written.to_string()),
        _ => None,
    }
}

fn wrong(key: &Key, node: &Node, expected: &str, problems: &mut ProblemList) {
    if !matches!(node.value, Value::Broken) {
        problems.add(|| {
            let span = if node.span.is_empty() { key.span } else { node.span };
            let text = format!("`{}` is {}, expected {expected}", key.text, node.describe());
            Problem::new(span, text).hint("this field does not support `$name`: write the value")
        });
    }
}

/// A time: a number with `s`, `m`, `h` or `d`, or several of them (`1h30m`). A bare number is refused: people mean seconds,
/// minutes or days by it.
pub(crate) fn parse_time(text: &str) -> Result<Duration, String> {
    let wrong = || format!("expected {TIME}");
    let mut total = 0.0;
    let mut rest = text.trim();
    while !rest.is_empty() {
        let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').ok_or_else(wrong)?;
        let number: f64 = rest[..end].parse().map_err(|_| wrong())?;
        let unit = match rest.as_bytes()[end] {
            b's' => 1.0,
            b'm' => 60.0,
            b'h' => 3600.0,
            b'd' => 86_400.0,
            _ => return Err(wrong()),
        };
        total += number * unit;
        rest = rest[end + 1..].trim_start();
    }
    match Duration::try_from_secs_f64(total) {
        Ok(time) if !text.trim().is_empty() && total < 1e10 => Ok(time),
        _ => Err(wrong()),
    }
}

/// A size: a number with `B`, or with `K`, `M`, `G` or `T` (of 1024). A bare number is refused.
pub(crate) fn parse_size(text: &str) -> Result<u64, String> {
    let wrong = || format!("expected {SIZE}");
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_uppercase().as_str() {
        "B" => 0,
        "K" | "KB" | "KIB" => 10,
        "M" | "MB" | "MIB" => 20,
        "G" | "GB" | "GIB" => 30,
        "T" | "TB" | "TIB" => 40,
        _ => return Err(wrong()),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    let bytes = number * (1_u64 << shift) as f64;
    if bytes.is_finite() && (0.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_their_unit() {
        let seconds = |text| parse_time(text).unwrap().as_secs();
        let times = [seconds("90s"), seconds("1h30m"), seconds("30d"), seconds("1.5h"), seconds("0s")];
        assert_eq!(times, [90, 5400, 2_592_000, 5400, 0]);
        for wrong in ["", "h", "2w", "-1s", "1e9d", "1h x", "30", "0", "1h30", "1é", "1 s"] {
            assert!(parse_time(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn sizes_are_read_with_their_unit() {
        let sizes = ["0B", "12b", "1.5K", "20G", "1MiB", "2gb"].map(|text| parse_size(text).unwrap());
        assert_eq!(sizes, [0, 12, 1536, 20 << 30, 1 << 20, 2 << 30]);
        for wrong in ["", "G", "-1K", "1X", "nanG", "1e30B", "20", "0", "1BB", "1KK"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn pauses_double_up_to_an_hour() {
        let limits = Limits { pause: Duration::from_secs(30), ..Limits::default() };
        let pauses = [1, 2, 3, 20, 64].map(|retry| limits.pause_before(retry).as_secs());
        assert_eq!(pauses, [30, 60, 120, 3600, 3600]);
    }
}
