//! The axes of a stage's matrix with their values, and which of them are zipped.

use super::axes::Axis;
use super::context::ResolveContext;
use super::globals;
use super::scope::Filler;
use crate::spec::model::{MatrixAxis, Stage};
use crate::spec::problem::Problem;
use crate::spec::suggest;

/// The axes of a matrix.
#[derive(Debug)]
pub(super) struct Matrix {
    /// Those in the file.
    pub axes: Vec<Axis>,
    /// Groups of axis numbers: the axes of a `zip` together, every other axis alone. In order.
    pub groups: Vec<Vec<usize>>,
    /// The axes that a sweep adds.
    pub swept: Vec<Axis>,
}

/// The axes of a stage; `None` where one of them is broken, which was reported.
pub(super) fn axes(stage: &Stage, context: &ResolveContext<'_>, filler: &mut Filler<'_>) -> Option<Matrix> {
    let written = &stage.matrix;
    let swept = context.layers.sweeps(&stage.name.text);
    // All of them, so that all problems are found.
    let mut found: Vec<Option<Axis>> =
        written.iter().chain(swept).map(|axis| matrix_axis(axis, stage, context, filler)).collect();
    let swept: Option<Vec<Axis>> = found.split_off(written.len()).into_iter().collect();
    let axes: Vec<Axis> = found.into_iter().collect::<Option<_>>()?;
    let swept = swept?;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (number, axis) in written.iter().enumerate() {
        match groups.last_mut().filter(|group| axis.group.is_some() && written[group[0]].group == axis.group)
        {
            Some(group) => group.push(number),
            None => groups.push(vec![number]),
        }
    }
    let mut fine = true;
    for group in &groups {
        let length = |number: usize| axes[number].values().len();
        let Some(&other) = group.iter().find(|number| length(**number) != length(group[0])) else { continue };
        fine = false;
        let (first, other_axis) = (&written[group[0]], &written[other]);
        filler.problems.add(|| {
            let message = format!(
                "the zipped axes `{}` and `{}` of stage `{}` have {} and {} values",
                first.name.text,
                other_axis.name.text,
                stage.name.text,
                length(group[0]),
                length(other)
            );
            Problem::new(other_axis.name.span, message)
                .maybe_related(Some(first.name.span), "the other")
                .hint(format!("their values are {} and {}", axes[group[0]].list(), axes[other].list()))
                .hint("`zip` combines the first values, then the second values, and so on")
        });
    }
    fine.then_some(Matrix { axes, groups, swept })
}

fn matrix_axis(
    axis: &MatrixAxis,
    stage: &Stage,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<Axis> {
    let shared = context.axes.0.get(&axis.name.text);
    match (&axis.values, shared) {
        (Some(values), shared) => {
            let below = match shared {
                Some(shared) => Some(shared.clone()?),
                None => None,
            };
            let scope = context.scope(Vec::new(), "the values of an axis");
            globals::axis(&axis.name, below, &[values], &scope, filler)
        }
        (None, Some(shared)) => shared.clone(),
        (None, None) => {
            filler.problems.add(|| {
                let name = crate::spec::node::shorten(&axis.name.text);
                Problem::new(
                    axis.name.span,
                    format!("the matrix of stage `{}` names the unknown axis `{name}`", stage.name.text),
                )
                .hint(suggest::hint(&axis.name.text, "the axes", context.axes.names()))
                .hint(format!("for values of this stage only, write `matrix: {{ {name}: [1, 2] }}`"))
            });
            None
        }
    }
}
