//! Parses a file stage by stage, so that known stages need not be parsed again.
//!
//! A stage that starts on its own line under `stages:` is cut out and parsed with placeholders for the text before and after it, so
//! that the parser is in the same state as in the whole file. A file that does not have this plain form, or that contains an error,
//! is parsed as a whole: this module reports no problems.

use std::collections::HashSet;
use std::ops::Range;

use super::memo::{At, Memo};
use super::node::{Key, MAX_DEPTH, Node, Value};
use super::problem::ProblemList;
use super::yaml;

/// Placeholders for the file before a stage, for a stage before another, and for a key after it. No stage has such a name.
const STAGES: &str = "stages:\n";
const BEFORE: &str = "_: 0\n";
const BEHIND: &str = "__:\n";

/// Parses `text`, which is source number `source`; `None` where it has to be parsed as a whole.
pub(super) fn read(text: &str, source: u16, memo: &mut Memo) -> Option<Node> {
    let used = memo.used();
    let root = Cut::of(text).and_then(|cut| cut.read(text, source, memo));
    if root.is_none() {
        memo.forget(used);
    }
    root
}

/// True where parsing `text` in pieces, with and without a memo, gives the same as parsing it as a whole. For tests and fuzzers.
pub fn pieces_agree(text: &str) -> bool {
    let mut problems = ProblemList::default();
    let whole = format!("{:?}", yaml::read(text, 0, 0, &mut problems));
    let mut memo = Memo::default();
    for _ in 0..2 {
        if let Some(root) = read(text, 0, &mut memo)
            && (problems.reports() > 0 || format!("{:?}", Some(root)) != whole)
        {
            return false;
        }
        memo = memo.bytes().map(Memo::read).unwrap_or_default();
    }
    true
}

/// The positions at which a file can be cut.
struct Cut {
    /// The end of the line `stages:`.
    head: usize,
    /// Where stages begin.
    stages: Vec<usize>,
    /// Their indentation.
    column: usize,
    /// Where the next key of the file begins, or the end of the text.
    tail: usize,
}

impl Cut {
    /// `None` where the file does not have the required form.
    fn of(text: &str) -> Option<Self> {
        if text.contains('\r') {
            return None;
        }
        let (mut head, mut stages, mut column, mut tail) = (None, Vec::new(), 0, None);
        let mut next = 0;
        for line in text.split_inclusive('\n') {
            let begin = next;
            next += line.len();
            let line = line.trim_end_matches('\n');
            let bare = line.trim_start_matches(' ');
            if bare.is_empty() || bare.starts_with('#') {
                continue;
            }
            let indent = line.len() - bare.len();
            // Another document, a directive, or blanks of another sort.
            if bare.starts_with('\t')
                || indent == 0 && ["%", "...", "---"].iter().any(|it| line.starts_with(it))
            {
                return None;
            }
            let is_key = bare.starts_with(|first: char| first.is_ascii_alphabetic());
            match head {
                None if is_stages(line) => head = Some(next),
                None => {}
                Some(_) if tail.is_some() => {}
                // Anything but a key could belong to what comes before it.
                Some(_) if indent == 0 && !is_key => return None,
                Some(_) if indent == 0 => tail = Some(begin),
                Some(_) => {
                    if stages.is_empty() {
                        column = indent;
                    }
                    if indent < column || indent == column && !is_key {
                        return None;
                    }
                    if indent == column {
                        stages.push(begin);
                    }
                }
            }
        }
        let cut = Self { head: head?, stages, column, tail: tail.unwrap_or(text.len()) };
        (!cut.stages.is_empty()).then_some(cut)
    }

    fn read(&self, text: &str, source: u16, memo: &mut Memo) -> Option<Node> {
        let mut stages = Vec::with_capacity(self.stages.len());
        let mut names = HashSet::with_capacity(self.stages.len());
        let ends = self.stages.iter().skip(1).chain([&self.tail]);
        for (begin, end) in self.stages.iter().zip(ends) {
            let (name, stage) = self.stage(text, *begin..*end, source, memo)?;
            if !names.insert(name.text.clone()) {
                return None;
            }
            stages.push((name, stage));
        }
        let first = stages.first()?.0.span;
        let mut entries = self.head(text, source)?;
        *entries.last_mut().map(|(_, node)| node)? = Node::new(Value::Map(stages), first);
        if self.tail < text.len() {
            entries.extend(self.tail(text, source)?);
        }
        let mut keys = HashSet::new();
        if !entries.iter().all(|(key, _)| keys.insert(&*key.text)) {
            return None;
        }
        let first = entries.first()?.0.span;
        Some(Node::new(Value::Map(entries), first))
    }

    /// The keys up to `stages`, whose value is still to come.
    fn head(&self, text: &str, source: u16) -> Option<Vec<(Key, Node)>> {
        let part = [&text[..self.head], &" ".repeat(self.column), BEHIND].concat();
        let entries = map(yaml::read_part(&part, source, 0)?)?;
        let (name, value) = entries.last()?;
        (&*name.text == "stages" && !value.replace && is_behind(value)).then_some(entries)
    }

    /// The keys after `stages`.
    fn tail(&self, text: &str, source: u16) -> Option<Vec<(Key, Node)>> {
        let part = [BEFORE, &text[self.tail..]].concat();
        let mut entries = map(yaml::read_part(&part, source, self.tail.checked_sub(BEFORE.len())?)?)?;
        entries.remove(0);
        Some(entries)
    }

    /// One stage.
    fn stage(&self, text: &str, range: Range<usize>, source: u16, memo: &mut Memo) -> Option<(Key, Node)> {
        let indent = " ".repeat(self.column);
        let (is_first, is_last) = (range.start == self.stages[0], range.end == self.tail);
        let before = if is_first { STAGES.to_owned() } else { [STAGES, &indent, BEFORE].concat() };
        let behind = match (is_last, range.end == text.len()) {
            (false, _) => [&indent, BEHIND].concat(),
            (true, false) => BEHIND.to_owned(),
            (true, true) => String::new(),
        };
        let part = [&before, &text[range.clone()], &behind].concat();
        let start = range.start.checked_sub(before.len())?;
        let (digest, at) = (*blake3::hash(part.as_bytes()).as_bytes(), At { source, start });
        if let Some(known) = memo.get(&digest, at) {
            return Some(known);
        }
        let mut whole = map(yaml::read_part(&part, source, start)?)?.into_iter();
        let mut stages = map(whole.next()?.1)?.into_iter();
        if !is_first {
            stages.next()?;
        }
        let stage = stages.next()?;
        // One stage, and after it what was put there.
        let others = whole.len() + stages.len();
        if others != usize::from(!behind.is_empty()) || stage.1.depth() + 2 > MAX_DEPTH {
            return None;
        }
        memo.keep(&digest, at, &stage);
        Some(stage)
    }
}

/// `stages:` with nothing after it.
fn is_stages(line: &str) -> bool {
    let rest = line.strip_prefix("stages:");
    rest.is_some_and(|rest| {
        let bare = rest.trim_start_matches(' ');
        bare.is_empty() || bare.starts_with('#') && bare.len() < rest.len()
    })
}

fn map(node: Node) -> Option<Vec<(Key, Node)>> {
    match node.value {
        Value::Map(entries) if !entries.is_empty() => Some(entries),
        _ => None,
    }
}

fn is_behind(node: &Node) -> bool {
    matches!(&node.value, Value::Map(entries) if matches!(&**entries, [(key, _)] if &*key.text == "__"))
}

#[cfg(test)]
#[path = "pieces_tests.rs"]
mod tests;
