//! What the command line chooses: the profile, and the `--set` arguments.

use std::collections::HashMap;
use std::sync::Arc;

use super::Choices;
use crate::spec::Spec;
use crate::spec::layer::{self, Known};
use crate::spec::model::{Defaults, Layer};
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::{Problem, Problems};
use crate::spec::source::{Source, Sources, Span};
use crate::spec::suggest;
use crate::spec::yaml;

/// The profile of a file that has none.
const DEFAULT: &str = "default";

/// The file, the profile over it, and each `--set` over that.
pub(super) struct Layers<'a> {
    pub profile: Arc<str>,
    base: &'a Layer,
    chosen: Option<&'a Layer>,
    set: Vec<Layer>,
}

impl<'a> Layers<'a> {
    /// Reads the choices; wrong ones are reported.
    pub fn read(spec: &'a Spec, choices: &Choices, sources: &mut Sources, problems: &mut Problems) -> Self {
        let (profile, chosen) = profile(spec, choices.profile.as_deref(), sources, problems);
        let known = Known::new(&spec.base, &spec.stages);
        let mut set = Vec::new();
        for argument in &choices.set {
            let source = sources.add(Source::argument("--set", argument));
            if let Some(node) = assignment(argument, source, problems) {
                set.push(layer::overrides(node, &known, "`--set`", problems));
            }
        }
        Self { profile, base: &spec.base, chosen, set }
    }

    /// From the lowest to the highest.
    fn all(&self) -> impl Iterator<Item = &Layer> {
        [self.base].into_iter().chain(self.chosen).chain(&self.set)
    }

    /// Every value of the pipeline's seed, the one that holds last.
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
    problems: &mut Problems,
) -> (Arc<str>, Option<&'a Layer>) {
    let Some(wanted) = wanted else {
        return match spec.profiles.first() {
            Some(first) => (first.name.text.clone(), Some(&first.layer)),
            None => (DEFAULT.into(), None),
        };
    };
    if let Some(found) = spec.profiles.iter().find(|profile| &*profile.name.text == wanted) {
        return (found.name.text.clone(), Some(&found.layer));
    }
    if !(spec.profiles.is_empty() && wanted == DEFAULT) {
        let source = sources.add(Source::argument("--profile", wanted));
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
    (wanted.into(), None)
}

/// `a.b=value` as the map `{ a: { b: value } }`.
fn assignment(argument: &str, source: u16, problems: &mut Problems) -> Option<Node> {
    let Some((path, value)) = argument.split_once('=') else {
        problems.add(|| {
            Problem::new(Span::new(source, 0..argument.len()), "found no `=`, expected `name.field=value`")
                .hint("as in `--set dril.total_steps=100000` or `--set seed=3`")
        });
        return None;
    };
    let keys = keys(path, source, problems)?;
    let begin = path.len() + 1;
    let mut node = yaml::read(value, source, begin, problems).or_else(|| {
        // Nothing after the `=` is no YAML document; whatever else gives none has been reported.
        let nothing = Node::new(Value::Null, Span::new(source, begin..argument.len()));
        value.trim().is_empty().then_some(nothing)
    })?;
    for key in keys.into_iter().rev() {
        let span = key.span;
        node = Node::new(Value::Map(vec![(key, node)]), span);
    }
    Some(node)
}

fn keys(path: &str, source: u16, problems: &mut Problems) -> Option<Vec<Key>> {
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
                .hint("as in `--set dril.total_steps=100000`, without spaces before the `=`")
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
