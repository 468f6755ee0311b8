//! What has changed in instances of a stage. It differs from instance to instance in values and in the names of upstream
//! instances, and is still the same change: instances with the same one share a line.

use std::collections::HashMap;

use super::why;
use crate::plan::Reason;

/// More changes of one stage that differ only in their values share a line.
const MAX_ALIKE: usize = 4;

/// The reasons for which something is stale.
#[derive(Clone, Debug)]
pub(super) struct Change {
    /// The text of one instance, or of all with the same change.
    text: String,
    /// As `text`, with upstream stages instead of their instances.
    shared: String,
    /// Without values.
    shape: String,
    /// How many others differ only in their values.
    others: usize,
}

/// Something that has a change, as one or more instances of a stage.
pub(super) trait Changed: Sized {
    /// Its change.
    fn change(&mut self) -> &mut Change;
    /// True where `other` may be on the same line as far as anything but the change is concerned.
    fn fits(&self, other: &Self) -> bool;
    /// Adds the instances of `other`.
    fn take(&mut self, other: Self);
}

impl Change {
    /// The change that has these reasons.
    pub fn new(reasons: &[Reason]) -> Self {
        Self {
            text: why::text(reasons),
            shared: why::of_any_instance(reasons),
            shape: why::shape(reasons),
            others: 0,
        }
    }

    /// The text for people; empty where nothing has changed.
    pub fn text(&self) -> String {
        match self.others {
            0 => self.text.clone(),
            others => format!("{} (and {others} more such changes)", self.text),
        }
    }
}

/// Those with one change.
struct Alike<T> {
    shape: String,
    /// One for each text.
    lines: Vec<T>,
    places: HashMap<String, usize>,
}

/// Joins what has the same change, and where there are many, what has the same change but for values.
pub(super) fn grouped<T: Changed>(all: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut groups: Vec<Alike<T>> = Vec::new();
    for mut one in all {
        let Change { text, shared, shape, .. } = one.change().clone();
        let place = groups.iter().position(|group| group.shape == shape && group.lines[0].fits(&one));
        let Some(group) = place.and_then(|at| groups.get_mut(at)) else {
            groups.push(Alike { shape, lines: vec![one], places: [(shared, 0)].into() });
            continue;
        };
        match group.places.get(&shared).and_then(|at| group.lines.get_mut(*at)) {
            Some(line) => {
                if line.change().text != text {
                    line.change().text = shared;
                }
                line.take(one);
            }
            None => {
                group.places.insert(shared, group.lines.len());
                group.lines.push(one);
            }
        }
    }
    groups.into_iter().flat_map(|group| with_few_lines(group.lines)).collect()
}

fn with_few_lines<T: Changed>(mut lines: Vec<T>) -> Vec<T> {
    if lines.len() > MAX_ALIKE {
        let others = lines.split_off(1);
        lines[0].change().others = others.len();
        others.into_iter().for_each(|other| lines[0].take(other));
    }
    lines
}
