//! A table of the kind `table` as a grid: values of this run above the published ones, coloured by their distance in
//! standard errors: over the trainings of a cell where it has several, else over its episodes.

use dril_stage_api::Labels;
use maud::{Markup, html};
use serde_json::Value;

use super::count;
use super::csvs::Csv;
use crate::inference::{FEWEST_EPISODES, FEWEST_TRAININGS};
use crate::number::{fixed, rounded};

/// Assumed number of episodes behind a published value.
const PUBLISHED_EPISODES: f64 = 100.0;

/// The mark of a result whose training diverged.
pub(crate) const DIVERGED: &str = "†";

/// One cell.
#[derive(Clone, Debug, PartialEq)]
struct Cell {
    mean: f64,
    std: f64,
    episodes: usize,
    trainings: usize,
    /// The standard error of the mean over the trainings, where there are several.
    error: Option<f64>,
    /// How many of the trainings diverged.
    diverged: usize,
    /// Mean and standard deviation as published.
    reference: Option<(f64, Option<f64>)>,
    /// What is shown: this run's score, and the published one.
    ours: String,
    published: Option<String>,
}

/// The grid.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Grid {
    down: Vec<String>,
    across: Vec<String>,
    rows: Vec<Vec<String>>,
    columns: Vec<Vec<String>>,
    cells: Vec<(Vec<String>, Vec<String>, Cell)>,
}

fn list(params: &Value, name: &str) -> Vec<String> {
    let items = params.get(name).and_then(Value::as_array).into_iter().flatten();
    items.filter_map(Value::as_str).map(str::to_owned).collect()
}

impl Cell {
    /// A cell that is shown with this many decimals.
    fn of(csv: &Csv, row: &[String], decimals: usize) -> Option<Self> {
        let number = |name: &str| csv.cell(row, name).parse::<f64>().ok();
        // The published columns were once called after the thesis.
        let either = |what: &str| {
            let names = [format!("reference_{what}"), format!("thesis_{what}")];
            names.iter().find_map(|name| Some((number(name)?, csv.cell(row, name))))
        };
        let (mean, std) = (either("mean"), either("std"));
        // As in the Markdown table, published numbers keep their digits beside decimals.
        let published = |(value, text): (f64, &str)| match decimals {
            0 => rounded(value),
            _ => text.to_owned(),
        };
        let ours = |name: &str| number(name).map(|value| fixed(value, decimals));
        let whole = |name: &str| csv.cell(row, name).parse::<usize>().ok();
        Some(Self {
            mean: number("mean")?,
            std: number("std")?,
            episodes: whole("episodes")?,
            trainings: whole("trainings")?,
            error: number("mean_error"),
            diverged: whole("diverged")?,
            reference: mean.map(|(mean, _)| (mean, std.map(|(std, _)| std))),
            ours: score(&ours("mean")?, ours("std")),
            published: mean.map(|mean| score(&published(mean), std.map(published))),
        })
    }

    fn is_pooled(&self) -> bool {
        self.trainings > 1
    }

    /// True where there are too few trainings, or episodes of the only one, for an interval.
    fn is_few(&self) -> bool {
        if self.is_pooled() { self.has_few_trainings() } else { self.episodes < FEWEST_EPISODES }
    }

    fn has_few_trainings(&self) -> bool {
        self.is_pooled() && self.trainings < FEWEST_TRAININGS
    }

    /// The variance of the mean. The episodes of one training are not independent of each other where there are several
    /// trainings, so the trainings are counted; `None` where there are too few.
    fn variance(&self) -> Option<f64> {
        if self.has_few_trainings() {
            return None;
        }
        if self.is_pooled() {
            return self.error.map(|error| error.powi(2));
        }
        Some(self.std.powi(2) / self.episodes as f64)
    }

    /// Distance from the published value in standard errors of the difference; positive if above.
    fn distance(&self) -> Option<f64> {
        let (mean, std) = self.reference?;
        let variance = self.variance()? + std?.powi(2) / PUBLISHED_EPISODES;
        (variance > 0.0).then(|| (self.mean - mean) / variance.sqrt())
    }

    fn class(&self) -> String {
        let few = if self.is_few() { " few" } else { "" };
        let step = self.distance().map_or(0, step);
        match step {
            0 => format!("n{few}"),
            step if step > 0 => format!("n u{step}{few}"),
            step => format!("n d{}{few}", -step),
        }
    }

    fn show(&self) -> Markup {
        let mark = match self.distance().map_or(0, step) {
            step if step > 0 => "▲",
            step if step < 0 => "▼",
            _ => "",
        };
        let far = self
            .distance()
            .map(|distance| format!("{} standard errors from the published value", fixed(distance, 1)));
        let diverged = (self.diverged > 0).then(|| match self.trainings {
            1 => "training diverged".to_owned(),
            all => format!("{} of {all} trainings diverged", self.diverged),
        });
        let notes: Vec<String> = far.into_iter().chain(diverged).collect();
        let title = (!notes.is_empty()).then(|| notes.join("; "));
        html! {
            span title=[title] {
                (mark) (self.ours) @if self.diverged > 0 { (DIVERGED) }
            }
            @if let Some(published) = &self.published {
                span class="ref" { (published) }
            }
        }
    }
}

/// `−12 ± 3`.
fn score(mean: &str, std: Option<String>) -> String {
    let std = std.map_or_else(String::new, |std| format!(" ± {std}"));
    mean.replace('-', "−") + &std
}

/// From −3 to 3: beyond one, two and three standard errors.
fn step(distance: f64) -> i32 {
    let size = if distance.abs() >= 3.0 { 3 } else { distance.abs().floor() as i32 };
    if distance < 0.0 { -size } else { size }
}

/// The parameter `decimals` of any kind. An older result has none. No more than the kinds allow, whatever a file says.
pub(super) fn decimals(params: &Value) -> usize {
    params.get("decimals").and_then(Value::as_u64).map_or(0, |decimals| decimals.min(6) as usize)
}

impl Grid {
    /// The grid of a table's CSV under its parameters; `None` where they do not belong together.
    pub(crate) fn of(params: &Value, csv: &Csv) -> Option<Self> {
        Self::with_gaps(params, csv, &[])
    }

    /// As [`Self::of`], with empty cells for combinations that have no row yet. `all` are the labels of the evaluations of
    /// the whole table, in the order of the matrix.
    pub(crate) fn with_gaps(params: &Value, csv: &Csv, all: &[&Labels]) -> Option<Self> {
        let (keys, across) = (list(params, "keys"), list(params, "columns"));
        let decimals = decimals(params);
        let mut grid = Self {
            down: keys.iter().filter(|key| !across.contains(key)).cloned().collect(),
            across,
            rows: Vec::new(),
            columns: Vec::new(),
            cells: Vec::new(),
        };
        // A key with one value in the whole table says nothing about its rows.
        let varies = |key: &String| {
            csv.rows.iter().any(|row| csv.cell(row, key) != csv.cell(&csv.rows[0], key))
                || all.iter().any(|labels| labels.get(key) != all[0].get(key))
        };
        grid.down.retain(varies);
        grid.across.retain(varies);
        for labels in all {
            let take = |keys: &[String]| -> Vec<String> {
                keys.iter().map(|key| labels.get(key).cloned().unwrap_or_default()).collect()
            };
            grid.add(&take(&grid.down), &take(&grid.across));
        }
        for row in &csv.rows {
            let take = |keys: &[String]| -> Vec<String> {
                keys.iter().map(|key| csv.cell(row, key).to_owned()).collect()
            };
            let (down, across) = (take(&grid.down), take(&grid.across));
            grid.add(&down, &across);
            grid.cells.push((down, across, Cell::of(csv, row, decimals)?));
        }
        crate::pivot::sort_by_appearance(&mut grid.columns, Vec::as_slice);
        Some(grid)
    }

    fn add(&mut self, down: &[String], across: &[String]) {
        if !self.rows.iter().any(|row| row == down) {
            self.rows.push(down.to_vec());
        }
        if !self.columns.iter().any(|column| column == across) {
            self.columns.push(across.to_vec());
        }
    }

    fn cell(&self, down: &[String], across: &[String]) -> Option<&Cell> {
        self.cells.iter().find(|(row, column, _)| row == down && column == across).map(|(_, _, cell)| cell)
    }

    /// The rows with the label that opens each level, where it is not the one above.
    fn labels(&self, n: usize) -> Vec<Option<&str>> {
        let row = &self.rows[n];
        let label = |level: usize| {
            let same = n > 0 && self.rows[n - 1][..=level] == row[..=level];
            (!same).then_some(row[level].as_str())
        };
        (0..row.len()).map(label).collect()
    }

    pub(crate) fn table(&self, caption: &str) -> Markup {
        html! {
            div class="wide" tabindex="0" role="region" aria-label=(caption) {
                table {
                    caption { (caption) }
                    thead { tr {
                        @for key in &self.down { th scope="col" { (key) } }
                        @for column in &self.columns {
                            th scope="col" class="n" {
                                @if column.is_empty() { "score" } @else { (column.join(" · ")) }
                            }
                        }
                    } }
                    tbody { @for (n, row) in self.rows.iter().enumerate() { tr {
                        @for label in self.labels(n) {
                            @match label { Some(label) => { th scope="row" { (label) } }, None => { td {} } }
                        }
                        @for column in &self.columns {
                            @match self.cell(row, column) {
                                Some(cell) => { td class=(cell.class()) { (cell.show()) } },
                                None => { td {} },
                            }
                        }
                    } } }
                }
            }
            (self.explain())
        }
    }

    /// The smallest and the largest number of trainings of a cell, in words.
    fn trainings(&self) -> String {
        let all = || self.cells.iter().map(|(_, _, cell)| cell.trainings);
        match (all().min().unwrap_or(1), all().max().unwrap_or(1)) {
            (low, high) if low == high => count(high, "training"),
            (low, high) => format!("{low} to {}", count(high, "training")),
        }
    }

    /// What a coloured cell counts as independent values.
    fn unit(&self) -> &'static str {
        let mut coloured = self.cells.iter().filter(|(_, _, cell)| cell.distance().is_some()).peekable();
        let pooled = coloured.peek().is_some_and(|(_, _, cell)| cell.is_pooled());
        match (pooled, coloured.all(|(_, _, cell)| cell.is_pooled() == pooled)) {
            (true, true) => "over trainings",
            (false, true) => "over episodes",
            _ => "over trainings, and over episodes where a cell has one training",
        }
    }

    fn explain(&self) -> Markup {
        let columns = self.across.join(" · ");
        let has = |test: fn(&Cell) -> bool| self.cells.iter().any(|(_, _, cell)| test(cell));
        let has_reference = has(|cell| cell.reference.is_some());
        let has_distance = has(|cell| cell.distance().is_some());
        let lacks_deviation = has(|cell| matches!(cell.reference, Some((_, None))));
        let few = [
            has(|cell| cell.is_few() && !cell.is_pooled()).then(|| format!("{FEWEST_EPISODES} episodes")),
            has(Cell::has_few_trainings).then(|| format!("{FEWEST_TRAININGS} trainings")),
        ];
        let few = few.into_iter().flatten().collect::<Vec<_>>().join(" or ");
        html! {
            p class="quiet legend" {
                "Mean ± standard deviation over episodes"
                @if has(Cell::is_pooled) { ", pooled over " (self.trainings()) }
                @if has_reference { ", with the published value below" }
                @if !columns.is_empty() { ". Columns: " (columns) }
                @if has_distance {
                    ". Colour: this run is "
                    span class="d3" { "▼3" } span class="d2" { "▼2" } span class="d1" { "▼1" }
                    " or more standard errors of the difference below it, or "
                    span class="u1" { "▲1" } span class="u2" { "▲2" } span class="u3" { "▲3" }
                    " or more above (" (self.unit()) "; "
                    (rounded(PUBLISHED_EPISODES)) " episodes per published value)"
                }
                @if lacks_deviation { ". Values published without a deviation give no colour" }
                @if !few.is_empty() { ". " span class="few" { "Hatched" } ": fewer than " (few) ", no interval" }
                @if has(Cell::has_few_trainings) { "; two trainings have no colour" }
                @if has(|cell| cell.diverged > 0) {
                    ". " (DIVERGED) ": training diverged, and the last finite weights were evaluated"
                }
                "."
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_table_becomes_a_grid_with_the_published_value_under_each_cell() {
        let text = "expert,policy,n,mean,std,episodes,trainings,mean_error,diverged,reference_mean,reference_std\n\
                    c,g,1,100.00,10.00,100,1,,0,90,10\nc,g,20,200.00,10.00,100,1,,0,,\n\
                    c,b,1,50.00,10.00,20,1,,0,100,10\n";
        let csv = Csv::parse(text.as_bytes()).unwrap();
        let grid = Grid::of(&json!({ "keys": ["expert", "policy", "n"], "columns": ["n"] }), &csv).unwrap();
        assert_eq!((&grid.down, &grid.across), (&vec!["policy".to_owned()], &vec!["n".to_owned()]));
        let page = grid.table("T").into_string();
        // Ten points of √2 standard errors each: far above; and 50 points of 2.4 below, over few episodes.
        assert!(page.contains("class=\"n u3\"") && page.contains("class=\"n d3 few\""), "{page}");
        assert!(page.contains("<td></td>"), "a combination that was not measured is empty");
    }

    #[test]
    fn the_unit_of_a_pooled_cell_is_the_training_and_two_are_too_few_for_a_colour() {
        let page = |cell: &str| {
            let text = format!(
                "n,mean,std,episodes,trainings,mean_error,diverged,reference_mean,reference_std\n\
                 1,100.00,50.00,{cell},0,80,10\n"
            );
            let csv = Csv::parse(text.as_bytes()).unwrap();
            Grid::of(&json!({ "keys": ["n"] }), &csv).unwrap().table("T").into_string()
        };
        // Over 1,000 episodes the distance were 10 standard errors; over ten trainings it is less than one.
        let ten = page("1000,10,25.00");
        assert!(ten.contains("<td class=\"n\">"), "{ten}");
        assert!(ten.contains("over trainings") && ten.contains("10 trainings"), "{ten}");
        assert!(page("1000,10,9.00").contains("<td class=\"n u2\">"));
        let two = page("1000,2,0.10");
        assert!(two.contains("<td class=\"n few\">") && !two.contains("Colour: "), "{two}");
        assert!(two.contains("fewer than 3 trainings"), "{two}");
        let one = page("1000,1,");
        assert!(one.contains("<td class=\"n u3\">") && !one.contains("trainings"), "{one}");
    }

    #[test]
    fn colours_are_explained_only_where_there_are_some() {
        let page = |reference: &str| {
            let text = format!(
                "n,mean,std,episodes,trainings,mean_error,diverged,reference_mean,reference_std\n\
                 1,100.00,10.00,100,1,,0,{reference}\n"
            );
            let csv = Csv::parse(text.as_bytes()).unwrap();
            Grid::of(&json!({ "keys": ["n"] }), &csv).unwrap().table("T").into_string()
        };
        let (both, mean, none) = (page("90,10"), page("90,"), page(","));
        assert!(both.contains("Colour: ") && !both.contains("give no colour"), "{both}");
        assert!(mean.contains("give no colour") && !mean.contains("Colour: "), "{mean}");
        assert!(!none.contains("give no colour") && !none.contains("Colour: "), "{none}");
    }

    #[test]
    fn colours_have_three_steps_each_way() {
        assert_eq!(
            [-9.0, -3.0, -2.5, -1.0, -0.9, 0.0, 1.1, 2.0, 4.0].map(step),
            [-3, -3, -2, -1, 0, 0, 1, 2, 3]
        );
    }
}
