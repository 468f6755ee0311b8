//! Connects the inputs of stage instances to outputs and files, and checks types and numbers.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use dril_stage_api::{Arity, Artifact, Input, Labels, Outside};

use super::context::ResolveContext;
use super::expand::{Expanded, Instance};
use super::graph::{Origin, Source, StageIndex, Wire};
use super::items::{Item, Unpacker, What};
use super::labels;
use super::reference::{self, Reference};
use super::scope::{Filler, Scope};
use super::select::{self, Chosen, Consumer};
use super::template::Path;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::source::Span;
use crate::spec::suggest;

/// The maximum number of connections: each takes memory, and a fan-in of everything into everything needs a quadratic number.
const MAX_SOURCES: usize = 1_000_000;

/// The wires of one instance, each with the place of its reference.
pub(super) type Wires = Vec<(Wire, Span)>;

/// Connects instances.
pub(super) struct Wirer<'a, 'p, 'f> {
    context: &'a ResolveContext<'a>,
    stages: &'a [Expanded<'a>],
    by_name: HashMap<&'a str, usize>,
    /// Collects problems.
    pub filler: &'f mut Filler<'p>,
    sources: usize,
}

/// An input being connected.
struct Connection<'c> {
    consumer: Consumer<'c>,
    scope: &'c Scope<'c>,
    /// Where `inputs` says so.
    at: Span,
    found: Vec<Source>,
    /// True where a problem was reported: then a missing input is not reported again.
    broken: bool,
    /// A referenced stage whose matrix has no such instance.
    left_out: Option<String>,
}

impl<'a, 'p, 'f> Wirer<'a, 'p, 'f> {
    /// A wirer for these stages.
    pub fn new(
        context: &'a ResolveContext<'a>,
        stages: &'a [Expanded<'a>],
        filler: &'f mut Filler<'p>,
    ) -> Self {
        let by_name = stages.iter().enumerate().map(|(at, stage)| (stage.name(), at)).collect();
        Self { context, stages, by_name, filler, sources: 0 }
    }

    /// The wires of an instance, in the order of its ports.
    pub fn connect(&mut self, stage: &'a Expanded<'a>, number: usize, instance: &'a Instance) -> Wires {
        let coordinates = stage.coordinates(number);
        let place = format!("stage `{}`", stage.name());
        let scope = Scope {
            globals: self.context.globals,
            axes: coordinates.clone(),
            all_axes: self.context.axis_places,
            place: &place,
        };
        if let Some((outside, at)) = &instance.outside {
            return self.wire_from_outside(stage, instance, outside, *at);
        }
        let wired = self.by_port(stage, instance);
        let mut wires = Vec::new();
        let mut missing = Vec::new();
        for input in &instance.ports.inputs {
            let Some((key, node)) =
                wired.get(input.name).filter(|(_, node)| !matches!(node.value, Value::Null))
            else {
                if input.arity != Arity::Optional {
                    missing.push(input);
                }
                continue;
            };
            let consumer = Consumer { stage: stage.name(), input, coordinates: &coordinates };
            let at = if node.span.is_empty() { key.span } else { node.span };
            let mut connection =
                Connection { consumer, scope: &scope, at, found: Vec::new(), broken: false, left_out: None };
            self.fill_input(node, &mut connection);
            if let Some(wire) = self.wire(connection) {
                wires.push((wire, node.span));
            }
        }
        if !missing.is_empty() {
            self.missing(stage, &missing);
        }
        labels::check(stage, instance, &wires, self.stages, (&scope, self.context), self.filler);
        wires
    }

    /// The wire of a stage whose parameters name a file from outside, at `at`.
    fn wire_from_outside(
        &mut self,
        stage: &'a Expanded<'a>,
        instance: &'a Instance,
        outside: &'a Outside,
        at: Span,
    ) -> Wires {
        for (key, _) in &stage.inputs {
            self.filler.problems.add(|| {
                let name = crate::spec::node::shorten(&key.text);
                Problem::new(key.span, format!("stage `{}` has no input `{name}`", stage.name()))
                    .hint(format!("set the file with `with: {{ {}: ... }}`", outside.param))
            });
        }
        let Some(input) = instance.ports.inputs.first() else { return Wires::new() };
        let folder = input.artifact == Artifact::FOLDER;
        let from = Origin::File {
            path: outside.path.clone(),
            place: self.filler.sources.get(at).place(at),
            folder,
            blake3: outside.blake3.clone(),
            exclude: outside.exclude.clone(),
            key: file_key(&outside.path, folder, &outside.exclude),
        };
        let sources = vec![Source { from, labels: Labels::new() }];
        vec![(Wire { port: input.name, many: false, sources }, at)]
    }

    /// For an invalid instance: only checks that the stages that it references exist.
    pub fn look_over(&mut self, stage: &'a Expanded<'a>) {
        let mut open: Vec<&Node> = stage.inputs.iter().map(|(_, node)| *node).collect();
        while let Some(node) = open.pop() {
            match &node.value {
                Value::List(items) => open.extend(items),
                Value::Map(entries) => {
                    open.extend(entries.iter().filter(|(key, _)| &*key.text != "file").map(|(_, node)| node));
                }
                Value::Text(text) if !text.contains('$') => {
                    let item = Item { name: None, node: node.clone(), what: What::Stage(text.to_string()) };
                    if let Ok(reference) = reference::parse(text)
                        && !self.by_name.contains_key(reference.stage.text)
                    {
                        let problem = self.unknown_stage(&reference, text, &item);
                        self.filler.problems.add(|| problem);
                    }
                }
                _ => {}
            }
        }
    }

    /// The references by input; a misspelt input name is reported and treated as the nearest one.
    fn by_port(
        &mut self,
        stage: &Expanded<'a>,
        instance: &'a Instance,
    ) -> HashMap<&'a str, (&'a Key, &'a Node)> {
        let mut wired = HashMap::new();
        for (key, node) in &stage.inputs {
            if let Some(input) = instance.ports.find_input(&key.text) {
                wired.insert(input.name, (*key, *node));
                continue;
            }
            let known = || instance.ports.inputs.iter().map(|input| input.name);
            let kind = stage.kind.map_or("", |kind| kind.name());
            self.filler.problems.add(|| {
                let name = crate::spec::node::shorten(&key.text);
                Problem::new(key.span, format!("stage `{}` has no input `{name}`", stage.name()))
                    .label(format!("not an input of kind `{kind}`"))
                    .hint(suggest::hint(&key.text, "its inputs", known()))
                    .maybe_hint(instance.ports.hint.map(str::to_owned))
            });
            if let Some(meant) = suggest::nearest(&key.text, known()) {
                wired.entry(meant).or_insert((*key, *node));
            }
        }
        wired
    }

    fn missing(&mut self, stage: &Expanded<'_>, missing: &[&Input]) {
        let stages = self.stages;
        self.filler.problems.add(|| {
            let names: Vec<String> =
                missing.iter().map(|input| format!("`{}` (type `{}`)", input.name, input.artifact)).collect();
            let (word, it) = if missing.len() == 1 { ("input", "it is") } else { ("inputs", "they are") };
            let message = format!("stage `{}` is missing the {word} {}", stage.name(), names.join(" and "));
            let example = missing.iter().map(|input| match candidate(stages, stage, input) {
                Some(output) => format!("{}: {output}", input.name),
                None => format!("{}: ...", input.name),
            });
            let example = example.collect::<Vec<_>>().join(", ");
            Problem::new(stage.stage.name.span, message)
                .hint(format!("{it} connected with `inputs: {{ {example} }}`"))
        });
    }

    fn fill_input(&mut self, node: &Node, connection: &mut Connection<'_>) {
        let Connection { consumer, scope, at, .. } = *connection;
        let filler = &mut *self.filler;
        let mut unpacker =
            Unpacker { filler, scope, input: consumer.input, at, items: Vec::new(), broken: false };
        unpacker.unpack(node);
        let Unpacker { items, broken, .. } = unpacker;
        connection.broken = broken;
        for item in &items {
            match &item.what {
                What::File(path) => {
                    let place = self.filler.sources.get(item.node.span).place(item.node.span);
                    let labels = name_label(item, connection);
                    let from = Origin::File {
                        path: path.clone(),
                        place,
                        folder: false,
                        blake3: None,
                        exclude: Vec::new(),
                        key: file_key(path, false, &[]),
                    };
                    connection.found.push(Source { from, labels });
                }
                What::Stage(text) => self.stage(text, item, connection),
            }
        }
    }

    /// Adds the sources of a reference.
    fn stage(&mut self, text: &str, item: &Item, connection: &mut Connection<'_>) {
        let found = self.referenced(text, item, connection);
        match found {
            Ok(found) => connection.found.extend(found),
            Err(problems) => {
                connection.broken = true;
                for problem in problems {
                    let used = item.node.via;
                    self.filler.problems.add(|| problem.maybe_related(used, "used here"));
                }
            }
        }
    }

    /// An empty list of problems means that the problem was reported before.
    fn referenced(
        &mut self,
        text: &str,
        item: &Item,
        connection: &mut Connection<'_>,
    ) -> Result<Vec<Source>, Vec<Problem>> {
        let whole = item.node.span;
        let reference = reference::parse(text).map_err(|bad| {
            let at = self.filler.within(&item.node, text, bad.range);
            let shown = crate::spec::node::shorten(text);
            let problem = Problem::new(at, format!("invalid input reference `{shown}`: {}", bad.message));
            vec![problem.maybe_hint(file_hint(text)).hint(reference::FORM)]
        })?;
        let Some(&at) = self.by_name.get(reference.stage.text) else {
            return Err(vec![self.unknown_stage(&reference, text, item)]);
        };
        let producer = &self.stages[at];
        let chosen = self.chosen(&reference, text, item, connection).ok_or_else(Vec::new)?;
        if producer.grid.is_none() {
            return Err(Vec::new());
        }
        self.spread(producer, &chosen, connection)?;
        let numbers = select::instances(producer, &chosen, &connection.consumer, whole)?;
        if numbers.is_empty() {
            connection.left_out.get_or_insert_with(|| producer.name().to_owned());
        }
        self.sources += numbers.len();
        if self.sources > MAX_SOURCES {
            let message = format!("the stages have more than {MAX_SOURCES} connections");
            return Err(vec![
                Problem::new(whole, message).hint("select fewer instances, as in `stage[axis=value]`"),
            ]);
        }
        let output_at = reference
            .output
            .as_ref()
            .map_or(whole, |output| self.filler.within(&item.node, text, output.range.clone()));
        let named = item.name.as_deref();
        let mut sources = Vec::with_capacity(numbers.len());
        for number in numbers {
            let instance = producer.instances.get(number).and_then(Option::as_ref).ok_or_else(Vec::new)?;
            let output = select::output(instance, producer, &reference, &connection.consumer, output_at)
                .map_err(|problem| vec![problem])?;
            let stage = StageIndex::new(producer.first + number);
            let labels = match connection.consumer.input.arity {
                Arity::Many => select::labels(producer, number, named),
                Arity::One | Arity::Optional => Labels::new(),
            };
            sources.push(Source { from: Origin::Stage { stage, output: output.name }, labels });
        }
        Ok(sources)
    }

    /// A stage that reads one artifact of a swept stage is swept, too: resolving starts again with that.
    fn spread(
        &mut self,
        producer: &Expanded<'_>,
        chosen: &[Chosen<'_>],
        connection: &Connection<'_>,
    ) -> Result<(), Vec<Problem>> {
        let consumer = &connection.consumer;
        let open = producer.axes().iter().filter(|axis| {
            self.context.layers.is_sweep(&axis.name)
                && consumer.input.arity != Arity::Many
                && chosen.iter().all(|selector| selector.axis.text != &*axis.name)
                && consumer.coordinates.iter().all(|(name, _)| *name != &*axis.name)
        });
        let open: Vec<(Arc<str>, Arc<str>)> =
            open.map(|axis| (consumer.stage.into(), axis.name.clone())).collect();
        if open.is_empty() {
            return Ok(());
        }
        self.filler.spread.extend(open);
        Err(Vec::new())
    }

    fn unknown_stage(&self, reference: &Reference<'_>, text: &str, item: &Item) -> Problem {
        let at = self.filler.within(&item.node, text, reference.stage.range.clone());
        let name = crate::spec::node::shorten(reference.stage.text);
        let problem = Problem::new(at, format!("there is no stage `{name}`"));
        let known = self.stages.iter().map(Expanded::name);
        let problem = problem.hint(suggest::hint(reference.stage.text, "the stages", known));
        problem.maybe_hint(file_hint(text))
    }

    /// The selectors, with the values of their `$name`s.
    fn chosen<'t>(
        &mut self,
        reference: &Reference<'t>,
        text: &str,
        item: &Item,
        connection: &Connection<'_>,
    ) -> Option<Vec<Chosen<'t>>> {
        let mut all = Vec::new();
        for selector in &reference.selectors {
            let axis_at = self.filler.within(&item.node, text, selector.axis.range.clone());
            let mut chosen = Chosen::all(selector, axis_at);
            if selector.values[0].text != "*" {
                let mut labels = Vec::new();
                for value in &selector.values {
                    let at = self.filler.within(&item.node, text, value.range.clone());
                    match value.text.strip_prefix('$') {
                        Some(name) => {
                            let path = Path { text: name, range: value.range.clone() };
                            labels.extend(self.looked_up(&path, at, connection)?);
                        }
                        None => labels.push((value.text.to_owned(), at)),
                    }
                }
                chosen.labels = Some(labels);
            }
            all.push(chosen);
        }
        Some(all)
    }

    /// The labels that `$path` refers to: one, or those of a list.
    fn looked_up(
        &mut self,
        path: &Path<'_>,
        at: Span,
        connection: &Connection<'_>,
    ) -> Option<Vec<(String, Span)>> {
        let node = self.filler.value(path, at, connection.scope)?;
        let items =
            if let Value::List(items) = &node.value { items.as_slice() } else { std::slice::from_ref(&node) };
        let labels: Option<Vec<(String, Span)>> =
            items.iter().map(|item| Some((item.scalar_text()?.to_string(), at))).collect();
        if labels.is_none() {
            self.filler.problems.add(|| {
                Problem::new(
                    at,
                    format!(
                        "`${}` is {}, expected a value of the axis or a list of values",
                        path.text,
                        node.describe()
                    ),
                )
                .maybe_related(Some(node.span), "its value")
            });
        }
        labels
    }

    fn wire(&mut self, connection: Connection<'_>) -> Option<Wire> {
        let Connection { consumer, at, found, broken, left_out, .. } = connection;
        let input = consumer.input;
        let many = input.arity == Arity::Many;
        if broken {
            return None;
        }
        if found.is_empty()
            && let Some(stage) = left_out
        {
            // An optional input is absent if the stage that makes it has no such instance.
            if input.arity != Arity::Optional {
                self.filler.problems.add(|| {
                    let message = format!(
                        "input `{}` of stage `{}` refers to instances that the matrix of stage `{stage}` excludes",
                        input.name, consumer.stage
                    );
                    Problem::new(at, message)
                        .hint("see its `when`, `exclude` or `zip`; exclude the same instances here with `when` or `exclude`")
                });
            }
            return None;
        }
        if !many && found.len() != 1 {
            self.filler.problems.add(|| {
                let message = format!(
                    "input `{}` of stage `{}` takes one artifact, but is connected to {}",
                    input.name,
                    consumer.stage,
                    found.len()
                );
                Problem::new(at, message).hint("select one instance, as in `stage[axis=value]`")
            });
            return None;
        }
        let mut seen = HashSet::new();
        let twice = found.iter().any(|source| !seen.insert((source.from.identity(), &source.labels)));
        if twice {
            self.filler.problems.add(|| {
                let message = format!(
                    "input `{}` of stage `{}` is connected to the same artifact twice",
                    input.name, consumer.stage
                );
                Problem::new(at, message)
                    .hint("remove one of the two, or give them names: `{ first: a, second: b }`")
            });
            return None;
        }
        Some(Wire { port: input.name, many, sources: found })
    }
}

/// A hint for a text that looks like a path.
fn file_hint(text: &str) -> Option<String> {
    let looks = text.contains(['/', '\\'])
        || [".csv", ".json", ".yaml", ".txt"].iter().any(|end| text.ends_with(end));
    looks.then(|| {
        format!("a file from outside is written as `{{ file: {} }}`", crate::spec::node::shorten(text))
    })
}

/// Identifies a file or folder from outside; no path contains a zero byte. A file and a folder at one path differ, so that each is
/// checked for what it is.
fn file_key(path: &str, folder: bool, exclude: &[String]) -> String {
    let mark = folder.then_some("/");
    let parts = std::iter::once(path).chain(mark).chain(exclude.iter().map(String::as_str));
    parts.collect::<Vec<_>>().join("\0")
}

fn name_label(item: &Item, connection: &Connection<'_>) -> Labels {
    let many = connection.consumer.input.arity == Arity::Many;
    let name = item.name.as_ref().filter(|_| many);
    name.map(|name| ("name".to_owned(), name.to_string())).into_iter().collect()
}

/// An output of exactly the type of an input, for an example in a hint.
fn candidate(stages: &[Expanded<'_>], consumer: &Expanded<'_>, input: &Input) -> Option<String> {
    let others = stages.iter().filter(|stage| stage.name() != consumer.name());
    others.filter_map(|stage| Some((stage, stage.instances.first()?.as_ref()?))).find_map(
        |(stage, instance)| {
            let output = instance.ports.outputs.iter().find(|output| output.artifact == input.artifact)?;
            Some(format!("{}.{}", stage.name(), output.name))
        },
    )
}
