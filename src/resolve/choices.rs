//! The choices of the command line: the profile and `--set`. Several values in one `--set` are a sweep: an additional axis of the
//! stage and of every downstream stage that reads one artifact of it.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use super::{Choices, sweep};
use crate::spec::Spec;
use crate::spec::layer::{self, Known};
use crate::spec::model::{Defaults, Layer, MatrixAxis, Profile};
use crate::spec::names;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::{Problem, ProblemList};
use crate::spec::source::{SourceText, Sources, Span};
use crate::spec::suggest;
use crate::spec::yaml;

/// The profile of a file that has none.
pub(super) const DEFAULT: &str = "default";

/// The layers of values: the files, the profile, then each `--set`.
pub(super) struct Layers<'a> {
    pub profile: Arc<str>,
    files: &'a [Layer],
    chosen: &'a [Layer],
    set: Vec<Layer>,
    sweeps: Vec<Sweep>,
}

/// An axis that `--set` adds to the matrix of a stage.
struct Sweep {
    stage: Arc<str>,
    axis: MatrixAxis,
}

/// One `--set`.
struct Setting {
    keys: Vec<Key>,
    layer: Layer,
    /// The axis that its values become, where it has several for a field of a stage.
    sweep: Option<MatrixAxis>,
}

impl Setting {
    /// True for a sweep whose field a later `--set` gives another value: `value` for `keys`, or with `None`, several. Then its
    /// axis must go with its values, or instances would be named after values that they do not have.
    fn is_replaced(&self, keys: &[Key], value: Option<&Node>) -> bool {
        let differ = || keys.iter().zip(&self.keys).any(|(key, own)| key.text != own.text);
        if self.sweep.is_none() || differ() {
            return false;
        }
        let mut value = value;
        for key in self.keys.iter().skip(keys.len()) {
            // A map is merged, and replaces only the fields that it has.
            match value {
                Some(node) if matches!(node.value, Value::Map(_)) && !node.replace => {
                    match node.get(&key.text) {
                        Some((_, field)) => value = Some(field),
                        None => return false,
                    }
                }
                _ => return true,
            }
        }
        true
    }
}

/// Stages that need the axis of a sweep because of their inputs, by stage and axis.
pub(super) type Spread = BTreeSet<(Arc<str>, Arc<str>)>;

impl<'a> Layers<'a> {
    /// Parses the choices; invalid ones are reported.
    pub fn read(
        spec: &'a Spec,
        choices: &Choices,
        spread: &Spread,
        sources: &mut Sources,
        problems: &mut ProblemList,
    ) -> Self {
        let (profile, chosen) = profile(spec, choices.profile.as_deref(), sources, problems);
        let known = Known::new(&spec.base, &spec.stages);
        let mut settings: Vec<Setting> = Vec::new();
        for argument in &choices.set {
            let source = sources.add(SourceText::argument("--set", argument));
            let Some((keys, values)) = assignment(argument, source, problems) else { continue };
            let values = <[Node; 1]>::try_from(values);
            let single = values.as_ref().ok().map(|[value]| value);
            settings.retain(|earlier| !earlier.is_replaced(&keys, single));
            let found = match values {
                Ok([value]) => Some((as_axis(&keys, value), None)),
                Err(values) => several(spec, &keys, values, &settings, problems),
            };
            report_nothing(spec, &keys, found.as_ref().map(|(value, _)| value), problems);
            if let Some((value, sweep)) = found {
                let layer = layer::overrides(nested(keys.clone(), value), &known, "`--set`", problems);
                settings.push(Setting { keys, layer, sweep });
            }
        }
        let (mut set, mut sweeps): (Vec<Layer>, Vec<Sweep>) = (Vec::new(), Vec::new());
        for Setting { keys, layer, sweep } in settings {
            set.push(layer);
            let stage = keys.first().map(|key| key.text.clone());
            sweeps.extend(stage.zip(sweep).map(|(stage, axis)| Sweep { stage, axis }));
        }
        let wanted = spread.iter().filter_map(|(stage, axis)| {
            let sweep = sweeps.iter().find(|sweep| sweep.axis.name.text == *axis)?;
            Some(Sweep { stage: stage.clone(), axis: sweep.axis.clone() })
        });
        let wanted: Vec<Sweep> = wanted.collect();
        sweeps.extend(wanted);
        Self { profile, files: &spec.files, chosen, set, sweeps }
    }

    /// The layers of the files, and those of a profile.
    pub fn under(spec: &'a Spec, profile: Option<&'a Profile>) -> Self {
        let (profile, chosen) = profile.map_or((DEFAULT.into(), &[] as &[Layer]), |profile| {
            (profile.name.text.clone(), profile.layers.as_slice())
        });
        Self { profile, files: &spec.files, chosen, set: Vec::new(), sweeps: Vec::new() }
    }

    /// The axes that a stage has because of a sweep.
    pub fn sweeps(&self, stage: &str) -> impl Iterator<Item = &MatrixAxis> {
        self.sweeps.iter().filter(move |sweep| &*sweep.stage == stage).map(|sweep| &sweep.axis)
    }

    /// The axes of all sweeps.
    pub fn swept(&self) -> Vec<Arc<str>> {
        let names: BTreeSet<_> = self.sweeps.iter().map(|sweep| sweep.axis.name.text.clone()).collect();
        names.into_iter().collect()
    }

    /// True for the axis of a sweep.
    pub fn is_sweep(&self, axis: &str) -> bool {
        self.sweeps.iter().any(|sweep| &*sweep.axis.name.text == axis)
    }

    /// All layers, lowest first.
    fn all(&self) -> impl Iterator<Item = &Layer> {
        self.files.iter().chain(self.chosen).chain(&self.set)
    }

    /// Every value of the pipeline's seed, lowest first.
    pub fn seeds(&self) -> Vec<&Node> {
        self.all().filter_map(|layer| layer.seed.as_ref()).collect()
    }

    /// Every value of a param, lowest first.
    pub fn param(&self, name: &str) -> Vec<&Node> {
        self.all().filter_map(|layer| layer.params.get(name)).collect()
    }

    /// Every value of an axis, lowest first.
    pub fn axis(&self, name: &str) -> Vec<&Node> {
        self.all().filter_map(|layer| layer.axes.get(name)).collect()
    }

    /// What all stages of a kind share, by kind, lowest first.
    pub fn defaults(&self) -> HashMap<&str, Vec<&Defaults>> {
        let mut kinds: HashMap<&str, Vec<&Defaults>> = HashMap::new();
        for defaults in self.all().flat_map(|layer| &layer.defaults) {
            kinds.entry(&*defaults.kind.text).or_default().push(defaults);
        }
        kinds
    }

    /// What goes over a stage's `with`, lowest first.
    pub fn stage(&self, name: &str) -> Vec<&Node> {
        self.all().filter_map(|layer| layer.stages.get(name)).collect()
    }
}

fn profile<'a>(
    spec: &'a Spec,
    wanted: Option<&str>,
    sources: &mut Sources,
    problems: &mut ProblemList,
) -> (Arc<str>, &'a [Layer]) {
    let Some(wanted) = wanted else {
        return match spec.profiles.first() {
            Some(first) => (first.name.text.clone(), &first.layers),
            None => (DEFAULT.into(), &[]),
        };
    };
    if let Some(found) = spec.profiles.iter().find(|profile| &*profile.name.text == wanted) {
        return (found.name.text.clone(), &found.layers);
    }
    if !(spec.profiles.is_empty() && wanted == DEFAULT) {
        let source = sources.add(SourceText::argument("--profile", wanted));
        problems.add(|| {
            let at = Span::new(source, 0..wanted.len());
            let problem =
                Problem::new(at, format!("there is no profile `{}`", crate::spec::node::shorten(wanted)));
            if spec.profiles.is_empty() {
                return problem.hint("the file has no `profiles`; leave `--profile` out");
            }
            problem.hint(suggest::hint(wanted, "the profiles", spec.profiles()))
        });
    }
    (wanted.into(), &[])
}

/// Reports nothing for all of a stage, of `params` or the like: it would leave them as they are.
fn report_nothing(spec: &Spec, keys: &[Key], value: Option<&Node>, problems: &mut ProblemList) {
    let ([key], Some(Node { value: Value::Null, span, .. })) = (keys, value) else { return };
    let is_part = ["params", "axes", "defaults"].contains(&&*key.text);
    if is_part || spec.stages.iter().any(|stage| stage.name.text == key.text) {
        problems.add(|| {
            Problem::new(*span, format!("found nothing for `{}`, expected a map of values", key.text)).hint(
                format!(
                    "set one of its values, as in `--set {}.name=value`, or leave this `--set` out",
                    key.text
                ),
            )
        });
    }
}

/// The value under these names, as a map.
fn nested(keys: Vec<Key>, value: Node) -> Node {
    keys.into_iter().rev().fold(value, |node, key| {
        let span = key.span;
        Node::new(Value::Map(vec![(key, node)]), span)
    })
}

/// The node for several values: for an axis, their list; for a field of a stage, a reference to the axis that they become, with
/// that axis.
fn several(
    spec: &Spec,
    keys: &[Key],
    values: Vec<Node>,
    earlier: &[Setting],
    problems: &mut ProblemList,
) -> Option<(Node, Option<MatrixAxis>)> {
    let (first, last) = (keys.first()?, keys.last()?);
    let at = values.iter().map(|value| value.span).reduce(|a, b| Span { end: b.end, ..a })?;
    let list = Node::new(Value::List(values), at);
    if &*first.text == "axes" {
        return Some((list, None));
    }
    let is_stage = spec.stages.iter().any(|stage| stage.name.text == first.text);
    if !is_stage || keys.len() < 2 || !names::is_identifier(&last.text) {
        problems.add(|| {
            let path = keys.iter().map(|key| &*key.text).collect::<Vec<_>>().join(".");
            Problem::new(at, format!("found several values for `{path}`, expected one"))
                .hint(sweep::hint(spec, keys))
                .hint("write a text with commas in quotes, a list in brackets")
        });
        return None;
    }
    let taken = |name: &str| {
        names::RESERVED_VALUES.contains(&name)
            || earlier.iter().filter_map(|set| set.sweep.as_ref()).any(|axis| &*axis.name.text == name)
            || spec.base.params.get(name).is_some()
            || spec.base.axes.get(name).is_some()
            || spec.stages.iter().flat_map(|stage| &stage.matrix).any(|axis| &*axis.name.text == name)
    };
    // The field's own name, if it is free: it appears in the names of instances and in tables.
    let candidates = [last.text.to_string(), format!("{}-{}", first.text, last.text)];
    let numbered = (2..).map(|number| format!("{}-{}-{number}", first.text, last.text));
    let name: Arc<str> = candidates.into_iter().chain(numbered).find(|name| !taken(name))?.into();
    let key = Key { text: name.clone(), span: last.span };
    let axis = MatrixAxis { name: key, values: Some(list), group: None };
    Some((Node::new(Value::Text(format!("${name}").into()), at), Some(axis)))
}

/// A single value of an axis, as in `axes.seed=3`, as the list that it means.
fn as_axis(keys: &[Key], value: Node) -> Node {
    let is_scalar = matches!(value.value, Value::Text(_) | Value::Number(..));
    match keys {
        [axes, _] if &*axes.text == "axes" && is_scalar => {
            let span = value.span;
            Node::new(Value::List(vec![value]), span)
        }
        _ => value,
    }
}

/// The names and the values of `a.b=value` and `a.b=1,2,3`.
fn assignment(argument: &str, source: u16, problems: &mut ProblemList) -> Option<(Vec<Key>, Vec<Node>)> {
    let Some((path, value)) = argument.split_once('=') else {
        problems.add(|| {
            Problem::new(Span::new(source, 0..argument.len()), "found no `=`, expected `name.field=value`")
                .hint("as in `--set dril.total_timesteps=98304` or `--set seed=3`")
        });
        return None;
    };
    let keys = keys(path, source, problems)?;
    let mut begin = path.len() + 1;
    let mut nodes = Vec::new();
    let parts = parts(value);
    for part in &parts {
        nodes.push(read_value(part, parts.len() == 1, source, begin, problems)?);
        begin += part.len() + 1;
    }
    Some((keys, nodes))
}

/// Parses a value as YAML, but never drops a part of it: a plain text is taken whole, and where YAML would ignore something else,
/// that is reported. `is_only`: it is not part of a sweep, so blanks around a text belong to it.
fn read_value(
    part: &str,
    is_only: bool,
    source: u16,
    begin: usize,
    problems: &mut ProblemList,
) -> Option<Node> {
    let bare = part.trim();
    let span = Span::new(source, begin..begin + part.len());
    if bare.is_empty() {
        // Nothing after the `=` is no YAML document.
        return Some(Node::new(Value::Null, span));
    }
    let text = |text: &str| Some(Node::new(Value::Text(text.into()), span));
    let whole = if is_only { part } else { bare };
    let comment = comment(bare);
    if is_plain(bare) && (comment.is_some() || bare.contains(['\n', '\r'])) {
        return text(whole);
    }
    if let Some(at) = comment {
        let start = begin + (part.len() - part.trim_start().len()) + at;
        problems.add(|| {
            let at = Span::new(source, start..begin + part.len());
            Problem::new(at, "found a `#`: YAML would read the rest as a comment")
                .hint("put the whole value in quotes for the command line, and the text with the `#` in quotes for YAML: `--set 'a.b=\"fix #12\"'`")
        });
        return None;
    }
    let node = yaml::read(part, source, begin, problems)?;
    match &node.value {
        Value::Text(read) if is_plain(bare) && &**read != whole => text(whole),
        Value::Null if !matches!(bare, "~" | "null" | "Null" | "NULL") => {
            problems.add(|| {
                Problem::new(
                    span,
                    format!("found `{}`, which YAML reads as null", crate::spec::node::shorten(bare)),
                )
                .hint("write `null`, or put a text in quotes, as in `--set 'a.b=\"&x\"'`")
            });
            None
        }
        _ => Some(node),
    }
}

/// True for what is no list, map, quoted text or anything else that begins with a sign of YAML's.
fn is_plain(bare: &str) -> bool {
    let marked = bare.starts_with(|c: char| "[]{}\"'&*!|>%@`,".contains(c));
    let begins = |sign: &str| {
        bare.strip_prefix(sign).is_some_and(|rest| rest.is_empty() || rest.starts_with([' ', '\n', '\t']))
    };
    let is_map = bare.lines().any(|line| {
        let line = line.find(" #").map_or(line, |at| &line[..at]);
        line.contains(": ") || line.ends_with(':')
    });
    !marked && !begins("-") && !begins("?") && !begins("---") && !begins("...") && !is_map
}

/// Where a comment begins: at a `#` that opens the text or follows a blank, outside of quotes.
fn comment(text: &str) -> Option<usize> {
    let mut quote = None;
    // What can precede a quote that opens a text.
    let mut last = ',';
    let mut before = ' ';
    for (at, c) in text.char_indices() {
        match quote {
            // `\"` continues the text; so does the second of two `'`, which opens the text again at once.
            Some(open) if c == open && !(c == '"' && before == '\\') => {
                quote = None;
            }
            Some(_) => {}
            None if c == '#' && before.is_whitespace() => return Some(at),
            None if matches!(c, '"' | '\'') && (",[{:".contains(last) || before == '\'') => quote = Some(c),
            None => {}
        }
        if !c.is_whitespace() {
            last = c;
        }
        before = c;
    }
    None
}

/// The parts between commas, where the value is no list, map or quoted text.
fn parts(value: &str) -> Vec<&str> {
    let plain = value.trim_start().starts_with(|c: char| c.is_alphanumeric() || "-+.$_".contains(c));
    let parts: Vec<&str> = value.split(',').collect();
    let full =
        parts.iter().all(|part| !part.trim().is_empty()) && !value.contains(['[', '{', '"', '\'', '\n']);
    if plain && full { parts } else { vec![value] }
}

fn keys(path: &str, source: u16, problems: &mut ProblemList) -> Option<Vec<Key>> {
    let mut keys = Vec::new();
    let mut begin = 0;
    for name in path.split('.') {
        let span = Span::new(source, begin..begin + name.len());
        if name.trim().is_empty() || name.trim() != name {
            problems.add(|| {
                Problem::new(
                    span,
                    "found an empty or spaced name, expected names with `.` between them and then `=`",
                )
                .hint("as in `--set dril.total_timesteps=98304`, without spaces before the `=`")
            });
            return None;
        }
        keys.push(Key { text: name.into(), span });
        begin += name.len() + 1;
    }
    let limit = crate::spec::node::MAX_DEPTH / 2;
    if keys.len() > limit {
        problems.add(|| {
            Problem::new(
                Span::new(source, 0..path.len()),
                format!("the path has {} names, expected at most {limit}", keys.len()),
            )
        });
        return None;
    }
    Some(keys)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(argument: &str) -> String {
        let mut problems = ProblemList::default();
        let Some((_, values)) = assignment(argument, 0, &mut problems) else { return "refused".to_owned() };
        let shown = values.iter().map(|node| match &node.value {
            Value::Text(text) => format!("{text:?}"),
            Value::Number(_, text) => text.to_string(),
            Value::List(items) => format!("list of {}", items.len()),
            Value::Map(entries) => format!("map of {}", entries.len()),
            Value::Null => "nothing".to_owned(),
            other => format!("{other:?}"),
        });
        shown.collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn a_value_is_taken_whole_or_refused() {
        for (argument, expected) in [
            ("s=#12", "\"#12\""),
            ("s=fix #12", "\"fix #12\""),
            ("s=it's #1", "\"it's #1\""),
            ("s=5 #12", "\"5 #12\""),
            ("s=c#", "\"c#\""),
            ("s= two  blanks ", "\" two  blanks \""),
            ("s=two\nlines", "\"two\\nlines\""),
            ("s=\"fix #12\"", "\"fix #12\""),
            ("s='it''s #12'", "\"it's #12\""),
            ("s=[a, '#b']", "list of 2"),
            ("s={a: \"x #\"}", "map of 1"),
            ("s=", "nothing"),
            ("s=null", "nothing"),
            ("s=3.10", "3.10"),
            ("s=a, b", "\"a\" \"b\""),
            ("s=fix #1, 2", "\"fix #1\" 2"),
            // Refused, with the place.
            ("s=\"a\" #12", "refused"),
            ("s=[a, b] # c", "refused"),
            ("s={a: x #y", "refused"),
            ("s=&x", "refused"),
            ("s=a: b #c", "refused"),
        ] {
            assert_eq!(read(argument), expected, "{argument}");
        }
    }
}
