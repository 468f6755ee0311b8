//! The texts that messages point to: pipeline files and arguments of the command line.

use std::sync::Arc;

/// A range of bytes in one of the [`Sources`]. Empty where only a position is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Span {
    /// Which source; 0 is the pipeline file.
    pub source: u16,
    /// The first byte.
    pub start: u32,
    /// The byte after the last.
    pub end: u32,
}

impl Span {
    /// A range of the source with that number.
    pub fn new(source: u16, range: std::ops::Range<usize>) -> Self {
        let clamp = |at: usize| u32::try_from(at).unwrap_or(u32::MAX);
        Self { source, start: clamp(range.start), end: clamp(range.end) }
    }

    /// True for an empty range, as the value of `kind:` with nothing after it.
    pub fn is_empty(self) -> bool {
        self.start >= self.end
    }

    /// The span of a range relative to the start of this span.
    pub fn part(self, range: std::ops::Range<usize>) -> Self {
        let start = self.start as usize;
        Self::new(self.source, start + range.start..start + range.end)
    }
}

/// A text with its name.
#[derive(Clone, Debug)]
pub(crate) struct SourceText {
    /// As shown in messages: `pipelines/thesis.yaml`, or ``argument `--set` ``.
    pub name: String,
    /// All of it.
    pub text: Arc<str>,
    /// An argument has neither lines nor columns.
    pub is_argument: bool,
    /// The folder of an included file, relative to that of the pipeline file, with a `/` at its end; else empty.
    pub folder: String,
    /// Where lines begin, so that the line of a byte is found without reading the text again.
    lines: Vec<u32>,
}

/// One line of a source around a [`Span`].
pub(crate) struct Line<'a> {
    /// From 1.
    pub number: usize,
    /// In characters, from 1.
    pub column: usize,
    /// The line, without its end.
    pub text: &'a str,
    /// The part of `text` that the span covers, in bytes.
    pub range: std::ops::Range<usize>,
}

impl SourceText {
    /// A file.
    pub fn file(name: &str, text: &str) -> Self {
        Self::new(name.to_owned(), text, false)
    }

    /// A file that is included: `path` is relative to the folder of the pipeline file, which is called `main`.
    pub fn included(main: &str, path: &str, text: &str) -> Self {
        let beside = main.rfind('/').map_or("", |slash| &main[..=slash]);
        let folder = path.rfind('/').map_or("", |slash| &path[..=slash]);
        Self { folder: folder.to_owned(), ..Self::new(format!("{beside}{path}"), text, false) }
    }

    /// An argument after `option`, as in `--set`.
    pub fn argument(option: &str, text: &str) -> Self {
        Self::new(format!("argument `{option}`"), text, true)
    }

    fn new(name: String, text: &str, is_argument: bool) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at + 1);
        let lines = std::iter::once(0).chain(ends).map(|at| u32::try_from(at).unwrap_or(u32::MAX)).collect();
        Self { name, text: text.into(), is_argument, folder: String::new(), lines }
    }

    /// The line where `span` begins.
    pub fn line(&self, span: Span) -> Line<'_> {
        let start = floor(&self.text, span.start as usize);
        let number = self.lines.partition_point(|begin| *begin as usize <= start).max(1);
        let begin = self.lines[number - 1] as usize;
        let rest = &self.text[begin..];
        let text = rest.split('\n').next().unwrap_or(rest).trim_end_matches('\r');
        let from = floor(text, start - begin);
        let to = floor(text, (span.end as usize).saturating_sub(begin)).max(from);
        Line { number, column: text[..from].chars().count() + 1, text, range: from..to }
    }

    /// `thesis.yaml:14:9`, or the argument's name.
    pub fn place(&self, span: Span) -> String {
        if self.is_argument {
            return self.name.clone();
        }
        let line = self.line(span);
        format!("{}:{}:{}", self.name, line.number, line.column)
    }

    /// The text at `span`.
    pub fn slice(&self, span: Span) -> &str {
        let (start, end) = (floor(&self.text, span.start as usize), floor(&self.text, span.end as usize));
        self.text.get(start..end).unwrap_or_default()
    }
}

/// The start of the character at `at`, or the end of the text.
fn floor(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

/// The sources of one resolution.
#[derive(Clone, Debug)]
pub(crate) struct Sources(Vec<Arc<SourceText>>);

impl Sources {
    /// The pipeline file, as source 0, and those that it includes.
    pub fn of(files: &[Arc<SourceText>]) -> Self {
        Self(files.to_vec())
    }

    /// Adds a source and gives its number.
    pub fn add(&mut self, source: SourceText) -> u16 {
        self.0.push(Arc::new(source));
        u16::try_from(self.0.len() - 1).unwrap_or(u16::MAX)
    }

    /// The source that `span` points into; the file where there is no such source.
    pub fn get(&self, span: Span) -> &SourceText {
        self.0.get(usize::from(span.source)).unwrap_or(&self.0[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_knows_its_line_and_its_column_in_characters() {
        let source = SourceText::file("a.yaml", "first\r\ngrün: x\n");
        let at = source.text.find('x').unwrap();
        let line = source.line(Span::new(0, at..at + 1));
        assert_eq!((line.number, line.column, line.text), (2, 7, "grün: x"));
        assert_eq!(&line.text[line.range], "x");
        assert_eq!(source.place(Span::new(0, at..at + 1)), "a.yaml:2:7");
    }

    #[test]
    fn a_span_past_the_end_or_inside_a_character_points_at_something() {
        let source = SourceText::file("a.yaml", "ü");
        for range in [0..9, 1..1, 7..9, 1..2] {
            let line = source.line(Span::new(0, range));
            assert_eq!(line.number, 1);
            assert!(line.text.get(line.range).is_some());
        }
        assert_eq!(SourceText::file("a.yaml", "").line(Span::new(0, 0..0)).column, 1);
    }

    #[test]
    fn a_span_of_several_lines_covers_the_rest_of_the_first() {
        let source = SourceText::file("a.yaml", "a: [1,\n 2]\n");
        let line = source.line(Span::new(0, 3..10));
        assert_eq!(&line.text[line.range], "[1,");
    }
}
