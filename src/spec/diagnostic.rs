//! ProblemList of a pipeline file for people: message, place, source line and hints.

use std::fmt;

use super::SourceName;
use super::source::{SourceText, Span};

/// Source lines are cropped to about this many characters around the caret.
const WIDTH: usize = 120;

/// One problem.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// What was seen and what was expected.
    pub message: String,
    /// Where: first the place to look at, then others that belong to it. Empty only where there is no text to point
    /// into, as for a folder.
    pub places: Vec<Place>,
    /// How to fix it.
    pub hints: Vec<String>,
}

/// A place in a file or an argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file's name, or ``argument `--set` ``.
    pub source: String,
    /// Line and column, from 1, the column in characters; `None` in an argument.
    pub position: Option<(usize, usize)>,
    /// The source line, made safe to print: cropped around the caret, control characters replaced.
    pub text: String,
    /// Characters of `text` before the caret.
    pub indent: usize,
    /// Characters that the caret covers, at least 1.
    pub width: usize,
    /// A few words beside the caret; may be empty.
    pub label: String,
}

impl Place {
    pub(super) fn new(source: &SourceText, span: Span, label: String) -> Self {
        let line = source.line(span);
        let before = line.text[..line.range.start].chars().count();
        let width = line.text[line.range.clone()].trim_end().chars().count().max(1);
        let length = line.text.chars().count();
        // The caret stays in view; what is cut is marked.
        let first = if length <= WIDTH { 0 } else { before.saturating_sub(WIDTH / 2) };
        let width = width.min(WIDTH);
        let mut text: String = line.text.chars().skip(first).take(WIDTH).map(printable).collect();
        let mut indent = before - first;
        if first > 0 {
            text.insert(0, '…');
            indent += 1;
        }
        if first + WIDTH < length {
            text.push('…');
        }
        let position = (!source.is_argument).then_some((line.number, line.column));
        Self { source: source.name.clone(), position, text, indent, width, label }
    }

    fn line_number(&self) -> String {
        self.position.map(|(line, _)| line.to_string()).unwrap_or_default()
    }

    fn render(&self, f: &mut fmt::Formatter<'_>, gutter: usize, primary: bool) -> fmt::Result {
        let (arrow, caret) = if primary { ("-->", "^") } else { (":::", "-") };
        let at = self.position.map(|(line, column)| format!(":{line}:{column}")).unwrap_or_default();
        writeln!(f, "{:gutter$}{arrow} {}{at}", "", self.source)?;
        writeln!(f, "{:gutter$} |", "")?;
        let line = format!("{:>gutter$} | {}", self.line_number(), self.text);
        writeln!(f, "{}", line.trim_end())?;
        let marks = caret.repeat(self.width);
        let marks = format!("{:gutter$} | {:indent$}{marks} {}", "", "", self.label, indent = self.indent);
        writeln!(f, "{}", marks.trim_end())
    }
}

/// Makes a text from a file or a stage kind safe for the terminal, on one line.
pub(super) fn plain(text: &str) -> String {
    text.chars().map(printable).collect()
}

/// A character that takes one place on a terminal and does nothing to it.
fn printable(character: char) -> char {
    match character {
        '\t' | '\n' | '\r' => ' ',
        // Also marks that change the direction of what follows: they can make a line read as another.
        '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => '\u{fffd}',
        other if other.is_control() => '\u{fffd}',
        other => other,
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "error: {}", self.message)?;
        let gutter = self.places.iter().map(|place| place.line_number().len()).max().unwrap_or(0);
        let gutter = gutter.max(1);
        for (number, place) in self.places.iter().enumerate() {
            place.render(f, gutter, number == 0)?;
        }
        for hint in &self.hints {
            writeln!(f, "{:gutter$} = hint: {hint}", "")?;
        }
        Ok(())
    }
}

/// All problems that were found, in the order of the file. Displays as the full text for the terminal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostics {
    found: Vec<Diagnostic>,
    more: usize,
}

impl Diagnostics {
    pub(crate) fn new(found: Vec<Diagnostic>, more: usize) -> Self {
        Self { found, more }
    }

    /// A file that could not be read: missing, a folder, not allowed.
    pub fn unreadable(name: &SourceName, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let name = &name.0;
        let (message, hint) = match error.kind() {
            ErrorKind::NotFound => {
                (format!("there is no file `{name}`"), "give the path of a pipeline file (YAML)")
            }
            ErrorKind::IsADirectory => (
                format!("`{name}` is a folder, expected a pipeline file (YAML)"),
                "give the path of a file in it, as in `dril-pipe run pipelines/thesis.yaml`",
            ),
            ErrorKind::PermissionDenied => {
                (format!("no permission to read `{name}`: {error}"), "change its permissions")
            }
            ErrorKind::InvalidData => (
                format!("`{name}` is not valid UTF-8, expected a text file"),
                "save the file as UTF-8 in your editor",
            ),
            _ => (format!("cannot read `{name}`: {error}"), "give the path of a pipeline file (YAML)"),
        };
        let problem = Diagnostic { message, places: Vec::new(), hints: vec![hint.to_owned()] };
        Self::new(vec![problem], 0)
    }

    /// How many, with those that are not listed.
    pub fn len(&self) -> usize {
        self.found.len() + self.more
    }

    /// True where there are none.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// Each that is listed.
    pub fn iter(&self) -> impl Iterator<Item = &Diagnostic> {
        self.found.iter()
    }
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, problem) in self.found.iter().enumerate() {
            if number > 0 {
                writeln!(f)?;
            }
            write!(f, "{problem}")?;
        }
        if self.more > 0 {
            writeln!(f, "\nerror: up to {} more problems; fix these first", self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostics {}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(text: &str, range: std::ops::Range<usize>) -> Place {
        Place::new(&SourceText::file("a.yaml", text), Span::new(0, range), String::new())
    }

    #[test]
    fn a_problem_shows_message_place_line_caret_and_hint() {
        let source = SourceText::file("pipelines/a.yaml", "one\n    inputs: { demo: dataset }\n");
        let place = Place::new(&source, Span::new(0, 18..22), "not an input of kind `bc`".into());
        let problem = Diagnostic {
            message: "stage `clone` has no input `demo`".into(),
            places: vec![place],
            hints: vec!["its inputs are `demonstrations`".into()],
        };
        let expected = "\
error: stage `clone` has no input `demo`
 --> pipelines/a.yaml:2:15
  |
2 |     inputs: { demo: dataset }
  |               ^^^^ not an input of kind `bc`
  = hint: its inputs are `demonstrations`
";
        assert_eq!(problem.to_string(), expected);
    }

    #[test]
    fn a_long_line_is_cropped_and_the_caret_stays_under_its_word() {
        let text = format!("{}word{}", "x".repeat(500), "y".repeat(500));
        let place = place(&text, 500..504);
        assert!(place.text.chars().count() <= WIDTH + 2);
        let under: String = place.text.chars().skip(place.indent).take(place.width).collect();
        assert_eq!(under, "word");
        assert_eq!(place.position, Some((1, 501)));
    }

    #[test]
    fn a_source_line_cannot_send_commands_to_the_terminal() {
        let place = place("a: \u{1b}[2J\u{202e}x\ty", 0..1);
        assert!(!place.text.contains(|c: char| c.is_control() || c == '\u{202e}'), "{place:?}");
    }

    #[test]
    fn a_folder_and_a_missing_file_have_different_messages() {
        let name = SourceName("pipelines".into());
        let text = |kind: std::io::ErrorKind| Diagnostics::unreadable(&name, &kind.into()).to_string();
        assert!(text(std::io::ErrorKind::IsADirectory).contains("`pipelines` is a folder"));
        assert!(text(std::io::ErrorKind::NotFound).contains("there is no file `pipelines`"));
    }
}
