//! The instances of a stage, in order: the product of the axes in its matrix (axes of a `zip` together), without the combinations
//! that `exclude` matches, plus those of `include`; of these, those for which `when` is true.

use std::collections::{BTreeSet, HashMap};

use super::axes::{Axis, AxisValue};
use super::context::{MAX_INSTANCES, ResolveContext};
use super::matrix;
use super::scope::{Filler, Scope};
use super::template::{self, Path};
use crate::spec::model::Stage;
use crate::spec::names;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
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
        let count = axes.iter().fold(1, |count: usize, axis| count.saturating_mul(axis.values.len()));
        Self { axes, cells: Cells::All(count) }
    }

    fn listed(axes: Vec<Axis>, list: Vec<Cell>) -> Self {
        let index = list.iter().cloned().zip(0..).collect();
        Self { axes, cells: Cells::Listed { list, index } }
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
        self.axes.iter().zip(positions).map(|(axis, at)| (&*axis.name, &axis.values[at])).collect()
    }

    fn positions(&self, mut instance: usize) -> Vec<usize> {
        match &self.cells {
            Cells::All(_) => {
                let mut positions = vec![0; self.axes.len()];
                for (position, axis) in positions.iter_mut().zip(&self.axes).rev() {
                    *position = instance % axis.values.len();
                    instance /= axis.values.len();
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
                let next = |before: usize| positions.iter().map(move |at| before * axis.values.len() + at);
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
    let matrix = matrix::axes(stage, context, filler)?;
    let rules = &stage.rules;
    let zipped = matrix.groups.iter().any(|group| group.len() > 1);
    if !zipped && rules.include.is_none() && rules.exclude.is_none() && rules.when.is_none() {
        return Some(Grid::all(matrix.axes));
    }
    let size = matrix.groups.iter().fold(1usize, |size, group| {
        size.saturating_mul(group.first().map_or(1, |axis| matrix.axes[*axis].values.len()))
    });
    if size > MAX_INSTANCES {
        filler.problems.add(|| {
            let message = format!(
                "the matrix of stage `{}` has more than {MAX_INSTANCES} combinations",
                stage.name.text
            );
            Problem::new(stage.name.span, message).hint("does it have too many axes?")
        });
        return None;
    }
    let mut axes = matrix.axes;
    let lengths: Vec<usize> = matrix.groups.iter().map(|group| axes[group[0]].values.len()).collect();
    let parts = matrix
        .groups
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
    let grid = Grid::listed(axes, cells);
    match &rules.when {
        Some(node) => when(node, stage, grid, context, filler),
        None => Some(grid),
    }
}

/// The maps of a rule: one, or a list of them.
fn maps<'n>(node: &'n Node, what: &str, filler: &mut Filler<'_>) -> Option<Vec<&'n [(Key, Node)]>> {
    let items =
        if let Value::List(items) = &node.value { items.as_slice() } else { std::slice::from_ref(node) };
    let mut maps = Vec::new();
    for item in items {
        let Value::Map(entries) = &item.value else {
            filler.problems.add(|| {
                Problem::new(
                    item.span,
                    format!("found {} in `{what}`, expected a map of axes and values", item.describe()),
                )
                .hint(format!("as in `{what}: [{{ expert: clipped, seed: [1, 2] }}]`"))
            });
            return None;
        };
        maps.push(entries.as_slice());
    }
    Some(maps)
}

/// A value, or each of a list.
fn one_or_more(node: &Node) -> &[Node] {
    if let Value::List(items) = &node.value { items } else { std::slice::from_ref(node) }
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
    if found.is_some() || axis.gone.contains(&text) {
        return Some(found);
    }
    filler.problems.add(|| {
        Problem::new(
            value.span,
            format!("`{what}`: axis `{}` has no value that is {}", axis.name, value.describe()),
        )
        .hint(suggest::hint(&text, "its values", axis.values.iter().map(|value| &*value.label)))
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
    for entries in maps(&node, "include", filler)? {
        let mut cell: Vec<Option<u32>> = vec![None; axes.len()];
        for (key, value) in entries {
            let Some(axis) = axis_of(key, "include", stage, axes, filler) else {
                fine = false;
                continue;
            };
            cell[axis] = added(&mut axes[axis], value, filler).map(narrow);
            fine &= cell[axis].is_some();
        }
        let at = entries.first().map_or(node.span, |(key, _)| key.span);
        let Some(cell) = cell.into_iter().collect::<Option<Vec<u32>>>() else {
            if fine {
                filler.problems.add(|| {
                    let names: Vec<&str> = axes.iter().map(|axis| &*axis.name).collect();
                    Problem::new(
                        at,
                        format!(
                            "a combination in `include` is missing an axis of stage `{}`",
                            stage.name.text
                        ),
                    )
                    .hint(format!("give a value for each of {}", suggest::list(&names)))
                });
            }
            fine = false;
            continue;
        };
        let cell = cell.into_boxed_slice();
        if cells.contains(&cell) {
            fine = false;
            filler.problems.add(|| {
                Problem::new(
                    at,
                    format!("stage `{}` has this combination of `include` already", stage.name.text),
                )
                .hint("remove it")
            });
        } else {
            cells.push(cell);
        }
    }
    fine.then_some(())
}

/// The position of a value in `include`; a new one is added to the stage's own axis.
fn added(axis: &mut Axis, value: &Node, filler: &mut Filler<'_>) -> Option<usize> {
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
        return Some(at);
    }
    if axis.values.iter().any(|value| value.fields.is_some()) || !names::is_label(&label) {
        return position(axis, value, "include", filler).flatten();
    }
    axis.values.push(AxisValue { label, span: value.span, value: value.clone(), fields: None });
    Some(axis.values.len() - 1)
}

/// The instances for which one of the maps matches; there may be none.
fn when(
    node: &Node,
    stage: &Stage,
    grid: Grid,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<Grid> {
    let place = format!("stage `{}`", stage.name.text);
    let maps = maps(node, "when", filler)?;
    let mut kept = Vec::new();
    for number in 0..grid.len() {
        let scope = Scope {
            globals: context.globals,
            axes: grid.coordinates(number),
            all_axes: context.axis_places,
            place: &place,
        };
        let mut holds = false;
        for entries in &maps {
            let mut all = true;
            for (key, expected) in *entries {
                all &= condition(key, expected, &scope, filler)?;
            }
            holds |= all;
        }
        if holds {
            kept.push(number);
        }
    }
    let Cells::Listed { list, .. } = grid.cells else { return Some(grid) };
    let kept = kept.into_iter().map(|number| list[number].clone()).collect();
    Some(Grid::listed(grid.axes, kept))
}

fn condition(key: &Key, expected: &Node, scope: &Scope<'_>, filler: &mut Filler<'_>) -> Option<bool> {
    let name = key.text.strip_prefix('$').unwrap_or(&key.text);
    if !template::is_path(name) {
        filler.problems.add(|| {
            let shown = crate::spec::node::shorten(&key.text);
            Problem::new(
                key.span,
                format!("`when` asks for `{shown}`, expected the name of an axis or a param"),
            )
            .hint("as in `when: { expert: clipped, profile: [desk, thesis] }`")
        });
        return None;
    }
    let value = filler.value(&Path { text: name, range: 0..key.text.len() }, key.span, scope)?;
    let Some(seen) = value.scalar_text() else {
        filler.problems.add(|| {
            Problem::new(
                key.span,
                format!(
                    "`when`: `{name}` is {}, expected a text, a number, `true` or `false`",
                    value.describe()
                ),
            )
        });
        return None;
    };
    let expected = filler.fill(expected, scope)?;
    let (wanted, negated) = match expected.get("not") {
        Some((_, node)) => (node, true),
        None => (&expected, false),
    };
    let texts: Option<Vec<_>> = one_or_more(wanted).iter().map(Node::scalar_text).collect();
    let Some(texts) = texts else {
        filler.problems.add(|| {
            Problem::new(expected.span, format!("`when`: `{name}` is compared with {}", expected.describe()))
                .hint(format!("write `{name}: value`, `{name}: [one, other]` or `{name}: {{ not: value }}`"))
        });
        return None;
    };
    Some(texts.iter().any(|text| **text == *seen) != negated)
}
