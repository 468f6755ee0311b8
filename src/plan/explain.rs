//! Explains why stages are stale, back to the first cause: what differs in the stage itself and, for every input that differs, in
//! the stage that makes it.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

use super::compare::differences;
use super::{OutsideFile, Plan, Reason, Verdict, lookup, order};
use crate::resolve::{Graph, Origin, StageIndex};
use crate::store::{Digest, Key, Outputs, Record, Store, StoreError};

/// Why stages are stale, or why they ran last time, with everything upstream: each stage once.
#[derive(Clone, Debug, Default)]
pub struct Explanations {
    /// First the requested stages, in that order; then those upstream.
    pub all: Vec<Explanation>,
    /// How many were requested.
    pub asked: usize,
}

/// Why a stage is stale, or why it ran last time.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The stage.
    pub stage: StageIndex,
    /// Its key, if it is known.
    pub key: Option<Key>,
    /// The record that it is compared with: for a finished stage, the one before; `None` where there is none.
    pub against: Option<Key>,
    /// What differs in the stage itself.
    pub reasons: Vec<Reason>,
    /// Upstream stages whose outputs differ or are not known yet.
    pub causes: Vec<Cause>,
}

/// An upstream stage whose output differs.
#[derive(Clone, Debug)]
pub struct Cause {
    /// The input that it feeds.
    pub port: String,
    /// Its index in [`Explanations::all`].
    pub at: usize,
}

/// Explains these stages of a plan. Time and memory are linear in stages and connections, however deep the graph is.
pub fn explain(plan: &Plan<'_>, store: &Store, stages: &[StageIndex]) -> Result<Explanations, StoreError> {
    let count = plan.graph.stages.node_count();
    let mut verdicts: Vec<Option<&Verdict>> = vec![None; count];
    let mut done: Vec<Option<Arc<Outputs>>> = vec![None; count];
    for (index, verdict) in &plan.steps {
        verdicts[index.index()] = Some(verdict);
        if let Verdict::Cached { outputs, .. } = verdict {
            done[index.index()] = Some(Arc::clone(outputs));
        }
    }
    let mut explainer = Explainer {
        plan,
        graph: plan.graph,
        files: &plan.files,
        store,
        verdicts,
        done,
        places: HashMap::new(),
        open: VecDeque::new(),
    };
    for &stage in stages {
        if !explainer.places.contains_key(&stage) {
            let against = explainer.before(stage)?;
            explainer.place(stage, against);
        }
    }
    let asked = explainer.places.len();
    let mut all = Vec::new();
    while let Some((stage, against)) = explainer.open.pop_front() {
        all.push(explainer.explain(stage, against)?);
    }
    Ok(Explanations { all, asked })
}

struct Explainer<'a> {
    plan: &'a Plan<'a>,
    graph: &'a Graph,
    files: &'a BTreeMap<String, OutsideFile>,
    store: &'a Store,
    verdicts: Vec<Option<&'a Verdict>>,
    done: Vec<Option<Arc<Outputs>>>,
    /// The index of each stage that is explained or queued.
    places: HashMap<StageIndex, usize>,
    /// Queued stages, with the record that each is compared with.
    open: VecDeque<(StageIndex, Option<(Key, Record)>)>,
}

impl Explainer<'_> {
    /// The default record for comparison: the nearest earlier one that is not the stage's own.
    fn before(&self, stage: StageIndex) -> Result<Option<(Key, Record)>, StoreError> {
        let own = self.key(stage);
        for key in self.plan.history.earlier(&self.graph.stages[stage].id) {
            if Some(*key) != own
                && let Some(record) = self.store.record(key)?
            {
                return Ok(Some((*key, record)));
            }
        }
        Ok(None)
    }

    fn key(&self, stage: StageIndex) -> Option<Key> {
        match self.verdicts[stage.index()] {
            Some(Verdict::Cached { key, .. } | Verdict::Run { key, .. }) => Some(*key),
            _ => None,
        }
    }

    /// The index of a stage. The first request decides which record it is compared with.
    fn place(&mut self, stage: StageIndex, against: Option<(Key, Record)>) -> usize {
        let next = self.places.len();
        match self.places.entry(stage) {
            Entry::Occupied(at) => *at.get(),
            Entry::Vacant(place) => {
                self.open.push_back((stage, against));
                *place.insert(next)
            }
        }
    }

    fn explain(
        &mut self,
        stage: StageIndex,
        against: Option<(Key, Record)>,
    ) -> Result<Explanation, StoreError> {
        let node = &self.graph.stages[stage];
        // A lost or damaged record is a reason that no comparison shows.
        let reasons = match self.verdicts[stage.index()] {
            Some(Verdict::Run { why, .. }) => why
                .iter()
                .filter(|why| matches!(why, Reason::Lost { .. } | Reason::Damaged { .. }))
                .cloned()
                .collect(),
            _ => Vec::new(),
        };
        let reasons = match &against {
            _ if !reasons.is_empty() => reasons,
            Some((_, then)) => differences(self.graph, node, then, &self.done, self.files),
            None => vec![Reason::New],
        };
        let causes = self.causes(stage, against.as_ref().map(|(_, record)| record), &reasons)?;
        let against = against.map(|(key, _)| key);
        Ok(Explanation { stage, key: self.key(stage), against, reasons, causes })
    }

    /// The stages that make the inputs that differ.
    fn causes(
        &mut self,
        stage: StageIndex,
        then: Option<&Record>,
        reasons: &[Reason],
    ) -> Result<Vec<Cause>, StoreError> {
        let mut causes = Vec::new();
        for wire in &self.graph.stages[stage].inputs {
            for source in &wire.sources {
                let Origin::Stage { stage: feeder, output } = source.from else { continue };
                let against = if self.done[feeder.index()].is_none() {
                    self.before(feeder)?
                } else {
                    let origin = lookup::origin(self.graph, source);
                    let Some(old) = changed(reasons, wire.port, &origin) else { continue };
                    match self.maker(feeder, output, old)? {
                        Some(record) => Some(record),
                        None => continue,
                    }
                };
                // A new stage needs no tree of new stages upstream.
                if then.is_none() && against.is_none() && self.done[feeder.index()].is_some() {
                    continue;
                }
                let at = self.place(feeder, against);
                causes.push(Cause { port: wire.port.to_owned(), at });
            }
        }
        Ok(causes)
    }

    /// The record with which a stage made that content.
    fn maker(
        &self,
        stage: StageIndex,
        output: &str,
        made: Digest,
    ) -> Result<Option<(Key, Record)>, StoreError> {
        let own = self.key(stage);
        for key in self.plan.history.earlier(&self.graph.stages[stage].id).filter(|key| Some(**key) != own) {
            let made_it = self.plan.history.outputs(key).and_then(|outputs| outputs.get(output));
            if made_it.is_some_and(|stored| stored.digest == made)
                && let Some(record) = self.store.record(key)?
            {
                return Ok(Some((*key, record)));
            }
        }
        Ok(None)
    }
}

/// The earlier content of an input, where a reason says that it differs.
fn changed(reasons: &[Reason], port: &str, origin: &str) -> Option<Digest> {
    reasons.iter().find_map(|reason| match reason {
        Reason::Input { port: at, from, old: Some(old), new: Some(_) } if at == port && from == origin => {
            Some(*old)
        }
        _ => None,
    })
}

impl Plan<'_> {
    /// `stage` and everything upstream, in topological order.
    pub fn roots_to(&self, stage: StageIndex) -> Vec<StageIndex> {
        let mut needed = vec![false; self.graph.stages.node_count()];
        let mut open = vec![stage];
        while let Some(stage) = open.pop() {
            if !std::mem::replace(&mut needed[stage.index()], true) {
                open.extend(order::feeding(self.graph, stage));
            }
        }
        self.steps.iter().map(|(index, _)| *index).filter(|index| needed[index.index()]).collect()
    }

    /// The position of a stage in topological order.
    pub fn position(&self, stage: StageIndex) -> usize {
        self.position.get(stage.index()).copied().unwrap_or(usize::MAX)
    }

    /// The verdict of a stage.
    pub fn verdict(&self, stage: StageIndex) -> Option<&Verdict> {
        let at = *self.position.get(stage.index())?;
        self.steps.get(at).map(|(_, verdict)| verdict)
    }
}
