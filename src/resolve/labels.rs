//! Lets kinds check the labels that their parameters name against those of the connected inputs.

use dril_stage_api::{FanIns, Incoming};

use super::context::ResolveContext;
use super::expand::{self, Expanded, Instance};
use super::graph::{Origin, Source, Wire};
use super::params;
use super::scope::{Filler, Scope};
use crate::spec::source::Span;

/// Reports the labels in the parameters of `instance`, which is one of `stage`, that its inputs do not have.
pub(super) fn check(
    stage: &Expanded<'_>,
    instance: &Instance,
    wires: &[(Wire, Span)],
    stages: &[Expanded<'_>],
    (scope, context): (&Scope<'_>, &ResolveContext<'_>),
    filler: &mut Filler<'_>,
) {
    let Some(kind) = stage.kind else { return };
    let many = wires.iter().filter(|(wire, _)| wire.many);
    let inputs: FanIns<'_> = many
        .map(|(wire, _)| (wire.port, wire.sources.iter().map(|source| incoming(source, stages)).collect()))
        .collect();
    if inputs.is_empty() {
        return;
    }
    let found = kind.check_labels(&instance.params, &inputs);
    if found.is_empty() {
        return;
    }
    // The parameters with their places were not kept: few are wrong.
    let Some(with) = expand::parameters(stage.stage, scope, context, filler) else { return };
    let whole = stage.stage.with.as_ref().map_or(stage.stage.name.span, |with| with.span);
    for problem in &found {
        filler.problems.add(|| params::explain(problem, &with, stage.name(), whole));
    }
}

fn incoming<'s>(source: &'s Source, stages: &'s [Expanded<'_>]) -> Incoming<'s> {
    let columns = match &source.from {
        Origin::File { .. } => None,
        Origin::Stage { stage, output } => {
            let at = stages.partition_point(|other| other.first <= stage.index()).checked_sub(1);
            let producer = at.map(|at| &stages[at]);
            let instance =
                producer.and_then(|producer| producer.instances.get(stage.index() - producer.first));
            // What an import brings in is not known, whatever type it is given.
            let instance = instance.and_then(Option::as_ref).filter(|instance| instance.outside.is_none());
            instance.and_then(|instance| instance.ports.find_output(output)?.columns.as_deref())
        }
    };
    Incoming { labels: &source.labels, columns }
}
