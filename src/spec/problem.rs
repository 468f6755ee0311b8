//! Collects problems, so that all of them are reported at once.

use std::collections::HashSet;

use super::diagnostic::{Diagnostic, Diagnostics, Place, plain};
use super::source::{Sources, Span};

/// The maximum number of problems that are listed; further ones are only counted, so that a hostile file cannot keep us busy.
const LIMIT: usize = 100;

/// A problem with spans; it becomes a [`Diagnostic`] together with the sources.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    message: String,
    at: Span,
    label: String,
    related: Vec<(Span, String)>,
    hints: Vec<String>,
}

impl Problem {
    /// A problem at `at`: `message` says what was seen and what was expected.
    pub fn new(at: Span, message: impl Into<String>) -> Self {
        Self { message: message.into(), at, label: String::new(), related: Vec::new(), hints: Vec::new() }
    }

    /// Adds a few words beside the caret.
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// Adds a remedy.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }

    /// Adds a remedy, if there is one.
    pub fn maybe_hint(mut self, hint: Option<String>) -> Self {
        self.hints.extend(hint);
        self
    }

    /// Adds a related place.
    pub fn related(mut self, at: Span, label: impl Into<String>) -> Self {
        self.related.push((at, label.into()));
        self
    }

    /// Adds a related place, if there is one.
    pub fn maybe_related(self, at: Option<Span>, label: &str) -> Self {
        match at {
            Some(at) if at != self.at => self.related(at, label),
            _ => self,
        }
    }
}

/// The problems so far. The same message at the same place counts once, however many stage instances have it.
#[derive(Clone, Debug, Default)]
pub(crate) struct ProblemList {
    found: Vec<Problem>,
    seen: HashSet<(Span, String)>,
    more: usize,
    reports: usize,
}

impl ProblemList {
    /// Reports a problem. The closure is called only if the problem will be listed: finding the nearest name takes time.
    pub fn add(&mut self, problem: impl FnOnce() -> Problem) {
        self.reports += 1;
        if self.found.len() >= LIMIT {
            self.more += 1;
            return;
        }
        let problem = problem();
        if self.seen.insert((problem.at, problem.message.clone())) {
            self.found.push(problem);
        }
    }

    /// The number of reports, including repetitions.
    pub fn reports(&self) -> usize {
        self.reports
    }

    /// True where further problems would not be listed.
    pub fn is_full(&self) -> bool {
        self.found.len() >= LIMIT
    }

    /// True where there is no problem so far.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// The diagnostics, in the order of the file, then of the arguments.
    pub fn into_diagnostics(mut self, sources: &Sources) -> Diagnostics {
        self.found.sort_by_key(|problem| problem.at);
        let found = self.found.into_iter().map(|problem| {
            let first = (problem.at, problem.label);
            let places = std::iter::once(first).chain(problem.related);
            Diagnostic {
                message: plain(&problem.message),
                places: places.map(|(at, label)| Place::new(sources.get(at), at, plain(&label))).collect(),
                hints: problem.hints.iter().map(|hint| plain(hint)).collect(),
            }
        });
        Diagnostics::new(found.collect(), self.more)
    }
}
