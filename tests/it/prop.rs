//! Random pipelines against a simple model of what an engine must do.

use std::collections::{BTreeMap, BTreeSet};

use dril_pipe::exec::Event;
use dril_pipe::plan::Verdict;
use proptest::prelude::*;
use serde_json::json;

use crate::lab::{Lab, Ran};
use crate::scenario::{self, StageLine};

/// A stage of the model: which earlier stages it reads, its own letter, and how many letters it keeps of each.
#[derive(Clone, Debug)]
struct Node {
    feeders: BTreeSet<usize>,
    letter: u8,
    keep: usize,
    cost: u32,
}

/// Up to twelve stages in random shapes; any number of them may be sources.
fn any_nodes() -> impl Strategy<Value = Vec<Node>> {
    let node = (proptest::collection::vec(any::<prop::sample::Index>(), 0..4), 0_u8..4, 0_usize..4, 1_u32..9);
    proptest::collection::vec(node, 1..12).prop_map(|drawn| {
        let node =
            |(at, (feeders, letter, keep, cost)): (usize, (Vec<prop::sample::Index>, u8, usize, u32))| {
                let feeders = if at == 0 {
                    BTreeSet::new()
                } else {
                    feeders.iter().map(|index| index.index(at)).collect()
                };
                Node { feeders, letter, keep, cost }
            };
        drawn.into_iter().enumerate().map(node).collect()
    })
}

fn name(at: usize) -> String {
    format!("s{at}")
}

fn stages(nodes: &[Node]) -> Vec<StageLine> {
    let stage = |(at, node): (usize, &Node)| {
        let letter = char::from(b'a' + node.letter).to_string();
        if node.feeders.is_empty() {
            // Names differ, so no two sources are the same work.
            let text = format!("{letter}{at}");
            return StageLine::new(&name(at), "emit", json!({"text": text, "cost": node.cost}));
        }
        let feeders: Vec<String> = node.feeders.iter().map(|feeder| name(*feeder)).collect();
        let feeders: Vec<&str> = feeders.iter().map(String::as_str).collect();
        let with = json!({"separator": format!("{letter}{at}"), "keep": node.keep, "cost": node.cost});
        StageLine::new(&name(at), "concat", with).reads("parts", &feeders)
    };
    nodes.iter().enumerate().map(stage).collect()
}

/// The texts that the stages write, computed without an engine.
fn model(nodes: &[Node]) -> Vec<String> {
    let mut texts: Vec<String> = Vec::new();
    for (at, node) in nodes.iter().enumerate() {
        let letter = char::from(b'a' + node.letter);
        let parts: Vec<&str> = node
            .feeders
            .iter()
            .map(|feeder| &texts[*feeder][..node.keep.min(texts[*feeder].len())])
            .collect();
        texts.push(if parts.is_empty() {
            format!("{letter}{at}")
        } else {
            parts.join(&format!("{letter}{at}"))
        });
    }
    texts
}

/// What a stage's result depends on, by the model: its own parameters and the texts that it reads.
#[derive(PartialEq)]
struct Work {
    letter: u8,
    keep: Option<usize>,
    reads: Vec<(usize, String)>,
}

fn work(nodes: &[Node], texts: &[String]) -> Vec<Work> {
    let of = |node: &Node| Work {
        letter: node.letter,
        keep: (!node.feeders.is_empty()).then_some(node.keep),
        reads: node.feeders.iter().map(|feeder| (*feeder, texts[*feeder].clone())).collect(),
    };
    nodes.iter().map(of).collect()
}

fn texts(lab: &Lab, ran: &Ran, nodes: &[Node]) -> Vec<String> {
    let output = |node: &Node| if node.feeders.is_empty() { "text" } else { "joined" };
    nodes.iter().enumerate().map(|(at, node)| ran.text(lab, &name(at), output(node))).collect()
}

fn sorted(names: Vec<String>) -> BTreeSet<String> {
    names.into_iter().collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_stage_runs_once_after_its_inputs_and_gives_what_the_model_gives(
        nodes in any_nodes(), threads in 1_usize..4,
    ) {
        let lab = Lab::new();
        let stages = stages(&nodes);
        let runner = dril_pipe::exec::InlineRunner { registry: crate::fakes::registry() };
        let options = dril_pipe::exec::Options { threads, ..Default::default() };
        let ran = lab.run_with(&stages, &runner, &options, &Default::default());
        let started = ran.started();
        prop_assert_eq!(started.len(), nodes.len());
        let position: BTreeMap<&String, usize> = started.iter().zip(0..).collect();
        prop_assert_eq!(position.len(), nodes.len());
        for (at, node) in nodes.iter().enumerate() {
            for feeder in &node.feeders {
                prop_assert!(position[&name(*feeder)] < position[&name(at)]);
            }
        }
        prop_assert_eq!(texts(&lab, &ran, &nodes), model(&nodes));
        prop_assert_eq!(lab.run(&stages).counts(), [0, nodes.len(), 0, 0, 0]);
    }

    #[test]
    fn after_an_edit_exactly_the_stages_run_whose_work_is_new_and_the_plan_foresaw_them(
        nodes in any_nodes(), edited in any::<prop::sample::Index>(), letter in 0_u8..4, keep in 0_usize..4,
    ) {
        let lab = Lab::new();
        lab.run(&stages(&nodes));
        let mut after = nodes.clone();
        let edited = edited.index(nodes.len());
        after[edited].letter = letter;
        after[edited].keep = keep;
        let (texts_before, texts_after) = (model(&nodes), model(&after));
        let (before, now) = (work(&nodes, &texts_before), work(&after, &texts_after));
        let expected: BTreeSet<String> =
            (0..nodes.len()).filter(|at| before[*at] != now[*at]).map(name).collect();

        let stages = stages(&after);
        let graph = scenario::graph(&stages);
        let plan = lab.plan(&graph);
        let mut may_run = BTreeSet::new();
        for (stage, verdict) in &plan.steps {
            let name = graph.stages[*stage].name.to_string();
            match verdict {
                Verdict::Cached { .. } => prop_assert!(!expected.contains(&name)),
                Verdict::Run { .. } => prop_assert!(expected.contains(&name) && may_run.insert(name)),
                Verdict::DependsOn { .. } => drop(may_run.insert(name)),
            }
        }
        let ran = lab.run(&stages);
        prop_assert_eq!(sorted(ran.started()), expected.clone());
        prop_assert!(expected.is_subset(&may_run));
        prop_assert_eq!(texts(&lab, &ran, &after), texts_after);
        // Going back costs nothing.
        prop_assert_eq!(lab.run(&self::stages(&nodes)).counts(), [0, nodes.len(), 0, 0, 0]);
    }

    #[test]
    fn one_failure_skips_exactly_what_lies_behind_it(nodes in any_nodes(), bad in any::<prop::sample::Index>()) {
        let lab = Lab::new();
        let mut stages = stages(&nodes);
        let bad = bad.index(nodes.len());
        // Nothing is wired to a `count` that fails: it stands where the stage stood and feeds the same readers.
        stages[bad] = StageLine::new(&name(bad), "count", json!({"mishap": "fail", "to": 1}));
        let mut behind = BTreeSet::from([bad]);
        for (at, node) in nodes.iter().enumerate() {
            if at != bad && node.feeders.iter().any(|feeder| behind.contains(feeder)) {
                behind.insert(at);
            }
        }
        let ran = lab.run(&stages);
        let skipped = ran.names(|event| match event {
            Event::Skipped { stage, .. } => Some(*stage),
            _ => None,
        });
        behind.remove(&bad);
        prop_assert_eq!(sorted(skipped), behind.iter().map(|at| name(*at)).collect());
        prop_assert_eq!(ran.counts(), [nodes.len() - 1 - behind.len(), 0, 1, behind.len(), 0]);
    }
}
