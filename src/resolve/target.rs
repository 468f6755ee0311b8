//! Which stages of a graph a command is about: `table22`, `table*`, `evaluate[policy=beta, seed=1|2]`.

use std::collections::BTreeSet;

use petgraph::Direction;
use petgraph::graph::DiGraph;
use petgraph::visit::EdgeRef;

use super::graph::{From, Graph, StageIndex, StageInstance};
use crate::spec::suggest;

/// What was asked for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Stages to bring up to date, with all that they need; without any, all stages.
    pub targets: Vec<String>,
    /// Stages with all that depends on them; of the targets, those that do.
    pub from: Vec<String>,
    /// Stages to run again although they are cached.
    pub force: Vec<String>,
    /// True: nothing but these stages; what they need must be there.
    pub only: bool,
}

/// A part of a graph.
#[derive(Clone, Debug)]
pub struct Selected {
    /// The stages that were asked for and, since their keys come from there, all that they need.
    pub graph: Graph,
    /// All stages, and the place of each in `graph`; `None` where nothing was left out.
    pub whole: Option<(Graph, Vec<Option<StageIndex>>)>,
    /// Stages of `graph` that are to run although they are cached.
    pub forced: BTreeSet<StageIndex>,
    /// Stages of `graph` that must be cached, since only others were asked for.
    pub settled: BTreeSet<StageIndex>,
}

impl Selected {
    /// All stages.
    pub fn all(&self) -> &Graph {
        self.whole.as_ref().map_or(&self.graph, |(graph, _)| graph)
    }

    /// The place in `graph` of a stage of [`Selected::all`]; `None` where it is no part of it.
    pub fn place(&self, stage: StageIndex) -> Option<StageIndex> {
        match &self.whole {
            Some((_, places)) => places.get(stage.index()).copied().flatten(),
            None => Some(stage),
        }
    }
}

/// A pattern that means no stage.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct NoStage {
    /// What was seen and what was expected.
    pub message: String,
    /// How to mend it.
    pub hint: String,
}

impl Selection {
    /// True where nothing is left out and nothing forced.
    pub fn is_all(&self) -> bool {
        *self == Self::default()
    }

    /// The part of `graph` that is meant.
    ///
    /// # Errors
    /// A pattern means no stage, or nothing is left.
    pub fn of(&self, graph: Graph) -> Result<Selected, NoStage> {
        let count = graph.stages.node_count();
        let mut goals = vec![self.targets.is_empty(); count];
        mark(&graph, &self.targets, &mut goals)?;
        if !self.from.is_empty() {
            let mut behind = vec![false; count];
            mark(&graph, &self.from, &mut behind)?;
            spread(&graph, &mut behind, Direction::Outgoing);
            goals.iter_mut().zip(behind).for_each(|(goal, behind)| *goal &= behind);
        }
        if !goals.contains(&true) {
            return Err(NoStage {
                message: "none of the stages that were asked for depends on those after `--from`".to_owned(),
                hint: "leave one of the two out".to_owned(),
            });
        }
        let mut kept = goals.clone();
        spread(&graph, &mut kept, Direction::Incoming);
        let mut forced = vec![false; count];
        mark(&graph, &self.force, &mut forced)?;
        let (part, places) = if kept.contains(&false) {
            let (part, places) = restrict(&graph, &kept);
            (Some(part), places)
        } else {
            (None, graph.stages.node_indices().map(Some).collect())
        };
        let set = |marks: &dyn Fn(usize) -> bool| {
            let marked = (0..count).filter(|stage| marks(*stage));
            marked.filter_map(|stage| places[stage]).collect::<BTreeSet<_>>()
        };
        let forced = set(&|stage| forced[stage]);
        let settled = set(&|stage| self.only && !goals[stage]);
        if forced.is_empty() && !self.force.is_empty() {
            return Err(NoStage {
                message: "the stages after `--force` are none of those that were asked for".to_owned(),
                hint: "name them as targets too, or leave the targets out".to_owned(),
            });
        }
        Ok(match part {
            Some(part) => Selected { graph: part, whole: Some((graph, places)), forced, settled },
            None => Selected { graph, whole: None, forced, settled },
        })
    }
}

/// Marks the stages that the patterns mean.
fn mark(graph: &Graph, patterns: &[String], marks: &mut [bool]) -> Result<(), NoStage> {
    for text in patterns {
        let pattern = Pattern::parse(text)?;
        let mut found = false;
        for (mark, stage) in marks.iter_mut().zip(graph.stages.node_weights()) {
            if pattern.fits(stage) {
                *mark = true;
                found = true;
            }
        }
        if !found {
            return Err(pattern.explain(graph));
        }
    }
    Ok(())
}

/// Marks all that can be reached from what is marked.
fn spread(graph: &Graph, marks: &mut [bool], direction: Direction) {
    let mut open: Vec<StageIndex> =
        graph.stages.node_indices().filter(|stage| marks[stage.index()]).collect();
    while let Some(stage) = open.pop() {
        for next in graph.stages.neighbors_directed(stage, direction) {
            if !std::mem::replace(&mut marks[next.index()], true) {
                open.push(next);
            }
        }
    }
}

/// The graph of the stages that are marked, in their order. Whatever they read must be marked too.
fn restrict(graph: &Graph, kept: &[bool]) -> (Graph, Vec<Option<StageIndex>>) {
    let mut places = vec![None; kept.len()];
    let mut stages: DiGraph<StageInstance, (), u32> = DiGraph::new();
    for stage in graph.stages.node_indices().filter(|stage| kept[stage.index()]) {
        places[stage.index()] = Some(stages.add_node(graph.stages[stage].clone()));
    }
    for stage in stages.node_weights_mut() {
        for source in stage.inputs.iter_mut().flat_map(|wire| &mut wire.sources) {
            if let From::Stage { stage, .. } = &mut source.from
                && let Some(place) = places[stage.index()]
            {
                *stage = place;
            }
        }
    }
    for edge in graph.stages.edge_references() {
        if let (Some(from), Some(to)) = (places[edge.source().index()], places[edge.target().index()]) {
            stages.add_edge(from, to, ());
        }
    }
    (Graph { pipeline: graph.pipeline.clone(), profile: graph.profile.clone(), stages }, places)
}

/// `name[axis=value|value, axis=value]`, with `*` and `?` in names and values.
struct Pattern<'t> {
    text: &'t str,
    name: &'t str,
    axes: Vec<(&'t str, Vec<&'t str>)>,
}

impl<'t> Pattern<'t> {
    fn parse(text: &'t str) -> Result<Self, NoStage> {
        let bad = || NoStage {
            message: format!("`{}` names no stage", crate::spec::node::shorten(text)),
            hint: "stages are named as `table22`, `table*` or `evaluate[policy=beta, seed=1|2]`".to_owned(),
        };
        let (name, rest) = match text.split_once('[') {
            Some((name, rest)) => (name, Some(rest.trim_end().strip_suffix(']').ok_or_else(bad)?)),
            None => (text, None),
        };
        let mut axes = Vec::new();
        for part in rest.iter().flat_map(|rest| rest.split(',')) {
            let (axis, values) = part.split_once('=').ok_or_else(bad)?;
            axes.push((axis.trim(), values.split('|').map(str::trim).collect()));
        }
        let name = name.trim();
        if name.is_empty() || name.contains([']', '=']) { Err(bad()) } else { Ok(Self { text, name, axes }) }
    }

    fn fits(&self, stage: &StageInstance) -> bool {
        glob(self.name, &stage.name)
            && self.axes.iter().all(|(axis, values)| {
                let coordinate = stage.coordinates.iter().find(|(name, _)| name == axis);
                coordinate.is_some_and(|(_, value)| values.iter().any(|pattern| glob(pattern, value)))
            })
    }

    /// Why it fits nothing.
    fn explain(&self, graph: &Graph) -> NoStage {
        let stages = || graph.stages.node_weights();
        let distinct = |names: &mut dyn Iterator<Item = String>| names.collect::<BTreeSet<_>>();
        let shown = crate::spec::node::shorten(self.text);
        let named: Vec<&StageInstance> = stages().filter(|stage| glob(self.name, &stage.name)).collect();
        if named.is_empty() {
            let known = distinct(&mut stages().map(|stage| stage.name.to_string()));
            let hint = suggest::hint(self.name, "the stages", known.iter().map(String::as_str));
            return NoStage { message: format!("there is no stage `{shown}`"), hint };
        }
        for (axis, values) in &self.axes {
            let on_axis = named.iter().flat_map(|stage| &stage.coordinates).filter(|(name, _)| name == axis);
            let known = distinct(&mut on_axis.map(|(_, value)| value.clone()));
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            if known.is_empty() {
                let axes = distinct(
                    &mut named.iter().flat_map(|stage| &stage.coordinates).map(|(name, _)| name.clone()),
                );
                let hint = suggest::hint(axis, "its axes", axes.iter().map(String::as_str));
                return NoStage { message: format!("`{shown}`: the stage has no axis `{axis}`"), hint };
            }
            if !known.iter().any(|value| values.iter().any(|pattern| glob(pattern, value))) {
                let value = values.join("|");
                let hint = suggest::hint(&value, "its values", known.iter().copied());
                return NoStage { message: format!("`{shown}`: no instance has `{axis}={value}`"), hint };
            }
        }
        NoStage {
            message: format!("`{shown}`: no instance has all of these values"),
            hint: "leave one of them out; `dril-pipe plan --all` lists the instances".to_owned(),
        }
    }
}

/// True where `text` is what `pattern` says: `*` stands for any characters, `?` for one.
fn glob(pattern: &str, text: &str) -> bool {
    let (pattern, text): (Vec<char>, Vec<char>) = (pattern.chars().collect(), text.chars().collect());
    let (mut p, mut t) = (0, 0);
    // Where the last `*` stands, and how much of the text it has taken.
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, t));
                p += 1;
            }
            Some(c) if *c == '?' || *c == text[t] => (p, t) = (p + 1, t + 1),
            _ => match &mut star {
                Some((at, taken)) => {
                    *taken += 1;
                    (p, t) = (*at + 1, *taken);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_and_question_marks_stand_for_characters() {
        for (pattern, text, expected) in [
            ("table22", "table22", true),
            ("table*", "table22", true),
            ("*", "", true),
            ("*2", "table22", true),
            ("t*b*2", "table22", true),
            ("table?", "table22", false),
            ("table??", "table22", true),
            ("", "a", false),
            ("a*b", "a", false),
            ("*a*a*a*a*a*a*b", "aaaaaaaaaaaaaaaaaaaaaaaaaaaa", false),
        ] {
            assert_eq!(glob(pattern, text), expected, "{pattern} {text}");
        }
    }
}
