//! Properties of the output: colours, live updates, width. Reads the environment so that other files need not, and makes text
//! from outside safe to print.

use std::env;
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

use crate::error::{Error, ErrorKind};

/// How to write to a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Terminal {
    /// Use colours.
    pub colour: bool,
    /// Lines can be redrawn.
    pub live: bool,
    /// Width in columns; `None` for unlimited.
    pub width: Option<usize>,
}

impl Terminal {
    /// A file or a pipe: no colours, no live updates, unlimited width.
    #[cfg(test)]
    pub const PLAIN: Self = Self { colour: false, live: false, width: None };

    /// Standard output.
    pub fn stdout() -> Self {
        Self::of(&io::stdout())
    }

    /// Standard error.
    pub fn stderr() -> Self {
        Self::of(&io::stderr())
    }

    fn of(stream: &(impl IsTerminal + rustix::fd::AsFd)) -> Self {
        let set = |name| env::var_os(name).is_some_and(|value| !value.is_empty());
        let is_terminal = stream.is_terminal();
        let dumb = env::var_os("TERM").is_none_or(|term| term == "dumb");
        let forced = env::var_os("CLICOLOR_FORCE").is_some_and(|value| value != "0" && !value.is_empty());
        let size = if is_terminal { rustix::termios::tcgetwinsize(stream).ok() } else { None };
        Self {
            colour: !set("NO_COLOR") && (forced || (is_terminal && !dumb)),
            live: is_terminal && !dumb,
            width: size.map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0),
        }
    }

    /// `text` in a style.
    pub fn paint(self, style: Style, text: &str) -> String {
        if self.colour { format!("\x1b[{}m{text}\x1b[0m", style.code()) } else { text.to_owned() }
    }

    /// Colours the words `error:` and `hint:` in a text.
    pub fn paint_errors(self, text: &str) -> String {
        if !self.colour {
            return text.to_owned();
        }
        let mut painted = String::new();
        for line in text.split_inclusive('\n') {
            if let Some(rest) = line.strip_prefix("error:") {
                painted += &self.paint(Style::Bad, "error:");
                painted += rest;
            } else if let Some((before, rest)) = line.split_once("= hint:") {
                let _ = write!(painted, "{before}= {}{rest}", self.paint(Style::Hint, "hint:"));
            } else {
                painted += line;
            }
        }
        painted
    }
}

/// The meaning of a piece of text, for its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    /// Success.
    Good,
    /// Failure.
    Bad,
    /// Needs attention.
    Notable,
    /// Secondary.
    Quiet,
    /// A hint.
    Hint,
    /// The subject of the line.
    Strong,
}

impl Style {
    fn code(self) -> &'static str {
        match self {
            Self::Good => "32",
            Self::Bad => "1;31",
            Self::Notable => "33",
            Self::Quiet => "2",
            Self::Hint => "36",
            Self::Strong => "1",
        }
    }
}

/// Writes `text` to stdout. A closed pipe (`| head`) is not an error.
///
/// # Errors
/// It cannot be written for any other reason.
pub(super) fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::new(ErrorKind::Io, format!("cannot write to stdout: {error}")))
        }
        _ => Ok(()),
    }
}

/// Writes an error to stderr.
pub(super) fn print_error(text: &str) {
    // If this fails, there is nowhere left to report it.
    let _ = io::stderr().lock().write_all(Terminal::stderr().paint_errors(text).as_bytes());
}

/// Makes text from a stage or a file safe for a terminal: removes colour sequences and replaces other control characters.
pub(super) fn printable(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '\x1b' if chars.peek() == Some(&'[') => {
                chars.next();
                // Parameters and intermediates, up to the final byte.
                while chars.next_if(|c| ('\x20'..='\x3f').contains(c)).is_some() {}
                chars.next_if(|c| ('\x40'..='\x7e').contains(c));
            }
            '\n' => safe.push('\n'),
            '\t' => safe.push_str("    "),
            '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
                safe.push('\u{fffd}');
            }
            c if c.is_control() => safe.push('\u{fffd}'),
            c => safe.push(c),
        }
    }
    safe
}

/// A path for people: relative where it is below the current folder.
pub(super) fn shown(path: &Path) -> String {
    let here = env::current_dir().ok();
    let below = here.and_then(|here| path.strip_prefix(here).ok());
    printable(&below.unwrap_or(path).display().to_string())
}

/// `text` cut to `width` columns, with `…` where something is missing.
pub(super) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut short: String = text.chars().take(width.saturating_sub(1)).collect();
    short.push('…');
    short
}

/// A time for people: `0.05 s`, `3.2 s`, `2 min 05 s`, `3 h 12 min`, `2 d 4 h`.
pub(super) fn duration(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    let whole = time.as_secs();
    match whole {
        0 if seconds < 0.995 => format!("{seconds:.2} s"),
        _ if seconds < 59.95 => format!("{seconds:.1} s"),
        0..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        3600..86_400 => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
        _ => format!("{} d {} h", whole / 86_400, whole / 3600 % 24),
    }
}

/// A time that is only an estimate: `40 s`, `7 min`, `3 h 12 min`, `2 d 4 h`.
pub(super) fn estimate(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..100 => format!("{} s", seconds.max(1)),
        seconds @ 100..3600 => format!("{} min", (seconds + 30) / 60),
        _ => duration(time),
    }
}

/// `1 stage`, `2 stages`.
pub(super) fn count(number: usize, noun: &str) -> String {
    if number == 1 { format!("1 {noun}") } else { format!("{number} {noun}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_the_two_largest_units() {
        let text = |seconds: f64| duration(Duration::from_secs_f64(seconds));
        let cases = [
            (0.0, "0.00 s"),
            (0.0312, "0.03 s"),
            (0.999, "1.0 s"),
            (3.21, "3.2 s"),
            (59.94, "59.9 s"),
            (60.0, "1 min 00 s"),
            (125.9, "2 min 05 s"),
            (11_520.0, "3 h 12 min"),
            (187_200.0, "2 d 4 h"),
        ];
        for (seconds, expected) in cases {
            assert_eq!(text(seconds), expected, "{seconds}");
        }
    }

    #[test]
    fn an_estimate_is_rounded() {
        let text = |seconds| estimate(Duration::from_millis(seconds));
        assert_eq!(
            [text(300), text(99_900), text(100_000), text(3_570_000)],
            ["1 s", "99 s", "2 min", "60 min"]
        );
        assert_eq!(text(11_520_000), "3 h 12 min");
    }

    #[test]
    fn text_from_a_stage_cannot_command_the_terminal() {
        assert_eq!(printable("\x1b[31mred\x1b[0m\x1b[2Jx\x07y\tz"), "redx\u{fffd}y    z");
        assert!(!printable("\x1b]0;title\x07\u{202e}").contains(['\x1b', '\x07', '\u{202e}']));
    }

    #[test]
    fn a_cut_text_says_so_and_fits() {
        assert_eq!(cut("evaluate", 8), "evaluate");
        assert_eq!(cut("evaluate", 5), "eval…");
        assert_eq!(cut("évaluer", 3), "év…");
    }

    #[test]
    fn without_colours_nothing_is_added() {
        assert_eq!(Terminal::PLAIN.paint(Style::Bad, "x"), "x");
        assert_eq!(Terminal::PLAIN.paint_errors("error: x\n"), "error: x\n");
        let colour = Terminal { colour: true, ..Terminal::PLAIN };
        assert_eq!(colour.paint_errors("error: x\n"), "\x1b[1;31merror:\x1b[0m x\n");
    }
}
