//! The lines of a plan: instances of a stage share one where the same happens to them for the same reasons.

use crate::cli::change::{Change, Changed, grouped};
use crate::cli::names::Names;
use crate::plan::{Plan, Verdict};
use crate::resolve::StageIndex;

/// The number of groups that are listed after "depends on".
const MAX_CAUSES: usize = 4;
/// The verdict of stages that are only counted.
const CACHED: &str = "cached";

/// One line of the table.
pub(super) struct Row<'n> {
    pub stages: Vec<StageIndex>,
    pub verdict: &'static str,
    stage: &'n str,
    /// The stages that it depends on and that will run.
    causes: Vec<StageIndex>,
    /// What differs in the stage itself.
    own: Change,
    names: &'n Names<'n>,
}

impl Changed for Row<'_> {
    fn change(&mut self) -> &mut Change {
        &mut self.own
    }

    fn fits(&self, other: &Self) -> bool {
        (self.stage, self.verdict) == (other.stage, other.verdict)
            && self.names.same_stages(&self.causes, &other.causes)
    }

    fn take(&mut self, other: Self) {
        self.stages.extend(other.stages);
        if self.causes != other.causes {
            self.causes.extend(other.causes);
            self.causes.sort_unstable();
            self.causes.dedup();
        }
    }
}

impl Row<'_> {
    /// Why, for the last column.
    pub fn why(&self) -> String {
        let own = self.own.text();
        match (self.causes.is_empty(), own.is_empty()) {
            (true, _) => own,
            (false, true) => self.names.groups(&self.causes, MAX_CAUSES),
            (false, false) => format!("{}; {own}", self.names.groups(&self.causes, MAX_CAUSES)),
        }
    }
}

/// The rows, one per instance if `all` is set, and else without cached ones.
pub(super) fn rows<'n>(plan: &Plan<'n>, names: &'n Names<'n>, all: bool) -> Vec<Row<'n>> {
    let rows = plan.steps.iter().filter_map(|(index, verdict)| {
        let stage = &plan.graph.stages.node_weight(*index)?.name;
        let (verdict, causes, why) = match verdict {
            Verdict::Cached { .. } => (CACHED, Vec::new(), &[][..]),
            Verdict::Run { why, .. } => ("run", Vec::new(), &why[..]),
            Verdict::DependsOn { stages, why } => ("depends on", stages.to_vec(), &why[..]),
        };
        Some(Row { stages: vec![*index], verdict, stage, causes, own: Change::new(why), names })
    });
    if all { rows.collect() } else { grouped(rows.filter(|row| row.verdict != CACHED)) }
}
