//! Resolves `$name` at a place of the file.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

use super::axes::AxisValue;
use super::choices::Spread;
use super::template::{self, BadTemplate, Lone, Path, Piece, Template};
use crate::spec::node::{MAX_DEPTH, Node, Value};
use crate::spec::problem::{Problem, ProblemList};
use crate::spec::source::{Sources, Span};
use crate::spec::suggest;

/// The maximum number of values in one param or in the parameters of one instance: a few nested `$name`s could otherwise ask for
/// astronomically many.
const MAX_HERE: usize = 100_000;
/// The maximum number of values in the parameters of all instances together.
const MAX_TOTAL: usize = 10_000_000;
/// The maximum length of a text with `${...}`, in bytes.
const MAX_TEXT: usize = 1 << 16;

/// Values of the whole pipeline.
pub(super) struct Globals {
    pub pipeline: Arc<str>,
    pub profile: Arc<str>,
    /// `None` for an invalid param, which was reported.
    pub params: HashMap<Arc<str>, Option<Node>>,
}

/// The names at a place.
pub(super) struct Scope<'a> {
    pub globals: &'a Globals,
    /// The axes of the stage's matrix, at one of its instances; empty outside of stages.
    pub axes: Vec<(&'a str, &'a AxisValue)>,
    /// All axes, to distinguish an unknown name from one that is not available here.
    pub all_axes: &'a HashMap<Arc<str>, Span>,
    /// "stage `dril`", or another place.
    pub place: &'a str,
}

/// Fills in values; shared by all scopes of one resolution.
pub(super) struct Filler<'p> {
    pub sources: &'p Sources,
    pub problems: &'p mut ProblemList,
    /// The number of values so far, in total and for the current value.
    total: usize,
    here: usize,
    /// Stages that turned out to need the axis of a sweep.
    pub spread: Spread,
}

/// A name without a value.
enum Miss {
    /// Its value is invalid, which was reported.
    Broken,
    Unknown {
        message: String,
        hint: String,
        related: Option<Span>,
    },
}

impl<'a> Scope<'a> {
    fn get(&self, path: &str, at: Span) -> Result<Cow<'a, Node>, Miss> {
        let mut names = path.split('.');
        let first = names.next().unwrap_or_default();
        let axis = self.axes.iter().find(|(name, _)| *name == first);
        let base = match axis {
            Some((_, value)) => Cow::Borrowed(match names.clone().next() {
                None => &value.value,
                Some(_) => value.fields.as_ref().ok_or_else(|| no_fields(first, value))?,
            }),
            None => self.global(first, at)?,
        };
        let Cow::Borrowed(mut node) = base else {
            return match names.next() {
                Some(name) => field(&base, name, path).map(|node| Cow::Owned(node.clone())),
                None => Ok(base),
            };
        };
        for name in names {
            node = field(node, name, path)?;
        }
        Ok(Cow::Borrowed(node))
    }

    fn global(&self, name: &str, at: Span) -> Result<Cow<'a, Node>, Miss> {
        let text = |text: &Arc<str>| Cow::Owned(Node::new(Value::Text(text.clone()), at));
        match name {
            "profile" => Ok(text(&self.globals.profile)),
            "pipeline" => Ok(text(&self.globals.pipeline)),
            _ => match self.globals.params.get(name) {
                Some(Some(node)) => Ok(Cow::Borrowed(node)),
                Some(None) => Err(Miss::Broken),
                None => Err(self.unknown(name)),
            },
        }
    }

    fn unknown(&self, name: &str) -> Miss {
        let message = format!("`${name}` is not known in {}", self.place);
        if let Some(at) = self.all_axes.get(name).copied() {
            let hint = if self.axes.is_empty() && !self.place.starts_with("stage") {
                format!("an axis has a value only in a stage whose `matrix` lists it; use `${name}` there")
            } else {
                format!("add the axis to the stage: `matrix: [..., {name}]`")
            };
            return Miss::Unknown { message, hint, related: Some(at) };
        }
        let mut known: Vec<&str> = self.globals.params.keys().map(|name| &**name).collect();
        known.sort_unstable();
        let known = self.axes.iter().map(|(name, _)| *name).chain(known).chain(["profile", "pipeline"]);
        let hint = suggest::hint(name, "the names here", known);
        Miss::Unknown { message, hint, related: None }
    }
}

fn no_fields(axis: &str, value: &AxisValue) -> Miss {
    Miss::Unknown {
        message: format!("the value `{}` of axis `{axis}` has no fields", value.label),
        hint: format!(
            "write `${axis}` for the value itself, or give the axis as a map of values with fields"
        ),
        related: Some(value.span),
    }
}

fn field<'n>(node: &'n Node, name: &str, path: &str) -> Result<&'n Node, Miss> {
    let Value::Map(entries) = &node.value else {
        return Err(Miss::Unknown {
            message: format!("`${path}`: found {}, which has no field `{name}`", node.describe()),
            hint: "a path can only go into maps".to_owned(),
            related: Some(node.span),
        });
    };
    match node.get(name) {
        Some((_, node)) => Ok(node),
        None => Err(Miss::Unknown {
            message: format!("`${path}`: there is no field `{name}`"),
            hint: suggest::hint(name, "the fields", entries.iter().map(|(key, _)| &*key.text)),
            related: Some(node.span),
        }),
    }
}

impl<'p> Filler<'p> {
    /// Reports to `problems`.
    pub fn new(sources: &'p Sources, problems: &'p mut ProblemList) -> Self {
        Self { sources, problems, total: 0, here: 0, spread: Spread::new() }
    }

    /// `node` with every `$` replaced; `None` where one cannot be, which is reported.
    pub fn fill(&mut self, node: &Node, scope: &Scope<'_>) -> Option<Node> {
        self.here = 0;
        self.fill_at(node, scope, 0)
    }

    /// The value of a path that is written at `at`; `None` where there is none, which is reported.
    pub fn value(&mut self, path: &Path<'_>, at: Span, scope: &Scope<'_>) -> Option<Node> {
        self.here = 0;
        self.get(path, at, scope, 0)
    }

    fn fill_at(&mut self, node: &Node, scope: &Scope<'_>, depth: usize) -> Option<Node> {
        self.count(1, node.span)?;
        let value = match &node.value {
            Value::Text(text) => return self.text(text, node, scope, depth),
            Value::List(items) => {
                // All of them, so that all problems are found.
                let filled: Vec<_> = items.iter().map(|item| self.fill_at(item, scope, depth + 1)).collect();
                Value::List(filled.into_iter().collect::<Option<_>>()?)
            }
            Value::Map(entries) => {
                let filled: Vec<_> = entries
                    .iter()
                    .map(|(key, node)| Some((key.clone(), self.fill_at(node, scope, depth + 1)?)))
                    .collect();
                Value::Map(filled.into_iter().collect::<Option<_>>()?)
            }
            Value::Broken => return None,
            scalar => scalar.clone(),
        };
        Some(Node { value, ..node.shell() })
    }

    fn text(&mut self, text: &str, node: &Node, scope: &Scope<'_>, depth: usize) -> Option<Node> {
        match template::parse(text, Lone::Refuse) {
            Ok(Template::Plain) => Some(node.clone()),
            Ok(Template::Exact(path)) => {
                let at = self.part(node, text, &path);
                Some(self.get(&path, at, scope, depth)?.brought_in(at))
            }
            Ok(Template::Mixed(pieces)) => {
                let text = self.join(&pieces, text, node, scope)?;
                Some(Node { value: Value::Text(text.into()), ..node.shell() })
            }
            Err(bad) => {
                self.bad(bad, text, node);
                None
            }
        }
    }

    /// `text`, which is written at `node`, with the value of each `${path}`; a `$` of another form is left as it is.
    pub fn braces(&mut self, text: &str, node: &Node, scope: &Scope<'_>) -> Option<String> {
        match template::parse(text, Lone::Keep) {
            Ok(Template::Mixed(pieces)) => self.join(&pieces, text, node, scope),
            Ok(_) => Some(text.to_owned()),
            Err(bad) => {
                self.bad(bad, text, node);
                None
            }
        }
    }

    fn get(&mut self, path: &Path<'_>, at: Span, scope: &Scope<'_>, depth: usize) -> Option<Node> {
        match scope.get(path.text, at) {
            Ok(node) => {
                // Before it is copied.
                self.count(node.size(), at)?;
                if depth + node.depth() > MAX_DEPTH {
                    self.problems.add(|| {
                        let message =
                            format!("with this value, lists and maps are more than {MAX_DEPTH} deep");
                        Problem::new(at, message).hint("do the params contain each other?")
                    });
                    return None;
                }
                Some(node.into_owned())
            }
            Err(Miss::Broken) => None,
            Err(Miss::Unknown { message, hint, related }) => {
                self.problems.add(|| Problem::new(at, message).maybe_related(related, "here").hint(hint));
                None
            }
        }
    }

    fn join(&mut self, pieces: &[Piece<'_>], whole: &str, node: &Node, scope: &Scope<'_>) -> Option<String> {
        let mut text = Some(String::new());
        for piece in pieces {
            match piece {
                Piece::Text(part) => text.iter_mut().for_each(|text| text.push_str(part)),
                Piece::Path(path) => match self.scalar(path, whole, node, scope) {
                    Some(part) => text.iter_mut().for_each(|text| text.push_str(&part)),
                    None => text = None,
                },
            }
            if text.as_ref().is_some_and(|text| text.len() > MAX_TEXT) {
                self.problems.add(|| {
                    Problem::new(node.span, format!("the text grows beyond {MAX_TEXT} characters"))
                        .hint("do the params contain each other many times?")
                });
                return None;
            }
        }
        text
    }

    fn scalar(&mut self, path: &Path<'_>, whole: &str, node: &Node, scope: &Scope<'_>) -> Option<Arc<str>> {
        let at = self.part(node, whole, path);
        let found = self.get(path, at, scope, 0)?;
        let text = found.written();
        if text.is_none() {
            self.problems.add(|| {
                Problem::new(
                    at,
                    format!(
                        "`${{{}}}` is {}, expected a value that a text can contain",
                        path.text,
                        found.describe()
                    ),
                )
                .maybe_related((found.span != at).then_some(found.span), "its value")
                .hint("a text can only contain texts, numbers, `true` and `false`")
            });
        }
        text
    }

    fn bad(&mut self, bad: BadTemplate, text: &str, node: &Node) {
        let at = self.within(node, text, bad.range);
        self.problems.add(|| Problem::new(at, bad.message).hint(bad.hint));
    }

    fn part(&self, node: &Node, text: &str, path: &Path<'_>) -> Span {
        self.within(node, text, path.range.clone())
    }

    /// The place of a part of a text, where the file shows the text as it is; else the place of the whole.
    pub fn within(&self, node: &Node, text: &str, range: std::ops::Range<usize>) -> Span {
        let shown = self.sources.get(node.span).slice(node.span);
        match shown.find(text) {
            Some(skip) if skip <= 1 => node.span.part(skip + range.start..skip + range.end),
            _ => {
                // In a block the lines are indented, and quoted text may contain escapes: the part is found by its own text.
                let part = &text[range.clone()];
                let before = text[..range.start].matches(part).count();
                let found = shown.match_indices(part).nth(before).filter(|_| part.len() > 1);
                found.map_or(node.span, |(at, part)| node.span.part(at..at + part.len()))
            }
        }
    }

    fn count(&mut self, values: usize, at: Span) -> Option<()> {
        let fits = |sum: usize, limit: usize| sum <= limit;
        let (here, total) = (self.here, self.total);
        self.here = here.saturating_add(values);
        self.total = total.saturating_add(values);
        if fits(self.here, MAX_HERE) && fits(self.total, MAX_TOTAL) {
            return Some(());
        }
        // Reported once, where it happens.
        if fits(here, MAX_HERE) && fits(total, MAX_TOTAL) {
            self.problems.add(|| {
                let problem = if fits(self.here, MAX_HERE) {
                    Problem::new(
                        at,
                        format!("the parameters of all stages come to more than {MAX_TOTAL} values"),
                    )
                } else {
                    Problem::new(at, format!("with this, the value has more than {MAX_HERE} parts"))
                };
                problem
                    .hint("are there too many stage instances, or params that contain each other many times?")
            });
        }
        None
    }
}
