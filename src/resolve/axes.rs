//! The axes of matrices, with their values after profile and `--set`.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::merge::merge;
use crate::spec::names;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::{Problem, ProblemList};
use crate::spec::source::Span;
use crate::spec::suggest;

/// An axis and its values, in order; at least one.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    pub name: Arc<str>,
    values: Vec<AxisValue>,
    /// The place of each label in `values`: every instance looks some up.
    places: HashMap<Arc<str>, usize>,
    /// Values that a profile or `--set` removed, or the stage's own list.
    gone: HashSet<Arc<str>>,
    has_fields: bool,
}

/// A value on an axis.
#[derive(Clone, Debug)]
pub(super) struct AxisValue {
    /// Its name: the text of a scalar, the key of a value with fields.
    pub label: Arc<str>,
    /// Its place.
    pub span: Span,
    /// The value of `$axis`.
    pub value: Node,
    /// The map in which `$axis.field` is looked up.
    pub fields: Option<Node>,
}

impl AxisValue {
    /// Its text, or that of the field at the path; `None` where that is no scalar.
    pub fn text(&self, path: &[&str]) -> Option<Arc<str>> {
        let Some((first, rest)) = path.split_first() else { return Some(self.label.clone()) };
        let mut node = self.fields.as_ref()?.get(first)?.1;
        for name in rest {
            node = node.get(name)?.1;
        }
        node.scalar_text()
    }
}

/// All axes under `axes`; `None` for an invalid one, which was reported.
#[derive(Debug, Default)]
pub(super) struct Axes(pub HashMap<Arc<str>, Option<Axis>>);

impl Axes {
    /// The names, sorted.
    pub fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = self.0.keys().map(|name| &**name).collect();
        names.sort_unstable();
        names
    }
}

impl Axis {
    /// An axis of these values; of those with the same label, the first has the place.
    fn new(name: Arc<str>, values: Vec<AxisValue>, gone: HashSet<Arc<str>>) -> Self {
        let mut places = HashMap::with_capacity(values.len());
        for (place, value) in values.iter().enumerate() {
            places.entry(value.label.clone()).or_insert(place);
        }
        let has_fields = values.iter().any(|value| value.fields.is_some());
        Self { name, values, places, gone, has_fields }
    }

    /// The values, in order.
    pub fn values(&self) -> &[AxisValue] {
        &self.values
    }

    /// The place of a value in the axis.
    pub fn position(&self, label: &str) -> Option<usize> {
        self.places.get(label).copied()
    }

    /// True for a value that was removed.
    pub fn is_gone(&self, label: &str) -> bool {
        self.gone.contains(label)
    }

    /// Adds a value, which the axis does not have yet, and returns its place.
    pub fn push(&mut self, value: AxisValue) -> usize {
        let place = self.values.len();
        self.places.insert(value.label.clone(), place);
        self.values.push(value);
        place
    }

    /// "`gaussian`, `beta`".
    pub fn list(&self) -> String {
        suggest::list(&self.values.iter().map(|value| &*value.label).collect::<Vec<_>>())
    }

    /// True where some value has fields: then no value can be added without them.
    pub fn has_fields(&self) -> bool {
        self.has_fields
    }
}

/// `node` as the values of the axis, laid over those that it has already: a map is merged value by value, and a list
/// over values with fields chooses among them.
pub(super) fn lay(below: Option<Axis>, name: &Key, node: Node, problems: &mut ProblemList) -> Option<Axis> {
    let mut gone = below.as_ref().map(|below| below.gone.clone()).unwrap_or_default();
    gone.extend(below.iter().flat_map(|below| &below.values).map(|value| value.label.clone()));
    let values = match (node.value, below) {
        (Value::List(items), Some(below)) if below.has_fields() => choose(&below, name, items, problems)?,
        (Value::List(items), _) => scalars(name, items, problems)?,
        (Value::Map(entries), below) => {
            let below = below.filter(|below| below.has_fields() && !node.replace);
            with_fields(below, name, entries, problems)?
        }
        (value, _) => {
            let node = Node { value, ..Node::new(Value::Null, node.span) };
            problems.add(|| {
                Problem::new(node.span, format!("axis `{}` is {}, expected its values", name.text, node.describe()))
                    .hint("write a list `[1, 20]`, or a map of values with fields `{ clipped: { policy: gaussian } }`")
            });
            return None;
        }
    };
    if values.is_empty() {
        problems.add(|| {
            Problem::new(node.span, format!("axis `{}` has no values, expected at least one", name.text))
                .hint("a stage with that axis would have no instance")
        });
        return None;
    }
    let mut axis = Axis::new(name.text.clone(), values, gone);
    axis.gone.retain(|label| !axis.places.contains_key(label));
    distinct(&axis, problems).then_some(axis)
}

fn choose(below: &Axis, name: &Key, items: Vec<Node>, problems: &mut ProblemList) -> Option<Vec<AxisValue>> {
    let mut chosen = Some(Vec::new());
    for item in items {
        let text = item.scalar_text().unwrap_or_default();
        match below.position(&text) {
            Some(at) => chosen.iter_mut().for_each(|all| all.push(below.values[at].clone())),
            None => {
                problems.add(|| {
                    let known = below.values.iter().map(|value| &*value.label);
                    Problem::new(item.span, format!("axis `{}` has no value that is {}", name.text, item.describe()))
                        .hint(suggest::hint(&text, "its values", known))
                        .hint("a list over an axis whose values have fields selects among them; a map adds and changes values")
                });
                chosen = None;
            }
        }
    }
    chosen
}

fn scalars(name: &Key, items: Vec<Node>, problems: &mut ProblemList) -> Option<Vec<AxisValue>> {
    let values: Vec<_> = items.into_iter().map(|item| scalar(name, item, problems)).collect();
    values.into_iter().collect()
}

fn scalar(name: &Key, item: Node, problems: &mut ProblemList) -> Option<AxisValue> {
    let Some(label) = item.scalar_text() else {
        problems.add(|| {
            Problem::new(
                item.span,
                format!("found {} in axis `{}`, expected a text or a number", item.describe(), name.text),
            )
            .hint("values with fields are written as a map: `{ clipped: { policy: gaussian } }`")
        });
        return None;
    };
    usable(name, &label, item.span, problems)?;
    Some(AxisValue { label, span: item.span, value: item, fields: None })
}

fn with_fields(
    below: Option<Axis>,
    name: &Key,
    entries: Vec<(Key, Node)>,
    problems: &mut ProblemList,
) -> Option<Vec<AxisValue>> {
    let mut values = below.map(|below| below.values).unwrap_or_default();
    let places: HashMap<Arc<str>, usize> =
        values.iter().enumerate().map(|(place, value)| (value.label.clone(), place)).collect();
    let mut fine = true;
    for (label, fields) in entries {
        fine &= usable(name, &label.text, label.span, problems).is_some();
        let fields = match fields.value {
            Value::Map(_) => fields,
            Value::Null => Node { value: Value::Map(Vec::new()), ..fields },
            _ => {
                problems.add(|| {
                    let message = format!(
                        "the value `{}` of axis `{}` is {}, expected a map of its fields",
                        label.text,
                        name.text,
                        fields.describe()
                    );
                    Problem::new(fields.span, message)
                        .hint("values without fields are written as a list: `[gaussian, beta]`")
                });
                fine = false;
                continue;
            }
        };
        // The keys of one map differ, so only values from below can be there already.
        match places.get(&label.text).map(|place| &mut values[*place]) {
            Some(value) => {
                let below = value.fields.take();
                value.fields = Some(match below {
                    Some(below) => merge(below, fields),
                    None => fields,
                });
            }
            None => {
                let value = Node::new(Value::Text(label.text.clone()), label.span);
                values.push(AxisValue { label: label.text, span: label.span, value, fields: Some(fields) });
            }
        }
    }
    fine.then_some(values)
}

fn usable(name: &Key, label: &str, at: Span, problems: &mut ProblemList) -> Option<()> {
    if names::is_label(label) {
        return Some(());
    }
    problems.add(|| {
        let shown = crate::spec::node::shorten(label);
        Problem::new(at, format!("`{shown}` cannot be a value of axis `{}`", name.text))
            .hint(format!("it is used in `stage[{}=value]`: it must not contain `{}` or start or end with a space, and have at most 100 characters", name.text, names::NOT_IN_LABELS))
    });
    None
}

fn distinct(axis: &Axis, problems: &mut ProblemList) -> bool {
    let mut seen: HashMap<&str, Span> = HashMap::new();
    let mut fine = true;
    for value in &axis.values {
        if let Some(first) = seen.insert(&value.label, value.span) {
            fine = false;
            problems.add(|| {
                Problem::new(
                    value.span,
                    format!("the value `{}` is on axis `{}` twice", value.label, axis.name),
                )
                .related(first, "first")
                .hint("remove one of the two")
            });
        }
    }
    fine
}
