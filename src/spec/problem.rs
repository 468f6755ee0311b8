//! Collecting what is wrong while reading goes on, so that all of it is reported at once.

use std::collections::HashSet;

use super::diagnostic::{Diagnostic, Diagnostics, Place, plain};
use super::source::{Sources, Span};

/// After so many the rest is counted only: nobody reads on, and a hostile file must not keep us busy.
const LIMIT: usize = 100;

/// Something wrong, as spans; becomes a [`Diagnostic`] once the sources are at hand.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    message: String,
    at: Span,
    label: String,
    related: Vec<(Span, String)>,
    hints: Vec<String>,
}

impl Problem {
    /// `message` says what was seen and what was expected at `at`.
    pub fn new(at: Span, message: impl Into<String>) -> Self {
        Self { message: message.into(), at, label: String::new(), related: Vec::new(), hints: Vec::new() }
    }

    /// A few words under the caret.
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// How to mend it.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }

    /// How to mend it, where that is known.
    pub fn maybe_hint(mut self, hint: Option<String>) -> Self {
        self.hints.extend(hint);
        self
    }

    /// Another place that belongs to it.
    pub fn related(mut self, at: Span, label: impl Into<String>) -> Self {
        self.related.push((at, label.into()));
        self
    }

    /// Another place that belongs to it, where there is one.
    pub fn maybe_related(self, at: Option<Span>, label: &str) -> Self {
        match at {
            Some(at) if at != self.at => self.related(at, label),
            _ => self,
        }
    }
}

/// What was found so far. The same words about the same place count once, however many stage instances share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Problems {
    found: Vec<Problem>,
    seen: HashSet<(Span, String)>,
    more: usize,
    reports: usize,
}

impl Problems {
    /// Reports a problem. The closure is called only while there is room: finding a misspelt name's nearest relative
    /// takes time.
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

    /// How often something was reported, repetitions included.
    pub fn reports(&self) -> usize {
        self.reports
    }

    /// True where what is still to be found would not be listed.
    pub fn is_full(&self) -> bool {
        self.found.len() >= LIMIT
    }

    /// True where nothing is wrong so far.
    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// For people: in the order of the file, then of the arguments.
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
