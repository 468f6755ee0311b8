//! The instances of a stage, in order: the product of the axes in its matrix (axes of a `zip` together), without the combinations
//! that `exclude` matches, plus those of `include`; of these, those for which `when` is true.

use std::collections::{BTreeSet, HashMap, HashSet};

use super::axes::{Axis, AxisValue};
use super::context::{MAX_INSTANCES, ResolveContext};
use super::matrix::{self, Matrix};
use super::rules::{maps, one_or_more, value_hint};
use super::scope::Filler;
use super::when;
use crate::spec::model::Stage;
use crate::spec::names;
use crate::spec::node::{Key, Node};
use crate::spec::problem::Problem;
use crate::spec::source::Span;
use crate::spec::suggest;

/// The instances of a stage, numbered.
#[derive(Debug)]
pub(super) struct Grid {
    axes: Vec<Axis>,
    cells: Cells,
}

#[derive(Debug)]
enum Cells {
    /// All combinations, with their number; the last axis varies fastest.
    All(usize),
    /// These: the positions on each axis, and the index of each combination.
    Listed { list: Vec<Cell>, index: HashMap<Cell, usize> },
}

/// A position on each axis.
type Cell = Box<[u32]>;

impl Grid {
    fn all(axes: Vec<Axis>) -> Self {
        let count = axes.iter().fold(1, |count: usize, axis| count.saturating_mul(axis.values().len()));
        Self { axes, cells: Cells::All(count) }
    }

    fn listed(axes: Vec<Axis>, list: Vec<Cell>) -> Self {
        let index = list.iter().cloned().zip(0..).collect();
        Self { axes, cells: Cells::Listed { list, index } }
    }

    /// Those of its instances.
    fn keep(self, instances: &[usize]) -> Self {
        let Cells::Listed { list, .. } = self.cells else { return self };
        Self::listed(self.axes, instances.iter().map(|number| list[*number].clone()).collect())
    }

    /// The axes, in the order of the matrix.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// How many instances there are.
    pub fn len(&self) -> usize {
        match &self.cells {
            Cells::All(count) => *count,
            Cells::Listed { list, .. } => list.len(),
        }
    }

    /// Axis and value of an instance, in the order of the matrix.
    pub fn coordinates(&self, instance: usize) -> Vec<(&str, &AxisValue)> {
        let positions = self.positions(instance);
        self.axes.iter().zip(positions).map(|(axis, at)| (&*axis.name, &axis.values()[at])).collect()
    }

    fn positions(&self, mut instance: usize) -> Vec<usize> {
        match &self.cells {
            Cells::All(_) => {
                let mut positions = vec![0; self.axes.len()];
                for (position, axis) in positions.iter_mut().zip(&self.axes).rev() {
                    *position = instance % axis.values().len();
                    instance /= axis.values().len();
                }
                positions
            }
            Cells::Listed { list, .. } => list[instance].iter().map(|at| *at as usize).collect(),
        }
    }

    /// The instances whose position on each axis is allowed, in order.
    pub fn select(&self, allowed: &[Vec<usize>]) -> Vec<usize> {
        match &self.cells {
            Cells::All(_) => self.axes.iter().zip(allowed).fold(vec![0], |before, (axis, positions)| {
                let next = |before: usize| positions.iter().map(move |at| before * axis.values().len() + at);
                before.into_iter().flat_map(next).collect()
            }),
            Cells::Listed { list, index } => {
                let asked =
                    allowed.iter().fold(1, |count: usize, positions| count.saturating_mul(positions.len()));
                if asked < list.len() {
                    let cells = product(allowed.iter().map(|positions| singles(positions.iter().copied())));
                    let mut found: Vec<usize> =
                        cells.iter().filter_map(|cell| index.get(cell.as_slice()).copied()).collect();
                    found.sort_unstable();
                    return found;
                }
                let fits = |cell: &Cell| {
                    cell.iter().zip(allowed).all(|(at, positions)| positions.contains(&(*at as usize)))
                };
                (0..list.len()).filter(|number| fits(&list[*number])).collect()
            }
        }
    }
}

fn singles(positions: impl Iterator<Item = usize>) -> Vec<Vec<u32>> {
    positions.map(|at| vec![narrow(at)]).collect()
}

/// Positions are below [`MAX_INSTANCES`].
fn narrow(position: usize) -> u32 {
    u32::try_from(position).unwrap_or(u32::MAX)
}

/// Every combination of one part from each list; the last list varies fastest.
fn product(parts: impl Iterator<Item = Vec<Vec<u32>>>) -> Vec<Vec<u32>> {
    parts.fold(vec![Vec::new()], |before, part| {
        let with =
            |start: &Vec<u32>| part.iter().map(|end| [start.as_slice(), end].concat()).collect::<Vec<_>>();
        before.iter().flat_map(with).collect()
    })
}

/// The instances of a stage; `None` where its matrix is invalid, which was reported.
pub(super) fn grid<'a>(
    stage: &'a Stage,
    context: &ResolveContext<'a>,
    filler: &mut Filler<'_>,
) -> Option<Grid> {
    let Matrix { mut axes, groups, swept } = matrix::axes(stage, context, filler)?;
    let rules = &stage.rules;
    let zipped = groups.iter().any(|group| group.len() > 1);
    if !zipped && rules.include.is_none() && rules.exclude.is_none() && rules.when.is_none() {
        axes.extend(swept);
        return Some(Grid::all(axes));
    }
    let lengths: Vec<usize> = groups.iter().map(|group| axes[group[0]].values().len()).collect();
    let swept_lengths: Vec<usize> = swept.iter().map(|axis| axis.values().len()).collect();
    fits(lengths.iter().chain(&swept_lengths), stage, filler)?;
    let parts = groups
        .iter()
        .zip(lengths)
        .map(|(group, length)| (0..length).map(|at| vec![narrow(at); group.len()]).collect());
    let mut cells: Vec<Cell> = product(parts).into_iter().map(Vec::into_boxed_slice).collect();
    // Axes of one group are adjacent in a cell, as in the matrix.
    if let Some(node) = &rules.exclude {
        exclude(node, stage, &axes, &mut cells, context, filler)?;
    }
    if let Some(node) = &rules.include {
        include(node, stage, &mut axes, &mut cells, context, filler)?;
    }
    if cells.is_empty() {
        filler.problems.add(|| {
            let at = rules.exclude.as_ref().map_or(stage.name.span, |node| node.span);
            Problem::new(at, format!("the matrix of stage `{}` has no combinations left", stage.name.text)).hint(
                "`exclude` removes all combinations; use `when` for a stage that is needed only sometimes",
            )
        });
        return None;
    }
    // The rules were written without the axes of a sweep, so those multiply what the rules leave.
    if !swept.is_empty() {
        fits([cells.len()].iter().chain(&swept_lengths), stage, filler)?;
        let ends = product(swept_lengths.into_iter().map(|length| singles(0..length)));
        let with =
            |cell: &Cell| ends.iter().map(|end| [cell, end.as_slice()].concat().into()).collect::<Vec<_>>();
        cells = cells.iter().flat_map(with).collect();
        axes.extend(swept);
    }
    let grid = Grid::listed(axes, cells);
    match &rules.when {
        Some(node) => {
            let instances = (0..grid.len()).map(|number| grid.coordinates(number));
            let kept = when::kept(node, stage, &grid.axes, instances, context, filler)?;
            Some(grid.keep(&kept))
        }
        None => Some(grid),
    }
}

/// Reports a matrix with axes of these lengths that has too many combinations.
fn fits<'l>(lengths: impl Iterator<Item = &'l usize>, stage: &Stage, filler: &mut Filler<'_>) -> Option<()> {
    if lengths.fold(1usize, |size, length| size.saturating_mul(*length)) <= MAX_INSTANCES {
        return Some(());
    }
    filler.problems.add(|| {
        let message =
            format!("the matrix of stage `{}` has more than {MAX_INSTANCES} combinations", stage.name.text);
        Problem::new(stage.name.span, message).hint("does it have too many axes?")
    });
    None
}

fn axis_of(key: &Key, what: &str, stage: &Stage, axes: &[Axis], filler: &mut Filler<'_>) -> Option<usize> {
    let found = axes.iter().position(|axis| axis.name == key.text);
    if found.is_none() {
        filler.problems.add(|| {
            let name = crate::spec::node::shorten(&key.text);
            Problem::new(
                key.span,
                format!("`{what}` names `{name}`, which is not an axis of stage `{}`", stage.name.text),
            )
            .hint(suggest::hint(&key.text, "its axes", axes.iter().map(|axis| &*axis.name)))
        });
    }
    found
}

fn exclude(
    node: &Node,
    stage: &Stage,
    axes: &[Axis],
    cells: &mut Vec<Cell>,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<()> {
    let node = filler.fill(node, &context.scope(Vec::new(), "`exclude`"))?;
    let mut fine = true;
    for entries in maps(&node, "exclude", filler)? {
        let mut rule: Vec<(usize, BTreeSet<u32>)> = Vec::new();
        for (key, node) in entries {
            let Some(axis) = axis_of(key, "exclude", stage, axes, filler) else {
                fine = false;
                continue;
            };
            let mut positions = BTreeSet::new();
            for value in one_or_more(node) {
                match position(&axes[axis], value, "exclude", filler) {
                    Some(found) => positions.extend(found.map(narrow)),
                    None => fine = false,
                }
            }
            rule.push((axis, positions));
        }
        if fine && !rule.is_empty() {
            cells.retain(|cell| !rule.iter().all(|(axis, positions)| positions.contains(&cell[*axis])));
        }
    }
    fine.then_some(())
}

/// The position of a value on an axis: inner `None` for one that a profile or `--set` removed.
fn position(axis: &Axis, value: &Node, what: &str, filler: &mut Filler<'_>) -> Option<Option<usize>> {
    let text = value.scalar_text().unwrap_or_default();
    let found = axis.position(&text);
    if found.is_some() || axis.is_gone(&text) {
        return Some(found);
    }
    filler.problems.add(|| {
        Problem::new(
            value.span,
            format!("`{what}`: axis `{}` has no value that is {}", axis.name, value.describe()),
        )
        .hint(value_hint(
            &text,
            "its values",
            &axis.values().iter().map(|value| &*value.label).collect::<Vec<_>>(),
        ))
    });
    None
}

fn include(
    node: &Node,
    stage: &Stage,
    axes: &mut [Axis],
    cells: &mut Vec<Cell>,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<()> {
    let node = filler.fill(node, &context.scope(Vec::new(), "`include`"))?;
    let mut fine = true;
    let mut known: HashSet<Cell> = cells.iter().cloned().collect();
    let mut included: HashSet<Cell> = HashSet::new();
    for entries in maps(&node, "include", filler)? {
        // Of each axis: whether it is named, and then its position, if its value was not removed.
        let mut cell: Vec<Option<Option<u32>>> = vec![None; axes.len()];
        for (key, value) in entries {
            let Some(axis) = axis_of(key, "include", stage, axes, filler) else {
                fine = false;
                continue;
            };
            let shared = context.axes.0.get(&axes[axis].name).and_then(Option::as_ref);
            match added(&mut axes[axis], shared, value, filler) {
                Some(position) => cell[axis] = Some(position.map(narrow)),
                None => fine = false,
            }
        }
        let at = entries.first().map_or(node.span, |(key, _)| key.span);
        let Some(cell) = cell.into_iter().collect::<Option<Vec<Option<u32>>>>() else {
            if fine {
                filler.problems.add(|| incomplete(at, stage, axes));
            }
            fine = false;
            continue;
        };
        let Some(cell) = cell.into_iter().collect::<Option<Vec<u32>>>() else { continue };
        let cell = cell.into_boxed_slice();
        if !included.insert(cell.clone()) {
            fine = false;
            filler.problems.add(|| {
                let message = format!("`include` of stage `{}` has this combination twice", stage.name.text);
                Problem::new(at, message).hint("remove one of the two")
            });
        } else if known.insert(cell.clone()) {
            // What the product has too is no mistake: under another profile it may lack it.
            cells.push(cell);
        }
    }
    fine.then_some(())
}

fn incomplete(at: Span, stage: &Stage, axes: &[Axis]) -> Problem {
    let names: Vec<&str> = axes.iter().map(|axis| &*axis.name).collect();
    let message = format!("a combination in `include` is missing an axis of stage `{}`", stage.name.text);
    Problem::new(at, message).hint(format!("give a value for each of {}", suggest::list(&names)))
}

/// The position of a value in `include`: inner `None` for one that a profile or `--set` removed. One that the stage's own axis
/// lacks is added to it: a new one, or one of the axis `shared` of that name, which the stage's own list leaves out.
fn added(
    axis: &mut Axis,
    shared: Option<&Axis>,
    value: &Node,
    filler: &mut Filler<'_>,
) -> Option<Option<usize>> {
    let Some(label) = value.scalar_text() else {
        filler.problems.add(|| {
            Problem::new(
                value.span,
                format!("found {} in `include`, expected one value of the axis", value.describe()),
            )
        });
        return None;
    };
    if let Some(at) = axis.position(&label) {
        return Some(Some(at));
    }
    if shared.is_some_and(|shared| shared.is_gone(&label)) {
        return Some(None);
    }
    if axis.has_fields() {
        let known = shared.and_then(|shared| Some(shared.values()[shared.position(&label)?].clone()));
        return match known {
            Some(known) => Some(Some(axis.push(known))),
            None => position(axis, value, "include", filler),
        };
    }
    if !names::is_label(&label) {
        return position(axis, value, "include", filler);
    }
    Some(Some(axis.push(AxisValue { label, span: value.span, value: value.clone(), fields: None })))
}
