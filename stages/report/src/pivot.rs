//! From a list of cells to a grid: keys run down or across, and keys with a single value appear above it.

use crate::caption::OURS;
use crate::markdown::{Column, escape};
use crate::reference::Row;
use crate::score::Score;
use crate::stats::Summary;

/// A value of the table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cell<'a> {
    /// The values of the table's keys, in their order.
    pub(crate) key: Vec<String>,
    /// What this run gave.
    pub(crate) summary: Summary,
    /// What was published.
    pub(crate) published: Option<&'a Row>,
    /// How many trainings it holds.
    pub(crate) trainings: usize,
    /// The standard error of the mean over the trainings; `None` for one.
    pub(crate) error: Option<f64>,
    /// How many of its evaluations are of an agent whose training diverged.
    pub(crate) diverged: usize,
}

impl Cell<'_> {
    fn published(&self, decimals: u8) -> Option<Score> {
        Score::published(self.published?, decimals)
    }
}

/// Sorts by the keys in turn, each in the order in which its values first appear.
pub(crate) fn sort_by_appearance<T>(items: &mut [T], key: impl Fn(&T) -> &[String]) {
    let keys: Vec<Vec<String>> = items.iter().map(|item| key(item).to_vec()).collect();
    let rank = |item: &T| -> Vec<usize> {
        let value_rank =
            |(at, value): (usize, &String)| keys.iter().position(|key| key.get(at) == Some(value));
        key(item).iter().enumerate().filter_map(value_rank).collect()
    };
    // A value's rank is the first row that has it: the same order as counting distinct values, without counting.
    items.sort_by_cached_key(rank);
}

/// How the values of a grid are printed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style<'a> {
    /// What stands before published values.
    pub(crate) source: &'a str,
    /// Decimals of what this run gave.
    pub(crate) decimals: u8,
}

/// The grid of a table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pivot {
    /// Keys of one value in the whole table, with that value.
    pub(crate) fixed: Vec<(String, String)>,
    /// The keys that run across.
    pub(crate) across: Vec<String>,
    /// The columns as they are to be printed.
    pub(crate) columns: Vec<Column>,
}

impl Pivot {
    /// The grid of `cells` (sorted, one for a key): the keys of `across` run across, in that order, the others down.
    pub(crate) fn new(keys: &[String], across: &[String], style: Style<'_>, cells: &[Cell<'_>]) -> Self {
        let position = |name: &String| keys.iter().position(|key| key == name);
        let constant = |at: &usize| cells.iter().all(|cell| cell.key.get(*at) == cells[0].key.get(*at));
        let (fixed, varying): (Vec<usize>, Vec<usize>) = (0..keys.len()).partition(constant);
        let across: Vec<usize> =
            across.iter().filter_map(position).filter(|at| varying.contains(at)).collect();
        let down: Vec<usize> = varying.into_iter().filter(|at| !across.contains(at)).collect();
        let grid = Grid {
            keys,
            rows: distinct(cells, &down),
            columns: distinct(cells, &across),
            down,
            across,
            style,
            cells,
        };
        Self {
            fixed: fixed.iter().map(|at| (keys[*at].clone(), cells[0].key[*at].clone())).collect(),
            across: grid.across.iter().map(|at| keys[*at].clone()).collect(),
            columns: grid.print(),
        }
    }

    /// What holds for the whole table, as lines to stand above it.
    pub(crate) fn lead(&self) -> Vec<String> {
        let pairs = self.fixed.iter().map(|(key, value)| format!("{}: {}", escape(key), escape(value)));
        let fixed = pairs.collect::<Vec<_>>().join(" · ");
        let across = self.across.iter().map(|key| escape(key)).collect::<Vec<_>>().join(" · ");
        let across = if across.is_empty() { across } else { format!("columns: {across}") };
        [fixed, across].into_iter().filter(|line| !line.is_empty()).collect()
    }
}

/// The cells, with the positions of the keys that run down and across, and the values that those take together.
struct Grid<'a> {
    keys: &'a [String],
    style: Style<'a>,
    cells: &'a [Cell<'a>],
    down: Vec<usize>,
    across: Vec<usize>,
    rows: Vec<Vec<String>>,
    columns: Vec<Vec<String>>,
}

impl Grid<'_> {
    fn cell(&self, row: &[String], column: &[String]) -> Option<&Cell<'_>> {
        self.cells.iter().find(|cell| take(cell, &self.down) == row && take(cell, &self.across) == column)
    }

    /// The lines to print: every row, and under it the published values where there is one.
    fn lines(&self) -> Vec<(usize, bool)> {
        let known = |row: &Vec<String>| {
            let mut cells = self.columns.iter().filter_map(|column| self.cell(row, column));
            cells.any(|cell| cell.published(self.style.decimals).is_some())
        };
        let lines = |(n, row)| if known(row) { vec![(n, false), (n, true)] } else { vec![(n, false)] };
        self.rows.iter().enumerate().flat_map(lines).collect()
    }

    fn print(&self) -> Vec<Column> {
        let lines = self.lines();
        let mut columns: Vec<Column> =
            (0..self.down.len()).map(|level| self.row_labels(level, &lines)).collect();
        if lines.iter().any(|(_, published)| *published) {
            let source = lines.iter().map(|(_, published)| if *published { self.style.source } else { OURS });
            columns.push(Column::words("source", source));
        }
        columns.extend(self.columns.iter().map(|column| {
            let header = if column.is_empty() { "score".to_owned() } else { column.join(" · ") };
            let score = |(row, published): &(usize, bool)| {
                let cell = self.cell(&self.rows[*row], column)?;
                let decimals = self.style.decimals;
                if *published {
                    cell.published(decimals)
                } else {
                    Some(Score::measured(&cell.summary, decimals))
                }
            };
            Column::scores(&header, &lines.iter().map(score).collect::<Vec<_>>())
        }));
        columns
    }

    /// A column of row labels: a label is not repeated while it and those left of it stay the same.
    fn row_labels(&self, level: usize, lines: &[(usize, bool)]) -> Column {
        let label = |(row, published): &(usize, bool)| {
            let same = |before: usize| self.rows[before][..=level] == self.rows[*row][..=level];
            let repeats = *published || row.checked_sub(1).is_some_and(same);
            if repeats { String::new() } else { self.rows[*row][level].clone() }
        };
        Column::words(&self.keys[self.down[level]], lines.iter().map(label))
    }
}

fn take(cell: &Cell<'_>, positions: &[usize]) -> Vec<String> {
    positions.iter().map(|at| cell.key[*at].clone()).collect()
}

/// The values that the cells take at these positions, each once, in the order of first appearance.
fn distinct(cells: &[Cell<'_>], positions: &[usize]) -> Vec<Vec<String>> {
    let mut values: Vec<Vec<String>> = Vec::new();
    for cell in cells {
        let value = take(cell, positions);
        if !values.contains(&value) {
            values.push(value);
        }
    }
    sort_by_appearance(&mut values, Vec::as_slice);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::markdown;
    use proptest::prelude::*;

    const STYLE: Style<'_> = Style { source: "paper", decimals: 0 };

    fn keys(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// Cells of a grid of three keys at these places, each with its own mean.
    fn cells(places: &[usize]) -> Vec<Cell<'static>> {
        let cell = |place: &usize| Cell {
            key: vec![format!("x{}", place % 3), format!("y{}", place / 3 % 3), format!("z{}", place / 9)],
            summary: Summary { mean: *place as f64, std: 0.0, episodes: 1 },
            published: None,
            trainings: 1,
            error: None,
            diverged: 0,
        };
        let mut cells: Vec<Cell<'static>> = places.iter().map(cell).collect();
        sort_by_appearance(&mut cells, |cell| &cell.key);
        cells
    }

    /// What a reader takes from a printed grid: the values of the keys, in alphabetical order, with the mean.
    fn read_back(pivot: &Pivot) -> Vec<(Vec<String>, String)> {
        let text = markdown::table(&pivot.columns);
        let mut lines = text.lines().map(|line| -> Vec<&str> { line.split('|').map(str::trim).collect() });
        let header = lines.next().unwrap();
        let mut found = Vec::new();
        let mut labels = vec![String::new(); header.len()];
        for line in lines.skip(1) {
            for at in 1..header.len() - 1 {
                let is_label = ["x", "y", "z"].contains(&header[at]);
                if is_label && !line[at].is_empty() {
                    labels[at] = line[at].to_owned();
                    labels[at + 1..].fill(String::new());
                } else if !is_label && !line[at].is_empty() {
                    let across = header[at].split(" · ").filter(|name| *name != "score").map(str::to_owned);
                    let down = labels.iter().filter(|label| !label.is_empty()).cloned();
                    let fixed = pivot.fixed.iter().map(|(_, value)| value.clone());
                    let mut key: Vec<String> = across.chain(down).chain(fixed).collect();
                    key.sort();
                    found.push((key, line[at].trim_end_matches(" ± 0").to_owned()));
                }
            }
        }
        found.sort();
        found
    }

    proptest! {
        #[test]
        fn a_reader_finds_every_cell_once_under_its_own_labels(
            places in Just((0..27).collect::<Vec<usize>>()).prop_shuffle(),
            taken in 1..=27_usize,
            across in prop::sample::subsequence(vec!["x", "y", "z"], 0..=3).prop_shuffle(),
        ) {
            let cells = cells(&places[..taken]);
            let pivot = Pivot::new(&keys(&["x", "y", "z"]), &keys(&across), STYLE, &cells);
            let mut expected: Vec<(Vec<String>, String)> =
                cells.iter().map(|cell| (cell.key.clone(), cell.summary.mean.to_string())).collect();
            expected.sort();
            prop_assert_eq!(read_back(&pivot), expected);
        }
    }

    #[test]
    fn the_lead_names_what_is_fixed_and_what_runs_across() {
        let pivot = Pivot::new(&keys(&["x", "y", "z"]), &keys(&["z", "y"]), STYLE, &cells(&[0, 3, 9]));
        assert_eq!(pivot.lead(), ["x: x0", "columns: z · y"]);
    }
}
